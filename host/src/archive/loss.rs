//! What is lost: windows that no longer exist anywhere, each run of numbers with its reason.
//!
//! What a node has dropped is listed as soon as the host hears of it. What a node still held when it started anew is listed when a later life
//! of it is met and has nothing of the earlier one (a node with a store delivers that first): it is all that was wanted of the earlier one and
//! is neither stored nor listed, and whatever came behind.

use belfry_shared::time::HostTime;
use rusqlite::{Connection, Row, params};
use serde::Serialize;

use super::checksum::{Kind, hour_start_us, seal, uncount};
use super::{Archive, ArchiveError};
use crate::window::{Loss, LossReason, without};

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

/// Windows that repairs could not save, of an hour of a setup. Of those whose numbers are known, the losses tell them as well.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DamagedHour {
    /// The setup.
    pub setup: String,
    /// Where the hour in which they began itself begins, in s of Unix time.
    pub start_s: f64,
    /// The same in hours of Unix time.
    #[serde(skip)]
    pub(super) hour: i64,
    /// How many.
    pub windows: u64,
}

impl Archive {
    /// What repairs could not save, hour by hour.
    pub(super) fn damaged_hours(&self) -> rusqlite::Result<Vec<DamagedHour>> {
        let query = "SELECT setup, hour, entries FROM tally WHERE kind = 'damaged' ORDER BY setup, hour";
        let mut statement = self.connection.prepare(query)?;
        let hour = |row: &Row<'_>| {
            let hour = row.get(1)?;
            let start_s = hour_start_us(hour) as f64 * 1e-6;
            Ok(DamagedHour { setup: row.get(0)?, start_s, hour, windows: row.get(2)? })
        };
        statement.query_map([], hour)?.collect()
    }

    /// Lists windows as lost, as far as they are not listed already.
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

    /// First and last numbers of what a life has lost while it lasted, and of what a damaged archive no longer had of it.
    pub(super) fn lost_numbers(&self, node: u16, boot: u32) -> rusqlite::Result<[Vec<[u32; 2]>; 2]> {
        // Should a life come back that was taken for over, it may have what was listed when its successor was met.
        let query = "SELECT first_number, last_number, reason = 'damaged' FROM loss
                     WHERE node = ?1 AND boot = ?2 AND last_number IS NOT NULL AND reason <> 'restarted'";
        let (mut lost, mut damaged) = (Vec::new(), Vec::new());
        let mut statement = self.connection.prepare_cached(query)?;
        let mut rows = statement.query(params![node, boot])?;
        while let Some(row) = rows.next()? {
            let numbers = if row.get(2)? { &mut damaged } else { &mut lost };
            numbers.push([row.get(0)?, row.get(1)?]);
        }
        Ok([lost, damaged])
    }
}

/// Keeps how many windows of an hour a repair could not save.
pub(super) fn remember(connection: &Connection, setup: &str, hour: i64, windows: u64) -> rusqlite::Result<()> {
    if windows == 0 {
        return Ok(());
    }
    connection
        .prepare_cached(
            "INSERT INTO tally (kind, setup, hour, entries, digest) VALUES ('damaged', ?1, ?2, ?3, 0)
             ON CONFLICT (kind, setup, hour) DO UPDATE SET entries = entries + excluded.entries",
        )?
        .execute(params![setup, hour, windows])
        .map(drop)
}

/// Lists what a repair could not save: of a life that is over, all that should be there; of another, all below its last window. Its node may still
/// have some of it, which is not lost when it comes.
pub(super) fn list_damaged(connection: &Connection, now: HostTime) -> rusqlite::Result<()> {
    let lives: Vec<(u16, u32, u32, Option<u32>)> = connection
        .prepare(
            "SELECT node, boot, min(first_window),
                 ifnull((SELECT min(first_number) FROM loss
                         WHERE (loss.node, loss.boot) = (service.node, service.boot) AND last_number IS NULL),
                        (SELECT max(number) FROM window WHERE (window.node, window.boot) = (service.node, service.boot)))
             FROM service GROUP BY node, boot",
        )?
        .query_map([], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?)))?
        .collect::<rusqlite::Result<_>>()?;
    for (node, boot, first_window, end) in lives {
        let Some(end) = end else { continue };
        for [first, last] in missing(connection, node, boot, [first_window, end])? {
            insert(connection, &Loss { node, boot, first, last: Some(last), reason: LossReason::Damaged }, now)?;
        }
    }
    Ok(())
}

/// Lists a loss, as far as it is not listed.
fn list(connection: &Connection, loss: &Loss, now: HostTime) -> rusqlite::Result<()> {
    let &Loss { node, boot, first, last, .. } = loss;
    let listed: Vec<[u32; 2]> = connection
        .prepare_cached("SELECT first_number, ifnull(last_number, ?3) FROM loss WHERE node = ?1 AND boot = ?2")?
        .query_map(params![node, boot, u32::MAX], |row| Ok([row.get(0)?, row.get(1)?]))?
        .collect::<rusqlite::Result<_>>()?;
    for [first, until] in without([first, last.unwrap_or(u32::MAX)], &listed) {
        // No life makes so many: what reaches so far has no end that is known.
        let last = Some(until).filter(|&until| until < u32::MAX).or(last);
        insert(connection, &Loss { first, last, ..*loss }, now)?;
    }
    Ok(())
}

/// Lists a loss of which nothing is listed.
fn insert(connection: &Connection, loss: &Loss, now: HostTime) -> rusqlite::Result<()> {
    let Loss { node, boot, first, last, reason } = loss;
    connection
        .prepare_cached(
            "INSERT INTO loss (node, boot, first_number, last_number, reason, noted_us, checksum)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, 0)",
        )?
        .execute(params![node, boot, first, last, reason.name(), now.0])?;
    seal(connection, Kind::Loss, connection.last_insert_rowid())
}

/// Takes windows of a life out of the lists: they have come all the same, and are dropped now.
pub(super) fn unlist(connection: &Connection, node: u16, boot: u32, numbers: &[u32]) -> rusqlite::Result<()> {
    type Row = (i64, i64, u32, u32, String, i64);
    let rows: Vec<Row> = connection
        .prepare_cached(
            "SELECT id, checksum, first_number, last_number, reason, noted_us FROM loss
             WHERE node = ?1 AND boot = ?2 AND last_number IS NOT NULL",
        )?
        .query_map(params![node, boot], |row| {
            Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?, row.get(4)?, row.get(5)?))
        })?
        .collect::<rusqlite::Result<_>>()?;
    let numbers: Vec<[u32; 2]> = numbers.iter().map(|&number| [number, number]).collect();
    for (id, checksum, first, last, reason, noted_us) in rows {
        let left = without([first, last], &numbers);
        if left == [[first, last]] {
            continue;
        }
        uncount(connection, Kind::Loss, "", 0, checksum)?;
        connection.prepare_cached("DELETE FROM loss WHERE id = ?1")?.execute([id])?;
        let Some(reason) = LossReason::ALL.into_iter().find(|known| known.name() == reason) else { continue };
        for [first, last] in left {
            insert(connection, &Loss { node, boot, first, last: Some(last), reason }, HostTime(noted_us))?;
        }
    }
    Ok(())
}

/// What of a life is neither stored nor listed as lost, from one number up to and without another.
fn missing(connection: &Connection, node: u16, boot: u32, [first, end]: [u32; 2]) -> rusqlite::Result<Vec<[u32; 2]>> {
    let query = "SELECT number, number FROM window WHERE node = ?1 AND boot = ?2 AND number >= ?3 AND number < ?4
                 UNION ALL SELECT first_number, last_number FROM loss
                     WHERE node = ?1 AND boot = ?2 AND last_number IS NOT NULL AND last_number >= ?3
                 ORDER BY 1";
    let mut next = first;
    let mut gaps = Vec::new();
    let mut statement = connection.prepare_cached(query)?;
    let mut known = statement.query(params![node, boot, first, end])?;
    while let Some(row) = known.next()? {
        let (first, last): (u32, u32) = (row.get(0)?, row.get(1)?);
        if first > next && next < end {
            gaps.push([next, first.min(end) - 1]);
        }
        next = next.max(last.saturating_add(1));
    }
    if next < end {
        gaps.push([next, end - 1]);
    }
    Ok(gaps)
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
    let query = "SELECT max(?3,
                     (SELECT ifnull(max(number) + 1, 0) FROM window WHERE node = ?1 AND boot = ?2),
                     (SELECT ifnull(max(last_number) + 1, 0) FROM loss WHERE node = ?1 AND boot = ?2))";
    let end: i64 = connection.prepare_cached(query)?.query_row(params![node, boot, first_window], |row| row.get(0))?;
    let end = u32::try_from(end).unwrap_or(u32::MAX);
    let gaps =
        missing(connection, node, boot, [first_window, end])?.into_iter().map(|[first, last]| (first, Some(last)));
    for (first, last) in gaps.chain([(end, None)]) {
        insert(connection, &Loss { node, boot, first, last, reason: LossReason::Restarted }, now)?;
    }
    Ok(())
}
