//! Results of a fleet's intervals as Parquet: a row for each mode of each interval.

use std::path::Path;

use super::ExportError;
use super::parquet::{Cell, Kind, ParquetTable, Text};
use crate::jetstream::IntervalResult;

const COLUMNS: [(&str, Kind); 10] = [
    ("structure", Kind::Text),
    ("interval", Kind::Whole),
    ("start_s", Kind::Number),
    ("end_s", Kind::Number),
    ("windows", Kind::Whole),
    ("temperature_degc", Kind::Number),
    ("mode", Kind::Whole),
    ("frequency_hz", Kind::Number),
    ("frequency_std_hz", Kind::Number),
    ("response_rms", Kind::Number),
];

/// Writes a file of these intervals, which appears whole. One that shows no mode has a row of mode 0, without numbers.
pub(crate) fn intervals(path: &Path, results: &[IntervalResult]) -> Result<u64, ExportError> {
    let mut table = ParquetTable::create(path, &COLUMNS)?;
    for result in results {
        let structure = Text::new(&result.structure);
        let seen = result.seen.as_ref();
        let mut push = |mode: usize, numbers: [Option<f64>; 3]| {
            let [frequency_hz, frequency_std_hz, response_rms] = numbers;
            table.push(&[
                Cell::Text(&structure),
                Cell::Whole(result.interval),
                Cell::Number(Some(result.start_s)),
                Cell::Number(Some(result.end_s)),
                Cell::Whole(result.windows as i64),
                Cell::Number(seen.and_then(|seen| seen.temperature_degc)),
                Cell::Whole(mode as i64),
                Cell::Number(frequency_hz),
                Cell::Number(frequency_std_hz),
                Cell::Number(response_rms),
            ])
        };
        let modes = seen.map_or(&[][..], |seen| &seen.modes);
        for mode in modes {
            push(mode.number, [Some(mode.frequency_hz), Some(mode.frequency_std_hz), Some(mode.response_rms)])?;
        }
        if modes.is_empty() {
            push(0, [None; 3])?;
        }
    }
    table.finish()
}
