//! Averaged power spectral densities, and the complex lines of every window, as tables.
//!
//! What a setup's spectra are of decides the column that its numbers stand in: (m/s²)²/Hz or (m/s)²/Hz, so that a table of a
//! study with both has both, and no number without its unit.

use std::path::Path;

use super::ExportError;
use super::parquet::{Cell, Kind, Text};
use super::rows::{RowsFile, TableFormat};
use crate::measure::{Measurement, epoch_s};
use crate::spectra::{LineGrid, WindowLines};
use crate::study::{Motion, Setup};

/// The motions that a study's spectra are of, in the order of a table's columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Column {
    Acceleration,
    Velocity,
}

impl Column {
    fn of(setup: &Setup) -> Self {
        if setup.motion() == Motion::Velocity { Self::Velocity } else { Self::Acceleration }
    }

    fn of_all<'a>(setups: impl Iterator<Item = &'a Setup> + Clone) -> Vec<Self> {
        let measured = |motion: &Self| setups.clone().any(|setup| Self::of(setup) == *motion);
        [Self::Acceleration, Self::Velocity].into_iter().filter(measured).collect()
    }

    fn psd_column(self) -> &'static str {
        match self {
            Self::Acceleration => "psd_m2_per_s4_hz",
            Self::Velocity => "psd_m2_per_s2_hz",
        }
    }

    fn line_columns(self) -> [&'static str; 2] {
        match self {
            Self::Acceleration => ["re_m_per_s2_sqrt_hz", "im_m_per_s2_sqrt_hz"],
            Self::Velocity => ["re_m_per_s_sqrt_hz", "im_m_per_s_sqrt_hz"],
        }
    }
}

/// One row of the table of power spectral densities.
struct PsdRow<'a> {
    setup: &'a Setup,
    channel: usize,
    averages: usize,
    frequency_hz: f64,
    psd: f64,
}

/// Every setup's densities, channel after channel; one-sided, of the channels that are not left out.
fn psd_rows<'a>(measurement: &'a Measurement<'_>) -> Vec<PsdRow<'a>> {
    let mut rows = Vec::new();
    for measured in &measurement.setups {
        let (setup, spectrum) = (measured.setup, &measured.spectrum);
        let grid = spectrum.grid();
        let matrices: Vec<_> = (0..grid.lines).map(|line| spectrum.matrix(line)).collect();
        for (place, channel) in spectrum.channels().iter().enumerate() {
            rows.extend(matrices.iter().enumerate().map(|(line, matrix)| PsdRow {
                setup,
                channel: *channel,
                averages: spectrum.averages(),
                frequency_hz: grid.frequency_hz(line),
                psd: matrix.get((place, place)).map_or(f64::NAN, |value| value.re),
            }));
        }
    }
    rows
}

fn channel_name(setup: &Setup, channel: usize) -> &str {
    setup.sensors.get(channel).map_or("", |sensor| sensor.channel.as_str())
}

/// Writes the averaged power spectral densities and returns the rows.
///
/// # Errors
/// [`ExportError::Write`] names the file.
pub fn write_psd(path: &Path, measurement: &Measurement<'_>, format: TableFormat) -> Result<u64, ExportError> {
    let motions = Column::of_all(measurement.setups.iter().map(|measured| measured.setup));
    let mut columns =
        vec![("setup", Kind::Text), ("channel", Kind::Text), ("averages", Kind::Whole), ("frequency_hz", Kind::Number)];
    columns.extend(motions.iter().map(|motion| (motion.psd_column(), Kind::Number)));
    let mut table = RowsFile::create(path, &columns, format)?;
    for row in psd_rows(measurement) {
        let (setup, channel) = (Text::new(&row.setup.name), Text::new(channel_name(row.setup, row.channel)));
        let mut cells = vec![
            Cell::Text(&setup),
            Cell::Text(&channel),
            Cell::Whole(row.averages as i64),
            Cell::Number(Some(row.frequency_hz)),
        ];
        let own = |motion: &Column| (*motion == Column::of(row.setup)).then_some(row.psd);
        cells.extend(motions.iter().map(|motion| Cell::Number(own(motion))));
        table.push(&cells)?;
    }
    table.finish()
}

/// Writes the complex lines of every window while they are measured: an observer of
/// [`measure_observed`](crate::measure::measure_observed).
///
/// Lines are as [`WindowLines`] has them: |line|² is the one-sided power spectral density, the phase refers to the start
/// of the window. A channel without sound data in a window has no rows there.
pub struct LinesTable {
    table: RowsFile,
    motions: Vec<Column>,
    /// The setup of the last window, with its channels.
    names: Option<(Text, Vec<Text>)>,
    name: String,
    failure: Option<ExportError>,
}

impl LinesTable {
    /// A file for the lines of these setups.
    ///
    /// # Errors
    /// [`ExportError::Write`] names the file.
    pub fn create(path: &Path, setups: &[Setup], format: TableFormat) -> Result<Self, ExportError> {
        let motions = Column::of_all(setups.iter());
        let mut columns = vec![
            ("setup", Kind::Text),
            ("window", Kind::Whole),
            ("start_s", Kind::Number),
            ("channel", Kind::Text),
            ("frequency_hz", Kind::Number),
        ];
        columns.extend(motions.iter().flat_map(|motion| motion.line_columns()).map(|name| (name, Kind::Number)));
        let table = RowsFile::create(path, &columns, format)?;
        Ok(Self { table, motions, names: None, name: String::new(), failure: None })
    }

    /// Writes a window's lines; [`LinesTable::finish`] reports what goes wrong.
    pub fn observe(&mut self, setup: &Setup, grid: &LineGrid, window: &WindowLines) {
        if self.failure.is_none()
            && let Err(error) = self.write(setup, grid, window)
        {
            self.failure = Some(error);
        }
    }

    /// Makes the file whole and returns its rows.
    ///
    /// # Errors
    /// [`ExportError::Write`] names the file.
    pub fn finish(self) -> Result<u64, ExportError> {
        match self.failure {
            Some(error) => Err(error),
            None => self.table.finish(),
        }
    }

    fn write(&mut self, setup: &Setup, grid: &LineGrid, window: &WindowLines) -> Result<(), ExportError> {
        if self.names.is_none() || self.name != setup.name {
            let channels = setup.sensors.iter().map(|sensor| Text::new(&sensor.channel)).collect();
            self.names = Some((Text::new(&setup.name), channels));
            self.name.clone_from(&setup.name);
        }
        let Some((name, channels)) = &self.names else { return Ok(()) };
        let start_s = window_start_s(setup, grid, window.grid_index);
        for (channel, lines) in channels.iter().zip(&window.channels) {
            for (line, value) in lines.iter().flatten().enumerate() {
                let mut cells = vec![
                    Cell::Text(name),
                    Cell::Whole(window.grid_index as i64),
                    Cell::Number(Some(start_s)),
                    Cell::Text(channel),
                    Cell::Number(Some(grid.frequency_hz(line))),
                ];
                for motion in &self.motions {
                    let own = *motion == Column::of(setup);
                    cells.extend([value.re, value.im].map(|part| Cell::Number(own.then_some(f64::from(part)))));
                }
                self.table.push(&cells)?;
            }
        }
        Ok(())
    }
}

/// Start of a window in s since the recording's first row, or since the first window that was collected live.
fn window_start_s(setup: &Setup, grid: &LineGrid, grid_index: u64) -> f64 {
    epoch_s(setup, grid) + grid_index as f64 * (grid.segment / 2) as f64 / grid.sampling_rate_hz
}
