//! What is lost: windows that no longer exist anywhere, each run of numbers with its reason.
//!
//! What a node has dropped is listed as soon as the host hears of it. What a node still held when it started anew is listed when a later life
//! of it is met and has nothing of the earlier one (a node with a store delivers that first): it is all that was wanted of the earlier one and
//! is neither stored nor listed, and whatever came behind.

use belfry_shared::message::WindowName;
use belfry_shared::time::HostTime;
use rusqlite::{Connection, Row, params};
use serde::Serialize;

use super::checksum::{Kind, seal};
use super::{Archive, ArchiveError};
use crate::window::{Loss, LossReason};

/// A loss as it is listed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ListedLoss {
    /// What is lost, and why.
    #[serde(flatten)]
    pub loss: Loss,
    /// When it was noted, in s of Unix time.
    pub noted_s: f64,
    /// How many of these windows have come all the same.
    pub came: u64,
}

impl ListedLoss {
    /// How many windows it comes to, where that is known.
    pub fn windows(&self) -> Option<u64> {
        self.loss.windows().map(|windows| windows.saturating_sub(self.came))
    }
}

impl Archive {
    /// Lists windows as lost; nothing where all of them are listed already.
    ///
    /// # Errors
    /// Where the database cannot be written.
    pub fn lose(&mut self, loss: &Loss, now: HostTime) -> Result<(), ArchiveError> {
        self.write(|archive| {
            let transaction = archive.writing()?;
            list(&transaction, loss, now)?;
            transaction.commit()
        })
    }

    /// All that is listed as lost, in the order in which it was noted. A window that has come all the same is not lost.
    ///
    /// # Errors
    /// Where the database cannot be read.
    pub fn losses(&self) -> Result<Vec<ListedLoss>, ArchiveError> {
        let read = || -> rusqlite::Result<Vec<ListedLoss>> {
            let query = "SELECT node, boot, first_number, last_number, reason, noted_us,
                         (SELECT count(*) FROM window WHERE (window.node, window.boot) = (loss.node, loss.boot)
                          AND number >= first_number AND (last_number IS NULL OR number <= last_number))
                         FROM loss ORDER BY noted_us, id";
            let mut statement = self.connection.prepare(query)?;
            let listed = |row: &Row<'_>| -> rusqlite::Result<Option<ListedLoss>> {
                let reason: String = row.get(4)?;
                let Some(reason) = LossReason::ALL.into_iter().find(|known| known.name() == reason) else {
                    return Ok(None);
                };
                let (node, boot, first, last) = (row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?);
                let loss = Loss { node, boot, first, last, reason };
                Ok(Some(ListedLoss { loss, noted_s: row.get::<_, i64>(5)? as f64 * 1e-6, came: row.get(6)? }))
            };
            statement.query_map([], listed)?.filter_map(Result::transpose).collect()
        };
        read().map_err(|source| self.failed(source))
    }

    /// First and last numbers of what a life has lost while it lasted.
    pub(super) fn lost_numbers(&self, node: u16, boot: u32) -> rusqlite::Result<Vec<[u32; 2]>> {
        // Should a life come back that was taken for over, it may have what was listed when its successor was met.
        let query = "SELECT first_number, last_number FROM loss
                     WHERE node = ?1 AND boot = ?2 AND last_number IS NOT NULL AND reason <> 'restarted'";
        let mut statement = self.connection.prepare_cached(query)?;
        statement.query_map(params![node, boot], |row| Ok([row.get(0)?, row.get(1)?]))?.collect()
    }
}

/// Lists windows that a repair could not save, by names that were read from damaged rows: only those that lie between others of their life and
/// are not there count, for the name may be what is damaged.
pub(super) fn list_damaged(connection: &Connection, names: &[WindowName], now: HostTime) -> rusqlite::Result<()> {
    let query = "SELECT ifnull(min(number) < ?3 AND max(number) > ?3 AND max(number = ?3) = 0, 0) FROM window
                 WHERE node = ?1 AND boot = ?2";
    for &WindowName { node, boot, number } in names {
        let is_missing =
            connection.prepare_cached(query)?.query_row(params![node, boot, number], |row| row.get::<_, bool>(0))?;
        if is_missing {
            let loss = Loss { node, boot, first: number, last: Some(number), reason: LossReason::Damaged };
            list(connection, &loss, now)?;
        }
    }
    Ok(())
}

/// Lists a loss, unless all of it is listed.
fn list(connection: &Connection, loss: &Loss, now: HostTime) -> rusqlite::Result<()> {
    let Loss { node, boot, first, last, reason } = loss;
    let new = connection
        .prepare_cached(
            "INSERT INTO loss (node, boot, first_number, last_number, reason, noted_us, checksum)
             SELECT ?1, ?2, ?3, ?4, ?5, ?6, 0 WHERE NOT EXISTS (
                 SELECT 1 FROM loss WHERE node = ?1 AND boot = ?2 AND first_number <= ?3
                     AND (last_number IS NULL OR last_number >= ?4))",
        )?
        .execute(params![node, boot, first, last, reason.name(), now.0])?;
    if new > 0 {
        seal(connection, Kind::Loss, connection.last_insert_rowid())?;
    }
    Ok(())
}

/// Lists what has not come of the lives of a node that were met before this one, and have not been ended yet.
pub(super) fn end_earlier_lives(connection: &Connection, node: u16, boot: u32, now: HostTime) -> rusqlite::Result<()> {
    let lives: Vec<(u32, u32)> = connection
        .prepare_cached(
            "SELECT boot, min(first_window) FROM service WHERE node = ?1 AND boot <> ?2 AND boot NOT IN (
                 SELECT boot FROM loss WHERE node = ?1 AND last_number IS NULL)
             GROUP BY boot HAVING min(id) < (SELECT min(id) FROM service WHERE node = ?1 AND boot = ?2)",
        )?
        .query_map(params![node, boot], |row| Ok((row.get(0)?, row.get(1)?)))?
        .collect::<rusqlite::Result<_>>()?;
    for (boot, first_window) in lives {
        end_life(connection, node, boot, first_window, now)?;
    }
    Ok(())
}

/// Lists all of a life that is neither stored nor listed, and what came behind.
fn end_life(connection: &Connection, node: u16, boot: u32, first_window: u32, now: HostTime) -> rusqlite::Result<()> {
    let query = "SELECT number, number FROM window WHERE node = ?1 AND boot = ?2 AND number >= ?3
                 UNION ALL SELECT first_number, last_number FROM loss
                     WHERE node = ?1 AND boot = ?2 AND last_number IS NOT NULL AND last_number >= ?3
                 ORDER BY 1";
    let mut next = first_window;
    let mut gaps = Vec::new();
    {
        let mut statement = connection.prepare_cached(query)?;
        let mut known = statement.query(params![node, boot, first_window])?;
        while let Some(row) = known.next()? {
            let (first, last): (u32, u32) = (row.get(0)?, row.get(1)?);
            if first > next {
                gaps.push((next, Some(first - 1)));
            }
            next = next.max(last.saturating_add(1));
        }
    }
    for (first, last) in gaps.into_iter().chain([(next, None)]) {
        list(connection, &Loss { node, boot, first, last, reason: LossReason::Restarted }, now)?;
    }
    Ok(())
}
