//! Modes of oscillators that a few dashpots couple.
//!
//! Undamped frequencies and a damping matrix of low rank flow in; all poles and vectors flow out. A dense eigenproblem of twice the size
//! takes ten times as long.

use nalgebra::{Complex, DMatrix, DVector, DVectorView};

use super::eigen::EigenPairs;
use super::sets::sets_apart;

/// More dashpots than this gain nothing over a dense eigenproblem.
const MOST_DASHPOTS: usize = 4;
/// Damping whose trace is this share of all is rounding.
const ROUNDING: f64 = 1e-13;
/// What dashpots damp or couple by less than this share of its frequency they leave alone.
const UNCOUPLED: f64 = 1e-13;
const MOST_SWEEPS: usize = 40;
/// A root that moves by less than this share of how far it is from its undamped pole has converged.
const CONVERGED: f64 = 1e-12;
/// Or by less than this share of itself.
const STILL: f64 = 4e-16;
/// Roots that are closer than this share of themselves may be one root found twice, or a double root, which has been found to half the
/// digits.
const APART: f64 = 1e-6;

/// All poles s (1/s), conjugates included, of `(s² + s C + diag(omega²)) q = 0` with the undamped `omega` (rad/s, above zero) and the
/// symmetric, positive semidefinite `damping` C (1/s), with vectors q of length 1, a column each. `None` where C is no matter of a few
/// dashpots, a pole does not turn, or poles are so close that they are not told apart: then a dense solver is asked.
///
/// With `C = B Bᵀ`, poles are the roots of `prod(s² + omega²) det(I + s Bᵀ diag(1/(s² + omega²)) B)`, all sought at once (Aberth 1973,
/// Math. Comp. 27, 339). As many different roots as there are poles are all poles.
///
/// # Panics
/// Where `damping` has not as many rows and columns as there are frequencies.
pub fn dashpot_modes(omega: &[f64], damping: &DMatrix<f64>) -> Option<EigenPairs<Complex<f64>>> {
    let count = omega.len();
    assert_eq!(damping.shape(), (count, count), "damping is that of {count} oscillators");
    let mut values = Vec::with_capacity(2 * count);
    let mut vectors = DMatrix::zeros(count, 2 * count);
    let is_damped = |at: usize| damping[(at, at)] > UNCOUPLED * omega[at];
    let is_coupled = |a: usize, b: usize| {
        is_damped(a) && is_damped(b) && damping[(a, b)].abs() > UNCOUPLED * (omega[a] * omega[b]).sqrt()
    };
    // Of a round tower's pairs of modes, which have one frequency, each set has one.
    for set in sets_apart(count, is_coupled) {
        let mut keep = |pole: Complex<f64>, vector: &DVector<Complex<f64>>| {
            for (&oscillator, share) in set.iter().zip(vector.iter()) {
                vectors[(oscillator, values.len())] = *share;
                vectors[(oscillator, values.len() + 1)] = share.conj();
            }
            values.extend([pole, pole.conj()]);
        };
        match set.as_slice() {
            &[alone] if !is_damped(alone) => {
                keep(Complex::new(0.0, omega[alone]), &DVector::from_element(1, Complex::ONE));
            }
            _ => {
                let own: Vec<f64> = set.iter().map(|&oscillator| omega[oscillator]).collect();
                let dashpots = Dashpots::of(&own, &damping.select_rows(&set).select_columns(&set))?;
                for root in dashpots.roots()? {
                    keep(root.pole, &dashpots.vector(&root)?);
                }
            }
        }
    }
    Some(EigenPairs { values, vectors })
}

/// Oscillators that dashpots couple, with the dashpots.
struct Dashpots<'a> {
    omega: &'a [f64],
    /// How each moves with each oscillator, dashpots x oscillators.
    motions: DMatrix<f64>,
}

/// A pole, in the upper half plane.
#[derive(Clone, Copy)]
struct Root {
    /// The oscillator from whose undamped pole it comes.
    of: usize,
    pole: Complex<f64>,
    /// `s² + omega²`, which the pole itself has to few digits.
    offset: Complex<f64>,
}

impl<'a> Dashpots<'a> {
    /// By Cholesky's method with pivots, which ends at the rank.
    fn of(omega: &'a [f64], damping: &DMatrix<f64>) -> Option<Self> {
        if !damping.trace().is_finite() || omega.iter().any(|omega| *omega <= 0.0) {
            return None;
        }
        let mut left = damping.clone();
        let negligible = ROUNDING * damping.trace();
        let mut motions: Vec<DVector<f64>> = Vec::new();
        while left.trace() > negligible {
            if motions.len() == MOST_DASHPOTS {
                return None;
            }
            let pivot = left.diagonal().imax();
            let root = left[(pivot, pivot)].sqrt();
            let motion = left.column(pivot) / root;
            left -= &motion * motion.transpose();
            motions.push(motion);
        }
        let motions = DMatrix::from_fn(motions.len(), omega.len(), |dashpot, oscillator| motions[dashpot][oscillator]);
        Some(Self { omega, motions })
    }

    fn roots(&self) -> Option<Vec<Root>> {
        let count = self.omega.len();
        // To first order.
        let start = |of: usize| {
            let by_dashpots = self.motions.column(of).norm_squared();
            self.root(of, Complex::new(0.0, -self.omega[of] * by_dashpots))
        };
        let mut roots: Vec<Root> = (0..count).map(start).collect();
        let mut open: Vec<usize> = (0..count).collect();
        for _ in 0..MOST_SWEEPS {
            let mut next = Vec::new();
            for &at in &open {
                let step = self.step(&roots, at)?;
                let root = &mut roots[at];
                let moved = self.root(at, root.offset + root.pole * step * 2.0 + step * step);
                let is_still = (moved.offset - root.offset).norm() <= CONVERGED * moved.offset.norm()
                    || step.norm() <= STILL * root.pole.norm();
                *root = moved;
                if !is_still {
                    next.push(at);
                }
            }
            open = next;
            if open.is_empty() {
                return are_different(&roots).then_some(roots);
            }
        }
        None
    }

    fn root(&self, of: usize, offset: Complex<f64>) -> Root {
        // The principal root has a real part of zero or more.
        let turned = (Complex::from(self.omega[of].powi(2)) - offset).sqrt();
        Root { of, pole: turned * Complex::I, offset }
    }

    /// Aberth's step of a root.
    fn step(&self, roots: &[Root], at: usize) -> Option<Complex<f64>> {
        let pole = roots[at].pole;
        let compliances = self.compliances(&roots[at]);
        let through = self.through(&compliances);
        let slope = &through - self.through(&compliances.component_mul(&compliances)) * (pole * pole * 2.0);
        let by_dashpots = coupling(pole, &through).lu().solve(&slope).map(|solved| solved.trace());
        let logarithmic = compliances.sum() * pole * 2.0 + by_dashpots.unwrap_or(Complex::new(f64::INFINITY, 0.0));
        if !logarithmic.is_finite() {
            // It stands on the root.
            return Some(Complex::ZERO);
        }
        let others = roots.iter().enumerate().filter(|(other, _)| *other != at).map(|(_, other)| other.pole);
        let others = others.chain(roots.iter().map(|other| other.pole.conj()));
        let step = -(logarithmic - others.map(|other| (pole - other).inv()).sum::<Complex<f64>>()).inv();
        step.is_finite().then_some(step)
    }

    /// `1 / (s² + omega²)` of each oscillator.
    fn compliances(&self, root: &Root) -> DVector<Complex<f64>> {
        let own = self.omega[root.of];
        let of = |other: &f64| (root.offset + (other - own) * (other + own)).inv();
        DVector::from_iterator(self.omega.len(), self.omega.iter().map(of))
    }

    /// `Bᵀ diag(by) B`, dashpots x dashpots.
    fn through(&self, by: &DVector<Complex<f64>>) -> DMatrix<Complex<f64>> {
        DMatrix::from_fn(self.motions.nrows(), self.motions.nrows(), |a, b| {
            let of = |(by, motion): (&Complex<f64>, DVectorView<'_, f64>)| by * (motion[a] * motion[b]);
            by.iter().zip(self.motions.column_iter()).map(of).sum::<Complex<f64>>()
        })
    }

    /// `q = diag(1/(s² + omega²)) B v`, where v is what the dashpots feel: `(I + s Bᵀ diag(1/(s² + omega²)) B) v = 0`.
    fn vector(&self, root: &Root) -> Option<DVector<Complex<f64>>> {
        let compliances = self.compliances(root);
        let felt = match self.motions.nrows() {
            1 => DVector::from_element(1, Complex::ONE),
            _ => {
                let right = coupling(root.pole, &self.through(&compliances)).svd(false, true).v_t?;
                right.row(right.nrows() - 1).adjoint()
            }
        };
        let forces = self.motions.map(Complex::from).tr_mul(&felt);
        let vector = compliances.component_mul(&forces);
        let length = vector.norm();
        (length.is_finite() && length > 0.0).then(|| vector / Complex::from(length))
    }
}

/// `I + s Bᵀ diag(1/(s² + omega²)) B`, which is singular at a pole.
fn coupling(pole: Complex<f64>, through: &DMatrix<Complex<f64>>) -> DMatrix<Complex<f64>> {
    DMatrix::identity(through.nrows(), through.nrows()) + through * pole
}

fn are_different(roots: &[Root]) -> bool {
    let turn = roots.iter().all(|root| root.pole.im > APART * root.pole.norm());
    let is_apart = |one: &Root, other: &Root| (one.pole - other.pole).norm() > APART * one.pole.norm();
    let mut pairs = roots.iter().enumerate().flat_map(|(at, one)| roots[..at].iter().map(move |other| (one, other)));
    turn && pairs.all(|(one, other)| is_apart(one, other))
}
