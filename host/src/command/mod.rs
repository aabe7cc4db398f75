//! The subcommands of `belfry`, one file each, and the console they share.
//!
//! A subcommand is a `clap` argument struct with a `run` that takes a [`Console`]. Library modules never print.

pub mod add;
mod case;
pub mod collect;
pub mod compare;
pub mod covalidate;
pub mod demo;
pub mod diagnose;
pub mod effects;
pub mod export;
pub mod history;
pub mod identify;
pub mod init;
mod interrupt;
pub mod paper;
pub mod ports;
pub mod remove;
pub mod replay;
mod route;
pub mod simulate;
mod steps;
mod trends;
pub mod update;

use std::io::{ErrorKind, IsTerminal, Write};
use std::time::Duration;

use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

pub use route::RouteArguments;

/// Where a command's words go: tables and sentences to standard output for people, or one JSON object with `--json`.
#[derive(Debug, Clone, Copy)]
pub struct Console {
    json: bool,
}

impl Console {
    /// A console for people, or for programs with `json`.
    pub fn new(json: bool) -> Self {
        Self { json }
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
            && let Err(error) = print(line)
        {
            self.warn(format_args!("cannot write to standard output: {error}"));
        }
    }

    /// Prints a warning on standard error, with or without `--json`.
    pub fn warn(&self, warning: impl std::fmt::Display) {
        // Where standard error is closed there is nobody left to tell.
        let _ = writeln!(std::io::stderr(), "warning: {warning}");
    }

    /// Says on standard error what happens, with or without `--json`, where no table can be kept in place.
    fn report(&self, line: impl std::fmt::Display) {
        let _ = writeln!(std::io::stderr(), "{line}");
    }

    /// Prints the command's JSON object; silent without `--json`.
    ///
    /// # Errors
    /// When standard output cannot be written, a reader that went away aside.
    pub fn json(&self, object: &impl Serialize) -> anyhow::Result<()> {
        if self.json {
            print(serde_json::to_string_pretty(object)?).context("cannot write to standard output")?;
        }
        Ok(())
    }

    /// Prints one of many JSON objects, on a line of its own; silent without `--json`.
    ///
    /// # Errors
    /// When standard output cannot be written, a reader that went away aside.
    pub fn json_line(&self, object: &impl Serialize) -> anyhow::Result<()> {
        if self.json {
            print(serde_json::to_string(object)?).context("cannot write to standard output")?;
        }
        Ok(())
    }

    /// A progress bar on standard error over `length` steps; hidden where standard error is not a terminal.
    pub fn progress(&self, length: u64, label: &str) -> ProgressBar {
        if !std::io::stderr().is_terminal() {
            return ProgressBar::hidden();
        }
        let style = ProgressStyle::with_template("{msg:24} {wide_bar} {percent:>3} % {eta:>4}")
            .unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = ProgressBar::new(length).with_style(style).with_message(label.to_owned());
        bar.enable_steady_tick(Duration::from_millis(200));
        bar
    }
}

/// A line on standard output; `println!` would panic where the reader has closed it.
fn print(line: impl std::fmt::Display) -> std::io::Result<()> {
    match writeln!(std::io::stdout(), "{line}") {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written,
    }
}
