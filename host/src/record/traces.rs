//! Traces with times of their own, as SAC, miniSEED and UDBF files hold them, on one grid of rows: pieces of any files flow in, channels flow out.
//!
//! Times are in nanoseconds since 1970 (UTC, as the files have them). Pieces that follow each other within half a sample are one stretch, so
//! that a logger whose rate is off by some ppm leaves no gaps; what is missing between others are rows without samples.

use std::collections::HashMap;
use std::path::PathBuf;

use super::array::Source;
use super::channels::{Channel, ChannelReader, Form, Stretch, UNSCALED, path_of};
use super::clock::MOST_FILLED_ROWS;
use super::columns::Columns;
use super::error::RecordError;
use super::leap;
use crate::study::Setup;

const NS: f64 = 1e9;

/// A piece of one trace.
#[derive(Debug, Clone)]
pub(super) struct Piece {
    /// Which of the names.
    pub(super) name: usize,
    pub(super) start_ns: i64,
    pub(super) rate_hz: f64,
    pub(super) count: u64,
    pub(super) source: usize,
    pub(super) offset: u64,
    pub(super) form: Form,
}

/// What files hold.
#[derive(Debug, Default)]
pub(super) struct Traces {
    pub(super) sources: Vec<(PathBuf, Source)>,
    names: Vec<String>,
    units: Vec<Option<String>>,
    known: HashMap<String, usize>,
    pieces: Vec<Piece>,
}

impl Traces {
    /// The number of a trace of this name.
    pub(super) fn name(&mut self, name: &str) -> usize {
        if let Some(known) = self.known.get(name) {
            return *known;
        }
        self.names.push(name.to_owned());
        self.units.push(None);
        self.known.insert(name.to_owned(), self.names.len() - 1);
        self.names.len() - 1
    }

    /// The file's word for a trace's unit.
    pub(super) fn set_unit(&mut self, name: usize, unit: &str) {
        if let Some(place) = self.units.get_mut(name) {
            *place = Some(unit.to_owned());
        }
    }

    pub(super) fn push(&mut self, piece: Piece) {
        self.pieces.push(piece);
    }

    /// What reads the setup's channels of them, on the grid that begins with the first of these.
    ///
    /// # Errors
    /// [`RecordError`] names the file where pieces lie over each other, are too far apart, or channels run apart.
    pub(super) fn reader(mut self, setup: &Setup) -> Result<ChannelReader, RecordError> {
        let first_file = path_of(&self.sources, 0);
        let columns = Columns::Paths(self.names.clone());
        let is_read = !setup.sensors.is_empty();
        let mut is_wanted = vec![!is_read; self.names.len()];
        for column in columns.find_all(&setup.sensors, &first_file)? {
            if let Some(wanted) = is_wanted.get_mut(column) {
                *wanted = true;
            }
        }
        self.pieces.retain(|piece| is_wanted.get(piece.name) == Some(&true) && piece.count > 0);
        self.pieces.sort_by_key(|piece| piece.start_ns);
        let start_ns = self.pieces.first().map_or(0, |piece| piece.start_ns);
        let rate_hz = setup.sampling_rate_hz;
        let mut channels: Vec<Channel> = self
            .names
            .iter()
            .zip(&self.units)
            .map(|(name, unit)| Channel {
                name: name.clone(),
                rate_hz: None,
                scale: UNSCALED,
                stretches: Vec::new(),
                unit: unit.clone(),
            })
            .collect();
        // When the sample behind each channel's last is due, in nanoseconds from the grid's first, and how many rows its clock is ahead.
        let mut due: Vec<Option<(i64, f64)>> = vec![None; channels.len()];
        // By how many rows each channel's first sample is later than the row that it becomes.
        let mut late_rows = vec![0.0; channels.len()];
        let mut missing: u64 = 0;
        for piece in &self.pieces {
            let wrong =
                |reason: String| Err(RecordError::Format { file: path_of(&self.sources, piece.source), reason });
            let (Some(channel), Some(due)) = (channels.get_mut(piece.name), due.get_mut(piece.name)) else { continue };
            // Where files are only looked into, each trace has a grid of its own.
            let grid_hz = if is_read { rate_hz } else { piece.rate_hz };
            let in_calendar_ns = piece.start_ns.saturating_sub(start_ns);
            let elapsed_ns = in_calendar_ns.saturating_add(leap::between_ns(start_ns, piece.start_ns));
            let late_of = |ns: i64| due.map(|(due_ns, _)| ns.saturating_sub(due_ns) as f64 / NS * piece.rate_hz);
            // A record that begins within a leap second has the time of the second after it.
            let is_early = leap::may_be_within(piece.start_ns)
                && late_of(in_calendar_ns).is_some_and(|late: f64| late.abs() <= 0.5);
            let elapsed_ns = if is_early { in_calendar_ns } else { elapsed_ns };
            let rows = elapsed_ns as f64 / NS * grid_hz;
            let late = late_of(elapsed_ns);
            let end = channel.end();
            let row = match late {
                Some(late) if late.abs() <= 0.5 => end,
                _ => rows.round() as u64, // a float too large for u64 saturates, and is refused here
            };
            if row < end {
                return wrong(format!(
                    "`{}` has samples twice, {} of them from {} on; cut one of the files",
                    channel.name,
                    end - row,
                    utc(piece.start_ns)
                ));
            }
            missing = row.saturating_sub(end).saturating_add(missing);
            if missing > MOST_FILLED_ROWS || row.checked_add(piece.count).is_none() {
                return wrong(format!(
                    "`{}` goes on at {} after a gap that is too long to fill; make setups of the parts",
                    channel.name,
                    utc(piece.start_ns)
                ));
            }
            channel.rate_hz.get_or_insert(piece.rate_hz);
            let length_ns = (piece.count as f64 / piece.rate_hz * NS) as i64;
            if let (None, Some(late_rows)) = (*due, late_rows.get_mut(piece.name)) {
                *late_rows = rows - row as f64;
            }
            *due = Some((elapsed_ns.saturating_add(length_ns), rows - row as f64));
            let Piece { count, source, offset, form, .. } = *piece;
            channel.stretches.push(Stretch { row, count, source, offset, form });
        }
        let ahead = due.iter().flatten().map(|(_, ahead)| *ahead);
        let (least, most) = ahead.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), one| (a.min(one), b.max(one)));
        if is_read && most - least > 1.5 {
            let reason = format!(
                "the clocks of its channels run apart: by {:.1} samples at the end; make setups of shorter parts",
                most - least
            );
            return Err(RecordError::Format { file: first_file, reason });
        }
        Ok(ChannelReader::new(self.sources, channels, true, setup)?.from(start_ns, late_rows))
    }
}

/// Nanoseconds since 1970 of a day of a year, both from 1, and a time of that day; `None` of what is no date.
pub(super) fn unix_ns(year: i64, day: i64, [hours, minutes, seconds]: [i64; 3], ns: i64) -> Option<i64> {
    let is_date = (1900..=2200).contains(&year) && (1..=366).contains(&day);
    // A leap second is the sixtieth.
    let is_time = (0..24).contains(&hours) && (0..60).contains(&minutes) && (0..=60).contains(&seconds);
    let leap_days = |year: i64| year / 4 - year / 100 + year / 400;
    let days = 365 * (year - 1970) + leap_days(year - 1) - leap_days(1969) + day - 1;
    let seconds = ((days * 24 + hours) * 60 + minutes) * 60 + seconds;
    (is_date && is_time).then(|| seconds.checked_mul(1_000_000_000)?.checked_add(ns))?
}

/// A time as people read it.
pub(crate) fn utc(ns: i64) -> String {
    let since = |ns: u64| std::time::UNIX_EPOCH.checked_add(std::time::Duration::from_nanos(ns));
    let time = u64::try_from(ns).ok().and_then(since);
    time.map_or_else(|| "a time before 1970".to_owned(), |time| humantime::format_rfc3339_millis(time).to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pieces of 60 s at 10 Hz of two channels, which begin at these times of the calendar in ns.
    fn reader(pieces: &[(usize, i64)]) -> Result<ChannelReader, RecordError> {
        let mut traces = Traces::default();
        let (a, b) = (traces.name("a"), traces.name("b"));
        traces.sources.push((PathBuf::from("x.mseed"), Source::Memory(Vec::new())));
        for (channel, start_ns) in pieces {
            let form = Form::packed(super::super::array::Sample::F32, false, 0);
            let name = if *channel == 0 { a } else { b };
            let piece = Piece { name, start_ns: *start_ns, rate_hz: 10.0, count: 600, source: 0, offset: 0, form };
            traces.push(piece);
        }
        traces.reader(&Setup::new(
            "now",
            10.0,
            ["a", "b"].map(|channel| crate::study::Sensor::new(channel, 1)).to_vec(),
        ))
    }

    #[test]
    fn a_leap_second_makes_neither_a_gap_nor_samples_twice() {
        const SECOND: i64 = 1_000_000_000;
        // 2017-01-01T00:00:00Z, which 2016-12-31T23:59:60Z is counted as too.
        let midnight = 1_483_228_800 * SECOND;
        let before = midnight - 59 * SECOND;
        // A minute from 23:59:01 on ends with the leap second.
        assert_eq!(reader(&[(0, before), (0, midnight), (1, before)]).unwrap().rows(), 1200);
        // The second piece begins within it: the first ended at 23:59:60.
        let earlier = midnight - 60 * SECOND;
        assert_eq!(reader(&[(0, earlier), (0, midnight), (1, earlier)]).unwrap().rows(), 1200);
        // A year before there was none.
        let day = midnight - 366 * 86_400 * SECOND;
        let error = reader(&[(0, day - 59 * SECOND), (0, day), (1, day)]).unwrap_err().to_string();
        assert!(error.contains("samples twice"), "{error}");
    }

    #[test]
    fn channels_between_the_others_rows_are_told_by_how_much() {
        use super::super::row_reader::RowReader;
        let start = 1_772_366_400_000_000_000;
        let late = reader(&[(0, start), (1, start + 30_000_000), (0, start + 60_000_000_000)]).unwrap();
        assert_eq!(late.late_rows().len(), 2);
        assert!(
            (late.late_rows()[0]).abs() < 1e-9 && (late.late_rows()[1] - 0.3).abs() < 1e-9,
            "{:?}",
            late.late_rows()
        );
    }

    #[test]
    fn days_of_a_year_are_counted_as_the_calendar_has_them() {
        // Python: datetime(2024, 12, 31, 23, 59, 59, tzinfo=timezone.utc).timestamp() and two more.
        for (year, day, time, expected) in [
            (2024, 366, [23, 59, 59], 1_735_689_599),
            (1970, 1, [0, 0, 0], 0),
            (2000, 60, [12, 0, 0], 951_825_600),
            (1969, 365, [23, 59, 59], -1),
        ] {
            assert_eq!(unix_ns(year, day, time, 7), Some(expected * 1_000_000_000 + 7));
        }
        assert_eq!(unix_ns(2024, 367, [0, 0, 0], 0), None);
        assert_eq!(unix_ns(2024, 1, [24, 0, 0], 0), None);
    }
}
