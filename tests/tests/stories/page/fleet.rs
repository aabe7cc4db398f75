//! Somebody looks after many structures: which of them raises an alarm, where it is, and what it says, in a browser.

use std::process::Stdio;
use std::thread;
use std::time::{Duration, Instant};

use belfry_tests::nats::NatsServer;
use belfry_tests::{belfry_command, fleet};
use serde_json::json;

use super::driver::Browser;
use super::server::Server;

const DESKTOP: (u32, u32) = (1280, 1000);
const PHONE: (u32, u32) = (390, 844);
/// Whether nothing is wider than the window.
const FITS: &str = "return document.documentElement.scrollWidth <= window.innerWidth + 1";

#[tokio::test(flavor = "multi_thread")]
#[cfg_attr(not(nats), ignore = "nats-server is not installed; ./test installs it")]
async fn a_fleet_is_looked_over_and_a_structure_with_an_alarm_is_looked_into() {
    const STRUCTURES: usize = 5;
    let server = tokio::task::spawn_blocking(|| {
        let server = NatsServer::start().unwrap();
        let about = |number: usize| match number {
            4 => String::new(),
            _ => format!("place_deg = [{}, {}]", 46.1 + 0.37 * number as f64, 6.1 + 0.9 * (number * number % 5) as f64),
        };
        fleet::publish(&server, STRUCTURES, 3, 1, about).unwrap();
        let mut command = belfry_command();
        let mut worker =
            command.args(["work", "--from", &server.url()]).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let start = Instant::now();
        while server.count_results().unwrap_or(0) < STRUCTURES * 3 {
            assert!(start.elapsed() < Duration::from_secs(120), "no results");
            thread::sleep(Duration::from_millis(200));
        }
        worker.kill().unwrap();
        worker.wait().unwrap();
        // As a worker keeps it after some months.
        let alarm = json!({
            "raised_s": 1.8e9, "first_day_s": 1.7998e9, "between_s": [1.79975e9, 1.79985e9], "log_evidence": 12.5, "state": "open",
            "modes": [{"number": 1, "percent": -0.41, "std_percent": 0.03}, {"number": 2, "percent": -0.02, "std_percent": 0.03}],
        });
        let judgement = json!({
            "standing": "changed", "days": 60, "frost_days": 3, "missing_days": 0, "log_evidence": 12.5, "alarm_from": 6.9,
            "alarms": [alarm], "lost_modes": [], "days_s": [],
        });
        let state = json!({"day": 20_833, "alarms": 0, "watch": {"judged_until_s": 1.8e9, "judgement": judgement, "causes": [null]}});
        server.put("belfry-states", "Tower-2", &state).unwrap();
        server
    })
    .await
    .unwrap();
    let page = Server::start_with(&["--fleet", &server.url()]);
    let browser = Browser::start(&[]).await;
    browser.size(DESKTOP).await;
    browser.client.goto(&page.address).await.unwrap();
    let rows = "document.querySelectorAll('main tbody tr').length";
    browser.wait_for("all structures", &format!("return {rows} === 5")).await;
    // The worst comes first, and says what it is.
    let first = "document.querySelector('main tbody tr').textContent";
    browser
        .wait_for("the alarm", &format!("return {first}.includes('Tower 2') && {first}.includes('alarm') && {first}.includes('mode 1 by −0.41 ± 0.03 %') && !{first}.includes('mode 2')"))
        .await;
    assert_eq!(browser.script("return document.querySelectorAll('.map a').length").await, json!(4), "one has no place");
    browser.picture("fleet").await;
    assert_eq!(browser.inaccessible().await, Vec::<String>::new());
    // Those that learn are chosen by a click.
    browser.click("learning").await;
    browser.wait_for("the others", &format!("return {rows} === 4")).await;
    browser.click("all").await;
    browser.wait_for("all again", &format!("return {rows} === 5")).await;
    browser.size(PHONE).await;
    browser.wait_for("nothing is wider than a phone", FITS).await;
    browser.picture("fleet on a phone").await;
    browser.size(DESKTOP).await;
    // From the map to the structure, and back.
    browser.script("document.querySelector('.map a[aria-label^=\"Tower 2\"]').dispatchEvent(new MouseEvent('click', { bubbles: true, cancelable: true }))").await;
    browser.wait_for("the structure", "return document.querySelector('h1').textContent === 'Tower 2' && document.querySelectorAll('.course svg').length >= 10").await;
    browser.picture("structure of a fleet").await;
    assert_eq!(browser.inaccessible().await, Vec::<String>::new());
    let shown = browser.script("return document.querySelectorAll('[aria-label=Nodes] tbody tr').length").await;
    assert!(shown.as_u64() >= Some(5), "{shown}");
    browser.script("history.back()").await;
    browser.wait_for("the list", &format!("return {rows} === 5")).await;
    // A structure that nobody has added is no page, and another site learns nothing.
    assert_eq!(page.get("/structure?key=Tower-9").status, 404);
    assert_eq!(page.get("/structure?key=%2A").status, 404);
    assert_eq!(page.ask_as("GET", "/data", &[], "").status, 401);
    browser.no_errors().await;
    // One that something else has written hides none of the others.
    let server = tokio::task::spawn_blocking(move || {
        server.put("belfry-structures", "Strange", &json!({ "nodes": 3 })).unwrap();
        server
    });
    let server = server.await.unwrap();
    let strange = format!(
        "return {rows} === 6 && document.querySelector('main tbody').textContent.includes('the entry of Strange')"
    );
    browser.wait_for("what cannot be read", &strange).await;
    // The server goes: the page says so, and what it knew stays.
    tokio::task::spawn_blocking(move || drop(server)).await.unwrap();
    browser
        .wait_for(
            "that the server is away",
            &format!(
                "return document.querySelector('header .failed')?.textContent.startsWith('The server:') && {rows} === 6"
            ),
        )
        .await;
    browser.end().await;
}
