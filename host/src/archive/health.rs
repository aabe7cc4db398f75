//! How nodes have served: what came of them, what is lost, and when they started anew.

use serde::Serialize;

use super::{Archive, ArchiveError};
use crate::watch::WindowHead;

/// How a node has served a setup.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NodeHealth {
    /// The node.
    pub node: u16,
    /// The setup.
    pub setup: String,
    /// Channels that its newest windows have.
    pub channels: usize,
    /// Windows that have come.
    pub windows: u64,
    /// Windows that its numbers say were made, and have not come.
    pub lost_windows: u64,
    /// Windows of which a channel is not sound.
    pub bad_windows: u64,
    /// Times that it has started anew, seen from its windows.
    pub restarts: u64,
    /// When the last window came, in s of Unix time.
    pub last_received_s: f64,
}

impl Archive {
    /// The heads of the newest windows of a node, `most` at most, the newest first.
    ///
    /// # Errors
    /// Where the archive cannot be read.
    pub fn newest_heads(&self, setup: &str, node: u16, most: usize) -> Result<Vec<WindowHead>, ArchiveError> {
        // By the index: a setup's windows are read from the newest on until there are enough of the node's.
        const QUERY: &str = "
            SELECT start_us, received_us, middle_offset_us, drift_ppb FROM window
            WHERE setup = ?1 AND node = ?2 ORDER BY start_us DESC LIMIT ?3";
        let read = || -> rusqlite::Result<Vec<WindowHead>> {
            let mut statement = self.connection.prepare(QUERY)?;
            let heads = statement.query_map((setup, node, most as i64), |row| {
                let (start_us, received_us): (i64, i64) = (row.get(0)?, row.get(1)?);
                Ok(WindowHead {
                    time_s: start_us.max(received_us) as f64 * 1e-6,
                    start_s: start_us as f64 * 1e-6,
                    middle_offset_s: f64::from(row.get::<_, i32>(2)?) * 1e-6,
                    drift_ppm: f64::from(row.get::<_, i32>(3)?) * 1e-3,
                })
            })?;
            heads.collect()
        };
        read().map_err(|source| self.failed(source))
    }

    /// How every node has served every setup so far.
    ///
    /// # Errors
    /// Where the archive cannot be read.
    pub fn health(&self) -> Result<Vec<NodeHealth>, ArchiveError> {
        const QUERY: &str = "
            WITH life AS (
                SELECT setup, node, boot, count(*) AS windows, max(number) - min(number) + 1 AS made, max(received_us) AS last,
                    sum(sound < channels) AS bad, max(channels) AS channels
                FROM window WHERE setup <> '' GROUP BY setup, node, boot)
            SELECT node, setup, max(channels), sum(windows), sum(made - windows), sum(bad), count(*) - 1, max(last)
            FROM life GROUP BY setup, node ORDER BY setup, node";
        let read = || -> rusqlite::Result<Vec<NodeHealth>> {
            let mut statement = self.connection.prepare(QUERY)?;
            let health = statement.query_map([], |row| {
                Ok(NodeHealth {
                    node: row.get(0)?,
                    setup: row.get(1)?,
                    channels: row.get(2)?,
                    windows: row.get(3)?,
                    lost_windows: row.get(4)?,
                    bad_windows: row.get(5)?,
                    restarts: row.get(6)?,
                    last_received_s: row.get::<_, i64>(7)? as f64 * 1e-6,
                })
            })?;
            health.collect()
        };
        read().map_err(|source| self.failed(source))
    }
}
