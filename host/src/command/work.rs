//! `belfry work`: modes and alarms of many structures, whose windows gateways have published.

use std::iter::once;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use super::Console;
use super::identify::interval;
use super::interrupt::stop_on_signal;
use super::server::ServerArguments;
use super::text::in_shell;
use super::watch::{JudgingArguments, node_sentence, sentence};
use crate::archive::moment;
use crate::jetstream::{ToAdd, WorkNews, WorkOptions, add, work};
use crate::study::Study;

const EXAMPLES: &str = "Examples:
  belfry work --from nats://hub:4222 --add tower       have a structure followed, once its modes are identified
  belfry work --from nats://hub:4222                   work until stopped; as many of these as there is to do
  belfry work --from nats://hub:4222 --parquet results  write results as Parquet, too
  belfry work --from tls://one,tls://two,tls://three --credentials worker.creds

Gateways (`belfry collect --to`) publish windows. A worker takes its share of the structures that were added, looks for the modes of each in every interval, as `belfry watch` does, judges whole days, and publishes results and alarms. More workers share the structures among them; those of one that is killed go to the others, which go on where it was. Nothing is lost, and nothing comes twice.

What is published, and how the server is set up: docs/fleet.md. With --json every event is one line: `share`, `result`, `alarm`, `unwritten`, `waiting`, `back` and `refused`.";

/// Make modes and alarms of many structures, whose windows gateways have published
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The NATS server: `nats://HOST:PORT` or `tls://HOST:PORT`, several of a cluster with commas
    #[arg(long, value_name = "URL")]
    from: String,
    /// How the server lets it in
    #[command(flatten)]
    server: ServerArguments,
    /// Have a study's structure followed, and end; again when its model has changed
    #[arg(long, value_name = "STUDY")]
    add: Option<PathBuf>,
    /// Length of an interval of the structure that is added, such as 1h or 30min
    #[arg(long, value_name = "DURATION", default_value = "1h", value_parser = interval)]
    every: Duration,
    /// Write results as Parquet as well, a file for each structure and day, into this folder
    #[arg(long, value_name = "DIR", conflicts_with = "add")]
    parquet: Option<PathBuf>,
    /// When an alarm of the structure that is added is raised
    #[command(flatten)]
    judging: JudgingArguments,
}

/// Runs the command.
///
/// # Errors
/// When the study to add cannot be followed, or the server does not let it in.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let address = arguments.server.address(&arguments.from)?;
    if let Some(study) = &arguments.add {
        let study = Study::load(study)?;
        let to_add = ToAdd { study: &study, every: arguments.every, settings: arguments.judging.settings() };
        let added = add(&address, &to_add)?;
        let what = if added.is_known { "goes on, with its study as it is now" } else { "is followed from now on" };
        console.say(format!(
            "{} {what}: {} modes, every {}.\nA gateway sends its windows: `belfry collect {} --to {address}`",
            added.structure,
            added.modes,
            humantime::format_duration(arguments.every),
            in_shell(&study.folder),
        ));
        return console.json("work-added-1", &added);
    }
    let stop = stop_on_signal()?;
    console
        .say(format!("Working for {address}. Ctrl-C stops; others take over, or this one when it is started again."));
    let mut unprinted = Ok(());
    let options = WorkOptions { parquet: arguments.parquet.clone() };
    work(&address, &options, &stop, &mut |news| {
        match &news {
            WorkNews::Waiting { reason } => console.report(format_args!("waiting: {reason}. It is tried again.")),
            WorkNews::Refused { structure, reason } => {
                console.warn(format_args!("{structure} is not followed until it is added anew: {reason}"));
            }
            WorkNews::Unwritten { reason } => {
                console.warn(format_args!("{reason}; the results are in the stream, and written with the next"));
            }
            WorkNews::Result { result, .. } => result.warnings.iter().for_each(|warning| {
                console.warn(format_args!("{}, {}: {warning}", result.structure, begin(result.start_s)));
            }),
            _ => {}
        }
        console.say(in_words(&news));
        if let Err(error) = console.json_line("work-1", &news) {
            unprinted = Err(error);
        }
    })?;
    unprinted
}

fn begin(start_s: f64) -> String {
    moment((start_s * 1e6) as i64)
}

fn in_words(news: &WorkNews) -> String {
    match news {
        WorkNews::Share { own, all, workers } => format!("{own} of {all} structures; {workers} workers"),
        WorkNews::Result { result, after_s } => {
            let modes = result.seen.as_ref().map_or(0, |seen| seen.modes.len());
            let (structure, windows) = (&result.structure, result.windows);
            let found = format!(
                "{structure}, {}: {modes} modes of {windows} windows, after {after_s:.1} s",
                begin(result.start_s)
            );
            once(found).chain(result.node_events.iter().map(node_sentence)).collect::<Vec<_>>().join("\n")
        }
        WorkNews::Alarm { alarm } => sentence(alarm, true),
        WorkNews::Waiting { .. } => "The server is away.".to_owned(),
        WorkNews::Unwritten { .. } => "A file of results is not written.".to_owned(),
        WorkNews::Back { after_s } => format!("The server is back after {after_s:.0} s."),
        WorkNews::Refused { structure, .. } => format!("{structure} is not followed."),
    }
}
