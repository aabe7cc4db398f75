//! Watching a study: new intervals are measured and kept, and all days are judged.
//!
//! The modes that are followed, the intervals that were seen and the alarms that were raised stand in the study's `results`, so a watch
//! goes on where it stopped, and whoever starts it anew gets the same.

use std::path::Path;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::cause::{Cause, cause};
use super::error::StoryError;
use super::nodes::nodes;
use crate::archive::{TimeRange, now_s};
use crate::identify::Identification;
use crate::measure::{Intervals, Route};
use crate::progress::{OnProgress, rows_of};
use crate::results::{ALARMS_FILE, INTERVALS_FILE, Lines, MODES_FILE, NODES_FILE, REFERENCE_FILE, Results, WATCH_FILE};
use crate::study::Study;
use crate::trend::seen;
use crate::watch::{
    Alarm, Block, JudgedBefore, Judgement, NodeLimits, NodeState, OpenProblem, Remembered, SeenInterval, Settings,
    State, Turn, blocks, judge, node_turns, often_seen,
};

/// What a watch is asked for.
#[derive(Debug, Clone, Copy)]
pub struct WatchRequest {
    /// Length of an interval.
    pub every: Duration,
    /// How spectra are made of recordings.
    pub route: Route,
    /// When an alarm is raised.
    pub settings: Settings,
}

/// How nodes are.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NodesReport {
    /// Each.
    pub nodes: Vec<NodeState>,
    /// What has begun and ended this time.
    pub events: Vec<NodeEvent>,
    /// Why nothing new is known.
    pub warning: Option<String>,
}

/// What is kept of that.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct KeptNodes {
    nodes: Vec<NodeState>,
}

/// What a watch has found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WatchReport {
    /// Length of an interval in s.
    pub every_s: f64,
    /// The modes that are followed.
    pub modes: Vec<WatchedMode>,
    /// Intervals that were seen until now, and those that are new.
    pub intervals: usize,
    /// Those of this time.
    pub new_intervals: usize,
    /// Until when days were judged, as times of the intervals count: Unix time of what nodes have sent, s after a recording's first row.
    pub judged_until_s: Option<f64>,
    /// When an alarm is raised.
    pub settings: Settings,
    /// What the days say.
    pub judgement: Judgement,
    /// What each alarm's change most probably is, by the study's model; null where there is none, or it cannot say.
    pub causes: Vec<Option<Cause>>,
    /// What has become of alarms this time.
    pub events: Vec<Event>,
    /// How each node is; none of recordings.
    pub nodes: Vec<NodeState>,
    /// What has begun and ended at nodes this time.
    pub node_events: Vec<NodeEvent>,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

/// A mode that is followed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WatchedMode {
    /// Its number.
    pub number: usize,
    /// Its frequency in Hz in the interval that showed it last.
    pub frequency_hz: f64,
    /// The share of intervals that show it.
    pub seen_share: f64,
    /// Whether that is enough to judge it.
    pub is_judged: bool,
}

/// What has become of an alarm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// The structure's name.
    pub structure: String,
    /// Raised, lasting or withdrawn.
    pub event: EventKind,
    /// The alarm.
    pub alarm: Alarm,
    /// What its change most probably is, where the study has a model that can say.
    #[serde(default)]
    pub cause: Option<Cause>,
}

/// What can become of an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// It is raised.
    Raised,
    /// Two weeks later the change is still there.
    Lasting,
    /// Later days take it back.
    Withdrawn,
}

/// What has begun, or ended, at a node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NodeEvent {
    /// The structure's name.
    pub structure: String,
    /// Begun or ended.
    pub event: Turned,
    /// The node.
    pub node: u16,
    /// What.
    #[serde(flatten)]
    pub problem: OpenProblem,
}

/// What can become of a problem.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Turned {
    /// It has begun.
    Begun,
    /// It has ended.
    Ended,
}

/// A line of `alarms.jsonl`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum WatchEvent {
    /// Of the structure.
    Structure(Event),
    /// Of a node.
    Node(NodeEvent),
}

/// What an earlier run left.
#[derive(Debug, Clone, Default, Deserialize)]
pub(crate) struct Earlier {
    #[serde(default)]
    every_s: f64,
    judged_until_s: Option<f64>,
    #[serde(default)]
    judgement: EarlierJudgement,
    #[serde(default)]
    causes: Vec<Option<Cause>>,
    /// What was learned; a fleet's worker remembers it. What another version has left is nothing.
    #[serde(default)]
    learned: Value,
}

#[derive(Debug, Clone, Default, Deserialize)]
struct EarlierJudgement {
    #[serde(default)]
    alarms: Vec<Alarm>,
}

/// Looks how nodes are, whatever can be measured, and notes what has begun and ended.
pub(super) fn watch_nodes(study: &Study, results: &Results, limits: &NodeLimits) -> Result<NodesReport, StoryError> {
    let before: KeptNodes = results.read_json(NODES_FILE, "watch")?.unwrap_or_default();
    let nodes = match nodes(study, &before.nodes, limits, now_s()) {
        Ok(nodes) => nodes,
        Err(why) => {
            let warning = Some(format!("how nodes are is not known: {why}"));
            return Ok(NodesReport { nodes: before.nodes, events: Vec::new(), warning });
        }
    };
    let events = node_events(&study.structure.name, &before.nodes, &nodes);
    // Events first: one that is noted twice is better than none.
    note(results, events.iter().cloned().map(WatchEvent::Node).collect())?;
    if nodes != before.nodes {
        results.write_json(NODES_FILE, &KeptNodes { nodes: nodes.clone() })?;
    }
    Ok(NodesReport { nodes, events, warning: None })
}

/// What has begun and ended at the nodes of a structure between two states.
pub(crate) fn node_events(structure: &str, before: &[NodeState], now: &[NodeState]) -> Vec<NodeEvent> {
    let turned = |turn: Turn| NodeEvent {
        structure: structure.to_owned(),
        event: if turn.is_over { Turned::Ended } else { Turned::Begun },
        node: turn.node,
        problem: turn.problem,
    };
    node_turns(before, now).into_iter().map(turned).collect()
}

/// Appends events to the file of alarms.
fn note(results: &Results, events: Vec<WatchEvent>) -> Result<(), StoryError> {
    if !events.is_empty() {
        results.append(ALARMS_FILE, results.lines::<WatchEvent>(ALARMS_FILE)?, &events)?;
    }
    Ok(())
}

/// Measures what is new, judges it, and writes what was found.
pub(super) fn watch(
    study: &mut Study,
    results: &Results,
    request: &WatchRequest,
    nodes: NodesReport,
    on_progress: OnProgress<'_>,
) -> Result<WatchReport, StoryError> {
    if study.setups.is_empty() {
        return Err(StoryError::NoSetupToWatch);
    }
    let every_s = request.every.as_secs_f64();
    let earlier: Earlier = results.read_json(WATCH_FILE, "watch")?.unwrap_or_default();
    if earlier.every_s > 0.0 && earlier.every_s != every_s {
        return Err(StoryError::OtherIntervals {
            before_s: earlier.every_s,
            every_s,
            file: results.path(INTERVALS_FILE),
        });
    }
    let reference = reference(results)?;
    let mut lines = results.lines(INTERVALS_FILE)?;
    let (mut intervals, mut warnings) = in_order(&mut lines, &results.path(INTERVALS_FILE));
    let before = intervals.len();
    let last_end_s = intervals.last().map(|last| last.end_s);
    let is_live = study.setups.iter().any(|setup| setup.live);
    // The first is at a full hour, or what else the intervals are.
    let from_s = is_live.then_some(last_end_s.unwrap_or(0.0));
    if let (true, Some(end_s)) = (is_live, last_end_s) {
        study.range = TimeRange { from_us: Some((end_s * 1e6).round() as i64), ..TimeRange::ALL };
    }
    let last_hz = last_seen(&reference, &intervals);
    let on_rows = &mut rows_of("intervals", on_progress);
    let every = Intervals { every_s, from_s };
    let (new, told) = seen(study, &reference, &last_hz, every, request.route, on_rows).map_err(StoryError::Follow)?;
    warnings.extend(told);
    intervals.extend(new.into_iter().filter(|one| last_end_s.is_none_or(|end_s| one.start_s >= end_s - 1e-3)));
    let without = intervals.iter().filter(|one| one.temperature_degc.is_none()).count();
    if request.settings.frost_below_degc.is_some() && without > 0 {
        warnings.push(format!(
            "{without} of {} intervals have no temperature: days without one cannot be told from days of frost, and weather may pass for a change; give the setup a `temperature` file",
            intervals.len()
        ));
    }
    results.append(INTERVALS_FILE, lines, &intervals[before..])?;
    let judged = judged(study, results, &reference, &intervals, &request.settings, earlier);
    warnings.extend(nodes.warning);
    warnings.extend(judged.warnings);
    let share = |number: usize| {
        let seen = intervals.iter().filter(|one| one.modes.iter().any(|mode| mode.number == number)).count();
        seen as f64 / intervals.len().max(1) as f64
    };
    let now_hz = last_seen(&reference, &intervals);
    note(results, judged.events.iter().cloned().map(WatchEvent::Structure).collect())?;
    Ok(WatchReport {
        every_s,
        modes: now_hz
            .into_iter()
            .map(|(number, frequency_hz)| WatchedMode {
                number,
                frequency_hz,
                seen_share: share(number),
                is_judged: judged.numbers.contains(&number),
            })
            .collect(),
        intervals: intervals.len(),
        new_intervals: intervals.len() - before,
        judged_until_s: judged.until_s,
        settings: request.settings,
        judgement: judged.judgement,
        causes: judged.causes,
        events: judged.events,
        nodes: nodes.nodes,
        node_events: nodes.events,
        warnings,
    })
}

/// What all days say.
pub(crate) struct Judged {
    /// Until when days were judged.
    pub(crate) until_s: Option<f64>,
    /// Numbers of the modes that intervals show often enough.
    numbers: Vec<usize>,
    pub(crate) judgement: Judgement,
    /// What each alarm's change most probably is.
    pub(crate) causes: Vec<Option<Cause>>,
    /// What has become of alarms this time.
    pub(crate) events: Vec<Event>,
    pub(crate) warnings: Vec<String>,
}

/// Judges all intervals, and goes on from what was judged `earlier`; `results` has the modes that are followed as a file, too.
pub(crate) fn judged(
    study: &Study,
    results: &Results,
    reference: &Identification,
    intervals: &[SeenInterval],
    settings: &Settings,
    earlier: Earlier,
) -> Judged {
    let mut warnings = Vec::new();
    let numbers: Vec<usize> = reference.modes.iter().map(|mode| mode.number).collect();
    let numbers = often_seen(intervals, &numbers);
    let days = whole_days(blocks(intervals, &numbers), intervals.last());
    let old = earlier.judgement.alarms.clone();
    let before = JudgedBefore {
        until_s: earlier.judged_until_s,
        alarms: earlier.judgement.alarms,
        learned: serde_json::from_value::<Option<Remembered>>(earlier.learned).unwrap_or_default(),
    };
    let judgement = judge(&days, &numbers, settings, before);
    let changed = changed(&old, &judgement.alarms);
    let mut causes = earlier.causes;
    causes.resize(judgement.alarms.len(), None);
    let mut anew: Vec<usize> = changed.iter().map(|(index, _)| *index).collect();
    anew.dedup();
    for index in anew {
        let is_withdrawn = judgement.alarms[index].state == State::Withdrawn;
        causes[index] = match is_withdrawn {
            true => None,
            false => cause_of(study, results, &judgement.alarms, index, &mut warnings),
        };
    }
    let event = |&(index, event): &(usize, EventKind)| Event {
        structure: study.structure.name.clone(),
        event,
        alarm: judgement.alarms[index].clone(),
        cause: causes[index].clone(),
    };
    let events = changed.iter().map(event).collect();
    let until_s = days.last().map(|day| day.time_s).or(earlier.judged_until_s);
    Judged { until_s, numbers, judgement, causes, events, warnings }
}

/// The modes that are followed: of an earlier watch, or else those that `identify` found.
fn reference(results: &Results) -> Result<Identification, StoryError> {
    if let Some(reference) = results.read_json(REFERENCE_FILE, "watch")? {
        return Ok(reference);
    }
    let found: Option<Identification> = results.read_json(MODES_FILE, "identify")?;
    let found = found.filter(|found| !found.modes.is_empty());
    let found = found.ok_or_else(|| StoryError::NothingToWatch { file: results.path(MODES_FILE) })?;
    results.write_json_short(REFERENCE_FILE, &found)?;
    Ok(found)
}

/// What intervals showed before, in the order of time, taken out of the lines, and a sentence for each line that is left out.
fn in_order(lines: &mut Lines<SeenInterval>, file: &Path) -> (Vec<SeenInterval>, Vec<String>) {
    let place = |line: &usize| format!("{}, line {line}", file.display());
    let broken = lines.broken.iter().map(|(line, why)| format!("{}: left out: {why}", place(line)));
    let mut sentences: Vec<String> = broken.chain(lines.half_a_line(file)).collect();
    let mut intervals: Vec<SeenInterval> = Vec::with_capacity(lines.objects.len());
    for (line, interval) in std::mem::take(&mut lines.objects) {
        if intervals.last().is_none_or(|last| interval.start_s >= last.start_s) {
            intervals.push(interval);
        } else {
            sentences.push(format!("{}: begins before the line above it; left out", place(&line)));
        }
    }
    (intervals, sentences)
}

/// Where each mode was seen last.
pub(crate) fn last_seen(reference: &Identification, intervals: &[SeenInterval]) -> Vec<(usize, f64)> {
    let last = |number: usize| {
        let mut newest = intervals.iter().rev().flat_map(|one| &one.modes);
        newest.find(|mode| mode.number == number).map(|mode| mode.frequency_hz)
    };
    reference.modes.iter().map(|mode| (mode.number, last(mode.number).unwrap_or(mode.frequency_hz))).collect()
}

/// Days that are over: one that goes on is judged tomorrow.
fn whole_days(mut days: Vec<Block>, last: Option<&SeenInterval>) -> Vec<Block> {
    const HALF_A_DAY_S: f64 = 43_200.0;
    let is_over = |day: &Block| last.is_some_and(|last| last.end_s >= day.time_s + HALF_A_DAY_S - 1.0);
    days.retain(is_over);
    days
}

/// What has become of alarms between two judgements: the index of each, and what.
fn changed(before: &[Alarm], now: &[Alarm]) -> Vec<(usize, EventKind)> {
    let mut events = Vec::new();
    for (index, alarm) in now.iter().enumerate() {
        let was = before.get(index).map(|alarm| alarm.state);
        if was.is_none() {
            events.push((index, EventKind::Raised));
        }
        match alarm.state {
            State::Lasting if was != Some(State::Lasting) => events.push((index, EventKind::Lasting)),
            State::Withdrawn if was != Some(State::Withdrawn) => events.push((index, EventKind::Withdrawn)),
            State::Open | State::Lasting | State::Withdrawn => {}
        }
    }
    events
}

/// What the change of an alarm is by the study's model; `None` where there is none, or where it cannot say, which is told.
fn cause_of(
    study: &Study,
    results: &Results,
    alarms: &[Alarm],
    index: usize,
    warnings: &mut Vec<String>,
) -> Option<Cause> {
    study.model.as_ref()?;
    match cause(study, &results.path(REFERENCE_FILE), &alarms[index], &alarms[..index]) {
        Ok(cause) => Some(cause),
        Err(error) => {
            warnings.push(format!("the model cannot say what has changed: {error}"));
            None
        }
    }
}
