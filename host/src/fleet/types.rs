//! What a fleet is told and what it says: options, errors, and the report of a node.

use belfry_shared::message::Summary;
use thiserror::Error;

use crate::link::memory::{Faults, LineStatistics};
use crate::link::{SessionError, SessionStatistics};

/// How the nodes are set up and what their lines do to them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FleetOptions {
    /// What the nodes send. Only [`Summary::Lines`] makes modes.
    pub summary: Summary,
    /// Baud rate of every line.
    pub baud: u32,
    /// What happens to frames.
    pub faults: Faults,
    /// When the nodes sample.
    pub pace: Pace,
    /// Draws clocks, boot ids and faults.
    pub seed: u64,
    /// Whether the nodes have keys, which are drawn too.
    pub has_keys: bool,
}

/// When simulated nodes sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pace {
    /// When the rows of the recording were sampled, by clocks that started at other times but run like the recording's: a crystal
    /// that is off samples at other moments, of which a recording has no rows.
    Recording,
    /// When their own crystals say, as on a board: every other node's is so many ppm fast, the others' as many slow. Rows are
    /// interpolated to these moments.
    Crystal {
        /// How far the crystals are off, in parts per million.
        ppm: f64,
        /// How much further as they warm and cool in the course of a day, each node's at hours of its own.
        swing_ppm: f64,
    },
}

impl Default for FleetOptions {
    /// Lines of 10 bits over a sound line of 115 200 baud.
    fn default() -> Self {
        Self {
            summary: Summary::Lines { bits: 10 },
            baud: 115_200,
            faults: Faults::default(),
            pace: Pace::Recording,
            seed: 1,
            has_keys: false,
        }
    }
}

/// Why the fleet could not measure.
#[derive(Debug, Error)]
pub enum FleetError {
    /// The host's session with a node ended.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A node was not ready when the recording began.
    #[error("node {node} was not ready when the recording began: its line damages too many frames")]
    NotReady {
        /// The node.
        node: u16,
    },
    /// The settings cannot be expressed in a configuration.
    #[error(
        "decimation {decimation} with a segment of {segment} and {lines} lines from line {first_line} cannot be sent to a node"
    )]
    Settings {
        /// Raw samples a decimated one.
        decimation: u32,
        /// Decimated samples a segment.
        segment: usize,
        /// Index of the first line.
        first_line: usize,
        /// Number of lines.
        lines: usize,
    },
    /// A worker thread ended early.
    #[error("a simulated node stopped unexpectedly; this is a fault in belfry, please report it")]
    Worker,
}

/// What one node and its line did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NodeReport {
    /// The node.
    pub node: u16,
    /// Its channels.
    pub channels: usize,
    /// The host's side of the conversation.
    pub session: SessionStatistics,
    /// What the line did towards the host.
    pub to_host: LineStatistics,
    /// What the line did towards the node.
    pub to_node: LineStatistics,
}
