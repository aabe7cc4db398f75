//! Merging: one set of modes from several setups that share reference points.
//!
//! Every setup's shape is scaled so that its references match those of all setups together (Au 2011, the least-squares
//! form for real factors, here complex); points measured more than once are averaged, and frequency and damping are
//! combined by their variances. What is uncertain of the references makes the scales uncertain, and with them all points of a setup.

use std::collections::BTreeMap;

use num_complex::Complex64;

use super::result::{FittedSpectrum, Mode, ModeMethod, ShapeComponent};
use super::scatter::noise_share;
use super::setup::MeasuredSetup;
use super::setup_mode::{SetupMode, SetupModes};
use super::shape::{Shape, align, normalise, phase_collinearity};
use crate::spectra::LineGrid;

/// Rounds of scaling setups to the mean of the references, and the mean to the setups.
const ROUNDS: usize = 20;
/// References below this share of a setup's shape cannot scale it.
const MIN_REFERENCE_SHARE: f64 = 0.05;
/// A shape that is uncertain by this share has no direction of its own among close modes.
const PAIR_NOISE: f64 = 0.25;
/// Setups disagree when their frequencies differ by this many standard deviations.
const DISAGREEMENT_SIGMAS: f64 = 4.0;

/// A measurement point of the merged shape.
struct Point {
    channel: String,
    point: String,
    /// (setup, place among its kept channels).
    places: Vec<(usize, usize)>,
    reference: bool,
}

impl Point {
    /// Whether it brings setups together.
    fn joins(&self) -> bool {
        self.reference && self.places.len() > 1
    }
}

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
    let mut modes: Vec<Mode> = (0..count)
        .map(|index| {
            let widened: Vec<SetupMode> = setups.iter().map(|setup| setup.modes[index].widened()).collect();
            let estimates: Vec<&SetupMode> = widened.iter().collect();
            merged(&points, &estimates, measured, grid, duration_s, warnings)
        })
        .collect();
    modes.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    number(&mut modes);
    warnings.extend(pairs(&mut modes));
    modes
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
        let overlap = b.frequency_hz - a.frequency_hz < a.bandwidth_hz().max(b.bandwidth_hz());
        if overlap && a.pair_with.is_none() && noise(a).max(noise(b)) > PAIR_NOISE {
            sentences.push(format!(
                "the modes at {:.4} and {:.4} Hz are a pair: the record tells the plane in which they move, but not the direction of each in it. Their standard deviations say so; a longer record tells them apart",
                a.frequency_hz, b.frequency_hz
            ));
            let (first, second) = (a.number, b.number);
            modes[upper - 1].pair_with = Some(second);
            modes[upper].pair_with = Some(first);
        }
    }
    sentences
}

/// Counts modes from 1; pairs go with their modes, and end with one of them.
pub(super) fn number(modes: &mut [Mode]) {
    let before: Vec<usize> = modes.iter().map(|mode| mode.number).collect();
    for (index, mode) in modes.iter_mut().enumerate() {
        mode.number = index + 1;
        mode.pair_with = mode.pair_with.and_then(|other| Some(before.iter().position(|number| *number == other)? + 1));
    }
}

/// What a setup's averages cover, in s.
pub(super) fn duration_s(measured: &MeasuredSetup<'_>, grid: &LineGrid) -> f64 {
    (measured.spectrum.averages() + 1) as f64 * 0.5 / grid.spacing_hz()
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
    grid: &LineGrid,
    duration_s: f64,
    warnings: &mut Vec<String>,
) -> Mode {
    // A mode that the user asked for stays where no setup shows it.
    let nowhere = estimates.iter().all(|mode| !mode.found);
    let found = || estimates.iter().filter(move |mode| mode.found || nowhere);
    let (frequency_hz, frequency_std_hz) =
        combine(found().map(|mode| (mode.resonance.frequency_hz, mode.frequency_std_hz)));
    let (damping_ratio, damping_ratio_std) =
        combine(found().map(|mode| (mode.resonance.damping_ratio, mode.damping_std)));
    for (mode, m) in estimates.iter().zip(measured) {
        let difference = (mode.resonance.frequency_hz - frequency_hz).abs();
        if mode.found && difference > DISAGREEMENT_SIGMAS * mode.frequency_std_hz.hypot(frequency_std_hz) {
            warnings.push(format!(
                "mode at {frequency_hz:.3} Hz: setup \"{}\" has it at {:.3} Hz; the structure or the load changed between setups",
                m.setup.name, mode.resonance.frequency_hz
            ));
        }
    }
    let fitted: Vec<FittedSpectrum> =
        measured.iter().zip(estimates).filter_map(|(m, mode)| fitted(m, mode, grid)).collect();
    warnings.extend(misfits(frequency_hz, &fitted));
    if estimates.len() > 1 {
        warnings.extend(weak_references(points, estimates, measured, frequency_hz));
    }
    let shapes: Vec<Shape> = estimates.iter().map(|mode| mode.shape.clone()).collect();
    let mut shape = joined(points, &shapes);
    let variances = variances(points, estimates, &shapes, &shape);
    let before = shape.iter().map(|component| component.norm()).fold(0.0, f64::max);
    normalise(&mut shape);
    let scale = if before > 0.0 { 1.0 / before } else { 1.0 };
    // Au (2014): coefficients of variation sqrt(zeta / (2 pi N)) and 1 / sqrt(2 pi zeta N), N cycles in the record.
    let cycles = frequency_hz * duration_s;
    let phase_collinearity = phase_collinearity(shape.as_slice());
    Mode {
        number: 0,
        frequency_hz,
        frequency_std_hz,
        damping_ratio,
        damping_ratio_std,
        frequency_std_bound_hz: frequency_hz * (damping_ratio / (std::f64::consts::TAU * cycles)).sqrt(),
        damping_ratio_std_bound: damping_ratio / (std::f64::consts::TAU * damping_ratio * cycles).sqrt(),
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
        lines_in_bandwidth: 2.0 * damping_ratio * frequency_hz / grid.spacing_hz(),
        misfit: found().filter_map(|mode| mode.misfit).map(|misfit| misfit.ratio).reduce(f64::max),
        fitted,
        method: ModeMethod::Spectra,
        pair_with: None,
        second_opinion: None,
    }
}

/// A mode's spectrum in one setup; `None` where it was not fitted, or is not there.
fn fitted(measured: &MeasuredSetup<'_>, mode: &SetupMode, grid: &LineGrid) -> Option<FittedSpectrum> {
    let lines: Vec<(usize, f64, f64)> = mode.curve.lines().filter(|_| mode.found).collect();
    (!lines.is_empty()).then(|| FittedSpectrum {
        setup: measured.setup.name.clone(),
        frequency_hz: lines.iter().map(|(line, ..)| grid.frequency_hz(*line)).collect(),
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
        "mode at {frequency_hz:.4} Hz: its spectrum in {where_seen} is not that of the modes alone; something else lies there, such as a tone or a mode that is not listed. Its standard deviations are widened by what is left; fits.svg shows it"
    ))
}

/// Points that bring setups together.
fn references(points: &[Point]) -> impl Iterator<Item = &Point> {
    points.iter().filter(|point| point.joins())
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
                "mode at {frequency_hz:.3} Hz: the references hardly move in setup \"{}\", so the scale of its other points is uncertain",
                m.setup.name
            )
        })
    };
    estimates.iter().zip(measured).enumerate().filter_map(warning).collect()
}

/// The shape at all points, from that of each setup.
fn joined(points: &[Point], shapes: &[Shape]) -> Shape {
    let scales = scales(points, shapes);
    let at = |point: &Point| {
        let sum: Complex64 = point.places.iter().map(|&(setup, place)| scales[setup] * shapes[setup][place]).sum();
        sum / point.places.len() as f64
    };
    Shape::from_iterator(points.len(), points.iter().map(at))
}

/// Variances of the components of a joined `shape`. With several setups, what a deviation of each component does to all others
/// through the setups' scales; the length and phase of the whole are free.
fn variances(points: &[Point], estimates: &[&SetupMode], shapes: &[Shape], shape: &Shape) -> Vec<f64> {
    // Small enough for changes to be as straight as they can be told.
    const STEP: f64 = 1e-4;
    if let [mode] = estimates {
        // The points are the setup's channels.
        return mode.shape_std.iter().map(|std| std * std).collect();
    }
    let mut variances = vec![0.0; points.len()];
    for (setup, mode) in estimates.iter().enumerate() {
        for (place, &std) in mode.shape_std.iter().enumerate() {
            if !std.is_finite() {
                let is_of_it = |point: &Point| point.places.contains(&(setup, place));
                // With a reference that nothing is known of, nothing is known of the whole setup's scale.
                let is_reference = points.iter().any(|point| is_of_it(point) && point.joins());
                let is_of_setup = |point: &Point| point.places.iter().any(|(other, _)| *other == setup);
                for (variance, point) in variances.iter_mut().zip(points) {
                    if is_of_it(point) || (is_reference && is_of_setup(point)) {
                        *variance = std * std;
                    }
                }
                continue;
            }
            let mut changed = shapes.to_vec();
            changed[setup][place] += Complex64::from(STEP * std);
            let mut there = joined(points, &changed);
            align(&mut there, shape);
            for (variance, (there, here)) in variances.iter_mut().zip(there.iter().zip(shape.iter())) {
                *variance += (there - here).norm_sqr() / (STEP * STEP);
            }
        }
    }
    variances
}

/// The factor by which each setup's shape is multiplied.
fn scales(points: &[Point], shapes: &[Shape]) -> Vec<Complex64> {
    let mut scales = vec![Complex64::ONE; shapes.len()];
    if shapes.len() == 1 {
        return scales;
    }
    let references: Vec<&Point> = references(points).collect();
    // Alternating least squares: references from the scaled setups, each setup's scale from the references.
    let mut values: Vec<Complex64> = references
        .iter()
        .map(|point| point.places.first().map_or(Complex64::ZERO, |&(setup, place)| shapes[setup][place]))
        .collect();
    for _ in 0..ROUNDS {
        for (setup, shape) in shapes.iter().enumerate() {
            let (mut product, mut norm) = (Complex64::ZERO, 0.0);
            for (point, value) in references.iter().zip(&values) {
                for &(_, place) in point.places.iter().filter(|(s, _)| *s == setup) {
                    product += shape[place].conj() * value;
                    norm += shape[place].norm_sqr();
                }
            }
            if norm > 0.0 {
                scales[setup] = product / norm;
            }
        }
        for (value, point) in values.iter_mut().zip(&references) {
            let sum: Complex64 = point.places.iter().map(|&(setup, place)| scales[setup] * shapes[setup][place]).sum();
            *value = sum / point.places.len() as f64;
        }
        // The common scale is free; without this it would shrink from round to round.
        let largest = values.iter().map(|value| value.norm()).fold(0.0, f64::max);
        if largest > 0.0 {
            values.iter_mut().for_each(|value| *value /= largest);
        }
    }
    scales
}

/// Mean by inverse variance and its deviation, which grows where the values scatter more than their deviations explain. Values
/// without a known deviation count only where no deviation is known.
pub(super) fn combine(values: impl Iterator<Item = (f64, f64)> + Clone) -> (f64, f64) {
    let known = values.clone().filter(|(_, std)| std.is_finite() && *std > 0.0);
    let count = known.clone().count();
    if count == 0 {
        let count = values.clone().count().max(1) as f64;
        let std = values.clone().map(|(_, std)| std).fold(0.0, f64::max);
        return (values.map(|(value, _)| value).sum::<f64>() / count, std / count.sqrt());
    }
    let weight: f64 = known.clone().map(|(_, std)| std.powi(-2)).sum();
    let mean = known.clone().map(|(value, std)| value * std.powi(-2)).sum::<f64>() / weight;
    let scatter: f64 = known.map(|(value, std)| ((value - mean) / std).powi(2)).sum();
    let excess = (scatter / (count.max(2) - 1) as f64).max(1.0);
    (mean, (excess / weight).sqrt())
}

#[cfg(test)]
mod tests {
    use num_complex::Complex64;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::{Point, SetupMode, Shape, align, joined, variances};
    use crate::identify::curve::Curve;
    use crate::identify::resonance::{Quantity, Resonance};

    fn estimate(shape: Shape, shape_std: Vec<f64>) -> SetupMode {
        let resonance = Resonance { frequency_hz: 1.0, damping_ratio: 0.01, quantity: Quantity::Acceleration };
        let (frequency_std_hz, damping_std, peak_density, level) = (0.01, 0.001, 1.0, 1.0);
        SetupMode {
            resonance,
            shape,
            frequency_std_hz,
            damping_std,
            shape_std,
            peak_density,
            level,
            found: true,
            curve: Curve::default(),
            misfit: None,
            collinearity: 1.0,
            shape_noise: 0.0,
        }
    }

    /// Two setups of three points each and a reference that hardly moves: the scatter of merged shapes is what is stated.
    #[test]
    fn a_weak_reference_makes_every_point_of_its_setup_uncertain() {
        let point = |name: &str, places: &[(usize, usize)]| Point {
            channel: name.to_owned(),
            point: name.to_owned(),
            places: places.to_vec(),
            reference: places.len() > 1,
        };
        let points = [
            point("reference", &[(0, 0), (1, 0)]),
            point("a", &[(0, 1)]),
            point("b", &[(0, 2)]),
            point("c", &[(1, 1)]),
            point("d", &[(1, 2)]),
        ];
        let truth = [vec![0.2, 1.0, -0.7], vec![0.2, 0.8, 0.5]];
        let std = 0.004;
        let shape = |values: &[f64]| Shape::from_iterator(3, values.iter().map(|&value| Complex64::from(value)));
        let exact = truth.each_ref().map(|values| shape(values));
        let whole = joined(&points, &exact);
        let estimates = exact.each_ref().map(|shape| estimate(shape.clone(), vec![std; 3]));
        let stated = variances(&points, &estimates.each_ref(), &exact, &whole);
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut squares = [0.0; 5];
        const DRAWS: usize = 4000;
        for _ in 0..DRAWS {
            let drawn = truth.each_ref().map(|values| {
                let noisy = values.iter().map(|value| {
                    let noise: f64 = StandardNormal.sample(&mut random);
                    value + std * noise
                });
                shape(&noisy.collect::<Vec<_>>())
            });
            let mut there = joined(&points, &drawn);
            align(&mut there, &whole);
            for (square, (there, here)) in squares.iter_mut().zip(there.iter().zip(whole.iter())) {
                *square += (there - here).norm_sqr() / DRAWS as f64;
            }
        }
        for (stated, square) in stated.iter().zip(squares) {
            let ratio = (stated / square).sqrt();
            assert!((0.9..1.1).contains(&ratio), "{stated} stated, {square} drawn");
        }
        // The scale is uncertain by 3 %, so the setups' large components are.
        assert!(stated[1].sqrt() > 1.5 * std, "{}", stated[1].sqrt());
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
