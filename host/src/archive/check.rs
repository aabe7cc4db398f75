//! Checking: every row against its checksum, every tally, and SQLite's own look at the file. Nothing is changed.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use rusqlite::Row;
use serde::Serialize;

use super::asked::unknown_settings;
use super::checksum::{Checksum, Kind, Tally, hour_start_us};
use super::damage::Damage;
use super::error::is_damage;
use super::heads::Survey;
use super::loss::{DamagedHour, ListedLoss};
use super::{ARCHIVE_FILE, Archive, ArchiveError};
use crate::numbers::{counted, is_or_are};

/// What SQLite says of a file's structure is cut off after so many lines.
const MOST_SAID: usize = 100;

/// What a check has found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CheckReport {
    /// The archive.
    pub archive: PathBuf,
    /// The version of its tables. Those of version 1 have no checksums.
    pub version: i32,
    /// Its size.
    pub bytes: u64,
    /// Windows of nodes that are as they were written.
    pub sound_windows: u64,
    /// What is not as it was written.
    pub damages: Vec<Damage>,
    /// What SQLite finds wrong with the file.
    pub structure: Vec<String>,
    /// Windows that no longer exist anywhere. That is no damage of the archive.
    pub lost: Vec<ListedLoss>,
    /// What repairs could not save of an hour: those of it whose numbers are known are in `lost` as well.
    pub lost_in_repairs: Vec<DamagedHour>,
    /// Whether nothing is wrong.
    pub is_sound: bool,
}

impl Archive {
    /// Checks the archive of the study in `folder`.
    ///
    /// # Errors
    /// Where there is none, it cannot be opened, or is no archive. What is damaged is no error.
    pub fn check(folder: &Path) -> Result<CheckReport, ArchiveError> {
        let absent = || ArchiveError::absent(folder.join(ARCHIVE_FILE));
        let archive = Self::open_any(folder)?.ok_or_else(absent)?;
        let failed = |source| archive.failed(source);
        archive.connection.execute_batch("BEGIN").map_err(failed)?;
        let version = archive.version()?;
        let structure = archive.structure();
        let (sound_windows, damages) = match version {
            1 => (archive.window_ids().len() as u64, Vec::new()),
            version => archive.check_rows(version).map_err(failed)?,
        };
        // Where that table is damaged, it has been said.
        let lost = if version < 3 { Vec::new() } else { archive.losses().unwrap_or_default() };
        let lost_in_repairs = if version < 2 { Vec::new() } else { archive.damaged_hours().unwrap_or_default() };
        let is_sound = damages.is_empty() && structure.is_empty();
        let bytes = std::fs::metadata(&archive.file).map_or(0, |metadata| metadata.len());
        let file = archive.file.clone();
        Ok(CheckReport {
            archive: file,
            version,
            bytes,
            sound_windows,
            damages,
            structure,
            lost,
            lost_in_repairs,
            is_sound,
        })
    }

    /// What SQLite finds wrong with the file.
    fn structure(&self) -> Vec<String> {
        let query = format!("PRAGMA integrity_check({MOST_SAID})");
        let said = self.connection.prepare(&query).and_then(|mut statement| {
            let lines = statement.query_map([], |row| row.get::<_, String>(0))?;
            lines.collect::<rusqlite::Result<Vec<_>>>()
        });
        match said {
            Ok(lines) => lines.into_iter().filter(|line| line != "ok").collect(),
            Err(error) => vec![error.to_string()],
        }
    }

    /// Windows that are sound, and all that is damaged.
    fn check_rows(&self, version: i32) -> rusqlite::Result<(u64, Vec<Damage>)> {
        let (asked, mut damages) = self.asked()?;
        let known: BTreeSet<u32> = asked.iter().map(|one| one.configuration.hash()).collect();
        damages.extend(self.check_table(Kind::Service)?);
        if version >= 3 {
            damages.extend(self.check_table(Kind::Loss)?);
        }
        let (mut sound, mut unknown) = (0, 0);
        for setup in self.setups()? {
            let survey = Survey::new(self, &setup)?;
            damages.extend(survey.damages.iter().cloned());
            for hour in survey.hours() {
                let (heads, wrong) = survey.hour(self, hour)?;
                damages.extend(wrong);
                for head in heads {
                    unknown += u64::from(!known.contains(&head.window.configuration_hash));
                    match self.channels(&head)? {
                        Ok(_) => sound += 1,
                        Err(what) => damages.push(head.damaged(what)),
                    }
                }
            }
        }
        damages.extend(unknown_settings(unknown));
        Ok((sound, damages))
    }

    /// Names of all setups of which there are windows, or should be.
    pub(super) fn setups(&self) -> rusqlite::Result<BTreeSet<String>> {
        let mut setups = BTreeSet::new();
        for query in ["SELECT DISTINCT setup FROM tally WHERE kind = 'window'", "SELECT DISTINCT setup FROM window"] {
            let mut statement = self.connection.prepare(query)?;
            let mut rows = statement.query([])?;
            loop {
                match rows.next() {
                    Ok(Some(row)) => setups.extend(row.get::<_, String>(0)),
                    Ok(None) => break,
                    // The tallies tell what is missed.
                    Err(error) if is_damage(&error) => break,
                    Err(error) => return Err(error),
                }
            }
        }
        Ok(setups)
    }

    fn check_table(&self, kind: Kind) -> rusqlite::Result<Vec<Damage>> {
        let (table, columns) = (kind.name(), kind.columns());
        let (mut damages, mut found) = (Vec::new(), Tally::default());
        let mut statement = self.connection.prepare(&format!("SELECT {columns}, checksum FROM {table}"))?;
        let mut rows = statement.query([])?;
        let mut read = |row: &Row<'_>| -> rusqlite::Result<bool> {
            let mut checksum = Checksum::new();
            checksum.add(row, columns)?;
            let stored = row.get("checksum")?;
            found.add(stored);
            Ok(checksum.value() == stored)
        };
        loop {
            match rows.next() {
                Ok(None) => break,
                Ok(Some(row)) if read(row).is_ok_and(|is_sound| is_sound) => {}
                Ok(Some(row)) => {
                    let id = row.get(0).unwrap_or_default();
                    damages.push(Damage::row(table, id, "it does not match its checksum"));
                }
                Err(error) if is_damage(&error) => {
                    damages.push(Damage::table(table, error.to_string()));
                    break;
                }
                Err(error) => return Err(error),
            }
        }
        let found = if found == Tally::default() { BTreeMap::new() } else { BTreeMap::from([(String::new(), found)]) };
        damages.extend(self.miscounted(kind, found)?);
        Ok(damages)
    }
}

/// What is damaged, an hour of a setup that has lost windows.
pub(super) fn lost_in(setup: &str, hour: i64, windows: u64) -> Damage {
    let what = format!("{} of setup \"{setup}\" {} lost", counted(windows, "window"), is_or_are(windows));
    Damage { start_s: Some(hour_start_us(hour) as f64 * 1e-6), ..Damage::table("window", what) }
}
