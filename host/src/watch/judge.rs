//! Judging day after day: a change that is found is an alarm, whose date and sizes are followed for two weeks; then it is known, and the
//! next one is looked for beside it.

use serde::{Deserialize, Serialize};

use super::block::{Block, DAY_S};
use super::evidence::{Evidence, LEAST_AFTER, LEAST_BEFORE, Learned, Remembered};
use crate::statistics::at_least;

/// When an alarm is raised.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Probability that a sound structure ever raises one, where its frequencies move as the model of them says.
    pub false_alarm_probability: f64,
    /// Smallest relative change of a frequency that is worth one.
    pub least_change: f64,
    /// Days on which the air, or what is slow to follow it, is colder are left out, in degrees Celsius; `None` judges all.
    pub frost_below_degc: Option<f64>,
}

impl Default for Settings {
    fn default() -> Self {
        Self { false_alarm_probability: 1e-3, least_change: 2e-3, frost_below_degc: Some(3.0) }
    }
}

/// How a structure stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Standing {
    /// There are too few days yet to know how it behaves.
    Learning,
    /// Nothing says that it has changed.
    Unchanged,
    /// An alarm was raised within the last two weeks.
    Changed,
}

/// What has become of an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Its date and sizes are still followed.
    Open,
    /// The change has lasted for two weeks.
    Lasting,
    /// Later days take it back.
    Withdrawn,
}

/// A change of a structure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alarm {
    /// The day that raised it, as times of the intervals count.
    pub raised_s: f64,
    /// The first day after the change, most probably.
    pub first_day_s: f64,
    /// The change lies between these with 95 %.
    pub between_s: [f64; 2],
    /// Logarithm of the evidence of a change over that of none.
    pub log_evidence: f64,
    /// What has become of it.
    pub state: State,
    /// How far each mode's frequency has changed, surroundings taken off.
    pub modes: Vec<ModeShift>,
}

/// A lasting change of a frequency.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ModeShift {
    /// The mode's number.
    pub number: usize,
    /// Change in percent.
    pub percent: f64,
    /// Its standard deviation.
    pub std_percent: f64,
}

/// What the days say of a structure.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judgement {
    /// How it stands.
    pub standing: Standing,
    /// Days that were judged.
    pub days: usize,
    /// Days left out for frost.
    pub frost_days: usize,
    /// Days that are still missing before anything can be said.
    pub missing_days: usize,
    /// Logarithm of the evidence of a change that is not known yet, today.
    pub log_evidence: Option<f64>,
    /// From which evidence on an alarm is raised.
    pub alarm_from: f64,
    /// All alarms, the first first.
    pub alarms: Vec<Alarm>,
    /// Modes that were seen on most days before and on none of the last week.
    pub lost_modes: Vec<usize>,
    /// The middle of each day that was judged.
    pub days_s: Vec<f64>,
    /// Of each mode, day by day: frequency less what surroundings do, in percent about its mean; what a picture shows.
    #[serde(skip)]
    pub cleaned_percent: Vec<Vec<f64>>,
    /// What was learned of the surroundings, for who judges the next days.
    #[serde(skip)]
    pub learned: Option<Remembered>,
    /// Of each mode, day by day: frequency as it was seen, in percent about its mean.
    #[serde(skip)]
    pub seen_percent: Vec<Vec<Option<f64>>>,
}

/// Days for which an alarm's date and sizes are followed.
const FOLLOWED_DAYS: f64 = 14.0;
/// A change is large where it is larger than what is worth an alarm by so many deviations: with 99 %.
const SURELY: f64 = 2.326;
/// Frost stays in the ground for so many days after a day that is colder by so much than where frost begins.
const THAWS_IN_DAYS: f64 = 4.0;
const HARD_FROST_K: f64 = 2.0;
/// A mode that so many days do not show, where that has a smaller probability by chance, is lost.
const LOST_AFTER: usize = 7;
const LOST: f64 = 1e-6;
/// Probability on either side of the dates between which a change lies.
const TAIL: f64 = 0.025;

/// What was judged before.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JudgedBefore {
    /// Until when.
    pub until_s: Option<f64>,
    /// The alarms that were raised until then.
    pub alarms: Vec<Alarm>,
    /// What was learned of the surroundings; it is learned anew where there is nothing, or days have changed.
    pub learned: Option<Remembered>,
}

/// Judges all days after those that were judged `before`; `numbers` are those of the blocks' modes.
pub fn judge(blocks: &[Block], numbers: &[usize], settings: &Settings, before: JudgedBefore) -> Judgement {
    let JudgedBefore { until_s, alarms, learned: remembered } = before;
    let judged_until_s = until_s.unwrap_or(f64::NEG_INFINITY);
    let kept = without_frost(blocks, settings.frost_below_degc);
    let alarm_from = -settings.false_alarm_probability.ln();
    let mut watch = Watch { blocks: &kept, numbers, settings, alarm_from, alarms, learned: None };
    let lasting = watch.changes(|alarm| alarm.state == State::Lasting);
    watch.learned = remembered.and_then(|remembered| Learned::recalled(remembered, &kept, &lasting));
    let mut evidence = None;
    for days in 1..=kept.len() {
        if kept[days - 1].time_s > judged_until_s || days == kept.len() {
            evidence = watch.judge_day(days);
        }
    }
    let known = watch.changes(|_| true);
    let lasting = watch.changes(|alarm| alarm.state == State::Lasting);
    let Watch { alarms, learned, .. } = watch;
    // It is that of the last day, learned beside changes that last; on a day that settles one it is learned here.
    let learned = Learned::up_to_date(learned, &kept, &known);
    let to_remember = learned.as_ref().map(|learned| learned.to_remember(&kept, &lasting));
    let cleaned = learned.and_then(|learned| learned.cleaned(&kept, &known));
    let needed = LEAST_BEFORE + LEAST_AFTER;
    let is_open = alarms.last().is_some_and(|alarm| alarm.state == State::Open);
    Judgement {
        standing: match (evidence, is_open) {
            (_, true) => Standing::Changed,
            (None, false) => Standing::Learning,
            (Some(_), false) => Standing::Unchanged,
        },
        days: kept.len(),
        frost_days: blocks.len() - kept.len(),
        missing_days: needed.saturating_sub(kept.len()),
        log_evidence: evidence,
        alarm_from,
        alarms,
        lost_modes: lost(&kept, numbers),
        learned: to_remember,
        days_s: kept.iter().map(|block| block.time_s).collect(),
        cleaned_percent: cleaned.map_or_else(Vec::new, |cleaned| {
            cleaned.column_iter().map(|mode| mode.iter().map(|value| 100.0 * value).collect()).collect()
        }),
        seen_percent: (0..numbers.len()).map(|mode| seen_percent(&kept, mode)).collect(),
    }
}

/// A watch at work.
struct Watch<'a> {
    blocks: &'a [Block],
    numbers: &'a [usize],
    settings: &'a Settings,
    alarm_from: f64,
    alarms: Vec<Alarm>,
    learned: Option<Learned>,
}

impl Watch<'_> {
    /// The first days after changes that lasted, of those alarms.
    fn changes(&self, is_meant: impl Fn(&Alarm) -> bool) -> Vec<usize> {
        let day = |alarm: &Alarm| self.blocks.partition_point(|block| block.time_s < alarm.first_day_s);
        let lasting = self.alarms.iter().filter(|alarm| alarm.state != State::Withdrawn);
        let days = lasting.filter(|alarm| is_meant(alarm)).map(day);
        days.filter(|day| (1..self.blocks.len()).contains(day)).collect()
    }

    /// The evidence for a change that is not known, after so many days.
    fn judge_day(&mut self, days: usize) -> Option<f64> {
        let blocks = &self.blocks[..days];
        let today_s = blocks.last()?.time_s;
        let known: Vec<usize> =
            self.changes(|alarm| alarm.state == State::Lasting).into_iter().filter(|day| *day < days).collect();
        self.learned = Learned::up_to_date(self.learned.take(), blocks, &known);
        let found = self.learned.as_ref()?.evidence(blocks, &known)?;
        let stands_out = found.log > self.alarm_from && self.is_large(&found);
        let (alarm_from, told) = (self.alarm_from, self.told(&found, blocks));
        match self.alarms.last_mut().filter(|alarm| alarm.state == State::Open) {
            Some(open) => {
                let raised_s = open.raised_s;
                let is_settled = today_s - raised_s >= FOLLOWED_DAYS * DAY_S;
                // What stood out once may come out smaller; it is taken back where the evidence goes.
                let state = match (is_settled, found.log > alarm_from) {
                    (false, _) => State::Open,
                    (true, true) => State::Lasting,
                    (true, false) => State::Withdrawn,
                };
                *open = Alarm { raised_s, state, ..told };
                // What is learned beside another change is not what was learned without it.
                if is_settled {
                    self.learned = None;
                }
            }
            None if stands_out => self.alarms.push(told),
            None => {}
        }
        Some(found.log)
    }

    fn is_large(&self, found: &Evidence) -> bool {
        let is_large = |mode: usize| {
            let std = found.covariance[(mode, mode)].sqrt();
            found.changes[mode].abs() > self.settings.least_change + SURELY * std
        };
        (0..found.changes.len()).any(is_large)
    }

    fn told(&self, found: &Evidence, blocks: &[Block]) -> Alarm {
        let mut sum = 0.0;
        let cumulated: Vec<f64> = found
            .by_day
            .iter()
            .map(|probability| {
                sum += probability;
                sum
            })
            .collect();
        let day_at = |probability: f64| {
            found.first + cumulated.partition_point(|sum| *sum < probability).min(cumulated.len().saturating_sub(1))
        };
        let shift = |(mode, number): (usize, &usize)| ModeShift {
            number: *number,
            percent: 100.0 * found.changes[mode],
            std_percent: 100.0 * found.covariance[(mode, mode)].sqrt(),
        };
        Alarm {
            raised_s: blocks.last().map_or(0.0, |block| block.time_s),
            first_day_s: blocks[found.day].time_s,
            between_s: [blocks[day_at(TAIL) - 1].time_s, blocks[day_at(1.0 - TAIL)].time_s],
            log_evidence: found.log,
            state: State::Open,
            modes: self.numbers.iter().enumerate().map(shift).collect(),
        }
    }
}

/// Days on which frost has no part.
fn without_frost(blocks: &[Block], frost_below_degc: Option<f64>) -> Vec<Block> {
    let Some(below_degc) = frost_below_degc else { return blocks.to_vec() };
    let mut last_hard_frost_s = f64::NEG_INFINITY;
    let is_warm = |block: &&Block| {
        let Some([air, days, _]) = block.temperatures_degc else { return true };
        let coldest = air.min(days);
        if coldest < below_degc - HARD_FROST_K {
            last_hard_frost_s = block.time_s;
        }
        coldest >= below_degc && block.time_s - last_hard_frost_s > THAWS_IN_DAYS * DAY_S
    };
    blocks.iter().filter(is_warm).cloned().collect()
}

/// Modes that the last week does not show although most days before do.
fn lost(blocks: &[Block], numbers: &[usize]) -> Vec<usize> {
    let Some(before) = blocks.len().checked_sub(LOST_AFTER).filter(|before| *before >= LEAST_BEFORE) else {
        return Vec::new();
    };
    let is_lost = |mode: usize| {
        let seen = |blocks: &[Block]| blocks.iter().filter(|block| block.modes[mode].is_some()).count();
        let share = seen(&blocks[..before]) as f64 / before as f64;
        // Not certain to be seen, however often it was.
        let share = share.min(1.0 - 1.0 / (before + 2) as f64);
        let unseen = LOST_AFTER - seen(&blocks[before..]);
        at_least(unseen, LOST_AFTER, 1.0 - share) < LOST
    };
    numbers.iter().enumerate().filter(|(mode, _)| is_lost(*mode)).map(|(_, number)| *number).collect()
}

/// Frequencies about their mean, in percent.
fn seen_percent(blocks: &[Block], mode: usize) -> Vec<Option<f64>> {
    let values: Vec<Option<f64>> = blocks.iter().map(|block| block.modes[mode].map(|seen| seen.value)).collect();
    let (sum, count) = values.iter().flatten().fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    values.into_iter().map(|value| value.map(|value| 100.0 * (value - sum / f64::max(count, 1.0)))).collect()
}
