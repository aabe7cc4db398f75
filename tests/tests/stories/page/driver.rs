//! A browser that is driven as a user would: clicks, waits, what the console says.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use fantoccini::actions::{InputSource, MOUSE_BUTTON_LEFT, MouseActions, PointerAction};
use fantoccini::error::CmdError;
use fantoccini::key::Key;
use fantoccini::wd::WebDriverCompatibleCommand;
use fantoccini::{Client, ClientBuilder, Locator};
use hyper_util::client::legacy::connect::HttpConnector;
use serde_json::{Value, json};

const PATIENCE: Duration = Duration::from_secs(60);
/// A checker of contrast, names and roles.
const AXE: &str = include_str!("../../../vendor/axe.min.js");

/// Chromium, driven; ends with this value.
pub(crate) struct Browser {
    driver: Child,
    pub(crate) client: Client,
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

/// Runs a script before those of every page.
#[derive(Debug)]
struct BeforeEachPage(String);

impl WebDriverCompatibleCommand for BeforeEachPage {
    fn endpoint(&self, base: &url::Url, session: Option<&str>) -> Result<url::Url, url::ParseError> {
        base.join(&format!("session/{}/goog/cdp/execute", session.unwrap_or_default()))
    }

    fn method_and_body(&self, _: &url::Url) -> (http::Method, Option<String>) {
        let body = json!({ "cmd": "Page.addScriptToEvaluateOnNewDocument", "params": { "source": self.0 } });
        (http::Method::POST, Some(body.to_string()))
    }
}

/// Prints the page to A4.
#[derive(Debug)]
struct Print;

impl WebDriverCompatibleCommand for Print {
    fn endpoint(&self, base: &url::Url, session: Option<&str>) -> Result<url::Url, url::ParseError> {
        base.join(&format!("session/{}/print", session.unwrap_or_default()))
    }

    fn method_and_body(&self, _: &url::Url) -> (http::Method, Option<String>) {
        let body = json!({ "background": true, "shrinkToFit": false, "page": { "width": 21.0, "height": 29.7 } });
        (http::Method::POST, Some(body.to_string()))
    }
}

impl Browser {
    pub(crate) async fn start(more: &[&str]) -> Self {
        let driver = Command::new("chromedriver").arg("--port=0").stdout(Stdio::piped()).stderr(Stdio::null()).spawn();
        let mut driver = driver.expect("chromedriver starts");
        let lines = BufReader::new(driver.stdout.take().unwrap()).lines();
        let port = lines.map_while(Result::ok).find_map(|line| {
            let (_, port) = line.split_once("successfully on port ")?;
            port.trim_end_matches('.').parse::<u16>().ok()
        });
        let mut arguments = vec!["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"];
        arguments.extend(more);
        let capabilities = json!({
            "goog:chromeOptions": { "args": arguments },
            "goog:loggingPrefs": { "browser": "ALL" },
        });
        let Value::Object(capabilities) = capabilities else { unreachable!("it is written as an object") };
        let address = format!("http://127.0.0.1:{}", port.expect("chromedriver tells its port"));
        let client = ClientBuilder::new(HttpConnector::new()).capabilities(capabilities).connect(&address).await;
        Self { driver, client: client.expect("Chromium starts") }
    }

    pub(crate) async fn size(&self, (width, height): (u32, u32)) {
        self.client.set_window_size(width, height).await.unwrap();
    }

    pub(crate) async fn script(&self, script: &str) -> Value {
        self.client.execute(script, Vec::new()).await.unwrap()
    }

    /// Runs a script before those of every page that is opened from now on.
    #[cfg_attr(test, allow(dead_code, reason = "the benchmark uses it"))]
    pub(crate) async fn before_each_page(&self, script: &str) {
        self.client.issue_cmd(BeforeEachPage(script.to_owned())).await.unwrap();
    }

    /// Pages of A4 that the page is printed to.
    #[cfg_attr(not(test), allow(dead_code, reason = "the stories use it"))]
    pub(crate) async fn printed_pages(&self) -> usize {
        let printed = self.client.issue_cmd(Print).await.unwrap();
        let pdf = STANDARD.decode(printed.as_str().expect("a PDF in base64")).unwrap();
        let text = String::from_utf8_lossy(&pdf);
        text.match_indices("/Type /Page").filter(|(at, found)| !text[at + found.len()..].starts_with('s')).count()
    }

    /// Waits until a script's value is true.
    pub(crate) async fn wait_for(&self, what: &str, script: &str) {
        let start = Instant::now();
        while self.script(script).await != Value::Bool(true) {
            let said = self.script("return document.querySelector('.status')?.textContent").await;
            assert!(start.elapsed() < PATIENCE, "{what}: in vain; the page says {said}; {:?}", self.errors().await);
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Clicks the first button that begins with these words, as a user sees them. The page may draw it anew in between.
    pub(crate) async fn click(&self, words: &str) {
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

    /// Presses the mouse at a place [x, y] of the window.
    pub(crate) async fn press(&self, place: &Value) {
        let [x, y] = [0, 1].map(|axis| place[axis].as_f64().expect("a place"));
        let button = MOUSE_BUTTON_LEFT;
        let press = MouseActions::new("mouse".to_owned())
            .then(PointerAction::MoveTo { duration: None, x, y })
            .then(PointerAction::Down { button })
            .then(PointerAction::Up { button });
        self.client.perform_actions(press).await.unwrap();
    }

    /// Goes through the choice of colours by keyboard; each stands in the address, and the system's choice needs no word there.
    pub(crate) async fn colours(&self) {
        for (shown, scheme) in [("Colours: auto", "light"), ("Colours: light", "dark"), ("Colours: dark", "")] {
            let path = format!("//button[.='{shown}']");
            let button = self.client.find(Locator::XPath(&path)).await.unwrap();
            button.send_keys(&Key::Enter.to_string()).await.unwrap();
            let dark = if scheme == "dark" { "dark" } else { "light" };
            let there = format!(
                "return getComputedStyle(document.documentElement).colorScheme === '{dark}' && ('{scheme}' ? location.hash.includes('theme={scheme}') : !location.hash.includes('theme'))"
            );
            self.wait_for(shown, &there).await;
        }
    }

    /// Waits until the command that was asked for is done.
    pub(crate) async fn done(&self, command: &str) {
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

    pub(crate) async fn no_errors(&self) {
        assert_eq!(self.errors().await.unwrap(), Vec::<String>::new());
    }

    /// The same but for those that say this, which are expected here.
    pub(crate) async fn no_errors_but(&self, expected: &str) {
        let mut errors = self.errors().await.unwrap();
        errors.retain(|error| !error.contains(expected));
        assert_eq!(errors, Vec::<String>::new());
    }

    /// What axe-core finds wrong: rules and the elements that break them.
    pub(crate) async fn inaccessible(&self) -> Vec<String> {
        let ask = format!(
            "{AXE}; const done = arguments[arguments.length - 1]; axe.run({{ resultTypes: ['violations'] }}).then(result => done(result.violations.map(v => v.id + ': ' + v.nodes.map(n => n.target.join(' ') + ' ' + n.failureSummary).slice(0, 4).join(' | '))), error => done([String(error)]))"
        );
        let found = self.client.execute_async(&ask, Vec::new()).await.unwrap();
        found.as_array().unwrap().iter().map(Value::to_string).collect()
    }

    /// Where test artefacts are wanted, a picture of the window goes there.
    pub(crate) async fn picture(&self, name: &str) {
        if let Some(folder) = std::env::var_os("BELFRY_SCREENSHOTS").map(PathBuf::from) {
            fs::create_dir_all(&folder).unwrap();
            fs::write(folder.join(format!("{name}.png")), self.client.screenshot().await.unwrap()).unwrap();
        }
    }

    pub(crate) async fn end(self) {
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
