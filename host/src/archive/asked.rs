//! What nodes were asked to measure, row by row, each held against its checksum.

use std::collections::BTreeMap;

use belfry_shared::message::Configuration;
use rusqlite::Row;

use super::checksum::{ASKED_COLUMNS, Checksum, Kind, Tally, tallies};
use super::damage::Damage;
use super::error::is_damage;
use super::{Archive, ArchiveError};
use crate::numbers::counted;

/// What a node was asked to measure.
#[derive(Debug, Clone)]
pub(super) struct Asked {
    pub(super) setup: String,
    pub(super) node: u16,
    pub(super) since_us: i64,
    pub(super) configuration: Configuration,
    /// Names of its channels.
    pub(super) names: Vec<String>,
}

impl Archive {
    /// All that was asked, in the order in which it was, and what of it is damaged.
    pub(super) fn asked(&self) -> rusqlite::Result<(Vec<Asked>, Vec<Damage>)> {
        let (mut asked, mut damages) = (Vec::new(), Vec::new());
        let mut found: BTreeMap<String, Tally> = BTreeMap::new();
        let query = format!("SELECT {ASKED_COLUMNS}, checksum FROM asked ORDER BY id");
        let mut statement = self.connection.prepare(&query)?;
        let mut rows = statement.query([])?;
        loop {
            match rows.next() {
                Ok(None) => break,
                Ok(Some(row)) => {
                    let id = row.get(0).unwrap_or_default();
                    match read(row, &mut found) {
                        Ok(Ok(one)) => asked.push(one),
                        Ok(Err(what)) => damages.push(Damage::row("asked", id, what)),
                        Err(error) if is_damage(&error) => damages.push(Damage::row("asked", id, error.to_string())),
                        Err(error) => return Err(error),
                    }
                }
                Err(error) if is_damage(&error) => {
                    damages.push(Damage::table("asked", error.to_string()));
                    break;
                }
                Err(error) => return Err(error),
            }
        }
        damages.extend(self.miscounted(Kind::Asked, found)?);
        Ok((asked, damages))
    }

    /// The setups, or all at once, of which there are not the rows that there should be.
    pub(super) fn miscounted(&self, kind: Kind, mut found: BTreeMap<String, Tally>) -> rusqlite::Result<Vec<Damage>> {
        let mut statement =
            self.connection.prepare("SELECT setup, entries, digest FROM tally WHERE kind = ?1 ORDER BY setup")?;
        let tally = |row: &Row<'_>| Ok((row.get(0)?, Tally { entries: row.get(1)?, digest: row.get(2)? }));
        let expected: rusqlite::Result<Vec<(String, Tally)>> =
            statement.query_map([kind.name()], tally).and_then(Iterator::collect);
        let expected = match expected {
            Err(error) if is_damage(&error) => return Ok(vec![Damage::table("tally", error.to_string())]),
            expected => expected?,
        };
        let mut damages = Vec::new();
        for (setup, expected) in expected {
            let found = found.remove(&setup).unwrap_or_default();
            if found != expected {
                damages.push(Damage::table(kind.name(), miscount(&setup, expected, found)));
            }
        }
        // Of the rest there should be nothing.
        damages.extend(
            found.iter().map(|(setup, &found)| Damage::table(kind.name(), miscount(setup, Tally::default(), found))),
        );
        Ok(damages)
    }

    /// What a setup's nodes have been asked to measure with, the last first; of all setups where none is named.
    ///
    /// # Errors
    /// Where the database cannot be read; what is damaged is left out.
    pub fn configurations(&self, setup: Option<&str>) -> Result<Vec<Configuration>, ArchiveError> {
        let (asked, _) = self.asked().map_err(|source| self.failed(source))?;
        let mut configurations: Vec<Configuration> = Vec::new();
        for one in asked.into_iter().rev().filter(|one| setup.is_none_or(|setup| setup == one.setup)) {
            if !configurations.contains(&one.configuration) {
                configurations.push(one.configuration);
            }
        }
        Ok(configurations)
    }

    /// Tallies of windows of a setup by hour, and that they cannot be read.
    pub(super) fn window_tallies(&self, setup: &str) -> rusqlite::Result<(BTreeMap<i64, Tally>, Vec<Damage>)> {
        match tallies(&self.connection, Kind::Window, setup) {
            Ok(tallies) => Ok((tallies.into_iter().collect(), Vec::new())),
            Err(error) if is_damage(&error) => Ok((BTreeMap::new(), vec![Damage::table("tally", error.to_string())])),
            Err(error) => Err(error),
        }
    }
}

/// That so many windows cannot be read, for nothing says with which settings they were measured; `None` where there are none.
pub(super) fn unknown_settings(windows: u64) -> Option<Damage> {
    let verb = if windows == 1 { "names" } else { "name" };
    let what = format!(
        "{} {verb} settings that nobody has asked for, and cannot be analysed; `belfry collect` with the same [analysis] notes these again",
        counted(windows, "window")
    );
    (windows > 0).then(|| Damage::table("asked", what))
}

/// How many rows there should be, and are.
pub(super) fn miscount(setup: &str, expected: Tally, found: Tally) -> String {
    let of = if setup.is_empty() { String::new() } else { format!(" of setup \"{setup}\"") };
    if expected.entries == found.entries {
        format!("the {} rows{of} are not all those that were written", found.entries)
    } else {
        format!("{} rows{of} should be there, {} are", expected.entries, found.entries)
    }
}

/// Reads a row and counts it; what is wrong with it.
fn read(row: &Row<'_>, found: &mut BTreeMap<String, Tally>) -> rusqlite::Result<Result<Asked, String>> {
    let mut checksum = Checksum::new();
    checksum.add(row, ASKED_COLUMNS)?;
    let stored: i64 = row.get("checksum")?;
    let (setup, settings, names): (String, String, String) =
        (row.get("setup")?, row.get("settings")?, row.get("channels")?);
    let (node, since_us, hash): (u16, i64, u32) = (row.get("node")?, row.get("since_us")?, row.get("configuration")?);
    found.entry(setup.clone()).or_default().add(stored);
    if checksum.value() != stored {
        return Ok(Err("it does not match its checksum".to_owned()));
    }
    let configuration: Configuration = match serde_json::from_str(&settings) {
        Ok(configuration) => configuration,
        Err(error) => return Ok(Err(format!("settings: {error}"))),
    };
    if configuration.hash() != hash {
        return Ok(Err("its settings are not those of its hash".to_owned()));
    }
    match serde_json::from_str(&names) {
        Ok(names) => Ok(Ok(Asked { setup, node, since_us, configuration, names })),
        Err(error) => Ok(Err(format!("channels of node {node}: {error}"))),
    }
}
