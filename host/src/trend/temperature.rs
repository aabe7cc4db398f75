//! Temperature beside a recording: a CSV table `time_s,temperature_degc`, time counted from the recording's first row; of a live
//! setup in Unix time.

use std::fs::File;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why there is no temperature.
#[derive(Debug, Error)]
pub enum TemperatureError {
    /// The file cannot be read.
    #[error("{}, the temperature that study.toml names: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The table is not what it should be.
    #[error(
        "{}, line {line}: {reason}; a table of temperatures has the columns time_s (from the recording's first row, or Unix time for a live setup; rising) and temperature_degc", file.display()
    )]
    Table {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: u64,
        /// What is wrong.
        reason: String,
    },
}

/// Temperatures over time.
#[derive(Debug, Clone, PartialEq)]
pub struct Temperatures {
    /// (s, degrees Celsius), rising in time.
    points: Vec<(f64, f64)>,
}

impl Temperatures {
    /// Reads a table.
    ///
    /// # Errors
    /// Missing columns, what is no number, time that does not rise, no rows.
    pub fn read(file: &Path) -> Result<Self, TemperatureError> {
        let open = File::open(file).map_err(|source| TemperatureError::Io { file: file.to_owned(), source })?;
        let table = |line: u64, reason: String| TemperatureError::Table { file: file.to_owned(), line, reason };
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(open);
        let header = reader.headers().map_err(|error| table(1, error.to_string()))?.clone();
        let column = |name: &str| {
            let place = header.iter().position(|column| column == name);
            place.ok_or_else(|| table(1, format!("the column {name} is missing")))
        };
        let (time, temperature) = (column("time_s")?, column("temperature_degc")?);
        let mut points: Vec<(f64, f64)> = Vec::new();
        for record in reader.records() {
            let record = record.map_err(|error| {
                let line = error.position().map_or(0, csv::Position::line);
                table(line, format!("not a CSV row like its header ({error})"))
            })?;
            let line = record.position().map_or(0, csv::Position::line);
            let number = |column: usize, name: &str| {
                let text = record.get(column).unwrap_or_default();
                let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
                value.ok_or_else(|| table(line, format!("`{text}` in {name} is no number")))
            };
            // A station that missed a reading leaves the cell empty.
            if record.get(temperature).is_some_and(str::is_empty) {
                continue;
            }
            let point = (number(time, "time_s")?, number(temperature, "temperature_degc")?);
            if points.last().is_some_and(|last| last.0 >= point.0) {
                return Err(table(line, format!("time_s = {} does not rise", point.0)));
            }
            points.push(point);
        }
        if points.is_empty() { Err(table(1, "there is no row".to_owned())) } else { Ok(Self { points }) }
    }

    /// Mean of the readings between two times, or one interpolated between neighbours where no reading is within; `None` outside the
    /// table.
    pub fn mean_degc(&self, start_s: f64, end_s: f64) -> Option<f64> {
        let inside: Vec<f64> =
            self.points.iter().filter(|(time, _)| (start_s..end_s).contains(time)).map(|(_, value)| *value).collect();
        if !inside.is_empty() {
            return Some(inside.iter().sum::<f64>() / inside.len() as f64);
        }
        let middle_s = 0.5 * (start_s + end_s);
        let after = self.points.iter().position(|(time, _)| *time >= middle_s)?;
        let ((t0, v0), (t1, v1)) = (*self.points.get(after.checked_sub(1)?)?, self.points[after]);
        Some(v0 + (v1 - v0) * (middle_s - t0) / (t1 - t0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Temperatures, TemperatureError> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("weather.csv");
        std::fs::write(&file, text).unwrap();
        Temperatures::read(&file)
    }

    #[test]
    fn readings_are_averaged_within_an_interval_and_interpolated_across_one() {
        let table = read("# a station\ntime_s,wind,temperature_degc\n0,3,10\n1800,4,12\n2700,,\n3600,5,20\n").unwrap();
        assert_eq!(table.mean_degc(0.0, 3600.0), Some(11.0));
        assert_eq!(table.mean_degc(2400.0, 3000.0), Some(12.0 + 8.0 * 900.0 / 1800.0));
        assert_eq!(table.mean_degc(4000.0, 5000.0), None);
    }

    #[test]
    fn a_table_that_is_none_is_refused_with_its_line() {
        for (text, expected) in [
            ("time_s,degrees\n0,1\n", "temperature_degc is missing"),
            ("time_s,temperature_degc\n0,1\n5,warm\n", "weather.csv, line 3: `warm`"),
            ("time_s,temperature_degc\n0,1\n0,2\n", "weather.csv, line 3: time_s = 0 does not rise"),
            ("time_s,temperature_degc\n", "no row"),
            ("time_s,temperature_degc\n0,1\n1\n", "weather.csv, line 3"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        assert!(Temperatures::read(Path::new("nowhere.csv")).unwrap_err().to_string().contains("nowhere.csv"));
    }
}
