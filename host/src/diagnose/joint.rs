//! How the values of effects go together: their joint covariance.
//!
//! A [`Fit`] flows in; values, covariance and correlation flow out. Segments are free within the model's tolerance there, so the
//! covariance is that of the effects whatever the segments are.

use serde::{Deserialize, Serialize};

use super::fit::Fit;

/// Fitted values of effects, and how their errors go together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Joint {
    /// The values, in the order of rows and columns.
    pub values: Vec<JointValue>,
    /// Covariance, in the products of the values' units.
    pub covariance: Vec<Vec<f64>>,
    /// Correlation.
    pub correlation: Vec<Vec<f64>>,
}

/// A fitted value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JointValue {
    /// The effect.
    pub effect: String,
    /// The parameter.
    pub parameter: String,
    /// Its value.
    pub value: f64,
    /// Its standard deviation.
    pub std: f64,
    /// The unit of both; `-` for a pure number.
    pub unit: String,
}

/// Two values so strongly correlated are known together better than apart: were one known, the other's deviation would be less than half.
const STRONG: f64 = 0.9;

impl Fit {
    /// The values of all effects that were fitted, with their joint covariance; `None` where there are none.
    pub fn joint(&self) -> Option<Joint> {
        let count = self.knobs.len();
        let values: Vec<JointValue> = (0..count)
            .filter_map(|at| {
                let knob = &self.knobs[at];
                let effect = self.state.effects.get(knob.effect)?;
                let (parameter, value) = effect.parameters().nth(knob.parameter)?;
                let std = self.stated_variance(at).sqrt() * knob.scale;
                let (name, unit) = (parameter.name.to_owned(), parameter.unit.to_owned());
                Some(JointValue { effect: effect.to_string(), parameter: name, value, std, unit })
            })
            .collect();
        if values.is_empty() || values.len() < count {
            return None;
        }
        let table = |of: &dyn Fn(usize, usize) -> f64| -> Vec<Vec<f64>> {
            (0..count).map(|row| (0..count).map(|column| of(row, column)).collect()).collect()
        };
        let scale = |at: usize| self.knobs[at].scale;
        // Mirror images differ by rounding.
        let of_units = |row: usize, column: usize| match row == column {
            true => self.stated_variance(row),
            false => self.covariance[(row.max(column), row.min(column))],
        };
        let covariance = table(&|row, column| of_units(row, column) * (scale(row) * scale(column)));
        let size = |at: usize| self.stated_variance(at).sqrt();
        let correlation = table(&|row, column| match size(row) * size(column) {
            product if product > 0.0 => (of_units(row, column) / product).clamp(-1.0, 1.0),
            _ => 0.0,
        });
        Some(Joint { values, covariance, correlation })
    }
}

impl Joint {
    /// A sentence for each two values of different effects that are strongly correlated.
    pub fn in_words(&self) -> Vec<String> {
        let mut sentences = Vec::new();
        for (row, one) in self.values.iter().enumerate() {
            for (column, other) in self.values.iter().enumerate().take(row) {
                let correlation = self.correlation.get(row).and_then(|row| row.get(column)).copied().unwrap_or(0.0);
                if one.effect != other.effect && correlation.abs() > STRONG {
                    let known = if correlation < 0.0 { "their sum" } else { "their difference" };
                    sentences.push(format!(
                        "{} and {} go together (correlation {correlation:+.2}): the data know {known}, each in its deviations, better than either",
                        other.name(),
                        one.name()
                    ));
                }
            }
        }
        sentences
    }
}

impl JointValue {
    /// `value of effect`.
    fn name(&self) -> String {
        format!("{} of {}", self.parameter, self.effect)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(effect: &str, parameter: &str) -> JointValue {
        let (effect, parameter) = (effect.to_owned(), parameter.to_owned());
        JointValue { effect, parameter, value: 1.0, std: 0.1, unit: "-".to_owned() }
    }

    /// Two values of one effect may go together as they like; two effects that do are told, with what is known of them.
    #[test]
    fn effects_that_go_together_are_told() {
        let values = vec![value("base-rotation", "x"), value("base-rotation", "y"), value("p-delta", "factor")];
        let correlation = vec![vec![1.0, 0.99, -0.95], vec![0.99, 1.0, 0.5], vec![-0.95, 0.5, 1.0]];
        let covariance = correlation.iter().map(|row: &Vec<f64>| row.iter().map(|one| 0.01 * one).collect()).collect();
        let words = Joint { values, covariance, correlation }.in_words();
        assert_eq!(words.len(), 1);
        assert!(
            words[0].starts_with("x of base-rotation and factor of p-delta go together (correlation -0.95)"),
            "{words:?}"
        );
        assert!(words[0].contains("their sum"), "{words:?}");
    }
}
