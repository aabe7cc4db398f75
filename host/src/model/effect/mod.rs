//! The catalogue of physical effects that a model may lack, one file each.
//!
//! A word such as `base-rotation=7e-15` or `added-mass@443.6m=2e5` flows in; an [`Effect`] with its kind, place and
//! values flows out and changes a [`Structure`] before it is assembled.

mod added_mass;
mod base_rotation;
mod base_translation;
mod mass_scale;
mod parse;
mod stiffness_loss;
mod stiffness_scale;
#[cfg(test)]
mod tests;

use std::fmt;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{BaseFlexibility, Body, Segment, Structure};
pub use parse::Where;

/// A parameter of an effect. Bounds belong to the range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Its name, as in files and JSON.
    pub name: &'static str,
    /// Its unit; `-` for none.
    pub unit: &'static str,
    /// The least admissible value.
    pub least: f64,
    /// The greatest admissible value; infinite where there is none.
    pub greatest: f64,
}

impl Parameter {
    /// The admissible values in words.
    pub fn range(&self) -> String {
        let unit = if self.unit == "-" { String::new() } else { format!(" {}", self.unit) };
        if self.greatest.is_infinite() {
            format!("{} or more{unit}", self.least)
        } else {
            format!("{} to {}{unit}", self.least, self.greatest)
        }
    }
}

/// What stands after the @ of an effect of this kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// Nothing: the effect concerns the whole structure.
    Nowhere,
    /// A height on the beam.
    Height,
}

/// A kind of effect: what it is called, what it is made of, and what it does to a structure.
pub trait EffectKind: fmt::Debug + Send + Sync {
    /// The name that a user types.
    fn name(&self) -> &'static str;

    /// Where such an effect acts.
    fn place(&self) -> Place {
        Place::Nowhere
    }

    /// The sets of parameters by which it can be given, the usual one first; all of a set are needed.
    fn parameter_sets(&self) -> &'static [&'static [Parameter]];

    /// Changes `structure`; `values` follow one of the parameter sets and lie inside its bounds.
    fn apply(&self, values: &[f64], place: Option<&Where>, structure: &mut Structure) -> Result<(), EffectError>;
}

/// Every kind there is.
pub const KINDS: &[&dyn EffectKind] = &[
    &stiffness_scale::StiffnessScale,
    &mass_scale::MassScale,
    &base_rotation::BaseRotation,
    &base_translation::BaseTranslation,
    &added_mass::AddedMassAt,
    &stiffness_loss::StiffnessLoss,
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
    /// The value's unit; `-` for none.
    pub unit: String,
}

/// Why an effect was refused.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum EffectError {
    /// The word has no value.
    #[error("`{word}`: no value; write KIND=VALUE or KIND@WHERE=VALUE, for instance added-mass@443.6m=200000")]
    NoValue {
        /// What was typed.
        word: String,
    },
    /// No such kind.
    #[error("no effect is called `{kind}`; there are {known}")]
    UnknownKind {
        /// What was typed.
        kind: String,
        /// The kinds there are.
        known: String,
    },
    /// A place that is none.
    #[error(
        "`{place}` is no place; write a height such as 443.6m, a channel such as ch07 (or ch04+ch05), a node such as node3, or a frequency such as 0.83hz"
    )]
    BadPlace {
        /// What was typed.
        place: String,
    },
    /// The kind acts elsewhere.
    #[error("{kind} {expected}, not {found}")]
    WrongPlace {
        /// The kind.
        kind: &'static str,
        /// What it needs.
        expected: &'static str,
        /// What it got.
        found: String,
    },
    /// The height is not on the beam.
    #[error("{kind}@{z_m}m: the beam stands from {z_base_m} m to {z_top_m} m")]
    OutsideBeam {
        /// The kind.
        kind: &'static str,
        /// The height asked for.
        z_m: f64,
        /// Where the beam starts.
        z_base_m: f64,
        /// Where it ends.
        z_top_m: f64,
    },
    /// The model's nodes do not stand above each other.
    #[error(
        "{kind} acts at a height, but the nodes of the model's matrices do not stand above each other; give them `nodes`, or use a beam table"
    )]
    NoHeights {
        /// The kind.
        kind: &'static str,
    },
    /// The effect changes segments, and matrices have none.
    #[error("{kind} changes beam segments or their base, and a model of matrices has none; it needs a beam table")]
    NeedsBeam {
        /// The kind.
        kind: &'static str,
    },
    /// The names of parameters given are not those of the kind.
    #[error("{kind}: `{value}` is not a value for it; expected {expected}")]
    BadValue {
        /// The kind.
        kind: &'static str,
        /// What was typed.
        value: String,
        /// What would have been right.
        expected: String,
    },
    /// A value outside its bounds.
    #[error("{kind}: {parameter} = {value} is out of range; it must be {range}")]
    OutOfRange {
        /// The kind.
        kind: &'static str,
        /// The parameter.
        parameter: &'static str,
        /// Its value.
        value: f64,
        /// The range in words, with the unit.
        range: String,
    },
}

impl Effect {
    /// An effect from its kind's name, its place and its values; `values` follow one of the kind's parameter sets.
    ///
    /// # Errors
    /// [`EffectError`]: an unknown kind, a place that does not suit it, a value out of range.
    pub fn new(kind: &str, place: Option<Where>, values: &[f64]) -> Result<Self, EffectError> {
        let kind = find(kind)?;
        check_place(kind, place.as_ref())?;
        let parameters = kind.parameter_sets().iter().find(|set| set.len() == values.len()).ok_or_else(|| {
            let value = values.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
            EffectError::BadValue { kind: kind.name(), value, expected: expected_value(kind) }
        })?;
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
        let number = |value: &toml::Value| value.as_float().or(value.as_integer().map(|integer| integer as f64));
        let value_of =
            |wanted: &str| given.iter().find(|(name, _)| *name == wanted).and_then(|(_, value)| number(value));
        if let [("value", value)] = given[..] {
            return Self::new(kind.name(), place, &[number(value).ok_or_else(|| bad(value.to_string()))?]);
        }
        let in_order = |set: &&[Parameter]| {
            let values: Option<Vec<f64>> = set.iter().map(|parameter| value_of(parameter.name)).collect();
            values.filter(|values| values.len() == given.len())
        };
        let words = || given.iter().map(|(name, value)| format!("{name} = {value}")).collect::<Vec<_>>().join(", ");
        let values = kind.parameter_sets().iter().find_map(in_order).ok_or_else(|| bad(words()))?;
        Self::new(kind.name(), place, &values)
    }

    /// The kind's name.
    pub fn kind(&self) -> &'static str {
        self.kind.name()
    }

    /// Where it acts, for kinds that act somewhere.
    pub fn place(&self) -> Option<&Where> {
        self.place.as_ref()
    }

    /// Parameters with their values.
    pub fn parameters(&self) -> impl Iterator<Item = (&'static Parameter, f64)> + '_ {
        self.parameters.iter().zip(self.values.iter().copied())
    }

    /// Changes `structure`.
    ///
    /// # Errors
    /// [`EffectError::OutsideBeam`] where its place is not on this structure, [`EffectError::NeedsBeam`] where it needs a beam
    /// table.
    pub fn apply(&self, structure: &mut Structure) -> Result<(), EffectError> {
        self.kind.apply(&self.values, self.place.as_ref(), structure)
    }

    /// For JSON.
    pub fn record(&self) -> EffectRecord {
        let parameters = self.parameters().map(|(parameter, value)| ParameterRecord {
            name: parameter.name.to_owned(),
            value,
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

fn find(name: &str) -> Result<&'static dyn EffectKind, EffectError> {
    KINDS.iter().copied().find(|kind| kind.name() == name).ok_or_else(|| {
        let known: Vec<_> = KINDS.iter().map(|kind| kind.name()).collect();
        EffectError::UnknownKind { kind: name.to_owned(), known: known.join(", ") }
    })
}

fn check_place(kind: &'static dyn EffectKind, place: Option<&Where>) -> Result<(), EffectError> {
    let expected = match (kind.place(), place) {
        (Place::Nowhere, None) | (Place::Height, Some(Where::Height(_))) => return Ok(()),
        (Place::Nowhere, Some(_)) => "acts on the whole structure and takes no @WHERE",
        (Place::Height, _) => "needs a height such as @225.2m",
    };
    let found = place.map_or_else(|| "nothing".to_owned(), |place| format!("@{place}"));
    Err(EffectError::WrongPlace { kind: kind.name(), expected, found })
}

/// What a value of this kind looks like, in words.
fn expected_value(kind: &dyn EffectKind) -> String {
    let sets = kind.parameter_sets().iter().map(|set| {
        set.iter()
            .map(|parameter| format!("{} ({})", parameter.name, parameter.range()))
            .collect::<Vec<_>>()
            .join(" and ")
    });
    sets.collect::<Vec<_>>().join(", or ")
}

/// The base of a beam.
fn base<'a>(kind: &'static str, structure: &'a mut Structure) -> Result<&'a mut BaseFlexibility, EffectError> {
    match structure.body {
        Body::Beam(_) => Ok(&mut structure.base),
        Body::Matrices(_) => Err(EffectError::NeedsBeam { kind }),
    }
}

/// The segments of a beam.
fn segments<'a>(kind: &'static str, structure: &'a mut Structure) -> Result<&'a mut [Segment], EffectError> {
    match &mut structure.body {
        Body::Beam(beam) => Ok(beam.segments_mut()),
        Body::Matrices(_) => Err(EffectError::NeedsBeam { kind }),
    }
}

/// The height of a located effect, on the beam.
fn height(kind: &'static str, place: Option<&Where>, structure: &Structure) -> Result<f64, EffectError> {
    let Some(&Where::Height(z_m)) = place else {
        let found = place.map_or_else(|| "nothing".to_owned(), |place| format!("@{place}"));
        return Err(EffectError::WrongPlace { kind, expected: "needs a height such as @225.2m", found });
    };
    let Some([z_base_m, z_top_m]) = structure.z_range_m() else {
        return Err(EffectError::NoHeights { kind });
    };
    if !(z_base_m..=z_top_m).contains(&z_m) {
        return Err(EffectError::OutsideBeam { kind, z_m, z_base_m, z_top_m });
    }
    Ok(z_m)
}
