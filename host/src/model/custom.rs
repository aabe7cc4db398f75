//! Hypotheses of the user's own, as matrices or as relative changes of segments: a `[[model.custom]]` of a study flows in, a
//! [`Custom`] that `custom@name` adds to a model flows out.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::DMatrix;
use thiserror::Error;

use super::beam::Segment;
use super::matrices::{MatrixError, read_sum};
use crate::study::{CustomSource, MatrixTerm};

/// A `[[model.custom]]` that was read.
#[derive(Debug, Clone, PartialEq)]
pub struct Custom {
    /// Its name.
    pub name: String,
    /// What a value of 1 adds to K.
    pub(super) stiffness: Option<Arc<DMatrix<f64>>>,
    /// What a value of 1 adds to M.
    pub(super) mass: Option<Arc<DMatrix<f64>>>,
    /// What a value of 1 changes about segments.
    segments: Vec<SegmentFactor>,
    /// The admissible values.
    pub range: [f64; 2],
    /// The typical value.
    pub typical: f64,
}

/// Relative changes between two heights.
#[derive(Debug, Clone, Copy, PartialEq)]
struct SegmentFactor {
    z_bottom_m: f64,
    z_top_m: f64,
    /// Of bending along local axes 1 and 2, of shear, torsion and mass.
    bending: [f64; 2],
    shear: f64,
    torsion: f64,
    mass: f64,
}

/// Why a `[[model.custom]]` cannot be read.
#[derive(Debug, Error)]
pub enum CustomError {
    /// A matrix.
    #[error(transparent)]
    Matrix(#[from] MatrixError),
    /// The table of segments.
    #[error("{}, line {line}: {reason}; expected the columns z_bottom_m,z_top_m and any of bending_1,bending_2,shear,torsion,mass (relative changes)", file.display())]
    Table {
        /// The file.
        file: PathBuf,
        /// 1-based line.
        line: u64,
        /// Why.
        reason: String,
    },
    /// The file cannot be opened.
    #[error("{}: cannot be read ({source}); [[model.custom]] in study.toml names it", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

impl Custom {
    /// Reads what a study names; paths start at `folder`.
    ///
    /// # Errors
    /// [`CustomError`] names the file and the line.
    pub fn read(source: &CustomSource, folder: &Path) -> Result<Self, CustomError> {
        let file = source.file.as_ref().map(|file| folder.join(file));
        let matrix = |terms: &[MatrixTerm], quantity| -> Result<Option<Arc<DMatrix<f64>>>, CustomError> {
            let read = || read_sum(terms, quantity, file.as_deref(), folder, None);
            Ok(if terms.is_empty() { None } else { Some(Arc::new(read()?)) })
        };
        Ok(Self {
            name: source.name.clone(),
            stiffness: matrix(&source.stiffness, "custom stiffness")?,
            mass: matrix(&source.mass, "custom mass")?,
            segments: match &source.segments {
                Some(path) => read_segments(&folder.join(path))?,
                None => Vec::new(),
            },
            range: [source.least.unwrap_or(f64::NEG_INFINITY), source.greatest.unwrap_or(f64::INFINITY)],
            typical: source.typical.unwrap_or(1.0),
        })
    }

    /// Whether it changes segments, which only a beam table has.
    pub(super) fn changes_segments(&self) -> bool {
        !self.segments.is_empty()
    }

    /// Changes a segment in the share of it that lies in each row of the table.
    pub(super) fn change(&self, segment: &mut Segment, value: f64) {
        for row in &self.segments {
            let overlap_m = segment.z_top_m.min(row.z_top_m) - segment.z_bottom_m.max(row.z_bottom_m);
            let amount = value * (overlap_m / segment.length_m()).max(0.0);
            let factor = |change: f64| (1.0 + amount * change).max(LEAST_FACTOR);
            for (bending, change) in segment.bending_n_m2.iter_mut().zip(row.bending) {
                *bending *= factor(change);
            }
            segment.shear_n = segment.shear_n.map(|shear| shear.map(|shear| shear * factor(row.shear)));
            segment.torsion_n_m2 *= factor(row.torsion);
            segment.scale_mass(factor(row.mass));
        }
    }
}

/// No hypothesis takes stiffness or mass away altogether.
const LEAST_FACTOR: f64 = 1e-3;

fn read_segments(path: &Path) -> Result<Vec<SegmentFactor>, CustomError> {
    let file = std::fs::File::open(path).map_err(|source| CustomError::Unreadable { file: path.to_owned(), source })?;
    let failed = |line: u64, reason: String| CustomError::Table { file: path.to_owned(), line, reason };
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(file);
    let header = reader.headers().map_err(|error| failed(1, error.to_string()))?.clone();
    let known = ["z_bottom_m", "z_top_m", "bending_1", "bending_2", "shear", "torsion", "mass"];
    if let Some(unknown) = header.iter().find(|column| !known.contains(column)) {
        return Err(failed(1, format!("the column `{unknown}` is unknown")));
    }
    let position = |column: &str| header.iter().position(|name| name == column);
    if let Some(missing) = ["z_bottom_m", "z_top_m"].into_iter().find(|column| position(column).is_none()) {
        return Err(failed(1, format!("the column `{missing}` is missing")));
    }
    let mut rows = Vec::new();
    for record in reader.records() {
        let record =
            record.map_err(|error| failed(error.position().map_or(1, csv::Position::line), error.to_string()))?;
        let line = record.position().map_or(1, csv::Position::line);
        let number = |column: &str| -> Result<f64, CustomError> {
            let cell = position(column).and_then(|at| record.get(at)).unwrap_or("0");
            let number = if cell.is_empty() { Some(0.0) } else { cell.parse().ok() };
            number
                .filter(|number: &f64| number.is_finite())
                .ok_or_else(|| failed(line, format!("column `{column}`: `{cell}` is not a number")))
        };
        let row = SegmentFactor {
            z_bottom_m: number("z_bottom_m")?,
            z_top_m: number("z_top_m")?,
            bending: [number("bending_1")?, number("bending_2")?],
            shear: number("shear")?,
            torsion: number("torsion")?,
            mass: number("mass")?,
        };
        if row.z_top_m <= row.z_bottom_m {
            return Err(failed(line, "z_top_m must lie above z_bottom_m".to_owned()));
        }
        rows.push(row);
    }
    if rows.is_empty() { Err(failed(1, "there is no row".to_owned())) } else { Ok(rows) }
}
