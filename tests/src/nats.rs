//! A NATS server with JetStream, as Debian packages it, on a port of this computer; and what stands in its streams, message by message.

use std::fs;
use std::io;
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use async_nats::jetstream;

/// How long a server may take to start.
const START: Duration = Duration::from_secs(30);

/// A server, whose streams stand in a folder in memory. It ends with this.
#[derive(Debug)]
pub struct NatsServer {
    folder: tempfile::TempDir,
    ports: Vec<[u16; 2]>,
    children: Vec<Option<Child>>,
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
        let folder = super::folder_in_memory()?;
        let listeners = (0..2 * servers).map(|_| TcpListener::bind("127.0.0.1:0")).collect::<io::Result<Vec<_>>>()?;
        let ports: Vec<u16> =
            listeners.iter().map(|one| one.local_addr().map(|address| address.port())).collect::<io::Result<_>>()?;
        drop(listeners);
        let mut new =
            Self { folder, ports: ports.as_chunks::<2>().0.to_vec(), children: (0..servers).map(|_| None).collect() };
        for server in 0..servers {
            new.restart(server)?;
        }
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
        let urls: Vec<String> = self.ports.iter().map(|[port, _]| format!("nats://127.0.0.1:{port}")).collect();
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

    /// How many messages a stream has.
    ///
    /// # Errors
    /// When the server fails.
    pub fn count(&self, stream: &str) -> Result<usize, Box<dyn std::error::Error>> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        runtime.block_on(async {
            let urls: Vec<String> = self.url().split(',').map(str::to_owned).collect();
            let context = jetstream::new(async_nats::connect(urls).await?);
            let stream = context.get_stream(stream).await?;
            Ok(usize::try_from(stream.cached_info().state.messages)?)
        })
    }

    /// All messages of a stream, in its order; none where there is no such stream yet.
    ///
    /// # Errors
    /// When the server fails.
    pub fn messages(&self, stream: &str) -> Result<Vec<StoredMessage>, Box<dyn std::error::Error>> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        runtime.block_on(async {
            let urls: Vec<String> = self.url().split(',').map(str::to_owned).collect();
            let context = jetstream::new(async_nats::connect(urls).await?);
            let Ok(stream) = context.get_stream(stream).await else { return Ok(Vec::new()) };
            let state = stream.cached_info().state.clone();
            let mut messages = Vec::new();
            // One that never had any counts from 0.
            for sequence in state.first_sequence.max(1)..=state.last_sequence {
                let message = stream.get_raw_message(sequence).await?;
                let id = message.headers.get("Nats-Msg-Id").map(|id| id.as_str().to_owned()).unwrap_or_default();
                let payload = message.payload.to_vec();
                messages.push(StoredMessage { subject: message.subject.to_string(), id, payload });
            }
            Ok(messages)
        })
    }
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
