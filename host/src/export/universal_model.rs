//! A model's modes at all of its nodes as a universal file that other programs draw: units (dataset 164), nodes (2411), lines between them
//! (82), and a real normal mode each with three translations and three rotations a node (55).
//!
//! A layout, lines between its nodes, and mode shapes over the rows of the matrices flow in; the file's text flows out.

use std::collections::{HashMap, HashSet};

use nalgebra::DMatrix;

use super::universal::{MARK, exponent, integers, reals, title_line, trace_lines, units};
use crate::model::{LayoutNode, Wireframe};

/// Where `ux, uy, uz, rx, ry, rz` are among [`LayoutNode::rows`].
const ORDER: [usize; 6] = [0, 1, 5, 2, 3, 4];

/// Modes of a model.
pub(super) struct ModelModes<'a> {
    /// What the structure is called.
    pub(super) title: &'a str,
    /// Where its nodes stand.
    pub(super) layout: &'a [LayoutNode],
    /// Lines between them; without any, nodes are joined by height.
    pub(super) frame: Option<&'a Wireframe>,
    pub(super) frequency_hz: &'a [f64],
    /// Rows of the matrices x modes, of unit modal mass.
    pub(super) shapes: &'a DMatrix<f64>,
}

/// The file's text.
pub(super) fn text(modes: &ModelModes<'_>) -> String {
    let labels = labels(modes.layout);
    let mut text = units();
    text += &format!("{MARK}  2411\n");
    for (node, label) in modes.layout.iter().zip(&labels) {
        // Both coordinate systems are the global one.
        text += &integers(&[*label, 0, 0, 11]);
        text += &node.position_m.map(|length| format!("{:>25}", exponent(length, 16, 'D'))).concat();
        text.push('\n');
    }
    text += MARK;
    text += &trace_lines(&lines(modes, &labels), "structure");
    for (index, frequency_hz) in modes.frequency_hz.iter().enumerate() {
        text += &dataset_55(modes, &labels, index, *frequency_hz);
    }
    text
}

/// Numbers of the nodes: their names where these are numbers, each of one node; else 1, 2, and so on.
fn labels(layout: &[LayoutNode]) -> Vec<i64> {
    let mut taken = HashSet::new();
    let is_label = |label: &i64| (1..=9_999_999_999).contains(label);
    let named: Option<Vec<i64>> = layout
        .iter()
        .map(|node| node.name.parse().ok().filter(is_label).filter(|label| taken.insert(*label)))
        .collect();
    named.unwrap_or_else(|| (1..=layout.len() as i64).collect())
}

/// Lines between nodes, by their numbers.
fn lines(modes: &ModelModes<'_>, labels: &[i64]) -> Vec<[i64; 2]> {
    if let Some(frame) = modes.frame {
        let known: HashMap<&str, i64> =
            modes.layout.iter().zip(labels).map(|(node, label)| (node.name.as_str(), *label)).collect();
        let label = |point: usize| known.get(frame.names.get(point)?.as_str()).copied();
        return frame.edges().into_iter().filter_map(|[a, b]| Some([label(a)?, label(b)?])).collect();
    }
    let mut upwards: Vec<(f64, i64)> =
        modes.layout.iter().map(|node| node.position_m[2]).zip(labels.iter().copied()).collect();
    upwards.sort_by(|a, b| a.0.total_cmp(&b.0));
    upwards.windows(2).map(|pair| [pair[0].1, pair[1].1]).collect()
}

/// Dataset 55: a real normal mode.
fn dataset_55(modes: &ModelModes<'_>, labels: &[i64], index: usize, frequency_hz: f64) -> String {
    let number = index as i64 + 1;
    let mut text =
        format!("{MARK}    55\n{}\nMode {number}, {frequency_hz} Hz\nNONE\nNONE\nNONE\n", title_line(modes.title));
    // Structural model, normal mode, six degrees of freedom a node, displacement, real numbers.
    text += &integers(&[1, 2, 3, 8, 2, 6]);
    // Two integers and four numbers follow: load case and mode, then frequency, modal mass, viscous and hysteretic damping.
    text += &integers(&[2, 4, 0, number]);
    text += &reals(&[frequency_hz, 1.0, 0.0, 0.0]);
    for (node, label) in modes.layout.iter().zip(labels) {
        let value = |dof: usize| {
            let row = node.rows.get(dof).copied().flatten()?;
            modes.shapes.get((row, index)).copied()
        };
        text += &integers(&[*label]);
        text += &reals(&ORDER.map(|dof| value(dof).unwrap_or(0.0)));
    }
    text + MARK
}
