//! The node: a state machine fed with samples, bytes and the time, and asked for bytes to send.

use core::ops::DerefMut;

use belfry_shared::frame;
use belfry_shared::frame::{END_OF_FRAME, FrameDecoder, FrameError, MAX_FRAME_BYTES, MAX_MESSAGE_BYTES, Opened};
use belfry_shared::message::{
    self, Acknowledgement, Again, BoardState, Calibration, ClockReply, ClockRequest, Configuration, Conversation,
    Counters, Fault, Fed, FeedPart, Heard, Heartbeat, Hello, HostMessage, InConversation, LEAST_PACE_MS, NodeMessage,
    Pace, Refusal, RefusalReason, Replay, Versions, WindowName,
};
use belfry_shared::seal::{Key, Sender, next_counter};
use belfry_shared::time::{ClockModel, NodeTime};

use crate::acquisition::{Acquisition, Rings, empty_rings};
use crate::level::{LevelMeter, Levels};
use crate::outbox::{Keeping, Outbox};
use crate::plan::Plan;
use crate::schedule::{SampleMoment, rows_to_us};
use crate::spectrum::LONGEST_SEGMENT;
use crate::store::{Keeper, NoStore};
use crate::windows::{Arena, Files, WindowMaker, Workshop};

/// Time between heartbeats in µs. The first comes earlier, so that the host soon knows of an absent sensor.
const HEARTBEAT_US: i64 = 120_000_000;
/// The same of a node that sends densities alone.
const SPARING_HEARTBEAT_US: i64 = 150_000_000;
const FIRST_HEARTBEAT_US: i64 = 10_000_000;
/// Most rows in a gap that the node fills as missing; after a longer gap it starts over at the next window.
const MAX_MISSING_ROWS: i64 = 1000;

/// A node's identity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Identity {
    /// Its id, as on its label.
    pub node: u16,
    /// Drawn anew at every start, so that the host notices a restart.
    pub boot: u32,
    /// Number of channels of its sensor, 1 to 4.
    pub channels: u8,
    /// Readings of this magnitude or more, in m/s², count as clipped.
    pub full_scale_m_s2: f32,
    /// The highest raw sampling rate in mHz.
    pub highest_rate_mhz: u32,
}

/// What waits to be sent beside the outbox.
#[derive(Debug, Clone, Default)]
struct Pending {
    /// An empty frame: a conversation begins, and what the host has heard before may be the beginning of a frame.
    end_mark: bool,
    hello: bool,
    /// The host that the next greeting answers.
    answers: Option<Conversation>,
    refusal: Option<Refusal>,
    clock: Option<(ClockRequest, NodeTime)>,
    heartbeat: bool,
    /// Whether a host has asked for that heartbeat.
    is_asked_for: bool,
    fed: bool,
}

/// What a node with a key knows of sealed frames. There is one for all its ports.
#[derive(Debug, Clone)]
struct Sealing {
    /// `None` where what was written into the node is no key.
    key: Option<Key>,
    boot: u32,
    counters: Counters,
}

impl Sealing {
    /// Whether a frame is of a host with the key, and was not heard before. Greetings say their whole counter.
    fn admits(&mut self, frame: &Opened<'_>, heard: &Heard) -> bool {
        let (Some(key), Some(seal)) = (&self.key, frame.seal) else { return false };
        let counter = match heard {
            Heard::Message(InConversation { message: HostMessage::Greet(greeting), .. }) => {
                Some(greeting.counter).filter(|&counter| counter > self.counters.heard)
            }
            _ => next_counter(self.counters.heard, seal.counter),
        };
        let admitted = counter.filter(|&counter| key.admits(Sender::Host, self.boot, counter, frame));
        self.counters.heard = admitted.unwrap_or(self.counters.heard);
        admitted.is_some()
    }

    /// Writes the frame of a message, and returns its length. 0 when counters are used up.
    fn encode(&mut self, message: &[u8], frame: &mut [u8; MAX_FRAME_BYTES]) -> usize {
        let Some(key) = &self.key else { return frame::encode(message, frame).unwrap_or(0) };
        let Some(counter) = self.counters.said.checked_add(1) else { return 0 };
        self.counters.said = counter;
        key.encode(Sender::Node, self.boot, counter, message, frame).unwrap_or(0)
    }
}

/// Writes the frame of a message, sealed where there is a key, and returns its length.
fn encode(sealing: &mut Option<Sealing>, message: &[u8], frame: &mut [u8; MAX_FRAME_BYTES]) -> usize {
    match sealing {
        Some(sealing) => sealing.encode(message, frame),
        None => frame::encode(message, frame).unwrap_or(0),
    }
}

/// The frame on its way out.
struct Transmitter {
    frame: [u8; MAX_FRAME_BYTES],
    length: usize,
    sent: usize,
}

/// Memory for a node's samples, its work and its outbox: about 106 KB. It starts as all zeros, so a static of it takes no flash.
pub struct Memory {
    rings: Rings,
    segment: [f32; LONGEST_SEGMENT],
    arena: Arena,
}

impl Memory {
    /// Empty memory.
    pub const fn new() -> Self {
        Self { rings: empty_rings(), segment: [0.0; LONGEST_SEGMENT], arena: Arena::START }
    }

    /// Room for a segment and its sums, for counting instructions.
    #[doc(hidden)]
    pub fn workbench(&mut self) -> (&mut [f32], &mut [f32]) {
        let (sums, _) = self.arena.split(LONGEST_SEGMENT / 2);
        (&mut self.segment, sums)
    }
}

impl Default for Memory {
    fn default() -> Self {
        Self::new()
    }
}

/// A sensor node, with its [`Memory`] in a static or a box.
///
/// Feed it with [`sample`](Self::sample) and [`receive`](Self::receive), call [`poll`](Self::poll) whenever there is nothing else
/// to do, and send what [`transmit`](Self::transmit) returns. One with a [`Store`](crate::Store) also wants [`keep`](Self::keep).
pub struct Node<M, K = NoStore> {
    identity: Identity,
    plan: Option<Plan>,
    clock: Option<ClockModel>,
    /// The row that it expects next, while it measures a recording.
    replay: Option<u64>,
    /// When the last row was sampled; `None` while the node waits for a row on the grid.
    last_row: Option<NodeTime>,
    acquisition: Acquisition,
    windows: WindowMaker,
    outbox: Outbox,
    store: K,
    memory: M,
    level: LevelMeter,
    /// When the next heartbeat is due; `None` before the node has looked at the time.
    next_heartbeat: Option<NodeTime>,
    /// Heartbeats that are to come often.
    pace: Pace,
    calibration: Option<Calibration>,
    decoder: FrameDecoder,
    damaged_frames: u32,
    /// The host that greeted last; `None` before any has.
    conversation: Option<Conversation>,
    refused_messages: u32,
    unknown_messages: u32,
    unsealed_messages: u32,
    sealing: Option<Sealing>,
    lost_rows: u32,
    stale_rows: u32,
    fault: Option<Fault>,
    /// Why it measures nothing.
    unfit: Option<RefusalReason>,
    correction: Option<fn(u32) -> f32>,
    board: BoardState,
    pending: Pending,
    transmitter: Transmitter,
}

impl<M: DerefMut<Target = Memory>> Node<M> {
    /// A node that has just started; it greets the host and waits for a configuration and the time.
    pub const fn new(identity: Identity, memory: M) -> Self {
        Self::start(identity, memory, NoStore)
    }
}

impl<M, K> Node<M, K> {
    const fn start(identity: Identity, memory: M, store: K) -> Self {
        Self {
            identity,
            plan: None,
            clock: None,
            replay: None,
            last_row: None,
            acquisition: Acquisition::START,
            windows: WindowMaker::START,
            outbox: Outbox::new(),
            store,
            memory,
            level: LevelMeter::START,
            next_heartbeat: None,
            pace: Pace { period_ms: LEAST_PACE_MS, heartbeats: 0 },
            calibration: None,
            decoder: FrameDecoder::new(),
            damaged_frames: 0,
            conversation: None,
            refused_messages: 0,
            unknown_messages: 0,
            unsealed_messages: 0,
            sealing: None,
            lost_rows: 0,
            stale_rows: 0,
            fault: None,
            unfit: None,
            correction: None,
            board: BoardState {
                stack_bytes: 0,
                stack_free_bytes: 0,
                longest_step_us: 0,
                latest_sample_ns: 0,
                temperature_centi_c: None,
                dropped_frames: 0,
                oscillator_ppm: None,
                longest_fetch_us: 0,
            },
            pending: Pending {
                end_mark: true,
                hello: true,
                answers: None,
                refusal: None,
                clock: None,
                heartbeat: false,
                is_asked_for: false,
                fed: false,
            },
            transmitter: Transmitter { frame: [0; MAX_FRAME_BYTES], length: 0, sent: 0 },
        }
    }
}

impl<M: DerefMut<Target = Memory>, K: Keeper> Node<M, K> {
    /// A node that has just started and keeps its windows in a store. It measures what it measured before, once a host has set its clock: how long
    /// it was without supply it cannot know.
    pub fn with_store(identity: Identity, memory: M, store: K) -> Self {
        let mut node = Self::start(identity, memory, store);
        node.calibration = node.store.calibration();
        if let Some(configuration) = node.store.configuration() {
            node.configure(configuration);
        }
        node
    }

    /// Its store, which outlasts it.
    pub fn release(self) -> K {
        self.store
    }

    /// Its store, while it is in use.
    pub fn store(&mut self) -> &mut K {
        &mut self.store
    }

    /// Its identity.
    pub fn identity(&self) -> Identity {
        self.identity
    }

    /// Gives it its key, before anything else: from now on it only obeys hosts that have it. `None` where there should be a key and is none that can
    /// be read: it can be asked who it is then, and obeys nobody.
    pub fn set_key(&mut self, key: Option<Key>) {
        let counters = Counters { said: 0, heard: 0 };
        self.sealing = Some(Sealing { key, boot: self.identity.boot, counters });
    }

    /// Sets the reason for the restart, for every greeting.
    pub fn report_fault(&mut self, fault: Fault) {
        self.fault = Some(fault);
    }

    /// Sets how to divide the pass band of its sensor's filters out of its lines: what they get more with the square of their frequency in Hz, at a
    /// sampling rate in mHz. Without, its samples have passed none.
    pub fn set_correction(&mut self, per_hz2: fn(u32) -> f32) {
        self.correction = Some(per_hz2);
    }

    /// Makes it refuse every configuration, and forget the one that it has kept.
    pub fn refuse_to_measure(&mut self, reason: RefusalReason) {
        self.unfit = Some(reason);
        self.plan = None;
    }

    /// Sets the state of its board, for the next heartbeat.
    pub fn report_board(&mut self, board: BoardState) {
        self.board = board;
    }

    /// The raw sampling rate in µHz at which to call [`sample`](Self::sample); `None` while it needs no sensor.
    pub fn sampling_rate_uhz(&self) -> Option<u64> {
        let plan = self.plan.as_ref().filter(|_| self.replay.is_none())?;
        Some(plan.configuration.sampling_rate_uhz)
    }

    /// The time to go by: the recording's while it measures one.
    fn time(&self, now: NodeTime) -> NodeTime {
        self.replay.map_or(now, |next| self.row_time(next.saturating_sub(1)))
    }

    /// When a row of a recording was sampled.
    fn row_time(&self, row: u64) -> NodeTime {
        let rate = self.plan.as_ref().map_or(1, |plan| plan.configuration.sampling_rate_uhz);
        NodeTime(rows_to_us(row, rate))
    }

    /// Takes a byte from the host that arrived at `now`.
    pub fn receive(&mut self, now: NodeTime, byte: u8) {
        let heard = match self.decoder.push(byte) {
            None => return,
            Some(frame) => frame.and_then(|frame| {
                let heard = message::hear(&frame)?;
                let is_admitted = self.sealing.as_mut().is_none_or(|sealing| sealing.admits(&frame, &heard));
                Ok((heard, is_admitted))
            }),
        };
        match heard {
            Ok((Heard::Message(InConversation { conversation, message }), true)) => {
                self.hear(now, conversation, message);
            }
            Ok((Heard::Message(InConversation { conversation, message }), false)) => {
                // A question needs no seal. Other hosts with the key learn from the answer what they have to seal for.
                if !matches!(message, HostMessage::Ask(_)) {
                    self.unsealed_messages = self.unsealed_messages.saturating_add(1);
                }
                self.answer(conversation);
            }
            // Its host learns from the answer which versions the node speaks.
            Ok((Heard::OtherVersion, _)) => self.pending.hello = true,
            Err(FrameError::Unknown { .. }) => self.unknown_messages = self.unknown_messages.saturating_add(1),
            Err(_) => self.damaged_frames = self.damaged_frames.saturating_add(1),
        }
    }

    /// Takes what a host says. Greetings decide who is listened to, before anything else.
    fn hear(&mut self, now: NodeTime, conversation: Conversation, message: HostMessage) {
        match message {
            HostMessage::Greet(greeting) if greeting.versions.common(Versions::OF_NODES).is_some() => {
                self.conversation = Some(conversation);
                self.answer(conversation);
            }
            HostMessage::Greet(_) | HostMessage::Ask(_) => self.answer(conversation),
            _ if self.conversation == Some(conversation) => self.obey(now, message),
            _ => {
                // Its host learns from the answer who has greeted since, or that the node has started anew.
                self.refuse();
                self.pending.hello = true;
            }
        }
    }

    fn answer(&mut self, conversation: Conversation) {
        (self.pending.end_mark, self.pending.hello) = (true, true);
        self.pending.answers = Some(conversation);
    }

    /// Does what the host says that greeted last.
    fn obey(&mut self, now: NodeTime, message: HostMessage) {
        match message {
            HostMessage::Greet(_) | HostMessage::Ask(_) => {}
            HostMessage::Configure(configuration) => self.configure(configuration),
            HostMessage::Acknowledge(acknowledgement) => self.acknowledged(&acknowledgement),
            HostMessage::Clock(request) => self.pending.clock = Some((request, now)),
            HostMessage::SetClock(model) => {
                // A newer model may overtake an older one on the line; one from the future would keep all others out.
                let is_newest = self.clock.is_none_or(|known| model.node >= known.node);
                if is_newest && model.node <= now && self.replay.is_none() {
                    self.clock = Some(model);
                    self.windows.reschedule();
                }
            }
            HostMessage::Replay(replay) => self.start_replay(replay),
            HostMessage::Feed(part) => self.feed(&part),
            HostMessage::EndReplay => self.end_replay(),
            HostMessage::Pace(pace) => {
                self.pace = pace;
                self.next_heartbeat = Some(self.time(now).offset(self.heartbeat_period_us()));
            }
            HostMessage::Calibrate(calibration) => {
                self.store.set_calibration(&calibration);
                self.calibration = Some(calibration);
                self.pending.hello = true;
            }
        }
    }

    /// Time to the next heartbeat.
    fn heartbeat_period_us(&self) -> i64 {
        if self.pace.heartbeats > 0 {
            1000 * i64::from(self.pace.period_ms.max(LEAST_PACE_MS))
        } else if self.is_sparing() {
            SPARING_HEARTBEAT_US
        } else {
            HEARTBEAT_US
        }
    }

    /// Whether its heartbeats have no bytes for more than the level.
    fn is_sparing(&self) -> bool {
        self.plan.as_ref().is_some_and(Plan::is_sparing)
    }

    fn refuse(&mut self) {
        self.refused_messages = self.refused_messages.saturating_add(1);
    }

    fn acknowledged(&mut self, acknowledgement: &Acknowledgement) {
        let Acknowledgement { boot, below, again } = acknowledgement;
        if *boot != self.identity.boot {
            if !self.store.acknowledge(*boot, *below) {
                self.refuse();
                return;
            }
            again.iter().for_each(|wanted| self.store.want(*boot, wanted));
            self.pending.hello |= self.store.take_news();
            return;
        }
        if *below > self.windows.next_number() {
            self.refuse();
            return;
        }
        let below = self.outbox.acknowledge(*below);
        self.store.acknowledge(*boot, below);
        let (oldest, in_outbox) = (self.oldest_window(), self.oldest_in_outbox());
        for wanted in again {
            // The host waits for what is gone, and would give it up as unreadable before the next heartbeat is due. A heartbeat now would cut
            // short the time over which levels are measured.
            self.pending.hello |= wanted.first_window < oldest;
            self.outbox.again(wanted);
            // What the outbox has is not read from the store.
            if wanted.first_window < in_outbox {
                let last_window = wanted.last_window.min(in_outbox - 1);
                self.store.want(*boot, &Again { last_window, ..*wanted });
            }
        }
    }

    /// The oldest window in the outbox, or else the next.
    fn oldest_in_outbox(&self) -> u32 {
        self.outbox.oldest_window().unwrap_or(self.windows.next_number())
    }

    /// The oldest window of this life that it still has, or else the next.
    fn oldest_window(&self) -> u32 {
        let in_outbox = self.oldest_in_outbox();
        self.store.oldest_window().map_or(in_outbox, |oldest| oldest.min(in_outbox))
    }

    fn start_replay(&mut self, replay: Replay) {
        if self.plan.is_some() {
            self.replay = Some(0);
            self.clock = Some(ClockModel { node: NodeTime(0), host: replay.start, drift_ppb: 0 });
            self.next_heartbeat = None;
            self.interrupt();
            // Windows are numbered on; the host must know from where.
            self.pending.heartbeat = true;
        }
        self.pending.hello = true;
    }

    fn end_replay(&mut self) {
        if self.replay.take().is_some() {
            self.clock = None;
            self.next_heartbeat = None;
            self.interrupt();
        }
        self.pending.hello = true;
    }

    /// Takes rows of a recording, if they follow the last.
    fn feed(&mut self, part: &FeedPart) {
        let (Some(next), Some(plan)) = (self.replay, &self.plan) else { return };
        self.pending.fed = true;
        if part.first_row != next {
            return;
        }
        for row in part.readings.chunks_exact(plan.channels()) {
            let Some(next) = self.replay else { return };
            self.take(self.row_time(next), row);
            self.replay = Some(next.saturating_add(1));
        }
    }

    fn configure(&mut self, configuration: Configuration) {
        let hash = configuration.hash();
        if self.plan.as_ref().is_some_and(|plan| plan.hash == hash) {
            self.pending.hello = true;
            return;
        }
        let plan = match self.unfit {
            Some(reason) => Err(reason),
            None => Plan::new(configuration, self.identity.channels, self.identity.highest_rate_mhz),
        };
        match plan {
            Ok(plan) => {
                let (_, ring) = self.memory.arena.split(plan.cells);
                self.outbox.shrink(ring.len());
                self.store.set_configuration(&plan.configuration);
                self.plan = Some(plan);
                // A recording's rows were meant for the plan before this one.
                self.end_replay();
                self.next_heartbeat = None;
                self.interrupt();
                self.pending.hello = true;
            }
            Err(reason) => self.pending.refusal = Some(Refusal { configuration_hash: hash, reason }),
        }
    }

    /// Drops what is measured but not yet transformed, and waits for the next row on the grid.
    fn interrupt(&mut self) {
        self.last_row = None;
        self.acquisition.restart();
        self.windows.restart();
    }

    /// Takes a row of readings in m/s², one per channel, sampled at `time`; NaN for a missing reading.
    ///
    /// The node notices by the time that rows never arrived, and counts them as missing. It ignores rows before it has a
    /// configuration and the host's time, and while it measures a recording.
    pub fn sample(&mut self, time: NodeTime, readings: &[f32]) {
        if self.replay.is_none() {
            self.take(time, readings);
        }
    }

    /// Takes a row that is missing because the sensor answers and has taken no sample since the last one.
    pub fn stale(&mut self, time: NodeTime) {
        let rows = self.acquisition.rows();
        self.sample(time, &[]);
        if self.acquisition.rows() > rows {
            self.stale_rows = self.stale_rows.saturating_add(1);
            self.level.note_stale();
        }
    }

    fn take(&mut self, time: NodeTime, readings: &[f32]) {
        let (Some(plan), Some(clock)) = (&self.plan, &self.clock) else { return };
        let period_us = rows_to_us(1, plan.configuration.sampling_rate_uhz) as i64;
        let missing = match self.last_row {
            None => {
                // Start on the row nearest to a multiple of the decimated period: windows then need no remainder.
                if plan.schedule.phase_ps(clock.host_time(time)).abs() / 1_000_000 > period_us / 2 {
                    return;
                }
                0
            }
            Some(last) => {
                let elapsed_us = time.since(last);
                if elapsed_us <= period_us / 2 {
                    return;
                }
                (elapsed_us + period_us / 2) / period_us.max(1) - 1
            }
        };
        self.lost_rows = self.lost_rows.saturating_add(u32::try_from(missing).unwrap_or(u32::MAX));
        if missing > MAX_MISSING_ROWS {
            self.interrupt();
            return;
        }
        for row in 0..missing {
            self.take_row(time.offset((row - missing) * period_us), &[]);
        }
        self.take_row(time, readings);
        self.last_row = Some(time);
    }

    fn take_row(&mut self, time: NodeTime, readings: &[f32]) {
        let (Some(plan), Some(clock)) = (&self.plan, &self.clock) else { return };
        let channels = plan.channels();
        let full_scale = self.identity.full_scale_m_s2;
        let made = self.acquisition.push(&mut self.memory.rings, &plan.stages, readings, channels, full_scale);
        for channel in 0..channels {
            let reading = readings.get(channel).copied().filter(|reading| reading.is_finite());
            self.level.add(channel, reading, full_scale);
        }
        if made {
            let index = self.acquisition.samples() - 1;
            let rows_ago =
                (self.acquisition.rows() - 1).saturating_sub(index * u64::from(plan.configuration.decimation));
            let ago_us = rows_to_us(rows_ago, plan.configuration.sampling_rate_uhz);
            let moment = SampleMoment { index, time: time.offset(-(ago_us as i64)) };
            self.windows.on_sample(plan, clock, moment);
        }
    }

    /// Does one step of the work that waits (at most one channel of one segment). Returns whether there was any; if so, call it
    /// again.
    pub fn poll(&mut self, now: NodeTime) -> bool {
        let now = self.time(now);
        match self.next_heartbeat {
            Some(due) if now.since(due) < 0 => {}
            Some(_) => {
                self.pending.heartbeat = true;
                self.pending.is_asked_for = self.pace.heartbeats > 0;
                self.pace.heartbeats = self.pace.heartbeats.saturating_sub(1);
                self.next_heartbeat = Some(now.offset(self.heartbeat_period_us()));
            }
            None => self.next_heartbeat = Some(now.offset(FIRST_HEARTBEAT_US)),
        }
        let Some(plan) = &self.plan else { return false };
        let Memory { rings, segment, arena } = &mut *self.memory;
        let (cells, ring) = arena.split(plan.cells);
        let name = WindowName { node: self.identity.node, boot: self.identity.boot, number: 0 };
        // A recording can be measured again.
        let keeps = self.store.keeps() && self.replay.is_none();
        let keeping = if keeps { Keeping::Waiting } else { Keeping::Never };
        let mut files = Files { outbox: &mut self.outbox, ring, name, keeping };
        // A recording has passed no sensor.
        let rate_mhz = u32::try_from(plan.configuration.sampling_rate_uhz / 1000).unwrap_or(u32::MAX);
        let correction = self.correction.filter(|_| self.replay.is_none());
        let correction_per_hz2 = correction.map_or(0.0, |of_rate| of_rate(rate_mhz));
        let workshop = Workshop { acquisition: &mut self.acquisition, rings, segment, cells, correction_per_hz2 };
        self.windows.work(plan, workshop, &mut files)
    }

    /// Does one step of what the store has to do: no more than [`STEP_BYTES`](crate::STEP_BYTES) go over the chip's bus. Returns whether there was
    /// any; if so, call it again.
    pub fn keep(&mut self, now: NodeTime) -> bool {
        if let Some(clock) = self.clock.filter(|_| self.replay.is_none()) {
            self.store.set_time(clock.host_time(now));
        }
        if let Some((window, part)) = self.store.take_written() {
            self.outbox.kept(window, part);
        }
        let (_, ring) = self.memory.arena.split(self.plan.as_ref().map_or(0, |plan| plan.cells));
        let has_put =
            self.outbox.to_keep(ring).is_some_and(|(window, part, message)| self.store.put(window, part, message));
        let has_worked = self.store.step();
        self.pending.hello |= self.store.take_news();
        has_put || has_worked
    }

    /// Whether [`transmit`](Self::transmit) has bytes to send.
    pub fn has_bytes(&self) -> bool {
        let Pending { end_mark, hello, answers: _, refusal, clock, heartbeat, is_asked_for: _, fed } = &self.pending;
        self.transmitter.sent < self.transmitter.length
            || *end_mark
            || *hello
            || *heartbeat
            || refusal.is_some()
            || clock.is_some()
            || self.outbox.is_pending()
            || self.store.is_loaded()
            || (*fed && !self.windows.is_busy())
    }

    /// Fills `out` with bytes to send at `now` and returns how many, up to the end of one frame.
    pub fn transmit(&mut self, now: NodeTime, out: &mut [u8]) -> usize {
        if self.transmitter.sent == self.transmitter.length {
            self.transmitter.sent = 0;
            self.transmitter.length = self.next_frame(now);
        }
        let waiting = self.transmitter.frame.get(self.transmitter.sent..self.transmitter.length).unwrap_or(&[]);
        let count = waiting.len().min(out.len());
        if let (Some(out), Some(waiting)) = (out.get_mut(..count), waiting.get(..count)) {
            out.copy_from_slice(waiting);
        }
        self.transmitter.sent += count;
        count
    }

    /// Makes the most urgent frame that waits and returns its length, 0 if there is none.
    fn next_frame(&mut self, now: NodeTime) -> usize {
        let (oldest_window, is_sparing) = (self.oldest_window(), self.is_sparing());
        let frame = &mut self.transmitter.frame;
        if core::mem::take(&mut self.pending.end_mark) {
            frame[0] = END_OF_FRAME;
            return 1;
        }
        let next_window = self.windows.next_number();
        let message = if let Some((request, node_received)) = self.pending.clock.take() {
            let believed = self.clock.filter(|_| self.replay.is_none()).map(|clock| clock.host_time(node_received));
            NodeMessage::Clock(ClockReply {
                host_sent: request.host_sent,
                node_received,
                node_sent: now,
                believed_delay_us: believed.map(|believed| believed.0.saturating_sub(request.host_sent.0)),
            })
        } else if core::mem::take(&mut self.pending.hello) {
            NodeMessage::Hello(Hello {
                versions: Versions::OF_NODES,
                node: self.identity.node,
                boot: self.identity.boot,
                answers: self.pending.answers.take(),
                conversation: self.conversation,
                channels: self.identity.channels,
                configuration_hash: self.plan.as_ref().map(|plan| plan.hash),
                clock_set: self.clock.is_some(),
                oldest_window,
                next_window,
                replaying: self.replay.is_some(),
                fault: self.fault.clone(),
                // As it will be in a moment.
                counters: self
                    .sealing
                    .as_ref()
                    .map(|sealing| Counters { said: sealing.counters.said.saturating_add(1), ..sealing.counters }),
                kept: self.store.kept(),
                calibration: self.calibration.clone(),
            })
        } else if let Some(refusal) = self.pending.refusal.take() {
            NodeMessage::Refused(refusal)
        } else if core::mem::take(&mut self.pending.heartbeat) {
            // Densities leave no bytes for more than the level, unless it was asked for.
            let is_sparing = is_sparing && !self.pending.is_asked_for;
            let Levels { level, variance, mean, sensors } =
                self.level.take(self.plan.as_ref().map_or(0, Plan::channels));
            NodeMessage::Heartbeat(Heartbeat {
                node: self.identity.node,
                boot: self.identity.boot,
                next_window,
                oldest_window,
                lost_windows: self.outbox.lost_windows().saturating_add(self.store.lost_windows()),
                damaged_frames: self.damaged_frames,
                refused_messages: self.refused_messages,
                level,
                sensors,
                lost_rows: self.lost_rows,
                board: self.board,
                unknown_messages: self.unknown_messages,
                unsealed_messages: self.unsealed_messages,
                stale_rows: self.stale_rows,
                variance: if is_sparing { Default::default() } else { variance },
                mean: if is_sparing { Default::default() } else { Heartbeat::means_of(&mean) },
            })
        } else {
            let (_, ring) = self.memory.arena.split(self.plan.as_ref().map_or(0, |plan| plan.cells));
            match (self.outbox.next(ring), self.replay) {
                (Some(part), _) => return encode(&mut self.sealing, part, frame),
                (None, _) if self.store.is_loaded() => {
                    return self.store.take_loaded().map_or(0, |part| encode(&mut self.sealing, part, frame));
                }
                // Only now, with everything that follows from the last rows computed and sent, it takes more.
                (None, Some(next_row)) if self.pending.fed && !self.windows.is_busy() => {
                    self.pending.fed = false;
                    NodeMessage::Fed(Fed { next_row })
                }
                _ => {
                    self.pending.fed = self.pending.fed && self.replay.is_some();
                    return 0;
                }
            }
        };
        let mut buffer = [0; MAX_MESSAGE_BYTES];
        match postcard::to_slice(&message, &mut buffer) {
            Ok(message) => encode(&mut self.sealing, message, frame),
            // What a node says fits by its types.
            Err(_) => 0,
        }
    }
}

#[cfg(test)]
mod tests;
