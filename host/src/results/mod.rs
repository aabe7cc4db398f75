//! The folder `results` of a study: what the steps write there, and read of each other.
//!
//! JSON objects, tables and pictures flow in and appear whole or not at all; what an earlier step wrote flows out again.

mod history;
mod lines;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

use crate::files::{ready_folder, write_anew};
use crate::study::Study;
pub(crate) use lines::Lines;

/// The modes of `belfry identify`.
pub const MODES_FILE: &str = "modes.json";
/// The stabilisation diagrams of its subspaces, a setup each.
pub const STABILISATION_FILE: &str = "stabilisation.json";
/// The spectra that modes were identified from, for pictures.
pub const SPECTRA_FILE: &str = "spectra.json";
/// The recordings at one glance, for pictures.
pub const RECORD_FILE: &str = "record.json";
/// What recordings hold, at the last look.
pub const LOOK_FILE: &str = "look.json";
/// The last comparison.
pub const COMPARISON_FILE: &str = "comparison.json";
/// The last update.
pub const UPDATE_FILE: &str = "update.json";
/// The last co-validation.
pub const COVALIDATION_FILE: &str = "covalidation.json";
/// The last diagnosis.
pub const DIAGNOSIS_FILE: &str = "diagnosis.json";
/// The last comparison with an earlier measurement.
pub const CHANGE_FILE: &str = "change.json";
/// What the days of a watch say.
pub const WATCH_FILE: &str = "watch.json";
/// What the intervals of a watch show.
pub const INTERVALS_FILE: &str = "watch.jsonl";
/// The modes that a watch follows: those that `identify` had found when it began.
pub const REFERENCE_FILE: &str = "watch_reference.json";
/// What has become of a watch's alarms.
pub const ALARMS_FILE: &str = "alarms.jsonl";
/// How many lines of that each destination has got.
pub const TOLD_FILE: &str = "watch_told.json";
/// How the nodes of a watch are.
pub const NODES_FILE: &str = "watch_nodes.json";
/// The misfit of the last diagnosis beside what its candidates would do.
pub const FINGERPRINTS_FILE: &str = "fingerprints.json";
/// The same as a picture.
pub const FINGERPRINTS_PICTURE: &str = "fingerprints.svg";
/// The last plan of a measurement.
pub const PLAN_FILE: &str = "plan.json";
/// The last profile of stiffness and mass.
pub const PROFILE_FILE: &str = "profile.json";
/// Everything in one HTML file.
pub const REPORT_FILE: &str = "report.html";
/// What each result of the model was computed from: checksums by name.
pub const INPUTS_FILE: &str = "inputs.json";
/// The steps of the model, a JSON object a line.
pub const HISTORY_FILE: &str = "history.jsonl";

/// The schema of each result that is JSON, or JSON a line: `docs/schema` has a file of that name.
const SCHEMAS: [(&str, &str); 21] = [
    (MODES_FILE, "identify-1"),
    (STABILISATION_FILE, "stabilisation-1"),
    (SPECTRA_FILE, "spectra-1"),
    (RECORD_FILE, "record-1"),
    (LOOK_FILE, "look-1"),
    (COMPARISON_FILE, "compare-1"),
    (UPDATE_FILE, "update-1"),
    (COVALIDATION_FILE, "covalidate-1"),
    (DIAGNOSIS_FILE, "diagnose-1"),
    (CHANGE_FILE, "change-1"),
    (WATCH_FILE, "watch-1"),
    (INTERVALS_FILE, "watch-interval-1"),
    (REFERENCE_FILE, "watch-reference-1"),
    (ALARMS_FILE, "watch-event-1"),
    (TOLD_FILE, "watch-told-1"),
    (NODES_FILE, "watch-nodes-1"),
    (FINGERPRINTS_FILE, "fingerprints-1"),
    (PLAN_FILE, "plan-1"),
    (PROFILE_FILE, "profile-1"),
    (INPUTS_FILE, "inputs-1"),
    (HISTORY_FILE, "step-1"),
];

/// A JSON object with the name and version of its schema: `docs/schema` has a file of that name for it. A key that goes, or that means
/// something else, makes a new version; a key that comes does not.
#[derive(Debug, Serialize)]
pub struct Versioned<'a, T> {
    #[serde(skip_serializing_if = "Option::is_none")]
    schema: Option<&'static str>,
    #[serde(flatten)]
    object: &'a T,
}

impl<'a, T> Versioned<'a, T> {
    /// An object of this schema.
    pub fn new(schema: &'static str, object: &'a T) -> Self {
        Self { schema: Some(schema), object }
    }

    /// An object of the schema that a result of this name has.
    fn of_result(name: &str, object: &'a T) -> Self {
        let schema = SCHEMAS.iter().find(|(file, _)| *file == name).map(|(_, schema)| *schema);
        Self { schema, object }
    }
}

/// Why a result could not be written or read.
#[derive(Debug, Error)]
pub enum ResultsError {
    /// Nothing can be written into the folder.
    #[error("cannot write into {}; results go there", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file cannot be written.
    #[error("cannot write {}", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file cannot be read.
    #[error("cannot read {}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file is not what a step of Belfry writes.
    #[error("{}, line {line}: not what `belfry {step}` writes; move the file away, or run that again", file.display())]
    Syntax {
        /// The file.
        file: PathBuf,
        /// 1-based line.
        line: usize,
        /// The command that writes such files.
        step: &'static str,
        /// What is wrong.
        source: serde_json::Error,
    },
}

/// A study's folder of results.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Results {
    folder: PathBuf,
}

impl Results {
    /// The folder of a study's results; it need not exist yet.
    pub fn of(study: &Study) -> Self {
        Self::in_study(&study.folder)
    }

    /// The same of a folder that may become a study's.
    pub(crate) fn in_study(folder: &Path) -> Self {
        Self { folder: folder.join("results") }
    }

    /// Where it is.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The path of a result.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Makes the folder where there is none, and makes sure that it can be written to: worth knowing before hours of recording
    /// are read.
    ///
    /// # Errors
    /// [`ResultsError::Folder`].
    pub fn make_ready(&self) -> Result<(), ResultsError> {
        let failed = |source| ResultsError::Folder { folder: self.folder.clone(), source };
        self.is_own().and_then(|()| ready_folder(&self.folder)).map_err(failed)
    }

    /// A study from someone else may have a link here, to a folder of the user's: nothing is written behind one.
    fn is_own(&self) -> io::Result<()> {
        match fs::symlink_metadata(&self.folder) {
            Ok(found) if found.is_symlink() => Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                "it is a link, and files where it leads would be replaced; remove it, or move the whole study there",
            )),
            _ => Ok(()),
        }
    }

    /// Writes a file and returns its path.
    ///
    /// # Errors
    /// [`ResultsError::Write`].
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<PathBuf, ResultsError> {
        let file = self.path(name);
        match self.is_own().and_then(|()| write_anew(&file, bytes)) {
            Ok(()) => Ok(file),
            Err(source) => Err(ResultsError::Write { file, source }),
        }
    }

    /// Removes a file, where it is there.
    ///
    /// # Errors
    /// [`ResultsError::Write`].
    pub fn remove(&self, name: &str) -> Result<(), ResultsError> {
        let file = self.path(name);
        match self.is_own().and_then(|()| std::fs::remove_file(&file)) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => Err(ResultsError::Write { file, source }),
            _ => Ok(()),
        }
    }

    /// Writes an object as JSON that names its schema, and returns its path.
    ///
    /// # Errors
    /// [`ResultsError::Write`].
    pub fn write_json(&self, name: &str, object: &impl Serialize) -> Result<PathBuf, ResultsError> {
        let text = serde_json::to_string_pretty(&Versioned::of_result(name, object))
            .map_err(|error| ResultsError::Write { file: self.path(name), source: error.into() })?;
        self.write(name, (text + "\n").as_bytes())
    }

    /// The same on one line, for files that nobody reads.
    ///
    /// # Errors
    /// [`ResultsError::Write`].
    pub fn write_json_short(&self, name: &str, object: &impl Serialize) -> Result<PathBuf, ResultsError> {
        let text = serde_json::to_string(&Versioned::of_result(name, object))
            .map_err(|error| ResultsError::Write { file: self.path(name), source: error.into() })?;
        self.write(name, (text + "\n").as_bytes())
    }

    /// Reads the JSON that `step` wrote; `None` where it has not been run.
    ///
    /// # Errors
    /// When the file cannot be read, or holds something else.
    pub fn read_json<T: DeserializeOwned>(&self, name: &str, step: &'static str) -> Result<Option<T>, ResultsError> {
        let file = self.path(name);
        let Some(text) = self.read(name)? else { return Ok(None) };
        let object = serde_json::from_str(&text);
        object.map(Some).map_err(|source| ResultsError::Syntax { file, line: source.line(), step, source })
    }

    /// The text of a file; `None` where there is none.
    fn read(&self, name: &str) -> Result<Option<String>, ResultsError> {
        let file = self.path(name);
        match fs::read_to_string(&file) {
            Ok(text) => Ok(Some(text)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(ResultsError::Read { file, source }),
        }
    }
}
