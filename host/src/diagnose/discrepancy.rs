//! What neither an effect nor the scatter of a beam's segments can make: how far a sound model of the kind misses modes all the same;
//! and how far segments scatter.
//!
//! A structure is no beam: sections distort, floors are no lumps, properties of bays are smeared. Relative errors of eigenvalues,
//! turning of neighbouring modes' shapes and local errors of shapes are independent Gaussian numbers, as an error of prediction
//! (Kennedy and O'Hagan 2001; Simoen, De Roeck and Lombaert 2015). How large they are is not known before: a [`Fit`] flows in, the
//! sizes with the highest evidence flow out, so that a model pays for each size by the volume of what it could then predict.

use std::cell::RefCell;
use std::collections::HashMap;

use nalgebra::{Cholesky, DVector, Dyn};
use rayon::prelude::*;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, Normal};

use super::criteria::{FAILS, STANDS_OUT};
use super::fit::Fit;
use super::misfit::Loss;
use super::near::Near;
use super::problem::Problem;
use super::state::State;

/// Standard deviations of what a model misses for reasons that no effect explains.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Discrepancy {
    /// Of a frequency, relative.
    pub frequency: f64,
    /// Of a component of a shape, in shares of its largest.
    pub shape: f64,
    /// Of what couples two modes, in shares of the stiffness: modes whose frequencies differ by d (ln f) turn by this over 2 d.
    pub coupling: f64,
    /// What the frequencies of a family of modes (bending along X, along Y, torsion) have in common, relative.
    pub family: f64,
    /// Of a shape, smoothly over the height and with sections that distort, in shares of its largest component.
    pub smooth: f64,
    /// All of these but the coupling are those of the middle mode; of others they are this power of the ratio of frequencies larger.
    pub growth: f64,
    /// How far segments scatter, in units of the tolerance that the study states.
    pub scatter: f64,
    /// What that is expected to be: 1, or what it would be if the study stated another tolerance.
    #[serde(skip)]
    pub(super) expected_scatter: f64,
}

/// How large a discrepancy can be.
struct Range {
    /// Sizes up to this are as good as none.
    least: f64,
    /// Up to this every size is as likely as any other; careful models of towers are this good.
    usual: f64,
    /// No structure that is rightly modelled as a beam or by matrices misses more.
    most: f64,
}

/// Engineers' tables of towers miss the frequencies of the structures they are made from by 0.3 to 3 %, most of it through
/// stiffnesses that scatter smoothly, which has its own tolerance.
const FREQUENCY: Range = Range { least: 5e-5, usual: 3e-3, most: 0.1 };
/// Sections distort by about a hundredth.
const SHAPE: Range = Range { least: 1e-4, usual: 5e-3, most: 0.2 };
/// Joints, shear areas and torsion constants are estimates for all modes of a family alike: those of careful models err by a hundredth in
/// frequency.
const FAMILY: Range = Range { least: 1e-4, usual: 1e-2, most: 0.1 };
/// Directions that tables give to a degree, and supports that are not quite alike, always couple modes by the least of these.
const COUPLING: Range = Range { least: 2e-3, usual: 4e-3, most: 0.2 };
/// The shorter the waves, the less a structure is a beam: at most by their square, as those of sections that shear.
const GROWTH: [f64; 2] = [0.0, 2.0];
/// Above what is usual, twice as much is one standard deviation less likely.
const FACTOR: f64 = 2.0;
/// A stated tolerance is an engineer's estimate: half as large, or larger by this factor, is one standard deviation less likely. A
/// sound structure that scatters twice as far was called unknown in 5 of 12 cases where the tolerance was taken for exact.
const SCATTER_FACTOR: f64 = 1.6;
/// A model whose segments scatter further from what the study states is not as good as it claims to be.
pub(super) const SCATTER: [f64; 2] = [0.5, 2.0];

impl Default for Discrepancy {
    fn default() -> Self {
        Self::NONE
    }
}

impl Range {
    /// How far a size is above what is usual, in standard deviations.
    fn above(&self, size: f64) -> f64 {
        ((size / self.usual).ln() / FACTOR.ln()).max(0.0)
    }
}

impl Discrepancy {
    /// Of a model that is as good as its tolerance says.
    pub(super) const NONE: Self = Self {
        frequency: 0.0,
        shape: 0.0,
        coupling: COUPLING.least,
        family: 0.0,
        smooth: 0.0,
        growth: 0.0,
        scatter: 1.0,
        expected_scatter: 1.0,
    };

    /// The same, if the study stated a tolerance this many times as large.
    fn none_at(expected_scatter: f64) -> Self {
        Self { scatter: expected_scatter, expected_scatter, ..Self::NONE }
    }

    /// What careful models of the kind miss, the more the shorter the waves, with segments that scatter as far as they may.
    fn usual_at(expected_scatter: f64) -> Self {
        let (frequency, shape, smooth) = (FREQUENCY.usual, SHAPE.usual, SHAPE.usual);
        Self { frequency, shape, smooth, growth: 1.0, scatter: SCATTER[1], ..Self::none_at(expected_scatter) }
    }

    /// From the logarithms of its sizes, the growth, and the logarithm of the scatter's.
    fn of_numbers(numbers: Numbers, expected_scatter: f64) -> Self {
        let size = |at: usize, range: &Range| {
            let size = numbers[at].exp();
            if size <= range.least * 1.001 { 0.0 } else { size }
        };
        let (frequency, shape) = (size(0, &FREQUENCY), size(1, &SHAPE));
        let (family, smooth) = (size(5, &FAMILY), size(6, &SHAPE));
        Self {
            frequency,
            shape,
            coupling: size(2, &COUPLING).max(COUPLING.least),
            family,
            smooth,
            // What is not there does not grow.
            growth: if [frequency, shape, family, smooth] == [0.0; 4] { 0.0 } else { numbers[AT_GROWTH] },
            scatter: numbers[4].exp(),
            expected_scatter,
        }
    }

    fn numbers(&self) -> Numbers {
        let ln = |size: f64, range: &Range| size.clamp(range.least, range.most).ln();
        let [frequency, family] = [ln(self.frequency, &FREQUENCY), ln(self.family, &FAMILY)];
        let [shape, smooth] = [self.shape, self.smooth].map(|size| ln(size, &SHAPE));
        [frequency, shape, ln(self.coupling, &COUPLING), self.growth, self.scatter.ln(), family, smooth]
    }

    /// How much larger the sizes of a mode are than those of the middle one, whose frequency is `middle_hz`.
    pub(super) fn grown(&self, frequency_hz: f64, middle_hz: f64) -> f64 {
        if self.growth == 0.0 { 1.0 } else { (frequency_hz / middle_hz).powf(self.growth) }
    }

    /// How far the sizes are above what is usual, in standard deviations.
    fn above(&self) -> [f64; 6] {
        let scatter = self.scatter_units().max(0.0);
        let [shape, smooth] = [self.shape, self.smooth].map(|size| SHAPE.above(size));
        let [frequency, family] = [FREQUENCY.above(self.frequency), FAMILY.above(self.family)];
        [frequency, shape, COUPLING.above(self.coupling), scatter, family, smooth]
    }

    /// By how much larger numbers of families are in units of another size; zero where either is none.
    pub(super) fn family_in_units_of(&self, other: &Self) -> f64 {
        if other.family > 0.0 { self.family / other.family } else { 0.0 }
    }

    /// How far the scatter's size is from what the study states, in standard deviations.
    fn scatter_units(&self) -> f64 {
        (self.scatter / self.expected_scatter).ln() / SCATTER_FACTOR.ln()
    }

    /// Logarithm of the prior: zero where the model is as good as its tolerance says.
    pub(super) fn log_prior(&self) -> f64 {
        let less = self.scatter_units().min(0.0);
        let squares = self.above().iter().map(|above| above * above).sum::<f64>() + less * less;
        -0.5 * squares - self.cost()
    }

    /// What the numbers in use cost.
    fn cost(&self) -> f64 {
        COST * self.in_use().len() as f64
    }

    /// Which of its numbers are others than those of a model that is as good as its tolerance says.
    fn in_use(&self) -> Vec<usize> {
        let (numbers, none) = (self.numbers(), Self::none_at(self.expected_scatter).numbers());
        (0..NUMBERS).filter(|&at| (numbers[at] - none[at]).abs() > 1e-9).collect()
    }

    /// Probability of a size as far above what is usual, or further, of a model of the right kind; `None` where none is above.
    pub(super) fn p_value(&self) -> Option<f64> {
        let above = self.above().into_iter().fold(0.0, f64::max);
        let normal = Normal::standard();
        (above > 0.0).then(|| 1.0 - normal.cdf(above).powi(SIZES.len() as i32))
    }

    /// What a model misses besides, in words; `None` where that is nothing.
    pub fn missed_in_words(&self) -> Option<String> {
        let sizes = [("frequencies", self.frequency.hypot(self.family)), ("shapes", self.shape.hypot(self.smooth))];
        let missed = sizes.into_iter().filter(|(_, size)| *size > 0.0);
        let parts: Vec<String> = missed.map(|(what, size)| format!("{what} by about {:.2} %", 100.0 * size)).collect();
        (!parts.is_empty()).then(|| parts.join(" and "))
    }

    /// How far segments scatter, in words; `None` where that is as far as the study states.
    pub fn scatter_in_words(&self) -> Option<String> {
        let is_other = self.scatter != self.expected_scatter;
        is_other.then(|| format!("its parts scatter {:.1} times as far as study.toml states", self.scatter))
    }

    /// Whether a model misses more than the study says that it may.
    pub(super) fn misses_more(&self) -> bool {
        self.missed_in_words().is_some() || self.scatter > self.expected_scatter
    }

    /// Whether a model of the right kind can miss as much.
    pub(super) fn is_plausible(&self) -> bool {
        self.p_value().is_none_or(|p_value| p_value >= FAILS)
    }

    /// With a share of its sizes.
    pub(crate) fn times(&self, share: f64) -> Self {
        Self {
            frequency: share * self.frequency,
            shape: share * self.shape,
            family: share * self.family,
            smooth: share * self.smooth,
            coupling: (share * self.coupling).max(COUPLING.least),
            scatter: self.scatter.powf(share),
            ..*self
        }
    }

    /// Whether another is the same for all that follows from it.
    pub(crate) fn is_like(&self, other: &Self) -> bool {
        let (one, other) = (self.numbers(), other.numbers());
        one.iter().zip(other).all(|(one, other)| (one - other).abs() < ALIKE)
    }
}

/// Sizes that differ by less than this (ln) are alike.
const ALIKE: f64 = 0.3;
/// What each number in use costs in the logarithm of the evidence. The sizes with the highest evidence stand for all sizes: the range
/// of a size before is about e to the 1 to 2 times what the data leave of it, and chance alone raises the evidence by half for
/// each number (Akaike 1974). Without this, every second tower whose modes differ from the model's by nothing but measurement and
/// tolerance had shapes missed.
const COST: f64 = 1.0;
/// How many numbers say what a model misses.
const NUMBERS: usize = 7;
type Numbers = [f64; NUMBERS];
/// The growth is the one of these at this index; the others are sizes.
const AT_GROWTH: usize = 3;
const SIZES: [usize; NUMBERS - 1] = [0, 1, 2, 4, 5, 6];
const ALL: [usize; NUMBERS] = [0, 1, 2, 3, 4, 5, 6];
/// The evidence has several maxima: small sizes that grow explain the upper modes as well as large ones that do not, and the robust
/// loss lets go of the lower ones. Between the two frequencies, shapes and growth have to change together. So sizes are first sought at
/// each of these, and growth is free only from the best.
const STARTS: [f64; 3] = [0.0, 1.0, 2.0];
/// Steps of that search, and then of the one for the best sizes (ln) and growth.
const COARSE: [f64; 2] = [1.6, 0.8];
const FINE: [f64; 2] = [0.8, 0.4];
const PRUNED: [f64; 1] = [0.4];
/// Where the evidence (ln) falls by more without a number, the others do not make up for it: in 400 cases where nothing fits they made up for
/// three quarters of a fall at most.
const HOPELESS: f64 = 30.0;
/// Fits and sizes are settled in turn, so often at most.
const MOST_ROUNDS: usize = 3;

impl Problem {
    /// The same with another discrepancy.
    pub(super) fn with_discrepancy(&self, discrepancy: Discrepancy) -> Self {
        let mut other = self.clone();
        other.background = self.background.sized(discrepancy.scatter);
        other.discrepancy = discrepancy;
        other
    }

    /// The sizes of the discrepancy with the highest evidence, near a fit, and by how much they raise its logarithm: the differences
    /// follow effects and background as they do there (Laplace's approximation).
    pub(super) fn best_discrepancy(&self, fit: &Fit) -> (Discrepancy, f64) {
        self.better_discrepancy(fit, &STARTS)
    }

    /// The same, beside that of the fit from these growths.
    fn better_discrepancy(&self, fit: &Fit, growths: &[f64]) -> (Discrepancy, f64) {
        // A dozen frequencies alone do not tell what a model misses from what it lacks.
        if !self.has_shapes() {
            return (fit.discrepancy, 0.0);
        }
        let near = Near::of_seen(self, fit);
        let expected = self.discrepancy.expected_scatter;
        let of_numbers = |numbers| Discrepancy::of_numbers(numbers, expected);
        // Steps come back to where others have been.
        let known = RefCell::new(HashMap::new());
        // Steps do not lead over what a number costs once it is in use: that is counted in the end.
        let evidence_of = |numbers: Numbers| {
            *known.borrow_mut().entry(numbers.map(f64::to_bits)).or_insert_with(|| {
                let sizes = of_numbers(numbers);
                Some(near.log_evidence(self, &sizes)? + sizes.cost())
            })
        };
        let less_cost = |(numbers, evidence): &(Numbers, f64)| evidence - of_numbers(*numbers).cost();
        let present = fit.discrepancy.numbers();
        let Some(before) = evidence_of(present) else {
            return (fit.discrepancy, 0.0);
        };
        let ranges = self.ranges();
        let mut start = (present, before);
        for growth in growths {
            let mut there = present;
            there[AT_GROWTH] = *growth;
            let Some(evidence) = evidence_of(there) else { continue };
            let found = climb((there, evidence), &COARSE, &SIZES, &ranges, &evidence_of);
            if found.1 > start.1 {
                start = found;
            }
            if of_numbers(found.0).growth == 0.0 && *growth > 0.0 {
                break;
            }
        }
        let none = Discrepancy::none_at(expected).numbers();
        let mut best = climb(start, &FINE, &ALL, &ranges, &evidence_of);
        // What is not worth its cost is left out, one after the other.
        loop {
            let in_use = of_numbers(best.0).in_use();
            let without = |&at: &usize| {
                let mut numbers = best.0;
                numbers[at] = none[at];
                let evidence = evidence_of(numbers).filter(|evidence| *evidence > best.1 - HOPELESS)?;
                let rest: Vec<usize> = in_use.iter().copied().filter(|other| *other != at).collect();
                Some(climb((numbers, evidence), &PRUNED, &rest, &ranges, &evidence_of))
            };
            let pruned = in_use.iter().filter_map(without).max_by(|a, b| less_cost(a).total_cmp(&less_cost(b)));
            match pruned {
                Some(pruned) if less_cost(&pruned) > less_cost(&best) => best = pruned,
                _ => break,
            }
        }
        (of_numbers(best.0), less_cost(&best) - less_cost(&(present, before)))
    }

    /// A fit that does not pass, with sizes of the discrepancy that are not 20 times less probable and with which it fits better; `None`
    /// where there are none. The test of fit is that of a hypothesis with unknown sizes, whose p-value is the highest over those that
    /// the data leave (Berger and Boos 1994, J. Am. Stat. Assoc. 89, 1012): the sizes of the highest evidence are one choice of many.
    pub(super) fn fitting_best(&self, fit: &Fit) -> Settled {
        if !self.has_shapes() {
            return None;
        }
        let least = fit.log_evidence() - STANDS_OUT;
        let expected = self.discrepancy.expected_scatter;
        let ranges = self.ranges();
        let mut best: Settled = None;
        for _ in 0..MOST_ROUNDS {
            let (problem, from) = here(&best, self, fit);
            let near = Near::of_seen(problem, from);
            let present = from.discrepancy.numbers();
            let Some(evidence) = near.log_evidence(problem, &from.discrepancy) else { break };
            let step = |(at, change): (usize, f64)| {
                let there = stepped(present, at, change, &ranges);
                let sizes = Discrepancy::of_numbers(there, expected);
                let is_left = near.log_evidence(problem, &sizes)? - evidence + from.log_evidence() > least;
                let other = problem.with_discrepancy(sizes);
                let refitted = (is_left && there != present).then(|| other.refitted(from).ok())??;
                (refitted.log_evidence() > least).then_some((other, refitted))
            };
            let steps: Vec<(usize, f64)> = ALL.into_iter().flat_map(|at| [(at, FINE[0]), (at, -FINE[0])]).collect();
            let p_value = |fit: &Fit| fit.goodness_of_fit().p_value;
            let found: Vec<(Problem, Fit)> = steps.into_par_iter().filter_map(step).collect();
            let found = found.into_iter().max_by(|a, b| p_value(&a.1).total_cmp(&p_value(&b.1)));
            match found.filter(|(_, found)| p_value(found) > p_value(from)) {
                Some(found) => best = Some(found),
                None => break,
            }
            if best.as_ref().is_some_and(|(_, fit)| fit.passes()) {
                break;
            }
        }
        best
    }

    /// How far each number may go.
    fn ranges(&self) -> [[f64; 2]; NUMBERS] {
        let scatter = if self.background.is_none() { [0.0; 2] } else { SCATTER.map(f64::ln) };
        let [frequency, shape, coupling, family] =
            [FREQUENCY, SHAPE, COUPLING, FAMILY].map(|range| [range.least.ln(), range.most.ln()]);
        let family = if self.families.ncols() == 0 { [family[0]; 2] } else { family };
        [frequency, shape, coupling, GROWTH, scatter, family, shape]
    }

    /// The same, if the study stated a tolerance this many times as large.
    pub(super) fn stated(&self, times: f64) -> Self {
        self.with_discrepancy(Discrepancy::none_at(times))
    }

    /// Where a search for the best fit with the best discrepancy starts. Without shapes there is none to be found.
    pub(super) fn discrepancies_to_start_from(&self) -> Vec<Discrepancy> {
        let expected = self.discrepancy.expected_scatter;
        let mut starts = vec![Discrepancy::none_at(expected)];
        if self.has_shapes() {
            starts.push(Discrepancy::usual_at(expected));
        }
        starts
    }

    fn has_shapes(&self) -> bool {
        self.measured.iter().any(|mode| mode.shape.is_some())
    }

    /// A fit again with the discrepancy that suits it best, and the problem with that; `None` where it has that already.
    pub(super) fn settled(&self, fit: &Fit) -> Settled {
        self.settled_from(fit, self.best_discrepancy(fit).0)
    }

    /// The same where the best discrepancy near the fit is known.
    pub(super) fn settled_from(&self, fit: &Fit, mut discrepancy: Discrepancy) -> Settled {
        let mut settled: Settled = None;
        for round in 1..=MOST_ROUNDS {
            let (problem, fit) = here(&settled, self, fit);
            if discrepancy.is_like(&fit.discrepancy) {
                break;
            }
            let next = problem.with_discrepancy(discrepancy);
            let Ok(refitted) = next.refitted(fit) else { break };
            if round < MOST_ROUNDS {
                // The fit has moved by little, and the best sizes with it.
                discrepancy = next.better_discrepancy(&refitted, &[]).0;
            }
            settled = Some((next, refitted));
        }
        settled
    }

    /// The same, where a model of the right kind can miss as much.
    pub(super) fn settled_plausibly(&self, fit: &Fit) -> Settled {
        self.settled(fit).filter(|(_, fit)| fit.discrepancy.is_plausible())
    }

    /// Logarithm of how much larger the determinants of a state's covariances are than without a discrepancy; `None` where one is not
    /// positive definite.
    pub(super) fn log_volume(&self, state: &State) -> Option<f64> {
        if self.discrepancy == Discrepancy::NONE {
            return Some(0.0);
        }
        let without = self.covariance_factors(&state.residual, &Discrepancy::NONE)?;
        let volume = |factors: &[Cholesky<f64, Dyn>]| factors.iter().map(log_determinant).sum::<f64>();
        Some(volume(&state.factors) - volume(&without))
    }

    /// A fit of a problem that differs by little (another discrepancy, a sensor or a mode less), again of this one, from where it was.
    pub(super) fn refitted(&self, fit: &Fit) -> Result<Fit, String> {
        self.fit_by(&[Loss::Robust], self.state_like(&fit.state, self.carried(fit))?, &fit.knobs)
    }

    /// The numbers with which segments are as those of a fit with another discrepancy have them: in units of how far they scatter.
    pub(super) fn carried(&self, fit: &Fit) -> DVector<f64> {
        let mut numbers = fit.state.numbers.clone();
        let mut scatter = numbers.rows_mut(0, self.background.scatter());
        scatter *= fit.discrepancy.scatter / self.discrepancy.scatter;
        let mut of_families = numbers.rows_mut(self.background.first_of_families(), self.families.ncols());
        of_families *= fit.discrepancy.family_in_units_of(&self.discrepancy);
        numbers
    }
}

/// Numbers of which one is another by a step, within its range.
fn stepped(mut numbers: Numbers, at: usize, change: f64, ranges: &[[f64; 2]; NUMBERS]) -> Numbers {
    numbers[at] = (numbers[at] + change).clamp(ranges[at][0], ranges[at][1]);
    numbers
}

/// Where steps in one number at a time lead that raise the evidence: numbers and their evidence flow in and out.
fn climb(
    from: (Numbers, f64),
    steps: &[f64],
    along: &[usize],
    ranges: &[[f64; 2]; NUMBERS],
    evidence_of: &dyn Fn(Numbers) -> Option<f64>,
) -> (Numbers, f64) {
    let (mut best, mut evidence) = from;
    for step in steps {
        let mut has_moved = true;
        while has_moved {
            has_moved = false;
            for &at in along {
                for change in [*step, -step] {
                    let there = stepped(best, at, change, ranges);
                    if there == best {
                        continue;
                    }
                    if let Some(found) = evidence_of(there).filter(|found| *found > evidence + 1e-3) {
                        (best, evidence, has_moved) = (there, found, true);
                        break;
                    }
                }
            }
        }
    }
    (best, evidence)
}

/// A problem with another discrepancy, and a fit of it; `None` where that of the given problem stands.
pub(super) type Settled = Option<(Problem, Fit)>;

/// What stands: problem and fit with another discrepancy, or else the given ones.
pub(super) fn here<'a>(settled: &'a Settled, problem: &'a Problem, fit: &'a Fit) -> (&'a Problem, &'a Fit) {
    settled.as_ref().map_or((problem, fit), |(problem, fit)| (problem, fit))
}

/// Of a matrix, from its Cholesky factor.
pub(super) fn log_determinant(factor: &Cholesky<f64, Dyn>) -> f64 {
    factor.l_dirty().diagonal().iter().map(|value| 2.0 * value.ln()).sum()
}
