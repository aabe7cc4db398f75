//! A run beside the base: which mode is which, what the changed shapes have of the base's, and what that says of K or M.

use nalgebra::{DMatrix, DVector};

use super::{Run, RunError, WELL_INSIDE};
use crate::assignment::assigned;
use crate::model::matrices::symmetric;
use crate::modes::ComputedModes;

/// Shapes in files have about so many digits: what a component may be off by, as a share of the shape's root mean square.
pub(super) const DIGITS: f64 = 1e-4;
/// A run's mode and the base's are one where the product of their MAC and the likeness of their frequencies is above this.
pub(super) const LEAST_LIKENESS: f64 = 0.3;
/// Frequencies of one mode are alike over this range (standard deviation of their logarithm).
pub(super) const LIKENESS: f64 = 0.3;
/// Of the base's modes at least this share has a partner in a run.
pub(super) const LEAST_PAIRED: f64 = 0.5;
/// A changed mode of which the base's modes explain less than this share (as a square) is not of their span.
pub(super) const EXPLAINED: f64 = 0.8;
/// A change has at least this share of each mode: frequencies in files do not tell less.
pub(super) const LEAST_STRENGTH: f64 = 1e-4;
/// Modes whose cosines are below this are at right angles, up to the digits of the file.
pub(super) const AT_RIGHT_ANGLES: f64 = 0.01;
/// Frequencies and shapes that differ by less are the same.
pub(super) const SAME: [f64; 2] = [1e-7, 1e-5];

/// A run beside the base: the places and the modes that both have.
pub(super) struct Paired<'a> {
    pub(super) run: &'a Run,
    /// Rows of the places in the base's and in the run's shapes.
    pub(super) rows: Vec<[usize; 2]>,
    /// The base's shapes at these places.
    pub(super) here: DMatrix<f64>,
    pub(super) modes: Vec<PairedMode>,
}

/// A mode of the base in a run.
pub(super) struct PairedMode {
    /// Index into the base's modes.
    pub(super) base: usize,
    /// Its lambda in the run.
    pub(super) lambda: f64,
    /// Its shape in the run at the common places, of the base's sign and about its size.
    pub(super) shape: DVector<f64>,
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

impl<'a> Paired<'a> {
    pub(super) fn of(base: &ComputedModes, run: &'a Run) -> Result<Self, RunError> {
        let names = || (run.modes.file.display().to_string(), base.file.display().to_string());
        let row = |place: &String| run.modes.places.iter().position(|other| other == place);
        let rows: Vec<[usize; 2]> =
            base.places.iter().enumerate().filter_map(|(here, place)| Some([here, row(place)?])).collect();
        if rows.is_empty() {
            let (run, base) = names();
            return Err(RunError::NoCommonPlace { run, base });
        }
        let here = base.shapes.select_rows(rows.iter().map(|[row, _]| row));
        let there = run.modes.shapes.select_rows(rows.iter().map(|[_, row]| row));
        let pairs = pairs(base, &here, &run.modes, &there);
        let modes = base.frequencies_hz.len().min(run.modes.frequencies_hz.len());
        if (pairs.len() as f64) < LEAST_PAIRED * modes as f64 {
            let (run, base) = names();
            return Err(RunError::OtherModes { run, base, paired: pairs.len(), modes });
        }
        let (lambda, lambda_there) = (base.lambda(), run.modes.lambda());
        // So much each mode has of what changes: the share by which its lambda moves.
        let most = pairs.iter().map(|&(at, other)| strength(lambda[at], lambda_there[other], run)).fold(0.0, f64::max);
        let mut strengths = DVector::from_element(lambda.len(), most);
        pairs.iter().for_each(|&(at, other)| strengths[at] = strength(lambda[at], lambda_there[other], run));
        let scaled = |at: usize, other: usize| {
            let (shape, partner) = (there.column(other), here.column(at));
            shape * (shape.dot(&partner) / shape.norm_squared())
        };
        let of_frequency = pairs.iter().map(|&(at, other)| (lambda_there[other] / lambda[at]).ln().abs() / 2.0);
        let of_shape =
            pairs.iter().map(|&(at, other)| (scaled(at, other) - here.column(at)).norm() / here.column(at).norm());
        let largest = [of_frequency.fold(0.0, f64::max), of_shape.fold(0.0, f64::max)];
        if largest[0] < SAME[0] && largest[1] < SAME[1] {
            let (run, base) = names();
            return Err(RunError::NothingChanged { run, base, largest: largest[0] });
        }
        // In the order of the base's modes, lowest first.
        let mode = |&(at, other): &(usize, usize), is_complete: bool| {
            let shape = scaled(at, other);
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
        let modes = |is_complete: bool| pairs.iter().filter_map(|pair| mode(pair, is_complete)).collect::<Vec<_>>();
        let mut paired = Self { run, rows, here: here.clone(), modes: modes(true) };
        if !paired.is_complete(base) {
            paired.modes = modes(false);
        }
        let expected = base.frequencies_hz.len().min(run.modes.frequencies_hz.len());
        if (paired.modes.len() as f64) < LEAST_PAIRED * expected as f64 {
            let (run, base) = names();
            return Err(RunError::OtherModes { run, base, paired: paired.modes.len(), modes: expected });
        }
        Ok(paired)
    }

    /// The modes in coordinates in which what stays as it is by the change, K or M, is 1: a column each, and their lengths before.
    pub(super) fn columns(&self, base: &ComputedModes) -> (DMatrix<f64>, Vec<f64>) {
        let root = base.lambda().map(f64::sqrt);
        let scaled = |mode: &PairedMode| {
            if self.run.is_mass { mode.shares.component_mul(&root) } else { mode.shares.clone() }
        };
        let mut columns = DMatrix::zeros(root.len(), self.modes.len());
        let mut lengths = Vec::new();
        for (mut column, mode) in columns.column_iter_mut().zip(&self.modes) {
            let one = scaled(mode);
            lengths.push(one.norm());
            column.copy_from(&one.normalize());
        }
        (columns, lengths)
    }

    /// Whether the base has all that the run has: its modes are then at right angles, as those of all degrees of freedom are.
    pub(super) fn is_complete(&self, base: &ComputedModes) -> bool {
        let (columns, _) = self.columns(base);
        let gram = columns.transpose() * &columns;
        (gram - DMatrix::identity(self.modes.len(), self.modes.len())).amax() < AT_RIGHT_ANGLES
    }

    /// What a change by 1 does.
    pub(super) fn change(&self, base: &ComputedModes) -> Change {
        let is_mass = self.run.is_mass;
        let lambda = base.lambda();
        let root = lambda.map(f64::sqrt);
        // What changes is diagonal before and after.
        let (columns, lengths) = self.columns(base);
        let turned = orthonormal(&columns);
        let diagonal = |lambda: f64| if is_mass { lambda.recip() } else { lambda };
        let before = DMatrix::from_diagonal(&lambda.map(diagonal));
        let after = DVector::from_iterator(self.modes.len(), self.modes.iter().map(|mode| diagonal(mode.lambda)));
        // Modes of the base that the run does not have stay as they are.
        let rest = DMatrix::identity(lambda.len(), lambda.len()) - &turned * turned.transpose();
        let after = &turned * DMatrix::from_diagonal(&after) * turned.transpose() + &rest * &before * &rest;
        let mut within = symmetric(&(after - before)) / self.run.change;
        if is_mass {
            within.iter_mut().enumerate().for_each(|(at, entry)| {
                *entry *= root[at % lambda.len()] * root[at / lambda.len()];
            });
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

/// Pairs of the base's modes and a run's, by shape and frequency; a run may have them in another order.
pub(super) fn pairs(
    base: &ComputedModes,
    here: &DMatrix<f64>,
    run: &ComputedModes,
    there: &DMatrix<f64>,
) -> Vec<(usize, usize)> {
    let likeness = |at: usize, other: usize| {
        let (a, b) = (here.column(at), there.column(other));
        let mac = a.dot(&b).powi(2) / (a.norm_squared() * b.norm_squared());
        let ratio = (run.frequencies_hz[other] / base.frequencies_hz[at]).ln() / LIKENESS;
        // A mode that does not move at the common places has no shape there.
        let likeness = if mac.is_finite() { mac } else { 0.0 } * (-0.5 * ratio * ratio).exp();
        if likeness < LEAST_LIKENESS { 0.0 } else { likeness }
    };
    assigned(base.frequencies_hz.len(), run.frequencies_hz.len(), &likeness)
}

/// The share of a mode that a change by 1 changes, of its strain energy or of its kinetic energy.
pub(super) fn strength(lambda: f64, lambda_there: f64, run: &Run) -> f64 {
    let ratio = if run.is_mass { lambda / lambda_there } else { lambda_there / lambda };
    ((ratio - 1.0) / run.change).abs().clamp(LEAST_STRENGTH, 1.0)
}

/// The shares of the base's modes in a changed shape that is scaled to its partner `at`: as the shape has them at the places, and where
/// these do not tell, near to none of the others. `deviations` is how large they may be, half of what is possible: two modes are coupled by no
/// more than what a change has of both, `dK_ij² <= dK_ii dK_jj`. `noise` is what a component may be off by, as a share of their root mean square.
pub(super) fn shares(
    here: &DMatrix<f64>,
    shape: &DVector<f64>,
    at: usize,
    deviations: &DVector<f64>,
    noise: f64,
) -> DVector<f64> {
    let modes = deviations.len();
    let expected = DVector::from_fn(modes, |mode, _| f64::from(u8::from(mode == at)));
    let scaled = here * DMatrix::from_diagonal(deviations);
    let noise = noise * shape.norm() / (shape.len() as f64).sqrt();
    let normal = scaled.transpose() * &scaled + DMatrix::identity(modes, modes) * (noise * noise);
    let right = scaled.transpose() * (shape - here.column(at));
    let solved = normal.cholesky().map(|factor| factor.solve(&right));
    solved.map_or(expected.clone(), |more| expected + more.component_mul(deviations))
}

/// Columns made orthonormal one after the other: the shares of low modes are the most exact, for what the base lacks lies above it, and a high
/// mode's share in a low one follows from that of the low one in it.
pub(super) fn orthonormal(columns: &DMatrix<f64>) -> DMatrix<f64> {
    let qr = columns.clone().qr();
    let (mut turned, triangle) = (qr.q(), qr.r());
    for (mut column, own) in turned.column_iter_mut().zip(triangle.diagonal().iter()) {
        column *= own.signum();
    }
    turned
}
