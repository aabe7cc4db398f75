//! What a study says, as validated types with units in their names.

use std::fmt;
use std::path::PathBuf;

/// A study as read from its folder, validated.
#[derive(Debug, Clone, PartialEq)]
pub struct Study {
    /// The study's folder; relative paths in `study.toml` start here.
    pub folder: PathBuf,
    /// What the structure is called.
    pub structure: Structure,
    /// The measurements, at least one for everything but a study of modes measured elsewhere.
    pub setups: Vec<Setup>,
    /// How to analyse them.
    pub analysis: Analysis,
    /// The finite element model, where the study has a beam.
    pub model: Option<Model>,
    /// What stands in `study.toml` for later versions of Belfry and has no influence on this one.
    pub unused: Vec<Unused>,
}

/// `[structure]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Structure {
    /// A name for titles.
    pub name: String,
}

/// `[[setup]]`: one measurement with its sensors in one arrangement.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// The setup's name, unique in the study.
    pub name: String,
    /// File patterns relative to the study's folder, in the order in which they follow each other in time.
    pub files: Vec<String>,
    /// The variable to read from MATLAB files that hold more than one matrix.
    pub variable: Option<String>,
    /// Rows per second.
    pub sampling_rate_hz: f64,
    /// What the recorded numbers are.
    pub unit: Unit,
    /// The sensors, in the order of `study.toml`; this is the channel order everywhere downstream.
    pub sensors: Vec<Sensor>,
}

/// What a recording's numbers are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// Acceleration in m/s².
    MetrePerSecondSquared,
    /// Acceleration in standard gravities.
    StandardGravity,
    /// Volts; every sensor then has a sensitivity.
    Volt,
    /// Velocity in m/s.
    MetrePerSecond,
}

/// `[[setup.sensor]]`: one measured direction at one place.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// The column's name, or its 1-based position where the file has no header.
    pub channel: String,
    /// The measurement point's name, unique within a setup; the channel's name unless given. Reference sensors are
    /// matched between setups by it.
    pub point: String,
    /// The sensor node that samples this channel.
    pub node: u16,
    /// Height in metres, where known. Identification needs none; comparison with a model does.
    pub elevation_m: Option<f64>,
    /// The direction that counts as positive.
    pub direction: Option<Direction>,
    /// Plan position from the beam axis in metres (global X, Y).
    pub offset_m: [f64; 2],
    /// Whether the same point stands in every setup.
    pub reference: bool,
    /// Recorded volts per m/s² (only with [`Unit::Volt`]).
    pub sensitivity_v_per_m_s2: Option<f64>,
    /// 1-based row of the model's matrices, instead of a place.
    pub dof: Option<usize>,
}

/// A sensor's positive direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Direction {
    /// Horizontal, degrees anticlockwise from +X seen from above.
    AzimuthDeg(f64),
    /// Vertical, positive up.
    Up,
}

/// `[analysis]`; what is `None` is chosen from the band and the recording's length.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Analysis {
    /// Lowest and highest frequency of interest.
    pub band_hz: Option<[f64; 2]>,
    /// Sampling rate after decimation.
    pub decimated_rate_hz: Option<f64>,
    /// Points a segment (a power of two from 256 to 4096).
    pub segment: Option<usize>,
}

/// `[model]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Path of the beam table, relative to the study's folder.
    pub beam: PathBuf,
    /// How far a segment's stiffness is trusted: one relative standard deviation.
    pub background_stiffness: Option<f64>,
    /// How far a segment's mass is trusted: one relative standard deviation.
    pub background_mass: Option<f64>,
    /// Height over which neighbouring segments err alike, in metres.
    pub correlation_length_m: Option<f64>,
    /// Effects already in the model, in the order of `study.toml`. Kept as written: nothing applies them yet, and
    /// [`Study::unused`] says so.
    pub effects: Vec<Effect>,
}

/// `[[model.effect]]`: a physical effect that the model has on top of its beam table.
#[derive(Debug, Clone, PartialEq)]
pub struct Effect {
    /// The effect's name in the catalogue, such as `base-rotation`.
    pub kind: String,
    /// The part after the @ (`"225.2m"`, `"ch07"`), for effects that have a place.
    pub location: Option<String>,
    /// Everything else as written: `value`, or parameters by their names.
    pub parameters: toml::Table,
}

/// Something in `study.toml` that this version of Belfry reads over.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unused {
    /// 1-based line in `study.toml`.
    pub line: usize,
    /// The section or key, such as `measured` or `model.matrices`.
    pub key: String,
}

impl fmt::Display for Unused {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { line, key } = self;
        write!(formatter, "`{key}` (study.toml line {line}) is for a later version of belfry and has no influence here")
    }
}
