//! The page of a fleet: a list and a map of its structures, and a page of each. What stands on the NATS server flows in; the page asks for it
//! again every few seconds. It changes nothing.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::{Query, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::{StatusCode, Uri};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router, middleware};
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::sync::{Mutex, watch};

use super::gate::Gate;
use super::guard::guard;
use super::routes::{Refused, asset, page_of};
use super::{ServeError, listen, runtime};
use crate::archive::now_s;
use crate::jetstream::{Address, Detail, FleetReader, StreamError};
use crate::page::served_fleet;

/// The server is looked at again after this time, or longer where a look takes long.
const LOOK_EVERY: Duration = Duration::from_secs(2);
/// Looks take a tenth of the time at most.
const BETWEEN_LOOKS: u32 = 9;

/// What the requests share.
struct Fleet {
    address: Address,
    /// A connection for pages of structures; none before the first, or where it has failed.
    reader: Mutex<Option<FleetReader>>,
    /// The overview, or why there is none.
    seen: watch::Receiver<Arc<Value>>,
}

/// Serves the overview of a fleet until `stop` resolves; `on_ready` gets the address that opens the page.
///
/// # Errors
/// When the port cannot be listened on, or the server breaks.
pub fn serve_fleet(
    address: &Address,
    port: u16,
    on_ready: impl FnOnce(&str),
    stop: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    let runtime = runtime()?;
    let served = runtime.block_on(async {
        let (listener, gate) = listen(port).await?;
        on_ready(&gate.opening_address());
        let (tell, seen) = watch::channel(Arc::new(json!({ "error": "connecting" })));
        let looking = tokio::spawn(look(address.clone(), tell));
        let fleet = Arc::new(Fleet { address: address.clone(), reader: Mutex::default(), seen });
        let served = tokio::select! {
            served = axum::serve(listener, router(fleet, gate)) => served,
            () = stop => Ok(()),
        };
        looking.abort();
        served.map_err(ServeError::Stopped)
    });
    runtime.shutdown_background();
    served
}

fn router(fleet: Arc<Fleet>, gate: Arc<Gate>) -> Router {
    Router::new()
        .route("/", get(page))
        .route("/assets/{*name}", get(asset))
        .route("/data", get(data))
        .route("/structure", get(structure))
        .fallback(|_: Uri| async { Refused::new(StatusCode::NOT_FOUND, "there is nothing at this address") })
        .layer(middleware::from_fn_with_state(gate, guard))
        .with_state(fleet)
}

/// Looks again and again, and says what it sees.
async fn look(address: Address, tell: watch::Sender<Arc<Value>>) {
    let mut reader: Option<FleetReader> = None;
    loop {
        let start = Instant::now();
        let seen = async {
            let connected = match reader.take() {
                Some(reader) => reader,
                None => FleetReader::connect(&address).await?,
            };
            let overview = connected.overview(now_s()).await?;
            // A connection that has failed is made anew.
            reader = Some(connected);
            Ok::<_, StreamError>(overview)
        };
        let seen = match seen.await {
            Ok(overview) => serde_json::to_value(overview).unwrap_or_default(),
            // The last list stays on the page.
            Err(error) => {
                let mut before = (**tell.borrow()).clone();
                before["error"] = error.to_string().into();
                before
            }
        };
        tell.send_replace(Arc::new(seen));
        tokio::time::sleep(LOOK_EVERY.max(BETWEEN_LOOKS * start.elapsed())).await;
    }
}

async fn page() -> Response {
    page_of(|nonce| Html(served_fleet(nonce)))
}

async fn data(State(fleet): State<Arc<Fleet>>) -> Response {
    let seen = Arc::clone(&fleet.seen.borrow());
    ([(CONTENT_TYPE, "application/json")], seen.to_string()).into_response()
}

#[derive(Debug, Deserialize)]
struct Asked {
    key: String,
}

async fn structure(State(fleet): State<Arc<Fleet>>, Query(asked): Query<Asked>) -> Result<Json<Detail>, Refused> {
    let failed = |error: StreamError| Refused::new(StatusCode::BAD_GATEWAY, error.to_string());
    let kept = fleet.reader.lock().await.clone();
    let reader = match kept {
        Some(reader) => reader,
        None => FleetReader::connect(&fleet.address).await.map_err(failed)?,
    };
    let detail = reader.detail(&asked.key, now_s()).await;
    *fleet.reader.lock().await = detail.is_ok().then_some(reader);
    let detail = detail.map_err(failed)?;
    let unknown = || Refused::new(StatusCode::NOT_FOUND, format!("the fleet has no structure \"{}\"", asked.key));
    detail.map(Json).ok_or_else(unknown)
}
