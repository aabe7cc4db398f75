//! Modes as a universal file: units (dataset 164), the sensors' coordinate systems (18) and places (15), lines between them (82), and a
//! complex mode each (55), as SDRC's universal file format describes them, columns included.
//!
//! A channel is a direction at a node. Channels that are named so (`12x`) keep their node; the places of others become nodes 1, 2 and so on
//! in the study's order (`modes::nodes`), with a component along an axis of the node's own coordinate system for each sensor there.

use std::collections::BTreeSet;

use num_complex::Complex64;

use super::modes::{Mode, Modes};
use crate::joints::structural_lines;
use crate::modes::node_and_direction;
use crate::modes::nodes::{FIRST_TURNED, GLOBAL, NodeAxis, Turned, numbered, position_m};
use crate::study::Sensor;

pub(super) const MARK: &str = "    -1\n";

/// The file's text, and what the reader of it should know.
pub fn text(modes: &Modes, title: &str) -> (String, Vec<String>) {
    let mut warnings = Vec::new();
    let mut turned = Vec::new();
    let node_axes = node_axes(&modes.sensors, &mut turned, &mut warnings);
    let unmeasured: Vec<&str> = (0..modes.sensors.len())
        .filter(|sensor| !modes.is_measured(*sensor))
        .filter_map(|sensor| Some(modes.sensors.get(sensor)?.channel.as_str()))
        .collect();
    let by_name = modes.sensors.iter().any(|sensor| named(sensor).is_some());
    if !unmeasured.is_empty() && !by_name {
        warnings.push(format!(
            "no mode has a component at channel {}: the nodes of a universal file then go to the study's channels by name only; call channels by node and direction (12x) where Belfry is to read the file back",
            unmeasured.join(", ")
        ));
    }
    let mut text = units();
    text += &systems(&turned);
    text += &nodes(&node_axes);
    text += &trace_lines(&lines_between(&node_axes), "sensors");
    for mode in &modes.modes {
        text += &dataset_55(mode, &node_axes, title);
    }
    (text, warnings)
}

/// Node and direction that a sensor's channel, or its point, is named by.
fn named(sensor: &Sensor) -> Option<(i64, usize)> {
    let name = node_and_direction(&sensor.channel).or_else(|| node_and_direction(&sensor.point));
    // Labels are positive; -1 would be read as a dataset's end.
    name.filter(|(node, _)| (1..=9_999_999_999).contains(node))
}

fn node_axes(sensors: &[Sensor], turned: &mut Vec<Turned>, warnings: &mut Vec<String>) -> Vec<NodeAxis> {
    let mut taken = BTreeSet::new();
    let mut node_axes: Vec<Option<NodeAxis>> = sensors
        .iter()
        .map(|sensor| {
            let (node, axis) = named(sensor).filter(|name| taken.insert(*name))?;
            Some(NodeAxis { node, axis, system: GLOBAL, position_m: position_m(sensor) })
        })
        .collect();
    let unnamed =
        || sensors.iter().zip(&node_axes).filter(|(_, node_axis)| node_axis.is_none()).map(|(sensor, _)| sensor);
    if !taken.is_empty() && unnamed().next().is_some() {
        let channels: Vec<&str> = unnamed().map(|sensor| sensor.channel.as_str()).collect();
        warnings.push(format!(
            "channel {} is not named by a node and direction of its own, as others are (12x): it gets a node by which Belfry cannot find the channel again",
            channels.join(", ")
        ));
    }
    let free = taken.iter().map(|(node, _)| *node).max().unwrap_or(0) + 1;
    let others = numbered(&unnamed().collect::<Vec<_>>(), free, turned);
    let without = node_axes.iter_mut().filter(|node_axis| node_axis.is_none());
    without.zip(others).for_each(|(node_axis, other)| *node_axis = Some(other));
    node_axes.into_iter().flatten().collect()
}

/// Dataset 164: SI, metres and newtons.
pub(super) fn units() -> String {
    let one = exponent(1.0, 17, 'D');
    let kelvin = exponent(273.15, 17, 'D');
    format!(
        "{MARK}   164\n{:10}{:20}{:10}\n{one:>25}{one:>25}{one:>25}\n{kelvin:>25}\n{MARK}",
        1, "SI: Meter (newton)", 2
    )
}

/// Dataset 18: the coordinate systems that are turned.
fn systems(turned: &[Turned]) -> String {
    if turned.is_empty() {
        return String::new();
    }
    let mut text = format!("{MARK}    18\n");
    for (number, &Turned { x: [x, y, z], z: beside }) in (FIRST_TURNED..).zip(turned) {
        text += &format!("{number:10}{:10}{GLOBAL:10}{:10}{:10}\n", 0, 8, 1);
        // To a millionth of a degree: 180, not 179.99999999999997.
        let degrees = |radians: f64| (1e6 * radians.to_degrees()).round() / 1e6;
        let inclination = if z == 0.0 { String::new() } else { format!(", inclination {} deg", degrees(z.asin())) };
        text += &format!("azimuth {} deg{inclination}\n", degrees(y.atan2(x)).rem_euclid(360.0));
        // The origin, a point of the X axis, and one of the XZ plane; a cross product may have a zero with a sign.
        text += &reals(&[0.0, 0.0, 0.0, x, y, z]);
        text += &reals(&beside.map(|part| part + 0.0));
    }
    text + MARK
}

/// Dataset 15: the nodes whose places are known, each once.
fn nodes(node_axes: &[NodeAxis]) -> String {
    let mut seen = BTreeSet::new();
    let mut lines = String::new();
    for node_axis in node_axes {
        let Some(position_m) = node_axis.position_m.filter(|_| seen.insert(node_axis.node)) else { continue };
        lines += &format!("{:10}{GLOBAL:10}{:10}{:10}", node_axis.node, node_axis.system, 11);
        lines += &reals(&position_m);
    }
    if lines.is_empty() { lines } else { format!("{MARK}    15\n{lines}{MARK}") }
}

/// Dataset 82: lines that other programs draw between nodes, a pair each.
pub(super) fn trace_lines(lines: &[[i64; 2]], name: &str) -> String {
    /// Nodes of a line of the dataset at most.
    const MOST: usize = 250;
    const PEN_UP: i64 = 0;
    let mut text = String::new();
    let joined: Vec<[i64; 3]> = lines.iter().map(|&[a, b]| [a, b, PEN_UP]).collect();
    for (number, part) in (1..).zip(joined.chunks(MOST / 3)) {
        let entries = part.concat();
        text += &format!("{MARK}    82\n");
        text += &integers(&[number, entries.len() as i64, 11]);
        text += &format!("{name}\n");
        for entries in entries.chunks(8) {
            text += &integers(entries);
        }
        text += MARK;
    }
    text
}

/// Lines of the structure between all nodes whose places are known, by their numbers.
fn lines_between(node_axes: &[NodeAxis]) -> Vec<[i64; 2]> {
    let mut seen = BTreeSet::new();
    let (nodes, places_m): (Vec<i64>, Vec<[f64; 3]>) = node_axes
        .iter()
        .filter_map(|one| Some((one.node, one.position_m?)))
        .filter(|(node, _)| seen.insert(*node))
        .unzip();
    let label = |at: usize| nodes.get(at).copied();
    let joined = structural_lines(&places_m);
    let mut lines: Vec<[i64; 2]> = joined
        .into_iter()
        .filter_map(|[a, b]| Some([label(a)?, label(b)?]))
        .map(|[a, b]| [a.min(b), a.max(b)])
        .collect();
    lines.sort_unstable();
    lines
}

/// A title as these files can have it.
pub(super) fn title_line(title: &str) -> String {
    let printable: String =
        title.chars().map(|c| if c.is_ascii_graphic() || c == ' ' { c } else { '?' }).take(80).collect();
    // One that a reader would take for the dataset's end.
    if printable.trim() == "-1" { "NONE".to_owned() } else { printable.trim().to_owned() }
}

/// Dataset 55: a complex mode at nodes.
fn dataset_55(mode: &Mode, node_axes: &[NodeAxis], title: &str) -> String {
    let (title, number, hz) = (title_line(title), mode.number, mode.frequency_hz);
    let mut text = format!("{MARK}    55\n{title}\nMode {number}, {hz} Hz\nNONE\nNONE\nNONE\n");
    // Structural model, complex eigenvalues of first order, three translations a node, displacement, complex numbers.
    text += &integers(&[1, 3, 2, 8, 5, 3]);
    // Two integers and six numbers follow: load case and mode, then the eigenvalue, modal A and modal B (not known).
    text += &integers(&[2, 6, 0, mode.number as i64]);
    let eigenvalue = eigenvalue(mode.frequency_hz, mode.damping_ratio.unwrap_or(0.0));
    text += &reals(&[eigenvalue.re, eigenvalue.im, 0.0, 0.0, 0.0, 0.0]);
    let mut nodes: Vec<(i64, [Complex64; 3])> = Vec::new();
    for (node_axis, component) in node_axes.iter().zip(&mode.shape) {
        let Some(component) = component else { continue };
        if nodes.iter().all(|(node, _)| *node != node_axis.node) {
            nodes.push((node_axis.node, [Complex64::ZERO; 3]));
        }
        let values = nodes.iter_mut().find(|(node, _)| *node == node_axis.node);
        if let Some(value) = values.and_then(|(_, values)| values.get_mut(node_axis.axis)) {
            *value = component.value;
        }
    }
    for (node, values) in nodes {
        text += &integers(&[node]);
        text += &reals(&values.map(|value| [value.re, value.im]).concat());
    }
    text + MARK
}

/// s = -zeta omega + i omega sqrt(1 - zeta²), of the upper half plane.
fn eigenvalue(frequency_hz: f64, damping_ratio: f64) -> Complex64 {
    let circular = std::f64::consts::TAU * frequency_hz;
    Complex64::new(-damping_ratio * circular, circular * (1.0 - damping_ratio * damping_ratio).max(0.0).sqrt())
}

/// A line of I10.
pub(super) fn integers(numbers: &[i64]) -> String {
    numbers.iter().map(|number| format!("{number:10}")).collect::<String>() + "\n"
}

/// A line of E13.5.
pub(super) fn reals(numbers: &[f64]) -> String {
    numbers.iter().map(|number| format!("{:>13}", exponent(*number, 5, 'E'))).collect::<String>() + "\n"
}

/// A number with an exponent of two digits, as Fortran writes it.
pub(super) fn exponent(number: f64, decimals: usize, letter: char) -> String {
    let text = format!("{number:.decimals$e}");
    let (mantissa, power) = text.split_once('e').unwrap_or((&text, "0"));
    match power.parse::<i32>() {
        Ok(power) if power < -99 => exponent(0.0, decimals, letter),
        Ok(power) => format!("{mantissa}{letter}{power:+03}"),
        Err(_) => text,
    }
}

#[cfg(test)]
mod tests {
    use super::{eigenvalue, exponent};

    #[test]
    fn numbers_are_written_as_fortran_writes_them() {
        for (number, expected) in [
            (0.0, "0.00000E+00"),
            (-1.5, "-1.50000E+00"),
            (12345.678, "1.23457E+04"),
            (2e-7, "2.00000E-07"),
            (1e-120, "0.00000E+00"),
        ] {
            assert_eq!(exponent(number, 5, 'E'), expected);
        }
    }

    #[test]
    fn an_eigenvalue_has_the_undamped_frequency_as_its_size() {
        let eigenvalue = eigenvalue(0.5, 0.02);
        assert!((eigenvalue.norm() - std::f64::consts::PI).abs() < 1e-12);
        assert!((eigenvalue.re / eigenvalue.norm() + 0.02).abs() < 1e-12);
    }
}
