//! The numbers that an effect is made of.

use serde::Serialize;

/// A parameter of an effect. Bounds belong to the range.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Parameter {
    /// Its name, as in files and JSON.
    pub name: &'static str,
    /// Its unit; `-` for none.
    pub unit: &'static str,
    /// The least admissible value.
    pub least: f64,
    /// The greatest admissible value; infinite where there is none.
    #[serde(serialize_with = "finite")]
    pub greatest: f64,
    /// The value at which the effect is not there.
    pub neutral: f64,
    /// What a value means.
    pub meaning: &'static str,
    /// Its typical distance from the neutral value.
    pub prior: Prior,
    /// What it changes grows with this power of its distance from the neutral value.
    pub power: u8,
    /// Distances from the neutral value up to this are found in every good installation, and are no finding.
    pub usual: f64,
}

/// The typical size of a parameter: one standard deviation of what is expected before anything is measured.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Prior {
    /// This value.
    Value(f64),
    /// The value that moves the frequency it moves most by this share: what is typical depends on the structure.
    FrequencyShift(f64),
    /// This share of the value from which a fit starts, and about that value.
    Share(f64),
    /// It is given, not fitted.
    Given,
}

/// JSON knows no infinity.
fn finite<S: serde::Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    value.is_finite().then_some(*value).serialize(serializer)
}

/// An effect that is worth looking for moves a frequency by some percent.
pub const TYPICAL_SHIFT: f64 = 0.05;

impl Parameter {
    /// A number of zero or more whose typical size depends on the structure.
    pub(super) const fn positive(name: &'static str, unit: &'static str, meaning: &'static str) -> Self {
        let prior = Prior::FrequencyShift(TYPICAL_SHIFT);
        Self { name, unit, least: 0.0, greatest: f64::INFINITY, neutral: 0.0, meaning, prior, power: 1, usual: 0.0 }
    }

    /// The same of a number whose square is what counts, up to a greatest.
    pub(super) const fn squared(name: &'static str, unit: &'static str, greatest: f64, meaning: &'static str) -> Self {
        Self { greatest, power: 2, ..Self::positive(name, unit, meaning) }
    }

    /// A number between bounds, of a typical size.
    pub(super) const fn ranged(
        name: &'static str,
        unit: &'static str,
        [least, greatest]: [f64; 2],
        typical: f64,
        meaning: &'static str,
    ) -> Self {
        Self { name, unit, least, greatest, neutral: 0.0, meaning, prior: Prior::Value(typical), power: 1, usual: 0.0 }
    }

    /// A factor, which is not there at 1.
    pub(super) const fn factor(
        name: &'static str,
        [least, greatest]: [f64; 2],
        typical: f64,
        meaning: &'static str,
    ) -> Self {
        Self { neutral: 1.0, ..Self::ranged(name, "-", [least, greatest], typical, meaning) }
    }

    /// The same, where every good installation has distances up to this from the neutral value.
    pub(super) const fn usually_within(self, usual: f64) -> Self {
        Self { usual, ..self }
    }

    /// A number that is not fitted.
    pub(super) const fn given(
        name: &'static str,
        unit: &'static str,
        [least, greatest]: [f64; 2],
        meaning: &'static str,
    ) -> Self {
        Self { name, unit, least, greatest, neutral: 0.0, meaning, prior: Prior::Given, power: 1, usual: 0.0 }
    }

    /// The value that changes `times` as much as `small` does, both as distances from the neutral value.
    pub fn enlarged(&self, small: f64, times: f64) -> f64 {
        if self.power == 1 { small * times } else { small * times.abs().powf(1.0 / f64::from(self.power)) }
    }

    /// Whether a value, known to a standard deviation, may be one that every good installation has: it is not above that by two of them.
    pub fn is_usual(&self, value: f64, std: f64) -> bool {
        self.usual > 0.0 && (value - self.neutral).abs() - 2.0 * std <= self.usual
    }

    /// Whether it is fitted.
    pub fn is_fitted(&self) -> bool {
        self.prior != Prior::Given
    }

    /// The admissible values in words.
    pub fn range(&self) -> String {
        let unit = if self.unit == "-" { String::new() } else { format!(" {}", self.unit) };
        match (self.least.is_finite(), self.greatest.is_finite()) {
            (true, true) => format!("{} to {}{unit}", self.least, self.greatest),
            (true, false) => format!("{} or more{unit}", self.least),
            (false, true) => format!("{} or less{unit}", self.greatest),
            (false, false) if self.unit == "-" => "any number".to_owned(),
            (false, false) => format!("any number of {}", self.unit),
        }
    }

    /// A number in a study.
    pub(super) fn read(&self, value: &toml::Value) -> Option<f64> {
        let integer = || value.as_integer().map(|integer| integer as f64);
        value.as_float().or_else(integer).or_else(|| value.as_str().and_then(|word| self.read_word(word)))
    }

    /// A number as typed; the name of an axis is one too.
    pub(super) fn read_word(&self, word: &str) -> Option<f64> {
        match (self.name, word.trim()) {
            ("axis", "x" | "X") => Some(1.0),
            ("axis", "y" | "Y") => Some(2.0),
            (_, number) => number.parse().ok(),
        }
    }
}
