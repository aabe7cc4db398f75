//! What the server answers.

use std::convert::Infallible;
use std::sync::{Arc, PoisonError};

use axum::extract::{DefaultBodyLimit, Path, Query, State};
use axum::http::header::{CONTENT_SECURITY_POLICY, CONTENT_TYPE};
use axum::http::{StatusCode, Uri};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router, middleware};
use rand::RngExt;
use rand::distr::Alphanumeric;
use serde::{Deserialize, Serialize};
use serde_json::json;
use tokio_stream::wrappers::WatchStream;
use tokio_stream::{Stream, StreamExt};

use super::gate::Gate;
use super::guard::guard;
use super::job::JobStatus;
use super::samples::{Loaded, Samples, SamplesError};
use super::shared::{RunError, Shared, look};
use crate::files::FolderLock;
use crate::model::effect::Effect;
use crate::page::{Tried, assets, served};
use crate::story::StoryError;
use crate::study::edit::set_mode_choice;
use crate::study::{Study, StudyError};

/// Bytes of a request's body at most.
const MOST_BODY: usize = 1 << 16;
/// Letters of the name of scripts that may run.
const NONCE_LETTERS: usize = 24;
/// Points of a piece of a recording, where the page does not say.
const USUAL_BINS: usize = 1000;

/// All addresses, guarded.
pub(super) fn router(shared: Arc<Shared>, gate: Arc<Gate>) -> Router {
    Router::new()
        .route("/", get(page))
        .route("/assets/{*name}", get(asset))
        .route("/data", get(data))
        .route("/events", get(events))
        .route("/run", post(run))
        .route("/cancel", post(cancel))
        .route("/picks", post(picks))
        .route("/try", get(tried))
        .route("/samples", get(samples))
        .fallback(|| async { Refused::new(StatusCode::NOT_FOUND, "there is nothing at this address") })
        .layer(DefaultBodyLimit::max(MOST_BODY))
        .layer(middleware::from_fn_with_state(gate, guard))
        .with_state(shared)
}

/// A request that was refused, and why, in a sentence.
#[derive(Debug)]
pub(super) struct Refused {
    status: StatusCode,
    reason: String,
}

impl Refused {
    pub(super) fn new(status: StatusCode, reason: impl Into<String>) -> Self {
        Self { status, reason: reason.into() }
    }

    #[cfg(test)]
    pub(super) fn status(&self) -> StatusCode {
        self.status
    }

    /// What cannot be done as the study stands.
    fn conflict(reason: impl ToString) -> Self {
        Self::new(StatusCode::CONFLICT, reason.to_string())
    }
}

impl IntoResponse for Refused {
    fn into_response(self) -> Response {
        (self.status, Json(json!({ "error": self.reason }))).into_response()
    }
}

impl From<StoryError> for Refused {
    fn from(error: StoryError) -> Self {
        Self::conflict(error)
    }
}

impl From<StudyError> for Refused {
    fn from(error: StudyError) -> Self {
        Self::conflict(error)
    }
}

impl From<SamplesError> for Refused {
    fn from(error: SamplesError) -> Self {
        Self::conflict(error)
    }
}

type Answer<T> = Result<T, Refused>;

/// Runs what reads files or computes beside the threads that answer.
async fn beside<T: Send + 'static>(work: impl FnOnce() -> Answer<T> + Send + 'static) -> Answer<T> {
    let broken = |_| Refused::new(StatusCode::INTERNAL_SERVER_ERROR, "this broke off; the terminal says why");
    tokio::task::spawn_blocking(work).await.map_err(broken)?
}

/// A page of ours, in which no other scripts run than those that it names.
pub(super) fn page_of(page: impl FnOnce(&str) -> Html<String>) -> Response {
    let nonce: String = rand::rng().sample_iter(Alphanumeric).take(NONCE_LETTERS).map(char::from).collect();
    let policy = format!(
        "default-src 'none'; script-src 'self' 'nonce-{nonce}'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    );
    ([(CONTENT_SECURITY_POLICY, policy)], page(&nonce)).into_response()
}

async fn page(State(shared): State<Arc<Shared>>) -> Answer<Response> {
    // Where study.toml cannot be read, the page itself says why, and goes on when it can.
    let name = beside(move || Ok(Study::load(shared.folder()).map(|study| study.structure.name))).await?;
    let title = name.unwrap_or_else(|_| "Belfry".to_owned());
    Ok(page_of(|nonce| Html(served(&title, nonce))))
}

pub(super) async fn asset(Path(_): Path<String>, uri: Uri) -> Answer<Response> {
    let asset = assets().into_iter().find(|asset| asset.path == uri.path());
    let asset = asset.ok_or_else(|| Refused::new(StatusCode::NOT_FOUND, "there is no such file"))?;
    Ok(([(CONTENT_TYPE, asset.media_type)], asset.text).into_response())
}

async fn data(State(shared): State<Arc<Shared>>) -> Answer<Response> {
    let text = beside(move || Ok(shared.data()?)).await?;
    Ok(([(CONTENT_TYPE, "application/json")], text.as_str().to_owned()).into_response())
}

async fn events(State(shared): State<Arc<Shared>>) -> Sse<impl Stream<Item = Result<Event, Infallible>>> {
    let ended =
        WatchStream::new(shared.ended()).map(|ended| if ended { None } else { Some(Event::default().comment("")) });
    let news = WatchStream::new(shared.news()).map(|news| Some(Event::default().json_data(news).unwrap_or_default()));
    // Ends with the server, which waits for every answer.
    let stream = news.merge(ended).map_while(|event| event.map(Ok));
    Sse::new(stream).keep_alive(KeepAlive::default())
}

#[derive(Debug, Deserialize)]
struct RunRequest {
    command: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Started {
    job: JobStatus,
}

async fn run(
    State(shared): State<Arc<Shared>>,
    Json(request): Json<RunRequest>,
) -> Answer<(StatusCode, Json<Started>)> {
    match shared.run(&request.command) {
        Ok(job) => Ok((StatusCode::ACCEPTED, Json(Started { job }))),
        Err(RunError::Refused(reason)) => Err(Refused::new(StatusCode::BAD_REQUEST, reason)),
        Err(RunError::Busy(command)) => Err(Refused::conflict(format!("`{command}` is still running"))),
        Err(RunError::Start(error)) => {
            Err(Refused::new(StatusCode::INTERNAL_SERVER_ERROR, format!("the command does not start: {error}")))
        }
    }
}

async fn cancel(State(shared): State<Arc<Shared>>) -> StatusCode {
    shared.cancel();
    StatusCode::NO_CONTENT
}

/// Frequencies that the user has clicked.
#[derive(Debug, Deserialize)]
struct Picks {
    #[serde(default)]
    add_hz: Vec<f64>,
    #[serde(default)]
    drop_hz: Vec<f64>,
    /// Bands of modes: a frequency, and from where to where it is fitted, or nothing.
    #[serde(default)]
    bands: Vec<ModeBand>,
}

/// The band of the mode at a frequency; none, where it is chosen from the data.
#[derive(Debug, Deserialize)]
struct ModeBand {
    hz: f64,
    band_hz: Option<[f64; 2]>,
}

async fn picks(State(shared): State<Arc<Shared>>, Json(picks): Json<Picks>) -> Answer<StatusCode> {
    let at = Arc::clone(&shared);
    let write = move || {
        let shared = at;
        let _editing = shared.editing.lock().unwrap_or_else(PoisonError::into_inner);
        if shared.is_busy() {
            return Err(Refused::conflict("a command is running; choose modes when it is done"));
        }
        // A command in a terminal may be writing there.
        let lock = FolderLock::at_once(shared.folder()).map_err(|error| Refused::conflict(error.to_string()))?;
        let Some(_lock) = lock else {
            return Err(Refused::conflict(
                "a command in a terminal is writing into this study; choose modes when it is done",
            ));
        };
        let mut choice = Study::load(shared.folder())?.analysis.modes;
        for hz in &picks.drop_hz {
            choice.drop(*hz).map_err(Refused::conflict)?;
        }
        picks.add_hz.iter().for_each(|hz| choice.add(*hz));
        for &ModeBand { hz, band_hz } in &picks.bands {
            choice.fit_to(hz, band_hz).map_err(Refused::conflict)?;
        }
        Ok(set_mode_choice(shared.folder(), &choice)?)
    };
    beside(write).await?;
    // All windows see it at once.
    look(&shared).await;
    Ok(StatusCode::NO_CONTENT)
}

/// `effect=...&effect=...`: a name that comes several times, which `Query` does not read.
async fn tried(State(shared): State<Arc<Shared>>, Query(pairs): Query<Vec<(String, String)>>) -> Answer<Json<Tried>> {
    let named = pairs.iter().filter(|(name, _)| name == "effect");
    let effects: Result<Vec<Effect>, _> = named.map(|(_, word)| word.parse()).collect();
    let effects = effects.map_err(|error| Refused::new(StatusCode::BAD_REQUEST, error.to_string()))?;
    Ok(Json(beside(move || Ok(Tried::of(&*shared.case()?, &effects)?)).await?))
}

#[derive(Debug, Deserialize)]
struct SamplesRequest {
    setup: String,
    channel: String,
    from_s: f64,
    to_s: f64,
    bins: Option<usize>,
}

async fn samples(State(shared): State<Arc<Shared>>, Query(request): Query<SamplesRequest>) -> Answer<Json<Samples>> {
    let piece = move || {
        let SamplesRequest { setup, channel, from_s, to_s, bins } = request;
        // Held while a recording is read, so that it is read once.
        let mut loaded = shared.loaded.lock().unwrap_or_else(PoisonError::into_inner);
        let study = Study::load(shared.folder())?;
        let recording = Loaded::of(&mut loaded, &study, shared.folder(), &setup)?;
        drop(loaded);
        Ok(recording.samples(&channel, from_s, to_s, bins.unwrap_or(USUAL_BINS))?)
    };
    Ok(Json(beside(piece).await?))
}
