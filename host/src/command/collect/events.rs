//! Events as lines of JSON.

use std::time::{Duration, UNIX_EPOCH};

use serde::Serialize;

use crate::collect::{Event, Happening, PortState, Report, Words, gap_in_words};

/// A line of `belfry collect --json`.
#[derive(Debug, Serialize)]
pub(super) struct EventLine<'a> {
    time: String,
    #[serde(flatten)]
    what: What<'a>,
}

#[derive(Debug, Serialize)]
#[serde(tag = "event", rename_all = "lowercase")]
enum What<'a> {
    Port { port: &'a str, node: Option<u16>, state: &'static str, reason: Option<&'a str> },
    Window { port: &'a str, node: u16, boot: u32, number: u32, start: String },
    Gap { port: &'a str, node: u16, boot: u32, number: u32, channel: String, reason: &'static str },
    Archive { state: &'static str, reason: Option<&'a str>, after_s: Option<f64> },
    Lost { port: &'a str, node: Option<u16>, windows: u64 },
    End(&'a Report),
}

impl<'a> EventLine<'a> {
    pub(super) fn new(event: &'a Event, words: &Words) -> Self {
        let port = event.port.as_str();
        let what = match &event.what {
            Happening::State(state) => {
                let reason = match state {
                    PortState::Gone(reason) | PortState::Refused(reason) => Some(reason.as_str()),
                    _ => None,
                };
                What::Port { port, node: event.node, state: state.name(), reason }
            }
            Happening::Stored { name, start_s } => {
                let start = time(Duration::try_from_secs_f64(*start_s).unwrap_or_default());
                What::Window { port, node: name.node, boot: name.boot, number: name.number, start }
            }
            Happening::Gap { name, channel, reason } => What::Gap {
                port,
                node: name.node,
                boot: name.boot,
                number: name.number,
                channel: words.name(event.node, *channel).map_or_else(|| (channel + 1).to_string(), str::to_owned),
                reason: gap_in_words(*reason),
            },
            Happening::ArchiveAway { reason } => {
                What::Archive { state: "waiting", reason: Some(reason), after_s: None }
            }
            Happening::ArchiveBack { after } => {
                What::Archive { state: "writable", reason: None, after_s: Some(after.as_secs_f64()) }
            }
            Happening::Lost { windows } => What::Lost { port, node: event.node, windows: *windows },
        };
        Self { time: time(event.unix), what }
    }

    /// The last line.
    pub(super) fn end(report: &'a Report, unix: Duration) -> Self {
        Self { time: time(unix), what: What::End(report) }
    }
}

/// A moment of Unix time, to the millisecond, in UTC.
pub(super) fn time(unix: Duration) -> String {
    // Beyond the year 9999 there is no such form.
    let latest = Duration::from_secs(253_402_300_799);
    humantime::format_rfc3339_millis(UNIX_EPOCH + unix.min(latest)).to_string()
}
