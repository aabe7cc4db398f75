//! How an identification stands to its truth.

use nalgebra::DVector;
use num_complex::Complex64;

use super::{Truth, points, setup};
use crate::identify::ssi::add_second_opinion;
use crate::identify::{self, Identification, IdentifyError, MeasuredSetup, Mode, hold_to_standards};
use crate::spectra::CrossSpectrum;
use crate::statistics::median;
use crate::study::ModeChoice;

/// Identifies a recording's spectrum, everything automatic.
///
/// # Errors
/// As [`identify::identify`].
pub fn identified(truth: &Truth, spectrum: CrossSpectrum) -> Result<Identification, IdentifyError> {
    let setup = setup("one", &points(truth.shapes.nrows()), &[]);
    identify::identify(&[MeasuredSetup { setup: &setup, spectrum }], &ModeChoice::default())
}

/// The same with the second opinion, as `belfry identify` does it.
///
/// # Errors
/// As [`identified`].
pub fn identified_by_both(truth: &Truth, spectrum: CrossSpectrum) -> Result<Identification, IdentifyError> {
    let (setup, choice) = (setup("one", &points(truth.shapes.nrows()), &[]), ModeChoice::default());
    let measured = [MeasuredSetup { setup: &setup, spectrum }];
    let mut found = identify::identify(&measured, &choice)?;
    add_second_opinion(&measured, &choice, &mut found)?;
    hold_to_standards(&mut found);
    Ok(found)
}

/// Modal assurance criterion of a mode and a true shape.
pub fn mac(mode: &Mode, truth: &Truth, at: usize) -> f64 {
    let found =
        DVector::from_iterator(mode.shape.len(), mode.shape.iter().map(|part| Complex64::new(part.re, part.im)));
    identify::mac(&found, &truth.shapes.column(at).map(Complex64::from))
}

/// How an identification stands to its truth.
#[derive(Debug, Default)]
pub struct Score {
    /// True modes that were not found, in Hz.
    pub missed_hz: Vec<f64>,
    /// Modes that are none, in Hz.
    pub spurious_hz: Vec<f64>,
    /// Errors of the frequencies in percent.
    pub frequency_errors: Vec<f64>,
    /// Damping ratios over the truth.
    pub damping: Vec<f64>,
    /// MAC of the shapes.
    pub macs: Vec<f64>,
    /// (estimate - truth) / std of the frequencies...
    pub frequency_z: Vec<f64>,
    /// ...of the damping ratios...
    pub damping_z: Vec<f64>,
    /// ...and of the shapes' components.
    pub shape_z: Vec<f64>,
}

/// Every true mode takes the mode within 2 % that resembles it the most.
pub fn score(found: &Identification, truth: &Truth) -> Score {
    let mut score = Score::default();
    let mut used = vec![false; found.modes.len()];
    for (at, &f) in truth.frequencies_hz.iter().enumerate() {
        let best = (0..found.modes.len())
            .filter(|&m| !used[m] && (found.modes[m].frequency_hz / f - 1.0).abs() < 0.02)
            .max_by(|&a, &b| mac(&found.modes[a], truth, at).total_cmp(&mac(&found.modes[b], truth, at)));
        let Some(m) = best.filter(|&m| mac(&found.modes[m], truth, at) > 0.8) else {
            score.missed_hz.push(f);
            continue;
        };
        used[m] = true;
        let mode = &found.modes[m];
        score.frequency_errors.push((mode.frequency_hz / f - 1.0) * 100.0);
        score.damping.push(mode.damping_ratio / truth.damping_ratio);
        score.macs.push(mac(mode, truth, at));
        score.frequency_z.push((mode.frequency_hz - f) / mode.frequency_std_hz);
        score.damping_z.push((mode.damping_ratio - truth.damping_ratio) / mode.damping_ratio_std);
        let (mut product, mut power) = (0.0, 0.0);
        for (row, part) in mode.shape.iter().enumerate() {
            product += part.re * truth.shapes[(row, at)];
            power += truth.shapes[(row, at)].powi(2);
        }
        for (row, part) in mode.shape.iter().enumerate() {
            score.shape_z.push((part.re - truth.shapes[(row, at)] * product / power) / part.std);
        }
    }
    let unused = found.modes.iter().zip(&used).filter(|(_, used)| !**used);
    score.spurious_hz = unused.map(|(mode, _)| mode.frequency_hz).collect();
    score
}

/// Root mean square.
pub fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
}

/// Median of the magnitudes; NaN of nothing.
pub fn median_of_magnitudes(values: &[f64]) -> f64 {
    let mut magnitudes: Vec<f64> = values.iter().map(|value| value.abs()).collect();
    median(&mut magnitudes).unwrap_or(f64::NAN)
}

/// Lowest and highest.
pub fn range(values: &[f64]) -> [f64; 2] {
    values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], &v| [low.min(v), high.max(v)])
}

impl Score {
    /// All figures in a line.
    pub fn line(&self) -> String {
        let [worst_low, worst_high] = range(&self.frequency_errors);
        let damping = range(&self.damping);
        format!(
            "missed {} spurious {} | f err % median {:.4} max {:.3} | damping {:.3}-{:.3} | min MAC {:.5} | z rms f {:.2} damping {:.2} shape {:.2}",
            self.missed_hz.len(),
            self.spurious_hz.len(),
            median_of_magnitudes(&self.frequency_errors),
            worst_high.max(-worst_low),
            damping[0],
            damping[1],
            range(&self.macs)[0],
            rms(&self.frequency_z),
            rms(&self.damping_z),
            rms(&self.shape_z)
        )
    }

    /// Takes another score's figures in.
    pub fn absorb(&mut self, other: Score) {
        self.missed_hz.extend(other.missed_hz);
        self.spurious_hz.extend(other.spurious_hz);
        self.frequency_errors.extend(other.frequency_errors);
        self.damping.extend(other.damping);
        self.macs.extend(other.macs);
        self.frequency_z.extend(other.frequency_z);
        self.damping_z.extend(other.damping_z);
        self.shape_z.extend(other.shape_z);
    }
}
