//! Structures that a fleet follows: what workers find of each in the bucket of structures, and how one is added.

use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::time::Duration;

use bytes::Bytes;
use serde::{Deserialize, Serialize};

use super::bundle::Bundle;
use super::error::StreamError;
use super::names;
use super::reading::{Start, each};
use super::server::{Address, Server, entry};
use crate::identify::Identification;
use crate::results::{MODES_FILE, REFERENCE_FILE, Results};
use crate::study::Study;
use crate::watch::Settings;

/// A structure, as it stands in the bucket.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Structure {
    /// Its name in words.
    pub(super) name: String,
    /// Latitude and longitude in degrees.
    #[serde(default)]
    pub(super) place_deg: Option<[f64; 2]>,
    /// Its nodes.
    pub(super) nodes: Vec<u16>,
    /// Length of an interval in s.
    pub(super) every_s: f64,
    /// When an alarm is raised.
    pub(super) settings: Settings,
}

impl Structure {
    /// The length of an interval in µs.
    pub(super) fn every_us(&self) -> i64 {
        ((self.every_s * 1e6) as i64).max(1)
    }
}

/// A study to add.
#[derive(Debug)]
pub struct ToAdd<'a> {
    /// The study.
    pub study: &'a Study,
    /// Length of an interval.
    pub every: Duration,
    /// When an alarm is raised.
    pub settings: Settings,
}

/// What was added.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Added {
    /// The structure, as subjects and keys name it.
    pub structure: String,
    /// Modes that are followed.
    pub modes: usize,
    /// Whether it had been added before: then the modes that are followed stay.
    pub is_known: bool,
}

/// Puts a structure's study where workers find it. One that is there already goes on with its modes and its intervals, and with what is new
/// in the study.
///
/// # Errors
/// When the study is not one live setup with modes, its intervals were of another length, or the server fails.
pub fn add(address: &Address, to_add: &ToAdd<'_>) -> Result<Added, StreamError> {
    let ToAdd { study, every, settings } = *to_add;
    let place = || study.folder.display().to_string();
    let unfit = |why: &str| StreamError::Unfit { study: place(), why: why.to_owned() };
    let [setup] = &study.setups[..] else {
        return Err(unfit("a fleet follows studies with one setup, whose sensors stay where they are"));
    };
    if !setup.live {
        return Err(unfit("its setup is a recording: a fleet follows what nodes send (`live = true`)"));
    }
    let structure = Structure {
        name: study.structure.name.clone(),
        place_deg: study.structure.place_deg,
        nodes: nodes_of(study),
        every_s: every.as_secs_f64(),
        settings,
    };
    let results = Results::of(study);
    let found: Option<Identification> = match results.read_json(REFERENCE_FILE, "watch")? {
        Some(reference) => Some(reference),
        None => results.read_json(MODES_FILE, "identify")?,
    };
    let found = found.filter(|found| !found.modes.is_empty());
    let found = found.ok_or_else(|| unfit("it has no modes to follow yet; `belfry identify` finds them"))?;
    let key = names::token(&structure.name);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(StreamError::System)?;
    runtime.block_on(async {
        let server = Server::connect(address).await?;
        let known = read(&server, &key).await?.map(|(structure, _)| structure);
        if let Some(known) = &known
            && (known.every_s != structure.every_s || known.name != structure.name)
        {
            return Err(StreamError::Unfit {
                study: place(),
                why: format!(
                    "{key} is there already, as \"{}\" with intervals of {} s; results of other intervals, or of another structure, do not go with its own",
                    known.name, known.every_s
                ),
            });
        }
        let earlier = if known.is_some() { study_of(&server, &key).await.ok() } else { None };
        let reference = match earlier.as_ref().and_then(Bundle::reference) {
            Some(reference) => reference.to_vec(),
            None => serde_json::to_vec(&found).map_err(|error| unfit(&error.to_string()))?,
        };
        let object = Bundle::of(study, reference)?.encode()?;
        let put = server.studies().await?.put(key.as_str(), &mut object.as_slice()).await;
        put.map_err(|error| StreamError::server(format!("the study of {key}"))(error.into()))?;
        // Who only looks on then finds them, and makes none.
        server.streams_of(&key).await?;
        // Last: workers look for the study when they see this.
        let value = serde_json::to_vec(&structure).map_err(|error| unfit(&error.to_string()))?;
        let put = server.structures.put(&key, Bytes::from(value)).await;
        put.map_err(|error| StreamError::server(format!("the entry of {key}"))(error.into()))?;
        Ok(Added { structure: key.clone(), modes: found.modes.len(), is_known: known.is_some() })
    })
}

/// The nodes of a study, in their order.
pub(super) fn nodes_of(study: &Study) -> Vec<u16> {
    let sensors = study.setups.iter().flat_map(|setup| &setup.sensors);
    sensors.map(|sensor| sensor.node).collect::<BTreeSet<u16>>().into_iter().collect()
}

/// A structure, and the revision of its entry; `None` where it was not added.
pub(super) async fn read(server: &Server, key: &str) -> Result<Option<(Structure, u64)>, StreamError> {
    let entry = entry(&server.structures, key, "entry").await?;
    let Some(entry) = entry.filter(|entry| !entry.value.is_empty()) else { return Ok(None) };
    Ok(Some((StreamError::read(format!("the entry of {key}"), &entry.value)?, entry.revision)))
}

/// The study of a structure.
pub(super) async fn study_of(server: &Server, key: &str) -> Result<Bundle, StreamError> {
    let what = || format!("the study of {key}");
    let info = server.studies().await?.info(key).await;
    let info = info.map_err(|error| StreamError::server(what())(error.into()))?;
    // Not by `get`, which reads by a consumer on one server: it may be a dead one.
    let (stream, chunks) = server.chunks(&info.nuid).await?;
    let mut bytes = Vec::new();
    each(&stream, &chunks, Start::Message(1), false, |chunk| {
        bytes.extend_from_slice(&chunk.payload);
        Ok(ControlFlow::Continue(()))
    })
    .await?;
    if bytes.len() != info.size {
        // It is being put anew.
        return Err(StreamError::Gone);
    }
    Bundle::decode(&bytes)
}
