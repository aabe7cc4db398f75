//! The live view: a table of ports and nodes that stays in place on a terminal, lines of what happens elsewhere.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

use belfry_shared::message::{ChannelState, SensorState};
use comfy_table::{Table, presets::UTF8_FULL_CONDENSED};
use indicatif::{ProgressBar, ProgressStyle};

use crate::command::Console;
use crate::command::ports::fault_in_words;
use crate::command::text::align_right;
use crate::link::collect::{PortState, PortStatus, unix_time};
use crate::link::fleet::channels_by_node;
use crate::spectra::{LineGrid, SpectralPlan};
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
    /// The setup's nodes, and their channels' names.
    nodes: BTreeMap<u16, Vec<String>>,
    console: Console,
}

impl View {
    pub(super) fn new(setup: &Setup, grid: &LineGrid, decimation: u32, console: &Console) -> Self {
        // Drawn when there is something new, and not at all where standard error is no terminal.
        let style = ProgressStyle::with_template("{msg}").unwrap_or_else(|_| ProgressStyle::default_spinner());
        let bar = if std::io::stderr().is_terminal() { ProgressBar::new_spinner() } else { ProgressBar::hidden() };
        bar.set_style(style);
        Self {
            bar,
            sampling_rate_hz: setup.sampling_rate_hz,
            segment_s: 1.0 / grid.spacing_hz(),
            lead_s: SpectralPlan::lead_rows(decimation) as f64 / setup.sampling_rate_hz,
            start_s: unix_time().as_secs_f64(),
            told: RefCell::default(),
            shown: Cell::default(),
            nodes: channels_by_node(setup)
                .into_iter()
                .map(|(node, channels)| (node, channels.iter().map(|&c| setup.sensors[c].channel.clone()).collect()))
                .collect(),
            console: *console,
        }
    }

    /// Shows the ports as they are now.
    pub(super) fn show(&self, statuses: &[PortStatus]) {
        if self.bar.is_hidden() {
            self.tell_changes(statuses);
        } else if self.shown.get().is_none_or(|shown| shown.elapsed() >= REDRAW) {
            self.shown.set(Some(Instant::now()));
            self.bar.set_message(format!("{}\n{}", self.text(statuses), self.next_window()));
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
            let state = self.state_in_words(status);
            // Counts go up all the time, and stand in the table at the end.
            let kind: String = state.chars().filter(|letter| !letter.is_ascii_digit()).collect();
            if told.get(&status.port) != Some(&kind) {
                self.console.report(format_args!("{}: {state}", named(status)));
                told.insert(status.port.clone(), kind);
            }
        }
    }

    /// When the next window can be complete.
    fn next_window(&self) -> String {
        let hop_s = 0.5 * self.segment_s;
        let now_s = unix_time().as_secs_f64();
        let first_start_s = ((self.start_s + self.lead_s) / hop_s).ceil() * hop_s;
        let done_after = |start_s: f64| start_s + self.segment_s + self.lead_s;
        let next_start_s = ((now_s - self.segment_s - self.lead_s) / hop_s).ceil() * hop_s;
        let seconds = done_after(next_start_s.max(first_start_s)) - now_s;
        let wait =
            if seconds > 90.0 { format!("{:.0} min", seconds / 60.0) } else { format!("{} s", self::seconds(seconds)) };
        format!("Next window in {wait}. Ctrl-C stops.")
    }

    /// The ports as a table, what is to be said of each below it, and which nodes are missing.
    pub(super) fn text(&self, statuses: &[PortStatus]) -> String {
        let mut text = self.table(statuses).to_string();
        for status in sorted(statuses) {
            text += &format!("\n{}: {}", named(status), self.state_in_words(status));
        }
        let is_there = |node: &&u16| statuses.iter().any(|status| status.node == Some(**node));
        let missing: Vec<String> = self.nodes.keys().filter(|node| !is_there(node)).map(u16::to_string).collect();
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
                let channels = heartbeat.level.iter().zip(&heartbeat.sensors);
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

    /// What a port has come to, and what is wrong with its node's sensors.
    pub(super) fn state_in_words(&self, status: &PortStatus) -> String {
        let mut words = match &status.state {
            PortState::Asking => "asks who is there".to_owned(),
            PortState::Silent => "nobody answers".to_owned(),
            PortState::Gone(reason) => format!("gone, tried again ({reason})"),
            PortState::Preparing => "is told what to measure, and the time".to_owned(),
            PortState::Measuring => "measures".to_owned(),
            PortState::Foreign => format!(
                "node {} answers on {}, but no sensor of this setup has `node = {0}`: left alone (a board's number is BELFRY_NODE when it is built)",
                status.node.unwrap_or_default(),
                status.port
            ),
            PortState::Refused(reason) => reason.clone(),
        };
        if let Some(fault) = status.hello.as_ref().and_then(|hello| hello.fault.as_ref()) {
            words += &format!("; {}", fault_in_words(fault));
        }
        if let Some((channel, reason)) = status.gaps.last {
            words += &format!(
                "; windows with gaps: {}, the last: {} {}",
                status.gaps.windows,
                self.channel(status, channel),
                in_words(reason)
            );
        }
        if let Some(heartbeat) = &status.heartbeat {
            for (channel, sensor) in heartbeat.sensors.iter().enumerate() {
                if *sensor != SensorState::Sound {
                    words += &format!("; {} {sensor}", self.channel(status, channel));
                }
            }
            if heartbeat.lost_rows > 0 {
                words += &format!("; {} rows lost", heartbeat.lost_rows);
            }
        }
        if status.statistics.foreign_windows > 0 {
            words += &format!("; {} windows of another study dropped", status.statistics.foreign_windows);
        }
        words
    }

    /// A channel of a port's node by the name that it has in the study.
    fn channel(&self, status: &PortStatus, channel: usize) -> String {
        match status.node.and_then(|node| self.nodes.get(&node)?.get(channel)) {
            Some(name) => format!("channel \"{name}\""),
            None => format!("channel {}", channel + 1),
        }
    }
}

/// Nodes by their numbers, then ports where nobody answers.
fn sorted(statuses: &[PortStatus]) -> Vec<&PortStatus> {
    let mut sorted: Vec<&PortStatus> = statuses.iter().collect();
    sorted.sort_by_key(|status| (status.node.is_none(), status.node, status.port.as_str()));
    sorted
}

/// Seconds in as many digits as say something.
pub(super) fn seconds(seconds: f64) -> String {
    if seconds < 10.0 { format!("{seconds:.2}") } else { format!("{seconds:.0}") }
}

fn named(status: &PortStatus) -> String {
    match status.node {
        Some(node) => format!("node {node} on {}", status.port),
        None => status.port.clone(),
    }
}

fn in_words(reason: ChannelState) -> &'static str {
    match reason {
        ChannelState::Sound { .. } => "sound",
        ChannelState::Missing => "gave no readings",
        ChannelState::Clipped => "was at the end of its range",
        ChannelState::Constant => "always read the same",
        ChannelState::Overrun => "was not transformed in time",
    }
}
