//! A fleet of simulated nodes: the real firmware library, fed from a recording, talking over simulated serial lines.
//!
//! Rows of one setup flow in, windows of all its channels flow out, on the grid of host time. Every node has its own
//! boot time, its own line and, where it paces the rows, its own crystal; host and node run the code they run on a real port.

mod in_process;
mod node;
mod pace;

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread;

use belfry_shared::decimation::Stages;
use belfry_shared::message::Summary;
use thiserror::Error;

use crate::link::memory::{Faults, LineStatistics};
use crate::link::{SessionError, SessionStatistics};
use crate::spectra::{LineGrid, WindowLines};
use crate::study::Setup;
use crate::window::{GridAssembler, channels_by_node, node_configuration};
pub use in_process::InProcess;
use node::{Feed, NodeSettings, SimulatedNode};

/// Blocks of rows that may wait for a worker.
const BLOCKS_AHEAD: usize = 4;

/// How the nodes are set up and what their lines do to them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FleetOptions {
    /// What the nodes send. Only [`Summary::Lines`] makes modes.
    pub summary: Summary,
    /// Baud rate of every line.
    pub baud: u32,
    /// What happens to frames.
    pub faults: Faults,
    /// When the nodes sample.
    pub pace: Pace,
    /// Draws clocks, boot ids and faults.
    pub seed: u64,
}

/// When simulated nodes sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pace {
    /// When the rows of the recording were sampled, by clocks that started at other times but run like the recording's: a crystal
    /// that is off samples at other moments, of which a recording has no rows.
    Recording,
    /// When their own crystals say, as on a board: every other node's is so many ppm fast, the others' as many slow. Rows are
    /// interpolated to these moments.
    Crystal {
        /// How far the crystals are off, in parts per million.
        ppm: f64,
        /// How much further as they warm and cool in the course of a day, each node's at hours of its own.
        swing_ppm: f64,
    },
}

impl Default for FleetOptions {
    /// Lines of 10 bits over a sound line of 115 200 baud.
    fn default() -> Self {
        Self {
            summary: Summary::Lines { bits: 10 },
            baud: 115_200,
            faults: Faults::default(),
            pace: Pace::Recording,
            seed: 1,
        }
    }
}

/// Why the fleet could not measure.
#[derive(Debug, Error)]
pub enum FleetError {
    /// The host's session with a node ended.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A node was not ready when the recording began.
    #[error("node {node} was not ready when the recording began: its line damages too many frames")]
    NotReady {
        /// The node.
        node: u16,
    },
    /// The settings cannot be expressed in a configuration.
    #[error(
        "decimation {decimation} with a segment of {segment} and {lines} lines from line {first_line} cannot be sent to a node"
    )]
    Settings {
        /// Raw samples a decimated one.
        decimation: u32,
        /// Decimated samples a segment.
        segment: usize,
        /// Index of the first line.
        first_line: usize,
        /// Number of lines.
        lines: usize,
    },
    /// A worker thread ended early.
    #[error("a simulated node stopped unexpectedly; this is a fault in belfry, please report it")]
    Worker,
}

/// What one node and its line did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NodeReport {
    /// The node.
    pub node: u16,
    /// Its channels.
    pub channels: usize,
    /// The host's side of the conversation.
    pub session: SessionStatistics,
    /// What the line did towards the host.
    pub to_host: LineStatistics,
    /// What the line did towards the node.
    pub to_node: LineStatistics,
}

/// What the fleet did.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FleetReport {
    /// One entry a node, by number.
    pub nodes: Vec<NodeReport>,
    /// Duration of the recording in s.
    pub duration_s: f64,
}

impl FleetReport {
    /// Bytes a second and channel on the wire towards the host, everything included.
    pub fn wire_bytes_per_second_and_channel(&self) -> f64 {
        let bytes: u64 = self.nodes.iter().map(|node| node.to_host.bytes).sum();
        let channels: usize = self.nodes.iter().map(|node| node.channels).sum();
        bytes as f64 / self.duration_s / channels as f64
    }
}

type Rows = Arc<[f64]>;

/// A fleet at work: give it rows, take its windows.
///
/// Nodes run on as many threads as there are processors; windows come out in the order of the grid.
pub struct Fleet {
    rows: Vec<SyncSender<Rows>>,
    windows: Receiver<Result<Feed, FleetError>>,
    workers: Vec<thread::JoinHandle<()>>,
    assembler: GridAssembler,
    channels: usize,
    row_count: u64,
    sampling_rate_hz: f64,
}

impl Fleet {
    /// Starts one node for every node number in the setup and brings them to measuring.
    pub fn start(setup: &Setup, decimation: u32, grid: &LineGrid, options: &FleetOptions) -> Result<Self, FleetError> {
        let settings = || FleetError::Settings {
            decimation,
            segment: grid.segment,
            first_line: grid.first_line,
            lines: grid.lines,
        };
        let stages = Stages::of(decimation).ok_or_else(settings)?;
        let lead_rows = u64::from(stages.first_full_output()) * u64::from(decimation);
        let channels_of = channels_by_node(setup);
        let workers = thread::available_parallelism().map_or(1, usize::from).min(channels_of.len().max(1));
        let mut nodes: Vec<Vec<NodeSettings>> = (0..workers).map(|_| Vec::new()).collect();
        for (index, (&number, channels)) in channels_of.iter().enumerate() {
            let configuration =
                node_configuration(setup.sampling_rate_hz, decimation, grid, channels.len(), options.summary)
                    .ok_or_else(settings)?;
            let channels = channels.clone();
            nodes[index % workers].push(NodeSettings { number, channels, configuration, lead_rows, options: *options });
        }
        let assembler = GridAssembler::new(*grid, setup.sensors.len(), channels_of);
        let (window_sender, windows) = channel();
        let (rows, workers) = nodes
            .into_iter()
            .map(|nodes| {
                let (sender, receiver) = sync_channel(BLOCKS_AHEAD);
                let results = window_sender.clone();
                let width = setup.sensors.len();
                (sender, thread::spawn(move || work(nodes, width, &receiver, &results)))
            })
            .unzip();
        Ok(Self {
            rows,
            windows,
            workers,
            assembler,
            channels: setup.sensors.len(),
            row_count: 0,
            sampling_rate_hz: setup.sampling_rate_hz,
        })
    }

    /// Takes rows (row-major, a value a channel, NaN where one is missing) and hands out windows that are whole.
    pub fn push(&mut self, rows: &[f64], on_window: &mut dyn FnMut(WindowLines)) -> Result<(), FleetError> {
        self.row_count += (rows.len() / self.channels.max(1)) as u64;
        let shared: Rows = rows.into();
        for sender in &self.rows {
            if sender.send(Arc::clone(&shared)).is_err() {
                break; // The worker's error is in the other channel.
            }
        }
        while let Ok(feed) = self.windows.try_recv() {
            self.take(feed?, on_window);
        }
        Ok(())
    }

    fn take(&mut self, feed: Feed, on_window: &mut dyn FnMut(WindowLines)) -> Option<NodeReport> {
        match feed {
            Feed::Window(window) => {
                self.assembler.add(*window, on_window);
                None
            }
            Feed::Done(report) => Some(report),
        }
    }

    /// Ends the recording, waits until everything is delivered, and hands out the remaining windows.
    pub fn finish(mut self, on_window: &mut dyn FnMut(WindowLines)) -> Result<FleetReport, FleetError> {
        self.rows.clear();
        let mut nodes = Vec::new();
        while let Ok(feed) = self.windows.recv() {
            nodes.extend(self.take(feed?, on_window));
        }
        for worker in self.workers.drain(..) {
            worker.join().map_err(|_| FleetError::Worker)?;
        }
        self.assembler.flush(on_window);
        nodes.sort_by_key(|node| node.node);
        Ok(FleetReport { nodes, duration_s: self.row_count as f64 / self.sampling_rate_hz })
    }
}

/// A worker's life: brings its nodes to measuring, feeds them, and waits for their last windows.
fn work(settings: Vec<NodeSettings>, width: usize, rows: &Receiver<Rows>, results: &Sender<Result<Feed, FleetError>>) {
    let run = || -> Result<(), FleetError> {
        // A receiver that has gone away wants no more results.
        let hand_over = |node: &mut SimulatedNode| {
            for window in node.take_windows() {
                let _ = results.send(Ok(Feed::Window(Box::new(window))));
            }
        };
        let mut nodes: Vec<SimulatedNode> = settings.into_iter().map(SimulatedNode::new).collect();
        for node in &mut nodes {
            node.prepare()?;
        }
        for block in rows {
            for node in &mut nodes {
                for row in block.chunks_exact(width) {
                    node.feed(row)?;
                }
                hand_over(node);
            }
        }
        for node in &mut nodes {
            let report = node.finish()?;
            hand_over(node);
            let _ = results.send(Ok(Feed::Done(report)));
        }
        Ok(())
    }();
    if let Err(error) = run {
        let _ = results.send(Err(error));
    }
}

#[cfg(test)]
mod tests;
