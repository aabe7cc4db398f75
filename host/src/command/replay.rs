//! `belfry replay`: a recording through nodes on real ports, and what comes back against the host's own computation.

mod progress;

use std::cell::Cell;
use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, bail};
use belfry_firmware::Identity;
use belfry_shared::message::{Configuration, MAX_CHANNELS, Summary};
use belfry_shared::time::HostTime;
use clap::Args;
use comfy_table::{Table, presets::UTF8_FULL_CONDENSED};
use serde::Serialize;

use super::Console;
use super::interrupt::stop_on_signal;
use crate::fleet::{FleetOptions, InProcess};
use crate::keys::Keys;
use crate::link::Transport;
use crate::link::port::{Port, is_remote, open_to_others};
use crate::link::replay::{Replayed, replay};
use crate::measure::{Material, Opened, Route, prepare};
use crate::record::{Block, Recording};
use crate::spectra::direct::Welch;
use crate::spectra::{LineGrid, SpectralPlan, WindowLines};
use crate::study::{Setup, Study};
use crate::window::{ChannelData, NodeWindow, channels_by_node, node_configuration};
use progress::FeedingProgress;

/// Play a recording through real nodes and check their results
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  belfry replay canton --port /dev/ttyACM0
  belfry replay canton --port /dev/ttyACM0 --nodes 1,2    a quicker check: these nodes only
  belfry replay canton --port tcp:127.0.0.1:5555          an emulated node

Each node of the study is played by the node on a port, one after the other where there are fewer ports than nodes; its own number does not matter. Samples go as fast as the node takes them. Belfry compares what comes back with the same firmware run on this computer, which must give the same bits, and with spectra made straight from the recording in double precision.

Ctrl-C ends it early: what came back until then is checked and reported, and the status is 1.")]
pub struct Arguments {
    /// The study's folder
    study: PathBuf,
    /// A port with a node: the name of a device, `tcp:HOST:PORT` or `unix:PATH`; repeat for more
    #[arg(long = "port", value_name = "PORT", required = true)]
    ports: Vec<String>,
    /// Baud rate of the ports
    #[arg(long, default_value_t = 115_200)]
    baud: u32,
    /// Nodes of the study that are played [default: all]
    #[arg(long, value_name = "NUMBERS", value_delimiter = ',')]
    nodes: Vec<u16>,
    /// Bits per component of the spectral lines
    #[arg(long, value_name = "BITS", default_value_t = 10, value_parser = clap::value_parser!(u8).range(3..=16))]
    bits: u8,
}

/// A node of the study to be played.
struct Role<'a> {
    setup: &'a Setup,
    folder: &'a std::path::Path,
    node: u16,
    channels: Vec<usize>,
    configuration: Configuration,
    grid: LineGrid,
    decimation: u32,
    /// Rows of its recording.
    rows: u64,
}

#[derive(Debug, Serialize)]
struct Played {
    setup: String,
    node: u16,
    port: String,
    rows: u64,
    /// Rows that the recording has.
    recording_rows: u64,
    seconds: f64,
    /// Seconds of the recording a second.
    times_real_time: f64,
    windows: usize,
    /// Windows that are those of the firmware on this computer, to the bit.
    identical: usize,
    /// Largest difference from lines in double precision, in shares of the largest line of the window.
    largest_difference: f64,
    repeated: u64,
    stack_free_bytes: Option<u32>,
    longest_step_us: Option<u32>,
    latest_sample_ns: Option<u32>,
    lost_rows: Option<u32>,
    dropped_frames: Option<u32>,
    /// Whether the node has no key.
    #[serde(skip)]
    is_open: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    /// Whether every recording was played to its end.
    complete: bool,
    nodes: Vec<Played>,
}

/// Runs the command.
///
/// # Errors
/// When the study, a recording or a port fails, it was interrupted, or a node's windows are not those of the firmware on this
/// computer.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let study = Study::load(&arguments.study)?;
    let prepared = prepare(&study, Route::Nodes(FleetOptions::default()))?;
    console.warn_all(&prepared.warnings);
    let mut roles = VecDeque::new();
    let mut total_rows = 0;
    for (&Opened { setup, ref material, rows }, &decimation) in prepared.setups.iter().zip(&prepared.plan.decimations) {
        if let Material::Archive(_) = material {
            console.warn(format_args!(
                "setup \"{}\" is left out: it was collected live, so there is no recording of it",
                setup.name
            ));
            continue;
        }
        let wanted = |node: &u16| arguments.nodes.is_empty() || arguments.nodes.contains(node);
        for (node, channels) in channels_by_node(setup).into_iter().filter(|(node, _)| wanted(node)) {
            let grid = prepared.plan.grid;
            let summary = Summary::Lines { bits: arguments.bits };
            let configuration = node_configuration(setup.sampling_rate_hz, decimation, &grid, channels.len(), summary)
                .with_context(|| {
                    format!(
                        "the settings of node {node} in setup \"{}\" do not fit into a node's configuration",
                        setup.name
                    )
                })?;
            total_rows += rows;
            roles.push_back(Role {
                setup,
                folder: &study.folder,
                node,
                channels,
                configuration,
                grid,
                decimation,
                rows,
            });
        }
    }
    if roles.is_empty() && arguments.nodes.is_empty() {
        bail!("no setup of the study has a recording");
    }
    if roles.is_empty() {
        bail!("the study has none of the nodes {}", list(&arguments.nodes));
    }
    let keys = Keys::load()?;
    let mut ports = Vec::new();
    for name in &arguments.ports {
        ports.push(Port::open(name, arguments.baud)?);
    }
    let stop = stop_on_signal()?;
    let roles_count = roles.len();
    let progress = FeedingProgress::new(total_rows, console);
    let queue = Mutex::new(roles);
    let played: Vec<anyhow::Result<Played>> = std::thread::scope(|scope| {
        let workers: Vec<_> =
            ports.iter_mut().map(|port| scope.spawn(|| work(port, &keys, &queue, &progress, &stop))).collect();
        let joined = |worker: std::thread::ScopedJoinHandle<'_, _>| -> Vec<_> {
            worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        };
        workers.into_iter().flat_map(joined).collect()
    });
    progress.end();
    let mut nodes = played.into_iter().collect::<anyhow::Result<Vec<_>>>()?;
    for node in nodes.iter().filter(|node| node.is_open && is_remote(&node.port)) {
        console.warn(open_to_others(&node.port));
    }
    nodes.sort_by(|a, b| (&a.setup, a.node).cmp(&(&b.setup, b.node)));
    tell(&nodes, console);
    let complete = nodes.len() == roles_count && nodes.iter().all(|node| node.rows >= node.recording_rows);
    let report = Report { complete, nodes };
    console.json("replay-1", &report)?;
    let sentence = verdict(&report, roles_count)?;
    console.say(sentence);
    Ok(())
}

/// What the comparison says, in a sentence.
fn verdict(report: &Report, roles: usize) -> anyhow::Result<String> {
    let Report { complete, nodes } = report;
    let differ = nodes.iter().filter(|node| node.identical < node.windows).count();
    let empty = nodes.iter().filter(|node| node.windows == 0).count();
    let windows: usize = nodes.iter().map(|node| node.windows).sum();
    if differ > 0 {
        bail!("{differ} nodes returned windows that differ from those that the same firmware computes here");
    }
    if !complete {
        let ended = nodes.iter().filter(|node| node.rows >= node.recording_rows).count();
        bail!(
            "interrupted after {ended} of {roles} nodes: all {windows} windows that came until then have the same bits as on this computer"
        );
    }
    if empty > 0 {
        bail!("{empty} nodes gave no window: the recording is shorter than one segment");
    }
    Ok(format!("All {windows} windows have the same bits as on this computer."))
}

fn list(nodes: &[u16]) -> String {
    nodes.iter().map(u16::to_string).collect::<Vec<_>>().join(", ")
}

/// Plays roles on a port until there are none left.
fn work(
    port: &mut Port,
    keys: &Keys,
    queue: &Mutex<VecDeque<Role<'_>>>,
    progress: &FeedingProgress,
    stop: &AtomicBool,
) -> Vec<anyhow::Result<Played>> {
    let mut played = Vec::new();
    while !stop.load(Ordering::Relaxed) {
        let next = queue.lock().map_or(None, |mut queue| queue.pop_front());
        let Some(role) = next else { return played };
        let result = play(port, keys, &role, progress, stop)
            .with_context(|| format!("setup \"{}\", node {}, played on {}", role.setup.name, role.node, port.name()));
        let failed = result.is_err();
        played.push(result);
        if failed {
            break;
        }
    }
    played
}

fn play(
    port: &mut Port,
    keys: &Keys,
    role: &Role<'_>,
    progress: &FeedingProgress,
    stop: &AtomicBool,
) -> anyhow::Result<Played> {
    let name = port.name().to_owned();
    let mut fed = 0;
    let mut on_rows = |rows: u64| {
        progress.add(rows.saturating_sub(fed));
        fed = rows.max(fed);
    };
    let wanted = || !stop.load(Ordering::Relaxed);
    let on_board = through(port, keys, role, &wanted, &mut on_rows)?;
    let identity = Identity {
        node: on_board.hello.node,
        boot: on_board.hello.boot,
        channels: MAX_CHANNELS as u8,
        full_scale_m_s2: f32::INFINITY,
        highest_rate_mhz: u32::MAX,
    };
    // As many rows as the board has taken, where it was stopped before the end.
    let left = Cell::new(on_board.rows);
    let is_left = || left.replace(left.get().saturating_sub(1)) > 0;
    let here = through(&mut InProcess::new(identity), &Keys::default(), role, &is_left, &mut |_| {})?;
    let same = |pair: &(&NodeWindow, &NodeWindow)| {
        let (board, here) = pair;
        (board.grid_index, board.middle_offset_us, &board.channels)
            == (here.grid_index, here.middle_offset_us, &here.channels)
    };
    let identical = on_board.windows.iter().zip(&here.windows).filter(same).count();
    let identical = if on_board.windows.len() == here.windows.len() { identical } else { 0 };
    let seconds = on_board.took.as_secs_f64();
    let board = on_board.heartbeat.as_ref().map(|heartbeat| heartbeat.board);
    Ok(Played {
        setup: role.setup.name.clone(),
        node: role.node,
        port: name,
        rows: on_board.rows,
        recording_rows: role.rows,
        seconds,
        times_real_time: on_board.rows as f64 / role.setup.sampling_rate_hz / seconds.max(1e-9),
        windows: on_board.windows.len(),
        identical,
        largest_difference: largest_difference(role, &on_board.windows)?,
        repeated: on_board.repeated,
        stack_free_bytes: board.map(|board| board.stack_free_bytes),
        longest_step_us: board.map(|board| board.longest_step_us),
        latest_sample_ns: board.map(|board| board.latest_sample_ns),
        lost_rows: on_board.heartbeat.as_ref().map(|heartbeat| heartbeat.lost_rows),
        dropped_frames: board.map(|board| board.dropped_frames),
        is_open: on_board.hello.counters.is_none(),
    })
}

/// Plays a role, row by row as long as `wanted` says so.
fn through(
    transport: &mut dyn Transport,
    keys: &Keys,
    role: &Role<'_>,
    wanted: &dyn Fn() -> bool,
    on_rows: &mut dyn FnMut(u64),
) -> anyhow::Result<Replayed> {
    let mut failure = None;
    let rows =
        Rows::open(role)?.take_while(|_| wanted()).map_while(|row| row.map_err(|error| failure = Some(error)).ok());
    let replayed = replay(transport, keys, &role.configuration, start(role), rows, on_rows)?;
    match failure {
        Some(error) => Err(error.into()),
        None => Ok(replayed),
    }
}

/// When row 0 was sampled: so that the first decimated sample whose filter lies within the recording is at the epoch.
fn start(role: &Role<'_>) -> HostTime {
    let lead_s = SpectralPlan::lead_rows(role.decimation) as f64 / role.setup.sampling_rate_hz;
    HostTime(-(lead_s * 1e6).round() as i64)
}

/// Rows of a role's channels, as nodes get them.
struct Rows {
    recording: Recording,
    block: Block,
    next: usize,
    channels: Vec<usize>,
}

impl Rows {
    fn open(role: &Role<'_>) -> anyhow::Result<Self> {
        let recording = Recording::open(role.setup, role.folder)?;
        Ok(Self { recording, block: Block::new(), next: 0, channels: role.channels.clone() })
    }
}

impl Iterator for Rows {
    type Item = Result<Vec<f32>, crate::record::RecordError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.next == self.block.row_count() {
            match self.recording.next_block(&mut self.block) {
                Ok(true) => self.next = 0,
                Ok(false) => return None,
                Err(error) => return Some(Err(error)),
            }
        }
        let width = self.block.channels();
        let row = self.block.values().get(self.next * width..(self.next + 1) * width)?;
        self.next += 1;
        Some(Ok(self
            .channels
            .iter()
            .map(|&channel| row.get(channel).map_or(f32::NAN, |value| *value as f32))
            .collect()))
    }
}

/// How far windows are off those made in double precision.
fn largest_difference(role: &Role<'_>, windows: &[NodeWindow]) -> anyhow::Result<f64> {
    let mut welch = Welch::new(role.grid, role.decimation, role.channels.len())
        .with_context(|| format!("decimation {} cannot be split", role.decimation))?;
    let mut exact: BTreeMap<u64, WindowLines> = BTreeMap::new();
    for row in Rows::open(role)? {
        let row: Vec<f64> = row?.into_iter().map(f64::from).collect();
        welch.push(&row, &mut |window| drop(exact.insert(window.grid_index, window)));
    }
    let mut largest = 0.0_f64;
    for window in windows {
        let Some(exact) = exact.get(&window.grid_index) else { continue };
        for (data, lines) in window.channels.iter().zip(&exact.channels) {
            let (ChannelData::Lines(found), Some(lines)) = (data, lines) else { continue };
            let scale = lines.iter().map(|line| line.norm()).fold(f32::MIN_POSITIVE, f32::max);
            let off = found.iter().zip(lines).map(|(found, line)| (found - line).norm()).fold(0.0, f32::max);
            largest = largest.max(f64::from(off / scale));
        }
    }
    Ok(largest)
}

fn tell(nodes: &[Played], console: &Console) {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED);
    table.set_header([
        "setup",
        "node",
        "port",
        "rows",
        "x real time",
        "windows",
        "same bits",
        "off double precision",
        "said again",
    ]);
    for node in nodes {
        table.add_row([
            node.setup.clone(),
            node.node.to_string(),
            node.port.clone(),
            node.rows.to_string(),
            format!("{:.0}", node.times_real_time),
            node.windows.to_string(),
            node.identical.to_string(),
            format!("{:.1e}", node.largest_difference),
            node.repeated.to_string(),
        ]);
    }
    console.say(table);
    for node in nodes {
        if let Some(free) = node.stack_free_bytes.filter(|&free| free > 0) {
            console.say(format!("Node {}: {free} bytes of its stack were never used.", node.node));
        }
        // Zero where it has not sampled since its start.
        if let Some(latest_ns) = node.latest_sample_ns.filter(|&latest_ns| latest_ns > 0) {
            let (latest_us, lost) = (f64::from(latest_ns) * 1e-3, node.lost_rows.unwrap_or(0));
            console.say(format!(
                "Node {}: with its sensor, since its start, samples were fetched {latest_us:.1} µs late at most; samples lost: {lost}.",
                node.node
            ));
        }
    }
}
