//! What moves frequencies without anything being wrong, as covariances between days: the temperatures, the level of vibration, seasons
//! where no temperature is known, and what wanders for days and weeks for reasons that nobody measures.

use belfry_numerics::CholeskyFactor;
use nalgebra::{DMatrix, DVector};

use super::block::{Block, DAY_S, FELT};

/// Sizes of what moves frequencies, as logarithms, one a term.
pub(super) type Sizes = [f64; TERMS];

/// Days' own errors, then what wanders for days and for weeks, linearly with the temperatures, smoothly with them, with the level of vibration,
/// with the season.
const TERMS: usize = 7;
/// Standard deviations that are usual, of a frequency (relative), a kelvin or ten times the level. Air temperatures move frequencies by 0.02 to 0.1 % a
/// kelvin, not quite linearly (Sohn 2007, "Effects of environmental and operational variability on structural health monitoring").
const USUAL: Sizes = [1e-4, 1e-4, 8e-4, 3e-4, 1e-3, 3e-3, 5e-3];
/// Each may be larger or smaller by this factor's exponent. How far frequencies wander over weeks cannot be learned from weeks, so it stays
/// near what is usual.
const SPREAD: [f64; TERMS] = [1.2, 1.2, 0.25, 1.2, 1.2, 1.2, 1.2];
/// Days after which what wanders is forgotten.
const FORGOTTEN_AFTER: [f64; 2] = [4.0, 25.0];
/// Temperatures that differ by less than these (air, days, weeks) have much the same effect, in kelvin.
const ALIKE_K: [f64; FELT] = [15.0, 8.0, 8.0];
const DAYS_A_YEAR: f64 = 365.25;
/// Without temperatures the weather of days is in what the season leaves: for so many days, and in this share of the season's variance.
const WEATHER: (f64, f64) = (15.0, 0.3);
/// How far off a mean is at first, and how large a change may be that is known.
const MEAN: f64 = 0.02;
const KNOWN_CHANGE: f64 = 0.02;
/// Where fits of sizes begin to step, how much shorter steps become, when they are short enough, and the most rounds.
const FIRST_STEP: f64 = 1.0;
const SHORTER: f64 = 0.6;
const SHORT: f64 = 0.3;
const MOST_ROUNDS: usize = 6;
/// A round that gains less than this in the logarithm of the evidence is the last.
const ENOUGH: f64 = 0.05;

/// Covariances between days, each of unit size.
pub(super) struct Surroundings {
    terms: Vec<Option<DMatrix<f64>>>,
    /// Of what is always there: the mean, and changes that are known.
    fixed: DMatrix<f64>,
}

/// A channel: its values, their variances by the measurement, and how large a relative change of all frequencies is in it.
pub(super) struct Channel {
    pub(super) values: DVector<f64>,
    pub(super) variances: Vec<f64>,
    pub(super) scale: f64,
    pub(super) modes: usize,
}

impl Surroundings {
    /// `known` are days before which the structure has changed.
    pub(super) fn of(blocks: &[Block], known: impl Iterator<Item = usize>) -> Self {
        let days = blocks.len();
        let apart = |a: usize, b: usize| (blocks[a].time_s - blocks[b].time_s).abs() / DAY_S;
        let matrix = |of: &dyn Fn(usize, usize) -> f64| Some(DMatrix::from_fn(days, days, of));
        let [of_days, of_weeks] = FORGOTTEN_AFTER.map(|after| matrix(&|a, b| (-apart(a, b) / after).exp()));
        let felt: Option<Vec<[f64; FELT]>> = blocks.iter().map(|block| block.temperatures_degc).collect();
        let (mut linear, mut smooth, mut season) = (None, None, None);
        if let Some(felt) = felt {
            let means: [f64; FELT] =
                std::array::from_fn(|part| felt.iter().map(|one| one[part]).sum::<f64>() / days.max(1) as f64);
            let product =
                |a: usize, b: usize, part: usize| (felt[a][part] - means[part]) * (felt[b][part] - means[part]);
            linear = matrix(&|a, b| (0..FELT).map(|part| product(a, b, part)).sum::<f64>() / FELT as f64);
            let distance = |a: usize, b: usize, part: usize| ((felt[a][part] - felt[b][part]) / ALIKE_K[part]).powi(2);
            smooth = matrix(&|a, b| (-0.5 * (0..FELT).map(|part| distance(a, b, part)).sum::<f64>()).exp());
        } else {
            season = matrix(&|a, b| {
                let days = apart(a, b);
                (std::f64::consts::TAU * days / DAYS_A_YEAR).cos() + WEATHER.1 * (-days / WEATHER.0).exp()
            });
        }
        let levels: Option<Vec<f64>> = blocks.iter().map(|block| block.level).collect();
        let level = levels.and_then(|levels| {
            let mean = levels.iter().sum::<f64>() / days.max(1) as f64;
            matrix(&|a, b| (levels[a] - mean) * (levels[b] - mean))
        });
        let mut fixed = DMatrix::from_element(days, days, MEAN * MEAN);
        for change in known.filter(|change| *change < days) {
            fixed.view_mut((change, change), (days - change, days - change)).add_scalar_mut(KNOWN_CHANGE.powi(2));
        }
        Self { terms: vec![of_days, of_weeks, linear, smooth, level, season], fixed }
    }

    /// The factor of a channel's covariance; `None` where rounding errors leave none.
    pub(super) fn factor(&self, channel: &Channel, sizes: &Sizes) -> Option<CholeskyFactor> {
        let mut covariance = &self.fixed * channel.scale.powi(2);
        for (term, size) in self.terms.iter().zip(&sizes[1..]) {
            if let Some(term) = term {
                let weight = (2.0 * size).exp();
                covariance.zip_apply(term, |sum, term| *sum += weight * term);
            }
        }
        let own = (2.0 * sizes[0]).exp();
        for (day, variance) in channel.variances.iter().enumerate() {
            covariance[(day, day)] += own + variance;
        }
        CholeskyFactor::of(&covariance, 0.0)
    }

    /// What the temperatures, the level, the season and what wanders explain of a channel, of `solved`, the inverse covariance times its values.
    pub(super) fn explained(&self, sizes: &Sizes, solved: &DVector<f64>) -> DVector<f64> {
        let mut explained = DVector::zeros(solved.len());
        for (term, size) in self.terms.iter().zip(&sizes[1..]) {
            if let Some(term) = term {
                explained += term * solved * (2.0 * size).exp();
            }
        }
        explained
    }

    /// The logarithm of the probability of a channel's values and sizes.
    fn log_posterior(&self, channel: &Channel, sizes: &Sizes, usual: &Sizes) -> f64 {
        let Some(factor) = self.factor(channel, sizes) else { return f64::NEG_INFINITY };
        let misfit = channel.values.dot(&factor.solve(&channel.values));
        let deviation = |(term, size): (usize, &f64)| ((size - usual[term]) / SPREAD[term]).powi(2);
        -0.5 * misfit - factor.log_volume() - 0.5 * sizes.iter().enumerate().map(deviation).sum::<f64>()
    }

    /// The most probable sizes, one after the other in steps that get shorter.
    pub(super) fn most_probable(&self, channel: &Channel) -> Sizes {
        let usual: Sizes = USUAL.map(|size| (size * channel.scale / (channel.modes.max(1) as f64).sqrt()).ln());
        let mut sizes = usual;
        let mut best = self.log_posterior(channel, &sizes, &usual);
        let mut step = FIRST_STEP;
        for _ in 0..MOST_ROUNDS {
            let before = best;
            for term in 0..TERMS {
                if term > 0 && self.terms[term - 1].is_none() {
                    continue;
                }
                for by in [step, -step] {
                    let start = best;
                    loop {
                        let mut other = sizes;
                        other[term] += by;
                        let log = self.log_posterior(channel, &other, &usual);
                        if log <= best {
                            break;
                        }
                        (best, sizes) = (log, other);
                    }
                    if best > start {
                        break;
                    }
                }
            }
            step *= SHORTER;
            if best - before < ENOUGH && step < SHORT {
                break;
            }
        }
        sizes
    }
}
