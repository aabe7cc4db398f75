//! Temperature beside a recording: a CSV table `time_s,temperature_degc`, time counted from the recording's first row; of a live
//! setup in Unix time. A live setup without a table has what its nodes' sensors say of themselves.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::heartbeats::{self, HEARTBEATS_FILE};
use crate::study::Setup;

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
    /// What nodes have said cannot be read.
    #[error("{}, what nodes have said of themselves: {source}", file.display())]
    Heartbeats {
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

    /// The temperatures of a setup of the study in `folder`: of the table that it names, or else of one of its nodes, and which. That is the one
    /// that has said most, as others are in the sun at other times; the lowest number of several.
    ///
    /// # Errors
    /// Where the table is none, or what nodes have said cannot be read.
    pub fn of_setup(setup: &Setup, folder: &Path) -> Result<Option<(Self, Option<u16>)>, TemperatureError> {
        if let Some(file) = &setup.temperature {
            return Ok(Some((Self::read(&folder.join(file))?, None)));
        }
        if !setup.live {
            return Ok(None);
        }
        let mut of_nodes: BTreeMap<u16, Vec<(f64, f64)>> = BTreeMap::new();
        let take = |heartbeat: heartbeats::KeptHeartbeat| {
            let is_of_setup = setup.sensors.iter().any(|sensor| sensor.node == heartbeat.node);
            if let (true, Some(degrees)) = (is_of_setup, heartbeat.temperature_degc) {
                of_nodes.entry(heartbeat.node).or_default().push((heartbeat.time_s, degrees));
            }
        };
        heartbeats::read(folder, take)
            .map_err(|source| TemperatureError::Heartbeats { file: folder.join(HEARTBEATS_FILE), source })?;
        let most = of_nodes.into_iter().rev().max_by_key(|(_, points)| points.len());
        Ok(most.map(|(node, mut points)| {
            // The computer's clock may have been set back.
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            points.dedup_by(|later, earlier| later.0 == earlier.0);
            (Self { points }, Some(node))
        }))
    }

    /// Mean of the readings between two times, or one interpolated between neighbours where no reading is within; `None` outside the
    /// table.
    pub fn mean_degc(&self, start_s: f64, end_s: f64) -> Option<f64> {
        let first_from = |from_s: f64| self.points.partition_point(|(time, _)| *time < from_s);
        let inside = self.points.get(first_from(start_s)..first_from(end_s)).unwrap_or_default();
        if !inside.is_empty() {
            return Some(inside.iter().map(|(_, value)| value).sum::<f64>() / inside.len() as f64);
        }
        let middle_s = 0.5 * (start_s + end_s);
        let after = first_from(middle_s);
        let ((t0, v0), (t1, v1)) = (*self.points.get(after.checked_sub(1)?)?, *self.points.get(after)?);
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
    fn a_live_setup_without_a_table_has_the_temperatures_of_the_node_that_says_most() {
        let folder = tempfile::tempdir().unwrap();
        let text = "[structure]\nname = \"t\"\n[[setup]]\nname = \"a\"\nlive = true\nsampling_rate_hz = 1000\n[[setup.sensor]]\nchannel = \"x\"\nnode = 1\n[[setup.sensor]]\nchannel = \"y\"\nnode = 2\n[analysis]\nband_hz = [0.1, 1.0]\n";
        let mut setup = crate::study::Study::from_text(text, folder.path()).unwrap().setups.remove(0);
        assert_eq!(Temperatures::of_setup(&setup, folder.path()).unwrap(), None);
        // Node 9 is of another setup, node 1 has no sensor for a while, and two lines are late.
        let line = |time_s: f64, node: u16, degrees: Option<f64>| {
            let degrees = degrees.map_or(String::new(), |degrees| format!(",\"temperature_degc\":{degrees}"));
            format!("{{\"time_s\":{time_s:?},\"node\":{node},\"boot\":1{degrees}}}\n")
        };
        let mut lines = String::new();
        for minute in (0..60).step_by(2) {
            let time_s = 60.0 * f64::from(minute);
            lines += &line(time_s, 9, Some(50.0));
            lines += &line(time_s + 1.0, 1, (minute > 20).then_some(30.0));
            if minute != 30 {
                lines += &line(time_s + 2.0, 2, Some(20.0 + f64::from(minute)));
            }
        }
        lines += &line(1802.0, 2, Some(50.0));
        lines += "half a line";
        std::fs::write(folder.path().join(HEARTBEATS_FILE), lines).unwrap();
        let (table, node) = Temperatures::of_setup(&setup, folder.path()).unwrap().unwrap();
        assert_eq!(node, Some(2));
        // Minutes 28, 30 and 32.
        assert_eq!(table.mean_degc(1680.0, 1930.0), Some(50.0));
        assert_eq!(table.mean_degc(1683.0, 1700.0), Some(48.0 + 2.0 * 9.5 / 120.0));
        assert_eq!(table.mean_degc(4000.0, 5000.0), None);
        setup.live = false;
        assert_eq!(Temperatures::of_setup(&setup, folder.path()).unwrap(), None);
        // A table that study.toml names comes first.
        setup.temperature = Some("weather.csv".into());
        std::fs::write(folder.path().join("weather.csv"), "time_s,temperature_degc\n0,1\n").unwrap();
        assert_eq!(Temperatures::of_setup(&setup, folder.path()).unwrap().unwrap().1, None);
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
