//! Why a conversation with a node cannot go on.

use std::io;

use belfry_shared::message::RefusalReason;
use thiserror::Error;

use super::wire::{NoCommonVersion, Untaken};

/// Why a conversation cannot go on.
#[derive(Debug, Error)]
pub enum SessionError {
    /// The node speaks other versions of the protocol.
    #[error("node {node} {problem}")]
    Version {
        /// The node the session is for.
        node: u16,
        /// Which versions.
        problem: NoCommonVersion,
    },
    /// The node has no key, and should have one.
    #[error(
        "node {node} answers without its key: write the key's image into it (`belfry key image {node}`), or remove its line from the file of keys if it is to have none; unless somebody else on the line answers in its name"
    )]
    Unsealed {
        /// The node the session is for.
        node: u16,
    },
    /// The node has another key than this computer.
    #[error(
        "node {node} has another key than this computer has for it: write the image of this one into it (`belfry key image {node}`), or copy its line from the file of keys where it was made"
    )]
    OtherKey {
        /// The node the session is for.
        node: u16,
    },
    /// The node has a key that this computer does not have.
    #[error(
        "node {node} has a key, and this computer does not have it: copy its line from the file of keys where it was made (`belfry key list` says where that file is)"
    )]
    KeyMissing {
        /// The node the session is for.
        node: u16,
    },
    /// Another node is on the line.
    #[error("node {found} answers where node {node} was expected: check the cables or the node numbers in study.toml")]
    WrongNode {
        /// The node the session is for.
        node: u16,
        /// The node that answered.
        found: u16,
    },
    /// Another program greets the node as well.
    #[error(
        "another program collects from node {node} on this line: end one of the two, each takes windows from the other"
    )]
    TakenOver {
        /// The node the session is for.
        node: u16,
    },
    /// The node cannot run the configuration.
    #[error("node {node} cannot measure what the study asks: {reason}")]
    Refused {
        /// The node the session is for.
        node: u16,
        /// Why.
        reason: RefusalReason,
    },
    /// The node holds windows that were asked for elsewhere.
    #[error(
        "node {node} still holds windows that another study asked for: collect them there, or have them dropped with --drop-foreign"
    )]
    ForeignWindows {
        /// The node the session is for.
        node: u16,
    },
    /// The node counts its windows anew under the name of an earlier life.
    #[error(
        "node {node} restarted with the same boot id, so its new windows cannot be distinguished from the old ones; switch it off and on again"
    )]
    RepeatedLife {
        /// The node the session is for.
        node: u16,
    },
    /// The transport failed.
    #[error("the line to node {node} failed")]
    Transport {
        /// The node the session is for.
        node: u16,
        /// The cause.
        source: io::Error,
    },
    /// A window could not be stored.
    #[error("a window of node {node} could not be stored")]
    Store {
        /// The node the session is for.
        node: u16,
        /// The cause.
        source: io::Error,
    },
}

impl SessionError {
    pub(super) fn untaken(node: u16, why: Untaken) -> Self {
        match why {
            Untaken::Version(problem) => Self::Version { node, problem },
            Untaken::Unsealed => Self::Unsealed { node },
            Untaken::OtherKey => Self::OtherKey { node },
        }
    }
}
