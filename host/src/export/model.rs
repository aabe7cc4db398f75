//! A model with its effects: its matrices, where their rows stand, and its modes.
//!
//! A [`Structure`] and its [`Assembly`] flow in. Files flow out that `[model] matrices` of a study reads as the same model: K and M
//! (C where there are dashpots), `dofs.csv`; and its modes at all degrees of freedom and at the study's sensors.

use std::path::{Path, PathBuf};

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::modes::{Component, Mode, Modes};
use super::parquet::{Cell, Kind, ParquetTable, Text};
use super::universal_model::{self, ModelModes};
use super::{ExportError, table, universal, write_bytes, write_file};
use crate::model::effect::{Effect, EffectError};
use crate::model::{
    Assembly, EigenError, LayoutNode, Structure, WholeMatrices, Wireframe, dof_of_row, dofs_csv, fits_in_full,
    matrix_market, node_and_direction, npy, sparse_matrix_market,
};
use crate::study::Sensor;

/// The lowest modes that are written.
const MODES: usize = 30;

/// How matrices are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MatrixFormat {
    /// Matrix Market.
    MatrixMarket,
    /// NumPy.
    Numpy,
}

/// A file that was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// Its path.
    pub file: PathBuf,
    /// Rows of the matrix or table, or modes.
    pub rows: usize,
}

/// A model to export.
#[derive(Debug)]
pub struct ModelExport<'a> {
    /// What it is called.
    pub title: &'a str,
    /// The structure without effects.
    pub bare: &'a Structure,
    /// The structure with effects.
    pub structure: &'a Structure,
    /// The study's sensors.
    pub sensors: &'a [Sensor],
    /// Lines and surfaces of the structure, where the study names some.
    pub frame: Option<&'a Wireframe>,
}

/// Effects that are no part of K, M or C: faults of sensors and clocks, forced lines, trends.
///
/// # Errors
/// Where the structure cannot have an effect.
pub fn left_out(bare: &Structure, effects: &[Effect]) -> Result<Vec<String>, EffectError> {
    let name = |effect: &Effect| Ok(if bare.is_changed_by(effect)? { None } else { Some(effect.to_string()) });
    effects.iter().filter_map(|effect| name(effect).transpose()).collect()
}

impl ModelExport<'_> {
    /// Writes the model into a folder; what the reader of it should know.
    ///
    /// # Errors
    /// When the model has no modes, or a file cannot be written.
    pub fn write(&self, folder: &Path, format: MatrixFormat) -> Result<(Vec<Written>, Vec<String>), ExportError> {
        let mut written = Vec::new();
        let mut note = |file: PathBuf, rows: usize| written.push(Written { file, rows });
        let assembly = self.structure.assemble();
        let dofs = assembly.rows();
        let path_of = |name: &str| folder.join(format!("{name}.{}", format.ending()));
        let write = |name: &str, matrix: &DMatrix<f64>| -> Result<PathBuf, ExportError> {
            let path = path_of(name);
            match format {
                MatrixFormat::MatrixMarket => write_file(&path, &matrix_market(matrix))?,
                MatrixFormat::Numpy => write_bytes(&path, &npy(matrix).map_err(ExportError::write(&path))?)?,
            }
            Ok(path)
        };
        match self.structure.whole_matrices() {
            Some(WholeMatrices { stiffness, mass, .. }) if format == MatrixFormat::Numpy => {
                fits_in_full(dofs).map_err(ExportError::TooLarge)?;
                note(write("stiffness", &DMatrix::from(&stiffness))?, dofs);
                note(write("mass", &DMatrix::from(&mass))?, dofs);
            }
            Some(WholeMatrices { stiffness, mass, .. }) => {
                for (name, matrix) in [("stiffness", &stiffness), ("mass", &mass)] {
                    let path = path_of(name);
                    write_file(&path, &sparse_matrix_market(matrix))?;
                    note(path, dofs);
                }
            }
            None if assembly.is_in_other_coordinates() => return Err(ExportError::NoMatrices),
            None => {
                note(write("stiffness", &assembly.stiffness)?, dofs);
                note(write("mass", &assembly.mass)?, dofs);
            }
        }
        if let Some(damping) = &assembly.damping {
            note(write("damping", damping)?, dofs);
        }
        let layout = self.bare.layout();
        if !layout.is_empty() {
            let path = folder.join("dofs.csv");
            write_bytes(&path, &dofs_csv(&layout).map_err(ExportError::write(&path))?)?;
            note(path, layout.iter().flat_map(|node| node.rows).flatten().count());
        }
        let names = self.structure.row_names();
        if !names.is_empty() {
            // As CalculiX calls them, which `dofs` of a study reads.
            let path = folder.join("dofs.dof");
            write_file(&path, &row_names(names))?;
            note(path, names.len());
        }
        let (path, modes) = (folder.join("model_shapes.csv"), assembly.modal_basis()?.modes(MODES));
        let at_rows = assembly.at_rows(&modes.shapes);
        table::write_rows(&path, &shapes(&layout, names, &at_rows))?;
        note(path, dofs);
        let path = folder.join("model_shapes.parquet");
        write_shapes(&path, &layout, names, &at_rows)?;
        note(path, dofs);
        if !layout.is_empty() {
            let (title, frame, frequency_hz) = (self.title, self.frame, modes.frequency_hz.as_slice());
            let drawn = ModelModes { title, layout: &layout, frame, frequency_hz, shapes: &at_rows };
            let path = folder.join("model_shapes.uff");
            write_file(&path, &universal_model::text(&drawn))?;
            note(path, frequency_hz.len());
        }
        let mut warnings = self.warnings(&assembly, &layout);
        let at_sensors = self.modes_at_sensors(&assembly, &modes, &mut warnings)?;
        let (path, count) = (folder.join("model_modes.csv"), at_sensors.modes.len());
        table::write_csv(&path, &at_sensors)?;
        note(path, count);
        if !at_sensors.sensors.is_empty() {
            let path = folder.join("model_modes.parquet");
            let rows = table::write_parquet(&path, &at_sensors)?;
            note(path, usize::try_from(rows).unwrap_or(usize::MAX));
            let path = folder.join("model_modes.uff");
            let (text, more) = universal::text(&at_sensors, self.title);
            write_file(&path, &text)?;
            warnings.extend(more);
            note(path, count);
        }
        Ok((written, warnings))
    }

    /// Modes as perfect sensors would see them, where they have a place: faults of sensors are none of the model.
    fn modes_at_sensors(
        &self,
        assembly: &Assembly,
        modes: &crate::model::Modes,
        warnings: &mut Vec<String>,
    ) -> Result<Modes, EigenError> {
        let perfect = assembly.with_perfect_sensors();
        let (sensors, rows) = match perfect.sensor_rows(self.sensors) {
            Ok(rows) => (self.sensors.to_vec(), Some(rows)),
            Err(error) => {
                warnings.push(format!("{error}; model_modes.csv has frequencies only"));
                (Vec::new(), None)
            }
        };
        let seen = rows.map(|rows| rows * &modes.shapes);
        let mode = |(index, &frequency_hz): (usize, &f64)| {
            let shape = seen.iter().flat_map(|seen| {
                let shape = seen.column(index);
                let largest = if shape.is_empty() { 0.0 } else { shape[shape.icamax()] };
                let scale = if largest == 0.0 { 1.0 } else { 1.0 / largest };
                let value = |value: &f64| Some(Component { value: Complex64::new(value * scale, 0.0), std: None });
                shape.iter().map(value).collect::<Vec<_>>()
            });
            Mode {
                number: index + 1,
                frequency_hz,
                frequency_std_hz: None,
                damping_ratio: None,
                damping_ratio_std: None,
                phase_collinearity: None,
                shape: shape.collect(),
            }
        };
        let modes = modes.frequency_hz.iter().enumerate().map(mode).collect();
        Ok(Modes { file: PathBuf::new(), json: String::new(), sensors, modes })
    }

    /// What the files do not hold.
    fn warnings(&self, assembly: &Assembly, layout: &[LayoutNode]) -> Vec<String> {
        let mut warnings = Vec::new();
        let placed = layout.iter().flat_map(|node| node.rows).flatten().count();
        let extra = assembly.rows().saturating_sub(placed);
        if !layout.is_empty() && extra > 0 {
            warnings.push(format!(
                "the last {extra} rows of the matrices are those of dampers, which stand at no node; dofs.csv leaves them out"
            ));
        }
        if assembly.damping.is_some() {
            warnings.push(
                "the modes are those of stiffness and mass; `[model] matrices` does not read a damping matrix"
                    .to_owned(),
            );
        }
        let base_moves = assembly.axis_motion(assembly.z_base_m()).amax() > 0.0;
        if let (true, [base, first, ..]) = (base_moves && self.bare.segments().is_some(), layout) {
            let [below_m, above_m] = [base.position_m[2], first.position_m[2]];
            let inside = |sensor: &&Sensor| sensor.elevation_m.is_some_and(|z_m| z_m < above_m);
            let channels: Vec<&str> =
                self.sensors.iter().filter(inside).map(|sensor| sensor.channel.as_str()).collect();
            let who = if channels.is_empty() { String::new() } else { format!(", at channel {}", channels.join(", ")) };
            warnings.push(format!(
                "the base moves with the effects in the model, and its motion is eliminated from the matrices; dofs.csv has it fixed, so a program that reads it is wrong between {below_m} and {above_m} m{who}"
            ));
        }
        warnings
    }
}

impl MatrixFormat {
    fn ending(self) -> &'static str {
        match self {
            Self::MatrixMarket => "mtx",
            Self::Numpy => "npy",
        }
    }
}

/// Names such as `12x` as CalculiX writes them, `12.1`; a name of another kind is left as it is.
fn row_names(names: &[String]) -> String {
    let name = |name: &String| match node_and_direction(name) {
        Some((node, direction)) => format!("{node}.{}\n", direction + 1),
        None => format!("{name}\n"),
    };
    names.iter().map(name).collect()
}

/// A row a degree of freedom: what it is, then the mass-normalised shape of every mode.
fn shapes(layout: &[LayoutNode], names: &[String], shapes: &DMatrix<f64>) -> Vec<Vec<String>> {
    let header = ["row", "node", "dof", "z_m"].map(str::to_owned);
    let modes = (1..=shapes.ncols()).map(|mode| format!("mode_{mode}"));
    let mut rows: Vec<Vec<String>> = vec![header.into_iter().chain(modes).collect()];
    for row in 0..shapes.nrows() {
        let (node, dof, z_m) = place(layout, names, row);
        let place = [node.to_owned(), dof.to_owned(), z_m.map_or_else(String::new, |z_m| z_m.to_string())];
        let values = shapes.row(row).iter().map(ToString::to_string).collect::<Vec<_>>();
        rows.push(std::iter::once((row + 1).to_string()).chain(place).chain(values).collect());
    }
    rows
}

/// The node, direction and height of a row, where they are known; of a row that has a name alone, that.
fn place<'a>(layout: &'a [LayoutNode], names: &'a [String], row: usize) -> (&'a str, &'a str, Option<f64>) {
    match dof_of_row(layout, row) {
        Some((node, dof)) => (&node.name, dof, Some(node.position_m[2])),
        None => (names.get(row).map_or("", String::as_str), "", None),
    }
}

/// Writes the same table as Parquet.
fn write_shapes(
    path: &Path,
    layout: &[LayoutNode],
    names: &[String],
    shapes: &DMatrix<f64>,
) -> Result<u64, ExportError> {
    let modes: Vec<String> = (1..=shapes.ncols()).map(|mode| format!("mode_{mode}")).collect();
    let mut columns = vec![("row", Kind::Whole), ("node", Kind::Text), ("dof", Kind::Text), ("z_m", Kind::Number)];
    columns.extend(modes.iter().map(|mode| (mode.as_str(), Kind::Number)));
    let mut table = ParquetTable::create(path, &columns)?;
    for row in 0..shapes.nrows() {
        let (node, dof, z_m) = place(layout, names, row);
        let (node, dof) = (Text::new(node), Text::new(dof));
        let mut cells = vec![Cell::Whole(row as i64 + 1), Cell::Text(&node), Cell::Text(&dof), Cell::Number(z_m)];
        cells.extend(shapes.row(row).iter().map(|value| Cell::Number(Some(*value))));
        table.push(&cells)?;
    }
    table.finish()
}
