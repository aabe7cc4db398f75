//! `belfry watch`: whether a structure has changed for good, day after day.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, bail};
use clap::Args;

use super::Console;
use super::identify::interval;
use super::interrupt::{alone, stop_on_signal};
use super::route::{RouteArguments, percent};
use super::text::{Columns, values_before_units};
use crate::archive::moment;
use crate::diagnose::{ChangeVerdict, Direction};
use crate::notify::{Delivered, Hook, Notifier};
use crate::numbers::probability_text;
use crate::results::ALARMS_FILE;
use crate::story::{
    Cause, Event, EventKind, NodeEvent, ProbableEffect, Project, StoryError, Turned, WatchEvent, WatchReport,
    WatchRequest,
};
use crate::watch::{Alarm, DAY_S, ModeShift, NodeLimits, Problem, Settings, Standing, State};

const EXAMPLES: &str = "Examples:
  belfry watch tower                           from now on, every hour, until stopped
  belfry watch tower --once                    what is there, then end; for cron
  belfry watch tower --on-alarm 'mail -s tower me@example.org'
  belfry watch tower --once --json

Follows the modes that `belfry identify` has found, in intervals, and judges whole days. Temperature, vibration level and what wanders for weeks are learned from the days themselves; a change is what they cannot do. The first 24 days say nothing yet. Days of frost are left out, so the setup needs a `temperature` file. An alarm has a date, a size for every mode and, where the study has a model, what it most probably is. It is followed for two weeks: then the change is lasting or withdrawn.

A node that is silent, loses samples, or has a faulty sensor or a clock that is off is an alarm of its own.

--on-alarm runs a command for every event, with the event as JSON on its standard input; [alarms] in study.toml has events sent by e-mail and MQTT. What fails is tried again, a quarter of an interval later and by the next watch.

Writes watch.json, watch.svg (every day), watch.jsonl (every interval) and alarms.jsonl (every event) into `results`. Remove watch.jsonl, watch.json and watch_reference.json to begin anew.";

/// Follow the modes day after day, and raise an alarm when the structure changes
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    study: PathBuf,
    /// Length of an interval, such as 1h or 30min
    #[arg(long, value_name = "DURATION", default_value = "1h", value_parser = interval)]
    every: Duration,
    /// Judge what is there, and end
    #[arg(long)]
    once: bool,
    /// When an alarm is raised
    #[command(flatten)]
    judging: JudgingArguments,
    /// Raise an alarm when a node has sent nothing for this long
    #[arg(long, value_name = "DURATION", default_value = "15min", value_parser = humantime::parse_duration)]
    silent_after: Duration,
    /// Run a command for every event, with the event as JSON on its standard input
    #[arg(long, value_name = "COMMAND")]
    on_alarm: Option<String>,
    /// How spectra are made of the recordings
    #[command(flatten)]
    route: RouteArguments,
}

/// When an alarm is raised.
#[derive(Debug, Args)]
pub(super) struct JudgingArguments {
    /// Smallest change of a frequency that is worth an alarm
    #[arg(long, value_name = "PERCENT", default_value_t = 0.2, value_parser = percent)]
    least: f64,
    /// Probability that a sound structure ever raises an alarm
    #[arg(long, value_name = "PROBABILITY", default_value_t = 1e-3, value_parser = probability)]
    false_alarms: f64,
    /// Leave out days on which the air, or what is slow to follow it, is colder
    #[arg(long, value_name = "DEGC", default_value_t = 3.0, allow_negative_numbers = true)]
    frost_below: f64,
    /// Judge days of frost as well: for structures of steel on rock
    #[arg(long, conflicts_with = "frost_below")]
    with_frost: bool,
}

impl JudgingArguments {
    /// The same as the judgement takes it.
    pub(super) fn settings(&self) -> Settings {
        Settings {
            false_alarm_probability: self.false_alarms,
            least_change: 0.01 * self.least,
            frost_below_degc: (!self.with_frost).then_some(self.frost_below),
        }
    }
}

fn probability(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|value| *value > 0.0 && *value <= 0.5);
    value.ok_or_else(|| "expected a number above 0, up to 0.5".to_owned())
}

/// While nothing happens it is looked this often whether the watch is to stop.
const PATIENCE: Duration = Duration::from_millis(200);
/// Shares of an interval after which new windows are looked for.
const LOOKS_AN_INTERVAL: u32 = 4;

/// Runs the command.
///
/// # Errors
/// When there are no modes to follow, recordings cannot be read, or the command for alarms cannot be run.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let stop = stop_on_signal()?;
    let hook = arguments.on_alarm.as_deref().map(hook_of).transpose()?;
    let limits = NodeLimits { silent_after_s: arguments.silent_after.as_secs_f64() };
    let settings = arguments.judging.settings();
    let request = WatchRequest { every: arguments.every, route: arguments.route.route(), settings };
    let mut is_first = true;
    loop {
        let mut project = Project::open(&arguments.study)?;
        let is_live = project.study().setups.iter().any(|setup| setup.live);
        let goes_on = is_live && !arguments.once;
        if goes_on && console.is_json() {
            bail!("--json prints one object, and this watch goes on; add --once, or read {ALARMS_FILE}");
        }
        let notifier = Notifier::new(project.study(), hook.as_ref());
        let nodes = {
            let _lock = alone(&arguments.study, console)?;
            notifier.begin().map_err(StoryError::from).and_then(|()| project.watch_nodes(&limits))
        };
        let nodes = nodes.map(Some).or_else(|error| passes(error, goes_on, console))?.unwrap_or_default();
        nodes.events.iter().for_each(|event| console.say(node_sentence(event)));
        let report = {
            let _lock = alone(&arguments.study, console)?;
            console.with_progress(|on_progress| project.watch(&request, nodes, on_progress))
        };
        for event in report.iter().flat_map(|report| &report.events) {
            console.say(sentence(event, is_live));
        }
        // Before the watch says that it cannot go on: where nodes are silent there may be nothing to watch, and that is an alarm.
        let notifier = Notifier::new(project.study(), hook.as_ref());
        let delivered = notifier.deliver(|event| match event {
            WatchEvent::Structure(event) => sentence(event, is_live),
            WatchEvent::Node(event) => node_sentence(event),
        });
        let delivered = delivered.map_err(StoryError::from).map(Some);
        let Delivered { failures, refused } =
            delivered.or_else(|error| passes(error, goes_on, console))?.unwrap_or_default();
        refused.iter().for_each(|error| console.warn(format_args!("{error}; the others have it")));
        if goes_on || report.is_err() {
            failures.iter().for_each(|error| console.warn(format_args!("{error}; it is tried again")));
        }
        // A live archive may have no whole interval yet.
        let report = report.map(Some).or_else(|error| passes(error, goes_on, console))?;
        if let Some(report) = report {
            if is_first || report.new_intervals > 0 {
                say(&report, &project, is_live, is_first, console);
            }
            console.warn_all(&report.warnings);
            console.json("watch-1", &report)?;
            is_first = false;
        }
        if !goes_on && !failures.is_empty() {
            let why: Vec<String> = failures.iter().map(ToString::to_string).collect();
            return Err(anyhow!("{}; the next watch tries again", why.join("; ")));
        }
        notify(if is_first { "WATCHDOG=1" } else { "READY=1\nWATCHDOG=1" });
        if !goes_on || waited(arguments.every / LOOKS_AN_INTERVAL, &stop) {
            return Ok(());
        }
    }
}

/// An error, of which a watch that goes on only says that there is one.
fn passes<T>(error: StoryError, goes_on: bool, console: &Console) -> anyhow::Result<Option<T>> {
    if goes_on {
        console.warn(format_args!("{error}; trying again"));
        return Ok(None);
    }
    Err(error.into())
}

/// Whether it is to stop, after a while or at once.
fn waited(length: Duration, stop: &Arc<AtomicBool>) -> bool {
    let start = Instant::now();
    while start.elapsed() < length {
        if stop.load(Ordering::Relaxed) {
            return true;
        }
        sleep(PATIENCE);
    }
    stop.load(Ordering::Relaxed)
}

/// The command of a line.
fn hook_of(line: &str) -> anyhow::Result<Hook> {
    Hook::parse(line).with_context(|| format!("--on-alarm: `{line}` is no command; are its quotes closed?"))
}

/// Tells systemd that the watch is alive, where it asks (sd_notify(3)).
#[cfg(unix)]
fn notify(state: &str) {
    if let Some(socket) = std::env::var_os("NOTIFY_SOCKET")
        && let Ok(sender) = std::os::unix::net::UnixDatagram::unbound()
    {
        // Whoever does not listen any more need not hear it.
        let _ = sender.send_to(state.as_bytes(), socket);
    }
}

#[cfg(not(unix))]
fn notify(_state: &str) {}

/// A time of the intervals.
fn time(time_s: f64, is_live: bool) -> String {
    if is_live { moment((time_s * 1e6) as i64) } else { format!("day {:.1}", time_s / DAY_S) }
}

pub(super) fn sentence(event: &Event, is_live: bool) -> String {
    let alarm = &event.alarm;
    let when = format!("between {} and {}", time(alarm.between_s[0], is_live), time(alarm.between_s[1], is_live));
    match event.event {
        EventKind::Raised => {
            let cause = in_words(event.cause.as_ref());
            format!("ALARM: {} has changed {when}: {}.{cause}", event.structure, shifts(alarm))
        }
        EventKind::Lasting => {
            format!("The change {when} lasts: {}.{}", shifts(alarm), in_words(event.cause.as_ref()))
        }
        EventKind::Withdrawn => {
            format!("The alarm of {} is withdrawn: later days do not show it.", time(alarm.raised_s, is_live))
        }
    }
}

pub(super) fn node_sentence(event: &NodeEvent) -> String {
    let (node, problem) = (format!("node {} of {}", event.node, event.structure), &event.problem);
    match event.event {
        Turned::Begun => format!("ALARM: {node} {}: {}.", problem.problem, problem.says),
        Turned::Ended => {
            let again = match problem.problem {
                Problem::Silent => "speaks again",
                Problem::LosesSamples => "loses no more samples",
                Problem::ClockOff => "keeps time again",
                Problem::FaultySensor => "has a sound sensor again",
            };
            format!("The alarm of {node} is over: it {again}.")
        }
    }
}

/// What a change most probably is, as a sentence behind others; nothing where no model says it.
fn in_words(cause: Option<&Cause>) -> String {
    let Some(cause) = cause else { return String::new() };
    let has = if cause.direction == Direction::Come { "has come" } else { "has gone" };
    let probable = |effect: &ProbableEffect| {
        let values = values_before_units(&effect.parameters, " ").replace('\n', ", ");
        let values = if values.is_empty() { values } else { format!(", {values}") };
        format!("{} ({}{values})", effect.effect, probability_text(effect.probability))
    };
    let named: Vec<String> =
        cause.effects.iter().filter(|effect| cause.named.contains(&effect.effect)).map(probable).collect();
    match cause.verdict {
        ChangeVerdict::Effect => format!(" Most probably {} {has}.", named.join(" and ")),
        ChangeVerdict::Ambiguous => format!(" One of these {has}: {}.", named.join(", ")),
        ChangeVerdict::Unknown | ChangeVerdict::Unchanged => {
            " By the model it is no single effect of the catalogue.".to_owned()
        }
    }
}

/// The changes that are more than their deviations.
fn shifts(alarm: &Alarm) -> String {
    let mut modes: Vec<_> = alarm.modes.iter().collect();
    modes.sort_by(|a, b| (b.percent / b.std_percent).abs().total_cmp(&(a.percent / a.std_percent).abs()));
    let clear = |mode: &&&ModeShift| mode.percent.abs() > 3.0 * mode.std_percent;
    let told: Vec<String> = modes
        .iter()
        .filter(clear)
        .map(|mode| format!("mode {} by {:+.2} ± {:.2} %", mode.number, mode.percent, mode.std_percent))
        .collect();
    told.join(", ")
}

fn say(report: &WatchReport, project: &Project, is_live: bool, is_first: bool, console: &Console) {
    let judgement = &report.judgement;
    if is_first {
        let mut table = Columns::new(["mode", "Hz now", "in % of intervals", "lasting change %", "± %"]);
        for mode in &report.modes {
            let shift = |alarm: &Alarm| alarm.modes.iter().find(|shift| shift.number == mode.number).copied();
            let lasting = judgement.alarms.iter().filter(|alarm| alarm.state != State::Withdrawn);
            let all: Vec<_> = lasting.filter_map(shift).collect();
            let sum = all.iter().map(|shift| shift.percent).sum::<f64>();
            let std = all.iter().map(|shift| shift.std_percent.powi(2)).sum::<f64>().sqrt();
            let of = |value: String| match (mode.is_judged, all.is_empty()) {
                (false, _) => "-".to_owned(),
                (true, true) => String::new(),
                (true, false) => value,
            };
            table.row([
                mode.number.to_string(),
                format!("{:.4}", mode.frequency_hz),
                format!("{:.0}", 100.0 * mode.seen_share),
                of(format!("{sum:+.2}")),
                of(format!("{std:.2}")),
            ]);
        }
        console.say(format!("\n{table}"));
    }
    let days = format!("{} days judged, {} left out for frost", judgement.days, judgement.frost_days);
    console.say(match (judgement.standing, judgement.log_evidence) {
        (Standing::Learning, _) => format!("Learning: {days}; {} more days are needed.", judgement.missing_days.max(1)),
        (Standing::Unchanged, Some(log)) if log > 0.0 => format!(
            "Unchanged: {days}. Evidence for a new change: {:.1} in powers of ten; an alarm needs {:.1}.",
            log / std::f64::consts::LN_10,
            judgement.alarm_from / std::f64::consts::LN_10
        ),
        (Standing::Unchanged, _) => format!("Unchanged: {days}. Nothing speaks for a new change."),
        (Standing::Changed, _) => {
            format!("Changed: {days}. The last alarm is followed until it has lasted for two weeks.")
        }
    });
    for number in &judgement.lost_modes {
        console.say(format!("Mode {number} was not seen for a week, although most days before show it."));
    }
    for node in report.nodes.iter().filter(|_| is_first) {
        for open in &node.problems {
            console.say(format!("Node {} {}: {}.", node.node, open.problem, open.says));
        }
    }
    if is_first && !judgement.alarms.is_empty() {
        let alarms = judgement.alarms.iter().zip(&report.causes);
        for (alarm, cause) in alarms.filter(|(alarm, _)| alarm.state != State::Withdrawn) {
            let what = if alarm.state == State::Open { "open" } else { "lasting" };
            let cause = in_words(cause.as_ref());
            console.say(format!("Change of {} ({what}): {}.{cause}", time(alarm.first_day_s, is_live), shifts(alarm)));
        }
        console.say("`belfry change STUDY --before MODES` compares the modes of two times, shapes as well.");
    }
    console.say(format!("Picture: {}", project.results().path("watch.svg").display()));
}
