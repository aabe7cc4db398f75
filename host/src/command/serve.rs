//! `belfry serve`: the page on the user's own machine.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::{Context, bail};
use clap::Args;

use super::interrupt::stop_on_signal;
use super::server::ServerArguments;
use super::{Console, RangeArguments};
use crate::serve::{Stepper, serve, serve_fleet};
use crate::story::Project;

const EXAMPLES: &str = "Examples:
  belfry serve canton               prints an address; open it in the browser
  belfry serve canton --open        opens it
  belfry serve canton --port 7300   always at this port
  belfry serve tower --last 7d      its steps take the last week of a live setup
  belfry serve --fleet nats://hub:4222

The page shows what `belfry report` writes, and takes the steps of the commands: identify, compare, update, covalidate, diagnose, profile, add, remove. It runs the same commands, shows them, and changes nothing but the study's folder. Commands in a terminal and other windows on the same study are seen at once.

--fleet shows all structures that workers follow, instead of a study: their state, last data and alarms, on a list and a map.

It listens on 127.0.0.1 alone. The address holds a token; without it nobody on this machine, and no other site in the browser, gets an answer. To look at a study on another machine, forward the port: ssh -L 7300:127.0.0.1:7300 HOST.

Ctrl-C ends it.";

/// How often an interruption is looked for.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// Show the study in the browser, and take its steps there
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY", required_unless_present = "fleet")]
    pub study: Option<PathBuf>,
    /// Show the structures of the fleet on this NATS server
    #[arg(long, value_name = "URL", conflicts_with = "study")]
    pub fleet: Option<String>,
    /// How the server lets it in
    #[command(flatten)]
    server: ServerArguments,
    /// The port on this machine [default: a free one]
    #[arg(long, value_name = "PORT", default_value_t = 0, hide_default_value = true)]
    pub port: u16,
    /// Open the page in the browser
    #[arg(long)]
    pub open: bool,
    /// Which windows of a live setup the page's steps analyse
    #[command(flatten)]
    pub range: RangeArguments,
}

/// Runs the command.
///
/// # Errors
/// When the study cannot be read, or the port cannot be listened on.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let stop = stop_on_signal()?;
    let stopped = async move {
        while !Arc::clone(&stop).load(Ordering::Relaxed) {
            tokio::time::sleep(LOOK_EVERY).await;
        }
    };
    let told = |name: &str, address: &str| {
        console.say(format!("{name}: {address}"));
        console.say("Open this address in the browser. Ctrl-C ends the server.");
        // Told to programs, too, as long as the server runs.
        let told = console.json_line("serve-1", &serde_json::json!({ "address": address }));
        let opened = if arguments.open { super::report::open(address) } else { Ok(()) };
        if let Err(error) = told.and(opened) {
            console.warn(format!("{error:#}"));
        }
    };
    let study = match (&arguments.study, &arguments.fleet) {
        (Some(study), _) => study,
        (None, Some(fleet)) => {
            let address = arguments.server.address(fleet)?;
            let ready = |page: &str| told(&format!("The fleet at {address}"), page);
            return Ok(serve_fleet(&address, arguments.port, ready, stopped)?);
        }
        (None, None) => bail!("name a study, or a fleet with --fleet"),
    };
    let project = Project::open(study)?;
    let program = std::env::current_exe().context("this program cannot be found again")?;
    arguments.range.range_of(project.study())?;
    let stepper = Stepper { program, range: arguments.range.words() };
    let ready = |address: &str| told(&project.study().structure.name, address);
    Ok(serve(project.study(), stepper, arguments.port, ready, stopped)?)
}
