//! How fast pictures come: the report of a day of the Canton Tower, and the page on the same study, in Chromium.
//!
//! `cargo bench -p belfry-benches --bench page` (needs chromium and chromedriver). Frames and times are the browser's own; it has no
//! window and no graphics card here, so a desk computer is faster. Run it with nothing else beside.

#[allow(dead_code, reason = "the stories use the rest")]
#[path = "../../tests/stories/page/driver.rs"]
mod driver;
#[allow(dead_code, reason = "the stories use the rest")]
#[path = "../../tests/stories/page/server.rs"]
mod server;

use std::path::Path;
use std::time::{Duration, Instant};

use belfry_tests::belfry_command;
use driver::Browser;
use serde_json::{Value, json};
use server::Server;

const RUNS: usize = 5;
/// A page that was scrolled is at rest after this time.
const SETTLED: Duration = Duration::from_secs(1);
const WINDOW: (u32, u32) = (1280, 900);

/// Notes when the first picture has been shown, in ms since the address was opened.
const WATCH: &str = "new MutationObserver(() => { if (!window.firstPicture && document.querySelector('figure:not(.waits) canvas')) \
    requestAnimationFrame(() => setTimeout(() => window.firstPicture ??= performance.now())) }) \
    .observe(document, { subtree: true, childList: true, attributes: true })";

/// The gaps between frames while `work(frame)` runs in each of them, ms.
const FRAMES: &str = "const done = arguments[arguments.length - 1], gaps = []; let last = null, count = 0; \
    const next = now => { if (last !== null) gaps.push(now - last); last = now; WORK; if (++count < 240) requestAnimationFrame(next); else done(gaps) }; \
    requestAnimationFrame(next)";

/// Whether the page has its pictures, and all of them are drawn.
const DRAWN: &str = "return document.querySelectorAll('figure').length > 8 && !document.querySelector('figure.waits, figure[data-dirty]')";

/// How long after an act something holds: until the pictures in sight are drawn, and until all are, ms.
const UNTIL: &str = "const done = arguments[arguments.length - 1], begin = performance.now(); let first = null; \
    const isSeen = figure => { const box = figure.getBoundingClientRect(); return box.bottom > 0 && box.top < innerHeight }; \
    const look = () => { const dirty = HOLDS ? [...document.querySelectorAll('figure[data-dirty]')] : null; \
        if (dirty && !dirty.some(isSeen)) first ??= performance.now() - begin; \
        dirty?.length === 0 ? done([first, performance.now() - begin]) : setTimeout(look, 1) }; ACT; setTimeout(look, 1)";

fn run(words: &[&str]) {
    let output = belfry_command().args(words).output().expect("belfry starts");
    assert!(output.status.success(), "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
}

/// Least, median and largest.
fn spread(mut values: Vec<f64>) -> (f64, f64, f64) {
    values.sort_by(f64::total_cmp);
    (values[0], values[values.len() / 2], values[values.len() - 1])
}

fn say(what: &str, values: Vec<f64>, unit: &str) {
    let count = values.len();
    let (least, median, most) = spread(values);
    println!("{what}: {median:.3} {unit} ({least:.3} to {most:.3} in {count} runs)");
}

fn say_frames(what: &str, gaps: &Value) {
    let gaps: Vec<f64> = gaps.as_array().expect("gaps").iter().filter_map(Value::as_f64).collect();
    let mean = gaps.iter().sum::<f64>() / gaps.len() as f64;
    let late = gaps.iter().filter(|gap| **gap > 25.0).count();
    let (_, _, most) = spread(gaps.clone());
    println!("{what}: {:.1} frames a second, longest {most:.0} ms, {late} of {} late", 1000.0 / mean, gaps.len());
}

/// How long after an act the pictures in sight, and all pictures, are as `holds` says, ms.
async fn timed(browser: &Browser, act: &str, holds: &str) -> [f64; 2] {
    let script = UNTIL.replace("HOLDS", holds).replace("ACT", act);
    let times = browser.client.execute_async(&script, Vec::new()).await.unwrap();
    [0, 1].map(|which| times[which].as_f64().expect("a time"))
}

#[tokio::main]
async fn main() {
    // `cargo test --benches` runs this as well.
    if !std::env::args().any(|word| word == "--bench") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let study = folder.path().join("canton").to_str().unwrap().to_owned();
    run(&["init", &study, "--template", "canton"]);
    run(&["simulate", &study, "--effect", "base-rotation=1.2e-14", "--hours", "24", "--seed", "3", "--adopt"]);
    run(&["identify", &study, "--direct"]);
    run(&["update", &study]);
    run(&["covalidate", &study, "--channels", "09", "--direct"]);
    run(&["diagnose", &study]);

    let mut written = Vec::new();
    for _ in 0..RUNS {
        let start = Instant::now();
        run(&["report", &study]);
        written.push(start.elapsed().as_secs_f64());
    }
    let report = Path::new(&study).join("results/report.html");
    println!("report of 24 h: {} bytes", std::fs::metadata(&report).unwrap().len());
    say("report written", written, "s");

    let browser = Browser::start(&[]).await;
    browser.size(WINDOW).await;
    browser.before_each_page(WATCH).await;
    let (mut first, mut all) = (Vec::new(), Vec::new());
    for _ in 0..RUNS {
        browser.client.goto(&format!("file://{}", report.display())).await.unwrap();
        let holds = "window.firstPicture && !document.querySelector('figure.waits')";
        let here = "const done = arguments[arguments.length - 1], look = () => HOLDS ? done([firstPicture, performance.now()]) : setTimeout(look); look()";
        let times = browser.client.execute_async(&here.replace("HOLDS", holds), Vec::new()).await.unwrap();
        first.push(times[0].as_f64().unwrap() / 1000.0);
        all.push(times[1].as_f64().unwrap() / 1000.0);
    }
    say("first picture of the report", first, "s");
    say("all pictures of the report", all, "s");

    browser.script("document.getElementById('structure-3d').scrollIntoView()").await;
    let frames = |work: &str| FRAMES.replace("WORK", work);
    say_frames("animation", &browser.client.execute_async(&frames(""), Vec::new()).await.unwrap());
    // The record's minima and maxima, and the left-out sensor's curves: the wheel turns in and out again.
    for id in ["covalidation", "record"] {
        let there = browser.script(&format!("const f = document.getElementById('{id}'); f?.scrollIntoView(); f?.querySelector('.plot').focus(); return Boolean(f)")).await;
        assert_eq!(there, json!(true), "{id}");
        // What has come into sight is painted before it is zoomed.
        tokio::time::sleep(SETTLED).await;
        let wheel = format!(
            "{{ const over = document.querySelector('#{id} .u-over'), box = over.getBoundingClientRect(); \
            over.dispatchEvent(new WheelEvent('wheel', {{ deltaY: count % 120 < 60 ? -40 : 40, clientX: box.left + box.width / 3, clientY: box.top + 20, bubbles: true, cancelable: true }})) }}"
        );
        say_frames(&format!("zoom of {id}"), &browser.client.execute_async(&frames(&wheel), Vec::new()).await.unwrap());
    }

    let server = Server::start(&study);
    browser.client.goto(&server.address).await.unwrap();
    browser.wait_for("the page is drawn", DRAWN).await;
    browser.script("document.getElementById('model').scrollIntoView()").await;
    let (mut added, mut removed) = (Vec::new(), Vec::new());
    let (mut seen, mut moved) = (Vec::new(), Vec::new());
    let press = |words: &str| {
        format!("[...document.querySelectorAll('button')].find(b => b.textContent.startsWith('{words}')).click()")
    };
    for _ in 0..RUNS {
        let facts = "document.getElementById('header').textContent.includes('base-rotation')";
        added.push(timed(&browser, &press("Add base-rotation"), facts).await[1] / 1000.0);
        browser.done("add").await;
        for value in ["0.2", "-0.15", "0.4", "0"] {
            let text = "document.querySelector('#frequency-errors figcaption').textContent";
            let slide = format!(
                "const before = {text}, slider = document.getElementById('slider-0'); slider.value = '{value}'; slider.dispatchEvent(new Event('input'))"
            );
            let [in_sight, all] = timed(&browser, &slide, &format!("{text} !== before")).await;
            seen.push(in_sight);
            moved.push(all);
        }
        removed.push(timed(&browser, &press("Undo: remove"), &format!("!{facts}")).await[1] / 1000.0);
        browser.done("remove").await;
    }
    say("effect added, all pictures follow", added, "s");
    say("effect removed, all pictures follow", removed, "s");
    say("slider moved, pictures in sight follow", seen, "ms");
    say("slider moved, all pictures follow", moved, "ms");
    browser.end().await;
}
