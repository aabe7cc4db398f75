//! The orthogonal matrix whose columns, as combinations of the model's shapes, resemble the measured shapes the most.
//!
//! Minimises `sum w_i (1 - MAC_i(V e_i))²` over V in O(m) by a Levenberg-Marquardt method on the group: steps are
//! `V exp(A)`, A skew. The gradient vanishes at MAC = 0 as it does at MAC = 1, so one start is not enough: the
//! identity and three ridge-regularised Procrustes solutions are taken, first with frozen weights `w (1 - MAC)`, then on the
//! true objective. Modes that the sensors hardly separate leave valleys with several minima: from the best one the search goes
//! a long way along the directions in which the objective rises the least.

use nalgebra::{Cholesky, DMatrix, DVector};

/// One measured shape's part of the objective.
#[derive(Debug, Clone)]
pub(super) struct ShapeTerm {
    /// G = Bᵀ B, B the model's shapes at the mode's sensors.
    gram: DMatrix<f64>,
    /// b = Bᵀ phihat, phihat of unit length.
    product: DVector<f64>,
    weight: f64,
}

/// Ridge of the Procrustes starts, relative to the mean diagonal of G.
const RIDGES: [f64; 3] = [1e-4, 1e-2, 1.0];
/// Rounds with frozen weights; they only have to reach the right valley.
const ROUGH_ROUNDS: usize = 6;
/// Far more than the polish needs; a bound so that it ends.
const POLISH_ROUNDS: usize = 400;
/// The search of the right valley ends where a step gains less than this share of the objective, ...
const SEARCH_GAIN: f64 = 1e-4;
/// ... and the polish there.
const POLISH_GAIN: f64 = 1e-13;
/// How many of the softest directions are tried from a bottom, ...
const SOFT_DIRECTIONS: usize = 2;
/// ... how far, as an angle, ...
const EXCURSION: f64 = 1.0;
/// ... and how often, where that found a lower bottom.
const EXCURSIONS: usize = 4;
/// Inverse iterations towards the softest directions.
const INVERSE_ITERATIONS: usize = 6;
/// A bottom that is lower by less than this share is the same one.
const LOWER: f64 = 1e-4;
/// Frozen weights stay above this share of the weight, or a pair that fits would be given up.
const LEAST_MISFIT: f64 = 1e-3;
/// How many of the best starts after the rough rounds are followed to the bottom.
const FOLLOWED: usize = 2;

impl ShapeTerm {
    /// `None` where the measured shape is zero at its sensors, or no model shape moves there.
    pub(super) fn new(shapes: &DMatrix<f64>, measured: &DVector<f64>, weight: f64) -> Option<Self> {
        let length = measured.norm();
        let gram = shapes.tr_mul(shapes);
        (length > 0.0 && gram.trace() > 0.0).then(|| Self { product: shapes.tr_mul(measured) / length, gram, weight })
    }

    /// MAC of the combination `v` of the model's shapes.
    pub(super) fn mac(&self, v: &DVector<f64>) -> f64 {
        let square = v.dot(&(&self.gram * v));
        if square > 0.0 { (self.product.dot(v).powi(2) / square).min(1.0) } else { 0.0 }
    }

    /// The highest MAC of any combination: bᵀ G⁺ b.
    pub(super) fn ceiling(&self) -> f64 {
        let eigen = self.gram.clone().symmetric_eigen();
        let greatest = eigen.eigenvalues.amax();
        let share = |(vector, &value): (nalgebra::DVectorView<'_, f64>, &f64)| {
            if value > 1e-13 * greatest { self.product.dot(&vector).powi(2) / value } else { 0.0 }
        };
        eigen.eigenvectors.column_iter().zip(eigen.eigenvalues.iter()).map(share).sum::<f64>().min(1.0)
    }

    /// The combination that resembles the measured shape most, with a ridge.
    fn best(&self, ridge: f64) -> Option<DVector<f64>> {
        let size = self.gram.nrows();
        let diagonal = self.gram.trace() / size as f64 * ridge;
        let v = Cholesky::new(&self.gram + DMatrix::identity(size, size) * diagonal)?.solve(&self.product);
        v.try_normalize(0.0)
    }

    /// 1 - MAC at column `v`, half its gradient, and half the Gauss-Newton part of its Hessian, both over dv.
    ///
    /// With the residual r = (I - phihat phihatᵀ) s, s = B v/|B v|, and g = Bᵀ s: `dr = (I - phihat phihatᵀ)(B dv - s gᵀ dv)/|B v|`,
    /// so `Jᵀ J = (G - g gᵀ - h hᵀ)/|B v|²` with `h = b - (phihatᵀ s) g`, and `Jᵀ r = -(phihatᵀ s) h/|B v|`.
    fn slopes(&self, v: &DVector<f64>) -> Option<(f64, DVector<f64>, DMatrix<f64>)> {
        let moved = &self.gram * v;
        let square = v.dot(&moved);
        (square > 0.0).then_some(())?;
        let length = square.sqrt();
        let cosine = self.product.dot(v) / length;
        let g = moved / length;
        let h = &self.product - &g * cosine;
        let curvature = (&self.gram - &g * g.transpose() - &h * h.transpose()) / square;
        Some(((1.0 - cosine * cosine).max(0.0), h * (-cosine / length), curvature))
    }
}

/// What is minimised.
#[derive(Clone, Copy)]
enum Stage<'a> {
    /// `sum c_i (1 - MAC_i)` with frozen c_i.
    Frozen(&'a [f64]),
    /// `sum w_i (1 - MAC_i)²`.
    True,
}

/// V, terms x terms: column i is the combination for term i (one without a measured shape takes what the others leave).
pub(super) fn minimise(terms: &[Option<ShapeTerm>]) -> DMatrix<f64> {
    let size = terms.len();
    let identity = DMatrix::identity(size, size);
    if size < 2 {
        return identity;
    }
    let starts = std::iter::once(identity.clone()).chain(RIDGES.iter().filter_map(|&ridge| procrustes(terms, ridge)));
    let mut rough: Vec<(f64, DMatrix<f64>)> = starts
        .map(|start| {
            let mut rotation = start;
            for _ in 0..ROUGH_ROUNDS {
                let frozen: Vec<f64> = terms
                    .iter()
                    .zip(rotation.column_iter())
                    .map(|(term, column)| {
                        let Some(term) = term else { return 0.0 };
                        term.weight * (1.0 - term.mac(&column.into_owned())).max(LEAST_MISFIT)
                    })
                    .collect();
                rotation = descend(terms, Stage::Frozen(&frozen), rotation, 2, SEARCH_GAIN);
            }
            (objective(terms, Stage::True, &rotation), rotation)
        })
        .collect();
    rough.sort_by(|a, b| a.0.total_cmp(&b.0));
    let best =
        rough.into_iter().take(FOLLOWED).map(|(_, start)| bottom(terms, start)).min_by(|a, b| a.0.total_cmp(&b.0));
    let Some(mut best) = best else { return identity };
    for _ in 0..EXCURSIONS {
        let lower = excursions(terms, &best.1).into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
        match lower {
            Some(lower) if lower.0 < (1.0 - LOWER) * best.0 => best = lower,
            _ => break,
        }
    }
    descend(terms, Stage::True, best.1, POLISH_ROUNDS, POLISH_GAIN)
}

/// The bottom of the valley around `start`: the objective there and V.
fn bottom(terms: &[Option<ShapeTerm>], start: DMatrix<f64>) -> (f64, DMatrix<f64>) {
    let rotation = descend(terms, Stage::True, start, POLISH_ROUNDS, SEARCH_GAIN);
    (objective(terms, Stage::True, &rotation), rotation)
}

/// Bottoms that are reached from a bottom over the softest directions.
fn excursions(terms: &[Option<ShapeTerm>], rotation: &DMatrix<f64>) -> Vec<(f64, DMatrix<f64>)> {
    let (_, hessian) = slopes(terms, Stage::True, rotation);
    let Some(directions) = softest(&hessian) else { return Vec::new() };
    directions
        .column_iter()
        .flat_map(|direction| [EXCURSION, -EXCURSION].map(|angle| direction * angle))
        .map(|step| bottom(terms, turned(rotation, &step)))
        .collect()
}

/// The directions in which a quadratic form rises the least, nearly: inverse iteration from the least diagonal entries, far
/// cheaper than all eigenvectors.
fn softest(hessian: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let size = hessian.nrows();
    let shift = 1e-6 * hessian.trace() / size as f64;
    let factor = Cholesky::new(hessian + DMatrix::identity(size, size) * shift)?;
    let mut order: Vec<usize> = (0..size).collect();
    order.sort_by(|&a, &b| hessian[(a, a)].total_cmp(&hessian[(b, b)]));
    let mut directions = DMatrix::zeros(size, SOFT_DIRECTIONS.min(size));
    for (column, &row) in order.iter().take(directions.ncols()).enumerate() {
        directions[(row, column)] = 1.0;
    }
    for _ in 0..INVERSE_ITERATIONS {
        directions = factor.solve(&directions).qr().q();
    }
    Some(directions)
}

/// The orthogonal matrix nearest to the columns that each resemble their measured shape the most (polar factor).
fn procrustes(terms: &[Option<ShapeTerm>], ridge: f64) -> Option<DMatrix<f64>> {
    let size = terms.len();
    let mut target = DMatrix::identity(size, size);
    for (term, mut column) in terms.iter().zip(target.column_iter_mut()) {
        if let Some(best) = term.as_ref().and_then(|term| term.best(ridge)) {
            column.copy_from(&best);
        }
    }
    let decomposition = target.svd(true, true);
    Some(decomposition.u? * decomposition.v_t?)
}

fn objective(terms: &[Option<ShapeTerm>], stage: Stage<'_>, rotation: &DMatrix<f64>) -> f64 {
    let part = |index: usize, term: &ShapeTerm| {
        let misfit = 1.0 - term.mac(&rotation.column(index).into_owned());
        match stage {
            Stage::Frozen(weights) => weights[index] * misfit,
            Stage::True => term.weight * misfit * misfit,
        }
    };
    terms.iter().enumerate().filter_map(|(index, term)| Some(part(index, term.as_ref()?))).sum()
}

/// Levenberg-Marquardt steps from `rotation`, each of which lowers the objective.
fn descend(
    terms: &[Option<ShapeTerm>],
    stage: Stage<'_>,
    mut rotation: DMatrix<f64>,
    rounds: usize,
    least_gain: f64,
) -> DMatrix<f64> {
    let mut value = objective(terms, stage, &rotation);
    let mut damping = 1e-3;
    for _ in 0..rounds {
        let (gradient, hessian) = slopes(terms, stage, &rotation);
        let scale = hessian.trace() / hessian.nrows().max(1) as f64;
        if scale <= 0.0 || gradient.amax() <= f64::EPSILON * scale {
            break;
        }
        let mut step = None;
        while step.is_none() && damping < 1e12 {
            let damped = &hessian + DMatrix::identity(hessian.nrows(), hessian.nrows()) * (damping * scale);
            let candidate = Cholesky::new(damped).map(|factor| turned(&rotation, &-factor.solve(&gradient)));
            step = candidate.and_then(|candidate| {
                let there = objective(terms, stage, &candidate);
                (there < value).then_some((there, candidate))
            });
            damping *= if step.is_some() { 0.2 } else { 5.0 };
        }
        let Some((there, candidate)) = step else { break };
        let gain = value - there;
        (value, rotation) = (there, candidate);
        damping = f64::max(damping, 1e-9);
        if gain <= least_gain * value {
            break;
        }
    }
    rotation
}

/// Gradient and a positive semi-definite Hessian over the skew entries A_jk, j < k, with dV = V A.
fn slopes(terms: &[Option<ShapeTerm>], stage: Stage<'_>, rotation: &DMatrix<f64>) -> (DVector<f64>, DMatrix<f64>) {
    let size = rotation.ncols();
    let unknowns = size * (size - 1) / 2;
    let mut gradient = DVector::zeros(unknowns);
    let mut hessian = DMatrix::zeros(unknowns, unknowns);
    let unknown = |j: usize, k: usize| j * size - j * (j + 1) / 2 + k - j - 1;
    for (index, term) in terms.iter().enumerate() {
        let Some((term, (misfit, half, curvature))) =
            term.as_ref().and_then(|term| Some((term, term.slopes(&rotation.column(index).into_owned())?)))
        else {
            continue;
        };
        // Into the coordinates of the columns of V.
        let half = rotation.tr_mul(&half);
        let curvature = rotation.tr_mul(&curvature) * rotation;
        let (slope, straight, square) = match stage {
            Stage::Frozen(weights) => (2.0 * weights[index], 2.0 * weights[index], 0.0),
            // w g²: gradient 2 w g g', Hessian 2 w g' g'ᵀ + 2 w g g''.
            Stage::True => (4.0 * term.weight * misfit, 4.0 * term.weight * misfit, 8.0 * term.weight),
        };
        // Column `index` moves along column `other` with A_(other,index).
        let others = (0..size).filter(|&other| other != index).map(|other| {
            let (at, sign) = if other < index { (unknown(other, index), 1.0) } else { (unknown(index, other), -1.0) };
            (other, at, sign)
        });
        let others: Vec<(usize, usize, f64)> = others.collect();
        for &(other, at, sign) in &others {
            gradient[at] += sign * slope * half[other];
            for &(second, second_at, second_sign) in &others {
                let entry = straight * curvature[(other, second)] + square * half[other] * half[second];
                hessian[(at, second_at)] += sign * second_sign * entry;
            }
        }
    }
    (gradient, hessian)
}

/// V times the Cayley transform of the skew matrix (I - A/2)⁻¹ (I + A/2), orthogonal for any A and exp(A) to second order.
fn turned(rotation: &DMatrix<f64>, step: &DVector<f64>) -> DMatrix<f64> {
    let size = rotation.ncols();
    let mut half = DMatrix::zeros(size, size);
    let mut entries = step.iter();
    for j in 0..size {
        for k in j + 1..size {
            let entry = 0.5 * entries.next().copied().unwrap_or(0.0);
            half[(j, k)] = entry;
            half[(k, j)] = -entry;
        }
    }
    let identity = DMatrix::identity(size, size);
    // I - A/2 of a skew A is never singular.
    let cayley = (&identity - &half).lu().solve(&(&identity + &half)).unwrap_or(identity);
    rotation * cayley
}
