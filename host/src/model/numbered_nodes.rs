//! Nodes by number, as programs write them: a universal file or Nastran's bulk data flows in, places of the rows that matrices name by node and degree
//! of freedom, and lines between nodes, flow out.

use std::collections::HashMap;
use std::path::Path;

use super::bulk_data::is_nastran;
use super::layout::{LONGEST_M, LayoutError, LayoutNode, longest_side_m, node_and_direction};
use super::{grid_points, universal_nodes};
use crate::files::read_plain;

/// The place of each direction of [`ROW_DIRECTIONS`](super::layout::ROW_DIRECTIONS) in [`LayoutNode::rows`].
const AMONG_ROWS: [usize; 6] = [0, 1, 5, 2, 3, 4];

/// The nodes that have rows, lowest first, in m where the file's lengths times `factor` are.
///
/// # Errors
/// [`LayoutError`] names the file, and the line or the node.
pub(super) fn read_numbered_nodes(path: &Path, factor: f64, places: &[String]) -> Result<Vec<LayoutNode>, LayoutError> {
    let unusable = |reason: String| LayoutError::Numbered { file: path.to_owned(), reason };
    if places.is_empty() {
        let reason = "it places nodes, and the rows of these matrices do not name theirs; export matrices by node and \
            degree of freedom, or bring a table under the key `dofs`";
        return Err(unusable(reason.to_owned()));
    }
    let positions = read_numbered_positions(path, factor)?;
    let mut nodes: Vec<LayoutNode> = Vec::new();
    let mut known: HashMap<&str, usize> = HashMap::new();
    for (row, place) in places.iter().enumerate() {
        let Some((name, direction)) = node_and_direction(place) else { continue };
        let Some(dof) = AMONG_ROWS.get(direction) else { continue };
        let index = match known.get(name) {
            Some(index) => *index,
            None => {
                // Nodes below zero are the program's own, and stand nowhere.
                let Some(position) = name.parse::<i64>().ok().filter(|node| *node > 0) else { continue };
                let Some(position_m) = positions.get(&position).copied() else {
                    return Err(unusable(format!("node {name} is not among its {} nodes", positions.len())));
                };
                nodes.push(LayoutNode { name: name.to_owned(), position_m, rows: [None; 6], fixed: [false; 6] });
                known.insert(name, nodes.len() - 1);
                nodes.len() - 1
            }
        };
        if let Some(slot) = nodes.get_mut(index).and_then(|node| node.rows.get_mut(*dof)) {
            *slot = Some(row);
        }
    }
    nodes.sort_by(|a, b| a.position_m[2].total_cmp(&b.position_m[2]));
    let size_m = longest_side_m(nodes.iter().map(|node| node.position_m));
    if size_m > LONGEST_M {
        return Err(unusable(format!(
            "nodes spread over {size_m:.0} m; are their places in mm? Then give their factor, nodes = [\"{}\", 0.001]",
            path.file_name().unwrap_or_default().display()
        )));
    }
    Ok(nodes)
}

/// Whether a file is a universal one, by its ending.
pub(super) fn is_universal(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("unv") || ending.eq_ignore_ascii_case("uff"))
}

/// Whether a file has nodes by number, by its ending: a universal one or Nastran's.
pub(crate) fn is_numbered(path: &Path) -> bool {
    is_universal(path) || is_nastran(path)
}

/// Where each node of a file stands, in m where its lengths times `factor` are.
///
/// # Errors
/// [`LayoutError`] names the file, and the line.
pub(crate) fn read_numbered_positions(path: &Path, factor: f64) -> Result<HashMap<i64, [f64; 3]>, LayoutError> {
    let text = read_text(path)?;
    let read = if is_universal(path) { universal_nodes::positions } else { grid_points::positions };
    let mut positions = read(&text).map_err(|reason| LayoutError::Numbered { file: path.to_owned(), reason })?;
    for length in positions.values_mut().flatten() {
        *length *= factor;
    }
    Ok(positions)
}

/// What the trace lines of a universal file join, pair by pair, each with its line in the file.
///
/// # Errors
/// [`LayoutError`] names the file, and the line.
pub(super) fn read_trace_lines(path: &Path) -> Result<Vec<(usize, [i64; 2])>, LayoutError> {
    let text = read_text(path)?;
    universal_nodes::trace_lines(&text).map_err(|reason| LayoutError::Numbered { file: path.to_owned(), reason })
}

fn read_text(path: &Path) -> Result<String, LayoutError> {
    let bytes = read_plain(path).map_err(|source| LayoutError::RowNames { file: path.to_owned(), source })?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Datasets 2411 and 15 as the formats' descriptions lay them out, in mm.
    const NODES: &str = "    -1\n   164\n         1SI: mm (newton)               2\n  1.00000000000000000D+03  1.00000000000000000D+00  1.00000000000000000D+00\n  2.73149999999999977D+02\n    -1\n    -1\n  2411\n         7         1         1        11\n   1.0000000000000000D+03   0.0000000000000000D+00   2.5000000000000000D+03\n    -1\n    -1\n    15\n         3         0         0         1  0.00000E+00  5.00000E+02  1.00000E+03\n    -1\n";

    fn read(text: &str, places: &[&str]) -> Result<Vec<LayoutNode>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("nodes.unv");
        std::fs::write(&path, text).unwrap();
        let places: Vec<String> = places.iter().map(|place| (*place).to_owned()).collect();
        read_numbered_nodes(&path, 1.0, &places).map_err(|error| error.to_string())
    }

    #[test]
    fn nodes_stand_where_both_datasets_say_in_metres() {
        let nodes = read(NODES, &["3x", "3rz", "7x", "7z", "-1x", "9"]).unwrap();
        assert_eq!(nodes[0].name, "3");
        assert_eq!((nodes[0].position_m, nodes[1].position_m), ([0.0, 0.5, 1.0], [1.0, 0.0, 2.5]));
        assert_eq!(nodes[0].rows, [Some(0), None, None, None, Some(1), None]);
        assert_eq!(nodes[1].rows, [Some(2), None, None, None, None, Some(3)]);
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, places, expected) in [
            (NODES, &["8x"][..], "node 8 is not among its 2 nodes"),
            (NODES, &[], "do not name theirs"),
            ("    -1\n    58\n    -1\n", &["3x"], "no nodes in it"),
            ("    -1\n  2411\n   seven\n    -1\n", &["3x"], "line 3: `seven`"),
            ("    -1\n    15\n  3 0 0 1 0.0 zero 1.0\n    -1\n", &["3x"], "line 3"),
        ] {
            let error = read(text, places).unwrap_err();
            assert!(error.contains("nodes.unv") && error.contains(expected), "{error}");
        }
        for length in 0..NODES.len() {
            let _ = read(&NODES[..length], &["3x", "7x"]);
        }
    }

    fn data() -> &'static Path {
        Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests-data"))
    }

    /// The chain of six nodes, 3 m apart, as pyuff and pyNastran write it in mm: the universal file says so, bulk data has no units.
    #[test]
    fn files_of_other_programs_place_nodes_alike() {
        let universal = read_numbered_positions(&data().join("pyuff_nodes.unv"), 1.0).unwrap();
        for file in ["pynastran_grids_8.bdf", "pynastran_grids_16.bdf"] {
            assert_eq!(read_numbered_positions(&data().join(file), 1e-3).unwrap(), universal, "{file}");
        }
        assert_eq!(universal[&13], [0.0, 0.0, 9.0]);
        let places = ["11x".to_owned(), "16x".to_owned()];
        let in_mm = read_numbered_nodes(&data().join("pynastran_grids_8.bdf"), 1.0, &places).unwrap_err().to_string();
        let expected = "nodes spread over 15000 m; are their places in mm? Then give their factor, nodes = [\"pynastran_grids_8.bdf\", 0.001]";
        assert!(in_mm.contains(expected), "{in_mm}");
    }

    /// Two lines, the second with a gap, as pyuff writes them.
    #[test]
    fn trace_lines_join_their_nodes_but_for_gaps() {
        let pairs: Vec<[i64; 2]> =
            read_trace_lines(&data().join("pyuff_lines.unv")).unwrap().into_iter().map(|(_, pair)| pair).collect();
        assert_eq!(pairs, [[11, 12], [12, 13], [13, 14], [14, 15], [15, 16], [11, 13], [14, 16]]);
        let none = read_trace_lines(&data().join("pyuff_nodes.unv")).unwrap_err().to_string();
        assert!(none.contains("pyuff_nodes.unv: no lines in it: export trace lines, dataset 82"), "{none}");
        let text = std::fs::read_to_string(data().join("pyuff_lines.unv")).unwrap();
        for length in 0..text.len() {
            let _ = universal_nodes::trace_lines(&text[..length]);
        }
        let damaged = universal_nodes::trace_lines("    -1\n    82\n 1 2 1\nname\n 3 four\n    -1\n").unwrap_err();
        assert!(damaged.contains("line 5: `four`"), "{damaged}");
    }
}
