//! One port: opened, asked who is there, and its node served, a step at a time.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use belfry_shared::time::HostTime;

use super::collector::{CollectError, Collector, NodeState};
use super::event::Happening;
use super::lock::lock;
use super::ports::Ports;
use super::status::{Gaps, PortState, PortStatus};
use crate::link::{Greeting, GreetingError, Session, SessionError, Transport, with_cause};
use crate::window::{ChannelData, NodeWindow, WindowSink};

/// How long a port is asked who is there before it counts as silent.
const ASK: Duration = Duration::from_secs(2);
/// Time between tries to open a port that is gone.
const REOPEN: Duration = Duration::from_secs(2);
/// Time before a port where nobody answers is asked again: it may be another program's.
const SILENT_PAUSE: Duration = Duration::from_secs(5);
/// Time between tries of a port whose node is of no use: it may be given another number, or other cables.
const ASK_AGAIN: Duration = Duration::from_secs(15);
/// Time between looks at what a node that says something has come to.
const LOOK: Duration = Duration::from_millis(200);
/// Time between looks at whether a greeting is due.
const GREETING_PAUSE: Duration = Duration::from_millis(100);
/// A node counts as silent when nothing came for this long: two heartbeats.
const SILENT: Duration = Duration::from_secs(250);

/// What is being done with the port. Times are the steady clock's.
enum Stage {
    /// Nothing, until then.
    Closed { until: Duration },
    /// It is open, and asked who is there, until then.
    Greeting { line: Box<dyn Transport>, greeting: Box<Greeting>, until: Duration },
    /// Its node is served.
    Serving { line: Box<dyn Transport>, node: Box<Served> },
}

struct Served {
    state: Box<NodeState>,
    looked: Duration,
    /// Frames that had come from it, and when the last came.
    heard: (u64, Duration),
}

/// Serves one port.
pub struct PortServer {
    port: String,
    status: Arc<Mutex<PortStatus>>,
    stage: Stage,
}

impl PortServer {
    /// A server for a port of which [`Collector::new_ports`] has told.
    pub fn new(collector: &Collector<'_>, port: &str) -> Self {
        let status = collector.status_of(port);
        Self { port: port.to_owned(), status, stage: Stage::Closed { until: Duration::ZERO } }
    }

    /// Does what is due; how long nothing will be, unless bytes come.
    pub fn step(&mut self, collector: &Collector<'_>, ports: &dyn Ports) -> Duration {
        let now = collector.steady();
        let stage = std::mem::replace(&mut self.stage, Stage::Closed { until: now });
        self.stage = match stage {
            Stage::Closed { until } if now < until => {
                self.stage = Stage::Closed { until };
                return until - now;
            }
            Stage::Closed { .. } => match ports.open(&self.port) {
                Ok(line) => greet(line, now),
                Err(reason) => self.close(collector, PortState::Gone(reason), REOPEN),
            },
            Stage::Greeting { line, greeting, until } => self.greet(collector, line, greeting, until),
            Stage::Serving { line, node } => self.serve(collector, line, node),
        };
        match &self.stage {
            Stage::Closed { .. } => Duration::ZERO,
            Stage::Greeting { .. } => GREETING_PAUSE,
            Stage::Serving { node, .. } => {
                let due_us = node.state.session.next_due().0.saturating_sub(collector.host_time().0.0);
                let due = Duration::from_micros(u64::try_from(due_us).unwrap_or(0));
                // What has come since the last look is to be told soon.
                if node.heard.1 > node.looked { due.min(LOOK) } else { due }
            }
        }
    }

    /// Waits until bytes have come, or so long; a line that fails meanwhile says so in the next step.
    pub fn wait(&mut self, longest: Duration) {
        let line = match &mut self.stage {
            Stage::Closed { .. } => None,
            Stage::Greeting { line, .. } | Stage::Serving { line, .. } => Some(line),
        };
        match line.map(|line| line.wait(longest)) {
            Some(Ok(())) => {}
            // Not at once again, whatever is wrong with it.
            Some(Err(_)) | None => std::thread::sleep(longest),
        }
    }

    /// Ends the service, with a last look at the node.
    pub fn end(mut self, collector: &Collector<'_>) {
        let stage = std::mem::replace(&mut self.stage, Stage::Closed { until: Duration::ZERO });
        if let Stage::Serving { mut node, .. } = stage {
            // The last chance of windows that wait to be stored: the node may have no room for them any more.
            lock(&collector.patience).try_now(collector.steady());
            if let Err(error) = self.with_sink(collector, &mut node.state, Session::store_waiting) {
                collector.fail(CollectError::Store(error));
            }
            self.look(collector, &mut node.state);
            collector.release(node.state);
        }
    }

    fn set(&self, collector: &Collector<'_>, state: PortState) {
        let mut status = lock(&self.status);
        if status.state != state {
            status.state = state.clone();
            let node = status.node;
            drop(status);
            collector.happened(&self.port, node, Happening::State(state));
        }
    }

    /// Closes the port, and leaves it closed for a pause.
    fn close(&self, collector: &Collector<'_>, state: PortState, pause: Duration) -> Stage {
        self.set(collector, state);
        Stage::Closed { until: collector.steady() + pause }
    }

    fn greet(
        &self,
        collector: &Collector<'_>,
        mut line: Box<dyn Transport>,
        mut greeting: Box<Greeting>,
        until: Duration,
    ) -> Stage {
        let now = collector.steady();
        let hello = match greeting.service(now, &mut *line) {
            Ok(Some(hello)) => hello,
            Ok(None) if now < until => return Stage::Greeting { line, greeting, until },
            Ok(None) | Err(GreetingError::Silent) => return self.close(collector, PortState::Silent, SILENT_PAUSE),
            Err(GreetingError::Line { source }) => {
                return self.close(collector, PortState::Gone(source.to_string()), REOPEN);
            }
            Err(error) => return self.close(collector, PortState::Refused(with_cause(&error)), ASK_AGAIN),
        };
        let node = hello.node;
        {
            let mut status = lock(&self.status);
            if status.node != Some(node) {
                status.forget_node();
            }
            status.node = Some(node);
            status.hello = Some(hello);
        }
        let Some(configurations) = collector.collection().nodes.get(&node) else {
            return self.close(collector, PortState::Foreign, ASK_AGAIN);
        };
        match collector.take(node, &self.port, configurations) {
            Ok(mut state) => {
                self.set(collector, PortState::Preparing);
                state.session.reconnect();
                let heard = (state.session.statistics().frames, now);
                Stage::Serving { line, node: Box::new(Served { state, looked: now, heard }) }
            }
            Err(other) => {
                let reason = format!("node {node} answers on {other} already: two nodes have its number");
                self.close(collector, PortState::Refused(reason), ASK_AGAIN)
            }
        }
    }

    /// Serves a node until it has been silent for long, or its line fails.
    fn serve(&self, collector: &Collector<'_>, mut line: Box<dyn Transport>, mut node: Box<Served>) -> Stage {
        let outcome = self.exchange(collector, &mut *line, &mut node.state);
        let now = collector.steady();
        let frames = node.state.session.statistics().frames;
        if frames > node.heard.0 {
            node.heard = (frames, now);
        }
        let goes_on = outcome.is_ok() && now.saturating_sub(node.heard.1) <= SILENT;
        if now.saturating_sub(node.looked) >= LOOK || !goes_on {
            node.looked = now;
            self.look(collector, &mut node.state);
        }
        if goes_on {
            return Stage::Serving { line, node };
        }
        collector.release(node.state);
        match outcome {
            // It has been silent for long, or another node is on the cable now.
            Ok(()) | Err(SessionError::WrongNode { .. }) => greet(line, now),
            Err(SessionError::Transport { source, .. }) => {
                self.close(collector, PortState::Gone(source.to_string()), REOPEN)
            }
            Err(error) => {
                let stage = self.close(collector, PortState::Refused(with_cause(&error)), ASK_AGAIN);
                if matches!(error, SessionError::Store { .. }) {
                    collector.fail(CollectError::Store(error));
                }
                stage
            }
        }
    }

    /// Reads what has come, and says what is due.
    fn exchange(
        &self,
        collector: &Collector<'_>,
        line: &mut dyn Transport,
        state: &mut NodeState,
    ) -> Result<(), SessionError> {
        let (_, current) = collector.host_time();
        if current != state.generation {
            // The computer's clock was set: what is known of the node's is worth nothing.
            state.generation = current;
            state.session.restart();
        }
        self.with_sink(collector, state, |session, sink| session.service(&|| collector.host_time().0, line, sink))
    }

    /// Does something with the way of a node's windows into the archive.
    fn with_sink(
        &self,
        collector: &Collector<'_>,
        state: &mut NodeState,
        act: impl FnOnce(&mut Session, &mut dyn WindowSink) -> Result<(), SessionError>,
    ) -> Result<(), SessionError> {
        let NodeState { session, peaks, gaps, .. } = state;
        let (now, _) = collector.host_time();
        let node = session.node();
        let Some(configurations) = collector.collection().nodes.get(&node) else { return Ok(()) };
        let mut on_window = |window: &NodeWindow, start: HostTime| {
            let stored = Happening::Stored { name: window.name, start_s: start.0 as f64 * 1e-6 };
            collector.happened(&self.port, Some(node), stored);
            let mut last_gap = None;
            for (channel, data) in window.channels.iter().enumerate() {
                if let ChannelData::Unsound(reason) = *data {
                    last_gap = Some((channel, reason));
                    let gap = Happening::Gap { name: window.name, channel, reason };
                    collector.happened(&self.port, Some(node), gap);
                }
            }
            if last_gap.is_some() {
                *gaps = Gaps { windows: gaps.windows + 1, last: last_gap };
            }
            peaks.add(window);
        };
        let mut sink = collector.sink(&self.port, configurations, now, &mut on_window);
        act(session, &mut sink)
    }

    /// Takes down what the node has come to.
    fn look(&self, collector: &Collector<'_>, state: &mut NodeState) {
        let session = &state.session;
        let statistics = session.statistics();
        let is_measuring = session.is_measuring();
        {
            let mut status = lock(&self.status);
            status.node = Some(session.node());
            status.hello = session.hello().cloned().or(status.hello.take());
            status.heartbeat = session.heartbeat().cloned();
            status.statistics = statistics;
            status.drift_ppm = session.clock().drift_ppm();
            status.gaps = state.gaps;
            status.peaks_hz = state.peaks.peaks_hz().to_vec();
        }
        if is_measuring {
            collector.measures();
        }
        self.set(collector, if is_measuring { PortState::Measuring } else { PortState::Preparing });
        let windows = statistics.lost_windows.saturating_sub(state.reported_losses);
        if windows > 0 {
            state.reported_losses = statistics.lost_windows;
            collector.happened(&self.port, Some(session.node()), Happening::Lost { windows });
        }
    }
}

fn greet(line: Box<dyn Transport>, now: Duration) -> Stage {
    Stage::Greeting { line, greeting: Box::new(Greeting::new()), until: now + ASK }
}
