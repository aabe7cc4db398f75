//! The catalogue of physical effects that a model may lack, one file each.
//!
//! A word such as `base-rotation=7e-15` or `added-mass@443.6m=2e5` flows in; an [`Effect`] with its kind, place and
//! values flows out and changes a [`Structure`] before it is assembled. A new kind is a file with an [`EffectKind`] and a
//! line in [`KINDS`]; what searches, fits, explains and edits effects asks the kind.

mod added_mass;
mod amplitude_stiffness;
mod axis_rotation;
mod base_rotation;
mod base_translation;
mod clock_offset;
mod connection_flexibility;
mod custom;
mod error;
mod harmonic;
mod mass_eccentricity;
mod mass_scale;
mod outrigger;
mod p_delta;
mod parameter;
mod parse;
mod rotary_inertia;
mod sensor_gain;
mod sensor_polarity;
mod sensor_rotation;
mod sensor_swap;
mod shear_flexibility;
mod stiffness_loss;
mod stiffness_scale;
mod target;
mod temperature_stiffness;
#[cfg(test)]
mod tests;
mod tuned_mass_damper;

use std::fmt;

use serde::{Deserialize, Serialize};

use super::Structure;
use crate::study::Sensor;
pub use custom::{Custom, CustomError};
pub use error::EffectError;
pub use parameter::{Parameter, Prior};
pub use parse::Where;
use target::check_sensors;

/// What stands after the @ of an effect of this kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// Nothing: the effect concerns the whole structure.
    Nowhere,
    /// A height on the beam.
    Height,
    /// A channel.
    Channel,
    /// Two channels.
    TwoChannels,
    /// A sensor node.
    Node,
    /// A sensor node, or nothing for all.
    NodeOrAll,
    /// A frequency.
    Frequency,
    /// The name of a `[[model.custom]]`.
    Name,
}

/// Where an effect of a kind can be seen, which says how it is looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Evidence {
    /// In frequencies and shapes.
    Modes,
    /// In the shapes' phases besides.
    Phases,
    /// In twin peaks of high damping.
    TwinPeaks,
    /// In the kurtosis of a line.
    Kurtosis,
    /// In how frequencies go with temperature over the record.
    TemperatureTrend,
    /// In how frequencies go with the level of response over the record.
    LevelTrend,
}

/// What the catalogue says of a kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct About {
    /// The name that a user types.
    pub name: &'static str,
    /// What it is, in two sentences.
    pub physics: &'static str,
    /// How it enters M, C, K or the sensors.
    pub formula: &'static str,
    /// How it shows.
    pub fingerprint: &'static str,
    /// What it is confused with, and what separates the two.
    pub look_alikes: &'static [LookAlike],
    /// Where the formula is from.
    pub source: &'static str,
}

/// An effect that looks alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct LookAlike {
    /// Its kind.
    pub kind: &'static str,
    /// The measurement that separates the two.
    pub separated_by: &'static str,
}

/// A kind of effect: what it is called, what it is made of, and what it does to a structure.
pub trait EffectKind: fmt::Debug + Send + Sync {
    /// What the catalogue says of it.
    fn about(&self) -> &'static About;

    /// Where such an effect acts.
    fn place(&self) -> Place {
        Place::Nowhere
    }

    /// Whether one at a height may be at any, rather than in one segment or another.
    fn may_be_anywhere(&self) -> bool {
        true
    }

    /// Where it can be seen.
    fn evidence(&self) -> Evidence {
        Evidence::Modes
    }

    /// The sets of parameters by which it can be given, the usual one first; all of a set are needed.
    fn parameter_sets(&self) -> &'static [&'static [Parameter]];

    /// Changes `structure`; the values of `given` follow one of the parameter sets and lie inside its bounds.
    ///
    /// # Errors
    /// [`EffectError`] where the structure has no place for it.
    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError>;
}

impl dyn EffectKind + '_ {
    /// The name that a user types.
    pub fn name(&self) -> &'static str {
        self.about().name
    }
}

impl PartialEq for dyn EffectKind + '_ {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

/// Values of an effect, by name, and its place.
#[derive(Debug, Clone, Copy)]
pub struct Given<'a> {
    parameters: &'static [Parameter],
    values: &'a [f64],
    place: Option<&'a Where>,
}

impl Given<'_> {
    /// The value of a parameter, where the set has it.
    pub fn value(&self, name: &str) -> Option<f64> {
        self.parameters.iter().position(|parameter| parameter.name == name).and_then(|at| self.values.get(at).copied())
    }

    /// The value of a parameter, zero where the set does not have it.
    fn or_zero(&self, name: &str) -> f64 {
        self.value(name).unwrap_or(0.0)
    }

    /// One value for both axes, or one each.
    fn by_axis(&self, both: &str, each: [&str; 2]) -> [f64; 2] {
        each.map(|name| self.value(name).or(self.value(both)).unwrap_or(0.0))
    }
}

/// Every kind there is.
pub const KINDS: &[&dyn EffectKind] = &[
    &stiffness_scale::StiffnessScale,
    &mass_scale::MassScale,
    &base_rotation::BaseRotation,
    &base_translation::BaseTranslation,
    &shear_flexibility::ShearFlexibility,
    &rotary_inertia::RotaryInertia,
    &p_delta::PDelta,
    &added_mass::AddedMassAt,
    &stiffness_loss::StiffnessLoss,
    &connection_flexibility::ConnectionFlexibility,
    &tuned_mass_damper::TunedMassDamper,
    &mass_eccentricity::MassEccentricity,
    &axis_rotation::AxisRotation,
    &outrigger::Outrigger,
    &temperature_stiffness::TemperatureStiffness,
    &amplitude_stiffness::AmplitudeStiffness,
    &sensor_gain::SensorGain,
    &sensor_polarity::SensorPolarity,
    &sensor_swap::SensorSwap,
    &sensor_rotation::SensorRotation,
    &clock_offset::ClockOffset,
    &harmonic::Harmonic,
    &custom::CustomChange,
];

/// An effect of a known kind, at a place, with values inside their bounds.
#[derive(Debug, Clone)]
pub struct Effect {
    kind: &'static dyn EffectKind,
    place: Option<Where>,
    parameters: &'static [Parameter],
    values: Vec<f64>,
}

/// An effect as it stands in JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EffectRecord {
    /// The kind's name.
    pub effect: String,
    /// The part after the @.
    pub r#where: Option<String>,
    /// Its parameters.
    pub parameters: Vec<ParameterRecord>,
}

/// A parameter's value as it stands in JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ParameterRecord {
    /// Its name.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Its standard deviation, where it was fitted.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub std: Option<f64>,
    /// The value's unit; `-` for none.
    pub unit: String,
}

impl Effect {
    /// An effect from its kind, its place and its values; `values` follow the first of the kind's parameter sets that has as
    /// many.
    ///
    /// # Errors
    /// [`EffectError`]: an unknown kind, a place that does not suit it, a value out of range.
    pub fn new(kind: &str, place: Option<Where>, values: &[f64]) -> Result<Self, EffectError> {
        let kind = find(kind)?;
        let parameters = kind.parameter_sets().iter().find(|set| set.len() == values.len()).ok_or_else(|| {
            let value = values.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
            EffectError::BadValue { kind: kind.name(), value, expected: expected_value(kind) }
        })?;
        Self::with_parameters(kind, place, parameters, values)
    }

    /// An effect by one of its kind's parameter sets.
    ///
    /// # Errors
    /// [`EffectError`]: a place that does not suit it, a value out of range.
    pub fn with_parameters(
        kind: &'static dyn EffectKind,
        place: Option<Where>,
        parameters: &'static [Parameter],
        values: &[f64],
    ) -> Result<Self, EffectError> {
        check_place(kind, place.as_ref())?;
        for (parameter, &value) in parameters.iter().zip(values) {
            if !value.is_finite() || value < parameter.least || value > parameter.greatest {
                let (name, range) = (parameter.name, parameter.range());
                return Err(EffectError::OutOfRange { kind: kind.name(), parameter: name, value, range });
            }
        }
        Ok(Self { kind, place, parameters, values: values.to_vec() })
    }

    /// An effect as it stands in a study: `value` for a kind with one parameter, else the parameters by name. Standard
    /// deviations that stand beside them (`std`, `..._std`) are read over.
    ///
    /// # Errors
    /// As [`Effect::new`], and where a parameter is missing, unknown or no number.
    pub fn from_study(written: &crate::study::Effect) -> Result<Self, EffectError> {
        let kind = find(&written.kind)?;
        let place = written.location.as_deref().map(str::parse).transpose()?;
        let given: Vec<(&str, &toml::Value)> = written
            .parameters
            .iter()
            .map(|(name, value)| (name.as_str(), value))
            .filter(|(name, _)| *name != "std" && !name.ends_with("_std"))
            .collect();
        let bad = |value: String| EffectError::BadValue { kind: kind.name(), value, expected: expected_value(kind) };
        if let [("value", value)] = given[..] {
            let single =
                kind.parameter_sets().iter().find_map(|set| if let [only] = set { Some((set, only)) } else { None });
            let (set, only) = single.ok_or_else(|| bad(value.to_string()))?;
            let number = only.read(value).ok_or_else(|| bad(value.to_string()))?;
            return Self::with_parameters(kind, place, set, &[number]);
        }
        let words = || {
            let words: Vec<String> = given.iter().map(|(name, value)| format!("{name} = {value}")).collect();
            if words.is_empty() { "nothing".to_owned() } else { words.join(", ") }
        };
        let value_of = |parameter: &Parameter| {
            given.iter().find(|(name, _)| *name == parameter.name).and_then(|(_, value)| parameter.read(value))
        };
        let (set, values) = set_of(kind, given.len(), value_of).ok_or_else(|| bad(words()))?;
        Self::with_parameters(kind, place, set, &values)
    }

    /// The kind's name.
    pub fn kind(&self) -> &'static str {
        self.kind.name()
    }

    /// The kind.
    pub fn of_kind(&self) -> &'static dyn EffectKind {
        self.kind
    }

    /// Where it acts, for kinds that act somewhere.
    pub fn place(&self) -> Option<&Where> {
        self.place.as_ref()
    }

    /// Parameters with their values.
    pub fn parameters(&self) -> impl ExactSizeIterator<Item = (&'static Parameter, f64)> + '_ {
        self.parameters.iter().zip(self.values.iter().copied())
    }

    /// The same effect at another place of the same sort.
    #[must_use]
    pub fn moved_to(&self, place: Where) -> Self {
        Self { place: Some(place), ..self.clone() }
    }

    /// The same effect with other values, brought inside their bounds.
    #[must_use]
    pub fn with_values(&self, values: &[f64]) -> Self {
        let inside = |(parameter, &value): (&Parameter, &f64)| value.clamp(parameter.least, parameter.greatest);
        let values = self.parameters.iter().zip(values).map(inside).collect();
        Self { values, ..self.clone() }
    }

    /// Changes `structure`.
    ///
    /// # Errors
    /// [`EffectError::OutsideBeam`] where its place is not on this structure, [`EffectError::NeedsBeam`] where it needs a beam
    /// table.
    pub fn apply(&self, structure: &mut Structure) -> Result<(), EffectError> {
        let given = Given { parameters: self.parameters, values: &self.values, place: self.place.as_ref() };
        self.kind.apply(&given, structure)
    }

    /// Whether its channels and nodes are among the sensors.
    ///
    /// # Errors
    /// [`EffectError::NoChannel`] and [`EffectError::NoNode`].
    pub fn check_sensors(&self, sensors: &[Sensor]) -> Result<(), EffectError> {
        check_sensors(self.kind.name(), self.place.as_ref(), sensors)
    }

    /// For JSON.
    pub fn record(&self) -> EffectRecord {
        let parameters = self.parameters().map(|(parameter, value)| ParameterRecord {
            name: parameter.name.to_owned(),
            value,
            std: None,
            unit: parameter.unit.to_owned(),
        });
        EffectRecord {
            effect: self.kind().to_owned(),
            r#where: self.place.as_ref().map(Where::to_string),
            parameters: parameters.collect(),
        }
    }
}

/// `kind` or `kind@where`, the name under which results speak of it.
impl fmt::Display for Effect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.place {
            Some(place) => write!(f, "{}@{place}", self.kind()),
            None => write!(f, "{}", self.kind()),
        }
    }
}

/// The kind of a name.
///
/// # Errors
/// [`EffectError::UnknownKind`] lists the names there are.
pub fn find(name: &str) -> Result<&'static dyn EffectKind, EffectError> {
    KINDS.iter().copied().find(|kind| kind.name() == name).ok_or_else(|| {
        let known: Vec<_> = KINDS.iter().map(|kind| kind.name()).collect();
        let likeness = |kind: &&str| strsim::jaro_winkler(name, kind);
        let nearest = known.iter().copied().max_by(|a, b| likeness(a).total_cmp(&likeness(b)));
        EffectError::UnknownKind {
            kind: name.to_owned(),
            nearest: nearest.filter(|nearest| likeness(nearest) > 0.8),
            known: known.join(", "),
        }
    })
}

/// `KIND` or `KIND@WHERE` as typed, without values: the kind, and where.
///
/// # Errors
/// [`EffectError`]: an unknown kind, a place that is none or does not suit it.
pub fn named(word: &str) -> Result<(&'static dyn EffectKind, Option<Where>), EffectError> {
    let (name, place) = match word.split_once('@') {
        Some((name, place)) => (name.trim(), Some(place.trim())),
        None => (word.trim(), None),
    };
    let kind = find(name)?;
    let place = place.map(str::parse::<Where>).transpose()?;
    check_place(kind, place.as_ref())?;
    Ok((kind, place))
}

fn check_place(kind: &'static dyn EffectKind, place: Option<&Where>) -> Result<(), EffectError> {
    let expected = match (kind.place(), place) {
        (Place::Nowhere | Place::NodeOrAll, None)
        | (Place::Height, Some(Where::Height(_)))
        | (Place::Node | Place::NodeOrAll, Some(Where::Node(_)))
        | (Place::Frequency, Some(Where::Frequency(_)))
        | (Place::Name, Some(Where::Name(_))) => return Ok(()),
        (Place::Channel, Some(Where::Channels(channels))) if channels.len() == 1 => return Ok(()),
        (Place::TwoChannels, Some(Where::Channels(channels))) if channels.len() == 2 && channels[0] != channels[1] => {
            return Ok(());
        }
        (Place::Nowhere, Some(_)) => "acts on the whole structure and takes no @WHERE",
        (Place::Height, _) => "needs a height such as @225.2m",
        (Place::Channel, _) => "needs a channel such as @ch07",
        (Place::TwoChannels, _) => "needs two channels such as @ch04+ch05",
        (Place::Node, _) => "needs a sensor node such as @node3",
        (Place::NodeOrAll, _) => "takes a sensor node such as @node3, or no @WHERE for all sensors",
        (Place::Frequency, _) => "needs a frequency such as @0.83hz",
        (Place::Name, _) => "needs the name of a [[model.custom]] of the study, such as @cables",
    };
    let found = place.map_or_else(|| "nothing".to_owned(), |place| format!("@{place}"));
    Err(EffectError::WrongPlace { kind: kind.name(), expected, found })
}

/// The parameter set of as many parameters as are given, all of which have a value.
fn set_of(
    kind: &'static dyn EffectKind,
    given: usize,
    value_of: impl Fn(&Parameter) -> Option<f64>,
) -> Option<(&'static [Parameter], Vec<f64>)> {
    let in_order = |set: &&'static [Parameter]| Some((*set, set.iter().map(&value_of).collect::<Option<Vec<f64>>>()?));
    kind.parameter_sets().iter().filter(|set| set.len() == given).find_map(in_order)
}

/// What a value of this kind looks like, in words.
fn expected_value(kind: &dyn EffectKind) -> String {
    let sets = kind.parameter_sets().iter().map(|set| {
        if set.is_empty() {
            return "no value".to_owned();
        }
        set.iter()
            .map(|parameter| format!("{} ({})", parameter.name, parameter.range()))
            .collect::<Vec<_>>()
            .join(" and ")
    });
    sets.collect::<Vec<_>>().join(", or ")
}
