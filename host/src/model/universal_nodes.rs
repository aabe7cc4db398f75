//! Nodes and trace lines of a universal file: datasets 2411 and 15 flow in as places by number, dataset 82 as pairs of nodes that a line joins.
//!
//! A dataset 164 gives the units of what follows it: lengths are divided by its factor to be metres. Without one they are metres.

use std::collections::HashMap;

use super::matrix_files::MOST_ROWS;
use crate::numbers::fortran;

/// The datasets of a file: the number of each, and its lines with their places in the file, from 1.
fn datasets(text: &str) -> impl Iterator<Item = (&str, Vec<(usize, &str)>)> {
    fn is_mark(line: &str) -> bool {
        line.trim() == "-1"
    }
    let mut lines = (1..).zip(text.lines());
    std::iter::from_fn(move || {
        lines.find(|(_, line)| is_mark(line))?;
        let (_, number) = lines.next()?;
        Some((number.trim(), lines.by_ref().take_while(|(_, line)| !is_mark(line)).collect()))
    })
}

/// Where each node stands, in m.
///
/// # Errors
/// A sentence that names the line.
pub(super) fn positions(text: &str) -> Result<HashMap<i64, [f64; 3]>, String> {
    const NODE: &str = "a node and its coordinate systems were expected";
    const PLACE: &str = "x, y and z were expected";
    let mut positions = HashMap::new();
    let mut metres = 1.0;
    for (number, lines) in datasets(text) {
        let mut of_node: Option<i64> = None;
        for (at, (place, line)) in lines.into_iter().enumerate() {
            let words: Vec<&str> = line.split_whitespace().collect();
            let wrong = |expected: &str| format!("line {place}: `{}` where {expected}", line.trim());
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
            match (number, of_node) {
                // Its second line: the factors of length, force and temperature.
                ("164", _) if at == 1 => {
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

/// What trace lines join, pair by pair, each with its line in the file.
///
/// # Errors
/// A sentence that names the line.
pub(super) fn trace_lines(text: &str) -> Result<Vec<(usize, [i64; 2])>, String> {
    let mut pairs = Vec::new();
    for (_, lines) in datasets(text).filter(|(number, _)| *number == "82") {
        let mut before = 0;
        // Number of the line, its nodes and its colour; a name; then the nodes, with 0 where the pen is lifted.
        for (place, line) in lines.into_iter().skip(2) {
            for word in line.split_whitespace() {
                let node = word.parse::<i64>().ok().filter(|node| *node >= 0);
                let node = node.ok_or_else(|| {
                    format!("line {place}: `{word}` where the number of a node, or 0 for a gap, was expected")
                })?;
                if before > 0 && node > 0 && node != before {
                    pairs.push((place, [before, node]));
                }
                before = node;
            }
        }
    }
    if pairs.is_empty() { Err("no lines in it: export trace lines, dataset 82".to_owned()) } else { Ok(pairs) }
}
