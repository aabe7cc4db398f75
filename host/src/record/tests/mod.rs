//! Recordings of every format, written to a temporary folder and read back.

mod arrays;
mod csv;
mod foreign;
mod hdf5;
mod lanes;
mod matlab;
mod parquet;
mod properties;
mod report;
mod universal;
mod white_space;

use std::path::Path;

use super::{Block, RecordError, RecordReport, Recording};
use crate::study::{Sensor, Setup, Unit};

/// A setup of channels at 50 Hz, in m/s².
fn setup(channels: &[&str], files: &[&str]) -> Setup {
    Setup {
        name: "january".to_owned(),
        files: files.iter().map(|file| (*file).to_owned()).collect(),
        live: false,
        block_s: None,
        utc_offset_h: None,
        variable: None,
        sampling_rate_hz: 50.0,
        unit: Unit::MetrePerSecondSquared,
        temperature: None,
        sensors: channels.iter().map(|channel| Sensor::new(*channel, 1)).collect(),
    }
}

/// Files of the given contents in a new folder.
fn folder(files: &[(&str, &[u8])]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, content) in files {
        std::fs::write(folder.path().join(name), content).unwrap();
    }
    folder
}

/// All rows and the report; checks on the way that the count made beforehand is that of the rows.
fn read(setup: &Setup, folder: &Path) -> Result<(Vec<Vec<f64>>, RecordReport), RecordError> {
    let mut recording = Recording::open(setup, folder)?;
    let mut block = Block::new();
    let mut rows = Vec::new();
    while recording.next_block(&mut block)? {
        assert_eq!(block.channels(), setup.sensors.len());
        assert!((1..=4096).contains(&block.row_count()));
        assert_eq!(block.rows().len(), block.row_count());
        rows.extend(block.rows().map(<[f64]>::to_vec));
    }
    assert_eq!(block.row_count(), 0);
    assert_eq!(recording.total_rows()?, rows.len() as u64);
    let report = recording.finish();
    assert_eq!(report.rows, rows.len() as u64);
    Ok((rows, report))
}

/// The rows of one file of the given name and content.
fn rows_of(setup: &Setup, name: &str, content: &[u8]) -> Vec<Vec<f64>> {
    read(setup, folder(&[(name, content)]).path()).unwrap().0
}

/// That a file reads, with one sample that is told at its place as none that a sensor can give, and counts as missing.
fn expect_impossible(setup: &Setup, name: &str, content: &[u8], parts: &[&str]) {
    let (rows, report) = read(setup, folder(&[(name, content)]).path()).unwrap();
    assert_eq!(rows.iter().flatten().filter(|value| value.is_nan()).count(), 1, "{rows:?}");
    assert_eq!(report.channels.iter().map(|channel| channel.missing).sum::<u64>(), 1);
    let told: Vec<String> = report.warnings.iter().map(ToString::to_string).collect();
    let is_told = |told: &&String| {
        told.contains("1 sample that no sensor can give") && parts.iter().all(|part| told.contains(part))
    };
    assert_eq!(told.iter().filter(is_told).count(), 1, "{parts:?} in {told:?}");
}

/// The error text of one file, which must hold all of `parts`.
fn expect_error(setup: &Setup, files: &[(&str, &[u8])], parts: &[&str]) {
    let folder = folder(files);
    let text = read(setup, folder.path()).expect_err("the recording should be refused").to_string();
    for part in parts {
        assert!(text.contains(part), "`{part}` is not in: {text}");
    }
}
