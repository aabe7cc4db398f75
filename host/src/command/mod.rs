//! The subcommands of `belfry`, one file each, and the console they share.
//!
//! A subcommand is a `clap` argument struct with a `run` that takes a [`Console`]. Library modules never print.

pub mod add;
pub mod archive;
pub mod calibrate;
pub mod change;
pub mod collect;
pub mod compare;
pub mod completions;
pub mod covalidate;
pub mod demo;
pub mod diagnose;
pub mod effects;
pub mod export;
pub mod history;
pub mod identify;
pub mod init;
mod interrupt;
pub mod key;
pub mod look;
pub mod man;
pub mod paper;
mod partial;
pub mod plan;
pub mod ports;
pub mod profile;
mod range;
pub mod remove;
pub mod replay;
pub mod report;
mod route;
pub mod serve;
mod server;
pub mod simulate;
mod steps;
mod text;
mod trends;
pub mod update;
pub mod watch;
pub mod work;

use std::collections::HashSet;
use std::io::{ErrorKind, IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use crate::progress::{OnProgress, Progress};
use crate::results::Versioned;

pub use range::RangeArguments;
pub use route::RouteArguments;
pub(crate) use text::{in_shell, p_is, printable};

/// A variable of the environment: where it is set, progress is told on standard error as JSON objects, a line each, instead of bars.
pub(crate) const PROGRESS_LINES: &str = "BELFRY_PROGRESS_LINES";
/// A stage of fewer pieces shows their count.
const COUNTED: u64 = 1000;
/// How often.
const PROGRESS_EVERY: Duration = Duration::from_millis(100);

/// Whether the one JSON object was printed.
static OBJECT_PRINTED: AtomicBool = AtomicBool::new(false);
/// Whether JSON objects were printed, each on a line of its own.
static LINES_PRINTED: AtomicBool = AtomicBool::new(false);
/// The progress bar in sight.
static BAR: Mutex<Option<ProgressBar>> = Mutex::new(None);
/// Warnings that were printed: what was said once is not said again.
static WARNED: LazyLock<Mutex<HashSet<String>>> = LazyLock::new(Mutex::default);

/// The schema of a failure.
const FAILURE: &str = "error-1";

/// What `--json` prints of a failure.
#[derive(Debug, Serialize)]
struct Failure {
    error: FailureReport,
}

/// Why a command failed, in sentences for its user.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FailureReport {
    /// What failed.
    pub message: String,
    /// Why: what the error before does not say itself, the nearest cause first.
    pub causes: Vec<String>,
}

impl FailureReport {
    /// What an error and its causes say.
    pub fn of(error: &anyhow::Error) -> Self {
        let message = text::shortened(&error.to_string()).into_owned();
        let mut causes: Vec<String> = Vec::new();
        for cause in error.chain().skip(1).map(ToString::to_string) {
            // Many errors quote their cause.
            let cause = text::shortened(&cause);
            if !causes.last().unwrap_or(&message).contains(&*cause) {
                causes.push(cause.into_owned());
            }
        }
        Self { message, causes }
    }
}

/// Where a command's words go: tables and sentences to standard output for people, or one JSON object with `--json`.
#[derive(Debug, Clone, Copy)]
pub struct Console {
    json: bool,
    is_brief: bool,
}

impl Console {
    /// A console for people, or for programs with `json`.
    pub fn new(json: bool) -> Self {
        Self { json, is_brief: false }
    }

    /// The same for one step of many: what matters, without details.
    pub(crate) fn brief(self) -> Self {
        Self { is_brief: true, ..self }
    }

    /// Prints a line that the story can do without, as [`Console::say`] does.
    pub fn detail(&self, line: impl std::fmt::Display) {
        if !self.is_brief {
            self.say(line);
        }
    }

    /// Whether only the story is told.
    pub fn is_brief(&self) -> bool {
        self.is_brief
    }

    /// Whether standard output carries one JSON object and nothing else.
    pub fn is_json(&self) -> bool {
        self.json
    }

    /// Prints a line for people; silent with `--json`.
    ///
    /// A reader that has seen enough (`belfry ... | head`) is no fault: the command goes on and writes its files.
    pub fn say(&self, line: impl std::fmt::Display) {
        if !self.json
            && let Err(error) = beside_bar(|| print(text::wrapped(&text::printable(&line.to_string()))))
        {
            self.warn(format_args!("cannot write to standard output: {error}"));
        }
    }

    /// Prints a text that another program reads, as it is; silent with `--json`.
    ///
    /// # Errors
    /// When standard output cannot be written, a reader that went away aside.
    pub fn raw(&self, text: &str) -> anyhow::Result<()> {
        if !self.json {
            print(text.trim_end_matches('\n')).context("cannot write to standard output")?;
        }
        Ok(())
    }

    /// Prints a warning on standard error, with or without `--json`; once, however often it comes.
    pub fn warn(&self, warning: impl std::fmt::Display) {
        let warning = text::printable(&text::shortened(&warning.to_string())).into_owned();
        if WARNED.lock().unwrap_or_else(PoisonError::into_inner).insert(warning.clone()) {
            // Where standard error is closed there is nobody left to tell.
            let _ = beside_bar(|| {
                writeln!(std::io::stderr(), "{}", text::wrapped_for_errors(&format!("warning: {warning}")))
            });
        }
    }

    /// Prints warnings; equal ones as one with their count.
    pub fn warn_all(&self, warnings: &[String]) {
        for (index, warning) in warnings.iter().enumerate() {
            if warnings[..index].contains(warning) {
                continue;
            }
            match warnings[index..].iter().filter(|other| *other == warning).count() {
                1 => self.warn(warning),
                count => self.warn(format_args!("{warning} ({count} times)")),
            }
        }
    }

    /// Says on standard error what happens, with or without `--json`, where no table can be kept in place.
    fn report(&self, line: impl std::fmt::Display) {
        let _ = writeln!(std::io::stderr(), "{}", text::printable(&line.to_string()));
    }

    /// Prints the command's JSON object, which is as the schema of this name and version says (`docs/schema`); silent without `--json`.
    ///
    /// # Errors
    /// When standard output cannot be written, a reader that went away aside.
    pub fn json(&self, schema: &'static str, object: &impl Serialize) -> anyhow::Result<()> {
        if self.json {
            OBJECT_PRINTED.store(true, Ordering::Relaxed);
            print(serde_json::to_string_pretty(&Versioned::new(schema, object))?)
                .context("cannot write to standard output")?;
        }
        Ok(())
    }

    /// Says why a command failed: the error and its causes on standard error, a sentence each, and with `--json` as an object on
    /// standard output. Not by `Debug`, which adds stack traces where `RUST_BACKTRACE` is set.
    pub fn fail(&self, error: &anyhow::Error) {
        let report = FailureReport::of(error);
        let mut stderr = std::io::stderr().lock();
        // Where standard error is closed there is nobody left to tell; the exit status still says it.
        let told = format!("error: {}", text::printable(&report.message));
        let _ = writeln!(stderr, "{}", text::wrapped_for_errors(&told));
        for cause in &report.causes {
            let _ = writeln!(stderr, "  caused by: {}", text::printable(cause));
        }
        // Some commands fail after they have said what they found.
        if self.json && !OBJECT_PRINTED.load(Ordering::Relaxed) {
            let failure = Failure { error: report };
            let is_line = LINES_PRINTED.load(Ordering::Relaxed);
            let _ = if is_line { self.json_line(FAILURE, &failure) } else { self.json(FAILURE, &failure) };
        }
    }

    /// Says to a program that it used the command line wrongly, as [`Console::fail`] says other failures; people are told by the parser of the
    /// command line itself.
    pub fn misused(&self, message: String) {
        let failure = Failure { error: FailureReport { message, causes: Vec::new() } };
        // Where standard output is closed there is nobody left to tell; the exit status still says it.
        let _ = self.json(FAILURE, &failure);
    }

    /// Prints one of many JSON objects, on a line of its own; silent without `--json`.
    ///
    /// # Errors
    /// When standard output cannot be written, a reader that went away aside.
    pub fn json_line(&self, schema: &'static str, object: &impl Serialize) -> anyhow::Result<()> {
        if self.json {
            LINES_PRINTED.store(true, Ordering::Relaxed);
            print(serde_json::to_string(&Versioned::new(schema, object))?)
                .context("cannot write to standard output")?;
        }
        Ok(())
    }

    /// A progress bar on standard error over `length` steps; hidden where standard error is not a terminal.
    pub fn progress(&self, length: u64, label: &str) -> ProgressBar {
        if !std::io::stderr().is_terminal() {
            return ProgressBar::hidden();
        }
        // Few pieces are counted one by one.
        let template = if length < COUNTED {
            "{msg} {wide_bar} {pos} of {len}"
        } else {
            "{msg:24} {wide_bar} {percent:>3} % {eta:>4}"
        };
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = ProgressBar::new(length).with_style(style).with_message(label.to_owned());
        bar.enable_steady_tick(Duration::from_millis(200));
        bar
    }

    /// Runs what takes its time with a progress bar for each of its stages.
    fn with_progress<T>(&self, work: impl FnOnce(OnProgress<'_>) -> T) -> T {
        if std::env::var_os(PROGRESS_LINES).is_some() {
            return self.with_progress_lines(work);
        }
        let mut shown = None;
        let outcome = work(&mut |Progress { stage, done, total }| {
            let mut bar = BAR.lock().unwrap_or_else(PoisonError::into_inner);
            if shown != Some(stage) {
                shown = Some(stage);
                if let Some(finished) = bar.replace(self.progress(total, stage)) {
                    finished.finish_and_clear();
                }
            }
            if let Some(bar) = bar.as_ref() {
                bar.set_length(total);
                bar.set_position(done);
            }
        });
        if let Some(finished) = BAR.lock().unwrap_or_else(PoisonError::into_inner).take() {
            finished.finish_and_clear();
        }
        outcome
    }

    /// The same for a program that reads along.
    fn with_progress_lines<T>(&self, work: impl FnOnce(OnProgress<'_>) -> T) -> T {
        let mut told: Option<(&'static str, Instant)> = None;
        work(&mut |progress| {
            let is_due = |(stage, at): (&str, Instant)| stage != progress.stage || at.elapsed() >= PROGRESS_EVERY;
            if told.is_none_or(is_due) {
                told = Some((progress.stage, Instant::now()));
                self.report(serde_json::to_string(&progress).unwrap_or_default());
            }
        })
    }
}

/// Writes where a progress bar may stand, which is drawn again below.
fn beside_bar<T>(write: impl FnOnce() -> T) -> T {
    match BAR.lock().unwrap_or_else(PoisonError::into_inner).as_ref() {
        Some(bar) => bar.suspend(write),
        None => write(),
    }
}

/// A line on standard output; `println!` would panic where the reader has closed it.
fn print(line: impl std::fmt::Display) -> std::io::Result<()> {
    match writeln!(std::io::stdout(), "{line}") {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written,
    }
}
