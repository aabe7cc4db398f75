//! Tracking: the modes of a whole record in a part of it.
//!
//! What the modes are is known from the whole record, so nothing is picked: each mode's filter (which stops its
//! neighbours) shows where it is now, and the estimate goes on from there as for a pick.

use nalgebra::DVector;
use num_complex::Complex64;

use super::estimate;
use super::judge;
use super::pick::Pick;
use super::result::{Harmonic, Mode};
use super::setup::{MeasuredSetup, quantity};
use super::shape::{Shape, filtered, mac, modal_filter};
use super::tone;
use crate::study::{Setup, band_at};

/// How far a mode may have moved, as a share of its frequency, and at least in lines.
pub(crate) const REACH: f64 = 0.03;
pub(crate) const REACH_LINES: f64 = 2.0;
/// A mode whose shape has less MAC with that of the whole record is another one, or noise.
const SAME: f64 = 0.8;
/// Modes within this factor of the reach are stopped while a mode is looked for.
const STOPPED: f64 = 2.0;

/// A known mode in a part of the record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tracked {
    /// Natural frequency in Hz and its standard deviation.
    pub frequency_hz: f64,
    /// Standard deviation of the frequency.
    pub frequency_std_hz: f64,
    /// Damping ratio.
    pub damping_ratio: f64,
    /// Its standard deviation.
    pub damping_ratio_std: f64,
    /// MAC with the shape of the whole record.
    pub mac: f64,
    /// Root mean square of the mode's own response where it moves most, in m/s² (m/s where velocity was recorded).
    pub level: f64,
}

/// Follows known modes in a part of a record, beside the forced lines of the whole; `None` for each that the part does not show.
pub fn track(measured: MeasuredSetup<'_>, modes: &[Mode], forced: &[Harmonic]) -> Vec<Option<Tracked>> {
    // A channel that is sound now and was not in most of the record has no part in the shapes.
    let setup = measured.setup;
    let is_known = |channel: &usize| modes.first().is_some_and(|mode| component(setup, *channel, mode).is_some());
    let known: Vec<usize> = measured.spectrum.channels().iter().copied().filter(is_known).collect();
    let measured = &MeasuredSetup { setup, spectrum: measured.spectrum.restricted(&known) };
    let spectrum = &measured.spectrum;
    let grid = *spectrum.grid();
    let band_hz = grid.frequency_hz(0)..=grid.frequency_hz(grid.lines.saturating_sub(1));
    let tones = forced.iter().filter(|line| band_hz.contains(&line.frequency_hz)).map(|line| tone::of(line, &grid));
    let taken = tone::lines(spectrum, &tones.collect::<Vec<_>>());
    let known: Vec<(usize, Shape)> =
        modes.iter().enumerate().filter_map(|(index, mode)| Some((index, shape_here(measured, mode)?))).collect();
    let hz = |known: usize| modes[known].frequency_hz;
    let reach_hz = |known: usize| (REACH * hz(known)).max(REACH_LINES * grid.spacing_hz());
    let picks: Vec<Pick> = known
        .iter()
        .map(|(index, shape)| {
            let mut near: Vec<&(usize, Shape)> = known
                .iter()
                .filter(|(other, _)| other != index && (hz(*other) - hz(*index)).abs() < STOPPED * reach_hz(*index))
                .collect();
            near.sort_by(|a, b| (hz(a.0) - hz(*index)).abs().total_cmp(&(hz(b.0) - hz(*index)).abs()));
            near.truncate(shape.len().saturating_sub(2) / 2);
            let shapes: Vec<&Shape> = std::iter::once(shape).chain(near.iter().map(|(_, shape)| shape)).collect();
            let filter = modal_filter(&shapes).unwrap_or_else(|| shape.clone());
            // Not beyond half-way to a neighbour that looks alike with these channels.
            let inside = |line: &usize| {
                let distance = (grid.frequency_hz(*line) - hz(*index)).abs();
                let nearest = near.iter().map(|(other, _)| (grid.frequency_hz(*line) - hz(*other)).abs());
                distance <= reach_hz(*index) && nearest.fold(f64::INFINITY, f64::min) >= distance
            };
            let density = |line: usize| filtered(&filter, &spectrum.matrix(line));
            let line = (0..grid.lines)
                .filter(|line| inside(line) && taken.binary_search(line).is_err())
                .map(|line| (density(line), line))
                .max_by(|a, b| a.0.total_cmp(&b.0))
                .map_or_else(|| grid.nearest_line(hz(*index)), |(_, line)| line);
            let unit = shape / Complex64::from(shape.norm().max(f64::MIN_POSITIVE));
            let band_hz = band_at(modes[*index].band_hz.as_slice(), grid.frequency_hz(line));
            Pick { by_user: true, band_hz, ..Pick::new(line, vec![unit]) }
        })
        .collect();
    let estimates = estimate::estimate(spectrum, quantity(measured.setup), 0, &picks, &taken);
    let mut tracked = vec![None; modes.len()];
    let all = [estimates];
    for (place, (index, shape)) in known.iter().enumerate() {
        let mode = &all[0].modes[place];
        let alike = mac(&mode.shape, shape);
        if alike >= SAME && mode.found && !judge::is_doubtful(&all, grid.spacing_hz(), place) {
            tracked[*index] = Some(Tracked {
                frequency_hz: mode.resonance.frequency_hz,
                frequency_std_hz: mode.frequency_std_hz,
                damping_ratio: mode.resonance.damping_ratio,
                damping_ratio_std: mode.damping_std,
                mac: alike,
                level: mode.level,
            });
        }
    }
    tracked
}

/// Whether two modes have the same shape at the channels that both have.
pub(crate) fn same_shape(a: &Mode, b: &Mode) -> bool {
    let both =
        a.shape.iter().filter_map(|part| Some((part, b.shape.iter().find(|other| other.channel == part.channel)?)));
    let (of_a, of_b): (Vec<_>, Vec<_>) = both.map(|(a, b)| (a.value(), b.value())).unzip();
    mac(&DVector::from_vec(of_a), &DVector::from_vec(of_b)) >= SAME
}

/// A mode's shape at the channels that a setup's spectrum has; `None` where it is not known at one of them.
fn shape_here(measured: &MeasuredSetup<'_>, mode: &Mode) -> Option<Shape> {
    let channels = measured.spectrum.channels();
    let parts: Option<Vec<Complex64>> =
        channels.iter().map(|&channel| component(measured.setup, channel, mode)).collect();
    parts.map(DVector::from_vec).filter(|shape| !shape.is_empty() && shape.norm() > 0.0)
}

/// What a mode's shape is at a channel of a setup.
fn component(setup: &Setup, channel: usize, mode: &Mode) -> Option<Complex64> {
    let sensor = setup.sensors.get(channel)?;
    let in_setup = format!("{}/{}", setup.name, sensor.channel);
    let named = |name: &str| mode.shape.iter().find(|component| component.channel == name);
    let reference = || mode.shape.iter().find(|part| sensor.reference && part.point == sensor.point);
    let part = named(&in_setup).or_else(reference).or_else(|| named(&sensor.channel))?;
    Some(part.value())
}
