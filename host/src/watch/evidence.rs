//! The evidence for one lasting change: all modes at once, at every date.
//!
//! The evidence is averaged over all dates, with a constant rate of changes, and over sizes, so its ratio to that of no change is a test
//! martingale while nothing changes: it exceeds 1 / alpha with a probability of alpha at most, however long the watch (Ville 1939;
//! Shafer, Shen, Vereshchagin and Vovk 2011, "Test Martingales, Bayes Factors and p-Values", Statist. Sci. 26). That holds where the
//! Gaussian process holds.

use nalgebra::{Cholesky, DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::block::{Block, DAY_S};
use super::channels::Observed;
use super::surroundings::{Channel, Sizes, Surroundings};
use crate::hash;

/// Standard deviations of changes of frequencies (relative), each as likely as the others.
const CHANGES: [f64; 3] = [1e-3, 4e-3, 1.6e-2];
/// One lasting change in so many days.
const DAYS_TO_A_CHANGE: f64 = 3652.5;
/// A change shows in so many days at least: one day alone is weather, or a fault.
pub(super) const LEAST_AFTER: usize = 3;
/// Days that show how a structure behaves when nothing is wrong, before which no change is looked for.
pub(super) const LEAST_BEFORE: usize = 21;
/// Sizes are learned anew where there are more days by this factor.
const RELEARNED: f64 = 1.1;

/// What is known of how a structure's frequencies move.
pub(super) struct Learned {
    /// Channels x modes.
    channels: DMatrix<f64>,
    sizes: Vec<Sizes>,
    /// From so many days.
    days: usize,
}

/// What was learned, for who judges the next days: to learn it again takes many times as long as to judge a day.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Remembered {
    days: usize,
    /// Of which days and changes it was learned.
    fingerprint: u64,
    sizes: Vec<Sizes>,
}

/// The evidence for a change.
pub(super) struct Evidence {
    /// Its logarithm over that of no change.
    pub(super) log: f64,
    /// The day before which it is most probable.
    pub(super) day: usize,
    /// Relative changes of the modes' frequencies there, and their covariance.
    pub(super) changes: DVector<f64>,
    pub(super) covariance: DMatrix<f64>,
    /// The first day that was considered, and the probability of it and of each that follows, were there a change.
    pub(super) first: usize,
    pub(super) by_day: Vec<f64>,
}

impl Learned {
    /// How many days were learned from when there are so many: what is learned does not depend on when it was asked.
    fn days_of(days: usize) -> usize {
        let mut learned = LEAST_BEFORE + LEAST_AFTER;
        loop {
            let next = (RELEARNED * learned as f64).ceil() as usize;
            if next > days {
                return learned;
            }
            learned = next;
        }
    }

    /// Learns from the days that there are, with the likeliest change allowed for; `None` while there are too few.
    pub(super) fn up_to_date(before: Option<Self>, blocks: &[Block], known: &[usize]) -> Option<Self> {
        let days = Self::days_of(blocks.len());
        if days > blocks.len() {
            return None;
        }
        if let Some(before) = before.filter(|before| before.days == days) {
            return Some(before);
        }
        let blocks = &blocks[..days];
        let observed = Observed::of(blocks);
        let channels = observed.channels();
        let mut learned = Self { sizes: Vec::new(), channels, days };
        let mut change = None;
        for _ in 0..2 {
            let surroundings = Surroundings::of(blocks, known.iter().copied().chain(change));
            let all = learned.seen(&observed);
            learned.sizes = all.iter().map(|channel| surroundings.most_probable(channel)).collect();
            change = learned.evidence(blocks, known).map(|evidence| evidence.day);
        }
        Some(learned)
    }

    /// What is `remembered`, where it was learned of just these days and changes.
    pub(super) fn recalled(remembered: Remembered, blocks: &[Block], known: &[usize]) -> Option<Self> {
        let Remembered { days, fingerprint: of, sizes } = remembered;
        let blocks = blocks.get(..days).filter(|blocks| fingerprint(blocks, known) == of)?;
        Some(Self { channels: Observed::of(blocks).channels(), sizes, days })
    }

    /// What to remember; `blocks` and `known` as it was brought up to date with.
    pub(super) fn to_remember(&self, blocks: &[Block], known: &[usize]) -> Remembered {
        let fingerprint = fingerprint(&blocks[..self.days], known);
        Remembered { days: self.days, fingerprint, sizes: self.sizes.clone() }
    }

    fn seen(&self, observed: &Observed) -> Vec<Channel> {
        let days = observed.values.nrows();
        let modes = self.channels.ncols();
        let values = &observed.values * self.channels.transpose();
        let variance = |channel: usize, day: usize| {
            (0..modes).map(|mode| self.channels[(channel, mode)].powi(2) * observed.variances[(day, mode)]).sum::<f64>()
        };
        (0..self.channels.nrows())
            .map(|channel| Channel {
                values: values.column(channel).into_owned(),
                variances: (0..days).map(|day| variance(channel, day)).collect(),
                scale: self.channels.row(channel).norm(),
                modes,
            })
            .collect()
    }

    /// The evidence for one change more than those that are `known`; `None` where no day could be the first after it.
    pub(super) fn evidence(&self, blocks: &[Block], known: &[usize]) -> Option<Evidence> {
        let days = blocks.len();
        let first = known.iter().map(|change| change + 1).fold(LEAST_BEFORE, usize::max);
        let last = days.checked_sub(LEAST_AFTER)?;
        if first > last {
            return None;
        }
        let surroundings = Surroundings::of(blocks, known.iter().copied());
        let modes = self.channels.ncols();
        let mut information = vec![DMatrix::zeros(modes, modes); days + 1];
        let mut weighed = vec![DVector::zeros(modes); days + 1];
        for (index, channel) in self.seen(&Observed::of(blocks)).iter().enumerate() {
            let inverse = surroundings.factor(channel, self.sizes.get(index)?)?.inverse();
            let solved = &inverse * &channel.values;
            let along = self.channels.row(index).transpose();
            let square = &along * along.transpose();
            let (mut of_step, mut of_values) = (0.0, 0.0);
            for day in (first..days).rev() {
                let with_later: f64 = inverse.view((day + 1, day), (days - day - 1, 1)).sum();
                of_step += inverse[(day, day)] + 2.0 * with_later;
                of_values += solved[day];
                information[day] += &square * of_step;
                weighed[day] += &along * of_values;
            }
        }
        let mut logs = Vec::with_capacity(last - first + 1);
        let mut best: Option<(f64, usize, f64)> = None;
        for day in first..=last {
            let age = |day: usize| (blocks[day].time_s - blocks[0].time_s) / (DAYS_TO_A_CHANGE * DAY_S);
            let prior = ((-age(day - 1)).exp() - (-age(day)).exp()).ln();
            let mut terms = [0.0; CHANGES.len()];
            for (term, size) in terms.iter_mut().zip(CHANGES) {
                let precision = DMatrix::identity(modes, modes) / (size * size);
                let factor = Cholesky::new(&information[day] + precision)?;
                let volume: f64 = factor.l_dirty().diagonal().iter().map(|value| value.ln()).sum();
                let log = 0.5 * weighed[day].dot(&factor.solve(&weighed[day])) - volume - modes as f64 * size.ln();
                if best.is_none_or(|(most, ..)| log + prior > most) {
                    best = Some((log + prior, day, size));
                }
                *term = prior + log - (CHANGES.len() as f64).ln();
            }
            logs.push(log_sum(&terms));
        }
        let (_, day, size) = best?;
        let precision = DMatrix::identity(modes, modes) / (size * size);
        let covariance = Cholesky::new(&information[day] + precision)?.inverse();
        let log = log_sum(&logs);
        Some(Evidence {
            log,
            day,
            changes: &covariance * &weighed[day],
            covariance,
            first,
            by_day: logs.iter().map(|one| (one - log).exp()).collect(),
        })
    }
}

impl Learned {
    /// Frequencies less what surroundings do, relative, days x modes; `changes` are days before which the structure has changed.
    pub(super) fn cleaned(&self, blocks: &[Block], changes: &[usize]) -> Option<DMatrix<f64>> {
        let surroundings = Surroundings::of(blocks, changes.iter().copied());
        let channels = self.seen(&Observed::of(blocks));
        let mut cleaned = DMatrix::zeros(blocks.len(), channels.len());
        for (index, channel) in channels.iter().enumerate() {
            let sizes = self.sizes.get(index)?;
            let solved = surroundings.factor(channel, sizes)?.solve(&channel.values);
            cleaned.set_column(index, &(&channel.values - surroundings.explained(sizes, &solved)));
        }
        let back = self.channels.clone().try_inverse()?;
        Some(cleaned * back.transpose())
    }
}

/// A number that differs where days or changes do, by any bit of theirs. Levels are left out: they are about the mean of all days, which each new one moves a
/// little.
fn fingerprint(blocks: &[Block], known: &[usize]) -> u64 {
    // Every number is written to its last digit.
    let day = |block: &Block| format!("{} {:?} {:?}", block.time_s, block.modes, block.temperatures_degc);
    let days = blocks.iter().map(day).chain([format!("{known:?}")]);
    days.fold(hash::START, |sum, text| hash::fnv1a(sum, text.bytes()))
}

/// The logarithm of a sum of exponentials.
fn log_sum(logs: &[f64]) -> f64 {
    let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if most.is_finite() { most + logs.iter().map(|log| (log - most).exp()).sum::<f64>().ln() } else { most }
}
