//! Reading: what a setup's nodes have sent, and its windows in the order of the grid.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use belfry_shared::message::{Configuration, WindowName};
use belfry_shared::time::WindowGrid;
use rusqlite::params;
use serde::Serialize;

use super::codec::{self, ChannelRow};
use super::{Archive, ArchiveError};
use crate::spectra::{LineGrid, WindowLines};
use crate::study::Setup;
use crate::window::{ChannelData, NodeWindow, channels_by_node, node_lines, place_lines};

/// Newest windows that may still lack a node whose turn to send has not come.
const UNSETTLED: usize = 2;

/// What the archive holds of a setup.
#[derive(Debug, Clone, PartialEq)]
pub struct CollectedSetup {
    /// The lines that its windows carry.
    pub grid: LineGrid,
    /// Raw samples a decimated one.
    pub decimation: u32,
    /// Starts at which at least one node has a window.
    pub windows: usize,
    /// First start, in hops since the Unix epoch; windows are counted from there.
    pub first_grid_index: u64,
    /// The same in s of Unix time.
    pub start_s: f64,
    /// Node windows that were measured with other lines, or averaged on the node, and are left out.
    pub other_windows: usize,
    /// Hashes of the configurations that make these lines.
    hashes: BTreeSet<u32>,
}

/// A setup's windows, and the archive that they are in.
#[derive(Debug)]
pub struct Collected {
    /// What there is of them.
    pub setup: CollectedSetup,
    archive: Archive,
}

impl Archive {
    /// What there is of a setup: windows with the settings that were asked of its nodes last, as far as there are any.
    /// `None` where there are no windows.
    ///
    /// # Errors
    /// Where the archive cannot be read.
    pub fn collected(self, setup: &Setup) -> Result<Option<Collected>, ArchiveError> {
        // What is counted now is what is read later, whatever comes in between.
        self.connection.execute_batch("BEGIN").map_err(|source| self.failed(source))?;
        let counted = || -> rusqlite::Result<BTreeMap<u32, usize>> {
            let query = "SELECT configuration, count(*) FROM window WHERE setup = ?1 GROUP BY configuration";
            let mut statement = self.connection.prepare(query)?;
            statement.query_map([&setup.name], |row| Ok((row.get(0)?, row.get(1)?)))?.collect()
        };
        let counts = counted().map_err(|source| self.failed(source))?;
        let configurations = self.configurations(Some(&setup.name))?;
        let with_windows = |configuration: &&Configuration| counts.contains_key(&configuration.hash());
        let newest = configurations.iter().filter(with_windows).find_map(|c| node_lines(c).map(|s| (s, c.clone())));
        let Some((wanted, configuration)) = newest else { return Ok(None) };
        let hashes: BTreeSet<u32> =
            configurations.iter().filter(|c| node_lines(c) == Some(wanted)).map(Configuration::hash).collect();
        let other_windows = counts.iter().filter(|(hash, _)| !hashes.contains(hash)).map(|(_, windows)| windows).sum();
        let (windows, first) = self
            .connection
            .query_row(
                "SELECT count(DISTINCT grid_index), min(grid_index) FROM window
                 WHERE setup = ?1 AND configuration IN (SELECT value FROM json_each(?2))",
                params![setup.name, json(&hashes)],
                |row| Ok((row.get::<_, usize>(0)?, row.get::<_, Option<u64>>(1)?)),
            )
            .map_err(|source| self.failed(source))?;
        let Some(first_grid_index) = first else { return Ok(None) };
        let clock =
            WindowGrid { sampling_rate_uhz: configuration.sampling_rate_uhz, hop_samples: configuration.hop_samples() };
        let (grid, decimation) = wanted;
        let start_s = clock.start(first_grid_index).0 as f64 * 1e-6;
        let collected = CollectedSetup { grid, decimation, windows, first_grid_index, start_s, other_windows, hashes };
        Ok(Some(Collected { setup: collected, archive: self }))
    }
}

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
    /// How every node has served every setup so far.
    ///
    /// # Errors
    /// Where the archive cannot be read.
    pub fn health(&self) -> Result<Vec<NodeHealth>, ArchiveError> {
        const QUERY: &str = "
            WITH life AS (
                SELECT setup, node, boot, count(*) AS windows, max(number) - min(number) + 1 AS made, max(received_us) AS last,
                    sum(EXISTS (SELECT 1 FROM channel WHERE channel.window = window.id AND state <> 'sound')) AS bad,
                    max((SELECT count(*) FROM channel WHERE channel.window = window.id)) AS channels
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

fn json(hashes: &BTreeSet<u32>) -> String {
    format!("{hashes:?}").replace('{', "[").replace('}', "]")
}

impl Collected {
    /// Hands out the windows of the whole setup in the order of the grid, counted from the first; `None` where a node has
    /// none. The newest are left out while nodes are still to send theirs.
    ///
    /// # Errors
    /// Where the archive cannot be read or is damaged; windows before that have been handed out.
    pub fn each_window(&self, setup: &Setup, on_window: &mut dyn FnMut(WindowLines)) -> Result<(), ArchiveError> {
        let nodes_expected = channels_by_node(setup).len();
        let columns = self.columns(setup)?;
        let failed = |source| self.archive.failed(source);
        let mut statement = self
            .archive
            .connection
            .prepare(
                "SELECT id, node, boot, number, configuration, grid_index, middle_offset_us, drift_ppb,
                     start_us FROM window
                 WHERE setup = ?1 AND configuration IN (SELECT value FROM json_each(?2)) ORDER BY grid_index, node, id",
            )
            .map_err(failed)?;
        let mut rows = statement.query(params![setup.name, json(&self.setup.hashes)]).map_err(failed)?;
        // Starts whose nodes may not have sent all yet, oldest first.
        let mut waiting: VecDeque<(WindowLines, BTreeSet<u16>)> = VecDeque::new();
        while let Some(row) = rows.next().map_err(failed)? {
            let (id, window) = read_window(row).map_err(failed)?;
            let start_us: i64 = row.get(8).map_err(failed)?;
            let Some(channels) = columns.of(&window, start_us) else { continue };
            let grid_index = window.grid_index.saturating_sub(self.setup.first_grid_index);
            if waiting.back().is_none_or(|(last, _)| last.grid_index != grid_index) {
                if waiting.len() > UNSETTLED
                    && let Some((settled, _)) = waiting.pop_front()
                {
                    on_window(settled);
                }
                let channels = vec![None; setup.sensors.len()];
                waiting.push_back((WindowLines { grid_index, channels }, BTreeSet::new()));
            }
            let Some((whole, nodes)) = waiting.back_mut() else { continue };
            // A node that started anew may have measured the same interval twice; the first stays.
            if nodes.insert(window.name.node) {
                let window = NodeWindow { channels: self.channels(id, &window)?, ..window };
                place_lines(&self.setup.grid, window, channels, whole);
            }
        }
        let is_whole = |(_, nodes): &(WindowLines, BTreeSet<u16>)| nodes.len() >= nodes_expected;
        let unsettled = waiting.iter().rev().take_while(|start| !is_whole(start)).count().min(UNSETTLED);
        waiting.truncate(waiting.len() - unsettled);
        waiting.into_iter().for_each(|(whole, _)| on_window(whole));
        Ok(())
    }

    /// Which of the setup's channels a node's are, by what each node was asked.
    fn columns(&self, setup: &Setup) -> Result<ChannelColumns, ArchiveError> {
        let rows = || -> rusqlite::Result<Vec<(u16, u32, i64, String)>> {
            let query = "SELECT node, configuration, since_us, channels FROM asked WHERE setup = ?1 ORDER BY id";
            let mut statement = self.archive.connection.prepare(query)?;
            let row = |row: &rusqlite::Row<'_>| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?));
            statement.query_map([&setup.name], row)?.collect()
        };
        let mut columns = ChannelColumns::default();
        for (node, hash, since_us, names) in rows().map_err(|source| self.archive.failed(source))? {
            let names: Vec<String> = serde_json::from_str(&names)
                .map_err(|error| self.archive.damaged(format!("channels of node {node}: {error}")))?;
            let column = |name: &String| setup.sensors.iter().position(|sensor| sensor.channel == *name);
            // A channel that the study no longer has is none of them.
            let channels: Vec<usize> = names.iter().map(|name| column(name).unwrap_or(usize::MAX)).collect();
            if channels.iter().any(|&channel| channel < usize::MAX) {
                columns.0.entry((node, hash)).or_default().push((since_us, channels));
            }
        }
        Ok(columns)
    }

    fn channels(&self, id: i64, window: &NodeWindow) -> Result<Vec<ChannelData>, ArchiveError> {
        let rows = || -> rusqlite::Result<Vec<ChannelRow>> {
            let query = format!("SELECT {} FROM channel WHERE window = ?1 ORDER BY channel", ChannelRow::COLUMNS);
            let mut statement = self.archive.connection.prepare_cached(&query)?;
            statement.query_map([id], ChannelRow::read)?.collect()
        };
        let rows = rows().map_err(|source| self.archive.failed(source))?;
        let of = |what: String| {
            let WindowName { node, boot, number } = window.name;
            self.archive.damaged(format!("window {number} of node {node} (boot {boot}): {what}"))
        };
        let channels = rows.iter().map(codec::data).collect::<Result<Vec<_>, _>>().map_err(of)?;
        let odd = channels.iter().find_map(|data| match data {
            ChannelData::Lines(lines) if lines.len() != self.setup.grid.lines => Some(lines.len()),
            _ => None,
        });
        match odd {
            Some(lines) => Err(of(format!("{lines} lines where there should be {}", self.setup.grid.lines))),
            None => Ok(channels),
        }
    }
}

/// From when on, in µs of Unix time, a node's channels are which of the setup.
type Since = (i64, Vec<usize>);

/// Which of the setup's channels a node's are, by node and configuration.
#[derive(Debug, Default)]
struct ChannelColumns(BTreeMap<(u16, u32), Vec<Since>>);

impl ChannelColumns {
    fn of(&self, window: &NodeWindow, start_us: i64) -> Option<&[usize]> {
        let asked = self.0.get(&(window.name.node, window.configuration_hash))?;
        let last = asked.iter().rev().find(|(since_us, _)| *since_us <= start_us).or(asked.first());
        last.map(|(_, channels)| channels.as_slice())
    }
}

/// A window without its channels, and its row.
fn read_window(row: &rusqlite::Row<'_>) -> rusqlite::Result<(i64, NodeWindow)> {
    let name = WindowName { node: row.get(1)?, boot: row.get(2)?, number: row.get(3)? };
    let window = NodeWindow {
        name,
        configuration_hash: row.get(4)?,
        grid_index: row.get(5)?,
        middle_offset_us: row.get(6)?,
        drift_ppb: row.get(7)?,
        channels: Vec::new(),
    };
    Ok((row.get(0)?, window))
}
