//! Hypotheses of the user's own and named groups of a model, as matrices or as relative changes of segments: a `[[model.custom]]` or
//! `[[model.group]]` of a study flows in, a [`Custom`] that `custom@name` or `group@name` adds to a model flows out.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use nalgebra_sparse::CscMatrix;
use thiserror::Error;

use super::assembly::Assembly;
use super::beam::Segment;
use super::contribution::{Contribution, Factors};
use super::matrices::{MatrixError, WholeMatrices, dense_bytes, read_sum, sparse_bytes};
use super::node_files::KnownRows;
use super::runs::RunChange;
use super::sensitivity::Change;
use super::structure::{Body, Structure};
use crate::study::{CustomSource, GroupTerms, MatrixTerm};

/// A `[[model.custom]]` or `[[model.group]]` that was read.
#[derive(Debug, Clone, PartialEq)]
pub struct Custom {
    /// Its name.
    pub name: String,
    /// What a value of 1 adds to K.
    pub(super) stiffness: Option<Arc<DMatrix<f64>>>,
    /// What a value of 1 adds to M.
    pub(super) mass: Option<Arc<DMatrix<f64>>>,
    /// What a value of 1 adds to K and to M of the whole model, where files say so.
    whole: [Option<Arc<CscMatrix<f64>>>; 2],
    /// What a value of 1 changes about segments.
    segments: Vec<SegmentFactor>,
    /// The admissible values.
    pub range: [f64; 2],
    /// The typical value.
    pub typical: f64,
    /// How far a group is trusted, and where it stands; `None` for a hypothesis.
    pub group: Option<GroupTerms>,
}

/// A change of K or M.
pub(super) struct CustomMatrix<'a> {
    /// DOFs x DOFs of the whole model.
    pub(super) entries: &'a CscMatrix<f64>,
    /// Whether it is one of M.
    pub(super) is_mass: bool,
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
    #[error("{}: cannot be read ({source}); [[model.{section}]] in study.toml names it", file.display())]
    Unreadable {
        /// `custom` or `group`.
        section: &'static str,
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

impl Custom {
    /// Reads what a study names; paths start at `folder`. Matrices are those of a model that is not reduced.
    ///
    /// # Errors
    /// [`CustomError`] names the file and the line.
    pub fn read(source: &CustomSource, folder: &Path) -> Result<Self, CustomError> {
        Ok(Self::read_whole(source, folder, &KnownRows::default())?.in_full())
    }

    /// As [`Custom::read`], but for its matrices in the rows of the model: [`Custom::within`] makes these. Files that do not state a size, or
    /// name their rows, have the rows that are `known`.
    ///
    /// # Errors
    /// As there.
    pub(super) fn read_whole(source: &CustomSource, folder: &Path, known: &KnownRows) -> Result<Self, CustomError> {
        let file = source.file.as_ref().map(|file| folder.join(file));
        let matrix = |terms: &[MatrixTerm], quantity| -> Result<Option<Arc<CscMatrix<f64>>>, CustomError> {
            let read = || read_sum(terms, quantity, file.as_deref(), folder, None, &mut known.clone());
            Ok(if terms.is_empty() { None } else { Some(Arc::new(read()?)) })
        };
        let [stiffness, mass] = match source.group {
            Some(_) => ["group's stiffness", "group's mass"],
            None => ["custom stiffness", "custom mass"],
        };
        Ok(Self {
            whole: [matrix(&source.stiffness, stiffness)?, matrix(&source.mass, mass)?],
            segments: match &source.segments {
                Some(path) => read_segments(&folder.join(path), source.section())?,
                None => Vec::new(),
            },
            ..Self::without_change(source)
        })
    }

    /// What a run of the user's own program changes; nothing that takes K or M to where it is not positive is admissible.
    pub(super) fn of_run(source: &CustomSource, change: &RunChange) -> Self {
        let without = Self::without_change(source);
        let [least, greatest] = without.range;
        Self {
            stiffness: Some(change.stiffness.clone()),
            mass: change.mass.clone(),
            range: [least.max(change.range[0]), greatest.min(change.range[1])],
            ..without
        }
    }

    /// Takes in what another group changes, which changes as this one does.
    ///
    /// # Errors
    /// Where their matrices are not of one size.
    pub(super) fn tie(&mut self, other: Self) -> Result<(), String> {
        for (own, more) in self.whole.iter_mut().zip(other.whole) {
            *own = match (own.take(), more) {
                (Some(own), Some(more)) if own.nrows() != more.nrows() => {
                    return Err(of_other_size(more.nrows(), own.nrows()));
                }
                (Some(own), Some(more)) => Some(Arc::new(own.as_ref() + more.as_ref())),
                (own, more) => own.or(more),
            };
        }
        // Of runs, both are in the coordinates of the same modes.
        for (own, more) in [(&mut self.stiffness, other.stiffness), (&mut self.mass, other.mass)] {
            *own = match (own.take(), more) {
                (Some(own), Some(more)) if own.shape() == more.shape() => Some(Arc::new(own.as_ref() + more.as_ref())),
                (own, more) => own.or(more),
            };
        }
        self.segments.extend(other.segments);
        self.range = [self.range[0].max(other.range[0]), self.range[1].min(other.range[1])];
        if let (Some(own), Some(more)) = (&mut self.group, other.group) {
            own.span_m = own.span_m.zip(more.span_m).map(|([a, b], [c, d])| [a.min(c), b.max(d)]);
        }
        Ok(())
    }

    /// What a study says of it, but for what it changes.
    fn without_change(source: &CustomSource) -> Self {
        let (usual, typical) = match source.group {
            Some(group) => (GROUP_RANGE, TYPICAL_OF_GROUP.max(TYPICAL_TIMES * group.std)),
            None => ([f64::NEG_INFINITY, f64::INFINITY], 1.0),
        };
        Self {
            name: source.name.clone(),
            stiffness: None,
            mass: None,
            whole: [None, None],
            segments: Vec::new(),
            range: [source.least.unwrap_or(usual[0]), source.greatest.unwrap_or(usual[1])],
            typical: source.typical.unwrap_or(typical),
            group: source.group,
        }
    }

    /// What it does to K and M by value, of a structure that is multiplied with factors, where that is the same however the structure is;
    /// `None` where it changes segments.
    pub(super) fn constant_change(&self, factors: &Factors) -> Option<Change> {
        if self.changes_segments() {
            return None;
        }
        let dofs = self.stiffness.as_ref().or(self.mass.as_ref())?.nrows();
        let part = |matrix: &Option<Arc<DMatrix<f64>>>, factor: f64| match matrix {
            Some(matrix) => matrix.as_ref() * factor,
            None => DMatrix::zeros(dofs, dofs),
        };
        Some(Change::of(&part(&self.stiffness, factors.stiffness), &part(&self.mass, factors.mass), None))
    }

    /// So much of it.
    pub(super) fn times(&self, value: f64) -> Amount {
        Amount { custom: self.clone(), value }
    }

    /// Why it is no group of a model, given the changes of those `before`; else its own change, K and M each in units of the model's.
    pub(super) fn change_of_group(&self, body: &Body, before: &[(&str, DVector<f64>)]) -> Result<DVector<f64>, String> {
        if self.changes_segments() && !matches!(body, Body::Beam(_)) {
            let why = "it changes segments, and a model given as matrices has none; give its own part of K or M";
            return Err(why.to_owned());
        }
        let structure = Structure::new(body.clone());
        let expected = structure.dofs();
        if let Some(found) = self.other_size(expected) {
            return Err(of_other_size(found, expected));
        }
        let here = structure.assemble();
        let mut there = structure;
        there.push(Arc::new(self.times(SMALL)));
        let there = there.assemble();
        let part = |here: &DMatrix<f64>, there: &DMatrix<f64>| (there - here) / here.norm();
        let parts = [part(&here.stiffness, &there.stiffness), part(&here.mass, &there.mass)];
        let change = DVector::from_iterator(2 * here.stiffness.len(), parts.iter().flatten().copied());
        let size = change.norm();
        if size.is_nan() || size < ROUNDING {
            return Err("it changes nothing of the model".to_owned());
        }
        let change = change / size;
        match before.iter().find(|(_, other)| 1.0 - other.dot(&change).abs() < SAME) {
            Some((other, _)) => Err(format!(
                "it changes the same as group `{other}`, up to a factor, so no measurement tells the two apart; make one group of them"
            )),
            None => Ok(change),
        }
    }

    /// The rows of a matrix that has not as many as `expected`.
    pub(super) fn other_size(&self, expected: usize) -> Option<usize> {
        [&self.stiffness, &self.mass].into_iter().flatten().map(|matrix| matrix.nrows()).find(|rows| *rows != expected)
    }

    /// The rows of a matrix for a whole model that has not as many as `expected`.
    pub(super) fn other_whole_size(&self, expected: usize) -> Option<usize> {
        self.whole_matrices().map(|matrix| matrix.entries.nrows()).find(|rows| *rows != expected)
    }

    /// What a value of 1 adds to K and to M of the whole model.
    pub(super) fn whole_matrices(&self) -> impl Iterator<Item = CustomMatrix<'_>> {
        let matrices = self.whole.iter().zip([false, true]);
        matrices.filter_map(|(matrix, is_mass)| Some(CustomMatrix { entries: matrix.as_deref()?, is_mass }))
    }

    /// Whether its matrices, which are symmetric, have an entry in a row of the whole model; never where no matrix says so.
    pub fn touches(&self, row: usize) -> bool {
        let has_entry = |matrix: CustomMatrix<'_>| {
            matrix.entries.get_col(row).is_some_and(|column| column.values().iter().any(|value| *value != 0.0))
        };
        self.whole_matrices().any(has_entry)
    }

    /// The same with matrices for a model in other coordinates than those of the whole one.
    pub(super) fn within(self, coordinates: &impl Fn(&CscMatrix<f64>) -> DMatrix<f64>) -> Self {
        let of = |matrix: &Option<Arc<CscMatrix<f64>>>| matrix.as_deref().map(|matrix| Arc::new(coordinates(matrix)));
        Self { stiffness: of(&self.whole[0]), mass: of(&self.whole[1]), ..self }
    }

    /// The same with matrices for a model that is not reduced.
    pub(super) fn in_full(self) -> Self {
        self.within(&|matrix| DMatrix::from(matrix))
    }

    /// All that its files say, to tell whether they have changed.
    pub fn bytes(&self) -> Vec<u8> {
        let mut bytes: Vec<u8> = self.whole_matrices().flat_map(|matrix| sparse_bytes(matrix.entries)).collect();
        if self.whole_matrices().next().is_none() {
            bytes = dense_bytes([&self.stiffness, &self.mass].into_iter().filter_map(Option::as_deref));
        }
        bytes.extend_from_slice(format!("{:?}", self.segments).as_bytes());
        bytes
    }

    /// Whether it changes segments, which only a beam table has.
    pub fn changes_segments(&self) -> bool {
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

/// Why matrices of so many rows are none of a model's.
pub(super) fn of_other_size(found: usize, expected: usize) -> String {
    format!("its matrices are {found} x {found}, those of the model {expected} x {expected}")
}

/// Relative changes that a group may have: from next to nothing left of it to ten times as much.
const GROUP_RANGE: [f64; 2] = [-0.99, 9.0];
/// A group that lacks something has changed by about this, or by three standard deviations of what it is trusted to.
const TYPICAL_OF_GROUP: f64 = 0.3;
const TYPICAL_TIMES: f64 = 3.0;

/// So much of a hypothesis, or a relative change of a group.
#[derive(Debug)]
pub(super) struct Amount {
    custom: Custom,
    value: f64,
}

impl Contribution for Amount {
    fn change_segments(&self, segments: &mut [Segment]) {
        for segment in segments {
            self.custom.change(segment, self.value);
        }
    }

    fn amount_of(&self) -> Option<(&str, f64)> {
        Some((&self.custom.name, self.value))
    }

    fn add_to_whole(&self, matrices: &mut WholeMatrices) {
        for CustomMatrix { entries, is_mass } in self.custom.whole_matrices() {
            let matrix = if is_mass { &mut matrices.mass } else { &mut matrices.stiffness };
            *matrix = &*matrix + &(entries * self.value);
        }
    }

    fn add_matrices(&self, assembly: &mut Assembly) {
        let add = |matrix: &mut DMatrix<f64>, change: &Option<Arc<DMatrix<f64>>>| {
            if let Some(change) = change {
                matrix.zip_apply(change.as_ref(), |entry, change| *entry += self.value * change);
            }
        };
        add(&mut assembly.stiffness, &self.custom.stiffness);
        add(&mut assembly.mass, &self.custom.mass);
    }
}

/// A small relative change.
const SMALL: f64 = 1e-3;
/// A change by less than this share of the model is rounding.
const ROUNDING: f64 = 1e-15;
/// Groups whose changes have a cosine this near to one differ by less than a thousandth: no measurement tells them apart.
const SAME: f64 = 1e-7;

/// No hypothesis takes stiffness or mass away altogether.
const LEAST_FACTOR: f64 = 1e-3;

fn read_segments(path: &Path, section: &'static str) -> Result<Vec<SegmentFactor>, CustomError> {
    let file = std::fs::File::open(path).map_err(|source| CustomError::Unreadable {
        section,
        file: path.to_owned(),
        source,
    })?;
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
