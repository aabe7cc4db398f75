//! Models that are given as matrices: files of M and K flow in, checked matrices with their layout flow out. Matrices are
//! written to such files here as well.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::DMatrix;
use nalgebra_sparse::{CooMatrix, CscMatrix};
use npyz::WriterBuilder;
use thiserror::Error;

use super::layout::{LayoutError, LayoutNode, is_line, is_list_of_rows, read_dofs, read_nodes, read_row_names};
use super::matrix_files;
use super::node_files::KnownRows;
use super::numbered_nodes::read_numbered_nodes;
use super::size::{self, TooManyUnknowns};
use crate::record::{MatError, RecordError};
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
    /// The matrices that these are reduced from; `None` where they are not reduced.
    pub(super) whole: Option<Arc<WholeMatrices>>,
    /// Where K and M are those of a reduced model: how the rows of the whole one, which nodes and sensors name, move with its coordinates,
    /// DOFs x coordinates.
    pub(super) coordinates: Option<Arc<DMatrix<f64>>>,
    /// What the rows are called, where sensors name them by channel or point; empty where they do not.
    pub(super) places: Arc<[String]>,
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
        "[model] matrices: `{name}` is neither a Matrix Market file (.mtx), a NumPy or SciPy file (.npy, .npz), a file of CalculiX (.sti, .mas), nor a matrix of the MATLAB, HDF5 or Nastran file named by `file`"
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
    #[error("{}: {rows} x {columns}; a {quantity} matrix is square", within(name, file))]
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
        "{}: {rows} x {rows}, but the matrices before it are {expected} x {expected}; all must be of one size",
        within(name, file)
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
    #[error("{}: the entry at row {row}, column {column} (counted from 1) is not a finite number", within(name, file))]
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
        "{}: not symmetric: row {row}, column {column} (counted from 1) holds {value:e}, its mirror {mirror:e}; stiffness and mass matrices are symmetric (gyroscopic terms and forces that follow the motion are not: export K and M without them)",
        within(name, file)
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
    /// Full matrices do not fit into memory: those of a model whose nodes stand above each other are not reduced.
    #[error("[model] matrices: {0}")]
    TooLarge(TooManyUnknowns),
    /// The layout of nodes.
    #[error(transparent)]
    Layout(#[from] LayoutError),
}

/// A matrix of a file of several, or a file of one.
fn within(name: &str, file: &Path) -> String {
    if file.ends_with(name) { file.display().to_string() } else { format!("{name} in {}", file.display()) }
}

/// Differences of mirror images below this share of the geometric mean of their diagonals are rounding.
const SYMMETRY_TOLERANCE: f64 = 1e-8;

/// Matrices as their files have them, with both triangles.
#[derive(Debug, Clone, PartialEq)]
pub struct WholeMatrices {
    /// K, DOFs x DOFs, symmetric.
    pub stiffness: CscMatrix<f64>,
    /// M, DOFs x DOFs, symmetric.
    pub mass: CscMatrix<f64>,
    /// The nodes, lowest first; empty where nothing is known of them.
    pub nodes: Vec<LayoutNode>,
    /// What the rows are called, where sensors name them; else empty.
    pub places: Arc<[String]>,
}

impl WholeMatrices {
    /// Reads and sums the matrices that a study names; relative paths start at `folder`.
    ///
    /// # Errors
    /// [`MatrixError`] names the file, the matrix and the entry.
    pub(super) fn read(source: &MatrixSource, folder: &Path) -> Result<Self, MatrixError> {
        let file = source.file.as_ref().map(|file| folder.join(file));
        let mut known = KnownRows::default();
        let stiffness = read_sum(&source.stiffness, "stiffness", file.as_deref(), folder, None, &mut known)?;
        let mass = read_sum(&source.mass, "mass", file.as_deref(), folder, Some(stiffness.nrows()), &mut known)?;
        for (matrix, quantity, admissible, expected) in [
            (&stiffness, "stiffness", (|value| value > 0.0) as fn(f64) -> bool, "only a number above 0"),
            (&mass, "mass", |value| value >= 0.0, "only 0 or more"),
        ] {
            let diagonal = diagonal(matrix);
            if let Some(row) = diagonal.iter().position(|&value| !admissible(value)) {
                return Err(MatrixError::Diagonal { quantity, row: row + 1, value: diagonal[row], expected });
            }
        }
        let (rows, mut nodes, mut places) = (stiffness.nrows(), Vec::new(), known.places);
        match &source.layout {
            Some(LayoutFile::Numbered { file, factor }) => {
                nodes = read_numbered_nodes(&folder.join(file), *factor, &places)?;
            }
            Some(LayoutFile::Nodes(path)) => nodes = read_nodes(&folder.join(path), rows)?,
            Some(LayoutFile::Dofs(path)) if is_list_of_rows(path) => {
                places = read_row_names(&folder.join(path), rows)?.into();
            }
            Some(LayoutFile::Dofs(path)) => nodes = read_dofs(&folder.join(path), rows)?,
            None => {}
        }
        Ok(Self { stiffness, mass, nodes, places })
    }

    /// Every entry, also those that are zero.
    ///
    /// # Errors
    /// [`MatrixError::TooLarge`] where full matrices of so many rows, and so many more than usual, do not fit into memory.
    pub(super) fn in_full(self, more_matrices: usize) -> Result<ImportedMatrices, MatrixError> {
        size::fits_with(self.stiffness.nrows(), more_matrices).map_err(MatrixError::TooLarge)?;
        Ok(ImportedMatrices {
            stiffness: DMatrix::from(&self.stiffness),
            mass: DMatrix::from(&self.mass),
            nodes: self.nodes,
            coordinates: None,
            places: self.places,
            whole: None,
        })
    }
}

impl ImportedMatrices {
    /// Reads and sums the matrices that a study names; relative paths start at `folder`.
    ///
    /// # Errors
    /// [`MatrixError`] names the file, the matrix and the entry.
    pub fn read(source: &MatrixSource, folder: &Path) -> Result<Self, MatrixError> {
        WholeMatrices::read(source, folder)?.in_full(0)
    }

    /// Whether the nodes stand above each other, so that heights mean something.
    pub fn is_line(&self) -> bool {
        is_line(&self.nodes)
    }

    /// All that its files say, to tell whether they have changed.
    pub fn bytes(&self) -> Vec<u8> {
        if let Some(whole) = &self.whole {
            return sparse_bytes(&whole.stiffness).chain(sparse_bytes(&whole.mass)).collect();
        }
        // Of a model of modes the coordinates are its shapes.
        dense_bytes([&self.stiffness, &self.mass].into_iter().chain(self.coordinates.as_deref()))
    }
}

/// Where entries stand and what they are, to tell whether they have changed.
pub(super) fn sparse_bytes(matrix: &CscMatrix<f64>) -> impl Iterator<Item = u8> + '_ {
    let entry = |(row, column, value): (usize, usize, &f64)| {
        [(row as u64).to_le_bytes(), (column as u64).to_le_bytes(), value.to_le_bytes()].into_iter().flatten()
    };
    matrix.triplet_iter().filter(|(_, _, value)| **value != 0.0).flat_map(entry)
}

/// All entries, to tell whether they have changed.
pub(super) fn dense_bytes<'a>(matrices: impl Iterator<Item = &'a DMatrix<f64>>) -> Vec<u8> {
    matrices.flat_map(|matrix| matrix.iter()).flat_map(|entry| entry.to_le_bytes()).collect()
}

/// An entry, from 0; zero where none is kept.
pub(super) fn entry(matrix: &CscMatrix<f64>, row: usize, column: usize) -> f64 {
    matrix.get_entry(row, column).map_or(0.0, |entry| entry.into_value())
}

/// Row and column, from 1, of an entry that is not finite.
fn not_finite(matrix: &CscMatrix<f64>) -> Option<[usize; 2]> {
    let (row, column, _) = matrix.triplet_iter().find(|(_, _, value)| !value.is_finite())?;
    Some([row + 1, column + 1])
}

/// The diagonal entries.
fn diagonal(matrix: &CscMatrix<f64>) -> Vec<f64> {
    (0..matrix.nrows().min(matrix.ncols())).map(|at| entry(matrix, at, at)).collect()
}

/// The sum of the matrices that `terms` name, symmetric; `file` holds what is named without an ending. Files that do not state
/// a size, or name their rows, have the rows that are `known`.
///
/// # Errors
/// [`MatrixError`] names the file and the matrix.
pub(super) fn read_sum(
    terms: &[MatrixTerm],
    quantity: &'static str,
    file: Option<&Path>,
    folder: &Path,
    mut size: Option<usize>,
    known: &mut KnownRows,
) -> Result<CscMatrix<f64>, MatrixError> {
    let mut total: Option<CscMatrix<f64>> = None;
    for MatrixTerm { name, factor } in terms {
        known.least = size.unwrap_or(known.least);
        let (path, matrix) = matrix_files::read(name, quantity, file, folder, known)?;
        let matrix = both_triangles(matrix);
        check(&matrix, &path, name, quantity, size)?;
        size = Some(matrix.nrows());
        // Mirror images may differ by rounding.
        let scaled = (&matrix + &matrix.transpose()) * (0.5 * factor);
        total = Some(match total {
            Some(total) => total + scaled,
            None => scaled,
        });
    }
    // The study's reader refuses an empty list.
    let total = total.unwrap_or_else(|| CscMatrix::zeros(0, 0));
    if let Some([row, column]) = not_finite(&total) {
        // Finite by themselves, they overflow together or by a factor.
        let file = file.map_or_else(|| folder.to_owned(), Path::to_path_buf);
        let name = format!("the sum of the {quantity} matrices");
        return Err(MatrixError::NotFinite { file, name, row, column });
    }
    Ok(total)
}

/// A matrix with the mirror image of its one triangle, where the other is empty: so programs write what is symmetric.
fn both_triangles(matrix: CscMatrix<f64>) -> CscMatrix<f64> {
    let has = |is_there: fn(usize, usize) -> bool| {
        matrix.triplet_iter().any(|(row, column, value)| is_there(row, column) && *value != 0.0)
    };
    if matrix.nrows() != matrix.ncols() || has(|row, column| row < column) == has(|row, column| row > column) {
        return matrix;
    }
    let mut image = CooMatrix::new(matrix.nrows(), matrix.ncols());
    for (row, column, value) in matrix.triplet_iter().filter(|(row, column, _)| row != column) {
        image.push(column, row, *value);
    }
    matrix + CscMatrix::from(&image)
}

fn check(
    matrix: &CscMatrix<f64>,
    file: &Path,
    name: &str,
    quantity: &'static str,
    size: Option<usize>,
) -> Result<(), MatrixError> {
    let (file, name) = (file.to_owned(), name.to_owned());
    let (rows, columns) = (matrix.nrows(), matrix.ncols());
    if rows != columns || rows == 0 {
        return Err(MatrixError::NotSquare { file, name, quantity, rows, columns });
    }
    if let Some(expected) = size
        && rows != expected
    {
        return Err(MatrixError::Size { file, name, rows, expected });
    }
    if let Some([row, column]) = not_finite(matrix) {
        return Err(MatrixError::NotFinite { file, name, row, column });
    }
    let diagonal = diagonal(matrix);
    let largest = matrix.values().iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    // What is not its own mirror image is an entry of the difference.
    let difference = matrix - &matrix.transpose();
    for (row, column, difference) in difference.triplet_iter().filter(|(row, column, _)| row < column) {
        // Entries are of different units; where a diagonal is empty, the largest entry is the scale.
        let product = (diagonal[row] * diagonal[column]).abs().sqrt();
        let scale = if product > 0.0 { product } else { largest };
        if difference.abs() > SYMMETRY_TOLERANCE * scale {
            let (value, mirror) = (entry(matrix, row, column), entry(matrix, column, row));
            return Err(MatrixError::NotSymmetric { file, name, row: row + 1, column: column + 1, value, mirror });
        }
    }
    Ok(())
}

/// Mirror images may differ by rounding.
pub(super) fn symmetric(matrix: &DMatrix<f64>) -> DMatrix<f64> {
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

/// A symmetric matrix with few entries as a Matrix Market file (coordinate, real, symmetric: the lower triangle), every digit kept. The library's
/// writer has a header in small letters, which other programs refuse.
pub fn sparse_matrix_market(matrix: &CscMatrix<f64>) -> String {
    let lower: Vec<(usize, usize, &f64)> = matrix.triplet_iter().filter(|(row, column, _)| row >= column).collect();
    let size = matrix.nrows();
    let mut text = format!("%%MatrixMarket matrix coordinate real symmetric\n{size} {size} {}\n", lower.len());
    for (row, column, value) in lower {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{} {} {value:e}", row + 1, column + 1);
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
