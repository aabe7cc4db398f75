//! What a user should know of a recording before trusting it, in sentences.

use std::fmt;
use std::path::PathBuf;

use super::error::{FilePosition, is_summer_time};
use crate::numbers::{counted, is_or_are};

/// Channels of a setup that have something in common.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Affected {
    names: Vec<String>,
    of: usize,
}

impl Affected {
    /// Of the `of` channels of a setup, those of these names.
    pub fn new(names: impl IntoIterator<Item = impl Into<String>>, of: usize) -> Self {
        Self { names: names.into_iter().map(Into::into).collect(), of }
    }

    /// What is so in some of a setup's channels, once for all that have the same in common, in the order of the first of them; the
    /// channels come with their names.
    pub(crate) fn alike<'a, T: PartialEq>(channels: impl Iterator<Item = (&'a str, Option<T>)>) -> Vec<(T, Self)> {
        let mut of = 0;
        let mut groups: Vec<(T, Vec<&str>)> = Vec::new();
        for (name, what) in channels {
            of += 1;
            let Some(here) = what else { continue };
            match groups.iter_mut().find(|(other, _)| *other == here) {
                Some((_, names)) => names.push(name),
                None => groups.push((here, vec![name])),
            }
        }
        groups.into_iter().map(|(what, names)| (what, Self::new(names, of))).collect()
    }

    /// Their names.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// The word for one of them, or for several.
    pub(crate) fn verb(&self, one: &'static str, several: &'static str) -> &'static str {
        if self.names.len() == 1 { one } else { several }
    }
}

impl fmt::Display for Affected {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<String> = self.names.iter().map(|name| format!("\"{name}\"")).collect();
        let names = names.join(", ");
        match self.names.len() {
            1 => write!(formatter, "channel {names}"),
            2 if self.of == 2 => write!(formatter, "both channels"),
            all if all == self.of => write!(formatter, "all {all} channels"),
            some => write!(formatter, "{some} of {} channels ({names})", self.of),
        }
    }
}

/// What a user should know before trusting a recording.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs)] // the messages say what each field is
pub enum RecordWarning {
    /// The time column says that rows are missing, or the headers of two files do.
    TimeGap { position: FilePosition, rows: u64, seconds: f64, is_between_files: bool },
    /// More gaps than are worth listing; the figures are for all of them.
    TimeGaps { count: u64, rows: u64, seconds: f64 },
    /// By the start in its header, a file begins before those that it follows have ended; so do `more` others.
    Early { file: PathBuf, early_s: f64, more: usize },
    /// By the start in its header, a file's rows are not where they are put beside those of other loggers.
    Shifted { file: PathBuf, late_ms: f64, degrees_at_1_hz: f64 },
    /// Blank lines between rows, where no time column says whether rows are missing.
    BlankLines { position: FilePosition, count: u64 },
    /// The same samples of these channels are missing from rows that are there.
    MissingSamples { channels: Affected, samples: u64, seconds: f64, gap_count: u64, first: FilePosition, first_s: f64 },
    /// Numbers that no sensor gives; they count as missing.
    Impossible { channels: Affected, samples: u64, value: f64, first: FilePosition, first_s: f64 },
    /// More than half of the samples of these channels are missing.
    MostlyMissing { channels: Affected, percent: f64 },
    /// A logger's rows lie between those of the others.
    Offset { file: PathBuf, late_ms: f64, degrees_at_1_hz: f64 },
    /// Samples of these channels lie between those of the others.
    ChannelOffset { channels: Affected, late_ms: f64, degrees_at_1_hz: f64 },
    /// By their columns of times, the clocks of two loggers run apart.
    ClocksApart { file: PathBuf, other: PathBuf, rows: f64 },
    /// These channels do not move at all.
    Constant { channels: Affected, value: f64 },
}

impl fmt::Display for RecordWarning {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TimeGap { position, rows, seconds, is_between_files } => {
                // Headers have UTC.
                let hour = if is_summer_time(*seconds) && !is_between_files {
                    " (an hour is also what a clock that is put forward for summer leaves out: such a logger has no gap, and is to keep to winter time or UTC)"
                } else {
                    ""
                };
                write!(
                    formatter,
                    "{position}: gap in time: {} ({seconds:.3} s) {} missing in all channels before it, and counted as missing samples{hour}",
                    counted(*rows, "row"),
                    is_or_are(*rows)
                )
            }
            Self::TimeGaps { count, rows, seconds } => write!(
                formatter,
                "{count} gaps in time altogether: {rows} rows ({seconds:.3} s) are missing in all channels"
            ),
            Self::Early { file, early_s, more } => {
                let others = match more {
                    0 => String::new(),
                    1 => " (and so does 1 more file)".to_owned(),
                    more => format!(" (and so do {more} more files)"),
                };
                write!(
                    formatter,
                    "{} starts {early_s:.3} s before the files that it follows have ended, by the start time in its header{others}: files are joined in the order of `files`, so put them in the order of time, or make setups of their own of them",
                    file.display()
                )
            }
            Self::Shifted { file, late_ms, degrees_at_1_hz } => {
                let than = if *late_ms < 0.0 { "earlier" } else { "later" };
                write!(
                    formatter,
                    "{}: by the start time in its header its samples are {:.2} ms {than} than the rows where they stand beside the other loggers', which turns phases by {:.2}° at 1 Hz: make a setup of its own from there on",
                    file.display(),
                    late_ms.abs(),
                    degrees_at_1_hz.abs()
                )
            }
            Self::BlankLines { position, count } => {
                let what = match count {
                    1 => "a blank line between rows, which is skipped".to_owned(),
                    count => format!("the first of {count} blank lines between rows, which are skipped"),
                };
                write!(
                    formatter,
                    "{position}: {what}. Where samples are missing, write a row of NaN, or all later samples come too early"
                )
            }
            Self::MissingSamples { channels, samples, seconds, gap_count, first, first_s } => {
                let have = channels.verb("has", "have");
                let samples = counted(*samples, "sample");
                let (gaps, which, they) = match gap_count {
                    1 => (format!("a gap of {samples} ({seconds:.3} s)"), "", "it touches"),
                    count => (format!("{count} gaps, {samples} ({seconds:.3} s) in all"), ", the first", "they touch"),
                };
                let into = time_of_day(*first_s);
                write!(
                    formatter,
                    "{channels} {have} {gaps}{which} at {first}, {into} into the record; the analysis leaves out the segments that {they}"
                )
            }
            Self::Impossible { channels, samples, value, first, first_s } => {
                let (which, count) = if *samples == 1 { ("", "it counts") } else { (" the first", "they count") };
                let samples = counted(*samples, "sample");
                write!(
                    formatter,
                    "{channels}: {samples} that no sensor can give,{which} {value:.3e} at {first}, {} into the record: the file is damaged there; {count} as missing",
                    time_of_day(*first_s)
                )
            }
            Self::MostlyMissing { channels, percent } => {
                let sensors = channels.verb("the sensor", "these sensors");
                let of_each = channels.verb("", " of each");
                write!(
                    formatter,
                    "{channels}: {percent:.1} % of the samples{of_each} are missing; consider leaving {sensors} out of the setup"
                )
            }
            Self::Offset { file, late_ms, degrees_at_1_hz } => {
                let (off, side) = (late_ms.abs(), if *late_ms > 0.0 { "later" } else { "earlier" });
                write!(
                    formatter,
                    "{}: its samples are {off:.2} ms {side} than those of the setup's first logger, less than a row: its phases are off by {:.2}° at 1 Hz, and more above",
                    file.display(),
                    degrees_at_1_hz.abs()
                )
            }
            Self::ChannelOffset { channels, late_ms, degrees_at_1_hz } => {
                let (off, side) = (late_ms.abs(), if *late_ms > 0.0 { "later" } else { "earlier" });
                write!(
                    formatter,
                    "{channels}: the samples are {off:.2} ms {side} than the rows that they become: phases are off by {:.2}° at 1 Hz, and more above",
                    degrees_at_1_hz.abs()
                )
            }
            Self::ClocksApart { file, other, rows } => write!(
                formatter,
                "{}: its clock and that of {} run apart by {rows:.1} rows to the end; make setups of shorter parts, or let the loggers share a clock",
                file.display(),
                other.display()
            ),
            Self::Constant { channels, value } => write!(
                formatter,
                "{channels} {}: every sample is {value}; check {}, or leave {} out of the setup",
                channels.verb("is dead", "are dead"),
                channels.verb("the sensor and its cable", "the sensors and their cables"),
                channels.verb("the sensor", "them")
            ),
        }
    }
}

/// Hours, minutes and seconds.
pub(crate) fn time_of_day(seconds: f64) -> String {
    let seconds = seconds.round() as u64;
    format!("{}:{:02}:{:02}", seconds / 3600, seconds / 60 % 60, seconds % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_are_named_unless_all_are_meant() {
        let some = |names: &[&str], of: usize| Affected::new(names.iter().copied(), of).to_string();
        assert_eq!(some(&["a"], 1), "channel \"a\"");
        assert_eq!(some(&["a"], 20), "channel \"a\"");
        assert_eq!(some(&["a", "b"], 2), "both channels");
        assert_eq!(some(&["a", "b"], 3), "2 of 3 channels (\"a\", \"b\")");
        assert_eq!(some(&["a", "b", "c"], 3), "all 3 channels");
    }
}
