//! Pruning: windows that are older than what is to be kept are dropped, an hour at a time, so that nodes may go on delivering.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use belfry_shared::time::HostTime;
use rusqlite::{Connection, OptionalExtension, TransactionBehavior, params};
use serde::Serialize;

use super::checksum::{Kind, hour_of, hour_start_us, seal, uncount};
use super::loss::unlist;
use super::range::moment;
use super::{Archive, ArchiveError};
use crate::patience::patiently;

/// How long pruning is tried again.
const LONGEST_WAIT: Duration = Duration::from_secs(300);

/// What is dropped of a node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PrunedNode {
    /// The setup.
    pub setup: String,
    /// The node.
    pub node: u16,
    /// Its windows that are dropped.
    pub windows: u64,
    /// When the first of them began.
    pub first: String,
    /// And the last.
    pub last: String,
}

/// What pruning drops.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PruneReport {
    /// What began before this is dropped; none where there is no window.
    pub before: Option<String>,
    /// What is dropped, by setup and node.
    pub nodes: Vec<PrunedNode>,
    /// Windows that stay.
    pub kept_windows: u64,
    /// µs of Unix time of `before`.
    #[serde(skip)]
    before_us: i64,
}

impl PruneReport {
    /// What began before this is dropped.
    pub fn before(&self) -> HostTime {
        HostTime(self.before_us)
    }

    /// Windows that are dropped.
    pub fn windows(&self) -> u64 {
        self.nodes.iter().map(|node| node.windows).sum()
    }
}

impl Archive {
    /// What [`Archive::prune`] would drop to keep so much: counted back from the newest window, so that an archive that nobody collects
    /// into stays as it is. A window that is dated later than `now` does not count as the newest.
    ///
    /// # Errors
    /// Where the archive cannot be read.
    pub fn prunable(&self, keep: Duration, now: HostTime) -> Result<PruneReport, ArchiveError> {
        let read = || -> rusqlite::Result<PruneReport> {
            let newest: Option<i64> =
                self.connection
                    .query_row("SELECT max(start_us) FROM window WHERE start_us <= ?1", [now.0], |row| row.get(0))?;
            let keep_us = i64::try_from(keep.as_micros()).unwrap_or(i64::MAX);
            let before_us = newest.map_or(i64::MIN, |newest| newest.saturating_sub(keep_us));
            let mut statement = self.connection.prepare(
                "SELECT setup, node, count(*), min(start_us), max(start_us) FROM window WHERE start_us < ?1
                 GROUP BY setup, node ORDER BY setup, node",
            )?;
            let node = |row: &rusqlite::Row<'_>| {
                let (first, last) = (moment(row.get(3)?), moment(row.get(4)?));
                Ok(PrunedNode { setup: row.get(0)?, node: row.get(1)?, windows: row.get(2)?, first, last })
            };
            let nodes: Vec<PrunedNode> = statement.query_map([before_us], node)?.collect::<rusqlite::Result<_>>()?;
            let all: u64 = self.connection.query_row("SELECT count(*) FROM window", [], |row| row.get(0))?;
            let dropped: u64 = nodes.iter().map(|node| node.windows).sum();
            Ok(PruneReport { before: newest.map(|_| moment(before_us)), nodes, kept_windows: all - dropped, before_us })
        };
        read().map_err(|source| self.failed(source))
    }

    /// Drops what [`Archive::prunable`] has found, and gives its room back.
    ///
    /// # Errors
    /// Where the archive cannot be written; what was dropped before that is gone.
    pub fn prune(&mut self, found: &PruneReport) -> Result<(), ArchiveError> {
        let mut prune = || -> rusqlite::Result<()> {
            for setup in self.setups()? {
                while self.prune_hour(&setup, found.before_us)? {}
            }
            // Windows of whole hours before that may be gone by damage; nobody misses them any more.
            self.connection.execute(
                "DELETE FROM tally WHERE kind IN ('window', 'damaged') AND hour < ?1",
                [hour_of(found.before_us)],
            )?;
            // Where pages are given back at all: an archive that was begun by an earlier version keeps them for new windows.
            let mut vacuum = self.connection.prepare("PRAGMA incremental_vacuum")?;
            let mut rows = vacuum.query([])?;
            while rows.next()?.is_some() {}
            drop(rows);
            drop(vacuum);
            // As far as nobody reads.
            let _ = self.connection.pragma_update_and_check(None, "wal_checkpoint", "truncate", |_| Ok(()));
            Ok(())
        };
        prune().map_err(|source| self.failed(source))
    }

    /// The same, again and again while another program writes or the disk is full; `on_wait` gets the first reason. What is dropped makes room for
    /// the rest.
    ///
    /// # Errors
    /// As [`Archive::prune`], where that does not pass for minutes.
    pub fn prune_patiently(
        &mut self,
        found: &PruneReport,
        on_wait: &mut dyn FnMut(&ArchiveError),
    ) -> Result<(), ArchiveError> {
        let start = Instant::now();
        let prune = || {
            let pruned = self.prune(found);
            if pruned.is_err() {
                // Where the disk is full, the log may give back what it takes.
                self.empty_log();
            }
            pruned
        };
        let passes = |error: &ArchiveError| error.will_pass() && start.elapsed() < LONGEST_WAIT;
        patiently(prune, passes, on_wait, || false).map(drop)
    }

    /// Drops what a setup has before a moment in the first hour of which it has anything; `false` where there is nothing.
    fn prune_hour(&mut self, setup: &str, before_us: i64) -> rusqlite::Result<bool> {
        let transaction = self.connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
        let first: Option<i64> = transaction
            .query_row("SELECT min(start_us) FROM window WHERE setup = ?1", [setup], |row| row.get(0))
            .optional()?
            .flatten();
        let Some(first) = first.filter(|&first| first < before_us) else { return Ok(false) };
        let hour = hour_of(first);
        let end_us = before_us.min(hour_start_us(hour.saturating_add(1)));
        let mut lives: BTreeMap<(u16, u32), Vec<u32>> = BTreeMap::new();
        let rows: Vec<(i64, i64, u16, u32, u32)> = transaction
            .prepare_cached("SELECT id, checksum, node, boot, number FROM window WHERE setup = ?1 AND start_us < ?2")?
            .query_map(params![setup, end_us], |row| {
                Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?, row.get(4)?))
            })?
            .collect::<rusqlite::Result<_>>()?;
        for (id, checksum, node, boot, number) in rows {
            transaction.prepare_cached("DELETE FROM channel WHERE window = ?1")?.execute([id])?;
            transaction.prepare_cached("DELETE FROM window WHERE id = ?1")?.execute([id])?;
            uncount(&transaction, Kind::Window, setup, hour, checksum)?;
            lives.entry((node, boot)).or_default().push(number);
        }
        for ((node, boot), dropped) in lives {
            unlist(&transaction, node, boot, &dropped)?;
            let next = dropped.into_iter().max().map_or(0, |last| last.saturating_add(1));
            want_from(&transaction, node, boot, next)?;
        }
        transaction.commit()?;
        Ok(true)
    }
}

/// Has the windows of a life wanted from this one on only: those before it have been dropped, and are not lost.
fn want_from(connection: &Connection, node: u16, boot: u32, next: u32) -> rusqlite::Result<()> {
    let rows: Vec<(i64, i64)> = connection
        .prepare_cached("SELECT id, checksum FROM service WHERE node = ?1 AND boot = ?2 AND first_window < ?3")?
        .query_map(params![node, boot, next], |row| Ok((row.get(0)?, row.get(1)?)))?
        .collect::<rusqlite::Result<_>>()?;
    for (id, checksum) in rows {
        uncount(connection, Kind::Service, "", 0, checksum)?;
        connection.prepare_cached("UPDATE service SET first_window = ?2 WHERE id = ?1")?.execute(params![id, next])?;
        seal(connection, Kind::Service, id)?;
    }
    Ok(())
}
