//! Reading messages of a stream in their order, from one on, to the newest there is.

use std::ops::ControlFlow;
use std::time::Duration;

use async_nats::jetstream::Message;
use async_nats::jetstream::consumer::pull::Config;
use async_nats::jetstream::consumer::{AckPolicy, Consumer, DeliverPolicy};
use async_nats::jetstream::stream::Stream;
use bytes::Bytes;
use tokio_stream::StreamExt;

use super::error::StreamError;
use super::names::TIME_HEADER;

/// Messages that are asked for at a time.
const AT_ONCE: usize = 256;
/// The server forgets a reader that has gone after this time.
const FORGOTTEN: Duration = Duration::from_secs(30);

/// A message.
pub(super) struct Incoming {
    pub(super) subject: String,
    /// Its place in the stream.
    pub(super) sequence: u64,
    /// The time that it is of, in µs of Unix time, where it says so.
    pub(super) time_us: Option<i64>,
    pub(super) payload: Bytes,
}

impl Incoming {
    /// The message behind `count` others of its reader, which it is counted to.
    ///
    /// # Errors
    /// [`StreamError::Gone`] where one is missing: what was on its way when the connection was interrupted does not come again.
    pub(super) fn behind(count: &mut u64, message: &Message) -> Result<Self, StreamError> {
        let info = message.info().map_err(StreamError::server("a message"))?;
        let time = message.headers.as_ref().and_then(|headers| headers.get(TIME_HEADER));
        *count += 1;
        if info.consumer_sequence != *count {
            return Err(StreamError::Gone);
        }
        Ok(Self {
            subject: message.subject.to_string(),
            sequence: info.stream_sequence,
            time_us: time.and_then(|time| time.as_str().parse().ok()),
            payload: message.payload.clone(),
        })
    }
}

/// A reader of the messages of these subjects from `from` on.
pub(super) async fn reader(
    stream: &Stream,
    subjects: &str,
    from: u64,
    headers_only: bool,
) -> Result<Consumer<Config>, StreamError> {
    let config = Config {
        deliver_policy: DeliverPolicy::ByStartSequence { start_sequence: from.max(1) },
        ack_policy: AckPolicy::None,
        filter_subject: subjects.to_owned(),
        headers_only,
        inactive_threshold: FORGOTTEN,
        num_replicas: 1,
        memory_storage: true,
        ..Config::default()
    };
    let reader = stream.create_consumer(config).await;
    reader.map_err(|error| StreamError::server(format!("reading {subjects}"))(error.into()))
}

/// Hands out the messages of these subjects from `from` on, until there are no more or `on_message` breaks.
pub(super) async fn each(
    stream: &Stream,
    subjects: &str,
    from: u64,
    headers_only: bool,
    mut on_message: impl FnMut(Incoming) -> Result<ControlFlow<()>, StreamError>,
) -> Result<(), StreamError> {
    let reader = reader(stream, subjects, from, headers_only).await?;
    let failed = || StreamError::server(format!("reading {subjects}"));
    let mut count = 0;
    'all: loop {
        let before = count;
        let batch = reader.fetch().max_messages(AT_ONCE).messages().await;
        let mut batch = batch.map_err(|error| failed()(error.into()))?;
        while let Some(message) = batch.next().await {
            let message = Incoming::behind(&mut count, &message.map_err(failed())?)?;
            if on_message(message)?.is_break() {
                break 'all;
            }
        }
        if count == before {
            break;
        }
    }
    // A reader that stays is forgotten by the server.
    let _ = stream.delete_consumer(&reader.cached_info().name).await;
    Ok(())
}
