//! The archive: windows that nodes have sent, kept in the study's `archive.sqlite`.
//!
//! Windows flow in one by one, each committed to the disk before [`Archive::store`] returns, so that it may be acknowledged;
//! windows of a whole setup flow out in the order of the grid, also while others come in. The tables are open to other
//! programs (`schema.sql`).

mod codec;
mod read;

use std::path::{Path, PathBuf};
use std::time::Duration;

use belfry_shared::message::Configuration;
use belfry_shared::time::{HostTime, WindowGrid};
use rusqlite::{Connection, OpenFlags, OptionalExtension, TransactionBehavior, params};
use thiserror::Error;

use crate::window::{ChannelData, KeptWindows, NodeWindow};

pub use read::{Collected, CollectedSetup, NodeHealth};

/// The archive's name in the study's folder.
pub const ARCHIVE_FILE: &str = "archive.sqlite";
/// "Blfr": what tells an archive from other databases.
const APPLICATION_ID: i32 = 0x426C_6672;
/// The version of the tables.
const VERSION: i32 = 1;
/// How long another program that writes is waited for.
const BUSY: Duration = Duration::from_secs(10);

/// Why an archive cannot be read or written.
#[derive(Debug, Error)]
pub enum ArchiveError {
    /// The database refuses.
    #[error("the archive {file} cannot be used", file = .file.display())]
    Database {
        /// The archive.
        file: PathBuf,
        /// Why.
        source: rusqlite::Error,
    },
    /// It is a database of something else.
    #[error("{file} is no archive of belfry: move it away", file = .file.display())]
    NotAnArchive {
        /// The file.
        file: PathBuf,
    },
    /// It was written by another version.
    #[error(
        "the archive {file} has tables of version {found}, this belfry knows version {VERSION}: use the belfry that wrote it", file = .file.display()
    )]
    Version {
        /// The archive.
        file: PathBuf,
        /// Its version.
        found: i32,
    },
    /// What stands in it makes no sense.
    #[error("the archive {file} is damaged: {what}", file = .file.display())]
    Damaged {
        /// The archive.
        file: PathBuf,
        /// What is wrong.
        what: String,
    },
}

/// A study's archive.
#[derive(Debug)]
pub struct Archive {
    file: PathBuf,
    connection: Connection,
}

impl Archive {
    /// Opens the archive of the study in `folder` for writing; makes it where there is none.
    ///
    /// # Errors
    /// [`ArchiveError`]; a file that is something else stays as it is.
    pub fn create(folder: &Path) -> Result<Self, ArchiveError> {
        let file = folder.join(ARCHIVE_FILE);
        let archive = Self::connect(file, OpenFlags::default())?;
        archive.prepare().map_err(|source| archive.failed(source))?;
        archive.check()?;
        Ok(archive)
    }

    /// Opens the archive of the study in `folder` for reading; `None` where there is none.
    ///
    /// # Errors
    /// [`ArchiveError`].
    pub fn open(folder: &Path) -> Result<Option<Self>, ArchiveError> {
        let file = folder.join(ARCHIVE_FILE);
        if !file.exists() {
            return Ok(None);
        }
        let archive = Self::connect(file, OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX)?;
        archive.check()?;
        Ok(Some(archive))
    }

    fn connect(file: PathBuf, flags: OpenFlags) -> Result<Self, ArchiveError> {
        let connection = Connection::open_with_flags(&file, flags)
            .and_then(|connection| connection.busy_timeout(BUSY).map(|()| connection))
            .map_err(|source| ArchiveError::Database { file: file.clone(), source })?;
        Ok(Self { file, connection })
    }

    /// Sets up a fresh archive.
    fn prepare(&self) -> rusqlite::Result<()> {
        let tables: i64 = self.connection.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))?;
        if tables == 0 {
            self.connection.execute_batch(&format!(
                "BEGIN IMMEDIATE; {} PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {VERSION}; COMMIT;",
                include_str!("schema.sql")
            ))?;
        }
        Ok(())
    }

    fn check(&self) -> Result<(), ArchiveError> {
        let pragma = |name: &str| {
            let value = self.connection.pragma_query_value(None, name, |row| row.get::<_, i32>(0));
            value.map_err(|source| self.failed(source))
        };
        if pragma("application_id")? != APPLICATION_ID {
            return Err(ArchiveError::NotAnArchive { file: self.file.clone() });
        }
        match pragma("user_version")? {
            VERSION => {}
            found => return Err(ArchiveError::Version { file: self.file.clone(), found }),
        }
        // Only now is it known to be an archive, so that writing to it does no harm. A write-ahead log lets others read meanwhile; a commit is
        // on the disk when it returns.
        if !self.connection.is_readonly("main").map_err(|source| self.failed(source))? {
            let log = self.connection.pragma_update(None, "journal_mode", "wal");
            log.and_then(|()| self.connection.pragma_update(None, "synchronous", "full"))
                .map_err(|source| self.failed(source))?;
        }
        Ok(())
    }

    fn failed(&self, source: rusqlite::Error) -> ArchiveError {
        match source.sqlite_error_code() {
            Some(rusqlite::ErrorCode::NotADatabase) => ArchiveError::NotAnArchive { file: self.file.clone() },
            _ => ArchiveError::Database { file: self.file.clone(), source },
        }
    }

    fn damaged(&self, what: impl Into<String>) -> ArchiveError {
        ArchiveError::Damaged { file: self.file.clone(), what: what.into() }
    }

    /// The file.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Notes what a node is asked to measure, with its channels' names; the last that was asked counts.
    ///
    /// # Errors
    /// Where the database cannot be written.
    pub fn ask(
        &mut self,
        setup: &str,
        node: u16,
        configuration: &Configuration,
        channels: &[&str],
        now: HostTime,
    ) -> Result<(), ArchiveError> {
        let json = |error: serde_json::Error| self.damaged(error.to_string());
        let settings = serde_json::to_string(configuration).map_err(json)?;
        let channels = serde_json::to_string(channels).map_err(json)?;
        let asked = self.connection.execute(
            "INSERT INTO asked (setup, node, since_us, configuration, settings, channels)
             SELECT ?1, ?2, ?3, ?4, ?5, ?6 WHERE (?4, ?6) IS NOT
                 (SELECT configuration, channels FROM asked WHERE setup = ?1 AND node = ?2 ORDER BY id DESC LIMIT 1)",
            params![setup, node, now.0, configuration.hash(), settings, channels],
        );
        asked.map(drop).map_err(|source| self.failed(source))
    }

    /// What a setup's nodes have been asked to measure with, the last first; of all setups where none is named.
    ///
    /// # Errors
    /// Where the database cannot be read.
    pub fn configurations(&self, setup: Option<&str>) -> Result<Vec<Configuration>, ArchiveError> {
        let query = "SELECT settings FROM asked WHERE ?1 IS NULL OR setup = ?1 GROUP BY settings ORDER BY max(id) DESC";
        let settings: Vec<String> = self
            .connection
            .prepare(query)
            .and_then(|mut statement| statement.query_map([setup], |row| row.get(0))?.collect())
            .map_err(|source| self.failed(source))?;
        let read = |text: &String| {
            serde_json::from_str(text).map_err(|error| self.damaged(format!("settings {text}: {error}")))
        };
        settings.iter().map(read).collect()
    }

    /// Notes that a life of a node serves a setup from now on, where it has not before; where it is met for the first time, its windows
    /// are wanted from `first_window` on.
    ///
    /// # Errors
    /// Where the database cannot be written.
    pub fn meet(
        &mut self,
        setup: &str,
        node: u16,
        boot: u32,
        first_window: u32,
        now: HostTime,
    ) -> Result<(), ArchiveError> {
        let met = self.connection.execute(
            "INSERT INTO service (setup, node, boot, first_window, since_us) SELECT ?1, ?2, ?3, ?4, ?5 WHERE ?1 IS NOT
                 (SELECT setup FROM service WHERE node = ?2 AND boot = ?3 ORDER BY id DESC LIMIT 1)",
            params![setup, node, boot, first_window, now.0],
        );
        met.map(drop).map_err(|source| self.failed(source))
    }

    /// What is kept of a life of a node; `None` where it has never been met.
    ///
    /// # Errors
    /// Where the database cannot be read.
    pub fn kept(&self, node: u16, boot: u32) -> Result<Option<KeptWindows>, ArchiveError> {
        let known = || -> rusqlite::Result<Option<KeptWindows>> {
            // All of its windows since it was met are wanted, whichever setup they belong to.
            let first: Option<u32> = self.connection.query_row(
                "SELECT min(first_window) FROM service WHERE node = ?1 AND boot = ?2",
                params![node, boot],
                |row| row.get(0),
            )?;
            let Some(first) = first else { return Ok(None) };
            let mut statement =
                self.connection.prepare_cached("SELECT number FROM window WHERE node = ?1 AND boot = ?2")?;
            let numbers =
                statement.query_map(params![node, boot], |row| row.get(0))?.collect::<rusqlite::Result<_>>()?;
            let last = self
                .connection
                .query_row(
                    "SELECT number, grid_index FROM window WHERE node = ?1 AND boot = ?2 ORDER BY number DESC LIMIT 1",
                    params![node, boot],
                    |row| Ok((row.get(0)?, row.get(1)?)),
                )
                .optional()?;
            Ok(Some(KeptWindows { first, numbers, last }))
        };
        known().map_err(|source| self.failed(source))
    }

    /// Keeps a window; it is on the disk when this returns. A window that is kept already is left as it is.
    ///
    /// It goes to the setup that its node served when it began: a node that has moved to the next setup may still have
    /// windows of the one before. A window during which the node moved belongs to none.
    ///
    /// # Errors
    /// Where the database cannot be written; nothing of the window is kept then.
    pub fn store(
        &mut self,
        setup: &str,
        configuration: &Configuration,
        window: &NodeWindow,
        now: HostTime,
    ) -> Result<(), ArchiveError> {
        let grid =
            WindowGrid { sampling_rate_uhz: configuration.sampling_rate_uhz, hop_samples: configuration.hop_samples() };
        // Windows overlap by half.
        let span = [window.grid_index, window.grid_index.saturating_add(2)].map(|index| grid.start(index));
        let file = self.file.clone();
        let stored = self.store_in_one(setup, window, span, now);
        stored.map_err(|source| ArchiveError::Database { file, source })
    }

    fn store_in_one(
        &mut self,
        setup: &str,
        window: &NodeWindow,
        [start, end]: [HostTime; 2],
        now: HostTime,
    ) -> rusqlite::Result<()> {
        let name = window.name;
        // At once, for a reading transaction that turns to writing is refused where another program writes.
        let transaction = self.connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
        let at = |moment: HostTime| -> rusqlite::Result<Option<String>> {
            let query = "SELECT setup FROM service WHERE node = ?1 AND boot = ?2 AND since_us <= ?3
                         ORDER BY since_us DESC, id DESC LIMIT 1";
            let mut statement = transaction.prepare_cached(query)?;
            statement.query_row(params![name.node, name.boot, moment.0], |row| row.get(0)).optional()
        };
        let (began, ended) = (at(start)?, at(end)?);
        let moved = began.is_some() && began != ended;
        let served = if moved { "" } else { began.as_deref().unwrap_or(setup) };
        let grid_index = i64::try_from(window.grid_index).unwrap_or(i64::MAX);
        let new = transaction
            .prepare_cached(
                "INSERT OR IGNORE INTO window
                 (node, boot, number, setup, configuration, grid_index, start_us, middle_offset_us, drift_ppb,
                  received_us)
                 VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10)",
            )?
            .execute(params![
                name.node,
                name.boot,
                name.number,
                served,
                window.configuration_hash,
                grid_index,
                start.0,
                window.middle_offset_us,
                window.drift_ppb,
                now.0,
            ])?;
        if new > 0 {
            let id = transaction.last_insert_rowid();
            for (index, data) in window.channels.iter().enumerate() {
                store_channel(&transaction, id, index, data)?;
            }
        }
        transaction.commit()
    }
}

fn store_channel(connection: &Connection, window: i64, index: usize, data: &ChannelData) -> rusqlite::Result<()> {
    let codec::ChannelRow { state, segments, lines, densities, peaks } = codec::row(data);
    connection
        .prepare_cached(
            "INSERT INTO channel (window, channel, state, segments, lines, densities, peaks) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
        )?
        .execute(params![window, index as i64, state, segments, lines, densities, peaks])
        .map(drop)
}

#[cfg(test)]
mod tests;
