//! The windows of a setup without their data, hour by hour, each hour held against its tally.
//!
//! An hour that does not add up is read once more by the rows' numbers, which takes no index: a page that cannot be read costs what is
//! on it, and nothing else.

use std::cell::OnceCell;
use std::collections::{BTreeMap, BTreeSet};

use belfry_shared::message::WindowName;
use rusqlite::{Row, params};

use super::Archive;
use super::asked::miscount;
use super::checksum::{CHANNEL_COLUMNS, Checksum, Tally, WINDOW_COLUMNS, hour_of, hour_start_us};
use super::codec::{self, ChannelRow};
use super::damage::Damage;
use super::error::is_damage;
use crate::window::{ChannelData, NodeWindow};

/// Crystals drift by less, in parts per thousand million.
const MOST_DRIFT_PPB: i32 = 1_000_000;

/// A window without its channels, and its row.
#[derive(Clone)]
pub(super) struct Head {
    pub(super) id: i64,
    pub(super) setup: String,
    pub(super) window: NodeWindow,
    pub(super) start_us: i64,
    pub(super) stored: i64,
    /// The checksum of what is read of it so far.
    checksum: Checksum,
}

impl Head {
    pub(super) const COLUMNS: &str = WINDOW_COLUMNS;

    /// Reads a row of a query for [`Head::COLUMNS`] and the checksum.
    pub(super) fn read(row: &Row<'_>) -> rusqlite::Result<Self> {
        let mut checksum = Checksum::new();
        checksum.add(row, Self::COLUMNS)?;
        let window = NodeWindow {
            name: WindowName { node: row.get("node")?, boot: row.get("boot")?, number: row.get("number")? },
            configuration_hash: row.get("configuration")?,
            grid_index: row.get("grid_index")?,
            middle_offset_us: row.get("middle_offset_us")?,
            drift_ppb: row.get("drift_ppb")?,
            channels: Vec::new(),
        };
        Ok(Self {
            id: row.get("id")?,
            setup: row.get("setup")?,
            window,
            start_us: row.get("start_us")?,
            stored: row.get("checksum")?,
            checksum,
        })
    }

    /// The same with what is wrong with it.
    pub(super) fn damaged(&self, what: impl Into<String>) -> Damage {
        Damage::window(self.id, self.window.name, self.start_us, what)
    }
}

impl Archive {
    /// The data of a window's channels, or what is wrong with it.
    pub(super) fn channels(&self, head: &Head) -> rusqlite::Result<Result<Vec<ChannelData>, String>> {
        let query = format!("SELECT {CHANNEL_COLUMNS} FROM channel WHERE window = ?1 ORDER BY channel");
        let mut checksum = head.checksum.clone();
        let mut read = || -> rusqlite::Result<Vec<ChannelRow>> {
            let mut statement = self.connection.prepare_cached(&query)?;
            let mut rows = statement.query([head.id])?;
            let mut channels = Vec::new();
            while let Some(row) = rows.next()? {
                checksum.add(row, CHANNEL_COLUMNS)?;
                channels.push(ChannelRow::read(row)?);
            }
            Ok(channels)
        };
        let rows = match read() {
            Err(error) if is_damage(&error) => return Ok(Err(error.to_string())),
            rows => rows?,
        };
        if checksum.value() != head.stored {
            return Ok(Err("it does not match its checksum".to_owned()));
        }
        if head.window.drift_ppb.unsigned_abs() > MOST_DRIFT_PPB.unsigned_abs() {
            return Ok(Err(format!("a clock that drifts by {} ppb is impossible", head.window.drift_ppb)));
        }
        Ok(rows.iter().map(codec::data).collect())
    }

    /// The window of a row, where there is one.
    pub(super) fn head(&self, id: i64) -> rusqlite::Result<Option<Head>> {
        let query = format!("SELECT {}, checksum FROM window WHERE id = ?1", Head::COLUMNS);
        let mut statement = self.connection.prepare_cached(&query)?;
        let mut rows = statement.query([id])?;
        rows.next()?.map(Head::read).transpose()
    }

    /// Numbers of all rows of windows that can be reached in any way.
    pub(super) fn window_ids(&self) -> BTreeSet<i64> {
        const WAYS: [&str; 5] = [
            "SELECT id FROM window NOT INDEXED ORDER BY id",
            "SELECT id FROM window NOT INDEXED ORDER BY id DESC",
            "SELECT id FROM window ORDER BY setup, start_us",
            "SELECT id FROM window ORDER BY node, boot, number",
            "SELECT window FROM channel ORDER BY window",
        ];
        let mut ids = BTreeSet::new();
        for way in WAYS {
            let Ok(mut statement) = self.connection.prepare(way) else { continue };
            let Ok(mut rows) = statement.query([]) else { continue };
            while let Ok(Some(row)) = rows.next() {
                ids.extend(row.get::<_, i64>(0));
            }
        }
        ids
    }
}

/// The windows of a setup.
pub(super) struct Survey {
    setup: String,
    tallies: BTreeMap<i64, Tally>,
    /// Hours in which there are windows, or should be.
    hours: BTreeSet<i64>,
    /// All that can be reached, by the hour; only where an hour does not add up.
    salvaged: OnceCell<BTreeMap<i64, Vec<Head>>>,
    /// What is wrong with all of it.
    pub(super) damages: Vec<Damage>,
}

impl Survey {
    pub(super) fn new(archive: &Archive, setup: &str) -> rusqlite::Result<Self> {
        let (tallies, mut damages) = archive.window_tallies(setup)?;
        let mut hours: BTreeSet<i64> = tallies.keys().copied().collect();
        let query = "SELECT DISTINCT start_us / 3600000000 FROM window WHERE setup = ?1";
        let mut statement = archive.connection.prepare(query)?;
        let seen: rusqlite::Result<Vec<i64>> =
            statement.query_map([setup], |row| row.get(0)).and_then(Iterator::collect);
        match seen {
            Ok(seen) => hours.extend(seen),
            Err(error) if is_damage(&error) => damages.push(Damage::table("window", error.to_string())),
            Err(error) => return Err(error),
        }
        Ok(Self { setup: setup.to_owned(), tallies, hours, salvaged: OnceCell::new(), damages })
    }

    /// The hours in which there are windows, or should be, in the order of time.
    pub(super) fn hours(&self) -> impl DoubleEndedIterator<Item = i64> {
        self.hours.iter().copied()
    }

    /// The first window that is sound, or the last, where `from_end`.
    pub(super) fn outermost(&self, archive: &Archive, from_end: bool) -> rusqlite::Result<Option<Head>> {
        let mut hours: Vec<i64> = self.hours().collect();
        if from_end {
            hours.reverse();
        }
        for hour in hours {
            let (mut heads, _) = self.hour(archive, hour)?;
            if from_end {
                heads.reverse();
            }
            for head in heads {
                if archive.channels(&head)?.is_ok() {
                    return Ok(Some(head));
                }
            }
        }
        Ok(None)
    }

    /// The windows that begin in an hour, in the order of time, and what is wrong there.
    pub(super) fn hour(&self, archive: &Archive, hour: i64) -> rusqlite::Result<(Vec<Head>, Vec<Damage>)> {
        let expected = self.tallies.get(&hour).copied().unwrap_or_default();
        let (mut heads, mut damages, failed) = self.by_index(archive, hour)?;
        if !failed && damages.is_empty() && tally(&heads) == expected {
            return Ok((heads, damages));
        }
        let salvaged = self.salvaged.get_or_init(|| salvage(archive, &self.setup));
        let known: BTreeSet<i64> = heads.iter().map(|head| head.id).collect();
        let more = salvaged.get(&hour).into_iter().flatten().filter(|head| !known.contains(&head.id)).cloned();
        heads.extend(more);
        heads.sort_by_key(|head| (head.start_us, head.window.name.node, head.id));
        let found = tally(&heads);
        let what = if found == expected {
            "an index is damaged; all windows are there".to_owned()
        } else {
            miscount(&self.setup, expected, found)
        };
        damages.push(Damage { start_s: Some(hour_start_us(hour) as f64 * 1e-6), ..Damage::table("window", what) });
        Ok((heads, damages))
    }

    /// The same by the index of starts, as far as it goes, and whether that is not all the way.
    fn by_index(&self, archive: &Archive, hour: i64) -> rusqlite::Result<(Vec<Head>, Vec<Damage>, bool)> {
        let query = format!(
            "SELECT {}, checksum FROM window WHERE setup = ?1 AND start_us >= ?2 AND start_us < ?3 ORDER BY start_us, node, id",
            Head::COLUMNS
        );
        let (mut heads, mut damages) = (Vec::new(), Vec::new());
        let mut statement = archive.connection.prepare_cached(&query)?;
        let mut rows =
            statement.query(params![self.setup, hour_start_us(hour), hour_start_us(hour.saturating_add(1))])?;
        loop {
            let row = match rows.next() {
                Ok(None) => return Ok((heads, damages, false)),
                Ok(Some(row)) => row,
                Err(error) if is_damage(&error) => return Ok((heads, damages, true)),
                Err(error) => return Err(error),
            };
            match Head::read(row) {
                Ok(head) => heads.push(head),
                Err(error) if is_damage(&error) => {
                    damages.push(Damage::row("window", row.get(0).unwrap_or_default(), error.to_string()));
                }
                Err(error) => return Err(error),
            }
        }
    }
}

/// All windows of a setup that can be read, by the hour in which they began.
fn salvage(archive: &Archive, setup: &str) -> BTreeMap<i64, Vec<Head>> {
    let mut hours: BTreeMap<i64, Vec<Head>> = BTreeMap::new();
    for id in archive.window_ids() {
        if let Ok(Some(head)) = archive.head(id)
            && head.setup == setup
        {
            hours.entry(hour_of(head.start_us)).or_default().push(head);
        }
    }
    hours
}

fn tally(heads: &[Head]) -> Tally {
    let mut tally = Tally::default();
    heads.iter().for_each(|head| tally.add(head.stored));
    tally
}
