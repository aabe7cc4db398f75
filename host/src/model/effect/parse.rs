//! Effects in words: `KIND[@WHERE]=VALUE` as typed, and `[[model.effect]]` of a study.

use std::str::FromStr;

use super::catalogue::find;
use super::error::EffectError;
use super::given::{Effect, bad_value, check_place, examples, expected_value};
use super::kind::EffectKind;
use super::parameter::Parameter;
use super::place::Where;
use super::target::in_study;
use crate::study::Sensor;

/// `KIND[@WHERE]=VALUE`, where VALUE is a number. A kind of several parameters takes `name=number,name=number` in any order,
/// or the numbers alone in the order of the catalogue: `base-rotation=flexibility_x=1e-14,flexibility_y=2e-14` or
/// `base-rotation=1e-14,2e-14`.
impl FromStr for Effect {
    type Err = EffectError;

    fn from_str(word: &str) -> Result<Self, EffectError> {
        let (head, value) = match word.split_once('=') {
            Some((head, value)) => (head, Some(value.trim()).filter(|value| !value.is_empty())),
            None => (word, None),
        };
        let (kind, place) = typed(head)?;
        let Some(value) = value else {
            // Kinds that are there or not have no value.
            let none = kind.parameter_sets().iter().find(|set| set.is_empty() && !word.contains('='));
            let set = none.ok_or_else(|| EffectError::NoValue {
                word: word.to_owned(),
                expected: expected_value(kind),
                examples: examples(kind),
            })?;
            return Self::with_parameters(kind, place, set, &[]);
        };
        let bad = || bad_value(kind, value.to_owned());
        let parts: Vec<&str> = value.split(',').map(str::trim).collect();
        if !value.contains('=') {
            let read = |set: &&'static [Parameter]| {
                let values = set.iter().zip(&parts).map(|(parameter, word)| parameter.read_word(word));
                Some((*set, values.collect::<Option<Vec<f64>>>()?))
            };
            let sets = kind.parameter_sets().iter().filter(|set| set.len() == parts.len());
            let (set, values) = sets.into_iter().find_map(read).ok_or_else(bad)?;
            return Self::with_parameters(kind, place, set, &values);
        }
        let mut given = Vec::new();
        for part in parts {
            let (parameter, number) = part.split_once('=').ok_or_else(bad)?;
            given.push((parameter.trim(), number.trim()));
        }
        let value_of = |parameter: &Parameter| {
            given.iter().find(|(given, _)| *given == parameter.name).and_then(|(_, word)| parameter.read_word(word))
        };
        let (set, values) = set_of(kind, given.len(), value_of).ok_or_else(bad)?;
        Self::with_parameters(kind, place, set, &values)
    }
}

impl Effect {
    /// An effect as it stands in a study: `value` for a kind with one parameter, else the parameters by name. Standard
    /// deviations that stand beside them (`std`, `..._std`) are skipped.
    ///
    /// # Errors
    /// As [`Effect::new`], and where a parameter is missing, unknown or not a number.
    pub fn from_study(written: &crate::study::Effect) -> Result<Self, EffectError> {
        let kind = find(&written.kind)?;
        let place = written.location.as_deref().map(|text| read_place(kind, text)).transpose()?;
        let given: Vec<(&str, &toml::Value)> = written
            .parameters
            .iter()
            .map(|(name, value)| (name.as_str(), value))
            .filter(|(name, _)| *name != "std" && !name.ends_with("_std"))
            .collect();
        if let [("value", value)] = given[..] {
            let single =
                kind.parameter_sets().iter().find_map(|set| if let [only] = set { Some((set, only)) } else { None });
            let (set, only) = single.ok_or_else(|| bad_value(kind, value.to_string()))?;
            let number = only.read(value).ok_or_else(|| bad_value(kind, value.to_string()))?;
            return Self::with_parameters(kind, place, set, &[number]);
        }
        let words = || {
            let words: Vec<String> = given.iter().map(|(name, value)| format!("{name} = {value}")).collect();
            if words.is_empty() { "nothing".to_owned() } else { words.join(", ") }
        };
        let value_of = |parameter: &Parameter| {
            given.iter().find(|(name, _)| *name == parameter.name).and_then(|(_, value)| parameter.read(value))
        };
        let (set, values) = set_of(kind, given.len(), value_of).ok_or_else(|| bad_value(kind, words()))?;
        Self::with_parameters(kind, place, set, &values)
    }
}

/// `KIND` or `KIND@WHERE` as typed, without values: the kind, and where.
///
/// # Errors
/// [`EffectError`]: an unknown kind, or a place that does not suit it.
pub fn named(word: &str) -> Result<(&'static dyn EffectKind, Option<Where>), EffectError> {
    let (kind, place) = typed(word)?;
    check_place(kind, place.as_ref())?;
    Ok((kind, place))
}

/// As [`named`], with channels named as the study's sensors name them.
///
/// # Errors
/// As [`named`], and where the place is not among the sensors.
pub fn named_in_study(word: &str, sensors: &[Sensor]) -> Result<(&'static dyn EffectKind, Option<Where>), EffectError> {
    let (kind, place) = named(word)?;
    Ok((kind, place.map(|place| in_study(&place, kind.name(), sensors)).transpose()?))
}

/// The kind first: a wrong name is the likeliest slip, and its error lists the names there are.
fn typed(head: &str) -> Result<(&'static dyn EffectKind, Option<Where>), EffectError> {
    let (name, place) = match head.split_once('@') {
        Some((name, place)) => (name, Some(place)),
        None => (head, None),
    };
    let kind = find(name.trim())?;
    Ok((kind, place.map(|place| read_place(kind, place)).transpose()?))
}

fn read_place(kind: &'static dyn EffectKind, text: &str) -> Result<Where, EffectError> {
    let wrong = || EffectError::wrong_place(kind.name(), kind.place(), Some(text.trim()));
    kind.place().read(text).ok_or_else(wrong)
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
