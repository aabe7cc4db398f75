//! A model of which only modes are known: modes that the user's own program computed, of the model as it is and once for each group that
//! was changed, flow in; matrices in the coordinates of those modes flow out, which every command takes like imported ones.
//!
//! In the coordinates of its mass-normalised modes Φ a structure has `K = Λ` and `M = 1`. Where a group of K is changed by the share h, the
//! changed modes are `Φ' = Φ A` with `K + h dK = A⁻ᵀ Λ' A⁻¹` and `1 = A⁻ᵀ A⁻¹`: A is orthogonal, so `h dK = A Λ' Aᵀ - Λ`. A follows from the
//! shapes at the places that both runs have (the inverse of modal coordinates of a modified structure, Fox and Kapoor 1968, "Rates of change
//! of eigenvalues and eigenvectors", AIAA J. 6, 2426). Where a group of M is changed, K and M change places. What the changed shapes have
//! that no combination of the base's has, the static share of modes beyond, gets coordinates of its own, to first order.

use std::f64::consts::TAU;
use std::path::Path;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use thiserror::Error;

use super::eigen::{Modes, eigenmodes};
use super::matrices::{ImportedMatrices, symmetric};
use crate::assignment::assigned;
use crate::modes::{ComputedModes, MeasuredError, read_computed};
use crate::statistics::largest_first;
use crate::study::RunSource;

/// Why modes of the user's own program make no model.
#[derive(Debug, Error)]
pub enum RunError {
    /// A file of modes.
    #[error(transparent)]
    Modes(#[from] MeasuredError),
    /// No place is in the base and in the run.
    #[error("{run} and {base} have no place of the same name; both need the same columns")]
    NoCommonPlace {
        /// The run's file.
        run: String,
        /// That of the model as it is.
        base: String,
    },
    /// The run's modes are not those of the base, slightly changed.
    #[error(
        "{run}: only {paired} of its {modes} modes have shapes like those of {base}; are the places the same, and is the change small?"
    )]
    OtherModes {
        /// The run's file.
        run: String,
        /// That of the model as it is.
        base: String,
        /// How many modes have a partner.
        paired: usize,
        /// How many there are.
        modes: usize,
    },
    /// Nothing differs.
    #[error(
        "{run}: the same modes as {base}, up to {largest:.0e} of a frequency; nothing was changed, or the change is too small for the digits of the file"
    )]
    NothingChanged {
        /// The run's file.
        run: String,
        /// That of the model as it is.
        base: String,
        /// The largest relative change of a frequency.
        largest: f64,
    },
}

/// Shapes in files have about so many digits: what a component may be off by, as a share of the shape's root mean square.
const DIGITS: f64 = 1e-4;
/// A run's mode and the base's are one where the product of their MAC and the likeness of their frequencies is above this.
const LEAST_LIKENESS: f64 = 0.3;
/// Frequencies of one mode are alike over this range (standard deviation of their logarithm).
const LIKENESS: f64 = 0.3;
/// Of the base's modes at least this share has a partner in a run.
const LEAST_PAIRED: f64 = 0.5;
/// A changed mode of which the base's modes explain less than this share (as a square) is not of their span.
const EXPLAINED: f64 = 0.8;
/// A change has at least this share of each mode: frequencies in files do not tell less.
const LEAST_STRENGTH: f64 = 1e-4;
/// Frequencies and shapes that differ by less are the same.
const SAME: [f64; 2] = [1e-7, 1e-5];
/// Motions that no combination of the base's modes has are kept where they are above this share of a shape, and at most so many a change.
const NEGLIGIBLE: f64 = 1e-3;
const MOST_BEYOND: usize = 5;
/// Modes above this share of the highest lambda lack those that come after it: nothing is judged by them.
const WELL_INSIDE: f64 = 0.5;
/// Their coordinates stand this many times above the highest mode in frequency, where they add motion and no resonance.
const ABOVE: f64 = 10.0;
/// And move so little themselves that what they add to a mode's energy is nothing (as a factor to the shape).
const LIGHT: f64 = 1e3;
/// A change of a frequency is said not to be linear where the run of another size has this share of it otherwise than predicted.
const NOT_LINEAR: f64 = 0.1;
/// Less than this share of a frequency is not worth a word.
const NOT_WORTH: f64 = 1e-3;
/// Shares of modes in each other tell how these are scaled where they are at least this large.
const TELLING: f64 = 3e-3;
/// Shapes that are this far from mass-normalised (as a factor between two modes) are said to be.
const NOT_NORMALISED: f64 = 1.5;

/// A run that was read: what was changed, by how much, and the modes.
struct Run {
    change: f64,
    is_mass: bool,
    modes: ComputedModes,
}

/// What a change by 1 adds in the coordinates of the modes.
#[derive(Debug, Clone)]
pub(super) struct RunChange {
    /// To K.
    pub(super) stiffness: Arc<DMatrix<f64>>,
    /// To M; `None` where K alone was changed.
    pub(super) mass: Option<Arc<DMatrix<f64>>>,
    /// Between which changes K and M stay positive.
    pub(super) range: [f64; 2],
}

/// A model of modes, and what each name that a run changes does to it.
#[derive(Debug)]
pub(super) struct OfRuns {
    pub(super) body: ImportedMatrices,
    /// By name, in the order of the first run of each.
    pub(super) changes: Vec<(String, RunChange)>,
    pub(super) warnings: Vec<String>,
}

/// What a change by 1 does, in modal coordinates.
struct Change {
    /// To K or M, in the base's modes.
    within: DMatrix<f64>,
    /// What each of the base's modes gets of motions that none of them has, modes x places.
    beyond: DMatrix<f64>,
    is_mass: bool,
    /// How large the change was that tells: with it, frequencies are those of the run.
    by: f64,
}

/// By how much lambda of the base's modes falls further below a straight line than the base's modes let it, by a change by 1, squared.
struct Bend {
    /// By mode of the base: relative; `None` where the run does not tell.
    of_modes: Vec<Option<f64>>,
}

/// Reads the modes of the model as it is, and the runs; paths start at `folder`.
///
/// # Errors
/// [`RunError`] names the file.
pub(super) fn read(base: &Path, runs: &[RunSource], folder: &Path) -> Result<OfRuns, RunError> {
    let base = read_computed(&folder.join(base))?;
    let mut names: Vec<(String, Vec<Run>)> = Vec::new();
    for source in runs {
        let modes = read_computed(&folder.join(&source.modes))?;
        let run = Run { change: source.change, is_mass: source.is_mass, modes };
        match names.iter_mut().find(|(name, _)| *name == source.changed) {
            Some((_, runs)) => runs.push(run),
            None => names.push((source.changed.clone(), vec![run])),
        }
    }
    // The smallest change is the nearest to a derivative; the others check it.
    for (_, runs) in &mut names {
        runs.sort_by(|a, b| a.change.abs().total_cmp(&b.change.abs()));
    }
    let pairs = names.iter().map(|(_, runs)| Paired::of(&base, &runs[0])).collect::<Result<Vec<_>, _>>()?;
    let changes: Vec<Change> = pairs.iter().map(|paired| paired.change(&base)).collect();
    let mut motions: Vec<DMatrix<f64>> = changes.iter().map(|change| change.motions_beyond(&base)).collect();
    let mut model = body(&base, &motions);
    let straight = in_coordinates(&changes, &model, &motions);
    for (at, (_, runs)) in names.iter().enumerate() {
        let bends = runs[1..].iter().filter_map(|run| Bend::of(&base, &model, &changes[at], &straight[at], run));
        stiffen(&mut motions[at], &changes[at], &bends.collect::<Vec<_>>(), &model);
    }
    model = body(&base, &motions);
    let changes = in_coordinates(&changes, &model, &motions);
    let body = model;
    let mut warnings: Vec<String> = not_normalised(&base, &pairs).into_iter().collect();
    for ((name, runs), change) in names.iter().zip(&changes) {
        warnings.extend(runs[1..].iter().filter_map(|run| not_linear(name, &body, change, &runs[0], run)));
    }
    let names = names.into_iter().map(|(name, _)| name);
    Ok(OfRuns { body, changes: names.zip(changes).collect(), warnings })
}

/// A run beside the base: the places and the modes that both have.
struct Paired<'a> {
    run: &'a Run,
    /// Rows of the places in the base's and in the run's shapes.
    rows: Vec<[usize; 2]>,
    /// The base's shapes at these places.
    here: DMatrix<f64>,
    modes: Vec<PairedMode>,
}

/// A mode of the base in a run.
struct PairedMode {
    /// Index into the base's modes.
    base: usize,
    /// Its lambda in the run.
    lambda: f64,
    /// Its shape in the run at the common places, of the base's sign and about its size.
    shape: DVector<f64>,
    /// The shares of the base's modes in that shape.
    shares: DVector<f64>,
}

impl<'a> Paired<'a> {
    fn of(base: &ComputedModes, run: &'a Run) -> Result<Self, RunError> {
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
        let mut modes = Vec::new();
        let mut largest = [0.0_f64; 2];
        // In the order of the base's modes, lowest first.
        for (at, other) in pairs {
            let (shape, partner) = (there.column(other), here.column(at));
            let shape = shape * (shape.dot(&partner) / shape.norm_squared());
            largest[0] = largest[0].max((lambda_there[other] / lambda[at]).ln().abs() / 2.0);
            largest[1] = largest[1].max((&shape - partner).norm() / partner.norm());
            let deviations = DVector::from_fn(lambda.len(), |mode, _| {
                // To first order `dK_ij / (λi - λj)`, and where M changes `-λi dM_ij / (λi - λj)`.
                let moved = if run.is_mass { lambda[at] } else { (lambda[mode] * lambda[at]).sqrt() };
                let coupled = (strengths[mode] * strengths[at]).sqrt() * run.change.abs() * moved;
                let greatest = (coupled / (lambda[mode] - lambda[at]).abs()).min(1.0);
                if mode == at { 1.0 } else { 0.5 * greatest }
            });
            // What the shape has of modes that the base lacks looks like some of those that it has.
            let lacking = strengths[at] * run.change.abs() * lambda[at] / lambda.max();
            let shares = shares(&here, &shape, at, &deviations, lacking.max(DIGITS));
            if (&here * &shares).norm_squared() >= EXPLAINED * shape.norm_squared() {
                modes.push(PairedMode { base: at, lambda: lambda_there[other], shape, shares });
            }
        }
        if largest[0] < SAME[0] && largest[1] < SAME[1] {
            let (run, base) = names();
            return Err(RunError::NothingChanged { run, base, largest: largest[0] });
        }
        Ok(Self { run, rows, here, modes })
    }

    /// What a change by 1 does.
    fn change(&self, base: &ComputedModes) -> Change {
        let is_mass = self.run.is_mass;
        let lambda = base.lambda();
        let root = lambda.map(f64::sqrt);
        // What stays as it is by the change, K or M, is 1 in these coordinates; what changes is diagonal before and after.
        let scaled = |shares: &DVector<f64>| if is_mass { shares.component_mul(&root) } else { shares.clone() };
        let columns: Vec<DVector<f64>> = self.modes.iter().map(|mode| scaled(&mode.shares)).collect();
        let unit: Vec<DVector<f64>> = columns.iter().map(|column| column.normalize()).collect();
        let turned = orthonormal(&DMatrix::from_columns(&unit));
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
        for ((mode, column), turned) in self.modes.iter().zip(&columns).zip(turned.column_iter()) {
            if lambda[mode.base] > WELL_INSIDE * lambda.max() {
                continue;
            }
            let size = if is_mass { mode.lambda.sqrt() } else { 1.0 };
            let shares = if is_mass { turned.component_div(&root) * size } else { turned.into_owned() };
            let left = &mode.shape * (size / column.norm()) - &self.here * shares;
            for ([row, _], value) in self.rows.iter().zip(&left) {
                beyond.column_mut(*row).axpy(value / self.run.change, &turned, 1.0);
            }
        }
        Change { within, beyond, is_mass, by: self.run.change }
    }
}

/// All changes in the coordinates of a body, each of which has motions beyond the modes of its own.
fn in_coordinates(changes: &[Change], body: &ImportedMatrices, motions: &[DMatrix<f64>]) -> Vec<RunChange> {
    let mut first = changes.first().map_or(0, |change| change.within.nrows());
    let mut all = Vec::with_capacity(changes.len());
    for (change, motions) in changes.iter().zip(motions) {
        all.push(change.in_coordinates(body, motions, first));
        first += motions.ncols();
    }
    all
}

impl Change {
    /// The motions at the places that no combination of the base's modes has, each so large that its coordinate has next to no energy: places
    /// x motions.
    fn motions_beyond(&self, base: &ComputedModes) -> DMatrix<f64> {
        let typical = base.shapes.norm() / (base.frequencies_hz.len() as f64).sqrt();
        let svd = self.beyond.clone().svd(false, true);
        let Some(directions) = svd.v_t else { return DMatrix::zeros(base.places.len(), 0) };
        let mut order = largest_first(svd.singular_values.as_slice());
        order.retain(|&at| svd.singular_values[at] > NEGLIGIBLE * typical);
        order.truncate(MOST_BEYOND);
        directions.select_rows(&order).transpose() * (LIGHT * typical)
    }

    /// In the coordinates of a body in which the motions beyond its modes are the coordinates from `first` on.
    fn in_coordinates(&self, body: &ImportedMatrices, motions: &DMatrix<f64>, first: usize) -> RunChange {
        let (modes, size) = (self.within.nrows(), body.stiffness.nrows());
        let mut whole = DMatrix::zeros(size, size);
        whole.view_mut((0, 0), (modes, modes)).copy_from(&self.within);
        let mut coupling = DMatrix::zeros(size, size);
        for (at, motion) in motions.column_iter().enumerate() {
            // A coordinate far above answers a force statically: by force over stiffness, times its motion at the places.
            let coordinate = first + at;
            let stiffness = body.stiffness[(coordinate, coordinate)];
            let part = &self.beyond * motion * (-stiffness / motion.norm_squared());
            // What that softens at the change of the run is in the run's frequencies already.
            let mut own = coupling.view_mut((0, 0), (modes, modes));
            own += &part * part.transpose() * (self.by / stiffness);
            coupling.view_mut((0, coordinate), (modes, 1)).copy_from(&part);
            coupling.view_mut((coordinate, 0), (1, modes)).copy_from(&part.transpose());
        }
        let (stiffness, mass) = if self.is_mass { (coupling, Some(whole)) } else { (whole + coupling, None) };
        let root = body.stiffness.diagonal().map(f64::sqrt);
        let in_units =
            DMatrix::from_fn(size, size, |row, column| stiffness[(row, column)] / (root[row] * root[column]));
        let of_mass = mass.as_ref().map_or([f64::NEG_INFINITY, f64::INFINITY], positive);
        let of_stiffness = positive(&in_units);
        let range = [of_stiffness[0].max(of_mass[0]), of_stiffness[1].min(of_mass[1])];
        RunChange { stiffness: Arc::new(stiffness), mass: mass.map(Arc::new), range }
    }
}

/// Pairs of the base's modes and a run's, by shape and frequency; a run may have them in another order.
fn pairs(base: &ComputedModes, here: &DMatrix<f64>, run: &ComputedModes, there: &DMatrix<f64>) -> Vec<(usize, usize)> {
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

/// Between which factors `1 + factor * change` stays positive definite.
fn positive(change: &DMatrix<f64>) -> [f64; 2] {
    /// So much of the way to where it is not.
    const NEARLY: f64 = 0.99;
    let eigenvalues = symmetric(change).symmetric_eigenvalues();
    let bound = |most: f64| if most > 0.0 { NEARLY / most } else { f64::INFINITY };
    [-bound(eigenvalues.max()), bound(-eigenvalues.min())]
}

impl Bend {
    /// From a run of another size than the one that tells of the change, and what the model of that has there.
    fn of(
        base: &ComputedModes,
        body: &ImportedMatrices,
        change: &Change,
        in_model: &RunChange,
        run: &Run,
    ) -> Option<Self> {
        let (modes, by) = (base.frequencies_hz.len(), run.change);
        let apart = by * (by - change.by);
        if apart == 0.0 || run.is_mass || !(in_model.range[0]..=in_model.range[1]).contains(&by) {
            return None;
        }
        let expected = in_model.modes(body, by)?;
        let (lambda, highest) = (base.lambda(), base.lambda().max());
        let mut of_modes = vec![None; modes];
        for mode in Paired::of(base, run).ok()?.modes.iter().filter(|mode| lambda[mode.base] < WELL_INSIDE * highest) {
            // The mode of the model that is mostly this one of the base.
            let share = |at: &usize| expected.shapes[(mode.base, *at)].abs();
            let at = (0..expected.frequency_hz.len()).max_by(|a, b| share(a).total_cmp(&share(b)))?;
            if expected.shapes[(mode.base, at)].powi(2) > EXPLAINED {
                let lambda_expected = (TAU * expected.frequency_hz[at]).powi(2);
                of_modes[mode.base] = Some((lambda_expected - mode.lambda) / apart / lambda[mode.base]);
            }
        }
        Some(Self { of_modes })
    }
}

/// Gives motions beyond the stiffness that runs of other sizes show, where there are any: a force that moves what is stiff lowers a mode more
/// than its share in the shape tells. None is negative; each motion's is fitted in turn until none changes.
fn stiffen(motions: &mut DMatrix<f64>, change: &Change, bends: &[Bend], body: &ImportedMatrices) {
    const ROUNDS: usize = 500;
    let Some(lightest) = motions.column_iter().next().map(|motion| motion.norm()) else { return };
    // By a unit of stiffness a mode bends by the square of what it gets of a motion.
    let along = &change.beyond * &*motions / lightest;
    let (mut rows, mut wanted) = (Vec::new(), Vec::new());
    for (mode, bent) in bends.iter().flat_map(|bend| bend.of_modes.iter().enumerate()) {
        let Some(bent) = bent else { continue };
        rows.push(along.row(mode).map(|share| share * share / body.stiffness[(mode, mode)]));
        wanted.push(*bent);
    }
    if rows.is_empty() {
        return;
    }
    let (rows, wanted) = (DMatrix::from_rows(&rows), DVector::from_vec(wanted));
    let (normal, right) = (rows.transpose() * &rows, rows.transpose() * wanted);
    let mut found = DVector::<f64>::zeros(motions.ncols());
    for _ in 0..ROUNDS {
        for at in 0..found.len() {
            let left = right[at] - normal.column(at).dot(&found) + normal[(at, at)] * found[at];
            found[at] = if normal[(at, at)] > 0.0 { (left / normal[(at, at)]).max(0.0) } else { 0.0 };
        }
    }
    // All motions beyond have coordinates of one stiffness: that of a motion, times the square of its size.
    let Some(stiffness) = body.stiffness.diagonal().iter().copied().reduce(f64::max) else { return };
    for (mut motion, found) in motions.column_iter_mut().zip(&found) {
        let size = (stiffness / found).sqrt();
        if size < lightest {
            motion *= size / lightest;
        }
    }
}

impl RunChange {
    /// Modes in the coordinates of the body, changed by so much.
    fn modes(&self, body: &ImportedMatrices, by: f64) -> Option<Modes> {
        let stiffness = &body.stiffness + self.stiffness.as_ref() * by;
        let mass = self.mass.as_ref().map_or_else(|| body.mass.clone(), |mass| &body.mass + mass.as_ref() * by);
        eigenmodes(&stiffness, &mass).ok()
    }
}

/// Matrices in the coordinates of the modes and of the motions beyond; its rows are the places.
fn body(base: &ComputedModes, motions: &[DMatrix<f64>]) -> ImportedMatrices {
    let lambda = base.lambda();
    let beyond: Vec<_> = motions.iter().flat_map(DMatrix::column_iter).collect();
    let (modes, size) = (lambda.len(), lambda.len() + beyond.len());
    let above = ABOVE * ABOVE * lambda.max();
    let diagonal = DVector::from_fn(size, |at, _| lambda.get(at).copied().unwrap_or(above));
    let mut coordinates = base.shapes.clone().resize_horizontally(size, 0.0);
    for (at, motion) in beyond.into_iter().enumerate() {
        coordinates.set_column(modes + at, &motion);
    }
    ImportedMatrices {
        stiffness: DMatrix::from_diagonal(&diagonal),
        mass: DMatrix::identity(size, size),
        nodes: Vec::new(),
        coordinates: Some(Arc::new(coordinates)),
        places: base.places.as_slice().into(),
        whole: None,
    }
}

/// Says where shapes are not mass-normalised. With shapes scaled by s, the share of mode j in the changed mode i is to that of i in j as
/// `-s_i² / s_j²` where K was changed, and as `-λ_i s_i² / (λ_j s_j²)` where M was.
fn not_normalised(base: &ComputedModes, runs: &[Paired<'_>]) -> Option<String> {
    let lambda = base.lambda();
    let size = lambda.len();
    let (mut normal, mut right) = (DMatrix::zeros(size, size), DVector::zeros(size));
    // At fewer places than modes, shares are a guess.
    for paired in runs.iter().filter(|paired| paired.rows.len() >= size) {
        for (index, one) in paired.modes.iter().enumerate() {
            for other in &paired.modes[..index] {
                let (i, j) = (one.base, other.base);
                let (there, back) = (one.shares[j], other.shares[i]);
                let weight = there.abs().min(back.abs());
                if weight < TELLING || lambda[i].max(lambda[j]) > WELL_INSIDE * lambda.max() {
                    continue;
                }
                let of_mass = if paired.run.is_mass { (lambda[i] / lambda[j]).ln() } else { 0.0 };
                let ratio = ((there / back).abs().ln() - of_mass) / 2.0;
                let weight = weight * weight;
                for (at, sign) in [(i, 1.0), (j, -1.0)] {
                    normal[(at, at)] += weight;
                    right[at] += sign * weight * ratio;
                }
                normal[(i, j)] -= weight;
                normal[(j, i)] -= weight;
            }
        }
    }
    let told: Vec<usize> = (0..size).filter(|&mode| normal[(mode, mode)] > 0.0).collect();
    // All scales together may be anything; what nothing tells stays as it is.
    let ridge = 1e-3 * normal.diagonal().max();
    for mode in 0..size {
        normal[(mode, mode)] += ridge;
    }
    let scales: DVector<f64> = normal.cholesky()?.solve(&right);
    let largest = told.iter().copied().max_by(|&a, &b| scales[a].total_cmp(&scales[b]))?;
    let smallest = told.iter().copied().min_by(|&a, &b| scales[a].total_cmp(&scales[b]))?;
    let factor = (scales[largest] - scales[smallest]).exp();
    (factor > NOT_NORMALISED).then(|| {
        format!(
            "{}: its shapes do not look mass-normalised: by the runs, mode {} is scaled {factor:.1} times as large as mode {}; export mass-normalised shapes, or give each mode its `modal_mass`",
            base.file.display(),
            largest + 1,
            smallest + 1
        )
    })
}

/// Says where a run of another size is not what the smallest lets expect.
fn not_linear(name: &str, body: &ImportedMatrices, change: &RunChange, smallest: &Run, run: &Run) -> Option<String> {
    let by = run.change;
    if !(change.range[0]..=change.range[1]).contains(&by) {
        return Some(format!(
            "{}: the run by {} of `{name}` says nothing of a change by {by}: stiffness or mass would become negative",
            run.modes.file.display(),
            smallest.change
        ));
    }
    let expected = change.modes(body, by)?;
    let coordinates = body.coordinates.as_ref()?;
    let expected = ComputedModes {
        file: run.modes.file.clone(),
        places: body.places.to_vec(),
        shapes: coordinates.as_ref() * &expected.shapes,
        frequencies_hz: expected.frequency_hz,
    };
    let seen: Vec<[usize; 2]> = (expected.places.iter().enumerate())
        .filter_map(|(row, place)| Some([row, run.modes.places.iter().position(|other| other == place)?]))
        .collect();
    let here = expected.shapes.select_rows(seen.iter().map(|[row, _]| row));
    let there = run.modes.shapes.select_rows(seen.iter().map(|[_, row]| row));
    let wrong = |&(at, other): &(usize, usize)| (expected.frequencies_hz[at] / run.modes.frequencies_hz[other]).ln();
    let highest_hz = smallest.modes.frequencies_hz.last()? * WELL_INSIDE.sqrt();
    let mut pairs = pairs(&expected, &here, &run.modes, &there);
    pairs.retain(|&(_, other)| run.modes.frequencies_hz[other] < highest_hz);
    let worst = pairs.iter().copied().max_by(|a, b| wrong(a).abs().total_cmp(&wrong(b).abs()))?;
    let moved = |&(_, other): &(usize, usize)| {
        let nearest = |hz: &f64| (run.modes.frequencies_hz[other] / hz).ln().abs();
        smallest.modes.frequencies_hz.iter().map(nearest).fold(f64::INFINITY, f64::min)
    };
    let most = pairs.iter().map(moved).fold(0.0, f64::max);
    (wrong(&worst).abs() > NOT_WORTH.max(NOT_LINEAR * most)).then(|| {
        format!(
            "{}: by {by} of `{name}` mode {} has {:.4} Hz, where the run by {} lets expect {:.4} Hz: frequencies do not follow this change as stiffness or mass would make them; take values of this size as estimates",
            run.modes.file.display(),
            worst.1 + 1,
            run.modes.frequencies_hz[worst.1],
            smallest.change,
            expected.frequencies_hz[worst.0],
        )
    })
}

impl ComputedModes {
    /// Squared circular frequencies in 1/s².
    fn lambda(&self) -> DVector<f64> {
        let squared = |hz: &f64| (TAU * hz).powi(2);
        DVector::from_iterator(self.frequencies_hz.len(), self.frequencies_hz.iter().map(squared))
    }
}
