//! A simulated node: the firmware, its crystal, its sensors, its end of a line, and a record of every life that it has had.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::time::Duration;

use belfry_firmware::{Identity, Memory, Node};
use belfry_host::link::Transport;
use belfry_host::window::{Assembler, ChannelData, Configurations, NodeWindow, Outcome};
use belfry_shared::frame::{FrameDecoder, MAX_FRAME_BYTES};
use belfry_shared::message::{
    self, Configuration, Conversation, Greeting, HostMessage, InConversation, NodeMessage, Summary,
};
use belfry_shared::quantise::{encode_decoded_lines, encoded_bytes};
use belfry_shared::time::NodeTime;

use super::report::Report;
use super::schedule::SensorFault;
use crate::cable::Connection;

const FULL_SCALE_M_S2: f32 = 20.0;
/// Bytes are looked at so often where there are any.
const STEP: Duration = Duration::from_millis(1);
/// Longer than the time between two heartbeats.
const HEARTBEAT_US: i64 = 200_000_000;

/// What a node has come to in one of its lives, as it says itself.
pub(super) struct Life {
    pub(super) node: u16,
    pub(super) boot: u32,
    /// Windows made; they are numbered from 0 on.
    pub(super) made: u32,
    /// Windows still held in the end.
    pub(super) held: u32,
    /// Windows that it had to drop for want of room.
    pub(super) dropped: u32,
    /// What was sent, by number: where the window begins on the grid, and a hash of all that was in it.
    pub(super) sent: BTreeMap<u32, (u64, u64)>,
}

/// Hears what the node says before anything befalls it.
struct Tap {
    decoder: FrameDecoder,
    assembler: Assembler,
    /// What it is to measure, once it is known.
    configurations: Option<Configurations>,
    sent: BTreeMap<u32, (u64, u64)>,
}

impl Tap {
    fn hear(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            let Some(Ok(frame)) = self.decoder.push(byte) else { continue };
            let encoded = frame.message.to_vec();
            let Ok(part) = message::decode::<NodeMessage<'_>>(&encoded) else { continue };
            let Some(configurations) = &self.configurations else { continue };
            if let Outcome::Whole(window) = self.assembler.take(configurations, &part, &encoded) {
                self.assembler.stored(window.name.number);
                self.sent.insert(window.name.number, (window.grid_index, fingerprint(&window)));
            }
        }
    }
}

/// A hash of all that is in a window, made of what the archive keeps of it.
fn fingerprint(window: &NodeWindow) -> u64 {
    let mut hasher = DefaultHasher::new();
    (window.middle_offset_us, window.drift_ppb, window.configuration_hash).hash(&mut hasher);
    for channel in &window.channels {
        match channel {
            ChannelData::Lines(lines) => {
                let mut code = vec![0; encoded_bytes(lines.len(), BITS)];
                // What has been decoded can be encoded again.
                let _ = encode_decoded_lines(lines, BITS, &mut code);
                ("sound", code).hash(&mut hasher);
            }
            ChannelData::Unsound(state) => {
                (format!("{state:?}").to_lowercase().as_str(), Vec::<u8>::new()).hash(&mut hasher)
            }
            // Densities are not asked for.
            ChannelData::Psd { .. } => "psd".hash(&mut hasher),
        }
    }
    hasher.finish()
}

/// The same of a window as the archive has it.
pub(super) fn fingerprint_of_rows(
    offset_us: i32,
    drift_ppb: i32,
    configuration: u32,
    rows: &[(String, Vec<u8>)],
) -> u64 {
    let mut hasher = DefaultHasher::new();
    (offset_us, drift_ppb, configuration).hash(&mut hasher);
    rows.iter().for_each(|(state, code)| (state.as_str(), code.clone()).hash(&mut hasher));
    hasher.finish()
}

/// Bits a component of the lines.
const BITS: u8 = 10;

/// A node.
pub(super) struct SimulatedNode {
    number: u16,
    channels: usize,
    ppm: f64,
    rate_hz: f64,
    boot: u32,
    /// When it was switched on last.
    on_since: Duration,
    node: Option<Node<Box<Memory>>>,
    tap: Option<Tap>,
    /// It is without supply until then.
    off_until: Duration,
    /// Its cable is pulled until then.
    unplugged_until: Duration,
    rows: u64,
    pub(super) samples: bool,
    sensor_faults: Vec<(Duration, usize, SensorFault)>,
    connection: Option<Connection>,
    lives: Vec<Life>,
    /// What the node is to measure, once it is known.
    configuration: Option<Configuration>,
}

impl SimulatedNode {
    pub(super) fn new(number: u16, channels: usize, ppm: f64, rate_hz: f64, boot: u32) -> Self {
        Self {
            number,
            channels,
            ppm,
            rate_hz,
            boot,
            on_since: Duration::ZERO,
            node: None,
            tap: None,
            off_until: Duration::ZERO,
            unplugged_until: Duration::ZERO,
            rows: 0,
            samples: true,
            sensor_faults: Vec::new(),
            connection: None,
            lives: Vec::new(),
            configuration: None,
        }
    }

    /// Its port's name.
    pub(super) fn port(&self) -> String {
        format!("node{}", self.number)
    }

    /// Says what the node will be asked to measure, so that what it sends can be understood.
    pub(super) fn will_measure(&mut self, configuration: &Configuration) {
        debug_assert!(matches!(configuration.summary, Summary::Lines { bits: BITS }));
        self.configuration = Some(configuration.clone());
        if let Some(tap) = &mut self.tap {
            tap.configurations = Some(Configurations::only(configuration.clone()));
        }
    }

    fn time(&self, now: Duration) -> NodeTime {
        NodeTime((now.saturating_sub(self.on_since).as_secs_f64() * (1.0 + self.ppm * 1e-6) * 1e6) as u64)
    }

    /// Takes its supply away until then.
    pub(super) fn switch_off(&mut self, now: Duration, until: Duration) {
        self.end_life(now);
        self.off_until = self.off_until.max(until);
    }

    fn switch_on(&mut self, now: Duration) {
        self.boot = self.boot.wrapping_mul(0x9E37_79B1).wrapping_add(1);
        let identity = Identity {
            node: self.number,
            boot: self.boot,
            channels: self.channels as u8,
            full_scale_m_s2: FULL_SCALE_M_S2,
            highest_rate_mhz: 4_000_000,
        };
        self.node = Some(Node::new(identity, Box::new(Memory::new())));
        self.on_since = now;
        self.rows = 0;
        self.tap = Some(Tap {
            decoder: FrameDecoder::new(),
            assembler: Assembler::new(self.number, self.boot),
            configurations: self.configuration.clone().map(Configurations::only),
            sent: BTreeMap::new(),
        });
    }

    /// Ends its life, and takes down what it says of it in the end.
    fn end_life(&mut self, now: Duration) {
        let time = self.time(now);
        let (Some(mut node), Some(tap)) = (self.node.take(), self.tap.take()) else { return };
        let mut decoder = FrameDecoder::new();
        // Ahead of the next heartbeat.
        let later = NodeTime(time.0.saturating_add_signed(HEARTBEAT_US));
        while node.poll(later) {}
        let mut frame = [0; MAX_FRAME_BYTES];
        let greeting =
            InConversation { conversation: Conversation([1; 4]), message: HostMessage::Greet(Greeting::OF_HOSTS) };
        let length = message::encode(&greeting, &mut frame).unwrap_or(0);
        [0].iter().chain(&frame[..length]).for_each(|&byte| node.receive(later, byte));
        let mut life = Life { node: self.number, boot: self.boot, made: 0, held: 0, dropped: 0, sent: tap.sent };
        let mut buffer = [0; MAX_FRAME_BYTES];
        while let count @ 1.. = node.transmit(later, &mut buffer) {
            for &byte in &buffer[..count] {
                match decoder.push(byte).map(|frame| message::decode::<NodeMessage<'_>>(frame?.message)) {
                    Some(Ok(NodeMessage::Hello(hello))) => {
                        (life.made, life.held) = (hello.next_window, hello.next_window - hello.oldest_window);
                    }
                    Some(Ok(NodeMessage::Heartbeat(heartbeat))) => life.dropped = heartbeat.lost_windows,
                    _ => {}
                }
            }
        }
        self.lives.push(life);
    }

    /// Ends its last life.
    pub(super) fn take_lives(&mut self, now: Duration) -> Vec<Life> {
        self.end_life(now);
        std::mem::take(&mut self.lives)
    }

    pub(super) fn unplug(&mut self, until: Duration, report: &mut Report) {
        self.unplugged_until = self.unplugged_until.max(until);
        self.disconnect(report);
    }

    pub(super) fn is_plugged(&self, now: Duration) -> bool {
        now >= self.unplugged_until
    }

    pub(super) fn disturb(&mut self, until: Duration, channel: usize, what: SensorFault) {
        self.sensor_faults.push((until, channel % self.channels, what));
    }

    /// Ends all that ails it.
    pub(super) fn heal(&mut self) {
        (self.off_until, self.unplugged_until) = (Duration::ZERO, Duration::ZERO);
        self.sensor_faults.clear();
    }

    /// Has a line from now on.
    pub(super) fn connect(&mut self, connection: Connection, report: &mut Report) {
        self.disconnect(report);
        self.connection = Some(connection);
    }

    pub(super) fn disconnect(&mut self, report: &mut Report) {
        if let Some(connection) = self.connection.take() {
            let (to_host, to_node) = connection.line.statistics();
            report.befell(&to_host.befell);
            report.befell(&to_node.befell);
        }
    }

    /// When something comes or goes next on its line, after `now`.
    pub(super) fn next_event(&self, now: Duration) -> Option<Duration> {
        let connection = self.connection.as_ref()?;
        let at = |ns: i64| Duration::from_nanos(u64::try_from(ns).unwrap_or(0));
        let arrival = connection.line.next_arrival().map(at);
        let is_waiting = self.node.as_ref().is_some_and(Node::has_bytes);
        let free = is_waiting.then(|| at(connection.line.node_free_at()));
        arrival.into_iter().chain(free).min().map(|next| next.max(now + STEP))
    }

    /// Does what is due up to `now`.
    pub(super) fn step(&mut self, now: Duration, noise: &[f32], report: &mut Report) {
        if self.connection.as_ref().is_some_and(|connection| !connection.is_held()) {
            self.disconnect(report);
        }
        if self.node.is_none() {
            if now < self.off_until {
                return;
            }
            self.switch_on(now);
        }
        self.sample(now, noise);
        let time = self.time(now);
        let Some(node) = &mut self.node else { return };
        let Some(Connection { line, .. }) = &self.connection else { return };
        let now_ns = now.as_nanos() as i64;
        line.advance(now_ns);
        let mut end = line.node_end();
        let mut buffer = [0; MAX_FRAME_BYTES];
        // A line in memory does not fail.
        while let Ok(count @ 1..) = end.read(&mut buffer) {
            buffer[..count].iter().for_each(|&byte| node.receive(time, byte));
        }
        while node.poll(time) {}
        if node.has_bytes() && line.node_free_at() <= now_ns {
            let count = node.transmit(time, &mut buffer);
            if let Some(tap) = &mut self.tap {
                tap.hear(&buffer[..count]);
            }
            let _ = end.write(&buffer[..count]);
        }
    }

    fn sample(&mut self, now: Duration, noise: &[f32]) {
        let time = self.time(now);
        let Some(node) = &mut self.node else { return };
        self.sensor_faults.retain(|(until, ..)| now < *until);
        let due = (time.0 as f64 * 1e-6 * self.rate_hz) as u64;
        let is_silent = self.sensor_faults.iter().any(|(.., what)| *what == SensorFault::Silent);
        if !self.samples || is_silent {
            self.rows = due;
            return;
        }
        while self.rows < due {
            let at = NodeTime((self.rows as f64 / self.rate_hz * 1e6) as u64);
            let mut readings = [0.0; 4];
            for (channel, reading) in readings.iter_mut().enumerate() {
                let place = self.rows as usize * 4 + channel + usize::from(self.number) * 1009;
                *reading = noise[place % noise.len()];
            }
            for &(_, channel, what) in &self.sensor_faults {
                let reading = &mut readings[channel];
                *reading = match what {
                    SensorFault::Missing => f32::NAN,
                    SensorFault::Clipped => FULL_SCALE_M_S2,
                    SensorFault::Stuck => 0.5,
                    SensorFault::Spikes if self.rows.is_multiple_of(37) => 9.0,
                    SensorFault::Spikes | SensorFault::Silent => *reading,
                };
            }
            node.sample(at, &readings[..self.channels]);
            while node.poll(at) {}
            self.rows += 1;
        }
    }
}
