//! Replay: a recording fed to a node through its port, and the windows that come back.
//!
//! Rows flow in, windows flow out. The node's clock is the recording's, so that it may run faster than time; it says how far
//! it has come ([`belfry_shared::message::Fed`]), and no more rows are sent ahead than it can hold.

use std::time::{Duration, Instant};

use belfry_firmware::{Memory, Node};
use belfry_shared::frame::{FrameDecoder, FrameError, MAX_FRAME_BYTES, PROTOCOL_VERSION};
use belfry_shared::message::{
    self, Acknowledgement, Configuration, FeedPart, Heartbeat, Hello, HostMessage, MAX_FEED, NodeMessage, Replay,
};
use belfry_shared::time::{HostTime, NodeTime};
use thiserror::Error;

use super::assembly::{Assembler, Configurations, Outcome};
use super::session::check_build;
use super::{NodeWindow, SessionError, Transport};

/// What is not answered within this time is said again.
const RETRY: Duration = Duration::from_millis(500);
/// How often, before the node counts as gone.
const TRIES: u32 = 20;

/// Why a replay ended early.
#[derive(Debug, Error)]
pub enum ReplayError {
    /// The node's version, build or memory does not fit, or its line failed.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The node that answers speaks another version of the protocol.
    #[error(
        "the node speaks protocol version {found}, this host speaks version {PROTOCOL_VERSION}: flash it with the firmware of this release"
    )]
    Version {
        /// The version it speaks.
        found: u8,
    },
    /// The line failed before it was known who is there.
    #[error("the line failed")]
    Line {
        /// The cause.
        source: std::io::Error,
    },
    /// Nothing answers.
    #[error("nothing answers on the line: is the node powered, and does no other program use the port?")]
    Silent,
    /// The node has stopped to answer in the middle.
    #[error("the node stopped to answer after row {row} of the recording")]
    Stopped {
        /// Rows that it has taken.
        row: u64,
    },
    /// The node has started anew in the middle.
    #[error("the node started anew after row {row} of the recording{reason}")]
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

/// Asks who is on a line.
///
/// # Errors
/// [`ReplayError::Silent`], the version or build where it is another one, or what is wrong with the line.
pub fn who_is_there(transport: &mut dyn Transport, patience: Duration) -> Result<Hello, ReplayError> {
    let mut line = Conversation::new(transport);
    let start = Instant::now();
    while start.elapsed() < patience {
        line.say(&HostMessage::Greet)?;
        if let Some(hello) = line.listen(RETRY, |message| match message {
            NodeMessage::Hello(hello) => Some(hello.clone()),
            _ => None,
        })? {
            check_build(hello.node, &hello)?;
            return Ok(hello);
        }
    }
    Err(ReplayError::Silent)
}

/// Lets the node on a line measure `rows` (readings in m/s², one a channel), of which the first was at `start`.
///
/// # Errors
/// [`ReplayError`]; the node is told to measure with its sensor again wherever it still listens.
pub fn replay(
    transport: &mut dyn Transport,
    configuration: &Configuration,
    start: HostTime,
    rows: impl Iterator<Item = Vec<f32>>,
    on_rows: &mut dyn FnMut(u64),
) -> Result<Replayed, ReplayError> {
    let hello = who_is_there(transport, RETRY * TRIES)?;
    let mut line = Conversation::new(transport);
    line.configure(configuration, &hello)?;
    let (hello, next_window) = line.start(hello.node, start)?;
    let mut assembler = Assembler::new(hello.boot);
    assembler.heartbeat(next_window, next_window);
    let began = Instant::now();
    let mut fed = Fed { row: 0, windows: Vec::new(), heartbeat: None };
    let mut rows = rows;
    let configurations = Configurations::only(configuration.clone());
    let rows_a_part = (MAX_FEED / usize::from(configuration.channels.max(1))).max(1);
    loop {
        let readings: Vec<Vec<f32>> = rows.by_ref().take(rows_a_part).collect();
        if readings.is_empty() {
            break;
        }
        let next = fed.row + readings.len() as u64;
        let part = FeedPart { first_row: fed.row, readings: readings.into_iter().flatten().collect() };
        line.feed(&configurations, &part, next, &mut assembler, &mut fed)?;
        on_rows(fed.row);
    }
    let took = began.elapsed();
    line.say(&HostMessage::EndReplay)?;
    let repeated = line.repeated;
    Ok(Replayed { hello, windows: fed.windows, rows: fed.row, took, heartbeat: fed.heartbeat, repeated })
}

/// What feeding has come to.
struct Fed {
    row: u64,
    windows: Vec<NodeWindow>,
    heartbeat: Option<Heartbeat>,
}

/// Looks at a message and its encoding; whether it was the one that is waited for.
type Look<'a> = dyn FnMut(&NodeMessage<'_>, &[u8]) -> Result<bool, ReplayError> + 'a;

/// Messages over a transport.
struct Conversation<'a> {
    transport: &'a mut dyn Transport,
    decoder: FrameDecoder,
    /// Frames whose messages wait to be looked at.
    frames: std::collections::VecDeque<Vec<u8>>,
    repeated: u64,
    /// The node, once it is known.
    node: Option<u16>,
}

impl<'a> Conversation<'a> {
    fn new(transport: &'a mut dyn Transport) -> Self {
        Self {
            transport,
            decoder: FrameDecoder::new(),
            frames: std::collections::VecDeque::new(),
            repeated: 0,
            node: None,
        }
    }

    fn failed(&self, source: std::io::Error) -> ReplayError {
        match self.node {
            Some(node) => SessionError::Transport { node, source }.into(),
            None => ReplayError::Line { source },
        }
    }

    fn say(&mut self, message: &HostMessage) -> Result<(), ReplayError> {
        let mut frame = [0; MAX_FRAME_BYTES];
        // Messages of the host fit by their types.
        let length = message::encode(message, &mut frame).unwrap_or(0);
        self.transport.write(&frame[..length]).map_err(|source| self.failed(source))
    }

    /// Looks at messages until `wanted` takes one, or the time is up.
    fn listen<T>(
        &mut self,
        patience: Duration,
        mut wanted: impl FnMut(&NodeMessage<'_>) -> Option<T>,
    ) -> Result<Option<T>, ReplayError> {
        let mut answer = None;
        self.listen_encoded(patience, &mut |message, _| {
            answer = wanted(message);
            Ok(answer.is_some())
        })?;
        Ok(answer)
    }

    /// The same, with the messages' encodings; whether one was taken.
    fn listen_encoded(&mut self, patience: Duration, wanted: &mut Look<'_>) -> Result<bool, ReplayError> {
        let start = Instant::now();
        let mut buffer = [0; 4096];
        loop {
            while let Some(frame) = self.frames.pop_front() {
                match message::decode::<NodeMessage<'_>>(&frame) {
                    Ok(message) => {
                        if wanted(&message, &frame)? {
                            return Ok(true);
                        }
                    }
                    Err(_) => self.repeated += 1,
                }
            }
            if start.elapsed() > patience {
                return Ok(false);
            }
            let count = self.transport.read(&mut buffer).map_err(|source| self.failed(source))?;
            for &byte in &buffer[..count] {
                match self.decoder.push(byte) {
                    None => {}
                    Some(Ok(frame)) => self.frames.push_back(frame.to_vec()),
                    Some(Err(FrameError::Version { found })) => {
                        return Err(ReplayError::Version { found });
                    }
                    Some(Err(_)) => self.repeated += 1,
                }
            }
        }
    }

    /// Says something until a greeting of the node shows that it was done.
    fn hello_after(
        &mut self,
        node: u16,
        message: &HostMessage,
        done: impl Fn(&Hello) -> bool,
    ) -> Result<Hello, ReplayError> {
        for _ in 0..TRIES {
            self.say(message)?;
            let hello = self.listen(RETRY, |message| match message {
                NodeMessage::Hello(hello) if done(hello) => Some(Ok(hello.clone())),
                NodeMessage::Refused(refusal) => Some(Err(refusal.reason)),
                _ => None,
            })?;
            match hello {
                Some(Ok(hello)) => return Ok(hello),
                Some(Err(reason)) => return Err(SessionError::Refused { node, reason }.into()),
                None => self.repeated += 1,
            }
        }
        Err(ReplayError::Silent)
    }

    fn configure(&mut self, configuration: &Configuration, hello: &Hello) -> Result<(), ReplayError> {
        self.node = Some(hello.node);
        let hash = Some(configuration.hash());
        let configure = HostMessage::Configure(configuration.clone());
        self.hello_after(hello.node, &configure, |hello| hello.configuration_hash == hash).map(drop)
    }

    /// Starts a recording; the greeting, and the number that the first window will have.
    fn start(&mut self, node: u16, start: HostTime) -> Result<(Hello, u32), ReplayError> {
        for _ in 0..TRIES {
            let hello = self.hello_after(node, &HostMessage::Replay(Replay { start }), |hello| hello.replaying)?;
            let next_window = self.listen(RETRY, |message| match message {
                NodeMessage::Heartbeat(heartbeat) => Some(heartbeat.next_window),
                _ => None,
            })?;
            if let Some(next_window) = next_window {
                return Ok((hello, next_window));
            }
        }
        Err(ReplayError::Silent)
    }

    /// Feeds a part until the node has taken it, and takes its windows meanwhile.
    fn feed(
        &mut self,
        configurations: &Configurations,
        part: &FeedPart,
        next: u64,
        assembler: &mut Assembler,
        fed: &mut Fed,
    ) -> Result<(), ReplayError> {
        let message = HostMessage::Feed(part.clone());
        for _ in 0..TRIES {
            self.say(&message)?;
            let stored = fed.windows.len();
            let taken = self.listen_encoded(RETRY, &mut |message, encoded| match message {
                NodeMessage::Fed(progress) => {
                    fed.row = progress.next_row;
                    Ok(progress.next_row >= next)
                }
                NodeMessage::Hello(hello) if hello.boot != assembler.boot() || !hello.replaying => {
                    let reason = hello.fault.as_ref().map_or(String::new(), |fault| format!(": {fault}"));
                    Err(ReplayError::Restarted { row: fed.row, reason })
                }
                NodeMessage::Heartbeat(heartbeat) => {
                    fed.heartbeat = Some(heartbeat.clone());
                    assembler.heartbeat(heartbeat.oldest_window, heartbeat.next_window);
                    Ok(false)
                }
                NodeMessage::Hello(_) | NodeMessage::Refused(_) | NodeMessage::Clock(_) => Ok(false),
                part => {
                    if let Outcome::Whole(window) = assembler.take(configurations, part, encoded) {
                        assembler.stored(window.name.number);
                        fed.windows.push(*window);
                    }
                    Ok(false)
                }
            })?;
            // Everything that came of the rows has been sent before the node says that it has taken them: what is missing now
            // was lost on the way.
            let now = HostTime(0);
            let again = if taken && !assembler.is_complete() {
                assembler.overdue(now, now, HostTime(1), false)
            } else {
                Vec::new()
            };
            if fed.windows.len() > stored || !again.is_empty() {
                self.repeated += again.len() as u64;
                let again_is_empty = again.is_empty();
                let (boot, below) = (assembler.boot(), assembler.below());
                self.say(&HostMessage::Acknowledge(Acknowledgement {
                    boot,
                    below,
                    again: again.into_iter().collect(),
                }))?;
                if !again_is_empty {
                    continue;
                }
            }
            if taken {
                return Ok(());
            }
            self.repeated += 1;
        }
        Err(ReplayError::Stopped { row: fed.row })
    }
}

/// The node's own code, in process, at the other end of a line that carries everything at once.
pub struct InProcess {
    node: Node<Box<Memory>>,
}

impl std::fmt::Debug for InProcess {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("InProcess")
    }
}

impl InProcess {
    /// A node as it starts.
    pub fn new(identity: belfry_firmware::Identity) -> Self {
        Self { node: Node::new(identity, Box::new(Memory::new())) }
    }
}

impl Transport for InProcess {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        for &byte in bytes {
            self.node.receive(NodeTime(0), byte);
        }
        Ok(())
    }

    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        while self.node.poll(NodeTime(0)) {}
        Ok(self.node.transmit(NodeTime(0), buffer))
    }
}
