//! Models that are given as matrices: files of M and K flow in, checked matrices with their layout flow out. Matrices are
//! written to such files here as well.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::DMatrix;
use nalgebra_sparse::io::load_coo_from_matrix_market_str;
use npyz::WriterBuilder;
use thiserror::Error;

use super::layout::{LayoutError, LayoutNode, is_line, read_dofs, read_nodes};
use super::size;
use crate::record::mat::{read_matrix, variables};
use crate::record::{MatError, NpyArray, RecordError};
use crate::study::{LayoutFile, MatrixSource, MatrixTerm};

/// Mass and stiffness matrices from files, and where their rows stand.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportedMatrices {
    /// K, DOFs x DOFs, symmetric.
    pub stiffness: DMatrix<f64>,
    /// M, DOFs x DOFs, symmetric.
    pub mass: DMatrix<f64>,
    /// The nodes, lowest first; empty where nothing is known of them, and sensors name rows.
    pub nodes: Vec<LayoutNode>,
    /// Where K and M are those of a reduced model: how the rows of the whole one, which nodes and sensors name, move with its coordinates,
    /// DOFs x coordinates.
    pub(super) coordinates: Option<Arc<DMatrix<f64>>>,
}

/// Why matrices were refused.
#[derive(Debug, Error)]
pub enum MatrixError {
    /// A MATLAB file.
    #[error(transparent)]
    Mat(#[from] MatError),
    /// A NumPy file.
    #[error(transparent)]
    Npy(#[from] RecordError),
    /// A name that no file goes with.
    #[error(
        "[model] matrices: `{name}` is neither a Matrix Market file (.mtx), a NumPy file (.npy), nor a variable of a MATLAB file named by `file`"
    )]
    NoFile {
        /// The name.
        name: String,
    },
    /// Another file that cannot be read.
    #[error("{}: {reason}", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// Why.
        reason: String,
    },
    /// Not square.
    #[error("{name} in {}: {rows} x {columns}; a {quantity} matrix is square", file.display())]
    NotSquare {
        /// The file.
        file: PathBuf,
        /// The matrix.
        name: String,
        /// `stiffness` or `mass`.
        quantity: &'static str,
        /// Its rows.
        rows: usize,
        /// Its columns.
        columns: usize,
    },
    /// Of another size than the others.
    #[error(
        "{name} in {}: {rows} x {rows}, but the matrices before it are {expected} x {expected}; all must be of one size",
        file.display()
    )]
    Size {
        /// The file.
        file: PathBuf,
        /// The matrix.
        name: String,
        /// Its rows.
        rows: usize,
        /// What was expected.
        expected: usize,
    },
    /// An entry that is not finite.
    #[error("{name} in {}: the entry at row {row}, column {column} (counted from 1) is not a finite number", file.display())]
    NotFinite {
        /// The file.
        file: PathBuf,
        /// The matrix.
        name: String,
        /// 1-based row.
        row: usize,
        /// 1-based column.
        column: usize,
    },
    /// Not symmetric.
    #[error(
        "{name} in {}: not symmetric: row {row}, column {column} (counted from 1) holds {value:e}, its mirror {mirror:e}; stiffness and mass matrices are symmetric",
        file.display()
    )]
    NotSymmetric {
        /// The file.
        file: PathBuf,
        /// The matrix.
        name: String,
        /// 1-based row.
        row: usize,
        /// 1-based column.
        column: usize,
        /// The entry.
        value: f64,
        /// Its mirror image.
        mirror: f64,
    },
    /// A diagonal entry that no structure has.
    #[error(
        "the summed {quantity} matrix has {value:e} on its diagonal in row {row} (counted from 1), where {expected} is possible"
    )]
    Diagonal {
        /// `stiffness` or `mass`.
        quantity: &'static str,
        /// 1-based row.
        row: usize,
        /// The entry.
        value: f64,
        /// What would have been right.
        expected: &'static str,
    },
    /// The layout of nodes.
    #[error(transparent)]
    Layout(#[from] LayoutError),
}

/// Differences of mirror images below this share of the geometric mean of their diagonals are rounding.
const SYMMETRY_TOLERANCE: f64 = 1e-8;

impl ImportedMatrices {
    /// Reads and sums the matrices that a study names; relative paths start at `folder`.
    ///
    /// # Errors
    /// [`MatrixError`] names the file, the matrix and the entry.
    pub fn read(source: &MatrixSource, folder: &Path) -> Result<Self, MatrixError> {
        let file = source.file.as_ref().map(|file| folder.join(file));
        let stiffness = read_sum(&source.stiffness, "stiffness", file.as_deref(), folder, None)?;
        let mass = read_sum(&source.mass, "mass", file.as_deref(), folder, Some(stiffness.nrows()))?;
        for (matrix, quantity, admissible, expected) in [
            (&stiffness, "stiffness", (|value| value > 0.0) as fn(f64) -> bool, "only a number above 0"),
            (&mass, "mass", |value| value >= 0.0, "only 0 or more"),
        ] {
            if let Some(row) = matrix.diagonal().iter().position(|&value| !admissible(value)) {
                return Err(MatrixError::Diagonal { quantity, row: row + 1, value: matrix[(row, row)], expected });
            }
        }
        let nodes = match &source.layout {
            Some(LayoutFile::Nodes(path)) => read_nodes(&folder.join(path), stiffness.nrows())?,
            Some(LayoutFile::Dofs(path)) => read_dofs(&folder.join(path), stiffness.nrows())?,
            None => Vec::new(),
        };
        Ok(Self { stiffness, mass, nodes, coordinates: None })
    }

    /// Whether the nodes stand above each other, so that heights mean something.
    pub fn is_line(&self) -> bool {
        is_line(&self.nodes)
    }
}

/// The sum of the matrices that `terms` name, symmetric; `file` is the MATLAB file of names without an ending.
///
/// # Errors
/// [`MatrixError`] names the file and the matrix.
pub(super) fn read_sum(
    terms: &[MatrixTerm],
    quantity: &'static str,
    file: Option<&Path>,
    folder: &Path,
    mut size: Option<usize>,
) -> Result<DMatrix<f64>, MatrixError> {
    let mut total: Option<DMatrix<f64>> = None;
    for MatrixTerm { name, factor } in terms {
        let (path, matrix) = read_one(name, quantity, file, folder)?;
        check(&matrix, &path, name, quantity, size)?;
        size = Some(matrix.nrows());
        let scaled = symmetric(&matrix) * *factor;
        total = Some(match total {
            Some(total) => total + scaled,
            None => scaled,
        });
    }
    // The study's reader refuses an empty list.
    Ok(total.unwrap_or_else(|| DMatrix::zeros(0, 0)))
}

fn read_one(
    name: &str,
    quantity: &'static str,
    file: Option<&Path>,
    folder: &Path,
) -> Result<(PathBuf, DMatrix<f64>), MatrixError> {
    let unreadable = |path: &Path, reason: String| MatrixError::Unreadable { file: path.to_owned(), reason };
    let size = |length: u64| usize::try_from(length).unwrap_or(usize::MAX);
    let path = folder.join(name);
    match (Path::new(name).extension().and_then(|extension| extension.to_str()), file) {
        (Some("mtx"), _) => {
            let text = std::fs::read_to_string(&path)
                .map_err(|error| unreadable(&path, format!("cannot be read ({error})")))?;
            check_sizes(&text).map_err(|reason| unreadable(&path, reason))?;
            let entries = load_coo_from_matrix_market_str::<f64>(&text)
                .map_err(|error| unreadable(&path, format!("not a Matrix Market file of real numbers ({error})")))?;
            let mut matrix = DMatrix::zeros(entries.nrows(), entries.ncols());
            for (row, column, value) in entries.triplet_iter() {
                matrix[(row, column)] += value;
            }
            Ok((path, matrix))
        }
        (Some("npy"), _) => {
            let array = NpyArray::open(&path)?;
            let &[rows, columns] = array.shape() else {
                let shape = array.shape();
                return Err(unreadable(&path, format!("an array of shape {shape:?}; a matrix has two dimensions")));
            };
            check_size(size(rows), size(columns), &path, name, quantity)?;
            Ok((path, array.read_matrix()?))
        }
        (_, Some(file)) => {
            let known = variables(file)?.into_iter().find(|variable| variable.name == name);
            let dimensions = known.map(|variable| variable.dimensions).unwrap_or_default();
            let rows = dimensions.first().copied().map_or(0, size);
            let columns = dimensions.get(1).copied().map_or(rows, size);
            check_size(rows, columns, file, name, quantity)?;
            Ok((file.to_owned(), read_matrix(file, name)?))
        }
        (_, None) => Err(MatrixError::NoFile { name: name.to_owned() }),
    }
}

/// More rows than this no model has that is kept as a full matrix (3 GB a matrix).
const MOST_ROWS: usize = 20_000;

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
    size::fits(rows).map_err(|why| why.to_string())?;
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

/// Before a matrix is read: a long one may take more memory than any square one that is let through.
fn check_size(rows: usize, columns: usize, file: &Path, name: &str, quantity: &'static str) -> Result<(), MatrixError> {
    let (file, name) = (file.to_owned(), name.to_owned());
    if rows != columns {
        return Err(MatrixError::NotSquare { file, name, quantity, rows, columns });
    }
    size::fits(rows).map_err(|why| MatrixError::Unreadable { file, reason: format!("`{name}` is too large: {why}") })
}

fn check(
    matrix: &DMatrix<f64>,
    file: &Path,
    name: &str,
    quantity: &'static str,
    size: Option<usize>,
) -> Result<(), MatrixError> {
    let (file, name) = (file.to_owned(), name.to_owned());
    let (rows, columns) = matrix.shape();
    if rows != columns || rows == 0 {
        return Err(MatrixError::NotSquare { file, name, quantity, rows, columns });
    }
    if let Some(expected) = size
        && rows != expected
    {
        return Err(MatrixError::Size { file, name, rows, expected });
    }
    if let Some(index) = matrix.iter().position(|value| !value.is_finite()) {
        let (row, column) = matrix.vector_to_matrix_index(index);
        return Err(MatrixError::NotFinite { file, name, row: row + 1, column: column + 1 });
    }
    let largest = matrix.amax();
    for (row, column) in (0..rows).flat_map(|column| (0..column).map(move |row| (row, column))) {
        let (value, mirror) = (matrix[(row, column)], matrix[(column, row)]);
        // Entries are of different units; where a diagonal is empty, the largest entry is the scale.
        let diagonal = (matrix[(row, row)] * matrix[(column, column)]).abs().sqrt();
        let scale = if diagonal > 0.0 { diagonal } else { largest };
        if (value - mirror).abs() > SYMMETRY_TOLERANCE * scale {
            return Err(MatrixError::NotSymmetric { file, name, row: row + 1, column: column + 1, value, mirror });
        }
    }
    Ok(())
}

/// Mirror images may differ by rounding.
fn symmetric(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    (matrix + matrix.transpose()) * 0.5
}

/// A symmetric matrix as a Matrix Market file (array, real, symmetric: the lower triangle, column after column), every
/// digit kept (Boisvert, Pozo, Remington 1996, NISTIR 5935).
pub fn matrix_market(matrix: &DMatrix<f64>) -> String {
    let size = matrix.nrows();
    let mut text = format!("%%MatrixMarket matrix array real symmetric\n{size} {size}\n");
    for column in 0..size {
        for row in column..size {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{:e}", matrix[(row, column)]);
        }
    }
    text
}

/// A matrix as a NumPy file.
///
/// # Errors
/// When the writer of the format fails.
pub fn npy(matrix: &DMatrix<f64>) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let shape = [matrix.nrows() as u64, matrix.ncols() as u64];
    let mut writer = npyz::WriteOptions::new()
        .default_dtype()
        .shape(&shape)
        .order(npyz::Order::Fortran)
        .writer(&mut bytes)
        .begin_nd()?;
    writer.extend(matrix.iter())?;
    writer.finish()?;
    Ok(bytes)
}
