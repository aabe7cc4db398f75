//! The whole story clicked through in a real browser: compare, see where it fails, learn what is missing, add it, watch the error fall.

use std::fs;

use fantoccini::Locator;
use fantoccini::key::Key;
use serde_json::json;

use super::driver::Browser;
use super::server::Server;
use super::{run, study};

/// Widths of a desktop's window and of a phone's.
const DESKTOP: (u32, u32) = (1280, 900);
const PHONE: (u32, u32) = (390, 844);
/// Whether nothing is wider than the window.
const FITS: &str = "return document.documentElement.scrollWidth <= window.innerWidth + 1";
/// Whether every picture is drawn.
const DRAWN: &str = "return document.querySelectorAll('figure').length > 8 && !document.querySelector('figure.waits, figure[data-dirty]')";

#[tokio::test(flavor = "multi_thread")]
async fn the_missing_effect_is_found_and_added_by_clicks_and_the_error_falls() {
    let folder = tempfile::tempdir().unwrap();
    let study = study(folder.path());
    run(&["identify", &study, "--direct"]);
    let server = Server::start(&study);
    let browser = Browser::start(&["--force-prefers-reduced-motion"]).await;
    browser.size(DESKTOP).await;
    browser.client.goto(&server.address).await.unwrap();
    browser.wait_for("the page is drawn", DRAWN).await;
    browser.picture("1 identified").await;

    browser.click("Compare with the model").await;
    browser.done("compare").await;
    browser.click("Ask what is missing").await;
    browser.done("diagnose").await;
    browser
        .wait_for(
            "the verdict",
            "return document.getElementById('findings').textContent.includes('The model lacks base-rotation')",
        )
        .await;
    // Whoever works by keyboard goes on from where the button stands.
    let focus = "return document.activeElement.textContent === 'Ask what is missing'";
    browser.wait_for("the focus stays", focus).await;
    browser.click("Close").await;
    browser
        .wait_for(
            "the status line is closed",
            "return document.querySelector('.status [role=status]').textContent === 'Ready.'",
        )
        .await;
    browser.picture("2 diagnosed").await;
    browser.click("Add base-rotation to the model").await;
    browser.done("add").await;
    browser
        .wait_for(
            "the error fell",
            "return document.getElementById('findings').textContent.includes('the mean frequency error fell from')",
        )
        .await;
    browser.wait_for("all pictures follow", DRAWN).await;
    browser.picture("3 added").await;
    let again = "return document.querySelectorAll('[aria-label=\"Add base-rotation to the model\"]').length";
    assert_eq!(browser.script(again).await, json!(0), "what is in the model is not to be added");
    // Each candidate that could be there has its fingerprint.
    let data = server.data();
    let candidates = data["diagnosis"]["candidates"].as_array().unwrap();
    let possible = candidates.iter().filter(|one| one["admissible"] != false).count();
    let shown = browser.script("return document.querySelectorAll('#fingerprints button canvas').length").await;
    assert!(possible > 4 && shown == json!(possible), "{shown} of {possible}");

    // A slider: shapes and frequencies follow, the study does not.
    let toml = fs::read(format!("{study}/study.toml")).unwrap();
    let frequencies = "return document.getElementById('frequency-errors').querySelector('figcaption').textContent";
    let fitted = browser.script(frequencies).await;
    let slider = browser.client.find(Locator::Css("input[type=range]#slider-0")).await.unwrap();
    slider.send_keys(&Key::Right.to_string().repeat(20)).await.unwrap();
    browser.wait_for("the slider's model", &format!("{frequencies} !== {fitted}")).await;
    assert_eq!(fs::read(format!("{study}/study.toml")).unwrap(), toml);
    // Beside the shapes, with the numbers that follow.
    let note =
        "return document.querySelector('#structure .sliders .note').textContent.includes('mean error of frequencies')";
    browser.wait_for("the slider's numbers", note).await;
    // A link shows the same: the slider's value, and which curves are on.
    let hide = "[...document.querySelectorAll('#structure-3d .key label')].find(one => one.textContent === 'model as first given').querySelector('input')";
    browser.script(&format!("{hide}.click()")).await;
    let tried = "location.hash.includes('try=') && location.hash.includes('hidden=')";
    browser.wait_for("the view in the address", &format!("return {tried}")).await;
    let moved = browser.script(frequencies).await;
    let here = browser.client.current_url().await.unwrap();
    let window = browser.client.window().await.unwrap();
    let other = browser.client.new_window(true).await.unwrap().handle;
    browser.client.switch_to_window(other).await.unwrap();
    browser.client.goto(here.as_str()).await.unwrap();
    browser.wait_for("the other window is drawn", DRAWN).await;
    browser.wait_for("the slider's model there", &format!("{frequencies} === {moved}")).await;
    let at = "return [document.getElementById('slider-0').value, document.querySelectorAll('#structure-3d .key input:not(:checked)').length]";
    assert_eq!(browser.script(at).await, json!(["0.2", 1]));
    browser.client.close_window().await.unwrap();
    browser.client.switch_to_window(window).await.unwrap();
    browser.script(&format!("{hide}.click()")).await;
    browser.click("Reset to the fitted values").await;
    browser.wait_for("the fitted model again", &format!("{frequencies} === {fitted}")).await;

    // By keyboard: Tab reaches the first link, Enter follows it, and focus is seen.
    browser.client.find(Locator::Css("body")).await.unwrap().send_keys(&Key::Tab.to_string()).await.unwrap();
    let focus = "return getComputedStyle(document.activeElement).outlineStyle !== 'none' && document.activeElement !== document.body";
    browser.wait_for("a focus that is seen", focus).await;

    // Another window on the same study, by the address of this view.
    browser.script("location.hash = 'mode=3'").await;
    browser
        .wait_for(
            "the view follows its address",
            "return document.querySelector('#header select, nav select').value === '3'",
        )
        .await;
    // By its frequency, for numbers change with the next identification; a frequency that no mode is near to is none.
    let mode = "return document.querySelector('nav select').value";
    // The address follows a moment after the page. It holds all digits, the choice of modes a few of them.
    let is_named = "Math.abs(parseFloat(location.hash.match(/mode=([^&]*)Hz/)?.[1]) / parseFloat(document.querySelector('nav select').selectedOptions[0].textContent.split('·')[1]) - 1) < 0.001";
    browser.script("location.hash = 'mode=0.6Hz'").await;
    browser.wait_for("no mode is at 0.6 Hz", &format!("{mode} === '1'")).await;
    browser.click("›").await;
    browser.wait_for("the next mode", &format!("{mode} === '2'")).await;
    browser.click("›").await;
    browser.wait_for("the mode's frequency in the address", &format!("{mode} === '3' && {is_named}")).await;
    let view = browser.client.current_url().await.unwrap();
    let first = browser.client.window().await.unwrap();
    let others = browser.client.new_window(true).await.unwrap().handle;
    browser.client.switch_to_window(others.clone()).await.unwrap();
    browser.client.goto(view.as_str()).await.unwrap();
    browser.wait_for("the other window is drawn", DRAWN).await;
    browser.click("Undo: remove base-rotation").await;
    browser.done("remove").await;
    browser.client.switch_to_window(first.clone()).await.unwrap();
    browser
        .wait_for("both windows agree", "return !document.body.textContent.includes('Undo: remove base-rotation')")
        .await;

    // What was undone is no fall.
    let undone =
        "return document.querySelector('#history figcaption').textContent.includes('the same effects as at first')";
    browser.wait_for("the undone step", undone).await;

    // A click on the line of a mode is that mode; where several are in sight, the page says how to choose lines for its fit.
    browser.script("location.hash = 'singular-values&mode=1'").await;
    let hint = "return document.getElementById('singular-values').textContent.includes('zoom until mode 1 is the only mode in sight')";
    browser.wait_for("how to fit a band", hint).await;
    let at = "const over = document.querySelector('#singular-values .u-over').getBoundingClientRect(), mark = [...document.querySelectorAll('#singular-values .mark')].find(one => one.textContent === '2').getBoundingClientRect();
        return [mark.left + mark.width / 2 + 3, over.top + 60]";
    browser.press(&browser.script(at).await).await;
    browser.wait_for("the mode of the line", &format!("{mode} === '2'")).await;

    // Half way to the next mode no peak stands: the page says which is the nearest, and there is nothing to add.
    let between = "const over = document.querySelector('#singular-values .u-over').getBoundingClientRect(), [a, b] = ['2', '3'].map(number => [...document.querySelectorAll('#singular-values .mark')].find(one => one.textContent === number).getBoundingClientRect());
        return [(a.left + b.right) / 2, over.top + 60]";
    browser.press(&browser.script(between).await).await;
    let none = "const text = document.getElementById('singular-values').textContent; return text.includes('No peak stands out at 0.2') && text.includes('; the nearest is mode ') && !text.includes('Add a mode')";
    browser.wait_for("no peak there", none).await;

    // A study that cannot be read says so until it can.
    let toml = fs::read_to_string(format!("{study}/study.toml")).unwrap();
    fs::write(format!("{study}/study.toml"), "[structure").unwrap();
    let is_bad = "document.querySelector('.status').classList.contains('failed')";
    browser.wait_for("the error", &format!("return {is_bad}")).await;
    fs::write(format!("{study}/study.toml"), toml).unwrap();
    browser.wait_for("the error is gone", &format!("return !{is_bad}")).await;
    // The browser notes by itself that the data were refused.
    browser.no_errors_but("/data - Failed to load resource").await;

    // A pick shows in both windows, and the modes that it leaves have other numbers.
    browser.script("location.hash = 'singular-values&mode=1'").await;
    browser.click("Drop this mode").await;
    let is_picked = "document.getElementById('singular-values').textContent.includes('Picked: 1 dropped')";
    browser.wait_for("the pick", &format!("return {is_picked}")).await;
    browser.client.switch_to_window(others.clone()).await.unwrap();
    browser.wait_for("the pick in the other window", &format!("return {is_picked}")).await;
    browser.wait_for("the third mode", &format!("{mode} === '3'")).await;
    browser.client.switch_to_window(first.clone()).await.unwrap();
    browser.click("Identify modes straight from the recording").await;
    browser.done("identify").await;
    browser.client.switch_to_window(others.clone()).await.unwrap();
    let is_second = format!("{mode} === '2' && !{is_picked} && {is_named}");
    browser.wait_for("the same mode by another number", &is_second).await;
    browser.client.switch_to_window(first.clone()).await.unwrap();
    let standing = "return document.getElementById('singular-values').textContent.includes('with the choice of study.toml: dropped at')";
    browser.wait_for("the choice stays in sight", standing).await;
    browser.script("location.hash = 'mode=1'").await;

    // Colours of the reader's choice, by keyboard.
    browser.colours().await;

    for (name, size, scheme) in [("desktop", DESKTOP, "light"), ("phone", PHONE, "light"), ("dark", DESKTOP, "dark")] {
        browser.size(size).await;
        browser.script(&format!("location.hash = 'theme={scheme}'")).await;
        browser.wait_for("all drawn", DRAWN).await;
        browser.wait_for("nothing is wider than the window", FITS).await;
        assert_eq!(browser.inaccessible().await, Vec::<String>::new(), "{name}");
        browser.picture(&format!("4 {name}")).await;
    }
    browser.no_errors().await;
    browser.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_report_opens_from_disk_with_all_its_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let study = study(folder.path());
    run(&["identify", &study, "--direct"]);
    run(&["diagnose", &study]);
    run(&["report", &study]);
    let browser = Browser::start(&["--force-prefers-reduced-motion"]).await;
    browser.size(DESKTOP).await;
    browser.client.goto(&format!("file://{study}/results/report.html")).await.unwrap();
    browser.wait_for("the report is drawn", DRAWN).await;
    assert_eq!(
        browser
            .script("return performance.getEntriesByType('resource').filter(one => one.name.startsWith('http')).length")
            .await,
        json!(0)
    );
    assert_eq!(
        browser.script("return document.querySelectorAll('[data-runs]').length").await,
        json!(0),
        "a report has nothing to click that asks a server"
    );
    browser.colours().await;
    // On paper no text is smaller than 8 points, and the report is short.
    let small = "window.dispatchEvent(new Event('beforeprint'));
        const small = [...document.querySelectorAll('main *, header *')].filter(one => one.checkVisibility() && [...one.childNodes].some(node => node.nodeType === 3 && node.data.trim()) && parseFloat(getComputedStyle(one).fontSize) < 10.6);
        window.dispatchEvent(new Event('afterprint'));
        return small.map(one => one.outerHTML.slice(0, 80))";
    assert_eq!(browser.script(small).await, json!([]));
    let pages = browser.printed_pages().await;
    assert!((5..=14).contains(&pages), "{pages} pages");
    browser.picture("5 report").await;
    browser.no_errors().await;
    browser.end().await;
}
