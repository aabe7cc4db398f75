//! What has changed between two measurements, as it is printed and stored.

use serde::Serialize;

use super::difference::Difference;
use super::pairing::mac_of;
use crate::compare::{ChiSquared, exceeding};
use crate::modes::{MeasuredMode, WRONG_BY, WRONGLY_IDENTIFIED};
use crate::statistics::at_least;

/// What has changed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Changes {
    /// Modes that both measurements have, in the order of now's.
    pub modes: Vec<ModeChange>,
    /// Modes that only the measurement before has.
    pub only_before: Vec<LonelyMode>,
    /// Modes that only the measurement of now has.
    pub only_now: Vec<LonelyMode>,
    /// Whether anything has changed; null where the measurements have no mode in common.
    pub test: Option<Test>,
    /// The change of all frequencies alike that fits them best, in percent, by inverse variance.
    pub common_percent: Option<f64>,
    /// Its standard deviation.
    pub common_percent_std: Option<f64>,
    /// Probability of as much difference between the modes, had all frequencies changed alike and nothing else.
    pub p_value_of_common: Option<f64>,
}

/// A mode in both measurements.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModeChange {
    /// Its number before.
    pub before: usize,
    /// Its number now.
    pub now: usize,
    /// Its frequency before.
    pub before_hz: f64,
    /// And now.
    pub now_hz: f64,
    /// By how much that has changed.
    pub change_percent: f64,
    /// The standard deviation of this, by both measurements.
    pub change_percent_std: f64,
    /// The damping ratio before, where it is known.
    pub damping_before: Option<f64>,
    /// And now.
    pub damping_now: Option<f64>,
    /// The difference of damping ratios in standard deviations; null where these are unknown.
    pub damping_z: Option<f64>,
    /// Modal assurance criterion of both shapes; null where one is not known.
    pub mac: Option<f64>,
    /// Numbers before of the close modes whose span its shape is compared with; empty for a mode that stands alone.
    pub close_to: Vec<usize>,
    /// Probability of as much change of its frequency by errors of the measurements alone.
    pub p_value_of_frequency: f64,
    /// The same of its shape.
    pub p_value_of_shape: Option<f64>,
    /// The same of both together.
    pub p_value: f64,
}

/// A mode that only one of the measurements has.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LonelyMode {
    /// Its number.
    pub number: usize,
    /// Its frequency.
    pub frequency_hz: f64,
}

/// A test whether anything has changed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Test {
    /// Squared differences in standard deviations, of all frequencies and shapes.
    pub chi_squared: f64,
    /// How many numbers these are.
    pub degrees_of_freedom: usize,
    /// Probability of as much by errors of the measurements alone: of all frequencies or of all shapes, whichever is less, twice; the highest
    /// over how many modes identification may have got wrong, times that it does so.
    pub p_value: f64,
    /// Numbers (now) of the modes that it may have got wrong, where nothing counts as changed for that.
    pub may_be_wrong: Vec<usize>,
}

/// Below this probability something has changed.
pub(super) const CHANGED: f64 = 0.01;

impl Test {
    /// Of all differences.
    fn of(differences: &[Difference], now: &[MeasuredMode]) -> Option<Self> {
        let (all, p_value) = tested(differences, &[])?;
        let mut best = (p_value, 0);
        let mut worst: Vec<(usize, f64)> = differences.iter().map(|one| one.test().p_value).enumerate().collect();
        worst.sort_by(|a, b| a.1.total_cmp(&b.1));
        let worst: Vec<usize> = worst.into_iter().map(|(at, _)| at).collect();
        for count in 1..=worst.len() {
            let chance = at_least(count, worst.len(), 2.0 * WRONGLY_IDENTIFIED);
            if chance < CHANGED.max(best.0) {
                break;
            }
            let p_value = chance * tested(differences, &worst[..count]).map_or(1.0, |(_, p_value)| p_value);
            if p_value > best.0 {
                best = (p_value, count);
            }
        }
        let excused = if best.0 < CHANGED { 0 } else { best.1 };
        let mut may_be_wrong: Vec<usize> = worst[..excused].iter().map(|&at| now[differences[at].now].number).collect();
        may_be_wrong.sort_unstable();
        Some(Self {
            chi_squared: all.chi_squared,
            degrees_of_freedom: all.degrees_of_freedom,
            p_value: best.0,
            may_be_wrong,
        })
    }

    /// Whether anything has changed.
    pub fn has_changed(&self) -> bool {
        self.p_value < CHANGED
    }
}

/// All squared differences, where some modes (indices) have deviations that are wrong as [`WRONG_BY`] says. Hundreds of components of shapes
/// would hide what a dozen frequencies say, so each is tested by itself (Bonferroni).
fn tested(differences: &[Difference], wrong: &[usize]) -> Option<(ChiSquared, f64)> {
    let (mut frequencies, mut shapes) = ((0.0, 0), (0.0, 0));
    for (at, difference) in differences.iter().enumerate() {
        let [by_frequency, by_shape] = if wrong.contains(&at) { WRONG_BY } else { [1.0; 2] };
        frequencies = (frequencies.0 + difference.of_frequency() * by_frequency.powi(-2), frequencies.1 + 1);
        if let Some((square, count)) = difference.of_shape() {
            shapes = (shapes.0 + square * by_shape.powi(-2), shapes.1 + count);
        }
    }
    (frequencies.1 > 0).then_some(())?;
    let all = ChiSquared::of(frequencies.0 + shapes.0, frequencies.1 + shapes.1);
    let of = |(square, count): (f64, usize)| exceeding(square, count as f64);
    let p_value = if shapes.1 == 0 { of(frequencies) } else { (2.0 * of(frequencies).min(of(shapes))).min(1.0) };
    Some((all, p_value))
}

impl Changes {
    pub(super) fn of(before: &[MeasuredMode], now: &[MeasuredMode], differences: &[Difference]) -> Self {
        let lonely = |mode: &MeasuredMode| LonelyMode { number: mode.number, frequency_hz: mode.frequency_hz };
        let lonely = |modes: &[MeasuredMode], is_paired: &dyn Fn(usize) -> bool| -> Vec<LonelyMode> {
            modes.iter().enumerate().filter(|(index, _)| !is_paired(*index)).map(|(_, mode)| lonely(mode)).collect()
        };
        let common = Common::of(differences);
        Self {
            modes: differences.iter().map(|difference| ModeChange::of(before, now, difference)).collect(),
            only_before: lonely(before, &|index| differences.iter().any(|one| one.before == index)),
            only_now: lonely(now, &|index| differences.iter().any(|one| one.now == index)),
            test: Test::of(differences, now),
            common_percent: common.map(|common| 100.0 * common.mean),
            common_percent_std: common.map(|common| 100.0 * common.std),
            p_value_of_common: common.map(|common| common.p_value),
        }
    }

    /// Whether anything has changed; `None` without a mode in common.
    pub fn has_changed(&self) -> Option<bool> {
        self.test.as_ref().map(Test::has_changed)
    }

    /// Whether all frequencies have changed alike, as temperature changes them.
    pub fn is_common(&self) -> bool {
        let stands_out = |mean: f64, std: f64| mean.abs() > COMMON * std;
        self.modes.len() > 2
            && self.p_value_of_common.is_some_and(|p_value| p_value >= CHANGED)
            && self.common_percent.zip(self.common_percent_std).is_some_and(|(mean, std)| stands_out(mean, std))
    }
}

/// A common change stands out at so many deviations.
const COMMON: f64 = 3.0;

/// The change that all frequencies have in common.
#[derive(Clone, Copy)]
struct Common {
    mean: f64,
    std: f64,
    p_value: f64,
}

impl Common {
    fn of(differences: &[Difference]) -> Option<Self> {
        let weight = |one: &Difference| one.frequency_std().powi(-2);
        let total: f64 = differences.iter().map(weight).sum();
        let mean = differences.iter().map(|one| weight(one) * one.numbers[0]).sum::<f64>() / total;
        let left: f64 = differences.iter().map(|one| weight(one) * (one.numbers[0] - mean).powi(2)).sum();
        let freedom = differences.len().checked_sub(1).filter(|freedom| *freedom > 0)?;
        let of_shapes = differences.iter().filter_map(Difference::of_shape);
        let shapes = of_shapes.fold((0.0, 0), |sum, (square, count)| (sum.0 + square, sum.1 + count));
        let p_values = [exceeding(left, freedom as f64), exceeding(shapes.0, shapes.1 as f64)];
        Some(Self { mean, std: total.sqrt().recip(), p_value: (2.0 * p_values[0].min(p_values[1])).min(1.0) })
    }
}

impl ModeChange {
    fn of(before: &[MeasuredMode], now: &[MeasuredMode], difference: &Difference) -> Self {
        let (one, other) = (&before[difference.before], &now[difference.now]);
        let ratio = other.frequency_hz / one.frequency_hz;
        let spanning = difference.shape.iter().flat_map(|shape| &shape.spanned_by);
        let close_to: Vec<usize> = spanning.map(|(index, _)| before[*index].number).collect();
        let damping = one.damping_ratio.zip(other.damping_ratio).map(|(one, other)| other - one);
        let damping_std = one.damping_ratio_std.zip(other.damping_ratio_std).map(|(one, other)| one.hypot(other));
        Self {
            before: one.number,
            now: other.number,
            before_hz: one.frequency_hz,
            now_hz: other.frequency_hz,
            change_percent: 100.0 * (ratio - 1.0),
            change_percent_std: 100.0 * ratio * difference.frequency_std(),
            damping_before: one.damping_ratio,
            damping_now: other.damping_ratio,
            damping_z: damping.zip(damping_std).map(|(damping, std)| damping / std),
            mac: mac_of(one, other),
            close_to: if close_to.len() > 1 { close_to } else { Vec::new() },
            p_value_of_frequency: exceeding(difference.of_frequency(), 1.0),
            p_value_of_shape: difference.of_shape().map(|(square, count)| exceeding(square, count as f64)),
            p_value: difference.test().p_value,
        }
    }
}
