//! Whether the rows of a stiffness matrix are those that a table says: the matrix and the table flow in, doubts flow out.
//!
//! A structure that moves as a rigid body has no strain, so K times such a motion is zero at every node but those beside supports. Rows that
//! are numbered otherwise than the table has them are out of balance nearly everywhere, whatever the structure is.

use nalgebra_sparse::CscMatrix;

use super::layout::LayoutNode;

/// A row is in balance where its forces cancel to this share: files have five digits or more, condensed matrices spread what supports do.
const BALANCED: f64 = 1e-2;
/// Of wrong numbers no more than this share is in balance by chance.
const BY_CHANCE: f64 = 0.05;
/// Of fewer rows nearly all may be beside supports.
const LEAST_ROWS: usize = 24;

/// A motion of the whole structure, and how many of the rows that take part are in balance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Unbalanced {
    pub(super) motion: &'static str,
    pub(super) balanced: usize,
    pub(super) rows: usize,
}

/// The first rigid motion under which hardly any row is in balance; `None` where rows are numbered as the nodes say, or too few to tell.
pub(super) fn unbalanced(stiffness: &CscMatrix<f64>, nodes: &[LayoutNode]) -> Option<Unbalanced> {
    // ux, uy, rx, ry, rz and uz of a node at a place.
    type AtPlace = fn([f64; 3]) -> [f64; 6];
    let motions: [(&'static str, AtPlace); 4] = [
        ("along X", |_| [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        ("along Y", |_| [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]),
        ("along Z", |_| [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        ("about Z", |[x, y, _]| [-y, x, 0.0, 0.0, 1.0, 0.0]),
    ];
    let middle = |axis: usize| nodes.iter().map(|node| node.position_m[axis]).sum::<f64>() / nodes.len() as f64;
    let middle = [0, 1, 2].map(middle);
    motions.into_iter().find_map(|(motion, of_place)| {
        let mut rigid = vec![None; stiffness.nrows()];
        for node in nodes {
            let place: [f64; 3] = std::array::from_fn(|axis| node.position_m[axis] - middle[axis]);
            for (row, value) in node.rows.iter().zip(of_place(place)) {
                if let Some(slot) = row.and_then(|row| rigid.get_mut(row)).filter(|_| value != 0.0) {
                    *slot = Some(value);
                }
            }
        }
        let (balanced, rows) = balance(stiffness, &rigid);
        (rows >= LEAST_ROWS && (balanced as f64) < BY_CHANCE * rows as f64).then_some(Unbalanced {
            motion,
            balanced,
            rows,
        })
    })
}

/// How many rows that take part in a motion are in balance, and how many have forces at all.
fn balance(stiffness: &CscMatrix<f64>, motion: &[Option<f64>]) -> (usize, usize) {
    // K is symmetric, so its columns are its rows.
    let of_row = |row: usize| {
        motion.get(row).copied().flatten()?;
        let column = stiffness.get_col(row)?;
        let forces = column.row_indices().iter().zip(column.values());
        let forces = forces.filter_map(|(at, entry)| Some(entry * motion.get(*at).copied().flatten()?));
        let (sum, size) = forces.fold((0.0, 0.0), |(sum, size), force| (sum + force, size + force.abs()));
        (size > 0.0).then_some(sum.abs() <= BALANCED * size)
    };
    (0..stiffness.nrows())
        .filter_map(of_row)
        .fold((0, 0), |(balanced, rows), is| (balanced + usize::from(is), rows + 1))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::model::matrices::WholeMatrices;
    use crate::study::{ModelSource, Study};

    /// The templates' structures, as `tests/foreign` has none of a few rows: sound, with rows in another order, off by one, and with nodes in
    /// another order.
    #[test]
    fn rows_in_another_order_than_their_table_has_them_are_noticed() {
        for name in ["frame", "bridge"] {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("templates").join(name);
            let Some(ModelSource::Matrices(source)) = Study::load(&folder).unwrap().model.map(|model| model.source)
            else {
                panic!("{name}")
            };
            let whole = WholeMatrices::read(&source, &folder).unwrap();
            let rows = whole.stiffness.nrows();
            assert_eq!(unbalanced(&whole.stiffness, &whole.nodes), None, "{name}");
            let renumbered = |number: &dyn Fn(usize) -> usize| {
                let mut nodes = whole.nodes.clone();
                for row in nodes.iter_mut().flat_map(|node| &mut node.rows) {
                    *row = row.map(number);
                }
                unbalanced(&whole.stiffness, &nodes)
            };
            // 7 and the number of rows have no common factor, and rows are no multiple of it.
            assert!(renumbered(&|row| (7 * row + 3) % rows).is_some(), "{name}");
            assert!(renumbered(&|row| (row + 1) % rows).is_some(), "{name}");
            let free = whole.nodes.iter().filter(|node| node.rows[0].is_some()).count();
            let mut nodes = whole.nodes.clone();
            let places: Vec<[f64; 3]> = nodes.iter().map(|node| node.position_m).collect();
            for (at, node) in nodes.iter_mut().enumerate() {
                node.position_m = places[(7 * at + 3) % places.len()];
            }
            let found = unbalanced(&whole.stiffness, &nodes).unwrap();
            assert_eq!(found.motion, "about Z", "{name}: {found:?}");
            assert!(free > LEAST_ROWS);
        }
    }
}
