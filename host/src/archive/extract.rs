//! Extracting: the windows of a range of time as an archive of their own, or as a table.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;

use belfry_shared::message::Configuration;
use rusqlite::types::Value;
use rusqlite::{ErrorCode, OpenFlags};
use serde::Serialize;

use super::asked::Asked;
use super::checksum::{CHANNEL_COLUMNS, Kind, WINDOW_COLUMNS};
use super::damage::Damage;
use super::heads::{Head, Survey};
use super::mend::Values;
use super::range::moment;
use super::read::{clock, hop_us};
use super::repair::{copy_row, write_window};
use super::{Archive, ArchiveError, TimeRange};
use crate::files::WholeFile;
use crate::window::ChannelData;

/// What was extracted.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Extract {
    /// Windows of nodes.
    pub windows: u64,
    /// What is damaged, and left out.
    pub damages: Vec<Damage>,
}

/// A sound window, with the settings that it was measured with as far as they are known.
struct Extracted<'a> {
    head: &'a Head,
    configuration: Option<&'a Configuration>,
    data: Vec<ChannelData>,
}

/// The columns of the table.
const COLUMNS: [&str; 13] = [
    "setup",
    "node",
    "boot",
    "window",
    "start_utc",
    "start_s",
    "middle_offset_us",
    "drift_ppb",
    "channel",
    "state",
    "frequency_hz",
    "re_m_per_s2_sqrt_hz",
    "im_m_per_s2_sqrt_hz",
];
/// Beside them, of a channel that its node has averaged.
const DENSITY_COLUMN: &str = "psd_m2_per_s4_hz";

impl Archive {
    /// Writes the windows of a range of time into an archive of its own.
    ///
    /// # Errors
    /// Where the archive cannot be read, or the file cannot be written; what was there stays then.
    pub fn extract_archive(&self, range: &TimeRange, output: &Path) -> Result<Extract, ArchiveError> {
        let fail = |source| ArchiveError::Write { file: output.to_owned(), source };
        let file = WholeFile::create(output).map_err(fail)?;
        let new = Self::connect(file.unfinished_path().to_owned(), OpenFlags::default(), None);
        let mut new = new.map_err(|error| fail(io::Error::other(error)))?;
        let mut extract = Extract::default();
        let new_failed = |source: rusqlite::Error| fail(io::Error::other(source));
        // Only the new file grows.
        let either_failed = |source: rusqlite::Error| match source.sqlite_error_code() {
            Some(ErrorCode::DiskFull | ErrorCode::ReadOnly | ErrorCode::CannotOpen) => new_failed(source),
            _ => self.failed(source),
        };
        // What is unfinished is of no use, so that nothing has to be rolled back.
        new.connection.pragma_update_and_check(None, "journal_mode", "off", |_| Ok(())).map_err(new_failed)?;
        new.prepare().map_err(new_failed)?;
        let transaction = new.connection.transaction().map_err(new_failed)?;
        let mut write = || -> rusqlite::Result<()> {
            for kind in [Kind::Asked, Kind::Service, Kind::Loss] {
                for id in self.row_ids(kind.name()) {
                    // A checksum of its own would make damage good.
                    let Some((values, _)) = self.row(kind.name(), kind.columns(), id) else { continue };
                    copy_row(&values, kind, &transaction)?;
                }
            }
            self.each_in(range, &mut extract, &mut |Extracted { head, .. }| {
                let query = format!("SELECT {WINDOW_COLUMNS} FROM window WHERE id = ?1");
                let values = self
                    .connection
                    .prepare_cached(&query)?
                    .query_row([head.id], |row| Values::read(row, WINDOW_COLUMNS))?;
                let query = format!("SELECT {CHANNEL_COLUMNS} FROM channel WHERE window = ?1 ORDER BY channel");
                let mut statement = self.connection.prepare_cached(&query)?;
                let channels: Vec<Values> = statement
                    .query_map([head.id], |row| Values::read(row, CHANNEL_COLUMNS))?
                    .collect::<rusqlite::Result<_>>()?;
                let channels: Vec<Value> = channels.into_iter().flat_map(|values| values.0).collect();
                write_window(&transaction, head.id, &values.0, &channels).map(drop)
            })
        };
        write().map_err(either_failed)?;
        transaction.commit().map_err(new_failed)?;
        drop(new);
        file.finish().map_err(fail)?;
        Ok(extract)
    }

    /// Writes the windows of a range of time as a CSV table, a row a line of a channel.
    ///
    /// # Errors
    /// As [`Archive::extract_archive`].
    pub fn extract_csv(&self, range: &TimeRange, output: &Path) -> Result<Extract, ArchiveError> {
        let fail = |source| ArchiveError::Write { file: output.to_owned(), source };
        let mut csv =
            csv::WriterBuilder::new().comment(Some(b'#')).from_writer(WholeFile::create(output).map_err(fail)?);
        let mut extract = Extract::default();
        let mut broken = csv.write_record(COLUMNS.iter().chain([&DENSITY_COLUMN])).err();
        let (asked, _) = self.asked().map_err(|source| self.failed(source))?;
        let write = self.each_in(range, &mut extract, &mut |window| {
            if broken.is_none() {
                broken = write_rows(&mut csv, &asked, window).err();
            }
            Ok(())
        });
        write.map_err(|source| self.failed(source))?;
        if let Some(error) = broken {
            return Err(fail(error.into()));
        }
        let file = csv.into_inner().map_err(|error| fail(error.into_error()))?;
        file.finish().map_err(fail)?;
        Ok(extract)
    }

    /// Hands out the sound windows of a range of time, setup by setup.
    fn each_in(
        &self,
        range: &TimeRange,
        extract: &mut Extract,
        on_window: &mut dyn FnMut(Extracted<'_>) -> rusqlite::Result<()>,
    ) -> rusqlite::Result<()> {
        let (asked, damages) = self.asked()?;
        extract.damages.extend(damages);
        let by_hash: BTreeMap<u32, &Configuration> =
            asked.iter().map(|one| (one.configuration.hash(), &one.configuration)).collect();
        let hop_of = |head: &Head| by_hash.get(&head.window.configuration_hash).map_or(0, |one| hop_us(one));
        for setup in self.setups()? {
            let survey = Survey::new(self, &setup)?;
            extract.damages.extend(survey.damages.iter().cloned());
            let last = survey.outermost(self, true)?;
            let end_us = last.map_or(i64::MIN, |head| head.start_us.saturating_add(2 * hop_of(&head)));
            let [from_us, to_us] = range.middles(end_us);
            for hour in survey.hours() {
                let (heads, wrong) = survey.hour(self, hour)?;
                extract.damages.extend(wrong);
                for head in heads {
                    if !(from_us..to_us).contains(&head.start_us.saturating_add(hop_of(&head))) {
                        continue;
                    }
                    match self.channels(&head)? {
                        Ok(data) => {
                            extract.windows += 1;
                            let configuration = by_hash.get(&head.window.configuration_hash).copied();
                            on_window(Extracted { head: &head, configuration, data })?;
                        }
                        Err(what) => extract.damages.push(head.damaged(what)),
                    }
                }
            }
        }
        Ok(())
    }
}

/// Writes a window's rows.
fn write_rows(
    csv: &mut csv::Writer<impl Write>,
    asked: &[Asked],
    Extracted { head, configuration, data }: Extracted<'_>,
) -> csv::Result<()> {
    let name = head.window.name;
    let mut named = asked.iter().rev().filter(|one| {
        one.setup == head.setup && one.node == name.node && one.configuration.hash() == head.window.configuration_hash
    });
    let names =
        named.clone().find(|one| one.since_us <= head.start_us).or_else(|| named.next_back()).map(|one| &one.names);
    let frequencies_hz: Vec<f64> = configuration.map(frequencies_hz).unwrap_or_default();
    let mut start = vec![head.setup.clone(), name.node.to_string(), name.boot.to_string(), name.number.to_string()];
    start.extend([moment(head.start_us), (head.start_us as f64 * 1e-6).to_string()]);
    start.extend([head.window.middle_offset_us.to_string(), head.window.drift_ppb.to_string()]);
    for (index, data) in data.into_iter().enumerate() {
        let mut channel = start.clone();
        channel.push(names.and_then(|names| names.get(index).cloned()).unwrap_or_else(|| (index + 1).to_string()));
        let frequency = |line: usize| frequencies_hz.get(line).map_or_else(String::new, f64::to_string);
        let mut row = |state: &str, rest: [String; 4]| {
            csv.write_record(channel.iter().map(String::as_str).chain([state]).chain(rest.iter().map(String::as_str)))
        };
        match data {
            ChannelData::Unsound(state) => row(super::codec::state_name(state), Default::default())?,
            ChannelData::Lines(lines) => {
                for (line, value) in lines.iter().enumerate() {
                    row("sound", [frequency(line), value.re.to_string(), value.im.to_string(), String::new()])?;
                }
            }
            ChannelData::Psd { densities, .. } => {
                for (line, density) in densities.iter().enumerate() {
                    row("sound", [frequency(line), String::new(), String::new(), density.to_string()])?;
                }
            }
        }
    }
    Ok(())
}

/// The frequencies of a configuration's lines.
fn frequencies_hz(configuration: &Configuration) -> Vec<f64> {
    let rate_hz = clock(configuration).sampling_rate_uhz as f64 * 1e-6 / f64::from(configuration.decimation.max(1));
    let spacing_hz = rate_hz / f64::from(configuration.segment.max(1));
    let lines = configuration
        .bands
        .iter()
        .flat_map(|band| (0..band.lines).map(|line| u32::from(band.first_line) + u32::from(line)));
    lines.map(|line| f64::from(line) * spacing_hz).collect()
}
