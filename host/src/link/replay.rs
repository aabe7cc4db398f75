//! Replay: a recording fed to a node through its port, and the windows that come back.
//!
//! Rows flow in, windows flow out. The node's clock is the recording's, so that it may run faster than time; it says how far
//! it has come ([`belfry_shared::message::Fed`]), and no more rows are sent ahead than it can hold.

use std::collections::VecDeque;
use std::io;
use std::time::{Duration, Instant};

use belfry_shared::message::{
    Configuration, FeedPart, Greeting, Heartbeat, Hello, HostMessage, MAX_FEED, NodeMessage, Replay,
};
use belfry_shared::time::HostTime;
use thiserror::Error;

use super::delivery::{Delivery, Overdue};
use super::error::SessionError;
use super::greeting::{GreetingError, who_is_there};
use super::transport::Transport;
use super::wire::{Frame, Wire};
use crate::keys::Keys;
use crate::window::{Configurations, NodeWindow};

/// What is not answered within this time is said again.
const RETRY: Duration = Duration::from_millis(500);
/// How often, before the node counts as gone.
const TRIES: u32 = 20;

/// Why a replay ended early.
#[derive(Debug, Error)]
pub enum ReplayError {
    /// Nobody answers who could play the recording.
    #[error(transparent)]
    Greeting(#[from] GreetingError),
    /// The node's version or memory does not fit, or its line failed.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The node answers, but does not follow.
    #[error("node {node} answers, but does not {what}: switch it off and on again")]
    Unwilling {
        /// The node.
        node: u16,
        /// What it was asked to do.
        what: &'static str,
    },
    /// The node has stopped answering in the middle.
    #[error("the node stopped answering after row {row} of the recording")]
    Stopped {
        /// Rows that it has taken.
        row: u64,
    },
    /// The node restarted in the middle.
    #[error("the node restarted after row {row} of the recording{reason}")]
    Restarted {
        /// Rows that it had taken.
        row: u64,
        /// What it says of the end before.
        reason: String,
    },
}

/// What came back.
#[derive(Debug)]
pub struct Replayed {
    /// What the node says of itself.
    pub hello: Hello,
    /// Its windows, in order.
    pub windows: Vec<NodeWindow>,
    /// Rows that were fed.
    pub rows: u64,
    /// How long feeding took.
    pub took: Duration,
    /// Its last heartbeat.
    pub heartbeat: Option<Heartbeat>,
    /// Frames that came damaged, and parts that had to be said again.
    pub repeated: u64,
}

/// Lets the node on a line measure `rows` (readings in m/s², one a channel), of which the first was at `start`. It ends where
/// `rows` do. A node with a key needs it among `keys`.
///
/// # Errors
/// [`ReplayError`].
pub fn replay(
    transport: &mut dyn Transport,
    keys: &Keys,
    configuration: &Configuration,
    start: HostTime,
    mut rows: impl Iterator<Item = Vec<f32>>,
    on_rows: &mut dyn FnMut(u64),
) -> Result<Replayed, ReplayError> {
    let Hello { node, counters, .. } = who_is_there(transport, RETRY * TRIES)?;
    let mut player = Player::new(transport, node, configuration);
    match keys.of(node) {
        Some(key) => player.wire.set_key(key.clone()),
        None if counters.is_some() => return Err(SessionError::KeyMissing { node }.into()),
        None => {}
    }
    player.greet()?;
    player.configure(configuration)?;
    let hello = player.start(start)?;
    let began = Instant::now();
    let rows_a_part = (MAX_FEED / usize::from(configuration.channels.max(1))).max(1);
    loop {
        let readings: Vec<Vec<f32>> = rows.by_ref().take(rows_a_part).collect();
        if readings.is_empty() {
            break;
        }
        let next_row = player.row + readings.len() as u64;
        let part = FeedPart { first_row: player.row, readings: readings.into_iter().flatten().collect() };
        player.feed(part, next_row)?;
        on_rows(player.row);
    }
    let took = began.elapsed();
    player.say(&HostMessage::EndReplay)?;
    let repeated = player.repeated();
    Ok(Replayed { hello, windows: player.windows, rows: player.row, took, heartbeat: player.heartbeat, repeated })
}

/// A node that measures a recording.
struct Player<'a> {
    transport: &'a mut dyn Transport,
    wire: Wire,
    /// Frames whose messages wait to be looked at.
    frames: VecDeque<Frame>,
    node: u16,
    delivery: Delivery,
    /// Rows that the node has taken.
    row: u64,
    windows: Vec<NodeWindow>,
    heartbeat: Option<Heartbeat>,
    /// How often something was said again.
    retries: u64,
}

impl<'a> Player<'a> {
    fn new(transport: &'a mut dyn Transport, node: u16, configuration: &Configuration) -> Self {
        Self {
            transport,
            wire: Wire::new(),
            frames: VecDeque::new(),
            node,
            delivery: Delivery::new(node, Configurations::only(configuration.clone())),
            row: 0,
            windows: Vec::new(),
            heartbeat: None,
            retries: 0,
        }
    }

    fn repeated(&self) -> u64 {
        self.retries + self.wire.counts().damaged_frames + self.delivery.counts().asked_again
    }

    fn failed(&self, source: io::Error) -> SessionError {
        SessionError::Transport { node: self.node, source }
    }

    fn say(&mut self, message: &HostMessage) -> Result<(), SessionError> {
        self.wire.say(message);
        self.wire.send(self.transport).map(drop).map_err(|source| self.failed(source))
    }

    /// The next frame, where one comes before `deadline`.
    fn next_frame(&mut self, deadline: Instant) -> Result<Option<Frame>, SessionError> {
        let mut buffer = [0; 4096];
        loop {
            if let Some(frame) = self.frames.pop_front() {
                return Ok(Some(frame));
            }
            if Instant::now() > deadline {
                return Ok(None);
            }
            let count = self.transport.read(&mut buffer).map_err(|source| self.failed(source))?;
            self.frames.extend(self.wire.receive(&buffer[..count]));
        }
    }

    /// The message of a frame, where it can be read.
    fn message<'f>(&mut self, frame: &'f Frame) -> Result<Option<NodeMessage<'f>>, SessionError> {
        self.wire.message(frame).map_err(|why| SessionError::untaken(self.node, why))
    }

    /// Says something until a greeting of the node shows that it was done.
    fn hello_after(
        &mut self,
        message: &HostMessage,
        what: &'static str,
        is_done: impl Fn(&Hello) -> bool,
    ) -> Result<Hello, ReplayError> {
        for _ in 0..TRIES {
            self.say(message)?;
            let deadline = Instant::now() + RETRY;
            while let Some(frame) = self.next_frame(deadline)? {
                match self.message(&frame)? {
                    Some(NodeMessage::Hello(hello)) if is_done(&hello) => return Ok(hello),
                    Some(NodeMessage::Refused(refusal)) => {
                        return Err(SessionError::Refused { node: self.node, reason: refusal.reason }.into());
                    }
                    _ => {}
                }
            }
            self.retries += 1;
        }
        Err(ReplayError::Unwilling { node: self.node, what })
    }

    /// Makes the node listen to this host.
    fn greet(&mut self) -> Result<(), ReplayError> {
        let conversation = Some(self.wire.conversation());
        let greet = HostMessage::Greet(Greeting::OF_HOSTS);
        self.hello_after(&greet, "listen", |hello| hello.conversation == conversation).map(drop)
    }

    fn configure(&mut self, configuration: &Configuration) -> Result<(), ReplayError> {
        let hash = Some(configuration.hash());
        let configure = HostMessage::Configure(configuration.clone());
        self.hello_after(&configure, "take its configuration", |hello| hello.configuration_hash == hash).map(drop)
    }

    /// Starts a recording; the heartbeat behind the greeting says which number its first window will have.
    fn start(&mut self, start: HostTime) -> Result<Hello, ReplayError> {
        let what = "start the recording";
        for _ in 0..TRIES {
            let hello = self.hello_after(&HostMessage::Replay(Replay { start }), what, |hello| hello.replaying)?;
            let deadline = Instant::now() + RETRY;
            while let Some(frame) = self.next_frame(deadline)? {
                if let Some(NodeMessage::Heartbeat(heartbeat)) = self.message(&frame)? {
                    self.delivery.begin(hello.boot, heartbeat.next_window);
                    return Ok(hello);
                }
            }
        }
        Err(ReplayError::Unwilling { node: self.node, what })
    }

    /// Feeds a part until the node has taken it, and takes its windows meanwhile.
    fn feed(&mut self, part: FeedPart, next_row: u64) -> Result<(), ReplayError> {
        let message = HostMessage::Feed(part);
        for _ in 0..TRIES {
            self.say(&message)?;
            let is_taken = self.listen_until(next_row)?;
            // Everything that came of the rows has been sent before the node says that it has taken them: what is missing now
            // was lost on the way.
            let now = HostTime(0);
            let overdue = Overdue { now, before: now, answered: HostTime(1), is_busy: false };
            let is_missing = is_taken && !self.delivery.has_all();
            let acknowledgements = self.delivery.acknowledgements(is_missing.then_some(overdue));
            let asks_again = acknowledgements.iter().any(|acknowledgement| !acknowledgement.again.is_empty());
            for acknowledgement in acknowledgements {
                self.say(&HostMessage::Acknowledge(acknowledgement))?;
            }
            if asks_again {
                // The rows are said again with it: the answer shows that what was asked for has been sent.
                continue;
            }
            if is_taken {
                return Ok(());
            }
            self.retries += 1;
        }
        Err(ReplayError::Stopped { row: self.row })
    }

    /// Takes what comes until the node has taken all rows before `next_row`; whether it has in time.
    fn listen_until(&mut self, next_row: u64) -> Result<bool, ReplayError> {
        let deadline = Instant::now() + RETRY;
        while let Some(frame) = self.next_frame(deadline)? {
            let Some(message) = self.message(&frame)? else { continue };
            match &message {
                NodeMessage::Fed(progress) => {
                    self.row = progress.next_row;
                    if self.row >= next_row {
                        return Ok(true);
                    }
                }
                NodeMessage::Hello(hello) if Some(hello.boot) != self.delivery.boot() || !hello.replaying => {
                    let reason = hello.fault.as_ref().map_or(String::new(), |fault| format!(": {fault}"));
                    return Err(ReplayError::Restarted { row: self.row, reason });
                }
                NodeMessage::Heartbeat(heartbeat) => {
                    self.delivery.holds(heartbeat.boot, heartbeat.oldest_window, heartbeat.next_window);
                    self.heartbeat = Some(heartbeat.clone());
                }
                NodeMessage::Hello(_) | NodeMessage::Refused(_) | NodeMessage::Clock(_) => {}
                // A recording's time is its own.
                part => self.delivery.take(None, part, &frame.encoded, &mut self.windows)?,
            }
        }
        Ok(false)
    }
}
