//! What is not in the archive as it was written, in words.

use std::fmt;

use belfry_shared::message::WindowName;
use serde::Serialize;

use super::range::moment;

/// Something that is not as it was written.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Damage {
    /// The table.
    pub table: &'static str,
    /// Its row, where one row is damaged.
    pub row: Option<i64>,
    /// The node of a window.
    pub node: Option<u16>,
    /// The node's life.
    pub boot: Option<u32>,
    /// The number of a window.
    pub window: Option<u32>,
    /// When it began, in s of Unix time; of an hour whose windows do not add up, the hour.
    pub start_s: Option<f64>,
    /// What is wrong.
    pub what: String,
}

impl Damage {
    /// A row of a table.
    pub(super) fn row(table: &'static str, row: i64, what: impl Into<String>) -> Self {
        Self { row: Some(row), ..Self::table(table, what) }
    }

    /// A table as a whole.
    pub(super) fn table(table: &'static str, what: impl Into<String>) -> Self {
        Self { table, row: None, node: None, boot: None, window: None, start_s: None, what: what.into() }
    }

    /// A window.
    pub(super) fn window(row: i64, name: WindowName, start_us: i64, what: impl Into<String>) -> Self {
        let WindowName { node, boot, number } = name;
        Self {
            node: Some(node),
            boot: Some(boot),
            window: Some(number),
            start_s: Some(start_us as f64 * 1e-6),
            ..Self::row("window", row, what)
        }
    }
}

impl fmt::Display for Damage {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let start = self.start_s.map(|start_s| moment((start_s * 1e6) as i64));
        match (self.window, self.node, self.boot, start, self.row) {
            (Some(window), Some(node), Some(boot), Some(start), _) => {
                write!(formatter, "window {window} of node {node} (boot {boot}), begun {start}: ")?;
            }
            (.., Some(start), _) => write!(formatter, "the hour from {start}: ")?,
            (.., Some(row)) => write!(formatter, "row {row} of {}: ", self.table)?,
            _ => write!(formatter, "{}: ", self.table)?,
        }
        formatter.write_str(&self.what)
    }
}

/// What the reader should know of damage: the first of it, and how much there is.
pub(crate) fn in_words(damages: &[Damage]) -> Vec<String> {
    /// More would hide what else is said.
    const MOST: usize = 3;
    let mut sentences: Vec<String> =
        damages.iter().take(MOST).map(|damage| format!("damaged in the archive, and left out: {damage}")).collect();
    if damages.len() > MOST {
        sentences.push(format!("and {} more; `belfry archive check` lists all", damages.len() - MOST));
    }
    sentences
}
