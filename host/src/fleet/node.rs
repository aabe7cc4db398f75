//! One simulated node: the firmware, its crystal, its line, and the host's session with it, in simulated time.

use belfry_firmware::{Identity, Memory, Node};
use belfry_shared::message::{Configuration, MAX_CHANNELS};
use belfry_shared::seal::Key;
use belfry_shared::time::{HostTime, NodeTime};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::pace::{Crystal, Resampler};
use super::types::{FleetError, FleetOptions, NodeReport, Pace};
use crate::link::memory::{HostEnd, Line, Nanoseconds, NodeEnd};
use crate::link::{Session, SessionError, Transport};
use crate::window::{Configurations, NodeWindow};

/// Simulated time before the recording in which node and host get to know each other.
const PREPARATION_NS: Nanoseconds = 120_000_000_000;
/// Simulated time after the recording: two heartbeats, so that the last window is missed if it was lost.
const AFTERMATH_NS: Nanoseconds = 250_000_000_000;
/// Longest wait for delivery after that.
const PATIENCE_NS: Nanoseconds = 3_600_000_000_000;
/// From warmth to warmth.
const DAY_NS: f64 = 86_400e9;
/// The node gets time to work at least this often.
const TICK_NS: Nanoseconds = 1_000_000_000;

/// What comes from a worker.
pub(super) enum Feed {
    /// A window of one node.
    Window(Box<NodeWindow>),
    /// A node has delivered everything.
    Done(Box<NodeReport>),
}

/// What makes a simulated node; can be sent to the thread that runs it.
pub(super) struct NodeSettings {
    /// Its number.
    pub(super) number: u16,
    /// The channels of a row that it samples.
    pub(super) channels: Vec<usize>,
    /// What it is to measure.
    pub(super) configuration: Configuration,
    /// The row that is at the epoch.
    pub(super) lead_rows: u64,
    /// Line and seed.
    pub(super) options: FleetOptions,
}

/// A node in simulated time.
pub(super) struct SimulatedNode {
    number: u16,
    channels: Vec<usize>,
    node: Node<Box<Memory>>,
    /// The node's clock.
    crystal: Crystal,
    /// Rows at the moments of the node's own crystal, where it samples by that.
    resampler: Option<Resampler>,
    line: Line,
    node_end: NodeEnd,
    host_end: HostEnd,
    session: Session,
    windows: Vec<NodeWindow>,
    now: Nanoseconds,
    row: u64,
    lead_rows: u64,
    sampling_rate_uhz: u64,
}

impl SimulatedNode {
    /// A node that has just been switched on.
    pub(super) fn new(settings: NodeSettings) -> Self {
        let NodeSettings { number, channels, configuration, lead_rows, options } = settings;
        let seed = options.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ u64::from(number);
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let identity = Identity {
            node: number,
            boot: random.random(),
            channels: configuration.channels,
            // A recording does not say where its sensors clip.
            full_scale_m_s2: f32::INFINITY,
            highest_rate_mhz: u32::MAX,
        };
        let line = Line::new(options.baud, options.faults, random.random());
        let sampling_rate_uhz = configuration.sampling_rate_uhz;
        let first_row = row_time(0, lead_rows, sampling_rate_uhz);
        let start = first_row - PREPARATION_NS;
        let boot = start - random.random_range(1_000_000_000..1_000_000_000_000);
        let (crystal, resampler) = match options.pace {
            Pace::Recording => (Crystal::exact(boot), None),
            Pace::Crystal { ppm, swing_ppm } => {
                let crystal = Crystal {
                    boot_ns: boot,
                    drift: 1e-6 * if number % 2 == 0 { ppm } else { -ppm },
                    swing: 1e-6 * swing_ppm,
                    swing_period_ns: DAY_NS,
                    phase: f64::from(number),
                };
                let period_ns = 1e15 / sampling_rate_uhz.max(1) as f64;
                (crystal, Some(Resampler::new(first_row, period_ns, crystal)))
            }
        };
        let mut node = Node::new(identity, Box::new(Memory::new()));
        // Drawn last, so that all else is as without.
        let key = options.has_keys.then(|| Key::new(random.random()));
        if key.is_some() {
            node.set_key(key.clone());
        }
        Self {
            number,
            channels,
            node,
            crystal,
            resampler,
            node_end: line.node_end(),
            host_end: line.host_end(),
            line,
            session: Session::new(number, Configurations::only(configuration), options.baud).with_key(key),
            windows: Vec::new(),
            now: start,
            row: 0,
            lead_rows,
            sampling_rate_uhz,
        }
    }

    /// Brings the node to measuring, up to the first row.
    pub(super) fn prepare(&mut self) -> Result<(), FleetError> {
        self.run_until(row_time(0, self.lead_rows, self.sampling_rate_uhz) - 1)?;
        if self.session.is_measuring() { Ok(()) } else { Err(FleetError::NotReady { node: self.number }) }
    }

    /// Samples the next row.
    pub(super) fn feed(&mut self, row: &[f64]) -> Result<(), FleetError> {
        let time = row_time(self.row, self.lead_rows, self.sampling_rate_uhz);
        self.row += 1;
        self.run_until(time)?;
        let mut readings = [f64::NAN; MAX_CHANNELS];
        for (reading, &channel) in readings.iter_mut().zip(&self.channels) {
            *reading = row.get(channel).copied().unwrap_or(f64::NAN);
        }
        match self.resampler.take() {
            None => self.sample(time, &readings),
            Some(mut resampler) => {
                resampler.push(readings, |moment, readings| self.sample(moment, readings));
                self.resampler = Some(resampler);
            }
        }
        let now = self.node_time(time);
        while self.node.poll(now) {}
        Ok(())
    }

    fn sample(&mut self, time: Nanoseconds, readings: &[f64; MAX_CHANNELS]) {
        let readings = readings.map(|reading| reading as f32);
        self.node.sample(self.node_time(time), &readings[..self.channels.len()]);
    }

    /// Lets everything be delivered after the last row.
    pub(super) fn finish(&mut self) -> Result<NodeReport, FleetError> {
        let end = self.now;
        self.run_until(end + AFTERMATH_NS)?;
        while !self.session.is_complete() && self.now < end + PATIENCE_NS {
            self.run_until(self.now + TICK_NS)?;
        }
        let (to_host, to_node) = self.line.statistics();
        let session = self.session.statistics();
        Ok(NodeReport { node: self.number, channels: self.channels.len(), session, to_host, to_node })
    }

    /// The windows that have come since the last call.
    pub(super) fn take_windows(&mut self) -> Vec<NodeWindow> {
        std::mem::take(&mut self.windows)
    }

    fn node_time(&self, now: Nanoseconds) -> NodeTime {
        // Rounded: a count is never negative.
        NodeTime((1e-3 * self.crystal.count_ns(now) + 0.5) as u64)
    }

    /// Lets everything happen that happens up to `time`.
    fn run_until(&mut self, time: Nanoseconds) -> Result<(), FleetError> {
        loop {
            let next = self.next_event().max(self.now + 1);
            if next > time {
                break;
            }
            self.step(next)?;
        }
        // Between two rows nothing happens as a rule, and there are millions of them.
        self.now = time;
        Ok(())
    }

    fn next_event(&self) -> Nanoseconds {
        let mut next = (self.now + TICK_NS).min(self.session.next_due().0.saturating_mul(1000));
        if let Some(arrival) = self.line.next_arrival() {
            next = next.min(arrival);
        }
        if self.node.has_bytes() {
            next = next.min(self.line.node_free_at());
        }
        next
    }

    fn step(&mut self, now: Nanoseconds) -> Result<(), FleetError> {
        self.now = now;
        self.line.advance(now);
        let node_time = self.node_time(now);
        let mut buffer = [0; 512];
        let failed = |source| SessionError::Transport { node: self.number, source };
        loop {
            let count = self.node_end.read(&mut buffer).map_err(failed)?;
            if count == 0 {
                break;
            }
            for &byte in &buffer[..count] {
                self.node.receive(node_time, byte);
            }
        }
        while self.node.poll(node_time) {}
        if self.node.has_bytes() && self.line.node_free_at() <= now {
            let mut frame = [0; belfry_shared::frame::MAX_FRAME_BYTES];
            let count = self.node.transmit(node_time, &mut frame);
            self.node_end.write(&frame[..count]).map_err(failed)?;
        }
        // Rounded up: a byte that has arrived has arrived.
        let host_time = HostTime(now.div_euclid(1000) + 1);
        self.session.service(&|| host_time, &mut self.host_end, &mut self.windows)?;
        Ok(())
    }
}

/// When a row is sampled, in ns since the epoch.
fn row_time(row: u64, lead_rows: u64, sampling_rate_uhz: u64) -> Nanoseconds {
    let rows = i128::from(row) - i128::from(lead_rows);
    (rows * 1_000_000_000_000_000 / i128::from(sampling_rate_uhz.max(1))) as Nanoseconds
}
