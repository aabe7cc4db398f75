//! What streams, buckets, subjects and headers are called.

use belfry_shared::message::WindowName;

/// The stream of what gateways send.
pub(super) const DATA: &str = "BELFRY";
/// Its subjects: windows and heartbeats. A server before 2.10 gives readers no subjects that two of its patterns have together.
pub(super) const DATA_SUBJECTS: [&str; 1] = ["belfry.*.*.*"];
/// The stream of what workers make of it.
pub(super) const RESULTS: &str = "BELFRY_RESULTS";
/// Its subjects.
pub(super) const RESULTS_SUBJECTS: [&str; 2] = ["belfry.*.results", "belfry.*.alarms"];
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

/// Where windows of a node go.
pub(super) fn windows(structure: &str, node: u16) -> String {
    format!("belfry.{structure}.windows.{node}")
}

/// Where heartbeats of a node go.
pub(super) fn heartbeats(structure: &str, node: u16) -> String {
    format!("belfry.{structure}.heartbeats.{node}")
}

/// All that gateways send of a structure.
pub(super) fn data(structure: &str) -> String {
    format!("belfry.{structure}.*.*")
}

/// All that gateways send.
pub(super) const ALL_DATA: &str = DATA_SUBJECTS[0];

/// Where results of a structure go.
pub(super) fn results(structure: &str) -> String {
    format!("belfry.{structure}.results")
}

/// Where alarms of a structure go.
pub(super) fn alarms(structure: &str) -> String {
    format!("belfry.{structure}.alarms")
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
    let mut parts = subject.strip_prefix("belfry.")?.splitn(3, '.');
    let (structure, kind, node) = (parts.next()?, parts.next()?, parts.next()?);
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
        for other in [results("t"), alarms("t"), windows("t", 3) + ".4", "belfry.t.windows".to_owned()] {
            assert_eq!(data_of(&other), None, "{other}");
        }
        let name = WindowName { node: 12, boot: u32::MAX, number: 7 };
        assert_eq!(window_of(&window_id(&tower, &name)), Some(name));
        assert_eq!(window_of("Tower-1-2"), None);
    }
}
