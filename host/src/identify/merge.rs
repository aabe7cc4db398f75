//! Merging: one set of modes from several setups that share reference points.
//!
//! Every setup's shape is scaled so that its references match those of all setups together (Au 2011, the least-squares
//! form for real factors, here complex); points measured more than once are averaged, and frequency and damping are
//! combined by their variances. What is uncertain of the references makes the scales uncertain, and with them all points of a setup.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use super::accuracy::std_bounds;
use super::covariance::{self, Numbers};
use super::join::{Point, changes, joined, references, variances};
use super::result::{FittedSpectrum, Mode, ModeMethod, ShapeComponent, pair_of, place};
use super::scatter::{GroupChanges, noise_share};
use super::setup::MeasuredSetup;
use super::setup_mode::{SetupMode, SetupModes};
use super::shape::{Shape, normalise, phase_collinearity};
use crate::spectra::LineGrid;

/// References below this share of a setup's shape cannot scale it.
const MIN_REFERENCE_SHARE: f64 = 0.05;
/// A shape that is uncertain by this share has no direction of its own among close modes.
const PAIR_NOISE: f64 = 0.25;
/// Poles closer than this many of their standard deviations, in frequency and damping together, are not told apart.
const TWIN_SIGMAS: f64 = 3.0;
/// The mean square of the sine of an angle that may be any, and the mean of its fourth power over the square of that.
const ANY_DIRECTION: f64 = 0.5;
const FOURTH_OVER_SQUARE: f64 = 1.5;
/// Setups disagree when their frequencies differ by this many standard deviations, and by this share from the mean: the wind of an hour
/// makes less.
const DISAGREEMENT_SIGMAS: f64 = 4.0;
const NO_CHANGE: f64 = 1e-3;

/// Merges all setups' estimates.
pub(super) fn merge(
    grid: &LineGrid,
    measured: &[MeasuredSetup<'_>],
    setups: &[SetupModes],
    warnings: &mut Vec<String>,
) -> Vec<Mode> {
    let points = points(measured);
    let count = setups.iter().map(|setup| setup.modes.len()).min().unwrap_or(0);
    let duration_s: f64 = measured.iter().map(|m| duration_s(m, grid)).sum();
    let mut merged: Vec<(Mode, GroupChanges)> = (0..count)
        .map(|index| {
            let widened: Vec<SetupMode> = setups.iter().map(|setup| setup.modes[index].widened()).collect();
            let estimates: Vec<&SetupMode> = widened.iter().collect();
            let (mode, changes) = merged(&points, &estimates, measured, duration_s, warnings);
            (Mode { pick: Some(index), ..mode }, changes)
        })
        .collect();
    merged.sort_by(|(a, _), (b, _)| a.frequency_hz.total_cmp(&b.frequency_hz));
    widen_twins(&mut merged);
    let (mut modes, changes): (Vec<Mode>, Vec<GroupChanges>) = merged.into_iter().unzip();
    let factors = covariance::factors(&modes.iter().zip(&changes).map(numbers).collect::<Vec<_>>(), grid.spacing_hz());
    modes.iter_mut().zip(factors).for_each(|(mode, factor)| mode.covariance_factor = factor);
    number(&mut modes);
    warnings.extend(pairs(&mut modes));
    modes
}

fn numbers<'a>((mode, changes): (&Mode, &'a GroupChanges)) -> Numbers<'a> {
    let stds = [mode.frequency_std_hz, mode.damping_ratio_std].into_iter();
    Numbers {
        frequency_hz: mode.frequency_hz,
        bandwidth_hz: mode.bandwidth_hz(),
        stds: stds.chain(mode.shape.iter().map(|component| component.std)).collect(),
        changes,
    }
}

/// Whether the resonances of a mode and of the next one overlap.
fn overlap(a: &Mode, b: &Mode) -> bool {
    b.frequency_hz - a.frequency_hz < a.bandwidth_hz().max(b.bandwidth_hz())
}

/// Gives two modes whose poles the record does not tell apart any direction in the plane of both: all that a spectrum shows of such twins
/// is the sum of what they do. The replicates turn together with the whole record, so that their scatter does not show it. Of poles that are
/// further apart the scatter shows what is linear, and what it leaves out falls with the square of their distance.
///
/// A shape that is turned by an angle a in the plane and scaled to fit is off by sin(a)^2 along itself and by sin(a) cos(a) across: over all
/// angles their squares are 3/8 and 1/8 on average.
fn widen_twins(modes: &mut [(Mode, GroupChanges)]) {
    let real = |mode: &Mode| DVector::from_iterator(mode.shape.len(), mode.shape.iter().map(|part| part.re));
    for upper in 1..modes.len() {
        let [(a, of_a), (b, of_b)] = &mut modes[upper - 1..=upper] else { continue };
        let frequency_sigmas = (b.frequency_hz - a.frequency_hz) / a.frequency_std_hz.hypot(b.frequency_std_hz);
        let damping_sigmas = (b.damping_ratio - a.damping_ratio) / a.damping_ratio_std.hypot(b.damping_ratio_std);
        let sigmas = frequency_sigmas.hypot(damping_sigmas);
        if !overlap(a, b) || sigmas.is_nan() {
            continue;
        }
        // The mean square of the angle's sine.
        let turned = ANY_DIRECTION * (TWIN_SIGMAS / sigmas).min(1.0).powi(4);
        let along = FOURTH_OVER_SQUARE * turned.powi(2);
        let across = turned - along;
        let (shape_a, shape_b) = (real(a), real(b));
        for (mode, changes, own, other) in [(a, of_a, &shape_a, &shape_b), (b, of_b, &shape_b, &shape_a)] {
            let beside = other - own * (own.dot(other) / own.norm_squared());
            let length = beside.norm();
            if length > 0.0 && changes.beside.ncols() == 0 {
                let errors = [own * along.sqrt(), beside * (across.sqrt() * own.norm() / length)];
                for error in &errors {
                    mode.shape.iter_mut().zip(error.iter()).for_each(|(part, error)| part.std = part.std.hypot(*error));
                }
                changes.beside = DMatrix::from_columns(&errors);
            }
        }
    }
}

/// Marks modes whose directions the record does not tell apart, and says so: two whose resonances overlap, of which the shape
/// of one at least is uncertain by a share that is too large for a shape.
fn pairs(modes: &mut [Mode]) -> Vec<String> {
    let noise = |mode: &Mode| {
        let shape = Shape::from_iterator(mode.shape.len(), mode.shape.iter().map(ShapeComponent::value));
        noise_share(&shape, &mode.shape.iter().map(|part| part.std).collect::<Vec<_>>())
    };
    let mut sentences = Vec::new();
    for upper in 1..modes.len() {
        let (a, b) = (&modes[upper - 1], &modes[upper]);
        if overlap(a, b) && a.pair_with.is_none() && noise(a).max(noise(b)) > PAIR_NOISE {
            sentences.push(format!(
                "{} are a pair: the record tells the plane in which they move, but not the direction of each in it. Their standard deviations say so; a longer record tells them apart",
                pair_of(a.frequency_hz, b.frequency_hz)
            ));
            let (first, second) = (a.number, b.number);
            modes[upper - 1].pair_with = Some(second);
            modes[upper].pair_with = Some(first);
        }
    }
    sentences
}

/// Counts modes from 1, lowest first; pairs go with their modes, and end with one of them.
pub(super) fn number(modes: &mut [Mode]) {
    modes.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    let before: Vec<usize> = modes.iter().map(|mode| mode.number).collect();
    for (index, mode) in modes.iter_mut().enumerate() {
        mode.number = index + 1;
        mode.pair_with = mode.pair_with.and_then(|other| Some(before.iter().position(|number| *number == other)? + 1));
    }
}

/// What a setup's averages cover, in s.
pub(super) fn duration_s(measured: &MeasuredSetup<'_>, grid: &LineGrid) -> f64 {
    covered_s(measured.spectrum.averages(), grid)
}

/// What so many averages cover, in s.
pub(super) fn covered_s(averages: usize, grid: &LineGrid) -> f64 {
    (averages + 1) as f64 * 0.5 / grid.spacing_hz()
}

fn points(measured: &[MeasuredSetup<'_>]) -> Vec<Point> {
    let mut points: Vec<Point> = Vec::new();
    let mut references: BTreeMap<&str, usize> = BTreeMap::new();
    let mut names: BTreeMap<&str, usize> = BTreeMap::new();
    for m in measured {
        for sensor in &m.setup.sensors {
            *names.entry(sensor.channel.as_str()).or_default() += 1;
        }
    }
    for (setup, m) in measured.iter().enumerate() {
        for (place, &channel) in m.spectrum.channels().iter().enumerate() {
            let Some(sensor) = m.setup.sensors.get(channel) else { continue };
            if sensor.reference
                && let Some(&index) = references.get(sensor.point.as_str())
            {
                points[index].places.push((setup, place));
                continue;
            }
            if sensor.reference {
                references.insert(&sensor.point, points.len());
            }
            let recurs = names.get(sensor.channel.as_str()).is_some_and(|&count| count > 1);
            let name = if recurs { format!("{}/{}", m.setup.name, sensor.channel) } else { sensor.channel.clone() };
            let (point, reference) = (sensor.point.clone(), sensor.reference);
            points.push(Point { channel: name, point, places: vec![(setup, place)], reference });
        }
    }
    points
}

fn merged(
    points: &[Point],
    estimates: &[&SetupMode],
    measured: &[MeasuredSetup<'_>],
    duration_s: f64,
    warnings: &mut Vec<String>,
) -> (Mode, GroupChanges) {
    // A mode that the user asked for stays where no setup shows it.
    let nowhere = estimates.iter().all(|mode| !mode.found);
    let found = || estimates.iter().filter(move |mode| mode.found || nowhere);
    let (frequency_hz, frequency_std_hz) =
        combine(found().map(|mode| (mode.resonance.frequency_hz, mode.frequency_std_hz)));
    let (damping_ratio, damping_ratio_std) =
        combine(found().map(|mode| (mode.resonance.damping_ratio, mode.damping_std)));
    let own_std_hz = own_deviation(found().map(|mode| mode.frequency_std_hz));
    let is_elsewhere = |mode: &SetupMode| {
        let difference = (mode.resonance.frequency_hz - frequency_hz).abs();
        // The mean holds the setup's own value, and is that much nearer to it.
        let std_hz = (mode.frequency_std_hz.powi(2) - own_std_hz.powi(2)).max(0.0).sqrt();
        mode.found && difference > DISAGREEMENT_SIGMAS * std_hz && difference > NO_CHANGE * frequency_hz
    };
    let elsewhere = estimates.iter().zip(measured).filter(|(mode, _)| is_elsewhere(mode));
    let elsewhere: Vec<String> = elsewhere
        .map(|(mode, m)| format!("setup \"{}\" has it at {:.4} Hz", m.setup.name, mode.resonance.frequency_hz))
        .collect();
    if !elsewhere.is_empty() {
        warnings.push(format!(
            "{}: {}; the structure or the load changed between setups",
            place(frequency_hz),
            elsewhere.join(", ")
        ));
    }
    let fitted: Vec<FittedSpectrum> = measured.iter().zip(estimates).filter_map(|(m, mode)| fitted(m, mode)).collect();
    warnings.extend(misfits(frequency_hz, &fitted));
    if found().any(|mode| mode.in_plane) {
        warnings.push(format!(
            "{}: the structure moves in two directions there, but only one mode was identified. Its shape may be any direction in their plane, and its standard deviations say so; a longer record may tell two modes apart",
            place(frequency_hz)
        ));
    }
    if estimates.len() > 1 {
        warnings.extend(weak_references(points, estimates, measured, frequency_hz));
    }
    let shapes: Vec<Shape> = estimates.iter().map(|mode| mode.shape.clone()).collect();
    let mut shape = joined(points, &shapes);
    let variances = variances(points, estimates, &shapes, &shape);
    let before = shape.iter().map(|component| component.norm()).fold(0.0, f64::max);
    normalise(&mut shape);
    let scale = if before > 0.0 { 1.0 / before } else { 1.0 };
    // A setup that does not show the mode says nothing of its frequency.
    let of_means = |std: fn(&SetupMode) -> f64, changes: fn(&GroupChanges) -> &[f64]| -> Vec<f64> {
        let weights: Vec<f64> = estimates
            .iter()
            .map(|mode| if (mode.found || nowhere) && std(mode).is_finite() { std(mode).powi(-2) } else { 0.0 })
            .collect();
        let total: f64 = weights.iter().sum();
        let each = estimates.iter().zip(&weights);
        each.flat_map(|(mode, weight)| changes(&mode.changes).iter().map(move |change| weight / total * change))
            .collect()
    };
    let changes = GroupChanges {
        frequency_hz: of_means(|mode| mode.frequency_std_hz, |changes| &changes.frequency_hz),
        damping_ratio: of_means(|mode| mode.damping_std, |changes| &changes.damping_ratio),
        shape: changes(points, estimates, &shapes, &shape, |mode| &mode.changes.shape),
        beside: changes(points, estimates, &shapes, &shape, |mode| &mode.changes.beside),
    };
    let [frequency_std_bound_hz, damping_ratio_std_bound] = std_bounds(frequency_hz, damping_ratio, duration_s);
    let phase_collinearity = phase_collinearity(shape.as_slice());
    let mode = Mode {
        number: 0,
        frequency_hz,
        frequency_std_hz,
        damping_ratio,
        damping_ratio_std,
        frequency_std_bound_hz,
        damping_ratio_std_bound,
        shape: points
            .iter()
            .enumerate()
            .map(|(index, point)| ShapeComponent {
                channel: point.channel.clone(),
                point: point.point.clone(),
                re: shape[index].re,
                im: shape[index].im,
                std: variances[index].sqrt() * scale,
            })
            .collect(),
        phase_collinearity,
        phase_collinearity_as_measured: found().map(|mode| mode.collinearity).fold(f64::INFINITY, f64::min),
        lines_in_bandwidth: 2.0 * damping_ratio * frequency_hz
            / found().map(|mode| mode.spacing_hz).fold(0.0, f64::max),
        misfit: found().filter_map(|mode| mode.misfit).map(|misfit| misfit.ratio).reduce(f64::max),
        fitted,
        method: ModeMethod::Spectra,
        band_hz: None,
        asked_hz: None,
        pair_with: None,
        second_opinion: None,
        covariance_factor: None,
        pick: None,
    };
    (mode, changes)
}

/// A mode's spectrum in one setup; `None` where it was not fitted, or is not there.
fn fitted(measured: &MeasuredSetup<'_>, mode: &SetupMode) -> Option<FittedSpectrum> {
    let lines: Vec<(f64, f64, f64)> = mode.curve.lines().filter(|_| mode.found).collect();
    (!lines.is_empty()).then(|| FittedSpectrum {
        setup: measured.setup.name.clone(),
        frequency_hz: lines.iter().map(|(hz, ..)| *hz).collect(),
        measured: lines.iter().map(|(_, measured, _)| *measured).collect(),
        fitted: lines.iter().map(|(.., fitted)| *fitted).collect(),
        scatter: mode.misfit.map_or(f64::NAN, |misfit| misfit.scatter),
        is_misfit: mode.misfit.is_some_and(|misfit| misfit.is_significant()),
    })
}

/// Says where a mode's spectrum is not what the fit expects.
fn misfits(frequency_hz: f64, fitted: &[FittedSpectrum]) -> Option<String> {
    let setups: Vec<String> =
        fitted.iter().filter(|one| one.is_misfit).map(|one| format!("\"{}\"", one.setup)).collect();
    let where_seen = match setups.len() {
        0 => return None,
        1 => format!("setup {}", setups[0]),
        _ => format!("setups {}", setups.join(", ")),
    };
    Some(format!(
        "{}: its spectrum in {where_seen} is not that of the modes alone; something else lies there, such as a tone or a mode that is not listed. Its standard deviations are widened by what is left; fits.svg shows it",
        place(frequency_hz)
    ))
}

/// Says in which setups the references hardly move.
fn weak_references(
    points: &[Point],
    estimates: &[&SetupMode],
    measured: &[MeasuredSetup<'_>],
    frequency_hz: f64,
) -> Vec<String> {
    let warning = |(setup, (mode, m)): (usize, (&&SetupMode, &MeasuredSetup<'_>))| {
        let own = references(points).flat_map(|point| &point.places).filter(|(s, _)| *s == setup);
        let norm: f64 = own.map(|&(_, place)| mode.shape[place].norm_sqr()).sum();
        (norm.sqrt() < MIN_REFERENCE_SHARE * mode.shape.norm()).then(|| {
            format!(
                "{}: the references hardly move in setup \"{}\", so the scale of its other points is uncertain",
                place(frequency_hz),
                m.setup.name
            )
        })
    };
    estimates.iter().zip(measured).enumerate().filter_map(warning).collect()
}

/// The deviation of a mean by inverse variance that the values' own deviations give it; infinite where none is known.
pub(super) fn own_deviation(stds: impl Iterator<Item = f64>) -> f64 {
    weight(stds.filter(|std| is_known(*std))).powf(-0.5)
}

fn is_known(std: f64) -> bool {
    std.is_finite() && std > 0.0
}

/// That of a mean by inverse variance.
fn weight(stds: impl Iterator<Item = f64>) -> f64 {
    stds.map(|std| std.powi(-2)).sum()
}

/// Mean by inverse variance and its deviation, which grows where the values scatter more than their deviations explain. Values
/// without a known deviation count only where no deviation is known.
pub(super) fn combine(values: impl Iterator<Item = (f64, f64)> + Clone) -> (f64, f64) {
    let known = values.clone().filter(|(_, std)| is_known(*std));
    let count = known.clone().count();
    if count == 0 {
        let count = values.clone().count().max(1) as f64;
        let std = values.clone().map(|(_, std)| std).fold(0.0, f64::max);
        return (values.map(|(value, _)| value).sum::<f64>() / count, std / count.sqrt());
    }
    let weight = weight(known.clone().map(|(_, std)| std));
    let mean = known.clone().map(|(value, std)| value * std.powi(-2)).sum::<f64>() / weight;
    let scatter: f64 = known.map(|(value, std)| ((value - mean) / std).powi(2)).sum();
    let excess = (scatter / (count.max(2) - 1) as f64).max(1.0);
    (mean, (excess / weight).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::accuracy::tests::found;

    /// Two modes so many deviations apart in frequency, both known to 0.1 in each part of their shapes.
    fn twins(sigmas: f64) -> Vec<(Mode, GroupChanges)> {
        let mode = |frequency_hz: f64, shape: [f64; 2]| {
            let part = |re: f64| ShapeComponent { channel: String::new(), point: String::new(), re, im: 0.0, std: 0.1 };
            Mode {
                frequency_hz,
                frequency_std_hz: 1e-4,
                damping_ratio_std: 1e-3,
                shape: shape.map(part).to_vec(),
                ..found().modes[0].clone()
            }
        };
        let first_hz = 0.5;
        let modes = [mode(first_hz, [1.0, 0.0]), mode(first_hz + sigmas * 2_f64.sqrt() * 1e-4, [1.0, 1.0])];
        let mut modes: Vec<(Mode, GroupChanges)> =
            modes.into_iter().map(|mode| (mode, GroupChanges::unknown(2))).collect();
        widen_twins(&mut modes);
        modes
    }

    #[test]
    fn twins_have_any_direction_in_their_plane_and_modes_whose_poles_are_apart_their_own() {
        let stds = |sigmas: f64| twins(sigmas)[0].0.shape.iter().map(|part| part.std).collect::<Vec<f64>>();
        // What is left of a shape that is scaled to fit one that is turned by any angle.
        let errors = |place: usize| {
            let all = (0..360).map(|degrees| {
                let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
                [1.0 - cos * cos, -cos * sin][place].powi(2)
            });
            (all.sum::<f64>() / 360.0).sqrt()
        };
        let near = stds(1.0);
        assert!((0..2).all(|place| (near[place] - 0.1_f64.hypot(errors(place))).abs() < 1e-12), "{near:?}");
        let beside = &twins(1.0)[0].1.beside;
        let of_errors = |place: usize| (beside.row(place).norm() - errors(place)).abs();
        assert!(of_errors(0) < 1e-12 && of_errors(1) < 1e-12, "{beside}");
        assert!(stds(12.0)[1] < 0.11 && stds(12.0)[1] > 0.1, "{:?}", stds(12.0));
        // Further apart than they are wide.
        assert_eq!(stds(200.0), [0.1, 0.1]);
    }

    #[test]
    fn setups_are_weighted_by_what_they_know_and_disagreement_is_not_averaged_away() {
        let combine = |values: &[(f64, f64)]| super::combine(values.iter().copied());
        let (mean, std) = combine(&[(1.0, 0.1), (1.2, 0.2)]);
        assert!((mean - 1.04).abs() < 1e-12 && (std - (1.0_f64 / 125.0).sqrt()).abs() < 1e-12);
        // One that knows nothing of its uncertainty adds nothing.
        assert_eq!(combine(&[(1.0, 0.1), (5.0, f64::INFINITY)]), (1.0, 0.1));
        assert_eq!(combine(&[(1.0, f64::INFINITY), (3.0, f64::INFINITY)]).0, 2.0);
        // Three deviations apart to either side: the mean is known as the scatter says.
        let (_, std) = combine(&[(-0.3, 0.1), (0.3, 0.1)]);
        assert!((std - 0.3).abs() < 1e-12);
    }
}
