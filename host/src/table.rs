//! Small CSV tables that a user writes: a header, then a row a thing, with `#` before comments.
//!
//! A file flows in; cells flow out, with errors that name file, line and column.

use std::fs::File;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::record::quoted;

/// Why a table was refused.
#[derive(Debug, Error)]
pub enum TableError {
    /// The file cannot be opened.
    #[error("{}: cannot be read ({source}); {named_by} names it", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// What names the file.
        named_by: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
    /// The text is not CSV.
    #[error("{}, line {line}: not a CSV row like its header ({reason})", file.display())]
    NotCsv {
        /// The file.
        file: PathBuf,
        /// 1-based line.
        line: u64,
        /// What the reader said.
        reason: String,
    },
    /// A column is missing, unknown or there twice.
    #[error("{}, line 1: the column `{column}` {problem}; expected {expected}", file.display())]
    Column {
        /// The file.
        file: PathBuf,
        /// The column.
        column: String,
        /// What is wrong with it.
        problem: &'static str,
        /// What a header looks like.
        expected: &'static str,
    },
    /// A cell cannot be meant.
    #[error("{}, line {line}, column `{column}`: `{value}` where {expected} was expected", file.display())]
    Value {
        /// The file.
        file: PathBuf,
        /// 1-based line.
        line: u64,
        /// The column.
        column: &'static str,
        /// The cell's text.
        value: String,
        /// What would have been right.
        expected: String,
    },
    /// There is a header and nothing else.
    #[error("{}: no {what}; expected one row each", file.display())]
    Empty {
        /// The file.
        file: PathBuf,
        /// What the rows are.
        what: &'static str,
    },
}

/// What the cells of a position are.
pub(crate) const METRES: &str = "a number in metres";

/// Columns of a position.
pub(crate) struct PlaceColumns {
    /// `x_m` and `y_m`, where they are there.
    plan: [Option<usize>; 2],
    /// `z_m`.
    pub(crate) z: usize,
}

/// A table that has been read.
#[derive(Debug)]
pub(crate) struct Table<'a> {
    file: &'a Path,
    header: csv::StringRecord,
    /// The rows below the header.
    pub(crate) rows: Vec<csv::StringRecord>,
}

impl<'a> Table<'a> {
    /// Reads a whole file, which `named_by` names.
    ///
    /// # Errors
    /// Where the file cannot be opened, or a row has not as many cells as the header.
    pub(crate) fn read(file: &'a Path, named_by: &'static str) -> Result<Self, TableError> {
        let unreadable = |source| TableError::Unreadable { file: file.to_owned(), named_by, source };
        let opened = File::open(file).map_err(unreadable)?;
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(opened);
        let not_csv = |error: csv::Error| TableError::NotCsv {
            file: file.to_owned(),
            line: error.position().map_or(1, csv::Position::line),
            reason: error.to_string(),
        };
        let header = reader.headers().map_err(not_csv)?.clone();
        let rows = reader.records().collect::<Result<_, _>>().map_err(not_csv)?;
        Ok(Self { file, header, rows })
    }

    /// The columns' names, in the file's order.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        // Spreadsheets begin a file with a byte order mark.
        self.header.iter().map(|name| name.trim_start_matches('\u{feff}'))
    }

    /// Where a column stands.
    pub(crate) fn find(&self, column: &str) -> Option<usize> {
        self.names().position(|name| name == column)
    }

    /// Where a column stands that must be there.
    ///
    /// # Errors
    /// Where it is missing.
    pub(crate) fn column(&self, column: &'static str, expected: &'static str) -> Result<usize, TableError> {
        self.find(column).ok_or_else(|| self.wrong_column(column, "is missing", expected))
    }

    /// A cell's text.
    pub(crate) fn text<'r>(&self, row: &'r csv::StringRecord, column: usize) -> &'r str {
        row.get(column).unwrap_or("")
    }

    /// A cell that must be a finite number.
    ///
    /// # Errors
    /// Where it is none.
    pub(crate) fn number(
        &self,
        row: &csv::StringRecord,
        column: usize,
        name: &'static str,
        expected: &str,
    ) -> Result<f64, TableError> {
        let number = self.text(row, column).parse::<f64>().ok().filter(|number| number.is_finite());
        number.ok_or_else(|| self.value(row, column, name, expected))
    }

    /// Where the columns of a position stand: `z_m`, and `x_m` and `y_m`, which may be absent.
    ///
    /// # Errors
    /// Where `z_m` is missing.
    pub(crate) fn place_columns(&self, expected: &'static str) -> Result<PlaceColumns, TableError> {
        Ok(PlaceColumns { plan: ["x_m", "y_m"].map(|name| self.find(name)), z: self.column("z_m", expected)? })
    }

    /// A position in m, 0 along columns that are absent.
    ///
    /// # Errors
    /// Where a cell is no finite number.
    pub(crate) fn place_m(&self, row: &csv::StringRecord, columns: &PlaceColumns) -> Result<[f64; 3], TableError> {
        let mut place_m = [0.0, 0.0, self.number(row, columns.z, "z_m", METRES)?];
        for ((slot, column), name) in place_m.iter_mut().zip(columns.plan).zip(["x_m", "y_m"]) {
            if let Some(column) = column {
                *slot = self.number(row, column, name, METRES)?;
            }
        }
        Ok(place_m)
    }

    /// What is wrong with a column.
    pub(crate) fn wrong_column(&self, column: &str, problem: &'static str, expected: &'static str) -> TableError {
        TableError::Column { file: self.file.to_owned(), column: column.to_owned(), problem, expected }
    }

    /// What is wrong with a cell.
    pub(crate) fn value(
        &self,
        row: &csv::StringRecord,
        column: usize,
        name: &'static str,
        expected: &str,
    ) -> TableError {
        TableError::Value {
            file: self.file.to_owned(),
            line: row.position().map_or(0, csv::Position::line),
            column: name,
            value: quoted(self.text(row, column).as_bytes()),
            expected: expected.to_owned(),
        }
    }

    /// That there are no rows, which are `what`.
    pub(crate) fn empty(&self, what: &'static str) -> TableError {
        TableError::Empty { file: self.file.to_owned(), what }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_line_and_column_and_who_names_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("table.csv");
        std::fs::write(&file, "\u{feff}node,z_m\n# the base\nfoot,0\nhead,high\n").unwrap();
        let table = Table::read(&file, "--places").unwrap();
        assert_eq!((table.find("node"), table.find("z_m"), table.rows.len()), (Some(0), Some(1), 2));
        assert_eq!(table.number(&table.rows[0], 1, "z_m", "a height").unwrap(), 0.0);
        let error = table.number(&table.rows[1], 1, "z_m", "a height").unwrap_err().to_string();
        assert!(error.ends_with("line 4, column `z_m`: `high` where a height was expected"), "{error}");
        let error = table.column("x_m", "node,x_m").unwrap_err().to_string();
        assert!(error.ends_with("line 1: the column `x_m` is missing; expected node,x_m"), "{error}");
        std::fs::write(&file, "node,z_m\nfoot\n").unwrap();
        let error = Table::read(&file, "--places").unwrap_err().to_string();
        assert!(error.contains("line 2: not a CSV row like its header"), "{error}");
        let error = Table::read(&folder.path().join("absent.csv"), "--places").unwrap_err().to_string();
        assert!(error.contains("absent.csv: cannot be read") && error.ends_with("--places names it"), "{error}");
    }
}
