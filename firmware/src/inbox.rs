//! The inbox: bytes from the host, on their way from the interrupt that reads them to the loop that works on them.
//!
//! Bytes flow in with the time at which they came, and out with the time at which their frame ended. While the loop computes a
//! spectrum, frames wait here. A frame that finds no room is dropped whole and counted; the host notices that no answer comes and
//! says it again.

use core::sync::atomic::{AtomicU32, Ordering};

use belfry_shared::frame::END_OF_FRAME;
use belfry_shared::time::NodeTime;
use heapless::spsc::{Consumer, Producer, Queue};

/// Bytes that may wait, one less than the queue's length: a frame of a recording that is being taken, another behind it.
const BYTES: usize = 1024;
/// Frames that may wait, one less again: what the host answers to many windows at once is short.
const FRAMES: usize = 64;

/// Room for what waits.
pub struct Inbox {
    bytes: Queue<u8, BYTES>,
    ends: Queue<NodeTime, FRAMES>,
    dropped_frames: AtomicU32,
}

impl Inbox {
    /// An empty inbox.
    pub const fn new() -> Self {
        Self { bytes: Queue::new(), ends: Queue::new(), dropped_frames: AtomicU32::new(0) }
    }

    /// The interrupt's end and the loop's.
    pub fn split(&mut self) -> (InboxWriter<'_>, InboxReader<'_>) {
        let Self { bytes, ends, dropped_frames } = self;
        let ((bytes_in, bytes_out), (ends_in, ends_out)) = (bytes.split(), ends.split());
        (
            InboxWriter { bytes: bytes_in, ends: ends_in, dropped_frames, has_bytes: false, is_cut: false },
            InboxReader { bytes: bytes_out, ends: ends_out, dropped_frames },
        )
    }
}

impl Default for Inbox {
    fn default() -> Self {
        Self::new()
    }
}

/// The end that takes bytes from the line.
pub struct InboxWriter<'a> {
    bytes: Producer<'a, u8>,
    ends: Producer<'a, NodeTime>,
    dropped_frames: &'a AtomicU32,
    /// Whether bytes of the frame that is coming are in the queue. There is room for its end then.
    has_bytes: bool,
    /// Whether the frame that is coming has lost bytes: the rest of it is left out.
    is_cut: bool,
}

impl InboxWriter<'_> {
    /// Takes a byte that came at `now`.
    pub fn push(&mut self, now: NodeTime, byte: u8) {
        if byte == END_OF_FRAME {
            self.end(now);
            return;
        }
        let has_room = self.bytes.len() + 1 < self.bytes.capacity() && self.ends.ready();
        self.is_cut = self.is_cut || !has_room || self.bytes.enqueue(byte).is_err();
        self.has_bytes = self.has_bytes || !self.is_cut;
    }

    /// Notes that the line has lost bytes: the frame they belonged to is dropped.
    pub fn lost_bytes(&mut self) {
        self.is_cut = true;
    }

    fn end(&mut self, now: NodeTime) {
        if core::mem::take(&mut self.is_cut) {
            // Only the interrupt writes it, so nothing comes between reading and writing.
            let dropped = self.dropped_frames.load(Ordering::Relaxed);
            self.dropped_frames.store(dropped.saturating_add(1), Ordering::Relaxed);
        }
        // The end of an empty frame says nothing, and takes no room.
        if core::mem::take(&mut self.has_bytes) {
            // Cannot fail: see `push`.
            let _ = self.bytes.enqueue(END_OF_FRAME);
            let _ = self.ends.enqueue(now);
        }
    }
}

/// The end that hands bytes to the node.
pub struct InboxReader<'a> {
    bytes: Consumer<'a, u8>,
    ends: Consumer<'a, NodeTime>,
    dropped_frames: &'a AtomicU32,
}

impl InboxReader<'_> {
    /// The oldest byte that waits; with an end mark, when it came.
    pub fn next_byte(&mut self) -> Option<(Option<NodeTime>, u8)> {
        let byte = self.bytes.dequeue()?;
        // The interrupt puts both in before the loop goes on.
        let time = if byte == END_OF_FRAME { self.ends.dequeue() } else { None };
        Some((time, byte))
    }

    /// Whether nothing waits.
    pub fn is_empty(&self) -> bool {
        !self.bytes.ready()
    }

    /// Frames dropped since the start. What had come of them before there was no more room is handed on all the same, and the node
    /// counts it as a damaged frame.
    pub fn dropped_frames(&self) -> u32 {
        self.dropped_frames.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use belfry_shared::frame::{FrameDecoder, FrameError, MAX_FRAME_BYTES, encode};
    use proptest::prelude::*;
    use std::vec::Vec;

    fn framed(message: &[u8]) -> Vec<u8> {
        let mut frame = [0; MAX_FRAME_BYTES];
        let length = encode(message, &mut frame).unwrap();
        frame[..length].to_vec()
    }

    fn push_all(writer: &mut InboxWriter<'_>, time: u64, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| writer.push(NodeTime(time), byte));
    }

    /// What the frames say that wait, and when they came.
    fn read_all(reader: &mut InboxReader<'_>) -> Vec<(u64, Result<Vec<u8>, FrameError>)> {
        let mut decoder = FrameDecoder::new();
        let mut frames = Vec::new();
        while let Some((time, byte)) = reader.next_byte() {
            assert_eq!(time.is_some(), byte == END_OF_FRAME);
            frames.extend(decoder.push(byte).map(|frame| (time.unwrap().0, frame.map(|frame| frame.message.to_vec()))));
        }
        frames
    }

    #[test]
    fn what_a_host_answers_to_two_windows_and_a_clock_request_waits_with_its_times() {
        let mut inbox = Inbox::new();
        let (mut writer, mut reader) = inbox.split();
        // An acknowledgement with all ranges it can ask again, garbage, a greeting, a configuration; twice, and a request.
        let window = [&[1; 140][..], &[2; 3], &[3], &[4; 70]];
        let said: Vec<&[u8]> = [window, window].concat().into_iter().chain([&[5; 9][..]]).collect();
        for (time, message) in said.iter().enumerate() {
            push_all(&mut writer, time as u64, &framed(message));
        }
        let heard = read_all(&mut reader);
        let expected: Vec<_> = (0..).zip(said.iter().map(|message| Ok(message.to_vec()))).collect();
        assert_eq!((heard, reader.dropped_frames(), reader.is_empty()), (expected, 0, true));
    }

    #[test]
    fn frames_without_room_are_dropped_whole_and_counted_and_the_next_is_whole() {
        let mut inbox = Inbox::new();
        let (mut writer, mut reader) = inbox.split();
        for n in 0..100 {
            push_all(&mut writer, n, &framed(&[n as u8; 50]));
        }
        let (kept, cut): (Vec<_>, Vec<_>) = read_all(&mut reader).into_iter().partition(|(_, frame)| frame.is_ok());
        // 57 bytes a frame: 17 fit into 1023, and a piece of the next.
        assert_eq!(kept, (0..17).map(|n| (n, Ok([n as u8; 50].to_vec()))).collect::<Vec<_>>());
        assert_eq!((cut.len(), reader.dropped_frames()), (1, 83));
        push_all(&mut writer, 201, &framed(b"heard"));
        assert_eq!(read_all(&mut reader).last(), Some(&(201, Ok(b"heard".to_vec()))));
        assert_eq!(reader.dropped_frames(), 83);
    }

    #[test]
    fn end_marks_alone_take_no_room() {
        let mut inbox = Inbox::new();
        let (mut writer, mut reader) = inbox.split();
        push_all(&mut writer, 1, &[END_OF_FRAME; 5000]);
        push_all(&mut writer, 2, &framed(b"heard"));
        assert_eq!(read_all(&mut reader), [(2, Ok(b"heard".to_vec()))]);
        assert_eq!(reader.dropped_frames(), 0);
    }

    #[test]
    fn a_frame_that_the_line_has_cut_is_counted_and_the_next_is_whole() {
        let mut inbox = Inbox::new();
        let (mut writer, mut reader) = inbox.split();
        push_all(&mut writer, 1, &[3, 4]);
        writer.lost_bytes();
        push_all(&mut writer, 2, &[5, END_OF_FRAME]);
        push_all(&mut writer, 3, &framed(b"heard"));
        assert_eq!(read_all(&mut reader).last(), Some(&(3, Ok(b"heard".to_vec()))));
        assert_eq!(reader.dropped_frames(), 1);
    }

    proptest! {
        /// Whatever the loop reads when: each frame is heard once, whole and in order, or counted.
        #[test]
        fn every_frame_is_heard_or_counted(
            messages in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..300), 1..60),
            looks in prop::collection::vec(any::<bool>(), 60),
        ) {
            let mut inbox = Inbox::new();
            let (mut writer, mut reader) = inbox.split();
            let mut decoder = FrameDecoder::new();
            let mut heard = Vec::new();
            let mut listen = |reader: &mut InboxReader<'_>| while let Some((time, byte)) = reader.next_byte() {
                if let Some(Ok(frame)) = decoder.push(byte) {
                    heard.push((time.unwrap().0, frame.message.to_vec()));
                }
            };
            for (n, message) in messages.iter().enumerate() {
                push_all(&mut writer, n as u64, &framed(message));
                if looks[n] { listen(&mut reader); }
            }
            listen(&mut reader);
            prop_assert_eq!(heard.len() + reader.dropped_frames() as usize, messages.len());
            for pair in heard.windows(2) { prop_assert!(pair[0].0 < pair[1].0); }
            for (n, message) in heard { prop_assert_eq!(&message, &messages[n as usize]); }
        }
    }
}
