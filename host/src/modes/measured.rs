//! Measured modes over the study's sensors: what comparison, update and diagnosis compare the model with.
//!
//! The readers of this folder make them, whatever the file.

use std::path::PathBuf;

use nalgebra::{DMatrix, DVector, RowDVector};

use super::stated::StatedMode;

/// Modes with what is known of them.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredModes {
    /// Where they come from.
    pub file: PathBuf,
    /// The modes, lowest frequency first.
    pub modes: Vec<MeasuredMode>,
    /// What the reader should know: components that are missing, sensors without any.
    pub warnings: Vec<String>,
}

/// A measured mode.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredMode {
    /// Its number in the file, from 1.
    pub number: usize,
    /// Natural frequency in Hz, above 0.
    pub frequency_hz: f64,
    /// Its standard deviation in Hz, where known and above 0.
    pub frequency_std_hz: Option<f64>,
    /// Damping ratio (1 is critical), where known.
    pub damping_ratio: Option<f64>,
    /// Its standard deviation, where known and above 0.
    pub damping_ratio_std: Option<f64>,
    /// Which of the model's modes it is, where the file says so.
    pub stated: Option<StatedMode>,
    /// Its shape; `None` where only the frequency is known.
    pub shape: Option<MeasuredShape>,
    /// How the errors of its numbers are correlated; `None` where the file does not tell.
    pub covariance_factor: Option<MeasuredCovarianceFactor>,
}

/// The errors of a mode's frequency and shape as sums of independent ones of unit variance, a column each. The covariance of two
/// numbers is the product of their rows, also of numbers of two modes of one group; variances are the squares of the standard
/// deviations.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredCovarianceFactor {
    /// Modes of different groups have independent errors.
    pub group: usize,
    /// Of the frequency in Hz.
    pub frequency_hz: RowDVector<f64>,
    /// Of the shape, a row for each of its sensors.
    pub shape: DMatrix<f64>,
}

/// Measured modes whose frequencies differ by less than this share turn within their span at the slightest change.
pub(crate) const CLOSE: f64 = 0.015;

/// One mode of so many is identified wrongly: as many of 243 on the blind bench (`diagnose::misfit`).
pub(crate) const WRONGLY_IDENTIFIED: f64 = 0.02;
/// By what factor the deviations of such a mode are wrong: those of its frequency, those of its shape.
pub(crate) const WRONG_BY: [f64; 2] = [5.0, 3.0];

impl MeasuredMode {
    /// All its numbers, little endian, each run of them with its length in front: the same bytes for the same mode, and other ones for any other.
    pub(crate) fn canonical_bytes(&self) -> Vec<u8> {
        let Self {
            number,
            frequency_hz,
            frequency_std_hz,
            damping_ratio,
            damping_ratio_std,
            stated,
            shape,
            covariance_factor,
        } = self;
        let mut bytes = Vec::new();
        let mut put = |values: &mut dyn ExactSizeIterator<Item = [u8; 8]>| {
            bytes.extend((values.len() as u64).to_le_bytes());
            values.for_each(|value| bytes.extend(value));
        };
        let count = |value: usize| (value as u64).to_le_bytes();
        put(&mut [count(*number), frequency_hz.to_le_bytes()].into_iter());
        for value in [frequency_std_hz, damping_ratio, damping_ratio_std] {
            put(&mut value.iter().map(|value| value.to_le_bytes()));
        }
        // The line that says it, and what the model makes of it, are no part of the measurement.
        put(&mut stated.iter().map(|stated| count(stated.number)));
        if let Some(MeasuredShape { sensors, values, imaginary, stds }) = shape {
            put(&mut sensors.iter().map(|&sensor| count(sensor)));
            put(&mut values.as_slice().iter().map(|value| value.to_le_bytes()));
            for values in [imaginary, stds] {
                let values = values.as_ref().map_or(&[][..], |values| values.as_slice());
                put(&mut values.iter().map(|value| value.to_le_bytes()));
            }
        }
        if let Some(MeasuredCovarianceFactor { group, frequency_hz, shape }) = covariance_factor {
            put(&mut [count(*group), count(shape.nrows())].into_iter());
            put(&mut frequency_hz.as_slice().iter().map(|value| value.to_le_bytes()));
            put(&mut shape.as_slice().iter().map(|value| value.to_le_bytes()));
        }
        bytes
    }

    /// The same with its shape at some of its sensors only; without a shape where it is known at none of them.
    #[must_use]
    pub(crate) fn at_sensors(&self, keep: &dyn Fn(usize) -> bool) -> Self {
        let mut other = self.clone();
        let Some(shape) = &mut other.shape else { return other };
        let rows: Vec<usize> = (0..shape.sensors.len()).filter(|&row| keep(shape.sensors[row])).collect();
        if let Some(factor) = other.covariance_factor.as_mut().filter(|factor| factor.shape.nrows() > 0) {
            factor.shape = factor.shape.select_rows(&rows);
        }
        shape.sensors = rows.iter().map(|&row| shape.sensors[row]).collect();
        shape.values = shape.values.select_rows(&rows);
        shape.imaginary = shape.imaginary.as_ref().map(|imaginary| imaginary.select_rows(&rows));
        shape.stds = shape.stds.as_ref().map(|stds| stds.select_rows(&rows));
        if rows.is_empty() {
            other.shape = None;
        }
        other
    }
}

/// A real mode shape at some of the study's sensors.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredShape {
    /// Indices into the study's sensors, ascending: those at which a component is known.
    pub sensors: Vec<usize>,
    /// The components there, in the sensors' positive directions, the largest 1.
    pub values: DVector<f64>,
    /// The imaginary parts of the components at the phase at which the shape is the most real, at the same scale; `None`
    /// where the file knows none.
    pub imaginary: Option<DVector<f64>>,
    /// Standard deviations of the components, at the same scale (NaN where one is unknown); `None` where all are.
    pub stds: Option<DVector<f64>>,
}
