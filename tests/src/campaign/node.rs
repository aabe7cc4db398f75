//! A simulated node: the firmware, its crystal, its sensors, its end of a line, and a record of every life that it has had.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::time::Duration;

use belfry_firmware::{Identity, Keeper, Memory, Node, SimulatedChip, Store, Technology};
use belfry_host::link::Transport;
use belfry_host::window::{Assembler, ChannelData, Configurations, NodeWindow, Outcome};
use belfry_shared::frame::{FrameDecoder, MAX_FRAME_BYTES};
use belfry_shared::message::{
    self, Configuration, Conversation, HostMessage, InConversation, Kept, NodeMessage, Summary, Versions,
};
use belfry_shared::quantise::{encode_decoded_lines, encoded_bytes};
use belfry_shared::seal::Key;
use belfry_shared::time::NodeTime;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::attacker::Attacker;
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

/// The windows of one boot that a node has sent whole, in that boot or a later one.
struct Sent {
    assembler: Assembler,
    windows: BTreeMap<u32, (u64, u64)>,
}

/// Hears what the node says before anything befalls it.
struct Tap {
    node: u16,
    decoder: FrameDecoder,
    /// What it is to measure, once it is known.
    configurations: Option<Configurations>,
    boots: BTreeMap<u32, Sent>,
    /// Whether it has said last that it holds windows.
    holds: bool,
}

impl Tap {
    fn hear(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            let Some(Ok(frame)) = self.decoder.push(byte) else { continue };
            let encoded = frame.message.to_vec();
            let Ok(part) = message::decode::<NodeMessage<'_>>(&encoded) else { continue };
            if let NodeMessage::Heartbeat(heartbeat) = &part {
                self.holds = heartbeat.oldest_window < heartbeat.next_window;
            }
            let Some(configurations) = &self.configurations else { continue };
            let Some((name, _)) = part.part() else { continue };
            let sent = self
                .boots
                .entry(name.boot)
                .or_insert_with(|| Sent { assembler: Assembler::new(self.node, name.boot), windows: BTreeMap::new() });
            if let Outcome::Whole(window) = sent.assembler.take(configurations, &part, &encoded) {
                sent.assembler.stored(window.name.number);
                sent.windows.insert(window.name.number, (window.grid_index, fingerprint(&window)));
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

/// A chip of this size has room for all windows of the longest outage.
const AMPLE_BYTES: usize = 512 << 10;
/// A node with a chip loses its supply while it writes, where it writes within this time.
const DOOM: Duration = Duration::from_secs(30);

/// The firmware, whose store has no chip where the node has none.
type Firmware = Node<Box<Memory>, Store<SimulatedChip<Vec<u8>>>>;

/// What a node has beside the sensor.
#[derive(Debug, Clone)]
pub(super) struct Equipment {
    pub(super) channels: usize,
    pub(super) ppm: f64,
    pub(super) rate_hz: f64,
    pub(super) key: Option<Key>,
    pub(super) technology: Technology,
    /// Of its memory chip; 0 where it has none.
    pub(super) chip_bytes: usize,
}

/// A node.
pub(super) struct SimulatedNode {
    number: u16,
    equipment: Equipment,
    /// What its chip holds while it is without supply.
    memory: Vec<u8>,
    boot: u32,
    /// When it was switched on last.
    on_since: Duration,
    node: Option<Firmware>,
    tap: Tap,
    /// When its supply fails at the latest, and until when it is away then: it fails sooner if it writes its chip.
    doom: Option<[Duration; 2]>,
    /// It is without supply until then.
    off_until: Duration,
    /// Its cable is pulled until then.
    unplugged_until: Duration,
    rows: u64,
    pub(super) samples: bool,
    sensor_faults: Vec<(Duration, usize, SensorFault)>,
    connection: Option<Connection>,
    /// Who writes on its line.
    attacker: Option<Attacker>,
    lives: Vec<Life>,
}

impl SimulatedNode {
    pub(super) fn new(number: u16, equipment: Equipment, boot: u32) -> Self {
        // Without a key anybody is believed.
        let attacker = equipment.key.is_some().then(|| Attacker::new(ChaCha8Rng::seed_from_u64(u64::from(boot))));
        Self {
            number,
            memory: vec![u8::MAX; equipment.chip_bytes],
            equipment,
            boot,
            on_since: Duration::ZERO,
            node: None,
            tap: Tap {
                node: number,
                decoder: FrameDecoder::new(),
                configurations: None,
                boots: BTreeMap::new(),
                holds: false,
            },
            doom: None,
            off_until: Duration::ZERO,
            unplugged_until: Duration::ZERO,
            rows: 0,
            samples: true,
            sensor_faults: Vec::new(),
            connection: None,
            attacker,
            lives: Vec::new(),
        }
    }

    /// Its key.
    pub(super) fn key(&self) -> Option<(u16, Key)> {
        Some((self.number, self.equipment.key.clone()?))
    }

    /// Its port's name.
    pub(super) fn port(&self) -> String {
        format!("node{}", self.number)
    }

    /// Says what the node will be asked to measure, so that what it sends can be understood.
    pub(super) fn will_measure(&mut self, configuration: &Configuration) {
        debug_assert!(matches!(configuration.summary, Summary::Lines { bits: BITS }));
        self.tap.configurations = Some(Configurations::only(configuration.clone()));
    }

    fn time(&self, now: Duration) -> NodeTime {
        NodeTime((now.saturating_sub(self.on_since).as_secs_f64() * (1.0 + self.equipment.ppm * 1e-6) * 1e6) as u64)
    }

    /// Takes its supply away until then, or for as long a little later: in the middle of a write of so many bytes, if it has a chip.
    pub(super) fn switch_off(&mut self, now: Duration, until: Duration, bytes: u64) {
        match &mut self.node {
            Some(node) if self.equipment.chip_bytes > 0 => {
                node.store().chip().fail_after(bytes, bytes as u8);
                self.doom = Some([now + DOOM, until + DOOM]);
            }
            _ => {
                self.end_life(now);
                self.off_until = self.off_until.max(until);
            }
        }
    }

    fn switch_on(&mut self, now: Duration) {
        let random = self.boot.wrapping_mul(0x9E37_79B1).wrapping_add(1);
        let chip = SimulatedChip::new(std::mem::take(&mut self.memory), self.equipment.technology);
        let store = Store::open(chip, random);
        if let Some(kept) = store.kept().filter(Kept::has_windows) {
            self.has_kept(&kept);
        }
        self.boot = store.boot();
        let identity = Identity {
            node: self.number,
            boot: self.boot,
            channels: self.equipment.channels as u8,
            full_scale_m_s2: FULL_SCALE_M_S2,
            highest_rate_mhz: 4_000_000,
        };
        let mut node = Node::with_store(identity, Box::new(Memory::new()), store);
        if let Some(key) = &self.equipment.key {
            node.set_key(Some(key.clone()));
        }
        self.node = Some(node);
        self.tap.decoder = FrameDecoder::new();
        self.on_since = now;
        self.rows = 0;
    }

    /// Of a life whose windows are on an ample chip, no more is lost with the supply than what had not been written.
    fn has_kept(&mut self, kept: &Kept) {
        if self.equipment.chip_bytes >= AMPLE_BYTES
            && let Some(life) = self.lives.iter_mut().find(|life| life.boot == kept.boot)
        {
            life.held = life.held.min(life.made.saturating_sub(kept.next_window));
        }
    }

    /// Ends its life, and takes down what it says of it in the end.
    fn end_life(&mut self, now: Duration) {
        let time = self.time(now);
        let Some(mut node) = self.node.take() else { return };
        self.doom = None;
        let mut decoder = FrameDecoder::new();
        // Ahead of the next heartbeat.
        let later = NodeTime(time.0.saturating_add_signed(HEARTBEAT_US));
        while node.poll(later) {}
        let mut frame = [0; MAX_FRAME_BYTES];
        // Every node answers a question, also without its key.
        let question = HostMessage::Ask(Versions::OF_HOSTS);
        let question = InConversation { conversation: Conversation([1; 4]), message: question };
        let length = message::encode(&question, &mut frame).unwrap_or(0);
        [0].iter().chain(&frame[..length]).for_each(|&byte| node.receive(later, byte));
        let sent = BTreeMap::new();
        let mut life = Life { node: self.number, boot: self.boot, made: 0, held: 0, dropped: 0, sent };
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
        self.memory = node.release().release().release();
    }

    /// Whether it has said last that it holds windows of its present life, or its chip has some of an earlier one.
    pub(super) fn holds_windows(&mut self) -> bool {
        let kept = self.node.as_mut().and_then(|node| node.store().kept());
        self.tap.holds || kept.is_some_and(|kept| kept.has_windows())
    }

    /// Ends its last life.
    pub(super) fn take_lives(&mut self, now: Duration) -> Vec<Life> {
        self.end_life(now);
        let mut lives = std::mem::take(&mut self.lives);
        for life in &mut lives {
            life.sent = self.tap.boots.remove(&life.boot).map_or_else(BTreeMap::new, |sent| sent.windows);
        }
        lives
    }

    pub(super) fn unplug(&mut self, until: Duration, report: &mut Report) {
        self.unplugged_until = self.unplugged_until.max(until);
        self.disconnect(report);
    }

    pub(super) fn is_plugged(&self, now: Duration) -> bool {
        now >= self.unplugged_until
    }

    pub(super) fn disturb(&mut self, until: Duration, channel: usize, what: SensorFault) {
        self.sensor_faults.push((until, channel % self.equipment.channels, what));
    }

    /// Ends all that ails it.
    pub(super) fn heal(&mut self) {
        (self.off_until, self.unplugged_until) = (Duration::ZERO, Duration::ZERO);
        self.attacker = None;
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
        self.lose_supply(now);
        let time = self.time(now);
        let Some(node) = &mut self.node else { return };
        let Some(Connection { line, .. }) = &self.connection else { return };
        let now_ns = now.as_nanos() as i64;
        line.advance(now_ns);
        let mut end = line.node_end();
        let mut buffer = [0; MAX_FRAME_BYTES];
        // A line in memory does not fail.
        while let Ok(count @ 1..) = end.read(&mut buffer) {
            let attack =
                self.attacker.as_mut().map_or_else(Vec::new, |attacker| attacker.tell_node(&buffer[..count], report));
            buffer[..count].iter().chain(&attack).for_each(|&byte| node.receive(time, byte));
        }
        while node.poll(time) | node.keep(time) {}
        if node.has_bytes() && line.node_free_at() <= now_ns {
            let count = node.transmit(time, &mut buffer);
            self.tap.hear(&buffer[..count]);
            let _ = end.write(&buffer[..count]);
            if let Some(attacker) = &mut self.attacker {
                let _ = end.write(&attacker.tell_host(self.number, self.boot, &buffer[..count], report));
            }
        }
    }

    /// Ends its life where its chip has failed, or it has lived for long enough.
    fn lose_supply(&mut self, now: Duration) {
        let has_failed = self.node.as_mut().is_some_and(|node| node.store().chip().has_failed());
        if let Some([latest, until]) = self.doom.filter(|[latest, _]| has_failed || now >= *latest) {
            let lasting = until.saturating_sub(latest);
            self.end_life(now);
            self.off_until = now + lasting;
        }
    }

    fn sample(&mut self, now: Duration, noise: &[f32]) {
        let time = self.time(now);
        let Some(node) = &mut self.node else { return };
        self.sensor_faults.retain(|(until, ..)| now < *until);
        let due = (time.0 as f64 * 1e-6 * self.equipment.rate_hz) as u64;
        let is_silent = self.sensor_faults.iter().any(|(.., what)| *what == SensorFault::Silent);
        if !self.samples || is_silent {
            self.rows = due;
            return;
        }
        while self.rows < due {
            let at = NodeTime((self.rows as f64 / self.equipment.rate_hz * 1e6) as u64);
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
            node.sample(at, &readings[..self.equipment.channels]);
            while node.poll(at) | node.keep(at) {}
            self.rows += 1;
        }
    }
}
