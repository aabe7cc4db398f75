//! Nodes of a universal file, datasets 2411 and 15: places of the rows that matrices name by node and degree of freedom.
//!
//! A dataset 164 gives the units of what follows it: lengths are divided by its factor to be metres. Without one they are metres.

use std::collections::HashMap;
use std::path::Path;

use super::layout::{LayoutError, LayoutNode, node_and_direction};
use super::matrix_files::MOST_ROWS;
use crate::numbers::fortran;

/// The place of each direction of [`ROW_DIRECTIONS`](super::layout::ROW_DIRECTIONS) in [`LayoutNode::rows`].
const AMONG_ROWS: [usize; 6] = [0, 1, 5, 2, 3, 4];

/// The nodes that have rows, lowest first, in m.
///
/// # Errors
/// [`LayoutError`] names the file, and the line or the node.
pub(super) fn read_universal_nodes(path: &Path, places: &[String]) -> Result<Vec<LayoutNode>, LayoutError> {
    let unusable = |reason: String| LayoutError::Universal { file: path.to_owned(), reason };
    if places.is_empty() {
        let reason = "it places nodes, and the rows of these matrices do not name theirs; export matrices by node and \
            degree of freedom, or bring a table under the key `dofs`";
        return Err(unusable(reason.to_owned()));
    }
    let positions = read_universal_positions(path)?;
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
    Ok(nodes)
}

/// Whether a layout is in a universal file, by its ending.
pub(crate) fn is_universal(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("unv") || ending.eq_ignore_ascii_case("uff"))
}

/// Where each node of a file stands, in m.
///
/// # Errors
/// [`LayoutError`] names the file, and the line.
pub(crate) fn read_universal_positions(path: &Path) -> Result<HashMap<i64, [f64; 3]>, LayoutError> {
    let text = std::fs::read(path).map_err(|source| LayoutError::RowNames { file: path.to_owned(), source })?;
    let unusable = |reason: String| LayoutError::Universal { file: path.to_owned(), reason };
    positions(&String::from_utf8_lossy(&text)).map_err(unusable)
}

/// Where each node stands, in m.
fn positions(text: &str) -> Result<HashMap<i64, [f64; 3]>, String> {
    let mut positions = HashMap::new();
    let mut metres = 1.0;
    let mut lines = text.lines().enumerate();
    let is_mark = |line: &str| line.trim() == "-1";
    while let Some((_, line)) = lines.next() {
        if !is_mark(line) {
            continue;
        }
        let Some((_, number)) = lines.next() else { break };
        let number = number.trim().to_owned();
        let mut of_node: Option<i64> = None;
        let mut line_of_dataset = 0;
        for (index, line) in lines.by_ref() {
            if is_mark(line) {
                break;
            }
            line_of_dataset += 1;
            let words: Vec<&str> = line.split_whitespace().collect();
            let wrong = |expected: &str| format!("line {}: `{}` where {expected}", index + 1, line.trim());
            let numbers = |from: usize| {
                let real = |at: usize| fortran(words.get(at)?);
                Some([real(from)?, real(from + 1)?, real(from + 2)?])
                    .filter(|all| all.iter().all(|one| one.is_finite()))
            };
            let label = || words.first().and_then(|word| word.parse::<i64>().ok());
            let mut insert = |node: i64, place: [f64; 3]| {
                positions.insert(node, place.map(|length| length / metres));
                if positions.len() > MOST_ROWS { Err(format!("more than {MOST_ROWS} nodes")) } else { Ok(()) }
            };
            const NODE: &str = "a node and its coordinate systems were expected";
            const PLACE: &str = "x, y and z were expected";
            match (number.as_str(), of_node) {
                // Its second line: the factors of length, force and temperature.
                ("164", _) if line_of_dataset == 2 => {
                    metres = numbers(0)
                        .map(|all| all[0])
                        .filter(|factor| *factor > 0.0)
                        .ok_or_else(|| wrong("factors were expected"))?;
                }
                ("2411" | "781", None) => of_node = Some(label().ok_or_else(|| wrong(NODE))?),
                ("2411" | "781", Some(node)) => {
                    insert(node, numbers(0).ok_or_else(|| wrong(PLACE))?)?;
                    of_node = None;
                }
                ("15", _) => insert(label().ok_or_else(|| wrong(NODE))?, numbers(4).ok_or_else(|| wrong(PLACE))?)?,
                _ => {}
            }
        }
    }
    if positions.is_empty() {
        return Err("no nodes in it: export dataset 2411 or 15".to_owned());
    }
    Ok(positions)
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
        read_universal_nodes(&path, &places).map_err(|error| error.to_string())
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
}
