//! A tumble of a node: its heartbeats, one a second, until it has lain on all six faces.

use std::io;
use std::time::Duration;

use belfry_shared::message::{Band, Calibration, Configuration, Heartbeat, Hello, Pace, SensorState, Summary};
use belfry_shared::seal::Key;
use belfry_shared::time::HostTime;
use thiserror::Error;

use super::still::{Cell, Still, faces_of, still};
use crate::link::{Session, SessionError, Transport};
use crate::window::{Configurations, KeptWindows, NodeWindow, WindowSink};

/// What a node measures meanwhile: all three axes, and windows so long that none is complete before the tumble is.
const SAMPLING_RATE_UHZ: u64 = 1_000_000_000;
const DECIMATION: u32 = 200;
const SEGMENT: u16 = 4096;
/// Time between heartbeats.
const PERIOD_MS: u32 = 1000;
/// Heartbeats that are asked for at once: it is asked again well before they end, and a node that is left alone goes back to its own pace soon.
const HEARTBEATS: u16 = 60;
const ASK_AGAIN_US: i64 = 30_000_000;
/// How long a node may measure without a heartbeat that was asked for.
const NO_ANSWER_US: i64 = 15_000_000;
/// A sensor that is started anew has no readings for some seconds.
const MOST_SILENT: u32 = 15;
/// Time between tries to tell the node its calibration.
const TELL_AGAIN_US: i64 = 1_000_000;
/// How often that is tried.
const MOST_TRIES: u32 = 8;

/// Why a tumble ended.
#[derive(Debug, Error)]
pub enum TumbleError {
    /// The conversation cannot go on.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The node has windows that nobody has stored.
    #[error(
        "node {node} still holds windows of a study: collect them first (`belfry collect`), or have them dropped with --drop-foreign"
    )]
    HoldsWindows {
        /// The node.
        node: u16,
    },
    /// The node does not know what it is asked for.
    #[error(
        "node {node} does not send means every second: its firmware is of an earlier release; flash that of this release, or record the tumble and use --recording"
    )]
    TooOld {
        /// The node.
        node: u16,
    },
    /// Its sensor says nothing.
    #[error(
        "the sensor of node {node} gives no readings ({state}): check its wires, or let it start; `belfry ports` shows the node's faults"
    )]
    NoReadings {
        /// The node.
        node: u16,
        /// What it says of the sensor.
        state: SensorState,
    },
    /// It has other axes.
    #[error("node {node} has {channels} channels; three axes are needed")]
    Axes {
        /// The node.
        node: u16,
        /// How many it has.
        channels: u8,
    },
    /// It has not confirmed its calibration.
    #[error("node {node} has not taken its calibration; study.toml has it")]
    NotKept {
        /// The node.
        node: u16,
    },
}

/// What a tumble has come to.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// The node is being greeted and set up.
    Preparing,
    /// For how many seconds each face was up while it lay still, in the order of [`super::Face::ALL`].
    Lying([f64; 6]),
    /// Every face was up for long enough.
    Done(Vec<Still>),
}

/// A tumble of one node.
pub struct Tumble {
    session: Session,
    gravity_m_s2: f64,
    heard: Heard,
    asked: Option<HostTime>,
    measures_since: Option<HostTime>,
}

/// Takes heartbeats; windows of the tumble are nobody's.
#[derive(Debug, Default)]
struct Heard {
    cells: Vec<Cell>,
    /// When the last heartbeat came, and from which life of the node.
    last: Option<(HostTime, u32)>,
    /// Heartbeats in a row without readings, and what the last of them says.
    silent: Option<(u32, SensorState)>,
}

impl WindowSink for Heard {
    fn store(&mut self, _: NodeWindow) -> io::Result<()> {
        Ok(())
    }

    fn kept(&mut self, _: u16, _: u32, _: u32) -> io::Result<Option<KeptWindows>> {
        Ok(None)
    }

    fn heartbeat(&mut self, now: HostTime, heartbeat: &Heartbeat) {
        // The first of a life is of a time that began before it was asked for.
        let before = self.last.replace((now, heartbeat.boot)).filter(|(_, boot)| *boot == heartbeat.boot);
        let Some((before, _)) = before else { return };
        let seconds = 1e-6 * now.0.saturating_sub(before.0) as f64;
        let (&[x, y, z, ..], &[u, v, w, ..]) = (heartbeat.mean_m_s2().as_slice(), heartbeat.variance.as_slice()) else {
            return;
        };
        let has_readings = |state: &SensorState| matches!(state, SensorState::Sound | SensorState::Noisy);
        let wrong = heartbeat.sensors.iter().take(3).find(|state| !has_readings(state));
        self.silent = wrong.map(|&state| (1 + self.silent.map_or(0, |(count, _)| count), state));
        // One that came late, or after others were lost, is of another length than the time since the last.
        let seconds = seconds.clamp(0.5e-3 * f64::from(PERIOD_MS), 1.5e-3 * f64::from(PERIOD_MS));
        let [mean_m_s2, variance] = [[x, y, z], [u, v, w]].map(|values| values.map(f64::from));
        let variance = if wrong.is_none() { variance } else { [f64::NAN; 3] };
        self.cells.push(Cell { seconds, mean_m_s2, variance });
    }
}

impl Tumble {
    /// A face is done after so long, in s; a little more than has to be.
    pub const ENOUGH_S: f64 = 8.0;

    /// A tumble of a node that has greeted, over a line of `baud`, where gravity is `gravity_m_s2`.
    ///
    /// # Errors
    /// Where the node has too few axes.
    pub fn new(
        hello: &Hello,
        baud: u32,
        key: Option<Key>,
        drops_foreign: bool,
        gravity_m_s2: f64,
    ) -> Result<Self, TumbleError> {
        if hello.channels < 3 {
            return Err(TumbleError::Axes { node: hello.node, channels: hello.channels });
        }
        let band = Band { first_line: 1, lines: 1 };
        let configuration = Configuration {
            channels: 3,
            sampling_rate_uhz: SAMPLING_RATE_UHZ,
            decimation: DECIMATION,
            segment: SEGMENT,
            summary: Summary::Lines { bits: 3 },
            bands: [band].into_iter().collect(),
        };
        // Windows of an earlier tumble are nobody's, and another study's are not touched.
        let drops = drops_foreign || hello.configuration_hash == Some(configuration.hash());
        let session =
            Session::new(hello.node, Configurations::only(configuration), baud).dropping_foreign(drops).with_key(key);
        Ok(Self { session, gravity_m_s2, heard: Heard::default(), asked: None, measures_since: None })
    }

    /// Reads what has come and says what is due.
    ///
    /// # Errors
    /// [`TumbleError`].
    pub fn step(&mut self, clock: &dyn Fn() -> HostTime, line: &mut dyn Transport) -> Result<Step, TumbleError> {
        self.service(clock, line)?;
        if !self.session.is_measuring() {
            return Ok(Step::Preparing);
        }
        let now = clock();
        if let Some((count, state)) = self.heard.silent
            && count >= MOST_SILENT
        {
            return Err(TumbleError::NoReadings { node: self.session.node(), state });
        }
        let since = |time: Option<HostTime>| time.map_or(i64::MAX, |time| now.0.saturating_sub(time.0));
        let begun = *self.measures_since.get_or_insert(now);
        let last_heard = self.heard.last.map_or(begun, |(time, _)| time.max(begun));
        if now.0.saturating_sub(last_heard.0) > NO_ANSWER_US {
            return Err(TumbleError::TooOld { node: self.session.node() });
        }
        let is_late = now.0.saturating_sub(last_heard.0) > 3 * 1000 * i64::from(PERIOD_MS);
        if since(self.asked) > ASK_AGAIN_US || (is_late && since(self.asked) > TELL_AGAIN_US) {
            self.asked = Some(now);
            self.session.pace(Pace { period_ms: PERIOD_MS, heartbeats: HEARTBEATS });
        }
        let found = still(&self.heard.cells, self.gravity_m_s2);
        let times = faces_of(&found);
        if times.iter().all(|seconds| *seconds >= Self::ENOUGH_S) {
            return Ok(Step::Done(found));
        }
        Ok(Step::Lying(times))
    }

    /// What has stood still until now.
    pub fn found(&self) -> Vec<Still> {
        still(&self.heard.cells, self.gravity_m_s2)
    }

    /// Tells the node what was found, until it confirms that, and ends the heartbeats; `wait` passes some time.
    ///
    /// # Errors
    /// [`TumbleError::NotKept`], or what ends the conversation.
    pub fn tell(
        &mut self,
        calibration: &Calibration,
        clock: &dyn Fn() -> HostTime,
        line: &mut dyn Transport,
        wait: &mut dyn FnMut(&mut dyn Transport, Duration),
    ) -> Result<(), TumbleError> {
        self.session.pace(Pace { period_ms: PERIOD_MS, heartbeats: 0 });
        for _ in 0..MOST_TRIES {
            self.session.calibrate(calibration);
            let begun = clock();
            while clock().0.saturating_sub(begun.0) < TELL_AGAIN_US {
                self.service(clock, line)?;
                if self.session.hello().is_some_and(|hello| hello.calibration.as_ref() == Some(calibration)) {
                    return Ok(());
                }
                wait(line, Duration::from_millis(20));
            }
        }
        Err(TumbleError::NotKept { node: self.session.node() })
    }

    /// When there is something to do even if no byte arrives.
    pub fn next_due(&self) -> HostTime {
        self.session.next_due()
    }

    fn service(&mut self, clock: &dyn Fn() -> HostTime, line: &mut dyn Transport) -> Result<(), TumbleError> {
        match self.session.service(clock, line, &mut self.heard) {
            Err(SessionError::ForeignWindows { node }) => Err(TumbleError::HoldsWindows { node }),
            served => Ok(served?),
        }
    }
}

#[cfg(test)]
mod tests;
