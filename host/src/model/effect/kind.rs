//! What an effect of a kind is: its name and physics, its parameters and place, and what it contributes to a structure.

use std::fmt;
use std::sync::Arc;

use serde::Serialize;

use super::error::EffectError;
use super::parameter::Parameter;
use super::place::{PlaceKind, Where};
use crate::model::assembly::Assembly;
use crate::model::contribution::Contribution;
use crate::model::storeys::Storeys;
use crate::model::structure::{Body, Structure};

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
    /// How it is typed, one example for each of its parameter sets.
    pub examples: &'static [&'static str],
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
    fn place(&self) -> PlaceKind {
        PlaceKind::Nowhere
    }

    /// Whether one at a height may be at any, rather than in one segment or another.
    fn may_be_anywhere(&self) -> bool {
        true
    }

    /// From which share of a structure's height upwards one at a height is looked for. What is nearer to the foot is the foot.
    fn looked_for_above(&self) -> f64 {
        0.0
    }

    /// Where it can be seen.
    fn evidence(&self) -> Evidence {
        Evidence::Modes
    }

    /// The sets of parameters by which it can be given, the usual one first; all of a set are needed.
    fn parameter_sets(&self) -> &'static [&'static [Parameter]];

    /// A warning about these values in `structure`.
    fn caution(&self, _given: &Given<'_>, _structure: &Structure) -> Option<String> {
        None
    }

    /// What it contributes to `structure`; the values of `given` follow one of the parameter sets and lie inside its bounds.
    ///
    /// # Errors
    /// [`EffectError`] where the structure has no place for it.
    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError>;
}

impl dyn EffectKind + '_ {
    /// The name that a user types.
    pub fn name(&self) -> &'static str {
        self.about().name
    }

    /// Whether the study itself says what it is, as a `[[model.custom]]` or `[[model.group]]`.
    pub fn is_of_the_study(&self) -> bool {
        matches!(self.place(), PlaceKind::Name | PlaceKind::Group)
    }

    /// Whether it is of the structure rather than of how it was measured.
    pub fn is_of_structure(&self) -> bool {
        match self.place() {
            PlaceKind::Nowhere | PlaceKind::Height | PlaceKind::Name | PlaceKind::Group => true,
            PlaceKind::Channel
            | PlaceKind::TwoChannels
            | PlaceKind::Node
            | PlaceKind::NodeOrAll
            | PlaceKind::Frequency => false,
        }
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
    pub(super) parameters: &'static [Parameter],
    pub(super) values: &'a [f64],
    pub(super) place: Option<&'a Where>,
}

impl<'a> Given<'a> {
    /// The value of a parameter, where the set has it.
    pub fn value(&self, name: &str) -> Option<f64> {
        self.parameters.iter().position(|parameter| parameter.name == name).and_then(|at| self.values.get(at).copied())
    }

    /// The value of a parameter, zero where the set does not have it.
    pub(super) fn or_zero(&self, name: &str) -> f64 {
        self.value(name).unwrap_or(0.0)
    }

    /// The values of X and Y, of which each has its own or both have one.
    pub(super) fn of_axes(&self, both: &str, each: [&str; 2]) -> [f64; 2] {
        each.map(|name| self.value(name).unwrap_or_else(|| self.or_zero(both)))
    }

    /// Where the effect acts.
    pub(super) fn place(&self) -> Option<&'a Where> {
        self.place
    }

    /// The height of an effect at one, on the structure.
    ///
    /// # Errors
    /// [`EffectError`] without a height, or with one off the structure.
    pub(super) fn height_m(&self, kind: &dyn EffectKind, structure: &Structure) -> Result<f64, EffectError> {
        let Some(&Where::Height(z_m)) = self.place else { return Err(self.wrong_place(kind)) };
        let [z_base_m, z_top_m] = self.check_line(kind, structure)?;
        if !(z_base_m..=z_top_m).contains(&z_m) {
            return Err(EffectError::OutsideBeam { kind: kind.name(), z_m, z_base_m, z_top_m });
        }
        Ok(z_m)
    }

    /// The channels of an effect on sensors.
    ///
    /// # Errors
    /// [`EffectError::WrongPlace`] where it has none.
    pub(super) fn channels(&self, kind: &dyn EffectKind) -> Result<&'a [String], EffectError> {
        match self.place {
            Some(Where::Channels(channels)) => Ok(channels),
            _ => Err(self.wrong_place(kind)),
        }
    }

    /// Base and top of a structure on which heights mean something.
    ///
    /// # Errors
    /// [`EffectError::NoHeights`] where they do not.
    pub(super) fn check_line(&self, kind: &dyn EffectKind, structure: &Structure) -> Result<[f64; 2], EffectError> {
        structure.z_range_m().ok_or(EffectError::NoHeights { kind: kind.name() })
    }

    /// Whether the structure is a beam table.
    ///
    /// # Errors
    /// [`EffectError::NeedsBeam`] where it is not.
    pub(super) fn check_beam(&self, kind: &dyn EffectKind, structure: &Structure) -> Result<(), EffectError> {
        match structure.body {
            Body::Beam(_) => Ok(()),
            Body::Matrices(_) => Err(EffectError::NeedsBeam { kind: kind.name() }),
        }
    }

    /// Whether the structure stands on a base that can give way: a beam, or matrices of nodes above each other that nothing but the
    /// lowest of them ties to the ground.
    ///
    /// # Errors
    /// [`EffectError::NeedsBase`] where it does not.
    pub(super) fn check_base(&self, kind: &dyn EffectKind, structure: &Structure) -> Result<(), EffectError> {
        match &structure.body {
            Body::Matrices(matrices) if !Assembly::of_matrices(matrices).is_held_at_its_foot() => {
                Err(EffectError::NeedsBase { kind: kind.name() })
            }
            _ => Ok(()),
        }
    }

    /// Whether the structure is a model of storeys, in both directions where each has a value of its own.
    ///
    /// # Errors
    /// [`EffectError::NeedsStoreys`] where it is not.
    pub(super) fn check_storeys(&self, kind: &dyn EffectKind, structure: &Structure) -> Result<(), EffectError> {
        let directions = Storeys::of(structure).iter().flatten().count();
        let is_of_storeys = directions >= self.parameters.len().clamp(1, 2);
        is_of_storeys.then_some(()).ok_or_else(|| EffectError::NeedsStoreys { kind: kind.name() })
    }

    /// The error that the effect acts elsewhere.
    pub(super) fn wrong_place(&self, kind: &dyn EffectKind) -> EffectError {
        EffectError::wrong_place(kind.name(), kind.place(), self.place.map(Where::to_string).as_deref())
    }
}
