//! Somebody on the line of a node with a key, who has not the key: repeats what either end has said, and makes frames up.

use std::collections::VecDeque;

use belfry_shared::frame::{END_OF_FRAME, FrameDecoder, MAX_FRAME_BYTES, MAX_MESSAGE_BYTES, encode};
use belfry_shared::message::{
    self, Acknowledgement, Band, Configuration, Conversation, Greeting, HostMessage, InConversation, NodeMessage,
    Summary, WindowHead, WindowName,
};
use belfry_shared::seal::{Key, Sender};
use belfry_shared::time::{ClockModel, HostTime, NodeTime};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::report::Report;

/// Frames of each end that it remembers: of hours, so of earlier boots too.
const REMEMBERED: usize = 256;
/// After this share of what either end says, it says something.
const SHARE: f64 = 0.03;

/// The attacker.
pub(super) struct Attacker {
    random: ChaCha8Rng,
    of_node: VecDeque<Vec<u8>>,
    of_host: VecDeque<Vec<u8>>,
    /// The beginning of a frame of the host.
    partial: Vec<u8>,
    /// The number of the conversation that it has heard last.
    conversation: Conversation,
}

fn remember(frames: &mut VecDeque<Vec<u8>>, frame: &[u8]) {
    if frame.len() > 1 {
        frames.push_back(frame.to_vec());
        if frames.len() > REMEMBERED {
            frames.pop_front();
        }
    }
}

impl Attacker {
    pub(super) fn new(random: ChaCha8Rng) -> Self {
        let conversation = Conversation([0; 4]);
        Self { random, of_node: VecDeque::new(), of_host: VecDeque::new(), partial: Vec::new(), conversation }
    }

    /// What it says to the node behind what the host has said.
    pub(super) fn tell_node(&mut self, said: &[u8], report: &mut Report) -> Vec<u8> {
        self.partial.extend_from_slice(said);
        while let Some(end) = self.partial.iter().position(|&byte| byte == END_OF_FRAME) {
            let frame: Vec<u8> = self.partial.drain(..=end).collect();
            self.overhear(&frame);
            remember(&mut self.of_host, &frame);
        }
        if !self.random.random_bool(SHARE) {
            return Vec::new();
        }
        let boot = self.random.random();
        let message = match self.random.random_range(0..5) {
            0 => HostMessage::Greet(Greeting { counter: self.random.random(), ..Greeting::OF_HOSTS }),
            1 => HostMessage::Configure(Configuration {
                channels: 1,
                sampling_rate_uhz: 10_000_000,
                decimation: 2,
                segment: 256,
                summary: Summary::Lines { bits: 4 },
                bands: std::iter::once(Band { first_line: 1, lines: 3 }).collect(),
            }),
            2 => HostMessage::Acknowledge(Acknowledgement { boot, below: u32::MAX, again: Default::default() }),
            3 => HostMessage::SetClock(ClockModel { node: NodeTime(0), host: HostTime(1), drift_ppb: 0 }),
            _ => return count(self.again(true), "host's frame repeated", report),
        };
        let message = InConversation { conversation: self.conversation, message };
        count(self.frame(Sender::Host, boot, &message), "host's frame forged", report)
    }

    /// What it says to the host behind what the node has said.
    pub(super) fn tell_host(&mut self, node: u16, boot: u32, said: &[u8], report: &mut Report) -> Vec<u8> {
        remember(&mut self.of_node, said);
        // In the middle of a frame, what it says would be noise on the line.
        if said.last() != Some(&END_OF_FRAME) || !self.random.random_bool(SHARE) {
            return Vec::new();
        }
        if self.random.random() {
            return count(self.again(false), "node's frame repeated", report);
        }
        let name = WindowName { node, boot, number: self.random.random_range(0..10_000) };
        let head = WindowHead {
            name,
            configuration_hash: self.random.random(),
            grid_index: self.random.random(),
            middle_offset_us: 0,
            drift_ppb: 0,
            data_parts: 0,
            channels: Default::default(),
        };
        count(self.frame(Sender::Node, boot, &NodeMessage::Head(head)), "node's frame forged", report)
    }

    /// The number of the host's conversation is in the clear.
    fn overhear(&mut self, frame: &[u8]) {
        let mut decoder = FrameDecoder::new();
        for &byte in frame {
            if let Some(Ok(opened)) = decoder.push(byte)
                && let Some(&conversation) = opened.message.first_chunk()
            {
                self.conversation = Conversation(conversation);
            }
        }
    }

    fn again(&mut self, of_host: bool) -> Vec<u8> {
        let frames = if of_host { &self.of_host } else { &self.of_node };
        if frames.is_empty() { Vec::new() } else { frames[self.random.random_range(0..frames.len())].clone() }
    }

    /// A frame without a seal, or with one of another key.
    fn frame(&mut self, sender: Sender, boot: u32, message: &impl Serialize) -> Vec<u8> {
        let mut buffer = [0; MAX_MESSAGE_BYTES];
        let Ok(message) = message::bytes(message, &mut buffer) else { return Vec::new() };
        let mut frame = [0; MAX_FRAME_BYTES];
        let length = if self.random.random() {
            encode(message, &mut frame)
        } else {
            let counter = self.random.random();
            Key::new(self.random.random()).encode(sender, boot, counter, message, &mut frame)
        };
        frame[..length.unwrap_or(0)].to_vec()
    }
}

fn count(frame: Vec<u8>, kind: &'static str, report: &mut Report) -> Vec<u8> {
    if !frame.is_empty() {
        report.fault(kind);
    }
    frame
}
