//! MATLAB files of versions 5 and 7.3: their variables, read as whole matrices (models) or row by row (recordings).
//!
//! The format is that of MathWorks' "MAT-File Format": elements with a tag, a variable being an element of elements,
//! compressed or not; files of version 7.3 are HDF5. An uncompressed recording is read by seeking; a compressed one is inflated first, a long one into a file.

mod element;
mod hdf5;
mod recording;

use std::path::Path;

use nalgebra::DMatrix;
use nalgebra_sparse::CooMatrix;

use super::error::{MatError, listed};
use element::MatFile;

pub use element::{Class, Variable};
pub(super) use recording::MatRecording;
#[cfg(test)]
pub(super) use recording::inflated_into_memory;

/// Numbers in the largest matrix that is made dense: 1 GiB.
const MOST_NUMBERS: u64 = 1 << 27;

/// The named variables of a MATLAB file, in the file's order.
///
/// # Errors
/// Where the file cannot be read, is of another version, or is damaged.
pub fn variables(path: &Path) -> Result<Vec<Variable>, MatError> {
    MatFile::open(path)?.variables()
}

/// Reads a real matrix, full or sparse, by its variable's name.
///
/// # Errors
/// Where the file cannot be read or is damaged, has no variable of that name, or the variable is no real matrix of a
/// size that fits memory.
pub fn read_matrix(path: &Path, name: &str) -> Result<DMatrix<f64>, MatError> {
    let file = MatFile::open(path)?;
    let variable = find(path, file.variables()?, name)?;
    let (rows, columns) = real_dimensions(path, &variable)?;
    let numbers = rows.checked_mul(columns).filter(|numbers| *numbers <= MOST_NUMBERS);
    let (Some(_), Ok(row_count), Ok(column_count)) = (numbers, usize::try_from(rows), usize::try_from(columns)) else {
        return Err(MatError::TooLarge { file: path.to_owned(), variable: variable.name, rows, columns });
    };
    if variable.class == Class::Sparse {
        return Ok(DMatrix::from(&sparse_entries(path, &file, &variable, [rows, columns])?));
    }
    // MATLAB stores column after column, as nalgebra does.
    let values = file.full(&variable, row_count as u64 * column_count as u64)?;
    if values.len() != row_count * column_count {
        let reason = format!("{} numbers where {rows} × {columns} are announced", values.len());
        return Err(MatError::Damaged { file: path.to_owned(), variable: variable.name, reason });
    }
    Ok(DMatrix::from_vec(row_count, column_count, values))
}

/// Reads the entries of a real matrix of [`Class::Sparse`] by its variable's name.
///
/// # Errors
/// As [`read_matrix`].
pub fn read_sparse_matrix(path: &Path, name: &str) -> Result<CooMatrix<f64>, MatError> {
    let file = MatFile::open(path)?;
    let variable = find(path, file.variables()?, name)?;
    let (rows, columns) = real_dimensions(path, &variable)?;
    sparse_entries(path, &file, &variable, [rows, columns])
}

fn sparse_entries(
    path: &Path,
    file: &MatFile,
    variable: &Variable,
    [rows, columns]: [u64; 2],
) -> Result<CooMatrix<f64>, MatError> {
    let size = |length: u64| usize::try_from(length).unwrap_or(usize::MAX);
    let (row_count, column_count) = (size(rows), size(columns));
    let mut entries = CooMatrix::new(row_count, column_count);
    file.sparse(variable, [rows, columns], &mut |row, column, value| {
        if row >= row_count || column >= column_count {
            let reason = format!("entry ({row}, {column}) is outside {rows} × {columns}");
            return Err(MatError::Damaged { file: path.to_owned(), variable: variable.name.clone(), reason });
        }
        entries.push(row, column, value);
        Ok(())
    })?;
    Ok(entries)
}

fn find(path: &Path, variables: Vec<Variable>, name: &str) -> Result<Variable, MatError> {
    let available = list(&variables);
    let found = variables.into_iter().find(|variable| variable.name == name);
    found.ok_or_else(|| MatError::NoVariable { file: path.to_owned(), variable: name.to_owned(), available })
}

/// Variables as errors list them.
fn list(variables: &[Variable]) -> String {
    if variables.is_empty() {
        return "no variables".to_owned();
    }
    listed(variables, "")
}

/// Rows and columns of a variable that must be a real matrix.
fn real_dimensions(path: &Path, variable: &Variable) -> Result<(u64, u64), MatError> {
    let (file, name) = (path.to_owned(), variable.name.clone());
    if let Class::Other(found) = variable.class {
        return Err(MatError::NotNumeric { file, variable: name, found: found.to_owned() });
    }
    if variable.complex {
        return Err(MatError::Complex { file, variable: name });
    }
    match variable.dimensions[..] {
        [rows, columns] => Ok((rows, columns)),
        _ => Err(MatError::Shape { file, variable: name, dimensions: variable.dimensions_text() }),
    }
}
