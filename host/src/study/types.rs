//! What a study says, as validated types with units in their names.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::alarms::Alarms;
use crate::archive::TimeRange;

/// The file of a study that a user writes.
pub const STUDY_FILE: &str = "study.toml";

/// A study as read from its folder, validated.
#[derive(Debug, Clone, PartialEq)]
pub struct Study {
    /// The study's folder; relative paths in `study.toml` start here.
    pub folder: PathBuf,
    /// What the structure is called.
    pub structure: Structure,
    /// The measurements, at least one for everything but a study of modes measured elsewhere.
    pub setups: Vec<Setup>,
    /// Modes identified elsewhere, instead of setups.
    pub measured: Option<MeasuredSource>,
    /// How to analyse them.
    pub analysis: Analysis,
    /// The finite element model, where the study has one.
    pub model: Option<Model>,
    /// Who hears of a watch's alarms.
    pub alarms: Alarms,
    /// Which part of what nodes have sent is analysed: all, where a command names none.
    pub range: TimeRange,
}

/// `[structure]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Structure {
    /// A name for titles.
    pub name: String,
    /// Latitude and longitude in degrees, for maps.
    pub place_deg: Option<[f64; 2]>,
}

/// `[measured]`: modes identified elsewhere, with the sensors that they stand at.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredSource {
    /// The file of modes, relative to the study's folder.
    pub modes: PathBuf,
    /// `[[sensor]]`; none where only frequencies were measured.
    pub sensors: Vec<Sensor>,
}

/// `[[setup]]`: one measurement with its sensors in one arrangement.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// The setup's name, unique in the study.
    pub name: String,
    /// File patterns relative to the study's folder, in the order in which they follow each other in time; none where
    /// `live`.
    pub files: Vec<String>,
    /// Measured by nodes whose windows are collected into the study's archive, instead of files.
    pub live: bool,
    /// The variable to read from MATLAB files that hold more than one matrix.
    pub variable: Option<String>,
    /// Rows per second.
    pub sampling_rate_hz: f64,
    /// Length of the blocks that each file is joined of, in s: between one and the next time is missing that nothing tells.
    pub block_s: Option<f64>,
    /// Hours by which the clock of a logger that writes dates and times is ahead of UTC; none where nobody says it.
    pub utc_offset_h: Option<f64>,
    /// What the recorded numbers are, but for sensors that say otherwise.
    pub unit: Unit,
    /// A table of temperatures beside the recording, relative to the study's folder.
    pub temperature: Option<PathBuf>,
    /// The sensors, in the order of `study.toml`; this is the channel order everywhere downstream.
    pub sensors: Vec<Sensor>,
}

/// Standard gravity in m/s².
pub const STANDARD_GRAVITY_M_S2: f64 = 9.806_65;

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
    /// Displacement in m.
    Metre,
    /// Inclination in rad.
    Radian,
    /// Vertical strain, a pure number.
    Strain,
}

/// Which motion of a point numbers are of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    /// In m/s².
    Acceleration,
    /// In m/s.
    Velocity,
    /// In m.
    Displacement,
    /// By how much the axis leans towards the sensor's direction, in rad.
    Tilt,
    /// How much longer the fibre at the sensor is, relative.
    Strain,
}

impl Motion {
    /// Its SI unit; 1 of a pure number.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Acceleration => "m/s²",
            Self::Velocity => "m/s",
            Self::Displacement => "m",
            Self::Tilt => "rad",
            Self::Strain => "1",
        }
    }
}

impl Unit {
    /// The unit that study.toml has this word for.
    pub fn of_word(word: &str) -> Option<Self> {
        Some(match word {
            "m/s2" => Self::MetrePerSecondSquared,
            "g" => Self::StandardGravity,
            "V" => Self::Volt,
            "m/s" => Self::MetrePerSecond,
            "m" => Self::Metre,
            "rad" => Self::Radian,
            "strain" => Self::Strain,
            _ => return None,
        })
    }

    /// The motion that it measures; volts stand for accelerations.
    pub fn motion(self) -> Motion {
        match self {
            Self::MetrePerSecondSquared | Self::StandardGravity | Self::Volt => Motion::Acceleration,
            Self::MetrePerSecond => Motion::Velocity,
            Self::Metre => Motion::Displacement,
            Self::Radian => Motion::Tilt,
            Self::Strain => Motion::Strain,
        }
    }
}

impl Sensor {
    /// Whether it measures a point's motion, not how the axis leans or a fibre stretches.
    pub fn is_of_a_point(&self) -> bool {
        !matches!(self.unit.map(Unit::motion), Some(Motion::Tilt | Motion::Strain))
    }
}

impl Setup {
    /// A setup of accelerations in m/s² of which nothing else is known.
    pub fn new(name: impl Into<String>, sampling_rate_hz: f64, sensors: Vec<Sensor>) -> Self {
        Self {
            name: name.into(),
            files: Vec::new(),
            live: false,
            variable: None,
            sampling_rate_hz,
            block_s: None,
            utc_offset_h: None,
            unit: Unit::MetrePerSecondSquared,
            temperature: None,
            sensors,
        }
    }

    /// Rows of each of the blocks that its files are joined of.
    pub fn block_rows(&self) -> Option<u64> {
        self.block_s.map(|block_s| (block_s * self.sampling_rate_hz).round() as u64).filter(|rows| *rows > 0)
    }

    /// The unit of a sensor's numbers: its own, or the setup's.
    pub fn unit_of(&self, sensor: &Sensor) -> Unit {
        sensor.unit.unwrap_or(self.unit)
    }

    /// The motion that spectra are of: velocities stay velocities where all channels measure them; otherwise all channels are made
    /// accelerations.
    pub fn motion(&self) -> Motion {
        let is_velocity = |sensor: &Sensor| self.unit_of(sensor).motion() == Motion::Velocity;
        if !self.sensors.is_empty() && self.sensors.iter().all(is_velocity) {
            Motion::Velocity
        } else {
            Motion::Acceleration
        }
    }

    /// How often each channel's motion is differentiated to be [`Setup::motion`].
    pub fn derivatives(&self) -> Vec<u8> {
        let order = |motion: Motion| match motion {
            Motion::Acceleration => 2,
            Motion::Velocity => 1,
            Motion::Displacement | Motion::Tilt | Motion::Strain => 0,
        };
        let wanted: u8 = order(self.motion());
        self.sensors.iter().map(|sensor| wanted - order(self.unit_of(sensor).motion())).collect()
    }

    /// The motion of all channels; `None` where they differ.
    pub fn common_motion(&self) -> Option<Motion> {
        let mut motions = self.sensors.iter().map(|sensor| self.unit_of(sensor).motion());
        let first = motions.next()?;
        motions.all(|motion| motion == first).then_some(first)
    }
}

/// `[[setup.sensor]]`: one measured direction at one place.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// The column's name, or its 1-based position where the file has no header.
    pub channel: String,
    /// The measurement point's name, unique within a setup; the channel's name unless given. Reference sensors are
    /// matched between setups by it.
    pub point: String,
    /// The sensor node that samples this channel; 0 for modes identified elsewhere, where none is named.
    pub node: u16,
    /// Height in metres, where known. Identification needs none; comparison with a model does.
    pub elevation_m: Option<f64>,
    /// The direction that counts as positive.
    pub direction: Option<Direction>,
    /// Plan position from the beam axis in metres (global X, Y).
    pub offset_m: [f64; 2],
    /// Whether the same point stands in every setup.
    pub reference: bool,
    /// What its numbers are; none where they are what the setup says.
    pub unit: Option<Unit>,
    /// Recorded volts per m/s² (only with [`Unit::Volt`]).
    pub sensitivity_v_per_m_s2: Option<f64>,
    /// What its readings are to be multiplied by, as its calibration says; none where they are taken as they are.
    pub gain: Option<f64>,
    /// The standard deviation of that, as its calibration says.
    pub gain_std: Option<f64>,
    /// What it reads without acceleration, in m/s², which is subtracted before the gain.
    pub offset_m_s2: Option<f64>,
    /// 1-based row of the model's matrices, instead of a place.
    pub dof: Option<usize>,
    /// The node of the model that it stands at, by name; a study that is read from its folder has the node's place as well.
    pub model_node: Option<String>,
}

impl Sensor {
    /// A channel of a node, of which nothing else is known; its point has its name.
    pub fn new(channel: impl Into<String>, node: u16) -> Self {
        let channel = channel.into();
        Self {
            point: channel.clone(),
            channel,
            node,
            elevation_m: None,
            direction: None,
            offset_m: [0.0; 2],
            reference: false,
            unit: None,
            sensitivity_v_per_m_s2: None,
            gain: None,
            gain_std: None,
            offset_m_s2: None,
            dof: None,
            model_node: None,
        }
    }
}

/// A sensor's positive direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Direction {
    /// Horizontal, degrees anticlockwise from +X seen from above.
    AzimuthDeg(f64),
    /// Vertical, positive up.
    Up,
    /// Neither: `azimuth_deg` as above, and degrees above the horizontal.
    Inclined {
        /// Degrees anticlockwise from +X seen from above.
        azimuth_deg: f64,
        /// Degrees above the horizontal, negative below it.
        inclination_deg: f64,
    },
}

impl Direction {
    /// Its parts along X, Y and Z (up).
    pub fn cosines(self) -> [f64; 3] {
        let (azimuth_deg, inclination_deg) = match self {
            Self::AzimuthDeg(azimuth_deg) => (azimuth_deg, 0.0),
            Self::Up => return [0.0, 0.0, 1.0],
            Self::Inclined { azimuth_deg, inclination_deg } => (azimuth_deg, inclination_deg),
        };
        let (sin, cos) = azimuth_deg.to_radians().sin_cos();
        let (up, along): (f64, f64) =
            if inclination_deg == 0.0 { (0.0, 1.0) } else { inclination_deg.to_radians().sin_cos() };
        [along * cos, along * sin, up]
    }
}

/// `[analysis]`; what is `None` is chosen from the band and the recording's length.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Analysis {
    /// Lowest and highest frequency of interest.
    pub band_hz: Option<[f64; 2]>,
    /// Sampling rate after decimation.
    pub decimated_rate_hz: Option<f64>,
    /// Points a segment (a power of two from 256 to 65536; up to 4096 where nodes transform them).
    pub segment: Option<usize>,
    /// What the user says of the modes.
    pub modes: ModeChoice,
}

/// What a study says of the modes to identify: frequencies in Hz near which they are.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ModeChoice {
    /// `modes_hz`: these and no others, instead of automatic picking.
    #[serde(rename = "modes_hz")]
    pub only_hz: Option<Vec<f64>>,
    /// `add_modes_hz`: these too.
    #[serde(rename = "add_modes_hz")]
    pub add_hz: Vec<f64>,
    /// `drop_modes_hz`: not these.
    #[serde(rename = "drop_modes_hz")]
    pub drop_hz: Vec<f64>,
    /// `mode_bands_hz`: a mode that is picked in one of these is fitted to its lines alone.
    #[serde(rename = "mode_bands_hz")]
    pub bands_hz: Vec<[f64; 2]>,
}

/// Frequencies that differ by less than this share are those of one mode: as near as the user sees when clicking.
const SAME_MODE: f64 = 0.003;

/// The band in which a frequency lies.
pub(crate) fn band_at(bands_hz: &[[f64; 2]], hz: f64) -> Option<[f64; 2]> {
    bands_hz.iter().copied().find(|[from, to]| (*from..=*to).contains(&hz))
}

impl ModeChoice {
    /// Wants the mode at a frequency fitted to this band, or to one that is chosen from the data.
    ///
    /// # Errors
    /// A sentence, where the mode is not inside of the band, or the band reaches into that of another mode.
    pub fn fit_to(&mut self, hz: f64, band_hz: Option<[f64; 2]>) -> Result<(), String> {
        let mut others = self.bands_hz.clone();
        others.retain(|band| band_at(&[*band], hz).is_none());
        if let Some([from, to]) = band_hz {
            if !(from > 0.0 && (from..to).contains(&hz)) {
                return Err(format!("the mode at {hz:.4} Hz does not lie between {from:.4} and {to:.4} Hz"));
            }
            if let Some([low, high]) = others.iter().find(|[low, high]| *low < to && from < *high) {
                return Err(format!(
                    "another mode is fitted to {low:.4} to {high:.4} Hz, which this band reaches into"
                ));
            }
            others.push([from, to]);
            others.sort_by(|a, b| a[0].total_cmp(&b[0]));
        }
        self.bands_hz = others;
        Ok(())
    }

    /// Frequencies at which the user wants modes.
    pub fn wanted_hz(&self) -> Vec<f64> {
        self.only_hz.iter().flatten().chain(&self.add_hz).copied().collect()
    }

    /// Wants a mode at a frequency: takes back that it was dropped, else adds it to those that are named.
    pub fn add(&mut self, hz: f64) {
        if !take_out(&mut self.drop_hz, hz) {
            self.only_hz.as_mut().unwrap_or(&mut self.add_hz).push(hz);
        }
    }

    /// Wants no mode at a frequency: takes back that it was added, else drops it.
    ///
    /// # Errors
    /// A sentence, where `modes_hz` does not name it, or names nothing else.
    pub fn drop(&mut self, hz: f64) -> Result<(), String> {
        let Some(only_hz) = &mut self.only_hz else {
            if !take_out(&mut self.add_hz, hz) {
                self.drop_hz.push(hz);
            }
            return Ok(());
        };
        match (only_hz.len(), take_out(only_hz, hz)) {
            (_, false) => Err(format!("modes_hz in [analysis] names no mode near {hz:.4} Hz")),
            (1, true) => {
                Err("modes_hz in [analysis] names this mode alone; take modes_hz out of study.toml".to_owned())
            }
            _ => Ok(()),
        }
    }
}

/// Takes the frequency next to one out, where it is the same mode's; whether there was one.
fn take_out(frequencies: &mut Vec<f64>, hz: f64) -> bool {
    let distance = |known: &f64| (known / hz - 1.0).abs();
    let nearest = frequencies.iter().enumerate().min_by(|a, b| distance(a.1).total_cmp(&distance(b.1)));
    let found = nearest.filter(|(_, known)| distance(known) <= SAME_MODE).map(|(index, _)| index);
    found.map(|index| frequencies.remove(index)).is_some()
}

/// `[model]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// What it is read from.
    pub source: ModelSource,
    /// How far a segment's stiffness is trusted: one relative standard deviation.
    pub background_stiffness: Option<f64>,
    /// How far a segment's mass is trusted: one relative standard deviation.
    pub background_mass: Option<f64>,
    /// Height over which neighbouring segments err alike, in metres.
    pub correlation_length_m: Option<f64>,
    /// Effects already in the model, in the order of `study.toml`.
    pub effects: Vec<Effect>,
    /// Hypotheses of the user's own.
    pub customs: Vec<CustomSource>,
    /// What the user's own program computed with something changed; only with [`ModelSource::Modes`].
    pub runs: Vec<RunSource>,
    /// Odds of kinds of effects before anything is measured, where they are others than usual.
    pub prior_odds: Vec<(String, f64)>,
    /// What it looks like.
    pub drawing: Drawing,
}

/// What a structure looks like, where nodes do not just stand above each other; paths are relative to the study's folder.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Drawing {
    /// A table of nodes and their places, where the model's own files have none.
    pub points: Option<PathBuf>,
    /// A table of pairs of nodes.
    pub lines: Option<PathBuf>,
    /// A table of three or four nodes each.
    pub surfaces: Option<PathBuf>,
}

/// Names among the prior odds that are no kinds of effects: of a model that lacks nothing, and of something else.
pub const NO_KINDS: [&str; 2] = ["adequate", "something-else"];

/// What a model is read from; paths are relative to the study's folder.
#[derive(Debug, Clone, PartialEq)]
pub enum ModelSource {
    /// A beam table.
    Beam(PathBuf),
    /// Matrices.
    Matrices(MatrixSource),
    /// Modes that the user's own program computed, by the file's name.
    Modes(PathBuf),
}

/// `matrices = { ... }`: where M and K are.
#[derive(Debug, Clone, PartialEq)]
pub struct MatrixSource {
    /// The MATLAB file that holds the matrices named without an ending of their own.
    pub file: Option<PathBuf>,
    /// What sums up to K, at least one.
    pub stiffness: Vec<MatrixTerm>,
    /// What sums up to M, at least one.
    pub mass: Vec<MatrixTerm>,
    /// Where the rows stand.
    pub layout: Option<LayoutFile>,
}

/// One of the matrices that are summed.
#[derive(Debug, Clone, PartialEq)]
pub struct MatrixTerm {
    /// A variable of the MATLAB file, or a Matrix Market (`.mtx`) or NumPy (`.npy`) file.
    pub name: String,
    /// Its factor.
    pub factor: f64,
}

/// `[[model.custom]]`: a hypothesis of the user's own, by name; paths are relative to the study's folder.
#[derive(Debug, Clone, PartialEq)]
pub struct CustomSource {
    /// 1-based line in `study.toml`.
    pub line: usize,
    /// Its name, what stands after the @ of `custom@name`.
    pub name: String,
    /// The MATLAB file of matrices named without an ending of their own.
    pub file: Option<PathBuf>,
    /// What sums up to the change of K; none for no change.
    pub stiffness: Vec<MatrixTerm>,
    /// What sums up to the change of M; none for no change.
    pub mass: Vec<MatrixTerm>,
    /// A table of relative changes of segments.
    pub segments: Option<PathBuf>,
    /// The least admissible value.
    pub least: Option<f64>,
    /// The greatest admissible value.
    pub greatest: Option<f64>,
    /// The typical value.
    pub typical: Option<f64>,
    /// The group that this one changes with, whose deviation and bounds are those of both.
    pub tied_to: Option<String>,
    /// The channels of the sensors that stand at this group, where the study says so.
    pub channels: Vec<String>,
    /// What makes a `[[model.group]]` of it; `None` for a `[[model.custom]]`.
    pub group: Option<GroupTerms>,
}

/// `[[model.run]]`: modes of the model with a group or a hypothesis changed; paths are relative to the study's folder.
#[derive(Debug, Clone, PartialEq)]
pub struct RunSource {
    /// 1-based line in `study.toml`.
    pub line: usize,
    /// The name of the group or hypothesis.
    pub changed: String,
    /// By how much: of a group the share of itself, of a hypothesis its value. Not 0.
    pub change: f64,
    /// Whether masses were changed, instead of stiffnesses.
    pub is_mass: bool,
    /// The file of modes.
    pub modes: PathBuf,
}

impl CustomSource {
    /// `custom` or `group`, as its section in study.toml is called.
    pub fn section(&self) -> &'static str {
        if self.group.is_some() { "group" } else { "custom" }
    }
}

/// What a `[[model.group]]` has besides: a part of the model that is trusted to a standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroupTerms {
    /// How far its stiffness or mass is trusted: one relative standard deviation.
    pub std: f64,
    /// From which height to which it stands, in m, where that is known.
    pub span_m: Option<[f64; 2]>,
}

/// A file that says where the rows of matrices stand.
#[derive(Debug, Clone, PartialEq)]
pub enum LayoutFile {
    /// `node,z_m`: five DOFs a node.
    Nodes(PathBuf),
    /// Nodes by number: a universal file, or Nastran's bulk data.
    Numbered {
        /// The file.
        file: PathBuf,
        /// What its lengths are multiplied with to be in m.
        factor: f64,
    },
    /// `row,node,dof` and positions; or CalculiX' .dof.
    Dofs(PathBuf),
}

impl LayoutFile {
    /// The file.
    pub fn file(&self) -> &Path {
        match self {
            Self::Nodes(file) | Self::Dofs(file) | Self::Numbered { file, .. } => file,
        }
    }
}

/// `[[model.effect]]`: a physical effect that the model has on top of its beam table.
#[derive(Debug, Clone, PartialEq)]
pub struct Effect {
    /// 1-based line in `study.toml`.
    pub line: usize,
    /// The effect's name in the catalogue, such as `base-rotation`.
    pub kind: String,
    /// The part after the @ (`"225.2m"`, `"07"`), for effects that have a place.
    pub location: Option<String>,
    /// Everything else as written: `value`, or parameters by their names.
    pub parameters: toml::Table,
}

impl Study {
    /// The sensors that measured mode shapes may stand at, each point once: those of `[measured]`, else of all setups. A
    /// channel's name that recurs between setups becomes `setup/channel`, as identification names it.
    pub fn sensors(&self) -> Vec<Sensor> {
        if let Some(measured) = &self.measured {
            return measured.sensors.clone();
        }
        let recurs = |channel: &str| {
            self.setups.iter().flat_map(|setup| &setup.sensors).filter(|sensor| sensor.channel == channel).count() > 1
        };
        let mut sensors: Vec<Sensor> = Vec::new();
        for setup in &self.setups {
            for sensor in &setup.sensors {
                // A reference stands in every setup; other points of one name are different sensors.
                if sensors.iter().any(|known| known.reference && sensor.reference && known.point == sensor.point) {
                    continue;
                }
                let mut sensor = sensor.clone();
                if recurs(&sensor.channel) {
                    sensor.channel = format!("{}/{}", setup.name, sensor.channel);
                }
                sensors.push(sensor);
            }
        }
        sensors
    }
}
