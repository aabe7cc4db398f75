//! The outbox: every part of every window, kept until the host acknowledges it.
//!
//! Messages lie in a ring of bytes that the caller owns, oldest first. A full ring loses its oldest window, and counts it, unless the store
//! keeps it.

use belfry_shared::message::Again;
use heapless::Deque;

/// Most parts the outbox holds.
pub(crate) const MAX_PARTS: usize = 112;

/// How far a part has come on its way to the host.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sending {
    /// Never sent.
    New,
    Sent,
    /// Sent, and asked for again.
    Again,
}

/// How far a part has come on its way to the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Keeping {
    /// It does not go there.
    Never,
    Waiting,
    Kept,
}

#[derive(Debug, Clone, Copy)]
struct Entry {
    window: u32,
    part: u16,
    offset: u16,
    length: u16,
    sending: Sending,
    keeping: Keeping,
}

impl Entry {
    fn end(&self) -> usize {
        usize::from(self.offset) + usize::from(self.length)
    }

    fn is_pending(&self) -> bool {
        self.sending != Sending::Sent
    }
}

/// The directory of the ring.
#[derive(Debug, Clone)]
pub(crate) struct Outbox {
    entries: Deque<Entry, MAX_PARTS>,
    lost_windows: u32,
}

impl Outbox {
    /// An empty outbox.
    pub(crate) const fn new() -> Self {
        Self { entries: Deque::new(), lost_windows: 0 }
    }

    /// Windows dropped because the ring was full.
    pub(crate) fn lost_windows(&self) -> u32 {
        self.lost_windows
    }

    /// The oldest window still here.
    pub(crate) fn oldest_window(&self) -> Option<u32> {
        self.entries.front().map(|entry| entry.window)
    }

    /// Stores a part behind the others; drops the oldest windows to make room. Returns whether it was stored: a message larger than
    /// the whole ring is not.
    pub(crate) fn push(&mut self, ring: &mut [u8], window: u32, part: u16, message: &[u8], keeping: Keeping) -> bool {
        let Ok(length) = u16::try_from(message.len()) else { return false };
        if message.len() > ring.len() {
            return false;
        }
        while self.entries.is_full() {
            self.drop_oldest_window();
        }
        let offset = loop {
            match self.room(ring.len(), message.len()) {
                Some(offset) => break offset,
                None => self.drop_oldest_window(),
            }
        };
        let Some(place) = ring.get_mut(offset..offset + message.len()) else { return false };
        let Ok(offset) = u16::try_from(offset) else { return false };
        place.copy_from_slice(message);
        self.entries.push_back(Entry { window, part, offset, length, sending: Sending::New, keeping }).is_ok()
    }

    /// Where the next `length` bytes fit, if anywhere.
    fn room(&self, ring: usize, length: usize) -> Option<usize> {
        let (Some(oldest), Some(newest)) = (self.entries.front(), self.entries.back()) else { return Some(0) };
        let (start, end) = (usize::from(oldest.offset), newest.end());
        if newest.offset >= oldest.offset {
            // The used bytes are in one piece: there may be room behind it, or from the ring's start.
            if end + length <= ring {
                Some(end)
            } else if length < start {
                Some(0)
            } else {
                None
            }
        } else {
            (end + length <= start).then_some(end)
        }
    }

    fn drop_oldest_window(&mut self) {
        let Some(window) = self.oldest_window() else { return };
        let mut parts = self.entries.iter().take_while(|entry| entry.window == window);
        let is_lost = parts.any(|entry| entry.keeping != Keeping::Kept);
        self.forget(|entry| entry.window == window);
        self.lost_windows = self.lost_windows.saturating_add(u32::from(is_lost));
    }

    fn forget(&mut self, done: impl Fn(&Entry) -> bool) {
        while self.entries.front().is_some_and(&done) {
            self.entries.pop_front();
        }
    }

    /// Drops the windows that lie beyond `ring` bytes (and all older ones), when the ring shrinks.
    pub(crate) fn shrink(&mut self, ring: usize) {
        while self.entries.iter().any(|entry| entry.end() > ring) {
            self.drop_oldest_window();
        }
    }

    /// Forgets all windows below `window`, up to the first that was not sent whole: nobody can have stored that one. Returns which it was.
    pub(crate) fn acknowledge(&mut self, window: u32) -> u32 {
        let is_new = |entry: &&Entry| entry.sending == Sending::New;
        let unsent = self.entries.iter().filter(is_new).map(|entry| entry.window).min();
        let window = unsent.map_or(window, |unsent| window.min(unsent));
        self.forget(|entry| entry.window < window);
        window
    }

    /// The oldest part that waits for the store: its window, its number and itself.
    pub(crate) fn to_keep<'a>(&self, ring: &'a [u8]) -> Option<(u32, u16, &'a [u8])> {
        let entry = self.entries.iter().find(|entry| entry.keeping == Keeping::Waiting)?;
        Some((entry.window, entry.part, ring.get(usize::from(entry.offset)..entry.end())?))
    }

    /// Notes that the store keeps a part.
    pub(crate) fn kept(&mut self, window: u32, part: u16) {
        let mut entries = self.entries.iter_mut();
        if let Some(entry) = entries.find(|entry| (entry.window, entry.part) == (window, part)) {
            entry.keeping = Keeping::Kept;
        }
    }

    /// Marks parts to be sent again.
    pub(crate) fn again(&mut self, wanted: &Again) {
        for entry in &mut self.entries {
            if entry.sending == Sending::Sent
                && (wanted.first_window..=wanted.last_window).contains(&entry.window)
                && (wanted.first_part..=wanted.last_part).contains(&entry.part)
            {
                entry.sending = Sending::Again;
            }
        }
    }

    /// Whether a part waits to be sent.
    pub(crate) fn is_pending(&self) -> bool {
        self.entries.iter().any(Entry::is_pending)
    }

    /// The next part to send, marked as sent.
    pub(crate) fn next<'a>(&mut self, ring: &'a [u8]) -> Option<&'a [u8]> {
        let entry = self.entries.iter_mut().find(|entry| entry.is_pending())?;
        entry.sending = Sending::Sent;
        ring.get(usize::from(entry.offset)..entry.end())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::{vec, vec::Vec};

    fn everything() -> Again {
        Again { first_window: 0, last_window: u32::MAX, first_part: 0, last_part: u16::MAX }
    }

    fn sent(outbox: &mut Outbox, ring: &[u8]) -> Vec<Vec<u8>> {
        core::iter::from_fn(|| outbox.next(ring).map(<[u8]>::to_vec)).collect()
    }

    #[test]
    fn parts_are_sent_once_kept_until_acknowledged_and_sent_again_when_asked() {
        let mut ring = [0; 100];
        let mut outbox = Outbox::new();
        for (window, part) in [(4, 1), (4, 0), (5, 1), (5, 0)] {
            assert!(outbox.push(&mut ring, window, part, &[window as u8, part as u8], Keeping::Never));
        }
        assert_eq!(sent(&mut outbox, &ring), [[4, 1], [4, 0], [5, 1], [5, 0]]);
        assert!(!outbox.is_pending());
        outbox.again(&Again { first_window: 4, last_window: 5, first_part: 0, last_part: 0 });
        assert_eq!(sent(&mut outbox, &ring), [[4, 0], [5, 0]]);
        outbox.acknowledge(5);
        outbox.again(&everything());
        assert_eq!(sent(&mut outbox, &ring), [[5, 1], [5, 0]]);
        assert_eq!((outbox.oldest_window(), outbox.lost_windows()), (Some(5), 0));
        outbox.acknowledge(6);
        assert_eq!(outbox.oldest_window(), None);
    }

    #[test]
    fn a_window_that_was_not_sent_whole_outlasts_any_acknowledgement() {
        let mut ring = [0; 100];
        let mut outbox = Outbox::new();
        for (window, part) in [(4, 1), (4, 0), (5, 1), (5, 0)] {
            assert!(outbox.push(&mut ring, window, part, &[window as u8, part as u8], Keeping::Never));
        }
        assert_eq!(core::iter::from_fn(|| outbox.next(&ring).map(<[u8]>::to_vec)).take(3).count(), 3);
        outbox.acknowledge(u32::MAX);
        assert_eq!(outbox.oldest_window(), Some(5));
        outbox.again(&everything());
        assert_eq!(sent(&mut outbox, &ring), [[5, 1], [5, 0]]);
        outbox.acknowledge(6);
        assert_eq!((outbox.oldest_window(), outbox.lost_windows()), (None, 0));
    }

    #[test]
    fn a_window_that_the_store_keeps_is_not_lost_when_it_leaves() {
        let mut ring = [0; 4];
        let mut outbox = Outbox::new();
        let mut push = |outbox: &mut Outbox, window, part| {
            assert!(outbox.push(&mut ring, window, part, &[window as u8], Keeping::Waiting));
        };
        for (window, part) in [(0, 1), (0, 0), (1, 1), (1, 0)] {
            push(&mut outbox, window, part);
        }
        outbox.kept(0, 1);
        outbox.kept(0, 0);
        outbox.kept(1, 1);
        push(&mut outbox, 2, 1);
        assert_eq!((outbox.oldest_window(), outbox.lost_windows()), (Some(1), 0));
        // Of window 1 the store has one part of two.
        push(&mut outbox, 2, 0);
        push(&mut outbox, 3, 1);
        assert_eq!((outbox.oldest_window(), outbox.lost_windows()), (Some(2), 1));
        assert_eq!(outbox.to_keep(&ring), Some((2, 1, &[2][..])));
    }

    proptest! {
        /// Against a plain list: what is here is always the newest windows, unchanged, and the rest is counted as lost.
        #[test]
        fn the_ring_keeps_the_newest_windows_intact(size in 50_usize..400, windows in prop::collection::vec(prop::collection::vec(1_usize..50, 1..4), 1..60)) {
            let mut ring = vec![0; size];
            let mut outbox = Outbox::new();
            let mut pushed: Vec<(u32, Vec<u8>)> = Vec::new();
            for (window, parts) in windows.iter().enumerate() {
                for (part, &length) in parts.iter().enumerate() {
                    let message = vec![(7 * window + part) as u8; length];
                    prop_assert!(outbox.push(&mut ring, window as u32, part as u16, &message, Keeping::Never));
                    pushed.push((window as u32, message));
                }
            }
            outbox.again(&everything());
            let oldest = outbox.oldest_window().unwrap();
            let here = sent(&mut outbox, &ring);
            // A window larger than the ring may have lost its first parts; all whole windows above it are here.
            let expected: Vec<_> = pushed.iter().rev().take(here.len()).rev().map(|(_, message)| message.clone()).collect();
            prop_assert_eq!(&here, &expected);
            prop_assert!(outbox.lost_windows() >= oldest);
        }
    }
}
