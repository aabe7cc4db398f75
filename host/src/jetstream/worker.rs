//! A worker: sessions with the server one after the other, until it is stopped.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;

use super::error::StreamError;
use super::follow::IntervalResult;
use super::server::Address;
use super::session::session;
use crate::patience::Patience;
use crate::story::Event;

/// Time between looks whether it is to stop.
const LOOK: Duration = Duration::from_millis(200);

/// What a worker does besides.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct WorkOptions {
    /// The folder that results go to as Parquet as well.
    pub parquet: Option<PathBuf>,
}

/// What happens to a worker.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "lowercase")]
pub enum WorkNews {
    /// It has a share of the structures.
    Share {
        /// Structures that are its own.
        own: usize,
        /// Structures of all.
        all: usize,
        /// Workers that are alive.
        workers: usize,
    },
    /// An interval has a result.
    Result {
        /// It.
        #[serde(flatten)]
        result: Box<IntervalResult>,
        /// Seconds from the window that ended the interval to the result.
        after_s: f64,
    },
    /// An alarm is raised, lasts or is withdrawn.
    Alarm {
        /// It.
        alarm: Box<Event>,
    },
    /// The server is away, or refuses.
    Waiting {
        /// Why.
        reason: String,
    },
    /// A file of results cannot be written; the stream has them, and it is tried again with the next result.
    Unwritten {
        /// Why.
        reason: String,
    },
    /// It can go on.
    Back {
        /// How long it could not, in s.
        after_s: f64,
    },
    /// A structure cannot be followed until it is added anew.
    Refused {
        /// The structure.
        structure: String,
        /// Why.
        reason: String,
    },
}

/// Works until it is to stop: takes its share of the structures, makes modes of each interval that is over, and publishes them.
///
/// # Errors
/// Where nothing can come of trying again: the credentials are none, or the system gives no threads.
pub fn work(
    address: &Address,
    options: &WorkOptions,
    stop: &AtomicBool,
    tell: &mut dyn FnMut(WorkNews),
) -> Result<(), StreamError> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let runtime = runtime.map_err(StreamError::System)?;
    let mut random = [0; 8];
    getrandom::fill(&mut random).map_err(|error| StreamError::System(error.into()))?;
    let me = format!("{:016x}", u64::from_ne_bytes(random));
    let tables = options.parquet.clone().map(Arc::new);
    let (start, mut patience) = (Instant::now(), Patience::with_server());
    let outcome = runtime.block_on(async {
        while !stop.load(Ordering::Relaxed) {
            let on_ready = |patience: &mut Patience| patience.worked(start.elapsed());
            let Err(error) = session(address, tables.as_ref(), &me, stop, &mut || on_ready(&mut patience), tell).await
            else {
                break;
            };
            if !error.may_pass() {
                return Err(error);
            }
            if patience.failed(start.elapsed()) {
                tell(WorkNews::Waiting { reason: error.to_string() });
            }
            while patience.is_waiting(start.elapsed()) && !stop.load(Ordering::Relaxed) {
                tokio::time::sleep(LOOK).await;
            }
        }
        Ok(())
    });
    // An interval that is being measured is measured anew by whoever takes it over.
    runtime.shutdown_background();
    outcome
}
