//! What to measure next, where a diagnosis could not tell effects apart: one more sensor, or a longer record.

use super::law::{Conditions, ORDINARY_DAMPING, ORDINARY_NOISE_PERCENT};
use super::places::sensor_at;
use super::{Plan, Request, SensorOption, Site, WANTED, plan};
use crate::diagnose::{Diagnosis, Estimate, PartialAnswer, PartialEffect, STANDS_OUT};
use crate::model::effect::{Effect, Where, named_in_study};
use crate::modes::MeasuredMode;
use crate::statistics::median;
use crate::study::{Direction, Sensor};

/// Heights at which one more sensor is tried, in both directions.
const HEIGHTS: usize = 3;
/// The band of a plan is that of the measured modes, and this share more at both ends.
const BEYOND: f64 = 0.05;
/// The best line of a plan for the effects that a diagnosis named together; `None` where it has nothing to say: twins, or a record
/// and sensors that should have told them apart. `record_hours` is how long the record was.
pub(crate) fn advice(
    site: &Site<'_>,
    measured: &[MeasuredMode],
    diagnosis: &Diagnosis,
    record_hours: Option<f64>,
) -> Option<String> {
    let names = diagnosis.ambiguous.first()?;
    let candidate = diagnosis.candidates.iter().find(|candidate| Some(&candidate.name()) == names.first())?;
    let effect = with_values(&candidate.name(), &candidate.parameters, site.sensors)?;
    best_line(site, measured, effect, names.get(1..)?, record_hours?)
}

/// The same for the least sure effect of a partial answer and what does nearly as well in its place, beside the other effects.
pub(crate) fn advice_beside(
    site: &Site<'_>,
    measured: &[MeasuredMode],
    partial: &PartialAnswer,
    record_hours: Option<f64>,
) -> Option<String> {
    let hours = record_hours?;
    let (least_sure, rival) = partial.least_sure()?;
    // What the evidence tells apart needs no other record.
    (rival.log_evidence_below < STANDS_OUT).then_some(())?;
    let fitted = |one: &PartialEffect| with_values(&one.name(), &one.parameters, site.sensors);
    let others = partial.effects.iter().filter(|other| *other != least_sure).map(fitted);
    let effects: Vec<Effect> = site.effects.iter().cloned().map(Some).chain(others).collect::<Option<_>>()?;
    let beside = Site { effects: &effects, ..*site };
    best_line(&beside, measured, fitted(least_sure)?, std::slice::from_ref(&rival.effect), hours)
}

/// The best line of a plan for an effect and those that it may be taken for.
fn best_line(
    site: &Site<'_>,
    measured: &[MeasuredMode],
    effect: Effect,
    rivals: &[String],
    hours: f64,
) -> Option<String> {
    let kinds = rivals.iter().map(|name| named_in_study(name, site.sensors).ok());
    let against = kinds.map(|rival| Some((rival?.0, None))).collect::<Option<Vec<_>>>()?;
    let lowest_hz = measured.iter().map(|mode| mode.frequency_hz).fold(f64::INFINITY, f64::min);
    let highest_hz = measured.iter().map(|mode| mode.frequency_hz).fold(0.0, f64::max);
    let mut damping: Vec<f64> = measured.iter().filter_map(|mode| mode.damping_ratio).collect();
    let request = Request {
        effect,
        against,
        without: Vec::new(),
        hours: vec![hours],
        places: possible_places(site),
        add: 1,
        conditions: Conditions {
            damping_ratio: median(&mut damping).unwrap_or(ORDINARY_DAMPING),
            noise_percent: ORDINARY_NOISE_PERCENT,
            band_hz: [lowest_hz * (1.0 - BEYOND), highest_hz * (1.0 + BEYOND)],
        },
        seed: 0,
    };
    sentence(&plan(site, &request, &mut |_, _| {}).ok()?, hours, rivals)
}

/// An effect that a diagnosis found, with its values.
fn with_values(name: &str, fitted: &[Estimate], sensors: &[Sensor]) -> Option<Effect> {
    let (kind, place) = named_in_study(name, sensors).ok()?;
    let values: Vec<f64> = fitted.iter().map(|parameter| parameter.value).collect();
    let is_it = |set: &&&'static [crate::model::effect::Parameter]| {
        set.len() == values.len() && set.iter().zip(fitted).all(|(a, b)| a.name == b.name)
    };
    let parameters = kind.parameter_sets().iter().find(is_it)?;
    Effect::with_parameters(kind, place, parameters, &values).ok()
}

/// Places over the height of the structure, in both directions.
fn possible_places(site: &Site<'_>) -> Vec<Sensor> {
    let Some([z_base_m, z_top_m]) = site.bare.z_range_m() else { return Vec::new() };
    let at = |step: usize| {
        let z_m = (z_base_m + (z_top_m - z_base_m) * step as f64 / HEIGHTS as f64).round().clamp(z_base_m, z_top_m);
        [("X", 0.0), ("Y", 90.0)].map(|(axis, azimuth_deg)| {
            let place = Where::Height(z_m);
            sensor_at(format!("{place} along {axis}"), z_m, Direction::AzimuthDeg(azimuth_deg), [0.0; 2])
        })
    };
    (1..=HEIGHTS).flat_map(at).collect()
}

fn sentence(plan: &Plan, hours: f64, rivals: &[String]) -> Option<String> {
    let that = |what: String, probability: f64| {
        let rivals = rivals.join(", ");
        let percent = 100.0 * probability;
        Some(format!("{what}; that would tell {} from {rivals} with a probability of {percent:.0} %", plan.effect))
    };
    let with = |hours: f64, option: &SensorOption| {
        format!("{hours:.1} h with one more sensor, at {}", option.added.join(", "))
    };
    let [first, more @ ..] = plan.options.as_slice() else { return None };
    let now = |option: &SensorOption| option.records.first().map_or(0.0, |record| record.probability_named);
    // The sensors at hand should have told them apart already: the plan's assumptions do not hold here.
    if now(first) >= WANTED {
        return None;
    }
    let longer = first.shortest_hours.filter(|&shortest| shortest > hours);
    match (longer, more.first()) {
        (_, Some(option)) if now(option) >= WANTED => that(with(hours, option), now(option)),
        (Some(longer), _) => that(format!("{longer:.1} h with the same sensors"), WANTED),
        (None, Some(option)) => that(with(option.shortest_hours?, option), WANTED),
        (None, None) => None,
    }
}
