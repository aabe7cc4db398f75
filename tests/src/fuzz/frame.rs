//! The frame decoder and the messages in frames.

use belfry_shared::frame::{FrameDecoder, MAX_FRAME_BYTES, MAX_MESSAGE_BYTES, encode};
use belfry_shared::message::{self, InConversation, NodeMessage};
use serde::Serialize;

/// Bytes as they come over a line, and then as a message that is sent over it: it comes whole, whatever came before.
///
/// # Panics
/// Where it does not.
pub fn frame(bytes: &[u8]) {
    let mut decoder = FrameDecoder::new();
    for &byte in bytes {
        if let Some(Ok(frame)) = decoder.push(byte) {
            let length = frame.message.len();
            assert!(length <= MAX_MESSAGE_BYTES, "a message of {length} bytes");
        }
    }
    let message = &bytes[..bytes.len().min(MAX_MESSAGE_BYTES)];
    let mut frame = [0; MAX_FRAME_BYTES];
    let length = encode(message, &mut frame).expect("a message that is short enough fits into a frame");
    // An end mark first, as at the beginning of a conversation.
    decoder.push(0);
    let (end, body) = frame[..length].split_last().expect("a frame ends with its end mark");
    assert!(body.iter().all(|&byte| decoder.push(byte).is_none()), "an end mark within a frame");
    assert_eq!(decoder.push(*end).map(|frame| frame.map(|frame| frame.message)), Some(Ok(message)));
}

/// Bytes as a message of a node and of a host. What can be read is written as it was read.
///
/// # Panics
/// Where it is not.
pub fn message(bytes: &[u8]) {
    if let Ok(read) = message::decode::<NodeMessage<'_>>(bytes) {
        let written = written(&read, bytes);
        let Ok(reread) = message::decode::<NodeMessage<'_>>(&written) else {
            panic!("what was written cannot be read")
        };
        // Bytes are compared, for a float may be no number.
        assert_eq!(self::written(&reread, &written), written);
    }
    if let Ok(read) = message::decode::<InConversation>(bytes) {
        let written = written(&read, bytes);
        let Ok(reread) = message::decode::<InConversation>(&written) else { panic!("what was written cannot be read") };
        assert_eq!(self::written(&reread, &written), written);
    }
}

/// A message that was read from these bytes, as it is written.
fn written(message: &impl Serialize, from: &[u8]) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME_BYTES];
    let length = match message::encode(message, &mut frame) {
        Ok(length) => length,
        // No frame could have brought it.
        Err(_) if from.len() > MAX_MESSAGE_BYTES => return from.to_vec(),
        Err(error) => panic!("a message that was read cannot be written: {error}"),
    };
    let mut decoder = FrameDecoder::new();
    let mut written = Vec::new();
    for &byte in &frame[..length] {
        if let Some(Ok(frame)) = decoder.push(byte) {
            written = frame.message.to_vec();
        }
    }
    assert!(!written.is_empty());
    written
}
