//! What a diagnosis will say of an effect, before anything is measured.
//!
//! A structure, an effect that it lacks and the modes that are expected of it with that effect flow in. Draws of what chance adds
//! (the scatter of segments and the errors of modes) flow in too; for each, the logarithms of the Bayes factors of the effect and of
//! its rivals flow out. Covariances, derivatives, priors and the evidence of one linear step are those of `score` and
//! `discrepancy`; what is linear here and is not in a fit is how the differences follow effects and scatter.

use nalgebra::{Cholesky, DMatrix, DVector};
use rayon::prelude::*;

use super::candidates::{Candidate, Options};
use super::criteria::FAILS;
use super::discrepancy::{Discrepancy, log_determinant};
use super::error::DiagnoseError;
use super::fit::{Fit, are_like_the_table, log_one_sided};
use super::knob::Knob;
use super::misfit::Loss;
use super::problem::Problem;
use super::relief::{Left, is_called_for};
use super::score::{LinearStep, is_admissible, is_seen, shows_by_derivative};
use super::search::is_good_as_it_is;
use super::state::State;
use super::steps::Setting;
use super::verdict::TWINS;
use crate::compare::exceeding;
use crate::model::Structure;
use crate::model::effect::{Effect, EffectKind, KINDS, Where};
use crate::modes::DrawnErrors;

/// How far a diagnosis may find segments to scatter, by chance, in units of what the study states.
const SCATTERS: [f64; 3] = [0.67, 1.5, 2.0];

/// What chance adds to a measurement.
#[derive(Debug, Clone)]
pub(crate) struct Draw {
    /// The scatter of segments, as independent normal numbers.
    pub(crate) scatter: DVector<f64>,
    /// Errors of the expected modes, which are numbered from 1 in this order.
    pub(crate) modes: Vec<DrawnErrors>,
}

impl Draw {
    fn of_mode(&self, number: usize) -> Option<&DrawnErrors> {
        self.modes.get(number.checked_sub(1)?)
    }
}

/// What an effect may be taken for.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Rival {
    /// A kind, at whatever place.
    Kind(&'static dyn EffectKind),
    /// A kind at one place; `None` for one that acts nowhere in particular.
    At(&'static dyn EffectKind, Option<Where>),
}

impl Rival {
    /// Every kind of the catalogue that shows in modes, but for those left out.
    pub(crate) fn all(options: &Options) -> Vec<Self> {
        let is_rival = |kind: &&'static dyn EffectKind| shows_by_derivative(*kind) && !options.leaves_out(*kind);
        KINDS.iter().copied().filter(is_rival).map(Self::Kind).collect()
    }

    /// Its kind.
    pub(crate) fn kind(&self) -> &'static dyn EffectKind {
        match self {
            Self::Kind(kind) | Self::At(kind, _) => *kind,
        }
    }
}

impl std::fmt::Display for Rival {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::At(kind, Some(place)) => write!(formatter, "{}@{place}", kind.name()),
            Self::At(kind, None) | Self::Kind(kind) => formatter.write_str(kind.name()),
        }
    }
}

/// A diagnosis linearised at the modes that are expected.
pub(crate) struct Outlook {
    problem: Problem,
    effects: Vec<Effect>,
    truth: Effect,
    /// The model as it is; its covariances are unity, so that derivatives are those of the differences themselves.
    given: Fit,
    /// How the differences follow effects in the model and the scatter.
    slopes: DMatrix<f64>,
    /// The differences of the model as it is, without chance.
    expected: DVector<f64>,
    /// The effect at every place of its kind, then its rivals.
    groups: Vec<Group>,
}

/// A hypothesis at all its places.
struct Group {
    rival: Rival,
    members: Vec<Member>,
    /// How many places its evidence is averaged over.
    hypotheses: usize,
}

/// An effect at a place.
struct Member {
    knobs: Vec<Knob>,
    /// How the differences follow its values; no columns for one that is there or not.
    columns: DMatrix<f64>,
    /// What one that is there or not adds to the differences.
    shift: Option<DVector<f64>>,
    /// Variances of its values by what the table has wrong and looks like them.
    besides: DVector<f64>,
}

impl Member {
    /// What it does to the differences, a column for each of its values, or one where it is there or not.
    fn directions(&self) -> DMatrix<f64> {
        self.shift
            .as_ref()
            .map_or_else(|| self.columns.clone(), |shift| DMatrix::from_columns(std::slice::from_ref(shift)))
    }
}

/// What the draws say of a hypothesis.
#[derive(Debug, Clone)]
pub(crate) struct Weighed {
    /// What it is.
    pub(crate) rival: Rival,
    /// Natural logarithm of its evidence over that of the model as it is, draw by draw.
    pub(crate) log_bayes_factors: Vec<f64>,
    /// Squared cosine between what the effect does and what this hypothesis can do, both seen through what else is uncertain.
    pub(crate) likeness: f64,
    /// Whether a diagnosis would count it, draw by draw: where the model misses more than its study says, errors must fall with it, and it must be
    /// larger than what the table's own errors look like.
    pub(crate) helps: Vec<bool>,
    /// Whether it passes for the effect whatever the evidence, draw by draw: a twin that the test of fit does not refute.
    pub(crate) is_twin: Vec<bool>,
}

impl Outlook {
    /// Of the modes that are expected with `truth` (the setting's measured ones, without errors); `effects` are in the model.
    ///
    /// # Errors
    /// [`DiagnoseError`] where the model has no such modes, or cannot have the effects.
    pub(crate) fn new(
        setting: Setting<'_>,
        effects: &[Effect],
        truth: &Effect,
        rivals: &[Rival],
    ) -> Result<Self, DiagnoseError> {
        let problem = setting.problem(effects)?;
        let failed = |reason| DiagnoseError::no_structure(effects, reason);
        let mut given = problem.as_given(effects).map_err(failed)?;
        let unity = |size: usize| Cholesky::new(DMatrix::identity(size, size));
        given.state.factors = given.state.residual.blocks().filter_map(|(_, block)| unity(block.size())).collect();
        let expected = differences(&given.state);
        let slopes = problem.jacobian(&given.state, &given.knobs).map_err(failed)?;
        let slopes = slopes.rows(0, expected.len()).into_owned();
        let mut outlook = Self {
            problem,
            effects: effects.to_vec(),
            truth: truth.clone(),
            given,
            slopes,
            expected,
            groups: Vec::new(),
        };
        let own_kind = truth.of_kind();
        // Against itself at another place, the effect is at its own.
        let is_placed = rivals.iter().any(|rival| rival.kind() == own_kind);
        let place = truth.place().cloned();
        let own = if is_placed { Rival::At(own_kind, place) } else { Rival::Kind(own_kind) };
        let others = rivals.iter().filter(|rival| !matches!(rival, Rival::Kind(kind) if *kind == own_kind));
        let mut groups: Vec<Group> = std::iter::once(&own)
            .chain(others)
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|rival| outlook.group(rival))
            .collect();
        groups[0].members.insert(0, outlook.own_member());
        outlook.groups = groups;
        Ok(outlook)
    }

    /// How many numbers the scatter of segments has.
    pub(crate) fn scatter_numbers(&self) -> usize {
        self.problem.background.size()
    }

    /// The structure with the effect and with a scatter of its segments.
    pub(crate) fn scattered(&self, scatter: &DVector<f64>) -> Option<Structure> {
        let effects: Vec<Effect> = self.effects.iter().chain([&self.truth]).cloned().collect();
        self.problem.structure_with(&effects, scatter)
    }

    /// The discrepancy that the model as it is would be given, were these modes measured.
    pub(crate) fn discrepancy(&self, setting: Setting<'_>) -> Option<Discrepancy> {
        let problem = setting.problem(&self.effects).ok()?;
        let fit = problem.as_given(&self.effects).ok()?;
        let best = problem.best_discrepancy(&fit).0;
        // These modes have no scatter, those that will be measured have what the study states.
        Some(Discrepancy { scatter: best.scatter.max(1.0), ..best })
    }

    fn group(&self, rival: &Rival) -> Group {
        let (candidates, hypotheses) = match rival {
            Rival::Kind(kind) => {
                (self.problem.candidates(*kind, &self.given), self.problem.hypotheses(*kind, &self.given))
            }
            Rival::At(kind, place) => (self.problem.candidates_at(*kind, vec![place.clone()], &self.given), 1),
        };
        let mut guesses = Vec::new();
        let members: Vec<Member> =
            candidates.iter().filter_map(|candidate| self.member(candidate, &mut guesses)).collect();
        Group { rival: rival.clone(), hypotheses: hypotheses.max(members.len()).max(1), members }
    }

    fn member(&self, candidate: &Candidate, guesses: &mut Vec<f64>) -> Option<Member> {
        let size = self.expected.len();
        if candidate.parameters.iter().any(crate::model::effect::Parameter::is_fitted) {
            let (knobs, columns) = self.problem.columns_of(&self.given, candidate, None, guesses)?;
            let columns = columns.rows(0, size).into_owned();
            let effect = candidate.effect(&candidate.neutral())?;
            let besides = |(at, knob): (usize, &Knob)| {
                let shift = self.given.state.largest_shift(columns.column(at));
                self.problem.looks_like(&effect, knob, shift).powi(2)
            };
            let besides = DVector::from_iterator(knobs.len(), knobs.iter().enumerate().map(besides));
            return Some(Member { knobs, columns, shift: None, besides });
        }
        let state = &self.given.state;
        let effects = self.effects.iter().cloned().chain([candidate.effect(&[])?]).collect();
        let there = self.problem.state(effects, state.numbers.clone(), Some(state)).ok()?;
        let there = differences(&there);
        let shift = (there.len() == size).then(|| there - &self.expected)?;
        Some(Member {
            knobs: Vec::new(),
            columns: DMatrix::zeros(size, 0),
            shift: Some(shift),
            besides: DVector::zeros(0),
        })
    }

    /// The effect where it is: its derivatives turned so that its values lead to what it does in full (Broyden 1965, the least
    /// change of a matrix that does so).
    fn own_member(&self) -> Member {
        let place = vec![self.truth.place().cloned()];
        let candidates = self.problem.candidates_at(self.truth.of_kind(), place, &self.given);
        let shares = |candidate: &Candidate| {
            let values = candidate.parameters.iter().map(|parameter| {
                self.truth.parameters().find(|(own, _)| own.name == parameter.name).map(|(_, value)| value)
            });
            values.collect::<Vec<Option<f64>>>()
        };
        let member = candidates.iter().find_map(|candidate| {
            let values = shares(candidate);
            let mut member = self.member(candidate, &mut Vec::new())?;
            let units = member
                .knobs
                .iter()
                .map(|knob| values[knob.parameter].map_or(0.0, |value| (value - knob.neutral) / knob.scale));
            let units = DVector::from_iterator(member.knobs.len(), units);
            let square = units.norm_squared();
            (square > 0.0).then(|| {
                let missing = -&self.expected - &member.columns * &units;
                member.columns += missing * units.transpose() / square;
                member
            })
        });
        let there_or_not = || Member {
            knobs: Vec::new(),
            columns: DMatrix::zeros(self.expected.len(), 0),
            shift: Some(-&self.expected),
            besides: DVector::zeros(0),
        };
        member.unwrap_or_else(there_or_not)
    }

    /// What the draws add to the differences, a column each.
    fn chance(&self, draws: &[Draw]) -> DMatrix<f64> {
        let state = &self.given.state;
        let knobs = self.given.knobs.len();
        let mut chance = DMatrix::zeros(self.expected.len(), draws.len());
        for (mut column, draw) in chance.column_iter_mut().zip(draws) {
            column += self.slopes.columns(knobs, self.slopes.ncols() - knobs) * &draw.scatter;
            for (first, block) in state.residual.blocks() {
                let mode = &self.problem.measured[block.measured];
                let Some(errors) = draw.of_mode(mode.number) else { continue };
                column[first] -= errors.frequency_hz / mode.frequency_hz;
                if let (Some(shape), Some(measured)) = (&block.shape, &mode.shape) {
                    let along = shape.directions.tr_mul(&errors.shape) / measured.values.norm();
                    let mut rows = column.rows_mut(first + 1, along.len());
                    rows -= along;
                }
            }
            let mut row = state.modes.len();
            for phases in &self.problem.phases {
                let mode = &self.problem.measured[phases.mode];
                let length = mode.shape.as_ref().map_or(1.0, |shape| shape.values.norm());
                for (at, deviation) in phases.deviations.iter().enumerate() {
                    let error = draw.of_mode(mode.number).and_then(|errors| errors.imaginary.get(at));
                    column[row] -= error.map_or(0.0, |error| error / length / deviation);
                    row += 1;
                }
            }
        }
        chance
    }

    /// Weighs the effect, the first, and its rivals; `share` is how much of the effect there is. `discrepancies` are what the
    /// hypotheses may be taken to miss besides: nothing, first of all, with segments that scatter about as far as the study states.
    pub(crate) fn weigh(&self, draws: &[Draw], share: f64, discrepancies: &[Discrepancy]) -> Vec<Weighed> {
        let mut differences = self.chance(draws);
        for mut column in differences.column_iter_mut() {
            column += &self.expected * share;
        }
        let mut sizes = vec![Discrepancy::NONE];
        if !self.problem.background.is_none() {
            sizes.extend(SCATTERS.map(|scatter| Discrepancy { scatter, ..Discrepancy::NONE }));
        }
        sizes.extend_from_slice(discrepancies);
        let parts: Vec<Part<'_>> = sizes.iter().filter_map(|sizes| Part::of(self, sizes, &differences)).collect();
        let Some(plain) = parts.first() else { return Vec::new() };
        let at_best = |log_evidence: &dyn Fn(usize) -> f64| {
            (0..parts.len()).max_by(|&a, &b| log_evidence(a).total_cmp(&log_evidence(b))).unwrap_or(0)
        };
        let whole = plain.seen(&DMatrix::from_columns(&[-&self.expected]));
        let p_value = |squares: f64| exceeding(squares, self.expected.len() as f64);
        let weigh = |group: &Group| {
            let gained: Vec<Gained<'_>> = parts.par_iter().map(|part| part.gains(group)).collect();
            let moves = group.rival.kind().is_of_structure();
            let said = |draw: usize| {
                let log_evidence = |part: usize| parts[part].present[draw] + gained[part].each[draw].log_evidence;
                let (with, without) = (at_best(&log_evidence), at_best(&|part| parts[part].present[draw]));
                let log_bayes_factor = log_evidence(with) - parts[without].present[draw];
                let (part, gain) = (&parts[with], &gained[with].each[draw]);
                let [p_value, p_value_with] = [parts[without].squares[draw], gain.squares].map(p_value);
                let counts = |moved: &Moved<'_>| {
                    let falls = !part.sizes.misses_more()
                        || is_called_for(p_value >= FAILS, p_value_with >= FAILS, log_bayes_factor)
                        || part
                            .left_by(moved, draw, moves)
                            .is_none_or(|left| left.is_relief(is_good_as_it_is(p_value, log_bayes_factor)));
                    falls && !moved.is_like_the_table(draw, part.sizes.scatter)
                };
                (log_bayes_factor, gain.best.is_none_or(|best| counts(&gained[with].moved[best])))
            };
            let (likeness, left) = plain.likeness(group, &whole);
            let (log_bayes_factors, helps) = (0..draws.len()).map(said).unzip();
            Weighed {
                rival: group.rival.clone(),
                log_bayes_factors,
                helps,
                is_twin: left.iter().map(|&left| likeness > TWINS && p_value(left) >= FAILS).collect(),
                likeness,
            }
        };
        self.groups.par_iter().map(weigh).collect()
    }
}

/// Differences of a state's modes as they are, and of its phases in standard deviations.
fn differences(state: &State) -> DVector<f64> {
    let all = state.joined(state.residual.vector(), &state.phases, &state.damping);
    all.rows(0, state.modes.len() + state.phases.len()).into_owned()
}

/// Drawn differences seen with one discrepancy, through the scatter and the effects in the model.
struct Part<'a> {
    outlook: &'a Outlook,
    sizes: Discrepancy,
    factors: Vec<Cholesky<f64, nalgebra::Dyn>>,
    slopes: DMatrix<f64>,
    curvature: Cholesky<f64, nalgebra::Dyn>,
    /// The draws.
    draws: Seen,
    /// `yᵀ P y` of each draw: the squares of what is left and of the scatter that is needed for it.
    squares: Vec<f64>,
    /// By how much the robust loss differs from them.
    robust: Vec<f64>,
    /// Logarithm of the evidence for the model as it is, up to what all discrepancies have in common.
    present: Vec<f64>,
}

/// Differences, a column each, as the covariances weigh them.
struct Seen {
    whole: DMatrix<f64>,
    /// What is left of them when scatter and effects in the model have done what they can.
    left: DMatrix<f64>,
    /// Values of these effects, then of the scatter, with which they did it.
    bent: DMatrix<f64>,
}

/// What a hypothesis does with one discrepancy.
struct Gained<'a> {
    /// At every place.
    moved: Vec<Moved<'a>>,
    /// At its best one, draw by draw.
    each: Vec<Gain>,
}

/// What a hypothesis does in one draw, at its best place.
struct Gain {
    /// Which of the places; `None` where it cannot be at any.
    best: Option<usize>,
    /// By how much the logarithm of the evidence rises, averaged over places.
    log_evidence: f64,
    /// The squares of what is left and of the scatter that is needed for it.
    squares: f64,
}

impl Gain {
    /// Of what cannot be.
    const NONE: Self = Self { best: None, log_evidence: f64::NEG_INFINITY, squares: f64::INFINITY };
}

/// What an effect at a place can do about the draws.
struct Moved<'a> {
    member: &'a Member,
    /// The step that leads to its values; none of one that is there or not.
    step: Option<LinearStep>,
    seen: Seen,
    /// Its values for each draw, in units of their scales.
    units: Vec<DVector<f64>>,
    /// The gain in the logarithm of the evidence, by squares.
    gains: Vec<f64>,
}

impl Moved<'_> {
    /// Whether its values are no larger than what the table's own errors look like, where parts scatter so many times as far as stated.
    fn is_like_the_table(&self, draw: usize, scatter: f64) -> bool {
        let Some(step) = &self.step else { return false };
        let besides = &self.member.besides * scatter.max(1.0).powi(2);
        are_like_the_table(&self.units[draw], step.covariance() + DMatrix::from_diagonal(&besides))
    }
}

impl<'a> Part<'a> {
    fn of(outlook: &'a Outlook, sizes: &Discrepancy, differences: &DMatrix<f64>) -> Option<Self> {
        let state = &outlook.given.state;
        let knobs = outlook.given.knobs.len();
        let factors = outlook.problem.covariance_factors(&state.residual, sizes)?;
        let mut slopes = outlook.slopes.clone();
        // Numbers of the scatter are in units of how far segments scatter; where masses are has a scale of its own.
        let mut by_scatter = slopes.columns_mut(knobs, outlook.problem.background.scatter());
        by_scatter *= sizes.scatter;
        let first = knobs + outlook.problem.background.first_of_families();
        outlook.problem.set_families(&state.residual, sizes, first, &mut slopes);
        state.whiten_by(&factors, &mut slopes);
        let information = slopes.tr_mul(&slopes);
        let size = information.nrows();
        let mut curvature = information.clone();
        for index in 0..size {
            curvature[(index, index)] += if index < knobs { 1e-12 } else { 1.0 };
        }
        let volume: f64 = factors.iter().map(log_determinant).sum::<f64>()
            + log_determinant(&Cholesky::new(information + DMatrix::identity(size, size))?);
        let draws = Seen { whole: DMatrix::zeros(0, 0), left: DMatrix::zeros(0, 0), bent: DMatrix::zeros(0, 0) };
        let curvature = Cholesky::new(curvature)?;
        let (squares, robust, present) = (Vec::new(), Vec::new(), Vec::new());
        let mut part = Self { outlook, sizes: *sizes, factors, slopes, curvature, draws, squares, robust, present };
        part.draws = part.seen(differences);
        let columns = |at: usize| (part.draws.left.column(at).into_owned(), part.draws.bent.column(at).into_owned());
        let costs: Vec<[f64; 2]> =
            (0..differences.ncols()).map(columns).map(|(left, bent)| part.costs(left, &bent)).collect();
        part.squares = costs.iter().map(|[squares, _]| *squares).collect();
        part.robust = costs.iter().map(|[squares, robust]| robust - squares).collect();
        part.present = costs.iter().map(|[_, robust]| sizes.log_prior() - 0.5 * (robust + volume)).collect();
        Some(part)
    }

    fn seen(&self, columns: &DMatrix<f64>) -> Seen {
        let mut whole = columns.clone();
        self.outlook.given.state.whiten_by(&self.factors, &mut whole);
        let bent = -self.curvature.solve(&self.slopes.tr_mul(&whole));
        let left = &whole + &self.slopes * &bent;
        Seen { whole, left, bent }
    }

    /// What differences and the scatter that left them cost: by squares, and by the robust loss.
    fn costs(&self, left: DVector<f64>, bent: &DVector<f64>) -> [f64; 2] {
        let state = &self.outlook.given.state;
        let knobs = self.outlook.given.knobs.len();
        let scatter = bent.rows(knobs, bent.len() - knobs).norm_squared();
        let all = left.resize_vertically(state.size(), 0.0);
        [Loss::Squares, Loss::Robust].map(|loss| scatter + state.misfit_of(&all, &self.factors, loss))
    }

    /// By how much a hypothesis gains on the model as it is in each draw: the logarithm of its evidence, averaged over its places.
    /// What the robust loss takes from it is that at its best place.
    fn gains<'b>(&self, group: &'b Group) -> Gained<'b> {
        let moved: Vec<Moved<'b>> = group.members.iter().filter_map(|member| self.moved(member)).collect();
        let mean = |draw: usize| {
            let gain = |place: &usize| moved[*place].gains[draw];
            let place = (0..moved.len()).max_by(|a, b| gain(a).total_cmp(&gain(b)));
            let Some(place) = place.filter(|place| gain(place) > f64::NEG_INFINITY) else { return Gain::NONE };
            let (best, most) = (&moved[place], gain(&place));
            let sum: f64 = moved.iter().map(|moved| (moved.gains[draw] - most).exp()).sum();
            let left = self.draws.left.column(draw) + &best.seen.left * &best.units[draw];
            let bent = self.draws.bent.column(draw) + &best.seen.bent * &best.units[draw];
            let [squares, robust] = self.costs(left, &bent);
            let shared = (sum / group.hypotheses as f64).ln();
            let log_evidence = most + shared - 0.5 * (robust - squares - self.robust[draw]);
            Gain { best: Some(place), log_evidence, squares }
        };
        let each = (0..self.squares.len()).map(mean).collect();
        Gained { moved, each }
    }

    /// What an effect leaves of the differences without any scatter, as [`Problem::left_with`] says it of a fit.
    fn left_by(&self, moved: &Moved<'_>, draw: usize, moves: bool) -> Option<Left> {
        let state = &self.outlook.given.state;
        let without = self.draws.whole.column(draw).into_owned();
        let with = &without + &moved.seen.whole * &moved.units[draw];
        let weighed = |differences: DVector<f64>| {
            state.misfit_and_frequencies(&differences.resize_vertically(state.size(), 0.0), &self.factors)
        };
        Left::of(weighed(with), weighed(without), moves)
    }

    fn moved<'b>(&self, member: &'b Member) -> Option<Moved<'b>> {
        let seen = self.seen(&member.directions());
        let gradients = seen.whole.tr_mul(&self.draws.left);
        if member.shift.is_some() {
            let own = seen.whole.dot(&seen.left);
            let gains = gradients.iter().map(|along| -along - 0.5 * own).collect();
            let units = vec![DVector::from_element(1, 1.0); self.squares.len()];
            return Some(Moved { member, step: None, units, seen, gains });
        }
        let information = seen.whole.tr_mul(&seen.left);
        if !is_seen(&information, &seen.whole) {
            return None;
        }
        let step = LinearStep::of(information)?;
        let one_sided = log_one_sided(&member.knobs);
        let gain = |gradient: DVector<f64>| {
            let (units, gain) = step.against(&member.knobs, &gradient)?;
            // A value that it cannot have explains nothing.
            let gain = if is_admissible(&member.knobs, &units) { gain + one_sided } else { f64::NEG_INFINITY };
            Some((units, gain))
        };
        let all: Option<Vec<_>> = gradients.column_iter().map(|gradient| gain(gradient.into_owned())).collect();
        let (units, gains) = all?.into_iter().unzip();
        Some(Moved { member, step: Some(step), seen, units, gains })
    }

    /// The squared cosine between what the effect does and what the hypothesis can do at its likest place, and the squared
    /// differences that it leaves there in each draw.
    fn likeness(&self, group: &Group, effect: &Seen) -> (f64, Vec<f64>) {
        let square = effect.whole.dot(&effect.left);
        let of = |member: &Member| {
            let Seen { whole, left, .. } = self.seen(&member.directions());
            let information = Cholesky::new(whole.tr_mul(&left))?;
            let explained = |gradient: DVector<f64>| gradient.dot(&information.solve(&gradient));
            let likeness = explained(whole.tr_mul(&effect.left).column(0).into_owned()) / square;
            let gradients = whole.tr_mul(&self.draws.left);
            let left = gradients.column_iter().zip(&self.squares);
            let left = left.map(|(gradient, square)| square - explained(gradient.into_owned()));
            likeness.is_finite().then(|| (likeness, left.collect::<Vec<f64>>()))
        };
        let likest = group.members.iter().filter_map(of).max_by(|a, b| a.0.total_cmp(&b.0));
        likest.unwrap_or_else(|| (0.0, self.squares.clone()))
    }
}
