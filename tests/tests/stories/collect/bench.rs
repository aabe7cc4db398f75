//! Nodes, cables, and a host that collects, all in simulated time.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use belfry_firmware::{Identity, Keeper, Memory, Node, SimulatedChip, Store, Technology};
use belfry_host::archive::Archive;
use belfry_host::collect::{
    Clock, CollectOptions, Collection, Collector, Event, PortServer, PortState, PortStatus, Ports, Report,
};
use belfry_host::link::Transport;
use belfry_host::link::memory::{Faults, Line};
use belfry_host::study::Study;
use belfry_shared::frame::MAX_FRAME_BYTES;
use belfry_shared::message::Kept;
use belfry_shared::time::NodeTime;
use belfry_tests::cable::{Connection, connect};

use super::mast::{RATE_HZ, folder_in_memory, identity, is_without_gaps, motion, numbers, write_study};

const BAUD: u32 = 115_200;
/// Bytes are looked at this often.
const STEP: Duration = Duration::from_micros(250);
/// What is waited for comes within this simulated time.
const PATIENCE: Duration = Duration::from_secs(60);
/// Unix time when the nodes are switched on.
const BEGIN: Duration = Duration::from_secs(1_900_000_000);

/// The host's clocks.
#[derive(Default)]
struct SimulatedClock {
    steady_us: AtomicU64,
    /// How far the computer's clock is set ahead.
    ahead_s: AtomicU64,
}

impl Clock for SimulatedClock {
    fn steady(&self) -> Duration {
        Duration::from_micros(self.steady_us.load(Ordering::Relaxed))
    }

    fn unix(&self) -> Duration {
        BEGIN + self.steady() + Duration::from_secs(self.ahead_s.load(Ordering::Relaxed))
    }
}

/// The memory chip of a node; of one without, it has no bytes.
type Chip = SimulatedChip<Vec<u8>>;

fn node_with(number: u16, boot: u32, chip: Chip) -> Node<Box<Memory>, Store<Chip>> {
    let store = Store::open(chip, boot);
    let identity = Identity { boot: store.boot(), ..identity(number) };
    Node::with_store(identity, Box::new(Memory::new()), store)
}

/// The firmware, with its crystal and its columns of the motion; it goes on when the host has gone.
struct SimulatedNode {
    number: u16,
    boot: u32,
    ppm: f64,
    first_column: usize,
    node: Node<Box<Memory>, Store<Chip>>,
    technology: Technology,
    rows: usize,
    /// The port where its cable is plugged in.
    port: String,
    connection: Option<Connection>,
}

impl SimulatedNode {
    fn new(number: u16, ppm: f64, first_column: usize) -> Self {
        let boot = u32::from(number) + 1000;
        let technology = Technology::Fram;
        let (node, port) = (node_with(number, boot, Chip::new(Vec::new(), technology)), format!("node{number}"));
        Self { number, boot, ppm, first_column, node, technology, rows: 0, port, connection: None }
    }

    fn time(&self, seconds: f64) -> NodeTime {
        NodeTime((seconds * (1.0 + self.ppm * 1e-6) * 1e6) as u64)
    }

    fn step(&mut self, now: Duration, motion: &[[f32; 4]]) {
        let now_s = now.as_secs_f64();
        while (self.rows as f64) < now_s * RATE_HZ {
            let row = &motion[self.rows % motion.len()];
            let time = self.time(self.rows as f64 / RATE_HZ);
            self.node.sample(time, &row[self.first_column..self.first_column + 2]);
            while self.node.poll(time) | self.node.keep(time) {}
            self.rows += 1;
        }
        if self.connection.as_ref().is_some_and(|connection| !connection.is_held()) {
            self.connection = None;
        }
        let time = self.time(now_s);
        let Some(Connection { line, .. }) = &self.connection else { return };
        let now_ns = now.as_nanos() as i64;
        line.advance(now_ns);
        let mut end = line.node_end();
        let mut buffer = [0; MAX_FRAME_BYTES];
        while let count @ 1.. = end.read(&mut buffer).unwrap() {
            buffer[..count].iter().for_each(|&byte| self.node.receive(time, byte));
        }
        while self.node.poll(time) | self.node.keep(time) {}
        if self.node.has_bytes() && line.node_free_at() <= now_ns {
            let count = self.node.transmit(time, &mut buffer);
            end.write(&buffer[..count]).unwrap();
        }
    }
}

/// The mast's study, its nodes, and the time.
pub(super) struct Bench {
    folder: tempfile::TempDir,
    motion: Vec<[f32; 4]>,
    clock: SimulatedClock,
    nodes: RefCell<BTreeMap<u16, SimulatedNode>>,
    /// Ports that are there, but are not listed yet.
    hidden: RefCell<Vec<String>>,
    /// Bytes that the archive has room for.
    room: Cell<Option<u64>>,
}

impl Bench {
    /// The one node's crystal gains 20 ppm, the other's loses as much.
    pub(super) fn new() -> Self {
        Self::with_crystals(20.0)
    }

    pub(super) fn with_crystals(ppm: f64) -> Self {
        let folder = folder_in_memory();
        write_study(folder.path());
        let nodes = BTreeMap::from([(3, SimulatedNode::new(3, ppm, 0)), (8, SimulatedNode::new(8, -ppm, 2))]);
        Self {
            folder,
            motion: motion(200.0),
            clock: SimulatedClock::default(),
            nodes: RefCell::new(nodes),
            hidden: RefCell::default(),
            room: Cell::default(),
        }
    }

    pub(super) fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Unix time by the computer's clock, in s.
    pub(super) fn unix_s(&self) -> f64 {
        self.clock.unix().as_secs_f64()
    }

    /// Sets the computer's clock ahead.
    pub(super) fn set_ahead(&self, seconds: u64) {
        self.clock.ahead_s.fetch_add(seconds, Ordering::Relaxed);
    }

    /// Pulls a node's cable, and plugs it in at another port.
    pub(super) fn replug(&self, node: u16, port: &str) {
        let mut nodes = self.nodes.borrow_mut();
        let node = nodes.get_mut(&node).unwrap();
        (node.port, node.connection) = (port.to_owned(), None);
    }

    /// Has a disk that is full once the archive is so long.
    pub(super) fn fill_disk(&self, room: u64) {
        self.room.set(Some(room));
    }

    /// Leaves a port out of the list, or puts it back.
    pub(super) fn hide(&self, port: &str, is_hidden: bool) {
        let mut hidden = self.hidden.borrow_mut();
        hidden.retain(|other| other != port);
        hidden.extend(is_hidden.then(|| port.to_owned()));
    }

    /// Starts a node anew; what it had is gone.
    pub(super) fn restart(&self, node: u16) -> u32 {
        let mut nodes = self.nodes.borrow_mut();
        let node = nodes.get_mut(&node).unwrap();
        node.boot += 1;
        node.node = node_with(node.number, node.boot, Chip::new(Vec::new(), node.technology));
        node.boot
    }

    /// Gives a node a blank memory chip, before it has begun.
    pub(super) fn give_chip(&self, node: u16, technology: Technology, bytes: usize) {
        let mut nodes = self.nodes.borrow_mut();
        let node = nodes.get_mut(&node).unwrap();
        node.technology = technology;
        node.node = node_with(node.number, node.boot, Chip::new(vec![0xFF; bytes], technology));
    }

    /// Has a node with a chip lose its supply while it writes the chip, after so many more bytes; what it has kept of earlier boots when it starts again.
    pub(super) fn cut(&self, node: u16, bytes: u64) -> Kept {
        self.nodes.borrow_mut().get_mut(&node).unwrap().node.store().chip().fail_after(bytes, 0x5A);
        while !self.nodes.borrow_mut().get_mut(&node).unwrap().node.store().chip().has_failed() {
            self.step();
        }
        let mut nodes = self.nodes.borrow_mut();
        let node = nodes.get_mut(&node).unwrap();
        let fresh = node_with(node.number, node.boot, Chip::new(Vec::new(), node.technology));
        let memory = std::mem::replace(&mut node.node, fresh).release().release().release();
        node.node = node_with(node.number, node.boot, Chip::new(memory, node.technology));
        node.connection = None;
        node.node.store().kept().unwrap()
    }

    fn step(&self) {
        let now = self.clock.steady() + STEP;
        self.clock.steady_us.store(now.as_micros() as u64, Ordering::Relaxed);
        self.nodes.borrow_mut().values_mut().for_each(|node| node.step(now, &self.motion));
    }

    /// Time passes with no host there.
    pub(super) fn pass(&self, duration: Duration) {
        let end = self.clock.steady() + duration;
        while self.clock.steady() < end {
            self.step();
        }
    }

    /// Collects for the study in `folder` what `story` waits for; the report, or what the command says instead.
    pub(super) fn collect(
        &self,
        folder: &Path,
        options: &CollectOptions,
        story: impl FnOnce(&mut Host<'_>),
    ) -> Result<Report, String> {
        self.try_collect(folder, options, story).map_err(|error| {
            let mut text = error.to_string();
            let mut cause = error.source();
            while let Some(error) = cause {
                text += &format!(": {error}");
                cause = error.source();
            }
            text
        })
    }

    fn try_collect(
        &self,
        folder: &Path,
        options: &CollectOptions,
        story: impl FnOnce(&mut Host<'_>),
    ) -> Result<Report, Box<dyn Error>> {
        let study = Study::load(folder)?;
        let mut archive = Archive::create(folder)?;
        if let Some(room) = self.room.get() {
            archive.limit_bytes(room)?;
        }
        let (setup, collection) = Collection::of(&study, &mut archive, options, self.clock.unix())?;
        let begin = self.clock.steady();
        let collector = Collector::new(&collection, archive, &self.clock);
        let mut host = Host { bench: self, collector: &collector, servers: Vec::new() };
        story(&mut host);
        host.servers.into_iter().for_each(|server| server.end(&collector));
        let statuses = collector.finish()?;
        let report = Report::new(setup, folder, self.clock.steady() - begin, &statuses)?;
        report.verdict()?;
        Ok(report)
    }

    /// Collects for the bench's own study, for some seconds.
    pub(super) fn collect_for(&self, seconds: u64) -> Result<Report, String> {
        self.collect(self.folder(), &options(), |host| host.run(Duration::from_secs(seconds)))
    }

    /// Collects until no window stays away of those after the first `count`: what was asked for when collecting ended comes
    /// with the next run.
    pub(super) fn collect_rest(&self, count: usize) {
        let has_gaps = |node| numbers(self.folder(), node)[count..].windows(2).any(|pair| pair[1] != pair[0] + 1);
        for _ in 0..5 {
            self.collect_for(4).unwrap();
            if ![3, 8].into_iter().any(has_gaps) {
                return;
            }
        }
    }
}

/// What the command takes where nothing is said.
pub(super) fn options() -> CollectOptions {
    CollectOptions { baud: BAUD, ..CollectOptions::default() }
}

impl Ports for Bench {
    fn list(&self) -> Vec<String> {
        let (nodes, hidden) = (self.nodes.borrow(), self.hidden.borrow());
        nodes.values().map(|node| node.port.clone()).filter(|port| !hidden.contains(port)).collect()
    }

    fn open(&self, name: &str) -> Result<Box<dyn Transport>, String> {
        let mut nodes = self.nodes.borrow_mut();
        let node = nodes.values_mut().find(|node| node.port == name).ok_or("there is no such port")?;
        let line = Line::new(BAUD, Faults::default(), 1);
        line.advance(self.clock.steady().as_nanos() as i64);
        let (connection, plug) = connect(line);
        node.connection = Some(connection);
        Ok(Box::new(plug))
    }
}

/// A host at work.
pub(super) struct Host<'a> {
    bench: &'a Bench,
    collector: &'a Collector<'a>,
    servers: Vec<PortServer>,
}

impl Host<'_> {
    fn step(&mut self) {
        self.bench.step();
        for port in self.collector.new_ports(self.bench) {
            self.servers.push(PortServer::new(self.collector, &port));
        }
        for server in &mut self.servers {
            server.step(self.collector, self.bench);
        }
    }

    /// Goes on for a while, or until collecting ends by itself.
    pub(super) fn run(&mut self, duration: Duration) {
        let end = self.bench.clock.steady() + duration;
        while self.bench.clock.steady() < end && !self.collector.is_over() {
            self.step();
        }
    }

    /// Goes on until what the ports have come to is as it should be.
    pub(super) fn wait_until(&mut self, what: &str, is_so: impl Fn(&[PortStatus]) -> bool) {
        let patience = self.bench.clock.steady() + PATIENCE;
        while !is_so(&self.statuses()) {
            assert!(!self.collector.is_over(), "{what}; it has ended by itself: {:?}", self.statuses());
            assert!(self.bench.clock.steady() < patience, "{what}: {:?}", self.statuses());
            self.run(Duration::from_millis(50));
        }
    }

    /// Goes on until the archive has no gap among a node's windows.
    pub(super) fn wait_for_all(&mut self, node: u16) {
        let folder = self.bench.folder().to_owned();
        self.wait_until("a window stays away", |_| is_without_gaps(&numbers(&folder, node)));
    }

    /// What has happened since the last call.
    pub(super) fn take_events(&self) -> Vec<Event> {
        self.collector.take_events()
    }

    pub(super) fn statuses(&self) -> Vec<PortStatus> {
        self.collector.statuses()
    }
}

pub(super) fn at<'a>(statuses: &'a [PortStatus], port: &str) -> Option<&'a PortStatus> {
    statuses.iter().find(|status| status.port == port)
}

pub(super) fn measures(statuses: &[PortStatus], port: &str, node: u16) -> bool {
    at(statuses, port).is_some_and(|status| status.state == PortState::Measuring && status.node == Some(node))
}

pub(super) fn windows(statuses: &[PortStatus]) -> u64 {
    statuses.iter().map(|status| status.statistics.windows).sum()
}
