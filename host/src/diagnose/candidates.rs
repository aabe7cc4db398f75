//! What could be missing, and where: every effect of the catalogue at every place of a structure and its sensors.

use super::fit::Fit;
use super::knob::Knob;
use super::problem::Problem;
use crate::model::Body;
use crate::model::effect::{Effect, EffectKind, Evidence, Parameter, PlaceKind, Where};

/// What a search leaves out.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Kinds that are not considered.
    pub without: Vec<String>,
}

impl Options {
    pub(super) fn leaves_out(&self, kind: &dyn EffectKind) -> bool {
        self.without.iter().any(|name| name == kind.name())
    }
}

/// An effect at a place, by one of its parameter sets.
#[derive(Debug, Clone)]
pub(super) struct Candidate {
    pub(super) kind: &'static dyn EffectKind,
    pub(super) place: Option<Where>,
    pub(super) parameters: &'static [Parameter],
    /// Values of parameters that are given, by their index.
    given: Vec<(usize, f64)>,
}

impl Problem {
    /// An effect of a kind at every place.
    pub(super) fn candidates(&self, kind: &'static dyn EffectKind, present: &Fit) -> Vec<Candidate> {
        self.candidates_at(kind, self.places(kind, present), present)
    }

    /// How many effects of a kind there could be, those included that need not be looked at closely.
    pub(super) fn hypotheses(&self, kind: &'static dyn EffectKind, present: &Fit) -> usize {
        let count = match kind.place() {
            PlaceKind::TwoChannels => self.sensors.len() * self.sensors.len().saturating_sub(1) / 2,
            _ if kind.evidence() == Evidence::TwinPeaks => self.heights_m().len(),
            _ => self.candidates(kind, present).len(),
        };
        count.max(1)
    }

    pub(super) fn candidates_at(
        &self,
        kind: &'static dyn EffectKind,
        places: Vec<Option<Where>>,
        present: &Fit,
    ) -> Vec<Candidate> {
        let has = |place: Option<&Where>| {
            present.state.effects.iter().any(|effect| effect.of_kind() == kind && effect.place() == place)
        };
        let sets: Vec<&'static [Parameter]> = kind.parameter_sets().to_vec();
        let plain: Vec<&'static [Parameter]> =
            sets.iter().copied().filter(|set| set.iter().all(Parameter::is_fitted)).collect();
        let mut candidates = Vec::new();
        for place in &places {
            if has(place.as_ref()) {
                continue;
            }
            let mut sizes = Vec::new();
            for &parameters in &plain {
                let candidate = Candidate { kind, place: place.clone(), parameters, given: Vec::new() };
                // A second set of as many parameters is for structures to which the first does not apply.
                if !sizes.contains(&parameters.len()) && candidate.fits(self) {
                    sizes.push(parameters.len());
                    candidates.push(candidate);
                }
            }
        }
        // Effects with a length: three neighbouring segments.
        if let (Some(parameters), Body::Beam(beam)) =
            (sets.iter().copied().find(|set| set.iter().any(|p| p.name == "length")), &self.bare.body)
        {
            let at = parameters.iter().position(|parameter| parameter.name == "length");
            for trio in beam.segments().windows(3) {
                let middle = |segment: &crate::model::Segment| 0.5 * (segment.z_bottom_m + segment.z_top_m);
                let (low_m, high_m) = (middle(&trio[0]), middle(&trio[2]));
                let z_m = rounded(0.5 * (low_m + high_m));
                let length_m = rounded(1.01 * (high_m - low_m));
                let place = Some(Where::Height(z_m));
                // At one place the user has the segments there in mind.
                if places.len() > 1 && !has(place.as_ref()) {
                    let given = at.map(|at| (at, length_m)).into_iter().collect();
                    candidates.push(Candidate { kind, place, parameters, given });
                }
            }
        }
        candidates
    }

    /// Where an effect of a kind can be.
    fn places(&self, kind: &'static dyn EffectKind, present: &Fit) -> Vec<Option<Where>> {
        let channels = || self.sensors.iter().map(|sensor| sensor.channel.clone());
        let mut nodes: Vec<u16> = self.sensors.iter().map(|sensor| sensor.node).filter(|&node| node > 0).collect();
        nodes.sort_unstable();
        nodes.dedup();
        let nodes = nodes.into_iter().map(|node| Some(Where::Node(node)));
        match kind.place() {
            PlaceKind::Nowhere => vec![None],
            PlaceKind::Height => {
                let [z_base_m, z_top_m] = self.bare.z_range_m().unwrap_or_default();
                let lowest_m = z_base_m + kind.looked_for_above() * (z_top_m - z_base_m);
                let heights = self.heights_m().into_iter().filter(|z_m| *z_m >= lowest_m);
                heights.map(|z_m| Some(Where::Height(z_m))).collect()
            }
            PlaceKind::Channel => channels().map(|channel| Some(Where::Channels(vec![channel]))).collect(),
            PlaceKind::TwoChannels => self.likely_swaps(present).into_iter().map(Some).collect(),
            // With one node only, its clock and its azimuth are those of all.
            PlaceKind::Node => nodes.collect(),
            PlaceKind::NodeOrAll => std::iter::once(None).chain(nodes).collect(),
            PlaceKind::Name | PlaceKind::Group => {
                let is_group = kind.place() == PlaceKind::Group;
                let named = self.bare.customs.iter().filter(|custom| custom.group.is_some() == is_group);
                named.map(|custom| Some(Where::Name(custom.name.clone()))).collect()
            }
            PlaceKind::Frequency => Vec::new(),
        }
    }

    /// Heights at which something can be: nodes and the middles between them, from above the base to the top.
    pub(super) fn heights_m(&self) -> Vec<f64> {
        let Some([z_base_m, _]) = self.bare.z_range_m() else { return Vec::new() };
        let nodes = match &self.bare.body {
            Body::Beam(beam) => beam.segments().iter().map(|segment| segment.z_top_m).collect(),
            Body::Matrices(_) => self.bare.assemble().node_elevations_m(),
        };
        let mut heights = Vec::new();
        let mut below = z_base_m;
        for node in nodes {
            heights.extend([rounded(0.5 * (below + node)), node]);
            below = node;
        }
        heights
    }

    /// Pairs of channels that would fit better exchanged, the likeliest first.
    fn likely_swaps(&self, present: &Fit) -> Vec<Where> {
        let state = &present.state;
        let mut gains: Vec<(f64, usize, usize)> = Vec::new();
        let shapes: Vec<_> = state
            .residual
            .blocks()
            .filter_map(|(_, block)| {
                let shape = block.shape.as_ref().filter(|shape| shape.models.len() == 1)?;
                let measured = self.measured[block.measured].shape.as_ref()?;
                let model = state.model.view.at_sensors.column(block.model) * shape.combination[0];
                Some((
                    model,
                    measured.sensors.clone(),
                    measured.values.normalize(),
                    crate::compare::shape_deviations(measured),
                ))
            })
            .collect();
        for a in 0..self.sensors.len() {
            for b in 0..a {
                let gain = shapes.iter().map(|(model, sensors, values, deviations)| {
                    let at = |sensor: usize| sensors.iter().position(|other| *other == sensor);
                    let (Some(at_a), Some(at_b)) = (at(a), at(b)) else { return 0.0 };
                    let square = |from: usize, at: usize| ((model[from] - values[at]) / deviations[at]).powi(2);
                    square(a, at_a) + square(b, at_b) - square(b, at_a) - square(a, at_b)
                });
                gains.push((gain.sum(), a, b));
            }
        }
        gains.sort_by(|a, b| b.0.total_cmp(&a.0));
        gains
            .into_iter()
            .take(SWAPS)
            .filter(|(gain, ..)| *gain > VISIBLE_SWAP)
            .map(|(_, a, b)| {
                let (low, high) = (a.min(b), a.max(b));
                Where::Channels(vec![self.sensors[low].channel.clone(), self.sensors[high].channel.clone()])
            })
            .collect()
    }
}

/// A swap that changes squared differences by less shows in nothing.
const VISIBLE_SWAP: f64 = 1.0;
/// Swaps that are looked at.
const SWAPS: usize = 5;

/// To a centimetre, as places are written.
fn rounded(z_m: f64) -> f64 {
    (100.0 * z_m).round() / 100.0
}

impl Candidate {
    /// The effect with these values.
    pub(super) fn effect(&self, values: &[f64]) -> Option<Effect> {
        let all: Vec<f64> = self
            .parameters
            .iter()
            .enumerate()
            .map(|(index, parameter)| self.given(index).or(values.get(index).copied()).unwrap_or(parameter.neutral))
            .collect();
        Effect::with_parameters(self.kind, self.place.clone(), self.parameters, &all).ok()
    }

    /// The value of a parameter that is given.
    fn given(&self, parameter: usize) -> Option<f64> {
        self.given.iter().find(|(at, _)| *at == parameter).map(|(_, value)| *value)
    }

    /// Whether the structure has a place for it.
    pub(super) fn fits(&self, problem: &Problem) -> bool {
        let effect = self.effect(&self.neutral());
        effect.is_some_and(|effect| problem.bare.clone().and(&[effect]).is_ok())
    }

    /// Values at which the effect is not there.
    pub(super) fn neutral(&self) -> Vec<f64> {
        self.parameters
            .iter()
            .enumerate()
            .map(|(index, parameter)| self.given(index).unwrap_or(parameter.neutral))
            .collect()
    }

    /// The values of the linear step, shortened to `longest` prior scales.
    pub(super) fn start(&self, knobs: &[Knob], linear: &[f64], longest: f64) -> Vec<f64> {
        let mut values = linear.to_vec();
        for knob in knobs {
            let units = ((linear[knob.parameter] - knob.neutral) / knob.scale).clamp(-longest, longest);
            values[knob.parameter] = (knob.neutral + units * knob.scale).clamp(knob.bounds[0], knob.bounds[1]);
        }
        values
    }

    /// The values of a neighbour, but for those that are given.
    pub(super) fn like(&self, values: &[f64]) -> Vec<f64> {
        values.iter().enumerate().map(|(index, value)| self.given(index).unwrap_or(*value)).collect()
    }

    pub(super) fn is_same(&self, other: &Self) -> bool {
        self.kind == other.kind
            && self.place == other.place
            && self.parameters == other.parameters
            && self.given == other.given
    }

    pub(super) fn z_m(&self) -> Option<f64> {
        match self.place {
            Some(Where::Height(z_m)) => Some(z_m),
            _ => None,
        }
    }

    /// Places from one height to another, both in the grid.
    fn places_between(&self, other: &Self, problem: &Problem) -> Option<usize> {
        let heights = problem.heights_m();
        let nearest = |z_m: f64| {
            (0..heights.len()).min_by(|&a, &b| (heights[a] - z_m).abs().total_cmp(&(heights[b] - z_m).abs()))
        };
        Some(nearest(self.z_m()?)?.abs_diff(nearest(other.z_m()?)?))
    }

    /// Whether two candidates of a kind are at neighbouring places, or at one.
    pub(super) fn is_beside(&self, other: &Self, problem: &Problem) -> bool {
        self.places_between(other, problem).is_some_and(|places| places <= 1)
    }

    /// Whether a fit at one would soon arrive at the other.
    pub(super) fn is_near(&self, other: &Self, problem: &Problem) -> bool {
        self.parameters == other.parameters && self.places_between(other, problem).is_some_and(|places| places <= 4)
    }
}
