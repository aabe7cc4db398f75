//! The host's end of the conversation with one node.
//!
//! Bytes and the time flow in, bytes to send and whole windows flow out. The session greets, agrees on a version, configures,
//! sets the clock, then collects: it acknowledges what the sink has stored and asks again for what is overdue.

mod stages;

use std::io::ErrorKind;

use belfry_shared::message::{
    Calibration, ClockReply, Conversation, Heartbeat, Hello, HostMessage, NodeMessage, Pace, Summary,
};
use belfry_shared::seal::Key;
use belfry_shared::time::HostTime;

use super::clock::{ClockEstimator, FIRST_EXCHANGES};
use super::delivery::Delivery;
use super::error::SessionError;
use super::transport::Transport;
use super::wire::{Frame, MOST_READS, Wire, WireCounts};
use crate::window::{Configurations, WindowSink};

/// Time over which the clock is measured before an earlier host's estimate is replaced.
const SETTLED_SPAN_US: i64 = 300_000_000;
/// A node whose time is this far off has it from a host whose clock was wrong; no line that works holds a request up for so long.
const WRONG_TIME_US: u64 = 1_000_000;
/// How often, and how soon, an exchange that was slow is made again: on a line that jitters the quickest of many says most, and
/// only there they cost bytes.
const REPEATS: u32 = 5;
const REPEAT_PERIOD_US: i64 = 1_000_000;
/// How often another host may greet the node meanwhile, before the session leaves the node to it.
const MOST_TAKEOVERS: u32 = 5;
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
    /// Messages that only a later version of Belfry would know.
    pub unknown_messages: u64,
    /// Frames without a sound seal, of a node that has a key, or heard before.
    pub unsealed_frames: u64,
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
    /// It measures for another study: the session asks for its oldest window before it gives it a configuration.
    Inspecting {
        asked: u32,
    },
    Configuring,
    Timing,
    SettingClock,
    Measuring,
}

/// The host's end of the conversation with one node.
#[derive(Debug)]
pub struct Session {
    node: u16,
    byte_us: f64,
    stage: Stage,
    wire: Wire,
    delivery: Delivery,
    clock: ClockEstimator,
    request_bytes: usize,
    /// How often the last exchange has been made again.
    repeats: u32,
    next_try: HostTime,
    next_exchange: HostTime,
    last_received: HostTime,
    /// When the last request for the time was said that the node has answered.
    answered: HostTime,
    /// When all that has been said is off the line, at its rate.
    said_until: HostTime,
    /// The life of the node that has been asked for windows of another study, and had none.
    inspected: Option<u32>,
    /// Whether an earlier host's time is on the node: a better one takes a while.
    knows_time: bool,
    /// Whether the host's own clock was set, and the node's time is wrong with it.
    must_set_time: bool,
    /// How often the node listened to another host.
    takeovers: u32,
    hello: Option<Hello>,
    heartbeat: Option<Heartbeat>,
}

impl Session {
    /// A session for a node that shall run the current one of `configurations`, over a line of `baud`.
    pub fn new(node: u16, configurations: Configurations, baud: u32) -> Self {
        Self {
            node,
            byte_us: 10e6 / f64::from(baud.max(1)),
            stage: Stage::Greeting,
            wire: Wire::new(),
            delivery: Delivery::new(node, configurations),
            clock: ClockEstimator::default(),
            request_bytes: 0,
            repeats: 0,
            next_try: HostTime(i64::MIN),
            next_exchange: HostTime(i64::MIN),
            last_received: HostTime(i64::MIN),
            answered: HostTime(i64::MIN),
            said_until: HostTime(i64::MIN),
            inspected: None,
            knows_time: false,
            must_set_time: false,
            takeovers: 0,
            hello: None,
            heartbeat: None,
        }
    }

    /// Gives windows up that another study asked for, instead of ending with an error.
    pub fn dropping_foreign(mut self, drops_foreign: bool) -> Self {
        self.delivery.drops_foreign = drops_foreign;
        self
    }

    /// Takes nothing from the node, and says nothing to it, without a seal of this key; `None` where it has none.
    pub fn with_key(mut self, key: Option<Key>) -> Self {
        if let Some(key) = key {
            self.wire.set_key(key);
        }
        self
    }

    /// Speaks under this number, for whoever says what a node would answer; it has a random one of its own otherwise.
    pub fn with_conversation(mut self, conversation: Conversation) -> Self {
        self.wire.set_conversation(conversation);
        self
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
        !self.delivery.must_acknowledge() && self.delivery.has_all()
    }

    /// Begins anew with the greeting, on a line that was away: the node may have started anew meanwhile.
    pub fn reconnect(&mut self) {
        self.wire.reconnect();
        self.takeovers = 0;
        self.greet_again();
    }

    fn greet_again(&mut self) {
        self.stage = Stage::Greeting;
        self.next_try = HostTime(i64::MIN);
        (self.last_received, self.said_until) = (HostTime(i64::MIN), HostTime(i64::MIN));
    }

    /// Begins anew with the greeting and the time; for a host whose own clock was set. What is known of windows stays.
    pub fn restart(&mut self) {
        self.greet_again();
        self.clock.clear();
        self.knows_time = false;
        self.must_set_time = true;
        self.next_exchange = HostTime(i64::MIN);
        self.answered = HostTime(i64::MIN);
    }

    /// Asks for heartbeats at another pace. A node of an earlier release does not know how.
    pub fn pace(&mut self, pace: Pace) {
        self.wire.say(&HostMessage::Pace(pace));
    }

    /// Tells the node what its axes read, for it to keep; its next greeting has it.
    pub fn calibrate(&mut self, calibration: &Calibration) {
        self.wire.say(&HostMessage::Calibrate(calibration.clone()));
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
        let WireCounts { bytes_received, bytes_sent, frames, damaged_frames, unknown_messages, unsealed_frames } =
            self.wire.counts();
        let delivery = self.delivery.counts();
        SessionStatistics {
            bytes_received,
            bytes_sent,
            frames,
            damaged_frames,
            unknown_messages,
            unsealed_frames,
            duplicate_parts: delivery.duplicate_parts,
            contradictions: delivery.contradictions,
            asked_again: delivery.asked_again,
            windows: delivery.windows,
            lost_windows: self.delivery.lost(),
            foreign_windows: delivery.foreign_windows,
        }
    }

    /// Stores the windows that wait for the sink, as far as it takes them.
    ///
    /// # Errors
    /// Where it never will.
    pub fn store_waiting(&mut self, sink: &mut dyn WindowSink) -> Result<(), SessionError> {
        self.delivery.retry(sink)
    }

    /// Reads what has arrived, as far as that comes to an end, says what is due, and sends it. `clock` is read when bytes have come: what arrives
    /// while others are stored must not seem to have come before.
    pub fn service(
        &mut self,
        clock: &dyn Fn() -> HostTime,
        transport: &mut dyn Transport,
        sink: &mut dyn WindowSink,
    ) -> Result<(), SessionError> {
        let node = self.node;
        let fail = |source| SessionError::Transport { node, source };
        self.delivery.retry(sink)?;
        let mut buffer = [0; 512];
        for _ in 0..MOST_READS {
            let count = transport.read(&mut buffer).map_err(fail)?;
            if count == 0 {
                break;
            }
            self.receive(clock(), &buffer[..count], sink)?;
        }
        let now = clock();
        self.poll(now);
        let on_line_us = self.wire.send(transport).map_err(fail)? as f64 * self.byte_us;
        self.said_until = HostTime(self.said_until.max(now).0.saturating_add(on_line_us as i64));
        Ok(())
    }

    fn receive(&mut self, now: HostTime, bytes: &[u8], sink: &mut dyn WindowSink) -> Result<(), SessionError> {
        self.last_received = now;
        for frame in self.wire.receive(bytes) {
            let message = self.wire.message(&frame);
            if let Some(message) = message.map_err(|why| SessionError::untaken(self.node, why))? {
                self.handle(now, &message, &frame, sink)?;
            }
        }
        Ok(())
    }

    fn handle(
        &mut self,
        now: HostTime,
        message: &NodeMessage<'_>,
        frame: &Frame,
        sink: &mut dyn WindowSink,
    ) -> Result<(), SessionError> {
        match message {
            NodeMessage::Hello(hello) => self.greeted(now, hello, sink)?,
            NodeMessage::Refused(refusal)
                if refusal.configuration_hash == self.delivery.configurations().current.hash() =>
            {
                return Err(SessionError::Refused { node: self.node, reason: refusal.reason });
            }
            NodeMessage::Refused(_) => {}
            NodeMessage::Clock(reply) => self.timed(now, reply, frame.bytes),
            NodeMessage::Heartbeat(heartbeat) if heartbeat.node != self.node => self.delivery.contradicted(),
            NodeMessage::Heartbeat(heartbeat) => {
                self.heartbeat = Some(heartbeat.clone());
                sink.heartbeat(now, heartbeat);
                if !self.delivery.holds(heartbeat.boot, heartbeat.oldest_window, heartbeat.next_window) {
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
                self.delivery.take(Some(now), part, &frame.encoded, sink)?;
            }
        }
        Ok(())
    }

    /// Takes an exchange of times, and corrects the node's time where it makes the estimate better.
    fn timed(&mut self, now: HostTime, reply: &ClockReply, reply_bytes: usize) {
        if reply.host_sent <= now {
            self.answered = self.answered.max(reply.host_sent);
        }
        let on_line = |bytes: usize| (bytes as f64 * self.byte_us).round() as i64;
        let (request_us, reply_us) = (on_line(self.request_bytes), on_line(reply_bytes));
        self.clock.add(reply, now, request_us, reply_us);
        if reply.believed_delay_us.is_some_and(|delay_us| delay_us.unsigned_abs() > WRONG_TIME_US) {
            self.knows_time = false;
        }
        if self.stage != Stage::Measuring {
            return;
        }
        // A first estimate must not take the place of one that an earlier host made over hours.
        let is_better = !self.knows_time || self.clock.span_us() >= SETTLED_SPAN_US;
        if let Some(model) = self.clock.model().filter(|_| is_better) {
            self.wire.say(&HostMessage::SetClock(model));
        }
        if self.needs_phase() && self.clock.is_last_slow() && self.repeats < REPEATS {
            self.repeats += 1;
            self.next_exchange = HostTime(now.0.saturating_add(REPEAT_PERIOD_US));
        } else {
            self.repeats = 0;
        }
    }

    fn greeted(&mut self, now: HostTime, hello: &Hello, sink: &mut dyn WindowSink) -> Result<(), SessionError> {
        let node = self.node;
        if hello.node != node {
            return Err(SessionError::WrongNode { node, found: hello.node });
        }
        if hello.counters.is_some() && !self.wire.has_key() {
            return Err(SessionError::KeyMissing { node });
        }
        if self.wire.is_out_of_step(hello) {
            self.stage = Stage::Greeting;
            self.next_try = HostTime(i64::MIN);
            return Ok(());
        }
        if !self.wire.is_listened_to(hello) {
            return self.not_listened_to(now, hello);
        }
        let is_new_life = match self.delivery.greeted(hello, sink) {
            // It is greeted again, until the sink can say what it has of this life.
            Err(SessionError::Store { source, .. }) if source.kind() == ErrorKind::WouldBlock => {
                self.stage = Stage::Greeting;
                return Ok(());
            }
            greeted => greeted?,
        };
        if is_new_life {
            self.clock.clear();
            self.knows_time = hello.clock_set;
            self.heartbeat = None;
        }
        self.hello = Some(hello.clone());
        if hello.replaying {
            // Its host has gone away in the middle of a recording; until that has ended it takes no sample and no time.
            self.wire.say(&HostMessage::EndReplay);
            self.stage = Stage::Greeting;
            return Ok(());
        }
        let configurations = self.delivery.configurations();
        let configured = hello.configuration_hash == Some(configurations.current.hash());
        // With another configuration it would soon drop what it still has for the other study.
        let serves_another = hello.configuration_hash.is_some_and(|hash| configurations.by_hash(hash).is_none());
        let holds_windows = hello.oldest_window < hello.next_window;
        let is_inspected = self.delivery.drops_foreign || self.inspected == Some(hello.boot);
        if serves_another && holds_windows && !is_inspected {
            if !matches!(self.stage, Stage::Inspecting { .. }) {
                self.stage = Stage::Inspecting { asked: 0 };
                self.next_try = HostTime(i64::MIN);
            }
            return Ok(());
        }
        let clock_set = hello.clock_set && !self.must_set_time;
        let stage = match (configured, clock_set) {
            (false, _) => Stage::Configuring,
            (true, _) if !self.is_timed() => Stage::Timing,
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

    /// Greets a node that has started anew, or that another host has greeted, so that it listens to this one.
    fn not_listened_to(&mut self, now: HostTime, hello: &Hello) -> Result<(), SessionError> {
        let is_asked = self.wire.has_key() && self.wire.is_answered_by(hello);
        if self.stage == Stage::Greeting {
            if is_asked {
                // It was asked, not greeted; now it can be.
                self.next_try = HostTime(i64::MIN);
                return Ok(());
            }
            if now < self.next_try {
                // What has been said already has still to arrive.
                return Ok(());
            }
        }
        self.takeovers += u32::from(hello.conversation.is_some());
        if self.takeovers > MOST_TAKEOVERS {
            return Err(SessionError::TakenOver { node: self.node });
        }
        self.stage = Stage::Greeting;
        self.next_try = HostTime(i64::MIN);
        Ok(())
    }

    /// Whether the clock has been measured well enough to be set.
    fn is_timed(&self) -> bool {
        self.clock.len() >= FIRST_EXCHANGES && (self.clock.is_settled() || !self.needs_phase())
    }

    /// Averaged densities have no phase for which exact clocks would be worth their bytes.
    fn needs_phase(&self) -> bool {
        matches!(self.delivery.configurations().current.summary, Summary::Lines { .. })
    }
}

#[cfg(test)]
mod tests;
