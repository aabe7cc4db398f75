//! What a session says at each stage, and when.

use belfry_shared::message::{Acknowledgement, Again, ClockRequest, Greeting, HostMessage};
use belfry_shared::time::HostTime;

use super::super::delivery::Overdue;
use super::{Session, Stage};

/// Time between tries of a greeting, configuration or clock setting, in µs.
pub(super) const RETRY_US: i64 = 500_000;
/// Time between clock exchanges before the clock is set first.
const FIRST_EXCHANGE_PERIOD_US: i64 = 100_000;
/// Time between clock exchanges while measuring: this share of the time over which the clock is known, so that it is soon known
/// well, up to the longest, for they are bytes on the wire.
const EXCHANGE_SHARE: i64 = 4;
const LEAST_EXCHANGE_PERIOD_US: i64 = 20_000_000;
const EXCHANGE_PERIOD_US: i64 = 200_000_000;
/// How often a node that measures for another study is asked for its oldest window before it counts as having none.
pub(super) const INSPECTIONS: u32 = 3;
/// The line counts as silent when nothing came for this long.
const SILENCE_US: i64 = 300_000;
/// A part asked again is asked once more after this time.
const ASK_PERIOD_US: i64 = 2_000_000;

impl Session {
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
        // A session acknowledges while it measures the clock, and from then on; in the other stages that has to wait.
        if self.delivery.must_acknowledge() && matches!(self.stage, Stage::Timing | Stage::Measuring) {
            HostTime(due.0.min(self.last_received.0.saturating_add(1)))
        } else {
            due
        }
    }

    pub(super) fn poll(&mut self, now: HostTime) {
        let retry = now >= self.next_try;
        match self.stage {
            Stage::Greeting if retry => {
                self.wire.say(&HostMessage::Greet(Greeting::OF_HOSTS));
                self.next_try = HostTime(now.0 + RETRY_US);
            }
            Stage::Inspecting { asked } if retry => self.inspect(now, asked),
            Stage::Configuring if retry => {
                self.wire.say(&HostMessage::Configure(self.delivery.configurations().current.clone()));
                self.next_try = HostTime(now.0 + RETRY_US);
            }
            Stage::Timing if self.is_timed() => {
                self.stage = if self.knows_time { Stage::Measuring } else { Stage::SettingClock };
                self.next_try = now;
            }
            Stage::Timing => {
                if now >= self.next_exchange {
                    self.ask_time(now, FIRST_EXCHANGE_PERIOD_US);
                }
                // A host that never lives for long must not leave the node without acknowledgements until it has no more room.
                self.poll_delivery(now);
            }
            Stage::SettingClock if retry => {
                if let Some(model) = self.clock.model() {
                    self.wire.say(&HostMessage::SetClock(model));
                    self.must_set_time = false;
                }
                self.wire.say(&HostMessage::Greet(Greeting::OF_HOSTS));
                self.next_try = HostTime(now.0 + RETRY_US);
            }
            Stage::Measuring => self.poll_measuring(now),
            _ => {}
        }
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
        self.wire.say(&HostMessage::Acknowledge(Acknowledgement { boot, below: oldest, again }));
        self.stage = Stage::Inspecting { asked: asked + 1 };
        self.next_try = HostTime(now.0 + RETRY_US);
    }

    fn poll_measuring(&mut self, now: HostTime) {
        if now >= self.next_exchange {
            let period_us = self.clock.span_us() / EXCHANGE_SHARE;
            let longest_us = if self.needs_phase() { EXCHANGE_PERIOD_US } else { 2 * EXCHANGE_PERIOD_US };
            self.ask_time(now, period_us.clamp(LEAST_EXCHANGE_PERIOD_US, longest_us));
        }
        self.poll_delivery(now);
    }

    /// Acknowledges what is stored, and asks again for what is overdue.
    fn poll_delivery(&mut self, now: HostTime) {
        let is_busy = now.0.saturating_sub(self.last_received.0) < SILENCE_US;
        let overdue = if self.delivery.has_all() || (is_busy && now < self.next_try) {
            None
        } else if self.said_until.0 > now.0 + SILENCE_US {
            // What the host says waits on a slow line: the answers to its last questions cannot have come.
            self.next_try = HostTime(self.said_until.0 - SILENCE_US);
            None
        } else {
            self.next_try = HostTime(now.0 + SILENCE_US);
            Some(Overdue { now, before: HostTime(now.0 - ASK_PERIOD_US), answered: self.answered, is_busy })
        };
        for acknowledgement in self.delivery.acknowledgements(overdue) {
            if !acknowledgement.again.is_empty() {
                // Its answer tells whether the node hears what it is asked.
                self.next_exchange = self.next_exchange.min(HostTime(now.0 + LEAST_EXCHANGE_PERIOD_US));
            }
            self.wire.say(&HostMessage::Acknowledge(acknowledgement));
        }
    }

    fn ask_time(&mut self, now: HostTime, period_us: i64) {
        self.request_bytes = self.wire.say(&HostMessage::Clock(ClockRequest { host_sent: now }));
        self.next_exchange = HostTime(now.0 + period_us);
    }
}
