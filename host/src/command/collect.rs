//! `belfry collect`: windows of a live setup, from its nodes into the study's archive.

mod view;

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use belfry_shared::message::{Configuration, SensorState, Summary};
use belfry_shared::time::HostTime;
use clap::Args;
use serde::Serialize;

use super::Console;
use crate::archive::{Archive, Collected};
use crate::link::Configurations;
use crate::link::collect::{Collection, PortStatus, collect, unix_time};
use crate::link::fleet::{channels_by_node, node_configuration, node_lines};
use crate::link::port::serial_ports;
use crate::spectra::{LineGrid, SetupExtent, SpectralPlan};
use crate::study::{Analysis, Setup, Study};
use view::View;

/// Hours that are measured where nothing is said.
const HOURS: f64 = 24.0;
/// Bits a component where nothing is said: frequencies within 0.0002 %.
const BITS: u8 = 10;

const EXAMPLES: &str = "Examples:
  belfry collect tower                                 every node on a serial port, also one that comes later
  belfry collect tower --port /dev/ttyACM0 --port /dev/ttyACM1
  belfry collect tower --port tcp:10.0.0.7:4001        a node behind a serial server
  belfry collect tower --for 12h                       then stop
  belfry collect tower --setup upper                   where the study has several live setups

The setup stands in study.toml with `live = true` instead of `files`; its sensors say which node samples them, channel by
channel in the order in which they stand there. [analysis] needs band_hz: nodes must know it before there are data. The
segment is the finest that leaves enough averages after --hours, unless [analysis] says one.

Windows go into the study's archive.sqlite. A node forgets a window only when it is on this disk, and keeps the others as
long as it has room, so collecting can be stopped and started again at any time. While it runs, `belfry identify`,
`belfry compare` and the rest work on what has come so far.";

/// Collect windows from nodes into the study's archive, until stopped
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    study: PathBuf,
    /// A port to collect from: a device, `tcp:HOST:PORT` or `unix:PATH`; several times for several [default: all serial ports]
    #[arg(long = "port", value_name = "PORT")]
    ports: Vec<String>,
    /// Baud rate of serial ports
    #[arg(long, default_value_t = 115_200)]
    baud: u32,
    /// The live setup to collect, where the study has several
    #[arg(long, value_name = "NAME")]
    setup: Option<String>,
    /// Stop after this time, such as 12h, 30min or 40s
    #[arg(long = "for", value_name = "DURATION", value_parser = duration)]
    duration: Option<Duration>,
    /// Hours that will be measured, for the choice of the segment when collecting begins [default: 24]
    #[arg(long, value_name = "HOURS", value_parser = hours)]
    hours: Option<f64>,
    /// Drop windows that nodes still hold for another study, instead of leaving such nodes alone
    #[arg(long)]
    drop_foreign: bool,
    /// Bits a component of the spectral lines [default: 10, or what was collected with before]
    #[arg(long, value_name = "BITS", value_parser = clap::value_parser!(u8).range(3..=16))]
    bits: Option<u8>,
}

fn duration(text: &str) -> Result<Duration, String> {
    humantime::parse_duration(text).map_err(|error| format!("{error}; expected a time such as 12h, 30min or 40s"))
}

fn hours(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(hours) if hours > 0.0 && hours <= 1e5 => Ok(hours),
        _ => Err("expected hours, a number above 0".to_owned()),
    }
}

/// What `--json` prints when collecting has ended.
#[derive(Debug, Serialize)]
struct Report {
    setup: String,
    archive: PathBuf,
    collected_s: f64,
    /// Starts at which the archive now holds a window of at least one node.
    windows_in_archive: usize,
    ports: Vec<PortReport>,
}

#[derive(Debug, Serialize)]
struct PortReport {
    port: String,
    node: Option<u16>,
    state: String,
    windows: u64,
    windows_with_gaps: u64,
    /// Windows of the node's life since the archive first met it that no longer exist anywhere, also before this run.
    lost_windows: u64,
    foreign_windows: u64,
    lost_rows: u32,
    /// Messages to the node that came faster than it could take them.
    dropped_frames: u32,
    damaged_frames: u64,
    bytes_received: u64,
    clock_drift_ppm: Option<f64>,
    level_m_s2: Vec<f32>,
    /// What is wrong with each channel's sensor; nothing where it is sound.
    sensors: Vec<Option<String>>,
    peaks_hz: Vec<f64>,
    last_fault: Option<String>,
}

/// What a setup's nodes are to measure.
struct Settings {
    grid: LineGrid,
    decimation: u32,
    bits: u8,
    /// Why, in a line.
    reason: String,
}

/// Runs the command.
///
/// # Errors
/// When the study has no live setup, its nodes cannot be told what to measure, no port can be used, or the archive cannot be
/// written.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let study = Study::load(&arguments.study)?;
    let setup = live_setup(&study, arguments.setup.as_deref())?;
    let ports = ports(&arguments.ports)?;
    // A node may be plugged in later, and a cable that is pulled may come back under another name.
    let list_ports = || if arguments.ports.is_empty() { all_ports().unwrap_or_default() } else { ports.clone() };
    let mut archive = Archive::create(&study.folder)?;
    let settings = settings(&study, setup, &archive, arguments)?;
    let nodes = configurations(setup, &settings, &mut archive)?;
    let view = View::new(setup, &settings.grid, settings.decimation, console);
    let numbers: Vec<String> = nodes.keys().map(u16::to_string).collect();
    console.say(format!("Setup \"{}\", nodes {}. {}", setup.name, numbers.join(", "), settings.reason));
    console.say(format!(
        "Windows go to {}. Ctrl-C stops; nodes keep what they have not delivered, as long as they have room.\n",
        archive.file().display()
    ));
    let stop = stop_on_signal()?;
    let collection = Collection {
        setup: setup.name.clone(),
        baud: arguments.baud,
        nodes,
        drop_foreign: arguments.drop_foreign,
        unix_time,
    };
    let start = Instant::now();
    let statuses = collect(&collection, archive, &stop, &list_ports, &mut |statuses| {
        view.show(statuses);
        let is_over = arguments.duration.is_some_and(|duration| start.elapsed() >= duration);
        if is_over { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    view.end();
    let statuses = statuses?;
    let archive = Archive::open(&study.folder)?.context("the archive has gone")?;
    let file = archive.file().to_owned();
    let windows = archive.collected(setup)?.map_or(0, |Collected { setup, .. }| setup.windows);
    console.json(&Report {
        setup: setup.name.clone(),
        archive: file,
        collected_s: start.elapsed().as_secs_f64(),
        windows_in_archive: windows,
        ports: statuses.iter().map(|status| port_report(status, &view)).collect(),
    })?;
    console.say(view.text(&statuses));
    let stored: u64 = statuses.iter().map(|status| status.statistics.windows).sum();
    let gaps: u64 = statuses.iter().map(|status| status.gaps.windows).sum();
    console.say(format!(
        "{stored} windows of nodes have come, {gaps} of them with gaps; the archive now has {windows} windows of this setup."
    ));
    if stored == 0 && statuses.iter().all(|status| status.state.is_useless()) {
        let reasons: Vec<String> = statuses.iter().map(|status| view.state_in_words(status)).collect();
        bail!("no port has a node that can be used: {}", reasons.join("; "));
    }
    if statuses.iter().all(|status| status.node.is_none()) {
        bail!("no node has answered on {}", ports.join(", "));
    }
    if windows > 0 && (stored == 0 || gaps < stored) {
        console.say(format!("Next: belfry identify {}", study.folder.display()));
    }
    Ok(())
}

fn live_setup<'a>(study: &'a Study, name: Option<&str>) -> anyhow::Result<&'a Setup> {
    let live: Vec<&Setup> = study.setups.iter().filter(|setup| setup.live).collect();
    let names = || live.iter().map(|setup| format!("\"{}\"", setup.name)).collect::<Vec<_>>().join(", ");
    match (name, live.as_slice()) {
        (_, []) => bail!(
            "the study has no live setup: write `live = true` instead of `files` into the [[setup]] of {} that nodes measure",
            study.folder.join("study.toml").display()
        ),
        (None, [setup]) => Ok(setup),
        (None, _) => bail!("the study has several live setups, {}: say which with --setup", names()),
        (Some(name), live) => {
            let found = live.iter().find(|setup| setup.name == name);
            found.copied().with_context(|| format!("\"{name}\" is no live setup of the study; these are: {}", names()))
        }
    }
}

/// The ports that are named, or all that there are.
fn ports(named: &[String]) -> anyhow::Result<Vec<String>> {
    if !named.is_empty() {
        let mut ports = named.to_vec();
        ports.sort();
        ports.dedup();
        return Ok(ports);
    }
    let ports = all_ports()?;
    if ports.is_empty() {
        bail!("there is no serial port; is the board's USB cable one that carries data? `--port` names others");
    }
    Ok(ports)
}

fn all_ports() -> std::io::Result<Vec<String>> {
    Ok(serial_ports()?.into_iter().map(|(name, _)| name).collect())
}

/// What the setup's nodes are to measure: as before where [analysis] still asks for that, else what suits it.
fn settings(study: &Study, setup: &Setup, archive: &Archive, arguments: &Arguments) -> anyhow::Result<Settings> {
    let Some(band_hz) = study.analysis.band_hz else {
        bail!(
            "nodes must know the band before there are data: give band_hz in [analysis] of {}, such as band_hz = [0.05, 1.5]",
            study.folder.join("study.toml").display()
        );
    };
    let rows = (arguments.hours.unwrap_or(HOURS) * 3600.0 * setup.sampling_rate_hz) as u64;
    let extent = SetupExtent { sampling_rate_hz: setup.sampling_rate_hz, rows, channels: setup.sensors.len() };
    let before = archive.configurations(Some(&setup.name))?;
    // Another setup of the study, that was collected before, fixes the lines as well: they are analysed together.
    let others = study.setups.iter().filter(|other| other.live && other.name != setup.name);
    let mut candidates = before.clone();
    for other in others {
        candidates.extend(archive.configurations(Some(&other.name))?.into_iter().take(1));
    }
    for known in &candidates {
        let (Summary::Lines { bits }, Some((lines, _))) = (known.summary, node_lines(known)) else { continue };
        let rate_hz = lines.sampling_rate_hz;
        let asks_for_it = study.analysis.segment.is_none_or(|segment| segment == lines.segment)
            && study.analysis.decimated_rate_hz.is_none_or(|wanted| (wanted / rate_hz - 1.0).abs() < 1e-6);
        let analysis =
            Analysis { decimated_rate_hz: Some(rate_hz), segment: Some(lines.segment), ..study.analysis.clone() };
        let long = SetupExtent { rows: u64::MAX >> 16, ..extent };
        let Ok(plan) = SpectralPlan::choose(&[long], &analysis) else { continue };
        let (grid, decimation) = (plan.grid, plan.decimations.first().copied().unwrap_or(1));
        let bits = arguments.bits.unwrap_or(bits);
        let channels = usize::from(known.channels);
        let same = node_configuration(setup.sampling_rate_hz, decimation, &grid, channels, known.summary);
        if asks_for_it && same.as_ref() == Some(known) {
            let mut reason = format!("As collected before: {}", in_words(&grid, bits));
            if arguments.hours.is_some() && study.analysis.segment.is_none() {
                reason += " (--hours counts for a first choice; another segment = ... in [analysis] begins anew.)";
            }
            return Ok(Settings { grid, decimation, bits, reason });
        }
    }
    let plan = SpectralPlan::choose(&[extent], &study.analysis)?;
    let (grid, decimation) = (plan.grid, plan.decimations.first().copied().unwrap_or(1));
    let bits = arguments.bits.unwrap_or(BITS);
    let mut reason = in_words(&grid, bits);
    if !before.is_empty() {
        reason += &format!(
            "\nThe setup or its [analysis] (band {} to {} Hz, segment, rate) asks for other lines than were collected before: what came before stays in the archive, but cannot be averaged with what comes now.",
            band_hz[0], band_hz[1]
        );
    }
    Ok(Settings { grid, decimation, bits, reason })
}

fn in_words(grid: &LineGrid, bits: u8) -> String {
    let segment_s = 1.0 / grid.spacing_hz();
    format!(
        "Segments of {} points at {} Hz, {} s, and a window every {} s; {} lines from {:.4} to {:.4} Hz in {bits} bits.",
        grid.segment,
        // To a ten-thousandth, without zeros.
        (grid.sampling_rate_hz * 1e4).round() / 1e4,
        view::seconds(segment_s),
        view::seconds(0.5 * segment_s),
        grid.lines,
        grid.frequency_hz(0),
        grid.frequency_hz(grid.lines.saturating_sub(1)),
    )
}

/// Each node's configurations; what is asked now is noted in the archive.
fn configurations(
    setup: &Setup,
    settings: &Settings,
    archive: &mut Archive,
) -> anyhow::Result<BTreeMap<u16, Configurations>> {
    // Of other setups too: a node that was carried over may still have windows of the one before.
    let earlier = archive.configurations(None)?;
    let now = HostTime(i64::try_from(unix_time().as_micros()).unwrap_or(i64::MAX));
    let mut nodes = BTreeMap::new();
    for (node, channels) in channels_by_node(setup) {
        let summary = Summary::Lines { bits: settings.bits };
        let current: Configuration =
            node_configuration(setup.sampling_rate_hz, settings.decimation, &settings.grid, channels.len(), summary)
                .with_context(|| format!("node {node} cannot be told these settings"))?;
        let names: Vec<&str> = channels.iter().map(|&channel| setup.sensors[channel].channel.as_str()).collect();
        archive.ask(&setup.name, node, &current, &names, now)?;
        nodes.insert(node, Configurations { current, earlier: earlier.clone() });
    }
    Ok(nodes)
}

/// A flag that Ctrl-C and the system's request to end set.
fn stop_on_signal() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed)).context("Ctrl-C cannot be waited for")?;
    Ok(stop)
}

fn port_report(status: &PortStatus, view: &View) -> PortReport {
    let heartbeat = status.heartbeat.as_ref();
    PortReport {
        port: status.port.clone(),
        node: status.node,
        state: view.state_in_words(status),
        windows: status.statistics.windows,
        windows_with_gaps: status.gaps.windows,
        lost_windows: status.statistics.lost_windows,
        foreign_windows: status.statistics.foreign_windows,
        lost_rows: heartbeat.map_or(0, |heartbeat| heartbeat.lost_rows),
        dropped_frames: heartbeat.map_or(0, |heartbeat| heartbeat.board.dropped_frames),
        damaged_frames: status.statistics.damaged_frames,
        bytes_received: status.statistics.bytes_received,
        clock_drift_ppm: status.drift_ppm,
        level_m_s2: heartbeat.map_or_else(Vec::new, |heartbeat| heartbeat.level.to_vec()),
        sensors: heartbeat.map_or_else(Vec::new, |heartbeat| {
            heartbeat.sensors.iter().map(|&state| (state != SensorState::Sound).then(|| state.to_string())).collect()
        }),
        peaks_hz: status.peaks_hz.clone(),
        last_fault: status.hello.as_ref().and_then(|hello| hello.fault.as_ref()).map(ToString::to_string),
    }
}
