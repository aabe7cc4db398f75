//! The host's end of the conversation with one node.
//!
//! Bytes and the time flow in, bytes to send and whole windows flow out. The session greets, checks the version, configures,
//! sets the clock, then collects: it acknowledges what the sink has stored and asks again for what is overdue.

use std::collections::VecDeque;
use std::io;

use belfry_shared::frame::{END_OF_FRAME, FrameDecoder, FrameError, MAX_FRAME_BYTES, PROTOCOL_VERSION};
use belfry_shared::message::{
    self, Acknowledgement, Again, ClockRequest, Heartbeat, Hello, HostMessage, NodeMessage, RefusalReason, SCHEMA_HASH,
    Summary,
};
use belfry_shared::time::HostTime;
use thiserror::Error;

use super::assembly::{Assembler, Configurations, Outcome};
use super::clock::ClockEstimator;
use super::{KeptWindows, Transport, WindowSink};

/// Time between tries of a greeting, configuration or clock setting, in µs.
const RETRY_US: i64 = 500_000;
/// Clock exchanges before the clock is set first, and the time between them.
const FIRST_EXCHANGES: usize = 6;
const FIRST_EXCHANGE_PERIOD_US: i64 = 100_000;
/// Time between clock exchanges while measuring: this share of the time over which the clock is known, so that it is soon known
/// well, up to the longest, for they are bytes on the wire.
const EXCHANGE_SHARE: i64 = 4;
const LEAST_EXCHANGE_PERIOD_US: i64 = 20_000_000;
const EXCHANGE_PERIOD_US: i64 = 200_000_000;
/// Time over which the clock is measured before an earlier host's estimate is replaced.
const SETTLED_SPAN_US: i64 = 300_000_000;
/// A node whose time is this far off has it from a host whose clock was wrong; no line that works holds a request up for so long.
const WRONG_TIME_US: u64 = 1_000_000;
/// How often, and how soon, an exchange that was slow is made again: on a line that jitters the quickest of many says most, and
/// only there they cost bytes.
const REPEATS: u32 = 5;
const REPEAT_PERIOD_US: i64 = 1_000_000;
/// How often a node that measures for another study is asked for its oldest window before it counts as having none.
const INSPECTIONS: u32 = 3;
/// The line counts as silent when nothing came for this long.
const SILENCE_US: i64 = 300_000;
/// A part asked again is asked once more after this time.
const ASK_PERIOD_US: i64 = 2_000_000;
/// Earlier lives of a node that are remembered.
const LIVES_KEPT: usize = 8;

/// Why a conversation cannot go on.
#[derive(Debug, Error)]
pub enum SessionError {
    /// The node speaks another version of the protocol.
    #[error(
        "node {node} speaks protocol version {found}, this host speaks version {PROTOCOL_VERSION}: flash the node with the firmware of this release"
    )]
    Version {
        /// The node the session is for.
        node: u16,
        /// The version it speaks.
        found: u8,
    },
    /// The node's messages are laid out differently although the version is the same.
    #[error(
        "node {node} runs firmware of another build (messages {found:#018x}, here {SCHEMA_HASH:#018x}): flash it with the firmware of this release"
    )]
    Schema {
        /// The node the session is for.
        node: u16,
        /// Its schema hash.
        found: u64,
    },
    /// Another node is on the line.
    #[error("node {found} answers where node {node} was expected: check the cables or the node numbers in study.toml")]
    WrongNode {
        /// The node the session is for.
        node: u16,
        /// The node that answered.
        found: u16,
    },
    /// The node cannot run the configuration.
    #[error("node {node} cannot measure what the study asks: {reason}")]
    Refused {
        /// The node the session is for.
        node: u16,
        /// Why.
        reason: RefusalReason,
    },
    /// The node holds windows that were asked for elsewhere.
    #[error(
        "node {node} still holds windows that another study asked for: collect them there, or have them dropped with --drop-foreign"
    )]
    ForeignWindows {
        /// The node the session is for.
        node: u16,
    },
    /// The node counts its windows anew under the name of an earlier life.
    #[error(
        "node {node} has started anew without drawing a new boot id: its windows cannot be told from those of before; switch it off and on again"
    )]
    RepeatedLife {
        /// The node the session is for.
        node: u16,
    },
    /// The transport failed.
    #[error("the line to node {node} failed")]
    Transport {
        /// The node the session is for.
        node: u16,
        /// The cause.
        source: io::Error,
    },
    /// A window could not be stored.
    #[error("a window of node {node} could not be stored")]
    Store {
        /// The node the session is for.
        node: u16,
        /// The cause.
        source: io::Error,
    },
}

/// What a session has seen.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SessionStatistics {
    /// Bytes that came from the node.
    pub bytes_received: u64,
    /// Bytes sent to the node.
    pub bytes_sent: u64,
    /// Frames that came undamaged.
    pub frames: u64,
    /// Frames that came damaged.
    pub damaged_frames: u64,
    /// Parts that were known already.
    pub duplicate_parts: u64,
    /// Parts that contradicted the configuration or other parts.
    pub contradictions: u64,
    /// Ranges of parts asked again.
    pub asked_again: u64,
    /// Windows stored.
    pub windows: u64,
    /// Windows that the node dropped before they were delivered, or that could not be read.
    pub lost_windows: u64,
    /// Windows that the node still had of another study, given up.
    pub foreign_windows: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    Greeting,
    /// It measures for another study: its oldest window is asked for, before it is told anything.
    Inspecting {
        asked: u32,
    },
    Configuring,
    Timing,
    SettingClock,
    Measuring,
}

/// Whether the node that says `hello` can be understood; `node` is named where it cannot.
pub(super) fn check_build(node: u16, hello: &Hello) -> Result<(), SessionError> {
    if hello.protocol_version != PROTOCOL_VERSION {
        return Err(SessionError::Version { node, found: hello.protocol_version });
    }
    if hello.schema_hash != SCHEMA_HASH {
        return Err(SessionError::Schema { node, found: hello.schema_hash });
    }
    Ok(())
}

/// The host's end of the conversation with one node.
#[derive(Debug)]
pub struct Session {
    node: u16,
    configurations: Configurations,
    byte_us: f64,
    stage: Stage,
    decoder: FrameDecoder,
    frame_bytes: usize,
    outgoing: VecDeque<u8>,
    assembler: Option<Assembler>,
    clock: ClockEstimator,
    request_bytes: usize,
    /// How often the last exchange has been made again.
    repeats: u32,
    next_try: HostTime,
    next_exchange: HostTime,
    last_received: HostTime,
    acknowledge: bool,
    drops_foreign: bool,
    /// The life of the node that has been asked for windows of another study, and had none.
    inspected: Option<u32>,
    /// Whether an earlier host's time is on the node: a better one takes a while.
    knows_time: bool,
    /// Whether the host's own clock was set, and the node's time is wrong with it.
    must_set_time: bool,
    hello: Option<Hello>,
    heartbeat: Option<Heartbeat>,
    /// The node's earlier lives, oldest first.
    earlier: Vec<Assembler>,
    forgotten_losses: u64,
    statistics: SessionStatistics,
}

impl Session {
    /// A session for a node that shall run the current one of `configurations`, over a line of `baud`.
    pub fn new(node: u16, configurations: Configurations, baud: u32) -> Self {
        Self {
            node,
            configurations,
            byte_us: 10e6 / f64::from(baud.max(1)),
            stage: Stage::Greeting,
            decoder: FrameDecoder::new(),
            frame_bytes: 0,
            outgoing: VecDeque::new(),
            assembler: None,
            clock: ClockEstimator::default(),
            request_bytes: 0,
            repeats: 0,
            next_try: HostTime(i64::MIN),
            next_exchange: HostTime(i64::MIN),
            last_received: HostTime(i64::MIN),
            acknowledge: false,
            drops_foreign: false,
            inspected: None,
            knows_time: false,
            must_set_time: false,
            hello: None,
            heartbeat: None,
            earlier: Vec::new(),
            forgotten_losses: 0,
            statistics: SessionStatistics::default(),
        }
    }

    /// Gives windows up that another study asked for, instead of ending with an error.
    pub fn dropping_foreign(self, drops_foreign: bool) -> Self {
        Self { drops_foreign, ..self }
    }

    /// The node it is for.
    pub fn node(&self) -> u16 {
        self.node
    }

    /// Whether the node has its configuration and the time.
    pub fn is_measuring(&self) -> bool {
        self.stage == Stage::Measuring
    }

    /// Whether every window known to exist is stored or given up, and the node knows.
    pub fn is_complete(&self) -> bool {
        !self.acknowledge && self.assembler.as_ref().is_none_or(Assembler::is_complete)
    }

    /// Begins anew with the greeting, on a line that was away: the node may have started anew meanwhile.
    pub fn reconnect(&mut self) {
        self.stage = Stage::Greeting;
        self.next_try = HostTime(i64::MIN);
        self.last_received = HostTime(i64::MIN);
    }

    /// Begins anew with the greeting and the time; for a host whose own clock was set. What is known of windows stays.
    pub fn restart(&mut self) {
        self.reconnect();
        self.clock.clear();
        self.knows_time = false;
        self.must_set_time = true;
        self.next_exchange = HostTime(i64::MIN);
    }

    /// The node's last greeting.
    pub fn hello(&self) -> Option<&Hello> {
        self.hello.as_ref()
    }

    /// The node's last sign of life.
    pub fn heartbeat(&self) -> Option<&Heartbeat> {
        self.heartbeat.as_ref()
    }

    /// What is known of the node's clock.
    pub fn clock(&self) -> &ClockEstimator {
        &self.clock
    }

    /// What it has seen.
    pub fn statistics(&self) -> SessionStatistics {
        let earlier: u64 = self.earlier.iter().map(|assembler| assembler.lost() + assembler.missing()).sum();
        let current = self.assembler.as_ref().map_or(0, Assembler::lost);
        let lost_windows = self.forgotten_losses + earlier + current;
        SessionStatistics { lost_windows, ..self.statistics }
    }

    /// Reads everything that has arrived, says what is due, and sends it. `clock` is read when bytes have come: what arrives
    /// while others are stored must not seem to have come before.
    pub fn service(
        &mut self,
        clock: &dyn Fn() -> HostTime,
        transport: &mut dyn Transport,
        sink: &mut dyn WindowSink,
    ) -> Result<(), SessionError> {
        let node = self.node;
        let fail = |source| SessionError::Transport { node, source };
        let mut buffer = [0; 512];
        loop {
            let count = transport.read(&mut buffer).map_err(fail)?;
            if count == 0 {
                break;
            }
            self.receive(clock(), &buffer[..count], sink)?;
        }
        self.poll(clock());
        if !self.outgoing.is_empty() {
            let bytes: Vec<u8> = self.outgoing.drain(..).collect();
            self.statistics.bytes_sent += bytes.len() as u64;
            transport.write(&bytes).map_err(fail)?;
        }
        Ok(())
    }

    /// When [`service`](Self::service) has something to do even if no byte arrives.
    pub fn next_due(&self) -> HostTime {
        let due = match self.stage {
            Stage::Greeting | Stage::Inspecting { .. } | Stage::Configuring | Stage::SettingClock => self.next_try,
            Stage::Timing => self.next_exchange,
            Stage::Measuring if !self.is_complete() => {
                HostTime(self.next_exchange.0.min(self.next_try.0.max(self.last_received.0.saturating_add(SILENCE_US))))
            }
            Stage::Measuring => self.next_exchange,
        };
        // Only a session that measures acknowledges; in the other stages that has to wait.
        if self.acknowledge && self.is_measuring() {
            HostTime(due.0.min(self.last_received.0.saturating_add(1)))
        } else {
            due
        }
    }

    fn receive(&mut self, now: HostTime, bytes: &[u8], sink: &mut dyn WindowSink) -> Result<(), SessionError> {
        self.last_received = now;
        self.statistics.bytes_received += bytes.len() as u64;
        for &byte in bytes {
            self.frame_bytes += 1;
            let ended = byte == END_OF_FRAME;
            let frame = match self.decoder.push(byte) {
                Some(Ok(frame)) => Some(frame.to_vec()),
                Some(Err(FrameError::Version { found })) => {
                    return Err(SessionError::Version { node: self.node, found });
                }
                Some(Err(_)) => {
                    self.statistics.damaged_frames += 1;
                    None
                }
                None => None,
            };
            if let Some(encoded) = frame {
                match message::decode::<NodeMessage<'_>>(&encoded) {
                    Ok(message) => {
                        self.statistics.frames += 1;
                        self.handle(now, &message, &encoded, sink)?;
                    }
                    Err(_) => self.statistics.damaged_frames += 1,
                }
            }
            if ended {
                self.frame_bytes = 0;
            }
        }
        Ok(())
    }

    fn handle(
        &mut self,
        now: HostTime,
        message: &NodeMessage<'_>,
        encoded: &[u8],
        sink: &mut dyn WindowSink,
    ) -> Result<(), SessionError> {
        match message {
            NodeMessage::Hello(hello) => self.greeted(hello, sink)?,
            NodeMessage::Refused(refusal) if refusal.configuration_hash == self.configurations.current.hash() => {
                return Err(SessionError::Refused { node: self.node, reason: refusal.reason });
            }
            NodeMessage::Refused(_) => {}
            NodeMessage::Clock(reply) => {
                let on_line = |bytes: usize| (bytes as f64 * self.byte_us).round() as i64;
                let (request_us, reply_us) = (on_line(self.request_bytes), on_line(self.frame_bytes));
                self.clock.add(reply, now, request_us, reply_us);
                if reply.believed_delay_us.is_some_and(|delay_us| delay_us.unsigned_abs() > WRONG_TIME_US) {
                    self.knows_time = false;
                }
                if self.stage == Stage::Measuring {
                    // A first estimate must not take the place of one that an earlier host made over hours.
                    let is_better = !self.knows_time || self.clock.span_us() >= SETTLED_SPAN_US;
                    if let Some(model) = self.clock.model().filter(|_| is_better) {
                        self.say(&HostMessage::SetClock(model));
                    }
                    if self.needs_phase() && self.clock.is_last_slow() && self.repeats < REPEATS {
                        self.repeats += 1;
                        self.next_exchange = HostTime(now.0.saturating_add(REPEAT_PERIOD_US));
                    } else {
                        self.repeats = 0;
                    }
                }
            }
            NodeMessage::Heartbeat(heartbeat) => {
                self.heartbeat = Some(heartbeat.clone());
                if let Some(assembler) = self.assembler.as_mut().filter(|a| a.boot() == heartbeat.boot) {
                    assembler.heartbeat(heartbeat.oldest_window, heartbeat.next_window);
                    // Also repeats an acknowledgement that was lost.
                    self.acknowledge |= heartbeat.oldest_window < assembler.below();
                } else {
                    self.stage = Stage::Greeting;
                }
            }
            part => {
                if let NodeMessage::Head(head) = part
                    && head.drift_ppb == 0
                {
                    // The earlier host was not there for long enough to know the drift.
                    self.knows_time = false;
                }
                let Some(assembler) = &mut self.assembler else { return Ok(()) };
                match assembler.take(&self.configurations, part, encoded) {
                    Outcome::Taken => {}
                    Outcome::Foreign if self.drops_foreign => {
                        if let NodeMessage::Head(head) = part {
                            assembler.stored(head.name.number);
                        }
                        self.statistics.foreign_windows += 1;
                        self.acknowledge = true;
                    }
                    Outcome::Foreign => return Err(SessionError::ForeignWindows { node: self.node }),
                    Outcome::Duplicate => {
                        self.statistics.duplicate_parts += 1;
                        self.acknowledge = true;
                    }
                    Outcome::Repeated => return Err(SessionError::RepeatedLife { node: self.node }),
                    Outcome::Contradiction => self.statistics.contradictions += 1,
                    Outcome::Whole(window) => {
                        let number = window.name.number;
                        if let Err(source) = sink.store(*window) {
                            assembler.unstored(number);
                            return Err(SessionError::Store { node: self.node, source });
                        }
                        assembler.stored(number);
                        self.statistics.windows += 1;
                        self.acknowledge = true;
                    }
                }
            }
        }
        Ok(())
    }

    fn greeted(&mut self, hello: &Hello, sink: &mut dyn WindowSink) -> Result<(), SessionError> {
        let node = self.node;
        check_build(node, hello)?;
        if hello.node != node {
            return Err(SessionError::WrongNode { node, found: hello.node });
        }
        if self.assembler.as_ref().is_none_or(|assembler| assembler.boot() != hello.boot) {
            // A new life of the node: what the old one still had is lost with it. What is known of the old one stays, for a
            // frame of it may come late, and its windows must not be taken for new ones.
            let known = self.earlier.iter().position(|assembler| assembler.boot() == hello.boot);
            let next = match known {
                Some(index) => self.earlier.remove(index),
                None => self.met(hello, sink)?,
            };
            self.earlier.extend(self.assembler.replace(next));
            if self.earlier.len() > LIVES_KEPT {
                let oldest = self.earlier.remove(0);
                self.forgotten_losses += oldest.lost() + oldest.missing();
            }
            self.clock.clear();
            self.knows_time = hello.clock_set;
            self.heartbeat = None;
        }
        if let Some(assembler) = &mut self.assembler {
            assembler.heartbeat(hello.oldest_window, hello.next_window);
            self.acknowledge |= hello.oldest_window < assembler.below();
        }
        self.hello = Some(hello.clone());
        if hello.replaying {
            // Its host has gone away in the middle of a recording; until that has ended it takes no sample and no time.
            self.say(&HostMessage::EndReplay);
            self.stage = Stage::Greeting;
            return Ok(());
        }
        let configured = hello.configuration_hash == Some(self.configurations.current.hash());
        // With another configuration it would soon drop what it still has for the other study.
        let serves_another = hello.configuration_hash.is_some_and(|hash| self.configurations.by_hash(hash).is_none());
        let holds_windows = hello.oldest_window < hello.next_window;
        if serves_another && holds_windows && !self.drops_foreign && self.inspected != Some(hello.boot) {
            if !matches!(self.stage, Stage::Inspecting { .. }) {
                self.stage = Stage::Inspecting { asked: 0 };
                self.next_try = HostTime(i64::MIN);
            }
            return Ok(());
        }
        let clock_set = hello.clock_set && !self.must_set_time;
        let stage = match (configured, clock_set) {
            (false, _) => Stage::Configuring,
            (true, _) if self.clock.len() < FIRST_EXCHANGES => Stage::Timing,
            (true, false) => Stage::SettingClock,
            (true, true) => Stage::Measuring,
        };
        if stage != self.stage {
            self.stage = stage;
            self.next_try = HostTime(i64::MIN);
            if stage == Stage::Timing {
                self.next_exchange = HostTime(i64::MIN);
            }
        }
        Ok(())
    }

    /// What there is to assemble of a life that this session has not seen before.
    fn met(&mut self, hello: &Hello, sink: &mut dyn WindowSink) -> Result<Assembler, SessionError> {
        let node = self.node;
        let fail = |source| SessionError::Store { node, source };
        let kept = sink.kept(node, hello.boot, hello.oldest_window).map_err(fail)?;
        let held = hello.next_window.saturating_sub(hello.oldest_window);
        if kept.is_none() && held > 0 {
            if !self.drops_foreign {
                return Err(SessionError::ForeignWindows { node });
            }
            self.statistics.foreign_windows += u64::from(held);
        }
        sink.meet(node, hello.boot, hello.next_window).map_err(fail)?;
        let kept = kept.unwrap_or(KeptWindows { first: hello.next_window, ..KeptWindows::default() });
        Ok(Assembler::resuming(hello.boot, &kept))
    }

    fn poll(&mut self, now: HostTime) {
        let retry = now >= self.next_try;
        match self.stage {
            Stage::Greeting if retry => {
                self.say(&HostMessage::Greet);
                self.next_try = HostTime(now.0 + RETRY_US);
            }
            Stage::Inspecting { asked } if retry => self.inspect(now, asked),
            Stage::Configuring if retry => {
                self.say(&HostMessage::Configure(self.configurations.current.clone()));
                self.next_try = HostTime(now.0 + RETRY_US);
            }
            Stage::Timing if self.clock.len() >= FIRST_EXCHANGES => {
                self.stage = if self.knows_time { Stage::Measuring } else { Stage::SettingClock };
                self.next_try = now;
            }
            Stage::Timing if now >= self.next_exchange => self.ask_time(now, FIRST_EXCHANGE_PERIOD_US),
            Stage::SettingClock if retry => {
                if let Some(model) = self.clock.model() {
                    self.say(&HostMessage::SetClock(model));
                    self.must_set_time = false;
                }
                self.say(&HostMessage::Greet);
                self.next_try = HostTime(now.0 + RETRY_US);
            }
            Stage::Measuring => self.poll_measuring(now),
            _ => {}
        }
    }

    /// Averaged densities have no phase for which exact clocks would be worth their bytes.
    fn needs_phase(&self) -> bool {
        matches!(self.configurations.current.summary, Summary::Lines { .. })
    }

    fn inspect(&mut self, now: HostTime, asked: u32) {
        let Some((boot, oldest)) = self.hello.as_ref().map(|hello| (hello.boot, hello.oldest_window)) else { return };
        if asked == INSPECTIONS {
            self.inspected = Some(boot);
            self.stage = Stage::Configuring;
            self.next_try = now;
            return;
        }
        let head = Again { first_window: oldest, last_window: oldest, first_part: 0, last_part: 0 };
        let again = std::iter::once(head).collect();
        self.say(&HostMessage::Acknowledge(Acknowledgement { boot, below: oldest, again }));
        self.stage = Stage::Inspecting { asked: asked + 1 };
        self.next_try = HostTime(now.0 + RETRY_US);
    }

    fn poll_measuring(&mut self, now: HostTime) {
        if now >= self.next_exchange {
            let period_us = self.clock.span_us() / EXCHANGE_SHARE;
            let longest_us = if self.needs_phase() { EXCHANGE_PERIOD_US } else { 2 * EXCHANGE_PERIOD_US };
            self.ask_time(now, period_us.clamp(LEAST_EXCHANGE_PERIOD_US, longest_us));
        }
        let busy = now.0.saturating_sub(self.last_received.0) < SILENCE_US;
        let Some(assembler) = &mut self.assembler else { return };
        let again = if assembler.is_complete() || (busy && now < self.next_try) {
            Vec::new()
        } else {
            self.next_try = HostTime(now.0 + SILENCE_US);
            assembler.overdue(now, HostTime(now.0 - ASK_PERIOD_US), self.last_received, busy)
        };
        if again.is_empty() && !self.acknowledge {
            return;
        }
        self.statistics.asked_again += again.len() as u64;
        let acknowledgement =
            Acknowledgement { boot: assembler.boot(), below: assembler.below(), again: again.into_iter().collect() };
        self.acknowledge = false;
        self.say(&HostMessage::Acknowledge(acknowledgement));
    }

    fn ask_time(&mut self, now: HostTime, period_us: i64) {
        let before = self.outgoing.len();
        self.say(&HostMessage::Clock(ClockRequest { host_sent: now }));
        self.request_bytes = self.outgoing.len() - before;
        self.next_exchange = HostTime(now.0 + period_us);
    }

    fn say(&mut self, message: &HostMessage) {
        let mut frame = [0; MAX_FRAME_BYTES];
        // The host's messages are all far shorter than a frame's limit.
        if let Ok(length) = message::encode(message, &mut frame) {
            self.outgoing.extend(&frame[..length]);
        }
    }
}

#[cfg(test)]
mod tests;
