//! A structure in a worker's hands: its windows of an interval become modes as a watch makes them, and its days are judged as a watch judges them.
//!
//! Nothing is kept here that is not on the server: a result says which mode was seen where last, and where the next interval begins. It is
//! published behind the structure's newest result, or not at all, where another worker has been quicker.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;

use async_nats::jetstream::kv::{Entry, UpdateErrorKind};
use async_nats::jetstream::message::StreamMessage;
use belfry_shared::time::HostTime;
use bytes::Bytes;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::day_table::DayTable;
use super::error::StreamError;
use super::ledger::{Due, Ledger};
use super::names::{self, DataKind};
use super::reading::{Incoming, Start, each};
use super::server::{PartStreams, Server, entry, id_of, newest};
use super::structure::{self, Structure};
use crate::archive::{Archive, PackedWindow, TimeRange};
use crate::fleet::FleetOptions;
use crate::heartbeats::HEARTBEATS_FILE;
use crate::identify::Identification;
use crate::measure::{Intervals, MeasureError, Route};
use crate::results::{REFERENCE_FILE, Results};
use crate::story::{Earlier, Event, Judged, NodeEvent, judged, last_seen, node_events, nodes};
use crate::study::Study;
use crate::trend::{TrendError, seen};
use crate::watch::{DAY_S, NodeLimits, NodeState, SeenInterval};

/// What an interval shows of a structure: a message of the stream of results.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IntervalResult {
    /// The structure, as subjects name it.
    pub structure: String,
    /// Whole intervals since the Unix epoch.
    pub interval: i64,
    /// Start in s of Unix time.
    pub start_s: f64,
    /// End, in s.
    pub end_s: f64,
    /// Windows of nodes, each counted once.
    pub windows: usize,
    /// What was seen of the modes; nothing where there was too little.
    pub seen: Option<SeenInterval>,
    /// The mode's number and frequency in Hz where each was seen last.
    pub last_hz: Vec<(usize, f64)>,
    /// The message of the stream from which whoever goes on reads: the first of this interval or of a later one. What is missing of the next is
    /// known from there.
    pub next: u64,
    /// How nodes are at its end, by what came of each; none in results of before 2026-12.
    #[serde(default)]
    pub nodes: Vec<NodeState>,
    /// What has begun and ended at nodes since the result before.
    #[serde(default)]
    pub node_events: Vec<NodeEvent>,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

/// What days have shown: a message of the stream of alarms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Alarms {
    structure: String,
    /// The day that was judged last, in days since the Unix epoch.
    day: i64,
    pub(super) events: Vec<Event>,
}

/// What the judgement of a structure goes on from.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct State {
    /// The day that an interval ended in when it was judged last.
    day: Option<i64>,
    /// The newest message of its alarms.
    alarms: u64,
    /// As `belfry watch` keeps it.
    pub(super) watch: Value,
}

/// A structure.
pub(super) struct Followed {
    key: String,
    streams: PartStreams,
    pub(super) structure: Structure,
    /// What the study stands in.
    _folder: TempDir,
    study: Arc<Study>,
    reference: Arc<Identification>,
    last_hz: Vec<(usize, f64)>,
    nodes: Vec<NodeState>,
    /// The last interval that has a result, and its place in the stream.
    done: Option<i64>,
    newest: u64,
    next: u64,
    state: State,
    revision: u64,
    /// Where results go as Parquet, and those of the newest day; none yet, or anew where they could not be written.
    tables: Option<Arc<PathBuf>>,
    table: Option<DayTable>,
}

/// The interval's messages, as they came.
struct Material {
    from_us: i64,
    to_us: i64,
    messages: Vec<Incoming>,
    /// Messages in between whose time was still to come when they came.
    ahead: usize,
}

impl Followed {
    /// Takes a structure over, where another worker has left it.
    pub(super) async fn take(server: &Server, key: &str, tables: Option<Arc<PathBuf>>) -> Result<Self, StreamError> {
        let (structure, _) = structure::read(server, key)
            .await?
            .ok_or_else(|| StreamError::Odd { what: key.to_owned(), why: "it has no entry".to_owned() })?;
        let folder = tempfile::tempdir().map_err(StreamError::System)?;
        structure::study_of(server, key).await?.unpack(folder.path())?;
        let mut study = Study::load(folder.path())?;
        // Readings of a station that were there when the study was added say nothing of today.
        study.setups.iter_mut().for_each(|setup| setup.temperature = None);
        let odd = |why: &str| StreamError::Odd { what: format!("the study of {key}"), why: why.to_owned() };
        let reference: Option<Identification> = Results::of(&study).read_json(REFERENCE_FILE, "watch")?;
        let reference = reference.ok_or_else(|| odd("it has no modes"))?;
        let streams = server.streams_of(key).await?;
        let last = newest(&streams.results, &names::results(key)).await?;
        let read = |last: &StreamMessage| StreamError::read(format!("the newest result of {key}"), &last.payload);
        let result: Option<IntervalResult> = last.as_ref().map(read).transpose()?;
        let entry = entry(&server.states().await?, key, "state").await?;
        let read = |entry: &Entry| StreamError::read(format!("the state of {key}"), &entry.value);
        let state: Option<State> = entry.as_ref().map(read).transpose()?;
        Ok(Self {
            key: key.to_owned(),
            streams,
            last_hz: result.as_ref().map_or_else(|| last_seen(&reference, &[]), |result| result.last_hz.clone()),
            done: result.as_ref().map(|result| result.interval),
            next: result.as_ref().map_or(1, |result| result.next),
            nodes: result.map(|result| result.nodes).unwrap_or_default(),
            newest: last.map_or(0, |last| last.sequence),
            state: state.unwrap_or_default(),
            revision: entry.map_or(0, |entry| entry.revision),
            structure,
            _folder: folder,
            study: Arc::new(study),
            reference: Arc::new(reference),
            tables,
            table: None,
        })
    }

    /// Reads what has come since the last result; the ledger of it, and the intervals that are over.
    pub(super) async fn catch_up(&self) -> Result<(Ledger, Vec<Due>), StreamError> {
        let mut ledger = Ledger::new(self.structure.every_us(), &self.structure.nodes, self.done);
        let mut due = Vec::new();
        each(&self.streams.data, &names::data(&self.key), Start::Message(self.next), true, |message| {
            if let Some((_, arrived)) = message.arrived() {
                due.extend(ledger.take(arrived));
            }
            Ok(ControlFlow::Continue(()))
        })
        .await?;
        Ok((ledger, due))
    }

    /// Keeps the newest result as Parquet, or all that are missing there; `None` before one was published.
    pub(super) async fn tabulate(&mut self, newest: Option<&IntervalResult>) -> Result<(), StreamError> {
        let Some(folder) = &self.tables else { return Ok(()) };
        let written = match (self.table.take(), newest) {
            (Some(mut table), Some(newest)) => table.push(newest.clone()).map(|()| table),
            (Some(table), None) => Ok(table),
            (None, _) => DayTable::catch_up(&self.streams.results, folder, &self.key).await,
        };
        self.table = Some(written?);
        Ok(())
    }

    /// Makes modes of an interval and publishes them.
    pub(super) async fn interval(&mut self, server: &Server, due: Due) -> Result<IntervalResult, StreamError> {
        let every_us = self.structure.every_us();
        let from_us = due.number.saturating_mul(every_us);
        let to_us = from_us.saturating_add(every_us);
        let mut material = Material { from_us, to_us, messages: Vec::new(), ahead: 0 };
        each(&self.streams.data, &names::data(&self.key), Start::Message(due.from), false, |message| {
            let sequence = message.sequence;
            if sequence > due.to {
                return Ok(ControlFlow::Break(()));
            }
            material.ahead += usize::from(message.is_ahead);
            if message.time_us.is_some_and(|time_us| (from_us..to_us).contains(&time_us)) {
                material.messages.push(message);
            }
            Ok(if sequence == due.to { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
        })
        .await?;
        let (study, reference) = (Arc::clone(&self.study), Arc::clone(&self.reference));
        let before = Before { last_hz: self.last_hz.clone(), nodes: self.nodes.clone() };
        let every_s = self.structure.every_s;
        let made = blocking(move || measured(&study, &reference, &before, every_s, &material)).await??;
        let last_hz = self.last_hz.iter().map(|&(number, before_hz)| {
            let mut modes = made.seen.iter().flat_map(|seen| &seen.modes);
            (number, modes.find(|mode| mode.number == number).map_or(before_hz, |mode| mode.frequency_hz))
        });
        let result = IntervalResult {
            structure: self.key.clone(),
            interval: due.number,
            start_s: from_us as f64 * 1e-6,
            end_s: to_us as f64 * 1e-6,
            windows: made.windows,
            last_hz: last_hz.collect(),
            seen: made.seen,
            next: due.next,
            node_events: node_events(&self.structure.name, &self.nodes, &made.nodes),
            nodes: made.nodes,
            warnings: made.warnings,
        };
        let payload = encoded(&result)?;
        let id = format!("{}-{}", self.key, due.number);
        let published = server.publish_behind(self.newest, names::results(&self.key), id, payload).await?;
        self.newest = published.ok_or_else(|| self.overtaken())?;
        self.last_hz.clone_from(&result.last_hz);
        self.nodes.clone_from(&result.nodes);
        (self.done, self.next) = (Some(due.number), due.next);
        Ok(result)
    }

    /// Judges all days, where one has come since the last time; what has become of alarms.
    pub(super) async fn judge(&mut self, server: &Server) -> Result<Vec<Event>, StreamError> {
        let day = |number: i64| ((number + 1) as f64 * self.structure.every_s / DAY_S).floor() as i64;
        let Some(day) = self.done.map(day).filter(|&day| self.state.day.is_none_or(|judged| day > judged)) else {
            return Ok(Vec::new());
        };
        let mut intervals: Vec<SeenInterval> = Vec::new();
        each(&self.streams.results, &names::results(&self.key), Start::Message(1), false, |message| {
            let result = serde_json::from_slice::<IntervalResult>(&message.payload);
            intervals.extend(result.ok().and_then(|result| result.seen));
            Ok(ControlFlow::Continue(()))
        })
        .await?;
        let (study, reference, settings) =
            (Arc::clone(&self.study), Arc::clone(&self.reference), self.structure.settings);
        let earlier: Earlier = match &self.state.watch {
            Value::Null => Earlier::default(),
            watch => serde_json::from_value(watch.clone()).map_err(|error| StreamError::Odd {
                what: format!("the state of {}", self.key),
                why: error.to_string(),
            })?,
        };
        let judge = move || judged(&study, &Results::of(&study), &reference, &intervals, &settings, earlier);
        let Judged { until_s, judgement, causes, events, .. } = blocking(judge).await?;
        let mut state = State {
            day: Some(day),
            alarms: self.state.alarms,
            watch: json!({"judged_until_s": until_s, "judgement": judgement, "causes": causes, "learned": judgement.learned}),
        };
        if !events.is_empty() {
            let alarms = Alarms { structure: self.key.clone(), day, events: events.clone() };
            let (subject, id) = (names::alarms(&self.key), format!("{}-alarms-{day}", self.key));
            let published = server.publish_behind(state.alarms, subject.clone(), id.clone(), encoded(&alarms)?).await?;
            state.alarms = match published {
                Some(sequence) => sequence,
                // A worker that was killed before it could say so has published the same.
                None => match newest(&self.streams.results, &subject).await? {
                    Some(last) if id_of(&last) == Some(id.as_str()) => last.sequence,
                    _ => return Err(self.overtaken()),
                },
            };
        }
        let value = Bytes::from(encoded(&state)?);
        self.revision = match server.states().await?.update(&self.key, value, self.revision).await {
            Ok(revision) => revision,
            Err(error) if matches!(error.kind(), UpdateErrorKind::WrongLastRevision) => return Err(self.overtaken()),
            Err(error) => return Err(StreamError::server(format!("the state of {}", self.key))(error.into())),
        };
        self.state = state;
        Ok(events)
    }

    fn overtaken(&self) -> StreamError {
        StreamError::Overtaken { structure: self.key.clone() }
    }
}

fn encoded(object: &impl Serialize) -> Result<Vec<u8>, StreamError> {
    serde_json::to_vec(object).map_err(|error| StreamError::server("a message")(error.into()))
}

/// Does what takes its time where it holds up nothing else.
async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, StreamError> {
    tokio::task::spawn_blocking(work).await.map_err(|error| StreamError::server("an interval")(error.into()))
}

/// What the interval before has left.
struct Before {
    last_hz: Vec<(usize, f64)>,
    nodes: Vec<NodeState>,
}

/// What was made of an interval.
struct Made {
    windows: usize,
    seen: Option<SeenInterval>,
    nodes: Vec<NodeState>,
    warnings: Vec<String>,
}

/// Puts an interval's windows into an archive of their own, and looks for the modes in it as a watch does.
fn measured(
    study: &Study,
    reference: &Identification,
    before: &Before,
    every_s: f64,
    material: &Material,
) -> Result<Made, StreamError> {
    let folder = tempfile::tempdir().map_err(StreamError::System)?;
    let mut archive = Archive::create_passing(folder.path())?;
    let (mut names, mut warnings, mut heartbeats) = (std::collections::BTreeSet::new(), Vec::new(), Vec::new());
    for message in &material.messages {
        if names::data_of(&message.subject).is_some_and(|(_, kind)| kind == DataKind::Heartbeat) {
            heartbeats.extend_from_slice(&message.payload);
            heartbeats.push(b'\n');
            continue;
        }
        let place = |why: String| format!("message {} of the stream is left out: {why}", message.sequence);
        match PackedWindow::decode(&message.payload) {
            Ok(window) => match archive.unpack(&window, HostTime(window.start_us))? {
                Ok(()) => drop(names.insert((window.name.node, window.name.boot, window.name.number))),
                Err(why) => warnings.push(place(why)),
            },
            Err(error) => warnings.push(place(error.to_string())),
        }
    }
    if material.ahead > 0 {
        let what =
            "are left out, whose time was more than 15 min ahead of the server's clock: is a gateway's clock wrong?";
        warnings.push(format!("{} messages {what}", material.ahead));
    }
    drop(archive);
    let file = folder.path().join(HEARTBEATS_FILE);
    std::fs::write(&file, heartbeats).map_err(|source| StreamError::File { file, source })?;
    let mut study = study.clone();
    study.folder = folder.path().to_owned();
    study.range = TimeRange { from_us: Some(material.from_us), to_us: Some(material.to_us), last: None };
    let now_s = material.to_us as f64 * 1e-6;
    let nodes = nodes(&study, &before.nodes, &NodeLimits::default(), now_s).unwrap_or_else(|why| {
        warnings.push(format!("how nodes are is not known: {why}"));
        before.nodes.clone()
    });
    let every = Intervals { every_s, from_s: Some(0.0) };
    let route = Route::Nodes(FleetOptions::default());
    let seen = match seen(&study, reference, &before.last_hz, every, route, &mut |_, _| {}) {
        Ok((seen, told)) => {
            warnings.extend(told);
            seen.into_iter().next()
        }
        Err(TrendError::Measure(MeasureError::Archive { source, .. })) if source.may_pass() => {
            return Err(StreamError::Archive(*source));
        }
        Err(error) => {
            warnings.push(error.to_string());
            None
        }
    };
    Ok(Made { windows: names.len(), seen, nodes, warnings })
}
