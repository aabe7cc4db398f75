//! Two-way exchanges that measure the node's clock.

use serde::{Deserialize, Serialize};

use crate::time::{HostTime, NodeTime};

/// Asks for the node's time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ClockRequest {
    /// When the host sent this.
    pub host_sent: HostTime,
}

/// The node's answer. With the time of its arrival the host has all four times of a two-way exchange.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ClockReply {
    /// The request's `host_sent`.
    pub host_sent: HostTime,
    /// When the request's last byte arrived at the node.
    pub node_received: NodeTime,
    /// When the node began to send this.
    pub node_sent: NodeTime,
    /// How long after `host_sent` the request arrived, in µs, by the host's time as the node knows it. If that is far from a
    /// line's delay, a host whose clock was wrong has set the node's. `None` before any host has.
    pub believed_delay_us: Option<i64>,
}
