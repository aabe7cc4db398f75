//! Modes of oscillators that a few dashpots couple.
//!
//! Undamped frequencies and a damping matrix of low rank flow in; all poles and vectors flow out. A dense eigenproblem of twice the size
//! takes ten times as long.

use nalgebra::{Complex, DMatrix, DVector};

use super::eigen::EigenPairs;

/// More dashpots than this gain nothing over a dense eigenproblem.
const MOST_DASHPOTS: usize = 4;
/// Damping whose trace is this share of all is rounding.
const ROUNDING: f64 = 1e-13;
/// An oscillator that dashpots damp by less than this share of its frequency is not coupled.
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
    for set in coupled_sets(omega, damping) {
        let own: Vec<f64> = set.iter().map(|&oscillator| omega[oscillator]).collect();
        let dashpots = Dashpots::of(&own, &damping.select_rows(&set).select_columns(&set))?;
        for root in dashpots.roots()? {
            for (value, of_set) in set.iter().zip(dashpots.vector(&root)?.iter()) {
                vectors[(*value, values.len())] = *of_set;
                vectors[(*value, values.len() + 1)] = of_set.conj();
            }
            values.extend([root.pole, root.pole.conj()]);
        }
    }
    Some(EigenPairs { values, vectors })
}

/// Oscillators in sets that no dashpot couples to each other: of a round tower's pairs of modes, which have one frequency, each set has one.
fn coupled_sets(omega: &[f64], damping: &DMatrix<f64>) -> Vec<Vec<usize>> {
    let count = omega.len();
    let mut lowest: Vec<usize> = (0..count).collect();
    for a in 0..count {
        for b in 0..a {
            let both = (omega[a] * omega[b]).sqrt();
            if damping[(a, b)].abs() > UNCOUPLED * both && lowest[a] != lowest[b] {
                let (kept, gone) = (lowest[a].min(lowest[b]), lowest[a].max(lowest[b]));
                lowest.iter_mut().filter(|of| **of == gone).for_each(|of| *of = kept);
            }
        }
    }
    let members = |first: usize| (first..count).filter(|&at| lowest[at] == first).collect();
    (0..count).filter(|&at| lowest[at] == at).map(members).collect()
}

/// One set of oscillators with its dashpots.
struct Dashpots<'a> {
    omega: &'a [f64],
    /// How each moves with each oscillator, dashpots x oscillators.
    motions: DMatrix<f64>,
    /// Oscillators that move any.
    coupled: Vec<usize>,
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
        let count = omega.len();
        if !damping.trace().is_finite() {
            return None;
        }
        if omega.iter().any(|omega| *omega <= 0.0) {
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
        let motions = DMatrix::from_fn(motions.len(), count, |dashpot, oscillator| motions[dashpot][oscillator]);
        let is_coupled = |&at: &usize| motions.column(at).norm_squared() > UNCOUPLED * omega[at];
        let coupled = (0..count).filter(is_coupled).collect();
        Some(Self { omega, motions, coupled })
    }

    fn roots(&self) -> Option<Vec<Root>> {
        let start = |of: usize| {
            let by_dashpots = self.motions.column(of).norm_squared();
            let (pole, offset) = (Complex::new(0.0, self.omega[of]), Complex::new(0.0, -self.omega[of] * by_dashpots));
            let is_coupled = self.coupled.binary_search(&of).is_ok();
            if is_coupled { self.root(of, offset) } else { Root { of, pole, offset: Complex::ZERO } }
        };
        let mut roots: Vec<Root> = (0..self.omega.len()).map(start).collect();
        let mut open = self.coupled.clone();
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
                return self.are_different(&roots).then_some(roots);
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
        let Root { of, pole, offset } = roots[at];
        let distances = self.distances(of, offset);
        let mut logarithmic = Complex::ZERO;
        let mut inverse = DVector::zeros(self.coupled.len());
        for (inverse, distance) in inverse.iter_mut().zip(distances.iter()) {
            *inverse = distance.inv();
            logarithmic += *inverse * pole * 2.0;
        }
        let count = self.motions.nrows();
        let mut coupling = DMatrix::<Complex<f64>>::identity(count, count);
        let mut slope = DMatrix::zeros(count, count);
        for a in 0..count {
            for b in 0..=a {
                let (mut first, mut second) = (Complex::ZERO, Complex::ZERO);
                for (&oscillator, inverse) in self.coupled.iter().zip(inverse.iter()) {
                    let by = *inverse * (self.motions[(a, oscillator)] * self.motions[(b, oscillator)]);
                    first += by;
                    second += by * *inverse;
                }
                let (value, by_pole) = (pole * first, first - pole * pole * second * 2.0);
                coupling[(a, b)] += value;
                slope[(a, b)] = by_pole;
                if a != b {
                    coupling[(b, a)] += value;
                    slope[(b, a)] = by_pole;
                }
            }
        }
        logarithmic += coupling.lu().solve(&slope).map_or(Complex::new(f64::INFINITY, 0.0), |solved| solved.trace());
        if !logarithmic.is_finite() {
            // It stands on the root.
            return Some(Complex::ZERO);
        }
        for &other in self.coupled.iter().filter(|other| **other != at) {
            logarithmic -= (pole - roots[other].pole).inv();
        }
        for &other in &self.coupled {
            logarithmic -= (pole - roots[other].pole.conj()).inv();
        }
        let step = -logarithmic.inv();
        step.is_finite().then_some(step)
    }

    /// `s² + omega²` of the coupled oscillators.
    fn distances(&self, of: usize, offset: Complex<f64>) -> DVector<Complex<f64>> {
        let own = self.omega[of];
        let distance = |&other: &usize| offset + (self.omega[other] - own) * (self.omega[other] + own);
        DVector::from_iterator(self.coupled.len(), self.coupled.iter().map(distance))
    }

    fn are_different(&self, roots: &[Root]) -> bool {
        let turn = roots.iter().all(|root| root.pole.im > APART * root.pole.norm());
        let is_apart = |one: &Root, other: &Root| (one.pole - other.pole).norm() > APART * one.pole.norm();
        let mut pairs = self
            .coupled
            .iter()
            .enumerate()
            .flat_map(|(at, &one)| self.coupled[..at].iter().map(move |&other| (one, other)));
        turn && pairs.all(|(one, other)| is_apart(&roots[one], &roots[other]))
    }

    /// `q = diag(1/(s² + omega²)) B v`, where v is what the dashpots feel: `(I + s Bᵀ diag(1/(s² + omega²)) B) v = 0`.
    fn vector(&self, root: &Root) -> Option<DVector<Complex<f64>>> {
        let mut vector = DVector::zeros(self.omega.len());
        if self.coupled.binary_search(&root.of).is_err() {
            vector[root.of] = Complex::ONE;
            return Some(vector);
        }
        let distances = self.distances(root.of, root.offset);
        let count = self.motions.nrows();
        let mut coupling = DMatrix::<Complex<f64>>::identity(count, count);
        for (&oscillator, distance) in self.coupled.iter().zip(distances.iter()) {
            let motion = self.motions.column(oscillator);
            coupling += (motion * motion.transpose()).map(|entry| root.pole * entry / distance);
        }
        let felt = match count {
            1 => DVector::from_element(1, Complex::ONE),
            _ => {
                let right = coupling.svd(false, true).v_t?;
                right.row(right.nrows() - 1).adjoint()
            }
        };
        for (&oscillator, distance) in self.coupled.iter().zip(distances.iter()) {
            let by_dashpots: Complex<f64> =
                self.motions.column(oscillator).iter().zip(felt.iter()).map(|(motion, felt)| felt * *motion).sum();
            vector[oscillator] = by_dashpots / distance;
        }
        let length = vector.norm();
        (length.is_finite() && length > 0.0).then(|| vector / Complex::from(length))
    }
}
