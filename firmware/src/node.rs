//! The node: a state machine fed with samples, bytes and the time, and asked for bytes to send.

use belfry_shared::frame;
use belfry_shared::frame::{FrameDecoder, MAX_FRAME_BYTES, PROTOCOL_VERSION};
use belfry_shared::message::{
    self, ClockReply, ClockRequest, Configuration, Heartbeat, Hello, HostMessage, NodeMessage, Refusal, SCHEMA_HASH,
    WindowName,
};
use belfry_shared::time::{ClockModel, NodeTime};

use crate::acquisition::Acquisition;
use crate::level::LevelMeter;
use crate::outbox::Outbox;
use crate::plan::Plan;
use crate::schedule::{SampleMoment, rows_to_ps};
use crate::windows::{Arena, Files, WindowMaker};

/// Time between heartbeats in µs.
const HEARTBEAT_US: i64 = 120_000_000;
/// Rows that may be missing in one piece before the node starts over at the next window.
const MAX_MISSING_ROWS: i64 = 1000;

/// What a node is born with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Identity {
    /// Its id, as on its label.
    pub node: u16,
    /// Drawn anew at every start, so that the host can tell a restarted node.
    pub boot: u32,
    /// Channels its sensor has, 1 to 4.
    pub channels: u8,
    /// Readings of this magnitude or more, in m/s², are clipped.
    pub full_scale_m_s2: f32,
}

/// What waits to be said beside the outbox.
#[derive(Debug, Clone, Default)]
struct Pending {
    hello: bool,
    refusal: Option<Refusal>,
    clock: Option<(ClockRequest, NodeTime)>,
    heartbeat: bool,
}

/// The frame on its way out.
struct Transmitter {
    frame: [u8; MAX_FRAME_BYTES],
    length: usize,
    sent: usize,
}

/// A sensor node.
///
/// Feed it with [`sample`](Self::sample) and [`receive`](Self::receive), give it time with [`poll`](Self::poll) whenever
/// nothing else is to be done, and send what [`transmit`](Self::transmit) gives. It takes about 110 KB; keep it in a static.
pub struct Node {
    identity: Identity,
    plan: Option<Plan>,
    clock: Option<ClockModel>,
    /// When the last row was taken; `None` while the node waits for a row on the grid.
    last_row: Option<NodeTime>,
    acquisition: Acquisition,
    windows: WindowMaker,
    outbox: Outbox,
    arena: Arena,
    level: LevelMeter,
    last_heartbeat: Option<NodeTime>,
    decoder: FrameDecoder,
    damaged_frames: u32,
    pending: Pending,
    transmitter: Transmitter,
}

impl Node {
    /// A node that has just started; it greets the host and waits for a configuration and the time.
    pub const fn new(identity: Identity) -> Self {
        Self {
            identity,
            plan: None,
            clock: None,
            last_row: None,
            acquisition: Acquisition::START,
            windows: WindowMaker::START,
            outbox: Outbox::new(),
            arena: Arena::START,
            level: LevelMeter::START,
            last_heartbeat: None,
            decoder: FrameDecoder::new(),
            damaged_frames: 0,
            pending: Pending { hello: true, refusal: None, clock: None, heartbeat: false },
            transmitter: Transmitter { frame: [0; MAX_FRAME_BYTES], length: 0, sent: 0 },
        }
    }

    /// Takes a byte from the host that arrived at `now`.
    pub fn receive(&mut self, now: NodeTime, byte: u8) {
        let message = match self.decoder.push(byte) {
            None => return,
            Some(frame) => frame.and_then(message::decode::<HostMessage>),
        };
        match message {
            Err(_) => self.damaged_frames = self.damaged_frames.saturating_add(1),
            Ok(HostMessage::Greet) => self.pending.hello = true,
            Ok(HostMessage::Configure(configuration)) => self.configure(configuration),
            Ok(HostMessage::Acknowledge(acknowledgement)) => {
                if acknowledgement.boot == self.identity.boot {
                    self.outbox.acknowledge(acknowledgement.below);
                    for wanted in &acknowledgement.again {
                        self.outbox.again(wanted);
                    }
                }
            }
            Ok(HostMessage::Clock(request)) => self.pending.clock = Some((request, now)),
            Ok(HostMessage::SetClock(model)) => {
                // A model may be overtaken on the line by a newer one; one from the future would keep all others out.
                let is_newest = self.clock.is_none_or(|known| model.node >= known.node);
                if is_newest && model.node <= now {
                    self.clock = Some(model);
                    self.windows.reschedule();
                }
            }
        }
    }

    fn configure(&mut self, configuration: Configuration) {
        let hash = configuration.hash();
        if self.plan.as_ref().is_some_and(|plan| plan.hash == hash) {
            self.pending.hello = true;
            return;
        }
        match Plan::new(configuration, self.identity.channels) {
            Ok(plan) => {
                let (_, ring) = self.arena.split(plan.cells);
                self.outbox.shrink(ring.len());
                self.plan = Some(plan);
                self.interrupt();
                self.pending.hello = true;
            }
            Err(reason) => self.pending.refusal = Some(Refusal { configuration_hash: hash, reason }),
        }
    }

    /// Drops everything measured but not yet transformed, and waits for the next row on the grid.
    fn interrupt(&mut self) {
        self.last_row = None;
        self.acquisition.restart();
        self.windows.restart();
    }

    /// Takes a row of readings in m/s² that was sampled at `time`, a channel each; NaN where a reading is missing.
    ///
    /// Rows that stayed out are noticed by the time and count as missing. Before the node has a configuration and the
    /// host's time, rows are dropped.
    pub fn sample(&mut self, time: NodeTime, readings: &[f32]) {
        let (Some(plan), Some(clock)) = (&self.plan, &self.clock) else { return };
        let period_us = (rows_to_ps(1, plan.configuration.sampling_rate_uhz) / 1_000_000) as i64;
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
        let made = self.acquisition.push(&plan.stages, readings, channels, self.identity.full_scale_m_s2);
        for channel in 0..channels {
            self.level.add(channel, self.acquisition.about_bias(channel));
        }
        if made {
            let index = self.acquisition.samples() - 1;
            let rows_ago =
                (self.acquisition.rows() - 1).saturating_sub(index * u64::from(plan.configuration.decimation));
            let ago_us = rows_to_ps(rows_ago, plan.configuration.sampling_rate_uhz) / 1_000_000;
            let moment = SampleMoment { index, time: time.offset(-(ago_us as i64)) };
            self.windows.on_sample(plan, clock, moment);
        }
    }

    /// Does one step of waiting work (one channel of one segment at most). Returns whether there was any; call again then.
    pub fn poll(&mut self, now: NodeTime) -> bool {
        match self.last_heartbeat {
            Some(last) if now.since(last) < HEARTBEAT_US => {}
            Some(_) => {
                self.pending.heartbeat = true;
                self.last_heartbeat = Some(now);
            }
            None => self.last_heartbeat = Some(now),
        }
        let Some(plan) = &self.plan else { return false };
        let (cells, ring) = self.arena.split(plan.cells);
        let name = WindowName { node: self.identity.node, boot: self.identity.boot, number: 0 };
        let mut files = Files { outbox: &mut self.outbox, ring, name };
        self.windows.work(plan, &mut self.acquisition, cells, &mut files)
    }

    /// Whether [`transmit`](Self::transmit) would give bytes.
    pub fn has_bytes(&self) -> bool {
        let Pending { hello, refusal, clock, heartbeat } = &self.pending;
        self.transmitter.sent < self.transmitter.length
            || *hello
            || *heartbeat
            || refusal.is_some()
            || clock.is_some()
            || self.outbox.is_pending()
    }

    /// Fills `out` with bytes to send at `now` and returns how many; never more than to the end of one frame.
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

    /// Makes the most urgent frame there is; 0 bytes where there is none.
    fn next_frame(&mut self, now: NodeTime) -> usize {
        let frame = &mut self.transmitter.frame;
        let message = if let Some((request, node_received)) = self.pending.clock.take() {
            NodeMessage::Clock(ClockReply { host_sent: request.host_sent, node_received, node_sent: now })
        } else if core::mem::take(&mut self.pending.hello) {
            NodeMessage::Hello(Hello {
                protocol_version: PROTOCOL_VERSION,
                schema_hash: SCHEMA_HASH,
                node: self.identity.node,
                boot: self.identity.boot,
                channels: self.identity.channels,
                configuration_hash: self.plan.as_ref().map(|plan| plan.hash),
                clock_set: self.clock.is_some(),
            })
        } else if let Some(refusal) = self.pending.refusal.take() {
            NodeMessage::Refused(refusal)
        } else if core::mem::take(&mut self.pending.heartbeat) {
            let next_window = self.windows.next_number();
            NodeMessage::Heartbeat(Heartbeat {
                node: self.identity.node,
                boot: self.identity.boot,
                next_window,
                oldest_window: self.outbox.oldest_window().unwrap_or(next_window),
                lost_windows: self.outbox.lost_windows(),
                damaged_frames: self.damaged_frames,
                level: self.level.take(self.plan.as_ref().map_or(0, Plan::channels)),
            })
        } else {
            let (_, ring) = self.arena.split(self.plan.as_ref().map_or(0, |plan| plan.cells));
            let part = self.outbox.next(ring);
            return part.map_or(0, |part| frame::encode(part, frame).unwrap_or(0));
        };
        message::encode(&message, frame).unwrap_or(0)
    }
}

#[cfg(test)]
mod tests;
