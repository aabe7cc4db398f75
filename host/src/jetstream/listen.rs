//! What comes now, by its headers: a task for each part of the fleet that is listened to.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use tokio::sync::mpsc::{Receiver, Sender, channel};
use tokio::sync::oneshot;
use tokio::task::{JoinHandle, JoinSet};
use tokio_stream::StreamExt;

use super::error::StreamError;
use super::names::Part;
use super::reading::{Incoming, Start, TRIES, reader};
use super::server::{PartStreams, Server};

/// The server says so often that it is there when it has nothing to say.
const HEARTBEAT: Duration = Duration::from_secs(2);
/// How long it is waited for news, before they are asked for again.
const EXPIRES: Duration = Duration::from_secs(10);
/// Messages that wait here at most, of all parts.
const WAITING: usize = 4096;
/// Parts that are begun with at the same time: a cluster elects servers for each.
const AT_ONCE: usize = 16;

/// Parts that are listened to.
pub(super) struct Listening {
    server: Server,
    tasks: BTreeMap<Part, Task>,
    send: Sender<Result<Incoming, StreamError>>,
    messages: Receiver<Result<Incoming, StreamError>>,
}

/// A task that ends with this.
struct Task(JoinHandle<()>);

impl Drop for Task {
    fn drop(&mut self) {
        self.0.abort();
    }
}

impl Listening {
    /// To no part yet.
    pub(super) fn new(server: &Server) -> Self {
        let (send, messages) = channel(WAITING);
        Self { server: server.clone(), tasks: BTreeMap::new(), send, messages }
    }

    /// The next message of any part, in the order of each; an error where one can be listened to no longer.
    pub(super) async fn next(&mut self) -> Result<Incoming, StreamError> {
        // It has a sender itself, so that there always may be one more.
        self.messages.recv().await.ok_or(StreamError::Gone)?
    }

    /// Listens to these parts alone, and has begun when it returns: nothing that comes to them afterwards is missed.
    pub(super) async fn listen_to(&mut self, parts: &BTreeSet<Part>) -> Result<(), StreamError> {
        self.tasks.retain(|part, _| parts.contains(part));
        let mut waiting =
            parts.iter().copied().filter(|part| !self.tasks.contains_key(part)).collect::<Vec<_>>().into_iter();
        let mut begun = JoinSet::new();
        loop {
            while begun.len() < AT_ONCE
                && let Some(part) = waiting.next()
            {
                let (server, send) = (self.server.clone(), self.send.clone());
                begun.spawn(async move { (part, begin(&server, part, send).await) });
            }
            let Some(one) = begun.join_next().await else { return Ok(()) };
            let (part, task) = one.map_err(|error| StreamError::server("reading what comes")(error.into()))?;
            self.tasks.insert(part, Task(task?));
        }
    }
}

/// Begins to listen to a part.
async fn begin(
    server: &Server,
    part: Part,
    send: Sender<Result<Incoming, StreamError>>,
) -> Result<JoinHandle<()>, StreamError> {
    let streams = server.streams(part).await?;
    let newest =
        streams.data.get_info().await.map_err(|error| StreamError::server("reading what comes")(error.into()))?;
    let next = newest.state.last_sequence + 1;
    let (ready, is_ready) = oneshot::channel();
    let task = tokio::spawn(async move {
        if let Err(error) = listen(&streams, part, next, ready, &send).await {
            // Nobody listens any more where the session is over.
            let _ = send.send(Err(error)).await;
        }
    });
    match is_ready.await {
        Ok(()) => Ok(task),
        // Its error is among the messages.
        Err(_) => Err(StreamError::Gone),
    }
}

/// Sends on what comes to a part from message `next` on. A reader that breaks off is made anew behind the last message.
async fn listen(
    streams: &PartStreams,
    part: Part,
    mut next: u64,
    ready: oneshot::Sender<()>,
    send: &Sender<Result<Incoming, StreamError>>,
) -> Result<(), StreamError> {
    let (mut ready, mut failures) = (Some(ready), 0);
    loop {
        let before = next;
        let Err(error) = listen_once(streams, part, &mut next, &mut ready, send).await else { return Ok(()) };
        failures = if next > before { 0 } else { failures + 1 };
        if failures > TRIES {
            return Err(error);
        }
    }
}

/// The same with one reader; it ends in an error, or where nobody listens any more.
async fn listen_once(
    streams: &PartStreams,
    part: Part,
    next: &mut u64,
    ready: &mut Option<oneshot::Sender<()>>,
    send: &Sender<Result<Incoming, StreamError>>,
) -> Result<(), StreamError> {
    let failed = |error: Box<dyn std::error::Error + Send + Sync>| StreamError::server("reading what comes")(error);
    let reader = reader(&streams.data, &part.data(), Start::Message(*next), true).await?;
    let messages = reader.stream().heartbeat(HEARTBEAT).expires(EXPIRES).messages().await;
    let mut messages = messages.map_err(|error| failed(error.into()))?;
    if let Some(ready) = ready.take() {
        // Whoever has asked may have gone.
        let _ = ready.send(());
    }
    let mut count = 0;
    while let Some(message) = messages.next().await {
        let message = message.map_err(|error| failed(error.into()))?;
        let message = Incoming::behind(&mut count, &message)?;
        *next = message.sequence + 1;
        if send.send(Ok(message)).await.is_err() {
            return Ok(());
        }
    }
    Err(StreamError::Gone)
}
