//! Matrices whose rows are nodes and degrees of freedom: Nastran's DMIG, as bulk data or punched, and Abaqus' *MATRIX INPUT.
//!
//! Entries by name flow in, a matrix in the order of the model's rows flows out; the first such file says what that order is. DMIG is that of
//! the "Quick Reference Guide" of MSC and NX Nastran, *MATRIX INPUT that of the "Abaqus Keywords Guide".

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use nalgebra_sparse::{CooMatrix, CscMatrix};

use super::bulk_data::{cards, real};
use super::layout::ROW_DIRECTIONS;
use super::matrix_files::{COMPLEX, MOST_ROWS, words};
use crate::record::listed;

/// A node and its degree of freedom from 1; 0 of a scalar point. Abaqus' own nodes count below zero.
type Row = (i64, u8);

/// What is known of a model's rows from the files that were read before.
#[derive(Debug, Clone, Default)]
pub(super) struct KnownRows {
    /// Rows that a file without a size has at least.
    pub(super) least: usize,
    /// What the rows are called, where files name them.
    pub(super) places: Arc<[String]>,
}

/// A matrix by names.
#[derive(Debug, Default)]
pub(super) struct NodeMatrix {
    entries: Vec<(Row, Row, f64)>,
}

/// What a row is called, as sensors name it: `12x`, `12rz`.
fn name((node, dof): Row) -> String {
    match usize::from(dof).checked_sub(1).map(|dof| ROW_DIRECTIONS.get(dof)) {
        None => node.to_string(),
        Some(Some(direction)) => format!("{node}{direction}"),
        Some(None) => format!("{node}.{dof}"),
    }
}

impl NodeMatrix {
    /// The matrix in the rows that are known; where none are, these are its own, by node and degree of freedom.
    ///
    /// # Errors
    /// A sentence, where it names rows that the model does not have, or where the model's files do not name theirs.
    pub(super) fn in_rows(self, known: &mut KnownRows) -> Result<CscMatrix<f64>, String> {
        if known.places.is_empty() {
            if known.least > 0 {
                return Err("its rows are nodes and degrees of freedom, those of the matrices before it are not; \
                    export all of them by node and degree of freedom"
                    .to_owned());
            }
            let mut rows: Vec<Row> = self.entries.iter().flat_map(|(row, column, _)| [*row, *column]).collect();
            rows.sort_unstable();
            rows.dedup();
            if rows.len() > MOST_ROWS {
                return Err(format!("{} rows; up to {MOST_ROWS} are read", rows.len()));
            }
            known.places = rows.into_iter().map(name).collect();
        }
        let places: HashMap<&str, usize> = known.places.iter().zip(0..).map(|(name, at)| (name.as_str(), at)).collect();
        let mut named: HashMap<Row, usize> = HashMap::new();
        let mut matrix = CooMatrix::new(known.places.len(), known.places.len());
        for (row, column, value) in &self.entries {
            let mut find = |row: &Row| {
                if let Some(at) = named.get(row) {
                    return Ok(*at);
                }
                let at = places.get(name(*row).as_str()).copied();
                let at = at.ok_or_else(|| {
                    format!("node {}, degree of freedom {} is none of the stiffness matrix' rows", row.0, row.1)
                })?;
                named.insert(*row, at);
                Ok::<usize, String>(at)
            };
            let (row, column) = (find(row)?, find(column)?);
            matrix.push(row, column, *value);
        }
        Ok(CscMatrix::from(&matrix))
    }

    /// Adds mirror images where only one of the two is there.
    fn mirrored(mut self) -> Self {
        let there: HashSet<(Row, Row)> = self.entries.iter().map(|(row, column, _)| (*row, *column)).collect();
        let mirror = |(row, column, value): &(Row, Row, f64)| {
            (row != column && !there.contains(&(*column, *row))).then_some((*column, *row, *value))
        };
        let images: Vec<_> = self.entries.iter().filter_map(mirror).collect();
        self.entries.extend(images);
        self
    }
}

/// Lines of node, degree of freedom, node, degree of freedom and value: Abaqus' *MATRIX OUTPUT, FORMAT=MATRIX INPUT (or LABELS).
pub(super) fn abaqus(text: &str) -> Result<NodeMatrix, String> {
    let mut matrix = NodeMatrix::default();
    for (index, line) in text.lines().enumerate() {
        let words = words(line);
        if words.is_empty() || line.trim_start().starts_with('*') {
            continue;
        }
        let entry = match words[..] {
            [row, of_row, column, of_column, value] => {
                let place = |node: &str, dof: &str| Some((node.parse::<i64>().ok()?, dof.parse::<u8>().ok()?));
                place(row, of_row).zip(place(column, of_column)).zip(real(value))
            }
            _ => None,
        };
        let Some(((row, column), value)) = entry else {
            return Err(format!(
                "line {}: `{}` where node, degree of freedom, node, degree of freedom and value were expected, as Abaqus writes them with FORMAT=MATRIX INPUT",
                index + 1,
                line.trim()
            ));
        };
        matrix.entries.push((row, column, value));
    }
    Ok(matrix.mirrored())
}

/// The matrix called `wanted` of a file of bulk data, or of a punched one.
///
/// # Errors
/// A sentence that names the line, or the matrices that there are.
pub(super) fn dmig(text: &str, wanted: &str) -> Result<NodeMatrix, String> {
    let mut matrix = NodeMatrix::default();
    let (mut form, mut others): (Option<i64>, Vec<String>) = (None, Vec::new());
    for card in cards(text, "DMIG") {
        let (line, field) = (card.line, |at: usize| card.field(at));
        let wrong = |what: &str, expected: &str| {
            Err(format!("line {line}: DMIG {}: `{what}` where {expected} was expected", field(0)))
        };
        if !field(0).eq_ignore_ascii_case(wanted) {
            if !others.iter().any(|other| other == field(0)) && others.len() < 12 {
                others.push(field(0).to_owned());
            }
            continue;
        }
        let whole = |at: usize| field(at).parse::<i64>().ok();
        if field(1) == "0" {
            form = whole(2);
            if !matches!(form, Some(1 | 6)) {
                return wrong(field(2), "the form of a square (1) or a symmetric (6) matrix");
            }
            if matches!(whole(3), Some(3 | 4)) {
                return Err(format!("line {line}: DMIG {}: {COMPLEX}", field(0)));
            }
            if !matches!(whole(3), Some(1 | 2)) {
                return wrong(field(3), "the type of real numbers (1 or 2)");
            }
            continue;
        }
        if form.is_none() {
            return wrong(field(1), "its first card, with 0 here");
        }
        let place = |node: &str, dof: &str| {
            let dof = if dof.is_empty() { Some(0) } else { dof.parse::<u8>().ok() };
            Some((node.parse::<i64>().ok()?, dof?))
        };
        let Some(column) = place(field(1), field(2)) else {
            return wrong(&format!("{} {}", field(1), field(2)), "a node and its degree of freedom");
        };
        for entry in card.fields.get(4..).unwrap_or_default().chunks(4) {
            let [node, dof, value] = [0, 1, 2].map(|at| entry.get(at).copied().unwrap_or_default());
            if node.is_empty() {
                continue;
            }
            let Some((row, value)) = place(node, dof).zip(real(value)) else {
                return wrong(&entry.join(" "), "a node, its degree of freedom and a number");
            };
            matrix.entries.push((row, column, value));
        }
    }
    match (form, matrix.entries.is_empty()) {
        (None, _) if others.is_empty() => Err("no DMIG cards in it".to_owned()),
        (None, _) => Err(format!("no DMIG matrix `{wanted}`: it has {}", listed(others, ""))),
        (_, true) => Err(format!("DMIG {wanted} has no entries")),
        (Some(6), _) => Ok(matrix.mirrored()),
        _ => Ok(matrix),
    }
}
