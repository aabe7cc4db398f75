//! A NATS server with JetStream, as Debian packages it, on a port of this computer; and what stands in its streams, message by message.

use std::collections::{BTreeMap, VecDeque};
use std::fs;
use std::io;
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU16, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use async_nats::jetstream;
use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use nkeys::KeyPair;
use serde_json::{Value, json};
use tokio_stream::StreamExt;

use super::post::Certificate;

/// How long servers may take to start, and to elect one of them.
const START: Duration = Duration::from_secs(60);
/// How names of the streams begin that hold what gateways send.
const DATA: &str = "BELFRY_";
/// How those of what workers make of it do.
const RESULTS: &str = "BELFRY_RESULTS_";

/// A server, whose streams stand in a folder in memory. It ends with this.
#[derive(Debug)]
pub struct NatsServer {
    folder: tempfile::TempDir,
    ports: Vec<[u16; 2]>,
    children: Vec<Option<Child>>,
    secured: Option<Secured>,
}

/// What a server asks of who connects.
#[derive(Debug)]
struct Secured {
    certificate: Certificate,
    credentials: PathBuf,
    /// What its configuration says of that.
    configuration: String,
}

/// Whether all streams stand on as many servers as they should.
async fn is_whole(client: &async_nats::Client, context: &jetstream::Context) -> bool {
    // Not by query_account, which asks for what servers before 2.10 do not say.
    let answer = client.request("$JS.API.INFO", "".into()).await;
    let said: Option<Value> = answer.ok().and_then(|answer| serde_json::from_slice(&answer.payload).ok());
    if said.is_none_or(|said| !said["error"].is_null()) {
        return false;
    }
    let Ok(names) = context.stream_names().collect::<Result<Vec<String>, _>>().await else { return false };
    for name in names {
        let Ok(stream) = context.get_stream(name).await else { return false };
        let cluster = stream.cached_info().cluster.as_ref();
        let is_current = cluster.is_none_or(|cluster| {
            cluster.leader.is_some() && cluster.replicas.iter().all(|peer| peer.current && !peer.offline)
        });
        if !is_current {
            return false;
        }
    }
    true
}

/// A token that an issuer's key signs (JWT with ed25519), as NATS servers trust it.
fn token(issuer: &KeyPair, name: &str, of: &KeyPair, nats: &Value) -> Result<String, Box<dyn std::error::Error>> {
    let claims = json!({
        "jti": name, "iat": 1_700_000_000, "iss": issuer.public_key(), "name": name, "sub": of.public_key(), "nats": nats,
    });
    let coded = |value: &Value| URL_SAFE_NO_PAD.encode(value.to_string());
    let text = format!("{}.{}", coded(&json!({ "typ": "JWT", "alg": "ed25519-nkey" })), coded(&claims));
    let signature = issuer.sign(text.as_bytes())?;
    Ok(format!("{text}.{}", URL_SAFE_NO_PAD.encode(signature)))
}

impl Secured {
    /// An operator, two accounts and a user, as `nsc` makes them, and a certificate.
    fn make(folder: &Path) -> Result<Self, Box<dyn std::error::Error>> {
        let certificate = Certificate::make(folder)?;
        let (operator, system, account, user) =
            (KeyPair::new_operator(), KeyPair::new_account(), KeyPair::new_account(), KeyPair::new_user());
        let limits = json!({
            "subs": -1, "data": -1, "payload": -1, "imports": -1, "exports": -1, "wildcards": true, "conn": -1, "leaf": -1,
            "mem_storage": -1, "disk_storage": -1, "streams": -1, "consumer": -1,
        });
        let of_account = json!({ "limits": limits, "type": "account", "version": 2 });
        let of_system = json!({ "type": "account", "version": 2, "limits": { "subs": -1, "data": -1, "payload": -1, "imports": -1, "exports": -1, "wildcards": true, "conn": -1, "leaf": -1 } });
        let of_user =
            json!({ "pub": {}, "sub": {}, "subs": -1, "data": -1, "payload": -1, "type": "user", "version": 2 });
        let of_operator = json!({ "type": "operator", "version": 2, "system_account": system.public_key() });
        let configuration = format!(
            "operator: {}\nsystem_account: {}\nresolver: MEMORY\nresolver_preload: {{ {}: {}, {}: {} }}\ntls {{ cert_file: \"{}\", key_file: \"{}\" }}\n",
            token(&operator, "operator", &operator, &of_operator)?,
            system.public_key(),
            system.public_key(),
            token(&operator, "system", &system, &of_system)?,
            account.public_key(),
            token(&operator, "belfry", &account, &of_account)?,
            certificate.certificate.display(),
            certificate.key.display(),
        );
        let credentials = folder.join("belfry.creds");
        let text = format!(
            "-----BEGIN NATS USER JWT-----\n{}\n------END NATS USER JWT------\n\n-----BEGIN USER NKEY SEED-----\n{}\n------END USER NKEY SEED------\n",
            token(&account, "gateway", &user, &of_user)?,
            user.seed()?
        );
        fs::write(&credentials, text)?;
        Ok(Self { certificate, credentials, configuration })
    }
}

impl NatsServer {
    /// Starts one.
    ///
    /// # Errors
    /// When it cannot be started.
    pub fn start() -> io::Result<Self> {
        Self::start_cluster(1)
    }

    /// Starts so many that are one cluster.
    ///
    /// # Errors
    /// When they cannot be started.
    pub fn start_cluster(servers: usize) -> io::Result<Self> {
        Self::start_as(servers, super::folder_in_memory()?, None)
    }

    /// Starts one that encrypts, and lets in who has its credentials.
    ///
    /// # Errors
    /// When it cannot be started, or openssl makes no certificate.
    pub fn start_secured() -> Result<Self, Box<dyn std::error::Error>> {
        let folder = super::folder_in_memory()?;
        let secured = Secured::make(folder.path())?;
        Ok(Self::start_as(1, folder, Some(secured))?)
    }

    /// What a command needs to be let in.
    pub fn arguments(&self) -> Vec<String> {
        let of = |secured: &Secured| {
            let (trust, credentials) = (&secured.certificate.certificate, &secured.credentials);
            let path = |path: &Path| path.display().to_string();
            vec!["--trust".to_owned(), path(trust), "--credentials".to_owned(), path(credentials)]
        };
        self.secured.as_ref().map(of).unwrap_or_default()
    }

    async fn connect(&self) -> Result<async_nats::Client, Box<dyn std::error::Error>> {
        let mut options = async_nats::ConnectOptions::new();
        if let Some(secured) = &self.secured {
            options = options.add_root_certificates(secured.certificate.certificate.clone()).require_tls(true);
            options = options.credentials(&fs::read_to_string(&secured.credentials)?)?;
        }
        let urls: Vec<String> = self.url().split(',').map(str::to_owned).collect();
        Ok(options.connect(urls).await?)
    }

    fn start_as(servers: usize, folder: tempfile::TempDir, secured: Option<Secured>) -> io::Result<Self> {
        let ports: Vec<u16> = (0..2 * servers).map(|_| free_port()).collect::<io::Result<_>>()?;
        let children = (0..servers).map(|_| None).collect();
        let mut new = Self { folder, ports: ports.as_chunks::<2>().0.to_vec(), children, secured };
        for server in 0..servers {
            new.restart(server)?;
        }
        new.wait_until_ready().map_err(|error| io::Error::other(error.to_string()))?;
        Ok(new)
    }

    /// Starts one anew that was killed.
    ///
    /// # Errors
    /// When it cannot be started.
    pub fn restart(&mut self, server: usize) -> io::Result<()> {
        let [port, cluster_port] = self.ports[server];
        let store = self.folder.path().join(format!("store{server}"));
        let file = self.folder.path().join(format!("server{server}.conf"));
        let mut text = format!(
            "server_name: s{server}\nlisten: \"127.0.0.1:{port}\"\njetstream {{ store_dir: \"{}\" }}\n",
            store.display()
        );
        if let Some(secured) = &self.secured {
            text += &secured.configuration;
        }
        if self.ports.len() > 1 {
            let routes: Vec<String> = self.ports.iter().map(|[_, port]| format!("nats://127.0.0.1:{port}")).collect();
            let routes = routes.join(", ");
            text += &format!("cluster {{ name: belfry, listen: \"127.0.0.1:{cluster_port}\", routes: [{routes}] }}\n");
        }
        fs::write(&file, text)?;
        let mut command = Command::new("nats-server");
        // Where others than root do not look.
        let path = std::env::var("PATH").unwrap_or_default();
        command.env("PATH", format!("{path}:/usr/sbin"));
        let log = fs::File::create(self.folder.path().join(format!("server{server}.log")))?;
        command.arg("-c").arg(&file).stdout(Stdio::null()).stderr(log);
        self.children[server] = Some(command.spawn()?);
        let start = Instant::now();
        while TcpStream::connect(("127.0.0.1", port)).is_err() {
            if start.elapsed() > START {
                return Err(io::Error::other("nats-server does not answer"));
            }
            thread::sleep(Duration::from_millis(20));
        }
        Ok(())
    }

    /// Waits until the servers have elected one of them, answer, and have all that the others have.
    ///
    /// # Errors
    /// When they do not.
    pub fn wait_until_ready(&self) -> Result<(), Box<dyn std::error::Error>> {
        let start = Instant::now();
        block_on(async {
            let client = self.connect().await?;
            let mut context = jetstream::new(client.clone());
            context.set_timeout(Duration::from_secs(1));
            while !is_whole(&client, &context).await {
                if start.elapsed() > START {
                    return Err("the servers do not come together".into());
                }
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
            Ok(())
        })
    }

    /// Kills one at once.
    ///
    /// # Errors
    /// When it cannot be killed.
    pub fn kill(&mut self, server: usize) -> io::Result<()> {
        let Some(mut child) = self.children[server].take() else { return Ok(()) };
        child.kill()?;
        child.wait().map(drop)
    }

    /// Where it is; all of a cluster, with commas between them.
    pub fn url(&self) -> String {
        let scheme = if self.secured.is_some() { "tls" } else { "nats" };
        let urls: Vec<String> = self.ports.iter().map(|[port, _]| format!("{scheme}://127.0.0.1:{port}")).collect();
        urls.join(",")
    }

    /// The folder with what a server has on its disk.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Processor time of the first, in s.
    ///
    /// # Errors
    /// When it does not run, or the system does not say.
    #[cfg(unix)]
    pub fn cpu_s(&self) -> Result<f64, Box<dyn std::error::Error>> {
        let child = self.children.first().and_then(Option::as_ref).ok_or("no server runs")?;
        super::live::cpu_s(child.id())
    }

    /// How many results there are.
    ///
    /// # Errors
    /// When the server fails.
    pub fn count_results(&self) -> Result<usize, Box<dyn std::error::Error>> {
        block_on(async {
            let context = jetstream::new(self.connect().await?);
            let mut count = 0;
            for stream in streams_of(&context, RESULTS).await? {
                let mut subjects = stream.info_with_subjects("belfry.*.*.results").await?;
                while let Some(subject) = subjects.next().await {
                    count += subject?.1;
                }
            }
            Ok(count)
        })
    }

    /// How many copies each stream has, and each bucket, by its name.
    ///
    /// # Errors
    /// When the server fails.
    pub fn replicas(&self) -> Result<BTreeMap<String, usize>, Box<dyn std::error::Error>> {
        block_on(async {
            let context = jetstream::new(self.connect().await?);
            let names = context.stream_names().collect::<Result<Vec<String>, _>>().await?;
            let mut replicas = BTreeMap::new();
            for name in names {
                let config = context.get_stream(&name).await?.cached_info().config.clone();
                replicas.insert(name, config.num_replicas);
            }
            Ok(replicas)
        })
    }

    /// Bytes on the first server's disk of what gateways have sent, and of what workers have made of it.
    ///
    /// # Errors
    /// When its folder cannot be read.
    pub fn stored_bytes(&self) -> io::Result<[u64; 2]> {
        let mut bytes = [0; 2];
        for entry in fs::read_dir(self.folder().join("store0/jetstream/$G/streams"))? {
            let (name, path) = entry.map(|entry| (entry.file_name(), entry.path()))?;
            let name = name.to_string_lossy();
            if let Some(of) = [DATA, RESULTS].iter().position(|kind| is_of(&name, kind)) {
                bytes[of] += bytes_below(&path)?;
            }
        }
        Ok(bytes)
    }

    /// Puts an entry into a bucket.
    ///
    /// # Errors
    /// When the server fails.
    pub fn put(&self, bucket: &str, key: &str, value: &Value) -> Result<(), Box<dyn std::error::Error>> {
        block_on(async {
            let bucket = jetstream::new(self.connect().await?).get_key_value(bucket).await?;
            bucket.put(key, value.to_string().into()).await?;
            Ok(())
        })
    }

    /// Publishes a message of a time in µs of Unix time.
    ///
    /// # Errors
    /// When the server fails.
    pub fn publish(&self, message: StoredMessage, time_us: i64) -> Result<(), Box<dyn std::error::Error>> {
        self.publish_all(vec![message], time_us)
    }

    /// Publishes messages of the same time, in this order.
    ///
    /// # Errors
    /// When the server fails.
    pub fn publish_all(&self, messages: Vec<StoredMessage>, time_us: i64) -> Result<(), Box<dyn std::error::Error>> {
        block_on(async {
            let context = jetstream::new(self.connect().await?);
            let mut waiting = VecDeque::new();
            for message in messages {
                let mut headers = async_nats::HeaderMap::new();
                headers.insert("Nats-Msg-Id", message.id.as_str());
                headers.insert("Belfry-Time", time_us.to_string().as_str());
                waiting
                    .push_back(context.publish_with_headers(message.subject, headers, message.payload.into()).await?);
                if waiting.len() > 64
                    && let Some(oldest) = waiting.pop_front()
                {
                    oldest.await?;
                }
            }
            for sent in waiting {
                sent.await?;
            }
            Ok(())
        })
    }

    /// How many structures have been judged.
    ///
    /// # Errors
    /// When the server fails.
    pub fn count_judged(&self) -> Result<usize, Box<dyn std::error::Error>> {
        block_on(async {
            let context = jetstream::new(self.connect().await?);
            let names = context.stream_names().collect::<Result<Vec<String>, _>>().await?;
            let bucket = "KV_belfry-states";
            if !names.iter().any(|name| name == bucket) {
                return Ok(0);
            }
            Ok(usize::try_from(context.get_stream(bucket).await?.cached_info().state.messages)?)
        })
    }

    /// All that gateways have sent, each part of the fleet in its order.
    ///
    /// # Errors
    /// When the servers do not answer for a while.
    pub fn data(&self) -> Result<Vec<StoredMessage>, Box<dyn std::error::Error>> {
        self.messages(DATA)
    }

    /// All that workers have made of it, each part of the fleet in its order.
    ///
    /// # Errors
    /// When the servers do not answer for a while.
    pub fn results(&self) -> Result<Vec<StoredMessage>, Box<dyn std::error::Error>> {
        self.messages(RESULTS)
    }

    /// All messages of streams of this kind. It asks again where servers are busy electing one of them.
    fn messages(&self, kind: &str) -> Result<Vec<StoredMessage>, Box<dyn std::error::Error>> {
        let start = Instant::now();
        loop {
            match block_on(self.messages_now(kind)) {
                Err(_) if start.elapsed() < START => thread::sleep(Duration::from_millis(100)),
                answer => return answer,
            }
        }
    }

    async fn messages_now(&self, kind: &str) -> Result<Vec<StoredMessage>, Box<dyn std::error::Error>> {
        let context = jetstream::new(self.connect().await?);
        let mut messages = Vec::new();
        for stream in streams_of(&context, kind).await? {
            let state = stream.cached_info().state.clone();
            // One that never had any counts from 0.
            for sequence in state.first_sequence.max(1)..=state.last_sequence {
                let message = stream.get_raw_message(sequence).await?;
                let id = message.headers.get("Nats-Msg-Id").map(|id| id.as_str().to_owned()).unwrap_or_default();
                let payload = message.payload.to_vec();
                messages.push(StoredMessage { subject: message.subject.to_string(), id, payload });
            }
        }
        Ok(messages)
    }
}

/// The streams of a kind, in the order of the fleet's parts.
async fn streams_of(
    context: &jetstream::Context,
    kind: &str,
) -> Result<Vec<jetstream::stream::Stream>, Box<dyn std::error::Error>> {
    let mut names = context.stream_names().collect::<Result<Vec<String>, _>>().await?;
    names.retain(|name| is_of(name, kind));
    names.sort();
    let mut streams = Vec::new();
    for name in names {
        streams.push(context.get_stream(name).await?);
    }
    Ok(streams)
}

/// Whether a stream is of a kind: its name ends with the number of a part.
fn is_of(name: &str, kind: &str) -> bool {
    name.strip_prefix(kind).is_some_and(|part| part.bytes().all(|byte| byte.is_ascii_digit()))
}

/// A port that no other server of this process gets, and no connection: those take theirs above, where a server that is killed for a while
/// would not find its own again.
///
/// # Errors
/// Where all are taken.
pub fn free_port() -> io::Result<u16> {
    const FIRST: u16 = 16_000;
    const COUNT: u16 = 16_000;
    static NEXT: LazyLock<AtomicU16> =
        LazyLock::new(|| AtomicU16::new((u64::from(std::process::id()) * 7919 % u64::from(COUNT)) as u16));
    for _ in 0..COUNT {
        let port = FIRST + NEXT.fetch_add(1, Ordering::Relaxed) % COUNT;
        if TcpListener::bind(("127.0.0.1", port)).is_ok() {
            return Ok(port);
        }
    }
    Err(io::Error::other("no port is free"))
}

/// Bytes of all files below a folder.
fn bytes_below(folder: &Path) -> io::Result<u64> {
    let mut bytes = 0;
    for entry in fs::read_dir(folder)? {
        let (path, kind) = (entry.as_ref().map(fs::DirEntry::path), entry.as_ref().map(fs::DirEntry::metadata));
        let (Ok(path), Ok(kind)) = (path, kind) else { continue };
        let kind = kind?;
        bytes += if kind.is_dir() { bytes_below(&path)? } else { kind.len() };
    }
    Ok(bytes)
}

/// Waits for what a server answers.
fn block_on<T>(
    answer: impl Future<Output = Result<T, Box<dyn std::error::Error>>>,
) -> Result<T, Box<dyn std::error::Error>> {
    tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(answer)
}

impl Drop for NatsServer {
    fn drop(&mut self) {
        for server in 0..self.children.len() {
            let _ = self.kill(server);
        }
    }
}

/// A message of a stream.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredMessage {
    /// Its subject.
    pub subject: String,
    /// What makes it one that the stream has already.
    pub id: String,
    /// Its content.
    pub payload: Vec<u8>,
}
