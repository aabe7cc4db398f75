//! The node's clock, measured from the host by two-way exchanges.
//!
//! Each exchange gives four times: request sent and reply received on the host's clock, request received and reply sent on
//! the node's. A message cannot arrive before it is sent: a request bounds what the clocks differ by from below, its reply from
//! above, and over many exchanges the bounds leave a strip in which the straight line of offset and drift must lie. Its middle
//! is right where the quickest requests took as long as the quickest replies (Mills 1991, NTP); slow ones, queued behind other
//! frames, bound nothing. Taking both ways apart (Moon, Skelly, Towsley 1999) does not wait for an exchange that is quick
//! there and back.

use std::collections::VecDeque;

use belfry_shared::message::ClockReply;
use belfry_shared::time::{ClockModel, HostTime, NodeTime};

/// Exchanges kept.
const KEPT: usize = 64;
/// Exchanges whose round trip is longer than the shortest by no more than this say over which time the clock is known.
const ROUND_TRIP_TOLERANCE_US: i64 = 10_000;
/// A reply cannot come before its request was sent, but for what reading clocks takes. (The time of frames on the line aside: one
/// that is faster than its baud rate says, as USB is, makes round trips that seem negative.)
const LEAST_WHOLE_ROUND_TRIP_US: i64 = -1_000;
/// Exchanges are forgotten after this: crystals bend with the temperature. One that swings by 20 ppm in the course of a day bends by
/// 0.2 ms from a line in this time, by 1.6 ms in an hour; in less, jitter counts more.
const KEPT_US: i64 = 1_200_000_000;
/// An exchange whose round trip is longer than the shortest by more than this bounds little.
const SLOW_US: i64 = 500;
/// Exchanges before the clock is set first, where enough of them are about as quick as the quickest; else there are more, up to so many or for so
/// long: on a slow line they wait for one another. On a computer that is busy, or a line that jitters, the quickest of six may be late by
/// milliseconds, which turns the shapes of all that is measured until the next exchanges.
pub(super) const FIRST_EXCHANGES: usize = 6;
const QUICK_EXCHANGES: usize = 3;
pub(super) const MOST_FIRST_EXCHANGES: usize = 30;
const LONGEST_FIRST_US: i64 = 4_000_000;
/// Span of exchanges from which drift is estimated.
const DRIFT_SPAN_US: i64 = 20_000_000;
/// Crystals do not drift more; a larger estimate is a fault of the measurement.
const MAX_DRIFT_PPB: f64 = 500_000.0;
/// How far the slope of the widest strip is narrowed down: 2^-40 of twice the largest drift is 1e-15.
const HALVINGS: usize = 40;
/// Strips whose widths differ by less, in µs, are equally wide.
const EQUALLY_WIDE_US: f64 = 0.5;

#[derive(Debug, Clone, Copy)]
struct Exchange {
    /// When the request arrived at the node, and host time minus node time by it, in µs: at most what they differ by.
    received: NodeTime,
    least_us: i64,
    /// When the reply left it, and host time minus node time by it, in µs: at least what they differ by.
    sent: NodeTime,
    most_us: i64,
    round_trip_us: i64,
}

/// Host time minus node time as a straight line over the node's time: its bounds, relative to the last exchange.
struct Strip {
    /// µs after the last exchange, and µs above its lower bound.
    least: Vec<(f64, f64)>,
    most: Vec<(f64, f64)>,
}

impl Strip {
    /// The highest lower and the lowest upper bound at the last exchange of lines of this slope.
    fn bounds(&self, slope: f64) -> (f64, f64) {
        let at = |&(elapsed, bound): &(f64, f64)| bound - slope * elapsed;
        (
            self.least.iter().map(at).fold(f64::NEG_INFINITY, f64::max),
            self.most.iter().map(at).fold(f64::INFINITY, f64::min),
        )
    }

    /// Concave in the slope.
    fn width(&self, slope: f64) -> f64 {
        let (least, most) = self.bounds(slope);
        most - least
    }

    /// The slope at which the strip is widest; the middle one where several are.
    fn slope(&self) -> f64 {
        let limit = MAX_DRIFT_PPB * 1e-9;
        let (mut low, mut high) = (-limit, limit);
        for _ in 0..2 * HALVINGS {
            let third = (high - low) / 3.0;
            if self.width(low + third) < self.width(high - third) { low += third } else { high -= third }
        }
        let widest = 0.5 * (low + high);
        let enough = self.width(widest) - EQUALLY_WIDE_US;
        let edge = |mut outside: f64| {
            let mut inside = widest;
            for _ in 0..HALVINGS {
                let middle = 0.5 * (inside + outside);
                if self.width(middle) >= enough { inside = middle } else { outside = middle }
            }
            inside
        };
        0.5 * (edge(-limit) + edge(limit))
    }
}

/// Estimates offset and drift of a node's clock.
#[derive(Debug, Clone, Default)]
pub struct ClockEstimator {
    exchanges: VecDeque<Exchange>,
    /// What follows from them. Whoever shows a node's drift asks for it several times a second, and finding it takes 0.1 ms.
    model: Option<ClockModel>,
    span_us: i64,
    /// Stays: later exchanges are further apart, and old ones are forgotten.
    is_settled: bool,
}

impl ClockEstimator {
    /// Adds an exchange. `request_us` and `reply_us` are the times the two frames need on the line; the rest of the round
    /// trip is waiting.
    pub fn add(&mut self, reply: &ClockReply, received: HostTime, request_us: i64, reply_us: i64) {
        let Some(exchange) = exchange(reply, received, request_us, reply_us) else { return };
        if self.exchanges.len() == KEPT {
            self.exchanges.pop_front();
        }
        let newest = exchange.sent;
        self.exchanges.push_back(exchange);
        while self.exchanges.front().is_some_and(|oldest| newest.since(oldest.sent) > KEPT_US) {
            self.exchanges.pop_front();
        }
        self.model = self.find_model();
        self.span_us = self.find_span_us();
        self.is_settled |= self.is_settling_over();
    }

    /// Exchanges there are.
    pub fn len(&self) -> usize {
        self.exchanges.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.exchanges.is_empty()
    }

    /// Forgets everything; for a node that has restarted.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Whether the last exchange was slow, and another would say more.
    pub fn is_last_slow(&self) -> bool {
        let excess = self
            .exchanges
            .back()
            .zip(self.shortest_us())
            .map(|(last, shortest)| last.round_trip_us.saturating_sub(shortest));
        excess.is_some_and(|excess| excess > SLOW_US)
    }

    /// Whether there have been enough exchanges for phases, since the first or since all was forgotten.
    pub fn is_settled(&self) -> bool {
        self.is_settled
    }

    fn is_settling_over(&self) -> bool {
        let ends = self.exchanges.front().zip(self.exchanges.back());
        let elapsed_us = ends.map_or(0, |(first, last)| last.sent.since(first.sent));
        let is_sure = self.within(SLOW_US).count() >= QUICK_EXCHANGES || elapsed_us >= LONGEST_FIRST_US;
        self.len() >= if is_sure { FIRST_EXCHANGES } else { MOST_FIRST_EXCHANGES }
    }

    /// Time over which exchanges with short round trips have been made, in µs: what the drift is known from. A burst of
    /// replies that a stalled line held back adds nothing.
    pub fn span_us(&self) -> i64 {
        self.span_us
    }

    fn find_span_us(&self) -> i64 {
        let mut good = self.within(ROUND_TRIP_TOLERANCE_US);
        let first = good.next();
        first.map_or(0, |first| good.last().unwrap_or(first).sent.since(first.sent))
    }

    /// How much faster the host's clock runs than the node's, in parts per million; `None` before it is known.
    pub fn drift_ppm(&self) -> Option<f64> {
        (self.span_us() >= DRIFT_SPAN_US).then(|| self.model.map(|model| f64::from(model.drift_ppb) * 1e-3))?
    }

    fn shortest_us(&self) -> Option<i64> {
        self.exchanges.iter().map(|exchange| exchange.round_trip_us).min()
    }

    /// The exchanges that took no longer than the shortest and so much more.
    fn within(&self, more_us: i64) -> impl Iterator<Item = &Exchange> {
        let longest = self.shortest_us().unwrap_or(0).saturating_add(more_us);
        self.exchanges.iter().filter(move |exchange| exchange.round_trip_us <= longest)
    }

    /// The best model so far: the middle of the strip that the exchanges leave, level while they span less than 20 s. `None` before
    /// the first exchange.
    pub fn model(&self) -> Option<ClockModel> {
        self.model
    }

    fn find_model(&self) -> Option<ClockModel> {
        let (first, last) = (self.exchanges.front()?, self.exchanges.back()?);
        let point =
            |node: NodeTime, bound: i64| (node.since(last.sent) as f64, bound.saturating_sub(last.least_us) as f64);
        let strip = Strip {
            least: self.exchanges.iter().map(|exchange| point(exchange.received, exchange.least_us)).collect(),
            most: self.exchanges.iter().map(|exchange| point(exchange.sent, exchange.most_us)).collect(),
        };
        let slope = if last.sent.since(first.sent) < DRIFT_SPAN_US { 0.0 } else { strip.slope() };
        let (least, most) = strip.bounds(slope);
        let offset_us = last.least_us.saturating_add((0.5 * (least + most)).round() as i64);
        let node_us = i64::try_from(last.sent.0).ok()?;
        Some(ClockModel {
            node: last.sent,
            host: HostTime(node_us.saturating_add(offset_us)),
            drift_ppb: (slope * 1e9).round() as i32,
        })
    }
}

/// An exchange of its four times; `None` where they lie beyond all clocks or contradict each other: the times of a reply
/// come from the line, and anything may stand in them.
fn exchange(reply: &ClockReply, received: HostTime, request_us: i64, reply_us: i64) -> Option<Exchange> {
    let sent = reply.host_sent.0.checked_add(request_us)?;
    let away_us = received.0.checked_sub(reply_us)?.checked_sub(sent)?;
    let held_us = reply.node_sent.since(reply.node_received);
    let round_trip_us = away_us.checked_sub(held_us)?;
    let whole_us = round_trip_us.saturating_add(request_us).saturating_add(reply_us);
    if held_us < 0 || whole_us < LEAST_WHOLE_ROUND_TRIP_US {
        return None;
    }
    let least_us = sent.checked_sub(i64::try_from(reply.node_received.0).ok()?)?;
    let most_us = received.0.checked_sub(reply_us)?.checked_sub(i64::try_from(reply.node_sent.0).ok()?)?;
    Some(Exchange { received: reply.node_received, least_us, sent: reply.node_sent, most_us, round_trip_us })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A node whose clock started 100 s before the host's epoch and loses 20 ppm.
    fn node_time(host_us: i64) -> NodeTime {
        NodeTime(((host_us + 100_000_000) as f64 / (1.0 + 20e-6)).round() as u64)
    }

    fn exchange(at_us: i64, queued_us: i64) -> (ClockReply, HostTime) {
        let received = at_us + 1_000;
        let sent = received + 300;
        let reply = ClockReply {
            host_sent: HostTime(at_us),
            node_received: node_time(received),
            node_sent: node_time(sent),
            believed_delay_us: None,
        };
        (reply, HostTime(sent + queued_us + 2_000))
    }

    #[test]
    fn offset_and_drift_are_found_although_some_replies_were_queued() {
        let mut estimator = ClockEstimator::default();
        for minute in 0..10 {
            let (reply, received) = exchange(minute * 60_000_000, if minute % 3 == 1 { 40_000 } else { 0 });
            estimator.add(&reply, received, 1_000, 2_000);
        }
        let model = estimator.model().unwrap();
        assert!((model.drift_ppb - 20_000).abs() < 10, "{model:?}");
        let later = 12 * 60_000_000;
        assert!((model.host_time(node_time(later)).0 - later).abs() <= 5);
    }

    #[test]
    fn a_burst_of_delayed_replies_does_not_pass_for_a_long_measurement() {
        let mut estimator = ClockEstimator::default();
        for (second, queued_us) in [(0, 0), (1, 0), (20, 900_000), (40, 700_000), (60, 500_000)] {
            let (reply, received) = exchange(second * 1_000_000, queued_us);
            estimator.add(&reply, received, 1_000, 2_000);
        }
        assert!((estimator.span_us() - 1_000_000).abs() < 100);
        let (reply, received) = exchange(80_000_000, 0);
        estimator.add(&reply, received, 1_000, 2_000);
        assert!((estimator.span_us() - 80_000_000).abs() < 5_000);
    }

    #[test]
    fn jitter_either_way_is_seen_through_where_no_exchange_is_quick_both_ways() {
        let mut estimator = ClockEstimator::default();
        let mut state = 1_u64;
        let mut jitter_us = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % 5_000) as i64
        };
        for minute in 0..32 {
            let at_us = minute * 60_000_000;
            let received = at_us + 1_000 + jitter_us();
            let reply = ClockReply {
                host_sent: HostTime(at_us),
                node_received: node_time(received),
                node_sent: node_time(received + 300),
                believed_delay_us: None,
            };
            estimator.add(&reply, HostTime(received + 300 + 2_000 + jitter_us()), 1_000, 2_000);
        }
        let model = estimator.model().unwrap();
        let now = 32 * 60_000_000;
        // The quickest of 32 draws of up to 5 ms is 0.15 ms late, and the slope turns that some way further.
        let error_us = model.host_time(node_time(now)).0 - now;
        assert!(error_us.abs() < 400, "{error_us} µs");
        assert!((model.drift_ppb - 20_000).abs() < 400, "{model:?}");
    }

    #[test]
    fn one_exchange_gives_an_offset_and_none_gives_nothing() {
        let mut estimator = ClockEstimator::default();
        assert_eq!(estimator.model(), None);
        let (reply, received) = exchange(0, 0);
        estimator.add(&reply, received, 1_000, 2_000);
        let model = estimator.model().unwrap();
        assert_eq!(model.drift_ppb, 0);
        assert!((model.host_time(node_time(0)).0).abs() <= 2);
    }
}
