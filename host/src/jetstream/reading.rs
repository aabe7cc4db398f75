//! Reading messages of a stream in their order, from one on, to the newest there is.

use std::ops::ControlFlow;
use std::time::Duration;

use async_nats::datetime::DateTime;
use async_nats::jetstream::Message;
use async_nats::jetstream::consumer::pull::Config;
use async_nats::jetstream::consumer::{AckPolicy, Consumer, DeliverPolicy};
use async_nats::jetstream::stream::Stream;
use belfry_shared::message::WindowName;
use bytes::Bytes;
use tokio_stream::StreamExt;

use super::error::StreamError;
use super::ledger::Arrived;
use super::names::{self, ID_HEADER, TIME_HEADER};

/// Messages that are asked for at a time.
const AT_ONCE: usize = 256;
/// The server forgets a reader that has gone after this time.
const FORGOTTEN: Duration = Duration::from_secs(30);
/// How long the next message may take.
const ANSWER: Duration = Duration::from_secs(5);
/// How often a reader is made anew that brings nothing.
pub(super) const TRIES: usize = 3;
/// Data cannot be of later than when they came to the server, but for how far clocks are apart, in µs.
const AHEAD_US: i64 = 900_000_000;

/// A message.
pub(super) struct Incoming {
    pub(super) subject: String,
    /// Its place in the stream.
    pub(super) sequence: u64,
    /// The time that it is of, in µs of Unix time, where it says so and can be right.
    pub(super) time_us: Option<i64>,
    /// Whether it says a time that was still to come when it came: the clock of its gateway is ahead.
    pub(super) is_ahead: bool,
    /// The window that it is, where it says so.
    window: Option<WindowName>,
    pub(super) payload: Bytes,
}

impl Incoming {
    /// The message behind `count` others of its reader, which it is counted to.
    ///
    /// # Errors
    /// [`StreamError::Gone`] where one is missing: what was on its way when the connection was interrupted does not come again.
    pub(super) fn behind(count: &mut u64, message: &Message) -> Result<Self, StreamError> {
        let info = message.info().map_err(StreamError::server("a message"))?;
        let header = |name| message.headers.as_ref().and_then(|headers| headers.get(name)).map(|value| value.as_str());
        *count += 1;
        if info.consumer_sequence != *count {
            return Err(StreamError::Gone);
        }
        let time_us: Option<i64> = header(TIME_HEADER).and_then(|time| time.parse().ok());
        let came_us = info.published.unix_timestamp_nanos() / 1000;
        let is_ahead = time_us.is_some_and(|time_us| i128::from(time_us) > came_us + i128::from(AHEAD_US));
        Ok(Self {
            subject: message.subject.to_string(),
            sequence: info.stream_sequence,
            time_us: time_us.filter(|_| !is_ahead),
            is_ahead,
            window: header(ID_HEADER).and_then(names::window_of),
            payload: message.payload.clone(),
        })
    }

    /// The structure that it is of, and what its headers say; `None` of what is neither a window nor a heartbeat.
    pub(super) fn arrived(&self) -> Option<(&str, Arrived)> {
        let (key, kind) = names::data_of(&self.subject)?;
        Some((key, Arrived { sequence: self.sequence, kind, time_us: self.time_us?, window: self.window }))
    }
}

/// Where reading begins.
#[derive(Debug, Clone, Copy)]
pub(super) enum Start {
    /// At this message of the stream, or the first behind it.
    Message(u64),
    /// At the first that has come since, by the server's clock.
    Time(DateTime),
}

impl Start {
    fn policy(self) -> DeliverPolicy {
        match self {
            Self::Message(sequence) => DeliverPolicy::ByStartSequence { start_sequence: sequence.max(1) },
            Self::Time(start_time) => DeliverPolicy::ByStartTime { start_time },
        }
    }
}

/// A reader of the messages of these subjects from `from` on. It stands on as many servers as the stream does: on one of them alone, it would be gone with
/// that one, and a cluster takes a minute or two to notice that a server is dead, until when it puts readers there.
pub(super) async fn reader(
    stream: &Stream,
    subjects: &str,
    from: Start,
    headers_only: bool,
) -> Result<Consumer<Config>, StreamError> {
    let config = Config {
        deliver_policy: from.policy(),
        ack_policy: AckPolicy::None,
        filter_subject: subjects.to_owned(),
        headers_only,
        inactive_threshold: FORGOTTEN,
        num_replicas: stream.cached_info().config.num_replicas.max(1),
        memory_storage: true,
        ..Config::default()
    };
    let mut failures = 0;
    loop {
        match stream.create_consumer(config.clone()).await {
            Ok(reader) => return Ok(reader),
            // Its servers elect one of them, which takes longer than a request waits where the first choice is dead.
            Err(_) if failures < TRIES => failures += 1,
            Err(error) => return Err(StreamError::server(format!("reading {subjects}"))(error.into())),
        }
    }
}

/// Why a reader came to no end.
enum Broken {
    /// The reader, or the server that it stands on: another may go on.
    Reader(StreamError),
    /// What was done with a message.
    Message(StreamError),
}

/// Hands out the messages of these subjects from `from` on, until there are no more or `on_message` breaks. A reader that has gone is made anew, behind
/// the last message.
pub(super) async fn each(
    stream: &Stream,
    subjects: &str,
    from: Start,
    headers_only: bool,
    mut on_message: impl FnMut(Incoming) -> Result<ControlFlow<()>, StreamError>,
) -> Result<(), StreamError> {
    let (mut next, mut failures) = (from, 0);
    loop {
        let mut came = false;
        let on_message = |message: Incoming| {
            came = true;
            on_message(message)
        };
        match read_on(stream, subjects, &mut next, headers_only, on_message).await {
            Ok(()) => return Ok(()),
            Err(Broken::Message(error)) => return Err(error),
            Err(Broken::Reader(_)) if came => failures = 0,
            Err(Broken::Reader(_)) if failures < TRIES => failures += 1,
            Err(Broken::Reader(error)) => return Err(error),
        }
    }
}

/// Hands out messages from `next` on, which it moves.
async fn read_on(
    stream: &Stream,
    subjects: &str,
    next: &mut Start,
    headers_only: bool,
    mut on_message: impl FnMut(Incoming) -> Result<ControlFlow<()>, StreamError>,
) -> Result<(), Broken> {
    let reader = reader(stream, subjects, *next, headers_only).await.map_err(Broken::Reader)?;
    let failed = |error: Box<dyn std::error::Error + Send + Sync>| {
        Broken::Reader(StreamError::server(format!("reading {subjects}"))(error))
    };
    // A reader that says nothing more has come to the end, or is dead: messages say how many are behind them.
    let (mut count, mut behind) = (0, reader.cached_info().num_pending as usize);
    'all: while behind > 0 {
        let before = count;
        let batch = reader.fetch().max_messages(AT_ONCE.min(behind)).messages();
        let mut batch = batch.await.map_err(|error| failed(error.into()))?;
        loop {
            let message = tokio::time::timeout(ANSWER, batch.next()).await.map_err(|error| failed(error.into()))?;
            let Some(message) = message else { break };
            let message = message.map_err(failed)?;
            behind = message.info().map_err(failed)?.pending as usize;
            let message = Incoming::behind(&mut count, &message).map_err(Broken::Reader)?;
            *next = Start::Message(message.sequence + 1);
            if on_message(message).map_err(Broken::Message)?.is_break() {
                break 'all;
            }
        }
        if count == before && behind > 0 {
            return Err(Broken::Reader(StreamError::Gone));
        }
    }
    // A reader that stays is forgotten by the server.
    let _ = stream.delete_consumer(&reader.cached_info().name).await;
    Ok(())
}
