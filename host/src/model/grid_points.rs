//! Where Nastran's grid points stand: the GRID cards of bulk data flow in, places by number flow out, as the cards have them.

use std::collections::HashMap;

use super::bulk_data::{Card, cards, real};
use super::matrix_files::MOST_ROWS;

/// The number of a grid point is in this field of its card, behind the keyword.
const NUMBER: usize = 0;
/// The coordinate system in which it stands.
const PLACED_IN: usize = 1;
/// The first of its three coordinates.
const FIRST: usize = 2;
/// The coordinate system in which it moves.
const MOVES_IN: usize = 5;

/// Where each grid point stands, in the lengths of the model.
///
/// # Errors
/// A sentence that names the line.
pub(super) fn positions(text: &str) -> Result<HashMap<i64, [f64; 3]>, String> {
    // What grid points have in fields that they leave out.
    let usual = cards(text, "GRDSET");
    let mut positions = HashMap::new();
    for card in cards(text, "GRID") {
        let wrong = |expected: &str| format!("line {}: GRID {}: {expected}", card.line, card.field(NUMBER));
        let number = card.field(NUMBER).parse::<i64>().ok().filter(|number| *number > 0);
        let number = number.ok_or_else(|| wrong("where the number of a grid point was expected"))?;
        for (at, what) in [(PLACED_IN, "stands"), (MOVES_IN, "moves")] {
            let own = Some(card.field(at)).filter(|system| !system.is_empty());
            let system = own.or_else(|| usual.first().map(|usual: &Card<'_>| usual.field(at))).unwrap_or_default();
            if !matches!(system, "" | "0" | "-1") {
                return Err(wrong(&format!(
                    "it {what} in coordinate system {system}, and only the basic one is read; bring the model in basic coordinates, or places in a table (node,x_m,y_m,z_m) under the key `points`"
                )));
            }
        }
        // A coordinate that is left out is 0.
        let coordinate = |axis: usize| match card.field(FIRST + axis) {
            "" => Some(0.0),
            field => real(field).filter(|length| length.is_finite()),
        };
        let place = [coordinate(0), coordinate(1), coordinate(2)];
        let [Some(x), Some(y), Some(z)] = place else { return Err(wrong("x, y and z were expected behind it")) };
        positions.insert(number, [x, y, z]);
        if positions.len() > MOST_ROWS {
            return Err(format!("more than {MOST_ROWS} grid points"));
        }
    }
    if positions.is_empty() {
        return Err("no GRID cards in it (files that INCLUDE names are not read)".to_owned());
    }
    Ok(positions)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fields of 8, of 16 and between commas; a coordinate that is left out is 0.
    #[test]
    fn grid_points_stand_where_their_cards_say() {
        let text = "GRID    7               1.0     2.5+1   -3.\n\
                    GRID*                  8               0             1.0             2.0\n\
                    *                    4.0\n\
                    grid,9,,,5.0\n\
                    CBAR,1,1,7,8,0.,0.,1.\n";
        let found = positions(text).unwrap();
        assert_eq!((found[&7], found[&8], found[&9]), ([1.0, 25.0, -3.0], [1.0, 2.0, 4.0], [0.0, 5.0, 0.0]));
        assert_eq!(found.len(), 3);
        for length in 0..text.len() {
            let _ = positions(&text[..length]);
        }
    }

    #[test]
    fn what_is_wrong_is_told_with_its_line() {
        for (text, expected) in [
            ("CBAR,1,1,7,8\n", "no GRID cards in it"),
            ("GRID,seven,,1.,2.,3.\n", "line 1: GRID seven: where the number"),
            ("GRID,7,3,1.,2.,3.\n", "line 1: GRID 7: it stands in coordinate system 3"),
            ("GRID,7,,1.,2.,3.,4\n", "GRID 7: it moves in coordinate system 4"),
            ("GRDSET,,,,,,5\nGRID,7,,1.,2.,3.\n", "line 2: GRID 7: it moves in coordinate system 5"),
            ("GRID,7,,1.,two,3.\n", "x, y and z were expected"),
        ] {
            let error = positions(text).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }
}
