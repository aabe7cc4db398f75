//! Collecting: a thread a port, from the first greeting to windows in the archive, until it is told to stop.
//!
//! A node is known by its greeting, not by its port: cables may be swapped, ports may vanish, and come back under another
//! name. Nothing is acknowledged before the archive has it on disk, so a stop at any moment loses nothing.

mod clock;
mod peaks;
mod sink;

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use belfry_shared::message::{ChannelState, Heartbeat, Hello};
use thiserror::Error;

use super::assembly::{ChannelData, Configurations};
use super::port::Port;
use super::replay::{ReplayError, who_is_there};
use super::session::{Session, SessionError, SessionStatistics};
use super::with_cause;
use crate::archive::Archive;
use clock::HostClock;
pub use clock::unix_time;
use peaks::PeakMeter;
use sink::ArchiveSink;

/// How long a port is asked who is there before it is asked again.
const ASK: Duration = Duration::from_secs(2);
/// Time between tries to open a port that is gone.
const REOPEN: Duration = Duration::from_secs(2);
/// How long a port where nobody answers is left alone: it may be another program's.
const SILENT_PAUSE: Duration = Duration::from_secs(5);
/// Time between tries of a port whose node is of no use: it may be given another number, or other cables.
const ASK_AGAIN: Duration = Duration::from_secs(15);
/// Time between looks at which ports there are.
const LIST: Duration = Duration::from_secs(2);
/// Time between looks at what the ports have come to.
const LOOK: Duration = Duration::from_millis(200);
/// A node counts as silent when nothing came for this long: two heartbeats.
const SILENT: Duration = Duration::from_secs(250);

/// Why collecting ended early.
#[derive(Debug, Error)]
pub enum CollectError {
    /// A window could not be kept.
    #[error(transparent)]
    Store(SessionError),
}

/// What is to be collected.
#[derive(Debug, Clone)]
pub struct Collection {
    /// The setup.
    pub setup: String,
    /// Baud rate of serial ports.
    pub baud: u32,
    /// Its nodes, and what each has to measure.
    pub nodes: BTreeMap<u16, Configurations>,
    /// Whether windows that nodes hold for another study are dropped.
    pub drop_foreign: bool,
    /// What tells Unix time: [`unix_time`].
    pub unix_time: fn() -> Duration,
}

/// What a port has come to.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum PortState {
    /// It is being opened, and asked who is there.
    #[default]
    Asking,
    /// Nobody answers.
    Silent,
    /// It cannot be opened, or has failed; it is tried again.
    Gone(String),
    /// Its node is given its configuration and the time.
    Preparing,
    /// Its node measures.
    Measuring,
    /// Its node does not belong to the setup, and is left alone.
    Foreign,
    /// Its node cannot be used as it is; it is tried again now and then.
    Refused(String),
}

impl PortState {
    /// Whether its node is of no use as it is.
    pub fn is_useless(&self) -> bool {
        matches!(self, Self::Foreign | Self::Refused(_))
    }
}

/// Windows since collecting began in which a channel was not sound.
#[derive(Debug, Clone, Copy, Default)]
pub struct Gaps {
    /// How many.
    pub windows: u64,
    /// What was wrong last: channel (from 0) and reason.
    pub last: Option<(usize, ChannelState)>,
}

/// A port, and the node on it.
#[derive(Debug, Clone, Default)]
pub struct PortStatus {
    /// The port.
    pub port: String,
    /// What it has come to.
    pub state: PortState,
    /// The node that answers, or did until its port failed.
    pub node: Option<u16>,
    /// Its last greeting.
    pub hello: Option<Hello>,
    /// Its last sign of life.
    pub heartbeat: Option<Heartbeat>,
    /// What its line did since collecting began.
    pub statistics: SessionStatistics,
    /// How much faster the host's clock runs than the node's, in parts per million, where it is known.
    pub drift_ppm: Option<f64>,
    /// Its windows with gaps.
    pub gaps: Gaps,
    /// Highest peaks of the mean density of all channels, in Hz, highest first.
    pub peaks_hz: Vec<f64>,
}

impl PortStatus {
    /// Leaves the port and its state.
    fn forget_node(&mut self) {
        let (port, state) = (std::mem::take(&mut self.port), std::mem::take(&mut self.state));
        *self = Self { port, state, ..Self::default() };
    }
}

/// What all threads share.
struct Shared<'a> {
    collection: &'a Collection,
    archive: Mutex<Archive>,
    clock: HostClock,
    stop: &'a AtomicBool,
    nodes: Mutex<BTreeMap<u16, Place>>,
    /// Whether any node has come to measure.
    has_measured: AtomicBool,
    failure: Mutex<Option<CollectError>>,
}

/// Where a node is that has answered.
enum Place {
    /// It is served on this port.
    Served(String),
    /// Its port is away, or silent; what is known of it goes on where it answers next.
    Away(Box<NodeState>),
}

/// What is known of a node.
struct NodeState {
    session: Session,
    /// The clock's generation that the session goes by.
    generation: u64,
    peaks: PeakMeter,
    gaps: Gaps,
}

/// A thread that panicked has told its fault already; what it shared is whole, for it is only changed in one go.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Collects until `stop` is set, `on_look` (which sees all ports five times a second) breaks, or no port could be used so far.
/// `ports` lists
/// the ports where nodes may be; it is asked again and again, for a node may be plugged in later.
///
/// # Errors
/// When a window cannot be kept; what was not kept stays in the nodes.
pub fn collect(
    collection: &Collection,
    archive: Archive,
    stop: &AtomicBool,
    ports: &dyn Fn() -> Vec<String>,
    on_look: &mut dyn FnMut(&[PortStatus]) -> ControlFlow<()>,
) -> Result<Vec<PortStatus>, CollectError> {
    let shared = Shared {
        collection,
        archive: Mutex::new(archive),
        clock: HostClock::new(collection.unix_time),
        stop,
        nodes: Mutex::default(),
        has_measured: AtomicBool::new(false),
        failure: Mutex::default(),
    };
    let mut statuses: BTreeMap<String, Arc<Mutex<PortStatus>>> = BTreeMap::new();
    thread::scope(|scope| {
        let shared = &shared;
        let mut workers = Vec::new();
        let mut listed: Option<Instant> = None;
        loop {
            if listed.is_none_or(|listed| listed.elapsed() >= LIST) {
                listed = Some(Instant::now());
                for port in ports() {
                    statuses.entry(port.clone()).or_insert_with(|| {
                        let status = Arc::new(Mutex::new(PortStatus { port: port.clone(), ..PortStatus::default() }));
                        let mut worker = Worker { shared, status: Arc::clone(&status), port };
                        workers.push(scope.spawn(move || worker.run()));
                        status
                    });
                }
            }
            let statuses = snapshot(&statuses);
            // Once a node has measured, another that is put in its place is no reason to give up.
            let is_hopeless =
                !shared.has_measured.load(Ordering::Relaxed) && statuses.iter().all(|status| status.state.is_useless());
            if on_look(&statuses).is_break() || is_hopeless {
                stop.store(true, Ordering::Relaxed);
            }
            if workers.iter().all(thread::ScopedJoinHandle::is_finished) {
                break;
            }
            thread::sleep(LOOK);
        }
        for worker in workers {
            worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        }
    });
    match lock(&shared.failure).take() {
        Some(failure) => Err(failure),
        None => Ok(snapshot(&statuses)),
    }
}

/// What all ports have come to. A port forgets a node that is served on another one now, so that the node counts once.
fn snapshot(statuses: &BTreeMap<String, Arc<Mutex<PortStatus>>>) -> Vec<PortStatus> {
    let serves = |status: &PortStatus| matches!(status.state, PortState::Preparing | PortState::Measuring);
    let served_node = |(port, status): (&String, &Arc<Mutex<PortStatus>>)| {
        let status = lock(status);
        status.node.filter(|_| serves(&status)).map(|node| (node, port.clone()))
    };
    let served: BTreeMap<u16, String> = statuses.iter().filter_map(served_node).collect();
    let look = |(port, status): (&String, &Arc<Mutex<PortStatus>>)| {
        let mut status = lock(status);
        let elsewhere = status.node.and_then(|node| served.get(&node)).is_some_and(|other| other != port);
        if elsewhere && !serves(&status) {
            status.forget_node();
        }
        status.clone()
    };
    statuses.iter().map(look).collect()
}

/// One port's thread.
struct Worker<'a> {
    shared: &'a Shared<'a>,
    status: Arc<Mutex<PortStatus>>,
    port: String,
}

impl Worker<'_> {
    fn is_stopped(&self) -> bool {
        self.shared.stop.load(Ordering::Relaxed)
    }

    fn set(&self, state: PortState) {
        lock(&self.status).state = state;
    }

    /// Waits, but not for long after a stop.
    fn wait(&self, duration: Duration) {
        let start = Instant::now();
        while start.elapsed() < duration && !self.is_stopped() {
            thread::sleep(LOOK.min(duration));
        }
    }

    fn run(&mut self) {
        while !self.is_stopped() {
            let pause = match Port::open(&self.port, self.shared.collection.baud) {
                Ok(mut port) => self.use_port(&mut port),
                Err(error) => {
                    self.set(PortState::Gone(with_cause(&error)));
                    REOPEN
                }
            };
            self.wait(pause);
        }
    }

    /// Asks who is there, and serves the node; when the port has failed, or is of no use, the pause before another try.
    fn use_port(&mut self, port: &mut Port) -> Duration {
        while !self.is_stopped() {
            let node = match who_is_there(port, ASK) {
                Ok(hello) => {
                    let mut status = lock(&self.status);
                    let node = hello.node;
                    if status.node != Some(node) {
                        status.forget_node();
                    }
                    status.node = Some(node);
                    status.hello = Some(hello);
                    node
                }
                Err(ReplayError::Silent) => {
                    self.set(PortState::Silent);
                    return SILENT_PAUSE;
                }
                Err(ReplayError::Line { source }) => {
                    self.set(PortState::Gone(source.to_string()));
                    return REOPEN;
                }
                Err(error) => {
                    self.set(PortState::Refused(with_cause(&error)));
                    return ASK_AGAIN;
                }
            };
            let Some(configurations) = self.shared.collection.nodes.get(&node) else {
                self.set(PortState::Foreign);
                return ASK_AGAIN;
            };
            let mut state = match self.take(node, configurations) {
                Ok(state) => state,
                Err(other) => {
                    self.set(PortState::Refused(format!(
                        "node {node} answers on {other} already: two nodes have its number"
                    )));
                    return ASK_AGAIN;
                }
            };
            self.set(PortState::Preparing);
            let served = self.serve(&mut state, configurations, port);
            lock(&self.shared.nodes).insert(node, Place::Away(state));
            match served {
                // It has been silent for long, or another node is on the cable now.
                Ok(()) | Err(SessionError::WrongNode { .. }) => {}
                Err(SessionError::Transport { source, .. }) => {
                    self.set(PortState::Gone(source.to_string()));
                    return REOPEN;
                }
                Err(error @ SessionError::Store { .. }) => {
                    self.set(PortState::Refused(with_cause(&error)));
                    *lock(&self.shared.failure) = Some(CollectError::Store(error));
                    self.shared.stop.store(true, Ordering::Relaxed);
                    return ASK_AGAIN;
                }
                Err(error) => {
                    self.set(PortState::Refused(with_cause(&error)));
                    return ASK_AGAIN;
                }
            }
        }
        ASK_AGAIN
    }

    /// Takes charge of a node; the port that has it already, where one does.
    fn take(&self, node: u16, configurations: &Configurations) -> Result<Box<NodeState>, String> {
        let Collection { baud, drop_foreign, .. } = *self.shared.collection;
        let mut nodes = lock(&self.shared.nodes);
        match nodes.insert(node, Place::Served(self.port.clone())) {
            None => Ok(Box::new(NodeState {
                session: Session::new(node, configurations.clone(), baud).dropping_foreign(drop_foreign),
                generation: self.shared.clock.look().1,
                peaks: PeakMeter::new(&configurations.current),
                gaps: Gaps::default(),
            })),
            Some(Place::Away(state)) => Ok(state),
            Some(Place::Served(other)) => {
                nodes.insert(node, Place::Served(other.clone()));
                Err(other)
            }
        }
    }

    /// Serves a node until the stop, until it has been silent for long, or until its line fails.
    fn serve(
        &self,
        state: &mut NodeState,
        configurations: &Configurations,
        port: &mut Port,
    ) -> Result<(), SessionError> {
        let shared = self.shared;
        let NodeState { session, generation, peaks, gaps } = state;
        session.reconnect();
        let mut looked = Instant::now();
        let mut heard = (session.statistics().frames, Instant::now());
        loop {
            let (now, current) = shared.clock.look();
            if current != *generation {
                // The computer's clock was set: what is known of the node's is worth nothing.
                *generation = current;
                session.restart();
            }
            let mut sink = ArchiveSink {
                archive: &shared.archive,
                setup: &shared.collection.setup,
                configurations,
                now,
                on_window: &mut |window| {
                    let mut unsound = window.channels.iter().enumerate().filter_map(|(channel, data)| match data {
                        ChannelData::Unsound(reason) => Some((channel, *reason)),
                        _ => None,
                    });
                    if let Some(gap) = unsound.next_back() {
                        *gaps = Gaps { windows: gaps.windows + 1, last: Some(gap) };
                    }
                    peaks.add(window);
                },
            };
            session.service(&|| shared.clock.look().0, port, &mut sink)?;
            let frames = session.statistics().frames;
            if frames > heard.0 {
                heard = (frames, Instant::now());
            }
            let ends = self.is_stopped() || heard.1.elapsed() > SILENT;
            if looked.elapsed() >= LOOK || ends {
                looked = Instant::now();
                let mut status = lock(&self.status);
                status.state = if session.is_measuring() { PortState::Measuring } else { PortState::Preparing };
                shared.has_measured.fetch_or(session.is_measuring(), Ordering::Relaxed);
                status.node = Some(session.node());
                status.hello = session.hello().cloned().or(status.hello.take());
                status.heartbeat = session.heartbeat().cloned();
                status.statistics = session.statistics();
                status.drift_ppm = session.clock().drift_ppm();
                status.gaps = *gaps;
                status.peaks_hz = peaks.peaks_hz().to_vec();
            }
            if ends {
                return Ok(());
            }
        }
    }
}
