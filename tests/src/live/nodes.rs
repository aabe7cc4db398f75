//! The firmware in real time, each node behind a Unix socket; it goes on when the host has gone.

use std::fs;
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use belfry_firmware::{Identity, Memory, Node};
use belfry_shared::time::NodeTime;

use crate::{belfry_command, folder_in_memory};

/// Threads that the nodes share.
const THREADS: usize = 4;
/// How often bytes are looked at.
const LOOK: Duration = Duration::from_millis(2);

/// What nodes measure.
#[derive(Debug, Clone, Copy)]
pub(super) struct Measured {
    pub(super) nodes: u16,
    pub(super) channels: usize,
    pub(super) rate_hz: f64,
    /// What stands in `[analysis]`.
    pub(super) analysis: &'static str,
}

impl Measured {
    fn write_study(&self, folder: &Path) -> io::Result<()> {
        let mut text = "[structure]\nname = \"Mast\"\n[[setup]]\nname = \"now\"\nlive = true\n".to_owned();
        text += &format!("sampling_rate_hz = {}\n", self.rate_hz);
        for node in 1..=self.nodes {
            for channel in 0..self.channels {
                text += &format!("[[setup.sensor]]\nchannel = \"{node}-{channel}\"\nnode = {node}\n");
            }
        }
        text += &format!("[analysis]\n{}\n", self.analysis);
        fs::write(folder.join("study.toml"), text)
    }
}

struct LiveNode {
    node: Node<Box<Memory>>,
    listener: UnixListener,
    stream: Option<UnixStream>,
    rows: u64,
    channels: usize,
    rate_hz: f64,
    /// How much its clock gains.
    gain: f64,
}

impl LiveNode {
    fn time(&self, seconds: f64) -> NodeTime {
        NodeTime((seconds * (1.0 + self.gain) * 1e6) as u64)
    }

    fn step(&mut self, on: Instant) {
        let now_s = on.elapsed().as_secs_f64();
        while (self.rows as f64) < now_s * self.rate_hz {
            let time = self.time(self.rows as f64 / self.rate_hz);
            let readings = [0, 1, 2, 3].map(|channel| noise(self.rows * 4 + channel));
            self.node.sample(time, &readings[..self.channels]);
            while self.node.poll(time) {}
            self.rows += 1;
        }
        if let Ok((stream, _)) = self.listener.accept() {
            self.stream = stream.set_nonblocking(true).is_ok().then_some(stream);
        }
        let Some(mut stream) = self.stream.take() else { return };
        if self.exchange(&mut stream, on) {
            self.stream = Some(stream);
        }
    }

    /// Hears and says what there is; whether the host is still there.
    fn exchange(&mut self, stream: &mut UnixStream, on: Instant) -> bool {
        let mut buffer = [0; 1024];
        match stream.read(&mut buffer) {
            Ok(0) => return false,
            Ok(count) => {
                let now = self.time(on.elapsed().as_secs_f64());
                buffer[..count].iter().for_each(|&byte| self.node.receive(now, byte));
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(_) => return false,
        }
        while self.node.has_bytes() {
            let now = self.time(on.elapsed().as_secs_f64());
            let count = self.node.transmit(now, &mut buffer);
            if count == 0 {
                break;
            }
            if stream.write_all(&buffer[..count]).is_err() {
                return false;
            }
        }
        true
    }
}

/// Ground motion of a kind: the same for every call, and hardly ever the same twice in a row.
fn noise(place: u64) -> f32 {
    let hash = place.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    ((hash >> 40) as f32 / (1 << 24) as f32 - 0.5) * 0.02
}

/// A study and its nodes at work.
pub(super) struct LiveNodes {
    pub(super) folder: tempfile::TempDir,
    nodes: u16,
    stop: Arc<AtomicBool>,
    threads: Vec<thread::JoinHandle<()>>,
}

impl LiveNodes {
    pub(super) fn start(measured: &Measured) -> io::Result<Self> {
        // Others that use the disk would be measured as well.
        let folder = folder_in_memory()?;
        measured.write_study(folder.path())?;
        let on = Instant::now();
        let stop = Arc::new(AtomicBool::new(false));
        let mut shares: Vec<Vec<LiveNode>> = (0..THREADS).map(|_| Vec::new()).collect();
        for number in 1..=measured.nodes {
            let listener = UnixListener::bind(folder.path().join(format!("node{number}")))?;
            listener.set_nonblocking(true)?;
            let identity = Identity {
                node: number,
                boot: rand::random(),
                channels: measured.channels as u8,
                full_scale_m_s2: 20.0,
                highest_rate_mhz: 4_000_000,
            };
            shares[usize::from(number) % THREADS].push(LiveNode {
                node: Node::new(identity, Box::new(Memory::new())),
                listener,
                stream: None,
                rows: 0,
                channels: measured.channels,
                rate_hz: measured.rate_hz,
                gain: if number % 2 == 0 { 20e-6 } else { -20e-6 },
            });
        }
        let work = |mut nodes: Vec<LiveNode>| {
            let stop = Arc::clone(&stop);
            thread::spawn(move || {
                while !stop.load(Ordering::Relaxed) {
                    nodes.iter_mut().for_each(|node| node.step(on));
                    thread::sleep(LOOK);
                }
            })
        };
        let threads = shares.into_iter().map(work).collect();
        Ok(Self { folder, nodes: measured.nodes, stop, threads })
    }

    /// The command that collects from them.
    pub(super) fn collect(&self) -> Command {
        let mut command = belfry_command();
        command.arg("collect").arg(self.folder.path());
        for node in 1..=self.nodes {
            command.arg("--port").arg(format!("unix:{}", self.folder.path().join(format!("node{node}")).display()));
        }
        command
    }
}

impl Drop for LiveNodes {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // A thread that has panicked has said so.
        self.threads.drain(..).for_each(|thread| drop(thread.join()));
    }
}
