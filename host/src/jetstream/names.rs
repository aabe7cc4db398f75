//! What streams, buckets, subjects and headers are called.

use std::fmt;

use belfry_shared::message::WindowName;

/// Parts of a fleet. Each has streams of its own: a server goes through all that lies between the messages of a structure, and a stream for each
/// structure would cost it more than the messages do.
const PARTS: u32 = 128;
/// The bucket of structures.
pub(super) const STRUCTURES: &str = "belfry-structures";
/// The bucket of what the judgement of each goes on from.
pub(super) const STATES: &str = "belfry-states";
/// The bucket of workers that are alive.
pub(super) const WORKERS: &str = "belfry-workers";
/// The object store of studies.
pub(super) const STUDIES: &str = "belfry-studies";

/// The header with the time that a message is of, in µs of Unix time: a window's middle, when a heartbeat came.
pub(super) const TIME_HEADER: &str = "Belfry-Time";
/// The header with what makes a message one that the stream has already.
pub(super) const ID_HEADER: &str = "Nats-Msg-Id";

/// A structure's name as a part of subjects and keys: letters, digits and `_` as they are, all else as `-`.
pub(super) fn token(structure: &str) -> String {
    let plain = |letter: char| if letter.is_ascii_alphanumeric() || letter == '_' { letter } else { '-' };
    let token: String = structure.chars().map(plain).collect();
    if token.is_empty() { "-".to_owned() } else { token }
}

/// A part of a fleet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Part(u32);

impl Part {
    /// The part that a structure is in: FNV-1a (32 bits) of its name as [`token`] writes it.
    pub(super) fn of(structure: &str) -> Self {
        let hash = |hash: u32, byte: u8| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
        Self(structure.bytes().fold(0x811c_9dc5, hash) % PARTS)
    }

    /// The stream of what gateways send.
    pub(super) fn data_stream(self) -> String {
        format!("BELFRY_{self}")
    }

    /// Its subject: windows and heartbeats. One, for a server before 2.10 gives readers no subjects that two of its patterns have together.
    pub(super) fn data(self) -> String {
        format!("belfry.{self}.*.*.*")
    }

    /// The stream of what workers make of it.
    pub(super) fn results_stream(self) -> String {
        format!("BELFRY_RESULTS_{self}")
    }

    /// Its subjects.
    pub(super) fn results(self) -> [String; 2] {
        [format!("belfry.{self}.*.results"), format!("belfry.{self}.*.alarms")]
    }
}

/// As names and subjects have it.
impl fmt::Display for Part {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{:03}", self.0)
    }
}

/// Where windows of a node go.
pub(super) fn windows(structure: &str, node: u16) -> String {
    format!("belfry.{}.{structure}.windows.{node}", Part::of(structure))
}

/// Where heartbeats of a node go.
pub(super) fn heartbeats(structure: &str, node: u16) -> String {
    format!("belfry.{}.{structure}.heartbeats.{node}", Part::of(structure))
}

/// All that gateways send of a structure.
pub(super) fn data(structure: &str) -> String {
    format!("belfry.{}.{structure}.*.*", Part::of(structure))
}

/// Where results of a structure go.
pub(super) fn results(structure: &str) -> String {
    format!("belfry.{}.{structure}.results", Part::of(structure))
}

/// Where alarms of a structure go.
pub(super) fn alarms(structure: &str) -> String {
    format!("belfry.{}.{structure}.alarms", Part::of(structure))
}

/// What makes a window one that the stream has already.
pub(super) fn window_id(structure: &str, name: &WindowName) -> String {
    format!("{structure}-{}-{}-{}", name.node, name.boot, name.number)
}

/// The name of a window, of its identity.
pub(super) fn window_of(id: &str) -> Option<WindowName> {
    let mut parts = id.rsplitn(4, '-');
    let number = parts.next()?.parse().ok()?;
    let boot = parts.next()?.parse().ok()?;
    let node = parts.next()?.parse().ok()?;
    Some(WindowName { node, boot, number })
}

/// What a subject of data says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum DataKind {
    /// A window of a node.
    Window {
        /// The node.
        node: u16,
    },
    /// A heartbeat.
    Heartbeat,
}

/// The structure and the kind of a message, by its subject; `None` for what is neither.
pub(super) fn data_of(subject: &str) -> Option<(&str, DataKind)> {
    let mut tokens = subject.strip_prefix("belfry.")?.splitn(4, '.').skip(1);
    let (structure, kind, node) = (tokens.next()?, tokens.next()?, tokens.next()?);
    let node = node.parse().ok()?;
    match kind {
        "windows" => Some((structure, DataKind::Window { node })),
        "heartbeats" => Some((structure, DataKind::Heartbeat)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_subject_says_whose_a_message_is_and_an_identity_which_window() {
        let tower = token("Tower 7.b/Süd");
        assert_eq!(tower, "Tower-7-b-S-d");
        assert_eq!(data_of(&windows(&tower, 12)), Some((tower.as_str(), DataKind::Window { node: 12 })));
        assert_eq!(data_of(&heartbeats("t", 3)), Some(("t", DataKind::Heartbeat)));
        for other in [results("t"), alarms("t"), windows("t", 3) + ".4", "belfry.000.t.windows".to_owned()] {
            assert_eq!(data_of(&other), None, "{other}");
        }
        let name = WindowName { node: 12, boot: u32::MAX, number: 7 };
        assert_eq!(window_of(&window_id(&tower, &name)), Some(name));
        assert_eq!(window_of("Tower-1-2"), None);
    }

    #[test]
    fn parts_are_alike_and_stay_what_they_are() {
        let mut sizes = std::collections::BTreeMap::new();
        for number in 0..12_800 {
            *sizes.entry(Part::of(&format!("Tower-{number}"))).or_insert(0) += 1;
        }
        assert_eq!(sizes.len(), PARTS as usize);
        // Binomial: 100 with a deviation of 10.
        assert!(sizes.values().all(|size| (60..140).contains(size)), "{sizes:?}");
        // FNV-1a of "a" is e40c292c, of "foobar" bf9cf968 (Noll's list). What is on servers lies where these say.
        assert_eq!(["a", "foobar"].map(|name| Part::of(name).to_string()), ["044", "104"]);
    }
}
