//! Days: means of what the intervals of a day show of the modes, and of what surrounds the structure.

use serde::{Deserialize, Serialize};

use crate::statistics::{MEDIAN_OF_ABSOLUTE, median};

/// What an interval shows of the modes that are followed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SeenInterval {
    /// Start and end: Unix time in s of what nodes have sent, s after the first row of a recording.
    pub start_s: f64,
    /// End, in s.
    pub end_s: f64,
    /// Mean temperature in degrees Celsius, where it is known.
    pub temperature_degc: Option<f64>,
    /// The modes that it shows.
    pub modes: Vec<SeenMode>,
}

/// A mode in an interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SeenMode {
    /// Its number among the modes that are followed.
    pub number: usize,
    /// Natural frequency in Hz.
    pub frequency_hz: f64,
    /// Its standard deviation.
    pub frequency_std_hz: f64,
    /// Root mean square of its own response where it moves most.
    pub response_rms: f64,
}

/// A day.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// Its middle, in s.
    pub time_s: f64,
    /// Of each mode that is followed, where it was seen.
    pub modes: Vec<Option<LogFrequency>>,
    /// Temperatures in degrees Celsius: of the air, and as parts feel it that follow within 2 and within 12 days.
    pub temperatures_degc: Option<[f64; FELT]>,
    /// Level of vibration: mean of the logarithm (base 10) of the modes' responses.
    pub level: Option<f64>,
}

/// A mean of logarithms of a frequency.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LogFrequency {
    /// ln of Hz.
    pub value: f64,
    /// Its standard deviation by the measurement alone.
    pub std: f64,
}

/// Length of a block in s: what goes with the hour cancels in a day.
pub const DAY_S: f64 = 86_400.0;
/// Time constants of what follows the air slowly: sections, and the ground or the water around a foot.
pub(super) const LAGS_S: [f64; 2] = [2.0 * DAY_S, 12.0 * DAY_S];
pub(super) const FELT: usize = 1 + LAGS_S.len();
/// A day whose intervals cover less than this share of it is left out.
const LEAST_COVERED: f64 = 0.25;
/// An interval that is further from the median of its day is another mode, or noise: in deviations of the day's intervals.
const FAR: f64 = 5.0;
/// No frequency of an interval is known better than this (relative).
const LEAST_STD: f64 = 1e-6;

/// A mode that fewer intervals show than this share of them says too little of any day.
const LEAST_SEEN: f64 = 0.2;

/// Those of these modes that intervals show often enough to be judged.
pub fn often_seen(intervals: &[SeenInterval], numbers: &[usize]) -> Vec<usize> {
    let count = |number: usize| intervals.iter().filter(|interval| seen(interval, number).is_some()).count();
    let is_often = |number: &usize| count(*number) as f64 >= LEAST_SEEN * intervals.len() as f64;
    numbers.iter().copied().filter(is_often).collect()
}

/// The days that intervals, in the order of time, make up; `modes` are the numbers of those that are followed.
pub fn blocks(intervals: &[SeenInterval], modes: &[usize]) -> Vec<Block> {
    let felt = felt(intervals);
    let levels = Levels::of(intervals, modes);
    let mut blocks = Vec::new();
    let mut first = 0;
    while first < intervals.len() {
        let day = day_of(&intervals[first]);
        let count = intervals[first..].iter().take_while(|interval| day_of(interval) == day).count();
        let here = first..first + count;
        first += count;
        let covered_s: f64 = intervals[here.clone()].iter().map(|interval| interval.end_s - interval.start_s).sum();
        if covered_s < LEAST_COVERED * DAY_S {
            continue;
        }
        let of_mode = |number: &usize| {
            let seen = intervals[here.clone()].iter().filter_map(|interval| seen(interval, *number)).collect();
            mean(seen)
        };
        let temperatures: Option<Vec<[f64; FELT]>> = felt[here.clone()].iter().copied().collect();
        blocks.push(Block {
            time_s: (day + 0.5) * DAY_S,
            modes: modes.iter().map(of_mode).collect(),
            temperatures_degc: temperatures
                .map(|all| std::array::from_fn(|part| all.iter().map(|one| one[part]).sum::<f64>() / all.len() as f64)),
            level: levels.mean(&intervals[here]),
        });
    }
    blocks
}

fn day_of(interval: &SeenInterval) -> f64 {
    (0.5 * (interval.start_s + interval.end_s) / DAY_S).floor()
}

/// Logarithm of a mode's frequency and its deviation, where the interval shows it with one.
fn seen(interval: &SeenInterval, number: usize) -> Option<LogFrequency> {
    let mode = interval.modes.iter().find(|mode| mode.number == number)?;
    let std = mode.frequency_std_hz / mode.frequency_hz;
    let is_usable = mode.frequency_hz > 0.0 && std.is_finite() && std > 0.0;
    is_usable.then(|| LogFrequency { value: mode.frequency_hz.ln(), std: std.max(LEAST_STD) })
}

/// By inverse variance, without what is far off.
fn mean(mut seen: Vec<LogFrequency>) -> Option<LogFrequency> {
    let middle = median(&mut seen.iter().map(|one| one.value).collect::<Vec<_>>())?;
    let mut off: Vec<f64> = seen.iter().map(|one| (one.value - middle).abs()).collect();
    let scatter = median(&mut off)? / MEDIAN_OF_ABSOLUTE;
    seen.retain(|one| (one.value - middle).abs() <= FAR * scatter.max(one.std));
    let total: f64 = seen.iter().map(|one| one.std.powi(-2)).sum();
    let value = seen.iter().map(|one| one.value * one.std.powi(-2)).sum::<f64>() / total;
    (total > 0.0).then(|| LogFrequency { value, std: total.powf(-0.5) })
}

/// The temperature of each interval, and as slower parts feel it, which begin at the mean of their first time constant.
fn felt(intervals: &[SeenInterval]) -> Vec<Option<[f64; FELT]>> {
    let known: Vec<(f64, f64)> = intervals
        .iter()
        .filter_map(|interval| Some((0.5 * (interval.start_s + interval.end_s), interval.temperature_degc?)))
        .collect();
    let Some(&(begin_s, _)) = known.first() else { return vec![None; intervals.len()] };
    let mut slow = LAGS_S.map(|lag_s| {
        let first: Vec<f64> =
            known.iter().take_while(|(time_s, _)| time_s - begin_s < lag_s).map(|one| one.1).collect();
        first.iter().sum::<f64>() / first.len() as f64
    });
    let mut before_s = begin_s;
    intervals
        .iter()
        .map(|interval| {
            let time_s = 0.5 * (interval.start_s + interval.end_s);
            let air = interval.temperature_degc?;
            for (slow, lag_s) in slow.iter_mut().zip(LAGS_S) {
                *slow += (air - *slow) * (1.0 - (-(time_s - before_s).max(0.0) / lag_s).exp());
            }
            before_s = time_s;
            let [days, weeks] = slow;
            Some([air, days, weeks])
        })
        .collect()
}

/// Levels of modes about their own means, so that a mode that is missing does not change the mean of all.
struct Levels<'a> {
    modes: &'a [usize],
    means: Vec<f64>,
}

impl<'a> Levels<'a> {
    fn of(intervals: &[SeenInterval], modes: &'a [usize]) -> Self {
        let mean = |number: &usize| {
            let all: Vec<f64> = intervals.iter().filter_map(|interval| level(interval, *number)).collect();
            all.iter().sum::<f64>() / all.len().max(1) as f64
        };
        Self { modes, means: modes.iter().map(mean).collect() }
    }

    fn mean(&self, intervals: &[SeenInterval]) -> Option<f64> {
        let of_mode = |(number, mean): (&usize, &f64)| -> Vec<f64> {
            intervals.iter().filter_map(|interval| Some(level(interval, *number)? - mean)).collect()
        };
        let all: Vec<f64> = self.modes.iter().zip(&self.means).flat_map(of_mode).collect();
        (!all.is_empty()).then(|| all.iter().sum::<f64>() / all.len() as f64)
    }
}

fn level(interval: &SeenInterval, number: usize) -> Option<f64> {
    let mode = interval.modes.iter().find(|mode| mode.number == number)?;
    (mode.response_rms.is_finite() && mode.response_rms > 0.0).then(|| mode.response_rms.log10())
}
