//! The command in real time: nodes behind sockets, the host killed and started again, the modes of what has come.

use std::cell::RefCell;
use std::fs::{self, File};
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::{Duration, Instant};

use assert_cmd::prelude::*;
use belfry_shared::time::NodeTime;
use belfry_tests::belfry_command;
use serde_json::Value;

use crate::page::server::Server;
use crate::said::sound;

use super::mast::{MODES, RATE_HZ, folder_in_memory, fresh_node, is_without_gaps, motion, numbers, write_study};

/// How long what takes no time of its own may take on a machine that is busy.
const PATIENCE: Duration = Duration::from_secs(60);
/// Time between windows: half a segment of 256 samples, at 500 a second.
const HOP: Duration = Duration::from_millis(256);
/// What programs at a bench say.
const LOG_FILE: &str = "programs.log";

/// The node's firmware in real time behind a socket; it goes on when the host has gone.
struct LiveNode {
    stop: Arc<AtomicBool>,
    thread: Option<thread::JoinHandle<()>>,
}

impl LiveNode {
    /// A node whose crystal gains `ppm`, with the motion's columns from `first` on.
    fn start(number: u16, ppm: f64, socket: &Path, motion: Arc<Vec<[f32; 4]>>, first: usize, on: Instant) -> Self {
        let listener = UnixListener::bind(socket).unwrap();
        listener.set_nonblocking(true).unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = thread::spawn(move || {
            let mut node = fresh_node(number, u32::from(number) + 1000);
            let mut stream: Option<UnixStream> = None;
            let mut rows = 0;
            let mut buffer = [0; 512];
            while !stopped.load(Ordering::Relaxed) {
                if let Ok((next, _)) = listener.accept() {
                    next.set_nonblocking(true).unwrap();
                    stream = Some(next);
                }
                let now_s = on.elapsed().as_secs_f64();
                let node_time = |seconds: f64| NodeTime((seconds * (1.0 + ppm * 1e-6) * 1e6) as u64);
                // Sampled when the structure was there, by a timer that nothing delays.
                while (rows as f64) < now_s * RATE_HZ {
                    let row = &motion[rows % motion.len()];
                    node.sample(node_time(rows as f64 / RATE_HZ), &row[first..first + 2]);
                    while node.poll(node_time(rows as f64 / RATE_HZ)) {}
                    rows += 1;
                }
                if let Some(line) = &mut stream {
                    let gone = match line.read(&mut buffer) {
                        Ok(0) => true,
                        Ok(count) => {
                            let now = node_time(on.elapsed().as_secs_f64());
                            buffer[..count].iter().for_each(|&byte| node.receive(now, byte));
                            false
                        }
                        Err(error) => error.kind() != ErrorKind::WouldBlock,
                    };
                    let mut failed = gone;
                    while !failed && node.has_bytes() {
                        let count = node.transmit(node_time(on.elapsed().as_secs_f64()), &mut buffer);
                        if count == 0 {
                            break;
                        }
                        failed = line.write_all(&buffer[..count]).is_err();
                    }
                    if failed {
                        stream = None;
                    }
                }
                thread::sleep(Duration::from_micros(300));
            }
        });
        Self { stop, thread: Some(thread) }
    }
}

impl Drop for LiveNode {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The mast's study, and its nodes: the one's crystal gains 20 ppm, the other's loses as much.
pub(super) struct LiveBench {
    pub(super) folder: tempfile::TempDir,
    /// Programs that were started, by their numbers.
    programs: RefCell<Vec<u32>>,
    _nodes: [LiveNode; 2],
}

impl LiveBench {
    pub(super) fn new() -> Self {
        let folder = folder_in_memory();
        write_study(folder.path());
        let motion = Arc::new(motion(200.0));
        let on = Instant::now();
        let start = |number, ppm, first| {
            let socket = folder.path().join(format!("node{number}"));
            LiveNode::start(number, ppm, &socket, Arc::clone(&motion), first, on)
        };
        let nodes = [start(3, 20.0, 0), start(8, -20.0, 2)];
        Self { folder, programs: RefCell::default(), _nodes: nodes }
    }

    pub(super) fn study(&self) -> &str {
        self.folder.path().to_str().unwrap()
    }

    pub(super) fn collect(&self, more: &[&str]) -> Command {
        let port = |node: u16| format!("unix:{}", self.folder.path().join(format!("node{node}")).display());
        let mut command = belfry_command();
        command.args(["collect", self.study(), "--port", &port(8), "--port", &port(3)]).args(more);
        command
    }

    /// Starts a program that works at the bench's study. What it says is shown where the story fails.
    pub(super) fn spawn(&self, mut command: Command) -> Child {
        let log = File::options().create(true).append(true).open(self.folder.path().join(LOG_FILE)).unwrap();
        let child = command.stdout(Stdio::null()).stderr(log).spawn().unwrap();
        self.programs.borrow_mut().push(child.id());
        child
    }

    /// Waits until the archive has `count` windows of each node.
    pub(super) fn wait_for(&self, count: usize) {
        let file = self.folder.path().join("archive.sqlite");
        let patience = PATIENCE + HOP * count as u32;
        wait_until(&format!("{count} windows of each node"), patience, || {
            file.exists() && [3, 8].iter().all(|&node| numbers(self.folder.path(), node).len() >= count)
        });
    }
}

impl Drop for LiveBench {
    fn drop(&mut self) {
        if thread::panicking() {
            // Stories that follow would have to share the machine with them.
            let programs = self.programs.borrow().iter().map(u32::to_string).collect::<Vec<_>>();
            let _ = Command::new("kill").arg("-KILL").args(programs).status();
            println!("{}", fs::read_to_string(self.folder.path().join(LOG_FILE)).unwrap_or_default());
        }
    }
}

/// Waits until something is so, for so long.
pub(super) fn wait_until(what: &str, patience: Duration, is_so: impl Fn() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(start.elapsed() < patience, "{what}: in vain");
        thread::sleep(Duration::from_millis(100));
    }
}

pub(super) fn kill(mut child: Child) {
    child.kill().unwrap();
    child.wait().unwrap();
}

pub(super) fn interrupt(child: &Child) {
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
}

/// Something on the other end that always has bytes, faster than any line of a node.
fn flood(socket: &Path, said: &'static [u8]) {
    let listener = UnixListener::bind(socket).unwrap();
    thread::spawn(move || {
        let bytes = said.repeat(4096);
        // It ends with the tests.
        for mut stream in listener.incoming().flatten() {
            let bytes = bytes.clone();
            thread::spawn(move || while stream.write_all(&bytes).is_ok() {});
        }
    });
}

#[test]
fn a_port_that_is_never_quiet_keeps_collecting_from_no_end() {
    let folder = folder_in_memory();
    write_study(folder.path());
    let sockets = [("noise", &b"noise"[..]), ("ends", b"\x07\x00")].map(|(name, said)| {
        let socket = folder.path().join(name);
        flood(&socket, said);
        format!("unix:{}", socket.display())
    });
    let collect = |more: &[&str]| {
        let mut command = belfry_command();
        command.arg("collect").arg(folder.path()).args(["--port", &sockets[0], "--port", &sockets[1]]).args(more);
        command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    };
    let ended = |mut child: Child, what: &str| {
        let start = Instant::now();
        while child.try_wait().unwrap().is_none() {
            if start.elapsed() > Duration::from_secs(15) {
                kill(child);
                panic!("{what} does not end it");
            }
            thread::sleep(Duration::from_millis(50));
        }
    };
    ended(collect(&["--for", "2s"]), "its time");
    let child = collect(&[]);
    thread::sleep(Duration::from_secs(1));
    interrupt(&child);
    ended(child, "an interrupt");
}

/// Starts a command and waits until it says something on its error output; what it had said by then.
fn says(mut command: Command, part: &'static str) -> (Child, Vec<String>) {
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
    let (tell, told) = mpsc::channel();
    // It ends with the command, whose output somebody has to read.
    thread::spawn(move || lines.for_each(|line| drop(tell.send(line))));
    let mut said: Vec<String> = Vec::new();
    while !said.last().is_some_and(|line| line.contains(part)) {
        match told.recv_timeout(PATIENCE) {
            Ok(line) => said.push(line),
            Err(_) => {
                kill(child);
                panic!("no {part:?} in {said:?}");
            }
        }
    }
    (child, said)
}

#[test]
fn an_archive_that_another_program_has_when_collecting_begins_is_waited_for() {
    let bench = LiveBench::new();
    let first = bench.collect(&[]).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    bench.wait_for(4);
    kill(first);
    let before = numbers(bench.folder.path(), 3).len();
    // It can neither be read nor written.
    let other = rusqlite::Connection::open(bench.folder.path().join("archive.sqlite")).unwrap();
    other.pragma_update(None, "locking_mode", "exclusive").unwrap();
    other.execute_batch("BEGIN IMMEDIATE; UPDATE window SET received_us = received_us; COMMIT").unwrap();
    let (mut child, said) = says(bench.collect(&[]), "It is tried again");
    assert!(said.iter().any(|line| line.contains("archive.sqlite") && line.contains("locked")), "{said:?}");
    assert!(child.try_wait().unwrap().is_none(), "it has given up: {said:?}");
    drop(other);
    bench.wait_for(before + 10);
    kill(child);
}

/// Carries bytes between a TCP port of this computer and a node's socket, as a serial server does; the port.
fn serial_server(socket: &Path) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let socket = socket.to_owned();
    // It ends with the tests.
    thread::spawn(move || {
        for outer in listener.incoming().flatten() {
            let inner = UnixStream::connect(&socket).unwrap();
            let (mut from_host, mut to_host) = (outer.try_clone().unwrap(), outer);
            let (mut from_node, mut to_node) = (inner.try_clone().unwrap(), inner);
            thread::spawn(move || std::io::copy(&mut from_node, &mut to_host));
            thread::spawn(move || {
                let carried = std::io::copy(&mut from_host, &mut to_node);
                to_node.shutdown(Shutdown::Both).and(carried.map(drop))
            });
        }
    });
    port
}

#[test]
fn a_node_without_a_key_behind_a_network_is_warned_of() {
    let bench = LiveBench::new();
    let port = serial_server(&bench.folder.path().join("node3"));
    let collect = |host: &str| {
        let mut command = belfry_command();
        command.args(["collect", bench.study(), "--port", &format!("tcp:{host}:{port}")]);
        let (child, said) = says(command, "measures");
        kill(child);
        said.iter().filter(|line| line.contains("leads over a network, and its node has no key")).count()
    };
    // An address that is not this computer's own, though it leads there.
    assert_eq!([collect("0.0.0.0"), collect("127.0.0.1")], [1, 0]);
}

#[test]
fn windows_come_once_whatever_happens_to_the_host_and_modes_come_of_them_while_they_grow() {
    let bench = LiveBench::new();
    // Killed in the middle of it.
    let killed = bench.collect(&[]).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    bench.wait_for(8);
    kill(killed);
    thread::sleep(Duration::from_secs(2));
    // Started again, and asked for modes meanwhile.
    let again = bench.collect(&["--json"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    // The drift is known from 20 s on.
    bench.wait_for(120);
    let modes = belfry_command().args(["identify", bench.study(), "--json"]).assert().success();
    let modes = sound(serde_json::from_slice(&modes.get_output().stdout).unwrap());
    // What has come so far can be looked at as a recording can.
    let look = belfry_command().args(["look", bench.study(), "--json"]).assert().success();
    let look = sound(serde_json::from_slice(&look.get_output().stdout).unwrap());
    let seen = &look["setups"][0];
    assert!(seen["live"] == true && seen["rows"].as_u64() >= Some(100) && seen["start_utc"].is_string(), "{seen}");
    let is_level = |channel: &Value| channel["rms"].as_f64() > Some(0.0) && channel["missing"].is_u64();
    assert!(seen["channels"].as_array().unwrap().iter().all(is_level), "{seen}");
    let after = numbers(bench.folder.path(), 3).len();
    // The page shows how the nodes serve, and follows by itself.
    let server = Server::start(bench.study());
    let windows = |data: &Value, node: u64| {
        let nodes = data["nodes"].as_array().unwrap();
        let one = nodes.iter().find(|one| one["node"] == node).unwrap();
        assert_eq!((&one["lost_windows"], &one["bad_windows"]), (&0.into(), &0.into()), "{one}");
        one["windows"].as_u64().unwrap()
    };
    let shown = server.data();
    assert!(windows(&shown, 3) >= 120 && windows(&shown, 8) >= 120, "{}", shown["nodes"]);
    server.wait_for("more windows", |data| [3, 8].iter().all(|&node| windows(data, node) > windows(&shown, node) + 2));
    bench.wait_for(after + 4);
    interrupt(&again);
    let output = again.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    assert!(said.contains("node 3 on unix:") && said.contains("measures"), "{said}");
    // Every window, each once, across all of it.
    for node in [3, 8] {
        let numbers = numbers(bench.folder.path(), node);
        assert!(is_without_gaps(&numbers), "node {node}: {numbers:?}");
    }
    // Lines of the log begin with the time.
    assert!(said.lines().all(|line| line.starts_with("20") && line[..24].ends_with('Z')), "{said}");
    // An event a line, the report last.
    let text = String::from_utf8(output.stdout).unwrap();
    let mut events: Vec<Value> = text.lines().map(|line| sound(serde_json::from_str(line).unwrap())).collect();
    let report = events.pop().unwrap();
    assert_eq!((&report["event"], &report["setup"]), (&"end".into(), &"now".into()));
    let of_node = |node: u64, event: &str| -> Vec<&Value> {
        events.iter().filter(|line| line["node"] == node && line["event"] == event).collect()
    };
    let mut nodes: Vec<u64> = Vec::new();
    for port in report["ports"].as_array().unwrap() {
        let node = port["node"].as_u64().unwrap();
        nodes.push(node);
        assert_eq!(of_node(node, "window").len() as u64, port["windows"].as_u64().unwrap(), "{port}");
        let states: Vec<&Value> = of_node(node, "port").iter().map(|line| &line["state"]).collect();
        assert_eq!(states, ["preparing", "measuring"], "node {node}");
        for nothing in ["lost_windows", "foreign_windows", "windows_with_gaps", "damaged_frames"] {
            assert_eq!(port[nothing], 0, "{nothing} in {port}");
        }
        // The host's clock is slower than a node's whose crystal gains.
        let ppm = if port["node"] == 3 { -20.0 } else { 20.0 };
        let drift = port["clock_drift_ppm"].as_f64().unwrap();
        // The quickest of four exchanges, over 20 s: half a millisecond of scheduling is 25 ppm.
        assert!((drift - ppm).abs() < 35.0, "{drift} ppm found where there are {ppm}");
        let peak = port["peaks_hz"][0].as_f64().unwrap();
        assert!(MODES.iter().any(|mode| (mode.0 - peak).abs() < 3.0), "a peak at {peak} Hz");
    }
    nodes.sort_unstable();
    assert_eq!(nodes, [3, 8]);
    // The modes of what had come by then, whose shapes span both nodes: their clocks differ by 40 ppm.
    let found = modes["modes"].as_array().unwrap();
    assert_eq!(found.len(), MODES.len(), "{found:?}");
    for (mode, (frequency_hz, _, shape)) in found.iter().zip(MODES) {
        let frequency = mode["frequency_hz"].as_f64().unwrap();
        assert!((frequency / frequency_hz - 1.0).abs() < 0.01, "{frequency} Hz");
        let components = mode["shape"].as_array().unwrap();
        let (mut product, mut squares, mut truth) = ((0.0, 0.0), 0.0, 0.0);
        for (component, factor) in components.iter().zip(shape) {
            let (re, im) = (component["re"].as_f64().unwrap(), component["im"].as_f64().unwrap());
            product = (product.0 + factor * re, product.1 + factor * im);
            squares += re * re + im * im;
            truth += factor * factor;
        }
        let mac = (product.0 * product.0 + product.1 * product.1) / (squares * truth);
        // In the first seconds the drift is not known: half a millisecond between the nodes is 16 degrees at 90 Hz.
        assert!(mac > 0.95, "MAC {mac} at {frequency} Hz");
    }
}
