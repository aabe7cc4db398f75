//! The node's clock, measured from the host by two-way exchanges.
//!
//! Each exchange gives four times: request sent and reply received on the host's clock, request received and reply sent on
//! the node's. The midpoints are the same moment if both ways took equally long (Mills 1991, NTP); of exchanges that did
//! not (a frame was queued behind another) the round trip is longer, and they are left out.

use std::collections::VecDeque;

use belfry_shared::message::ClockReply;
use belfry_shared::time::{ClockModel, HostTime, NodeTime};

/// Exchanges kept.
const KEPT: usize = 32;
/// Exchanges whose round trip is at most this much longer than the shortest are used; USB serial ports alone vary by 1 ms.
const ROUND_TRIP_TOLERANCE_US: i64 = 2_000;
/// Error of an exchange without any excess, in µs; half the excess of its round trip over the shortest adds to it.
const LEAST_ERROR_US: f64 = 30.0;
/// A line faster than its baud rate says (USB) makes round trips that seem negative, but not by more than this.
const LEAST_ROUND_TRIP_US: i64 = -1_000_000;
/// Span of exchanges from which drift is estimated.
const DRIFT_SPAN_US: i64 = 20_000_000;
/// Crystals do not drift more; a larger estimate is a fault of the measurement.
const MAX_DRIFT_PPB: f64 = 500_000.0;

#[derive(Debug, Clone, Copy)]
struct Exchange {
    node: NodeTime,
    /// Host time minus node time in µs.
    offset_us: i64,
    round_trip_us: i64,
}

/// Estimates offset and drift of a node's clock.
#[derive(Debug, Clone, Default)]
pub struct ClockEstimator {
    exchanges: VecDeque<Exchange>,
}

impl ClockEstimator {
    /// Adds an exchange. `request_us` and `reply_us` are the times the two frames need on the line; the rest of the round
    /// trip is waiting.
    pub fn add(&mut self, reply: &ClockReply, received: HostTime, request_us: i64, reply_us: i64) {
        let Some(exchange) = exchange(reply, received, request_us, reply_us) else { return };
        if self.exchanges.len() == KEPT {
            self.exchanges.pop_front();
        }
        self.exchanges.push_back(exchange);
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
        self.exchanges.clear();
    }

    /// Time over which exchanges with short round trips have been made, in µs: what the drift is known from. A burst of
    /// replies that a stalled line held back adds nothing.
    pub fn span_us(&self) -> i64 {
        let span = self.good().and_then(|(_, good)| Some(good.last()?.node.since(good.first()?.node)));
        span.unwrap_or(0)
    }

    /// How much faster the host's clock runs than the node's, in parts per million; `None` before it is known.
    pub fn drift_ppm(&self) -> Option<f64> {
        (self.span_us() >= DRIFT_SPAN_US).then(|| self.model().map(|model| f64::from(model.drift_ppb) * 1e-3))?
    }

    /// The shortest round trip, and the exchanges that took little longer.
    fn good(&self) -> Option<(i64, Vec<&Exchange>)> {
        let shortest = self.exchanges.iter().map(|exchange| exchange.round_trip_us).min()?;
        let is_short =
            |exchange: &&Exchange| exchange.round_trip_us <= shortest.saturating_add(ROUND_TRIP_TOLERANCE_US);
        Some((shortest, self.exchanges.iter().filter(is_short).collect()))
    }

    /// The best model so far: a weighted least-squares line through the exchanges with short round trips, a constant offset while they
    /// span less than 20 s. `None` before the first exchange.
    pub fn model(&self) -> Option<ClockModel> {
        let (shortest, good) = self.good()?;
        let (first, last) = (good.first()?, good.last()?);
        let weight = |exchange: &Exchange| {
            let excess_us = (exchange.round_trip_us - shortest) as f64 / 2.0;
            1.0 / (LEAST_ERROR_US * LEAST_ERROR_US + excess_us * excess_us)
        };
        let total: f64 = good.iter().map(|e| weight(e)).sum();
        let elapsed = |exchange: &Exchange| exchange.node.since(last.node) as f64;
        let lead = |exchange: &Exchange| exchange.offset_us.saturating_sub(last.offset_us) as f64;
        let mean_elapsed = good.iter().map(|e| weight(e) * elapsed(e)).sum::<f64>() / total;
        let mean_lead = good.iter().map(|e| weight(e) * lead(e)).sum::<f64>() / total;
        let slope = if last.node.since(first.node) < DRIFT_SPAN_US {
            0.0
        } else {
            let covariance: f64 =
                good.iter().map(|e| weight(e) * (elapsed(e) - mean_elapsed) * (lead(e) - mean_lead)).sum();
            let variance: f64 = good.iter().map(|e| weight(e) * (elapsed(e) - mean_elapsed).powi(2)).sum();
            (covariance / variance).clamp(-MAX_DRIFT_PPB * 1e-9, MAX_DRIFT_PPB * 1e-9)
        };
        // The line's value at the last exchange.
        let offset = last.offset_us.saturating_add((mean_lead - slope * mean_elapsed).round() as i64);
        let node_us = i64::try_from(last.node.0).ok()?;
        Some(ClockModel {
            node: last.node,
            host: HostTime(node_us.saturating_add(offset)),
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
    if held_us < 0 || round_trip_us < LEAST_ROUND_TRIP_US {
        return None;
    }
    let node = reply.node_received.offset(held_us / 2);
    let offset_us = sent.checked_add(away_us / 2)?.checked_sub(i64::try_from(node.0).ok()?)?;
    Some(Exchange { node, offset_us, round_trip_us })
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
        let reply =
            ClockReply { host_sent: HostTime(at_us), node_received: node_time(received), node_sent: node_time(sent) };
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
