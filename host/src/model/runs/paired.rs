//! A run beside the base: which mode is which, what the changed shapes have of the base's, and what that says of K or M.

use std::collections::HashMap;

use nalgebra::{DMatrix, DVector};

use super::{Run, RunError, WELL_INSIDE};
use crate::assignment::{assigned, likeness};
use crate::model::matrices::symmetric;
use crate::modes::ComputedModes;

/// Shapes in files have about so many digits: what a component may be off by, as a share of the shape's root mean square.
const DIGITS: f64 = 1e-4;
/// A run's mode and the base's are one where the product of their MAC and the likeness of their frequencies is above this.
const LEAST_LIKENESS: f64 = 0.3;
/// Frequencies of one mode are alike over this range (standard deviation of their logarithm).
const LIKENESS: f64 = 0.3;
/// Of the base's modes at least this share has a partner in a run.
const LEAST_PAIRED: f64 = 0.5;
/// A changed mode of which the base's modes explain less than this share (as a square) is not of their span.
pub(super) const EXPLAINED: f64 = 0.8;
/// A change has at least this share of each mode: frequencies in files do not tell less.
const LEAST_STRENGTH: f64 = 1e-4;
/// Modes whose cosines are below this are at right angles, up to the digits of the file.
const AT_RIGHT_ANGLES: f64 = 0.01;
/// Frequencies and shapes that differ by less are the same.
const SAME: [f64; 2] = [1e-7, 1e-5];

/// A run beside the base: the places and the modes that both have.
pub(super) struct Paired<'a> {
    pub(super) run: &'a Run,
    /// Rows of the places in the base's and in the run's shapes.
    pub(super) rows: Vec<[usize; 2]>,
    /// The base's shapes at these places.
    here: DMatrix<f64>,
    pub(super) modes: Vec<PairedMode>,
}

/// A mode of the base in a run.
pub(super) struct PairedMode {
    /// Index into the base's modes.
    pub(super) base: usize,
    /// Its lambda in the run.
    pub(super) lambda: f64,
    /// Its shape in the run at the common places, of the base's sign and about its size.
    shape: DVector<f64>,
    /// The shares of the base's modes in that shape.
    pub(super) shares: DVector<f64>,
}

/// What a change by 1 does, in modal coordinates.
pub(super) struct Change {
    /// To K or M, in the base's modes.
    pub(super) within: DMatrix<f64>,
    /// What each of the base's modes gets of motions that none of them has, modes x places.
    pub(super) beyond: DMatrix<f64>,
    pub(super) is_mass: bool,
    /// How large the change was that tells: with it, frequencies are those of the run.
    pub(super) by: f64,
}

/// Rows of the places that both have, and the shapes there.
pub(super) struct Common {
    pub(super) rows: Vec<[usize; 2]>,
    pub(super) here: DMatrix<f64>,
    pub(super) there: DMatrix<f64>,
}

impl Common {
    pub(super) fn of(one: &ComputedModes, other: &ComputedModes) -> Self {
        let rows_there: HashMap<&str, usize> = other.places.iter().map(String::as_str).zip(0..).collect();
        let rows: Vec<[usize; 2]> = (one.places.iter().enumerate())
            .filter_map(|(row, place)| Some([row, *rows_there.get(place.as_str())?]))
            .collect();
        let here = one.shapes.select_rows(rows.iter().map(|[row, _]| row));
        let there = other.shapes.select_rows(rows.iter().map(|[_, row]| row));
        Self { rows, here, there }
    }

    /// Pairs of the modes of both, by shape and frequency; they may be in another order.
    pub(super) fn pairs(&self, one: &ComputedModes, other: &ComputedModes) -> Vec<(usize, usize)> {
        let alike = |at: usize, there: usize| {
            let (a, b) = (self.here.column(at), self.there.column(there));
            let mac = a.dot(&b).powi(2) / (a.norm_squared() * b.norm_squared());
            let ratio = other.frequencies_hz[there] / one.frequencies_hz[at];
            // A mode that does not move at the common places has no shape there.
            likeness(if mac.is_finite() { mac } else { 0.0 }, ratio, LIKENESS, LEAST_LIKENESS)
        };
        assigned(one.frequencies_hz.len(), other.frequencies_hz.len(), &alike)
    }
}

impl<'a> Paired<'a> {
    /// # Errors
    /// [`RunError`] where too few modes have partners, or nothing differs.
    pub(super) fn of(base: &ComputedModes, run: &'a Run) -> Result<Self, RunError> {
        let names = || (run.modes.file.display().to_string(), base.file.display().to_string());
        let common = Common::of(base, &run.modes);
        if common.rows.is_empty() {
            let (run, base) = names();
            return Err(RunError::NoCommonPlace { run, base });
        }
        let pairs = common.pairs(base, &run.modes);
        let Common { rows, here, there } = common;
        let (lambda, lambda_there) = (base.lambda(), run.modes.lambda());
        // So much each mode has of what changes: the share by which its lambda moves.
        let most = pairs.iter().map(|&(at, other)| strength(lambda[at], lambda_there[other], run)).fold(0.0, f64::max);
        let mut strengths = DVector::from_element(lambda.len(), most);
        pairs.iter().for_each(|&(at, other)| strengths[at] = strength(lambda[at], lambda_there[other], run));
        // In the order of the base's modes, lowest first.
        let mode = |&(at, other): &(usize, usize), is_complete: bool| {
            let (shape, partner) = (there.column(other), here.column(at));
            let shape = shape * (shape.dot(&partner) / shape.norm_squared());
            let deviations = DVector::from_fn(lambda.len(), |mode, _| {
                // To first order `dK_ij / (λi - λj)`, and where M changes `-λi dM_ij / (λi - λj)`.
                let moved = if run.is_mass { lambda[at] } else { (lambda[mode] * lambda[at]).sqrt() };
                let coupled = (strengths[mode] * strengths[at]).sqrt() * run.change.abs() * moved;
                let greatest = (coupled / (lambda[mode] - lambda[at]).abs()).min(1.0);
                if mode == at { 1.0 } else { 0.5 * greatest }
            });
            // What the shape has of modes that the base lacks looks like some of those that it has.
            let lacking = strengths[at] * run.change.abs() * lambda[at] / lambda.max();
            let noise = if is_complete { DIGITS } else { lacking.max(DIGITS) };
            let shares = shares(&here, &shape, at, &deviations, noise);
            let is_explained = (&here * &shares).norm_squared() >= EXPLAINED * shape.norm_squared();
            is_explained.then_some(PairedMode { base: at, lambda: lambda_there[other], shape, shares })
        };
        let modes_if = |is_complete: bool| pairs.iter().filter_map(|pair| mode(pair, is_complete)).collect();
        let mut modes: Vec<PairedMode> = modes_if(true);
        if !are_complete(&modes, run, &lambda) {
            modes = modes_if(false);
        }
        let expected = lambda.len().min(lambda_there.len());
        if (modes.len() as f64) < LEAST_PAIRED * expected as f64 {
            let (run, base) = names();
            return Err(RunError::OtherModes { run, base, paired: modes.len(), modes: expected });
        }
        let of_frequency = modes.iter().map(|mode| (mode.lambda / lambda[mode.base]).ln().abs() / 2.0);
        let of_shape = modes.iter().map(|mode| {
            let partner = here.column(mode.base);
            (&mode.shape - partner).norm() / partner.norm()
        });
        let largest = [of_frequency.fold(0.0, f64::max), of_shape.fold(0.0, f64::max)];
        if largest[0] < SAME[0] && largest[1] < SAME[1] {
            let (run, base) = names();
            return Err(RunError::NothingChanged { run, base, largest: largest[0] });
        }
        Ok(Self { run, rows, here, modes })
    }

    /// What a change by 1 does.
    pub(super) fn change(&self, base: &ComputedModes) -> Change {
        let is_mass = self.run.is_mass;
        let lambda = base.lambda();
        let root = lambda.map(f64::sqrt);
        // What changes is diagonal before and after.
        let (columns, lengths) = columns(&self.modes, self.run, &lambda);
        let turned = orthonormal(&columns);
        let diagonal = |lambda: f64| if is_mass { lambda.recip() } else { lambda };
        let before = DMatrix::from_diagonal(&lambda.map(diagonal));
        let after = DVector::from_iterator(self.modes.len(), self.modes.iter().map(|mode| diagonal(mode.lambda)));
        // Modes of the base that the run does not have stay as they are.
        let rest = DMatrix::identity(lambda.len(), lambda.len()) - &turned * turned.transpose();
        let after = &turned * DMatrix::from_diagonal(&after) * turned.transpose() + &rest * &before * &rest;
        let mut within = symmetric(&(after - before)) / self.run.change;
        if is_mass {
            within = in_units(&within, &root);
        }
        // The shape of unit modal mass, less what the base's modes make of it.
        let mut beyond = DMatrix::zeros(lambda.len(), base.places.len());
        for ((mode, length), turned) in self.modes.iter().zip(lengths).zip(turned.column_iter()) {
            if lambda[mode.base] > WELL_INSIDE * lambda.max() {
                continue;
            }
            let size = if is_mass { mode.lambda.sqrt() } else { 1.0 };
            let shares = if is_mass { turned.component_div(&root) * size } else { turned.into_owned() };
            let left = &mode.shape * (size / length) - &self.here * shares;
            for ([row, _], value) in self.rows.iter().zip(&left) {
                beyond.column_mut(*row).axpy(value / self.run.change, &turned, 1.0);
            }
        }
        Change { within, beyond, is_mass, by: self.run.change }
    }
}

/// The modes in coordinates in which what stays as it is by the change, K or M, is 1: a column each, and their lengths before.
fn columns(modes: &[PairedMode], run: &Run, lambda: &DVector<f64>) -> (DMatrix<f64>, Vec<f64>) {
    let mut columns = DMatrix::zeros(lambda.len(), modes.len());
    for (mut column, mode) in columns.column_iter_mut().zip(modes) {
        column.copy_from(&mode.shares);
        if run.is_mass {
            column.zip_apply(lambda, |share, lambda| *share *= lambda.sqrt());
        }
    }
    let lengths = columns.column_iter_mut().map(|mut column| column.normalize_mut()).collect();
    (columns, lengths)
}

/// Whether the base has all that the run has: its modes are then at right angles, as those of all degrees of freedom are.
fn are_complete(modes: &[PairedMode], run: &Run, lambda: &DVector<f64>) -> bool {
    let (columns, _) = columns(modes, run, lambda);
    let gram = columns.transpose() * &columns;
    (gram - DMatrix::identity(modes.len(), modes.len())).amax() < AT_RIGHT_ANGLES
}

/// The share of a mode that a change by 1 changes, of its strain energy or of its kinetic energy.
fn strength(lambda: f64, lambda_there: f64, run: &Run) -> f64 {
    let ratio = if run.is_mass { lambda / lambda_there } else { lambda_there / lambda };
    ((ratio - 1.0) / run.change).abs().clamp(LEAST_STRENGTH, 1.0)
}

/// The shares of the base's modes in a changed shape that is scaled to its partner `at`: as the shape has them at the places, and where
/// these do not tell, near to none of the others. `deviations` is how large they may be, half of what is possible: two modes are coupled by no
/// more than what a change has of both, `dK_ij² <= dK_ii dK_jj`. `noise` is what a component may be off by, as a share of their root mean square.
fn shares(here: &DMatrix<f64>, shape: &DVector<f64>, at: usize, deviations: &DVector<f64>, noise: f64) -> DVector<f64> {
    let modes = deviations.len();
    let expected = DVector::from_fn(modes, |mode, _| f64::from(u8::from(mode == at)));
    let scaled = here * DMatrix::from_diagonal(deviations);
    let noise = noise * shape.norm() / (shape.len() as f64).sqrt();
    let normal = scaled.transpose() * &scaled + DMatrix::identity(modes, modes) * (noise * noise);
    let right = scaled.transpose() * (shape - here.column(at));
    let solved = normal.cholesky().map(|factor| factor.solve(&right));
    solved.map_or(expected.clone(), |more| expected + more.component_mul(deviations))
}

/// A matrix with each row and each column times what `units` has for it.
pub(super) fn in_units(matrix: &DMatrix<f64>, units: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |row, column| units[row] * matrix[(row, column)] * units[column])
}

/// Columns made orthonormal one after the other: the shares of low modes are the most exact, for what the base lacks lies above it, and a high
/// mode's share in a low one follows from that of the low one in it.
fn orthonormal(columns: &DMatrix<f64>) -> DMatrix<f64> {
    let qr = columns.clone().qr();
    let (mut turned, triangle) = (qr.q(), qr.r());
    for (mut column, own) in turned.column_iter_mut().zip(triangle.diagonal().iter()) {
        column *= own.signum();
    }
    turned
}
