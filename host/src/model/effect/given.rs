//! An effect with its place and values, checked against its kind, and what it does to a structure.

use std::fmt;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::catalogue::find;
use super::error::EffectError;
use super::kind::{EffectKind, Given};
use super::parameter::Parameter;
use super::place::Where;
use super::target::in_study;
use crate::model::contribution::Contribution;
use crate::model::structure::{Body, Structure};
use crate::study::Sensor;

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
            bad_value(kind, value)
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

    /// The same effect at another place of the same kind.
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

    /// The same effect with its channels named as the study's sensors name them.
    ///
    /// # Errors
    /// [`EffectError::NoChannel`] and [`EffectError::NoNode`] where its channels or its node are not among the sensors.
    pub fn in_study(&self, sensors: &[Sensor]) -> Result<Self, EffectError> {
        let place = self.place.as_ref().map(|place| in_study(place, self.kind(), sensors)).transpose()?;
        Ok(Self { place, ..self.clone() })
    }

    /// What it contributes to `structure`.
    ///
    /// # Errors
    /// [`EffectError::OutsideBeam`] where its place is not on this structure, [`EffectError::NeedsBeam`] where it needs a beam
    /// table.
    pub fn contribution(&self, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        self.kind.contribution(&self.given(), structure)
    }

    /// A warning about its values in a structure.
    pub fn caution(&self, structure: &Structure) -> Option<String> {
        self.kind.caution(&self.given(), structure)
    }

    fn given(&self) -> Given<'_> {
        Given { parameters: self.parameters, values: &self.values, place: self.place.as_ref() }
    }

    /// `kind@where=value`, or `kind@where=name=value,...` of several: read again, it is this effect.
    pub fn typed(&self) -> String {
        let values: Vec<String> = match self.parameters().collect::<Vec<_>>()[..] {
            [(_, value)] => vec![format!("{value:e}")],
            ref several => several.iter().map(|(parameter, value)| format!("{}={value:e}", parameter.name)).collect(),
        };
        if values.is_empty() { self.to_string() } else { format!("{self}={}", values.join(",")) }
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

impl Structure {
    /// A body with effects, in their order; a beam is clamped at the base but for what they free.
    ///
    /// # Errors
    /// [`EffectError`] where an effect's height is not on this structure, or it needs a beam table.
    pub fn with_effects(body: impl Into<Body>, effects: &[Effect]) -> Result<Self, EffectError> {
        Self::new(body).and(effects)
    }

    /// The structure with more effects, in their order.
    ///
    /// # Errors
    /// As [`Structure::with_effects`].
    pub fn and(mut self, effects: &[Effect]) -> Result<Self, EffectError> {
        for effect in effects {
            let contribution = effect.contribution(&self)?;
            self.push(contribution);
        }
        Ok(self)
    }
}

/// Whether an effect of a kind can act at a place.
///
/// # Errors
/// [`EffectError::WrongPlace`], [`EffectError::NoPlace`].
pub(super) fn check_place(kind: &'static dyn EffectKind, place: Option<&Where>) -> Result<(), EffectError> {
    if kind.place().takes(place) {
        return Ok(());
    }
    Err(EffectError::wrong_place(kind.name(), kind.place(), place.map(Where::to_string).as_deref()))
}

/// The error that `value` is not one for an effect of a kind.
pub(super) fn bad_value(kind: &dyn EffectKind, value: String) -> EffectError {
    EffectError::BadValue { kind: kind.name(), value, expected: expected_value(kind), examples: examples(kind) }
}

/// How a kind is typed.
pub(super) fn examples(kind: &dyn EffectKind) -> String {
    kind.about().examples.join(" or ")
}

/// What a value of a kind looks like, in words.
pub(super) fn expected_value(kind: &dyn EffectKind) -> String {
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
