//! Before anything is measured: which sensors, and how long a record, will find an effect and tell it from its rivals.
//!
//! A model, its sensors, possible further places and an effect of a given size flow in; the probability that `belfry diagnose` names
//! the effect flows out, for each record and each set of sensors. `law` says which modes are expected and how sure they will be;
//! `sight` draws measurements of one set of sensors and has each diagnosed, linearised ([`crate::diagnose`]'s `outlook`, with its
//! covariances, derivatives and evidence); here the shortest record and the best places are sought, and `advice` asks the same for
//! what a diagnosis could not tell apart. `places` reads possible places, `report` is what is printed.

mod advice;
mod error;
pub(crate) mod law;
mod places;
mod report;
mod sight;
#[cfg(test)]
mod tests;

use rayon::prelude::*;

pub(crate) use advice::{advice, advice_beside};
pub use error::PlanError;
pub use law::{Conditions, ORDINARY_DAMPING, ORDINARY_NOISE_PERCENT};
pub use places::read_places;
pub use report::{Assumed, Obstacle, Plan, RecordOutlook, SensorOption};

use crate::diagnose::{Discrepancy, Estimate, Options, Rival};
use crate::model::Structure;
use crate::model::effect::{Effect, EffectKind, Evidence, Where};
use crate::study::{Model, Sensor};
use sight::{DRAWS, IDENTICAL, Judged, Sight, Subject, twins_of};

/// What is to be planned for.
#[derive(Debug, Clone)]
pub struct Request {
    /// The effect that the model lacks.
    pub effect: Effect,
    /// What it is to be told from; every kind of the catalogue where none is named.
    pub against: Vec<(&'static dyn EffectKind, Option<Where>)>,
    /// Kinds that are not considered.
    pub without: Vec<String>,
    /// Lengths of records.
    pub hours: Vec<f64>,
    /// Where a sensor could stand besides.
    pub places: Vec<Sensor>,
    /// How many of these are added, one after the other.
    pub add: usize,
    /// What the measurement is like.
    pub conditions: Conditions,
    /// Of what is drawn.
    pub seed: u64,
}

/// A model and the sensors on it.
#[derive(Debug, Clone, Copy)]
pub struct Site<'a> {
    /// The structure as first given.
    pub bare: &'a Structure,
    /// How far it is trusted.
    pub model: &'a Model,
    /// Effects in the model.
    pub effects: &'a [Effect],
    /// Sensors that stand already.
    pub sensors: &'a [Sensor],
}

/// The probability that a plan asks for.
pub const WANTED: f64 = 0.95;
/// The longest record that is considered: 30 days.
pub const LONGEST_HOURS: f64 = 720.0;
/// Lengths are found to this share.
const LENGTH_SHARE: f64 = 0.1;
/// Sizes that could be found are sought up to so many times the given one.
const MOST_TIMES: f64 = 64.0;
/// Rivals with which lengths, sizes and places are sought: those that were strongest among all.
const CONTENDERS: usize = 4;

/// What measurements will show. `on_option` hears how many sets of sensors are done, of how many.
///
/// # Errors
/// [`PlanError`] where the effect cannot be planned for, or sensors and model do not go together.
pub fn plan(site: &Site<'_>, request: &Request, on_option: &mut dyn FnMut(u64, u64)) -> Result<Plan, PlanError> {
    let rivals = check(site, request)?;
    let subject = Subject { site: *site, truth: &request.effect, conditions: &request.conditions, seed: request.seed };
    let mut hours = request.hours.clone();
    hours.sort_by(f64::total_cmp);
    hours.dedup();
    let longest = hours.last().copied().unwrap_or(LONGEST_HOURS);
    let mut left = request.places.clone();
    let mut added: Vec<String> = Vec::new();
    let mut sensors = site.sensors.to_vec();
    if sensors.is_empty() {
        if left.is_empty() {
            return Err(PlanError::NoSensors);
        }
        // Without sensors of its own, a study begins with all places.
        sensors.append(&mut left);
        added.extend(sensors.iter().map(|sensor| sensor.channel.clone()));
    }
    let sight = Sight::new(subject, sensors)?;
    let discrepancies = sight.discrepancies(longest)?;
    let least_hours = sight.least_hours()?;
    let search = Search { request, rivals, discrepancies, hours, least_hours };
    let frequencies_hz = sight.modes(longest)?.iter().map(|mode| mode.frequency_hz).collect();
    let (first, mut chosen) = search.option(&sight, added.clone())?;
    let twins = chosen.twins.iter().map(ToString::to_string).collect();
    let mut options = vec![first];
    let mut sensors = sight.sensors;
    let more = request.add.min(left.len());
    for _ in 0..more {
        on_option(options.len() as u64, 1 + more as u64);
        let Some(best) = search.best_place(subject, &sensors, &left, &chosen)? else { break };
        let place = left.remove(best);
        added.push(place.channel.clone());
        sensors.push(place);
        let (option, next) = search.option(&Sight::new(subject, sensors.clone())?, added.clone())?;
        options.push(option);
        chosen = next;
    }
    let Conditions { damping_ratio, noise_percent, band_hz } = request.conditions;
    Ok(Plan {
        effect: request.effect.to_string(),
        parameters: estimates(&request.effect, 1.0),
        rivals: search.rivals.iter().map(ToString::to_string).collect(),
        twins,
        assumed: Assumed {
            damping_ratio,
            noise_percent,
            band_hz,
            frequencies_hz,
            frequency_std_over_bound: law::OVER_BOUND,
            draws: DRAWS,
            seed: request.seed,
        },
        options,
        wanted_probability: WANTED,
        least_hours,
        longest_hours: LONGEST_HOURS,
        warnings: Vec::new(),
    })
}

/// The rivals of the effect, where it can be planned for.
fn check(site: &Site<'_>, request: &Request) -> Result<Vec<Rival>, PlanError> {
    let effect = &request.effect;
    let kind = effect.of_kind();
    if !matches!(kind.evidence(), Evidence::Modes | Evidence::Phases) {
        return Err(PlanError::NotInModes { kind: kind.name() });
    }
    if effect.parameters().len() > 0 && effect.parameters().all(|(parameter, value)| value == parameter.neutral) {
        return Err(PlanError::NoEffect { effect: effect.to_string() });
    }
    if site.effects.iter().any(|other| other.of_kind() == kind && other.place() == effect.place()) {
        return Err(PlanError::IsThere { effect: effect.to_string() });
    }
    if request.against.is_empty() {
        let all = Rival::all(&Options { without: request.without.clone() });
        return Ok(all.into_iter().filter(|rival| rival.kind() != kind).collect());
    }
    let rival = |&(other, ref place): &(&'static dyn EffectKind, Option<Where>)| {
        if !matches!(other.evidence(), Evidence::Modes | Evidence::Phases) {
            return Err(PlanError::NotInModes { kind: other.name() });
        }
        match place {
            Some(place) if other == kind && effect.place() == Some(place) => {
                Err(PlanError::ItsOwnRival { effect: effect.to_string() })
            }
            None if other == kind => Err(PlanError::ItsOwnRival { effect: effect.to_string() }),
            Some(place) => Ok(Rival::At(other, Some(place.clone()))),
            None => Ok(Rival::Kind(other)),
        }
    };
    request.against.iter().map(rival).collect()
}

/// The values of an effect of which there is a share; deviations are not known.
fn estimates(effect: &Effect, share: f64) -> Vec<Estimate> {
    effect
        .parameters()
        .map(|(parameter, value)| Estimate {
            name: parameter.name.to_owned(),
            value: parameter.neutral + share * (value - parameter.neutral),
            std: None,
            typical_sizes: None,
            unit: parameter.unit.to_owned(),
        })
        .collect()
}

/// What all options of a plan have in common.
struct Search<'a> {
    request: &'a Request,
    rivals: Vec<Rival>,
    discrepancies: Vec<Discrepancy>,
    /// Shortest first.
    hours: Vec<f64>,
    /// No shorter record is sought.
    least_hours: f64,
}

/// What an option has settled for the next.
struct Chosen {
    twins: Vec<Rival>,
    contenders: Vec<Rival>,
    /// The record that says most about what one more sensor would help.
    telling_hours: f64,
}

impl Search<'_> {
    /// What one set of sensors will show.
    fn option(&self, sight: &Sight<'_>, added: Vec<String>) -> Result<(SensorOption, Chosen), PlanError> {
        let weighed = self
            .hours
            .iter()
            .map(|&hours| sight.weigh(hours, &self.rivals, 1.0, &self.discrepancies))
            .collect::<Result<Vec<_>, _>>()?;
        // Where rivals are named, a twin among them is what the question is about.
        let is_catalogue = self.request.against.is_empty();
        let twins = weighed.last().filter(|_| is_catalogue).map_or_else(Vec::new, |weighed| twins_of(weighed));
        let judged: Vec<Judged> = self
            .hours
            .iter()
            .zip(&weighed)
            .filter_map(|(&hours, weighed)| Judged::of(hours, weighed, &twins))
            .collect();
        let mut contenders: Vec<(f64, Rival)> = Vec::new();
        for weighed in &weighed {
            let Some((own, rivals)) = weighed.split_first() else { continue };
            for rival in rivals.iter().filter(|rival| !twins.contains(&rival.rival)) {
                let over = own.log_bayes_factors.iter().zip(&rival.log_bayes_factors).map(|(own, other)| own - other);
                let least = over.fold(f64::INFINITY, f64::min);
                match contenders.iter_mut().find(|(_, known)| *known == rival.rival) {
                    Some(known) => known.0 = known.0.min(least),
                    None => contenders.push((least, rival.rival.clone())),
                }
            }
        }
        contenders.sort_by(|a, b| a.0.total_cmp(&b.0));
        let contenders: Vec<Rival> = contenders.into_iter().take(CONTENDERS).map(|(_, rival)| rival).collect();
        let doubt = |judged: &&Judged| (judged.record.probability_named - 0.5).abs();
        let telling = judged.iter().min_by(|a, b| doubt(a).total_cmp(&doubt(b)));
        let telling_hours = telling.map_or(LONGEST_HOURS, |judged| judged.record.hours);
        let chosen = Chosen { twins, contenders, telling_hours };
        let records: Vec<RecordOutlook> = judged.into_iter().map(|judged| judged.record).collect();
        let (shortest_hours, obstacle) = self.shortest(sight, &chosen, &records)?;
        Ok((SensorOption { added, sensors: sight.sensors.len(), records, shortest_hours, obstacle }, chosen))
    }

    fn judged(&self, sight: &Sight<'_>, chosen: &Chosen, hours: f64, share: f64) -> Result<Option<Judged>, PlanError> {
        let weighed = sight.weigh(hours, &chosen.contenders, share, &self.discrepancies)?;
        Ok(Judged::of(hours, &weighed, &chosen.twins))
    }

    /// The shortest record that reaches the wanted probability, or why none does.
    fn shortest(
        &self,
        sight: &Sight<'_>,
        chosen: &Chosen,
        records: &[RecordOutlook],
    ) -> Result<(Option<f64>, Option<Obstacle>), PlanError> {
        let reaches = |record: &RecordOutlook| record.probability_named >= WANTED;
        let mut enough = records.iter().find(|record| reaches(record)).map(|record| record.hours);
        let below = records.iter().take_while(|record| !reaches(record)).last().map(|record| record.hours);
        if enough.is_none() {
            let Some(longest) = self.judged(sight, chosen, LONGEST_HOURS, 1.0)? else { return Ok((None, None)) };
            if !reaches(&longest.record) {
                return Ok((None, Some(self.obstacle(sight, chosen, &longest)?)));
            }
            enough = Some(LONGEST_HOURS);
        }
        let mut high = enough.unwrap_or(LONGEST_HOURS);
        let mut low = match below {
            Some(below) => below,
            None => {
                let least = self.least_hours.min(high);
                match self.judged(sight, chosen, least, 1.0)? {
                    Some(judged) if reaches(&judged.record) => return Ok((Some(least), None)),
                    _ => least,
                }
            }
        };
        while high > low * (1.0 + LENGTH_SHARE) {
            let middle = (low * high).sqrt();
            match self.judged(sight, chosen, middle, 1.0)? {
                Some(judged) if reaches(&judged.record) => high = middle,
                _ => low = middle,
            }
        }
        Ok((Some(high), None))
    }

    /// Why the longest record does not reach the wanted probability.
    fn obstacle(&self, sight: &Sight<'_>, chosen: &Chosen, longest: &Judged) -> Result<Obstacle, PlanError> {
        if let Some((rival, likeness)) = &longest.strongest
            && *likeness > IDENTICAL
        {
            return Ok(Obstacle::Twins { rival: rival.to_string() });
        }
        let findable_share = self.findable_share(sight, chosen)?;
        let effect = &self.request.effect;
        let can_be = |share: f64| {
            effect.parameters().all(|(parameter, value)| {
                let value = parameter.neutral + share * (value - parameter.neutral);
                (parameter.least..=parameter.greatest).contains(&value)
            })
        };
        let findable_share = findable_share.filter(|&share| can_be(share));
        let findable = findable_share.filter(|_| effect.parameters().len() == 1);
        let findable = findable.and_then(|share| estimates(effect, share).into_iter().next());
        Ok(match &longest.strongest {
            Some((rival, _)) if longest.probability_counted >= WANTED => {
                Obstacle::Rival { rival: rival.to_string(), findable_share, findable }
            }
            _ => Obstacle::Tolerance { findable_share, findable },
        })
    }

    /// The size, in shares of the given one, from which on the longest record reaches the wanted probability.
    fn findable_share(&self, sight: &Sight<'_>, chosen: &Chosen) -> Result<Option<f64>, PlanError> {
        let reaches = |share: f64| -> Result<bool, PlanError> {
            let judged = self.judged(sight, chosen, LONGEST_HOURS, share)?;
            Ok(judged.is_some_and(|judged| judged.record.probability_named >= WANTED))
        };
        let (mut low, mut high) = (1.0, 2.0);
        while !reaches(high)? {
            (low, high) = (high, 2.0 * high);
            if high > MOST_TIMES {
                return Ok(None);
            }
        }
        while high > low * (1.0 + LENGTH_SHARE) {
            let middle = 0.5 * (low + high);
            if reaches(middle)? { high = middle } else { low = middle }
        }
        Ok(Some(high))
    }

    /// The place (index) where one more sensor helps most; `None` where none is left.
    fn best_place(
        &self,
        subject: Subject<'_>,
        sensors: &[Sensor],
        places: &[Sensor],
        chosen: &Chosen,
    ) -> Result<Option<usize>, PlanError> {
        let judge = |place: &Sensor| -> Result<Option<(f64, f64)>, PlanError> {
            let sensors = sensors.iter().chain([place]).cloned().collect();
            let judged = self.judged(&Sight::new(subject, sensors)?, chosen, chosen.telling_hours, 1.0)?;
            Ok(judged.map(|judged| (judged.record.probability_named, judged.margin)))
        };
        let judged = places.par_iter().map(judge).collect::<Result<Vec<_>, _>>()?;
        let better =
            |a: &(usize, (f64, f64)), b: &(usize, (f64, f64))| a.1.0.total_cmp(&b.1.0).then(a.1.1.total_cmp(&b.1.1));
        let known = judged.into_iter().enumerate().filter_map(|(index, judged)| Some((index, judged?)));
        Ok(known.max_by(better).map(|(index, _)| index))
    }
}
