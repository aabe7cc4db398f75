//! What a port has come to, and what the node on it has done.

use belfry_shared::message::{ChannelState, Heartbeat, Hello};

use crate::link::SessionStatistics;

/// What a port has come to.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum PortState {
    /// It is being opened, and asked who is there.
    #[default]
    Asking,
    /// Nobody answers.
    Silent,
    /// It cannot be opened, or has failed; it is tried again.
    Gone(String),
    /// Its node is given its configuration and the time.
    Preparing,
    /// Its node measures.
    Measuring,
    /// Its node does not belong to the setup, and nothing is asked of it.
    Foreign,
    /// Its node cannot be used as it is; it is tried again now and then.
    Refused(String),
}

impl PortState {
    /// Whether its node is of no use as it is.
    pub fn is_useless(&self) -> bool {
        matches!(self, Self::Foreign | Self::Refused(_))
    }

    /// Whether a node is served on it.
    pub fn is_served(&self) -> bool {
        matches!(self, Self::Preparing | Self::Measuring)
    }

    /// In a word, for programs.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Asking => "asking",
            Self::Silent => "silent",
            Self::Gone(_) => "gone",
            Self::Preparing => "preparing",
            Self::Measuring => "measuring",
            Self::Foreign => "foreign",
            Self::Refused(_) => "refused",
        }
    }
}

/// Windows since collecting began in which a channel was not sound.
#[derive(Debug, Clone, Copy, Default)]
pub struct Gaps {
    /// How many.
    pub windows: u64,
    /// What was wrong last: channel (from 0) and reason.
    pub last: Option<(usize, ChannelState)>,
}

/// A port, and the node on it.
#[derive(Debug, Clone, Default)]
pub struct PortStatus {
    /// The port.
    pub port: String,
    /// What it has come to.
    pub state: PortState,
    /// The node that answers, or did until its port failed.
    pub node: Option<u16>,
    /// Its last greeting.
    pub hello: Option<Hello>,
    /// Its last sign of life.
    pub heartbeat: Option<Heartbeat>,
    /// What its line did since collecting began.
    pub statistics: SessionStatistics,
    /// How much faster the host's clock runs than the node's, in parts per million, where it is known.
    pub drift_ppm: Option<f64>,
    /// Its windows with gaps.
    pub gaps: Gaps,
    /// Highest peaks of the mean density of all channels, in Hz, highest first.
    pub peaks_hz: Vec<f64>,
}

impl PortStatus {
    /// Leaves the port and its state.
    pub(super) fn forget_node(&mut self) {
        let (port, state) = (std::mem::take(&mut self.port), std::mem::take(&mut self.state));
        *self = Self { port, state, ..Self::default() };
    }
}
