//! `belfry calibrate`: what a sensor's axes read at rest, by laying it on its six faces.

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use belfry_shared::message::{Calibration, Hello};
use belfry_shared::time::HostTime;
use clap::Args;
use serde::Serialize;

use super::Console;
use super::interrupt::{alone, stop_on_signal};
use super::route::in_range;
use super::text::Columns;
use crate::archive::moment;
use crate::calibrate::{
    AXES, Axis, Calibrated, Face, Gravity, Step, Still, Tumble, cells_of, entries, fit, from_node, still, to_node,
};
use crate::collect::{Clock, SystemClock};
use crate::keys::Keys;
use crate::link::port::Port;
use crate::link::{Transport, who_is_there};
use crate::study::edit::{CalibrationEntry, set_calibration};
use crate::study::{Setup, Study};

const EXAMPLES: &str = "Examples:
  belfry calibrate tower --port /dev/ttyACM0 --latitude 52.5
  belfry calibrate tower --recording tumble.csv --channels x,y,z --gravity 9.8127
  belfry calibrate tower --port /dev/ttyACM0 --read      what the node has kept

Lay the sensor on each of its six faces, in any order, and leave it there for ten seconds without touching the table. Belfry finds the times when it lay still and the axis that points up, and fits gains and offsets of the three axes to gravity. A face need only be level to a degree or so (--level): half of the tilt shows in the other two axes and is corrected for, the rest is in the deviations.

Gravity is standard gravity (9.80665 m/s²) unless --gravity or --latitude says better; it is up to 0.27 % off, which all gains then share. Shapes do not change by what all sensors share.

Writes gain, gain_std and offset_m_s2 of the sensors into study.toml; an acceleration is (reading - offset) × gain. The node keeps the values as well, over restarts where it has a memory chip, for other studies to read. It never applies them: what is in study.toml is applied, once, also to windows that were collected before.";

/// Find the gains and offsets of a sensor by laying it on its six faces
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    study: PathBuf,
    /// The node's port: a device, `tcp:HOST:PORT` or `unix:PATH`
    #[arg(long, value_name = "PORT", required_unless_present = "recording", conflicts_with = "recording")]
    port: Option<String>,
    /// Baud rate of a serial port
    #[arg(long, default_value_t = 115_200)]
    baud: u32,
    /// A recording of the tumble instead of a node, in any format that a setup's files may have
    #[arg(long, value_name = "FILE")]
    recording: Option<PathBuf>,
    /// The recording's three channels, X, Y and Z [default: those of the setup, where it has three]
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', requires = "recording")]
    channels: Vec<String>,
    /// Only sensors of this setup, whose unit and sampling rate a recording has as well [default: of all setups]
    #[arg(long, value_name = "NAME")]
    setup: Option<String>,
    /// Local gravity in m/s²
    #[arg(long, value_name = "M/S2", value_parser = gravity)]
    gravity: Option<f64>,
    /// Latitude in degrees, by which gravity is known to 0.01 %
    #[arg(long, value_name = "DEG", value_parser = latitude, allow_negative_numbers = true, conflicts_with = "gravity")]
    latitude: Option<f64>,
    /// Height above the sea in metres, with --latitude
    #[arg(long, value_name = "M", default_value_t = 0.0, allow_negative_numbers = true, requires = "latitude")]
    height: f64,
    /// How far from level a face may lie, in degrees (standard deviation in each direction)
    #[arg(long, value_name = "DEG", default_value_t = 1.0, value_parser = level)]
    level: f64,
    /// Take what the node has kept, instead of tumbling it
    #[arg(long, requires = "port")]
    read: bool,
    /// Only say what was found: study.toml and the node stay as they are
    #[arg(long)]
    dry_run: bool,
    /// Drop windows that the node still holds for a study
    #[arg(long, requires = "port")]
    drop_foreign: bool,
}

fn gravity(text: &str) -> Result<f64, String> {
    // From the top of the highest mountain near the equator to the poles.
    in_range(text, 9.7..=9.9, "gravity on the ground, from 9.7 to 9.9 m/s²")
}

fn latitude(text: &str) -> Result<f64, String> {
    in_range(text, -90.0..=90.0, "degrees from -90 to 90")
}

fn level(text: &str) -> Result<f64, String> {
    in_range(text, 0.01..=10.0, "degrees from 0.01 to 10")
}

/// Time after which a tumble of which nothing more comes is given up.
const LONGEST: Duration = Duration::from_secs(900);
/// How long a port is asked who is there.
const PATIENCE: Duration = Duration::from_secs(3);
/// The loop looks this often, whatever comes.
const LOOK: Duration = Duration::from_millis(50);
/// Below this probability the faces were less level than was said.
const UNLIKELY: f64 = 1e-3;

#[derive(Debug, Serialize)]
struct Report {
    node: Option<u16>,
    gravity_m_s2: Option<f64>,
    gravity_std_m_s2: Option<f64>,
    level_deg: Option<f64>,
    seen_level_deg: Option<f64>,
    axes: Vec<AxisReport>,
    /// Sensors whose values are in study.toml now, as setup and channel.
    written: Vec<[String; 2]>,
    kept_by_node: bool,
    found_at: Option<String>,
}

#[derive(Debug, Serialize)]
struct AxisReport {
    axis: &'static str,
    gain: f64,
    gain_std: f64,
    offset_m_s2: f64,
    offset_std_m_s2: Option<f64>,
    cross_axis: Option<[f64; 3]>,
    cross_axis_std: Option<[f64; 3]>,
}

impl AxisReport {
    fn of(name: &'static str, axis: &Axis) -> Self {
        Self {
            axis: name,
            gain: axis.gain,
            gain_std: axis.gain_std,
            offset_m_s2: axis.offset_m_s2,
            offset_std_m_s2: Some(axis.offset_std_m_s2),
            cross_axis: Some(axis.cross),
            cross_axis_std: Some(axis.cross_std),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// When the port or the recording cannot be used, a face is missing, no sensor of the study is meant, or study.toml cannot be changed.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let study = Study::load(&arguments.study)?;
    let setups = setups(&study, arguments)?;
    let gravity = gravity_of(arguments);
    match (&arguments.port, &arguments.recording) {
        (Some(port), _) => of_node(arguments, port, &study, &setups, gravity, console),
        (None, Some(file)) => {
            let setup = setups.first().context("the study has no setup")?;
            let names = channels(arguments, setup)?;
            let names = names.each_ref().map(String::as_str);
            let found = still(&cells_of(file, setup, names)?, gravity.value_m_s2);
            let calibrated = fit(&found, gravity, arguments.level)?;
            let entries = entries(&setups, names, &calibrated.axes);
            if entries.is_empty() {
                bail!("no sensor of the study has a channel named {}", names.join(", "));
            }
            say(&calibrated, &found, console);
            let written = write(arguments, &study, &entries, console)?;
            console.json("calibrate-1", &report(None, &calibrated, written, false))
        }
        (None, None) => bail!("name a --port, or a --recording"),
    }
}

fn setups<'s>(study: &'s Study, arguments: &Arguments) -> anyhow::Result<Vec<&'s Setup>> {
    let all: Vec<&Setup> = study.setups.iter().collect();
    let Some(name) = &arguments.setup else { return Ok(all) };
    let named: Vec<&Setup> = all.iter().filter(|setup| setup.name == *name).copied().collect();
    if named.is_empty() {
        let names: Vec<String> = all.iter().map(|setup| format!("\"{}\"", setup.name)).collect();
        bail!("the study has no setup \"{name}\"; these are: {}", names.join(", "));
    }
    Ok(named)
}

fn gravity_of(arguments: &Arguments) -> Gravity {
    match (arguments.gravity, arguments.latitude) {
        (Some(value), _) => Gravity::measured(value),
        (None, Some(latitude)) => Gravity::at(latitude, arguments.height),
        (None, None) => Gravity::standard(),
    }
}

fn channels(arguments: &Arguments, setup: &Setup) -> anyhow::Result<[String; 3]> {
    let given = &arguments.channels;
    let own: Vec<String> = setup.sensors.iter().map(|sensor| sensor.channel.clone()).collect();
    let meant = if given.is_empty() { own } else { given.clone() };
    meant.try_into().map_err(|other: Vec<String>| match given.len() {
        0 => anyhow!(
            "setup \"{}\" has {} channels: say with --channels which three are X, Y and Z of the sensor",
            setup.name,
            other.len()
        ),
        count => anyhow!("--channels names {count} channels, where X, Y and Z of one sensor are needed"),
    })
}

/// A node on a port: tumbled, or asked what it has kept.
fn of_node(
    arguments: &Arguments,
    port: &str,
    study: &Study,
    setups: &[&Setup],
    gravity: Gravity,
    console: &Console,
) -> anyhow::Result<()> {
    let mut line = Port::open(port, arguments.baud)?;
    let hello = who_is_there(&mut line, PATIENCE).with_context(|| format!("no node to calibrate on {port}"))?;
    let node = hello.node;
    if !setups.iter().any(|setup| setup.sensors.iter().any(|sensor| sensor.node == node)) {
        bail!("node {node} answers on {port}, and no sensor of the study has `node = {node}`");
    }
    if arguments.read {
        return read(arguments, study, setups, &hello, console);
    }
    let keys = Keys::load()?;
    let start = SystemClock::new();
    let unix = start.unix();
    let clock = || HostTime::since_epoch(unix + start.steady());
    let key = keys.of(node).cloned();
    let mut tumble = Tumble::new(&hello, arguments.baud, key, arguments.drop_foreign, gravity.value_m_s2)?;
    console.say(format!(
        "Node {node}. Lay it on each of its six faces, in any order, and leave it for ten seconds each time."
    ));
    let Some(found) = lie_down(&mut tumble, &clock, &mut line, console)? else { return Ok(()) };
    let calibrated = fit(&found, gravity, arguments.level)?;
    say(&calibrated, &found, console);
    let kept = to_node(&calibrated.axes, clock());
    let entries = from_node(setups, node, &kept);
    let written = write(arguments, study, &entries, console)?;
    if !arguments.dry_run {
        tumble.tell(&kept, &clock, &mut line, &mut |line, time| {
            // A line that fails says so when it is read.
            let _ = line.wait(time);
        })?;
        console.say(format!("Node {node} keeps the values too (over a restart only where it has a memory chip)."));
    }
    console.json("calibrate-1", &report(Some(node), &calibrated, written, !arguments.dry_run))
}

/// Follows the node over its faces; `None` where it is interrupted.
fn lie_down(
    tumble: &mut Tumble,
    clock: &dyn Fn() -> HostTime,
    line: &mut Port,
    console: &Console,
) -> anyhow::Result<Option<Vec<Still>>> {
    let stop = stop_on_signal()?;
    let begun = clock();
    let mut told = [false; 6];
    while !stop.load(Ordering::Relaxed) {
        match tumble.step(clock, line)? {
            Step::Done(found) => return Ok(Some(found)),
            Step::Preparing => {}
            Step::Lying(seconds) => {
                for ((face, seconds), told) in Face::ALL.into_iter().zip(seconds).zip(&mut told) {
                    if seconds >= Tumble::ENOUGH_S && !*told {
                        *told = true;
                        console.say(format!("{face} is done."));
                    }
                }
            }
        }
        if clock().0.saturating_sub(begun.0) > LONGEST.as_micros() as i64 {
            // Says which faces are missing.
            return Ok(Some(tumble.found()));
        }
        let due_us = tumble.next_due().0.saturating_sub(clock().0);
        line.wait(LOOK.min(Duration::from_micros(u64::try_from(due_us).unwrap_or(0)).max(Duration::from_millis(1))))?;
    }
    Ok(None)
}

/// Takes what a node has kept into study.toml.
fn read(
    arguments: &Arguments,
    study: &Study,
    setups: &[&Setup],
    hello: &Hello,
    console: &Console,
) -> anyhow::Result<()> {
    let Some(calibration) = &hello.calibration else {
        bail!("node {} keeps no calibration: tumble it, without --read", hello.node);
    };
    let Calibration { time, axes } = calibration;
    let entries = from_node(setups, hello.node, calibration);
    let mut table = Columns::new(["axis", "gain", "±", "offset m/s²"]);
    for (name, axis) in AXES.iter().zip(axes) {
        let numbers = [axis.gain(), axis.gain_std(), axis.offset_m_s2()].map(|value| format!("{value:.6}"));
        table.row([(*name).to_owned()].into_iter().chain(numbers));
    }
    console.say(format!("Node {}, calibrated on {}:\n{table}", hello.node, moment(time.0)));
    let written = write(arguments, study, &entries, console)?;
    let axis = |(name, axis): (&&'static str, &belfry_shared::message::AxisCalibration)| AxisReport {
        axis: name,
        gain: axis.gain(),
        gain_std: axis.gain_std(),
        offset_m_s2: axis.offset_m_s2(),
        offset_std_m_s2: None,
        cross_axis: None,
        cross_axis_std: None,
    };
    console.json(
        "calibrate-1",
        &Report {
            node: Some(hello.node),
            gravity_m_s2: None,
            gravity_std_m_s2: None,
            level_deg: None,
            seen_level_deg: None,
            axes: AXES.iter().zip(axes).map(axis).collect(),
            written,
            kept_by_node: true,
            found_at: Some(moment(time.0)),
        },
    )
}

fn say(calibrated: &Calibrated, found: &[Still], console: &Console) {
    let Gravity { value_m_s2, relative_std } = calibrated.gravity;
    let shared = if relative_std > 0.0 {
        format!(" (± {:.3} %, which all gains share)", 100.0 * relative_std)
    } else {
        String::new()
    };
    console.say(format!("{} still times; gravity {value_m_s2:.5} m/s²{shared}.", found.len()));
    let mut table = Columns::new(["axis", "gain", "±", "offset m/s²", "±", "of X %", "of Y %", "of Z %", "± %"]);
    for (name, axis) in AXES.iter().zip(&calibrated.axes) {
        let cross = axis.cross.map(|share| if share == 1.0 { String::new() } else { format!("{:.2}", 100.0 * share) });
        let cross_std = axis.cross_std.iter().copied().fold(0.0, f64::max);
        let values = [
            (*name).to_owned(),
            format!("{:.5}", axis.gain),
            format!("{:.5}", axis.gain_std),
            format!("{:.4}", axis.offset_m_s2),
            format!("{:.4}", axis.offset_std_m_s2),
        ];
        table.row(values.into_iter().chain(cross).chain([format!("{:.2}", 100.0 * cross_std)]));
    }
    console.say(table);
    if calibrated.p_value < UNLIKELY {
        console.warn(format_args!(
            "the faces were {:.1}° off level, more than {}°: level them better, or say so with --level, or the deviations are too small",
            calibrated.seen_level_deg, calibrated.level_deg
        ));
    }
}

/// Puts the values into study.toml, unless it is to stay as it is. The sensors whose values are there now, as setup and channel.
fn write(
    arguments: &Arguments,
    study: &Study,
    entries: &[CalibrationEntry],
    console: &Console,
) -> anyhow::Result<Vec<[String; 2]>> {
    if arguments.dry_run {
        return Ok(Vec::new());
    }
    let _lock = alone(&arguments.study, console)?;
    set_calibration(&study.folder, entries)?;
    let names: Vec<&str> = entries.iter().map(|entry| entry.channel.as_str()).collect();
    console.say(format!(
        "study.toml has the gain and the offset of {}. They count from now on, also for what was collected before.",
        names.join(", ")
    ));
    Ok(entries.iter().map(|entry| [entry.setup.clone(), entry.channel.clone()]).collect())
}

fn report(node: Option<u16>, calibrated: &Calibrated, written: Vec<[String; 2]>, kept_by_node: bool) -> Report {
    let Gravity { value_m_s2, relative_std } = calibrated.gravity;
    Report {
        node,
        gravity_m_s2: Some(value_m_s2),
        gravity_std_m_s2: Some(value_m_s2 * relative_std),
        level_deg: Some(calibrated.level_deg),
        seen_level_deg: Some(calibrated.seen_level_deg),
        axes: AXES.iter().zip(&calibrated.axes).map(|(name, axis)| AxisReport::of(name, axis)).collect(),
        written,
        kept_by_node,
        found_at: None,
    }
}
