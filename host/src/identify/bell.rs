//! The bell of one mode: frequency and damping from a filtered power spectrum.
//!
//! First EFDD: the bell (the spectrum itself, not its root) is transformed to the autocorrelation, freed of the window's own
//! autocorrelation, and read for frequency (phase) and damping (logarithmic decrement). From there a maximum-likelihood
//! (Whittle) fit of frequency, damping, level, the neighbours' remains and a noise floor, with the Hann window's leakage in
//! the model, so that neither a cut bell nor a coarse line spacing biases the damping.

use std::f64::consts::{PI, TAU};

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

use super::resonance::{LineShape, Quantity, Resonance, hann_autocorrelation};
use super::scoring::{Schedule, Slopes, fisher_scoring};

/// Damping ratios outside this range are not fitted.
pub(super) const DAMPING_RANGE: [f64; 2] = [1e-5, 0.3];
/// Part of the autocorrelation's decay that is read.
const DECAY_RANGE: [f64; 2] = [0.95, 0.25];
/// Steps of Fisher scoring.
const MAX_STEPS: usize = 60;
/// Standard deviation of a tilt beforehand: a neighbour of the same level and a force that is correlated with the mode's make
/// about as much at most.
const TILT_PRIOR: f64 = 0.5;
/// What is added to the information, so that it has an inverse where a level is nothing.
const RIDGE: f64 = 1e-9;
/// A component's level may not fall below this share of the smallest density.
const MIN_LEVEL: f64 = 1e-6;

/// A filtered spectrum around a mode.
#[derive(Debug, Clone)]
pub struct Bell {
    /// Frequencies of consecutive lines in Hz.
    pub frequency_hz: Vec<f64>,
    /// Densities.
    pub density: Vec<f64>,
    /// Duration of a segment in s (one over the line spacing).
    pub duration_s: f64,
    /// Averages, where the responses of neighbours are in the spectrum and their forces may be correlated with the mode's.
    pub mixed: Option<f64>,
}

/// What the fit found.
#[derive(Debug, Clone, PartialEq)]
pub struct BellFit {
    /// The mode.
    pub resonance: Resonance,
    /// Its level: density over [`Resonance::density`].
    pub level: f64,
    /// Noise floor.
    pub floor: f64,
    /// Levels of the neighbours' remains.
    pub neighbours: Vec<f64>,
    /// What the fit expects at the bell's lines: of the mode alone, and of everything.
    pub expected: Vec<[f64; 2]>,
    /// Negative logarithm of the likelihood, an average.
    pub objective: f64,
    /// Standard deviations of frequency in Hz and damping ratio from the likelihood's curvature, where responses of neighbours are mixed in:
    /// what is believed of their tilts beforehand is the same in all groups of windows, and not in the scatter between these.
    pub certainty: Option<[f64; 2]>,
}

impl Bell {
    /// EFDD: frequency and damping from the autocorrelation of the bell's part between `first` and `last` (indices).
    ///
    /// `None` where the bell does not decay.
    pub fn from_autocorrelation(&self, first: usize, last: usize, quantity: Quantity) -> Option<Resonance> {
        let lines = self.frequency_hz.get(first..=last)?;
        let centre_hz = lines[lines.len() / 2];
        // Lags up to half a segment: beyond, the window's autocorrelation is too small to divide by.
        let lags = 4 * lines.len();
        let lag_s = 0.5 * self.duration_s / lags as f64;
        let correlation: Vec<Complex64> = (0..=lags)
            .map(|lag| {
                let t = lag as f64 * lag_s;
                let sum: Complex64 = lines
                    .iter()
                    .zip(&self.density[first..])
                    .map(|(f, density)| Complex64::from_polar(*density, TAU * (f - centre_hz) * t))
                    .sum();
                sum / hann_autocorrelation(t / self.duration_s)
            })
            .collect();
        let start = correlation.first()?.norm();
        let relative: Vec<f64> = correlation.iter().map(|value| value.norm() / start).collect();
        let from = relative.iter().position(|&value| value <= DECAY_RANGE[0])?;
        let to = relative.iter().position(|&value| value <= DECAY_RANGE[1]).unwrap_or(lags);
        if to < from + 2 {
            return None;
        }
        let mut turns = 0.0;
        let mut last_phase = correlation[from].arg();
        let points: Vec<(f64, f64, f64)> = (from..=to)
            .map(|lag| {
                let phase = correlation[lag].arg();
                let step = (phase - last_phase + PI).rem_euclid(TAU) - PI;
                turns += step;
                last_phase = phase;
                (lag as f64 * lag_s, relative[lag].ln(), turns)
            })
            .collect();
        let decay = -slope(points.iter().map(|&(t, log, _)| (t, log)));
        let turn = slope(points.iter().map(|&(t, _, phase)| (t, phase)));
        let frequency_hz = centre_hz + turn / TAU;
        let damping_ratio = (decay / (TAU * frequency_hz)).clamp(DAMPING_RANGE[0], DAMPING_RANGE[1]);
        (frequency_hz > 0.0 && decay.is_finite()).then_some(Resonance { frequency_hz, damping_ratio, quantity })
    }

    /// Maximum-likelihood fit (Whittle 1953) from a start, with neighbours whose resonances are known and only their level
    /// is fitted: least sum of ln S + P/S over the lines, by Fisher scoring with damping. The frequency stays within
    /// `limits_hz`; `None` where the start gives no finite likelihood.
    pub fn fit(&self, start: Resonance, neighbours: &[Resonance], limits_hz: [f64; 2]) -> Option<BellFit> {
        let schedule = Schedule {
            damping: 1e-2,
            factors: [0.3, 8.0],
            ridge: RIDGE,
            most_steps: MAX_STEPS,
            least_gain: 1e-10 * self.density.len() as f64,
        };
        let start = Model::start(self, start, neighbours, limits_hz);
        let (fitted, objective) =
            fisher_scoring(start, &schedule, |model| model.slopes(self), |model, step| model.moved(step, self))?;
        Some(fitted.result(self, objective))
    }
}

fn slope(points: impl Iterator<Item = (f64, f64)> + Clone) -> f64 {
    let count = points.clone().count() as f64;
    let (mean_x, mean_y) = points.clone().fold((0.0, 0.0), |(x, y), p| (x + p.0 / count, y + p.1 / count));
    let (mut xy, mut xx) = (0.0, 0.0);
    for (x, y) in points {
        xy += (x - mean_x) * (y - mean_y);
        xx += (x - mean_x).powi(2);
    }
    xy / xx
}

/// Parameters: offset of the frequency in bandwidths, ln damping, ln level, ln neighbours' levels, ln floor; then, where
/// neighbours are mixed in, the tilts of the mode and of its neighbours.
///
/// The spectrum of a sum of modes has cross terms where the forces are correlated. In partial fractions they are, at each pole, a
/// change of its level and a part that is odd about it, so that a level and a tilt a pole hold all that there can be.
#[derive(Debug, Clone)]
struct Model<'a> {
    resonance: Resonance,
    neighbours: &'a [Resonance],
    limits_hz: [f64; 2],
    /// Own level, neighbours' levels, floor.
    levels: Vec<f64>,
    /// Own tilt and the neighbours', over their levels; none where they are 0.
    tilts: Vec<f64>,
    min_density: f64,
}

impl<'a> Model<'a> {
    fn start(bell: &Bell, resonance: Resonance, neighbours: &'a [Resonance], limits_hz: [f64; 2]) -> Self {
        let largest = bell.density.iter().copied().fold(0.0, f64::max);
        let smallest = bell.density.iter().copied().fold(f64::INFINITY, f64::min).max(largest * 1e-12);
        let level = largest / resonance.peak_density(bell.duration_s);
        let mut levels = vec![level];
        levels.extend(neighbours.iter().map(|other| 0.01 * largest / other.peak_density(bell.duration_s)));
        levels.push(smallest * 0.5);
        let tilts = vec![0.0; if bell.mixed.is_some() { 1 + neighbours.len() } else { 0 }];
        Self { resonance, neighbours, limits_hz, levels, tilts, min_density: smallest }
    }

    /// The likelihood here; `None` where it is not finite.
    fn slopes(&self, bell: &Bell) -> Option<Slopes> {
        let count = bell.frequency_hz.len();
        let first_tilt = 2 + self.levels.len();
        let parameters = first_tilt + self.tilts.len();
        // Derivatives of ln S by the parameters, and P/S - 1.
        let mut jacobian: DMatrix<f64> = DMatrix::zeros(count, parameters);
        let mut excess: DVector<f64> = DVector::zeros(count);
        let mut objective = 0.0;
        // Derivatives by frequency (in bandwidths) and ln damping are central differences of a closed form.
        let step = 1e-4;
        let bandwidth = self.resonance.bandwidth_hz();
        let moved = |df: f64, dz: f64| Resonance {
            frequency_hz: self.resonance.frequency_hz + df * bandwidth,
            damping_ratio: self.resonance.damping_ratio * dz.exp(),
            ..self.resonance
        };
        let moved = |df: f64, dz: f64| moved(df, dz).line_shape(bell.duration_s);
        let (right, left, more, less) = (moved(step, 0.0), moved(-step, 0.0), moved(0.0, step), moved(0.0, -step));
        let (shapes, mut densities) = (self.line_shapes(bell), Vec::new());
        for (index, (&f, &density)) in bell.frequency_hz.iter().zip(&bell.density).enumerate() {
            let at = |shape: &LineShape| self.unit_density(shape, 0, f);
            self.densities(&shapes, f, &mut densities);
            let (own, floor) = (densities[0], densities[densities.len() - 1]);
            let total: f64 = densities.iter().sum();
            if total <= 0.0 {
                return None;
            }
            jacobian[(index, 0)] = self.levels[0] * (at(&right) - at(&left)) / (2.0 * step) / total;
            jacobian[(index, 1)] = self.levels[0] * (at(&more) - at(&less)) / (2.0 * step) / total;
            jacobian[(index, 2)] = own / total;
            for (place, other) in densities[1..densities.len() - 1].iter().enumerate() {
                jacobian[(index, 3 + place)] = other / total;
            }
            jacobian[(index, first_tilt - 1)] = floor / total;
            let poles = shapes.iter().zip(&self.levels);
            for (place, (pole, level)) in poles.enumerate().take(self.tilts.len()) {
                jacobian[(index, first_tilt + place)] = level * pole.skew(f) / total;
            }
            excess[index] = density / total - 1.0;
            objective += total.ln() + density / total;
        }
        let transposed = jacobian.transpose();
        let (mut gradient, mut fisher) = (&transposed * excess, &transposed * &jacobian);
        let prior = 1.0 / (TILT_PRIOR * TILT_PRIOR * bell.mixed.unwrap_or(1.0).max(1.0));
        for (place, tilt) in self.tilts.iter().enumerate() {
            objective += 0.5 * prior * tilt * tilt;
            gradient[first_tilt + place] -= prior * tilt;
            fisher[(first_tilt + place, first_tilt + place)] += prior;
        }
        objective.is_finite().then_some(Slopes { objective, gradient, fisher })
    }

    fn moved(&self, step: &DVector<f64>, bell: &Bell) -> Self {
        let limit = |value: f64, bound: f64| value.clamp(-bound, bound);
        let bandwidth = self.resonance.bandwidth_hz().max(0.02 / bell.duration_s);
        let shift = limit(step[0] * self.resonance.bandwidth_hz(), bandwidth.max(0.2 / bell.duration_s));
        let [first, last] = self.limits_hz;
        let resonance = Resonance {
            frequency_hz: (self.resonance.frequency_hz + shift).clamp(first, last),
            damping_ratio: (self.resonance.damping_ratio * limit(step[1], 0.7).exp())
                .clamp(DAMPING_RANGE[0], DAMPING_RANGE[1]),
            ..self.resonance
        };
        let largest = bell.density.iter().copied().fold(0.0, f64::max);
        let largest_level = |index: usize| if index + 1 == self.levels.len() { largest } else { f64::INFINITY };
        let levels = self
            .levels
            .iter()
            .enumerate()
            .map(|(index, level)| {
                let unit = match index {
                    0 => self.resonance.peak_density(bell.duration_s),
                    _ if index + 1 == self.levels.len() => 1.0,
                    _ => self.neighbours[index - 1].peak_density(bell.duration_s),
                };
                let lowest = MIN_LEVEL * self.min_density / unit;
                (level * limit(step[2 + index], 2.0).exp()).clamp(lowest, largest_level(index).max(lowest))
            })
            .collect();
        let steps = step.iter().skip(2 + self.levels.len());
        let tilts = self.tilts.iter().zip(steps).map(|(tilt, step)| tilt + limit(*step, 0.5)).collect();
        Self { resonance, levels, tilts, ..*self }
    }

    /// The mode and its neighbours as the bell sees them.
    fn line_shapes(&self, bell: &Bell) -> Vec<LineShape> {
        std::iter::once(&self.resonance).chain(self.neighbours).map(|pole| pole.line_shape(bell.duration_s)).collect()
    }

    /// The densities of the mode, its neighbours and the floor at a frequency.
    fn densities(&self, poles: &[LineShape], frequency_hz: f64, densities: &mut Vec<f64>) {
        let of_pole =
            |(place, (pole, level)): (usize, (&LineShape, &f64))| level * self.unit_density(pole, place, frequency_hz);
        densities.clear();
        densities.extend(poles.iter().zip(&self.levels).enumerate().map(of_pole));
        densities.extend(self.levels.last());
    }

    /// The density of a pole of unit level with the tilt at its place.
    fn unit_density(&self, pole: &LineShape, place: usize, frequency_hz: f64) -> f64 {
        let tilted = self.tilts.get(place).map_or(0.0, |tilt| tilt * pole.skew(frequency_hz));
        pole.density(frequency_hz).max(0.0) + tilted
    }

    fn result(&self, bell: &Bell, objective: f64) -> BellFit {
        let count = self.levels.len();
        let (poles, mut densities) = (self.line_shapes(bell), Vec::new());
        let expected = |&hz: &f64| {
            self.densities(&poles, hz, &mut densities);
            [densities[0], densities.iter().sum()]
        };
        BellFit {
            resonance: self.resonance,
            level: self.levels[0],
            floor: self.levels[count - 1],
            neighbours: self.levels[1..count - 1].to_vec(),
            expected: bell.frequency_hz.iter().map(expected).collect(),
            objective,
            certainty: self.certainty(bell),
        }
    }

    fn certainty(&self, bell: &Bell) -> Option<[f64; 2]> {
        let averages = bell.mixed?.max(1.0);
        let mut fisher = self.slopes(bell)?.fisher;
        for index in 0..fisher.nrows() {
            fisher[(index, index)] += RIDGE;
        }
        let covariance = fisher.cholesky()?.inverse() / averages;
        let std = |place: usize| covariance[(place, place)].max(0.0).sqrt();
        Some([std(0) * self.resonance.bandwidth_hz(), std(1) * self.resonance.damping_ratio])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn acceleration(frequency_hz: f64, damping_ratio: f64) -> Resonance {
        Resonance { frequency_hz, damping_ratio, quantity: Quantity::Acceleration }
    }

    fn exact_bell(resonance: Resonance, duration_s: f64, half: usize, floor: f64) -> Bell {
        let centre = (resonance.frequency_hz * duration_s).round() as usize;
        let frequency_hz: Vec<f64> = (centre - half..=centre + half).map(|line| line as f64 / duration_s).collect();
        let density = frequency_hz.iter().map(|&f| 3.0 * resonance.density(f, duration_s) + floor).collect();
        Bell { frequency_hz, density, duration_s, mixed: None }
    }

    #[test]
    fn the_fit_recovers_frequency_and_damping_whatever_the_line_spacing() {
        for (damping_ratio, duration_s) in [(0.01, 60.0), (0.01, 250.0), (0.005, 40.0), (0.03, 100.0)] {
            let truth = acceleration(1.003, damping_ratio);
            // Within a quarter of the frequency to either side, where the tilted resonance is positive.
            let bell = exact_bell(truth, duration_s, 10, 1e-3);
            let start = acceleration(1.01, 2.0 * damping_ratio);
            let fit = bell.fit(start, &[], [0.9, 1.1]).unwrap();
            assert!((fit.resonance.frequency_hz - 1.003).abs() < 1e-6, "{fit:?}");
            assert!((fit.resonance.damping_ratio / damping_ratio - 1.0).abs() < 1e-3, "{fit:?}");
            assert!((fit.level / 3.0 - 1.0).abs() < 1e-3, "{fit:?}");
        }
    }

    #[test]
    fn certainty_grows_with_averages_and_is_less_where_a_neighbour_is_mixed_in() {
        let (truth, other) = (acceleration(1.0, 0.01), acceleration(1.03, 0.01));
        let std = |averages: Option<f64>, neighbours: &[Resonance]| {
            let mut bell = Bell { mixed: averages, ..exact_bell(truth, 100.0, 15, 1e-3) };
            for (density, &f) in bell.density.iter_mut().zip(&bell.frequency_hz) {
                *density += other.density(f, 100.0);
            }
            bell.fit(truth, neighbours, [0.9, 1.1]).unwrap().certainty
        };
        assert_eq!(std(None, &[other]), None, "filters stop neighbours");
        let [few, many] = [50.0, 200.0].map(|averages| std(Some(averages), &[other]).unwrap());
        for (few, many) in few.into_iter().zip(many) {
            // What is believed beforehand counts for more where there is less data.
            assert!((0.5..0.8).contains(&(many / few)), "{few} {many}");
        }
        // A neighbour costs accuracy.
        let alone = std(Some(50.0), &[]).unwrap();
        assert!(alone[0] < few[0] && few[0] < 0.02, "{alone:?} {few:?}");
    }

    #[test]
    fn the_autocorrelation_gives_a_start_within_a_fifth() {
        let truth = acceleration(1.003, 0.01);
        let bell = exact_bell(truth, 100.0, 20, 0.0);
        let start = bell.from_autocorrelation(0, 40, Quantity::Acceleration).unwrap();
        assert!((start.frequency_hz - 1.003).abs() < 1e-3, "{start:?}");
        // The bell is cut at ten bandwidths, which makes it look a little more damped (methods: half-bells).
        assert!((start.damping_ratio / 0.01 - 1.0).abs() < 0.2, "{start:?}");
    }

    #[test]
    fn a_neighbours_remains_do_not_move_the_mode() {
        let truth = acceleration(1.0, 0.01);
        let other = acceleration(1.05, 0.01);
        let mut bell = exact_bell(truth, 100.0, 15, 1e-3);
        for (density, &f) in bell.density.iter_mut().zip(&bell.frequency_hz) {
            *density += 0.3 * other.density(f, 100.0);
        }
        let fit = bell.fit(acceleration(1.002, 0.02), &[other], [0.9, 1.1]).unwrap();
        assert!((fit.resonance.frequency_hz - 1.0).abs() < 1e-5 && (fit.resonance.damping_ratio - 0.01).abs() < 1e-5);
    }
}
