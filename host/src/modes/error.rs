//! Why a file of modes was refused.

use std::path::PathBuf;

use thiserror::Error;

/// Why a file of modes was refused.
#[derive(Debug, Error)]
pub enum MeasuredError {
    /// It cannot be opened.
    #[error("{}: cannot be read ({source}); [measured] modes in study.toml names the file of modes", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A run of the user's own program that cannot be opened.
    #[error("{}: cannot be read ({source}); [model] modes or a [[model.run]] in study.toml names it", file.display())]
    UnreadableRun {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A computed shape that is not real.
    #[error(
        "{}, mode {number}, {place}: the shape is complex; a run is of the undamped structure that does not rotate, whose shapes are real",
        file.display()
    )]
    Complex {
        /// The file.
        file: PathBuf,
        /// The mode.
        number: usize,
        /// The place.
        place: String,
    },
    /// A computed shape with a gap.
    #[error("{}, mode {number}: no component at {place}; a run has all of its modes at all of its places", file.display())]
    NoComponent {
        /// The file.
        file: PathBuf,
        /// The mode.
        number: usize,
        /// The place.
        place: String,
    },
    /// Its text is not what its format wants.
    #[error("{}, line {line}: {reason}", file.display())]
    Syntax {
        /// The file.
        file: PathBuf,
        /// 1-based line.
        line: u64,
        /// What is wrong.
        reason: String,
    },
    /// A cell that is no number.
    #[error("{}, line {line}, column `{column}`: `{value}` where {expected} was expected", file.display())]
    Value {
        /// The file.
        file: PathBuf,
        /// 1-based line.
        line: u64,
        /// The column.
        column: String,
        /// What stands there.
        value: String,
        /// What should.
        expected: &'static str,
    },
    /// A channel that the study does not have.
    #[error("{}: `{channel}` is no channel or point of the study; it has {known}", file.display())]
    UnknownChannel {
        /// The file.
        file: PathBuf,
        /// The name in the file.
        channel: String,
        /// The study's channels.
        known: String,
    },
    /// A channel twice in one shape.
    #[error("{}, mode {number}: channel {channel} has two components", file.display())]
    ChannelTwice {
        /// The file.
        file: PathBuf,
        /// The mode.
        number: usize,
        /// The channel.
        channel: String,
    },
    /// Two modes of one number.
    #[error("{}: two modes have the number {number}; give each its own", file.display())]
    SameNumber {
        /// The file.
        file: PathBuf,
        /// The number.
        number: usize,
    },
    /// Two modes that are said to be one of the model's.
    #[error(
        "{}, line {line}: model_mode {number} is that of measured mode {other} already; each of the model's modes has one partner, and an empty cell leaves it open", file.display()
    )]
    SameModelMode {
        /// The file.
        file: PathBuf,
        /// 1-based line.
        line: u64,
        /// The number of the model's mode.
        number: usize,
        /// The measured mode that has it.
        other: usize,
    },
    /// A mode that the model does not have.
    #[error(
        "{}, line {line}: model_mode {number}, but the model as first given has {modes} modes; they count from 1, lowest frequency first, as `belfry compare` shows them", file.display()
    )]
    NoSuchModelMode {
        /// The file.
        file: PathBuf,
        /// 1-based line.
        line: u64,
        /// The number in the file.
        number: usize,
        /// How many modes the model has.
        modes: usize,
    },
    /// A frequency that none can be.
    #[error("{}, mode {number}: the frequency is {frequency_hz} Hz; expected a number above 0", file.display())]
    Frequency {
        /// The file.
        file: PathBuf,
        /// The mode.
        number: usize,
        /// What stands there.
        frequency_hz: f64,
    },
    /// A component that is infinite.
    #[error("{}, mode {number}, channel {channel}: the shape's component is not a finite number", file.display())]
    Infinite {
        /// The file.
        file: PathBuf,
        /// The mode.
        number: usize,
        /// The channel.
        channel: String,
    },
    /// A shape of zeros.
    #[error("{}, mode {number}: every known component of its shape is zero", file.display())]
    ZeroShape {
        /// The file.
        file: PathBuf,
        /// The mode.
        number: usize,
    },
    /// Nothing in it.
    #[error("{}: no modes in it", file.display())]
    NoModes {
        /// The file.
        file: PathBuf,
    },
    /// Node labels that belong to no sensor.
    #[error(
        "{}: node {node}, direction {direction} belongs to no sensor; name a channel (or its `point`) by node label and direction, such as \"{node}{direction}\" - the study has {known}",
        file.display()
    )]
    UnknownNode {
        /// The file.
        file: PathBuf,
        /// The label.
        node: i64,
        /// `x`, `y` or `z`.
        direction: &'static str,
        /// The study's channels.
        known: String,
    },
}
