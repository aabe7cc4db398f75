//! Why an archive cannot be read or written, and what passes by itself.

use std::path::PathBuf;

use rusqlite::ErrorCode;
use thiserror::Error;

use super::VERSION;

/// Why an archive cannot be read or written.
#[derive(Debug, Error)]
pub enum ArchiveError {
    /// The database refuses.
    #[error("the archive {file} cannot be used: {why}", file = .file.display())]
    Database {
        /// The archive.
        file: PathBuf,
        /// Why.
        why: rusqlite::Error,
    },
    /// It is a database of something else.
    #[error("{file} is no archive of belfry, or its first page is damaged: `belfry archive repair` rebuilds that of an archive; move anything else away", file = .file.display())]
    NotAnArchive {
        /// The file.
        file: PathBuf,
    },
    /// It was written by a newer version.
    #[error(
        "the archive {file} has tables of version {found}, this belfry knows versions 1 to {VERSION}: use the belfry that wrote it", file = .file.display()
    )]
    Version {
        /// The archive.
        file: PathBuf,
        /// Its version.
        found: i32,
    },
    /// It was written by an older version, and cannot be brought up to this one.
    #[error(
        "the archive {file} has tables of version {found}, and cannot be brought to version {VERSION}; it is as it was. Is there room for as much again, and may its folder be written to? SQLite says: {why}", file = .file.display()
    )]
    Migration {
        /// The archive.
        file: PathBuf,
        /// Its version.
        found: i32,
        /// Why.
        why: rusqlite::Error,
    },
    /// What stands in it makes no sense.
    #[error("the archive {file} is damaged: {what}; see `belfry archive check`", file = .file.display())]
    Damaged {
        /// The archive.
        file: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// Its first page makes no sense, without which no other can be found.
    #[error("the archive {file} cannot be opened, for its first page is damaged: `belfry archive repair` rebuilds it where nothing else is wrong; else move the file away, or put a copy in its place. SQLite says: {why}", file = .file.display())]
    Unopenable {
        /// The archive.
        file: PathBuf,
        /// What SQLite says.
        why: rusqlite::Error,
    },
    /// Its end is missing.
    #[error("the archive {file} has been cut: {has} of its {of} pages are there. `belfry archive repair` saves what it finds on them", file = .file.display())]
    Cut {
        /// The archive.
        file: PathBuf,
        /// Pages that the file has.
        has: u64,
        /// Pages that it should have.
        of: u64,
    },
    /// No row of it can be found.
    #[error("nothing of the archive {file} can be saved: move it away, or put a copy in its place", file = .file.display())]
    NothingSaved {
        /// The archive.
        file: PathBuf,
    },
    /// Nothing lies in the range of time that is asked for.
    #[error("it has no window {range}; its windows begin from {first} to {last}")]
    OutOfRange {
        /// The range, in words.
        range: String,
        /// When its first window begins.
        first: String,
        /// And its last.
        last: String,
    },
    /// Another program has the archive open for writing.
    #[error("the archive {file} is being written to: stop `belfry collect` first, nodes keep their windows meanwhile", file = .file.display())]
    InUse {
        /// The archive.
        file: PathBuf,
    },
    /// It has no content.
    #[error("{file} is there and has 0 bytes: either nothing has been collected yet, or what it had is lost, as on a full disk or by a copy that broke off", file = .file.display())]
    Empty {
        /// The archive.
        file: PathBuf,
    },
    /// There is none.
    #[error("there is no {file}: no node has been collected from", file = .file.display())]
    Absent {
        /// Where it should be.
        file: PathBuf,
    },
    /// A file beside it cannot be written.
    #[error("{file} cannot be written", file = .file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

impl ArchiveError {
    /// Why there is nothing in an archive that nobody has made yet.
    pub(crate) fn absent(file: PathBuf) -> Self {
        if file.exists() { Self::Empty { file } } else { Self::Absent { file } }
    }

    /// What the database says, where it refuses.
    fn code(&self) -> Option<ErrorCode> {
        match self {
            Self::Database { why, .. } => why.sqlite_error_code(),
            _ => None,
        }
    }

    /// Whether there is nothing to go by in the file.
    pub(super) fn is_beyond_repair(&self) -> bool {
        matches!(
            self,
            Self::Unopenable { .. }
                | Self::Cut { .. }
                | Self::NotAnArchive { .. }
                | Self::NothingSaved { .. }
                | Self::Damaged { .. }
        )
    }

    /// Whether another program writes or repairs, or the disk is full: that passes, also for an archive that is still to be opened.
    pub fn will_pass(&self) -> bool {
        let passes = |code| matches!(code, ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked | ErrorCode::DiskFull);
        matches!(self, Self::InUse { .. }) || self.code().is_some_and(passes)
    }

    /// Whether an archive that has been written to is worth another try: as [`ArchiveError::will_pass`], or its disk is away.
    pub fn may_pass(&self) -> bool {
        let is_away = |code| {
            matches!(
                code,
                ErrorCode::SystemIoFailure | ErrorCode::CannotOpen | ErrorCode::ReadOnly | ErrorCode::OutOfMemory
            )
        };
        self.will_pass() || self.code().is_some_and(is_away)
    }
}

/// Whether a row, or the page it is on, is damaged, so that others may still be read.
pub(super) fn is_damage(error: &rusqlite::Error) -> bool {
    match error {
        rusqlite::Error::SqliteFailure(failure, _) => {
            matches!(failure.code, ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase | ErrorCode::SystemIoFailure)
        }
        rusqlite::Error::InvalidColumnType(..)
        | rusqlite::Error::FromSqlConversionFailure(..)
        | rusqlite::Error::IntegralValueOutOfRange(..)
        | rusqlite::Error::Utf8Error(..) => true,
        _ => false,
    }
}
