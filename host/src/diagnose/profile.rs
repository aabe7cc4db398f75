//! What a fit has learned of the model's table: stiffness and mass of each segment, as factors on what the table says.
//!
//! A [`Fit`] flows in, whose background is a few independent numbers; factors with their standard deviations flow out, segment by
//! segment, beside the deviations before anything was measured. Effects are free there, so what an effect could do as well is not taken for
//! knowledge of a segment.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::background::Background;
use super::discrepancy::Discrepancy;
use super::fit::{Estimate, Fit};
use super::joint::Joint;
use super::problem::Problem;
use super::report::GoodnessOfFit;
use crate::model::effect::{Effect, PlaceKind, Where};
use crate::model::{Custom, Segment, Stiffness};
use crate::study::GroupTerms;

/// What was learned of a model's segments.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Profile {
    /// Names of the effects in the model, which were fitted together with the segments.
    pub effects: Vec<String>,
    /// Bending and shear along each axis, torsion and mass; only those that the study does not trust.
    pub quantities: Vec<QuantityProfile>,
    /// Groups of the model, as study.toml has them.
    pub groups: Vec<ProfileGroup>,
    /// What was learned of where masses are within a floor and along the height; null where the study trusts its table.
    pub masses: Option<Masses>,
    /// What was learned of how sections distort; null where the study trusts its table.
    pub sections: Option<Sections>,
    /// The values of the effects with their joint covariance; null where there are none.
    pub joint: Option<Joint>,
    /// How well the model fits.
    pub goodness_of_fit: GoodnessOfFit,
    /// What it misses besides; its `scatter` is how far segments scatter, in units of what the study states.
    pub discrepancy: Discrepancy,
}

/// A stiffness, or the mass, over the height.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct QuantityProfile {
    /// Which.
    pub quantity: Quantity,
    /// The unit of what the table says.
    pub unit: &'static str,
    /// Segment by segment, lowest first.
    pub segments: Vec<ProfileSegment>,
}

/// What varies over the height.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// Bending stiffness along the first principal direction.
    #[serde(rename = "bending_1")]
    Bending1,
    /// Bending stiffness along the second.
    #[serde(rename = "bending_2")]
    Bending2,
    /// Shear stiffness along the first principal direction.
    #[serde(rename = "shear_1")]
    Shear1,
    /// Shear stiffness along the second.
    #[serde(rename = "shear_2")]
    Shear2,
    /// Torsional stiffness.
    Torsion,
    /// Mass and moments of inertia, at the segment's top.
    Mass,
}

/// A segment's factor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ProfileSegment {
    /// Its lower end.
    pub z_bottom_m: f64,
    /// Its upper end.
    pub z_top_m: f64,
    /// What the table says; null where it is rigid in shear.
    pub given: Option<f64>,
    /// The factor on it.
    pub factor: f64,
    /// Its standard deviation.
    pub std: f64,
    /// The same before anything was measured: the model's tolerance.
    pub prior_std: f64,
}

/// A group's factor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProfileGroup {
    /// Its name in study.toml.
    pub name: String,
    /// From which height to which it stands; null where study.toml does not say.
    pub span_m: Option<[f64; 2]>,
    /// The factor on its own part of the model, its effects included.
    pub factor: f64,
    /// Its standard deviation.
    pub std: f64,
    /// The same before anything was measured: what study.toml trusts it to, times how far parts scatter.
    pub prior_std: f64,
}

/// How far sections distort in their own plane, which a beam's do not: see [`crate::model::Distortion`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sections {
    /// Poisson's ratio with which they narrow where the structure bends.
    pub narrowing: Estimate,
}

/// Where masses are that a table lumps on the axis of its nodes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Masses {
    /// The share of each node's mass that is spread over the segments next to it.
    pub spread: Estimate,
    /// How far centres of mass are off the axis.
    pub offset: [Estimate; 2],
}

impl Quantity {
    fn of(stiffness: Option<Stiffness>) -> Self {
        match stiffness {
            Some(Stiffness::Bending1) => Self::Bending1,
            Some(Stiffness::Bending2) => Self::Bending2,
            Some(Stiffness::Shear1) => Self::Shear1,
            Some(Stiffness::Shear2) => Self::Shear2,
            Some(Stiffness::Torsion) => Self::Torsion,
            None => Self::Mass,
        }
    }

    /// As JSON and tables have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Bending1 => "bending_1",
            Self::Bending2 => "bending_2",
            Self::Shear1 => "shear_1",
            Self::Shear2 => "shear_2",
            Self::Torsion => "torsion",
            Self::Mass => "mass",
        }
    }

    fn unit(self) -> &'static str {
        match self {
            Self::Bending1 | Self::Bending2 | Self::Torsion => "N m²",
            Self::Shear1 | Self::Shear2 => "N",
            Self::Mass => "kg",
        }
    }

    fn given(self, segment: &Segment) -> Option<f64> {
        match self {
            Self::Bending1 => Some(segment.bending_n_m2[0]),
            Self::Bending2 => Some(segment.bending_n_m2[1]),
            Self::Shear1 => segment.shear_n[0],
            Self::Shear2 => segment.shear_n[1],
            Self::Torsion => Some(segment.torsion_n_m2),
            Self::Mass => Some(segment.mass_top_kg),
        }
    }
}

impl QuantityProfile {
    /// Standard deviation of segments before the measurement, away from the foot: there it is larger, as nobody knows how a foot is held.
    pub fn prior_std(&self) -> f64 {
        self.segments.last().map_or(0.0, |top| top.prior_std)
    }
}

impl ProfileSegment {
    /// The share of the variance before that the measurement took away: 0 where it says nothing of the segment.
    pub fn learned(&self) -> f64 {
        if self.prior_std > 0.0 { 1.0 - (self.std / self.prior_std).powi(2) } else { 0.0 }
    }
}

impl Profile {
    /// Indices of groups, the highest first where heights are known, else in the order of study.toml.
    pub fn groups_from_the_top(&self) -> Vec<usize> {
        let lowest_m = |at: usize| self.groups[at].span_m.map_or(f64::NEG_INFINITY, |span_m| span_m[0]);
        let mut order: Vec<usize> = (0..self.groups.len()).collect();
        order.sort_by(|&a, &b| lowest_m(b).total_cmp(&lowest_m(a)));
        order
    }

    /// Of a fit of a problem; without quantities where the model has no segments or the study trusts them.
    pub(super) fn of(problem: &Problem, fit: &Fit) -> Self {
        let (numbers, first) = (&fit.state.numbers, fit.knobs.len());
        let count = problem.background.of_segments();
        let covariance = fit.covariance.view((first, first), (count, count)).into_owned();
        let segments = problem.bare.segments().unwrap_or_default();
        let nothing = DVector::zeros(numbers.len());
        type Part = (Option<Stiffness>, DVector<f64>, DMatrix<f64>);
        let of_part = |(now, before): (Part, Part)| {
            let (stiffness, changes, by_numbers) = now;
            let (factors, stds) = (changes.map(Background::factor), deviations(&by_numbers, &covariance));
            let quantity = Quantity::of(stiffness);
            let segment = |(index, segment): (usize, &Segment)| ProfileSegment {
                z_bottom_m: segment.z_bottom_m,
                z_top_m: segment.z_top_m,
                given: quantity.given(segment),
                factor: factors[index],
                std: stds[index],
                prior_std: before.2.row(index).norm(),
            };
            let segments = segments.iter().enumerate().map(segment).collect();
            QuantityProfile { quantity, unit: quantity.unit(), segments }
        };
        Self {
            effects: fit.effects().iter().map(Effect::to_string).collect(),
            quantities: problem
                .background
                .changes(numbers)
                .zip(problem.background.changes(&nothing))
                .map(of_part)
                .collect(),
            groups: groups(problem, fit),
            masses: masses(problem, fit),
            sections: sections(problem, fit),
            joint: fit.joint(),
            goodness_of_fit: fit.goodness_as_stated(problem).into(),
            discrepancy: fit.discrepancy,
        }
    }
}

/// Standard deviations of relative changes, from the covariance of the numbers that make them.
fn deviations(part: &DMatrix<f64>, covariance: &DMatrix<f64>) -> DVector<f64> {
    let spread = part * covariance;
    DVector::from_fn(part.nrows(), |row, _| spread.row(row).dot(&part.row(row)).max(0.0).sqrt())
}

/// A number of the background in its unit.
fn of_number(fit: &Fit, at: usize, one: f64, name: &str, unit: &str) -> Estimate {
    let variance = fit.covariance[(fit.knobs.len() + at, fit.knobs.len() + at)];
    Estimate {
        name: name.to_owned(),
        value: one * fit.state.numbers[at],
        std: Some(one * variance.max(0.0).sqrt()),
        unit: unit.to_owned(),
        typical_sizes: None,
    }
}

/// Groups as they are fitted: within what they are trusted to, and by the effect that one may have besides.
fn groups(problem: &Problem, fit: &Fit) -> Vec<ProfileGroup> {
    let background = &problem.background;
    let (changes, stds) = (background.changes_of_groups(&fit.state.numbers), background.groups());
    let first = fit.knobs.len() + background.first_of_groups();
    let group = |(at, (custom, terms)): (usize, (&Custom, GroupTerms))| {
        let mut along = DVector::zeros(fit.covariance.nrows());
        along[first + at] = stds[at];
        let is_of_it = |effect: &Effect| {
            effect.of_kind().place() == PlaceKind::Group
                && matches!(effect.place(), Some(Where::Name(name)) if *name == custom.name)
        };
        let mut change = changes[at];
        if let Some(index) = fit.effects().iter().position(is_of_it) {
            change += fit.effects()[index].parameters().next().map_or(0.0, |(_, value)| value);
            if let Some(knob) = fit.knobs.iter().position(|knob| knob.effect == index) {
                along[knob] = fit.knobs[knob].scale;
            }
        }
        ProfileGroup {
            name: custom.name.clone(),
            span_m: terms.span_m,
            factor: 1.0 + change,
            std: along.dot(&(&fit.covariance * &along)).max(0.0).sqrt(),
            prior_std: stds[at],
        }
    };
    problem.bare.groups().enumerate().map(group).collect()
}

fn sections(problem: &Problem, fit: &Fit) -> Option<Sections> {
    let at = problem.background.of_sections()?;
    Some(Sections { narrowing: of_number(fit, at, Background::distortion(1.0).narrowing, "narrowing", "-") })
}

fn masses(problem: &Problem, fit: &Fit) -> Option<Masses> {
    let units = problem.background.units_of_masses()?;
    let first = problem.background.of_segments();
    let estimate = |at: usize, name: &str, unit: &str| of_number(fit, first + at, units[at], name, unit);
    Some(Masses { spread: estimate(0, "spread", "-"), offset: [estimate(1, "x", "m"), estimate(2, "y", "m")] })
}
