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

/// What of a run of numbers, first and last, is in none of the others, which are in any order.
pub(crate) fn without([first, last]: [u32; 2], others: &[[u32; 2]]) -> Vec<[u32; 2]> {
    let mut others: Vec<[u32; 2]> =
        others.iter().copied().filter(|other| other[0] <= last && other[1] >= first).collect();
    others.sort_unstable();
    let mut left = Vec::new();
    // Wider than the numbers, for the last of them may be the last there is.
    let mut next = u64::from(first);
    for [other_first, other_last] in others {
        if let Some(before) = other_first.checked_sub(1).filter(|&before| u64::from(before) >= next) {
            left.push([next as u32, before]);
        }
        next = next.max(u64::from(other_last) + 1);
    }
    if next <= u64::from(last) {
        left.push([next as u32, last]);
    }
    left
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_of_a_run_is_in_none_of_the_others() {
        assert_eq!(without([3, 9], &[]), [[3, 9]]);
        assert_eq!(without([3, 9], &[[8, 12], [0, 3], [5, 5], [5, 6]]), [[4, 4], [7, 7]]);
        assert_eq!(without([3, 9], &[[0, 20]]), <[[u32; 2]; 0]>::default());
        assert_eq!(without([3, 9], &[[10, 20], [0, 2]]), [[3, 9]]);
        assert_eq!(without([7, u32::MAX], &[[0, 7], [9, u32::MAX]]), [[8, 8]]);
        assert_eq!(without([7, u32::MAX], &[[u32::MAX, u32::MAX]]), [[7, u32::MAX - 1]]);
    }
}
