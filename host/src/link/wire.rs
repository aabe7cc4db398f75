//! Messages over a byte stream: bytes that have come become frames, messages become bytes that wait to be sent. The version in which both
//! ends go on is agreed here.

use std::collections::VecDeque;
use std::io;
use std::sync::OnceLock;

use belfry_shared::frame::{END_OF_FRAME, FrameDecoder, FrameError, MAX_FRAME_BYTES, PROTOCOL_VERSION};
use belfry_shared::message::{
    self, Conversation, Hello, HostMessage, InConversation, NodeMessage, Versions, version_5,
};
use thiserror::Error;

use super::transport::Transport;

/// How often a line is read before anything else has its turn: a peer that never pauses must not keep its host from looking at the time, or from
/// ending.
pub(super) const MOST_READS: usize = 64;

/// The number under which this program speaks with nodes.
pub fn conversation() -> Conversation {
    static CONVERSATION: OnceLock<Conversation> = OnceLock::new();
    *CONVERSATION.get_or_init(|| Conversation(rand::random()))
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
}

/// What has passed.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct WireCounts {
    pub(super) bytes_received: u64,
    pub(super) bytes_sent: u64,
    pub(super) frames: u64,
    pub(super) damaged_frames: u64,
    pub(super) unknown_messages: u64,
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
    outgoing: VecDeque<u8>,
    counts: WireCounts,
}

impl Wire {
    pub(super) fn new() -> Self {
        Self::of(conversation())
    }

    /// The end of another program than this one.
    fn of(conversation: Conversation) -> Self {
        Self {
            conversation,
            decoder: FrameDecoder::new(),
            frame_bytes: 0,
            joins_midway: false,
            version: None,
            tried: version_5::VERSION,
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

    /// Whether a node that says this listens to this end.
    pub(super) fn is_listened_to(&self, hello: &Hello) -> bool {
        hello.conversation == Some(self.conversation)
    }

    /// Whether a node that says this answers a greeting or question of this end.
    pub(super) fn is_answered_by(&self, hello: &Hello) -> bool {
        hello.answers == Some(self.conversation)
    }

    pub(super) fn counts(&self) -> WireCounts {
        self.counts
    }

    /// Queues a message; how many bytes it has on the line.
    pub(super) fn say(&mut self, message: &HostMessage) -> usize {
        let mut frame = [0; MAX_FRAME_BYTES];
        let message = InConversation { conversation: self.conversation, message: message.clone() };
        // The host's messages fit into a frame by their types.
        let length = match self.version.unwrap_or_else(|| self.next_try()) {
            version_5::VERSION => version_5::encode_host(&message, &mut frame),
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

    /// Sends what is queued.
    pub(super) fn send(&mut self, transport: &mut dyn Transport) -> io::Result<()> {
        if self.outgoing.is_empty() {
            return Ok(());
        }
        let bytes: Vec<u8> = self.outgoing.drain(..).collect();
        self.counts.bytes_sent += bytes.len() as u64;
        transport.write(&bytes)
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

    /// The message of a frame. `None` where it cannot be read, which counts as damage, or where only a later version knows it.
    ///
    /// # Errors
    /// Where the node speaks no version that this host does.
    pub(super) fn message<'f>(&mut self, frame: &'f Frame) -> Result<Option<NodeMessage<'f>>, NoCommonVersion> {
        let Frame { version, ref encoded, .. } = *frame;
        let message = match version {
            version_5::VERSION => version_5::decode_node(encoded),
            PROTOCOL_VERSION => message::decode(encoded),
            // Versions before that have greetings of their own; but they were never spoken beside another.
            ..version_5::VERSION => {
                return Err(NoCommonVersion { versions: Versions { lowest: version, highest: version } });
            }
            // All that can be read is who is there. The rest is for whom the node has agreed on that version with.
            _ => match message::decode(encoded) {
                Ok(NodeMessage::Hello(hello)) => Ok(NodeMessage::Hello(hello)),
                _ => Err(FrameError::Unknown { key: 0 }),
            },
        };
        match &message {
            Ok(NodeMessage::Hello(Hello { versions, .. })) => {
                let common = Versions::OF_HOSTS.common(*versions);
                self.version = Some(common.ok_or(NoCommonVersion { versions: *versions })?);
                self.counts.frames += 1;
            }
            Ok(_) => self.counts.frames += 1,
            Err(FrameError::Unknown { .. }) => self.counts.unknown_messages += 1,
            Err(_) => self.counts.damaged_frames += 1,
        }
        Ok(message.ok())
    }
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
