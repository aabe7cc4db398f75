//! A user collects live: nodes in real time behind sockets, the command killed and started again, the modes of what has come,
//! cables pulled, nodes that start anew, a disk that is full.

use std::collections::BTreeMap;
use std::fs;
use std::io::{ErrorKind, Read, Write};
use std::ops::ControlFlow;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use std::thread;
use std::time::{Duration, Instant};

use assert_cmd::prelude::*;
use belfry_firmware::{Identity, Memory, Node};
use belfry_host::archive::Archive;
use belfry_host::link::Configurations;
use belfry_host::link::collect::{Collection, PortState, PortStatus, collect, unix_time};
use belfry_host::link::fleet::node_configuration;
use belfry_host::spectra::LineGrid;
use belfry_shared::message::Summary;
use belfry_shared::time::NodeTime;
use belfry_tests::belfry_command;
use rand::{RngExt, SeedableRng};
use serde_json::Value;

/// Rows a second: fast, so that a window takes a quarter of a second.
const RATE_HZ: f64 = 1000.0;
/// The structure's modes: frequency in Hz, damping ratio, shape at the four sensors.
const MODES: [(f64, f64, [f64; 4]); 2] = [(40.0, 0.01, [0.2, 0.5, 0.8, 1.0]), (90.0, 0.01, [0.7, 0.9, -0.2, -0.8])];
const PATIENCE: Duration = Duration::from_secs(60);

/// The structure's motion from the moment when the nodes were switched on: modes driven by noise, in m/s².
fn motion(seconds: f64) -> Vec<[f32; 4]> {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(4);
    let mut noise = move || 2.0 * random.random::<f64>() - 1.0;
    // Two-pole resonators; their impulse response is that of the mode.
    let poles = MODES.map(|(frequency_hz, damping, _)| {
        let omega = std::f64::consts::TAU * frequency_hz / RATE_HZ;
        let radius = (-damping * omega).exp();
        (2.0 * radius * (omega * (1.0 - damping * damping).sqrt()).cos(), -radius * radius)
    });
    let mut states = [(0.0, 0.0); 2];
    (0..(seconds * RATE_HZ) as usize)
        .map(|_| {
            let mut row = [0.0_f64; 4];
            for ((state, (a, b)), (_, _, shape)) in states.iter_mut().zip(poles).zip(MODES) {
                *state = (a * state.0 + b * state.1 + 0.01 * noise(), state.0);
                row.iter_mut().zip(shape).for_each(|(value, factor)| *value += factor * state.0);
            }
            row.map(|value| (value + 1e-3 * noise()) as f32)
        })
        .collect()
}

/// The node's firmware in real time behind a socket; it goes on when the host has gone.
struct LiveNode {
    stop: Arc<AtomicBool>,
    orders: mpsc::Sender<Order>,
    thread: Option<thread::JoinHandle<()>>,
}

/// What happens to a node.
enum Order {
    /// Its cable is pulled, and plugged in there.
    Plug(UnixListener),
    /// It starts anew; what it had is gone.
    Restart,
}

fn listener(socket: &Path) -> UnixListener {
    let listener = UnixListener::bind(socket).unwrap();
    listener.set_nonblocking(true).unwrap();
    listener
}

fn fresh_node(number: u16, boot: u32) -> Node<Box<Memory>> {
    let full_scale_m_s2 = 20.0;
    let identity = Identity { node: number, boot, channels: 2, full_scale_m_s2, highest_rate_mhz: 4_000_000 };
    Node::new(identity, Box::new(Memory::new()))
}

impl LiveNode {
    /// A node whose crystal gains `ppm`, with the motion's columns from `first` on.
    fn start(number: u16, ppm: f64, socket: &Path, motion: Arc<Vec<[f32; 4]>>, first: usize, on: Instant) -> Self {
        let mut listener = listener(socket);
        let (orders, ordered) = mpsc::channel();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = thread::spawn(move || {
            let mut boot = u32::from(number) + 1000;
            let mut node = fresh_node(number, boot);
            let mut stream: Option<UnixStream> = None;
            let mut rows = 0;
            let mut buffer = [0; 512];
            while !stopped.load(Ordering::Relaxed) {
                match ordered.try_recv() {
                    Ok(Order::Plug(other)) => (listener, stream) = (other, None),
                    Ok(Order::Restart) => {
                        boot += 1;
                        node = fresh_node(number, boot);
                    }
                    Err(_) => {}
                }
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
                        failed = count == 0 || line.write_all(&buffer[..count]).is_err();
                        if count == 0 {
                            failed = false;
                            break;
                        }
                    }
                    if failed {
                        stream = None;
                    }
                }
                thread::sleep(Duration::from_micros(300));
            }
        });
        Self { stop, orders, thread: Some(thread) }
    }

    /// Pulls the cable, and plugs it in at another socket; the socket where it was is gone, as a USB port would be.
    fn replug(&self, from: &Path, to: &Path) {
        fs::remove_file(from).unwrap();
        self.orders.send(Order::Plug(listener(to))).unwrap();
    }

    fn restart(&self) {
        self.orders.send(Order::Restart).unwrap();
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

/// A folder in memory where the system has one: every window is on the disk before the next is taken, and a disk that others keep busy
/// makes minutes of that.
fn folder_in_memory() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap()
}

/// A study of four sensors on two nodes, and the nodes.
struct Bench {
    folder: tempfile::TempDir,
    nodes: BTreeMap<u16, LiveNode>,
}

impl Bench {
    /// The one node's crystal gains 20 ppm, the other's loses as much.
    fn new() -> Self {
        Self::with_crystals(20.0)
    }

    fn with_crystals(ppm: f64) -> Self {
        let folder = folder_in_memory();
        let mut text = "[structure]\nname = \"Mast\"\n[[setup]]\nname = \"now\"\nlive = true\n".to_owned();
        text += &format!("sampling_rate_hz = {RATE_HZ}\n");
        for (channel, node) in [("a", 3), ("b", 3), ("c", 8), ("d", 8)] {
            text += &format!("[[setup.sensor]]\nchannel = \"{channel}\"\nnode = {node}\n");
        }
        text += "[analysis]\nband_hz = [15.0, 150.0]\nsegment = 256\n";
        fs::write(folder.path().join("study.toml"), text).unwrap();
        let motion = Arc::new(motion(200.0));
        let on = Instant::now();
        let start = |number, ppm, first| {
            let socket = folder.path().join(format!("node{number}"));
            LiveNode::start(number, ppm, &socket, Arc::clone(&motion), first, on)
        };
        let nodes = BTreeMap::from([(3, start(3, ppm, 0)), (8, start(8, -ppm, 2))]);
        Self { folder, nodes }
    }

    fn socket(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn study(&self) -> &str {
        self.folder.path().to_str().unwrap()
    }

    fn port(&self, node: u16) -> String {
        format!("unix:{}", self.folder.path().join(format!("node{node}")).display())
    }

    fn collect(&self, more: &[&str]) -> Command {
        let mut command = belfry_command();
        command.args(["collect", self.study(), "--port", &self.port(8), "--port", &self.port(3)]).args(more);
        command
    }

    /// Collects until no window stays away of those after the first `count`: what was lost on the way, or asked for when collecting
    /// ended, comes with the next run.
    fn collect_rest(&self, count: usize) {
        let has_gaps = |node: &u16| self.numbers(*node)[count..].windows(2).any(|pair| pair[1] != pair[0] + 1);
        for _ in 0..5 {
            self.collect(&["--for", "4s"]).assert().success();
            if ![3, 8].iter().any(has_gaps) {
                return;
            }
        }
    }

    fn archive(&self) -> rusqlite::Connection {
        rusqlite::Connection::open(self.folder.path().join("archive.sqlite")).unwrap()
    }

    /// Numbers of a node's windows, life by life.
    fn lives(&self, node: u16) -> BTreeMap<u32, Vec<u32>> {
        let archive = self.archive();
        let mut lives: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        // Before its tables are there, the archive has none.
        let Ok(mut statement) =
            archive.prepare("SELECT boot, number FROM window WHERE node = ?1 ORDER BY boot, number")
        else {
            return lives;
        };
        let rows = statement.query_map([node], |row| Ok((row.get(0)?, row.get(1)?))).unwrap();
        for (boot, number) in rows.map(Result::unwrap) {
            lives.entry(boot).or_default().push(number);
        }
        lives
    }

    /// Numbers of the windows of a node that has had one life.
    fn numbers(&self, node: u16) -> Vec<u32> {
        let lives = self.lives(node);
        assert!(lives.len() <= 1, "lives of node {node}: {:?}", lives.keys());
        lives.into_values().next().unwrap_or_default()
    }

    /// Waits until the archive has `count` windows of each node.
    fn wait_for(&self, count: usize) {
        let start = Instant::now();
        let file: PathBuf = self.folder.path().join("archive.sqlite");
        while !file.exists() || [3, 8].iter().any(|&node| self.numbers(node).len() < count) {
            assert!(start.elapsed() < PATIENCE, "{count} windows of each node do not come");
            thread::sleep(Duration::from_millis(100));
        }
    }
}

fn kill(mut child: Child) {
    child.kill().unwrap();
    child.wait().unwrap();
}

fn interrupt(child: &Child) {
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
}

#[test]
fn windows_come_once_whatever_happens_to_the_host_and_modes_come_of_them_while_they_grow() {
    let bench = Bench::new();
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
    let modes: Value = serde_json::from_slice(&modes.get_output().stdout).unwrap();
    let after = bench.numbers(3).len();
    bench.wait_for(after + 4);
    interrupt(&again);
    let output = again.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    assert!(said.contains("node 3 on unix:") && said.contains("measures"), "{said}");
    // Every window, each once, across all of it.
    for node in [3, 8] {
        let numbers = bench.numbers(node);
        let expected: Vec<u32> = (0..numbers.len() as u32).collect();
        assert_eq!(numbers, expected, "node {node}");
    }
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["setup"], "now");
    let mut nodes: Vec<u64> = Vec::new();
    for port in report["ports"].as_array().unwrap() {
        nodes.push(port["node"].as_u64().unwrap());
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

#[test]
fn ports_and_studies_that_do_not_serve_are_told_in_words() {
    let bench = Bench::new();
    let fails = |command: &mut Command, parts: &[&str]| {
        let output = command.assert().failure().get_output().clone();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        for part in parts {
            assert!(said.contains(part), "no {part:?} in: {said}");
        }
    };
    let identify = || {
        let mut command = belfry_command();
        command.args(["identify", bench.study()]);
        command
    };
    fails(&mut identify(), &["setup \"now\"", "no window has come yet", "belfry collect"]);
    // Only nodes of another study answer.
    let study = bench.folder.path().join("study.toml");
    let text = fs::read_to_string(&study).unwrap();
    fs::write(&study, text.replace("node = 3", "node = 4").replace("node = 8", "node = 5")).unwrap();
    fails(
        &mut bench.collect(&["--for", "60s"]),
        &["no sensor of this setup has `node = 3`", "no port has a node that can be used"],
    );
    // More channels than the node has.
    fs::write(&study, text.replace("node = 8", "node = 3")).unwrap();
    let mut one_port = belfry_command();
    one_port.args(["collect", bench.study(), "--port", &bench.port(3), "--for", "60s"]);
    fails(&mut one_port, &["node 3 cannot measure", "the node has 2 channels"]);
    // No band, and no live setup.
    fs::write(&study, text.replace("band_hz = [15.0, 150.0]\n", "")).unwrap();
    fails(&mut bench.collect(&["--for", "60s"]), &["band_hz", "before there are data"]);
    fs::write(&study, text.replace("live = true", "files = [\"a.csv\"]\nunit = \"g\"")).unwrap();
    fails(&mut bench.collect(&["--for", "60s"]), &["no live setup", "live = true"]);
    fs::write(&study, &text).unwrap();
    fails(&mut bench.collect(&["--setup", "then"]), &["\"then\" is no live setup", "\"now\""]);
    // The nodes still measure for who asks rightly.
    bench.collect(&["--for", "4s", "--json"]).assert().success();
    assert!(!bench.numbers(3).is_empty());
}

#[test]
fn a_host_that_stays_away_for_long_gets_what_the_node_still_has_and_is_told_what_is_lost() {
    let bench = Bench::new();
    bench.collect(&["--for", "3s"]).assert().success();
    let (before, before_eight) = (bench.numbers(3), bench.numbers(8).len());
    // A node keeps 112 parts at most: some fifty windows here, seven seconds.
    thread::sleep(Duration::from_secs(14));
    let output = bench.collect(&["--for", "5s", "--json"]).assert().success().get_output().clone();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let numbers = bench.numbers(3);
    let (last_before, first_after) = (before.len() as u32 - 1, numbers[before.len()]);
    assert!(is_without_gaps(&before) && first_after > last_before + 10, "{numbers:?}");
    // What was still there comes, as does what was measured meanwhile.
    bench.collect_rest(before.len().max(before_eight));
    let numbers = bench.numbers(3);
    let after: Vec<u32> = numbers[before.len()..].to_vec();
    assert!(after.len() > 30 && after.iter().copied().eq(first_after..first_after + after.len() as u32), "{numbers:?}");
    let lost =
        report["ports"].as_array().unwrap().iter().find(|port| port["node"] == 3).unwrap()["lost_windows"].clone();
    assert_eq!(lost, first_after - last_before - 1);
    // Another study, of the very same settings: nothing of what the node measured before is taken for its own.
    bench.collect(&["--for", "3s"]).assert().success();
    thread::sleep(Duration::from_secs(2));
    let other = folder_in_memory();
    fs::copy(bench.socket("study.toml"), other.path().join("study.toml")).unwrap();
    let collect_there = |more: &[&str]| {
        let mut command = belfry_command();
        command.arg("collect").arg(other.path()).args(["--port", &bench.port(3), "--for", "4s", "--json"]).args(more);
        command.assert()
    };
    let refused = collect_there(&[]).failure().get_output().clone();
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(
        said.contains("still holds windows that another study asked for") && said.contains("--drop-foreign"),
        "{said}"
    );
    let dropped = collect_there(&["--drop-foreign"]).success().get_output().clone();
    let dropped: Value = serde_json::from_slice(&dropped.stdout).unwrap();
    let foreign = dropped["ports"][0]["foreign_windows"].as_u64().unwrap() as u32;
    assert!(foreign > 5, "{dropped}");
    let there = rusqlite::Connection::open(other.path().join("archive.sqlite")).unwrap();
    let first: u32 = there.query_row("SELECT min(number) FROM window", [], |row| row.get(0)).unwrap();
    assert_eq!(first, bench.numbers(3).last().unwrap() + 1 + foreign, "{dropped}");
}

/// Waits until what the ports have come to is as it should be.
fn wait_until(seen: &Mutex<Vec<PortStatus>>, what: &str, is_so: impl Fn(&[PortStatus]) -> bool) {
    let start = Instant::now();
    while !is_so(&seen.lock().unwrap()) {
        assert!(start.elapsed() < PATIENCE, "{what}: {:?}", seen.lock().unwrap());
        thread::sleep(Duration::from_millis(50));
    }
}

/// Sets the flag when it goes, also where a test fails: what waits for it would hang.
struct SetAtEnd<'a>(&'a AtomicBool);

impl Drop for SetAtEnd<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Collects from `nodes` on what `ports` lists, while the story is told; what the ports have come to in the end.
fn while_collecting(
    bench: &Bench,
    nodes: &[u16],
    unix_time: fn() -> Duration,
    ports: &(dyn Fn() -> Vec<String> + Sync),
    story: impl FnOnce(&Mutex<Vec<PortStatus>>),
) -> Vec<PortStatus> {
    let grid = LineGrid { sampling_rate_hz: RATE_HZ, segment: 256, first_line: 4, lines: 32 };
    let configuration = node_configuration(RATE_HZ, 1, &grid, 2, Summary::Lines { bits: 10 }).unwrap();
    let collection = Collection {
        setup: "now".to_owned(),
        baud: 115_200,
        nodes: nodes.iter().map(|&node| (node, Configurations::only(configuration.clone()))).collect(),
        drop_foreign: false,
        unix_time,
    };
    let archive = Archive::create(bench.folder.path()).unwrap();
    let stop = AtomicBool::new(false);
    let seen: Mutex<Vec<PortStatus>> = Mutex::default();
    thread::scope(|scope| {
        let stopping = SetAtEnd(&stop);
        let collected = scope.spawn(|| {
            collect(&collection, archive, &stop, ports, &mut |statuses| {
                *seen.lock().unwrap() = statuses.to_vec();
                ControlFlow::Continue(())
            })
        });
        story(&seen);
        assert!(!collected.is_finished(), "it has ended by itself: {:?}", seen.lock().unwrap());
        drop(stopping);
        collected.join().unwrap().unwrap()
    })
}

fn port_at(socket: &Path) -> String {
    format!("unix:{}", socket.display())
}

fn at<'a>(statuses: &'a [PortStatus], socket: &Path) -> Option<&'a PortStatus> {
    statuses.iter().find(|status| status.port == port_at(socket))
}

fn measures(statuses: &[PortStatus], socket: &Path, node: u16) -> bool {
    at(statuses, socket).is_some_and(|status| status.state == PortState::Measuring && status.node == Some(node))
}

fn is_without_gaps(numbers: &[u32]) -> bool {
    numbers.iter().copied().eq(0..numbers.len() as u32)
}

fn windows(statuses: &[PortStatus]) -> u64 {
    statuses.iter().map(|status| status.statistics.windows).sum()
}

#[test]
fn a_node_goes_on_at_another_port_and_after_a_restart() {
    let bench = Bench::new();
    let (here, there) = (bench.socket("node3"), bench.socket("elsewhere"));
    let ports = || [&here, &there].into_iter().filter(|socket| socket.exists()).map(|socket| port_at(socket)).collect();
    let boot = 3 + 1000 + 1;
    let statuses = while_collecting(&bench, &[3], unix_time, &ports, |seen| {
        wait_until(seen, "no window comes", |statuses| measures(statuses, &here, 3) && windows(statuses) >= 4);
        bench.nodes[&3].replug(&here, &there);
        wait_until(seen, "the other port is not found", |statuses| measures(statuses, &there, 3));
        let before = windows(&seen.lock().unwrap());
        wait_until(seen, "no window comes there", |statuses| windows(statuses) >= before + 4);
        // What went into the pulled cable is asked for again.
        wait_until(seen, "a window stays away", |_| is_without_gaps(&bench.numbers(3)));
        bench.nodes[&3].restart();
        let has_restarted = |statuses: &[PortStatus]| {
            statuses.iter().any(|status| status.hello.as_ref().is_some_and(|hello| hello.boot == boot))
        };
        wait_until(seen, "the restart is not seen", has_restarted);
        wait_until(seen, "no window of its new life comes", |_| {
            bench.lives(3).get(&boot).is_some_and(|numbers| numbers.len() >= 4)
        });
    });
    // Each window once, of both lives.
    let lives = bench.lives(3);
    assert_eq!(lives.keys().copied().collect::<Vec<u32>>(), [boot - 1, boot]);
    for (boot, numbers) in &lives {
        assert!(is_without_gaps(numbers), "life {boot}: {numbers:?}");
    }
    // Its count has moved with it: the port where it was has none.
    let stored: usize = lives.values().map(Vec::len).sum();
    assert_eq!(windows(&statuses), stored as u64);
    let old = at(&statuses, &here).unwrap();
    assert!(matches!(old.state, PortState::Gone(_)) && old.node.is_none(), "{old:?}");
}

#[test]
fn another_node_in_its_place_is_left_alone_and_does_not_end_collecting() {
    let bench = Bench::new();
    let (here, eight, there) = (bench.socket("node3"), bench.socket("node8"), bench.socket("elsewhere"));
    let is_listed = AtomicBool::new(false);
    let ports = || {
        let there = is_listed.load(Ordering::Relaxed).then(|| port_at(&there));
        there.into_iter().chain([port_at(&here)]).collect()
    };
    while_collecting(&bench, &[3], unix_time, &ports, |seen| {
        wait_until(seen, "no window comes", |statuses| measures(statuses, &here, 3) && windows(statuses) >= 4);
        bench.nodes[&3].replug(&here, &there);
        bench.nodes[&8].replug(&eight, &here);
        let is_foreign = |statuses: &[PortStatus]| {
            at(statuses, &here).is_some_and(|status| status.state == PortState::Foreign && status.node == Some(8))
        };
        wait_until(seen, "the other node is not seen", is_foreign);
        // What node 3 did there is not the other's.
        let status = at(&seen.lock().unwrap(), &here).unwrap().clone();
        assert!(status.statistics.windows == 0 && status.heartbeat.is_none(), "{status:?}");
        thread::sleep(Duration::from_secs(1));
        is_listed.store(true, Ordering::Relaxed);
        wait_until(seen, "its new port is not found", |statuses| measures(statuses, &there, 3));
        wait_until(seen, "no window comes there", |statuses| windows(statuses) >= 8);
        wait_until(seen, "a window stays away", |_| is_without_gaps(&bench.numbers(3)));
    });
    assert!(bench.numbers(8).is_empty());
    let numbers = bench.numbers(3);
    assert!(is_without_gaps(&numbers), "{numbers:?}");
}

/// How far the computer's clock is set ahead, in s.
static AHEAD_S: AtomicU64 = AtomicU64::new(0);

#[test]
fn a_computers_clock_that_is_set_moves_the_nodes_time_with_it() {
    let bench = Bench::with_crystals(200.0);
    let socket = bench.socket("node3");
    let set_time = || unix_time() + Duration::from_secs(AHEAD_S.load(Ordering::Relaxed));
    let ports = || vec![port_at(&socket)];
    let began_after = |seconds: f64| -> usize {
        let query = "SELECT count(*) FROM window WHERE start_us > ?1";
        bench.archive().query_row(query, [(seconds * 1e6) as i64], |row| row.get(0)).unwrap()
    };
    while_collecting(&bench, &[3], set_time, &ports, |seen| {
        // From 20 s on; on a busy computer some milliseconds of scheduling stand against them, fewer with every exchange.
        wait_until(seen, "the drift of -200 ppm is not found", |statuses| {
            let drift_ppm = at(statuses, &socket).and_then(|status| status.drift_ppm);
            drift_ppm.is_some_and(|drift_ppm| (drift_ppm + 200.0).abs() < 60.0)
        });
        let tomorrow_s = unix_time().as_secs_f64() + 80_000.0;
        assert_eq!(began_after(tomorrow_s), 0);
        AHEAD_S.store(86_400, Ordering::Relaxed);
        wait_until(seen, "no window of tomorrow comes", |_| began_after(tomorrow_s) >= 8);
        wait_until(seen, "a window stays away", |_| is_without_gaps(&bench.numbers(3)));
    });
    let numbers = bench.numbers(3);
    assert!(is_without_gaps(&numbers), "{numbers:?}");
    // Today's came before.
    assert!(began_after(0.0) > began_after(unix_time().as_secs_f64() + 80_000.0) + 8);
}

#[test]
fn a_full_disk_ends_collecting_and_costs_no_window() {
    let bench = Bench::new();
    bench.collect(&["--for", "3s"]).assert().success();
    let before = bench.numbers(3).len();
    assert!(before > 0);
    // No file may grow beyond a size that the archive is soon to reach; the shell counts in halves of KB.
    let halves = fs::metadata(bench.socket("archive.sqlite")).unwrap().len() / 512 + 100;
    let command = bench.collect(&["--for", "60s"]);
    let arguments: Vec<&str> = command.get_args().map(|argument| argument.to_str().unwrap()).collect();
    let mut limited = Command::new("sh");
    limited.args(["-c", &format!("trap '' XFSZ; ulimit -f {halves}; exec \"$@\""), "sh"]);
    limited.arg(command.get_program()).args(arguments);
    let output = limited.assert().failure().get_output().clone();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    for part in ["archive.sqlite", "cannot be used"] {
        assert!(said.contains(part), "no {part:?} in: {said}");
    }
    // The nodes still have what could not be kept.
    bench.collect_rest(before);
    for node in [3, 8] {
        let numbers = bench.numbers(node);
        assert!(numbers.len() > before + 4, "{} windows of node {node}, {before} before", numbers.len());
        assert!(is_without_gaps(&numbers), "node {node}: {numbers:?}");
    }
}
