//! Mass and stiffness matrices with what places them in space.

use std::borrow::Cow;
use std::sync::Arc;

use nalgebra::{DMatrix, DVectorView, RowDVector};

use super::DOFS_A_NODE;
use super::base::BaseFlexibility;
use super::beam::Segment;
use super::damped::DampedModes;
use super::distortion::Distortion;
use super::eigen::{EigenError, ModalBasis, Modes};
use super::geometry::{Geometry, Line, LocalMotion};
use super::joint::Kink;
use super::layout::{longest_side_m, sides_m};
use super::matrices::{ImportedMatrices, WholeMatrices, entry};
use super::sensing::Sensing;
use super::sensitivity::Change;

/// A force is none up to this share of what K's largest stiffness makes of the motion: matrices are written with five digits and more.
const NO_FORCE: f64 = 1e-4;
/// No first storey is so many times as high as the second.
const HIGH_STOREYS: f64 = 4.0;
/// Buildings, bridges and towers weigh 20 to 700 kg per m³ of the box around them, whose sides are taken as no less than a twentieth of the
/// longest: so many tonnes.
const TONNES_PER_M3: [f64; 2] = [0.02, 0.7];
const SLENDER: f64 = 20.0;
/// The width of a section in radii of gyration about its axis: 2 for a ring, 2.4 for a full square.
const WIDTH_OVER_RADIUS: f64 = 2.4;
/// No beam is wider than so many times its height.
const MOST_SQUAT: f64 = 10.0;

/// A mass on the diagonal of M.
#[derive(Debug, Clone, PartialEq)]
pub struct MassAtRow {
    /// The row that nodes and sensors name.
    pub row: usize,
    /// The mass.
    pub mass_kg: f64,
    /// Where it is, in m.
    pub place_m: Option<[f64; 3]>,
}

/// Mass and stiffness matrices with what places them in space.
#[derive(Debug, Clone)]
pub struct Assembly {
    /// K, DOFs x DOFs, base left out, symmetric (N/m, N, N m).
    pub stiffness: DMatrix<f64>,
    /// M, DOFs x DOFs, symmetric (kg, kg m, kg m²).
    pub mass: DMatrix<f64>,
    /// C of the dashpots, DOFs x DOFs, symmetric (N s/m); `None` where there are none.
    pub damping: Option<DMatrix<f64>>,
    /// How the rows that nodes and sensors name move with the DOFs, where these are a reduced model's; `None` where they are the DOFs.
    pub(super) coordinates: Option<Arc<DMatrix<f64>>>,
    /// Where the DOFs stand.
    pub(super) geometry: Geometry,
    /// The matrices that these are reduced from, where they are.
    whole: Option<Arc<WholeMatrices>>,
    /// How far sections distort in their own plane.
    pub(super) distortion: Distortion,
    /// What the sensors really are.
    pub sensing: Sensing,
}

impl Assembly {
    /// A beam with all masses at its nodes, from its K (the base eliminated), the kinks of each segment's joints and the
    /// motion of the base node.
    pub(super) fn of_beam(
        segments: Vec<Segment>,
        stiffness: DMatrix<f64>,
        kinks: Vec<Vec<Kink>>,
        base_motion: DMatrix<f64>,
    ) -> Self {
        let mut mass = DMatrix::zeros(stiffness.nrows(), stiffness.ncols());
        for (index, segment) in segments.iter().enumerate() {
            for (dof, value) in segment.lumped_mass().into_iter().enumerate() {
                let row = index * DOFS_A_NODE + dof;
                mass[(row, row)] += value;
            }
        }
        let geometry = Geometry::Line(Line::of_beam(segments, kinks, base_motion));
        Self {
            stiffness,
            mass,
            damping: None,
            coordinates: None,
            whole: None,
            geometry,
            distortion: Distortion::default(),
            sensing: Sensing::default(),
        }
    }

    /// Imported matrices as they are.
    pub(super) fn of_matrices(matrices: &ImportedMatrices) -> Self {
        let ImportedMatrices { stiffness, mass, nodes, coordinates, places, whole } = matrices;
        Self {
            stiffness: stiffness.clone(),
            mass: mass.clone(),
            damping: None,
            coordinates: coordinates.clone(),
            whole: whole.clone(),
            geometry: if places.is_empty() || !nodes.is_empty() {
                Geometry::of_nodes(nodes, stiffness)
            } else {
                Geometry::Named(places.clone())
            },
            distortion: Distortion::default(),
            sensing: Sensing::default(),
        }
    }

    /// The longest side of the box around its nodes in m, the height of a line; 0 where nothing is known of them.
    pub fn size_m(&self) -> f64 {
        match &self.geometry {
            Geometry::Line(line) => line.z_top_m() - line.z_base_m(),
            Geometry::Space(nodes) => longest_side_m(nodes.iter().map(|node| node.position_m)),
            Geometry::Unknown | Geometry::Named(_) => 0.0,
        }
    }

    /// Masses on the diagonal of M where they are none of a beam's: along X, along Y and upwards, where directions are known, else all in one.
    /// `None` for nodes above each other that have five degrees of freedom each.
    pub(crate) fn masses_in_space(&self) -> Option<Vec<Vec<MassAtRow>>> {
        if self.node_elevations_m().len() * DOFS_A_NODE == self.dofs() {
            return None;
        }
        let at = |row: usize, place_m: Option<[f64; 3]>| {
            let mass_kg = match &self.whole {
                Some(whole) => entry(&whole.mass, row, row),
                None => self.mass.get((row, row)).copied().unwrap_or(0.0),
            };
            MassAtRow { row, mass_kg, place_m }
        };
        // Rows along X, Y and Z, and where they are; of nodes above each other those alone that sway.
        let nodes: Vec<([Option<usize>; 3], [f64; 3])> = match &self.geometry {
            Geometry::Space(nodes) => nodes.iter().map(|node| (node.translations(), node.position_m)).collect(),
            Geometry::Line(line) => {
                let heights_m = std::iter::once(line.z_base_m()).chain(line.node_elevations_m());
                let node =
                    |(rows, z_m): (&[Option<usize>; DOFS_A_NODE], f64)| ([rows[0], rows[1], None], [0.0, 0.0, z_m]);
                line.node_rows().iter().zip(heights_m).map(node).collect()
            }
            Geometry::Unknown | Geometry::Named(_) => {
                return Some(vec![(0..self.rows()).map(|row| at(row, None)).collect()]);
            }
        };
        let along =
            |axis: usize| nodes.iter().filter_map(|(rows, place_m)| Some(at(rows[axis]?, Some(*place_m)))).collect();
        Some([0, 1, 2].map(along).to_vec())
    }

    /// Why masses look as if they were in tonnes: what all weigh, and the space that the nodes enclose, in m³. `None` where they look right, or
    /// nothing is known of where nodes stand.
    pub fn looks_like_tonnes(&self) -> Option<[f64; 2]> {
        let [mass, volume_m3] = match self.masses_in_space() {
            Some(masses) => {
                let least_m = self.size_m() / SLENDER;
                let sides_m = sides_m(masses.iter().flatten().filter_map(|mass| mass.place_m));
                let of_direction = |masses: &Vec<MassAtRow>| masses.iter().map(|mass| mass.mass_kg).sum::<f64>();
                let mass = masses.iter().map(of_direction).fold(0.0, f64::max);
                [mass, sides_m.map(|side_m| side_m.max(least_m)).iter().product()]
            }
            None => self.mass_and_volume_of_beam(),
        };
        (volume_m3 > 0.0 && (TONNES_PER_M3[0]..TONNES_PER_M3[1]).contains(&(mass / volume_m3)))
            .then_some([mass, volume_m3])
    }

    /// What a beam weighs, and the space that it fills: its width follows from how its mass turns about its axis, and is a twentieth of
    /// its height where it has no such inertia.
    fn mass_and_volume_of_beam(&self) -> [f64; 2] {
        let of_dof =
            |dof: usize| -> f64 { (dof..self.dofs()).step_by(DOFS_A_NODE).map(|row| self.mass[(row, row)]).sum() };
        let [mass, turning, height_m] = [of_dof(0), of_dof(DOFS_A_NODE - 1), self.size_m()];
        let width_m = WIDTH_OVER_RADIUS * (turning / mass).sqrt();
        let width_m = match width_m {
            width_m if width_m.is_nan() || width_m <= 0.0 => height_m / SLENDER,
            // Nothing is wider than high by so much: inertias are in t mm².
            width_m if width_m > MOST_SQUAT * height_m => 1e-3 * width_m,
            width_m => width_m,
        };
        [mass, height_m * width_m * width_m]
    }

    /// The same with sensors that are as the study says: faults of sensors are none of the model.
    #[must_use]
    pub fn with_perfect_sensors(&self) -> Self {
        Self { sensing: Sensing::default(), ..self.clone() }
    }

    /// Number of degrees of freedom.
    pub fn dofs(&self) -> usize {
        self.stiffness.nrows()
    }

    /// Number of rows that nodes and sensors name: as many as degrees of freedom, but in a model of modes or a reduced one.
    pub fn rows(&self) -> usize {
        self.coordinates.as_ref().map_or_else(|| self.dofs(), |coordinates| coordinates.nrows())
    }

    /// Whether degrees of freedom are others than the rows that nodes and sensors name: of a model of modes, or of a reduced one.
    pub fn is_in_other_coordinates(&self) -> bool {
        self.coordinates.is_some()
    }

    /// Motion of the rows that nodes and sensors name, rows x anything, where that of the degrees of freedom is `motion`.
    pub fn at_rows<'a>(&self, motion: &'a DMatrix<f64>) -> Cow<'a, DMatrix<f64>> {
        match &self.coordinates {
            Some(coordinates) => Cow::Owned(coordinates.as_ref() * motion),
            None => Cow::Borrowed(motion),
        }
    }

    /// How a row that nodes and sensors name moves with the degrees of freedom; `None` where it is one of them.
    pub(super) fn coordinates_of(&self, row: usize) -> Option<RowDVector<f64>> {
        self.coordinates.as_ref().map(|coordinates| coordinates.row(row).into_owned())
    }

    /// One more degree of freedom, without mass and stiffness, that does not belong to the line; its row.
    pub(super) fn add_dof(&mut self) -> usize {
        let dof = self.dofs();
        let widen = |whole: &mut DMatrix<f64>| {
            *whole = std::mem::replace(whole, DMatrix::zeros(0, 0)).resize(dof + 1, dof + 1, 0.0)
        };
        widen(&mut self.stiffness);
        widen(&mut self.mass);
        self.damping.iter_mut().for_each(widen);
        if let Geometry::Line(line) = &mut self.geometry {
            line.widen(dof + 1);
        }
        dof
    }

    /// Adds dashpots to C.
    pub(super) fn add_damping(&mut self, dashpots: &DMatrix<f64>) {
        let dofs = self.dofs();
        *self.damping.get_or_insert_with(|| DMatrix::zeros(dofs, dofs)) += dashpots;
    }

    /// What takes K, M and C to those of `there`, over `step`; they differ in a few rows. `None` where they are alike, or have not
    /// as many DOFs.
    pub fn change_to(&self, there: &Self, step: f64) -> Option<Change> {
        let dofs = self.dofs();
        if there.dofs() != dofs {
            return None;
        }
        let differ = |here: &DMatrix<f64>, there: &DMatrix<f64>, row: usize| {
            // nalgebra stores column after column, and the matrices are symmetric.
            let column = row * dofs..(row + 1) * dofs;
            !are_equal(&here.as_slice()[column.clone()], &there.as_slice()[column])
        };
        let none = || DMatrix::zeros(dofs, dofs);
        let damped = (self.damping.is_some() || there.damping.is_some())
            .then(|| [self, there].map(|assembly| assembly.damping.clone().unwrap_or_else(none)));
        let changes = |&row: &usize| {
            differ(&self.stiffness, &there.stiffness, row)
                || differ(&self.mass, &there.mass, row)
                || damped.as_ref().is_some_and(|[here, there]| differ(here, there, row))
        };
        let rows: Vec<usize> = (0..dofs).filter(changes).collect();
        if rows.is_empty() {
            return None;
        }
        let part = |here: &DMatrix<f64>, there: &DMatrix<f64>| {
            let place = |i: usize, j: usize| (rows[i], rows[j]);
            DMatrix::from_fn(rows.len(), rows.len(), |i, j| (there[place(i, j)] - here[place(i, j)]) / step)
        };
        let (stiffness, mass) = (part(&self.stiffness, &there.stiffness), part(&self.mass, &there.mass));
        let damping = damped.as_ref().map(|[here, there]| part(here, there));
        Some(Change::of_rows(rows, stiffness, mass, damping))
    }

    /// How the rows move with the ground, DOFs x 5: `ux, uy, rx, ry, rz` of a point on the ground below. `None` where nodes do not stand above
    /// each other.
    fn rigid_motions(&self) -> Option<DMatrix<f64>> {
        if self.is_in_other_coordinates() {
            return None;
        }
        self.line()?;
        let mut motions = DMatrix::zeros(self.dofs(), DOFS_A_NODE);
        for (rows, height_m) in self.nodes_above_ground() {
            for (dof, row) in rows.iter().enumerate().filter_map(|(dof, row)| Some((dof, (*row)?))) {
                motions[(row, dof)] = 1.0;
                match dof {
                    0 => motions[(row, 3)] = height_m,
                    1 => motions[(row, 2)] = -height_m,
                    _ => {}
                }
            }
        }
        Some(motions)
    }

    /// Rows of each node, the lowest first, and its height above the ground in m.
    pub(super) fn nodes_above_ground(&self) -> impl Iterator<Item = (&[Option<usize>; DOFS_A_NODE], f64)> {
        let ground_m = self.ground_m();
        let heights_m = std::iter::once(self.z_base_m()).chain(self.node_elevations_m());
        self.node_rows().iter().zip(heights_m.map(move |z_m| z_m - ground_m))
    }

    /// Height of the ground: of the lowest node where nothing of it moves. Where the model leaves that out, 0, if that is less than
    /// [`HIGH_STOREYS`] spans below the lowest node; else heights are above some other level, and it is one span below.
    fn ground_m(&self) -> f64 {
        let lowest_m = self.z_base_m();
        let is_free = self.node_rows().first().is_some_and(|rows| rows.iter().any(Option::is_some));
        if !is_free {
            return lowest_m;
        }
        let span_m = self.node_elevations_m().first().map_or(0.0, |second_m| second_m - lowest_m);
        if lowest_m > 0.0 && lowest_m < HIGH_STOREYS * span_m { 0.0 } else { lowest_m - span_m }
    }

    /// Whether nodes stand above each other, and the lowest that move are all that is tied to the ground.
    pub(super) fn is_held_at_its_foot(&self) -> bool {
        let Some(motions) = self.rigid_motions() else { return false };
        let forces = &self.stiffness * &motions;
        let is_moving = |rows: &&[Option<usize>; DOFS_A_NODE]| rows.iter().any(Option::is_some);
        let Some(lowest) = self.node_rows().iter().find(is_moving) else { return false };
        let scale = self.stiffness.diagonal().amax();
        // Floors that only sway are strained where they move as the ground turns: the moment is carried by what they leave out.
        let turns = self.node_rows().iter().any(|rows| rows[2].is_some() || rows[3].is_some());
        let is_small = |row: usize| {
            let mut motions = motions.column_iter().enumerate().filter(|(dof, _)| turns || !matches!(dof, 2 | 3));
            motions.all(|(dof, motion)| forces[(row, dof)].abs() <= NO_FORCE * scale * motion.amax())
        };
        (0..self.dofs()).all(|row| lowest.contains(&Some(row)) || is_small(row))
    }

    /// Lets the ground below give way.
    pub(super) fn stand_on(&mut self, base: &BaseFlexibility) {
        let Some((change, base_motion)) =
            self.rigid_motions().and_then(|motions| base.under(&self.stiffness, &motions))
        else {
            return;
        };
        self.stiffness += change;
        if let Geometry::Line(line) = &mut self.geometry {
            line.let_base_move(base_motion);
        }
    }

    /// Whether heights mean something: nodes stand above each other.
    pub fn is_line(&self) -> bool {
        self.line().is_some()
    }

    fn line(&self) -> Option<&Line> {
        match &self.geometry {
            Geometry::Line(line) => Some(line),
            Geometry::Unknown | Geometry::Named(_) | Geometry::Space(_) => None,
        }
    }

    /// Matrix rows of `ux, uy, rx, ry, rz` of each node, the lowest first; empty where the nodes do not stand above each
    /// other.
    pub(super) fn node_rows(&self) -> &[[Option<usize>; DOFS_A_NODE]] {
        self.line().map_or(&[], Line::node_rows)
    }

    /// Heights of the nodes in m, lowest first, the lowest left out (a beam's node i has the DOFs from 5 i on, one of
    /// imported matrices those of its layout). Empty where the nodes do not stand above each other.
    pub fn node_elevations_m(&self) -> Vec<f64> {
        self.line().map_or_else(Vec::new, |line| line.node_elevations_m().collect())
    }

    /// Height of the lowest node in m; 0 where heights mean nothing.
    pub fn z_base_m(&self) -> f64 {
        self.line().map_or(0.0, Line::z_base_m)
    }

    /// Bottom and top in m of spans of imported matrices that are not those of a beam: motion between these two nodes is
    /// taken to be straight.
    pub fn guessed_spans_m(&self) -> &[[f64; 2]] {
        self.line().map_or(&[], Line::guessed_m)
    }

    /// Parts of a motion's kinetic energy, times two and a frequency squared: along X, along Y, of both together (negative where they go
    /// against each other), and of turning about Z. `None` where the nodes do not stand above each other.
    pub(crate) fn energies(&self, motion: DVectorView<'_, f64>) -> Option<[f64; 4]> {
        let nodes = self.node_rows();
        let rows = |dof: usize| nodes.iter().filter_map(move |rows| rows[dof]).collect::<Vec<usize>>();
        let [along_x, along_y, turning] = [0, 1, 4].map(rows);
        let product = |one: &[usize], mass: &[usize], other: &[usize]| -> f64 {
            let masses = |row: usize| {
                mass.iter().zip(other).map(move |(&column, &other)| self.mass[(row, column)] * motion[other])
            };
            one.iter().zip(mass).map(|(&one, &row)| motion[one] * masses(row).sum::<f64>()).sum()
        };
        let both = if along_x.len() == along_y.len() { product(&along_x, &along_x, &along_y) } else { 0.0 };
        let of = |rows: &[usize]| product(rows, rows, rows);
        (!nodes.is_empty()).then(|| [of(&along_x), of(&along_y), both, of(&turning)])
    }

    /// The structure's modes without its dashpots, lowest frequency first.
    ///
    /// # Errors
    /// [`EigenError`] where the matrices are not those of a supported structure.
    pub fn modes(&self) -> Result<Modes, EigenError> {
        let modes = self.modal_basis()?.modes(usize::MAX);
        modes.are_held()?;
        Ok(modes)
    }

    /// All eigenvectors of K and M, those without mass included.
    ///
    /// # Errors
    /// As [`Assembly::modes`].
    pub fn modal_basis(&self) -> Result<ModalBasis, EigenError> {
        ModalBasis::of(&self.stiffness, &self.mass)
    }

    /// The lowest eigenvectors, from those of a structure near by, the `sharp` lowest as exact as all would be; all, where that is sooner done or
    /// dashpots mix modes.
    ///
    /// # Errors
    /// As [`Assembly::modes`].
    pub(crate) fn modal_basis_near(
        &self,
        near: &ModalBasis,
        sharp: usize,
        count: usize,
    ) -> Result<ModalBasis, EigenError> {
        let lowest = match self.damping {
            None => near.near(&self.stiffness, &self.mass, sharp, count),
            Some(_) => None,
        };
        lowest.map_or_else(|| self.modal_basis(), Ok)
    }

    /// Its damped modes, where dashpots hang on it; `basis` is that of K and M.
    ///
    /// # Errors
    /// As [`Assembly::modes`].
    pub fn damped_modes(&self, basis: &ModalBasis) -> Result<Option<DampedModes>, EigenError> {
        self.damping.as_ref().map(|damping| DampedModes::of(basis, damping)).transpose()
    }

    /// Motion of the axis at a height, 5 x DOFs: rows `ux, uy, rx, ry, rz`. Between nodes the element's own shape
    /// functions (cubic, with the shear correction); heights outside count as the ends. Zero where nodes do not stand above
    /// each other.
    pub fn axis_motion(&self, z_m: f64) -> DMatrix<f64> {
        self.line().map_or_else(|| DMatrix::zeros(DOFS_A_NODE, self.dofs()), |line| line.motion(z_m, self.dofs()))
    }

    /// [`Assembly::axis_motion`] at the few DOFs that take part in it; `None` where nodes do not stand above each other.
    pub(super) fn local_motion(&self, z_m: f64) -> Option<LocalMotion> {
        self.line().map(|line| line.local_motion(z_m))
    }
}

/// Whether two slices of the same length are equal: the same as `==`, several at a time, which a search for the first difference
/// is not.
fn are_equal(here: &[f64], there: &[f64]) -> bool {
    const AT_ONCE: usize = 16;
    let equal = |(here, there): (&[f64], &[f64])| here.iter().zip(there).fold(true, |same, (a, b)| same & (a == b));
    here.chunks(AT_ONCE).zip(there.chunks(AT_ONCE)).all(equal)
}
