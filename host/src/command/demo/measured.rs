//! The measured modes beside the true ones.

use std::collections::BTreeMap;

use nalgebra::DVector;
use num_complex::Complex64;
use serde::Serialize;

use crate::command::Console;
use crate::command::text::Columns;
use crate::identify::{Mode, mac};
use crate::numbers::signed;
use crate::picture::TrueShape;
use crate::simulate::{TrueMode, Truth};

/// A measured mode belongs to a true one when it is this near (relative) and this alike.
const NEAR: f64 = 0.05;
const ALIKE: f64 = 0.5;

/// What identification should have found, and what it found.
#[derive(Debug, Serialize)]
pub(super) struct Measured {
    pairs: Vec<Pair>,
    missed_hz: Vec<f64>,
    spurious_hz: Vec<f64>,
    /// The true shape of each measured mode, for the picture.
    #[serde(skip)]
    pub(super) shapes: Vec<Option<TrueShape>>,
}

/// A measured mode beside its truth.
#[derive(Debug, Clone, Serialize)]
struct Pair {
    number: usize,
    true_frequency_hz: f64,
    frequency_hz: f64,
    frequency_std_hz: f64,
    frequency_error_percent: f64,
    true_damping_ratio: f64,
    damping_ratio: f64,
    damping_ratio_std: f64,
    mac: f64,
}

impl Measured {
    /// Pairs the measured modes with the true ones within the band.
    pub(super) fn of(modes: &[Mode], truth: &Truth, band_hz: [f64; 2]) -> Self {
        let in_band = |mode: &&TrueMode| (band_hz[0]..=band_hz[1]).contains(&mode.frequency_hz);
        let true_modes: Vec<&TrueMode> = truth.modes.iter().filter(in_band).collect();
        let matches = pair(modes, &true_modes, truth);
        let pairs = modes.iter().zip(&matches).filter_map(|(mode, index)| {
            let true_mode = true_modes[(*index)?];
            Some(Pair {
                number: mode.number,
                true_frequency_hz: true_mode.frequency_hz,
                frequency_hz: mode.frequency_hz,
                frequency_std_hz: mode.frequency_std_hz,
                frequency_error_percent: 100.0 * (mode.frequency_hz / true_mode.frequency_hz - 1.0),
                true_damping_ratio: true_mode.damping_ratio,
                damping_ratio: mode.damping_ratio,
                damping_ratio_std: mode.damping_ratio_std,
                mac: shape_mac(mode, true_mode, truth),
            })
        });
        let missed = true_modes.iter().enumerate().filter(|(index, _)| !matches.contains(&Some(*index)));
        let spurious = modes.iter().zip(&matches).filter(|(_, index)| index.is_none());
        let shape =
            |(found, mode): (&Option<usize>, &Mode)| found.map(|index| true_shape(mode, true_modes[index], truth));
        Self {
            pairs: pairs.collect(),
            missed_hz: missed.map(|(_, mode)| mode.frequency_hz).collect(),
            spurious_hz: spurious.map(|(mode, _)| mode.frequency_hz).collect(),
            shapes: matches.iter().zip(modes).map(shape).collect(),
        }
    }

    /// Tells them as a table.
    pub(super) fn tell(&self, console: &Console) {
        let mut table = Columns::new([
            "mode",
            "true Hz",
            "measured Hz",
            "± Hz",
            "error %",
            "true damping %",
            "measured %",
            "± %",
            "MAC",
        ])
        .expendable(&[7, 4]);
        for pair in &self.pairs {
            table.row([
                pair.number.to_string(),
                format!("{:.4}", pair.true_frequency_hz),
                format!("{:.4}", pair.frequency_hz),
                format!("{:.4}", pair.frequency_std_hz),
                signed(pair.frequency_error_percent, 2),
                format!("{:.2}", 100.0 * pair.true_damping_ratio),
                format!("{:.2}", 100.0 * pair.damping_ratio),
                format!("{:.2}", 100.0 * pair.damping_ratio_std),
                format!("{:.4}", pair.mac),
            ]);
        }
        console.say(format!("\n{table}"));
        for frequency_hz in &self.missed_hz {
            console.say(format!("Not found: the mode at {frequency_hz:.4} Hz."));
        }
        for frequency_hz in &self.spurious_hz {
            console.say(format!("Found at {frequency_hz:.4} Hz, but there is no such mode."));
        }
    }
}

/// For each measured mode the true mode that is near and most alike, each true mode once.
fn pair(modes: &[Mode], true_modes: &[&TrueMode], truth: &Truth) -> Vec<Option<usize>> {
    let mut candidates: Vec<(f64, usize, usize)> = Vec::new();
    for (measured, mode) in modes.iter().enumerate() {
        for (index, true_mode) in true_modes.iter().enumerate() {
            let alike = shape_mac(mode, true_mode, truth);
            if (mode.frequency_hz / true_mode.frequency_hz - 1.0).abs() < NEAR && alike > ALIKE {
                candidates.push((alike, measured, index));
            }
        }
    }
    candidates.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut pairs = vec![None; modes.len()];
    for (_, measured, index) in candidates {
        if pairs[measured].is_none() && !pairs.contains(&Some(index)) {
            pairs[measured] = Some(index);
        }
    }
    pairs
}

/// MAC of a measured and a true shape over the channels that both have.
fn shape_mac(mode: &Mode, true_mode: &TrueMode, truth: &Truth) -> f64 {
    let expected: BTreeMap<&str, f64> = truth
        .channels
        .iter()
        .zip(&true_mode.shape)
        .map(|(channel, &value)| (channel.channel.as_str(), value))
        .collect();
    let (mut a, mut b) = (Vec::new(), Vec::new());
    for component in &mode.shape {
        if let Some(&value) = expected.get(component.channel.as_str()) {
            a.push(Complex64::new(component.re, component.im));
            b.push(Complex64::from(value));
        }
    }
    mac(&DVector::from_vec(a), &DVector::from_vec(b))
}

/// A true shape by point, with the sign of the measured one.
fn true_shape(mode: &Mode, true_mode: &TrueMode, truth: &Truth) -> TrueShape {
    let value = |channel: &str| {
        let index = truth.channels.iter().position(|other| other.channel == channel)?;
        true_mode.shape.get(index).copied()
    };
    let product: f64 = mode.shape.iter().filter_map(|c| Some(c.re * value(&c.channel)?)).sum();
    let sign = if product < 0.0 { -1.0 } else { 1.0 };
    mode.shape.iter().filter_map(|c| Some((c.point.clone(), sign * value(&c.channel)?))).collect()
}
