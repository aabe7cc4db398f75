//! A fleet of simulated nodes: the real firmware library, fed from a recording, talking over simulated serial lines.
//!
//! Rows of one setup flow in, windows of all its channels flow out, on the grid of host time. Every node has its own
//! boot time, its own line and, where it paces the rows, its own crystal; host and node run the code they run on a real port.

mod in_process;
mod node;
mod pace;
mod types;

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread;

use belfry_shared::decimation::Stages;

use crate::spectra::{LineGrid, WindowLines};
use crate::study::Setup;
use crate::window::{GridAssembler, NodeWindow, channels_by_node, node_configuration};
pub use in_process::InProcess;
use node::{Feed, NodeSettings, SimulatedNode};
pub use types::{FleetError, FleetOptions, NodeReport, Pace};

/// Blocks of rows that may wait for a worker.
const BLOCKS_AHEAD: usize = 4;

/// What the fleet did.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FleetReport {
    /// One entry a node, by number.
    pub nodes: Vec<NodeReport>,
    /// Duration of the recording in s.
    pub duration_s: f64,
}

impl FleetReport {
    /// Bytes per second and channel on the wire towards the host, everything included.
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
    /// Gets every node's windows as they came.
    copies: Option<Sender<NodeWindow>>,
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
            copies: None,
        })
    }

    /// Sends every node's windows there as well, as they came.
    pub fn with_windows_to(self, copies: Sender<NodeWindow>) -> Self {
        Self { copies: Some(copies), ..self }
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
                if let Some(copies) = &self.copies {
                    // Whoever has gone away wants none.
                    let _ = copies.send((*window).clone());
                }
                self.assembler.add(*window, on_window);
                None
            }
            Feed::Done(report) => Some(*report),
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
            let _ = results.send(Ok(Feed::Done(Box::new(report))));
        }
        Ok(())
    }();
    if let Err(error) = run {
        let _ = results.send(Err(error));
    }
}

#[cfg(test)]
mod tests;
