//! Messages over a byte stream: bytes that have come become frames, messages become bytes that wait to be sent. The version in which both
//! ends go on is agreed here.

use std::collections::VecDeque;
use std::io;

use belfry_shared::frame::{
    END_OF_FRAME, FrameDecoder, FrameError, MAX_FRAME_BYTES, MAX_MESSAGE_BYTES, Opened, PROTOCOL_VERSION, Seal,
};
use belfry_shared::message::{
    self, Conversation, Greeting, Hello, HostMessage, InConversation, NodeMessage, Versions, version_5,
};
use belfry_shared::seal::{Key, Sender, next_counter};
use thiserror::Error;

use super::transport::Transport;

/// How often a line is read before anything else has its turn: a peer that never pauses must not keep its host from looking at the time, or from
/// ending.
pub(super) const MOST_READS: usize = 64;

/// Of so many frames without a sound seal, one is answered with a question.
const ASK_EVERY: u64 = 8;
/// So many sealed frames may be on their way to a node, or lost, before it is greeted: fewer than their counters tell apart.
const MOST_UNHEARD: u32 = 100;

/// Why nothing that a node says can be taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub(super) enum Untaken {
    /// It speaks other versions.
    #[error(transparent)]
    Version(#[from] NoCommonVersion),
    /// It answers, and has no key.
    #[error("answers without its key")]
    Unsealed,
    /// It answers, and has another key.
    #[error("has another key")]
    OtherKey,
}

/// The present boot of a node with a key, and how far sealed frames have been counted in it.
#[derive(Debug, Clone, Copy)]
struct Proven {
    boot: u32,
    /// The counter of the last frame to the node, of this host or, as the node says, of another.
    said: u32,
    /// The counter of the last frame of the node.
    heard: u32,
}

/// What a frame of a node with a key is worth.
enum Worth {
    /// The node has said it now, and once.
    Sound,
    /// Anybody may have said it, or it has been heard before.
    None,
    /// The node is in another boot, or was once: it is asked.
    OtherBoot,
}

/// The node on the line speaks no version that this host speaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error(
    "speaks {versions} of the protocol, this host speaks {host}: {advice}",
    host = Versions::OF_HOSTS,
    advice = if .versions.highest < Versions::OF_HOSTS.lowest {
        "flash the node with the firmware of this release"
    } else {
        "update Belfry on this computer to the release of the node's firmware"
    }
)]
pub struct NoCommonVersion {
    /// What it speaks, as far as its frames say so.
    pub versions: Versions,
}

/// A frame that has come undamaged.
#[derive(Debug)]
pub(super) struct Frame {
    /// The version of its message.
    version: u8,
    /// Its message, encoded.
    pub(super) encoded: Vec<u8>,
    /// Bytes that it had on the line.
    pub(super) bytes: usize,
    seal: Option<Seal>,
}

impl Frame {
    fn opened(&self) -> Opened<'_> {
        Opened { version: self.version, message: &self.encoded, seal: self.seal }
    }
}

/// What has passed.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct WireCounts {
    pub(super) bytes_received: u64,
    pub(super) bytes_sent: u64,
    pub(super) frames: u64,
    pub(super) damaged_frames: u64,
    pub(super) unknown_messages: u64,
    pub(super) unsealed_frames: u64,
}

/// The host's end of a byte stream.
#[derive(Debug)]
pub(super) struct Wire {
    conversation: Conversation,
    decoder: FrameDecoder,
    /// Bytes since the last frame ended.
    frame_bytes: usize,
    /// Whether the first bytes may be the end of a frame that the node began before this end listened.
    joins_midway: bool,
    /// The version that is agreed; `None` before the node has said what it speaks.
    version: Option<u8>,
    /// The version of the last greeting before that.
    tried: u8,
    /// The node's key, where it has one.
    key: Option<Key>,
    /// What is known of a node with a key; `None` before it has answered.
    proven: Option<Proven>,
    /// Boots that it has left: what it has said in them counts never again, although it may answer this end.
    left: Vec<u32>,
    outgoing: VecDeque<u8>,
    counts: WireCounts,
}

impl Wire {
    /// An end that speaks under a number of its own: what a node has answered to any other end, also to one of this program in an earlier
    /// boot, is no answer to it.
    pub(super) fn new() -> Self {
        Self {
            conversation: Conversation(rand::random()),
            decoder: FrameDecoder::new(),
            frame_bytes: 0,
            joins_midway: false,
            version: None,
            tried: version_5::VERSION,
            key: None,
            proven: None,
            left: Vec::new(),
            outgoing: VecDeque::new(),
            counts: WireCounts::default(),
        }
    }

    /// Goes on with another stream of the same node, which may be in the middle of a frame: what cannot be read up to the first
    /// end mark was cut off by joining late, not damaged on the way.
    pub(super) fn reconnect(&mut self) {
        self.decoder = FrameDecoder::new();
        self.frame_bytes = 0;
        self.joins_midway = true;
        // It may have been flashed meanwhile.
        self.version = None;
    }

    /// The number under which it speaks.
    pub(super) fn conversation(&self) -> Conversation {
        self.conversation
    }

    /// Speaks under another number.
    pub(super) fn set_conversation(&mut self, conversation: Conversation) {
        self.conversation = conversation;
    }

    /// Takes nothing any more from the node that is not sealed with its key.
    pub(super) fn set_key(&mut self, key: Key) {
        self.key = Some(key);
    }

    /// Whether the node has a key here.
    pub(super) fn has_key(&self) -> bool {
        self.key.is_some()
    }

    /// Whether a node that says this listens to this end.
    pub(super) fn is_listened_to(&self, hello: &Hello) -> bool {
        hello.conversation == Some(self.conversation)
    }

    /// Whether a node that says this hears nothing more but a greeting: too many sealed frames in a row have not come to it.
    pub(super) fn is_out_of_step(&self, hello: &Hello) -> bool {
        let heard = hello.counters.map_or(0, |counters| counters.heard);
        self.proven.is_some_and(|proven| proven.said.saturating_sub(heard) > MOST_UNHEARD)
    }

    /// Whether a node that says this answers a greeting or question of this end.
    pub(super) fn is_answered_by(&self, hello: &Hello) -> bool {
        hello.answers == Some(self.conversation)
    }

    pub(super) fn counts(&self) -> WireCounts {
        self.counts
    }

    /// Queues a message; how many bytes it has on the line. Before a node with a key has answered, nothing can be said to it but the question
    /// who it is, which takes a greeting's place.
    pub(super) fn say(&mut self, message: &HostMessage) -> usize {
        let mut frame = [0; MAX_FRAME_BYTES];
        let message = match (&self.key, self.proven, message) {
            (Some(_), None, HostMessage::Greet(greeting)) => HostMessage::Ask(greeting.versions),
            (Some(_), Some(proven), HostMessage::Greet(greeting)) => {
                HostMessage::Greet(Greeting { counter: proven.said.saturating_add(1), ..*greeting })
            }
            (Some(_), None, HostMessage::Ask(_)) | (None, ..) | (_, Some(_), _) => message.clone(),
            (Some(_), None, _) => return 0,
        };
        let message = InConversation { conversation: self.conversation, message };
        // A node that has shown its key speaks a version that has keys: no frame without a seal may come from here any more.
        let first = self.proven.map(|_| PROTOCOL_VERSION);
        let version = self.version.or(first).unwrap_or_else(|| self.next_try());
        // The host's messages fit into a frame by their types.
        let length = match (&self.key, &mut self.proven) {
            (Some(key), Some(proven)) if version != version_5::VERSION => seal(key, proven, &message, &mut frame),
            _ if version == version_5::VERSION => version_5::encode_host(&message, &mut frame),
            _ => message::encode(&message, &mut frame),
        };
        let length = length.unwrap_or(0);
        self.outgoing.extend(&frame[..length]);
        length
    }

    /// A node of version 5 does not hear greetings of later ones, and those take its own for a question: so they take turns.
    fn next_try(&mut self) -> u8 {
        self.tried = if self.tried == PROTOCOL_VERSION { version_5::VERSION } else { PROTOCOL_VERSION };
        self.tried
    }

    /// Sends what is queued; how many bytes that is.
    pub(super) fn send(&mut self, transport: &mut dyn Transport) -> io::Result<usize> {
        if self.outgoing.is_empty() {
            return Ok(0);
        }
        let bytes: Vec<u8> = self.outgoing.drain(..).collect();
        self.counts.bytes_sent += bytes.len() as u64;
        transport.write(&bytes).map(|()| bytes.len())
    }

    /// The frames that end within `bytes`.
    pub(super) fn receive(&mut self, bytes: &[u8]) -> Vec<Frame> {
        self.counts.bytes_received += bytes.len() as u64;
        let mut frames = Vec::new();
        for &byte in bytes {
            self.frame_bytes += 1;
            match self.decoder.push(byte) {
                Some(Ok(opened)) => frames.push(Frame {
                    version: opened.version,
                    encoded: opened.message.to_vec(),
                    bytes: self.frame_bytes,
                    seal: opened.seal,
                }),
                Some(Err(_)) if self.joins_midway => {}
                Some(Err(_)) => self.counts.damaged_frames += 1,
                None => {}
            }
            if byte == END_OF_FRAME {
                self.frame_bytes = 0;
                self.joins_midway = false;
            }
        }
        frames
    }

    /// The message of a frame. `None` where it cannot be read, which counts as damage, where only a later version knows it, or where it lacks
    /// the seal that it should have.
    ///
    /// # Errors
    /// Where the node speaks no version that this host does, or answers a question without its key.
    pub(super) fn message<'f>(&mut self, frame: &'f Frame) -> Result<Option<NodeMessage<'f>>, Untaken> {
        // Nothing of a frame counts before its seal has been looked at.
        let message = match read(frame) {
            Ok(message) => message,
            Err(Unread::TooOld) if self.proven.is_some() => {
                self.refuse();
                return Ok(None);
            }
            Err(Unread::TooOld) => {
                let versions = Versions { lowest: frame.version, highest: frame.version };
                return Err(NoCommonVersion { versions }.into());
            }
            Err(Unread::Frame(FrameError::Unknown { .. })) => {
                self.counts.unknown_messages += 1;
                return Ok(None);
            }
            Err(Unread::Frame(_)) => {
                self.counts.damaged_frames += 1;
                return Ok(None);
            }
        };
        if self.key.is_some() {
            let worth = match &message {
                NodeMessage::Hello(hello) => self.weigh_hello(frame, hello)?,
                _ => self.weigh(frame),
            };
            match worth {
                Worth::Sound => {}
                Worth::OtherBoot => {
                    // Not greeted: an old greeting that somebody repeats must not cost more than a question.
                    self.say_unsealed(&HostMessage::Ask(Versions::OF_HOSTS));
                    return Ok(None);
                }
                Worth::None => {
                    self.refuse();
                    return Ok(None);
                }
            }
        }
        if let NodeMessage::Hello(Hello { versions, .. }) = &message {
            let common = Versions::OF_HOSTS.common(*versions);
            self.version = Some(common.ok_or(NoCommonVersion { versions: *versions })?);
        }
        self.counts.frames += 1;
        Ok(Some(message))
    }

    /// Counts a frame that is not taken.
    fn refuse(&mut self) {
        self.counts.unsealed_frames += 1;
        if self.counts.unsealed_frames % ASK_EVERY == 1 {
            // It may be that too many frames of the node were lost in a row; its answer says how far it has counted.
            self.say_unsealed(&HostMessage::Ask(Versions::OF_HOSTS));
        }
    }

    /// Whether a frame is the node's, of its present boot and new.
    fn weigh(&mut self, frame: &Frame) -> Worth {
        let (Some(key), Some(proven), Some(seal)) = (&self.key, &mut self.proven, frame.seal) else {
            return Worth::None;
        };
        let counter = next_counter(proven.heard, seal.counter);
        match counter.filter(|&counter| key.admits(Sender::Node, proven.boot, counter, &frame.opened())) {
            Some(counter) => {
                proven.heard = counter;
                Worth::Sound
            }
            None => Worth::None,
        }
    }

    /// The same for a greeting, which says itself for which boot and under which counter it was sealed. One of another boot is the present
    /// one's if it answers this host, whose number no node has known before, and if the node has not left that boot since.
    fn weigh_hello(&mut self, frame: &Frame, hello: &Hello) -> Result<Worth, Untaken> {
        let is_answer = self.is_answered_by(hello);
        // A node that has shown its key has it: whoever answers in its name without it is another.
        let is_unknown = is_answer && self.proven.is_none();
        let Some(key) = &self.key else { return Ok(Worth::None) };
        let Some(counters) = hello.counters.filter(|_| frame.seal.is_some()) else {
            return if is_unknown { Err(Untaken::Unsealed) } else { Ok(Worth::None) };
        };
        if !key.admits(Sender::Node, hello.boot, counters.said, &frame.opened()) {
            return if is_unknown { Err(Untaken::OtherKey) } else { Ok(Worth::None) };
        }
        match &mut self.proven {
            Some(proven) if proven.boot == hello.boot => {
                if counters.said <= proven.heard {
                    return Ok(Worth::None);
                }
                proven.heard = counters.said;
                // Another host with the key may have spoken meanwhile.
                proven.said = proven.said.max(counters.heard);
                Ok(Worth::Sound)
            }
            _ if self.left.contains(&hello.boot) => Ok(Worth::None),
            _ if is_answer => {
                self.left.extend(self.proven.map(|proven| proven.boot));
                self.proven = Some(Proven { boot: hello.boot, said: counters.heard, heard: counters.said });
                Ok(Worth::Sound)
            }
            _ => Ok(Worth::OtherBoot),
        }
    }

    fn say_unsealed(&mut self, message: &HostMessage) {
        let mut frame = [0; MAX_FRAME_BYTES];
        let message = InConversation { conversation: self.conversation, message: message.clone() };
        let length = message::encode(&message, &mut frame).unwrap_or(0);
        self.outgoing.extend(&frame[..length]);
    }
}

/// Why a frame's message is not known.
enum Unread {
    /// It is of a version that has never been spoken beside another, with greetings of its own.
    TooOld,
    Frame(FrameError),
}

/// The message of a frame; of versions beyond this one all that can be read is who is there. The rest is for whom the node has agreed on
/// that version with.
fn read(frame: &Frame) -> Result<NodeMessage<'_>, Unread> {
    let message = match frame.version {
        version_5::VERSION => version_5::decode_node(&frame.encoded),
        PROTOCOL_VERSION => message::decode(&frame.encoded),
        ..version_5::VERSION => return Err(Unread::TooOld),
        _ => match message::decode(&frame.encoded) {
            Ok(NodeMessage::Hello(hello)) => Ok(NodeMessage::Hello(hello)),
            _ => Err(FrameError::Unknown { kind: 0 }),
        },
    };
    message.map_err(Unread::Frame)
}

/// Writes the sealed frame of a message, and returns its length.
fn seal(
    key: &Key,
    proven: &mut Proven,
    message: &InConversation,
    frame: &mut [u8; MAX_FRAME_BYTES],
) -> Result<usize, FrameError> {
    let mut buffer = [0; MAX_MESSAGE_BYTES];
    let bytes = message::bytes(message, &mut buffer)?;
    proven.said = proven.said.checked_add(1).ok_or(FrameError::Message)?;
    key.encode(Sender::Host, proven.boot, proven.said, bytes, frame)
}

#[cfg(test)]
mod tests {
    use belfry_shared::frame::{MAX_FRAME_BYTES, encode};

    use super::Wire;

    #[test]
    fn the_rest_of_a_frame_that_began_earlier_is_no_damage_but_a_second_one_is() {
        let mut wire = Wire::new();
        wire.reconnect();
        assert!(wire.receive(&[7, 7, 7, 0]).is_empty());
        assert_eq!(wire.counts().damaged_frames, 0);
        assert!(wire.receive(&[7, 7, 7, 0]).is_empty());
        assert_eq!(wire.counts().damaged_frames, 1);
    }

    #[test]
    fn what_an_old_stream_left_does_not_join_the_first_frame_of_the_next() {
        let mut wire = Wire::new();
        wire.receive(&[9, 9]);
        wire.reconnect();
        let mut frame = [0; MAX_FRAME_BYTES];
        let length = encode(b"whole", &mut frame).unwrap();
        let frames = wire.receive(&frame[..length]);
        assert!(matches!(&frames[..], [first] if first.encoded == b"whole" && first.bytes == length));
    }
}
