//! Writing: what nodes are asked, which setup they serve, and the windows that they send.

use belfry_shared::message::{Configuration, Summary, WindowName};
use belfry_shared::time::{HostTime, WindowGrid};
use rusqlite::types::FromSql;
use rusqlite::{Connection, ErrorCode, OptionalExtension, Transaction, TransactionBehavior, params};

use super::checksum::{Kind, seal, seal_window};
use super::loss::end_earlier_lives;
use super::{Archive, ArchiveError, codec};
use crate::window::{ChannelData, KeptWindows, NodeWindow};

impl Archive {
    /// At once, for a reading transaction that turns to writing is refused where another program writes.
    pub(super) fn writing(&mut self) -> rusqlite::Result<Transaction<'_>> {
        self.connection.transaction_with_behavior(TransactionBehavior::Immediate)
    }

    /// Writes, on a full disk after giving back what the log takes: its pages may already have room in the file itself.
    pub(super) fn write<T>(
        &mut self,
        mut write: impl FnMut(&mut Self) -> rusqlite::Result<T>,
    ) -> Result<T, ArchiveError> {
        let is_full = |error: &rusqlite::Error| error.sqlite_error_code() == Some(ErrorCode::DiskFull);
        let written = match write(self) {
            Err(error) if is_full(&error) && self.empty_log() => write(self),
            written => written,
        };
        written.map_err(|source| self.failed(source))
    }

    /// Moves what is in the log into the file, and whether all of it could be.
    pub(super) fn empty_log(&self) -> bool {
        let is_busy = self.connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |row| row.get::<_, i64>(0));
        is_busy.is_ok_and(|is_busy| is_busy == 0)
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
        self.write(|archive| {
            let transaction = archive.writing()?;
            let new = transaction.execute(
                "INSERT INTO asked (setup, node, since_us, configuration, settings, channels, checksum)
                 SELECT ?1, ?2, ?3, ?4, ?5, ?6, 0 WHERE (?4, ?6) IS NOT
                     (SELECT configuration, channels FROM asked WHERE setup = ?1 AND node = ?2 ORDER BY id DESC LIMIT 1)",
                params![setup, node, now.0, configuration.hash(), settings, channels],
            )?;
            if new > 0 {
                seal(&transaction, Kind::Asked, transaction.last_insert_rowid())?;
            }
            transaction.commit()
        })
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
        self.write(|archive| {
            let transaction = archive.writing()?;
            let new = transaction.execute(
                "INSERT INTO service (setup, node, boot, first_window, since_us, checksum)
                 SELECT ?1, ?2, ?3, ?4, ?5, 0 WHERE ?1 IS NOT
                     (SELECT setup FROM service WHERE node = ?2 AND boot = ?3 ORDER BY id DESC LIMIT 1)",
                params![setup, node, boot, first_window, now.0],
            )?;
            if new > 0 {
                seal(&transaction, Kind::Service, transaction.last_insert_rowid())?;
            }
            transaction.commit()
        })
    }

    /// Notes that a node has no windows any more of the lives that were met before this one: what has not come of them is lost.
    ///
    /// # Errors
    /// Where the database cannot be written.
    pub fn end_before(&mut self, node: u16, boot: u32, now: HostTime) -> Result<(), ArchiveError> {
        self.write(|archive| {
            let transaction = archive.writing()?;
            end_earlier_lives(&transaction, node, boot, now)?;
            transaction.commit()
        })
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
            let [lost, damaged] = self.lost_numbers(node, boot)?;
            Ok(Some(KeptWindows { first, numbers, lost, damaged, last }))
        };
        known().map_err(|source| self.failed(source))
    }

    /// When the window of a name begins, in hops since the epoch; `None` where it is not kept.
    ///
    /// # Errors
    /// Where the database cannot be read.
    pub fn start(&self, name: &WindowName) -> Result<Option<u64>, ArchiveError> {
        self.of_window(name, "grid_index")
    }

    /// A column of a window's row; `None` where it is not kept.
    pub(super) fn of_window<T: FromSql>(&self, name: &WindowName, column: &str) -> Result<Option<T>, ArchiveError> {
        let query = format!("SELECT {column} FROM window WHERE node = ?1 AND boot = ?2 AND number = ?3");
        let value = self.connection.prepare_cached(&query).and_then(|mut statement| {
            statement.query_row(params![name.node, name.boot, name.number], |row| row.get(0)).optional()
        });
        value.map_err(|source| self.failed(source))
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
        self.write(|archive| archive.store_in_one(setup, bits(configuration), window, span, now))
    }

    fn store_in_one(
        &mut self,
        setup: &str,
        bits: Option<u8>,
        window: &NodeWindow,
        [start, end]: [HostTime; 2],
        now: HostTime,
    ) -> rusqlite::Result<()> {
        let name = window.name;
        let transaction = self.writing()?;
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
        let is_sound = |data: &&ChannelData| !matches!(data, ChannelData::Unsound(_));
        let new = transaction
            .prepare_cached(
                "INSERT OR IGNORE INTO window
                 (node, boot, number, setup, configuration, grid_index, start_us, middle_offset_us, drift_ppb,
                  received_us, channels, sound, checksum)
                 VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, 0)",
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
                window.channels.len(),
                window.channels.iter().filter(is_sound).count(),
            ])?;
        if new > 0 {
            let id = transaction.last_insert_rowid();
            for (index, data) in (0..).zip(&window.channels) {
                store_channel(&transaction, id, index, &codec::row(data, bits))?;
            }
            seal_window(&transaction, id)?;
        }
        transaction.commit()
    }
}

/// Bits a component of the lines that are measured with a configuration.
pub(super) fn bits(configuration: &Configuration) -> Option<u8> {
    match configuration.summary {
        Summary::Lines { bits } => Some(bits),
        Summary::Psd { .. } => None,
    }
}

/// Writes a channel of a window.
pub(super) fn store_channel(
    connection: &Connection,
    window: i64,
    index: i64,
    row: &codec::ChannelRow,
) -> rusqlite::Result<()> {
    let codec::ChannelRow { state, segments, bits, lines, densities, peaks } = row;
    connection
        .prepare_cached(
            "INSERT INTO channel (window, channel, state, segments, bits, lines, densities, peaks)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)",
        )?
        .execute(params![window, index, state, segments, bits, lines, densities, peaks])
        .map(drop)
}
