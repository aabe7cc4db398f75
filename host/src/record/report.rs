//! What was read: rows, missing samples, gaps, dead channels and levels, gathered block by block.

use super::block::Block;
use super::clock::{Clock, TimeGap};
use super::columns::Selection;
use super::error::FilePosition;
use super::warning::{Affected, RecordWarning};

/// Gaps that are kept one by one for each channel.
const GAPS_KEPT: usize = 5;
/// No sensor gives more, in m/s², m/s or any other unit, nor do counts of 64 bits: a bit of a number's exponent was flipped. Its square is
/// still a number of 32 bits, as spectra have them.
const MOST: f64 = 1e19;
/// A channel with a larger part of its samples missing is warned of as such.
const MOSTLY_MISSING: f64 = 0.5;

/// What was in a recording, as far as it was read.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordReport {
    /// Rows read, filled rows included.
    pub rows: u64,
    /// Rows of NaN filled in where the time column, or the headers of two files, say that rows are missing.
    pub filled_rows: u64,
    /// Each channel, in the order of the setup's sensors.
    pub channels: Vec<ChannelReport>,
    /// What the user should know before trusting the recording.
    pub warnings: Vec<RecordWarning>,
}

/// What was in one channel of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelReport {
    /// The sensor's channel.
    pub channel: String,
    /// Samples missing, filled rows included.
    pub missing: u64,
    /// Runs of missing samples.
    pub gap_count: u64,
    /// The first few of these runs.
    pub gaps: Vec<Gap>,
    /// Whether all samples are equal or missing: a dead or unplugged sensor.
    pub constant: bool,
    /// Mean of the samples in m/s² (m/s for a velocity); NaN without samples.
    pub mean: f64,
    /// Root mean square about the mean, in m/s² (m/s for a velocity); NaN where there is no sample.
    pub rms: f64,
}

/// A run of missing samples of one channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Gap {
    /// Where the first missing sample stands (the row after it, if the row itself is missing from the file).
    pub position: FilePosition,
    /// The recording's row, from 0, at which the run starts.
    pub row: u64,
    /// Its length in rows.
    pub rows: u64,
}

/// The sums behind a [`RecordReport`].
#[derive(Debug, Clone)]
pub(super) struct Statistics {
    rows: u64,
    channels: Vec<ChannelSums>,
    /// Working space: per channel, the value that differences are taken from, their sum and the sum of their squares.
    pivots: Vec<f64>,
    sums: Vec<f64>,
    squares: Vec<f64>,
}

#[derive(Debug, Clone, Default)]
struct ChannelSums {
    /// The first value: taken off all others, so that gravity on a vertical sensor does not drown its vibration.
    pivot: Option<f64>,
    sum: f64,
    square: f64,
    present: u64,
    missing: u64,
    gap_count: u64,
    gaps: Vec<Gap>,
    /// The last sample was missing; the length of the run so far counts on in `gaps` while it is kept there.
    in_gap: bool,
    /// Samples beyond [`MOST`], and where the first of them stands, with its row and its value.
    beyond: u64,
    first_beyond: Option<(FilePosition, u64, f64)>,
}

impl Statistics {
    pub(super) fn new(channels: usize) -> Self {
        Self {
            rows: 0,
            channels: vec![ChannelSums::default(); channels],
            pivots: vec![f64::NAN; channels],
            sums: vec![0.0; channels],
            squares: vec![0.0; channels],
        }
    }

    /// Takes a block in; `position` says where a row of the block stands, and of it a channel (both from 0). Values beyond any sensor's
    /// range, and infinite ones, count as missing, and are so in the block from then on.
    pub(super) fn add(&mut self, block: &mut Block, position: impl Fn(usize, usize) -> FilePosition) {
        self.sums.fill(0.0);
        self.squares.fill(0.0);
        for row in block.rows() {
            let sums = self.sums.iter_mut().zip(&mut self.squares);
            for ((value, pivot), (sum, square)) in row.iter().zip(&self.pivots).zip(sums) {
                let difference = value - pivot;
                *sum += difference;
                *square += difference * difference;
            }
        }
        for (index, channel) in self.channels.iter_mut().enumerate() {
            let (Some(sum), Some(square)) = (self.sums.get(index), self.squares.get(index)) else { continue };
            if *square < MOST * MOST {
                // Every sample is there, and within reach of the first: the common case, for which the loop above is all the work.
                channel.sum += sum;
                channel.square += square;
                channel.present += block.row_count() as u64;
                channel.in_gap = false;
                continue;
            }
            // A missing, infinite or impossible sample (or the channel's first) spoilt the sums: take the samples one by one.
            for (row, value) in block.channel_mut(index).enumerate() {
                let row_of_all = self.rows + row as u64;
                if value.abs() > MOST {
                    channel.beyond += 1;
                    channel.first_beyond.get_or_insert_with(|| (position(row, index), row_of_all, *value));
                    *value = f64::NAN;
                }
                channel.push(*value, row_of_all, || position(row, index));
            }
            if let (Some(pivot), Some(known)) = (self.pivots.get_mut(index), channel.pivot) {
                *pivot = known;
            }
        }
        self.rows += block.row_count() as u64;
    }

    /// The report of all that was taken in, with the gaps in time that `clock` found.
    pub(super) fn report(self, selection: &Selection, clock: &Clock, sampling_rate_hz: f64) -> RecordReport {
        let seconds = |rows: u64| rows as f64 / sampling_rate_hz;
        let rows = self.rows;
        let filled_rows = clock.missing_rows.min(rows);
        let all = selection.channels.len();
        let beyond = self.channels.iter().zip(&selection.channels).filter_map(|(sums, name)| {
            let (first, row, value) = sums.first_beyond.clone()?;
            let (channels, samples) = (Affected::new([name], all), sums.beyond);
            Some(RecordWarning::Impossible { channels, samples, value, first, first_s: seconds(row) })
        });
        let beyond = beyond.collect();
        let channels: Vec<ChannelReport> =
            self.channels.into_iter().zip(&selection.channels).map(|(sums, name)| sums.report(name)).collect();
        let mut warnings: Vec<RecordWarning> = beyond;
        let gaps = clock.gaps.iter().cloned().map(|TimeGap { position, rows, is_between_files }| {
            RecordWarning::TimeGap { position, rows, seconds: seconds(rows), is_between_files }
        });
        warnings.extend(gaps);
        if clock.gap_count > clock.gaps.len() as u64 {
            warnings.push(RecordWarning::TimeGaps {
                count: clock.gap_count,
                rows: clock.missing_rows,
                seconds: seconds(clock.missing_rows),
            });
        }
        let blank_lines =
            clock.blank_lines.clone().map(|(position, count)| RecordWarning::BlankLines { position, count });
        warnings.extend(blank_lines);
        let warnings_of_channels = alike(&channels, |report| {
            let first = report.gaps.first().filter(|_| report.missing > filled_rows)?;
            Some((report.missing, report.gap_count, report.gaps.as_slice(), first))
        });
        warnings.extend(warnings_of_channels.into_iter().map(|((missing, gap_count, _, first), channels)| {
            let (samples, first_s, first) = (missing, seconds(first.row), first.position.clone());
            RecordWarning::MissingSamples { channels, samples, seconds: seconds(missing), gap_count, first, first_s }
        }));
        // Where nobody recorded, no channel is to blame.
        let recorded = (rows - filled_rows) as f64;
        let lost = |report: &ChannelReport| report.missing.saturating_sub(filled_rows) as f64;
        let mostly_missing = |report: &ChannelReport| lost(report) > MOSTLY_MISSING * recorded;
        let few = alike(&channels, |report| mostly_missing(report).then(|| lost(report)));
        warnings.extend(
            few.into_iter()
                .map(|(lost, channels)| RecordWarning::MostlyMissing { channels, percent: 100.0 * lost / recorded }),
        );
        let dead =
            alike(&channels, |report| (report.constant && rows > 0 && !mostly_missing(report)).then_some(report.mean));
        warnings.extend(dead.into_iter().map(|(value, channels)| RecordWarning::Constant { channels, value }));
        RecordReport { rows, filled_rows, channels, warnings }
    }
}

/// [`Affected::alike`] of channels' reports.
fn alike<'a, T: PartialEq>(
    channels: &'a [ChannelReport],
    what: impl Fn(&'a ChannelReport) -> Option<T>,
) -> Vec<(T, Affected)> {
    Affected::alike(channels.iter().map(|report| (report.channel.as_str(), what(report))))
}

impl ChannelSums {
    fn push(&mut self, value: f64, row: u64, position: impl Fn() -> FilePosition) {
        if value.is_nan() {
            self.missing += 1;
            if !self.in_gap {
                self.gap_count += 1;
                if self.gaps.len() < GAPS_KEPT {
                    self.gaps.push(Gap { position: position(), row, rows: 0 });
                }
            }
            self.in_gap = true;
            if self.gap_count == self.gaps.len() as u64
                && let Some(gap) = self.gaps.last_mut()
            {
                gap.rows += 1;
            }
            return;
        }
        self.in_gap = false;
        self.present += 1;
        let difference = value - *self.pivot.get_or_insert(value);
        self.sum += difference;
        self.square += difference * difference;
    }

    fn report(self, channel: &str) -> ChannelReport {
        let present = self.present as f64;
        let offset = self.sum / present; // NaN where nothing is present
        let variance = self.square / present - offset * offset;
        ChannelReport {
            channel: channel.to_owned(),
            missing: self.missing,
            gap_count: self.gap_count,
            gaps: self.gaps,
            // One sample alone has nothing to differ from.
            constant: self.square == 0.0 && self.present != 1,
            mean: self.pivot.map_or(f64::NAN, |pivot| pivot + offset),
            // Rounding may leave a tiny negative variance. `max` would also make 0 of the NaN of no samples.
            rms: if self.present == 0 { f64::NAN } else { variance.max(0.0).sqrt() },
        }
    }
}
