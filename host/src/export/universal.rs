//! Modes as a universal file: units (dataset 164), the sensors' coordinate systems (18) and places (15), lines between them (82), and a
//! complex mode each (55), as SDRC's universal file format describes them, columns included.
//!
//! A channel is a direction at a node. Channels that are named so (`12x`) keep their node; others become nodes 1 to p in the
//! study's order, with their component along the node's own axis x (z for vertical ones): a coordinate system says where
//! that axis points, so that no azimuth is lost.

use std::collections::BTreeSet;

use num_complex::Complex64;

use super::modes::{Mode, Modes};
use crate::modes::node_and_direction;
use crate::spanning::shortest_lines;
use crate::study::{Direction, Sensor};

/// The global Cartesian coordinate system.
const GLOBAL: usize = 0;
/// Number of the first coordinate system that is turned; 1 and 2 are the global ones of some tools.
const FIRST_TURNED: usize = 11;
pub(super) const MARK: &str = "    -1\n";

/// A channel as a direction at a node.
#[derive(Debug, Clone, Copy, PartialEq)]
struct NodeAxis {
    /// Label of the node, from 1.
    node: i64,
    /// 0, 1, 2: x, y, z of the node's coordinate system.
    axis: usize,
    /// That coordinate system.
    system: usize,
    position_m: Option<[f64; 3]>,
}

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

fn node_axes(sensors: &[Sensor], turned: &mut Vec<[f64; 3]>, warnings: &mut Vec<String>) -> Vec<NodeAxis> {
    let position_m = |sensor: &Sensor| {
        let [x, y] = sensor.offset_m;
        sensor.elevation_m.map(|z| [x, y, z])
    };
    let mut taken = BTreeSet::new();
    let mut node_axes: Vec<Option<NodeAxis>> = sensors
        .iter()
        .map(|sensor| {
            let (node, axis) = named(sensor).filter(|name| taken.insert(*name))?;
            Some(NodeAxis { node, axis, system: GLOBAL, position_m: position_m(sensor) })
        })
        .collect();
    let unnamed: Vec<&str> = sensors
        .iter()
        .zip(&node_axes)
        .filter(|(_, node_axis)| node_axis.is_none())
        .map(|(sensor, _)| sensor.channel.as_str())
        .collect();
    if !taken.is_empty() && !unnamed.is_empty() {
        warnings.push(format!(
            "channel {} is not named by a node and direction of its own, as others are (12x): it gets a node by which Belfry cannot find the channel again",
            unnamed.join(", ")
        ));
    }
    let free = taken.iter().map(|(node, _)| *node).max().unwrap_or(0) + 1;
    let without = node_axes.iter_mut().zip(sensors).filter(|(node_axis, _)| node_axis.is_none());
    for (node, (node_axis, sensor)) in (free..).zip(without) {
        let position_m = position_m(sensor);
        let (axis, system) = axis(sensor.direction, position_m.is_some(), turned);
        *node_axis = Some(NodeAxis { node, axis, system, position_m });
    }
    node_axes.into_iter().flatten().collect()
}

/// Axis and coordinate system of a direction. A node whose place is not known stands in no dataset 15 and so has no system
/// of its own: its component then goes to the nearest axis.
fn axis(direction: Option<Direction>, placed: bool, turned: &mut Vec<[f64; 3]>) -> (usize, usize) {
    let Some(direction) = direction else { return (0, GLOBAL) };
    let cosines = direction.cosines();
    if let Some(along) = cosines.iter().position(|cosine| *cosine == 1.0) {
        return (along, GLOBAL);
    }
    if !placed {
        let nearest = (0..3).max_by(|&a, &b| cosines[a].abs().total_cmp(&cosines[b].abs()));
        return (nearest.unwrap_or(0), GLOBAL);
    }
    // A whole turn more is the same direction, but for rounding.
    let is_same = |known: &[f64; 3]| known.iter().zip(cosines).all(|(a, b)| (a - b).abs() < 1e-9);
    let known = turned.iter().position(is_same);
    let system = known.unwrap_or_else(|| {
        turned.push(cosines);
        turned.len() - 1
    });
    (0, FIRST_TURNED + system)
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

/// Dataset 18: systems whose X axes are these directions.
fn systems(turned: &[[f64; 3]]) -> String {
    if turned.is_empty() {
        return String::new();
    }
    let mut text = format!("{MARK}    18\n");
    for (number, &[x, y, z]) in (FIRST_TURNED..).zip(turned) {
        text += &format!("{number:10}{:10}{GLOBAL:10}{:10}{:10}\n", 0, 8, 1);
        // To a millionth of a degree: 180, not 179.99999999999997.
        let degrees = |radians: f64| (1e6 * radians.to_degrees()).round() / 1e6;
        let inclination = if z == 0.0 { String::new() } else { format!(", inclination {} deg", degrees(z.asin())) };
        text += &format!("azimuth {} deg{inclination}\n", degrees(y.atan2(x)).rem_euclid(360.0));
        // The origin, a point of the X axis, and one of the XZ plane: beside a vertical axis the global X.
        text += &reals(&[0.0, 0.0, 0.0, x, y, z]);
        text += &reals(if x.hypot(y) > 0.0 { &[0.0, 0.0, 1.0] } else { &[1.0, 0.0, 0.0] });
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

/// Lines between the nodes of channels of one direction.
fn lines_between(node_axes: &[NodeAxis]) -> Vec<[i64; 2]> {
    let mut directions: Vec<(usize, usize)> = node_axes.iter().map(|one| (one.system, one.axis)).collect();
    directions.sort_unstable();
    directions.dedup();
    let mut lines = Vec::new();
    for direction in directions {
        let (nodes, places_m): (Vec<i64>, Vec<[f64; 3]>) = node_axes
            .iter()
            .filter(|one| (one.system, one.axis) == direction)
            .filter_map(|one| Some((one.node, one.position_m?)))
            .unzip();
        let label = |at: usize| nodes.get(at).copied();
        let joined = shortest_lines(&places_m);
        lines.extend(
            joined.into_iter().filter_map(|[a, b]| Some([label(a)?, label(b)?])).map(|[a, b]| [a.min(b), a.max(b)]),
        );
    }
    lines.sort_unstable();
    // Two directions of one node are joined alike.
    lines.dedup();
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
    use super::{axis, eigenvalue, exponent};
    use crate::study::Direction;

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

    #[test]
    fn directions_off_the_axes_get_a_coordinate_system_each() {
        let mut azimuths = Vec::new();
        let mut at = |azimuth: f64, placed: bool| axis(Some(Direction::AzimuthDeg(azimuth)), placed, &mut azimuths);
        assert_eq!(
            [at(0.0, true), at(90.0, true), at(18.0, true), at(180.0, true), at(378.0, true)],
            [(0, 0), (1, 0), (0, 11), (0, 12), (0, 11)]
        );
        assert_eq!([at(100.0, false), at(-10.0, false)], [(1, 0), (0, 0)]);
        let along = |azimuth: f64| Direction::AzimuthDeg(azimuth).cosines();
        assert_eq!(azimuths, [along(18.0), along(180.0)]);
    }
}
