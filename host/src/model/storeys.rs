//! Models of storeys: floors that hold each other by the shear of the columns between them.
//!
//! K and M of such a model flow in; its storeys, from the ground up, flow out, and what they do to K where the frame also bends as one, or
//! where the weight above leans on them.

use nalgebra::{DMatrix, DVector};

use super::assembly::Assembly;
use super::structure::{Body, Structure};

/// Entries of K between floors that are not neighbours are none up to this share of its largest.
const NONE: f64 = 1e-9;
/// However much of the sway overall bending has, shear keeps this share of each storey's.
const LEAST_SHEAR: f64 = 0.1;

/// Floors that move in one direction, the lowest first.
#[derive(Debug, Clone, PartialEq)]
pub struct Storeys {
    /// Rows of the matrices.
    rows: Vec<usize>,
    /// Above the ground.
    heights_m: Vec<f64>,
    /// Shear force per drift of each storey in N/m.
    stiffness_n_m: Vec<f64>,
    /// Of each floor.
    masses_kg: Vec<f64>,
}

impl Storeys {
    /// Of motion along X (0) or Y (1); `None` where floors do not hold each other by shear alone, or their heights are not known.
    fn along(direction: usize, assembly: &Assembly) -> Option<Self> {
        let nodes = assembly.node_rows();
        // Floors that turn about X or Y have more than shear between them.
        if assembly.is_in_other_coordinates() || nodes.iter().any(|rows| rows[2].is_some() || rows[3].is_some()) {
            return None;
        }
        let floors = assembly.nodes_above_ground().filter_map(|(rows, height_m)| Some((rows[direction]?, height_m)));
        let (rows, heights_m): (Vec<usize>, Vec<f64>) = floors.unzip();
        let count = rows.len();
        if count < 2 {
            return None;
        }
        let stiffness = assembly.stiffness.select_rows(&rows).select_columns(&rows);
        let largest = stiffness.amax();
        let is_chain = (0..count).all(|floor| {
            (0..count).all(|other| floor.abs_diff(other) < 2 || stiffness[(floor, other)].abs() <= NONE * largest)
        });
        let above = |floor: usize| if floor + 1 < count { -stiffness[(floor + 1, floor)] } else { 0.0 };
        let first = stiffness[(0, 0)] - above(0);
        let stiffness_n_m: Vec<f64> = std::iter::once(first).chain((0..count - 1).map(above)).collect();
        let masses_kg: Vec<f64> = rows.iter().map(|&row| assembly.mass[(row, row)]).collect();
        let is_storeys = is_chain
            && heights_m.windows(2).all(|pair| pair[0] < pair[1])
            && heights_m[0] > 0.0
            && stiffness_n_m.iter().all(|stiffness| *stiffness > 0.0)
            && masses_kg.iter().sum::<f64>() > 0.0;
        is_storeys.then_some(Self { rows, heights_m, stiffness_n_m, masses_kg })
    }

    /// Of a structure as it is given, along X and Y: what effects make of it may be none.
    pub(super) fn of(structure: &Structure) -> [Option<Self>; 2] {
        let Body::Matrices(matrices) = &structure.body else { return [None, None] };
        Self::within(&Assembly::of_matrices(matrices))
    }

    /// Along X and Y.
    pub(super) fn within(assembly: &Assembly) -> [Option<Self>; 2] {
        [0, 1].map(|direction| Self::along(direction, assembly))
    }

    /// Sway of a cantilever of EI = 1 at one floor by a unit force at another.
    fn cantilever(&self) -> DMatrix<f64> {
        let count = self.rows.len();
        DMatrix::from_fn(count, count, |at, force| {
            let [low, high] = [at.min(force), at.max(force)].map(|floor| self.heights_m[floor]);
            low * low * (3.0 * high - low) / 6.0
        })
    }

    /// 1 / EI of a cantilever whose top sways by this share of what the storeys do under loads in proportion to mass and height, and what it
    /// has of the drift of each storey.
    fn bending(&self, share: f64) -> (f64, Vec<f64>) {
        let count = self.rows.len();
        let loads = DVector::from_fn(count, |floor, _| self.masses_kg[floor] * self.heights_m[floor]);
        let drift = |floor: usize| loads.rows(floor, count - floor).sum() / self.stiffness_n_m[floor];
        let drifts: Vec<f64> = (0..count).map(drift).collect();
        let sway = self.cantilever() * loads;
        let by_stiffness = share * drifts.iter().sum::<f64>() / sway[count - 1];
        let below = std::iter::once(0.0).chain(sway.iter().copied());
        let bends = sway.iter().zip(below).map(|(sway, below)| by_stiffness * (sway - below));
        // A storey below a floor without mass drifts by neither.
        let shares = bends.zip(&drifts).map(|(bends, drift)| if *drift > 0.0 { bends / drift } else { 0.0 });
        (by_stiffness, shares.collect())
    }

    /// What K changes by where the frame bends as one. Floors x floors; `None` where there is no such model.
    fn bent(&self, bending: Bending) -> Option<DMatrix<f64>> {
        let (by_stiffness, storeys) = match bending {
            Bending::InStoreys(share) => {
                let (by_stiffness, shares) = self.bending(share);
                let sheared = |(stiffness, share): (&f64, &f64)| stiffness / (1.0 - share).max(LEAST_SHEAR);
                (by_stiffness, self.stiffness_n_m.iter().zip(&shares).map(sheared).collect())
            }
            Bending::LeftOut(ratio) => (self.bending(ratio).0, self.stiffness_n_m.clone()),
        };
        let flexibility = chain(&storeys).cholesky()?.inverse() + self.cantilever() * by_stiffness;
        Some(flexibility.cholesky()?.inverse() - chain(&self.stiffness_n_m))
    }

    /// Lets the frame bend as one.
    pub(super) fn bend(&self, bending: Bending, stiffness: &mut DMatrix<f64>) {
        if let Some(change) = self.bent(bending).filter(|_| !bending.is_none()) {
            self.add(&change, stiffness);
        }
    }

    /// Heights in m of the upper floors of storeys that are held at their limit, as so much of their drift would be bending.
    pub(super) fn held_m(&self, bending: Bending) -> Vec<f64> {
        let Bending::InStoreys(share) = bending else { return Vec::new() };
        let shares = self.bending(share).1;
        let held = self.heights_m.iter().zip(shares).filter(|(_, share)| 1.0 - share < LEAST_SHEAR);
        held.map(|(height_m, _)| *height_m).collect()
    }

    /// Takes the weight above from each storey's stiffness, N / h, by so many N for each kg.
    pub(super) fn lean(&self, n_per_kg: f64, stiffness: &mut DMatrix<f64>) {
        let mut above_kg = 0.0;
        let mut weights = vec![0.0; self.rows.len()];
        for floor in (0..self.rows.len()).rev() {
            above_kg += self.masses_kg[floor];
            let below_m = if floor > 0 { self.heights_m[floor - 1] } else { 0.0 };
            weights[floor] = -n_per_kg * above_kg / (self.heights_m[floor] - below_m);
        }
        self.add(&chain(&weights), stiffness);
    }

    fn add(&self, change: &DMatrix<f64>, stiffness: &mut DMatrix<f64>) {
        for (at, &row) in self.rows.iter().enumerate() {
            for (other, &column) in self.rows.iter().enumerate() {
                stiffness[(row, column)] += change[(at, other)];
            }
        }
    }
}

/// How far a frame bends as one, by its storeys' sway of the top under loads in proportion to mass and height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Bending {
    /// This share of the sway is bending. The storeys' stiffnesses were taken from all of it: they have the rest, and the sway stays what it
    /// was.
    InStoreys(f64),
    /// So many times the sway comes by bending besides, of which the storeys' stiffnesses have nothing.
    LeftOut(f64),
}

impl Bending {
    fn is_none(self) -> bool {
        let (Self::InStoreys(share) | Self::LeftOut(share)) = self;
        share == 0.0
    }
}

/// K of storeys of these stiffnesses, the lowest on the ground.
fn chain(stiffness_n_m: &[f64]) -> DMatrix<f64> {
    let mut chain = DMatrix::zeros(stiffness_n_m.len(), stiffness_n_m.len());
    for (floor, stiffness) in stiffness_n_m.iter().enumerate() {
        chain[(floor, floor)] += stiffness;
        if let Some(below) = floor.checked_sub(1) {
            chain[(below, below)] += stiffness;
            chain[(floor, below)] -= stiffness;
            chain[(below, floor)] -= stiffness;
        }
    }
    chain
}
