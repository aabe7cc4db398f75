//! Collecting: a thread a port, from the first greeting to windows in the archive, until it is told to stop.
//!
//! A node is known by its greeting, not by its port: cables may be swapped, ports may vanish and come back. Nothing is
//! acknowledged before the archive has it on disk, so a stop at any moment loses nothing.

mod clock;
mod peaks;
mod sink;

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use belfry_shared::message::{ChannelState, Heartbeat, Hello};
use belfry_shared::time::HostTime;
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
/// Time between tries of a port whose node is of no use: it may be given another number, or other cables.
const ASK_AGAIN: Duration = Duration::from_secs(15);
/// Time between looks at what the ports have come to.
const LOOK: Duration = Duration::from_millis(200);
/// A node counts as silent when nothing came for this long: two heartbeats.
const SILENT_US: i64 = 250_000_000;

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
    /// Ports where its nodes may be.
    pub ports: Vec<String>,
    /// Baud rate of serial ports.
    pub baud: u32,
    /// Its nodes, and what each has to measure.
    pub nodes: BTreeMap<u16, Configurations>,
    /// Whether windows that nodes hold for another study are dropped.
    pub drop_foreign: bool,
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

/// A port, and the node on it.
#[derive(Debug, Clone, Default)]
pub struct PortStatus {
    /// The port.
    pub port: String,
    /// What it has come to.
    pub state: PortState,
    /// The node that answers.
    pub node: Option<u16>,
    /// Its last greeting.
    pub hello: Option<Hello>,
    /// Its last sign of life.
    pub heartbeat: Option<Heartbeat>,
    /// What its line did since collecting began.
    pub statistics: SessionStatistics,
    /// How much faster the host's clock runs than the node's, in parts per million, where it is known.
    pub drift_ppm: Option<f64>,
    /// Windows since collecting began in which a channel was not sound, and what was wrong last.
    pub gaps: u64,
    /// The last gap: channel (from 0) and reason.
    pub last_gap: Option<(usize, ChannelState)>,
    /// Highest peaks of the mean density of all channels, in Hz, highest first.
    pub peaks_hz: Vec<f64>,
}

/// What all threads share.
struct Shared<'a> {
    collection: &'a Collection,
    archive: Mutex<Archive>,
    clock: HostClock,
    stop: &'a AtomicBool,
    /// Which port serves a node.
    claims: Mutex<BTreeMap<u16, String>>,
    failure: Mutex<Option<CollectError>>,
}

/// A thread that panicked has told its fault already; what it shared is whole, for it is only changed in one go.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Collects until `stop` is set, `on_look` (which sees all ports five times a second) breaks, or no port can be used.
///
/// # Errors
/// When a window cannot be kept; what was not kept stays in the nodes.
pub fn collect(
    collection: &Collection,
    archive: Archive,
    stop: &AtomicBool,
    on_look: &mut dyn FnMut(&[PortStatus]) -> ControlFlow<()>,
) -> Result<Vec<PortStatus>, CollectError> {
    let shared = Shared {
        collection,
        archive: Mutex::new(archive),
        clock: HostClock::new(),
        stop,
        claims: Mutex::default(),
        failure: Mutex::default(),
    };
    let fresh = |port: &String| Mutex::new(PortStatus { port: port.clone(), ..PortStatus::default() });
    let statuses: Vec<Mutex<PortStatus>> = collection.ports.iter().map(fresh).collect();
    let snapshot = || -> Vec<PortStatus> { statuses.iter().map(|status| lock(status).clone()).collect() };
    thread::scope(|scope| {
        let shared = &shared;
        let workers: Vec<_> =
            statuses.iter().map(|status| scope.spawn(move || Worker::new(shared, status).run())).collect();
        while !workers.iter().all(thread::ScopedJoinHandle::is_finished) {
            let statuses = snapshot();
            if on_look(&statuses).is_break() || statuses.iter().all(|status| status.state.is_useless()) {
                stop.store(true, Ordering::Relaxed);
            }
            thread::sleep(LOOK);
        }
        for worker in workers {
            worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        }
    });
    match lock(&shared.failure).take() {
        Some(failure) => Err(failure),
        None => Ok(snapshot()),
    }
}

/// What remains of a node while its port is away.
struct NodeState {
    session: Session,
    peaks: PeakMeter,
    gaps: u64,
    last_gap: Option<(usize, ChannelState)>,
}

/// One port's thread.
struct Worker<'a> {
    shared: &'a Shared<'a>,
    status: &'a Mutex<PortStatus>,
    port: String,
    nodes: BTreeMap<u16, NodeState>,
    /// The clock's generation that the sessions have been told the time of.
    generation: u64,
}

impl<'a> Worker<'a> {
    fn new(shared: &'a Shared<'a>, status: &'a Mutex<PortStatus>) -> Self {
        let port = lock(status).port.clone();
        Self { shared, status, port, nodes: BTreeMap::new(), generation: shared.clock.look().1 }
    }

    fn is_stopped(&self) -> bool {
        self.shared.stop.load(Ordering::Relaxed)
    }

    fn set(&self, state: PortState) {
        lock(self.status).state = state;
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
                Ok(mut port) => {
                    let pause = self.use_port(&mut port);
                    lock(&self.shared.claims).retain(|_, claimed| *claimed != self.port);
                    pause
                }
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
                    let mut status = lock(self.status);
                    status.node = Some(hello.node);
                    let node = hello.node;
                    status.hello = Some(hello);
                    node
                }
                Err(ReplayError::Silent) => {
                    self.set(PortState::Silent);
                    continue;
                }
                Err(ReplayError::Session(SessionError::Transport { source, .. })) => {
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
            let claimed = lock(&self.shared.claims).entry(node).or_insert_with(|| self.port.clone()).clone();
            if claimed != self.port {
                self.set(PortState::Refused(format!(
                    "node {node} answers on {claimed} already: two nodes have its number"
                )));
                return ASK_AGAIN;
            }
            self.set(PortState::Preparing);
            match self.serve(node, configurations, port) {
                Ok(()) => {}
                // Another node is on the cable now.
                Err(SessionError::WrongNode { .. }) => {
                    lock(&self.shared.claims).remove(&node);
                }
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

    /// Serves a node until the stop, or until its line fails.
    fn serve(&mut self, node: u16, configurations: &Configurations, port: &mut Port) -> Result<(), SessionError> {
        let shared = self.shared;
        let baud = shared.collection.baud;
        let state = self.nodes.entry(node).or_insert_with(|| NodeState {
            session: Session::new(node, configurations.clone(), baud).dropping_foreign(shared.collection.drop_foreign),
            peaks: PeakMeter::new(&configurations.current),
            gaps: 0,
            last_gap: None,
        });
        let NodeState { session, peaks, gaps, last_gap } = state;
        session.reconnect();
        let mut looked = Instant::now();
        loop {
            let (now, generation) = shared.clock.look();
            if generation != self.generation {
                // The computer's clock was set: what is known of the node's is worth nothing.
                self.generation = generation;
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
                        *gaps += 1;
                        *last_gap = Some(gap);
                    }
                    peaks.add(window);
                },
            };
            session.service(&|| shared.clock.look().0, port, &mut sink)?;
            let stopped = shared.stop.load(Ordering::Relaxed);
            if looked.elapsed() >= LOOK || stopped {
                looked = Instant::now();
                let mut status = lock(self.status);
                status.state = match (session.is_measuring(), is_silent(session, now)) {
                    (_, true) => PortState::Silent,
                    (true, false) => PortState::Measuring,
                    (false, false) => PortState::Preparing,
                };
                status.node = Some(node);
                status.hello = session.hello().cloned().or(status.hello.take());
                status.heartbeat = session.heartbeat().cloned();
                status.statistics = session.statistics();
                status.drift_ppm = session.clock().drift_ppm();
                (status.gaps, status.last_gap) = (*gaps, *last_gap);
                status.peaks_hz = peaks.peaks_hz().to_vec();
            }
            if stopped {
                return Ok(());
            }
        }
    }
}

fn is_silent(session: &Session, now: HostTime) -> bool {
    let last = session.last_received();
    last.0 > i64::MIN && now.0.saturating_sub(last.0) > SILENT_US
}
