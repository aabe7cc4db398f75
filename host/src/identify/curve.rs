//! What a fit looks like: a mode's spectrum behind its modal filter, as measured and as the fit expects it.
//!
//! The last fit of a mode flows in, and what its replicates measure; the curves, and how far they are from each other, flow out.

use std::ops::Range;

use nalgebra::DMatrix;
use num_complex::Complex64;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::bell::{Bell, BellFit};
use super::joint::Seen;
use super::resonance::Resonance;
use super::scatter::jackknife;
use super::shape::{Shape, filtered};
use crate::spectra::CrossSpectrum;
use crate::statistics::median;

/// Chance makes fits look as bad as this once in so many modes; what is worse is something that the model of the spectrum lacks.
const CHANCE: f64 = 1e-4;
/// Neighbouring lines of Hann's window are correlated by 2/3, so squares of residuals by (2/3)⁴ on either side: the sum of them scatters
/// by as much more than that of independent ones.
const JOINED: f64 = 1.395;

/// A mode's spectrum at the lines of its fit.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Curve {
    frequency_hz: Vec<f64>,
    measured: Vec<f64>,
    /// Of the mode alone, and of everything; none where the fit was not asked.
    expected: Vec<[f64; 2]>,
}

impl Curve {
    /// What a mode of a joint fit looks like, where it is at `place`; `expected` has P and S at each line, if the fit was asked.
    pub(super) fn of_joint(seen: &Seen, expected: Option<[&[DMatrix<Complex64>]; 2]>, place: usize) -> Self {
        let own = |matrix: &DMatrix<Complex64>| matrix[(place, place)].re;
        let expected =
            expected.map(|[alone, all]| alone.iter().zip(all).map(|(alone, all)| [own(alone), own(all)]).collect());
        Self {
            frequency_hz: seen.frequency_hz.clone(),
            measured: seen.matrices.iter().map(own).collect(),
            expected: expected.unwrap_or_default(),
        }
    }

    /// What a mode that is fitted alone looks like.
    pub(super) fn of_bell(fit: &BellFit, bell: Bell) -> Self {
        Self { frequency_hz: bell.frequency_hz, measured: bell.density, expected: fit.expected.clone() }
    }

    /// What a pole looks like that explains `level` of the response along a shape of unit length, in these lines; what lies beside it is
    /// taken for a floor.
    pub(super) fn of_pole(
        spectrum: &CrossSpectrum,
        shape: &Shape,
        resonance: &Resonance,
        level: f64,
        lines: Range<usize>,
    ) -> Self {
        let grid = spectrum.grid();
        let line_shape = resonance.line_shape(1.0 / grid.spacing_hz());
        let frequency_hz: Vec<f64> = lines.clone().map(|line| grid.frequency_hz(line)).collect();
        let measured: Vec<f64> = lines.map(|line| filtered(shape, &spectrum.matrix(line))).collect();
        let alone: Vec<f64> = frequency_hz.iter().map(|&hz| level * line_shape.density(hz)).collect();
        let mut left: Vec<f64> = measured.iter().zip(&alone).map(|(measured, alone)| measured - alone).collect();
        let floor = median(&mut left).unwrap_or(0.0).max(0.0);
        let expected = alone.iter().map(|alone| [*alone, alone + floor]).collect();
        Self { frequency_hz, measured, expected }
    }

    /// Its lines in Hz with what is measured and expected of everything there: (frequency, measured, expected).
    pub(super) fn lines(&self) -> impl Iterator<Item = (f64, f64, f64)> {
        let both = self.frequency_hz.iter().zip(&self.measured).zip(&self.expected);
        both.map(|((hz, measured), expected)| (*hz, *measured, expected[1]))
    }

    /// What is measured at a line of the same grid, which has the same frequency to the last bit.
    fn at(&self, frequency_hz: f64) -> Option<f64> {
        let line = self.frequency_hz.binary_search_by(|hz| hz.total_cmp(&frequency_hz));
        self.measured.get(line.ok()?).copied()
    }

    /// How far the fit is from the measurement; `replicates` are the curves without one group of windows each, which say how
    /// much the measurement scatters. `None` with fewer than two replicates.
    ///
    /// Lines count by the share that the mode has in them: elsewhere other modes and noise are misjudged without harm to it.
    pub(super) fn misfit(&self, replicates: &[&Self]) -> Option<Misfit> {
        let groups = replicates.len();
        if groups < 2 {
            return None;
        }
        let (mut weights, mut weights_squared, mut away, mut scatter) = (0.0, 0.0, 0.0, 0.0);
        for (index, (hz, measured, expected)) in self.lines().enumerate() {
            let others: Vec<f64> = replicates.iter().filter_map(|replicate| replicate.at(hz)).collect();
            if others.len() < groups || expected <= 0.0 {
                continue;
            }
            let weight = (self.expected[index][0] / expected).clamp(0.0, 1.0);
            weights += weight;
            weights_squared += weight * weight;
            away += weight * (measured / expected - 1.0).powi(2);
            scatter += weight * (jackknife(&others) / expected).powi(2);
        }
        let lines = weights * weights / (JOINED * weights_squared);
        let ratio = away / scatter;
        let by_chance = FisherSnedecor::new(lines, lines * (groups - 1) as f64).ok()?.sf(ratio);
        by_chance.is_finite().then_some(Misfit { ratio: ratio.sqrt(), scatter: (scatter / weights).sqrt(), by_chance })
    }
}

/// How far a fit is from what was measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Misfit {
    /// Root mean square of the residuals over their own scatter: about 1, or less, where nothing is missing in the fit.
    pub(super) ratio: f64,
    /// Relative standard deviation of a measured density.
    pub(super) scatter: f64,
    /// The probability of as large a one by chance.
    by_chance: f64,
}

impl Misfit {
    /// Whether more than chance is left.
    pub(super) fn is_significant(&self) -> bool {
        self.by_chance < CHANCE && self.ratio > 1.0
    }

    #[cfg(test)]
    pub(super) fn of_ratio(ratio: f64) -> Self {
        Self { ratio, scatter: 0.1, by_chance: if ratio > 2.0 { 0.0 } else { 1.0 } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bell of 21 lines whose measurement is `away` times what is expected, with replicates that scatter by a tenth.
    fn curves(away: impl Fn(usize) -> f64) -> (Curve, Vec<Curve>) {
        let bell = |index: usize| 1.0 / (1.0 + (index as f64 - 10.0).powi(2) / 9.0);
        let expected: Vec<[f64; 2]> = (0..21).map(|index| [bell(index), bell(index) + 0.01]).collect();
        let measured: Vec<f64> = expected.iter().enumerate().map(|(index, e)| e[1] * away(index)).collect();
        let frequency_hz: Vec<f64> = (50..71).map(|line| 0.1 * f64::from(line)).collect();
        let curve = Curve { frequency_hz, measured, expected };
        // The jackknife over 20 groups makes 0.1 of that.
        let step = 0.1 / 19_f64.sqrt();
        let replicate = |group: usize| {
            let sign = if group.is_multiple_of(2) { 1.0 } else { -1.0 };
            let measured = curve.expected.iter().map(|e| e[1] * (1.0 + sign * step)).collect();
            Curve { measured, expected: Vec::new(), ..curve.clone() }
        };
        let replicates = (0..20).map(replicate).collect();
        (curve, replicates)
    }

    fn misfit(away: impl Fn(usize) -> f64) -> Misfit {
        let (curve, replicates) = curves(away);
        curve.misfit(&replicates.iter().collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn residuals_as_large_as_the_scatter_are_chance() {
        let fits = misfit(|index| if index % 2 == 0 { 1.1 } else { 0.9 });
        assert!((0.9..1.1).contains(&fits.ratio) && !fits.is_significant(), "{fits:?}");
    }

    #[test]
    fn what_the_fit_lacks_at_the_resonance_is_significant_and_elsewhere_is_not() {
        let wrong = misfit(|index| if (8..=12).contains(&index) { 1.8 } else { 1.0 });
        assert!(wrong.ratio > 3.0 && wrong.is_significant(), "{wrong:?}");
        // The last lines are a tenth of the mode's top.
        let elsewhere = misfit(|index| if index > 19 { 1.5 } else { 1.0 });
        assert!(!elsewhere.is_significant(), "{elsewhere:?}");
    }

    #[test]
    fn one_group_says_nothing_of_scatter() {
        let (curve, replicates) = curves(|_| 1.0);
        assert_eq!(curve.misfit(&[&replicates[0]]), None);
    }
}
