//! Which files a study's simulated recordings go to, and how `study.toml` comes to name them.

use std::fs;
use std::path::{Path, PathBuf};

use thiserror::Error;
use toml_edit::{Array, DocumentMut, Item, Value};

use crate::files::write_whole;
use crate::study::edit::with_line_ends_of;
use crate::study::{Setup, Study};

/// Where the recording of one setup goes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlannedRecording {
    /// The setup's name.
    pub setup: String,
    /// The file.
    pub path: PathBuf,
    /// What the setup's `files` must hold for the study to read this file; `None` where it does already.
    pub adopt_as: Option<String>,
}

/// Why recordings cannot be planned.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum PlanError {
    /// Nothing to simulate.
    #[error("the study has no [[setup]]; a simulation needs one to know sensors and sampling rate")]
    NoSetups,
    /// Two setups would share a file.
    #[error("setups {first} and {second} would both be written to {file}; rename one, or give them different files", file = .file.display())]
    SameFile {
        /// One setup.
        first: String,
        /// The other.
        second: String,
        /// Their file.
        file: PathBuf,
    },
}

/// Why `study.toml` was left as it was.
#[derive(Debug, Error)]
pub enum AdoptError {
    /// It cannot be read or written.
    #[error("{file}: {source}", file = .file.display())]
    Io {
        /// `study.toml`.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is not TOML.
    #[error("{file}: {source}", file = .file.display())]
    Toml {
        /// `study.toml`.
        file: PathBuf,
        /// Where and why.
        source: Box<toml_edit::TomlError>,
    },
    /// The setup does not stand in it.
    #[error("{file}: no [[setup]] with name = \"{setup}\"", file = .file.display())]
    NoSuchSetup {
        /// `study.toml`.
        file: PathBuf,
        /// The setup.
        setup: String,
    },
}

/// A file for each setup: the one its `files` name where that is a single plain `.npy` name, else
/// `simulated-<setup>.npy`; in `output` where given, else in the study's folder.
///
/// # Errors
/// [`PlanError`]: a study without setups, setups that would overwrite each other.
pub fn plan(study: &Study, output: Option<&Path>) -> Result<Vec<PlannedRecording>, PlanError> {
    let mut planned: Vec<PlannedRecording> = Vec::new();
    for setup in &study.setups {
        let own = plain_npy(setup);
        let name = own.map_or_else(|| format!("simulated-{}.npy", file_word(&setup.name)), ToOwned::to_owned);
        let path = match output {
            Some(folder) => folder.join(Path::new(&name).file_name().unwrap_or_default()),
            None => study.folder.join(&name),
        };
        if let Some(other) = planned.iter().find(|other| other.path == path) {
            return Err(PlanError::SameFile { first: other.setup.clone(), second: setup.name.clone(), file: path });
        }
        let reads_it = own.is_some_and(|own| same_file(&study.folder.join(own), &path));
        let adopt_as = (!reads_it).then(|| as_seen_from(&study.folder, &path));
        planned.push(PlannedRecording { setup: setup.name.clone(), path, adopt_as });
    }
    if planned.is_empty() { Err(PlanError::NoSetups) } else { Ok(planned) }
}

/// Makes the study in `folder` read the planned recordings: sets `files` of their setups in `study.toml` (and drops
/// `live`), keeping comments and order.
///
/// # Errors
/// [`AdoptError`]; the file is then as it was.
pub fn adopt(folder: &Path, planned: &[PlannedRecording]) -> Result<(), AdoptError> {
    let file = folder.join("study.toml");
    let io = |source| AdoptError::Io { file: file.clone(), source };
    let text = fs::read_to_string(&file).map_err(io)?;
    let mut document: DocumentMut =
        text.parse().map_err(|source| AdoptError::Toml { file: file.clone(), source: Box::new(source) })?;
    for recording in planned {
        let Some(name) = &recording.adopt_as else { continue };
        let no_such_setup = || AdoptError::NoSuchSetup { file: file.clone(), setup: recording.setup.clone() };
        let setups = document.get_mut("setup").and_then(Item::as_array_of_tables_mut).ok_or_else(no_such_setup)?;
        let is_it = |table: &&mut toml_edit::Table| {
            table.get("name").and_then(Item::as_str).is_some_and(|name| name == recording.setup)
        };
        let table = setups.iter_mut().find(is_it).ok_or_else(no_such_setup)?;
        let mut files = Value::Array(Array::from_iter([name.as_str()]));
        if let Some(old) = table.get("files").and_then(Item::as_value) {
            // The decor holds the blanks before the value and the comment after it.
            *files.decor_mut() = old.decor().clone();
        }
        match table.get_mut("files") {
            Some(item) => *item = Item::Value(files),
            None => drop(table.insert("files", Item::Value(files))),
        }
        // Only what is collected goes without a unit.
        if table.remove("live").is_some() && !table.contains_key("unit") {
            table.insert("unit", Item::Value("m/s2".into()));
        }
    }
    write_whole(&file, with_line_ends_of(&text, document.to_string()).as_bytes()).map_err(io)
}

fn plain_npy(setup: &Setup) -> Option<&str> {
    match setup.files.as_slice() {
        [file] if file.ends_with(".npy") && !file.contains(['*', '?', '[']) => Some(file),
        _ => None,
    }
}

/// A setup's name with everything that a file name had better not hold replaced.
fn file_word(name: &str) -> String {
    name.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '-' }).collect()
}

fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

fn same_file(one: &Path, other: &Path) -> bool {
    absolute(one) == absolute(other)
}

/// How `study.toml` names a file: relative to the study's folder where it lies inside. Where it does not, absolute, and
/// as a pattern that matches itself only.
fn as_seen_from(folder: &Path, path: &Path) -> String {
    let path = absolute(path);
    match path.strip_prefix(absolute(folder)) {
        Ok(inside) => glob::Pattern::escape(&inside.to_string_lossy()),
        Err(_) => glob::Pattern::escape(&path.to_string_lossy()),
    }
}
