//! The whole story clicked through in a real browser: compare, see where it fails, learn what is missing, add it, watch the error fall.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use fantoccini::error::CmdError;
use fantoccini::key::Key;
use fantoccini::wd::WebDriverCompatibleCommand;
use fantoccini::{Client, ClientBuilder, Locator};
use hyper_util::client::legacy::connect::HttpConnector;
use serde_json::{Value, json};

use super::server::Server;
use super::{run, study};

const PATIENCE: Duration = Duration::from_secs(60);
/// A checker of contrast, names and roles.
const AXE: &str = include_str!("../../../vendor/axe.min.js");
/// Widths of a desktop's window and of a phone's.
const DESKTOP: (u32, u32) = (1280, 900);
const PHONE: (u32, u32) = (390, 844);

/// Chromium, driven; ends with this value.
struct Browser {
    driver: Child,
    client: Client,
}

/// What the browser's console has.
#[derive(Debug)]
struct ConsoleLog;

impl WebDriverCompatibleCommand for ConsoleLog {
    fn endpoint(&self, base: &url::Url, session: Option<&str>) -> Result<url::Url, url::ParseError> {
        base.join(&format!("session/{}/se/log", session.unwrap_or_default()))
    }

    fn method_and_body(&self, _: &url::Url) -> (http::Method, Option<String>) {
        (http::Method::POST, Some(json!({ "type": "browser" }).to_string()))
    }
}

impl Browser {
    async fn start() -> Self {
        let driver = Command::new("chromedriver").arg("--port=0").stdout(Stdio::piped()).stderr(Stdio::null()).spawn();
        let mut driver = driver.expect("chromedriver starts");
        let lines = BufReader::new(driver.stdout.take().unwrap()).lines();
        let port = lines.map_while(Result::ok).find_map(|line| {
            let (_, port) = line.split_once("successfully on port ")?;
            port.trim_end_matches('.').parse::<u16>().ok()
        });
        let arguments = [
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--force-prefers-reduced-motion",
        ];
        let capabilities = json!({
            "goog:chromeOptions": { "args": arguments },
            "goog:loggingPrefs": { "browser": "ALL" },
        });
        let Value::Object(capabilities) = capabilities else { unreachable!("it is written as an object") };
        let address = format!("http://127.0.0.1:{}", port.expect("chromedriver tells its port"));
        let client = ClientBuilder::new(HttpConnector::new()).capabilities(capabilities).connect(&address).await;
        Self { driver, client: client.expect("Chromium starts") }
    }

    async fn size(&self, (width, height): (u32, u32)) {
        self.client.set_window_size(width, height).await.unwrap();
    }

    async fn script(&self, script: &str) -> Value {
        self.client.execute(script, Vec::new()).await.unwrap()
    }

    /// Waits until a script's value is true.
    async fn wait_for(&self, what: &str, script: &str) {
        let start = Instant::now();
        while self.script(script).await != Value::Bool(true) {
            let said = self.script("return document.querySelector('.status')?.textContent").await;
            assert!(start.elapsed() < PATIENCE, "{what}: in vain; the page says {said}; {:?}", self.errors().await);
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Clicks the first button that begins with these words, as a user sees them. The page may draw it anew in between.
    async fn click(&self, words: &str) {
        let path = format!("//button[starts-with(normalize-space(.), '{words}') and not(@aria-disabled='true')]");
        let start = Instant::now();
        loop {
            let Err(error) = self.try_click(&path).await else { return };
            assert!(start.elapsed() < PATIENCE, "{words}: {error}");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    async fn try_click(&self, path: &str) -> Result<(), CmdError> {
        let button = self.client.find(Locator::XPath(path)).await?;
        let reference = serde_json::to_value(&button).map_err(CmdError::Json)?;
        self.client.execute("arguments[0].scrollIntoView({ block: 'center' })", vec![reference]).await?;
        button.click().await
    }

    /// Waits until the command that was asked for is done.
    async fn done(&self, command: &str) {
        let script = format!(
            "return document.querySelector('.status').textContent.includes('belfry {command}') && document.querySelector('.status').textContent.includes(': done')"
        );
        self.wait_for(command, &script).await;
    }

    /// Warnings and errors of the console so far.
    async fn errors(&self) -> Result<Vec<String>, CmdError> {
        let log = self.client.issue_cmd(ConsoleLog).await?;
        let entries = log.as_array().cloned().unwrap_or_default();
        let bad = entries.iter().filter(|entry| matches!(entry["level"].as_str(), Some("SEVERE" | "WARNING")));
        Ok(bad.map(|entry| entry["message"].to_string()).collect())
    }

    async fn no_errors(&self) {
        assert_eq!(self.errors().await.unwrap(), Vec::<String>::new());
    }

    /// What axe-core finds wrong: rules and the elements that break them.
    async fn inaccessible(&self) -> Vec<String> {
        let ask = format!(
            "{AXE}; const done = arguments[arguments.length - 1]; axe.run({{ resultTypes: ['violations'] }}).then(result => done(result.violations.map(v => v.id + ': ' + v.nodes.map(n => n.target.join(' ') + ' ' + n.failureSummary).slice(0, 4).join(' | '))), error => done([String(error)]))"
        );
        let found = self.client.execute_async(&ask, Vec::new()).await.unwrap();
        found.as_array().unwrap().iter().map(Value::to_string).collect()
    }

    /// Where test artefacts are wanted, a picture of the window goes there.
    async fn picture(&self, name: &str) {
        if let Some(folder) = std::env::var_os("BELFRY_SCREENSHOTS").map(PathBuf::from) {
            fs::create_dir_all(&folder).unwrap();
            fs::write(folder.join(format!("{name}.png")), self.client.screenshot().await.unwrap()).unwrap();
        }
    }

    async fn end(self) {
        // The driver ends its browser when its session ends.
        self.client.clone().close().await.unwrap();
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Asked to end, it ends its browser as well.
        let asked = Command::new("kill").arg(self.driver.id().to_string()).status();
        if !asked.is_ok_and(|status| status.success()) {
            let _ = self.driver.kill();
        }
        let _ = self.driver.wait();
    }
}

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
    let browser = Browser::start().await;
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

    // A slider: shapes and frequencies follow, the study does not.
    let toml = fs::read(format!("{study}/study.toml")).unwrap();
    let frequencies = "return document.getElementById('frequency-errors').querySelector('figcaption').textContent";
    let fitted = browser.script(frequencies).await;
    let slider = browser.client.find(Locator::Css("input[type=range]#slider-0")).await.unwrap();
    slider.send_keys(&Key::Right.to_string().repeat(20)).await.unwrap();
    browser.wait_for("the slider's model", &format!("{frequencies} !== {fitted}")).await;
    assert_eq!(fs::read(format!("{study}/study.toml")).unwrap(), toml);
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
    let view = browser.client.current_url().await.unwrap();
    let first = browser.client.window().await.unwrap();
    let second = browser.client.new_window(true).await.unwrap().handle;
    browser.client.switch_to_window(second).await.unwrap();
    browser.client.goto(view.as_str()).await.unwrap();
    browser.wait_for("the other window is drawn", DRAWN).await;
    browser.click("Undo: remove base-rotation").await;
    browser.done("remove").await;
    browser.client.switch_to_window(first).await.unwrap();
    browser
        .wait_for("both windows agree", "return !document.body.textContent.includes('Undo: remove base-rotation')")
        .await;

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
    let browser = Browser::start().await;
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
    browser.picture("5 report").await;
    browser.no_errors().await;
    browser.end().await;
}
