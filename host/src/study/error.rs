//! What can be wrong with a study: where, what was expected, and what to do.

use std::fmt;
use std::path::PathBuf;

use thiserror::Error;

/// A key in a study's file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FilePosition {
    /// The study's file.
    pub file: PathBuf,
    /// 1-based line.
    pub line: usize,
    /// Dotted key such as `setup.sensor.node`; empty for the document as a whole.
    pub key: String,
}

impl fmt::Display for FilePosition {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}, line {}", self.file.display(), self.line)?;
        if self.key.is_empty() { Ok(()) } else { write!(formatter, ", `{}`", self.key) }
    }
}

/// Why a study cannot be used.
#[derive(Debug, Error)]
pub enum StudyError {
    /// A table of places.
    #[error(transparent)]
    Places(#[from] super::places::PlacesError),
    /// The file cannot be written.
    #[error("{file}: cannot be written ({source})", file = .file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is absent or unreadable.
    #[error("cannot read {}; name a study's folder, or make a new study with `belfry init`", file.display())]
    Read {
        /// The file that should hold the study.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// More sensors than any analysis of all of them against each other could take.
    #[error(
        "{position}: {found} sensors, where one measurement has {most} at most: make setups of parts that share reference points"
    )]
    TooManySensors {
        /// The first of them.
        position: FilePosition,
        /// How many there are.
        found: usize,
        /// How many there may be.
        most: usize,
    },
    /// The file is no TOML.
    #[error("{}, line {line}: {message}; see https://toml.io for how TOML is written", file.display())]
    Syntax {
        /// The study's file.
        file: PathBuf,
        /// 1-based line.
        line: usize,
        /// What the parser found.
        message: String,
    },
    /// A key that Belfry does not know.
    #[error("{position}: unknown key{}; known here: {}", did_you_mean(*near), known.join(", "))]
    UnknownKey {
        /// The key.
        position: FilePosition,
        /// The known key that it most resembles, if any does.
        near: Option<&'static str>,
        /// All keys known there.
        known: &'static [&'static str],
    },
    /// A key that has to be there is not.
    #[error("{}, line {}: {} needs `{name}`: {expected}", position.file.display(), position.line, table_name(table))]
    Missing {
        /// The table that lacks it.
        position: FilePosition,
        /// The key that is missing.
        name: String,
        /// What should stand there.
        expected: &'static str,
        /// The table's dotted key.
        table: String,
    },
    /// Another type than expected.
    #[error("{position}: expected {expected}, found {found}", found = with_article(found))]
    WrongType {
        /// The key.
        position: FilePosition,
        /// The TOML type that stands there.
        found: &'static str,
        /// What should stand there.
        expected: &'static str,
    },
    /// The right type, but a value that cannot be meant.
    #[error("{position}: expected {expected}, found {found}")]
    OutOfRange {
        /// The key.
        position: FilePosition,
        /// The value as written.
        found: String,
        /// What should stand there.
        expected: &'static str,
    },
    /// A unit that Belfry cannot convert.
    #[error(
        "{position}: unknown unit {found}; use \"m/s2\", \"g\", \"V\" (with a sensitivity for every sensor), \"m/s\", \
         \"m\", \"rad\" or \"strain\""
    )]
    UnknownUnit {
        /// The key.
        position: FilePosition,
        /// The unit as written.
        found: String,
    },
    /// A file pattern that cannot match anything.
    #[error("{position}: {pattern:?} is no file pattern; use * for any characters and [abc] for one of several")]
    Pattern {
        /// The list of patterns.
        position: FilePosition,
        /// The pattern.
        pattern: String,
        /// What is wrong with it.
        source: glob::PatternError,
    },
    /// A name that has to be unique stands twice.
    #[error("{position}: {name:?} is already used in line {first_line}; {advice}")]
    Duplicate {
        /// The second.
        position: FilePosition,
        /// The name.
        name: String,
        /// Line of the first.
        first_line: usize,
        /// What makes it unique.
        advice: &'static str,
    },
    /// A node samples at most four channels.
    #[error(
        "{position}: channel {channel:?} is the fifth of node {node} in setup {setup:?}; a node has at most \
         {limit} channels, so give it to another node"
    )]
    NodeFull {
        /// The sensor's node.
        position: FilePosition,
        /// The setup.
        setup: String,
        /// The sensor that has no room.
        channel: String,
        /// The node.
        node: u16,
        /// How many channels a node has.
        limit: usize,
    },
    /// Volts say nothing without a sensitivity.
    #[error(
        "{position}: channel {channel:?} needs `sensitivity_v_per_m_s2` (volts per m/s²), as setup {setup:?} \
         is recorded in V"
    )]
    NoSensitivity {
        /// The sensor.
        position: FilePosition,
        /// The setup.
        setup: String,
        /// The sensor's channel.
        channel: String,
    },
    /// A sensitivity where the recording is in a unit already.
    #[error(
        "{position}: channel {channel:?} has a sensitivity, but setup {setup:?} is not recorded in volts; \
         remove it, or set `unit = \"V\"`"
    )]
    NeedlessSensitivity {
        /// The sensitivity.
        position: FilePosition,
        /// The setup.
        setup: String,
        /// The sensor's channel.
        channel: String,
    },
    /// The band's ends are the wrong way round.
    #[error("{position}: the band starts at {low_hz} Hz and ends at {high_hz} Hz; write the lower frequency first")]
    BandReversed {
        /// The band.
        position: FilePosition,
        /// What stands first.
        low_hz: f64,
        /// What stands second.
        high_hz: f64,
    },
    /// The band reaches beyond what the sampling rate can show.
    #[error(
        "{position}: the band ends at {high_hz} Hz, but setup {setup:?} shows nothing above {limit_hz} Hz \
         ({reason}); end the band there or below{}",
        if *decimated { ", or raise `decimated_rate_hz`" } else { "" }
    )]
    BandTooHigh {
        /// The band.
        position: FilePosition,
        /// The setup with the lowest limit.
        setup: String,
        /// Where the band ends.
        high_hz: f64,
        /// Up to where there is something to see.
        limit_hz: f64,
        /// Where the limit comes from.
        reason: &'static str,
        /// Whether it is the decimated rate that limits.
        decimated: bool,
    },
    /// The recording cannot be brought to the decimated rate.
    #[error(
        "{position}: {decimated_rate_hz} Hz cannot be reached from the {sampling_rate_hz} Hz of setup \
         {setup:?}; divide the sampling rate by a whole number made of up to three factors from 2 to 10, or \
         leave the key out"
    )]
    DecimatedRate {
        /// The decimated rate.
        position: FilePosition,
        /// The setup.
        setup: String,
        /// What is asked for.
        decimated_rate_hz: f64,
        /// What was recorded.
        sampling_rate_hz: f64,
    },
    /// Several setups that nothing ties together.
    #[error(
        "{position}: no point is a reference in every setup ({references}), so their shapes cannot be put \
         together; give the sensors that stayed in place the same `point` and `reference = true` in every \
         setup"
    )]
    NoCommonReference {
        /// The first setup that has none of the reference points before it.
        position: FilePosition,
        /// The reference points of each setup.
        references: String,
    },
    /// A reference point that is not where it was.
    #[error(
        "{position}: reference point {point:?} has another position or direction than in line \
         {first_line}; a reference stays in place, so correct one of the two or give it another `point`"
    )]
    ReferenceMoved {
        /// The later sensor.
        position: FilePosition,
        /// The point.
        point: String,
        /// Line of the earlier sensor.
        first_line: usize,
    },
    /// No measurement at all.
    #[error(
        "{} says nothing of sensors; add a [[setup]] with its [[setup.sensor]] (a recording), or [measured] \
         with [[sensor]] (modes from elsewhere)",
        file.display()
    )]
    NothingMeasured {
        /// The study's file.
        file: PathBuf,
    },
    /// Both a recording and modes from elsewhere.
    #[error(
        "{position}: a study has either [measured] (modes from elsewhere) or [[setup]] (line {setup_line}: a recording), this one has both; remove one"
    )]
    MeasuredTwice {
        /// `[measured]`.
        position: FilePosition,
        /// Line of the first setup.
        setup_line: usize,
    },
    /// A sensor that belongs to no setup.
    #[error(
        "{position}: a sensor of a recording stands under its setup as [[setup.sensor]]; [[sensor]] goes with [measured]"
    )]
    SensorOutsideSetup {
        /// The sensor.
        position: FilePosition,
    },
    /// Two layouts.
    #[error("{position}: matrices have either `nodes` or `dofs`; remove one")]
    LayoutTwice {
        /// The second.
        position: FilePosition,
    },
    /// A model of nothing, or of two things.
    #[error(
        "{position}: a model has one of `beam`, `matrices` and `modes`, this one has {}",
        if *several { "more than one; remove all but one" } else { "none; write for instance beam = \"beam.csv\"" }
    )]
    ModelSource {
        /// The model.
        position: FilePosition,
        /// Whether more than one is there.
        several: bool,
    },
}

fn did_you_mean(near: Option<&str>) -> String {
    near.map(|near| format!(" (did you mean `{near}`?)")).unwrap_or_default()
}

fn table_name(table: &str) -> String {
    match table {
        "" => "the study".to_owned(),
        "setup" | "setup.sensor" | "model.effect" => format!("[[{table}]]"),
        _ => format!("[{table}]"),
    }
}

fn with_article(kind: &str) -> String {
    let article = if kind.starts_with(['a', 'i']) { "an" } else { "a" };
    format!("{article} {kind}")
}
