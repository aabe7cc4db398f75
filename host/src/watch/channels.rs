//! Combinations of modes whose errors are independent: the principal components of how frequencies move from day to day.
//!
//! What moves all modes at once, weather that the temperatures do not tell, is in the first of them and leaves the others alone (Yan,
//! Kerschen, De Boe and Golinval 2005, "Structural damage diagnosis under varying environmental conditions", part I).

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::block::Block;
use crate::statistics::{MEDIAN_OF_ABSOLUTE, median};

/// No frequency of a structure is steadier from day to day than this (relative).
const STEADIEST: f64 = 2e-5;
/// A mode that a day does not show is taken from the days beside it, with so many times the usual difference of two days as its deviation.
const OF_A_GAP: f64 = 5.0;
/// Days that differ from the day before by more deviations count as if they differed by so many.
const MOST: f64 = 3.0;
/// A component has at least this share of the variance that independent modes would have: from few days it may look smaller by chance.
const LEAST_VARIANCE: f64 = 0.05;

/// Logarithms of frequencies about their means, days x modes, and their variances by the measurement.
pub(super) struct Observed {
    pub(super) values: DMatrix<f64>,
    pub(super) variances: DMatrix<f64>,
    /// How far each mode moves from day to day.
    daily: Vec<f64>,
}

impl Observed {
    pub(super) fn of(blocks: &[Block]) -> Self {
        let modes = blocks.first().map_or(0, |block| block.modes.len());
        let (mut values, mut variances) = (DMatrix::zeros(blocks.len(), modes), DMatrix::zeros(blocks.len(), modes));
        let mut all_daily = Vec::with_capacity(modes);
        for mode in 0..modes {
            let seen: Vec<(usize, f64)> =
                blocks.iter().enumerate().filter_map(|(day, block)| Some((day, block.modes[mode]?.value))).collect();
            let mean = seen.iter().map(|(_, value)| value).sum::<f64>() / seen.len().max(1) as f64;
            let mut steps: Vec<f64> = seen.windows(2).map(|pair| (pair[1].1 - pair[0].1).abs()).collect();
            // A step has the variance of two days.
            let daily =
                (median(&mut steps).unwrap_or(0.0) / MEDIAN_OF_ABSOLUTE / std::f64::consts::SQRT_2).max(STEADIEST);
            all_daily.push(daily);
            for (day, block) in blocks.iter().enumerate() {
                match block.modes[mode] {
                    Some(here) => {
                        values[(day, mode)] = here.value - mean;
                        variances[(day, mode)] = here.std * here.std;
                    }
                    None => {
                        values[(day, mode)] = between(&seen, day).map_or(0.0, |value| value - mean);
                        variances[(day, mode)] = (OF_A_GAP * daily).powi(2);
                    }
                }
            }
        }
        Self { values, variances, daily: all_daily }
    }

    /// Channels x modes: the combinations, each with errors of about one.
    pub(super) fn channels(&self) -> DMatrix<f64> {
        let (days, modes) = self.values.shape();
        let mut correlation = DMatrix::zeros(modes, modes);
        for day in 1..days {
            let step = DVector::from_fn(modes, |mode, _| {
                let step = self.values[(day, mode)] - self.values[(day - 1, mode)];
                (step / (self.daily[mode] * std::f64::consts::SQRT_2)).clamp(-MOST, MOST)
            });
            correlation += &step * step.transpose();
        }
        correlation /= days.saturating_sub(1).max(1) as f64;
        // Correlations known from few days are shrunk.
        let kept = days as f64 / (days as f64 + 2.0 * modes as f64);
        for row in 0..modes {
            for column in (0..modes).filter(|column| *column != row) {
                correlation[(row, column)] *= kept;
            }
        }
        let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new(correlation);
        DMatrix::from_fn(modes, modes, |channel, mode| {
            eigenvectors[(mode, channel)] / eigenvalues[channel].max(LEAST_VARIANCE).sqrt() / self.daily[mode]
        })
    }
}

/// On the straight line between the days beside it; beyond the first or the last, that one.
fn between(seen: &[(usize, f64)], day: usize) -> Option<f64> {
    let after = seen.partition_point(|(other, _)| *other < day);
    match (after.checked_sub(1).map(|before| seen[before]), seen.get(after)) {
        (Some((from, low)), Some(&(to, high))) => Some(low + (high - low) * (day - from) as f64 / (to - from) as f64),
        (Some((_, value)), None) | (None, Some(&(_, value))) => Some(value),
        (None, None) => None,
    }
}
