//! Years of a structure that weather and traffic move: false alarms of sound ones, and how soon a loss of stiffness is found.
//!
//! The years are made by other laws than those that a watch assumes.

use std::fmt;
use std::ops::Range;

use belfry_host::watch::{Alarm, DAY_S, JudgedBefore, Judgement, SeenInterval, SeenMode, Settings, blocks, judge};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::statistics::{rms, wilson_percent};

const MODES: usize = 6;
const NUMBERS: [usize; MODES] = [1, 2, 3, 4, 5, 6];
const DAYS: usize = 365;

/// A year, hour by hour.
struct Year {
    intervals: Vec<SeenInterval>,
    /// The change of each mode's frequency in percent, and when.
    truth: Option<(f64, [f64; MODES])>,
}

/// Hours of weather and traffic, counted from the first, on a structure that is drawn.
struct Weather {
    intervals: Vec<SeenInterval>,
    /// The share of a loss of stiffness that each mode feels.
    shares: [f64; MODES],
}

impl Weather {
    /// From a day of the year on: sections that follow the air within days, ice that grows smoothly in them and stiffens by percents, traffic by
    /// the hour and the weekday, and modes that one hour in twenty does not show. `change` is a day, and the stiffness that is lost from then on.
    fn draw(random: &mut ChaCha8Rng, first_day: f64, days: usize, change: Option<(f64, f64)>) -> Self {
        let mut draw =
            |range: Range<f64>| -> [f64; MODES] { std::array::from_fn(|_| random.random_range(range.clone())) };
        let (per_kelvin, ice_share, traffic) = (draw(-6e-4..-2e-4), draw(0.01..0.06), draw(0.0..4e-3));
        let (shares, noise) = (draw(0.2..1.0), draw(2.8e-4..8e-4));
        let (mut weather, mut section, mut ice) = (0.0, 8.0, 0.0_f64);
        let mut intervals = Vec::with_capacity(24 * days);
        for hour in 0..24 * days {
            let mut normal = || -> f64 { StandardNormal.sample(&mut *random) };
            let day = hour as f64 / 24.0;
            let turn = std::f64::consts::TAU;
            weather += -weather / 72.0 + 4.0 * (2.0_f64 / 72.0).sqrt() * normal();
            let air =
                9.0 - 10.0 * (turn * (first_day + day) / 365.25).cos() + weather + 4.0 * (turn * (day - 0.4)).sin();
            section += (air - section) / 60.0;
            ice += (0.5 * (1.0 - ((section + 2.0) / 2.0).tanh()) - ice) / 40.0;
            let is_busy = (day as usize) % 7 < 5 && (6..20).contains(&(hour % 24));
            let level = if is_busy { 0.3 } else { -0.2 } + 0.15 * normal();
            let loss = change.filter(|(from, _)| day >= *from).map_or(0.0, |(_, loss)| loss);
            let mut modes = Vec::with_capacity(MODES);
            for mode in 0..MODES {
                let moved = per_kelvin[mode] * (0.6 * section + 0.4 * air) + ice_share[mode] * ice
                    - traffic[mode] * level
                    - 0.5 * loss * shares[mode];
                let frequency_hz = (mode + 1) as f64 * (moved + noise[mode] * normal()).exp();
                let frequency_std_hz = noise[mode] * frequency_hz;
                modes.push(SeenMode {
                    number: mode + 1,
                    frequency_hz,
                    frequency_std_hz,
                    response_rms: 10f64.powf(level),
                });
            }
            modes.retain(|_| !random.random_bool(0.05));
            let start_s = day * DAY_S;
            intervals.push(SeenInterval { start_s, end_s: start_s + 3600.0, temperature_degc: Some(air), modes });
        }
        Self { intervals, shares }
    }
}

fn year(seed: u64, loss: f64) -> Year {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let first_day = random.random_range(0.0..365.0_f64).floor();
    let change_day = random.random_range(120.0..330.0_f64).floor();
    let Weather { intervals, shares } = Weather::draw(&mut random, first_day, DAYS, Some((change_day, loss)));
    let truth = (loss > 0.0).then(|| (change_day * DAY_S, shares.map(|share| -50.0 * loss * share)));
    Year { intervals, truth }
}

fn judged(intervals: &[SeenInterval]) -> Judgement {
    judge(&blocks(intervals, &NUMBERS), &NUMBERS, &Settings::default(), JudgedBefore::default())
}

/// What became of a year.
#[derive(Debug)]
struct Found {
    days_late: Option<f64>,
    /// Errors of the modes' changes, in deviations.
    errors: Vec<f64>,
    false_alarms: usize,
    is_date_within: bool,
}

fn found(year: &Year) -> Found {
    let judgement = judged(&year.intervals);
    let Some((at_s, changes)) = year.truth else {
        return Found {
            days_late: None,
            errors: Vec::new(),
            false_alarms: judgement.alarms.len(),
            is_date_within: true,
        };
    };
    // Of a change in a frost that lasts, the first days after it are those after the frost.
    let is_it = |alarm: &&Alarm| {
        alarm.raised_s > at_s && alarm.between_s[0] <= at_s + DAY_S && alarm.between_s[1] >= at_s - DAY_S
    };
    let right = judgement.alarms.iter().find(is_it);
    let error =
        |alarm: &Alarm, mode: usize| (alarm.modes[mode].percent - changes[mode]) / alarm.modes[mode].std_percent;
    Found {
        days_late: right.map(|alarm| (alarm.raised_s - at_s) / DAY_S),
        errors: right.map_or_else(Vec::new, |alarm| (0..MODES).map(|mode| error(alarm, mode)).collect()),
        false_alarms: judgement.alarms.len() - usize::from(right.is_some()),
        is_date_within: right.is_some_and(|alarm| alarm.between_s[0] <= at_s && at_s <= alarm.between_s[1]),
    }
}

/// What became of sound structures, and of as many with a loss.
#[derive(Debug)]
pub struct YearsReport {
    seed: u64,
    loss_percent: f64,
    sound: Vec<Found>,
    lossy: Vec<Found>,
}

/// Watches `years` sound structures for a year each, and as many that lose a share of their stiffness; `said` hears of each that is done.
pub fn watch_years(seed: u64, years: u64, loss_percent: f64, mut said: impl FnMut(usize)) -> YearsReport {
    let mut done = 0;
    let mut all = |first: u64, loss: f64| -> Vec<Found> {
        let one = |seed: u64| {
            let found = found(&year(seed, loss));
            done += 1;
            said(done);
            found
        };
        (first..first + years).map(one).collect()
    };
    let sound = all(seed, 0.0);
    let lossy = all(seed + years, 0.01 * loss_percent);
    YearsReport { seed, loss_percent, sound, lossy }
}

impl YearsReport {
    /// Whether no sound structure had an alarm, and every loss was found.
    pub fn is_right(&self) -> bool {
        self.sound.iter().all(|one| one.false_alarms == 0) && self.lossy.iter().all(|one| one.days_late.is_some())
    }
}

/// So many of them, in words with a 95 % interval.
fn share(found: &[Found], is: impl Fn(&Found) -> bool) -> String {
    let count = found.iter().filter(|one| is(one)).count();
    let [low, high] = wilson_percent(count, found.len());
    format!("{count} of {} ({low:.0} to {high:.0} %)", found.len())
}

impl fmt::Display for YearsReport {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { seed, loss_percent, sound, lossy } = self;
        writeln!(
            formatter,
            "seed {seed}: {} sound years, and as many with a loss of {loss_percent} % of all stiffness",
            sound.len()
        )?;
        writeln!(formatter, "sound years with a false alarm: {}", share(sound, |one| one.false_alarms > 0))?;
        writeln!(formatter, "losses found: {}", share(lossy, |one| one.days_late.is_some()))?;
        writeln!(formatter, "  within a week: {}", share(lossy, |one| one.days_late.is_some_and(|late| late <= 7.0)))?;
        let late = lossy.iter().filter_map(|one| one.days_late).fold(0.0, f64::max);
        writeln!(formatter, "  the last of them after {late:.0} days (frost is waited for)")?;
        writeln!(formatter, "  with another alarm besides: {}", share(lossy, |one| one.false_alarms > 0))?;
        writeln!(formatter, "  dates within what is stated with 95 %: {}", share(lossy, |one| one.is_date_within))?;
        let errors: Vec<f64> = lossy.iter().flat_map(|one| one.errors.iter().copied()).collect();
        let worst = errors.iter().fold(0.0, |worst: f64, error| worst.max(error.abs()));
        write!(formatter, "  errors of sizes: {:.2} stated deviations (rms), {worst:.1} at most", rms(&errors))
    }
}

#[cfg(test)]
#[path = "years_tests.rs"]
mod tests;
