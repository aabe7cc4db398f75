//! The connection to a server, and the streams and buckets that Belfry has there.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use async_nats::jetstream::context::{PublishError, PublishErrorKind};
use async_nats::jetstream::kv::{Entry, Store};
use async_nats::jetstream::message::StreamMessage;
use async_nats::jetstream::object_store::{Config as ObjectsConfig, ObjectStore};
use async_nats::jetstream::stream::{
    Config as StreamConfig, DiscardPolicy, LastRawMessageErrorKind, StorageType, Stream,
};
use async_nats::jetstream::{self, Context};
use async_nats::{Client, ConnectOptions, Event, HeaderMap};
use bytes::Bytes;
use url::Url;

use super::error::StreamError;
use super::names::{Part, STATES, STRUCTURES, STUDIES, WORKERS};
use crate::link::with_cause;

/// How long an answer is waited for.
const ANSWER: Duration = Duration::from_secs(5);
/// Windows and heartbeats are kept so long, where Belfry makes the stream.
const KEPT: Duration = Duration::from_secs(30 * 86_400);
/// A worker that has not said so for this long is not alive.
pub(super) const ALIVE: Duration = Duration::from_secs(10);
/// The port of a server, where its address names none.
const PORT: u16 = 4222;

/// Where a server is, and how to be let in.
#[derive(Debug, Clone)]
pub struct Address {
    /// Its URLs: several of a cluster.
    pub(crate) servers: Vec<Url>,
    /// The file of credentials.
    pub credentials: Option<PathBuf>,
    /// A file of certificates to trust beside the system's.
    pub trusted: Option<PathBuf>,
    /// Copies of each message that the cluster keeps, where the streams are made.
    pub replicas: usize,
}

impl Address {
    /// The address of `nats://HOST:PORT` or `tls://HOST:PORT`; several of a cluster with commas between them.
    ///
    /// # Errors
    /// A sentence that says what was expected.
    pub fn parse(text: &str) -> Result<Self, String> {
        let expected = |part: &str| format!("expected nats://HOST:PORT or tls://HOST:PORT, not \"{part}\"");
        let server = |part: &str| {
            let url = Url::parse(part).map_err(|_| expected(part))?;
            let is_known =
                matches!(url.scheme(), "nats" | "tls") && url.host_str().is_some_and(|host| !host.is_empty());
            if is_known { Ok(url) } else { Err(expected(part)) }
        };
        let servers = text.split(',').map(server).collect::<Result<_, _>>()?;
        Ok(Self { servers, credentials: None, trusted: None, replicas: 1 })
    }
}

/// Without the password.
impl fmt::Display for Address {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let named: Vec<String> = self
            .servers
            .iter()
            .map(|url| {
                let host = url.host_str().unwrap_or_default();
                format!("{}://{host}:{}", url.scheme(), url.port().unwrap_or(PORT))
            })
            .collect();
        formatter.write_str(&named.join(","))
    }
}

/// The streams of a part of the fleet.
#[derive(Clone)]
pub(super) struct PartStreams {
    /// What gateways send.
    pub(super) data: Stream,
    /// What workers make of it.
    pub(super) results: Stream,
}

/// A connection.
#[derive(Clone)]
pub(super) struct Server {
    client: Client,
    context: Context,
    replicas: usize,
    /// The bucket of structures.
    pub(super) structures: Store,
    /// Streams that were asked for.
    parts: Arc<Mutex<BTreeMap<Part, PartStreams>>>,
    /// Whether the connection has been interrupted since it was made.
    interrupted: Arc<AtomicBool>,
}

impl Server {
    /// Connects.
    pub(super) async fn connect(address: &Address) -> Result<Self, StreamError> {
        let failed = |why: String| StreamError::Connect { address: address.to_string(), why };
        let interrupted = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&interrupted);
        let mut options = ConnectOptions::new()
            .name("belfry")
            .connection_timeout(ANSWER)
            .request_timeout(Some(ANSWER))
            .require_tls(address.servers.iter().any(|url| url.scheme() == "tls"))
            .event_callback(move |event| {
                let flag = Arc::clone(&flag);
                async move {
                    if matches!(event, Event::Disconnected | Event::Closed) {
                        flag.store(true, Ordering::Relaxed);
                    }
                }
            });
        if let Some(file) = &address.credentials {
            let unread = |source| StreamError::Credentials { file: file.clone(), source };
            let text = std::fs::read_to_string(file).map_err(unread)?;
            options = options.credentials(&text).map_err(unread)?;
        }
        if let Some(file) = &address.trusted {
            options = options.add_root_certificates(file.clone());
        }
        let servers: Vec<String> = address.servers.iter().map(Url::to_string).collect();
        let client = options.connect(servers).await.map_err(|error| failed(with_cause(&error)))?;
        let mut context = jetstream::new(client.clone());
        context.set_timeout(ANSWER);
        let structures = bucket(&context, STRUCTURES, Duration::ZERO, address.replicas).await?;
        // Everything has as many copies as what the first command of all has made.
        let replicas = structures.stream.cached_info().config.num_replicas.max(1);
        Ok(Self { client, context, replicas, structures, parts: Arc::default(), interrupted })
    }

    /// The streams of a part; they are made where they are not there yet.
    pub(super) async fn streams(&self, part: Part) -> Result<PartStreams, StreamError> {
        let known = self.parts.lock().unwrap_or_else(PoisonError::into_inner).get(&part).cloned();
        if let Some(streams) = known {
            return Ok(streams);
        }
        let data = config(&part.data_stream(), &[&part.data()], KEPT, self.replicas);
        let [results, alarms] = part.results();
        let results = config(&part.results_stream(), &[&results, &alarms], Duration::ZERO, self.replicas);
        let (data, results) = (stream(&self.context, data).await?, stream(&self.context, results).await?);
        let streams = PartStreams { data, results };
        self.parts.lock().unwrap_or_else(PoisonError::into_inner).insert(part, streams.clone());
        Ok(streams)
    }

    /// The streams that a structure is in.
    pub(super) async fn streams_of(&self, key: &str) -> Result<PartStreams, StreamError> {
        self.streams(Part::of(key)).await
    }

    /// Fails where the connection has been interrupted: what was on its way to here may be lost.
    pub(super) fn is_whole(&self) -> Result<(), StreamError> {
        if self.interrupted.load(Ordering::Relaxed) { Err(StreamError::Gone) } else { Ok(()) }
    }

    /// The bucket of what judgements go on from.
    pub(super) async fn states(&self) -> Result<Store, StreamError> {
        bucket(&self.context, STATES, Duration::ZERO, self.replicas).await
    }

    /// The bucket of workers that are alive.
    pub(super) async fn workers(&self) -> Result<Store, StreamError> {
        bucket(&self.context, WORKERS, ALIVE, self.replicas).await
    }

    /// The object store of studies.
    pub(super) async fn studies(&self) -> Result<ObjectStore, StreamError> {
        if let Ok(store) = self.context.get_object_store(STUDIES).await {
            return Ok(store);
        }
        let config =
            ObjectsConfig { bucket: STUDIES.to_owned(), num_replicas: self.replicas, ..ObjectsConfig::default() };
        let store = self.context.create_object_store(config).await;
        store.map_err(|error| StreamError::server(format!("object store {STUDIES}"))(error.into()))
    }

    /// The stream below that, and the subject of the parts of an object in it.
    pub(super) async fn chunks(&self, object: &str) -> Result<(Stream, String), StreamError> {
        let stream = self.context.get_stream(format!("OBJ_{STUDIES}")).await;
        let stream = stream.map_err(|error| StreamError::server(format!("object store {STUDIES}"))(error.into()))?;
        Ok((stream, format!("$O.{STUDIES}.C.{object}")))
    }

    /// Publishes a message, and waits until the server has it on its disk.
    pub(super) async fn publish(&self, message: Outgoing) -> Result<(), StreamError> {
        let Outgoing { subject, id, time_us, payload } = message;
        let (bytes, most) = (payload.len() + HEADERS, self.client.max_payload());
        if bytes > most {
            return Err(StreamError::TooLong { what: id, bytes, most });
        }
        let mut headers = HeaderMap::new();
        headers.insert("Nats-Msg-Id", id.as_str());
        headers.insert(super::names::TIME_HEADER, time_us.to_string().as_str());
        let failed = |error: PublishError| StreamError::server(id.clone())(error.into());
        let acknowledged =
            self.context.publish_with_headers(subject, headers, Bytes::from(payload)).await.map_err(failed)?;
        acknowledged.await.map(drop).map_err(failed)
    }
}

impl Server {
    /// Publishes a message behind the one that is the newest of its subject; where it has got, or `None` where another is the newest by now.
    pub(super) async fn publish_behind(
        &self,
        newest: u64,
        subject: String,
        id: String,
        payload: Vec<u8>,
    ) -> Result<Option<u64>, StreamError> {
        let failed = |error: PublishError| StreamError::server(id.clone())(error.into());
        let mut headers = HeaderMap::new();
        headers.insert("Nats-Msg-Id", id.as_str());
        headers.insert("Nats-Expected-Last-Subject-Sequence", newest.to_string().as_str());
        let sent = self.context.publish_with_headers(subject, headers, Bytes::from(payload)).await.map_err(failed)?;
        match sent.await {
            Ok(acknowledged) if acknowledged.duplicate => Ok(None),
            Ok(acknowledged) => Ok(Some(acknowledged.sequence)),
            Err(error) if error.kind() == PublishErrorKind::WrongLastSequence => Ok(None),
            Err(error) => Err(failed(error)),
        }
    }
}

/// The newest message of a subject.
pub(super) async fn newest(stream: &Stream, subject: &str) -> Result<Option<StreamMessage>, StreamError> {
    match stream.get_last_raw_message_by_subject(subject).await {
        Ok(message) => Ok(Some(message)),
        Err(error) if matches!(error.kind(), LastRawMessageErrorKind::NoMessageFound) => Ok(None),
        Err(error) => Err(StreamError::server(format!("the newest of {subject}"))(error.into())),
    }
}

/// An entry of a bucket with the revision that it has; `what` says what it is of its key.
pub(super) async fn entry(store: &Store, key: &str, what: &str) -> Result<Option<Entry>, StreamError> {
    let entry = store.entry(key).await;
    entry.map_err(|error| StreamError::server(format!("the {what} of {key}"))(error.into()))
}

/// What makes a message one that the stream has already.
pub(super) fn id_of(message: &StreamMessage) -> Option<&str> {
    message.headers.get(super::names::ID_HEADER).map(|value| value.as_str())
}

/// A stream, which is made where there is none.
async fn stream(context: &Context, config: StreamConfig) -> Result<Stream, StreamError> {
    let name = config.name.clone();
    let stream = context.get_or_create_stream(config).await;
    stream.map_err(|error| StreamError::server(format!("stream {name}"))(error.into()))
}

/// A bucket, which is made where there is none.
async fn bucket(context: &Context, name: &str, max_age: Duration, replicas: usize) -> Result<Store, StreamError> {
    if let Ok(store) = context.get_key_value(name).await {
        return Ok(store);
    }
    // Not by create_key_value, which asks for what servers before 2.10 do not say.
    let stream = StreamConfig {
        max_messages_per_subject: 1,
        discard: DiscardPolicy::New,
        allow_rollup: true,
        deny_delete: true,
        allow_direct: true,
        ..config(&format!("KV_{name}"), &[&format!("$KV.{name}.>")], max_age, replicas)
    };
    let failed = || StreamError::server(format!("bucket {name}"));
    context.get_or_create_stream(stream).await.map_err(|error| failed()(error.into()))?;
    context.get_key_value(name).await.map_err(|error| failed()(error.into()))
}

/// What a stream is to be.
fn config(name: &str, subjects: &[&str], max_age: Duration, num_replicas: usize) -> StreamConfig {
    StreamConfig {
        name: name.to_owned(),
        subjects: subjects.iter().map(|&subject| subject.to_owned()).collect(),
        storage: StorageType::File,
        num_replicas,
        max_age,
        ..StreamConfig::default()
    }
}

/// Headers take less, beside the content of a message.
const HEADERS: usize = 256;

/// A message of a gateway.
pub(super) struct Outgoing {
    pub(super) subject: String,
    /// What makes it one that the stream has already.
    pub(super) id: String,
    /// The time that it is of.
    pub(super) time_us: i64,
    pub(super) payload: Vec<u8>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_names_servers_and_hides_a_password() {
        let address = Address::parse("nats://me:secret@one:4223,tls://two").unwrap();
        assert_eq!(address.to_string(), "nats://one:4223,tls://two:4222");
        for text in ["", "one:4222", "http://one", "nats://", "nats://one,,nats://two"] {
            assert!(Address::parse(text).is_err_and(|said| said.contains("nats://HOST:PORT")), "{text}");
        }
    }
}
