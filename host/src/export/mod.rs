//! Export: what Belfry found, as files that other tools read.
//!
//! Modes ([`modes`]) flow out as universal files ([`universal`]) and as tables ([`table`]); [`crate::modes`] reads back the former, and the
//! latter as CSV. A model with its effects ([`model`]) flows out as matrices that [`crate::model`] reads back; averaged spectra and the lines of
//! every window ([`spectra`]) as Parquet or CSV, the lines while they are measured. A file appears whole or not at all.

pub(crate) mod intervals;
pub mod model;
pub mod modes;
mod parquet;
pub mod rows;
pub mod spectra;
pub mod table;
pub mod universal;
mod universal_model;

#[cfg(test)]
mod model_tests;
#[cfg(test)]
mod tests;

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::files::write_whole;
use crate::model::effect::EffectError;
use crate::model::{EigenError, TooManyUnknowns};

/// Why something could not be exported.
#[derive(Debug, Error)]
pub enum ExportError {
    /// There are no modes yet.
    #[error("{}: the study has no modes yet; run `belfry identify {}` first", file.display(), study.display())]
    NoModes {
        /// Where they should be.
        file: PathBuf,
        /// The study's folder.
        study: PathBuf,
    },
    /// None were found.
    #[error("{}: no modes were found, so there is nothing to export; widen band_hz or measure longer", file.display())]
    Empty {
        /// The file.
        file: PathBuf,
    },
    /// The model is known by its modes alone.
    #[error("a model of modes ([model] modes) has no matrices to export; the program that computed the modes has them")]
    NoMatrices,
    /// Full matrices do not fit into memory.
    #[error("NumPy files hold full matrices: {0}; without --format npy they are written with what is not zero")]
    TooLarge(TooManyUnknowns),
    /// The file of modes cannot be opened.
    #[error("{}: cannot be read ({source})", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file of modes is not what `identify` writes.
    #[error("{}, line {}: not the modes of `belfry identify` ({source}); run it again", file.display(), source.line())]
    Syntax {
        /// The file.
        file: PathBuf,
        /// What is wrong, and where.
        source: serde_json::Error,
    },
    /// The modes are of other sensors than the study's.
    #[error(
        "{}, mode {number}: `{channel}` is no channel of the study; run `belfry identify` again after changing sensors",
        file.display()
    )]
    UnknownChannel {
        /// The file.
        file: PathBuf,
        /// The mode.
        number: usize,
        /// The name in the file.
        channel: String,
    },
    /// A channel's name is that of another column of the table.
    #[error(
        "channel `{channel}` cannot be a column of the table of modes: `{column}` is another column; rename the channel, or export as uff55 or json"
    )]
    ColumnTwice {
        /// The channel.
        channel: String,
        /// The column.
        column: String,
    },
    /// The model has no modes.
    #[error("the model: {0}")]
    Eigen(#[from] EigenError),
    /// An effect that the structure cannot have.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// A file cannot be written.
    #[error("{}: cannot be written ({source})", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

impl ExportError {
    /// For `map_err` on writing `file`.
    fn write(file: &Path) -> impl Fn(io::Error) -> ExportError + '_ {
        move |source| ExportError::Write { file: file.to_owned(), source }
    }
}

/// Writes a file whole, in place of what was there.
///
/// # Errors
/// [`ExportError::Write`] names the file.
pub fn write_file(path: &Path, text: &str) -> Result<(), ExportError> {
    write_bytes(path, text.as_bytes())
}

/// The same of bytes.
pub(crate) fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), ExportError> {
    write_whole(path, bytes).map_err(ExportError::write(path))
}
