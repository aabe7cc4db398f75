//! The node: well-formed messages of hosts in any order, samples, noise and time.

use belfry_firmware::{Identity, Memory, Node};
use belfry_shared::frame::{FrameDecoder, MAX_FRAME_BYTES, MAX_MESSAGE_BYTES};
use belfry_shared::message::{self, Conversation, Greeting, HostMessage, InConversation, NodeMessage};
use belfry_shared::seal::{Key, Sender};
use belfry_shared::time::NodeTime;

use super::input::Input;

/// Rows that are sampled at most.
const MOST_ROWS: u64 = 4096;
/// Times at which the node is to be right: a century.
const LATEST_US: u64 = 3_200_000_000_000_000;

const BOOT: u32 = 7;
/// The key of a node that has one, and another.
const KEY: Key = Key::new([0x4B; 32]);
const OTHER_KEY: Key = Key::new([0x4C; 32]);

struct Bench {
    node: Node<Box<Memory>>,
    /// Of a node with a key: what hosts have sealed so far.
    sealed: Option<u32>,
    time: NodeTime,
    heard: FrameDecoder,
    channels: u8,
}

impl Bench {
    fn hear(&mut self, conversation: u8, message: HostMessage) {
        self.hear_with(&KEY, conversation, message);
    }

    /// A message with a seal of another key, or of none, changes nothing.
    fn hear_forged(&mut self, conversation: u8, message: HostMessage) {
        let (rate, sealed) = (self.node.sampling_rate_uhz(), self.sealed);
        if conversation.is_multiple_of(2) {
            self.sealed = None;
        }
        self.hear_with(&OTHER_KEY, conversation, message);
        self.sealed = sealed;
        assert_eq!(self.node.sampling_rate_uhz(), rate, "the node has obeyed somebody without its key");
    }

    fn hear_with(&mut self, key: &Key, conversation: u8, mut message: HostMessage) {
        let counter = self.sealed.map(|sealed| sealed.saturating_add(1));
        if let (HostMessage::Greet(greeting), Some(counter)) = (&mut message, counter) {
            greeting.counter = counter;
        }
        let message = InConversation { conversation: Conversation([conversation; 4]), message };
        let (mut buffer, mut frame) = ([0; MAX_MESSAGE_BYTES], [0; MAX_FRAME_BYTES]);
        // Rows of a recording may take more than a frame has.
        let length = match counter {
            None => message::encode(&message, &mut frame),
            Some(counter) => message::bytes(&message, &mut buffer)
                .and_then(|bytes| key.encode(Sender::Host, BOOT, counter, bytes, &mut frame)),
        };
        let Ok(length) = length else { return };
        self.sealed = counter;
        frame[..length].iter().for_each(|&byte| self.node.receive(self.time, byte));
    }

    fn sample(&mut self, rows: u64, reading: u64) {
        let period_us = self.node.sampling_rate_uhz().map_or(1000, |rate_uhz| 1_000_000_000_000 / rate_uhz.max(1));
        for row in 0..rows {
            self.time = NodeTime((self.time.0 + period_us).min(LATEST_US));
            let value = match reading % 4 {
                0 => f32::from_bits((reading >> 2) as u32),
                1 => (row as f32 * 0.37).sin(),
                2 => 25.0,
                _ => 0.0,
            };
            self.node.sample(self.time, &[value; 4][..usize::from(self.channels)]);
            while self.node.poll(self.time) {}
        }
    }

    /// Has the node say what it has to say; all of it can be read.
    fn listen(&mut self, most: usize) {
        let mut out = [0; MAX_FRAME_BYTES];
        for _ in 0..most {
            let count = self.node.transmit(self.time, &mut out);
            if count == 0 {
                assert!(!self.node.has_bytes(), "the node has something to say and says nothing");
                return;
            }
            for &byte in &out[..count] {
                match self.heard.push(byte) {
                    None => {}
                    Some(Ok(frame)) => {
                        let read = message::decode::<NodeMessage<'_>>(frame.message);
                        assert!(read.is_ok(), "a message that cannot be read");
                    }
                    Some(Err(error)) => panic!("a frame that cannot be read: {error}"),
                }
            }
        }
    }
}

/// A node is told and shown what the bytes say.
///
/// # Panics
/// Where the node does, or says what cannot be read.
pub fn node(bytes: &[u8]) {
    let mut input = Input(bytes);
    let first = input.number::<1>();
    let (channels, has_key) = (1 + (first % 4) as u8, first >= 0x80);
    let identity = Identity { node: 3, boot: BOOT, channels, full_scale_m_s2: 20.0, highest_rate_mhz: 4_000_000 };
    let mut node = Node::new(identity, Box::new(Memory::new()));
    if has_key {
        node.set_key(Some(KEY));
    }
    let sealed = has_key.then_some(0);
    let mut bench = Bench { node, sealed, time: NodeTime(1), heard: FrameDecoder::new(), channels };
    let mut rows_left = MOST_ROWS;
    bench.hear(1, HostMessage::Greet(Greeting::OF_HOSTS));
    while let Some(choice) = input.byte() {
        match choice % 8 {
            0..=2 => {
                if let Some(said) = input.message::<InConversation>() {
                    let conversation = if choice < 0xE0 { 1 } else { 2 };
                    if has_key && choice % 8 == 2 {
                        bench.hear_forged(conversation, said.message);
                    } else {
                        bench.hear(conversation, said.message);
                    }
                }
            }
            3 => bench.time = NodeTime(bench.time.0.saturating_add(input.number::<5>()).min(LATEST_US)),
            4 | 5 => {
                let rows = input.number::<2>().min(rows_left);
                rows_left -= rows;
                bench.sample(rows, input.number::<4>());
            }
            6 => {
                let noise = input.byte().unwrap_or(0);
                bench.node.receive(bench.time, noise);
            }
            _ => {
                while bench.node.poll(bench.time) {}
                bench.listen(usize::from(choice));
            }
        }
    }
    while bench.node.poll(bench.time) {}
    bench.listen(1024);
}
