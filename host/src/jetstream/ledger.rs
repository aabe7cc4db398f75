//! Which intervals of a structure are over, by the messages of the stream alone.
//!
//! Messages flow in, in the order of the stream, by their headers; an interval flows out when all nodes have sent something of a later one and
//! nothing of it is missing by the numbers of windows, or when one is far ahead of the others. What belongs to it is then what has come until
//! now, and what comes later is too late. So an interval has the same windows whoever asks, and when: a result says where to go on, and from
//! there everything comes out as it would have.

use std::collections::BTreeMap;

use belfry_shared::message::WindowName;

use super::names::DataKind;

/// How long a node that is silent, or what is missing, is waited for, once another is past an interval, in µs; half an interval where that is
/// less, but a minute at least: a line that drops frames, or a machine that is busy, holds a node up for some seconds however short the
/// intervals are.
const LONGEST_WAIT_US: i64 = 900_000_000;
const LEAST_WAIT_US: i64 = 60_000_000;

/// A message, by its headers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arrived {
    /// Its place in the stream.
    pub(super) sequence: u64,
    /// What it is.
    pub(super) kind: DataKind,
    /// The time that it is of.
    pub(super) time_us: i64,
    /// The window that it is, where it says so.
    pub(super) window: Option<WindowName>,
}

/// An interval that is over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Due {
    /// Its number: whole intervals since the Unix epoch.
    pub(super) number: i64,
    /// The first message that belongs to it.
    pub(super) from: u64,
    /// The message that ended it.
    pub(super) to: u64,
    /// Where whoever goes on reads from: the first message of it or of a later one, whichever came first.
    pub(super) next: u64,
}

/// What has come of an interval.
#[derive(Debug, Clone, Copy)]
struct Begun {
    first: u64,
    has_windows: bool,
}

/// What has come of a node.
#[derive(Debug, Clone, Default)]
struct Node {
    /// The time of its last window.
    last_us: Option<i64>,
    /// The window of its highest number since it has started, and that window's time.
    highest: Option<(WindowName, i64)>,
    gaps: Vec<Gap>,
}

/// Windows between two that have come: they are sent again.
#[derive(Debug, Clone, Copy)]
struct Gap {
    boot: u32,
    first: u32,
    last: u32,
    /// The time of the window before.
    after_us: i64,
    /// The same, when the gap was first seen.
    since_us: i64,
}

impl Node {
    /// Takes note of a window. What is missing before `from_us` is of intervals that are done.
    fn note(&mut self, window: WindowName, time_us: i64, from_us: i64) {
        if let Some(at) = self.gaps.iter().position(|gap| gap.has(&window)) {
            let gap = self.gaps.swap_remove(at);
            self.gaps.extend(gap.without(window.number, time_us));
            return;
        }
        if let Some((highest, highest_us)) = self.highest.filter(|(highest, _)| highest.boot == window.boot) {
            if window.number <= highest.number {
                return;
            }
            let gap = Gap {
                boot: window.boot,
                first: highest.number + 1,
                last: window.number - 1,
                after_us: highest_us,
                since_us: highest_us,
            };
            self.gaps.extend(Some(gap).filter(|gap| gap.first <= gap.last && gap.since_us >= from_us));
        }
        self.highest = Some((window, time_us));
    }

    /// Whether it has sent something of after an interval, and nothing of before that is missing. A gap in the interval before counts, or the
    /// one that waited for it would end the next later than one who goes on from its result.
    fn is_past(&self, end_us: i64) -> bool {
        let is_missing = self.gaps.iter().any(|gap| gap.after_us < end_us);
        self.last_us.is_some_and(|time_us| time_us >= end_us) && !is_missing
    }
}

impl Gap {
    fn has(&self, window: &WindowName) -> bool {
        window.boot == self.boot && (self.first..=self.last).contains(&window.number)
    }

    /// What is left of it on both sides of a window that has come.
    fn without(self, number: u32, time_us: i64) -> impl Iterator<Item = Self> {
        let before = (number > self.first).then(|| Self { last: number - 1, ..self });
        let behind = (number < self.last).then(|| Self { first: number + 1, after_us: time_us, ..self });
        before.into_iter().chain(behind)
    }
}

/// The messages of a structure.
#[derive(Debug, Clone)]
pub(super) struct Ledger {
    every_us: i64,
    nodes: BTreeMap<u16, Node>,
    /// The last interval that is done.
    done: Option<i64>,
    begun: BTreeMap<i64, Begun>,
    /// The last message.
    last: u64,
}

impl Ledger {
    /// Of a structure with these nodes, of which `done` is done.
    pub(super) fn new(every_us: i64, nodes: &[u16], done: Option<i64>) -> Self {
        let nodes = nodes.iter().map(|&node| (node, Node::default())).collect();
        Self { every_us: every_us.max(1), nodes, done, begun: BTreeMap::new(), last: 0 }
    }

    /// Takes a message; the intervals that are over with it.
    pub(super) fn take(&mut self, arrived: Arrived) -> Vec<Due> {
        let Arrived { sequence, kind, time_us, window } = arrived;
        // It has been read already.
        if sequence <= self.last {
            return Vec::new();
        }
        self.last = sequence;
        if let DataKind::Window { node } = kind {
            let from_us = self.done.map_or(i64::MIN, |done| self.start_us(done));
            // What the study does not have is of nobody.
            let Some(node) = self.nodes.get_mut(&node) else { return Vec::new() };
            node.last_us = Some(time_us);
            if let Some(window) = window {
                node.note(window, time_us, from_us);
            }
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

    fn start_us(&self, number: i64) -> i64 {
        number.saturating_mul(self.every_us)
    }

    /// The first interval with windows, where it is over.
    fn over(&mut self) -> Option<Due> {
        let (&number, begun) = self.begun.iter().find(|(_, begun)| begun.has_windows)?;
        let from = begun.first;
        let (start_us, end_us) = (self.start_us(number), self.start_us(number.saturating_add(1)));
        let wait_us = LONGEST_WAIT_US.min(self.every_us / 2).max(LEAST_WAIT_US);
        let far_us = end_us.saturating_add(wait_us);
        let is_far = |node: &Node| node.last_us.is_some_and(|time_us| time_us >= far_us);
        let is_over = self.nodes.values().all(|node| node.is_past(end_us)) || self.nodes.values().any(is_far);
        if !is_over {
            return None;
        }
        self.done = Some(number);
        // Whoever goes on from here reads nothing of before.
        self.nodes.values_mut().for_each(|node| node.gaps.retain(|gap| gap.since_us >= start_us));
        self.begun = self.begun.split_off(&(number + 1));
        let later = self.begun.values().map(|begun| begun.first).min();
        Some(Due { number, from, to: self.last, next: later.map_or(from, |later| later.min(from)) })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const HOUR_US: i64 = 3_600_000_000;
    const MINUTE_US: i64 = 60_000_000;
    const SECOND_US: i64 = 1_000_000;

    fn window(node: u16) -> DataKind {
        DataKind::Window { node }
    }

    /// A message that does not say which window it is.
    fn take(ledger: &mut Ledger, sequence: u64, kind: DataKind, time_us: i64) -> Vec<Due> {
        ledger.take(Arrived { sequence, kind, time_us, window: None })
    }

    fn named(sequence: u64, node: u16, number: u32, time_us: i64) -> Arrived {
        Arrived { sequence, kind: window(node), time_us, window: Some(WindowName { node, boot: 1, number }) }
    }

    #[test]
    fn an_interval_is_over_when_all_nodes_are_past_it_or_one_by_a_quarter_of_an_hour() {
        let mut ledger = Ledger::new(HOUR_US, &[3, 8], None);
        assert!(take(&mut ledger, 5, window(3), 10 * MINUTE_US).is_empty());
        assert!(take(&mut ledger, 6, window(8), 10 * MINUTE_US).is_empty());
        assert!(take(&mut ledger, 7, window(3), 61 * MINUTE_US).is_empty());
        // It is late, and belongs to the interval yet.
        assert!(take(&mut ledger, 8, window(8), 59 * MINUTE_US).is_empty());
        let due = take(&mut ledger, 9, window(8), 60 * MINUTE_US);
        assert_eq!(due, [Due { number: 0, from: 5, to: 9, next: 5 }]);
        // What comes twice, or of a node that the study does not have, does not count; nor does a heartbeat.
        assert!(take(&mut ledger, 9, window(8), 200 * MINUTE_US).is_empty());
        assert!(take(&mut ledger, 10, window(4), 200 * MINUTE_US).is_empty());
        assert!(take(&mut ledger, 11, DataKind::Heartbeat, 200 * MINUTE_US).is_empty());
        assert!(take(&mut ledger, 12, window(3), 134 * MINUTE_US).is_empty());
        let due = take(&mut ledger, 13, window(3), 135 * MINUTE_US);
        assert_eq!(due, [Due { number: 1, from: 7, to: 13, next: 7 }]);
        // An hour without windows is none.
        let due = take(&mut ledger, 14, window(3), 600 * MINUTE_US);
        assert_eq!(due, [Due { number: 2, from: 12, to: 14, next: 11 }]);
        let due = take(&mut ledger, 15, window(3), 675 * MINUTE_US);
        assert_eq!(due, [Due { number: 10, from: 14, to: 15, next: 14 }]);
    }

    /// Of intervals of ten seconds, a node that hangs for half a minute has all of its windows in them.
    #[test]
    fn a_node_that_hangs_for_seconds_is_waited_for_however_short_intervals_are() {
        let mut ledger = Ledger::new(10 * SECOND_US, &[3, 8], None);
        let mut due = take(&mut ledger, 1, window(8), 5 * SECOND_US);
        due.extend((2..).zip(5..40).flat_map(|(sequence, s)| take(&mut ledger, sequence, window(3), s * SECOND_US)));
        assert!(due.is_empty(), "{due:?}");
        due.extend((37..).zip(6..11).flat_map(|(sequence, s)| take(&mut ledger, sequence, window(8), s * SECOND_US)));
        assert_eq!(due, [Due { number: 0, from: 1, to: 41, next: 1 }]);
        // For longer than a minute nothing waits.
        assert_eq!(take(&mut ledger, 42, window(3), 80 * SECOND_US).len(), 1);
    }

    /// Windows that were on their way when a gateway died are sent again, behind newer ones: they belong to their interval yet, and hold up no
    /// other. What never comes is waited for a minute.
    #[test]
    fn what_is_missing_by_its_number_is_waited_for() {
        let mut ledger = Ledger::new(10 * SECOND_US, &[3], None);
        assert!(ledger.take(named(1, 3, 6, 6 * SECOND_US)).is_empty());
        // 7, 8 and 9 are missing.
        assert!(ledger.take(named(2, 3, 10, 10 * SECOND_US)).is_empty());
        assert!(ledger.take(named(3, 3, 8, 8 * SECOND_US)).is_empty());
        assert!(ledger.take(named(4, 3, 7, 7 * SECOND_US)).is_empty());
        assert!(ledger.take(named(5, 3, 9, 9 * SECOND_US)).is_empty());
        // The last window is one of before: a newer one ends the interval.
        assert_eq!(ledger.take(named(6, 3, 11, 11 * SECOND_US)), [Due { number: 0, from: 1, to: 6, next: 1 }]);
        // 12 to 14 never come.
        assert!(ledger.take(named(7, 3, 15, 15 * SECOND_US)).is_empty());
        assert!(ledger.take(named(8, 3, 24, 24 * SECOND_US)).is_empty());
        assert!(ledger.take(named(9, 3, 26, 26 * SECOND_US)).is_empty());
        assert!(ledger.take(named(10, 3, 79, 79 * SECOND_US)).is_empty());
        assert_eq!(ledger.take(named(11, 3, 80, 80 * SECOND_US)).len(), 1);
        // A node that has started anew has no gap to what it sent before.
        let mut ledger = Ledger::new(10 * SECOND_US, &[3], None);
        assert!(ledger.take(named(1, 3, 6, 6 * SECOND_US)).is_empty());
        let anew = WindowName { node: 3, boot: 2, number: 4 };
        assert_eq!(ledger.take(Arrived { window: Some(anew), ..named(2, 3, 0, 11 * SECOND_US) }).len(), 1);
    }

    proptest! {
        /// Whoever takes over after any interval comes to the same, whatever came late, was sent again or did not come at all.
        #[test]
        fn who_goes_on_from_where_a_result_says_gets_the_same(
            steps in prop::collection::vec((0_u16..3, prop::option::of(-40_i64..40)), 1..400),
            numbers in prop::collection::vec((0_usize..400, 0_usize..400), 0..60),
            lost in prop::collection::vec(0_usize..400, 0..20),
            every_us in prop::sample::select(vec![4 * MINUTE_US, 20 * MINUTE_US, HOUR_US]),
        ) {
            let nodes = [0, 1, 2];
            let mut time = 5 * HOUR_US;
            let mut counts = [0; 3];
            let mut sent: Vec<(DataKind, i64, Option<WindowName>)> = steps
                .iter()
                .map(|&(node, jump)| {
                    time += 3 * MINUTE_US;
                    if let Some(jump) = jump {
                        return (DataKind::Heartbeat, time + jump * MINUTE_US, None);
                    }
                    let number = &mut counts[usize::from(node)];
                    *number += 1;
                    let name = WindowName { node, boot: 1, number: *number };
                    // Each clock is off by as much as ever.
                    (window(node), time + i64::from(node) * 11 * MINUTE_US, Some(name))
                })
                .collect();
            let count = sent.len();
            numbers.iter().for_each(|&(one, other)| sent.swap(one % count, other % count));
            let mut at = 0;
            sent.retain(|_| {
                at += 1;
                !lost.contains(&at)
            });
            let messages: Vec<Arrived> = (1..)
                .zip(&sent)
                .map(|(sequence, &(kind, time_us, window))| Arrived { sequence, kind, time_us, window })
                .collect();
            let run = |from: u64, done: Option<i64>| -> Vec<Due> {
                let mut ledger = Ledger::new(every_us, &nodes, done);
                messages.iter().filter(|arrived| arrived.sequence >= from).flat_map(|&arrived| ledger.take(arrived)).collect()
            };
            let all = run(1, None);
            for (index, due) in all.iter().enumerate() {
                prop_assert_eq!(&run(due.next, Some(due.number)), &all[index + 1..]);
            }
            prop_assert!(all.is_sorted_by(|a, b| a.number < b.number));
        }
    }
}
