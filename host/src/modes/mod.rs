//! Modes that were measured: a file of modes flows in, modes over the study's sensors flow out.
//!
//! The file is what `belfry identify` writes (JSON), a CSV table, or a UFF 55 file of another tool. A shape may be
//! complex in the file; it is turned to the phase at which it is the most real.

mod channel;
mod computed;
mod csv_table;
mod drawn;
mod error;
mod json;
mod measured;
pub(crate) mod nodes;
mod shape;
mod stated;
#[cfg(test)]
mod tests;
mod uff;

use std::collections::BTreeSet;
use std::path::Path;

use crate::study::Sensor;
pub use computed::{ComputedModes, read_computed};
pub use drawn::DrawnErrors;
pub(crate) use drawn::normals;
pub use error::MeasuredError;
pub use json::as_reported;
pub(crate) use measured::{CLOSE, WRONG_BY, WRONGLY_IDENTIFIED};
pub use measured::{MeasuredCovarianceFactor, MeasuredMode, MeasuredModes, MeasuredShape};
use shape::RawMode;
pub use stated::StatedMode;
pub(crate) use stated::are_known;
pub(crate) use uff::node_and_direction;

/// Reads a file of modes; its ending says what it is (`.json`, `.csv`, `.uff` or `.unv`), and where that says nothing, its
/// beginning does.
///
/// # Errors
/// [`MeasuredError`] names the file, the line or mode, and the channel.
pub fn read(path: &Path, sensors: &[Sensor]) -> Result<MeasuredModes, MeasuredError> {
    let bytes = std::fs::read(path).map_err(|source| MeasuredError::Unreadable { file: path.to_owned(), source })?;
    parse(path, &bytes, sensors)
}

/// What files of modes look like.
#[derive(Clone, Copy)]
enum Format {
    Json,
    Csv,
    Uff,
}

impl Format {
    fn of(path: &Path, text: &str) -> Self {
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("json") => Self::Json,
            Some("csv") => Self::Csv,
            Some("uff" | "unv" | "u55") => Self::Uff,
            _ if text.trim_start().starts_with('{') => Self::Json,
            _ if text.lines().next().is_some_and(|line| line.trim() == "-1") => Self::Uff,
            _ => Self::Csv,
        }
    }

    fn modes(
        self,
        path: &Path,
        text: &str,
        sensors: &[Sensor],
        warnings: &mut Vec<String>,
    ) -> Result<Vec<RawMode>, MeasuredError> {
        match self {
            Self::Json => json::modes(path, text, sensors),
            Self::Csv => csv_table::modes(path, text, sensors),
            Self::Uff => uff::modes(path, text, sensors, warnings),
        }
    }
}

fn parse(path: &Path, bytes: &[u8], sensors: &[Sensor]) -> Result<MeasuredModes, MeasuredError> {
    let text = String::from_utf8_lossy(bytes);
    let text = text.trim_start_matches('\u{feff}');
    let mut warnings = Vec::new();
    let raw = Format::of(path, text).modes(path, text, sensors, &mut warnings)?;
    finish(path, raw, sensors, warnings)
}

/// Checks what all formats have in common, and makes shapes real.
fn finish(
    path: &Path,
    raw: Vec<RawMode>,
    sensors: &[Sensor],
    mut warnings: Vec<String>,
) -> Result<MeasuredModes, MeasuredError> {
    let file = path.to_owned();
    if raw.is_empty() {
        return Err(MeasuredError::NoModes { file });
    }
    let mut numbers = BTreeSet::new();
    let mut modes = Vec::new();
    let mut seen = vec![false; sensors.len()];
    for component in raw.iter().flat_map(|mode| &mode.components).filter(|component| !component.value.is_nan()) {
        if let Some(seen) = seen.get_mut(component.sensor) {
            *seen = true;
        }
    }
    for mode in raw {
        if !numbers.insert(mode.number) {
            return Err(MeasuredError::SameNumber { file, number: mode.number });
        }
        if !(mode.frequency_hz.is_finite() && mode.frequency_hz > 0.0) {
            return Err(MeasuredError::Frequency { file, number: mode.number, frequency_hz: mode.frequency_hz });
        }
        modes.push(mode.finish(&file, sensors, &seen, &mut warnings)?);
    }
    if seen.contains(&true) {
        let blind: Vec<&str> =
            sensors.iter().zip(&seen).filter(|(_, seen)| !**seen).map(|(sensor, _)| sensor.channel.as_str()).collect();
        if !blind.is_empty() {
            warnings.push(format!("{}: no mode has a component at channel {}", path.display(), blind.join(", ")));
        }
    }
    modes.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    Ok(MeasuredModes { file, modes, warnings })
}
