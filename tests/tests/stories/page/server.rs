//! A running `belfry serve`, and a client that says what a browser would, or what it would not.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use belfry_tests::belfry_command;
use belfry_tests::schema::sound;
use serde_json::{Value, json};

/// How long anything may take: the machine may be busy with other tests.
const PATIENCE: Duration = Duration::from_secs(120);

/// A server, which ends with this value.
pub(crate) struct Server {
    child: Child,
    /// The address that opens the page.
    pub(crate) address: String,
    host: String,
    cookie: String,
}

/// An answer.
pub(crate) struct Answer {
    pub(crate) status: u16,
    head: String,
    pub(crate) body: String,
}

impl Answer {
    pub(crate) fn header(&self, name: &str) -> &str {
        let line =
            self.head.lines().find_map(|line| line.split_once(": ").filter(|(key, _)| key.eq_ignore_ascii_case(name)));
        line.map_or("", |(_, value)| value)
    }

    pub(crate) fn json(&self) -> Value {
        serde_json::from_str(&self.body).unwrap_or_else(|_| panic!("{} {}", self.status, self.body))
    }
}

impl Server {
    /// Serves a study and opens its page.
    pub(crate) fn start(study: &str) -> Self {
        Self::start_with(&[study])
    }

    /// The same of what these arguments name.
    pub(crate) fn start_with(arguments: &[&str]) -> Self {
        let mut child = belfry_command()
            .arg("serve")
            .args(arguments)
            .arg("--json")
            .stdout(Stdio::piped())
            .spawn()
            .expect("belfry starts");
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let told = sound(serde_json::from_str(&line).expect("the address, as JSON"));
        let address = told["address"].as_str().unwrap().to_owned();
        let (host, path) = address.strip_prefix("http://").unwrap().split_once('/').unwrap();
        let mut server = Self { child, host: host.to_owned(), cookie: String::new(), address: address.clone() };
        let opened = server.ask_as("GET", &format!("/{path}"), &[], "");
        assert_eq!((opened.status, opened.header("location")), (303, "/"));
        let cookie = opened.header("set-cookie").to_owned();
        assert!(cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"), "{cookie}");
        server.cookie = cookie.split(';').next().unwrap().to_owned();
        server
    }

    /// Asks with these headers and no others than a client needs.
    pub(crate) fn ask_as(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &str) -> Answer {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let mut request =
            format!("{method} {path} HTTP/1.1\r\nconnection: close\r\ncontent-length: {}\r\n", body.len());
        if !headers.iter().any(|(name, _)| *name == "host") {
            request += &format!("host: {}\r\n", self.host);
        }
        for (name, value) in headers {
            request += &format!("{name}: {value}\r\n");
        }
        stream.write_all(format!("{request}content-type: application/json\r\n\r\n{body}").as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let (head, body) = answer.split_once("\r\n\r\n").expect("a head and a body");
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        Answer { status, head: head.to_owned(), body: body.to_owned() }
    }

    /// What lets a window in.
    pub(crate) fn cookie(&self) -> &str {
        &self.cookie
    }

    /// Asks as the page does.
    pub(crate) fn get(&self, path: &str) -> Answer {
        self.ask_as("GET", path, &[("cookie", &self.cookie)], "")
    }

    /// Sends as the page does.
    pub(crate) fn post(&self, path: &str, body: &Value) -> Answer {
        let origin = format!("http://{}", self.host);
        self.ask_as("POST", path, &[("cookie", &self.cookie), ("origin", &origin)], &body.to_string())
    }

    pub(crate) fn data(&self) -> Value {
        let answer = self.get("/data");
        assert_eq!(answer.status, 200, "{}", answer.body);
        answer.json()
    }

    /// Waits until the data are as they should be.
    pub(crate) fn wait_for(&self, what: &str, is_there: impl Fn(&Value) -> bool) {
        let start = Instant::now();
        while !is_there(&self.data()) {
            assert!(start.elapsed() < PATIENCE, "{what}: in vain");
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// Runs a command to its good end; its last state.
    pub(crate) fn finish(&self, words: &[&str]) -> Value {
        let job = self.finish_with(words);
        assert_eq!(job["state"], "done", "{job}");
        job
    }

    /// The same to whatever end.
    pub(crate) fn finish_with(&self, words: &[&str]) -> Value {
        let started = self.post("/run", &json!({ "command": words }));
        assert_eq!(started.status, 202, "{}", started.body);
        self.job_ended()
    }

    /// The last state of the command that runs.
    pub(crate) fn job_ended(&self) -> Value {
        self.job_until(|job| job["state"] != "running")
    }

    /// The first state of the command that is as it should be, from the events that a window follows.
    pub(crate) fn job_until(&self, mut is_there: impl FnMut(&Value) -> bool) -> Value {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        write!(stream, "GET /events HTTP/1.1\r\nhost: {}\r\ncookie: {}\r\n\r\n", self.host, self.cookie).unwrap();
        let lines = BufReader::new(stream).lines().map(|line| line.expect("an event in time"));
        let news = lines.filter_map(|line| serde_json::from_str::<Value>(line.strip_prefix("data: ")?).ok());
        let job = news.map(|mut news| news["job"].take()).find(|job| is_there(job));
        job.expect("the server tells of it")
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // Where it has ended by itself there is nothing to end.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
