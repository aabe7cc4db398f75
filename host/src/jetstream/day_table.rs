//! Results of a structure as Parquet files, one a day: `STRUCTURE/2027-01-15.parquet`. A file is always written whole, of what the stream has, so a worker
//! that is killed, or two that believe to be in charge, can neither lose nor double a row.

use std::fs;
use std::mem;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use async_nats::jetstream::stream::Stream;

use super::error::StreamError;
use super::follow::IntervalResult;
use super::names;
use super::reading::{Start, each};
use crate::archive::day;
use crate::export::intervals::intervals;
use crate::watch::DAY_S;

/// The results of the newest day.
#[derive(Debug)]
pub(super) struct DayTable {
    folder: PathBuf,
    day: i64,
    results: Vec<IntervalResult>,
}

impl DayTable {
    /// Makes up for days that have no file, and for those from the last file but one on, which a worker that was killed, or asleep, may have left unfinished.
    pub(super) async fn catch_up(results: &Stream, folder: &Path, key: &str) -> Result<Self, StreamError> {
        let folder = folder.join(key);
        fs::create_dir_all(&folder).map_err(|source| StreamError::File { file: folder.clone(), source })?;
        let unsure = last_but_one(&folder).map_err(|source| StreamError::File { file: folder.clone(), source })?;
        let mut table = Self { folder, day: i64::MIN, results: Vec::new() };
        each(results, &names::results(key), Start::Message(1), false, |message| {
            let Ok(result) = serde_json::from_slice::<IntervalResult>(&message.payload) else {
                return Ok(ControlFlow::Continue(()));
            };
            let day = day_of(&result);
            if day != table.day {
                let next = Self { folder: table.folder.clone(), day, results: Vec::new() };
                let done = mem::replace(&mut table, next);
                let file = done.file();
                // As names sort, days do.
                if !file.exists() || unsure.as_ref().is_none_or(|unsure| file >= *unsure) {
                    done.write()?;
                }
            }
            table.results.push(result);
            Ok(ControlFlow::Continue(()))
        })
        .await?;
        table.write()?;
        Ok(table)
    }

    /// Takes a result that was published.
    pub(super) fn push(&mut self, result: IntervalResult) -> Result<(), StreamError> {
        let day = day_of(&result);
        if day != self.day {
            (self.day, self.results) = (day, Vec::new());
        }
        self.results.push(result);
        self.write()
    }

    fn file(&self) -> PathBuf {
        self.folder.join(format!("{}.parquet", day(self.day.saturating_mul((DAY_S * 1e6) as i64))))
    }

    fn write(&self) -> Result<(), StreamError> {
        if self.results.is_empty() {
            return Ok(());
        }
        let file = self.file();
        let written = intervals(&file, &self.results);
        written.map(drop).map_err(|error| StreamError::File { file, source: std::io::Error::other(error) })
    }
}

/// The file of the newest day but one, or of the only one; `None` where there is none.
fn last_but_one(folder: &Path) -> std::io::Result<Option<PathBuf>> {
    let files = fs::read_dir(folder)?.map(|entry| entry.map(|entry| entry.path()));
    let mut files = files.collect::<std::io::Result<Vec<_>>>()?;
    files.retain(|file| file.extension().is_some_and(|ending| ending == "parquet"));
    files.sort();
    let at = files.len().saturating_sub(2);
    Ok(files.into_iter().nth(at))
}

/// The day in which an interval begins, in days since the Unix epoch.
fn day_of(result: &IntervalResult) -> i64 {
    (result.start_s / DAY_S).floor() as i64
}
