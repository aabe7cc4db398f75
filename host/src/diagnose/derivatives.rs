//! How a state's differences follow the effects' values and the background.
//!
//! A [`State`] and a knob, or a structure one step away, flow in; derivatives of the whitened differences flow out.

use nalgebra::{DMatrix, DVector};

use super::background::Background;
use super::evaluation::SCATTER_OF_DAMPING;
use super::knob::{Knob, with_values};
use super::problem::Problem;
use super::state::{Modelled, State};
use crate::compare::Following;
use crate::model::{Change, ModeDerivative, Responses, SegmentChange, Stiffness, Structure, eccentricity_changes};

/// How the differences of modes, before they are weighed, follow what is not trusted.
pub(super) struct BySegments {
    /// Relative changes of each segment's quantities, in the order of [`Background::quantities`], each differences x segments.
    quantities: Vec<DMatrix<f64>>,
    /// Relative changes of groups, differences x groups.
    groups: DMatrix<f64>,
    /// How far masses are spread and off the axis, and how far sections narrow.
    others: Vec<DVector<f64>>,
}

impl BySegments {
    /// At a state.
    fn of(state: &State, problem: &Problem) -> Option<Self> {
        let Modelled { structure, assembly, view, .. } = state.model.as_ref();
        // Factors on segments multiply, so a step of one that has changed is so much larger.
        let changes = problem.background.changes_of_groups(&state.numbers);
        let larger = structure.groups().zip(changes).map(
            |((group, _), change)| {
                if group.changes_segments() { 1.0 + change } else { 1.0 }
            },
        );
        let by_groups: Vec<DVector<f64>> = structure
            .group_changes(assembly)
            .iter()
            .zip(larger)
            .map(|(change, larger)| state.along(change) / larger)
            .collect();
        let groups =
            if by_groups.is_empty() { DMatrix::zeros(state.modes.len(), 0) } else { DMatrix::from_columns(&by_groups) };
        if !problem.background.has_segments() {
            return Some(Self { quantities: Vec::new(), groups, others: Vec::new() });
        }
        let changes = structure.segment_changes();
        let by_quantity = |quantity: Option<Stiffness>| {
            let change = |change: &SegmentChange| match quantity {
                Some(stiffness) => state.along(&change.stiffness[stiffness as usize]),
                None => state.along(&change.mass),
            };
            DMatrix::from_columns(&changes.iter().map(change).collect::<Vec<_>>())
        };
        let quantities = problem.background.quantities().map(by_quantity).collect();
        let [along_x, along_y] = eccentricity_changes(assembly);
        let by_masses = [&structure.spread_change(), &along_x, &along_y].map(|change| state.along(change));
        let rows = assembly.distorted_rows(&problem.sensors, Background::distortion(1.0)).ok()?;
        let by_sections = state.residual.slope(&state.models, &view.derivatives_by_rows(&rows, &state.models));
        Some(Self { quantities, groups, others: by_masses.into_iter().chain([by_sections]).collect() })
    }
}

impl State {
    /// Derivatives of [`State::differences`] by the background's numbers.
    pub(super) fn by_background(&self, problem: &Problem) -> DMatrix<f64> {
        let (first, all) = (problem.background.first_of_families(), problem.background.size());
        let mut by_numbers = self.by_scatter(problem).unwrap_or_else(|| DMatrix::zeros(self.modes.len(), first));
        by_numbers.resize_horizontally_mut(all, 0.0);
        problem.set_families(&self.residual, &problem.discrepancy, first, &mut by_numbers);
        self.whiten_by(&self.factors, &mut by_numbers);
        // Scatter moves damping by next to nothing.
        by_numbers.resize_vertically(self.size(), 0.0)
    }

    fn responses(&self) -> &Responses {
        self.slopes.responses.get_or_init(|| self.model.view.responses(&self.models))
    }

    fn following(&self) -> Option<&Following> {
        let of = || Following::of(&self.model.view, &self.residual, self.responses(), &self.models);
        self.slopes.following.get_or_init(of).as_ref()
    }

    /// The derivative of the differences of modes before they are weighed by a change of the structure.
    fn along(&self, change: &Change) -> DVector<f64> {
        match self.following() {
            Some(following) => following.along(change),
            None => {
                let derivatives = self.model.view.derivatives(self.responses(), &self.models, change);
                self.residual.slope(&self.models, &derivatives)
            }
        }
    }

    /// Of the differences of modes before they are weighed, by the numbers of segments and masses; `None` where there are none.
    fn by_scatter(&self, problem: &Problem) -> Option<DMatrix<f64>> {
        if problem.background.is_none() {
            return None;
        }
        let by_segments = self.slopes.by_segments.get_or_init(|| BySegments::of(self, problem)).as_ref()?;
        Some(problem.background.chain(&by_segments.quantities, &by_segments.groups, &by_segments.others, &self.numbers))
    }

    /// The derivative of the differences by what takes the structure to `structure` in a step of the size `step`; those of modes
    /// before they are weighed.
    pub(super) fn towards(&self, problem: &Problem, structure: &Structure, step: f64) -> Option<DVector<f64>> {
        let Modelled { assembly, view, delays_s, .. } = self.model.as_ref();
        let there = structure.assemble();
        if there.dofs() != assembly.dofs() {
            return None;
        }
        let (rows, delays_there_s) =
            (there.sensor_rows(&problem.sensors).ok()?, there.sensing.delays_s(&problem.sensors));
        let change = assembly.change_to(&there, step);
        let mut modes = DVector::zeros(self.modes.len());
        let still = DVector::zeros(view.at_sensors.nrows());
        let still = ModeDerivative { ln_frequency: 0.0, shape: still, damping_ratio: 0.0 };
        let mut slopes = vec![still; self.models.len()];
        match (&change, self.following()) {
            (Some(change), Some(following)) => modes = following.along(change),
            (Some(change), None) => slopes = view.derivatives(self.responses(), &self.models, change),
            (None, _) => {}
        }
        let mut phases = DVector::zeros(self.phases.len());
        if rows != view.sensor_rows || delays_there_s != *delays_s {
            let seen = view.seen_by(rows, delays_there_s);
            for (slope, &model) in slopes.iter_mut().zip(&self.models) {
                slope.shape += (seen.at_sensors.column(model) - view.at_sensors.column(model)) / step;
            }
            phases = (problem.phase_differences(self, &seen) - &self.phases) / step;
        }
        modes += self.residual.slope(&self.models, &slopes);
        let damping = DVector::from_fn(self.damping.len(), |mode, _| {
            let pair = self.pairs.get(mode);
            let at = pair.and_then(|pair| Some((pair.model, self.models.binary_search(&pair.model).ok()?)));
            let known = problem.damping.get(mode).copied().flatten();
            at.filter(|_| known.is_some()).map_or(0.0, |(model, at)| {
                let predicted = problem.ordinary_damping + view.damping_ratio(model);
                slopes[at].damping_ratio / predicted / SCATTER_OF_DAMPING
            })
        });
        let all = self.joined(modes, &phases, &damping);
        all.iter().all(|value| value.is_finite()).then_some(all)
    }

    /// The derivative of [`State::differences`] by a knob.
    pub(super) fn by_knob(&self, problem: &Problem, knob: &Knob) -> Option<DVector<f64>> {
        let value = self.value(knob);
        // Inwards where the bound is near.
        let step = if value + knob.step <= knob.bounds[1] { knob.step } else { -knob.step };
        let effects = with_values(&self.effects, std::slice::from_ref(knob), &[value + step]);
        let along = self.towards(problem, &problem.structure_with(&effects, &self.numbers)?, step)? * knob.scale;
        Some(self.whiten(along))
    }

    /// Derivatives at this state from those at another one near by: what a step from there has shown of them is put right (Broyden 1965,
    /// "A Class of Methods for Solving Nonlinear Simultaneous Equations", eq. 4.5). `None` where the two compare other modes.
    pub(super) fn carry(&self, from: &State, knobs: &[Knob], jacobian: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let before = self.turned(from, DMatrix::from_columns(&[from.differences()]))?;
        let mut carried = self.turned(from, jacobian.clone())?;
        let of_knob = |knob: &Knob| (self.value(knob) - from.value(knob)) / knob.scale;
        let of_knobs = DVector::from_iterator(knobs.len(), knobs.iter().map(of_knob));
        let mut step = of_knobs.resize_vertically(jacobian.ncols(), 0.0);
        step.rows_mut(knobs.len(), self.numbers.len()).copy_from(&(&self.numbers - &from.numbers));
        let unforeseen = self.differences() - before.column(0) - &carried * &step;
        carried.ger(step.norm_squared().recip(), &unforeseen, &step, 1.0);
        carried.iter().all(|value| value.is_finite()).then_some(carried)
    }

    /// Differences (rows) of another state, in the directions and the standard deviations of this one; `None` where the two compare other
    /// modes.
    fn turned(&self, from: &State, mut differences: DMatrix<f64>) -> Option<DMatrix<f64>> {
        if self.size() != from.size() {
            return None;
        }
        for ((first, own, factor), (_, other, other_factor)) in self.blocks().zip(from.blocks()) {
            if (own.measured, own.size()) != (other.measured, other.size()) || own.models() != other.models() {
                return None;
            }
            // Directions of a single mode stay as they are.
            let (Some(shape), Some(other)) = (&own.shape, &other.shape) else { continue };
            if shape.models.len() > 1 {
                let turn = shape.directions.tr_mul(&other.directions);
                let mut part = other_factor.l() * differences.rows(first, own.size());
                let of_shape = turn * part.rows(1, own.size() - 1);
                part.rows_mut(1, own.size() - 1).copy_from(&of_shape);
                factor.l_dirty().solve_lower_triangular_mut(&mut part);
                differences.rows_mut(first, own.size()).copy_from(&part);
            }
        }
        Some(differences)
    }
}
