//! The time column: compares it with the setup's sampling rate and finds where rows are missing.
//!
//! Times in seconds flow in, row by row and file after file; the number of rows lost before each flows out.

use super::error::{FilePosition, RecordError};
use crate::statistics::median;

/// A time column's step (or the rate that a file states) may differ from the sampling rate by this much.
pub(super) const RATE_TOLERANCE: f64 = 1e-3;
/// Times that are seconds since 1970, and not since the recording's start: of the years 2001 to 2100.
pub(super) const UNIX_S: std::ops::Range<f64> = 1e9..4.1e9;
/// Seconds since 1970 in nanoseconds, to the microsecond: at these times a float has a quarter of one.
pub(super) fn unix_ns(seconds: f64) -> i64 {
    ((1e6 * seconds).round() as i64).saturating_mul(1000)
}

/// Rows that may be filled into one recording: 55 h at 50 Hz. More is a wrong time column, not a gap.
pub(super) const MOST_FILLED_ROWS: u64 = 10_000_000;
/// The rate is compared with the setup's over stretches of this many steps.
const STEPS_TO_CHECK: u32 = 4096;
/// Gaps in time that are kept one by one.
const GAPS_KEPT: usize = 5;

/// Rows missing from a recording by its time column, or between files by their headers.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TimeGap {
    /// The row after the gap.
    pub(super) position: FilePosition,
    /// Rows missing, filled with NaN.
    pub(super) rows: u64,
    /// Whether headers of files say so.
    pub(super) is_between_files: bool,
}

/// Follows the time column through a recording.
#[derive(Debug, Clone)]
pub(super) struct Clock {
    sampling_rate_hz: f64,
    recording_start_s: Option<f64>,
    previous_s: Option<f64>,
    at_file_start: bool,
    regular_s: f64,
    regular_steps: u32,
    /// The first few gaps.
    pub(super) gaps: Vec<TimeGap>,
    /// All gaps.
    pub(super) gap_count: u64,
    /// Rows missing in all gaps together.
    pub(super) missing_rows: u64,
    /// Where the first blank line between two rows stands, and how many there are, in files without a time column.
    pub(super) blank_lines: Option<(FilePosition, u64)>,
}

impl Clock {
    pub(super) fn new(sampling_rate_hz: f64) -> Self {
        Self {
            sampling_rate_hz,
            recording_start_s: None,
            previous_s: None,
            at_file_start: true,
            regular_s: 0.0,
            regular_steps: 0,
            gaps: Vec::new(),
            gap_count: 0,
            missing_rows: 0,
            blank_lines: None,
        }
    }

    /// Time from the first row to the last that was seen, in s; `None` without a column of times.
    pub(super) fn elapsed_s(&self) -> Option<f64> {
        Some(self.previous_s? - self.recording_start_s?)
    }

    /// Notes blank lines between two rows, of which no time says whether samples are missing there.
    pub(super) fn note_blank_lines(&mut self, position: FilePosition, count: u64) {
        let (_, all) = self.blank_lines.get_or_insert((position, 0));
        *all += count;
    }

    /// The next time is the first of a file.
    pub(super) fn start_file(&mut self) {
        self.at_file_start = true;
        self.regular_s = 0.0;
        self.regular_steps = 0;
    }

    /// Takes a row's time, which is finite, and returns the rows missing before it.
    ///
    /// A step of more than one and a half sampling intervals is a gap. A file whose times start again where those of
    /// the recording's first file did (or at zero) follows the file before it without a gap.
    pub(super) fn advance(&mut self, time_s: f64, column: &str, position: &FilePosition) -> Result<u64, RecordError> {
        let start_s = *self.recording_start_s.get_or_insert(time_s);
        let first_of_file = std::mem::take(&mut self.at_file_start);
        let Some(previous_s) = self.previous_s.replace(time_s) else { return Ok(0) };
        let step_s = time_s - previous_s;
        let step_rows = step_s * self.sampling_rate_hz;
        // Times since 1970 do not start again: such files are of two loggers, or one of them twice.
        if first_of_file && step_s <= 0.0 && !UNIX_S.contains(&time_s) {
            let restarts = |at_s: f64| (time_s - at_s).abs() * self.sampling_rate_hz <= 1.5;
            if restarts(start_s) || restarts(0.0) {
                return Ok(0);
            }
        }
        if step_s <= 0.0 {
            return Err(RecordError::TimeBackwards { position: position.clone(), previous_s, time_s });
        }
        if step_rows <= 1.5 {
            self.check_regular_step(step_s, column, position)?;
            return Ok(0);
        }
        let rows = step_rows.round() as u64 - 1; // a float too large for u64 saturates, and is refused here
        if rows > MOST_FILLED_ROWS.saturating_sub(self.missing_rows) {
            return Err(RecordError::GapTooLong {
                position: position.clone(),
                previous_s,
                time_s,
                limit: MOST_FILLED_ROWS,
            });
        }
        self.note_gap(TimeGap { position: position.clone(), rows, is_between_files: false });
        Ok(rows)
    }

    /// Notes rows that are missing between two files by their headers.
    pub(super) fn note_gap_between_files(&mut self, position: FilePosition, rows: u64) {
        self.note_gap(TimeGap { position, rows, is_between_files: true });
    }

    fn note_gap(&mut self, gap: TimeGap) {
        self.missing_rows += gap.rows;
        self.gap_count += 1;
        if self.gaps.len() < GAPS_KEPT {
            self.gaps.push(gap);
        }
    }

    /// Notices a rate that changes within a file: every full stretch of regular steps must keep the setup's rate.
    fn check_regular_step(&mut self, step_s: f64, column: &str, position: &FilePosition) -> Result<(), RecordError> {
        self.regular_s += step_s;
        self.regular_steps += 1;
        if self.regular_steps < STEPS_TO_CHECK {
            return Ok(());
        }
        let measured_hz = f64::from(self.regular_steps) / self.regular_s;
        self.regular_s = 0.0;
        self.regular_steps = 0;
        if is_rate(measured_hz, self.sampling_rate_hz) {
            return Ok(());
        }
        let (position, column, stated_hz) = (position.clone(), column.to_owned(), self.sampling_rate_hz);
        Err(RecordError::RateDiffers { position, column, measured_hz, stated_hz })
    }
}

/// Whether a file's rate is the setup's, within 0.1 %; one that is no number is none.
pub(super) fn is_rate(measured_hz: f64, stated_hz: f64) -> bool {
    (measured_hz / stated_hz - 1.0).abs() <= RATE_TOLERANCE
}

/// Compares a file's first times with `sampling_rate_hz`; `position` is where they start.
///
/// # Errors
/// [`RecordError::RateDiffers`] where the two differ by more than 0.1 %.
pub(super) fn check_rate(
    times_s: &[f64],
    resolution_s: f64,
    sampling_rate_hz: f64,
    column: &str,
    position: &FilePosition,
) -> Result<(), RecordError> {
    match disagreeing_rate_hz(times_s, resolution_s, sampling_rate_hz) {
        None => Ok(()),
        Some(measured_hz) => {
            let (position, column, stated_hz) = (position.clone(), column.to_owned(), sampling_rate_hz);
            Err(RecordError::RateDiffers { position, column, measured_hz, stated_hz })
        }
    }
}

/// The rate that disagrees with `sampling_rate_hz` by more than 0.1 %, of a file's first times; `None` where they agree
/// or say nothing. What rounding to `resolution_s` can still do to the mean is allowed for.
fn disagreeing_rate_hz(times_s: &[f64], resolution_s: f64, sampling_rate_hz: f64) -> Option<f64> {
    let (measured_hz, sum_s) = regular_rate(times_s)?;
    let allowed = RATE_TOLERANCE + resolution_s / sum_s;
    // A rate that is no number (a step of the smallest doubles) disagrees too.
    if (measured_hz / sampling_rate_hz - 1.0).abs() <= allowed { None } else { Some(measured_hz) }
}

/// The rate that a file's first times say; `None` where they say nothing.
pub(super) fn rate_of_times_hz(times_s: &[f64]) -> Option<f64> {
    regular_rate(times_s).map(|(rate_hz, _)| rate_hz)
}

/// The rate by the regular steps of some times, and how many seconds these make up.
///
/// The median step separates gaps from regular steps; the mean of the regular ones is then free of the rounding of the
/// single times (128 Hz written with three decimals steps by 0.007 and 0.008 s).
fn regular_rate(times_s: &[f64]) -> Option<(f64, f64)> {
    let mut steps_s: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).collect();
    let median_s = median(&mut steps_s)?;
    let regular = steps_s.iter().filter(|step| **step < 1.5 * median_s);
    let (count, sum_s) = regular.fold((0_u32, 0.0), |(count, sum_s), step_s| (count + 1, sum_s + step_s));
    Some((f64::from(count) / sum_s, sum_s))
}
