//! A gateway: what a study's archive has goes into the stream, in the order of the archive, each window once.
//!
//! It reads the archive as any other program does, so that nothing waits for it: nodes are acknowledged when a window is on this disk. One window
//! is on its way at a time. So the stream's newest message of each node says how far it came, whatever ended it, and however long ago.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use async_nats::jetstream::message::StreamMessage;

use super::error::StreamError;
use super::heartbeats;
use super::names::{self, TIME_HEADER};
use super::position::Position;
use super::server::{Address, Outgoing, Server, id_of, newest};
use super::structure::nodes_of;
use crate::archive::Archive;
use crate::patience::Patience;
use crate::study::Study;

/// Windows that are read at a time, and after which the position is kept.
const AT_ONCE: usize = 64;
/// Time between looks at an archive that has nothing new.
const LOOK: Duration = Duration::from_millis(500);
/// How long a gateway that is to stop goes on with what is not published yet.
const LAST: Duration = Duration::from_secs(10);

/// What happens to a gateway.
#[derive(Debug, Clone, PartialEq)]
pub enum GatewayNews {
    /// Nothing can be published, and why. It is tried again; the archive keeps everything.
    Waiting {
        /// Why.
        reason: String,
    },
    /// It can again.
    Back {
        /// How long it could not.
        after: Duration,
    },
    /// A window of the archive is damaged, and left out.
    LeftOut {
        /// Which, and what is wrong.
        what: String,
    },
}

/// A gateway at work, on a thread of its own.
#[derive(Debug)]
pub struct Gateway {
    stop: Arc<AtomicBool>,
    published: Arc<AtomicU64>,
    news: Receiver<GatewayNews>,
    thread: JoinHandle<()>,
}

/// What the thread has.
struct Publisher {
    structure: String,
    folder: PathBuf,
    nodes: Vec<u16>,
    address: Address,
    stop: Arc<AtomicBool>,
    published: Arc<AtomicU64>,
    news: Sender<GatewayNews>,
    start: Instant,
    patience: Patience,
}

impl Gateway {
    /// A gateway of a study's archive.
    ///
    /// # Errors
    /// Where the system gives no thread.
    pub fn start(study: &Study, address: Address) -> Result<Self, StreamError> {
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(StreamError::System)?;
        let (stop, published) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
        let (tell, news) = channel();
        let mut publisher = Publisher {
            structure: names::token(&study.structure.name),
            folder: study.folder.clone(),
            nodes: nodes_of(study),
            address,
            stop: Arc::clone(&stop),
            published: Arc::clone(&published),
            news: tell,
            start: Instant::now(),
            patience: Patience::with_server(),
        };
        let thread = std::thread::Builder::new().name("gateway".to_owned());
        let thread = thread.spawn(move || runtime.block_on(publisher.run())).map_err(StreamError::System)?;
        Ok(Self { stop, published, news, thread })
    }

    /// What has happened since the last call.
    pub fn news(&self) -> Vec<GatewayNews> {
        self.news.try_iter().collect()
    }

    /// Ends it when it has published what there is, or cannot; how many windows it has published.
    pub fn finish(self) -> u64 {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        self.published.load(Ordering::Relaxed)
    }
}

impl Publisher {
    async fn run(&mut self) {
        while let Err(error) = self.publish().await {
            if self.patience.failed(self.start.elapsed()) {
                self.tell(GatewayNews::Waiting { reason: error.to_string() });
            }
            while self.patience.is_waiting(self.start.elapsed()) && !self.is_stopped() {
                tokio::time::sleep(LOOK).await;
            }
            if self.is_stopped() {
                return;
            }
        }
    }

    /// Publishes until it is stopped.
    async fn publish(&mut self) -> Result<(), StreamError> {
        let server = Server::connect(&self.address).await?;
        let stream = &server.streams_of(&self.structure).await?.data;
        let mut position = Position::read(&self.folder, &stream.cached_info().created.to_string())?;
        // It is made by the collection, which may be waiting for its disk.
        let archive = loop {
            match Archive::open(&self.folder)? {
                Some(archive) => break archive,
                None if self.is_stopped() => return Ok(()),
                None => tokio::time::sleep(LOOK).await,
            }
        };
        let mut row = position.row_in(&archive)?;
        let mut last_heartbeats = BTreeMap::new();
        for &node in &self.nodes {
            let last = newest(stream, &names::windows(&self.structure, node)).await?;
            let name = last.and_then(|last| names::window_of(id_of(&last)?));
            if let Some(published) = name.map_or(Ok(None), |name| archive.row_of(&name))? {
                row = row.max(published);
            }
            if let Some(last) = newest(stream, &names::heartbeats(&self.structure, node)).await? {
                last_heartbeats.insert(node, time_of(&last));
            }
        }
        let mut stopped: Option<Instant> = None;
        loop {
            let windows = archive.following(row, AT_ONCE)?;
            let lines = heartbeats::following(&self.folder, position.heartbeat_bytes, AT_ONCE);
            let lines = lines.map_err(|source| StreamError::File { file: self.folder.clone(), source })?;
            let is_idle = windows.is_empty() && lines.is_empty();
            for line in lines {
                let (node, time_us) = (line.heartbeat.node, line.time_us());
                position.heartbeat_bytes = line.end;
                if last_heartbeats.get(&node).is_some_and(|&last_us| time_us <= last_us) {
                    continue;
                }
                let id = format!("{}-{node}-{}-h{time_us}", self.structure, line.heartbeat.boot);
                let subject = names::heartbeats(&self.structure, node);
                server.publish(Outgoing { subject, id, time_us, payload: line.text }).await?;
            }
            // What was said before this connection was skipped by now, or is behind all that comes.
            if is_idle {
                last_heartbeats.clear();
            }
            for (next, window) in windows {
                match window {
                    Err(damage) => self.tell(GatewayNews::LeftOut { what: damage.to_string() }),
                    Ok(window) => {
                        let subject = names::windows(&self.structure, window.name.node);
                        let id = names::window_id(&self.structure, &window.name);
                        let (time_us, payload) = (window.middle_us(), window.encode()?);
                        server.publish(Outgoing { subject, id, time_us, payload }).await?;
                        self.published.fetch_add(1, Ordering::Relaxed);
                        position.window = Some(window.name);
                    }
                }
                row = next;
            }
            if let Some(after) = self.patience.worked(self.start.elapsed()) {
                self.tell(GatewayNews::Back { after });
            }
            if !is_idle {
                position.row = row;
                position.write(&self.folder)?;
            }
            if self.is_stopped() && (is_idle || stopped.get_or_insert_with(Instant::now).elapsed() > LAST) {
                return Ok(());
            }
            if is_idle {
                tokio::time::sleep(LOOK).await;
            }
        }
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn tell(&self, news: GatewayNews) {
        // Whoever does not listen any more need not hear it.
        let _ = self.news.send(news);
    }
}

/// The time that a message is of, in µs of Unix time.
fn time_of(message: &StreamMessage) -> i64 {
    message.headers.get(TIME_HEADER).and_then(|value| value.as_str().parse().ok()).unwrap_or(i64::MIN)
}
