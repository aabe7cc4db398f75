//! Beam tables: `beam.csv` flows in, checked segments flow out, base first.

use std::io::Read;
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::DOFS_A_NODE;
use super::layout::LONGEST_M;
use crate::record::quoted;

/// One beam segment with the masses lumped at its top node.
#[derive(Debug, Clone, PartialEq)]
pub struct Segment {
    /// Height of the lower end in m.
    pub z_bottom_m: f64,
    /// Height of the upper end in m.
    pub z_top_m: f64,
    /// Bending stiffness EI in N m² for motion along local axes 1 and 2.
    pub bending_n_m2: [f64; 2],
    /// Where local axis 1 stands, degrees anticlockwise from +X seen from above; axis 2 stands 90° further.
    pub axis_deg: f64,
    /// Shear stiffness kGA in N for motion along local axes 1 and 2; `None` is rigid in shear (Euler-Bernoulli).
    pub shear_n: [Option<f64>; 2],
    /// Torsional stiffness GJ in N m².
    pub torsion_n_m2: f64,
    /// Mass at the top node in kg.
    pub mass_top_kg: f64,
    /// Rotational inertia at the top node about the global X, Y and Z axes in kg m².
    pub inertia_kg_m2: [f64; 3],
}

/// The stiffnesses of a segment, each known as well as its own formula.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stiffness {
    /// Bending along local axis 1.
    Bending1,
    /// Bending along local axis 2.
    Bending2,
    /// Shear along local axis 1.
    Shear1,
    /// Shear along local axis 2.
    Shear2,
    /// Torsion.
    Torsion,
}

impl Stiffness {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Bending1, Self::Bending2, Self::Shear1, Self::Shear2, Self::Torsion];
}

impl Segment {
    /// Length in m.
    pub fn length_m(&self) -> f64 {
        self.z_top_m - self.z_bottom_m
    }

    /// The diagonal of M at the top node: mass along X and Y, inertia about X, Y and Z.
    pub(super) fn lumped_mass(&self) -> [f64; DOFS_A_NODE] {
        let [inertia_x, inertia_y, inertia_z] = self.inertia_kg_m2;
        [self.mass_top_kg, self.mass_top_kg, inertia_x, inertia_y, inertia_z]
    }

    /// Multiplies bending, shear and torsion alike.
    pub fn scale_stiffness(&mut self, factor: f64) {
        Stiffness::ALL.into_iter().for_each(|stiffness| self.scale(stiffness, factor));
    }

    /// Multiplies one of its stiffnesses.
    pub fn scale(&mut self, stiffness: Stiffness, factor: f64) {
        match stiffness {
            Stiffness::Bending1 => self.bending_n_m2[0] *= factor,
            Stiffness::Bending2 => self.bending_n_m2[1] *= factor,
            Stiffness::Shear1 => self.shear_n[0] = self.shear_n[0].map(|shear| shear * factor),
            Stiffness::Shear2 => self.shear_n[1] = self.shear_n[1].map(|shear| shear * factor),
            Stiffness::Torsion => self.torsion_n_m2 *= factor,
        }
    }

    /// Multiplies mass and rotational inertia alike.
    pub fn scale_mass(&mut self, factor: f64) {
        self.mass_top_kg *= factor;
        self.inertia_kg_m2 = self.inertia_kg_m2.map(|inertia| inertia * factor);
    }
}

/// A line-like structure: contiguous segments, base first.
#[derive(Debug, Clone, PartialEq)]
pub struct BeamTable {
    segments: Vec<Segment>,
}

/// Why a beam table was refused.
#[derive(Debug, Error)]
pub enum BeamError {
    /// The file cannot be opened.
    #[error("{file}: cannot be read ({source}); [model] beam in study.toml names the beam table", file = .file.display())]
    Unreadable {
        /// The table.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The text is not CSV.
    #[error("{file}, line {line}: not a CSV row like its header ({reason})", file = .file.display())]
    NotCsv {
        /// The table.
        file: PathBuf,
        /// Its line, 1-based.
        line: u64,
        /// What the reader said.
        reason: String,
    },
    /// The header lacks a column.
    #[error("{file}, line 1: the column `{column}` is missing; {expected}", file = .file.display())]
    MissingColumn {
        /// The table.
        file: PathBuf,
        /// The column.
        column: &'static str,
        /// What a header looks like.
        expected: &'static str,
    },
    /// The header has a column that nothing reads, or one twice.
    #[error("{file}, line 1: the column `{column}` {problem}; {HEADER}", file = .file.display())]
    UnexpectedColumn {
        /// The table.
        file: PathBuf,
        /// The column.
        column: String,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A cell is not a number in its range.
    #[error("{file}, line {line}, column `{column}`: `{value}` where {expected} was expected", file = .file.display())]
    Value {
        /// The table.
        file: PathBuf,
        /// Its line, 1-based.
        line: u64,
        /// The column.
        column: &'static str,
        /// The cell's text.
        value: String,
        /// What would have been right.
        expected: &'static str,
    },
    /// A segment does not start where the one before ends.
    #[error(
        "{file}, line {line}, column `z_bottom_m`: the segment starts at {z_bottom_m} m, the one before ends at {z_top_m} m; segments stand base first and touch each other",
        file = .file.display()
    )]
    NotContiguous {
        /// The table.
        file: PathBuf,
        /// Line of the upper segment.
        line: u64,
        /// Where it starts.
        z_bottom_m: f64,
        /// Where the lower one ends.
        z_top_m: f64,
    },
    /// The table has a header and nothing else.
    #[error("{file}: no segments; expected one row per segment, base first", file = .file.display())]
    Empty {
        /// The table.
        file: PathBuf,
    },
    /// Higher than any structure.
    #[error("{file}: the beam is {height_m:.0} m high; are its heights in mm? Columns that end in _m are in metres", file = .file.display())]
    TooHigh {
        /// The table.
        file: PathBuf,
        /// From its base to its top.
        height_m: f64,
    },
}

const HEADER: &str = "expected z_bottom_m,z_top_m,bending_1_n_m2,bending_2_n_m2,axis_deg,shear_n (or \
                      shear_1_n,shear_2_n),torsion_n_m2,mass_top_kg,inertia_x_kg_m2,inertia_y_kg_m2,inertia_z_kg_m2";

const COLUMNS: [&str; 13] = [
    "z_bottom_m",
    "z_top_m",
    "bending_1_n_m2",
    "bending_2_n_m2",
    "axis_deg",
    "shear_n",
    "shear_1_n",
    "shear_2_n",
    "torsion_n_m2",
    "mass_top_kg",
    "inertia_x_kg_m2",
    "inertia_y_kg_m2",
    "inertia_z_kg_m2",
];

/// Ends of neighbouring segments may differ by this much (in m) and still be the same node: rounding in the table.
const JOINT_TOLERANCE_M: f64 = 1e-6;

impl BeamTable {
    /// Reads a `beam.csv`.
    ///
    /// # Errors
    /// [`BeamError`] with the file, the line and the column.
    pub fn read(path: &Path) -> Result<Self, BeamError> {
        let file =
            crate::files::open_plain(path).map_err(|source| BeamError::Unreadable { file: path.to_owned(), source })?;
        Self::from_reader(file, path)
    }

    /// Reads a table from text that stands elsewhere; `name` stands for the file in errors.
    ///
    /// # Errors
    /// As [`BeamTable::read`].
    pub fn from_reader(reader: impl Read, name: &Path) -> Result<Self, BeamError> {
        let mut csv = csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(reader);
        let header = csv.headers().map_err(|error| not_csv(name, &error))?.clone();
        let columns = Columns::of_header(&header, name)?;
        let mut segments: Vec<Segment> = Vec::new();
        for record in csv.records() {
            let record = record.map_err(|error| not_csv(name, &error))?;
            let row =
                Row { file: name, line: record.position().map_or(0, csv::Position::line), record, columns: &columns };
            let segment = row.segment()?;
            if let Some(below) = segments.last()
                && (segment.z_bottom_m - below.z_top_m).abs() > JOINT_TOLERANCE_M
            {
                let (line, z_bottom_m, z_top_m) = (row.line, segment.z_bottom_m, below.z_top_m);
                return Err(BeamError::NotContiguous { file: name.to_owned(), line, z_bottom_m, z_top_m });
            }
            segments.push(segment);
        }
        if segments.is_empty() {
            return Err(BeamError::Empty { file: name.to_owned() });
        }
        let table = Self { segments };
        let height_m = table.z_top_m() - table.z_base_m();
        if height_m > LONGEST_M {
            return Err(BeamError::TooHigh { file: name.to_owned(), height_m });
        }
        Ok(table)
    }

    /// The segments, base first; never empty.
    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// The segments for effects to change; their ends stay where they are.
    pub fn segments_mut(&mut self) -> &mut [Segment] {
        &mut self.segments
    }

    /// Height of the base in m.
    pub fn z_base_m(&self) -> f64 {
        self.segments.first().map_or(0.0, |segment| segment.z_bottom_m)
    }

    /// Height of the top in m.
    pub fn z_top_m(&self) -> f64 {
        self.segments.last().map_or(0.0, |segment| segment.z_top_m)
    }
}

fn not_csv(name: &Path, error: &csv::Error) -> BeamError {
    let line = error.position().map_or(1, csv::Position::line);
    BeamError::NotCsv { file: name.to_owned(), line, reason: error.to_string() }
}

/// Where each column of [`COLUMNS`] stands in the file.
struct Columns([Option<usize>; COLUMNS.len()]);

impl Columns {
    fn of_header(header: &csv::StringRecord, file: &Path) -> Result<Self, BeamError> {
        let mut positions = [None; COLUMNS.len()];
        for (position, name) in header.iter().enumerate() {
            let name = name.trim_start_matches('\u{feff}');
            let unexpected =
                |problem| BeamError::UnexpectedColumn { file: file.to_owned(), column: name.to_owned(), problem };
            let Some(slot) = COLUMNS.iter().zip(&mut positions).find(|(column, _)| **column == name) else {
                return Err(unexpected("is unknown"));
            };
            if slot.1.replace(position).is_some() {
                return Err(unexpected("stands twice"));
            }
        }
        let columns = Self(positions);
        let common = columns.position("shear_n").is_some();
        let each = columns.position("shear_1_n").is_some() || columns.position("shear_2_n").is_some();
        if common && each {
            let problem = "stands beside `shear_1_n` or `shear_2_n`: give one or the other";
            return Err(BeamError::UnexpectedColumn { file: file.to_owned(), column: "shear_n".into(), problem });
        }
        for column in COLUMNS {
            let wanted = match column {
                "shear_n" => !each,
                "shear_1_n" | "shear_2_n" => !common && each,
                _ => true,
            };
            if wanted && columns.position(column).is_none() {
                return Err(BeamError::MissingColumn { file: file.to_owned(), column, expected: HEADER });
            }
        }
        Ok(columns)
    }

    fn position(&self, column: &str) -> Option<usize> {
        COLUMNS.iter().zip(self.0).find(|(name, _)| **name == column).and_then(|(_, position)| position)
    }
}

/// What a number of the table must be.
#[derive(Clone, Copy)]
enum Range {
    Any,
    Positive,
    NotNegative,
}

struct Row<'a> {
    file: &'a Path,
    line: u64,
    record: csv::StringRecord,
    columns: &'a Columns,
}

impl Row<'_> {
    fn segment(&self) -> Result<Segment, BeamError> {
        let shear_n = if self.columns.position("shear_n").is_some() {
            [self.shear("shear_n")?; 2]
        } else {
            [self.shear("shear_1_n")?, self.shear("shear_2_n")?]
        };
        let segment = Segment {
            z_bottom_m: self.number("z_bottom_m", Range::Any)?,
            z_top_m: self.number("z_top_m", Range::Any)?,
            bending_n_m2: [
                self.number("bending_1_n_m2", Range::Positive)?,
                self.number("bending_2_n_m2", Range::Positive)?,
            ],
            axis_deg: self.number("axis_deg", Range::Any)?,
            shear_n,
            torsion_n_m2: self.number("torsion_n_m2", Range::Positive)?,
            mass_top_kg: self.number("mass_top_kg", Range::NotNegative)?,
            inertia_kg_m2: [
                self.number("inertia_x_kg_m2", Range::NotNegative)?,
                self.number("inertia_y_kg_m2", Range::NotNegative)?,
                self.number("inertia_z_kg_m2", Range::NotNegative)?,
            ],
        };
        if segment.length_m() <= JOINT_TOLERANCE_M {
            return Err(self.value_error("z_top_m", "a height above the row's z_bottom_m"));
        }
        Ok(segment)
    }

    fn cell(&self, column: &'static str) -> &str {
        self.columns.position(column).and_then(|position| self.record.get(position)).unwrap_or("")
    }

    fn number(&self, column: &'static str, range: Range) -> Result<f64, BeamError> {
        let (accepted, expected): (fn(f64) -> bool, _) = match range {
            Range::Any => (|_| true, "a number"),
            Range::Positive => (|value| value > 0.0, "a number above 0"),
            Range::NotNegative => (|value| value >= 0.0, "a number of 0 or more"),
        };
        match self.cell(column).parse::<f64>() {
            Ok(value) if value.is_finite() && accepted(value) => Ok(value),
            _ => Err(self.value_error(column, expected)),
        }
    }

    fn shear(&self, column: &'static str) -> Result<Option<f64>, BeamError> {
        if self.cell(column).is_empty() {
            return Ok(None);
        }
        self.number(column, Range::Positive)
            .map(Some)
            .map_err(|_| self.value_error(column, "a number above 0, or nothing for rigid in shear,"))
    }

    fn value_error(&self, column: &'static str, expected: &'static str) -> BeamError {
        let value = self.cell(column).to_owned();
        let value = quoted(value.as_bytes());
        BeamError::Value { file: self.file.to_owned(), line: self.line, column, value, expected }
    }
}
