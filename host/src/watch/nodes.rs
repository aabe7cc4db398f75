//! How nodes are, by what has come of each lately: one that is silent, loses samples, has a faulty sensor or a clock that is off is an alarm of its own
//! kind, which begins and ends.
//!
//! Heartbeats and the heads of windows flow in, [`NodeState`]s flow out. A state before says which problems are open already: those end at half
//! of what begins them, so that one on the edge does not come and go.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::heartbeats::KeptHeartbeat;
use crate::statistics::median;

/// How far back heartbeats say how much is lost, in s.
pub const LOOKED_BACK_S: f64 = 86_400.0;
/// Windows that say how good a node's clock is: the newest.
pub const NEWEST_WINDOWS: usize = 9;
/// Heartbeats have to span this long before a share of lost samples is said, in s.
const LEAST_SPAN_S: f64 = 600.0;
/// The largest share of samples or windows that may be lost.
const MOST_LOST: f64 = 0.01;
/// Crystals are within 20 to 50 ppm; one that is off by this much is broken, or its node is too hot or too cold for it.
const MOST_DRIFT_PPM: f64 = 200.0;
/// A sensor is faulty when so many heartbeats on end say so.
const FAULTY_HEARTBEATS: usize = 3;
/// Where windows are rarer than heartbeats, a node is silent after this many of them.
const WINDOWS_MISSED: f64 = 4.0;
/// How far clocks of nodes and of this computer may be apart, in s.
const AHEAD_S: f64 = 60.0;
/// An open problem ends below this share of what begins it.
const ENDS_BELOW: f64 = 0.5;

/// The head of a window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WindowHead {
    /// When it came, or began, whichever is later, in s of Unix time.
    pub time_s: f64,
    /// When it began.
    pub start_s: f64,
    /// When its middle was, minus when it should have been, in s.
    pub middle_offset_s: f64,
    /// How much faster the host's clock ran than the node's, in ppm.
    pub drift_ppm: f64,
}

/// What has come of a node lately.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NodeNews {
    /// The node.
    pub node: u16,
    /// The newest windows, the newest first; up to [`NEWEST_WINDOWS`].
    pub windows: Vec<WindowHead>,
    /// Heartbeats of the last [`LOOKED_BACK_S`], oldest first.
    pub heartbeats: Vec<KeptHeartbeat>,
    /// Time between two of the node's samples in s, before and after decimation; zero where nothing says them.
    pub sample_s: f64,
    /// After decimation.
    pub decimated_s: f64,
}

/// What can be wrong with a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Problem {
    /// Nothing has come of it.
    Silent,
    /// It loses samples or windows.
    LosesSamples,
    /// Its clock is off, or runs badly.
    ClockOff,
    /// A sensor is faulty.
    FaultySensor,
}

/// Something that is wrong with a node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OpenProblem {
    /// What.
    pub problem: Problem,
    /// When it was seen first, in s of Unix time; of a node that is silent, when it last spoke.
    pub since_s: f64,
    /// What is measured, as words: "3.1 % of samples".
    pub says: String,
}

/// How a node is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NodeState {
    /// The node.
    pub node: u16,
    /// When something last came of it, in s of Unix time; null where nothing ever has.
    pub last_seen_s: Option<f64>,
    /// Its sensor's temperature in °C.
    pub temperature_degc: Option<f64>,
    /// The share of samples that it lost within a day; null where heartbeats do not say.
    pub lost_samples_share: Option<f64>,
    /// The share of windows.
    pub lost_windows_share: Option<f64>,
    /// How far its windows are off the grid of time, in s: the median of the newest.
    pub clock_offset_s: Option<f64>,
    /// How much faster the host's clock runs than its own, in ppm.
    pub clock_drift_ppm: Option<f64>,
    /// What is wrong.
    pub problems: Vec<OpenProblem>,
}

/// When nodes are an alarm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NodeLimits {
    /// A node is silent when nothing has come of it for this long, in s.
    pub silent_after_s: f64,
}

impl Default for NodeLimits {
    fn default() -> Self {
        Self { silent_after_s: 900.0 }
    }
}

/// What has become of a problem.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Turn {
    /// The node.
    pub node: u16,
    /// Whether it has ended.
    pub is_over: bool,
    /// It.
    pub problem: OpenProblem,
}

impl fmt::Display for Problem {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Silent => "is silent",
            Self::LosesSamples => "loses samples",
            Self::ClockOff => "has a clock that is off",
            Self::FaultySensor => "has a faulty sensor",
        })
    }
}

/// How a node is at `now_s`, which was as `before` says.
pub fn state(news: &NodeNews, before: Option<&NodeState>, limits: &NodeLimits, now_s: f64) -> NodeState {
    let last_window_s = news.windows.first().map(|window| window.time_s);
    let last = news.heartbeats.last();
    let last_seen_s = [last_window_s, last.map(|last| last.time_s), before.and_then(|before| before.last_seen_s)];
    // A clock that was ahead for a while has seen nothing that is still to come.
    let has_been = |time_s: &f64| *time_s <= now_s + AHEAD_S;
    let last_seen_s = last_seen_s.into_iter().flatten().filter(has_been).reduce(f64::max);
    let lost = Lost::of(news);
    let clock_offset_s = median_of(news.windows.iter().map(|window| window.middle_offset_s));
    let clock_drift_ppm = median_of(news.windows.iter().map(|window| window.drift_ppm));
    let mut problems = Vec::new();
    // A problem of which nothing is measured now is as it was: silence is no recovery.
    let mut note = |problem: Problem, since_s: f64, measured: Option<(f64, String)>| {
        let open = before.and_then(|before| before.problems.iter().find(|open| open.problem == problem));
        let least = if open.is_some() { ENDS_BELOW } else { 1.0 };
        match measured {
            None => problems.extend(open.cloned()),
            Some((size, says)) if size > least => {
                problems.push(OpenProblem { problem, since_s: open.map_or(since_s, |open| open.since_s), says });
            }
            Some(_) => {}
        }
    };
    if let Some(seen_s) = last_seen_s {
        // A node whose windows are long has to be waited for where it says nothing else.
        let by_windows_s = if last.is_none() { WINDOWS_MISSED * spacing_s(&news.windows) } else { 0.0 };
        let after_s = limits.silent_after_s.max(by_windows_s);
        // It speaks or it does not: there is no edge to be on.
        let size = if now_s - seen_s > after_s { 2.0 } else { 0.0 };
        note(Problem::Silent, seen_s, Some((size, format!("nothing for {}", duration(now_s - seen_s)))));
    }
    let shares = [lost.samples, lost.windows].into_iter().flatten();
    let loses = shares.reduce(f64::max).map(|most| {
        let of = |share: Option<f64>, what: &str| share.map(|share| format!("{:.1} % of {what}", 100.0 * share));
        let told: Vec<String> =
            [of(lost.samples, "samples"), of(lost.windows, "windows")].into_iter().flatten().collect();
        (most / MOST_LOST, told.join(", "))
    });
    note(Problem::LosesSamples, now_s, loses);
    let clock = clock_offset_s.zip(clock_drift_ppm).map(|(offset_s, drift_ppm)| {
        // A node keeps its windows on the grid to a sample after decimation.
        let by_offset = if news.decimated_s > 0.0 { offset_s.abs() / news.decimated_s } else { 0.0 };
        let size = by_offset.max(drift_ppm.abs() / MOST_DRIFT_PPM);
        (size, format!("off by {:.1} ms, drifting by {drift_ppm:.1} ppm", 1e3 * offset_s))
    });
    note(Problem::ClockOff, now_s, clock);
    let faulty = match lasting_faults(&news.heartbeats) {
        Some(faults) => Some((2.0, faults)),
        None if news.heartbeats.is_empty() => None,
        None => Some((0.0, String::new())),
    };
    note(Problem::FaultySensor, now_s, faulty);
    NodeState {
        node: news.node,
        last_seen_s,
        temperature_degc: last.and_then(|last| last.temperature_degc),
        lost_samples_share: lost.samples,
        lost_windows_share: lost.windows,
        clock_offset_s,
        clock_drift_ppm,
        problems,
    }
}

/// What has begun and ended between two states of all nodes.
pub fn turns(before: &[NodeState], now: &[NodeState]) -> Vec<Turn> {
    let mut turns = Vec::new();
    for state in now {
        let earlier = before.iter().find(|earlier| earlier.node == state.node).map_or(&[][..], |one| &one.problems);
        let is_in = |list: &[OpenProblem], one: &OpenProblem| list.iter().any(|other| other.problem == one.problem);
        let turn =
            |is_over: bool| move |problem: &OpenProblem| Turn { node: state.node, is_over, problem: problem.clone() };
        turns.extend(earlier.iter().filter(|one| !is_in(&state.problems, one)).map(turn(true)));
        turns.extend(state.problems.iter().filter(|one| !is_in(earlier, one)).map(turn(false)));
    }
    turns
}

/// Shares that were lost.
struct Lost {
    samples: Option<f64>,
    windows: Option<f64>,
}

impl Lost {
    /// Counts rise from a node's start on: what they rose by from one heartbeat to the next, each life for itself.
    fn of(news: &NodeNews) -> Self {
        let mut lives: BTreeMap<u32, [&KeptHeartbeat; 2]> = BTreeMap::new();
        for heartbeat in &news.heartbeats {
            lives.entry(heartbeat.boot).or_insert([heartbeat; 2])[1] = heartbeat;
        }
        let (mut span_s, mut rows, mut windows) = (0.0, 0.0, 0.0);
        for [first, last] in lives.values() {
            span_s += last.time_s - first.time_s;
            let rose = |count: fn(&KeptHeartbeat) -> u32| f64::from(count(last).saturating_sub(count(first)));
            rows += rose(|one| one.lost_rows) + rose(|one| one.stale_rows);
            windows += rose(|one| one.lost_windows);
        }
        let share = |lost: f64, every_s: f64| {
            (span_s >= LEAST_SPAN_S && every_s > 0.0).then(|| (lost * every_s / span_s).min(1.0))
        };
        // One window lost among few is no share.
        let windows = if windows > 1.0 { windows } else { 0.0 };
        Self { samples: share(rows, news.sample_s), windows: share(windows, spacing_s(&news.windows)) }
    }
}

/// Time from one window to the next, in s: the median.
fn spacing_s(windows: &[WindowHead]) -> f64 {
    median_of(windows.windows(2).map(|pair| pair[0].start_s - pair[1].start_s)).unwrap_or(0.0).max(0.0)
}

/// The sensors that all of the newest heartbeats call faulty.
fn lasting_faults(heartbeats: &[KeptHeartbeat]) -> Option<String> {
    let newest = heartbeats.get(heartbeats.len().checked_sub(FAULTY_HEARTBEATS)?..)?;
    let last = newest.last()?;
    let lasts = |channel: usize| newest.iter().all(|one| one.faults.iter().any(|(faulty, _)| *faulty == channel));
    let told: Vec<String> = last
        .faults
        .iter()
        .filter(|(channel, _)| lasts(*channel))
        .map(|(channel, what)| format!("channel {channel} {what}"))
        .collect();
    (!told.is_empty()).then(|| told.join(", "))
}

fn median_of(values: impl Iterator<Item = f64>) -> Option<f64> {
    median(&mut values.collect::<Vec<f64>>())
}

/// A time in s as words.
fn duration(time_s: f64) -> String {
    let seconds = time_s.clamp(0.0, 1e9) as u64;
    humantime::format_duration(std::time::Duration::from_secs(if seconds < 120 { seconds } else { seconds / 60 * 60 }))
        .to_string()
}

#[cfg(test)]
mod tests {
    use std::slice::from_ref;

    use super::*;

    const NOW_S: f64 = 1.8e9;
    const LIMITS: NodeLimits = NodeLimits { silent_after_s: 900.0 };

    fn heartbeat(ago_s: f64, boot: u32, lost_rows: u32) -> KeptHeartbeat {
        KeptHeartbeat {
            time_s: NOW_S - ago_s,
            node: 3,
            boot,
            temperature_degc: Some(21.5),
            mean_m_s2: Vec::new(),
            variance: Vec::new(),
            lost_rows,
            stale_rows: 0,
            lost_windows: 0,
            faults: Vec::new(),
        }
    }

    /// A node of 50 samples a second, 5 after decimation, whose windows come every two minutes.
    fn news(heartbeats: Vec<KeptHeartbeat>) -> NodeNews {
        let window = |index: usize| {
            let start_s = NOW_S - 60.0 - 120.0 * index as f64;
            WindowHead { time_s: start_s, start_s, middle_offset_s: 0.004, drift_ppm: 18.0 }
        };
        NodeNews { node: 3, windows: (0..9).map(window).collect(), heartbeats, sample_s: 0.02, decimated_s: 0.2 }
    }

    fn problems(state: &NodeState) -> Vec<Problem> {
        state.problems.iter().map(|open| open.problem).collect()
    }

    #[test]
    fn a_node_is_silent_when_nothing_has_come_for_a_while_and_speaks_again() {
        let good = state(&news(vec![heartbeat(60.0, 7, 0)]), None, &LIMITS, NOW_S);
        assert!(good.problems.is_empty() && good.temperature_degc == Some(21.5), "{good:?}");
        assert_eq!(good.last_seen_s, Some(NOW_S - 60.0));
        // A quarter of an hour without anything; the windows are in the archive as they were.
        let later_s = NOW_S + 900.0;
        let silent = state(&news(Vec::new()), Some(&good), &LIMITS, later_s);
        assert_eq!(problems(&silent), [Problem::Silent]);
        assert_eq!((silent.problems[0].since_s, silent.problems[0].says.as_str()), (NOW_S - 60.0, "nothing for 16m"));
        let [begun] = &turns(from_ref(&good), from_ref(&silent))[..] else { panic!("one turn") };
        assert!(!begun.is_over && begun.node == 3);
        assert_eq!(turns(from_ref(&silent), from_ref(&silent)), []);
        let [over] = &turns(&[silent], &[good])[..] else { panic!("one turn") };
        assert!(over.is_over && over.problem.problem == Problem::Silent);
        // Where windows alone say that it is there, four of them are waited for.
        let mut rare = news(Vec::new());
        rare.windows.iter_mut().enumerate().for_each(|(at, one)| {
            (one.time_s, one.start_s) = (NOW_S - 1000.0 * (1.0 + at as f64), NOW_S - 1000.0 * (1.0 + at as f64));
        });
        assert_eq!(problems(&state(&rare, None, &LIMITS, NOW_S + 2900.0)), []);
        assert_eq!(problems(&state(&rare, None, &LIMITS, NOW_S + 3100.0)), [Problem::Silent]);
        // Of one that never came nothing is known.
        assert_eq!(problems(&state(&NodeNews::default(), None, &LIMITS, NOW_S)), []);
    }

    #[test]
    fn lost_samples_are_an_alarm_above_a_hundredth_of_a_day_until_they_are_half_of_that() {
        // An hour of 50 samples a second is 180 000.
        let share = |lost: u32| {
            state(&news(vec![heartbeat(3660.0, 7, 100), heartbeat(60.0, 7, 100 + lost)]), None, &LIMITS, NOW_S)
        };
        let good = share(1700);
        assert!(good.problems.is_empty() && (good.lost_samples_share.unwrap() - 1700.0 / 180_000.0).abs() < 1e-12);
        let bad = share(5400);
        assert_eq!(
            (problems(&bad), bad.problems[0].says.as_str()),
            (vec![Problem::LosesSamples], "3.0 % of samples, 0.0 % of windows")
        );
        let on = |lost: u32| {
            let news = news(vec![heartbeat(3660.0, 7, 100), heartbeat(60.0, 7, 100 + lost)]);
            problems(&state(&news, Some(&bad), &LIMITS, NOW_S))
        };
        assert_eq!((on(1700), on(800)), (vec![Problem::LosesSamples], vec![]));
        // A start in between counts from zero again; ten minutes say nothing.
        let lives =
            vec![heartbeat(3660.0, 7, 9000), heartbeat(1860.0, 7, 9000), heartbeat(1800.0, 8, 0), heartbeat(0.0, 8, 0)];
        assert_eq!(state(&news(lives), None, &LIMITS, NOW_S).lost_samples_share, Some(0.0));
        assert_eq!(
            state(&news(vec![heartbeat(300.0, 7, 0), heartbeat(0.0, 7, 9000)]), None, &LIMITS, NOW_S).problems,
            []
        );
    }

    #[test]
    fn a_clock_off_the_grid_or_a_crystal_that_is_broken_and_a_sensor_that_stays_faulty_are_alarms() {
        let mut off = news(vec![heartbeat(60.0, 7, 0)]);
        off.windows.iter_mut().for_each(|window| window.middle_offset_s = -0.21);
        let off = state(&off, None, &LIMITS, NOW_S);
        assert_eq!((problems(&off), off.clock_offset_s), (vec![Problem::ClockOff], Some(-0.21)));
        let mut one = news(vec![heartbeat(60.0, 7, 0)]);
        one.windows[0].middle_offset_s = 5.0;
        assert_eq!(problems(&state(&one, None, &LIMITS, NOW_S)), [], "one window is none");
        let mut fast = news(vec![heartbeat(60.0, 7, 0)]);
        fast.windows.iter_mut().for_each(|window| window.drift_ppm = 260.0);
        assert_eq!(problems(&state(&fast, None, &LIMITS, NOW_S)), [Problem::ClockOff]);
        let faulty = |ago_s: f64, channel: usize| KeptHeartbeat {
            faults: vec![(channel, "clipped".to_owned())],
            ..heartbeat(ago_s, 7, 0)
        };
        let stays = state(&news(vec![faulty(300.0, 2), faulty(180.0, 2), faulty(60.0, 2)]), None, &LIMITS, NOW_S);
        assert_eq!(
            (problems(&stays), stays.problems[0].says.as_str()),
            (vec![Problem::FaultySensor], "channel 2 clipped")
        );
        assert_eq!(
            problems(&state(&news(vec![faulty(300.0, 2), faulty(180.0, 1), faulty(60.0, 2)]), None, &LIMITS, NOW_S)),
            []
        );
        // A day of silence is no recovery: both stay until something else is measured.
        let bad = NodeState { problems: [bad_share(), stays.problems.clone()].concat(), ..stays };
        let later = state(&news(Vec::new()), Some(&bad), &LIMITS, NOW_S + 2.0 * LOOKED_BACK_S);
        assert_eq!(problems(&later), [Problem::Silent, Problem::LosesSamples, Problem::FaultySensor]);
        let spoken = news(vec![heartbeat(3660.0, 7, 0), heartbeat(60.0, 7, 0)]);
        assert_eq!(problems(&state(&spoken, Some(&bad), &LIMITS, NOW_S)), []);
    }

    fn bad_share() -> Vec<OpenProblem> {
        state(&news(vec![heartbeat(3660.0, 7, 0), heartbeat(60.0, 7, 5400)]), None, &LIMITS, NOW_S).problems
    }

    /// A computer without a clock thinks that it is 2036 until it is told the time.
    #[test]
    fn what_was_seen_in_a_time_to_come_was_not_seen() {
        let mut ahead = news(vec![heartbeat(60.0, 7, 0)]);
        ahead.windows[0].time_s = NOW_S + 3e8;
        let seen = state(&ahead, None, &LIMITS, NOW_S);
        assert_eq!(seen.last_seen_s, Some(NOW_S - 60.0));
        let kept = NodeState { last_seen_s: Some(NOW_S + 3e8), ..seen };
        assert_eq!(problems(&state(&news(Vec::new()), Some(&kept), &LIMITS, NOW_S + 3600.0)), [Problem::Silent]);
    }
}
