//! The coordinates of a model of modes, and what changes do in them.

use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::paired::{Change, EXPLAINED, Paired, in_units};
use super::{RunChange, WELL_INSIDE};
use crate::model::eigen::{Modes, eigenmodes};
use crate::model::matrices::{ImportedMatrices, symmetric};
use crate::modes::ComputedModes;
use crate::statistics::largest_first;

/// Motions that no combination of the base's modes has are kept where they are above this share of a shape, and at most so many a change.
const NEGLIGIBLE: f64 = 1e-3;
pub(super) const MOST_BEYOND: usize = 5;
/// Their coordinates stand this many times above the highest mode in frequency, where they add motion and no resonance.
const ABOVE: f64 = 10.0;
/// And move so little themselves that what they add to a mode's energy is nothing (as a factor to the shape).
const LIGHT: f64 = 1e3;

/// The coordinates of a model of modes: the base's modes, motions beyond them, and what no place sees.
pub(super) struct Coordinates<'a> {
    pub(super) body: ImportedMatrices,
    /// Of each change, places x motions.
    motions: &'a [DMatrix<f64>],
    /// What each change exerts on the unseen coordinate of each mode, changes x modes.
    unseen: DMatrix<f64>,
}

impl Change {
    /// The motions at the places that no combination of the base's modes has, each so large that its coordinate has next to no energy: places
    /// x motions.
    pub(super) fn motions_beyond(&self, base: &ComputedModes) -> DMatrix<f64> {
        let typical = base.shapes.norm() / (base.frequencies_hz.len() as f64).sqrt();
        let svd = self.beyond.clone().svd(false, true);
        let Some(directions) = svd.v_t else { return DMatrix::zeros(base.places.len(), 0) };
        let mut order = largest_first(svd.singular_values.as_slice());
        order.retain(|&at| svd.singular_values[at] > NEGLIGIBLE * typical);
        order.truncate(MOST_BEYOND);
        directions.select_rows(&order).transpose() * (LIGHT * typical)
    }
}

impl<'a> Coordinates<'a> {
    pub(super) fn of(base: &ComputedModes, motions: &'a [DMatrix<f64>], unseen: DMatrix<f64>) -> Self {
        let lambda = base.lambda();
        let beyond: Vec<_> = motions.iter().flat_map(DMatrix::column_iter).collect();
        let (modes, seen) = (lambda.len(), lambda.len() + beyond.len());
        let size = seen + unseen.ncols();
        let above = ABOVE * ABOVE * lambda.max();
        let diagonal = DVector::from_fn(size, |at, _| lambda.get(at).copied().unwrap_or(above));
        let mut coordinates = base.shapes.clone().resize_horizontally(size, 0.0);
        for (at, motion) in beyond.into_iter().enumerate() {
            coordinates.set_column(modes + at, &motion);
        }
        let body = ImportedMatrices {
            stiffness: DMatrix::from_diagonal(&diagonal),
            mass: DMatrix::identity(size, size),
            nodes: Vec::new(),
            coordinates: Some(Arc::new(coordinates)),
            places: base.places.as_slice().into(),
            whole: None,
        };
        Self { body, motions, unseen }
    }

    /// A change, the one at `index`, in these coordinates.
    pub(super) fn change(&self, index: usize, change: &Change) -> RunChange {
        let (modes, size) = (change.within.nrows(), self.body.stiffness.nrows());
        let mut whole = DMatrix::zeros(size, size);
        whole.view_mut((0, 0), (modes, modes)).copy_from(&change.within);
        let mut coupling = DMatrix::zeros(size, size);
        let before: usize = self.motions[..index].iter().map(DMatrix::ncols).sum();
        let stiffness = |at: usize| self.body.stiffness[(at, at)];
        for (at, motion) in self.motions[index].column_iter().enumerate() {
            // A coordinate far above answers a force statically: by force over stiffness, times its motion at the places.
            let coordinate = modes + before + at;
            let part = &change.beyond * motion * (-stiffness(coordinate) / motion.norm_squared());
            coupling.view_mut((0, coordinate), (modes, 1)).copy_from(&part);
            coupling.view_mut((coordinate, 0), (1, modes)).copy_from(&part.transpose());
        }
        let unseen = size - self.unseen.ncols();
        for (mode, force) in self.unseen.row(index).iter().enumerate() {
            let part = force * (stiffness(mode) * stiffness(unseen + mode)).sqrt();
            coupling[(mode, unseen + mode)] = part;
            coupling[(unseen + mode, mode)] = part;
            // What that takes off at the change of the run is in the run's frequencies already.
            coupling[(mode, mode)] += change.by * force * force * stiffness(mode);
        }
        let (stiffness, mass) = if change.is_mass { (coupling, Some(whole)) } else { (whole + coupling, None) };
        let of_mass = mass.as_ref().map_or([f64::NEG_INFINITY, f64::INFINITY], positive);
        let units = self.body.stiffness.diagonal().map(|stiffness| stiffness.sqrt().recip());
        let of_stiffness = positive(&in_units(&stiffness, &units));
        let range = [of_stiffness[0].max(of_mass[0]), of_stiffness[1].min(of_mass[1])];
        RunChange { stiffness: Arc::new(stiffness), mass: mass.map(Arc::new), range }
    }
}

/// Between which factors `1 + factor * change` stays positive definite.
fn positive(change: &DMatrix<f64>) -> [f64; 2] {
    /// So much of the way to where it is not.
    const NEARLY: f64 = 0.99;
    let eigenvalues = symmetric(change).symmetric_eigenvalues();
    let bound = |most: f64| if most > 0.0 { NEARLY / most } else { f64::INFINITY };
    [-bound(eigenvalues.max()), bound(-eigenvalues.min())]
}

/// By how much lambda of each of the base's modes falls below what the change says so far, by a change by 1, squared, as a share of it: joints
/// and massless parts give way, which no place need see. Zero where other runs do not tell, or it does not fall.
pub(super) fn bend(
    lambda: &DVector<f64>,
    body: &ImportedMatrices,
    by: f64,
    change: &RunChange,
    others: &[Paired<'_>],
) -> DVector<f64> {
    let (mut sum, mut count) = (DVector::<f64>::zeros(lambda.len()), DVector::<f64>::zeros(lambda.len()));
    for paired in others {
        let there = paired.run.change;
        // With the change that tells as it is, the rest is to that from there on.
        let apart = there * (there - by);
        if apart == 0.0 || !change.admits(there) {
            continue;
        }
        let Some(expected) = change.modes(body, there) else { continue };
        for mode in paired.modes.iter().filter(|mode| lambda[mode.base] < WELL_INSIDE * lambda.max()) {
            // The mode of the model that is mostly this one of the base.
            let share = |at: &usize| expected.shapes[(mode.base, *at)].abs();
            let at = (0..expected.frequency_hz.len()).max_by(|a, b| share(a).total_cmp(&share(b)));
            if let Some(at) = at.filter(|at| share(at).powi(2) > EXPLAINED) {
                let lambda_expected = (TAU * expected.frequency_hz[at]).powi(2);
                sum[mode.base] += (lambda_expected - mode.lambda) / apart / lambda[mode.base];
                count[mode.base] += 1.0;
            }
        }
    }
    sum.zip_map(&count, |sum, count| if count > 0.0 { (sum / count).max(0.0) } else { 0.0 })
}

/// What each change exerts on a coordinate of each mode that no place sees, changes x modes: its square is what the mode bends by. Where all parts
/// get stiffer alike nothing bends, so forces of one mode are to add up to nothing: signs go against the sum of the larger ones.
pub(super) fn forces_on_unseen(bends: &[DVector<f64>]) -> DMatrix<f64> {
    let modes = bends.first().map_or(0, |bend| bend.len());
    if bends.iter().all(|bend| bend.amax() == 0.0) {
        return DMatrix::zeros(bends.len(), 0);
    }
    let mut forces = DMatrix::zeros(bends.len(), modes);
    for mode in 0..modes {
        let sizes: Vec<f64> = bends.iter().map(|bend| bend[mode].sqrt()).collect();
        let mut sum = 0.0_f64;
        for at in largest_first(&sizes) {
            forces[(at, mode)] = if sum > 0.0 { -sizes[at] } else { sizes[at] };
            sum += forces[(at, mode)];
        }
    }
    forces
}

impl RunChange {
    /// Whether K and M stay positive where it is so large.
    pub(super) fn admits(&self, by: f64) -> bool {
        (self.range[0]..=self.range[1]).contains(&by)
    }

    /// Modes in the coordinates of the body, changed by so much.
    pub(super) fn modes(&self, body: &ImportedMatrices, by: f64) -> Option<Modes> {
        let stiffness = &body.stiffness + self.stiffness.as_ref() * by;
        let mass = self.mass.as_ref().map_or_else(|| body.mass.clone(), |mass| &body.mass + mass.as_ref() * by);
        eigenmodes(&stiffness, &mass).ok()
    }
}
