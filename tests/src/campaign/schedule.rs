//! What fails when, drawn beforehand.

use std::time::Duration;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::NODES;

/// What a sensor does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SensorFault {
    /// Readings are missing.
    Missing,
    /// Readings are beyond its range.
    Clipped,
    /// It always reads the same.
    Stuck,
    /// A reading now and then is far off.
    Spikes,
    /// No row is taken at all.
    Silent,
}

impl SensorFault {
    const ALL: [Self; 5] = [Self::Missing, Self::Clipped, Self::Stuck, Self::Spikes, Self::Silent];
}

/// Something that fails.
#[derive(Debug, Clone, Copy)]
pub(super) enum Fault {
    /// A node loses its supply for a while.
    NodeOff { node: usize, lasting: Duration },
    /// A node's cable is pulled for a while.
    Unplugged { node: usize, lasting: Duration },
    /// A sensor misbehaves for a while.
    Sensor { node: usize, channel: usize, what: SensorFault, lasting: Duration },
    /// The host is killed in the middle of what it does, and is away for a while.
    HostKilled { lasting: Duration },
    /// The host ends as it is asked to, and is away for a while.
    HostEnded { lasting: Duration },
    /// The computer's clock is set, by so much.
    ClockSet { by_us: i64 },
    /// The disk is full for a while.
    DiskFull { lasting: Duration },
    /// Another program writes into the archive for a while.
    ArchiveBusy { lasting: Duration },
}

impl Fault {
    /// What it is called in a report.
    pub(super) fn name(&self) -> &'static str {
        match self {
            Self::NodeOff { .. } => "node restarted",
            Self::Unplugged { .. } => "cable pulled",
            Self::Sensor { what, .. } => match what {
                SensorFault::Missing => "readings missing",
                SensorFault::Clipped => "sensor clipped",
                SensorFault::Stuck => "sensor stuck",
                SensorFault::Spikes => "spikes",
                SensorFault::Silent => "sensor silent",
            },
            Self::HostKilled { .. } => "host killed",
            Self::HostEnded { .. } => "host ended",
            Self::ClockSet { by_us } if *by_us < 0 => "computer's clock set back",
            Self::ClockSet { .. } => "computer's clock set ahead",
            Self::DiskFull { .. } => "disk full",
            Self::ArchiveBusy { .. } => "archive busy",
        }
    }
}

/// Faults in the order in which they come, each with its moment since the beginning; the next one last.
pub(super) struct Schedule(Vec<(Duration, Fault)>);

/// How often in a day: of each node, and of the host.
const NODE_OFF: f64 = 4.0;
const UNPLUGGED: f64 = 3.0;
const SENSOR: f64 = 10.0;
const HOST_KILLED: f64 = 5.0;
const HOST_ENDED: f64 = 3.0;
const CLOCK_SET: f64 = 3.0;
const DISK_FULL: f64 = 2.0;
const ARCHIVE_BUSY: f64 = 4.0;

/// A length of time between two, short ones as often as long ones.
fn lasting(random: &mut ChaCha8Rng, least_s: f64, most_s: f64) -> Duration {
    Duration::from_secs_f64((random.random_range(least_s.ln()..most_s.ln())).exp())
}

impl Schedule {
    pub(super) fn draw(random: &mut ChaCha8Rng, length: Duration, intensity: f64) -> Self {
        let mut faults = Vec::new();
        let days = length.as_secs_f64() / 86_400.0;
        let mut often = |random: &mut ChaCha8Rng, a_day: f64, make: &mut dyn FnMut(&mut ChaCha8Rng) -> Fault| {
            let expected = a_day * days * intensity;
            let count = expected.floor() as usize + usize::from(random.random::<f64>() < expected.fract());
            for _ in 0..count {
                let at = length.mul_f64(random.random());
                faults.push((at, make(random)));
            }
        };
        for node in 0..NODES {
            often(random, NODE_OFF, &mut |random| Fault::NodeOff { node, lasting: lasting(random, 0.5, 1800.0) });
            often(random, UNPLUGGED, &mut |random| Fault::Unplugged { node, lasting: lasting(random, 0.1, 3600.0) });
            often(random, SENSOR, &mut |random| Fault::Sensor {
                node,
                channel: random.random_range(0..4),
                what: SensorFault::ALL[random.random_range(0..SensorFault::ALL.len())],
                lasting: lasting(random, 0.2, 1800.0),
            });
        }
        often(random, HOST_KILLED, &mut |random| Fault::HostKilled { lasting: lasting(random, 0.5, 7200.0) });
        often(random, HOST_ENDED, &mut |random| Fault::HostEnded { lasting: lasting(random, 0.5, 7200.0) });
        often(random, CLOCK_SET, &mut |random| {
            let by_us = lasting(random, 0.6, 36.0 * 3600.0).as_micros() as i64;
            Fault::ClockSet { by_us: if random.random() { by_us } else { -by_us } }
        });
        often(random, DISK_FULL, &mut |random| Fault::DiskFull { lasting: lasting(random, 5.0, 3600.0) });
        often(random, ARCHIVE_BUSY, &mut |random| Fault::ArchiveBusy { lasting: lasting(random, 1.0, 900.0) });
        faults.sort_by_key(|(at, _)| std::cmp::Reverse(*at));
        Self(faults)
    }

    /// When the next fault comes.
    pub(super) fn next(&self) -> Option<Duration> {
        self.0.last().map(|(at, _)| *at)
    }

    /// The next fault, if it is due.
    pub(super) fn due(&mut self, now: Duration) -> Option<Fault> {
        let is_due = self.0.last().is_some_and(|(at, _)| *at <= now);
        if is_due { self.0.pop().map(|(_, fault)| fault) } else { None }
    }
}
