//! Where the degrees of freedom of matrices stand: `nodes.csv` or `dofs.csv` flows in, places of matrix rows flow out.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::DOFS_A_NODE;
use crate::table::{METRES, Table, TableError};

/// Rotations and translations of a node, in the order of [`LayoutNode::rows`].
const DOF_NAMES: [&str; 6] = ["ux", "uy", "rx", "ry", "rz", "uz"];
/// Directions 1 to 6 of a node, as names of rows end; those that end like another come after it.
pub(super) const ROW_DIRECTIONS: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];
/// Nodes whose plan positions differ by less (in m) stand above each other.
const PLAN_TOLERANCE_M: f64 = 1e-6;
/// What names the tables.
const NAMED_BY: &str = "[model] matrices in study.toml";

/// A node of a model that is given as matrices.
#[derive(Debug, Clone, PartialEq)]
pub struct LayoutNode {
    /// Its name in the file.
    pub name: String,
    /// Position in m: X, Y, and Z up.
    pub position_m: [f64; 3],
    /// 0-based matrix rows of `ux, uy, rx, ry, rz, uz`; `None` is fixed, or not in the model.
    pub rows: [Option<usize>; 6],
    /// Which of them are fixed.
    pub fixed: [bool; 6],
}

/// Where `ux`, `uy` and `uz` are among [`LayoutNode::rows`].
pub(super) const TRANSLATIONS: [usize; 3] = [0, 1, 5];

impl LayoutNode {
    /// Its matrix rows along X, Y and Z.
    pub(crate) fn translations(&self) -> [Option<usize>; 3] {
        TRANSLATIONS.map(|dof| self.rows[dof])
    }
}

/// The sides of the box around places along X, Y and Z, in m; 0 around none.
pub(crate) fn sides_m(places_m: impl Iterator<Item = [f64; 3]> + Clone) -> [f64; 3] {
    let side = |axis: usize| {
        let along = places_m.clone().map(|place_m| place_m[axis]);
        let (lowest, highest) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), at| (a.min(at), b.max(at)));
        (highest - lowest).max(0.0)
    };
    [0, 1, 2].map(side)
}

/// The longest side of the box around places, in m.
pub(crate) fn longest_side_m(places_m: impl Iterator<Item = [f64; 3]> + Clone) -> f64 {
    sides_m(places_m).into_iter().fold(0.0, f64::max)
}

/// Why a layout was refused.
#[derive(Debug, Error)]
pub enum LayoutError {
    /// The table itself.
    #[error(transparent)]
    Table(#[from] TableError),
    /// The names of rows cannot be read.
    #[error("{}: cannot be read ({source}); {NAMED_BY} names it", file.display())]
    RowNames {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A universal file, or one of Nastran, that does not place the rows.
    #[error("{}: {reason}", file.display())]
    Numbered {
        /// The file.
        file: PathBuf,
        /// Why.
        reason: String,
    },
    /// A line that is no name of a row.
    #[error("{}, line {line}: `{found}` where a node and its direction, such as 12.1, were expected", file.display())]
    RowName {
        /// The file.
        file: PathBuf,
        /// 1-based line.
        line: usize,
        /// What stands there.
        found: String,
    },
    /// Not as many names as rows.
    #[error("{}: names {found} rows, but the matrices have {dofs}", file.display())]
    RowCount {
        /// The file.
        file: PathBuf,
        /// Names in it.
        found: usize,
        /// Rows of the matrices.
        dofs: usize,
    },
    /// Nodes spread over more than any structure.
    #[error(
        "{}: nodes spread over {size_m:.0} m; are their places in mm? Columns that end in _m are in metres",
        file.display()
    )]
    TooWide {
        /// The file.
        file: PathBuf,
        /// Their longest side.
        size_m: f64,
    },
    /// The nodes and the matrices do not go together.
    #[error(
        "{}: {nodes} nodes, but matrices of {dofs} rows have {} nodes of 5 DOFs (with the fixed base first, {}); a different layout needs `dofs` instead of `nodes`",
        file.display(), *dofs as f64 / 5.0, *dofs as f64 / 5.0 + 1.0
    )]
    NodeCount {
        /// The file.
        file: PathBuf,
        /// Nodes in it.
        nodes: usize,
        /// Rows of the matrices.
        dofs: usize,
    },
}

/// Whether a layout is CalculiX' list of rows, by its ending.
pub(crate) fn is_list_of_rows(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == "dof")
}

/// Reads CalculiX' list of what each row is, `node.direction` a line, directions from 1: names such as `12x`, in the order of the rows.
pub(super) fn read_row_names(path: &Path, dofs: usize) -> Result<Vec<String>, LayoutError> {
    let file = path.to_owned();
    let text = std::fs::read_to_string(path).map_err(|source| LayoutError::RowNames { file: file.clone(), source })?;
    let name = |line: &str| {
        let (node, direction) = line.trim().split_once('.')?;
        let direction = ROW_DIRECTIONS.get(direction.parse::<usize>().ok()?.checked_sub(1)?)?;
        Some(format!("{}{direction}", node.parse::<u64>().ok()?))
    };
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let names = lines.map(|(index, line)| {
        let (file, found) = (file.clone(), line.trim().to_owned());
        name(line).ok_or(LayoutError::RowName { file, line: index + 1, found })
    });
    let names = names.collect::<Result<Vec<String>, _>>()?;
    if names.len() == dofs { Ok(names) } else { Err(LayoutError::RowCount { file, found: names.len(), dofs }) }
}

/// Node and direction of a row's name, such as `12rz`; directions from 0: x, y, z and the rotations about them.
pub fn node_and_direction(name: &str) -> Option<(&str, usize)> {
    ROW_DIRECTIONS.iter().enumerate().rev().find_map(|(at, direction)| Some((name.strip_suffix(direction)?, at)))
}

/// Reads `node,z_m` (further columns are read over): five DOFs a node, lowest first; one node more than the matrices hold
/// is the fixed base.
pub(super) fn read_nodes(path: &Path, dofs: usize) -> Result<Vec<LayoutNode>, LayoutError> {
    let table = Table::read(path, NAMED_BY)?;
    let expected = "node,z_m";
    let (name, height) = (table.column("node", expected)?, table.column("z_m", expected)?);
    let nodes = table.rows.len();
    let fixed = match nodes.checked_mul(DOFS_A_NODE) {
        Some(rows) if rows == dofs => 0,
        Some(rows) if rows == dofs + DOFS_A_NODE => 1,
        _ => return Err(LayoutError::NodeCount { file: path.to_owned(), nodes, dofs }),
    };
    let mut layout: Vec<LayoutNode> = Vec::new();
    for (index, row) in table.rows.iter().enumerate() {
        let z_m = table.number(row, height, "z_m", METRES)?;
        if layout.last().is_some_and(|below| below.position_m[2] >= z_m) {
            return Err(table.value(row, height, "z_m", "a height above the node before").into());
        }
        let mut node = LayoutNode {
            name: table.text(row, name).to_owned(),
            position_m: [0.0, 0.0, z_m],
            rows: [None; 6],
            fixed: [true; 6],
        };
        if let Some(number) = index.checked_sub(fixed) {
            for dof in 0..DOFS_A_NODE {
                node.rows[dof] = Some(number * DOFS_A_NODE + dof);
                node.fixed[dof] = false;
            }
        }
        layout.push(node);
    }
    check_size(path, &layout)?;
    Ok(layout)
}

/// No structure is longer: its places are in mm.
pub(super) const LONGEST_M: f64 = 10_000.0;

fn check_size(path: &Path, nodes: &[LayoutNode]) -> Result<(), LayoutError> {
    let size_m = longest_side_m(nodes.iter().map(|node| node.position_m));
    if size_m > LONGEST_M { Err(LayoutError::TooWide { file: path.to_owned(), size_m }) } else { Ok(()) }
}

/// Reads `row,node,dof` and the position as `z_m` or `x_m,y_m,z_m`; `row` counts from 1 and is empty for a fixed DOF.
pub(super) fn read_dofs(path: &Path, dofs: usize) -> Result<Vec<LayoutNode>, LayoutError> {
    let table = Table::read(path, NAMED_BY)?;
    let expected = "row,node,dof,x_m,y_m,z_m (x_m and y_m may be absent)";
    let (row_column, node_column) = (table.column("row", expected)?, table.column("node", expected)?);
    let (dof_column, place_columns) = (table.column("dof", expected)?, table.place_columns(expected)?);
    let mut layout: Vec<LayoutNode> = Vec::new();
    let mut taken = vec![false; dofs];
    let mut known: HashMap<&str, usize> = HashMap::new();
    for row in &table.rows {
        let position_m = table.place_m(row, &place_columns)?;
        let dof = DOF_NAMES
            .iter()
            .position(|name| *name == table.text(row, dof_column))
            .ok_or_else(|| table.value(row, dof_column, "dof", &format!("one of {}", DOF_NAMES.join(", "))))?;
        let matrix_row = match table.text(row, row_column) {
            "" => None,
            text => {
                let free = text
                    .parse::<usize>()
                    .ok()
                    .and_then(|number| number.checked_sub(1))
                    .filter(|&index| taken.get(index) == Some(&false));
                let index = free.ok_or_else(|| {
                    let expected = format!("a row of the matrices, 1 to {dofs}, that no other line has");
                    table.value(row, row_column, "row", &expected)
                })?;
                taken[index] = true;
                Some(index)
            }
        };
        let name = table.text(row, node_column);
        let node = match known.get(name).copied().and_then(|at| layout.get_mut(at)) {
            Some(node) if node.position_m != position_m => {
                let [x, y, z] = node.position_m;
                let expected = format!("the position ({x}, {y}, {z}) that the node has in an earlier line");
                return Err(table.value(row, place_columns.z, "z_m", &expected).into());
            }
            Some(node) => node,
            None => {
                layout.push(LayoutNode { name: name.to_owned(), position_m, rows: [None; 6], fixed: [false; 6] });
                let last = layout.len() - 1;
                known.insert(name, last);
                &mut layout[last]
            }
        };
        if node.rows[dof].is_some() || node.fixed[dof] {
            let expected = format!("a DOF that node {name} has not had yet");
            return Err(table.value(row, dof_column, "dof", &expected).into());
        }
        node.rows[dof] = matrix_row;
        node.fixed[dof] = matrix_row.is_none();
    }
    layout.sort_by(|a, b| a.position_m[2].total_cmp(&b.position_m[2]));
    check_size(path, &layout)?;
    Ok(layout)
}

/// The table of degrees of freedom that a study of matrices names: a line a degree of freedom that has a row or is fixed.
///
/// # Errors
/// When the writer of the format fails.
pub fn dofs_csv(nodes: &[LayoutNode]) -> std::io::Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(["row", "node", "dof", "x_m", "y_m", "z_m"])?;
    for node in nodes {
        for ((name, row), fixed) in DOF_NAMES.iter().zip(node.rows).zip(node.fixed) {
            let row = row.map(|row| (row + 1).to_string());
            let Some(row) = row.or_else(|| fixed.then(String::new)) else { continue };
            let position = node.position_m.map(|metres| metres.to_string());
            writer.write_record([row, node.name.clone(), (*name).to_owned()].into_iter().chain(position))?;
        }
    }
    writer.into_inner().map_err(csv::IntoInnerError::into_error)
}

/// What a matrix row is called: node and degree of freedom; `None` where the layout does not have it.
pub fn dof_of_row(nodes: &[LayoutNode], row: usize) -> Option<(&LayoutNode, &'static str)> {
    nodes.iter().find_map(|node| {
        let dof = node.rows.iter().position(|known| *known == Some(row))?;
        Some((node, DOF_NAMES[dof]))
    })
}

/// Whether all nodes stand above each other on the Z axis of the plan, each at a height of its own.
pub(super) fn is_line(nodes: &[LayoutNode]) -> bool {
    nodes.len() > 1
        && nodes.windows(2).all(|pair| match pair {
            [below, above] => {
                let moved = |axis: usize| (above.position_m[axis] - below.position_m[axis]).abs();
                moved(0) < PLAN_TOLERANCE_M && moved(1) < PLAN_TOLERANCE_M && moved(2) > PLAN_TOLERANCE_M
            }
            _ => true,
        })
}
