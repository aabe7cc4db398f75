//! Numbers in bulk, packed for the page: a picture needs no more digits than a screen has points.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::{Deserialize, Serialize};

/// Steps that a range is cut into, by the size of a number.
const STEPS_U8: f64 = 254.0;
const STEPS_U16: f64 = 65534.0;

/// Numbers as steps of a range: the value is `from + step * n`, its power of ten where `log`; the largest n stands for none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Packed {
    r#type: PackedType,
    /// The numbers n, little-endian.
    base64: String,
    from: f64,
    step: f64,
    log: bool,
}

/// The size of a packed number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PackedType {
    /// A byte.
    U8,
    /// Two bytes.
    U16,
}

impl Packed {
    /// Numbers to 1/65534 of their range.
    pub fn fine(values: impl IntoIterator<Item = f64>) -> Self {
        Self::of(values.into_iter().collect(), PackedType::U16, false)
    }

    /// The logarithms of positive numbers to 1/65534 of their range; others count as missing.
    pub fn fine_log(values: impl IntoIterator<Item = f64>) -> Self {
        Self::of(logarithms(values), PackedType::U16, true)
    }

    /// The logarithms of positive numbers to 1/254 of their range: for colours.
    pub fn coarse_log(values: impl IntoIterator<Item = f64>) -> Self {
        Self::of(logarithms(values), PackedType::U8, true)
    }

    fn of(values: Vec<f64>, r#type: PackedType, log: bool) -> Self {
        let finite = || values.iter().copied().filter(|value| value.is_finite());
        let (low, high) = finite().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        let steps = if r#type == PackedType::U8 { STEPS_U8 } else { STEPS_U16 };
        let from = if low.is_finite() { low } else { 0.0 };
        // In halves: the range of the largest numbers would overflow.
        let range = 2.0 * (0.5 * high - 0.5 * low);
        let step = if range > 0.0 && range.is_finite() { range / steps } else { 1.0 };
        let steps_of = |value: f64| {
            if value.is_finite() { ((value - from) / step).round().clamp(0.0, steps) } else { steps + 1.0 }
        };
        let bytes: Vec<u8> = match r#type {
            PackedType::U8 => values.iter().map(|value| steps_of(*value) as u8).collect(),
            PackedType::U16 => values.iter().flat_map(|value| (steps_of(*value) as u16).to_le_bytes()).collect(),
        };
        Self { r#type, base64: STANDARD.encode(bytes), from, step, log }
    }

    /// The numbers again; NaN where there is none, nothing where they were not packed by this.
    pub fn values(&self) -> Vec<f64> {
        let bytes = STANDARD.decode(&self.base64).unwrap_or_default();
        let value = |n: f64, steps: f64| {
            let value = if n > steps { f64::NAN } else { self.from + self.step * n };
            if self.log { 10_f64.powf(value) } else { value }
        };
        match self.r#type {
            PackedType::U8 => bytes.iter().map(|n| value(f64::from(*n), STEPS_U8)).collect(),
            PackedType::U16 => {
                let (pairs, _) = bytes.as_chunks();
                pairs.iter().map(|pair| value(f64::from(u16::from_le_bytes(*pair)), STEPS_U16)).collect()
            }
        }
    }
}

/// NaN where there is no logarithm.
fn logarithms(values: impl IntoIterator<Item = f64>) -> Vec<f64> {
    values.into_iter().map(|value| if value > 0.0 { value.log10() } else { f64::NAN }).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn numbers_come_back_to_a_step_of_their_range(values in prop::collection::vec(prop::num::f64::ANY, 0..50)) {
            let back = Packed::fine(values.iter().copied()).values();
            let finite: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
            let low = finite.iter().copied().fold(f64::INFINITY, f64::min);
            let range = finite.iter().copied().fold(f64::NEG_INFINITY, f64::max) - low;
            prop_assert_eq!(back.len(), values.len());
            for (value, back) in values.iter().zip(&back).filter(|_| range.is_finite()) {
                let near = (value - back).abs() <= range / STEPS_U16 + 1e-12 * value.abs();
                prop_assert!(if value.is_finite() { near } else { back.is_nan() }, "{} {}", value, back);
            }
        }
    }

    #[test]
    fn logarithms_keep_their_relative_error_over_decades() {
        let densities: Vec<f64> = (0..400).map(|line| 1e-12 * 1.07_f64.powi(line)).collect();
        let back = Packed::fine_log(densities.iter().copied()).values();
        assert!(densities.iter().zip(&back).all(|(there, back)| (back / there - 1.0).abs() < 5e-4));
        let coarse = Packed::coarse_log([1e-9, 0.0, -1.0, 1e-3, f64::INFINITY]).values();
        assert!((coarse[0] / 1e-9 - 1.0).abs() < 1e-6 && (coarse[3] / 1e-3 - 1.0).abs() < 1e-6);
        assert!(coarse[1].is_nan() && coarse[2].is_nan() && coarse[4].is_nan());
        assert_eq!(Packed::fine([]).values(), Vec::<f64>::new());
        assert_eq!(Packed::fine([3.5, 3.5]).values(), [3.5, 3.5]);
    }
}
