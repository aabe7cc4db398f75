//! Why the stream, or what is to go into it, cannot be used.

use std::io;
use std::path::PathBuf;

use serde::de::DeserializeOwned;
use thiserror::Error;

use crate::archive::{ArchiveError, PackedError};
use crate::link::with_cause;
use crate::results::ResultsError;
use crate::study::StudyError;

/// Why the stream, or what is to go into it, cannot be used.
#[derive(Debug, Error)]
pub enum StreamError {
    /// The server does not answer, or refuses.
    #[error("no connection to {address}: {why}")]
    Connect {
        /// Its address.
        address: String,
        /// What was said.
        why: String,
    },
    /// The file of credentials is none.
    #[error("{}: not a file of NATS credentials (a JWT and an nkey seed, as `nsc generate creds` writes it): {source}", file.display())]
    Credentials {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        source: io::Error,
    },
    /// The server has failed at something.
    #[error("{what}: {why}")]
    Server {
        /// At what.
        what: String,
        /// What was said.
        why: String,
    },
    /// The connection has gone while something was read.
    #[error("the connection has gone")]
    Gone,
    /// A window is longer than the server takes.
    #[error(
        "{what} takes {bytes} bytes, and the server takes {most} at most: raise max_payload in its configuration; until then nothing behind it is published"
    )]
    TooLong {
        /// What.
        what: String,
        /// Its length.
        bytes: usize,
        /// The server's limit.
        most: usize,
    },
    /// Another worker has published for this structure.
    #[error("another worker has published results of {structure}")]
    Overtaken {
        /// The structure.
        structure: String,
    },
    /// Something in a bucket is not what Belfry puts there.
    #[error("{what} on the server is not what Belfry puts there: {why}")]
    Odd {
        /// What.
        what: String,
        /// What is wrong.
        why: String,
    },
    /// A structure's study cannot be followed.
    #[error("{study}: {why}")]
    Unfit {
        /// The study.
        study: String,
        /// Why, and what to do.
        why: String,
    },
    /// The system gives no threads, no random numbers or no folder for what passes.
    #[error("this computer gives a worker or a gateway no place to run")]
    System(#[source] io::Error),
    /// A file cannot be read or written.
    #[error("{}", file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The archive fails.
    #[error(transparent)]
    Archive(#[from] ArchiveError),
    /// A window cannot be encoded.
    #[error(transparent)]
    Packed(#[from] PackedError),
    /// The study cannot be read.
    #[error(transparent)]
    Study(Box<StudyError>),
    /// Results of the study cannot be read.
    #[error(transparent)]
    Results(#[from] ResultsError),
}

impl From<StudyError> for StreamError {
    fn from(error: StudyError) -> Self {
        Self::Study(Box::new(error))
    }
}

impl StreamError {
    /// The server has failed at something.
    pub(super) fn server(what: impl Into<String>) -> impl FnOnce(Box<dyn std::error::Error + Send + Sync>) -> Self {
        let what = what.into();
        move |error| Self::Server { what, why: with_cause(&*error) }
    }

    /// Reads an object of the server's as JSON.
    pub(super) fn read<T: DeserializeOwned>(what: impl Into<String>, json: &[u8]) -> Result<T, Self> {
        serde_json::from_slice(json).map_err(|error| Self::Odd { what: what.into(), why: error.to_string() })
    }

    /// Whether it may pass by itself: the server is away, or another worker was quicker.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Archive(error) => error.may_pass(),
            Self::Credentials { .. }
            | Self::Unfit { .. }
            | Self::Study(_)
            | Self::Results(_)
            | Self::System(_)
            | Self::File { .. } => false,
            _ => true,
        }
    }
}
