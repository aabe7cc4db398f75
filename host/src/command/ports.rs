//! `belfry ports`: which serial ports there are, and which nodes answer on them.

use std::time::Duration;

use belfry_shared::message::Fault;
use clap::Args;
use comfy_table::{Table, presets::UTF8_FULL_CONDENSED};
use serde::Serialize;

use super::Console;
use crate::archive::moment;
use crate::collect::fault_in_words;
use crate::link::port::{Port, serial_ports};
use crate::link::{GreetingError, who_is_there, with_cause};

/// How long a port is asked.
const PATIENCE: Duration = Duration::from_millis(1500);

/// List serial ports and the nodes that answer on them
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  belfry ports
  belfry ports --port tcp:127.0.0.1:5555      an emulated node as well

Belfry asks every port who is there and waits a second and a half for an answer. It cannot ask a port that another program has open.")]
pub struct Arguments {
    /// A further port to ask: the name of a device, `tcp:HOST:PORT` or `unix:PATH`; repeat for more
    #[arg(long = "port", value_name = "PORT")]
    ports: Vec<String>,
    /// The same, without `--port`
    #[arg(value_name = "PORT")]
    more_ports: Vec<String>,
    /// Baud rate
    #[arg(long, default_value_t = 115_200)]
    baud: u32,
}

#[derive(Debug, Serialize)]
struct PortReport {
    port: String,
    device: String,
    node: Option<u16>,
    channels: Option<u8>,
    measuring: bool,
    /// When it was calibrated, where it has kept that.
    calibrated: Option<String>,
    last_fault: Option<String>,
    #[serde(skip)]
    fault: Option<Fault>,
    problem: Option<String>,
}

#[derive(Debug, Serialize)]
struct Report {
    ports: Vec<PortReport>,
}

/// Runs the command.
///
/// # Errors
/// When the system does not say which ports there are.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let mut ports = serial_ports()?;
    ports.extend(arguments.ports.iter().chain(&arguments.more_ports).map(|name| (name.clone(), String::new())));
    // All at once: a port where nobody answers takes its time.
    let reports: Vec<PortReport> = std::thread::scope(|scope| {
        let asked: Vec<_> =
            ports.iter().map(|(name, what)| scope.spawn(move || ask(name, what, arguments.baud))).collect();
        asked.into_iter().map(|thread| thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
    });
    if reports.is_empty() {
        console.say("There is no serial port. Is the board's USB cable one that carries data?");
    } else {
        console.say(table(&reports));
    }
    if let Some(found) = reports.iter().find(|report| report.node.is_some()) {
        // The study is the reader's to name, so these are no lines to be run as they stand.
        console.say(format!(
            "Then: belfry collect STUDY --port {0}    # measure with that node\n      belfry replay STUDY --port {0}     # a recording through it",
            found.port
        ));
    }
    console.json("ports-1", &Report { ports: reports })
}

fn ask(name: &str, device: &str, baud: u32) -> PortReport {
    let nobody = |problem: Option<String>| PortReport {
        port: name.to_owned(),
        device: device.to_owned(),
        node: None,
        channels: None,
        measuring: false,
        calibrated: None,
        last_fault: None,
        fault: None,
        problem,
    };
    let mut port = match Port::open(name, baud) {
        Ok(port) => port,
        Err(error) => return nobody(Some(with_cause(&error))),
    };
    match who_is_there(&mut port, PATIENCE) {
        Ok(hello) => PortReport {
            node: Some(hello.node),
            channels: Some(hello.channels),
            measuring: hello.configuration_hash.is_some() && hello.clock_set,
            calibrated: hello.calibration.as_ref().map(|calibration| moment(calibration.time.0)),
            last_fault: hello.fault.as_ref().map(ToString::to_string),
            fault: hello.fault,
            ..nobody(None)
        },
        Err(GreetingError::Silent) => nobody(None),
        Err(error) => nobody(Some(with_cause(&error))),
    }
}

fn table(reports: &[PortReport]) -> Table {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED);
    table.set_header(["port", "device", "node", "channels", "state"]);
    for report in reports {
        let calibrated = report.calibrated.as_ref().map_or(String::new(), |when| format!("; calibrated on {when}"));
        let state = match (report.node, &report.problem, &report.fault) {
            (_, Some(problem), _) => problem.clone(),
            (Some(_), _, Some(fault)) => fault_in_words(fault),
            (Some(_), ..) if report.measuring => "measures".to_owned(),
            (Some(_), ..) => "waits for a configuration".to_owned(),
            (None, ..) => "no answer".to_owned(),
        };
        let number = |value: Option<String>| value.unwrap_or_else(|| "-".to_owned());
        table.add_row([
            report.port.clone(),
            report.device.clone(),
            number(report.node.map(|node| node.to_string())),
            number(report.channels.map(|channels| channels.to_string())),
            state + &calibrated,
        ]);
    }
    table
}
