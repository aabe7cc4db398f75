//! What a campaign has come to: windows, losses, faults, and what is not as it should be.

use std::collections::BTreeMap;
use std::fmt;

use belfry_host::collect::{Event, Happening, PortState};
use belfry_host::link::memory::Befallen;

/// Violations that are printed.
const MOST_SAID: usize = 20;

/// The counts of a campaign.
#[derive(Debug, Clone, Default)]
pub struct Report {
    /// Draws everything.
    pub seed: u64,
    /// Runs that were made.
    pub runs: u64,
    /// Days times nodes.
    pub node_days: f64,
    /// Lives of nodes, from one start to the next.
    pub lives: u64,
    /// Windows that nodes have made.
    pub made: u64,
    /// Of these, those in the archive, each once and as it was sent.
    pub stored: u64,
    /// Windows in the archive of which a channel has no sound data.
    pub gaps: u64,
    /// Of those made, those listed as lost, by reason.
    pub lost: BTreeMap<String, u64>,
    /// Faults that were put in, by kind.
    pub faults: BTreeMap<&'static str, u64>,
    /// Why ports were refused, and how often.
    pub refused: BTreeMap<String, u64>,
    /// What is not as it should be.
    pub violations: Vec<String>,
}

impl Report {
    pub(super) fn new(seed: u64) -> Self {
        Self { seed, ..Self::default() }
    }

    pub(super) fn fault(&mut self, kind: &'static str) {
        *self.faults.entry(kind).or_default() += 1;
    }

    pub(super) fn befell(&mut self, befallen: &Befallen) {
        let Befallen { drop, flip, lose_byte, insert, duplicate, reorder, split, stall } = *befallen;
        let kinds = [
            ("frame dropped", drop),
            ("frame with a flipped bit", flip),
            ("frame with a byte too few", lose_byte),
            ("frame with a byte too many", insert),
            ("frame duplicated", duplicate),
            ("frames in another order", reorder),
            ("frame in two pieces", split),
            ("line stalled", stall),
        ];
        for (kind, count) in kinds.into_iter().filter(|(_, count)| *count > 0) {
            *self.faults.entry(kind).or_default() += count;
        }
    }

    pub(super) fn happened(&mut self, events: &[Event]) {
        for event in events {
            if let Happening::State(PortState::Refused(reason)) = &event.what {
                *self.refused.entry(reason.clone()).or_default() += 1;
            }
        }
    }

    pub(super) fn lose(&mut self, reason: &str) {
        *self.lost.entry(reason.to_owned()).or_default() += 1;
    }

    pub(super) fn add(&mut self, other: Self) {
        self.runs += other.runs;
        self.node_days += other.node_days;
        self.lives += other.lives;
        self.made += other.made;
        self.stored += other.stored;
        self.gaps += other.gaps;
        other.lost.into_iter().for_each(|(reason, count)| *self.lost.entry(reason).or_default() += count);
        other.faults.into_iter().for_each(|(kind, count)| *self.faults.entry(kind).or_default() += count);
        other.refused.into_iter().for_each(|(reason, count)| *self.refused.entry(reason).or_default() += count);
        self.violations.extend(other.violations);
    }
}

impl fmt::Display for Report {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lost: u64 = self.lost.values().sum();
        writeln!(
            formatter,
            "seed {}: {:.1} node-days in {} runs, {} lives of nodes",
            self.seed, self.node_days, self.runs, self.lives
        )?;
        writeln!(
            formatter,
            "windows: {} made, {} stored ({} of them with a gap), {lost} lost",
            self.made, self.stored, self.gaps
        )?;
        for (reason, count) in &self.lost {
            writeln!(formatter, "  lost, {reason}: {count}")?;
        }
        writeln!(formatter, "faults:")?;
        for (kind, count) in &self.faults {
            writeln!(formatter, "  {kind}: {count}")?;
        }
        for (reason, count) in &self.refused {
            writeln!(formatter, "refused {count} times: {reason}")?;
        }
        for violation in self.violations.iter().take(MOST_SAID) {
            writeln!(formatter, "WRONG: {violation}")?;
        }
        write!(formatter, "{} things are wrong", self.violations.len())
    }
}
