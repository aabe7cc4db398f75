//! Sensors as directions at nodes, which universal files have: sensors flow in, each one's node and axis flows out.
//!
//! Whoever writes such a file and whoever reads it back number alike, by places in the sensors' order. Sensors at one place that are at
//! right angles are one node; a coordinate system says where its axes point, so that no azimuth is lost.

use nalgebra::Vector3;

use crate::study::{Direction, Sensor};

/// The global Cartesian coordinate system.
pub(crate) const GLOBAL: usize = 0;
/// Number of the first coordinate system that is turned; 1 and 2 are the global ones of some tools.
pub(crate) const FIRST_TURNED: usize = 11;
/// How far from a right angle, or from each other, directions may be by rounding.
const ROUNDING: f64 = 1e-9;

/// A coordinate system: where its X and its Z axis point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Turned {
    pub(crate) x: [f64; 3],
    pub(crate) z: [f64; 3],
}

/// A sensor as a direction at a node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct NodeAxis {
    /// Label of the node, from 1.
    pub(crate) node: i64,
    /// 0, 1, 2: x, y, z of the node's coordinate system.
    pub(crate) axis: usize,
    /// That coordinate system.
    pub(crate) system: usize,
    pub(crate) position_m: Option<[f64; 3]>,
}

/// Where a sensor stands.
pub(crate) fn position_m(sensor: &Sensor) -> Option<[f64; 3]> {
    let [x, y] = sensor.offset_m;
    sensor.elevation_m.map(|z| [x, y, z])
}

/// Sensors that share a node.
struct Group {
    /// Where they stand, and their directions, where others may join.
    open: Option<([f64; 3], Vec<[f64; 3]>)>,
    sensors: Vec<usize>,
}

/// Node and axis of each of the sensors, whose nodes are numbered from `first` on; systems that are new are appended to `turned`.
pub(crate) fn numbered(sensors: &[&Sensor], first: i64, turned: &mut Vec<Turned>) -> Vec<NodeAxis> {
    let mut groups: Vec<Group> = Vec::new();
    for (index, sensor) in sensors.iter().enumerate() {
        let own = position_m(sensor).zip(sensor.direction.map(Direction::cosines)).filter(|_| sensor.is_of_a_point());
        let shared = own.and_then(|(place_m, along)| {
            groups.iter().position(|group| {
                group.open.as_ref().is_some_and(|(here_m, directions)| {
                    *here_m == place_m && directions.iter().all(|other| dot(*other, along).abs() < ROUNDING)
                })
            })
        });
        match (shared.and_then(|group| groups.get_mut(group)), own) {
            (Some(group), Some((_, along))) => {
                group.sensors.push(index);
                group.open.iter_mut().for_each(|(_, directions)| directions.push(along));
            }
            _ => groups.push(Group { open: own.map(|(place_m, along)| (place_m, vec![along])), sensors: vec![index] }),
        }
    }
    let mut node_axes: Vec<Option<NodeAxis>> = vec![None; sensors.len()];
    for (node, group) in (first..).zip(groups) {
        let (axes, system) = match (&group.open, &group.sensors[..]) {
            (Some((_, directions)), _) => axes(directions, turned),
            (None, [sensor]) => {
                let sensor = sensors[*sensor];
                let (axis, system) = alone(sensor.direction, position_m(sensor).is_some(), turned);
                (vec![axis], system)
            }
            (None, _) => continue,
        };
        for (sensor, axis) in group.sensors.iter().zip(axes) {
            let position_m = position_m(sensors[*sensor]);
            node_axes[*sensor] = Some(NodeAxis { node, axis, system, position_m });
        }
    }
    node_axes.into_iter().flatten().collect()
}

/// Axis and system of a sensor that shares its node with none. A node whose place is not known stands in no list of nodes and so has no
/// system of its own: its component then goes to the nearest axis.
fn alone(direction: Option<Direction>, is_placed: bool, turned: &mut Vec<Turned>) -> (usize, usize) {
    let Some(direction) = direction else { return (0, GLOBAL) };
    let along = direction.cosines();
    if is_placed {
        let (axes, system) = axes(&[along], turned);
        return (axes.first().copied().unwrap_or(0), system);
    }
    let nearest = (0..3).max_by(|&a, &b| along[a].abs().total_cmp(&along[b].abs()));
    (nearest.unwrap_or(0), GLOBAL)
}

/// Axes of directions at right angles, and their system: the global one where it has all of them, else the one with its Z axis the most upwards.
fn axes(directions: &[[f64; 3]], turned: &mut Vec<Turned>) -> (Vec<usize>, usize) {
    let of_global = |along: &[f64; 3]| along.iter().position(|cosine| *cosine == 1.0);
    if let Some(axes) = directions.iter().map(of_global).collect::<Option<Vec<usize>>>() {
        return (axes, GLOBAL);
    }
    let mut best: Option<(Vec<usize>, Turned)> = None;
    for [first, second, third] in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
        let order = &[first, second, third][..directions.len().min(3)];
        let Some(system) = system(directions, order) else { continue };
        if best.as_ref().is_none_or(|(_, before)| system.z[2] > before.z[2] + ROUNDING) {
            best = Some((order.to_vec(), system));
        }
    }
    let Some((axes, system)) = best else { return (vec![0; directions.len()], GLOBAL) };
    // A whole turn more is the same direction, but for rounding.
    let is_near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < ROUNDING);
    let known = turned.iter().position(|known| is_near(known.x, system.x) && is_near(known.z, system.z));
    let number = known.unwrap_or_else(|| {
        turned.push(system);
        turned.len() - 1
    });
    (axes, FIRST_TURNED + number)
}

/// The right-handed system that has these directions as these axes; none where it would be left-handed.
fn system(directions: &[[f64; 3]], axes: &[usize]) -> Option<Turned> {
    let of_axis = |axis: usize| axes.iter().position(|one| *one == axis).and_then(|at| directions.get(at)).copied();
    match (of_axis(0), of_axis(1), of_axis(2)) {
        // One direction alone is the X axis.
        (Some(x), None, None) => Some(Turned { x, z: upwards_beside(x) }),
        (Some(x), Some(y), None) => Some(Turned { x, z: cross(x, y) }),
        (Some(x), None, Some(z)) => Some(Turned { x, z }),
        (None, Some(y), Some(z)) => Some(Turned { x: cross(y, z), z }),
        (Some(x), Some(y), Some(z)) if dot(cross(x, y), z) > 0.0 => Some(Turned { x, z }),
        _ => None,
    }
}

/// The direction at a right angle to this one that points the most upwards; beside a vertical one the global X.
fn upwards_beside(along: [f64; 3]) -> [f64; 3] {
    let [x, y, z] = along;
    if z == 0.0 {
        return [0.0, 0.0, 1.0];
    }
    let level = x.hypot(y);
    if level < ROUNDING { [1.0, 0.0, 0.0] } else { [-z * x / level, -z * y / level, level] }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    Vector3::from(a).dot(&Vector3::from(b))
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    Vector3::from(a).cross(&Vector3::from(b)).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sensor on a mast.
    fn sensor(z_m: Option<f64>, direction: Option<Direction>) -> Sensor {
        Sensor { elevation_m: z_m, direction, ..Sensor::new("a", 1) }
    }

    fn node_axes(sensors: &[Sensor]) -> (Vec<(i64, usize, usize)>, Vec<Turned>) {
        let mut turned = Vec::new();
        let sensors: Vec<&Sensor> = sensors.iter().collect();
        let numbered = numbered(&sensors, 1, &mut turned);
        (numbered.iter().map(|one| (one.node, one.axis, one.system)).collect(), turned)
    }

    fn at(z_m: f64, azimuth: f64) -> Sensor {
        sensor(Some(z_m), Some(Direction::AzimuthDeg(azimuth)))
    }

    #[test]
    fn directions_off_the_axes_get_a_coordinate_system_each() {
        let (axes, turned) = node_axes(&[at(1.0, 0.0), at(2.0, 90.0), at(3.0, 18.0), at(4.0, 180.0), at(5.0, 378.0)]);
        assert_eq!(axes, [(1, 0, 0), (2, 1, 0), (3, 0, 11), (4, 0, 12), (5, 0, 11)]);
        let along = |azimuth: f64| Direction::AzimuthDeg(azimuth).cosines();
        assert_eq!([turned[0].x, turned[1].x], [along(18.0), along(180.0)]);
        assert!(turned.iter().all(|system| system.z == [0.0, 0.0, 1.0]), "{turned:?}");
        // Where nothing says where a sensor stands, the nearest axis.
        let nowhere = |azimuth: f64| sensor(None, Some(Direction::AzimuthDeg(azimuth)));
        assert_eq!(node_axes(&[nowhere(100.0), nowhere(-10.0)]).0, [(1, 1, 0), (2, 0, 0)]);
        assert_eq!(node_axes(&[sensor(Some(3.0), None)]).0, [(1, 0, 0)]);
    }

    #[test]
    fn sensors_at_one_place_are_one_node() {
        let up = sensor(Some(9.0), Some(Direction::Up));
        // Along the global axes, in whatever order.
        assert_eq!(node_axes(&[at(9.0, 90.0), up.clone(), at(9.0, 0.0)]).0, [(1, 1, 0), (1, 2, 0), (1, 0, 0)]);
        // Turned: x at 18 degrees, y at 108, z up.
        let (axes, turned) = node_axes(&[at(9.0, 108.0), at(9.0, 18.0), up, at(20.0, 18.0)]);
        assert_eq!(axes, [(1, 1, 11), (1, 0, 11), (1, 2, 11), (2, 0, 11)]);
        assert_eq!(turned.len(), 1);
        // A sensor the other way, and one that is not at a right angle, need a node of their own.
        assert_eq!(node_axes(&[at(9.0, 0.0), at(9.0, 180.0), at(9.0, 30.0)]).0, [(1, 0, 0), (2, 0, 11), (3, 0, 12)]);
        // So does what measures no motion of a point.
        let tilt = Sensor { unit: Some(crate::study::Unit::Radian), ..at(9.0, 90.0) };
        assert_eq!(node_axes(&[at(9.0, 0.0), tilt]).0, [(1, 0, 0), (2, 1, 0)]);
    }

    /// Every axis of a system points as its sensor does, with its sign.
    #[test]
    fn systems_are_right_handed_and_have_the_directions_as_axes() {
        for azimuths in [[18.0, 108.0], [18.0, -72.0], [180.0, 270.0], [200.0, 110.0]] {
            let (axes, turned) = node_axes(&azimuths.map(|azimuth| at(3.0, azimuth)));
            let Turned { x, z } = turned[0];
            let system = [x, cross(z, x), z];
            for ((node, axis, _), azimuth) in axes.into_iter().zip(azimuths) {
                let along = Direction::AzimuthDeg(azimuth).cosines();
                assert!(node == 1 && dot(system[axis], along) > 1.0 - 1e-12, "{azimuths:?}: {system:?}");
            }
            assert!(z[2] > 0.999, "{z:?}");
        }
    }
}
