//! Files of one matrix: a name flows in, the entries that are not zero flow out, whatever the format.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use nalgebra_sparse::io::load_coo_from_matrix_market_str;
use nalgebra_sparse::{CooMatrix, CscMatrix};
use zip::ZipArchive;

use super::bulk_data::is_nastran;
use super::matrices::MatrixError;
use super::node_files::{self, KnownRows};
use super::size;
use crate::numbers::fortran;
use crate::record::mat::{Class, read_matrix, read_sparse_matrix, variables};
use crate::record::{NpyArray, RecordError, RowError, read_row};

/// How a Matrix Market file starts, in letters of either case.
const HEADER: &str = "%%MatrixMarket";
/// What a file of complex entries is refused with, whatever its format.
pub(super) const COMPLEX: &str = "entries are complex; K and M are real: export them without structural damping and gyroscopic terms, and give damping by the modes. \
    Where the imaginary parts are zero, save the real parts alone";
/// More rows than this no model has.
pub(super) const MOST_ROWS: usize = 200_000;

/// The matrix that `name` stands for, and its file: by its ending a file in `folder`, else a variable of the MATLAB or HDF5 file
/// `container`, or a matrix of that Nastran file.
///
/// Files without a size, and those whose rows are nodes and degrees of freedom, have the rows that are `known`.
///
/// # Errors
/// [`MatrixError`] names the file.
pub(super) fn read(
    name: &str,
    quantity: &'static str,
    container: Option<&Path>,
    folder: &Path,
    known: &mut KnownRows,
) -> Result<(PathBuf, CscMatrix<f64>), MatrixError> {
    let path = folder.join(name);
    let unreadable = |reason: String| MatrixError::Unreadable { file: path.clone(), reason };
    let text = || std::fs::read_to_string(&path).map_err(|error| unreadable(format!("cannot be read ({error})")));
    let ending = Path::new(name).extension().and_then(|extension| extension.to_str());
    let matrix = match (ending, container) {
        (Some("mtx"), _) => {
            let text = text()?;
            let has_header = text.get(..HEADER.len()).is_some_and(|start| start.eq_ignore_ascii_case(HEADER));
            let names_it = |line: &str| line.to_ascii_lowercase().contains("matrixmarket");
            if !has_header && text.lines().next().is_some_and(names_it) {
                return Err(unreadable(format!(
                    "its first line is no header of Matrix Market, which begins with {HEADER}"
                )));
            }
            let read = if has_header || text.trim().is_empty() {
                matrix_market(&text)
            } else if is_by_nodes(&text) {
                node_files::abaqus(&text).and_then(|matrix| matrix.in_rows(known))
            } else {
                triplets(&text, known.least)
            };
            read.map_err(unreadable)?
        }
        (Some("sti" | "mas"), _) => triplets(&text()?, known.least).map_err(unreadable)?,
        (Some("npz"), _) => scipy(&path).map_err(unreadable)?,
        (Some("npy"), _) => {
            let array = NpyArray::open(&path).map_err(|error| match error {
                RecordError::ComplexNumbers { .. } => unreadable(COMPLEX.to_owned()),
                error => error.into(),
            })?;
            let &[rows, columns] = array.shape() else {
                let shape = array.shape();
                return Err(unreadable(format!("an array of shape {shape:?}; a matrix has two dimensions")));
            };
            check_size(in_memory(rows), in_memory(columns), &path, name, quantity)?;
            CscMatrix::from(&array.read_matrix()?)
        }
        (_, Some(file)) if is_nastran(file) => {
            let read = |error| MatrixError::Unreadable { file: file.to_owned(), reason: error };
            let text = std::fs::read_to_string(file).map_err(|error| read(format!("cannot be read ({error})")))?;
            let matrix = node_files::dmig(&text, name).and_then(|matrix| matrix.in_rows(known)).map_err(read)?;
            return Ok((file.to_owned(), matrix));
        }
        (_, Some(file)) => return Ok((file.to_owned(), of_matlab(file, name, quantity)?)),
        (_, None) => return Err(MatrixError::NoFile { name: name.to_owned() }),
    };
    Ok((path, matrix))
}

/// Whether the lines of a file without a header are nodes and degrees of freedom: five numbers each.
fn is_by_nodes(text: &str) -> bool {
    let mut lines = text.lines().filter(|line| !line.trim().is_empty() && !line.trim_start().starts_with(['*', '%']));
    lines.next().is_some_and(|line| words(line).len() == 5)
}

/// The words of a line, between blanks and commas.
pub(super) fn words(line: &str) -> Vec<&str> {
    line.split(|c: char| c.is_whitespace() || c == ',').filter(|word| !word.is_empty()).collect()
}

/// A length that no memory has, where it is too long for one.
fn in_memory(length: u64) -> usize {
    usize::try_from(length).unwrap_or(usize::MAX)
}

fn of_matlab(file: &Path, name: &str, quantity: &'static str) -> Result<CscMatrix<f64>, MatrixError> {
    let known = variables(file)?.into_iter().find(|variable| variable.name == name);
    let is_sparse = known.as_ref().is_some_and(|variable| variable.class == Class::Sparse);
    let dimensions = known.as_ref().map(|variable| variable.dimensions.clone()).unwrap_or_default();
    if known.is_some_and(|variable| variable.complex) {
        return Err(MatrixError::Unreadable { file: file.to_owned(), reason: format!("`{name}`: {COMPLEX}") });
    }
    let rows = dimensions.first().copied().map_or(0, in_memory);
    let columns = dimensions.get(1).copied().map_or(rows, in_memory);
    if is_sparse && rows.max(columns) <= MOST_ROWS {
        return Ok(CscMatrix::from(&read_sparse_matrix(file, name)?));
    }
    check_size(rows, columns, file, name, quantity)?;
    Ok(CscMatrix::from(&read_matrix(file, name)?))
}

/// Before a full matrix is read: a long one may take more memory than any square one that is let through.
fn check_size(rows: usize, columns: usize, file: &Path, name: &str, quantity: &'static str) -> Result<(), MatrixError> {
    let (file, name) = (file.to_owned(), name.to_owned());
    if rows != columns {
        return Err(MatrixError::NotSquare { file, name, quantity, rows, columns });
    }
    size::fits_in_full(rows)
        .map_err(|why| MatrixError::Unreadable { file, reason: format!("`{name}` is too large: {why}") })
}

/// A Matrix Market file.
fn matrix_market(text: &str) -> Result<CscMatrix<f64>, String> {
    let header = text.lines().next().unwrap_or_default().to_ascii_lowercase();
    if header.split_whitespace().any(|word| word == "complex" || word == "hermitian") {
        return Err(COMPLEX.to_owned());
    }
    check_sizes(text)?;
    let entries = load_coo_from_matrix_market_str::<f64>(text)
        .map_err(|error| format!("not a Matrix Market file of real numbers ({error})"))?;
    Ok(CscMatrix::from(&entries))
}

/// Refuses sizes and indices that the library would choke on: it takes any digits for a number that fits, and any size for
/// one that fits into memory.
fn check_sizes(text: &str) -> Result<(), String> {
    let coordinate = text.lines().next().is_some_and(|header| header.to_ascii_lowercase().contains("coordinate"));
    let is_content = |line: &str| !line.trim().is_empty() && !line.starts_with('%');
    let mut lines = text.lines().enumerate().filter(|(_, line)| is_content(line));
    let Some((index, sizes)) = lines.next() else { return Ok(()) };
    let is_size = |word: &str| word.parse::<usize>().is_ok_and(|size| (1..=MOST_ROWS).contains(&size));
    let rows = sizes.split_whitespace().next().and_then(|word| word.parse().ok()).unwrap_or(0);
    if let Some(word) = sizes.split_whitespace().take(2).find(|word| !is_size(word)) {
        return Err(format!(
            "line {}: `{word}` where a number of rows or columns, 1 to {MOST_ROWS}, was expected",
            index + 1
        ));
    }
    if !coordinate {
        size::fits_in_full(rows).map_err(|why| why.to_string())?;
    }
    let is_no_index = |word: &&str| word.parse::<u32>().is_err();
    if let Some(word) = sizes.split_whitespace().nth(2).filter(is_no_index) {
        return Err(format!("line {}: `{word}` where a number of entries was expected", index + 1));
    }
    for (index, line) in lines.filter(|_| coordinate) {
        if let Some(word) = line.split_whitespace().take(2).find(is_no_index) {
            return Err(format!("line {}: `{word}` where a row or column was expected", index + 1));
        }
    }
    Ok(())
}

/// Lines of row, column and value, from 1, without a header: what CalculiX writes as .sti and .mas (SOLVER=MATRIXSTORAGE) and Abaqus with
/// FORMAT=COORDINATE. As many rows as the largest number says, and at least
/// `least_rows`: the last ones may have no mass, or be none of a group's.
fn triplets(text: &str, least_rows: usize) -> Result<CscMatrix<f64>, String> {
    const EXPECTED: &str =
        "where row, column and value were expected, as CalculiX (.sti, .mas) and Abaqus (FORMAT=COORDINATE) write them";
    let mut entries: Vec<(usize, usize, f64)> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let words = words(line);
        if words.is_empty() || line.starts_with("**") || line.starts_with('%') {
            continue;
        }
        let wrong = |expected: &str| format!("line {}: `{}` {expected}", index + 1, line.trim());
        let [row, column, value] = words[..] else {
            return Err(wrong(EXPECTED));
        };
        let place = |word: &str| word.parse::<usize>().ok().filter(|place| (1..=MOST_ROWS).contains(place));
        match (place(row), place(column), fortran(value)) {
            (Some(row), Some(column), Some(value)) => entries.push((row - 1, column - 1, value)),
            _ => return Err(wrong(EXPECTED)),
        }
    }
    let rows = entries.iter().map(|(row, column, _)| row.max(column) + 1).max().ok_or("no entries in it")?;
    let rows = rows.max(least_rows);
    let mut matrix = CooMatrix::new(rows, rows);
    for (row, column, value) in entries {
        matrix.push(row, column, value);
    }
    Ok(CscMatrix::from(&matrix))
}

/// More than so many numbers no array of a sparse matrix has.
const MOST_NUMBERS: u64 = 1 << 27;

/// A sparse matrix as SciPy's `save_npz` writes it: compressed rows or columns, or coordinates.
fn scipy(path: &Path) -> Result<CscMatrix<f64>, String> {
    let file = File::open(path).map_err(|error| format!("cannot be read ({error})"))?;
    let mut archive = ZipArchive::new(BufReader::new(file)).map_err(|error| format!("not a .npz file ({error})"))?;
    let shape = numbers(&mut archive, "shape")?.ok_or(NOT_SCIPY)?;
    let size = |length: &f64| (1.0..=MOST_ROWS as f64).contains(length).then_some(*length as usize);
    let [Some(rows), Some(columns)] = [shape.first().and_then(size), shape.get(1).and_then(size)] else {
        return Err(format!("a matrix of shape {shape:?}, where 1 to {MOST_ROWS} rows and columns were expected"));
    };
    let values = numbers(&mut archive, "data")?.ok_or(NOT_SCIPY)?;
    let mut matrix = CooMatrix::new(rows, columns);
    let mut push = |row: f64, column: f64, value: f64| {
        if !((0.0..rows as f64).contains(&row) && (0.0..columns as f64).contains(&column)) {
            return Err(format!("an entry at row {row}, column {column} (counted from 0) of {rows} x {columns}"));
        }
        matrix.push(row as usize, column as usize, value);
        Ok(())
    };
    if let Some((row, column)) = numbers(&mut archive, "row")?.zip(numbers(&mut archive, "col")?) {
        if row.len() != values.len() || column.len() != values.len() {
            return Err("`row`, `col` and `data` are of different lengths".to_owned());
        }
        row.iter().zip(&column).zip(&values).try_for_each(|((row, column), value)| push(*row, *column, *value))?;
        return Ok(CscMatrix::from(&matrix));
    }
    // Rows and columns of a symmetric matrix are alike.
    let starts = numbers(&mut archive, "indptr")?.ok_or(NOT_SCIPY)?;
    let places = numbers(&mut archive, "indices")?.ok_or(NOT_SCIPY)?;
    if starts.len() != rows + 1 || places.len() != values.len() || rows != columns {
        return Err(NOT_SCIPY.to_owned());
    }
    for (row, bounds) in starts.windows(2).enumerate() {
        let (from, to) = (bounds[0].max(0.0) as usize, bounds[1].max(0.0) as usize);
        let (Some(places), Some(values)) = (places.get(from..to), values.get(from..to)) else {
            return Err(format!("row {} has no entries {from} to {to}", row + 1));
        };
        places.iter().zip(values).try_for_each(|(column, value)| push(row as f64, *column, *value))?;
    }
    Ok(CscMatrix::from(&matrix))
}

const NOT_SCIPY: &str =
    "not a square sparse matrix as scipy.sparse.save_npz writes it; bring it to one of the forms csr, csc and coo";

/// The numbers of one array of the archive; `None` where it has none of that name.
fn numbers(archive: &mut ZipArchive<BufReader<File>>, name: &str) -> Result<Option<Vec<f64>>, String> {
    let Ok(member) = archive.by_name(&format!("{name}.npy")) else { return Ok(None) };
    let damaged = |reason: String| format!("array `{name}`: {reason}");
    // A small file may announce billions: values, rows and columns of a matrix stand in memory three times over.
    let most = member.size().min(MOST_NUMBERS);
    size::fit_numbers(in_memory(most).saturating_mul(9)).map_err(|[needed, free]| {
        damaged(format!("it takes about {needed:.1} GB of memory, and {free:.1} GB are free"))
    })?;
    read_row(member, most).map(Some).map_err(|error| match error {
        RowError::Complex(_) => COMPLEX.to_owned(),
        error @ RowError::Unusable(_) => damaged(error.to_string()),
    })
}
