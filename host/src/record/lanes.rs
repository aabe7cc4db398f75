//! Recordings of several loggers on one line of time: files of each follow one another in a lane of its own, and lanes stand beside each other by
//! when they begin.
//!
//! A setup's files and channels flow in, grouped by the columns that they share; rows of all channels flow out, NaN where a logger does not record.
//! Each logger goes by its own count of rows, or by its column of times. What is left beside whole rows is told.

use std::path::PathBuf;

use super::clock::{Clock, MOST_FILLED_ROWS, RATE_TOLERANCE};
use super::columns::{Columns, Selection};
use super::error::{At, FilePosition, RecordError};
use super::row_reader::{RowReader, Rows};
use super::source_file::{SourceFile, common_columns};
use super::warning::{Affected, RecordWarning};
use crate::study::Setup;

/// Clocks that run apart by more rows than this are told of: half a row is what a row can be off by anyhow.
const MOST_APART_ROWS: f64 = 0.5;
/// An offset below this part of a row moves a phase by less than 0.4 degrees at a tenth of the sampling rate.
const LEAST_OFFSET_ROWS: f64 = 0.01;
/// Files whose headers leave less between them follow each other, beside what the rate's tolerance makes of their length: many recorders write whole
/// seconds, so that two starts that are rounded apart differ by one.
const LEAST_BETWEEN_FILES_S: f64 = 1.5;
/// Loggers whose channels an error lists.
const MOST_LISTED: usize = 2;

/// How a file stands to those before it, by the start in its header.
#[derive(Debug, Clone, Default)]
struct Joint {
    /// Rows missing before it.
    missing: u64,
    /// By how many seconds it begins before those have ended; 0 where it does not.
    early_s: f64,
    /// By how many rows it begins later than the row at which it is put.
    late_rows: f64,
}

/// Files that follow each other, and how far they are read.
#[derive(Debug)]
pub(super) struct Lane {
    /// Those of the recording's setup that have its channels.
    setup: Setup,
    pub(super) files: Vec<SourceFile>,
    /// How each of them stands to those before it.
    joints: Vec<Joint>,
    pub(super) selection: Selection,
    /// Where its channels stand among the recording's.
    places: Vec<usize>,
    pub(super) clock: Clock,
    next_file: usize,
    reader: Option<Box<dyn RowReader>>,
    /// Missing rows still to be filled in before the open file.
    filling: u64,
    /// Rows of the recording before its first.
    lead: u64,
    /// By how much of a row its first is later than the recording's row that it becomes.
    offset_rows: f64,
    /// The same of each of its channels, beside that.
    late_rows: Vec<f64>,
    /// Rows read last, and how many of them are handed out.
    rows: Vec<f64>,
    used: usize,
    /// Rows read of all its files.
    count: u64,
}

/// Lanes of a setup's files: one where all have the same columns, several where they differ and say when they begin.
pub(super) fn lanes_of(setup: &Setup, files: Vec<SourceFile>) -> Result<Vec<Lane>, RecordError> {
    let is_other =
        |error: &RecordError| matches!(error, RecordError::OtherColumns { .. } | RecordError::UnknownChannel { .. });
    match common_columns(&files, setup) {
        Ok(columns) => Ok(vec![Lane::new(setup.clone(), files, columns, (0..setup.sensors.len()).collect())?]),
        Err(error) if files.len() > 1 && setup.block_s.is_none() && is_other(&error) => beside(setup, files, error),
        Err(error) => Err(error),
    }
}

/// Files with different columns beside each other; `otherwise` where they are not of that kind.
fn beside(setup: &Setup, files: Vec<SourceFile>, otherwise: RecordError) -> Result<Vec<Lane>, RecordError> {
    // Without channels files are only looked into.
    let looked = Setup { sensors: Vec::new(), ..setup.clone() };
    let mut groups: Vec<(Columns, Vec<SourceFile>)> = Vec::new();
    for file in files {
        let columns = file.inspect(&looked)?;
        match groups.iter_mut().find(|(other, _)| *other == columns) {
            Some((_, files)) => files.push(file),
            None => groups.push((columns, vec![file])),
        }
    }
    let firsts: Vec<&SourceFile> = groups.iter().filter_map(|(_, files)| files.first()).collect();
    let starts = firsts.iter().map(|file| Ok(start_of(file, &looked)?.ok_or_else(|| file.path.clone())));
    let starts: Vec<Result<i64, PathBuf>> = starts.collect::<Result<_, RecordError>>()?;
    if groups.len() < 2 || starts.iter().all(Result::is_err) {
        return Err(otherwise);
    }
    if let Some(file) = starts.into_iter().find_map(Result::err) {
        return Err(RecordError::LoggerWithoutTime { file });
    }
    let mut of_groups: Vec<Vec<usize>> = vec![Vec::new(); groups.len()];
    for (place, sensor) in setup.sensors.iter().enumerate() {
        let channel = || sensor.channel.clone();
        let mut found = groups.iter().zip(&firsts).zip(&mut of_groups).filter_map(|(((columns, _), file), places)| {
            columns.find(&sensor.channel, &file.path).is_ok().then_some((file, places))
        });
        match (found.next(), found.next()) {
            (Some((_, places)), None) => places.push(place),
            (Some(_), Some((file, _))) => {
                return Err(RecordError::AmbiguousLogger { file: file.path.clone(), channel: channel() });
            }
            (None, _) => {
                let file = firsts.first().map(|file| file.path.clone()).unwrap_or_default();
                let mut available: Vec<String> =
                    groups.iter().take(MOST_LISTED).map(|(columns, _)| columns.to_string()).collect();
                let more = groups.len().saturating_sub(MOST_LISTED);
                if more > 0 {
                    available.push(format!("and those of {more} more loggers"));
                }
                let available = available.join(", other files ");
                return Err(RecordError::UnknownChannel { file, channel: channel(), available });
            }
        }
    }
    if of_groups.iter().any(Vec::is_empty) {
        return Err(otherwise);
    }
    let mut lanes = Vec::new();
    for ((_, files), places) in groups.into_iter().zip(of_groups) {
        let sensors = places.iter().filter_map(|place| setup.sensors.get(*place).cloned()).collect();
        let own = Setup { sensors, ..setup.clone() };
        let columns = common_columns(&files, &own)?;
        lanes.push(Lane::new(own, files, columns, places)?);
    }
    let starts = lanes.iter().map(Lane::start_ns).collect::<Result<Option<Vec<i64>>, _>>()?;
    let starts = starts.ok_or(otherwise)?;
    let first_ns = starts.iter().min().copied().unwrap_or(0);
    for (lane, start_ns) in lanes.iter_mut().zip(starts) {
        let rows = start_ns.saturating_sub(first_ns) as f64 * 1e-9 * setup.sampling_rate_hz;
        (lane.lead, lane.offset_rows) = (rows.round() as u64, rows - rows.round());
        if lane.lead > MOST_FILLED_ROWS {
            let (file, late_s) = (lane.first_file(), rows / setup.sampling_rate_hz);
            return Err(RecordError::LoggerTooLate { file, late_s, limit: MOST_FILLED_ROWS });
        }
    }
    Ok(lanes)
}

/// When a file's first row was, in nanoseconds since 1970 (UTC), where it says it.
fn start_of(file: &SourceFile, setup: &Setup) -> Result<Option<i64>, RecordError> {
    Ok(file.said(setup)?.start_ns.filter(|start_ns| *start_ns > 0))
}

impl Lane {
    fn new(
        setup: Setup,
        files: Vec<SourceFile>,
        columns: Option<Columns>,
        places: Vec<usize>,
    ) -> Result<Self, RecordError> {
        let (Some(columns), Some(first)) = (columns, files.first()) else {
            return Err(RecordError::NoFiles { setup: setup.name });
        };
        let selection = Selection::new(&setup, &columns, &first.path)?;
        let joints = joints(&setup, &files)?;
        let clock = Clock::new(setup.sampling_rate_hz);
        let (lead, offset_rows, rows) = (0, 0.0, Vec::new());
        let (next_file, reader, filling, used, count) = (0, None, 0, 0, 0);
        let late_rows = Vec::new();
        Ok(Self {
            setup,
            files,
            joints,
            selection,
            places,
            clock,
            next_file,
            reader,
            filling,
            lead,
            offset_rows,
            late_rows,
            rows,
            used,
            count,
        })
    }

    /// Where its channels stand among the recording's.
    pub(super) fn places(&self) -> &[usize] {
        &self.places
    }

    fn first_file(&self) -> PathBuf {
        self.files.first().map(|file| file.path.clone()).unwrap_or_default()
    }

    /// When its first row was, in nanoseconds since 1970 (UTC), where its files say it.
    pub(super) fn start_ns(&self) -> Result<Option<i64>, RecordError> {
        self.files.first().map_or(Ok(None), |first| start_of(first, &self.setup))
    }

    /// Rows of each file, those that are missing before it included.
    pub(super) fn rows_of_files(&self) -> impl Iterator<Item = Result<u64, RecordError>> {
        let mut clock = Clock::new(self.setup.sampling_rate_hz);
        let files = self.files.iter().zip(&self.joints);
        files.map(move |(file, joint)| Ok(joint.missing + file.count_rows(&self.setup, &mut clock)?))
    }

    /// Rows up to its end, those before its first included.
    pub(super) fn count_rows(&self) -> Result<u64, RecordError> {
        Ok(self.lead + self.rows_of_files().sum::<Result<u64, _>>()?)
    }

    /// Appends the next rows, `most` at most and of one file, to `values`; how many, and whether they begin a file; 0 at the end.
    pub(super) fn read(&mut self, most: usize, values: &mut Vec<f64>) -> Result<(usize, bool), RecordError> {
        let mut is_begin = false;
        loop {
            let Some(reader) = &mut self.reader else {
                let Some(file) = self.files.get(self.next_file) else { return Ok((0, false)) };
                let reader = file.open(&self.setup)?;
                if self.next_file == 0 {
                    let late = |column: &usize| reader.late_rows().get(*column).copied().unwrap_or(0.0);
                    self.late_rows = self.selection.columns.iter().map(late).collect();
                }
                self.filling = self.joints.get(self.next_file).map_or(0, |joint| joint.missing);
                self.clock.start_file();
                if self.filling > 0 {
                    self.clock.note_gap_between_files(FilePosition::row(&file.path, 1), self.filling);
                }
                self.reader = Some(reader);
                self.next_file += 1;
                is_begin = true;
                continue;
            };
            let mut into = Rows { selection: &self.selection, clock: &mut self.clock, values };
            if self.filling > 0 {
                let count = usize::try_from(self.filling).unwrap_or(usize::MAX).min(most);
                (0..count).for_each(|_| into.push_missing());
                self.filling -= count as u64;
                return Ok((count, is_begin));
            }
            let count = reader.read(most, &mut into)?;
            if count > 0 {
                return Ok((count, is_begin));
            }
            self.reader = None;
        }
    }

    /// Whether the file that is open is the first.
    pub(super) fn is_in_first_file(&self) -> bool {
        self.next_file == 1
    }

    /// Where a row of the last read stands; the first or the last row of all where none is open.
    pub(super) fn position(&self, row: usize) -> FilePosition {
        match &self.reader {
            Some(reader) => reader.position(row),
            None => {
                let file = if self.next_file == 0 { self.files.first() } else { self.files.last() };
                let file = file.map(|file| file.path.clone()).unwrap_or_default();
                FilePosition { file, at: At::Row(self.count.max(1)) }
            }
        }
    }

    /// Rows that wait, after those of the next file are read where none does; `None` at the end.
    fn waiting(&mut self, most: usize) -> Result<Option<usize>, RecordError> {
        if self.lead > 0 {
            return Ok(Some(usize::try_from(self.lead).unwrap_or(usize::MAX).min(most)));
        }
        let channels = self.places.len().max(1);
        if self.used * channels >= self.rows.len() {
            let mut rows = std::mem::take(&mut self.rows);
            rows.clear();
            let read = self.read(most, &mut rows);
            (self.rows, self.used) = (rows, 0);
            let (count, _) = read?;
            self.count += count as u64;
            if count == 0 {
                return Ok(None);
            }
        }
        Ok(Some(self.rows.len() / channels - self.used))
    }

    /// Hands out so many rows of those that wait, to rows of `width` values.
    fn hand_out(&mut self, count: usize, values: &mut [f64], width: usize) {
        if self.lead > 0 {
            self.lead -= count as u64;
            return;
        }
        let rows = self.rows.chunks_exact(self.places.len().max(1)).skip(self.used);
        for (to, from) in values.chunks_exact_mut(width.max(1)).zip(rows).take(count) {
            for (place, value) in self.places.iter().zip(from) {
                if let Some(to) = to.get_mut(*place) {
                    *to = *value;
                }
            }
        }
        self.used += count;
    }

    /// By how many rows its column of times is ahead of its count of rows, at its end.
    fn ahead_rows(&self) -> Option<f64> {
        let steps = self.count.checked_sub(1)? as f64;
        Some(self.clock.elapsed_s()? * self.setup.sampling_rate_hz - steps)
    }
}

/// How each file stands to those before it, where all say in their headers when they begin; nothing of files that do not.
///
/// A file that begins within the leeway of where those before it end follows them, and the next one is held against it. One that begins too early,
/// or that has the same start as the one before (which is the measurement's then), is put behind them, and they end that much later.
fn joints(setup: &Setup, files: &[SourceFile]) -> Result<Vec<Joint>, RecordError> {
    let mut joints = vec![Joint::default(); files.len()];
    // Such blocks follow each other whenever they were recorded.
    if setup.block_s.is_some() || files.len() < 2 {
        return Ok(joints);
    }
    let spans = files.iter().map(|file| file.span(setup)).collect::<Result<Option<Vec<_>>, _>>()?;
    let Some(spans) = spans else { return Ok(joints) };
    let first_ns = spans.first().map_or(0, |first| first.start_ns);
    let (mut rows, mut filled, mut length_s) = (0, 0, 0.0);
    // Start of the file before and end of all before, in s after the first file's start.
    let mut before: Option<[f64; 2]> = None;
    for ((file, joint), span) in files.iter().zip(&mut joints).zip(spans) {
        let start_s = span.start_ns.saturating_sub(first_ns) as f64 * 1e-9;
        let mut end_s = start_s;
        if let Some([other_s, end_of_all_s]) = before {
            let gap_s = start_s - end_of_all_s;
            let leeway_s = LEAST_BETWEEN_FILES_S + RATE_TOLERANCE * length_s;
            if gap_s > leeway_s && start_s != other_s {
                joint.missing = (gap_s * setup.sampling_rate_hz).round() as u64;
            } else if gap_s.abs() > leeway_s || start_s == other_s {
                joint.early_s = if start_s == other_s { 0.0 } else { -gap_s };
                end_s = end_of_all_s;
            }
            filled += joint.missing.min(MOST_FILLED_ROWS + 1);
            if filled > MOST_FILLED_ROWS {
                let (position, limit) = (FilePosition::row(&file.path, 1), MOST_FILLED_ROWS);
                let [previous_s, time_s] = [end_of_all_s, start_s].map(|s| first_ns as f64 * 1e-9 + s);
                return Err(RecordError::GapTooLong { position, previous_s, time_s, limit });
            }
        }
        rows += joint.missing;
        joint.late_rows = start_s * setup.sampling_rate_hz - rows as f64;
        rows += span.rows;
        length_s = span.rows as f64 / span.rate_hz;
        before = Some([start_s, end_s + length_s]);
    }
    Ok(joints)
}

/// Appends the next rows of all lanes, `most` at most, to `values` of `width` channels; how many, and of each lane the row of its last read that the
/// first of them is. 0 at the end of all.
pub(super) fn read_beside(
    lanes: &mut [Lane],
    most: usize,
    width: usize,
    values: &mut Vec<f64>,
) -> Result<(usize, Vec<usize>), RecordError> {
    let waiting = lanes.iter_mut().map(|lane| lane.waiting(most)).collect::<Result<Vec<_>, _>>()?;
    let Some(count) = waiting.iter().flatten().min().copied() else { return Ok((0, Vec::new())) };
    let count = count.min(most);
    let start = values.len();
    values.resize(start + count * width, f64::NAN);
    let firsts = lanes.iter().map(|lane| lane.used).collect();
    for (lane, waiting) in lanes.iter_mut().zip(&waiting) {
        if waiting.is_some() {
            lane.hand_out(count, values.get_mut(start..).unwrap_or_default(), width);
        }
    }
    Ok((count, firsts))
}

/// The lane of a channel.
pub(super) fn lane_of(lanes: &[Lane], channel: usize) -> usize {
    lanes.iter().position(|lane| lane.places.contains(&channel)).unwrap_or(0)
}

/// What is left between the lanes: offsets below a row, and clocks that run apart.
pub(super) fn warnings(lanes: &[Lane], sampling_rate_hz: f64) -> Vec<RecordWarning> {
    let off = lanes.iter().filter(|lane| lane.offset_rows.abs() >= LEAST_OFFSET_ROWS);
    let mut warnings: Vec<RecordWarning> = off
        .map(|lane| RecordWarning::Offset {
            file: lane.first_file(),
            late_ms: 1e3 * lane.offset_rows / sampling_rate_hz,
            degrees_at_1_hz: 360.0 * lane.offset_rows / sampling_rate_hz,
        })
        .collect();
    for lane in lanes {
        let mut early = lane.files.iter().zip(&lane.joints).filter(|(_, joint)| joint.early_s > 0.0);
        if let Some((file, joint)) = early.next() {
            let (file, early_s) = (file.path.clone(), joint.early_s);
            warnings.push(RecordWarning::Early { file, early_s, more: early.count() });
        }
        let worst = lane.files.iter().zip(&lane.joints);
        let worst = worst.max_by(|(_, a), (_, b)| a.late_rows.abs().total_cmp(&b.late_rows.abs()));
        // Alone, nothing stands beside it.
        if let Some((file, joint)) =
            worst.filter(|(_, joint)| lanes.len() > 1 && joint.late_rows.abs() > MOST_APART_ROWS)
        {
            warnings.push(RecordWarning::Shifted {
                file: file.path.clone(),
                late_ms: 1e3 * joint.late_rows / sampling_rate_hz,
                degrees_at_1_hz: 360.0 * joint.late_rows / sampling_rate_hz,
            });
        }
        // To a hundredth of a millisecond: channels of one logger are late alike.
        let late = |rows: f64| (1e5 * rows / sampling_rate_hz).round() as i64;
        let told = lane.late_rows.iter().map(|rows| Some(late(*rows)).filter(|_| rows.abs() >= LEAST_OFFSET_ROWS));
        let channels = lane.selection.channels.iter().map(String::as_str).zip(told);
        warnings.extend(Affected::alike(channels).into_iter().map(|(late, channels)| RecordWarning::ChannelOffset {
            channels,
            late_ms: late as f64 * 1e-2,
            degrees_at_1_hz: 360.0 * late as f64 * 1e-5,
        }));
    }
    let ahead: Vec<(f64, &Lane)> = lanes.iter().filter_map(|lane| Some((lane.ahead_rows()?, lane))).collect();
    let least = ahead.iter().min_by(|a, b| a.0.total_cmp(&b.0));
    let most = ahead.iter().max_by(|a, b| a.0.total_cmp(&b.0));
    if let (Some((least, slow)), Some((most, fast))) = (least, most)
        && most - least > MOST_APART_ROWS
    {
        let (file, other) = (slow.first_file(), fast.first_file());
        warnings.push(RecordWarning::ClocksApart { file, other, rows: most - least });
    }
    warnings
}
