//! Windows that no longer exist anywhere, and why.

use std::fmt;

use serde::Serialize;

/// Why windows are lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum LossReason {
    /// The node had no room for them any longer before the host had them.
    Overwritten,
    /// The node started anew before the host had them.
    Restarted,
    /// They cannot be read: asked for again and again in vain, or their parts contradict each other.
    Unreadable,
    /// They are dated at a time that has not been: the computer's clock was set meanwhile.
    Misdated,
    /// The archive had them, was damaged, and could not be repaired there.
    Damaged,
}

impl LossReason {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Overwritten, Self::Restarted, Self::Unreadable, Self::Misdated, Self::Damaged];

    /// In a word, for programs.
    pub fn name(self) -> &'static str {
        match self {
            Self::Overwritten => "overwritten",
            Self::Restarted => "restarted",
            Self::Unreadable => "unreadable",
            Self::Misdated => "misdated",
            Self::Damaged => "damaged",
        }
    }
}

impl fmt::Display for LossReason {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Overwritten => "the node had no room for them any longer",
            Self::Restarted => "the node started anew before they were stored",
            Self::Unreadable => "they cannot be read",
            Self::Misdated => "they are dated at a time that has not been",
            Self::Damaged => "they were damaged in the archive",
        })
    }
}

/// Windows of one life of a node that are lost for the same reason, by their numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Loss {
    /// The node.
    pub node: u16,
    /// Its life.
    pub boot: u32,
    /// The first of them.
    pub first: u32,
    /// The last; `None` for all that the life made from the first on, whose count nobody knows.
    pub last: Option<u32>,
    /// Why.
    pub reason: LossReason,
}

impl Loss {
    /// How many there are, where that is known.
    pub fn windows(&self) -> Option<u64> {
        self.last.map(|last| u64::from(last.saturating_sub(self.first)) + 1)
    }

    /// Makes one of two losses that follow each other; whether that was possible.
    pub(crate) fn join(&mut self, next: &Self) -> bool {
        let is_next = (self.node, self.boot, self.reason) == (next.node, next.boot, next.reason)
            && self.last.and_then(|last| last.checked_add(1)) == Some(next.first);
        if is_next {
            self.last = next.last;
        }
        is_next
    }
}

impl fmt::Display for Loss {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { node, boot, first, last, reason } = self;
        match last {
            Some(last) if last == first => write!(formatter, "window {first}")?,
            Some(last) => write!(formatter, "windows {first} to {last}")?,
            None => write!(formatter, "windows from {first} on, if there were any,")?,
        }
        write!(formatter, " of node {node} (boot {boot}): {reason}")
    }
}
