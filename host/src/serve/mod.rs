//! The page on the user's own machine: what a study shows, live, and the steps that can be taken in it.
//!
//! A study's folder flows in; a server on 127.0.0.1 flows out, that gives the page of [`crate::page`], its data, and runs the commands of
//! `belfry` that the page asks for. What the page does is what the command does, because it is the command: `job` starts this program
//! again, so that a step can be stopped at any point and leaves results whole or as they were. `guard` keeps everyone else out, `shared`
//! holds what all requests share, `samples` cuts pieces out of recordings, `routes` answers.

mod fleet;
mod gate;
mod guard;
mod job;
mod routes;
mod samples;
mod shared;

use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use axum::serve::{Listener, ListenerExt};
use thiserror::Error;
use tokio::net::TcpListener;
use tokio::runtime::Runtime;

use crate::study::Study;
pub use fleet::serve_fleet;
use gate::Gate;
pub use job::Stepper;
use shared::Shared;

/// How long what runs may take to end in good order.
const GRACE: Duration = Duration::from_secs(3);

/// Why a page cannot be served.
#[derive(Debug, Error)]
pub enum ServeError {
    /// The port is taken, or not allowed.
    #[error("cannot listen on port {port} of this machine; name another with --port, or leave it out")]
    Listen {
        /// The port.
        port: u16,
        /// What the system said.
        source: io::Error,
    },
    /// The server broke.
    #[error("the server stopped")]
    Stopped(#[source] io::Error),
}

/// Serves a study until `stop` resolves; `on_ready` gets the address that opens the page. Port 0 takes a free one.
///
/// # Errors
/// When the port cannot be listened on, or the server breaks.
pub fn serve(
    study: &Study,
    stepper: Stepper,
    port: u16,
    on_ready: impl FnOnce(&str),
    stop: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    let runtime = runtime()?;
    let served = runtime.block_on(async {
        let (listener, gate) = listen(port).await?;
        let shared = Arc::new(Shared::new(study.folder.clone(), stepper));
        on_ready(&gate.opening_address());
        let watcher = tokio::spawn(shared::watch_files(Arc::clone(&shared)));
        let (ended, mut is_ended) = (Arc::clone(&shared), shared.ended());
        let stopped = async move {
            stop.await;
            ended.cancel();
            // Streams of events would wait for ever.
            ended.end();
        };
        let serving = axum::serve(listener, routes::router(Arc::clone(&shared), gate)).with_graceful_shutdown(stopped);
        // Whoever has sent half a request may never send the rest.
        let late = async {
            let _ = is_ended.wait_for(|ended| *ended).await;
            tokio::time::sleep(GRACE).await;
        };
        let served = tokio::select! {
            served = serving => served,
            () = late => Ok(()),
        };
        watcher.abort();
        shared.job_ended().await;
        served.map_err(ServeError::Stopped)
    });
    runtime.shutdown_timeout(GRACE);
    served
}

/// The threads that answer.
fn runtime() -> Result<Runtime, ServeError> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    runtime.map_err(ServeError::Stopped)
}

/// Listens on a port of this machine, or on a free one for 0; what lets windows in there.
async fn listen(port: u16) -> Result<(impl Listener<Addr = SocketAddr>, Arc<Gate>), ServeError> {
    let failed = |source| ServeError::Listen { port, source };
    let listener = TcpListener::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, port))).await.map_err(failed)?;
    let port = listener.local_addr().map_err(failed)?.port();
    // The last part of an answer would wait 40 ms for the browser to acknowledge the others.
    let listener = listener.tap_io(|stream| {
        let _ = stream.set_nodelay(true);
    });
    Ok((listener, Arc::new(Gate::new(port))))
}
