//! Files that a user brings: the study, tables, matrices and recordings.

use std::fs;
use std::path::{Path, PathBuf};

use belfry_host::model::{BeamTable, ImportedMatrices};
use belfry_host::record::mat::{read_matrix, variables};
use belfry_host::record::{Block, Recording};
use belfry_host::study::{LayoutFile, MatrixSource, MatrixTerm, Setup, Study};

/// Longer recordings are opened and not read.
const MOST_RECORDED: u64 = 1 << 18;

thread_local! {
    /// Where files are written.
    static FOLDER: tempfile::TempDir = crate::folder_in_memory().expect("a folder for files");
}

/// Larger models are refused by the memory that they take, which depends on the computer; smaller ones are checked quickly.
const MOST_ROWS: u64 = 300;

/// Writes a file; its folder.
fn write(name: &str, bytes: &[u8]) -> PathBuf {
    FOLDER.with(|folder| {
        fs::write(folder.path().join(name), bytes).expect("the folder takes files");
        folder.path().to_owned()
    })
}

/// A message names the file that it is about, and is short. (What may not be printed is left out where it is printed.)
fn check(message: &str, name: &str) {
    assert!(message.contains(name), "no `{name}` in: {message}");
    assert!(message.len() < 1024, "a message of {} bytes", message.len());
}

/// A study.toml.
///
/// # Panics
/// Where reading it does, or the message does not name the file.
pub fn study(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    if let Err(error) = Study::from_text(&text, Path::new("tower")) {
        check(&error.to_string(), "study.toml");
    }
}

/// A beam table.
///
/// # Panics
/// As [`study`].
pub fn beam(bytes: &[u8]) {
    if let Err(error) = BeamTable::from_reader(bytes, Path::new("beam.csv")) {
        check(&error.to_string(), "beam.csv");
    }
}

fn source(name: &str) -> MatrixSource {
    let term = || vec![MatrixTerm { name: name.to_owned(), factor: 1.0 }];
    MatrixSource { file: None, stiffness: term(), mass: term(), layout: None }
}

/// The nodes of a model that is given as matrices, and the same as its DOFs.
///
/// # Panics
/// As [`study`].
pub fn layout(bytes: &[u8]) {
    let sound = "%%MatrixMarket matrix coordinate real symmetric\n10 10 10\n1 1 1\n2 2 1\n3 3 1\n4 4 1\n5 5 1\n6 6 1\n7 7 1\n8 8 1\n9 9 1\n10 10 1\n";
    write("sound.mtx", sound.as_bytes());
    let folder = write("layout.csv", bytes);
    for layout in [LayoutFile::Nodes("layout.csv".into()), LayoutFile::Dofs("layout.csv".into())] {
        let source = MatrixSource { layout: Some(layout), ..source("sound.mtx") };
        if let Err(error) = ImportedMatrices::read(&source, &folder) {
            check(&error.to_string(), "layout.csv");
        }
    }
    write("named.mtx", b"1,1, 1,1, 1.0\n2,3, 2,3, 1.0\n");
    for name in ["layout.unv", "layout.bdf"] {
        let folder = write(name, bytes);
        let layout = LayoutFile::Numbered { file: name.into(), factor: 1.0 };
        let source = MatrixSource { layout: Some(layout), ..source("named.mtx") };
        if let Err(error) = ImportedMatrices::read(&source, &folder) {
            check(&error.to_string(), name);
        }
    }
}

/// A model's matrix as a Matrix Market file.
///
/// # Panics
/// As [`study`].
pub fn mtx(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let sizes = text.lines().find(|line| !line.starts_with('%') && !line.trim().is_empty()).unwrap_or_default();
    if sizes.split_whitespace().take(2).any(|word| word.parse().is_ok_and(|rows: u64| rows > MOST_ROWS)) {
        return;
    }
    let folder = write("k.mtx", bytes);
    read_source(&source("k.mtx"), &folder, "k.mtx");
}

/// A model's matrix as a NumPy file.
///
/// # Panics
/// As [`study`].
pub fn npy_matrix(bytes: &[u8]) {
    let folder = write("k.npy", bytes);
    read_source(&source("k.npy"), &folder, "k.npy");
}

/// A model's matrices in a MATLAB file.
///
/// # Panics
/// As [`study`].
pub fn mat_matrix(bytes: &[u8]) {
    let folder = write("k.mat", bytes);
    let file = folder.join("k.mat");
    for variable in variables(&file).unwrap_or_default() {
        if variable.dimensions.iter().any(|&length| length > MOST_ROWS) {
            continue;
        }
        if let Err(error) = read_matrix(&file, &variable.name) {
            check(&error.to_string(), "k.mat");
        }
        let source = MatrixSource { file: Some("k.mat".into()), ..source(&variable.name) };
        // The sum of what a file holds is named by what it is.
        let _ = ImportedMatrices::read(&source, &folder);
    }
}

fn read_source(source: &MatrixSource, folder: &Path, name: &str) {
    if let Err(error) = ImportedMatrices::read(source, folder) {
        let message = error.to_string();
        // What is wrong with the sum is said of the sum.
        check(&message, if message.starts_with("the summed") { "row" } else { name });
    }
}

/// A setup of these channels, recorded in this file at 50 Hz.
fn setup(channels: &[&str], name: &str) -> Setup {
    let mut text = format!(
        "[structure]\nname = \"Mast\"\n[[setup]]\nname = \"now\"\nfiles = [\"{name}\"]\nsampling_rate_hz = 50\nunit = \"m/s2\"\n"
    );
    for channel in channels {
        text += &format!("[[setup.sensor]]\nchannel = \"{channel}\"\nnode = 1\n");
    }
    text += "[analysis]\nband_hz = [0.5, 10.0]\n";
    Study::from_text(&text, Path::new("tower")).expect("a sound study").setups.remove(0)
}

/// Reads a recording through; the rows are as many as were counted beforehand.
fn record(ending: &str, bytes: &[u8]) {
    let name = format!("a.{ending}");
    let folder = write(&name, bytes);
    for channels in [&["1"][..], &["2", "a"], &["a"]] {
        if let Err(error) = read(&setup(channels, &name), &folder) {
            check(&error, &name);
        }
    }
}

fn read(setup: &Setup, folder: &Path) -> Result<(), String> {
    let told = |error: belfry_host::record::RecordError| error.to_string();
    let mut recording = Recording::open(setup, folder).map_err(told)?;
    // A damaged time may leave a gap of millions of rows, which takes long to go through.
    if recording.total_rows().is_ok_and(|rows| rows > MOST_RECORDED) {
        return Ok(());
    }
    let mut block = Block::new();
    let mut rows = 0;
    while recording.next_block(&mut block).map_err(told)? {
        assert_eq!(block.channels(), setup.sensors.len());
        rows += block.row_count() as u64;
    }
    assert_eq!(recording.total_rows().map_err(told)?, rows, "rows were counted that are not there");
    assert_eq!(recording.finish().rows, rows);
    Ok(())
}

/// A recording as text between white space.
///
/// # Panics
/// As [`study`], or where the rows read are not those counted.
pub fn white_space(bytes: &[u8]) {
    record("txt", bytes);
}

/// A recording as a CSV table.
///
/// # Panics
/// As [`white_space`].
pub fn table(bytes: &[u8]) {
    record("csv", bytes);
}

/// A recording as a NumPy file.
///
/// # Panics
/// As [`white_space`].
pub fn npy(bytes: &[u8]) {
    record("npy", bytes);
}

/// A recording as a MATLAB file.
///
/// # Panics
/// As [`white_space`].
pub fn mat(bytes: &[u8]) {
    record("mat", bytes);
}

/// A recording as a Parquet file.
///
/// # Panics
/// As [`white_space`].
pub fn parquet(bytes: &[u8]) {
    record("parquet", bytes);
}

/// A recording as a universal file.
///
/// # Panics
/// As [`white_space`].
pub fn uff(bytes: &[u8]) {
    record("uff", bytes);
}

/// A recording as an HDF5 file.
///
/// # Panics
/// As [`white_space`].
pub fn hdf5(bytes: &[u8]) {
    record("h5", bytes);
}

/// A recording as a WAV file.
///
/// # Panics
/// As [`white_space`].
pub fn wav(bytes: &[u8]) {
    record("wav", bytes);
}

/// A recording as a SAC file.
///
/// # Panics
/// As [`white_space`].
pub fn sac(bytes: &[u8]) {
    record("sac", bytes);
}

/// A recording as a miniSEED file.
///
/// # Panics
/// As [`white_space`].
pub fn mseed(bytes: &[u8]) {
    record("mseed", bytes);
}

/// A recording as a TDMS file.
///
/// # Panics
/// As [`white_space`].
pub fn tdms(bytes: &[u8]) {
    record("tdms", bytes);
}

/// A recording as a UDBF file.
///
/// # Panics
/// As [`white_space`].
pub fn udbf(bytes: &[u8]) {
    record("udbf", bytes);
}

/// A model's matrices as Nastran's DMIG, and as Abaqus' lines of nodes.
///
/// # Panics
/// As [`study`].
pub fn dmig(bytes: &[u8]) {
    let folder = write("k.bdf", bytes);
    let nastran = MatrixSource { file: Some("k.bdf".into()), ..source("KAAX") };
    read_source(&nastran, &folder, "k.bdf");
    write("k.mtx", bytes);
    if !bytes.starts_with(b"%") {
        read_source(&source("k.mtx"), &folder, "k.mtx");
    }
}
