//! What stands on the server of all structures, and of one: for a page, which reads and changes nothing.

use std::collections::{BTreeMap, VecDeque};
use std::ops::ControlFlow;
use std::time::Duration;

use async_nats::datetime::DateTime;
use async_nats::jetstream::stream::Stream;
use serde::Serialize;
use serde_json::Value;
use tokio::task::JoinSet;

use super::error::StreamError;
use super::follow::{IntervalResult, State};
use super::names;
use super::reading::{Start, each};
use super::server::{Address, PartStreams, Server, entry, newest};
use super::session::{alive, keys};
use super::structure::{self, Structure};
use crate::watch::OpenProblem;

/// Structures that are asked for at the same time.
const AT_ONCE: usize = 32;
/// Intervals that a structure's page has: those of the two weeks before its newest, but so many at most.
const NEWEST_INTERVALS: usize = 1344;
const NEWEST: Duration = Duration::from_secs(14 * 86_400);
/// A structure is silent when nothing has come of it for so long, in s: windows are at most 14 minutes apart, heartbeats two.
const SILENT_AFTER_S: f64 = 1200.0;

/// All structures.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Overview {
    /// When this was so, in s of Unix time.
    pub at_s: f64,
    /// Workers that are alive.
    pub workers: usize,
    /// The structures, by name.
    pub structures: Vec<Row>,
}

/// A structure in the overview.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// The structure, as subjects name it.
    pub key: String,
    /// Its name in words.
    pub name: String,
    /// Latitude and longitude in degrees, where its study says them.
    pub place_deg: Option<[f64; 2]>,
    /// Its nodes.
    pub nodes: usize,
    /// Length of an interval in s.
    pub every_s: f64,
    /// How it stands.
    pub state: RowState,
    /// When something last came of it, in s of Unix time.
    pub last_data_s: Option<f64>,
    /// The end of the newest interval that has a result.
    pub last_result_s: Option<f64>,
    /// Modes that this shows.
    pub modes: usize,
    /// Its alarms as `belfry watch` keeps them.
    pub alarms: Vec<Value>,
    /// What is wrong with its nodes, as words.
    pub node_problems: BTreeMap<u16, Vec<String>>,
    /// Why it cannot be read.
    pub why: Option<String>,
}

impl Row {
    fn unreadable(key: String, why: String) -> Self {
        Self {
            name: key.clone(),
            key,
            place_deg: None,
            nodes: 0,
            every_s: 0.0,
            state: RowState::Unreadable,
            last_data_s: None,
            last_result_s: None,
            modes: 0,
            alarms: Vec::new(),
            node_problems: BTreeMap::new(),
            why: Some(why),
        }
    }
}

/// How a structure stands; the first that is so.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RowState {
    /// An alarm is open.
    Alarm,
    /// Nothing has come of it for a while.
    Silent,
    /// Something is wrong with a node.
    NodeTrouble,
    /// It has changed for good.
    Changed,
    /// What stands on the server of it cannot be read.
    Unreadable,
    /// It has no result yet.
    Waiting,
    /// There are too few days to judge it.
    Learning,
    /// Nothing says that it has changed.
    Unchanged,
}

/// A structure for its page.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Detail {
    /// As in the overview.
    #[serde(flatten)]
    pub row: Row,
    /// When something last came of each node, in s of Unix time.
    pub nodes_seen_s: BTreeMap<u16, Option<f64>>,
    /// What its days say, as `watch.json` has it; null before the first.
    pub judgement: Value,
    /// The newest intervals, oldest first.
    pub intervals: Vec<IntervalResult>,
}

/// A connection for pages.
#[derive(Clone)]
pub struct Reader(Server);

impl Reader {
    /// Connects.
    ///
    /// # Errors
    /// When the server does not answer, or refuses.
    pub async fn connect(address: &Address) -> Result<Self, StreamError> {
        Server::connect(address).await.map(Self)
    }

    /// All structures at `now_s`.
    ///
    /// # Errors
    /// When the server fails.
    pub async fn overview(&self, now_s: f64) -> Result<Overview, StreamError> {
        let workers = alive(&self.0.workers().await?).await?.len();
        let mut waiting = keys(&self.0.structures).await?.into_iter();
        let (mut asked, mut structures) = (JoinSet::new(), Vec::new());
        loop {
            while asked.len() < AT_ONCE
                && let Some(key) = waiting.next()
            {
                let server = self.0.clone();
                asked.spawn(async move {
                    match row(&server, &key, now_s).await {
                        Ok(found) => Ok(found.map(|found| found.row)),
                        // One that something else has written hides none of the others.
                        Err(StreamError::Odd { what, why }) => Ok(Some(Row::unreadable(key, format!("{what}: {why}")))),
                        Err(error) => Err(error),
                    }
                });
            }
            let Some(found) = asked.join_next().await else { break };
            let found = found.map_err(|error| StreamError::server("a structure")(error.into()))?;
            structures.extend(found?);
        }
        structures.sort_by(|a, b| alphanumeric_sort::compare_str(&a.name, &b.name).then_with(|| a.key.cmp(&b.key)));
        Ok(Overview { at_s: now_s, workers, structures })
    }

    /// One structure; `None` where it was not added.
    ///
    /// # Errors
    /// When the server fails.
    pub async fn detail(&self, key: &str, now_s: f64) -> Result<Option<Detail>, StreamError> {
        let server = &self.0;
        // What is asked for may be anything.
        if names::token(key) != key {
            return Ok(None);
        }
        let Some(found) = row(server, key, now_s).await? else { return Ok(None) };
        let mut nodes_seen_s = BTreeMap::new();
        for &node in &found.structure.nodes {
            let seen = seen_s(&found.streams.data, &[names::windows(key, node), names::heartbeats(key, node)]).await?;
            nodes_seen_s.insert(node, seen);
        }
        let mut intervals = VecDeque::new();
        // After a year there are some MB of them.
        if let Some(newest) = found.newest_result {
            each(&found.streams.results, &names::results(key), Start::Time(newest - NEWEST), false, |message| {
                if intervals.len() == NEWEST_INTERVALS {
                    intervals.pop_front();
                }
                intervals.extend(serde_json::from_slice::<IntervalResult>(&message.payload));
                Ok(ControlFlow::Continue(()))
            })
            .await?;
        }
        let Found { row, judgement, .. } = found;
        Ok(Some(Detail { row, nodes_seen_s, judgement, intervals: intervals.into() }))
    }
}

/// What a row is made of.
struct Found {
    row: Row,
    /// Its entry.
    structure: Structure,
    streams: PartStreams,
    /// What its days say.
    judgement: Value,
    /// When its newest result came.
    newest_result: Option<DateTime>,
}

/// A structure's row; `None` where it was not added.
async fn row(server: &Server, key: &str, now_s: f64) -> Result<Option<Found>, StreamError> {
    let Some((structure, _)) = structure::read(server, key).await? else { return Ok(None) };
    let streams = server.streams_of(key).await?;
    let last = newest(&streams.results, &names::results(key)).await?;
    let newest_result = last.as_ref().map(|last| last.time);
    let last = last.and_then(|last| serde_json::from_slice::<IntervalResult>(&last.payload).ok());
    let entry = entry(&server.states().await?, key, "state").await?;
    let judgement = entry.and_then(|entry| serde_json::from_slice::<State>(&entry.value).ok());
    let judgement = judgement.map_or(Value::Null, |mut state| state.watch["judgement"].take());
    let last_data_s = seen_s(&streams.data, &[names::data(key)]).await?;
    let alarms = judgement["alarms"].as_array().cloned().unwrap_or_default();
    let troubled = last.iter().flat_map(|last| &last.nodes).filter(|node| !node.problems.is_empty());
    let words = |one: &OpenProblem| format!("{}: {}", one.problem, one.says);
    let node_problems: BTreeMap<u16, Vec<String>> =
        troubled.map(|node| (node.node, node.problems.iter().map(words).collect())).collect();
    let is_there = |state: &str| alarms.iter().any(|alarm| alarm["state"] == state);
    let state = match (last_data_s, &last) {
        _ if is_there("open") => RowState::Alarm,
        (Some(seen_s), _) if now_s - seen_s > SILENT_AFTER_S => RowState::Silent,
        _ if !node_problems.is_empty() => RowState::NodeTrouble,
        _ if is_there("lasting") => RowState::Changed,
        (_, None) => RowState::Waiting,
        _ if judgement["standing"] == "unchanged" => RowState::Unchanged,
        _ => RowState::Learning,
    };
    let row = Row {
        key: key.to_owned(),
        name: structure.name.clone(),
        place_deg: structure.place_deg,
        nodes: structure.nodes.len(),
        every_s: structure.every_s,
        state,
        last_data_s,
        last_result_s: last.as_ref().map(|last| last.end_s),
        modes: last.and_then(|last| last.seen).map_or(0, |seen| seen.modes.len()),
        alarms,
        node_problems,
        why: None,
    };
    Ok(Some(Found { row, structure, streams, judgement, newest_result }))
}

/// When the newest message of these subjects came, in s of Unix time.
async fn seen_s(data: &Stream, subjects: &[String]) -> Result<Option<f64>, StreamError> {
    let mut seen_s = None;
    for subject in subjects {
        let last = newest(data, subject).await?;
        let time_s = last.map(|last| last.time.unix_timestamp_nanos() as f64 * 1e-9);
        seen_s = [seen_s, time_s].into_iter().flatten().reduce(f64::max);
    }
    Ok(seen_s)
}
