//! What a structure in space looks like: tables of lines and surfaces between named nodes flow in; the points, what joins them, and how each moves
//! in a mode flow out. Pictures and the page draw it; nothing is computed from it.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use nalgebra::{DMatrix, RowDVector};
use thiserror::Error;

use super::assembly::Assembly;
use super::geometry::Geometry;
use super::layout::{LayoutError, LayoutNode};
use super::numbered_nodes::{is_universal, read_trace_lines};
use crate::modes::node_and_direction;
use crate::study::{Model, Places};
use crate::table::{Table, TableError};

/// What names the tables.
const NAMED_BY: &str = "[model] in study.toml";
/// No more lines, and no more surfaces, than a page draws in a moment.
const MOST: usize = 20_000;
/// A surface has a fourth corner or not.
const LEAST_CORNERS: usize = 3;

/// Points, lines and surfaces of a structure.
#[derive(Debug, Clone, PartialEq)]
pub struct Wireframe {
    /// Names of the points.
    pub names: Vec<String>,
    /// Where they stand, in m: X, Y, and Z up.
    pub places_m: Vec<[f64; 3]>,
    /// Points that lines join.
    pub lines: Vec<[usize; 2]>,
    /// Three or four points around each surface.
    pub surfaces: Vec<Vec<usize>>,
}

/// Why there is nothing to draw.
#[derive(Debug, Error)]
pub enum WireframeError {
    /// One of the tables.
    #[error(transparent)]
    Table(#[from] TableError),
    /// What places the nodes.
    #[error(transparent)]
    Layout(#[from] LayoutError),
    /// Nothing places the nodes.
    #[error(
        "[model] `{key}`: nothing says where the nodes stand; name a table of them, as `dofs` of matrices or `points` (node,x_m,y_m,z_m)"
    )]
    NoPlaces {
        /// `lines` or `surfaces`.
        key: &'static str,
    },
    /// A trace line to a node that stands nowhere.
    #[error("{}, line {line}: node {node} of a trace line is not among those of {}", file.display(), places.display())]
    NoSuchNode {
        /// The universal file.
        file: PathBuf,
        /// 1-based line.
        line: usize,
        /// The node.
        node: i64,
        /// What places the nodes.
        places: PathBuf,
    },
    /// More than can be drawn.
    #[error("{}: {found} {what}, where at most {MOST} are drawn; name those that show the structure's form", file.display())]
    TooMany {
        /// The table.
        file: PathBuf,
        /// How many.
        found: usize,
        /// `lines` or `surfaces`.
        what: &'static str,
    },
}

impl Wireframe {
    /// Reads what a study says of its model's look; `None` where it says nothing.
    ///
    /// # Errors
    /// [`WireframeError`] names file, line and column.
    pub fn read(model: &Model, folder: &Path) -> Result<Option<Self>, WireframeError> {
        let drawing = &model.drawing;
        let key = match (&drawing.lines, &drawing.surfaces) {
            (None, None) => return Ok(None),
            (Some(_), _) => "lines",
            (None, Some(_)) => "surfaces",
        };
        let places = Places::of(model, folder)?.ok_or(WireframeError::NoPlaces { key })?;
        let mut frame = Self { names: Vec::new(), places_m: Vec::new(), lines: Vec::new(), surfaces: Vec::new() };
        let mut known = HashMap::new();
        if let Some(path) = &drawing.lines {
            let path = folder.join(path);
            frame.lines = if is_universal(&path) {
                frame.traced(&path, &places, &mut known)?
            } else {
                let corners = frame.corners(&path, &["from", "to"], &places, &mut known)?;
                corners.iter().filter_map(|ends| ends.as_slice().try_into().ok()).collect()
            };
        }
        if let Some(path) = &drawing.surfaces {
            frame.surfaces = frame.corners(&folder.join(path), &["a", "b", "c", "d"], &places, &mut known)?;
        }
        Ok(Some(frame))
    }

    /// The points that the trace lines of a universal file join.
    fn traced(
        &mut self,
        file: &Path,
        places: &Places,
        known: &mut HashMap<String, usize>,
    ) -> Result<Vec<[usize; 2]>, WireframeError> {
        let pairs = read_trace_lines(file)?;
        if pairs.len() > MOST {
            return Err(WireframeError::TooMany { file: file.to_owned(), found: pairs.len(), what: "lines" });
        }
        let mut end = |line: usize, node: i64| {
            let point = self.point(&node.to_string(), places, known);
            point.ok_or_else(|| WireframeError::NoSuchNode {
                file: file.to_owned(),
                line,
                node,
                places: places.file().to_owned(),
            })
        };
        pairs.into_iter().map(|(line, [from, to])| Ok([end(line, from)?, end(line, to)?])).collect()
    }

    /// The points that each row of a table names; the fourth of a surface may be absent.
    fn corners(
        &mut self,
        file: &Path,
        columns: &[&'static str],
        places: &Places,
        known: &mut HashMap<String, usize>,
    ) -> Result<Vec<Vec<usize>>, WireframeError> {
        let table = Table::read(file, NAMED_BY)?;
        let (what, expected) = match columns.len() {
            2 => ("lines", "from,to: names of nodes"),
            _ => ("surfaces", "a,b,c,d: names of nodes (d is empty for a triangle)"),
        };
        if table.rows.is_empty() {
            return Err(table.empty(what).into());
        }
        if table.rows.len() > MOST {
            return Err(WireframeError::TooMany { file: file.to_owned(), found: table.rows.len(), what });
        }
        let (needed, optional) = columns.split_at(columns.len().min(LEAST_CORNERS));
        let mut at: Vec<(usize, &'static str)> = Vec::with_capacity(columns.len());
        for name in needed {
            at.push((table.column(name, expected)?, name));
        }
        at.extend(optional.iter().filter_map(|name| Some((table.find(name)?, *name))));
        let mut all = Vec::with_capacity(table.rows.len());
        for row in &table.rows {
            let mut corners = Vec::with_capacity(columns.len());
            for &(column, name) in &at {
                let node = table.text(row, column);
                if node.is_empty() && optional.contains(&name) {
                    continue;
                }
                let point = self.point(node, places, known).ok_or_else(|| {
                    let like = places.nearest_name(node).map_or_else(String::new, |name| format!(" such as {name}"));
                    table.value(row, column, name, &format!("a node of {}{like}", places.file().display()))
                })?;
                if corners.contains(&point) {
                    return Err(table.value(row, column, name, "another node than before in this line").into());
                }
                corners.push(point);
            }
            all.push(corners);
        }
        Ok(all)
    }

    /// The point at a node, a new one where there is none yet; `None` where no node has this name.
    fn point(&mut self, node: &str, places: &Places, known: &mut HashMap<String, usize>) -> Option<usize> {
        if let Some(point) = known.get(node) {
            return Some(*point);
        }
        let (place_m, point) = (places.find(node)?, self.names.len());
        self.names.push(node.to_owned());
        self.places_m.push(place_m);
        known.insert(node.to_owned(), point);
        Some(point)
    }

    /// Whether all points stand above each other, as those of a mast: it is drawn by height.
    pub fn is_upright(&self) -> bool {
        self.places_m.windows(2).all(|pair| pair[0][..2] == pair[1][..2])
    }

    /// Lines and the edges of surfaces, each once.
    pub fn edges(&self) -> Vec<[usize; 2]> {
        let around = self
            .surfaces
            .iter()
            .flat_map(|corners| (0..corners.len()).map(|at| [corners[at], corners[(at + 1) % corners.len()]]));
        let mut edges: Vec<[usize; 2]> =
            self.lines.iter().copied().chain(around).map(|[a, b]| [a.min(b), a.max(b)]).collect();
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// Motion of every point along X, Y and Z in shapes over the degrees of freedom, point by point: 3 points x shapes. Zero where the model has
    /// no such motion.
    pub fn motion(&self, assembly: &Assembly, shapes: &DMatrix<f64>) -> DMatrix<f64> {
        let rows = self.rows(assembly);
        let mut motion = DMatrix::zeros(rows.len(), shapes.ncols());
        for (index, row) in rows.iter().enumerate() {
            let Some(row) = *row else { continue };
            let of_row: RowDVector<f64> = match assembly.coordinates_of(row) {
                Some(coordinates) => coordinates * shapes,
                None => shapes.row(row).into_owned(),
            };
            motion.set_row(index, &of_row);
        }
        motion
    }

    /// Rows of the model along X, Y and Z of every point.
    fn rows(&self, assembly: &Assembly) -> Vec<Option<usize>> {
        match &assembly.geometry {
            Geometry::Named(rows) => {
                let named: HashMap<(i64, usize), usize> =
                    rows.iter().enumerate().filter_map(|(row, name)| Some((node_and_direction(name)?, row))).collect();
                let of_point = |name: &String| {
                    let node = name.parse::<i64>().ok();
                    [0, 1, 2].map(|axis| named.get(&(node?, axis)).copied())
                };
                self.names.iter().flat_map(of_point).collect()
            }
            Geometry::Space(nodes) => {
                let nodes: HashMap<&str, &LayoutNode> = nodes.iter().map(|node| (node.name.as_str(), node)).collect();
                let of_point =
                    |name: &String| nodes.get(name.as_str()).map(|node| node.translations()).unwrap_or_default();
                self.names.iter().flat_map(of_point).collect()
            }
            // A line is drawn by its heights, and of other matrices nothing says which row is whose.
            Geometry::Line(_) | Geometry::Unknown => vec![None; 3 * self.names.len()],
        }
    }
}
