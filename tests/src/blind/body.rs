//! A structure as it truly is: nodes with masses, elements between them, a base, springs, weights, attached oscillators and
//! sensors. A beam table cut finely flows in, effects change what they like, matrices and sensor rows flow out.
//!
//! Five DOFs a node, global: ux, uy, rx, ry, rz. Rigid in shear, ry = dux/dz and rx = -duy/dz.

use nalgebra::{DMatrix, SMatrix};

use super::banded::{Banded, Modes, lowest_modes};
use super::element::Plane;
use super::structures::Structure;
use super::table::{Channel, Segment};

pub(super) const DOFS: usize = 5;
const GRAVITY_M_S2: f64 = 9.81;
/// Elements that a table's segment is cut into, for the truth.
const CUTS: usize = 3;
/// Share of a table's lumped mass that goes to the fine nodes beside it, where its own inertia allows.
const SPREAD: f64 = 0.15;

#[derive(Debug, Clone, Default)]
pub(super) struct Node {
    pub(super) z_m: f64,
    pub(super) mass_kg: f64,
    pub(super) inertia_kg_m2: [f64; 3],
    /// What the table gives the node: rotary inertia about X and Y, before spreading.
    pub(super) table_inertia_kg_m2: [f64; 2],
    /// The mass's place in plan.
    pub(super) centre_m: [f64; 2],
}

#[derive(Debug, Clone)]
pub(super) struct Element {
    /// The table's segment that it is cut from.
    pub(super) segment: usize,
    pub(super) bending_n_m2: [f64; 2],
    pub(super) axis_deg: f64,
    pub(super) shear_compliance_per_n: [f64; 2],
    pub(super) torsion_n_m2: f64,
    /// Height above its bottom and flexibility of a rotational joint.
    pub(super) joint: Option<(f64, f64)>,
}

impl Element {
    /// Makes bending, shear and torsion stiffer by one factor.
    pub(super) fn scale(&mut self, factor: f64) {
        self.bending_n_m2 = self.bending_n_m2.map(|bending| bending * factor);
        self.shear_compliance_per_n = self.shear_compliance_per_n.map(|compliance| compliance / factor);
        self.torsion_n_m2 *= factor;
    }
}

impl Node {
    /// Makes the node heavier, its inertias too.
    pub(super) fn scale(&mut self, factor: f64) {
        self.mass_kg *= factor;
        self.inertia_kg_m2 = self.inertia_kg_m2.map(|inertia| inertia * factor);
        self.table_inertia_kg_m2 = self.table_inertia_kg_m2.map(|inertia| inertia * factor);
    }
}

/// A mass on a spring and a dashpot, moving along one horizontal direction.
#[derive(Debug, Clone)]
pub(super) struct Attachment {
    pub(super) z_m: f64,
    pub(super) azimuth_deg: f64,
    pub(super) mass_kg: f64,
    pub(super) frequency_hz: f64,
    pub(super) damping_ratio: f64,
}

/// A sensor as it truly is.
#[derive(Debug, Clone)]
pub(super) struct Sensor {
    pub(super) place: Channel,
    pub(super) factor: f64,
    pub(super) delay_s: f64,
}

#[derive(Debug, Clone)]
pub(super) struct Body {
    pub(super) nodes: Vec<Node>,
    /// `elements[i]` joins nodes i and i + 1.
    pub(super) elements: Vec<Element>,
    /// Flexibility of the base's DOFs; 0 is clamped.
    pub(super) base_flexibility: [f64; DOFS],
    /// Springs to the ground: node, DOF, stiffness.
    pub(super) springs: Vec<(usize, usize, f64)>,
    /// Share of the weight that acts through the deflection.
    pub(super) weight: f64,
    pub(super) attachments: Vec<Attachment>,
    pub(super) sensors: Vec<Sensor>,
    /// A steady tone in the recording.
    pub(super) tone_hz: Option<f64>,
    /// How all stiffness follows the temperature, relative per kelvin.
    pub(super) stiffness_per_kelvin: f64,
}

impl Body {
    /// The structure as its table has it, finely cut.
    pub(super) fn fine(structure: &Structure) -> Self {
        Self::cut(structure, CUTS, SPREAD)
    }

    /// The study's own mesh.
    pub(super) fn coarse(structure: &Structure) -> Self {
        Self::cut(structure, 1, 0.0)
    }

    fn cut(structure: &Structure, cuts: usize, spread: f64) -> Self {
        let segments = &structure.segments;
        let mut nodes = vec![Node { z_m: structure.base_m(), ..Node::default() }];
        let mut elements = Vec::new();
        for (segment, row) in segments.iter().enumerate() {
            for cut in 1..=cuts {
                let z_m = row.z_bottom_m + row.length_m() * cut as f64 / cuts as f64;
                nodes.push(Node { z_m, ..Node::default() });
                elements.push(Element {
                    segment,
                    bending_n_m2: row.bending_n_m2,
                    axis_deg: row.axis_deg,
                    shear_compliance_per_n: row.shear_n.map(|shear| 1.0 / shear),
                    torsion_n_m2: row.torsion_n_m2,
                    joint: None,
                });
            }
        }
        let mut body = Self {
            nodes,
            elements,
            base_flexibility: [0.0; DOFS],
            springs: Vec::new(),
            weight: 0.0,
            attachments: Vec::new(),
            sensors: (structure.channels.iter())
                .map(|place| Sensor { place: place.clone(), factor: 1.0, delay_s: 0.0 })
                .collect(),
            tone_hz: None,
            stiffness_per_kelvin: 0.0,
        };
        for (segment, row) in segments.iter().enumerate() {
            body.place_mass((segment + 1) * cuts, row, segments.get(segment + 1), cuts, spread);
        }
        body
    }

    /// Spreads a table's mass over its node and the two beside it; sum, centre and moments of inertia stay. The polar inertia stays
    /// at the node: in torsion nothing could make up for its spreading.
    fn place_mass(&mut self, node: usize, row: &Segment, above: Option<&Segment>, cuts: usize, spread: f64) {
        let [rotary_x, rotary_y, polar] = row.inertia_kg_m2;
        let mut inertia = row.inertia_kg_m2;
        self.nodes[node].table_inertia_kg_m2 = [rotary_x, rotary_y];
        let mut left = row.mass_top_kg;
        if let Some(above) = above.filter(|_| spread > 0.0) {
            let (below_m, above_m) = (row.length_m() / cuts as f64, above.length_m() / cuts as f64);
            // Of a share s, the part below lies at -a and the part above at +b: they balance, with second moment s m a b.
            let second = row.mass_top_kg * below_m * above_m;
            let share = spread.min(0.5 * rotary_x.min(rotary_y) / second);
            let down = share * above_m / (below_m + above_m);
            for (to, part) in [(node - 1, down), (node + 1, share - down)] {
                self.nodes[to].mass_kg += part * row.mass_top_kg;
            }
            left -= share * row.mass_top_kg;
            inertia = [rotary_x - share * second, rotary_y - share * second, polar];
        }
        self.nodes[node].mass_kg += left;
        for (sum, part) in self.nodes[node].inertia_kg_m2.iter_mut().zip(inertia) {
            *sum += part;
        }
    }

    pub(super) fn base_m(&self) -> f64 {
        self.nodes[0].z_m
    }

    pub(super) fn length_m(&self, element: usize) -> f64 {
        self.nodes[element + 1].z_m - self.nodes[element].z_m
    }

    pub(super) fn middle_m(&self, element: usize) -> f64 {
        0.5 * (self.nodes[element + 1].z_m + self.nodes[element].z_m)
    }

    /// The element that holds a height.
    pub(super) fn element_at(&self, z_m: f64) -> usize {
        let above = self.nodes.iter().skip(1).position(|node| z_m < node.z_m);
        above.unwrap_or(self.elements.len() - 1)
    }

    pub(super) fn nearest_node(&self, z_m: f64) -> usize {
        let distance = |node: &Node| (node.z_m - z_m).abs();
        let nearest = self.nodes.iter().enumerate().min_by(|(_, a), (_, b)| distance(a).total_cmp(&distance(b)));
        nearest.map_or(0, |(node, _)| node)
    }

    pub(super) fn total_mass_kg(&self) -> f64 {
        self.nodes.iter().map(|node| node.mass_kg).sum()
    }

    /// An element's two planes, each with its DOFs as sums of the global ones.
    fn planes(&self, element: usize) -> [(Plane, SMatrix<f64, 4, 10>); 2] {
        let this = &self.elements[element];
        let (sin, cos) = this.axis_deg.to_radians().sin_cos();
        [(0, cos, sin), (1, -sin, cos)].map(|(axis, x, y)| {
            let plane = Plane {
                length_m: self.length_m(element),
                bending_n_m2: this.bending_n_m2[axis],
                shear_compliance_per_n: this.shear_compliance_per_n[axis],
                joint: this.joint,
            };
            let mut local = SMatrix::zeros();
            for (row, first) in [(0, 0), (2, DOFS)] {
                local[(row, first)] = x;
                local[(row, first + 1)] = y;
                // Slope along the axis: x dux/dz + y duy/dz.
                local[(row + 1, first + 3)] = x;
                local[(row + 1, first + 2)] = -y;
            }
            (plane, local)
        })
    }

    /// Stiffness and mass, clamped base DOFs taken out.
    pub(super) fn matrices(&self) -> (Banded, Banded) {
        let order = self.nodes.len() * DOFS;
        let (mut stiffness, mut mass) = (Banded::zeros(order), Banded::zeros(order));
        let (mut above_kg, mut above_kg_m2) = (0.0, 0.0);
        for element in (0..self.elements.len()).rev() {
            let node = &self.nodes[element + 1];
            let [x, y] = node.centre_m;
            above_kg += node.mass_kg;
            above_kg_m2 += node.inertia_kg_m2[2] + node.mass_kg * (x * x + y * y);
            let mut whole = SMatrix::<f64, 10, 10>::zeros();
            for (plane, local) in self.planes(element) {
                let own = plane.stiffness() - plane.geometric(self.weight * GRAVITY_M_S2 * above_kg);
                whole += local.transpose() * own * local;
            }
            // Weight that stands apart leans when the section turns.
            let leaning = self.weight * GRAVITY_M_S2 * above_kg_m2;
            let torsion = (self.elements[element].torsion_n_m2 - leaning) / self.length_m(element);
            for (row, column, sign) in [(4, 4, 1.0), (9, 9, 1.0), (9, 4, -1.0)] {
                whole[(row, column)] += sign * torsion;
            }
            for row in 0..10 {
                for column in 0..=row {
                    stiffness.add(element * DOFS + row, element * DOFS + column, whole[(row, column)]);
                }
            }
        }
        for (at, node) in self.nodes.iter().enumerate() {
            let (first, m) = (at * DOFS, node.mass_kg);
            let [x, y] = node.centre_m;
            let [rotary_x, rotary_y, polar] = node.inertia_kg_m2;
            let diagonal = [m, m, rotary_x, rotary_y, polar + m * (x * x + y * y)];
            for (dof, value) in diagonal.into_iter().enumerate() {
                mass.add(first + dof, first + dof, value);
            }
            // The centre moves by ux - y rz and uy + x rz.
            mass.add(first + 4, first, -m * y);
            mass.add(first + 4, first + 1, m * x);
        }
        for &(node, dof, spring) in &self.springs {
            stiffness.add(node * DOFS + dof, node * DOFS + dof, spring);
        }
        for (dof, &flexibility) in self.base_flexibility.iter().enumerate() {
            if flexibility > 0.0 {
                stiffness.add(dof, dof, 1.0 / flexibility);
            } else {
                stiffness.fix(dof, 1.0);
                mass.fix(dof, 0.0);
            }
        }
        (stiffness, mass)
    }

    /// The lowest undamped modes, attachments left out; `None` where the structure buckles.
    pub(super) fn modes(&self, count: usize) -> Option<Modes> {
        let (stiffness, mass) = self.matrices();
        lowest_modes(&stiffness, &mass, count)
    }

    /// The motion at a place along a direction, as a row over all DOFs.
    pub(super) fn motion_row(&self, z_m: f64, azimuth_deg: f64, offset_m: [f64; 2]) -> Vec<(usize, f64)> {
        let element = self.element_at(z_m);
        let height_m = z_m - self.nodes[element].z_m;
        let (sin, cos) = azimuth_deg.to_radians().sin_cos();
        let axis = self.elements[element].axis_deg.to_radians();
        let (sin_axis, cos_axis) = axis.sin_cos();
        let along = [cos * cos_axis + sin * sin_axis, -cos * sin_axis + sin * cos_axis];
        let mut row = SMatrix::<f64, 1, 10>::zeros();
        for ((plane, local), along) in self.planes(element).into_iter().zip(along) {
            row += plane.deflection(height_m) * local * along;
        }
        let turning = sin * offset_m[0] - cos * offset_m[1];
        let share = height_m / self.length_m(element);
        row[4] += turning * (1.0 - share);
        row[9] += turning * share;
        row.iter().enumerate().map(|(at, &value)| (element * DOFS + at, value)).collect()
    }

    /// What the sensors make of shapes: channels x modes, delays left out.
    pub(super) fn at_sensors(&self, shapes: &DMatrix<f64>) -> DMatrix<f64> {
        let rows = self.sensors.iter().map(|sensor| {
            let place = &sensor.place;
            let row = self.motion_row(place.elevation_m, place.azimuth_deg, place.offset_m);
            row.into_iter().map(|(dof, value)| (dof, sensor.factor * value)).collect::<Vec<_>>()
        });
        let rows: Vec<_> = rows.collect();
        DMatrix::from_fn(rows.len(), shapes.ncols(), |channel, mode| {
            rows[channel].iter().map(|&(dof, value)| value * shapes[(dof, mode)]).sum()
        })
    }
}

#[cfg(test)]
#[path = "body_tests.rs"]
mod tests;
