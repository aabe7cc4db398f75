//! What sensors see of the model: places and directions flow in, a matrix over the DOFs flows out.

use nalgebra::{DMatrix, RowDVector};
use thiserror::Error;

use super::assembly::Assembly;
use super::distortion::Distortion;
use super::geometry::{Geometry, Line};
use super::layout::{LayoutNode, TRANSLATIONS, longest_side_m};
use crate::modes::node_and_direction;
use crate::study::{Direction, Motion, Sensor, Unit};

/// Why a sensor has no place in the model.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum SensorError {
    /// The study does not say how high it stands.
    #[error("channel {channel}: no elevation_m; a comparison with the model needs the height of every sensor")]
    NoElevation {
        /// The channel.
        channel: String,
    },
    /// The study does not say which way it points.
    #[error("channel {channel}: no azimuth_deg; give degrees anticlockwise from +X seen from above, or \"up\"")]
    NoDirection {
        /// The channel.
        channel: String,
    },
    /// It stands above or below the beam.
    #[error(
        "channel {channel}: elevation_m = {elevation_m} lies outside the structure, which stands from {z_base_m} m to {z_top_m} m"
    )]
    OutsideBeam {
        /// The channel.
        channel: String,
        /// Its height.
        elevation_m: f64,
        /// Where the beam starts.
        z_base_m: f64,
        /// Where it ends.
        z_top_m: f64,
    },
    /// The model's matrices come without places.
    #[error(
        "channel {channel}: the model's matrices come without places of their rows; give the sensor a `dof` (row of the matrices, from 1), or the matrices `nodes` or `dofs`"
    )]
    NoPlaces {
        /// The channel.
        channel: String,
    },
    /// It stands far from all nodes of a structure in space.
    #[error(
        "channel {channel}: no node stands near {place:?} m (x, y, height): the nearest is {nearest}; check units and axes, or name the node with model_node"
    )]
    NotAtNode {
        /// The channel.
        channel: String,
        /// Where the sensor stands.
        place: [f64; 3],
        /// The nearest node, where that stands, and how far away.
        nearest: String,
    },
    /// It points where the model does not move.
    #[error(
        "channel {channel}: points along {axis}, but the model has no motion along {axis} there: its `dofs` name no {dof}, free or fixed"
    )]
    NoMotion {
        /// The channel.
        channel: String,
        /// `X`, `Y` or `Z`.
        axis: &'static str,
        /// `ux`, `uy` or `uz`.
        dof: &'static str,
    },
    /// It names no row of a model whose rows have names.
    #[error("channel {channel}: no row of the model has that name (nor that of its `point`); there are {known}")]
    NotAmongPlaces {
        /// The channel.
        channel: String,
        /// The names.
        known: String,
    },
    /// A strain gauge at the beam's axis.
    #[error("channel {channel}: a strain gauge at the axis sees no bending; give its place in plan, offset_m = [x, y]")]
    StrainAtAxis {
        /// The channel.
        channel: String,
    },
    /// A strain gauge where no beam says how fibres stretch, or a tilt that is not horizontal.
    #[error(
        "channel {channel}: the model does not tell this: tilt and strain need nodes that stand above each other and turn about X and Y, tilt a horizontal direction"
    )]
    NotOfAPoint {
        /// The channel.
        channel: String,
    },
    /// It names a row that the matrices do not have.
    #[error("channel {channel}: dof = {dof}, but the model's matrices have the rows 1 to {dofs}")]
    NoSuchDof {
        /// The channel.
        channel: String,
        /// The row asked for.
        dof: usize,
        /// The rows there are.
        dofs: usize,
    },
}

/// A sensor this far (in m) outside the beam stands at its end: rounding in the files.
const END_TOLERANCE_M: f64 = 1e-6;
/// A direction cosine below this is rounding of a sensor that points along an axis.
const ALONG_AN_AXIS: f64 = 1e-9;
/// Half of the length over which a strain gauge is taken to measure, as a share of its segment.
const STRAIN_STEP: f64 = 0.01;
/// A sensor this near (in m) to a node of a structure in space stands at it.
const NODE_TOLERANCE_M: f64 = 1e-3;
/// A sensor further than this share of the structure's size from all nodes is not of this structure.
const FAR: f64 = 0.1;

/// A sensor of a structure in space that stands at no node, and whose motion is that of the nearest.
#[derive(Debug, Clone, PartialEq)]
pub struct BesideNode {
    /// The channel.
    pub channel: String,
    /// The node's name.
    pub node: String,
    /// How far it is, in m.
    pub distance_m: f64,
}

/// The node nearest to a place, and how far that is in m.
fn nearest_node(nodes: &[LayoutNode], place: [f64; 3]) -> Option<(&LayoutNode, f64)> {
    let distance =
        |node: &LayoutNode| node.position_m.iter().zip(place).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    nodes.iter().map(|node| (node, distance(node))).min_by(|a, b| a.1.total_cmp(&b.1))
}

/// The row that a sensor's channel or point names, by itself or as node and direction (`12x`, `12:+X`).
fn named_row(places: &[String], sensor: &Sensor) -> Option<usize> {
    let names = [&sensor.channel, &sensor.point];
    let by_name = names.into_iter().find_map(|name| places.iter().position(|place| place == name));
    by_name.or_else(|| {
        let sought = names.into_iter().find_map(|name| node_and_direction(name))?;
        places.iter().position(|place| node_and_direction(place) == Some(sought))
    })
}

/// The row of the node and direction that a sensor's channel or point names.
fn row_of_node(nodes: &[LayoutNode], sensor: &Sensor) -> Option<usize> {
    let row = |node: &LayoutNode| {
        // The order of a node's rows.
        let names = ["x", "y", "rx", "ry", "rz", "z"].map(|direction| format!("{}{direction}", node.name));
        let of_node = names.into_iter().zip(node.rows).filter_map(|(name, row)| Some((name, row?)));
        of_node.collect::<Vec<_>>()
    };
    let (names, rows): (Vec<String>, Vec<usize>) = nodes.iter().flat_map(row).unzip();
    rows.get(named_row(&names, sensor)?).copied()
}

/// The first few names.
fn listed(places: &[String]) -> String {
    const MOST: usize = 12;
    let more = if places.len() > MOST { format!(" and {} more", places.len() - MOST) } else { String::new() };
    format!("{}{more}", places[..places.len().min(MOST)].join(", "))
}

fn direction_of(sensor: &Sensor) -> Result<Direction, SensorError> {
    sensor.direction.ok_or_else(|| SensorError::NoDirection { channel: sensor.channel.clone() })
}

/// Whether the nodes turn about horizontal axes: where they do not, nothing tells how the axis leans.
fn has_rotations(line: &Line) -> bool {
    line.node_rows().iter().any(|node| node[2].is_some() || node[3].is_some())
}

fn check_inside(line: &Line, sensor: &Sensor, elevation_m: f64) -> Result<(), SensorError> {
    let (z_base_m, z_top_m) = (line.z_base_m(), line.z_top_m());
    if (z_base_m - END_TOLERANCE_M..=z_top_m + END_TOLERANCE_M).contains(&elevation_m) {
        return Ok(());
    }
    Err(SensorError::OutsideBeam { channel: sensor.channel.clone(), elevation_m, z_base_m, z_top_m })
}

impl Assembly {
    /// Motion at the sensors, sensors x DOFs, in the sensors' order and positive directions.
    ///
    /// Where nodes stand above each other the section is rigid, but for its [`Distortion`]: a sensor at the plan offset (x, y) moves by
    /// `ux - y rz` and `uy + x rz`, and up by `uz + y rx - x ry`. Between nodes see [`Assembly::axis_motion`]. In a structure in space the
    /// offset is the sensor's place in plan, and its motion that of the nearest node, see [`Assembly::beside_nodes`].
    ///
    /// # Errors
    /// [`SensorError`] names the channel.
    pub fn sensor_rows(&self, sensors: &[Sensor]) -> Result<DMatrix<f64>, SensorError> {
        let row = |sensor: &Sensor| {
            let mut row = self.sensor_row(sensor)?;
            if let Some(coordinates) = &self.coordinates {
                // A sensor names few rows of the whole model.
                let named = row.iter().enumerate().filter(|(_, share)| **share != 0.0);
                let nothing = RowDVector::zeros(self.dofs());
                row = named.fold(nothing, |sum, (at, share)| sum + coordinates.row(at) * *share);
            }
            if !self.distortion.is_none() {
                self.add_distorted(&mut row, sensor, self.distortion);
            }
            Ok(row)
        };
        self.recorded(sensors, row)
    }

    /// Sensors of a structure in space that stand at no node.
    pub fn beside_nodes(&self, sensors: &[Sensor]) -> Vec<BesideNode> {
        let Geometry::Space(nodes) = &self.geometry else { return Vec::new() };
        let beside = |sensor: &Sensor| {
            let z_m = sensor.elevation_m.filter(|_| sensor.dof.is_none())?;
            let [x, y] = sensor.offset_m;
            let (node, distance_m) = nearest_node(nodes, [x, y, z_m])?;
            let (channel, node) = (sensor.channel.clone(), node.name.clone());
            (distance_m > NODE_TOLERANCE_M).then_some(BesideNode { channel, node, distance_m })
        };
        sensors.iter().filter_map(beside).collect()
    }

    /// The rows of the model, as files have them, whose motion a sensor sees; none where it has no place.
    pub fn rows_seen_by(&self, sensor: &Sensor) -> Vec<usize> {
        let row = self.sensor_row(sensor).ok();
        let seen = row.iter().flat_map(|row| row.iter().enumerate().filter(|(_, share)| **share != 0.0));
        seen.map(|(at, _)| at).collect()
    }

    /// What of [`Assembly::sensor_rows`] such a distortion of sections makes, sensors x DOFs: linear in it.
    ///
    /// # Errors
    /// As there.
    pub(crate) fn distorted_rows(
        &self,
        sensors: &[Sensor],
        distortion: Distortion,
    ) -> Result<DMatrix<f64>, SensorError> {
        let row = |sensor: &Sensor| {
            let mut row = RowDVector::zeros(self.dofs());
            self.add_distorted(&mut row, sensor, distortion);
            Ok(row)
        };
        self.recorded(sensors, row)
    }

    /// Rows of sensors as they really point, as channels record them.
    fn recorded(
        &self,
        sensors: &[Sensor],
        row: impl Fn(&Sensor) -> Result<RowDVector<f64>, SensorError>,
    ) -> Result<DMatrix<f64>, SensorError> {
        let mut rows = DMatrix::zeros(sensors.len(), self.dofs());
        for (index, sensor) in sensors.iter().enumerate() {
            rows.set_row(index, &row(&self.sensing.turned(sensor))?);
        }
        self.sensing.record(&mut rows, sensors);
        Ok(rows)
    }

    /// Adds what a sensor sees of sections that distort: nothing at the axis, of tilt and strain, and where no beam says how it bends.
    fn add_distorted(&self, row: &mut RowDVector<f64>, sensor: &Sensor, distortion: Distortion) {
        let is_displaced = sensor.dof.is_none()
            && sensor.offset_m != [0.0; 2]
            && !matches!(sensor.unit.map(Unit::motion), Some(Motion::Tilt | Motion::Strain));
        let line = match &self.geometry {
            Geometry::Line(line) if is_displaced && has_rotations(line) => line,
            _ => return,
        };
        if let (Some(z_m), Some(direction)) = (sensor.elevation_m, sensor.direction) {
            let [cos, sin, _] = direction.cosines();
            line.add_bent(row, z_m, distortion.at(sensor.offset_m, [cos, sin]));
        }
    }

    /// The beam whose turning a sensor sees.
    fn turning(&self, sensor: &Sensor, elevation_m: f64) -> Result<&Line, SensorError> {
        match &self.geometry {
            Geometry::Line(line) => {
                check_inside(line, sensor, elevation_m)?;
                has_rotations(line).then_some(line)
            }
            _ => None,
        }
        .ok_or_else(|| SensorError::NotOfAPoint { channel: sensor.channel.clone() })
    }

    /// What an inclinometer sees: the axis leans towards +X by ry, towards +Y by -rx.
    fn tilt_row(&self, sensor: &Sensor, elevation_m: f64) -> Result<RowDVector<f64>, SensorError> {
        let [cos, sin, up] = direction_of(sensor)?.cosines();
        let line = self.turning(sensor, elevation_m)?;
        if up.abs() >= ALONG_AN_AXIS {
            return Err(SensorError::NotOfAPoint { channel: sensor.channel.clone() });
        }
        let mut row = RowDVector::zeros(self.dofs());
        line.local_motion(elevation_m).add_to(&mut row, [0.0, 0.0, -sin, cos, 0.0]);
        Ok(row)
    }

    /// What a vertical strain gauge sees: the section is rigid, so a fibre at the plan offset (x, y) moves up by y rx - x ry and
    /// stretches by y drx/dz - x dry/dz.
    fn strain_row(&self, sensor: &Sensor, elevation_m: f64) -> Result<RowDVector<f64>, SensorError> {
        let line = self.turning(sensor, elevation_m)?;
        let [x, y] = sensor.offset_m;
        let channel = || sensor.channel.clone();
        if sensor.offset_m == [0.0; 2] {
            return Err(SensorError::StrainAtAxis { channel: channel() });
        }
        let spans = line.spans();
        let span = spans.iter().find(|span| elevation_m <= span.z_top_m).or(spans.last());
        let span = span.ok_or_else(|| SensorError::NotOfAPoint { channel: channel() })?;
        // Rotations are parabolas within a span, so their slope is that between two heights about the sensor.
        let (bottom_m, top_m) = (span.z_bottom_m, span.z_top_m);
        let step_m = STRAIN_STEP * (top_m - bottom_m);
        let heights_m = [(elevation_m - step_m).max(bottom_m), (elevation_m + step_m).min(top_m)];
        let mut row = RowDVector::zeros(self.dofs());
        for (z_m, sign) in heights_m.into_iter().zip([-1.0, 1.0]) {
            let by_length = sign / (heights_m[1] - heights_m[0]);
            line.local_motion(z_m).add_to(&mut row, [0.0, 0.0, y * by_length, -x * by_length, 0.0]);
        }
        Ok(row)
    }

    fn sensor_row(&self, sensor: &Sensor) -> Result<RowDVector<f64>, SensorError> {
        let channel = || sensor.channel.clone();
        let of_row = |index: usize| {
            let mut row = RowDVector::zeros(self.rows());
            row[index] = 1.0;
            row
        };
        if let Some(dof) = sensor.dof {
            let index = dof.checked_sub(1).filter(|index| *index < self.rows());
            let no_such_dof = || SensorError::NoSuchDof { channel: channel(), dof, dofs: self.rows() };
            return index.map(of_row).ok_or_else(no_such_dof);
        }
        if let Geometry::Named(places) = &self.geometry {
            let not_among = || SensorError::NotAmongPlaces { channel: channel(), known: listed(places) };
            return named_row(places, sensor).map(of_row).ok_or_else(not_among);
        }
        if let (Geometry::Space(nodes), None) = (&self.geometry, sensor.elevation_m)
            && let Some(row) = row_of_node(nodes, sensor)
        {
            return Ok(of_row(row));
        }
        let elevation_m = sensor.elevation_m.ok_or_else(|| SensorError::NoElevation { channel: channel() })?;
        match sensor.unit.map(Unit::motion) {
            Some(Motion::Tilt) => return self.tilt_row(sensor, elevation_m),
            Some(Motion::Strain) => return self.strain_row(sensor, elevation_m),
            _ => {}
        }
        let cosines = direction_of(sensor)?.cosines();
        let cosines = cosines.map(|cosine| if cosine.abs() > ALONG_AN_AXIS { cosine } else { 0.0 });
        let [x, y] = sensor.offset_m;
        let check_moves = |moves: [bool; 3]| {
            let still = (0..3).find(|&axis| cosines[axis] != 0.0 && !moves[axis]);
            still.map_or(Ok(()), |still| {
                let (axis, dof) = [("X", "ux"), ("Y", "uy"), ("Z", "uz")][still];
                Err(SensorError::NoMotion { channel: channel(), axis, dof })
            })
        };
        let mut row = RowDVector::zeros(self.rows());
        match &self.geometry {
            Geometry::Line(line) => {
                check_inside(line, sensor, elevation_m)?;
                check_moves(line.moves())?;
                let [cos, sin, up] = cosines;
                // The section is rigid: the axis' motions, and what its rotations make of the offset.
                let of_axis = [cos, sin, y * up, -x * up, x * sin - y * cos];
                line.local_motion(elevation_m).add_to(&mut row, of_axis);
                line.add_vertical_motion(&mut row, elevation_m, up);
            }
            Geometry::Space(nodes) => {
                let place = [x, y, elevation_m];
                let nearest = nearest_node(nodes, place);
                let (nearest, distance_m) = nearest.ok_or_else(|| SensorError::NoPlaces { channel: channel() })?;
                if distance_m > (FAR * longest_side_m(nodes.iter().map(|node| node.position_m))).max(NODE_TOLERANCE_M) {
                    return Err(SensorError::NotAtNode {
                        channel: channel(),
                        place,
                        nearest: format!("{} at {:?}, {distance_m:.2} m away", nearest.name, nearest.position_m),
                    });
                }
                check_moves(TRANSLATIONS.map(|dof| nearest.rows[dof].is_some() || nearest.fixed[dof]))?;
                for (index, cosine) in nearest.translations().into_iter().zip(cosines) {
                    if let Some(index) = index {
                        row[index] += cosine;
                    }
                }
            }
            Geometry::Unknown | Geometry::Named(_) => return Err(SensorError::NoPlaces { channel: channel() }),
        }
        Ok(row)
    }
}
