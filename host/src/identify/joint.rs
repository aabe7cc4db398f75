//! Close modes together: the model of their small cross-spectral matrix.
//!
//! Modes fitted one by one flow in; what modal filters are expected to make of all channels flows out: a matrix of as many rows
//! as there are close modes. Its expectation is `S = A P Aᴴ + D V D`: P the modal spectra with the segment's leakage, A what
//! the filters' shapes still mix (1 on its diagonal), V the noise as the filters pass it, D its size and colour: what is left
//! beside the modes is mostly the tails of modes outside the band, which rise or fall across it, and which filters see together, so
//! that V is correlated further. Correlated modal forces are in P. `joint_fit` fits it.

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::crossing::{At, rows};
use super::resonance::Resonance;

/// What is known beforehand of the exponent of the force's density over frequency, near a mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SlopePrior {
    /// Mean.
    pub(super) mean: f64,
    /// Standard deviation.
    pub(super) std: f64,
}

/// A group of close modes seen through modal filters.
#[derive(Debug, Clone)]
pub(super) struct Seen {
    /// Frequencies of the lines in Hz.
    pub(super) frequency_hz: Vec<f64>,
    /// R, line by line: modes x modes, Hermitian.
    pub(super) matrices: Vec<DMatrix<Complex64>>,
    /// V: what the filters make of noise, modes x modes, Hermitian.
    pub(super) noise: DMatrix<Complex64>,
    /// Duration of a segment in s.
    pub(super) duration_s: f64,
    /// Averages behind each matrix.
    pub(super) averages: f64,
    /// The force's colour.
    pub(super) slope: SlopePrior,
}

/// Close modes and how they are seen.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct JointFit {
    /// The modes.
    pub(super) resonances: Vec<Resonance>,
    /// Their levels: density over [`Resonance::density`].
    pub(super) levels: Vec<f64>,
    /// Exponents of the modal forces' densities over frequency, near the modes; 0 is white.
    pub(super) slopes: Vec<f64>,
    /// A, modes x modes, 1 on its diagonal.
    pub(super) mixture: DMatrix<Complex64>,
    /// Coherence of the modal forces with its phase, Hermitian, 1 on its diagonal.
    pub(super) correlation: DMatrix<Complex64>,
    /// The diagonal of D at each mode's frequency...
    pub(super) noise: Vec<f64>,
    /// ...and its exponent over frequency.
    pub(super) noise_colours: Vec<f64>,
    /// What is added to the correlations of V, Hermitian, 0 on its diagonal.
    pub(super) noise_correlation: DMatrix<Complex64>,
    /// The modes' frequencies at the start, which the noise's colours refer to.
    pub(super) centres_hz: Vec<f64>,
}

impl JointFit {
    /// The same modes once the shapes have taken the mixture in.
    pub(super) fn unmixed(mut self, growths: &[f64]) -> Self {
        self.mixture.fill_with_identity();
        for (level, growth) in self.levels.iter_mut().zip(growths) {
            *level *= growth;
        }
        self
    }

    /// A start from modes fitted one by one.
    pub(super) fn start(resonances: Vec<Resonance>, levels: Vec<f64>) -> Self {
        let size = resonances.len();
        let identity = DMatrix::identity(size, size);
        Self {
            centres_hz: resonances.iter().map(|resonance| resonance.frequency_hz).collect(),
            resonances,
            levels,
            mixture: identity.clone(),
            correlation: identity,
            slopes: vec![0.0; size],
            noise: vec![1.0; size],
            noise_colours: vec![0.0; size],
            noise_correlation: DMatrix::zeros(size, size),
        }
    }

    /// P at each of some frequencies, modes x modes.
    pub(super) fn modal_spectra(&self, frequency_hz: &[f64], duration_s: f64) -> Vec<DMatrix<Complex64>> {
        let rows = rows(&self.resonances, duration_s);
        let size = rows.len();
        let at_line = |&hz: &f64| {
            let at: Vec<At> = rows.iter().zip(&self.slopes).map(|(row, &slope)| row.at(hz, slope)).collect();
            let entry = |i: usize, j: usize| self.amplitude(i, j) * rows[i].entry([i, j], at[i], &at);
            DMatrix::from_fn(size, size, entry)
        };
        frequency_hz.iter().map(at_line).collect()
    }

    /// S at each of the lines, from P there.
    pub(super) fn expected(&self, spectra: &[DMatrix<Complex64>], seen: &Seen) -> Vec<DMatrix<Complex64>> {
        let at_line = |(&hz, spectra): (&f64, &DMatrix<Complex64>)| {
            &self.mixture * spectra * self.mixture.adjoint() + self.noise_seen(seen, hz)
        };
        seen.frequency_hz.iter().zip(spectra).map(at_line).collect()
    }

    /// D V D at a frequency, modes x modes.
    pub(super) fn noise_seen(&self, seen: &Seen, frequency_hz: f64) -> DMatrix<Complex64> {
        let (floor, sizes) = (self.floor(seen), self.noise_sizes(frequency_hz));
        DMatrix::from_fn(sizes.len(), sizes.len(), |i, j| floor[(i, j)] * (sizes[i] * sizes[j]))
    }

    /// V with what is added to its correlations, modes x modes.
    pub(super) fn floor(&self, seen: &Seen) -> DMatrix<Complex64> {
        let size = self.noise.len();
        let added = |i: usize, j: usize| self.noise_correlation[(i, j)] * noise_scale(seen, i, j);
        DMatrix::from_fn(size, size, |i, j| seen.noise[(i, j)] + added(i, j))
    }

    /// The diagonal of D at a frequency.
    pub(super) fn noise_sizes(&self, frequency_hz: f64) -> Vec<f64> {
        let at = |mode: usize| (frequency_hz / self.centres_hz[mode]).powf(self.noise_colours[mode]);
        self.noise.iter().enumerate().map(|(mode, noise)| noise * at(mode)).collect()
    }

    /// Cross amplitude of two modal forces.
    pub(super) fn amplitude(&self, i: usize, j: usize) -> Complex64 {
        self.correlation[(i, j)] * (self.levels[i] * self.levels[j]).sqrt()
    }
}

/// What a correlation of V is multiplied by.
pub(super) fn noise_scale(seen: &Seen, i: usize, j: usize) -> f64 {
    (seen.noise[(i, i)].re * seen.noise[(j, j)].re).sqrt()
}
