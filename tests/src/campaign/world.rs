//! All but the host: its clocks, the nodes with their cables, and what is to fail when.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::time::Duration;

use belfry_firmware::Technology;
use belfry_host::collect::{Clock, Collection, Ports};
use belfry_host::keys::Keys;
use belfry_host::link::Transport;
use belfry_host::link::memory::{Faults, Line};
use belfry_shared::seal::Key;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::node::{Equipment, Life, SimulatedNode};
use super::report::Report;
use super::schedule::{Fault, Schedule};
use super::study::Drawn;
use crate::cable::connect;

/// Baud rate of all lines.
pub(super) const BAUD: u32 = 115_200;
/// Unix time in s at the beginning, by a clock that is right.
const BEGIN_S: u64 = 1_900_000_000;
/// A clock that is further off is set towards what is right.
const MOST_OFF_US: i64 = 3 * 86_400_000_000;
/// Shares of frames that a line damages.
const DAMAGED: [f64; 4] = [0.0, 0.01, 0.05, 0.2];
/// A node's chip takes up to so many bytes more before its supply fails: a few windows.
const MOST_BYTES_BEFORE_CUT: u64 = 5000;
/// Readings that come again and again.
const READINGS: usize = 65_537;

/// The host's clocks.
#[derive(Default)]
pub(super) struct WorldClock {
    steady_ns: AtomicU64,
    ahead_us: AtomicI64,
    /// The least of it so far.
    least_ahead_us: AtomicI64,
}

impl Clock for WorldClock {
    fn steady(&self) -> Duration {
        Duration::from_nanos(self.steady_ns.load(Ordering::Relaxed))
    }

    fn unix(&self) -> Duration {
        let right = Duration::from_secs(BEGIN_S) + self.steady();
        let ahead_us = self.ahead_us.load(Ordering::Relaxed);
        let ahead = Duration::from_micros(ahead_us.unsigned_abs());
        if ahead_us < 0 { right.saturating_sub(ahead) } else { right + ahead }
    }
}

/// What ails the host, until when.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct HostTroubles {
    /// It is to end, and then away until then; whether it is killed.
    pub(super) away: Option<(Duration, bool)>,
    pub(super) disk_full_until: Duration,
    pub(super) busy_until: Duration,
}

struct Parts {
    nodes: Vec<SimulatedNode>,
    schedule: Schedule,
    random: ChaCha8Rng,
    /// What every line damages; drawn where nothing is said.
    damaged: Option<f64>,
    report: Report,
    troubles: HostTroubles,
    is_faultless: bool,
}

/// The nodes, their lines, and the time.
pub(super) struct World {
    pub(super) folder: PathBuf,
    pub(super) clock: WorldClock,
    noise: Vec<f32>,
    parts: RefCell<Parts>,
}

impl World {
    pub(super) fn new(study: &Drawn, folder: &Path, schedule: Schedule, damaged: Option<f64>, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let node = |(index, &channels): (usize, &usize)| {
            let (chip_bytes, is_nor) = study.chips[index];
            let equipment = Equipment {
                channels,
                ppm: random.random_range(-50.0..50.0),
                rate_hz: study.rate_hz,
                key: study.keys[index].map(Key::new),
                technology: if is_nor { Technology::Nor } else { Technology::Fram },
                chip_bytes,
            };
            SimulatedNode::new(index as u16 + 1, equipment, random.random())
        };
        let nodes = study.channels.iter().enumerate().map(node).collect();
        let noise = (0..READINGS).map(|_| random.random_range(-0.01..0.01)).collect();
        let (report, troubles) = (Report::new(0), HostTroubles::default());
        let parts = Parts { nodes, schedule, random, damaged, report, troubles, is_faultless: false };
        Self { folder: folder.to_owned(), clock: WorldClock::default(), noise, parts: RefCell::new(parts) }
    }

    pub(super) fn now(&self) -> Duration {
        self.clock.steady()
    }

    /// The earliest Unix time in µs that the computer's clock has shown, or would have shown at the beginning.
    pub(super) fn earliest_us(&self) -> i64 {
        BEGIN_S as i64 * 1_000_000 + self.clock.least_ahead_us.load(Ordering::Relaxed)
    }

    /// Ends all faults, for good.
    pub(super) fn end_faults(&self) {
        let parts = &mut *self.parts.borrow_mut();
        parts.is_faultless = true;
        parts.troubles = HostTroubles::default();
        for node in &mut parts.nodes {
            node.heal();
            // Every line that comes now is sound.
            node.disconnect(&mut parts.report);
        }
    }

    /// Ends or begins the sampling of all nodes.
    pub(super) fn set_sampling(&self, samples: bool) {
        self.parts.borrow_mut().nodes.iter_mut().for_each(|node| node.samples = samples);
    }

    /// What every node has come to, and what has befallen the lines.
    pub(super) fn take_lives(&self, report: &mut Report) -> Vec<Life> {
        let now = self.now();
        let parts = &mut *self.parts.borrow_mut();
        parts.nodes.iter_mut().for_each(|node| node.disconnect(&mut parts.report));
        report.add(std::mem::replace(&mut parts.report, Report::new(0)));
        parts.nodes.iter_mut().flat_map(|node| node.take_lives(now)).collect()
    }

    /// Whether a node holds windows, as far as it has said.
    pub(super) fn holds_windows(&self) -> bool {
        self.parts.borrow_mut().nodes.iter_mut().any(SimulatedNode::holds_windows)
    }

    pub(super) fn troubles(&self) -> HostTroubles {
        self.parts.borrow().troubles
    }

    /// Whether the host is to end now, and then be away until when; and whether it is killed.
    pub(super) fn take_away(&self) -> Option<(Duration, bool)> {
        self.parts.borrow_mut().troubles.away.take()
    }

    /// The nodes' keys.
    pub(super) fn keys(&self) -> Keys {
        self.parts.borrow().nodes.iter().filter_map(SimulatedNode::key).collect()
    }

    /// When something fails next.
    pub(super) fn next_fault(&self) -> Option<Duration> {
        let parts = self.parts.borrow();
        parts.schedule.next().filter(|_| !parts.is_faultless)
    }

    /// Tells the nodes' listeners what is measured.
    pub(super) fn will_measure(&self, collection: &Collection) {
        for node in &mut self.parts.borrow_mut().nodes {
            let number = node.port().trim_start_matches("node").parse().ok();
            if let Some(configurations) = number.and_then(|number| collection.nodes.get(&number)) {
                node.will_measure(&configurations.current);
            }
        }
    }

    /// Has time go on to the next moment at which something happens, `end` at the latest; the ports where something has.
    pub(super) fn step(&self, end: Duration) -> Vec<String> {
        let parts = &mut *self.parts.borrow_mut();
        let now = self.now();
        let next = parts.nodes.iter().filter_map(|node| node.next_event(now)).min().map_or(end, |next| next.min(end));
        self.clock.steady_ns.store(next.as_nanos() as u64, Ordering::Relaxed);
        let mut ports = Vec::new();
        for node in &mut parts.nodes {
            if next == end || node.next_event(now).is_some_and(|due| due <= next) {
                node.step(next, &self.noise, &mut parts.report);
                ports.push(node.port());
            }
        }
        ports
    }

    /// Has fail what is to fail by now.
    pub(super) fn fail(&self) {
        let parts = &mut *self.parts.borrow_mut();
        let now = self.now();
        while !parts.is_faultless
            && let Some(fault) = parts.schedule.due(now)
        {
            parts.report.fault(fault.name());
            let nodes = &mut parts.nodes;
            match fault {
                Fault::NodeOff { node, lasting } => {
                    nodes[node].switch_off(now, now + lasting, parts.random.random_range(1..MOST_BYTES_BEFORE_CUT));
                }
                Fault::Unplugged { node, lasting } => nodes[node].unplug(now + lasting, &mut parts.report),
                Fault::Sensor { node, channel, what, lasting } => nodes[node].disturb(now + lasting, channel, what),
                Fault::HostKilled { lasting } => parts.troubles.away = Some((now + lasting, true)),
                Fault::HostEnded { lasting } => parts.troubles.away = Some((now + lasting, false)),
                Fault::ClockSet { by_us } => {
                    let ahead_us = self.clock.ahead_us.load(Ordering::Relaxed);
                    let by_us = if ahead_us.abs() > MOST_OFF_US { -ahead_us.signum() * by_us.abs() } else { by_us };
                    self.clock.ahead_us.store(ahead_us + by_us, Ordering::Relaxed);
                    self.clock.least_ahead_us.fetch_min(ahead_us + by_us, Ordering::Relaxed);
                }
                Fault::DiskFull { lasting } => parts.troubles.disk_full_until = now + lasting,
                Fault::ArchiveBusy { lasting } => parts.troubles.busy_until = now + lasting,
            }
        }
    }
}

impl Ports for World {
    fn list(&self) -> Vec<String> {
        self.parts.borrow().nodes.iter().map(SimulatedNode::port).collect()
    }

    fn open(&self, name: &str) -> Result<Box<dyn Transport>, String> {
        let parts = &mut *self.parts.borrow_mut();
        let now = self.now();
        let node = parts.nodes.iter_mut().find(|node| node.port() == name && node.is_plugged(now));
        let node = node.ok_or("there is no such port")?;
        let drawn = DAMAGED[parts.random.random_range(0..DAMAGED.len())];
        let share = if parts.is_faultless { 0.0 } else { parts.damaged.unwrap_or(drawn) };
        let faults = Faults {
            drop: share / 4.0,
            flip: share / 4.0,
            lose_byte: share / 4.0,
            insert: share / 4.0,
            duplicate: share / 4.0,
            reorder: share / 4.0,
            split: share / 4.0,
            stall: share / 4.0,
            jitter_us: if parts.is_faultless { 0 } else { 2000 },
        };
        let line = Line::new(BAUD, faults, parts.random.random());
        line.advance(now.as_nanos() as i64);
        let (connection, plug) = connect(line);
        node.connect(connection, &mut parts.report);
        Ok(Box::new(plug))
    }
}
