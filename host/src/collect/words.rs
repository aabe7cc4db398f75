//! What ports have come to, in words.

use std::collections::BTreeMap;

use belfry_shared::message::{ChannelState, Fault, FaultKind, SensorState};

use super::status::{PortState, PortStatus};
use crate::study::Setup;
use crate::window::channels_by_node;

/// Words for the ports of a setup, whose channels have names.
#[derive(Debug, Clone)]
pub struct Words {
    /// The setup's nodes, and their channels' names.
    nodes: BTreeMap<u16, Vec<String>>,
}

impl Words {
    /// Words for a setup.
    pub fn new(setup: &Setup) -> Self {
        let names = |channels: Vec<usize>| channels.iter().map(|&c| setup.sensors[c].channel.clone()).collect();
        Self { nodes: channels_by_node(setup).into_iter().map(|(node, channels)| (node, names(channels))).collect() }
    }

    /// The setup's nodes.
    pub fn nodes(&self) -> impl Iterator<Item = u16> {
        self.nodes.keys().copied()
    }

    /// What a port has come to, and what is wrong with its node's sensors.
    pub fn state(&self, status: &PortStatus) -> String {
        let mut words = match &status.state {
            PortState::Asking => "waiting for an answer".to_owned(),
            PortState::Silent => "no answer".to_owned(),
            PortState::Gone(reason) => format!("gone, tried again ({reason})"),
            PortState::Preparing => "gets its configuration and the time".to_owned(),
            PortState::Measuring => "measures".to_owned(),
            PortState::Foreign => format!(
                "not used: no sensor of this setup has `node = {}` (BELFRY_NODE sets a board's number when it is built)",
                status.node.unwrap_or_default()
            ),
            PortState::Refused(reason) => reason.clone(),
        };
        if let Some(fault) = status.hello.as_ref().and_then(|hello| hello.fault.as_ref()) {
            words += &format!("; {}", fault_in_words(fault));
        }
        if let Some((channel, reason)) = status.gaps.last {
            words += &format!(
                "; windows with gaps: {}, the last: {} {}",
                status.gaps.windows,
                self.channel(status.node, channel),
                gap_in_words(reason)
            );
        }
        if let Some(heartbeat) = &status.heartbeat {
            for (channel, sensor) in heartbeat.sensors.iter().enumerate() {
                if *sensor != SensorState::Sound {
                    words += &format!("; {} {sensor}", self.channel(status.node, channel));
                }
            }
            if heartbeat.lost_rows > 0 {
                words += &format!("; {} samples lost", heartbeat.lost_rows);
            }
            if heartbeat.stale_rows > 0 {
                words += &format!("; {} times the sensor had taken no new sample", heartbeat.stale_rows);
            }
            if heartbeat.refused_messages > 0 {
                words += &format!(
                    "; the node refused {} messages, mostly of a program that had not greeted it last",
                    heartbeat.refused_messages
                );
            }
            if heartbeat.unsealed_messages > 0 {
                words += &format!(
                    "; the node refused {} messages that were not sealed with its key, or that it had heard before",
                    heartbeat.unsealed_messages
                );
            }
            if heartbeat.unknown_messages > 0 {
                words += &format!(
                    "; the node passed over {} messages, which later firmware would know",
                    heartbeat.unknown_messages
                );
            }
            if heartbeat.board.dropped_frames > 0 {
                words += &format!("; the node dropped {} messages from this computer", heartbeat.board.dropped_frames);
            }
        }
        if status.statistics.unknown_messages > 0 {
            words += &format!(
                "; {} messages of the node passed over, which a later version of Belfry would know",
                status.statistics.unknown_messages
            );
        }
        if status.statistics.unsealed_frames > 0 {
            words += &format!(
                "; {} frames refused that the node has not sealed, or that had come before",
                status.statistics.unsealed_frames
            );
        }
        if status.statistics.contradictions > 0 {
            words += &format!(
                "; {} parts of windows refused: of another node, of a time that has not been, or of another size than asked for",
                status.statistics.contradictions
            );
        }
        if status.statistics.foreign_windows > 0 {
            words += &format!("; {} windows of another study dropped", status.statistics.foreign_windows);
        }
        words
    }

    /// A channel's name in the study.
    pub fn name(&self, node: Option<u16>, channel: usize) -> Option<&str> {
        node.and_then(|node| self.nodes.get(&node)?.get(channel)).map(String::as_str)
    }

    fn channel(&self, node: Option<u16>, channel: usize) -> String {
        match self.name(node, channel) {
            Some(name) => format!("channel \"{name}\""),
            None => format!("channel {}", channel + 1),
        }
    }
}

/// Why a channel has a gap.
pub(crate) fn gap_in_words(reason: ChannelState) -> &'static str {
    match reason {
        ChannelState::Sound { .. } => "was sound",
        ChannelState::Missing => "gave no readings",
        ChannelState::Clipped => "was clipped",
        ChannelState::Constant => "always read the same",
        ChannelState::Overrun => "was not computed in time",
        ChannelState::Unknown => "was not sound, for a reason that this version of Belfry does not know",
    }
}

/// What a node has recorded of its last end, or of its board.
pub(crate) fn fault_in_words(fault: &Fault) -> String {
    match fault.kind {
        FaultKind::Clock | FaultKind::Key | FaultKind::Store => fault.to_string(),
        FaultKind::Panic
        | FaultKind::HardFault
        | FaultKind::StackOverflow
        | FaultKind::Watchdog
        | FaultKind::Unknown => {
            format!("restarted: {fault}")
        }
    }
}

/// Seconds in as many digits as say something.
pub(crate) fn seconds_in_words(seconds: f64) -> String {
    if seconds < 10.0 { format!("{seconds:.2}") } else { format!("{seconds:.0}") }
}
