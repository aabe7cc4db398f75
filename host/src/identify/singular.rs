//! Singular values of the cross-spectral matrix, line by line.
//!
//! G is Hermitian and positive semidefinite, so its singular value decomposition is its eigen-decomposition (paper, eq. 4).

use std::ops::Range;

use nalgebra::{DMatrix, DVector, Dyn, SymmetricEigen};
use num_complex::Complex64;
use rayon::prelude::*;

use super::matrices::Source;
use super::result::SingularSpectrum;
use crate::spectra::LineGrid;
use crate::statistics::{largest_first, median};

/// Ranks shown in pictures.
const SHOWN: usize = 4;
/// Singular values taken for modes when the noise floor is estimated from the others.
const RANKS_OF_MODES: usize = 3;

/// Fewer channels leave too few values to tell noise from modes.
pub(super) const NOISE_EDGE_CHANNELS: usize = RANKS_OF_MODES + 2;

/// Largest singular value, the vectors of the first two, and the noise floor of one matrix.
#[derive(Debug, Clone)]
pub(super) struct Leading {
    /// Largest singular value.
    pub(super) value: f64,
    /// Its vector, of unit length.
    pub(super) vector: DVector<Complex64>,
    /// The vector of the next; none of one channel.
    pub(super) second: Option<DVector<Complex64>>,
    /// Singular values, descending.
    pub(super) values: Vec<f64>,
    /// Channel by channel, the density that no other channel explains, 1 / (G^-1)_ii; 0 with fewer averages than channels.
    unexplained: Vec<f64>,
}

/// Decomposes a Hermitian matrix.
pub(super) fn leading(matrix: DMatrix<Complex64>) -> Leading {
    let eigen = SymmetricEigen::new(matrix);
    let order = largest_first(eigen.eigenvalues.as_slice());
    let values: Vec<f64> = order.iter().map(|&index| eigen.eigenvalues[index].max(0.0)).collect();
    let first = order.first().copied().unwrap_or(0);
    Leading {
        value: values.first().copied().unwrap_or(0.0),
        vector: eigen.eigenvectors.column(first).into_owned(),
        second: order.get(1).map(|&second| eigen.eigenvectors.column(second).into_owned()),
        unexplained: unexplained(&eigen),
        values,
    }
}

/// 1 / (G^-1)_ii of every channel i.
fn unexplained(eigen: &SymmetricEigen<Complex64, Dyn>) -> Vec<f64> {
    let mut inverse = vec![0.0; eigen.eigenvalues.len()];
    // Of two channels that are alike one value is nothing but rounding, of either sign.
    let least = f64::EPSILON * eigen.eigenvalues.max().max(f64::MIN_POSITIVE);
    for (vector, value) in eigen.eigenvectors.column_iter().zip(&eigen.eigenvalues) {
        let value = value.max(least);
        inverse.iter_mut().zip(vector.iter()).for_each(|(sum, part)| *sum += part.norm_sqr() / value);
    }
    inverse.into_iter().map(f64::recip).collect()
}

/// The decomposition of a setup's matrices at some lines.
#[derive(Debug, Clone)]
pub(super) struct SingularValues {
    first_line: usize,
    /// One decomposition a line.
    lines: Vec<Leading>,
}

impl SingularValues {
    /// Of all lines.
    pub(super) fn of(source: &Source<'_>) -> Self {
        Self::of_lines(source, 0..source.grid().lines)
    }

    /// Of these lines.
    pub(super) fn of_lines(source: &Source<'_>, lines: Range<usize>) -> Self {
        Self {
            first_line: lines.start,
            lines: lines.into_par_iter().map(|line| leading(source.matrix(line, None))).collect(),
        }
    }

    /// The decomposition at a line, which is one of those.
    pub(super) fn at(&self, line: usize) -> &Leading {
        &self.lines[line - self.first_line]
    }

    /// The noise of every channel near a line: the median, over lines, of what no other channel explains there. A mode is in few lines, or
    /// is explained by what other channels see of it, but for what their noise hides. `None` where the matrices have too few averages to tell.
    ///
    /// A channel's unexplained density of a complex Wishart matrix of n channels over M averages is the noise times a gamma variable of
    /// M - n + 1 degrees over M (Muirhead 1982, theorem 3.2.10, for complex numbers), whose median is a third less than its degrees.
    pub(super) fn noise(&self, lines: Range<usize>, averages: usize) -> Option<Vec<f64>> {
        let channels = self.lines.first()?.unexplained.len();
        let free = (averages + 1).checked_sub(channels).filter(|free| *free > 1)?;
        let inside = lines.start.max(self.first_line)..lines.end.min(self.first_line + self.lines.len());
        let of_channel = |channel: usize| {
            let mut values: Vec<f64> = inside.clone().map(|line| self.at(line).unexplained[channel]).collect();
            median(&mut values).map(|noise| noise * averages as f64 / (free as f64 - 1.0 / 3.0))
        };
        (0..channels).map(of_channel).collect()
    }

    /// For pictures.
    pub(super) fn spectrum(&self, grid: &LineGrid, setup: &str) -> SingularSpectrum {
        let ranks = self.lines.first().map_or(0, |line| line.values.len()).min(SHOWN);
        SingularSpectrum {
            setup: setup.to_owned(),
            frequency_hz: (0..grid.lines).map(|line| grid.frequency_hz(line)).collect(),
            values: (0..ranks).map(|rank| self.lines.iter().map(|line| line.values[rank]).collect()).collect(),
        }
    }
}

/// The level that noise alone would give the largest singular value, from the small ones.
///
/// The mean of the values beyond the modes' is the noise density nu; the largest value of a matrix of pure noise of n
/// channels over M averages then lies near nu (1 + sqrt(n / M))^2 (Marchenko & Pastur 1967). Of channels with as many shapes
/// `taken_out` n is what is left. `None` where that is fewer than [`NOISE_EDGE_CHANNELS`].
pub(super) fn noise_edge(values: &[f64], taken_out: usize, averages: usize) -> Option<f64> {
    // As many values as shapes are taken out are nothing.
    let values = &values[..values.len().saturating_sub(taken_out)];
    let rest = values.get(RANKS_OF_MODES..).filter(|_| values.len() >= NOISE_EDGE_CHANNELS)?;
    let floor = rest.iter().sum::<f64>() / rest.len() as f64;
    Some(floor * edge_over_density(values.len(), averages))
}

/// How far the largest singular value of noise is above its density.
pub(super) fn edge_over_density(channels: usize, averages: usize) -> f64 {
    (1.0 + (channels as f64 / averages.max(1) as f64).sqrt()).powi(2)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    #[test]
    fn each_channels_noise_is_known_beside_a_mode_that_all_share() {
        let (averages, lines) = (24_u32, 33);
        let noise = [1.0_f64, 4.0, 0.25, 1.0, 2.0, 1.0];
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut normal = || Complex64::new(random.sample(StandardNormal), random.sample(StandardNormal)) / 2_f64.sqrt();
        let mut line = || {
            let mut sum = DMatrix::zeros(noise.len(), noise.len());
            for _ in 0..averages {
                let mode = normal() * 30.0;
                let window =
                    DVector::from_iterator(noise.len(), noise.iter().map(|noise| mode + normal() * noise.sqrt()));
                sum += &window * window.adjoint() / Complex64::from(f64::from(averages));
            }
            leading(sum)
        };
        let singular = SingularValues { first_line: 100, lines: (0..lines).map(|_| line()).collect() };
        let found = singular.noise(0..4000, averages as usize).unwrap();
        // A channel's own noise, and what the noise of the others leaves unknown of the mode.
        let expected = |channel: usize| {
            let others = noise.iter().enumerate().filter(|(other, _)| *other != channel);
            noise[channel] + others.map(|(_, noise)| noise.recip()).sum::<f64>().recip()
        };
        let ratios: Vec<f64> = found.iter().enumerate().map(|(channel, found)| found / expected(channel)).collect();
        assert!(ratios.iter().all(|ratio| (0.75..1.25).contains(ratio)), "{ratios:?}");
        assert_eq!(
            singular.noise(0..4000, noise.len()),
            None,
            "with as many averages as channels nothing is left to tell"
        );
    }
}
