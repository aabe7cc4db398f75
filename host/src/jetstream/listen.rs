//! What comes now, by its headers: a task for each part of the fleet that is listened to.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use async_nats::jetstream::consumer::pull::Stream as Messages;
use async_nats::jetstream::stream::Stream;
use tokio::sync::mpsc::{Receiver, Sender, channel};
use tokio::task::{JoinHandle, JoinSet};
use tokio_stream::StreamExt;

use super::error::StreamError;
use super::names::Part;
use super::reading::{Incoming, Start, TRIES, reader};
use super::server::Server;

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
            let (part, task) = one.map_err(failed)?;
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
    let next = streams.data.get_info().await.map_err(failed)?.state.last_sequence + 1;
    let first = open(&streams.data, part, next).await?;
    Ok(tokio::spawn(async move {
        if let Err(error) = listen(&streams.data, part, next, first, &send).await {
            // Nobody listens any more where the session is over.
            let _ = send.send(Err(error)).await;
        }
    }))
}

/// What comes to a part from message `next` on, by headers.
async fn open(data: &Stream, part: Part, next: u64) -> Result<Messages, StreamError> {
    let reader = reader(data, &part.data(), Start::Message(next), true).await?;
    reader.stream().heartbeat(HEARTBEAT).expires(EXPIRES).messages().await.map_err(failed)
}

/// Sends on what comes to a part from message `next` on, of `messages` first. A reader that breaks off is made anew behind the last message.
async fn listen(
    data: &Stream,
    part: Part,
    mut next: u64,
    first: Messages,
    send: &Sender<Result<Incoming, StreamError>>,
) -> Result<(), StreamError> {
    let (mut opened, mut failures) = (Ok(first), 0);
    loop {
        let before = next;
        let ended = match opened {
            Ok(messages) => send_on(messages, &mut next, send).await,
            Err(error) => Err(error),
        };
        let Err(error) = ended else { return Ok(()) };
        failures = if next > before { 0 } else { failures + 1 };
        if failures > TRIES {
            return Err(error);
        }
        opened = open(data, part, next).await;
    }
}

/// Sends on what a reader brings, and moves `next` behind it; it ends in an error, or where nobody listens any more.
async fn send_on(
    mut messages: Messages,
    next: &mut u64,
    send: &Sender<Result<Incoming, StreamError>>,
) -> Result<(), StreamError> {
    let mut count = 0;
    while let Some(message) = messages.next().await {
        let message = Incoming::behind(&mut count, &message.map_err(failed)?)?;
        *next = message.sequence + 1;
        if send.send(Ok(message)).await.is_err() {
            return Ok(());
        }
    }
    Err(StreamError::Gone)
}

fn failed(error: impl std::error::Error + Send + Sync + 'static) -> StreamError {
    StreamError::server("reading what comes")(error.into())
}
