//! Left-out channels as a linear function of the others, through mode shapes.

use nalgebra::DMatrix;
use thiserror::Error;

/// Predicts left-out channels: `y_d = chi_d (chi_sᵀ chi_s)⁻¹ chi_sᵀ y_s` (Lei, Wang, Shen 2012, eq. 16, where the paper's print
/// drops a factor), the modal coordinates being those that explain the kept channels best.
#[derive(Debug, Clone, PartialEq)]
pub struct Predictor {
    /// Left-out channels x kept channels.
    pub weights: DMatrix<f64>,
}

/// Why there is no prediction.
#[derive(Debug, Error, PartialEq)]
pub enum PredictError {
    /// More modes than sensors.
    #[error(
        "{modes} modes cannot be told apart by {sensors} sensors; leave fewer channels out, or use fewer modes (--modes)"
    )]
    TooManyModes {
        /// Modes used.
        modes: usize,
        /// Sensors kept.
        sensors: usize,
    },
    /// Modes that look alike at the sensors kept.
    #[error(
        "at the {sensors} sensors kept, the {modes} mode shapes have rank {rank} only: {} of their combinations move none of these sensors, so the left-out motion they carry is lost; use fewer modes (--modes), or leave other channels out",
        modes - rank
    )]
    RankDeficient {
        /// Modes used.
        modes: usize,
        /// Sensors kept.
        sensors: usize,
        /// Rank of chi_s.
        rank: usize,
    },
}

/// Singular values below this share of the largest count as none: noise would grow a millionfold.
const RANK_TOLERANCE: f64 = 1e-6;

impl Predictor {
    /// From the shapes at the kept and the left-out sensors (sensors x modes, same modes, any scale a mode).
    ///
    /// Any shapes with the same span give the same prediction: with chi T for chi and T invertible, T cancels. That is why
    /// an update by Psi, whose shapes are Phi1 V, cannot change it.
    ///
    /// # Errors
    /// [`PredictError`] where the kept sensors cannot separate the modes.
    pub fn new(kept: &DMatrix<f64>, left_out: &DMatrix<f64>) -> Result<Self, PredictError> {
        let (sensors, modes) = kept.shape();
        if modes > sensors {
            return Err(PredictError::TooManyModes { modes, sensors });
        }
        // Columns of unit length: rank should not depend on how a shape is scaled.
        let lengths: Vec<f64> = kept.column_iter().map(|column| column.norm()).collect();
        let scale = |shapes: &DMatrix<f64>| {
            let mut scaled = shapes.clone();
            for (mut column, &length) in scaled.column_iter_mut().zip(&lengths) {
                if length > 0.0 {
                    column /= length;
                }
            }
            scaled
        };
        let decomposition = scale(kept).svd(true, true);
        let greatest = decomposition.singular_values.iter().copied().fold(0.0, f64::max);
        let rank = decomposition.singular_values.iter().filter(|&&value| value > RANK_TOLERANCE * greatest).count();
        let inverse =
            decomposition.pseudo_inverse(RANK_TOLERANCE * greatest).ok().filter(|_| rank == modes && modes > 0);
        let inverse = inverse.ok_or(PredictError::RankDeficient { modes, sensors, rank })?;
        Ok(Self { weights: scale(left_out) * inverse })
    }
}
