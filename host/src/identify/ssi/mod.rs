//! A second opinion on modes: covariance-driven stochastic subspace identification (SSI-cov), reference-based (Peeters and De
//! Roeck 1999).
//!
//! The averaged cross-spectral matrices of setups flow in. `covariance` transforms them, a sub-band at a time, to covariances;
//! `subspace` reads poles of all orders from these; `uncertainty` says how far each pole moves with the data;
//! `stabilisation` keeps the poles that return from order to order. `opinion` pairs them with modes that are known already,
//! `modes` makes modes of them alone. Out flow what the method says of each known mode, the stable poles that are none of them,
//! and the stabilisation diagram.
//!
//! It shares the spectra with the first method, which may start from its poles. It assumes no shape of a resonance, no white or smooth force and
//! no uncorrelated modes: the covariances of any linear structure under any broad-band load decay exponentially.

mod covariance;
mod likeness;
mod modes;
mod opinion;
mod rejected;
mod shapes;
mod stabilisation;
mod subspace;
#[cfg(test)]
mod tests;
mod uncertainty;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::resonance::{Quantity, Resonance};
use super::result::RejectedBecause;
use super::setup::{MeasuredSetup, quantity};
use super::shape::mac;
use crate::spectra::{CrossSpectrum, LineGrid};
use stabilisation::{Diagram, StablePole};

pub(in crate::identify) use covariance::OUTER_MARGIN_LINES;
pub(super) use likeness::{component_of, component_of_mut};
pub use modes::identify_by_subspace;
pub use opinion::add_second_opinion;

/// Two estimates are of one mode within this share of the wider half bandwidth and of the line spacing, and as many of their
/// standard deviations, with at least this MAC.
const SAME_OF_BANDWIDTH: f64 = 0.5;
const SAME_OF_LINE: f64 = 0.25;
const SAME_SIGMAS: f64 = 3.0;
const SAME_MAC: f64 = 0.5;
/// A pole may be that of a mode, or of another setup's pole, within so many lines and this share of the wider bandwidth together.
const NEAR_LINES: f64 = 1.5;
const NEAR_OF_BANDWIDTH: f64 = 1.0;
/// Bandwidths that a pole is away from the band's ends at least, to be tried or listed.
const EDGE_BANDWIDTHS: f64 = 2.0;
/// A pole is clear where it explains this share of the response at its frequency, lasts so many orders, and its damping ratio is
/// known within this share. Chance makes poles of noise that last and are sharp, but seldom all of this.
const CLEAR_SHARE: f64 = 0.5;
const CLEAR_ORDERS: usize = 5;
const CLEAR_DAMPING_STD: f64 = 0.35;
/// A pole that explains less, but this much, may be a weak mode beside a strong one: the fit of spectra tries it too.
const TRIED_SHARE: f64 = 0.1;

/// What subspace identification says of a mode.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SecondOpinion {
    /// Natural frequency in Hz.
    pub frequency_hz: f64,
    /// Its standard deviation.
    pub frequency_std_hz: f64,
    /// Damping ratio (1 is critical).
    pub damping_ratio: f64,
    /// Its standard deviation.
    pub damping_ratio_std: f64,
    /// How alike its shape is to the mode's.
    pub mac: f64,
    /// Whether frequency and damping agree with the mode's within their standard deviations.
    pub agrees: bool,
}

/// A pole that is stable over the orders of the model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SubspacePole {
    /// Natural frequency in Hz.
    pub frequency_hz: f64,
    /// Its standard deviation.
    pub frequency_std_hz: f64,
    /// Damping ratio (1 is critical).
    pub damping_ratio: f64,
    /// Its standard deviation.
    pub damping_ratio_std: f64,
    /// Which setup shows it.
    pub setup: String,
    /// The order of the model that this estimate is from.
    pub order: usize,
    /// The orders that show it.
    pub orders: Vec<usize>,
    /// How much of the response at its frequency it explains; about 1 for a mode that stands alone.
    pub share: f64,
    /// Whether it is probably a mode; others may be noise.
    pub is_clear: bool,
}

/// A pole of the stabilisation diagram.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DiagramPole {
    /// The order of its model.
    pub order: usize,
    /// Natural frequency in Hz.
    pub frequency_hz: f64,
    /// Damping ratio (1 is critical).
    pub damping_ratio: f64,
}

/// The stabilisation diagram of a setup.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StabilisationDiagram {
    /// The setup's name.
    pub setup: String,
    /// All poles that could be modes.
    pub poles: Vec<DiagramPole>,
    /// Those that are stable, lowest first.
    pub stable: Vec<SubspacePole>,
}

/// What one setup shows.
#[derive(Debug, Clone)]
struct SetupPoles {
    dots: Vec<DiagramPole>,
    /// Stable poles, lowest first.
    stable: Vec<StablePole>,
}

impl SetupPoles {
    fn of(measured: &MeasuredSetup<'_>) -> Self {
        let (dots, stable) = poles(&measured.spectrum, quantity(measured.setup));
        Self { dots, stable }
    }

    fn diagram(&self, setup: &str) -> StabilisationDiagram {
        let stable = self.stable.iter().map(|pole| pole.report(setup)).collect();
        StabilisationDiagram { setup: setup.to_owned(), poles: self.dots.clone(), stable }
    }
}

/// All poles, and the stable ones of them, each mode once: the surest of the estimates that sub-bands and numbers of lags give.
fn poles(spectrum: &CrossSpectrum, quantity: Quantity) -> (Vec<DiagramPole>, Vec<StablePole>) {
    let bands = covariance::sub_bands(spectrum.grid(), spectrum.channels().len());
    let diagrams: Vec<Diagram> = bands.par_iter().map(|band| stabilisation::analyse(spectrum, *band)).collect();
    let (mut dots, mut all) = (Vec::new(), Vec::new());
    for diagram in diagrams {
        dots.extend(diagram.dots);
        all.extend(diagram.poles);
    }
    all.sort_by(|a, b| a.doubt().total_cmp(&b.doubt()));
    let spacing_hz = spectrum.grid().spacing_hz();
    let mut poles: Vec<StablePole> = Vec::new();
    for pole in all {
        if !poles.iter().any(|other| is_same(&pole, other, spacing_hz)) {
            poles.push(pole);
        }
    }
    for pole in &mut poles {
        pole.share = share(pole, spectrum, quantity);
    }
    poles.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    (dots, poles)
}

/// Whether two estimates of a setup are of one mode.
fn is_same(a: &StablePole, b: &StablePole, spacing_hz: f64) -> bool {
    let bandwidth_hz = 2.0 * a.damping_ratio.max(b.damping_ratio) * a.frequency_hz;
    let scatter_hz = (SAME_SIGMAS * a.frequency_std_hz.hypot(b.frequency_std_hz)).min(0.5 * bandwidth_hz + spacing_hz);
    let leeway_hz = SAME_OF_BANDWIDTH * 0.5 * bandwidth_hz + SAME_OF_LINE * spacing_hz + scatter_hz;
    (a.frequency_hz - b.frequency_hz).abs() < leeway_hz && mac(&a.shape, &b.shape) > SAME_MAC
}

/// How far from a pole a mode or another setup's pole may be and still be the same.
fn reach_hz(spacing_hz: f64, damping_ratio: f64, frequency_hz: f64) -> f64 {
    NEAR_LINES * spacing_hz + NEAR_OF_BANDWIDTH * 2.0 * damping_ratio * frequency_hz
}

/// The density that a pole alone would have at its frequency over the measured one, all channels together.
fn share(pole: &StablePole, spectrum: &CrossSpectrum, quantity: Quantity) -> f64 {
    let grid = spectrum.grid();
    let resonance = Resonance { frequency_hz: pole.frequency_hz, damping_ratio: pole.damping_ratio, quantity };
    let line = grid.nearest_line(pole.frequency_hz);
    let own = resonance.density(grid.frequency_hz(line), 1.0 / grid.spacing_hz());
    let measured = spectrum.matrix(line).trace().re;
    if measured > 0.0 { pole.power * own / measured } else { 0.0 }
}

impl StablePole {
    fn is_clear(&self) -> bool {
        self.is_known_with(CLEAR_SHARE)
    }

    /// Whether it is worth a trial by the other method.
    fn is_tried(&self) -> bool {
        self.is_known_with(TRIED_SHARE)
    }

    /// Whether its resonance lies in the band as a whole: the slope of what lies outside passes for a wide pole near the band's end.
    fn is_inside(&self, grid: &LineGrid) -> bool {
        let wide_hz = EDGE_BANDWIDTHS * 2.0 * self.damping_ratio * self.frequency_hz;
        let (low_hz, high_hz) = (grid.frequency_hz(0), grid.frequency_hz(grid.lines.saturating_sub(1)));
        self.frequency_hz - wide_hz > low_hz && self.frequency_hz + wide_hz < high_hz
    }

    fn is_known_with(&self, share: f64) -> bool {
        self.lacks(share).is_none()
    }

    /// Why it is not clear; `None` where it is.
    fn unclear_because(&self) -> Option<RejectedBecause> {
        self.lacks(CLEAR_SHARE)
    }

    /// What it lacks to be known, if it should explain this share of the response.
    fn lacks(&self, share: f64) -> Option<RejectedBecause> {
        if self.orders.len() < CLEAR_ORDERS {
            Some(RejectedBecause::Unstable)
        } else if self.share.is_nan() || self.share < share {
            Some(RejectedBecause::Weak)
        } else if self.damping_ratio_std.is_nan() || self.damping_ratio_std >= CLEAR_DAMPING_STD * self.damping_ratio {
            Some(RejectedBecause::Damping)
        } else {
            None
        }
    }

    fn report(&self, setup: &str) -> SubspacePole {
        SubspacePole {
            frequency_hz: self.frequency_hz,
            frequency_std_hz: self.frequency_std_hz,
            damping_ratio: self.damping_ratio,
            damping_ratio_std: self.damping_ratio_std,
            setup: setup.to_owned(),
            order: self.order,
            orders: self.orders.clone(),
            share: self.share,
            is_clear: self.is_clear(),
        }
    }
}
