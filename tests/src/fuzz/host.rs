//! The host's end of a conversation: well-formed messages of nodes in any order, an archive that fails now and then, and time.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::io::{self, ErrorKind};
use std::sync::LazyLock;

use belfry_firmware::{Identity, Memory, Node};
use belfry_host::link::{Session, Transport};
use belfry_host::window::{Configurations, KeptWindows, Loss, NodeWindow, WindowSink};
use belfry_shared::frame::{FrameDecoder, MAX_FRAME_BYTES, MAX_MESSAGE_BYTES};
use belfry_shared::message::{
    self, Band, Configuration, Conversation, Counters, Greeting, Hello, HostMessage, InConversation, NodeMessage,
    Summary, WindowName,
};
use belfry_shared::seal::{Key, Sender};
use belfry_shared::time::{HostTime, NodeTime};

use super::input::Input;

const NODE: u16 = 3;
/// 2030, and the time until then again.
const BEGIN_US: i64 = 1_900_000_000_000_000;
const LATEST_US: i64 = 2 * BEGIN_US;

/// What a node asks for that is asked for lines of one channel.
fn configuration() -> Configuration {
    Configuration {
        channels: 1,
        sampling_rate_uhz: 50_000_000,
        decimation: 5,
        segment: 256,
        summary: Summary::Lines { bits: 8 },
        bands: [Band { first_line: 3, lines: 20 }].into_iter().collect(),
    }
}

/// The number under which the sessions speak.
const CONVERSATION: Conversation = Conversation([0xC0, 0x4E, 0x56, 1]);

/// What a node of this release says when this program greets it.
static HELLO: LazyLock<Hello> = LazyLock::new(|| {
    let identity = Identity { node: NODE, boot: 0, channels: 1, full_scale_m_s2: 20.0, highest_rate_mhz: 4_000_000 };
    let mut node = Node::new(identity, Box::new(Memory::new()));
    let mut frame = [0; MAX_FRAME_BYTES];
    let greeting = InConversation { conversation: CONVERSATION, message: HostMessage::Greet(Greeting::OF_HOSTS) };
    let length = message::encode(&greeting, &mut frame).expect("a greeting fits into a frame");
    frame[..length].iter().for_each(|&byte| node.receive(NodeTime(1), byte));
    let mut decoder = FrameDecoder::new();
    let mut out = [0; MAX_FRAME_BYTES];
    loop {
        let count = node.transmit(NodeTime(1), &mut out);
        assert!(count > 0, "a node answers a greeting");
        for &byte in &out[..count] {
            if let Some(Ok(NodeMessage::Hello(hello))) =
                decoder.push(byte).map(|frame| message::decode::<NodeMessage<'_>>(frame?.message))
            {
                return hello;
            }
        }
    }
});

/// The key of a node that has one, and another.
const KEY: Key = Key::new([0x4B; 32]);
const OTHER_KEY: Key = Key::new([0x4C; 32]);
/// Numbers from here on have only windows that somebody without the key has made up.
const FORGED: u32 = 100;

/// A line whose other end is the bytes.
#[derive(Default)]
struct Pipe {
    bytes: VecDeque<u8>,
    /// Of a node with a key: the boot in which it is, and what it has sealed so far.
    sealed: Option<(u32, u32)>,
}

impl Pipe {
    fn say(&mut self, message: NodeMessage<'_>) {
        self.say_with(&KEY, message);
    }

    /// Somebody without the key says it: sealed with another, or not at all.
    fn forge(&mut self, message: NodeMessage<'_>, is_sealed: bool) {
        let sealed = self.sealed;
        if !is_sealed {
            self.sealed = None;
        }
        self.say_with(&OTHER_KEY, renumbered(message));
        self.sealed = sealed;
    }

    fn say_with(&mut self, key: &Key, mut message: NodeMessage<'_>) {
        let (mut buffer, mut frame) = ([0; MAX_MESSAGE_BYTES], [0; MAX_FRAME_BYTES]);
        let length = match &mut self.sealed {
            None => message::encode(&message, &mut frame),
            Some((boot, said)) => {
                *said = said.saturating_add(1);
                if let NodeMessage::Hello(hello) = &mut message {
                    *boot = hello.boot;
                    hello.counters = Some(Counters { said: *said, heard: 0 });
                }
                message::bytes(&message, &mut buffer)
                    .and_then(|bytes| key.encode(Sender::Node, *boot, *said, bytes, &mut frame))
            }
        };
        self.bytes.extend(&frame[..length.unwrap_or(0)]);
    }
}

/// A part of a window that the node has not made.
fn renumbered(mut message: NodeMessage<'_>) -> NodeMessage<'_> {
    match &mut message {
        NodeMessage::Head(head) => head.name.number += FORGED,
        NodeMessage::Lines(part) => part.name.number += FORGED,
        _ => {}
    }
    message
}

impl Transport for Pipe {
    fn write(&mut self, _: &[u8]) -> io::Result<()> {
        Ok(())
    }

    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = buffer.len().min(self.bytes.len());
        buffer.iter_mut().zip(self.bytes.drain(..count)).for_each(|(place, byte)| *place = byte);
        Ok(count)
    }
}

/// An archive in memory, which may be busy.
#[derive(Default)]
struct Kept {
    lives: BTreeMap<u32, (u32, BTreeSet<u32>)>,
    is_busy: bool,
    has_key: bool,
}

impl WindowSink for Kept {
    fn store(&mut self, window: NodeWindow) -> io::Result<()> {
        if self.is_busy {
            return Err(ErrorKind::WouldBlock.into());
        }
        let WindowName { node, boot, number } = window.name;
        assert_eq!(node, NODE, "a window of another node");
        assert!(!self.has_key || number < FORGED, "a window that somebody without the key has made up");
        let is_new = self.lives.entry(boot).or_default().1.insert(number);
        assert!(is_new, "window {number} of boot {boot} is stored a second time");
        Ok(())
    }

    fn is_ready(&self) -> bool {
        !self.is_busy
    }

    fn kept(&mut self, _: u16, boot: u32, _: u32) -> io::Result<Option<KeptWindows>> {
        let known = self.lives.get(&boot);
        let kept = |(first, numbers): &(u32, BTreeSet<u32>)| KeptWindows {
            first: *first,
            numbers: numbers.iter().copied().collect(),
            ..KeptWindows::default()
        };
        Ok(known.map(kept))
    }

    fn meet(&mut self, _: u16, boot: u32, first_window: u32) -> io::Result<()> {
        if self.is_busy {
            return Err(ErrorKind::WouldBlock.into());
        }
        self.lives.entry(boot).or_insert((first_window, BTreeSet::new()));
        Ok(())
    }

    fn lost(&mut self, loss: &Loss) -> io::Result<()> {
        if self.is_busy {
            return Err(ErrorKind::WouldBlock.into());
        }
        let stored = self.lives.get(&loss.boot).map(|(_, numbers)| numbers);
        let is_lost = |number: &u32| *number >= loss.first && loss.last.is_some_and(|last| *number <= last);
        assert!(!stored.is_some_and(|numbers| numbers.iter().any(is_lost)), "{loss}, and is stored");
        Ok(())
    }
}

/// A message as the node says it to whom this program listens, in few lives and with small numbers, so that messages belong together.
fn at_home(message: NodeMessage<'_>) -> NodeMessage<'_> {
    let name = |name: WindowName| WindowName { node: NODE, boot: name.boot % 4, number: name.number % 16 };
    match message {
        NodeMessage::Hello(hello) => NodeMessage::Hello(Hello {
            boot: hello.boot % 4,
            configuration_hash: hello
                .configuration_hash
                .map(|hash| if hash.is_multiple_of(2) { configuration().hash() } else { hash }),
            clock_set: hello.clock_set,
            oldest_window: hello.oldest_window % 16,
            next_window: hello.oldest_window % 16 + hello.next_window % 16,
            replaying: hello.replaying,
            ..HELLO.clone()
        }),
        NodeMessage::Heartbeat(mut heartbeat) => {
            (heartbeat.node, heartbeat.boot) = (NODE, heartbeat.boot % 4);
            (heartbeat.oldest_window, heartbeat.next_window) =
                (heartbeat.oldest_window % 16, heartbeat.oldest_window % 16 + heartbeat.next_window % 16);
            NodeMessage::Heartbeat(heartbeat)
        }
        NodeMessage::Head(mut head) => {
            head.name = name(head.name);
            head.configuration_hash = configuration().hash();
            head.data_parts %= 4;
            // 25.6 s/2 a hop: about the year 2030.
            head.grid_index = BEGIN_US as u64 / 12_800_000 + head.grid_index % 1024;
            NodeMessage::Head(head)
        }
        NodeMessage::Lines(mut part) => {
            part.name = name(part.name);
            (part.part, part.channel, part.bits) = (part.part % 4, 0, 8);
            NodeMessage::Lines(part)
        }
        other => other,
    }
}

/// The host hears what the bytes say.
///
/// # Panics
/// Where the host does, or stores a window twice, or one that it has taken for lost.
pub fn host(bytes: &[u8]) {
    let mut input = Input(bytes);
    let flags = input.number::<1>();
    let has_key = flags & 2 != 0;
    let mut session = Session::new(NODE, Configurations::only(configuration()), 115_200)
        .dropping_foreign(flags & 1 != 0)
        .with_conversation(CONVERSATION)
        .with_key(has_key.then_some(KEY));
    let mut pipe = Pipe { bytes: VecDeque::new(), sealed: has_key.then_some((0, 0)) };
    let mut kept = Kept { has_key, ..Kept::default() };
    let mut now_us = BEGIN_US;
    while let Some(choice) = input.byte() {
        match choice % 8 {
            0..=3 => {
                if let Some(message) = input.message::<NodeMessage<'_>>() {
                    match choice {
                        _ if has_key && choice >= 0xC0 => pipe.forge(at_home(message), choice % 8 < 2),
                        0..0xC0 => pipe.say(at_home(message)),
                        _ => pipe.say(message),
                    }
                }
            }
            4 => now_us = now_us.saturating_add(input.number::<4>() as i64).min(LATEST_US),
            5 if choice < 0x20 => now_us = (input.number::<7>() as i64).min(LATEST_US),
            5 if choice < 0x40 => session.restart(),
            5 => pipe.bytes.extend(input.byte()),
            6 => kept.is_busy = choice >= 0x80,
            _ => {}
        }
        if choice % 8 >= 4 || pipe.bytes.len() > 4096 {
            let now = HostTime(now_us);
            if session.service(&|| now, &mut pipe, &mut kept).is_err() {
                session.reconnect();
            }
        }
    }
    kept.is_busy = false;
    let now = HostTime(now_us);
    let _ = session.service(&|| now, &mut pipe, &mut kept);
}
