//! What recordings say of themselves, before a study describes them: channels, rates, units, lengths and times.
//!
//! Paths flow in; one [`Surveyed`] for each run of files with the same channels and rate flows out. What files do not say stays unknown.

use std::path::{Path, PathBuf};

use super::clock::Clock;
use super::columns::{Columns, is_time_column};
use super::error::RecordError;
use super::source_file::SourceFile;
use super::traces;
use crate::study::Setup;

/// No recording has this rate: a reader that compares it with its own says what that is.
const NO_RATE_HZ: f64 = 1e-12;
/// Rates that differ less, relatively, are one.
const SAME_RATE: f64 = 1e-3;

/// Files that may become a setup.
#[derive(Debug, Clone, PartialEq)]
pub struct Surveyed {
    /// In the order of time, or each with channels or parts of them.
    pub files: Vec<PathBuf>,
    /// In the files' order.
    pub channels: Vec<SurveyedChannel>,
    /// Rows a second, of most channels; `None` where the files do not say it.
    pub rate_hz: Option<f64>,
    /// Rows of all files together.
    pub rows: u64,
    /// When the first row was, in UTC, where the files say it.
    pub start_utc: Option<String>,
}

impl Surveyed {
    /// Whether a channel has the rate of most, or says none.
    pub fn is_at_rate(&self, channel: &SurveyedChannel) -> bool {
        let is_other = |(rate_hz, of_most_hz): (f64, f64)| (rate_hz / of_most_hz - 1.0).abs() > SAME_RATE;
        !channel.rate_hz.zip(self.rate_hz).is_some_and(is_other)
    }
}

/// A channel as its file describes it.
#[derive(Debug, Clone, PartialEq)]
pub struct SurveyedChannel {
    /// What a sensor's `channel` would be.
    pub name: String,
    /// Its own rate.
    pub rate_hz: Option<f64>,
    /// The word for its unit that study.toml has, where it is one of these.
    pub unit: Option<&'static str>,
    /// The file's own word for it.
    pub unit_as_written: Option<String>,
}

/// Looks into files.
///
/// # Errors
/// [`RecordError`] names the file that cannot be read, or whose format is unknown.
pub fn survey(paths: Vec<PathBuf>) -> Result<Vec<Surveyed>, RecordError> {
    let mut found: Vec<(Columns, Surveyed)> = Vec::new();
    for file in SourceFile::all(paths)? {
        let (columns, one) = survey_one(&file)?;
        let is_same = |other: &(Columns, Surveyed)| {
            other.0 == columns
                && match (other.1.rate_hz, one.rate_hz) {
                    (Some(a), Some(b)) => (a / b - 1.0).abs() < SAME_RATE,
                    (a, b) => a == b,
                }
        };
        match found.last_mut().filter(|last| is_same(last)) {
            Some((_, last)) => {
                last.files.extend(one.files);
                last.rows += one.rows;
            }
            None => found.push((columns, one)),
        }
    }
    Ok(found.into_iter().map(|(_, one)| one).collect())
}

fn survey_one(file: &SourceFile) -> Result<(Columns, Surveyed), RecordError> {
    let asked = Setup::new("", NO_RATE_HZ, Vec::new());
    let (columns, of_times_hz) = match file.inspect(&asked) {
        Ok(columns) => (columns, None),
        Err(RecordError::RateDiffers { measured_hz, .. }) => {
            // With its own rate its columns are told.
            (file.inspect(&Setup { sampling_rate_hz: measured_hz, ..asked.clone() })?, Some(rounded(measured_hz)))
        }
        Err(error) => return Err(error),
    };
    let said = file.said(&asked)?;
    let names: Vec<String> = match &columns {
        Columns::Named(names) | Columns::Paths(names) => names.clone(),
        Columns::Numbered(count) => (1..=*count).map(|number| number.to_string()).collect(),
        Columns::Responses(names) => names.iter().map(ToString::to_string).collect(),
    };
    let is_time = |name: &str| matches!(columns, Columns::Named(_)) && is_time_column(name, &[]);
    let channels: Vec<SurveyedChannel> = (0..)
        .zip(names)
        .filter(|(_, name)| !is_time(name))
        .map(|(at, name)| {
            let (rate_hz, unit_as_written) = said.channels.get::<usize>(at).cloned().unwrap_or_default();
            let unit = unit_as_written.as_deref().and_then(unit_of);
            SurveyedChannel { name, rate_hz: rate_hz.map(rounded).or(of_times_hz), unit, unit_as_written }
        })
        .collect();
    let rate_hz = most_common(channels.iter().filter_map(|channel| channel.rate_hz));
    let counted = Setup { sampling_rate_hz: rate_hz.unwrap_or(1.0), ..asked };
    let rows = file.count_rows(&counted, &mut Clock::new(counted.sampling_rate_hz))?;
    let start_utc = said.start_ns.filter(|start_ns| *start_ns > 0).map(traces::utc);
    let files = file.paths().map(Path::to_path_buf).collect();
    Ok((columns, Surveyed { files, channels, rate_hz, rows, start_utc }))
}

/// A rate without what single precision and the rounding of times make of it: 50 and not 49.99999.
fn rounded(rate_hz: f64) -> f64 {
    const AS_GOOD_AS_WHOLE: f64 = 1e-5;
    let whole = rate_hz.round();
    if whole > 0.0 && (rate_hz / whole - 1.0).abs() < AS_GOOD_AS_WHOLE { whole } else { rate_hz }
}

fn most_common(rates_hz: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    let same = |one: f64| rates_hz.clone().filter(|other| (other / one - 1.0).abs() < SAME_RATE).count();
    rates_hz.clone().max_by_key(|rate_hz| same(*rate_hz))
}

/// The unit of study.toml that a file's word stands for.
fn unit_of(written: &str) -> Option<&'static str> {
    let plain: String = written.chars().filter(|c| !matches!(c, ' ' | '^' | '*' | '[' | ']' | '(' | ')')).collect();
    Some(match plain.replace('²', "2").to_lowercase().as_str() {
        "m/s2" | "m/s/s" | "ms-2" | "m/sec2" | "m.s-2" => "m/s2",
        "g" | "gn" | "g0" | "grav" => "g",
        "v" | "volt" | "volts" => "V",
        "m/s" | "ms-1" | "m/sec" => "m/s",
        "m" | "meter" | "metre" | "meters" | "metres" => "m",
        "rad" | "radian" | "radians" => "rad",
        "strain" | "m/m" => "strain",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn look(names: &[&str]) -> Vec<Surveyed> {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests-data"));
        survey(names.iter().map(|name| folder.join(name)).collect()).unwrap()
    }

    fn names(one: &Surveyed) -> Vec<&str> {
        one.channels.iter().map(|channel| channel.name.as_str()).collect()
    }

    #[test]
    fn files_of_other_programs_say_channels_rates_and_units() {
        for (file, channels, units) in [
            ("h5py_channels.h5", ["run 1/top-x", "run 1/top-y"], Some("m/s2")),
            ("h5py_matrix.h5", ["1", "2"], None),
            ("soundfile_pcm24.wav", ["1", "2"], None),
            ("obspy_steim2.mseed", ["XX.MAST.00.HNX", "XX.MAST.00.HNY"], None),
            ("interleaved.tdms", ["run 1/top-x", "run 1/top-y"], None),
        ] {
            let found = look(&[file]);
            assert_eq!(found.len(), 1);
            assert_eq!(
                (names(&found[0]), found[0].rate_hz, found[0].rows),
                (channels.to_vec(), Some(50.0), 300),
                "{file}"
            );
            assert!(found[0].channels.iter().all(|channel| channel.unit == units), "{file}");
        }
        let tdms = &look(&["nptdms.tdms"])[0];
        // Its channel of words is none.
        assert_eq!(names(tdms), ["run 1/top-x", "run 1/top-y"]);
        assert_eq!(tdms.channels[0].unit, Some("m/s2"));
        assert_eq!(tdms.channels[0].unit_as_written.as_deref(), Some("m/s^2"));
        let numbers = &look(&["same.npy"])[0];
        assert_eq!((names(numbers), numbers.rate_hz, numbers.rows), (vec!["1", "2"], None, 300));
    }

    #[test]
    fn loggers_say_units_and_when_they_began() {
        let one = &look(&["gantner.dat"])[0];
        assert_eq!((one.rate_hz, one.rows, one.channels[5].name.as_str()), (Some(1000.0), 500, "TC1"));
        assert_eq!(one.channels[5].unit_as_written.as_deref(), Some("°C"));
        let one = &look(&["udbf_little.dat"])[0];
        assert_eq!((names(one), one.rate_hz, one.rows), (vec!["top-x", "top-y"], Some(50.0), 300));
        assert_eq!(one.channels[0].unit, Some("m/s2"));
        assert_eq!(one.start_utc.as_deref(), Some("2026-03-01T12:00:00.250Z"));
        let folder = tempfile::tempdir().unwrap();
        let table = folder.path().join("a.csv");
        std::fs::write(&table, "time,x\ns,g\n1772366400.25,1\n1772366400.27,2\n1772366400.29,3\n").unwrap();
        let one = &survey(vec![table]).unwrap()[0];
        assert_eq!(
            (one.rate_hz.map(f64::round), one.start_utc.as_deref()),
            (Some(50.0), Some("2026-03-01T12:00:00.250Z"))
        );
        assert_eq!(one.channels[0].unit, Some("g"));
    }

    #[test]
    fn a_time_column_says_the_rate_and_is_no_channel() {
        let table = &look(&["pyarrow_gzip.parquet"])[0];
        assert_eq!(table.rate_hz, Some(50.0));
        assert!(!names(table).contains(&"time_s"));
    }

    #[test]
    fn traces_share_a_line_of_time_and_others_become_setups_of_their_own() {
        let found = look(&["obspy_HNX.sac", "obspy_HNY.sac", "soundfile_float.wav", "soundfile_pcm24.wav"]);
        assert_eq!(found.iter().map(|one| one.files.len()).collect::<Vec<_>>(), [2, 2]);
        assert_eq!(names(&found[0]), ["XX.MAST.00.HNX", "XX.MAST.00.HNY"]);
        assert_eq!(found[0].start_utc.as_deref(), Some("2026-03-01T12:00:00.000Z"));
        assert_eq!(found[1].rows, 600);
        let parts = look(&["obspy_part1.mseed", "obspy_part2.mseed"]);
        assert_eq!((parts.len(), parts[0].rows, parts[0].rate_hz), (1, 300, Some(50.0)));
    }
}
