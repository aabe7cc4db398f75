//! The live view: a table of ports and nodes that stays in place on a terminal, lines of what happens elsewhere.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

use belfry_shared::message::SensorState;
use comfy_table::{Table, presets::UTF8_FULL_CONDENSED};
use indicatif::{ProgressBar, ProgressStyle};

use super::events::time;
use crate::collect::{Clock, Collection, Event, Happening, PortStatus, SystemClock, Words, seconds_in_words};
use crate::command::Console;
use crate::command::text::{align_right, printable};
use crate::spectra::SpectralPlan;
use crate::study::Setup;

/// Time between drawings.
const REDRAW: Duration = Duration::from_secs(1);

/// Shows what the ports have come to.
pub(super) struct View {
    bar: ProgressBar,
    sampling_rate_hz: f64,
    segment_s: f64,
    /// The node's filter sees this much after a segment's end.
    lead_s: f64,
    start_s: f64,
    /// What has been told of each port, where there is no terminal.
    told: RefCell<BTreeMap<String, String>>,
    /// When the table was drawn last.
    shown: Cell<Option<Instant>>,
    words: Words,
    clock: SystemClock,
    console: Console,
}

impl View {
    pub(super) fn new(setup: &Setup, collection: &Collection, console: &Console) -> Self {
        let clock = SystemClock::new();
        // Drawn when there is something new, and not at all where standard error is no terminal.
        let style = ProgressStyle::with_template("{msg}").unwrap_or_else(|_| ProgressStyle::default_spinner());
        let bar = if std::io::stderr().is_terminal() { ProgressBar::new_spinner() } else { ProgressBar::hidden() };
        bar.set_style(style);
        Self {
            bar,
            sampling_rate_hz: setup.sampling_rate_hz,
            segment_s: 1.0 / collection.grid.spacing_hz(),
            lead_s: SpectralPlan::lead_rows(collection.decimation) as f64 / setup.sampling_rate_hz,
            start_s: clock.unix().as_secs_f64(),
            told: RefCell::default(),
            shown: Cell::default(),
            words: Words::new(setup),
            clock,
            console: *console,
        }
    }

    /// What the setup's ports and channels are called.
    pub(super) fn words(&self) -> &Words {
        &self.words
    }

    /// Shows the ports as they are now, and what has happened.
    pub(super) fn show(&self, statuses: &[PortStatus], events: &[Event]) {
        self.tell_archive(events);
        if self.bar.is_hidden() {
            self.tell_changes(statuses);
            self.tell_losses(events);
        } else if self.shown.get().is_none_or(|shown| shown.elapsed() >= REDRAW) {
            self.shown.set(Some(Instant::now()));
            self.bar.set_message(format!("{}\n{}", printable(&self.text(statuses)), self.next_window()));
            self.bar.tick();
        }
    }

    /// Takes the table off the screen.
    pub(super) fn end(&self) {
        self.bar.finish_and_clear();
    }

    /// A line for every port whose state has changed.
    fn tell_changes(&self, statuses: &[PortStatus]) {
        let mut told = self.told.borrow_mut();
        for status in statuses {
            let state = self.words.state(status);
            // Counts go up all the time, and stand in the table at the end.
            let kind: String = state.chars().filter(|letter| !letter.is_ascii_digit()).collect();
            if told.get(&status.port) != Some(&kind) {
                self.log(format_args!("{}: {state}", named(status)));
                told.insert(status.port.clone(), kind);
            }
        }
    }

    /// Says once when the archive cannot be written, and once when it can again.
    fn tell_archive(&self, events: &[Event]) {
        for event in events {
            let line = match &event.what {
                Happening::ArchiveAway { reason } => {
                    format!("{reason}. It is tried again; nodes keep their windows meanwhile.")
                }
                Happening::ArchiveBack { after } => {
                    format!("the archive is written again, after {} s", seconds_in_words(after.as_secs_f64()))
                }
                _ => continue,
            };
            self.bar.suspend(|| self.log(line));
        }
    }

    fn tell_losses(&self, events: &[Event]) {
        for event in events {
            if let Happening::Lost { windows } = event.what {
                let node = event.node.map_or_else(String::new, |node| format!("node {node} on "));
                self.log(format_args!("{node}{}: {windows} windows lost", event.port));
            }
        }
    }

    /// A line on standard error, with the time.
    fn log(&self, line: impl std::fmt::Display) {
        self.console.report(format_args!("{} {line}", time(self.clock.unix())));
    }

    /// When the next window can be complete.
    fn next_window(&self) -> String {
        let hop_s = 0.5 * self.segment_s;
        let now_s = self.clock.unix().as_secs_f64();
        let first_start_s = ((self.start_s + self.lead_s) / hop_s).ceil() * hop_s;
        let done_after = |start_s: f64| start_s + self.segment_s + self.lead_s;
        let next_start_s = ((now_s - self.segment_s - self.lead_s) / hop_s).ceil() * hop_s;
        let seconds = done_after(next_start_s.max(first_start_s)) - now_s;
        let wait = if seconds > 90.0 {
            format!("{:.0} min", seconds / 60.0)
        } else {
            format!("{} s", seconds_in_words(seconds))
        };
        format!("Next window in {wait}. Ctrl-C stops.")
    }

    /// The ports as a table, the state of each below it, and which nodes are missing.
    pub(super) fn text(&self, statuses: &[PortStatus]) -> String {
        let mut text = self.table(statuses).to_string();
        for status in sorted(statuses) {
            text += &format!("\n{}: {}", named(status), self.words.state(status));
        }
        let is_there = |node: &u16| statuses.iter().any(|status| status.node == Some(*node));
        let missing: Vec<String> =
            self.words.nodes().filter(|node| !is_there(node)).map(|node| node.to_string()).collect();
        if !missing.is_empty() {
            text += &format!("\nOn no port: node {}.", missing.join(", "));
        }
        text
    }

    /// The ports as a table.
    fn table(&self, statuses: &[PortStatus]) -> Table {
        let mut table = Table::new();
        table.load_style(UTF8_FULL_CONDENSED);
        table.set_header(["node", "rate Hz", "windows", "gaps", "lost", "clock ppm", "level mm/s²", "peaks Hz"]);
        for status in sorted(statuses) {
            let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
            // By the host's clock: the node's crystal makes it what it is.
            let rate = status.drift_ppm.map(|drift| format!("{:.4}", self.sampling_rate_hz / (1.0 + drift * 1e-6)));
            let level = status.heartbeat.as_ref().map(|heartbeat| {
                let rms = heartbeat.rms();
                let channels = rms.iter().zip(&heartbeat.sensors);
                let level = |(level, sensor): (&f32, &SensorState)| match sensor {
                    SensorState::Absent => "-".to_owned(),
                    _ => format!("{:.2}", 1e3 * level),
                };
                channels.map(level).collect::<Vec<_>>().join(" ")
            });
            let peaks: Vec<String> = status.peaks_hz.iter().map(|peak| format!("{peak:.3}")).collect();
            table.add_row([
                or_dash(status.node.map(|node| node.to_string())),
                or_dash(rate),
                status.statistics.windows.to_string(),
                status.gaps.windows.to_string(),
                status.statistics.lost_windows.to_string(),
                or_dash(status.drift_ppm.map(|drift| format!("{drift:+.2}"))),
                or_dash(level),
                or_dash((!peaks.is_empty()).then(|| peaks.join(" "))),
            ]);
        }
        align_right(&mut table, 6);
        table
    }
}

/// Nodes by their numbers, then ports where nobody answers.
fn sorted(statuses: &[PortStatus]) -> Vec<&PortStatus> {
    let mut sorted: Vec<&PortStatus> = statuses.iter().collect();
    sorted.sort_by_key(|status| (status.node.is_none(), status.node, status.port.as_str()));
    sorted
}

fn named(status: &PortStatus) -> String {
    match status.node {
        Some(node) => format!("node {node} on {}", status.port),
        None => status.port.clone(),
    }
}
