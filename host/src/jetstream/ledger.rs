//! Which intervals of a structure are over, by the messages of the stream alone.
//!
//! Messages flow in, in the order of the stream, by their headers; an interval flows out when all nodes have sent something of a later one, or when
//! one is far ahead of the others. What belongs to it is then what has come until now, and what comes later is too late. So an interval has the
//! same windows whoever asks, and when: a result says where to go on, and from there everything comes out as it would have.

use std::collections::BTreeMap;

use super::names::DataKind;

/// How long a node that is silent is waited for, once another is past an interval, in µs; half an interval where that is less, but a minute
/// at least: a line that drops frames, or a machine that is busy, holds a node up for some seconds however short the intervals are.
const LONGEST_WAIT_US: i64 = 900_000_000;
const LEAST_WAIT_US: i64 = 60_000_000;

/// An interval that is over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Due {
    /// Its number: whole intervals since the Unix epoch.
    pub(super) number: i64,
    /// The first message that belongs to it.
    pub(super) from: u64,
    /// The message that ended it.
    pub(super) to: u64,
    /// The first message of a later one.
    pub(super) next: u64,
}

/// What has come of an interval.
#[derive(Debug, Clone, Copy)]
struct Begun {
    first: u64,
    has_windows: bool,
}

/// The messages of a structure.
#[derive(Debug, Clone)]
pub(super) struct Ledger {
    every_us: i64,
    /// The time of the newest window of each node.
    nodes: BTreeMap<u16, Option<i64>>,
    /// The last interval that is done.
    done: Option<i64>,
    begun: BTreeMap<i64, Begun>,
    /// The last message.
    last: u64,
}

impl Ledger {
    /// Of a structure with these nodes, of which `done` is done.
    pub(super) fn new(every_us: i64, nodes: &[u16], done: Option<i64>) -> Self {
        let nodes = nodes.iter().map(|&node| (node, None)).collect();
        Self { every_us: every_us.max(1), nodes, done, begun: BTreeMap::new(), last: 0 }
    }

    /// Takes a message; the intervals that are over with it.
    pub(super) fn take(&mut self, sequence: u64, kind: DataKind, time_us: i64) -> Vec<Due> {
        // It has been read already.
        if sequence <= self.last {
            return Vec::new();
        }
        self.last = sequence;
        if let DataKind::Window { node } = kind {
            // What the study does not have is of nobody.
            let Some(newest) = self.nodes.get_mut(&node) else { return Vec::new() };
            *newest = Some(time_us);
        }
        let number = time_us.div_euclid(self.every_us);
        if self.done.is_none_or(|done| number > done) {
            let begun = self.begun.entry(number).or_insert(Begun { first: sequence, has_windows: false });
            begun.has_windows |= matches!(kind, DataKind::Window { .. });
        }
        let mut due = Vec::new();
        while let Some(next) = self.over() {
            due.push(next);
        }
        due
    }

    /// The first interval with windows, where it is over.
    fn over(&mut self) -> Option<Due> {
        let (&number, begun) = self.begun.iter().find(|(_, begun)| begun.has_windows)?;
        let end_us = number.saturating_add(1).saturating_mul(self.every_us);
        let wait_us = LONGEST_WAIT_US.min(self.every_us / 2).max(LEAST_WAIT_US);
        let far_us = end_us.saturating_add(wait_us);
        let is_past = |newest: &Option<i64>, than_us: i64| newest.is_some_and(|time_us| time_us >= than_us);
        let is_over = self.nodes.values().all(|newest| is_past(newest, end_us))
            || self.nodes.values().any(|newest| is_past(newest, far_us));
        if !is_over {
            return None;
        }
        let from = begun.first;
        self.done = Some(number);
        self.begun = self.begun.split_off(&(number + 1));
        let later = self.begun.values().map(|begun| begun.first).min();
        Some(Due { number, from, to: self.last, next: later.unwrap_or(self.last + 1) })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const HOUR_US: i64 = 3_600_000_000;
    const MINUTE_US: i64 = 60_000_000;

    fn window(node: u16) -> DataKind {
        DataKind::Window { node }
    }

    #[test]
    fn an_interval_is_over_when_all_nodes_are_past_it_or_one_by_a_quarter_of_an_hour() {
        let mut ledger = Ledger::new(HOUR_US, &[3, 8], None);
        assert!(ledger.take(5, window(3), 10 * MINUTE_US).is_empty());
        assert!(ledger.take(6, window(8), 10 * MINUTE_US).is_empty());
        assert!(ledger.take(7, window(3), 61 * MINUTE_US).is_empty());
        // It is late, and belongs to the interval yet.
        assert!(ledger.take(8, window(8), 59 * MINUTE_US).is_empty());
        assert_eq!(ledger.take(9, window(8), 60 * MINUTE_US), [Due { number: 0, from: 5, to: 9, next: 7 }]);
        // What comes twice, or of a node that the study does not have, does not count; nor does a heartbeat.
        assert!(ledger.take(9, window(8), 200 * MINUTE_US).is_empty());
        assert!(ledger.take(10, window(4), 200 * MINUTE_US).is_empty());
        assert!(ledger.take(11, DataKind::Heartbeat, 200 * MINUTE_US).is_empty());
        assert!(ledger.take(12, window(3), 134 * MINUTE_US).is_empty());
        assert_eq!(ledger.take(13, window(3), 135 * MINUTE_US), [Due { number: 1, from: 7, to: 13, next: 11 }]);
        // An hour without windows is none.
        assert_eq!(ledger.take(14, window(3), 600 * MINUTE_US), [Due { number: 2, from: 12, to: 14, next: 11 }]);
        assert_eq!(ledger.take(15, window(3), 675 * MINUTE_US), [Due { number: 10, from: 14, to: 15, next: 15 }]);
    }

    /// Of intervals of ten seconds, a node that hangs for half a minute has all of its windows in them.
    #[test]
    fn a_node_that_hangs_for_seconds_is_waited_for_however_short_intervals_are() {
        const SECOND_US: i64 = 1_000_000;
        let mut ledger = Ledger::new(10 * SECOND_US, &[3, 8], None);
        let mut due = ledger.take(1, window(8), 5 * SECOND_US);
        due.extend((2..).zip(5..40).flat_map(|(sequence, s)| ledger.take(sequence, window(3), s * SECOND_US)));
        assert!(due.is_empty(), "{due:?}");
        due.extend((37..).zip(6..11).flat_map(|(sequence, s)| ledger.take(sequence, window(8), s * SECOND_US)));
        assert_eq!(due, [Due { number: 0, from: 1, to: 41, next: 7 }]);
        // For longer than a minute nothing waits.
        assert_eq!(ledger.take(42, window(3), 80 * SECOND_US).len(), 1);
    }

    proptest! {
        /// Whoever takes over after any interval comes to the same, whatever came late or did not come at all.
        #[test]
        fn who_goes_on_from_where_a_result_says_gets_the_same(
            steps in prop::collection::vec((0_u16..3, -40_i64..40, any::<bool>()), 1..400)
        ) {
            let nodes = [0, 1, 2];
            let mut time = 5 * HOUR_US;
            let messages: Vec<(u64, DataKind, i64)> = (1..)
                .zip(&steps)
                .map(|(sequence, &(node, jump, is_window))| {
                    time += 3 * MINUTE_US;
                    let kind = if is_window { window(node) } else { DataKind::Heartbeat };
                    (sequence, kind, time + jump * MINUTE_US)
                })
                .collect();
            let run = |from: u64, done: Option<i64>| -> Vec<Due> {
                let mut ledger = Ledger::new(HOUR_US, &nodes, done);
                let later = messages.iter().filter(|(sequence, ..)| *sequence >= from);
                later.flat_map(|&(sequence, kind, time_us)| ledger.take(sequence, kind, time_us)).collect()
            };
            let all = run(1, None);
            for (index, due) in all.iter().enumerate() {
                prop_assert_eq!(&run(due.next, Some(due.number)), &all[index + 1..]);
            }
            prop_assert!(all.is_sorted_by(|a, b| a.number < b.number));
        }
    }
}
