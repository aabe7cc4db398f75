//! A host's greeting.

use serde::{Deserialize, Serialize};

use super::Versions;

/// What a host says of itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Greeting {
    /// The versions of the protocol that it speaks.
    pub versions: Versions,
    /// The whole counter of the frame that says this, where it is sealed ([`crate::seal`]); else 0.
    pub counter: u32,
}

impl Greeting {
    /// A host's of this release, without a seal.
    pub const OF_HOSTS: Self = Self { versions: Versions::OF_HOSTS, counter: 0 };
}
