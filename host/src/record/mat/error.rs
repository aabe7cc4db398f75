//! What can be wrong with a MATLAB file.

use std::io;
use std::path::{Path, PathBuf};

/// Why a MATLAB file's variable could not be read.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what each field is
pub enum MatError {
    #[error("{file} cannot be read: {source}")]
    Io { file: PathBuf, source: io::Error },
    #[error("{file} is empty: expected a MATLAB v5 file")]
    EmptyFile { file: PathBuf },
    #[error(
        "{file} is a MATLAB v7.3 file (HDF5): expected v5, so save it again in MATLAB with save('name.mat', '-v7')"
    )]
    Version73 { file: PathBuf },
    #[error("{file} is not a MATLAB v5 file: save it again in MATLAB with save('name.mat', '-v7')")]
    NotVersion5 { file: PathBuf },
    #[error("{file} is cut short within {part}: copy or save the file again")]
    Truncated { file: PathBuf, part: String },
    #[error("{file}, variable `{variable}`: damaged: {reason}; copy or save the file again")]
    Damaged { file: PathBuf, variable: String, reason: String },
    #[error("{file} has no variable `{variable}`: it has {available}")]
    NoVariable { file: PathBuf, variable: String, available: String },
    #[error("{file} has several matrices: say which with `variable`, one of {candidates}")]
    SeveralMatrices { file: PathBuf, candidates: String },
    #[error("{file} has no matrix of real numbers: it has {available}")]
    NoMatrix { file: PathBuf, available: String },
    #[error(
        "{file}, variable `{variable}` is of class {found}: expected a full matrix of real numbers (double, single or integer)"
    )]
    NotNumeric { file: PathBuf, variable: String, found: String },
    #[error("{file}, variable `{variable}` is complex: expected real numbers, so save its real part")]
    Complex { file: PathBuf, variable: String },
    #[error("{file}, variable `{variable}` is {dimensions}: expected two dimensions")]
    Shape { file: PathBuf, variable: String, dimensions: String },
    #[error("{file}, variable `{variable}` is empty: expected at least one row of samples")]
    Empty { file: PathBuf, variable: String },
    #[error("{file}, variable `{variable}` of {rows} × {columns} does not fit memory as a full matrix")]
    TooLarge { file: PathBuf, variable: String, rows: u64, columns: u64 },
}

impl MatError {
    /// For `map_err` on what is done to `file`.
    pub(super) fn io(file: &Path) -> impl Fn(io::Error) -> MatError + '_ {
        move |source| MatError::Io { file: file.to_owned(), source }
    }

    /// For `map_err` on what is read of `part` of `file`: the end of the file there is the file's fault.
    pub(super) fn reading<'a>(file: &'a Path, part: &'a str) -> impl Fn(io::Error) -> MatError + 'a {
        move |source| match source.kind() {
            io::ErrorKind::UnexpectedEof => MatError::Truncated { file: file.to_owned(), part: part.to_owned() },
            io::ErrorKind::InvalidData | io::ErrorKind::InvalidInput => {
                MatError::Damaged { file: file.to_owned(), variable: part.to_owned(), reason: source.to_string() }
            }
            _ => MatError::Io { file: file.to_owned(), source },
        }
    }
}
