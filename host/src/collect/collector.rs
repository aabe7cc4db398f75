//! What the ports of a collection share: the archive, the clock, and what is known of every node wherever it answers.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use belfry_shared::time::HostTime;
use thiserror::Error;

use super::clock::{Clock, HostClock};
use super::collection::Collection;
use super::event::{Event, Happening};
use super::lock::lock;
use super::peaks::PeakMeter;
use super::ports::Ports;
use super::sink::ArchiveSink;
use super::status::{Gaps, PortStatus};
use crate::archive::Archive;
use crate::files::folder_of;
use crate::heartbeats::HeartbeatLog;
use crate::link::{Session, SessionError};
use crate::patience::Patience;
use crate::window::{Configurations, NodeWindow};

/// How long another program that writes into the archive is waited for, before it is left for a moment.
const WAIT: Duration = Duration::from_millis(500);
/// Time between looks at which ports there are.
const LIST: Duration = Duration::from_secs(2);

/// Why collecting ended early, or gave nothing.
#[derive(Debug, Error)]
pub enum CollectError {
    /// A window could not be kept.
    #[error(transparent)]
    Store(SessionError),
    /// Nodes answered, but none that can be used.
    #[error("no port has a node that can be used: {reasons}")]
    NoUsableNode {
        /// Why, port by port.
        reasons: String,
    },
    /// No node answered.
    #[error("no node has answered on {ports}")]
    NoAnswer {
        /// The ports.
        ports: String,
    },
}

/// Where a node is that has answered.
enum Whereabouts {
    /// It is served on this port.
    Served(String),
    /// Its port is away, or silent; what is known of it goes on where it answers next.
    Away(Box<NodeState>),
}

/// What is known of a node.
pub(super) struct NodeState {
    pub(super) session: Session,
    /// The clock's generation that the session goes by.
    pub(super) generation: u64,
    pub(super) peaks: PeakMeter,
    pub(super) gaps: Gaps,
    /// Lost windows that have been reported.
    pub(super) reported_losses: u64,
}

type SharedStatus = Arc<Mutex<PortStatus>>;

/// A collection at work.
pub struct Collector<'a> {
    collection: &'a Collection,
    pub(super) archive: Mutex<Archive>,
    /// With an archive that cannot be written for a while.
    pub(super) patience: Mutex<Patience>,
    pub(super) heartbeats: Mutex<HeartbeatLog>,
    /// With the file of heartbeats.
    pub(super) heartbeat_patience: Mutex<Patience>,
    clock: &'a dyn Clock,
    host_clock: HostClock,
    stopped: AtomicBool,
    last_listed: Mutex<Option<Duration>>,
    statuses: Mutex<BTreeMap<String, SharedStatus>>,
    nodes: Mutex<BTreeMap<u16, Whereabouts>>,
    /// Whether any node has come to measure.
    has_measured: AtomicBool,
    events: Mutex<Vec<Event>>,
    failure: Mutex<Option<CollectError>>,
}

impl<'a> Collector<'a> {
    /// A collection that begins now.
    pub fn new(collection: &'a Collection, archive: Archive, clock: &'a dyn Clock) -> Self {
        // Longer would hold up all ports. On an open database this does not fail.
        let _ = archive.wait_for_others(WAIT);
        Self {
            collection,
            heartbeats: Mutex::new(HeartbeatLog::new(folder_of(archive.file()))),
            heartbeat_patience: Mutex::default(),
            archive: Mutex::new(archive),
            patience: Mutex::default(),
            clock,
            host_clock: HostClock::new(clock),
            stopped: AtomicBool::new(false),
            last_listed: Mutex::default(),
            statuses: Mutex::default(),
            nodes: Mutex::default(),
            has_measured: AtomicBool::new(false),
            events: Mutex::default(),
            failure: Mutex::default(),
        }
    }

    /// Ports that have appeared since the last call; each needs a [`PortServer`](super::PortServer). It looks every two seconds.
    pub fn new_ports(&self, ports: &dyn Ports) -> Vec<String> {
        let now = self.steady();
        let mut listed = lock(&self.last_listed);
        if listed.is_some_and(|listed| now.saturating_sub(listed) < LIST) {
            return Vec::new();
        }
        *listed = Some(now);
        let mut statuses = lock(&self.statuses);
        let mut new = Vec::new();
        for port in ports.list() {
            if !statuses.contains_key(&port) {
                let status = PortStatus { port: port.clone(), ..PortStatus::default() };
                statuses.insert(port.clone(), Arc::new(Mutex::new(status)));
                new.push(port);
            }
        }
        new
    }

    /// What all ports have come to. A port forgets a node that is served on another one now, so that the node counts once.
    pub fn statuses(&self) -> Vec<PortStatus> {
        let statuses = lock(&self.statuses);
        let served_node = |(port, status): (&String, &SharedStatus)| {
            let status = lock(status);
            status.node.filter(|_| status.state.is_served()).map(|node| (node, port.clone()))
        };
        let served: BTreeMap<u16, String> = statuses.iter().filter_map(served_node).collect();
        let look = |(port, status): (&String, &SharedStatus)| {
            let mut status = lock(status);
            let elsewhere = status.node.and_then(|node| served.get(&node)).is_some_and(|other| other != port);
            if elsewhere && !status.state.is_served() {
                status.forget_node();
            }
            status.clone()
        };
        statuses.iter().map(look).collect()
    }

    /// What has happened since the last call.
    pub fn take_events(&self) -> Vec<Event> {
        std::mem::take(&mut lock(&self.events))
    }

    /// Looks at the archive that windows go into, or sets how it is written.
    pub fn with_archive<T>(&self, look: impl FnOnce(&Archive) -> T) -> T {
        look(&lock(&self.archive))
    }

    /// Ends collecting.
    pub fn stop(&self) {
        self.stopped.store(true, Ordering::Relaxed);
    }

    /// Whether it has ended: it was stopped, a window could not be kept, or no port is of any use.
    pub fn is_over(&self) -> bool {
        // Once a node has measured, another that is put in its place is no reason to give up.
        let is_hopeless = || {
            let statuses = lock(&self.statuses);
            !statuses.is_empty() && statuses.values().all(|status| lock(status).state.is_useless())
        };
        if !self.has_measured.load(Ordering::Relaxed) && is_hopeless() {
            self.stop();
        }
        self.is_stopped()
    }

    /// What the ports have come to in the end.
    ///
    /// # Errors
    /// When a window could not be kept; what was not kept stays in the nodes.
    pub fn finish(self) -> Result<Vec<PortStatus>, CollectError> {
        match lock(&self.failure).take() {
            Some(failure) => Err(failure),
            None => Ok(self.statuses()),
        }
    }

    pub(super) fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }

    pub(super) fn collection(&self) -> &Collection {
        self.collection
    }

    pub(super) fn steady(&self) -> Duration {
        self.clock.steady()
    }

    /// The host's time, and how often the computer's clock has jumped.
    pub(super) fn host_time(&self) -> (HostTime, u64) {
        self.host_clock.look(self.clock)
    }

    /// A port's status, which its server keeps.
    pub(super) fn status_of(&self, port: &str) -> SharedStatus {
        Arc::clone(lock(&self.statuses).entry(port.to_owned()).or_default())
    }

    pub(super) fn happened(&self, port: &str, node: Option<u16>, what: Happening) {
        let event = Event { unix: self.clock.unix(), port: port.to_owned(), node, what };
        lock(&self.events).push(event);
    }

    pub(super) fn measures(&self) {
        self.has_measured.store(true, Ordering::Relaxed);
    }

    pub(super) fn fail(&self, failure: CollectError) {
        *lock(&self.failure) = Some(failure);
        self.stop();
    }

    /// Where windows of a node go at `now`.
    pub(super) fn sink<'s>(
        &'s self,
        port: &'s str,
        configurations: &'s Configurations,
        now: HostTime,
        on_window: &'s mut dyn FnMut(&NodeWindow, HostTime),
    ) -> ArchiveSink<'s> {
        ArchiveSink { collector: self, port, configurations, now, on_window }
    }

    /// Takes charge of a node; the port that has it already, where one does.
    pub(super) fn take(
        &self,
        node: u16,
        port: &str,
        configurations: &Configurations,
    ) -> Result<Box<NodeState>, String> {
        let Collection { baud, drop_foreign, ref keys, .. } = *self.collection;
        let mut nodes = lock(&self.nodes);
        match nodes.insert(node, Whereabouts::Served(port.to_owned())) {
            None => Ok(Box::new(NodeState {
                session: Session::new(node, configurations.clone(), baud)
                    .dropping_foreign(drop_foreign)
                    .with_key(keys.of(node).cloned()),
                generation: self.host_time().1,
                peaks: PeakMeter::new(&configurations.current),
                gaps: Gaps::default(),
                reported_losses: 0,
            })),
            Some(Whereabouts::Away(state)) => Ok(state),
            Some(Whereabouts::Served(other)) => {
                nodes.insert(node, Whereabouts::Served(other.clone()));
                Err(other)
            }
        }
    }

    /// Gives up charge of a node.
    pub(super) fn release(&self, state: Box<NodeState>) {
        lock(&self.nodes).insert(state.session.node(), Whereabouts::Away(state));
    }
}
