//! Checksums of rows, and tallies of them: a row that has changed does not match its checksum, one that is gone is missed by its tally.
//!
//! What a checksum covers stands in `schema.sql`. It is made of what SQLite reads back of a row, so that writer and reader cannot
//! differ.

use crc::{CRC_64_XZ, Crc, Digest, Table};
use rusqlite::types::ValueRef;
use rusqlite::{Connection, Row, params};

/// Sixteen tables: a window has kilobytes, an archive gigabytes.
static CRC: Crc<u64, Table<16>> = Crc::<u64, Table<16>>::new(&CRC_64_XZ);

/// The columns of a window that its checksum covers.
pub(super) const WINDOW_COLUMNS: &str = "id, node, boot, number, setup, configuration, grid_index, start_us, middle_offset_us, drift_ppb, received_us, channels, sound";
/// The columns of a window's channels that its checksum covers.
pub(super) const CHANNEL_COLUMNS: &str = "window, channel, state, segments, bits, lines, densities, peaks";
/// The columns of what was asked that its checksum covers.
pub(super) const ASKED_COLUMNS: &str = "id, setup, node, since_us, configuration, settings, channels";
/// The columns of a service that its checksum covers.
const SERVICE_COLUMNS: &str = "id, setup, node, boot, first_window, since_us";
/// The columns of a loss that its checksum covers.
const LOSS_COLUMNS: &str = "id, node, boot, first_number, last_number, reason, noted_us";

const US_PER_HOUR: i64 = 3_600_000_000;

/// The hour of Unix time that a moment is in.
pub(super) fn hour_of(start_us: i64) -> i64 {
    start_us.div_euclid(US_PER_HOUR)
}

/// The µs of Unix time at which an hour begins.
pub(super) fn hour_start_us(hour: i64) -> i64 {
    hour.saturating_mul(US_PER_HOUR)
}

/// A checksum that grows row by row.
#[derive(Clone)]
pub(super) struct Checksum(Digest<'static, u64, Table<16>>);

impl Checksum {
    pub(super) fn new() -> Self {
        Self(CRC.digest())
    }

    /// Adds the first `columns` values of a row.
    pub(super) fn add(&mut self, row: &Row<'_>, columns: &str) -> rusqlite::Result<()> {
        for index in 0..columns.split(", ").count() {
            self.add_value(row.get_ref(index)?);
        }
        Ok(())
    }

    pub(super) fn add_value(&mut self, value: ValueRef<'_>) {
        let mut put = |kind: u8, number: i64, bytes: &[u8]| {
            self.0.update(&[kind]);
            self.0.update(&number.to_le_bytes());
            self.0.update(bytes);
        };
        match value {
            ValueRef::Null => put(0, 0, &[]),
            ValueRef::Integer(number) => put(1, number, &[]),
            ValueRef::Text(text) => put(2, text.len() as i64, text),
            ValueRef::Blob(bytes) => put(3, bytes.len() as i64, bytes),
            // No column holds one; a damaged row may.
            ValueRef::Real(number) => put(4, number.to_bits() as i64, &[]),
        }
    }

    pub(super) fn value(self) -> i64 {
        self.0.finalize() as i64
    }
}

/// How many rows there are, and their checksums joined.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Tally {
    pub(super) entries: u64,
    pub(super) digest: i64,
}

impl Tally {
    pub(super) fn add(&mut self, checksum: i64) {
        self.entries += 1;
        self.digest ^= checksum;
    }
}

/// What tallies count: tables of these names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Window,
    Asked,
    Service,
    Loss,
}

impl Kind {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Window => "window",
            Self::Asked => "asked",
            Self::Service => "service",
            Self::Loss => "loss",
        }
    }

    /// The columns that a checksum of a row covers.
    pub(super) fn columns(self) -> &'static str {
        match self {
            Self::Window => WINDOW_COLUMNS,
            Self::Asked => ASKED_COLUMNS,
            Self::Service => SERVICE_COLUMNS,
            Self::Loss => LOSS_COLUMNS,
        }
    }
}

/// Adds a row to its tally.
fn count(connection: &Connection, kind: Kind, setup: &str, hour: i64, checksum: i64) -> rusqlite::Result<()> {
    connection
        .prepare_cached(
            "INSERT INTO tally (kind, setup, hour, entries, digest) VALUES (?1, ?2, ?3, 1, ?4)
             ON CONFLICT (kind, setup, hour) DO UPDATE SET entries = entries + 1,
                 digest = (digest | excluded.digest) & ~(digest & excluded.digest)",
        )?
        .execute(params![kind.name(), setup, hour, checksum])
        .map(drop)
}

/// Takes a row out of its tally, which goes with the last.
pub(super) fn uncount(
    connection: &Connection,
    kind: Kind,
    setup: &str,
    hour: i64,
    checksum: i64,
) -> rusqlite::Result<()> {
    connection
        .prepare_cached(
            "UPDATE tally SET entries = entries - 1, digest = (digest | ?4) & ~(digest & ?4)
             WHERE kind = ?1 AND setup = ?2 AND hour = ?3",
        )?
        .execute(params![kind.name(), setup, hour, checksum])?;
    connection
        .prepare_cached("DELETE FROM tally WHERE kind = ?1 AND setup = ?2 AND hour = ?3 AND entries <= 0")?
        .execute(params![kind.name(), setup, hour])
        .map(drop)
}

/// The tallies of a kind and setup, by hour.
pub(super) fn tallies(connection: &Connection, kind: Kind, setup: &str) -> rusqlite::Result<Vec<(i64, Tally)>> {
    let mut statement = connection
        .prepare_cached("SELECT hour, entries, digest FROM tally WHERE kind = ?1 AND setup = ?2 ORDER BY hour")?;
    let tally = |row: &Row<'_>| Ok((row.get(0)?, Tally { entries: row.get(1)?, digest: row.get(2)? }));
    statement.query_map(params![kind.name(), setup], tally)?.collect()
}

/// Gives a window that has just been written its checksum, and counts it.
pub(super) fn seal_window(connection: &Connection, id: i64) -> rusqlite::Result<()> {
    let mut checksum = Checksum::new();
    let (setup, start_us): (String, i64) = connection
        .prepare_cached(&format!("SELECT {WINDOW_COLUMNS} FROM window WHERE id = ?1"))?
        .query_row([id], |row| {
            checksum.add(row, WINDOW_COLUMNS)?;
            Ok((row.get("setup")?, row.get("start_us")?))
        })?;
    let query = format!("SELECT {CHANNEL_COLUMNS} FROM channel WHERE window = ?1 ORDER BY channel");
    let mut statement = connection.prepare_cached(&query)?;
    let mut rows = statement.query([id])?;
    while let Some(row) = rows.next()? {
        checksum.add(row, CHANNEL_COLUMNS)?;
    }
    let checksum = checksum.value();
    connection.prepare_cached("UPDATE window SET checksum = ?2 WHERE id = ?1")?.execute([id, checksum])?;
    count(connection, Kind::Window, &setup, hour_of(start_us), checksum)
}

/// The same of a row of another table.
pub(super) fn seal(connection: &Connection, kind: Kind, id: i64) -> rusqlite::Result<()> {
    let (table, columns) = (kind.name(), kind.columns());
    let mut checksum = Checksum::new();
    let setup: String =
        connection.prepare_cached(&format!("SELECT {columns} FROM {table} WHERE id = ?1"))?.query_row([id], |row| {
            checksum.add(row, columns)?;
            if kind == Kind::Asked { row.get("setup") } else { Ok(String::new()) }
        })?;
    let checksum = checksum.value();
    connection.prepare_cached(&format!("UPDATE {table} SET checksum = ?2 WHERE id = ?1"))?.execute([id, checksum])?;
    count(connection, kind, &setup, 0, checksum)
}
