//! What a sensor may call a time response of a universal file: its node and direction, its title, or its number in the file.
//!
//! Node, direction and title flow in; the response that a sensor's channel names flows out.

use std::fmt;
use std::path::Path;

use super::error::RecordError;

/// The names of one response.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ResponseName {
    /// `12x`, `12-y`, `12rz`; `None` where the response has no direction.
    label: Option<String>,
    /// The dataset's first line of text.
    title: String,
}

impl ResponseName {
    /// `direction` as dataset 58 counts it: 1 to 3 along x, y, z, 4 to 6 about them, negative for the opposite sense.
    pub(super) fn new(node: i64, direction: i64, title: &str) -> Self {
        const NAMES: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];
        let along = usize::try_from(direction.unsigned_abs()).ok().and_then(|count| NAMES.get(count.checked_sub(1)?));
        let sign = if direction < 0 { "-" } else { "" };
        Self { label: along.map(|along| format!("{node}{sign}{along}")), title: title.to_owned() }
    }

    fn is_called(&self, channel: &str) -> bool {
        let plain: String = channel.chars().filter(|c| !matches!(c, ':' | '+' | ' ')).collect();
        self.label.as_deref() == Some(plain.to_ascii_lowercase().as_str())
    }
}

impl fmt::Display for ResponseName {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.label {
            Some(label) => formatter.write_str(label),
            None => formatter.write_str(&self.title),
        }
    }
}

/// Whether two files have the same responses in the same order. Titles often carry dates: they count only where a node
/// and direction does not name the response.
pub(super) fn same_responses(one: &[ResponseName], other: &[ResponseName]) -> bool {
    let is_named = |name: &ResponseName| {
        name.label.is_some() && one.iter().filter(|response| response.label == name.label).count() == 1
    };
    one.len() == other.len()
        && one.iter().zip(other).all(|(a, b)| a.label == b.label && (is_named(a) || a.title == b.title))
}

/// The response (from 0) that a sensor's `channel` names: by node and direction, else by its title, else by its position.
pub(super) fn find_response(
    names: &[ResponseName],
    channel: &str,
    file: &Path,
    unknown: impl Fn() -> RecordError,
) -> Result<usize, RecordError> {
    let channel = channel.trim();
    for by_label in [true, false] {
        let mut found = (0..).zip(names).filter(|(_, name)| {
            if by_label { name.is_called(channel) } else { !channel.is_empty() && name.title == channel }
        });
        match (found.next(), found.next()) {
            (Some((response, _)), None) => return Ok(response),
            (Some(_), Some(_)) => {
                return Err(RecordError::AmbiguousChannel { file: file.to_owned(), channel: channel.to_owned() });
            }
            (None, _) => {}
        }
    }
    match channel.parse::<usize>() {
        Ok(position) if (1..=names.len()).contains(&position) => Ok(position - 1),
        _ => Err(unknown()),
    }
}
