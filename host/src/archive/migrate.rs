//! From tables of earlier versions to those of this one, in one transaction. Version 1 had no checksums and no tallies, and lines as
//! floating-point numbers; version 2 had no list of what is lost.

use std::collections::BTreeMap;

use belfry_shared::message::Configuration;
use rusqlite::{Connection, TransactionBehavior, params};

use super::checksum::{Kind, seal, seal_window};
use super::{Archive, ArchiveError, VERSION, codec, write};
use crate::window::ChannelData;

/// The tables of version 1, out of the way of those of this version. Names of indices are free then as well.
const SET_ASIDE: &str = "
    DROP INDEX service_by_life;
    DROP INDEX window_by_start;
    ALTER TABLE channel RENAME TO channel_1;
    ALTER TABLE window RENAME TO window_1;
    ALTER TABLE service RENAME TO service_1;
    ALTER TABLE asked RENAME TO asked_1;";

/// What stays as it is.
const COPY: &str = "
    INSERT INTO asked SELECT *, 0 FROM asked_1;
    INSERT INTO service SELECT *, 0 FROM service_1;
    INSERT INTO window SELECT *,
        (SELECT count(*) FROM channel_1 WHERE channel_1.window = window_1.id),
        (SELECT count(*) FROM channel_1 WHERE channel_1.window = window_1.id AND state = 'sound'), 0
    FROM window_1;";

const DROP: &str = "DROP TABLE channel_1; DROP TABLE window_1; DROP TABLE service_1; DROP TABLE asked_1;";

impl Archive {
    /// Brings its tables up to this version; where that fails they are as they were.
    pub(super) fn migrate(&mut self, found: i32) -> Result<(), ArchiveError> {
        let mut migrate = || -> rusqlite::Result<()> {
            let transaction = self.connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            // Another program may have done it meanwhile.
            let version: i32 = transaction.pragma_query_value(None, "user_version", |row| row.get(0))?;
            if version == 2 {
                transaction.execute_batch(loss_table())?;
            } else if version == 1 {
                transaction.execute_batch(SET_ASIDE)?;
                transaction.execute_batch(include_str!("schema.sql"))?;
                transaction.execute_batch(COPY)?;
                copy_channels(&transaction)?;
                transaction.execute_batch(DROP)?;
            }
            transaction.pragma_update(None, "user_version", VERSION)?;
            transaction.commit()
        };
        migrate().map_err(|why| ArchiveError::Migration { file: self.file.clone(), found, why })
    }
}

/// What version 3 has beside version 2: the last table.
fn loss_table() -> &'static str {
    let schema = include_str!("schema.sql");
    schema.find("CREATE TABLE loss").map_or("", |start| &schema[start..])
}

fn copy_channels(connection: &Connection) -> rusqlite::Result<()> {
    let ids = |table: &str| -> rusqlite::Result<Vec<i64>> {
        connection.prepare(&format!("SELECT id FROM {table} ORDER BY id"))?.query_map([], |row| row.get(0))?.collect()
    };
    for id in ids("asked")? {
        seal(connection, Kind::Asked, id)?;
    }
    for id in ids("service")? {
        seal(connection, Kind::Service, id)?;
    }
    let bits = bits_by_hash(connection)?;
    let mut windows = connection.prepare("SELECT id, configuration FROM window ORDER BY id")?;
    let mut windows = windows.query([])?;
    while let Some(window) = windows.next()? {
        let (id, hash): (i64, u32) = (window.get(0)?, window.get(1)?);
        copy_channels_of(connection, id, bits.get(&hash).copied())?;
        seal_window(connection, id)?;
    }
    Ok(())
}

/// Copies the channels of a window, whose lines were sent in `bits` a component.
fn copy_channels_of(connection: &Connection, id: i64, bits: Option<u8>) -> rusqlite::Result<()> {
    let mut channels = connection.prepare_cached(
        "SELECT channel, state, segments, NULL AS bits, lines, densities, peaks FROM channel_1 WHERE window = ?1",
    )?;
    let mut channels = channels.query(params![id])?;
    while let Some(channel) = channels.next()? {
        let mut row = codec::ChannelRow::read(channel)?;
        // What makes no sense stays as it is, and is told when it is read.
        if let (Some(bits), Ok(ChannelData::Lines(lines))) = (bits, codec::data(&row))
            && let Some(code) = codec::as_sent(&lines, bits)
        {
            (row.bits, row.lines) = (Some(bits), Some(code));
        }
        write::store_channel(connection, id, channel.get(0)?, &row)?;
    }
    Ok(())
}

/// The bits that lines were asked for in, by the hash of the settings.
fn bits_by_hash(connection: &Connection) -> rusqlite::Result<BTreeMap<u32, u8>> {
    let mut statement = connection.prepare("SELECT DISTINCT settings FROM asked")?;
    let settings: Vec<String> = statement.query_map([], |row| row.get(0))?.collect::<rusqlite::Result<_>>()?;
    let read = settings.iter().filter_map(|text| serde_json::from_str::<Configuration>(text).ok());
    Ok(read.filter_map(|configuration| Some((configuration.hash(), write::bits(&configuration)?))).collect())
}
