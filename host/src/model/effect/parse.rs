//! The words in which effects are typed: `KIND[@WHERE]=VALUE`.

use std::fmt;
use std::str::FromStr;

use super::{Effect, EffectError, Parameter, expected_value, find, set_of};

/// The part after the @: where an effect acts.
#[derive(Debug, Clone, PartialEq)]
pub enum Where {
    /// `443.6m`: a height in m.
    Height(f64),
    /// `ch07`, or several: `ch04+ch05`.
    Channels(Vec<String>),
    /// `node3`: a sensor node.
    Node(u16),
    /// `0.83hz`: a frequency in Hz.
    Frequency(f64),
    /// `cables`: the name of a `[[model.custom]]`.
    Name(String),
}

impl FromStr for Where {
    type Err = EffectError;

    fn from_str(text: &str) -> Result<Self, EffectError> {
        let number =
            |suffix| text.strip_suffix(suffix).and_then(|n: &str| n.parse::<f64>().ok()).filter(|n| n.is_finite());
        let channels =
            || text.split('+').map(|part| part.strip_prefix("ch").filter(|name| !name.is_empty()).map(str::to_owned));
        let place = if let Some(node) = text.strip_prefix("node").and_then(|n| n.parse().ok()) {
            Some(Self::Node(node))
        } else if let Some(frequency) = number("hz").or(number("Hz")).filter(|&hz| hz > 0.0) {
            Some(Self::Frequency(frequency))
        } else if let Some(height) = number("m") {
            Some(Self::Height(height))
        } else {
            let channels = channels().collect::<Option<_>>().map(Self::Channels);
            let is_word = |c: char| c.is_alphanumeric() || c == '-' || c == '_';
            channels.or_else(|| {
                let starts = text.starts_with(char::is_alphabetic);
                (starts && text.chars().all(is_word)).then(|| Self::Name(text.to_owned()))
            })
        };
        place.ok_or_else(|| EffectError::BadPlace { place: text.to_owned() })
    }
}

impl fmt::Display for Where {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Height(z_m) => write!(f, "{z_m}m"),
            Self::Channels(channels) => {
                let words: Vec<_> = channels.iter().map(|channel| format!("ch{channel}")).collect();
                f.write_str(&words.join("+"))
            }
            Self::Node(node) => write!(f, "node{node}"),
            Self::Frequency(frequency_hz) => write!(f, "{frequency_hz}hz"),
            Self::Name(name) => f.write_str(name),
        }
    }
}

/// `KIND[@WHERE]=VALUE`, where VALUE is a number, or `name=number,name=number` for a kind with several parameters:
/// `base-rotation=flexibility_x=1e-14,flexibility_y=2e-14`.
impl FromStr for Effect {
    type Err = EffectError;

    fn from_str(word: &str) -> Result<Self, EffectError> {
        let (head, value) = match word.split_once('=') {
            Some((head, value)) => (head, Some(value.trim()).filter(|value| !value.is_empty())),
            None => (word, None),
        };
        let (name, place) = match head.split_once('@') {
            Some((name, place)) => (name.trim(), Some(place.trim().parse::<Where>())),
            None => (head.trim(), None),
        };
        // The kind first: a wrong name is the likeliest slip, and its error lists the names there are.
        let kind = find(name)?;
        let place = place.transpose()?;
        let Some(value) = value else {
            // Kinds that are there or not have no value.
            let none = kind.parameter_sets().iter().find(|set| set.is_empty() && !word.contains('='));
            let set = none.ok_or_else(|| EffectError::NoValue { word: word.to_owned() })?;
            return Self::with_parameters(kind, place, set, &[]);
        };
        let bad =
            || EffectError::BadValue { kind: kind.name(), value: value.to_owned(), expected: expected_value(kind) };
        if let Ok(number) = value.parse::<f64>() {
            let set = kind.parameter_sets().iter().find(|set| set.len() == 1).ok_or_else(bad)?;
            return Self::with_parameters(kind, place, set, &[number]);
        }
        let mut given = Vec::new();
        for part in value.split(',') {
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
