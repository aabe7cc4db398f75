//! Where a gateway stands in its archive, kept in the study's `gateway.json`.
//!
//! The file may be older than what was published: the stream's newest message of each node is asked as well. So it may be lost, too.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use belfry_shared::message::WindowName;
use serde::{Deserialize, Serialize};

use super::error::StreamError;
use crate::archive::Archive;
use crate::files::{read_plain, write_whole};

/// The file's name in the study's folder.
pub(super) const POSITION_FILE: &str = "gateway.json";

/// What was published last.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Position {
    /// When the stream was made: another stream has nothing of this one.
    pub(super) stream: String,
    /// The window.
    pub(super) window: Option<WindowName>,
    /// The number of its row, for when the archive no longer has it.
    pub(super) row: i64,
    /// Bytes of the file of heartbeats.
    pub(super) heartbeat_bytes: u64,
}

impl Position {
    /// Where the gateway of a study's `folder` stands in a stream.
    pub(super) fn read(folder: &Path, stream: &str) -> Result<Self, StreamError> {
        let file = path(folder);
        let bytes = match read_plain(&file) {
            Err(error) if error.kind() == ErrorKind::NotFound => Vec::new(),
            bytes => bytes.map_err(|source| StreamError::File { file, source })?,
        };
        // Half a file is none: the stream says the rest.
        let position = serde_json::from_slice::<Self>(&bytes).ok().filter(|position| position.stream == stream);
        Ok(position.unwrap_or_else(|| Self { stream: stream.to_owned(), ..Self::default() }))
    }

    /// Keeps it.
    pub(super) fn write(&self, folder: &Path) -> Result<(), StreamError> {
        let file = path(folder);
        let written = serde_json::to_vec(self).map_err(Into::into).and_then(|text| write_whole(&file, &text));
        written.map_err(|source| StreamError::File { file, source })
    }

    /// The row of the window, as the archive numbers it now: a repair numbers anew.
    pub(super) fn row_in(&self, archive: &Archive) -> Result<i64, StreamError> {
        let row = self.window.map_or(Ok(None), |window| archive.row_of(&window))?;
        Ok(row.unwrap_or(self.row))
    }
}

fn path(folder: &Path) -> PathBuf {
    folder.join(POSITION_FILE)
}
