//! `belfry collect`: windows of a live setup, from its nodes into the study's archive.

mod events;
mod view;

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::bail;
use clap::Args;

use super::Console;
use super::interrupt::stop_on_signal;
use super::server::ServerArguments;
use super::text::{in_shell, next_lines};
use crate::archive::Archive;
use crate::calibrate::differs;
use crate::collect::{
    Clock, CollectOptions, Collection, CollectionError, Collector, Report, SystemClock, SystemPorts, all_ports, collect,
};
use crate::jetstream::{Gateway, GatewayNews};
use crate::keys::Keys;
use crate::link::port::{is_remote, open_to_others};
use crate::link::with_cause;
use crate::patience::patiently;
use crate::seedlink::{SeedLink, SeedLinkNews};
use crate::study::Study;
use events::EventLine;
use view::View;

const EXAMPLES: &str = "Examples:
  belfry collect tower                                 every node on a serial port
  belfry collect tower --port /dev/ttyACM0 --port /dev/ttyACM1
  belfry collect tower --port tcp:10.0.0.7:4001        a node behind a serial server
  belfry collect tower --for 12h                       then stop
  belfry collect tower --setup upper                   one of several live setups
  belfry collect tower --to nats://hub:4222            a gateway of a fleet
  belfry collect dam --seedlink seis.example.org       records of an accelerometer network

In study.toml the setup has `live = true` instead of `files`. Its sensors say which node samples them; a node's channels are its sensors in their order there. [analysis] needs band_hz: nodes must know it before there are data. The segment is the finest that leaves enough averages after --hours, unless [analysis] gives one.

A node with a key (`belfry key`) is only collected from with it.

Windows go into the study's archive.sqlite. A node forgets a window only when it is on this disk, and keeps the others as long as it has room, so collecting can be stopped and started again at any time. A full disk, or another program that writes into the archive, does not end it: it is tried again. With --to, windows and heartbeats also go to a server, where `belfry work` takes them; while it is away collecting goes on, and what is missing follows later. While it runs, `belfry identify`, `belfry compare` and the rest work on what has come so far.

With --seedlink, records of the channels that the study's recordings name (NET.STA.LOC.CHA) come from a SeedLink server and go to a file for each channel and day, where `files` finds them, such as `seis/*.mseed`. It goes on where it stopped.

With --json every event is one line, a JSON object with `event`, `time`, `port` and `node`:
  port    the port has come to another `state`, with its `reason` on errors
  window  a window is on the disk: `boot`, `number`, and its `start`
  gap     a `channel` of that window has no sound data, and the `reason`
  lost    so many `windows` no longer exist anywhere
  archive the archive is `waiting`, with the `reason`, or `writable` again `after_s`
  end     the last line: totals of the archive and of each port";

/// Collect measurements from nodes until stopped
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    study: PathBuf,
    /// A port to collect from: a device, `tcp:HOST:PORT` or `unix:PATH`; repeat for more [default: all serial ports]
    #[arg(long = "port", value_name = "PORT")]
    ports: Vec<String>,
    /// Collect miniSEED of existing accelerometers from a SeedLink server instead, into the files of the study's recordings
    #[arg(long, value_name = "HOST", conflicts_with_all = ["ports", "setup", "hours", "to", "drop_foreign", "bits"])]
    seedlink: Option<String>,
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
    /// Publish each window to a NATS server as well, once it is in the archive: `nats://HOST:PORT` or `tls://HOST:PORT`, several of a cluster with commas
    #[arg(long = "to", value_name = "URL")]
    to: Option<String>,
    /// How the server lets it in
    #[command(flatten)]
    server: ServerArguments,
    /// Drop windows that nodes still hold for another study; such nodes are not used otherwise
    #[arg(long)]
    drop_foreign: bool,
    /// Bits per component of the spectral lines [default: 10, or what was collected with before]
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

/// Collects records until it is stopped.
fn seedlink(study: &Study, server: &str, duration: Option<Duration>, console: &Console) -> anyhow::Result<()> {
    let mut client = SeedLink::new(study, server)?;
    if console.is_json() {
        bail!("--json is for nodes; with --seedlink, the files in the study's folder say what has come");
    }
    let stop = stop_on_signal()?;
    console.say(format!("Channels {}. Ctrl-C stops.", client.channels().join(", ")));
    let start = Instant::now();
    let is_over = || stop.load(Ordering::Relaxed) || duration.is_some_and(|duration| start.elapsed() >= duration);
    let count = client.collect(is_over, |news| match news {
        SeedLinkNews::Waiting { reason } => console.report(format_args!("{reason}. It is tried again.")),
        SeedLinkNews::Connected => console.report("connected"),
        SeedLinkNews::Refused { names } => {
            let names = names.join(", ");
            console.report(format_args!(
                "the server does not give {names}; it is asked again when the connection is made anew, within an hour"
            ));
        }
        SeedLinkNews::LeftOut { sequence } => {
            console.report(format_args!(
                "packet {sequence:06X} has no record of miniSEED 2 with 512 bytes, and is left out"
            ));
        }
        SeedLinkNews::Records { .. } => {}
    })?;
    console.say(format!("{count} records of miniSEED."));
    Ok(())
}

/// Runs the command.
///
/// # Errors
/// When the study has no live setup, its nodes cannot be told what to measure, no port can be used, or the archive cannot be
/// written.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let study = Study::load(&arguments.study)?;
    if let Some(server) = &arguments.seedlink {
        return seedlink(&study, server, arguments.duration, console);
    }
    // That the study has a live setup is known before its folder is written to.
    Collection::live_setup(&study, arguments.setup.as_deref())?;
    if arguments.to.is_none() && arguments.server.are_given() {
        bail!("--credentials and --trust are for the server that --to names");
    }
    let address = arguments.to.as_deref().map(|to| arguments.server.address(to)).transpose()?;
    let ports = ports(arguments)?;
    let clock = SystemClock::new();
    let options = CollectOptions {
        setup: arguments.setup.clone(),
        hours: arguments.hours,
        bits: arguments.bits,
        drop_foreign: arguments.drop_foreign,
        baud: arguments.baud,
        keys: Keys::load()?,
    };
    let remote: Vec<&String> = arguments.ports.iter().filter(|port| is_remote(port)).collect();
    let stop = stop_on_signal()?;
    let begin = || {
        let mut archive = Archive::create(&study.folder)?;
        let (setup, collection) = Collection::of(&study, &mut archive, &options, clock.unix())?;
        Ok((archive, setup, collection))
    };
    // Another program may have the archive, or the disk may be full.
    let said = |error: &CollectionError| console.report(format_args!("{}. It is tried again.", with_cause(error)));
    let begun = patiently(begin, CollectionError::will_pass, said, || stop.load(Ordering::Relaxed))?;
    let Some((archive, setup, collection)) = begun else { return Ok(()) };
    let view = View::new(setup, &collection, console);
    let numbers: Vec<String> = collection.nodes.keys().map(u16::to_string).collect();
    console.say(format!("Setup \"{}\", nodes {}. {}", setup.name, numbers.join(", "), collection.reason));
    console.say(format!(
        "Windows go to {}. Ctrl-C stops; nodes keep what they have not delivered, as long as they have room.\n",
        archive.file().display()
    ));
    let start = clock.steady();
    let elapsed = || clock.steady().saturating_sub(start);
    let collector = Collector::new(&collection, archive, &clock);
    let gateway = address.map(|address| Gateway::start(&study, address)).transpose()?;
    let mut unprinted = None;
    collect(&collector, &ports, &mut |statuses, events| {
        for status in statuses {
            let is_open = status.hello.as_ref().is_some_and(|hello| hello.counters.is_none());
            if is_open && remote.contains(&&status.port) {
                console.warn(open_to_others(&status.port));
            }
            if let Some(other) = status.hello.as_ref().and_then(|hello| differs(setup, hello)) {
                console.warn(other);
            }
        }
        view.show(statuses, events);
        gateway.iter().flat_map(Gateway::news).for_each(|news| console.report(in_words(&news)));
        for event in events {
            if let Err(error) = console.json_line("collect-1", &EventLine::new(event, view.words())) {
                unprinted = Some(error);
            }
        }
        let is_over = arguments.duration.is_some_and(|duration| elapsed() >= duration);
        if is_over || unprinted.is_some() || stop.load(Ordering::Relaxed) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    });
    view.end();
    let published = gateway.map(Gateway::finish);
    let statuses = collector.finish()?;
    if let Some(error) = unprinted {
        return Err(error);
    }
    let report = Report::new(setup, &study.folder, elapsed(), &statuses)?;
    console.json_line("collect-1", &EventLine::end(&report, clock.unix()))?;
    console.say(view.text(&statuses));
    let (stored, gaps, windows) = (report.windows(), report.windows_with_gaps(), report.windows_in_archive);
    console.say(format!(
        "{stored} windows of nodes have come, {gaps} of them with gaps; the archive now has {windows} windows of this setup."
    ));
    if let Some(published) = published {
        console.say(format!("{published} windows were published."));
    }
    report.verdict()?;
    if windows > 0 && (stored == 0 || gaps < stored) {
        let study = in_shell(&study.folder);
        console.say(next_lines(&[(format!("identify {study}"), "the modes, of what has come so far")]));
    }
    Ok(())
}

/// What happens to a gateway.
fn in_words(news: &GatewayNews) -> String {
    match news {
        GatewayNews::Waiting { reason } => {
            format!("publishing waits: {reason}. The archive keeps everything, and it is tried again.")
        }
        GatewayNews::Back { after } => {
            format!("publishing goes on after {}", humantime::format_duration(Duration::from_secs(after.as_secs())))
        }
        GatewayNews::LeftOut { what } => format!("not published: {what}"),
    }
}

/// The ports that are named, or all that there are.
fn ports(arguments: &Arguments) -> anyhow::Result<SystemPorts> {
    let mut named = arguments.ports.clone();
    named.sort();
    named.dedup();
    if named.is_empty() && all_ports()?.is_empty() {
        bail!("there is no serial port; is the board's USB cable one that carries data? `--port` names others");
    }
    Ok(SystemPorts { named, baud: arguments.baud })
}
