//! What stands on the server of all structures, and of one: for a page, which reads and changes nothing.

use std::collections::BTreeMap;
use std::ops::ControlFlow;

use serde::Serialize;
use serde_json::Value;
use tokio::task::JoinSet;

use super::error::StreamError;
use super::follow::{IntervalResult, State};
use super::names;
use super::reading::each;
use super::server::{Address, Server, newest};
use super::session::{alive, keys};
use super::structure::{self, Structure};

/// Structures that are asked for at the same time.
const AT_ONCE: usize = 32;
/// Intervals that a structure's page has: two weeks of hours.
const NEWEST_INTERVALS: usize = 336;
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
}

/// How a structure stands; the first that is so.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RowState {
    /// An alarm is open.
    Alarm,
    /// Nothing has come of it for a while.
    Silent,
    /// It has changed for good.
    Changed,
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
        let mut waiting = keys(&self.0.structures().await?).await?.into_iter();
        let (mut asked, mut structures) = (JoinSet::new(), Vec::new());
        loop {
            while asked.len() < AT_ONCE
                && let Some(key) = waiting.next()
            {
                let server = self.0.clone();
                asked.spawn(async move { row(&server, &key, now_s).await.map(|found| found.map(|(row, ..)| row)) });
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
        let Some((row, structure, judgement)) = row(server, key, now_s).await? else { return Ok(None) };
        let mut nodes_seen_s = BTreeMap::new();
        for &node in &structure.nodes {
            let seen = seen_s(server, &[names::windows(key, node), names::heartbeats(key, node)]).await?;
            nodes_seen_s.insert(node, seen);
        }
        let mut intervals = std::collections::VecDeque::with_capacity(NEWEST_INTERVALS);
        each(&server.results, &names::results(key), 1, false, |message| {
            if intervals.len() == NEWEST_INTERVALS {
                intervals.pop_front();
            }
            intervals.extend(serde_json::from_slice::<IntervalResult>(&message.payload));
            Ok(ControlFlow::Continue(()))
        })
        .await?;
        Ok(Some(Detail { row, nodes_seen_s, judgement, intervals: intervals.into() }))
    }
}

/// A structure's row, its entry and what its days say.
async fn row(server: &Server, key: &str, now_s: f64) -> Result<Option<(Row, Structure, Value)>, StreamError> {
    let Some((structure, _)) = structure::read(server, key).await? else { return Ok(None) };
    let last = newest(&server.results, &names::results(key)).await?;
    let last = last.and_then(|last| serde_json::from_slice::<IntervalResult>(&last.payload).ok());
    let entry = server.states().await?.entry(key).await;
    let entry = entry.map_err(|error| StreamError::server(format!("the state of {key}"))(error.into()))?;
    let judgement = entry.and_then(|entry| serde_json::from_slice::<State>(&entry.value).ok());
    let judgement = judgement.map_or(Value::Null, |mut state| state.watch["judgement"].take());
    let last_data_s = seen_s(server, &[names::data(key)]).await?;
    let alarms = judgement["alarms"].as_array().cloned().unwrap_or_default();
    let is_there = |state: &str| alarms.iter().any(|alarm| alarm["state"] == state);
    let state = match (last_data_s, &last) {
        _ if is_there("open") => RowState::Alarm,
        (Some(seen_s), _) if now_s - seen_s > SILENT_AFTER_S => RowState::Silent,
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
    };
    Ok(Some((row, structure, judgement)))
}

/// When the newest message of these subjects came, in s of Unix time.
async fn seen_s(server: &Server, subjects: &[String]) -> Result<Option<f64>, StreamError> {
    let mut seen_s = None;
    for subject in subjects {
        let last = newest(&server.data, subject).await?;
        let time_s = last.map(|last| last.time.unix_timestamp_nanos() as f64 * 1e-9);
        seen_s = [seen_s, time_s].into_iter().flatten().reduce(f64::max);
    }
    Ok(seen_s)
}
