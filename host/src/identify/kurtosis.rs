//! Whether what moves at a pick is forced: its kurtosis at the line, its power in bands, its envelope.
//!
//! A pick and the setups flow in; what tells a force of one frequency from a mode's response to random loads flows out.

use super::pick::{OVERLAP_VARIANCE, Pick};
use super::setup::MeasuredSetup;
use super::tone::LOBE_LINES;
use crate::spectra::{BAND_HALVES, CrossSpectrum, ENVELOPE_HALF, around};

/// A harmonic's kurtosis is below this; where it is also this many standard deviations below a mode's, it is a harmonic.
pub(super) const HARMONIC_KURTOSIS: f64 = 2.25;
const HARMONIC_SIGMAS: f64 = 3.5;
/// Of fewer windows than this a tone would not be so far from 3, as the standard deviation grows; but a Gaussian's estimates hardly go
/// further down for it: of 40 independent windows 1 in 4000 has less than 2.03, of 13 less than 1.71.
const TAIL_WINDOWS: f64 = 80.0;
/// Where a force's frequency wanders, the power in a band about it varies by less than this share of what noise has at least...
const STEADY_SHARE: f64 = 0.4;
/// ...and the pick's line is one of the band's strongest: it has this share of the most.
const OWN_SHARE: f64 = 0.1;
/// A Gaussian response has <P^3> <P> / <P^2>^2 = 3/2 of the power P of its envelope. Of n independent values it comes out below 3/2
/// less [`CHANCE`] n to the power of -0.23 once in 10 000 times (found by drawing it, for 20 to 300 values).
const GAUSSIAN_ENVELOPE: f64 = 1.5;
const CHANCE: [f64; 2] = [0.86, -0.23];
/// Windows for one independent value: a lightly damped mode's envelope hardly changes from one window to the next.
const WINDOWS_A_VALUE: f64 = 3.0;
/// Weaker evidence of a force that is there at times, which counts only beside other evidence, in the same units. Drawn as above with three
/// windows a value, a mode has more than 1.9 in 2 of 100 records, and more than 2.4 in 1 of 1000.
pub(super) const SUSPECTED_SIGMAS: f64 = 1.9;
pub(super) const AT_TIMES_SIGMAS: f64 = 2.4;
/// A mode's envelope has one value in three windows or fewer where its bandwidth is this share of the lines' distance: it holds 1/(pi B)
/// seconds, and windows follow each other by half the inverse of the distance.
pub(super) const CHANGING_LINES: f64 = 0.21;

/// Kurtosis of the band-passed response at a line, over all setups.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Kurtosis {
    /// The estimate: 3 for a mode, 1.5 for a steady harmonic.
    pub(super) value: f64,
    /// How far it is below a mode's, in standard deviations.
    pub(super) sigmas_below: f64,
    /// Lines to either side over which the force's frequency wanders.
    pub(super) wanders_lines: usize,
    /// Share of the time that the force is there.
    pub(super) on_share: f64,
}

impl Kurtosis {
    /// That of a mode, before anything is known.
    pub(super) const OF_A_MODE: Self = Self { value: 3.0, sigmas_below: 0.0, wanders_lines: 0, on_share: 1.0 };

    /// Whether it is so far from a mode's that nothing else need be known.
    pub(super) fn is_harmonics(&self) -> bool {
        self.is_low() && self.sigmas_below > HARMONIC_SIGMAS
    }

    /// Whether it is that of a force which is there at times.
    pub(super) fn is_at_times(&self) -> bool {
        self.on_share < 1.0
    }

    /// Lines to either side over which the frequency itself goes: what is there at times keeps it, and its band is that of its sidebands.
    pub(super) fn frequency_lines(&self) -> usize {
        if self.is_at_times() { 0 } else { self.wanders_lines }
    }

    /// Whether it is nearer to a harmonic's than to a mode's.
    pub(super) fn is_low(&self) -> bool {
        self.value * self.on_share < HARMONIC_KURTOSIS
    }
}

/// The kurtosis of the response at a pick, or in a band about it where that is a harmonic's.
pub(super) fn kurtosis(measured: &[MeasuredSetup<'_>], pick: &Pick) -> Kurtosis {
    let windows = measured.iter().map(|m| m.spectrum.averages() as f64).sum::<f64>();
    let effective = windows / OVERLAP_VARIANCE;
    let at_line = at_line(measured, pick, pick.line, effective);
    if at_line.is_harmonics() {
        return at_line;
    }
    let wandering = (0..BAND_HALVES.len()).filter_map(|width| wandering(measured, pick, width, effective));
    let wandering = wandering.filter(|found| !is_beside_steady(measured, pick, found.wanders_lines, effective));
    let elsewhere = wandering
        .max_by(|a, b| a.sigmas_below.total_cmp(&b.sigmas_below))
        .or_else(|| on_and_off(measured, pick, windows));
    // What is no proof by itself may be one beside a width that no mode has.
    elsewhere.filter(|found| found.is_harmonics() || !at_line.is_low()).unwrap_or(at_line)
}

/// The kurtosis at a line, where a pick moves most.
fn at_line(measured: &[MeasuredSetup<'_>], pick: &Pick, line: usize, effective: f64) -> Kurtosis {
    let [value] = pooled(measured, pick, |spectrum, channel| [spectrum.kurtosis(line)[channel]]);
    // Mean and standard deviation of 1.5 <|X|^4>/<|X|^2>^2 for a Gaussian response.
    let expected = 3.0 * effective / (effective + measured.len() as f64);
    let deviation = 3.0 / effective.max(TAIL_WINDOWS).sqrt();
    Kurtosis { value, sigmas_below: (expected - value) / deviation, wanders_lines: 0, on_share: 1.0 }
}

/// Whether it is a force of one frequency beside the pick that keeps the power of the band steady: no line of one that wanders is steady
/// by itself.
fn is_beside_steady(measured: &[MeasuredSetup<'_>], pick: &Pick, half: usize, effective: f64) -> bool {
    let lines = measured.first().map_or(0, |m| m.spectrum.grid().lines);
    let is_beside = |line: &usize| line.abs_diff(pick.line) as f64 > LOBE_LINES;
    around(pick.line, half, lines).filter(is_beside).any(|line| at_line(measured, pick, line, effective).is_harmonics())
}

/// Values of the channel that moves most at a pick, which carries least noise: the mean over the setups by their averages.
fn pooled<const COUNT: usize>(
    measured: &[MeasuredSetup<'_>],
    pick: &Pick,
    values: impl Fn(&CrossSpectrum, usize) -> [f64; COUNT],
) -> [f64; COUNT] {
    let (mut sums, mut windows) = ([0.0; COUNT], 0.0);
    for (m, shape) in measured.iter().zip(&pick.shapes) {
        let weight = m.spectrum.averages() as f64;
        windows += weight;
        for (sum, value) in sums.iter_mut().zip(values(&m.spectrum, shape.icamax())) {
            *sum += weight * value;
        }
    }
    sums.map(|sum| sum / windows)
}

/// Whether the density at a pick's line is among the largest of the band about it, in every setup.
fn is_among_strongest(measured: &[MeasuredSetup<'_>], pick: &Pick, half: usize) -> bool {
    measured.iter().zip(&pick.shapes).all(|(m, shape)| {
        let density = |line: usize| m.spectrum.density(line, shape.icamax());
        let most = around(pick.line, half, m.spectrum.grid().lines).map(density).fold(0.0, f64::max);
        density(pick.line) >= OWN_SHARE * most
    })
}

/// The kurtosis in a band about a pick, where that is a force of constant size and the pick's line among its strongest.
fn wandering(measured: &[MeasuredSetup<'_>], pick: &Pick, width: usize, effective: f64) -> Option<Kurtosis> {
    let [variation, of_noise] =
        pooled(measured, pick, |spectrum, channel| spectrum.variation(pick.line, channel, width));
    // Of a power that is Gamma distributed, the relative variance 1/k is found with a variance of 2 (k + 1)/k³ a window.
    let deviation = (2.0 * of_noise * of_noise * (1.0 + of_noise) / effective).sqrt();
    let sigmas_below = (of_noise - variation) / deviation;
    let value = 1.5 * (1.0 + variation);
    let is_steady = variation < STEADY_SHARE * of_noise && sigmas_below > HARMONIC_SIGMAS;
    (is_steady && is_among_strongest(measured, pick, BAND_HALVES[width])).then_some(Kurtosis {
        value,
        sigmas_below,
        wanders_lines: BAND_HALVES[width],
        on_share: 1.0,
    })
}

/// The kurtosis of a force that goes on and off, where that is what the envelope about a pick shows.
fn on_and_off(measured: &[MeasuredSetup<'_>], pick: &Pick, windows: f64) -> Option<Kurtosis> {
    let [flat, on_share] = pooled(measured, pick, |spectrum, channel| spectrum.envelope(pick.line, channel));
    let by_chance = CHANCE[0] * (windows / WINDOWS_A_VALUE).powf(CHANCE[1]);
    let sigmas_below = HARMONIC_SIGMAS * (GAUSSIAN_ENVELOPE - flat) / by_chance;
    let kurtosis = Kurtosis { value: 1.5 / on_share, sigmas_below, wanders_lines: ENVELOPE_HALF, on_share };
    let is_suspected = kurtosis.is_low() && sigmas_below > SUSPECTED_SIGMAS;
    (is_suspected && is_among_strongest(measured, pick, ENVELOPE_HALF)).then_some(kurtosis)
}
