//! Which of a structure's measured places are joined by lines, where nobody says it: places flow in, pairs of them flow out.
//!
//! A structure that stands has lines upwards through places above each other, and an outline around those of one height. What that leaves
//! apart, and all of a structure that lies, is joined by the shortest lines.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use crate::spanning::shortest_lines;

/// Places that differ by less are above each other, or of one height.
const SAME_M: f64 = 0.01;

/// Pairs of places, by their positions in the list, lower first; all places are joined to each other.
pub(crate) fn structural_lines(places_m: &[[f64; 3]]) -> Vec<[usize; 2]> {
    let shortest = shortest_lines(places_m);
    if !stands(places_m) {
        return shortest;
    }
    let mut lines: Vec<[usize; 2]> = verticals(places_m).into_iter().chain(outlines(places_m)).collect();
    let mut part: Vec<usize> = (0..places_m.len()).collect();
    lines.iter().for_each(|line| {
        join(&mut part, *line);
    });
    let length =
        |[a, b]: &[usize; 2]| (0..3).map(|axis| (places_m[*a][axis] - places_m[*b][axis]).powi(2)).sum::<f64>();
    let mut rest = shortest;
    rest.sort_by(|a, b| length(a).total_cmp(&length(b)));
    lines.extend(rest.into_iter().filter(|line| join(&mut part, *line)));
    lines.sort_unstable();
    lines.dedup();
    lines
}

/// Whether a structure is at least as high as it is wide.
pub(crate) fn stands(places_m: &[[f64; 3]]) -> bool {
    let side = |axis: usize| {
        let values = || places_m.iter().map(|place| place[axis]);
        values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
    };
    let height = side(2);
    height > 0.0 && height >= side(0).max(side(1))
}

/// Makes one part of the two that a line joins; whether they were two.
fn join(part: &mut [usize], [a, b]: [usize; 2]) -> bool {
    let (from, to) = (part[b], part[a]);
    part.iter_mut().filter(|of| **of == from).for_each(|of| *of = to);
    from != to
}

/// A length in steps in which places are the same.
pub(crate) fn step(length_m: f64) -> i64 {
    (length_m / SAME_M).round() as i64
}

fn verticals(places_m: &[[f64; 3]]) -> Vec<[usize; 2]> {
    let mut above: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
    for (index, [x, y, _]) in places_m.iter().enumerate() {
        above.entry([step(*x), step(*y)]).or_default().push(index);
    }
    let mut lines = Vec::new();
    for mut column in above.into_values() {
        column.sort_by(|&a, &b| places_m[a][2].total_cmp(&places_m[b][2]));
        lines.extend(column.windows(2).map(|pair| [pair[0].min(pair[1]), pair[0].max(pair[1])]));
    }
    lines
}

fn outlines(places_m: &[[f64; 3]]) -> Vec<[usize; 2]> {
    let mut levels: BTreeMap<i64, BTreeMap<[i64; 2], usize>> = BTreeMap::new();
    for (index, [x, y, z]) in places_m.iter().enumerate() {
        levels.entry(step(*z)).or_default().entry([step(*x), step(*y)]).or_insert(index);
    }
    let mut lines = Vec::new();
    for level in levels.into_values() {
        let level: Vec<usize> = level.into_values().collect();
        let plan: Vec<[f64; 2]> = level.iter().map(|&index| [places_m[index][0], places_m[index][1]]).collect();
        let around = ring(&plan);
        let pairs = around.iter().zip(around.iter().cycle().skip(1));
        // Two are joined once.
        let count = if around.len() < 3 { around.len().saturating_sub(1) } else { around.len() };
        lines.extend(pairs.take(count).map(|(&a, &b)| [level[a].min(level[b]), level[a].max(level[b])]));
    }
    lines
}

/// Points in plan in the order around their middle.
pub(crate) fn ring(points: &[[f64; 2]]) -> Vec<usize> {
    let count = points.len().max(1) as f64;
    let middle = [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / count);
    let angle = |index: usize| (points[index][1] - middle[1]).atan2(points[index][0] - middle[0]).rem_euclid(2.0 * PI);
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| angle(a).total_cmp(&angle(b)));
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two edges of a tower, whose levels have a sensor at one or at both: no line leads from an edge of one level to the other of the next.
    #[test]
    fn a_tower_has_edges_and_levels_and_no_zigzag() {
        let [left, right] = [[-7.0, 1.0], [5.0, 5.0]];
        let at = |[x, y]: [f64; 2], z: f64| [x, y, z];
        let places =
            [at(left, 30.0), at(right, 30.0), at(left, 100.0), at(right, 100.0), at(right, 200.0), at(left, 300.0)];
        let lines = structural_lines(&places);
        assert_eq!(lines, [[0, 1], [0, 2], [1, 3], [2, 3], [2, 5], [3, 4]]);
    }

    #[test]
    fn a_level_of_four_has_an_outline_and_what_is_apart_is_joined() {
        let square = [[1.0, 1.0], [-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0]].map(|[x, y]| [x, y, 9.0]);
        let lone = [0.3, 0.5, 4.0];
        let lines = structural_lines(&[square[0], square[1], square[2], square[3], lone]);
        assert_eq!(lines[..4], [[0, 2], [0, 3], [0, 4], [1, 2]]);
        assert_eq!(lines.len(), 5, "four sides, and one line to the fifth: {lines:?}");
    }

    #[test]
    fn what_lies_is_joined_by_the_shortest_lines() {
        let deck = [0.0, 10.0, 20.0, 30.0].map(|x| [x, 0.0, 5.0]);
        assert_eq!(structural_lines(&deck), [[0, 1], [1, 2], [2, 3]]);
        assert!(structural_lines(&[]).is_empty());
    }
}
