//! One set of sensors: what it will show of an effect in records of any length.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::Site;
use super::error::PlanError;
use super::law::{Conditions, expected_modes};
use super::report::RecordOutlook;
use crate::compare::ModelView;
use crate::diagnose::steps::Setting;
use crate::diagnose::{Discrepancy, Draw, Outlook, Rival, STANDS_OUT, Weighed};
use crate::model::Assembly;
use crate::model::effect::Effect;
use crate::modes::{MeasuredMode, normals};
use crate::progress::UNHEARD;
use crate::statistics::median;
use crate::study::Sensor;

/// What does not depend on sensors and records.
#[derive(Debug, Clone, Copy)]
pub(super) struct Subject<'a> {
    /// The model; its sensors are those that stand already.
    pub(super) site: Site<'a>,
    /// The effect that it lacks.
    pub(super) truth: &'a Effect,
    /// What the measurement is like.
    pub(super) conditions: &'a Conditions,
    /// Of the draws.
    pub(super) seed: u64,
}

/// Measurements that are drawn: a probability of 95 % is then known to 1.5 %.
pub(super) const DRAWS: usize = 200;
/// Measurements from which the sizes of discrepancies are taken that a diagnosis may consider.
const MEASURED_DRAWS: u64 = 6;
/// They are considered at these shares.
const SHARES: [f64; 2] = [1.0, 0.5];
/// With fewer averages than these deviations are no longer small.
const LEAST_AVERAGES: f64 = 4.0;
/// Streams of random numbers for each draw: scatter, then the modes.
const STREAMS_A_DRAW: u64 = 1 << 16;

/// A set of sensors, and the structure with the effect.
pub(super) struct Sight<'a> {
    subject: Subject<'a>,
    pub(super) sensors: Vec<Sensor>,
    assembly: Assembly,
    view: ModelView,
}

impl<'a> Sight<'a> {
    /// # Errors
    /// [`PlanError`] where sensors have no place, or the structure cannot have the effect.
    pub(super) fn new(subject: Subject<'a>, sensors: Vec<Sensor>) -> Result<Self, PlanError> {
        let effects: Vec<Effect> = subject.site.effects.iter().chain([subject.truth]).cloned().collect();
        let assembly = subject.site.bare.clone().and(&effects)?.assemble();
        let view = ModelView::of(&assembly, &sensors)?;
        Ok(Self { subject, sensors, assembly, view })
    }

    /// The modes that a record is expected to show.
    ///
    /// # Errors
    /// [`PlanError::NoModes`].
    pub(super) fn modes(&self, hours: f64) -> Result<Vec<MeasuredMode>, PlanError> {
        let modes = expected_modes(&self.assembly, &self.view, self.subject.conditions, hours);
        if modes.is_empty() { Err(PlanError::NoModes { band_hz: self.subject.conditions.band_hz }) } else { Ok(modes) }
    }

    /// The shortest record for which the laws of deviations hold: so many averages of the lowest mode.
    ///
    /// # Errors
    /// As [`Sight::modes`].
    pub(super) fn least_hours(&self) -> Result<f64, PlanError> {
        let lowest_hz = self.modes(1.0)?.iter().map(|mode| mode.frequency_hz).fold(f64::INFINITY, f64::min);
        Ok(LEAST_AVERAGES / (2.0 * self.subject.conditions.damping_ratio * lowest_hz) / 3600.0)
    }

    pub(super) fn setting<'b>(&'b self, measured: &'b [MeasuredMode]) -> Setting<'b> {
        let Site { bare, model, .. } = self.subject.site;
        Setting { bare, model, sensors: &self.sensors, measured, tally: &UNHEARD }
    }

    fn draw(&self, modes: &[MeasuredMode], scatter_numbers: usize, index: u64) -> Draw {
        let random = |stream: u64| {
            let mut random = ChaCha8Rng::seed_from_u64(self.subject.seed);
            random.set_stream(STREAMS_A_DRAW * index + stream);
            random
        };
        Draw {
            scatter: normals(scatter_numbers, &mut random(0)),
            modes: (1..).zip(modes).map(|(stream, mode)| mode.drawn_errors(&mut random(stream))).collect(),
        }
    }

    /// Modes as they might be measured: of the structure with the effect and with scattered segments, with errors.
    pub(super) fn measured(&self, outlook: &Outlook, hours: f64, index: u64) -> Option<Vec<MeasuredMode>> {
        let draw = self.draw(&[], outlook.scatter_numbers(), index);
        let assembly = outlook.scattered(&draw.scatter)?.assemble();
        let view = ModelView::of(&assembly, &self.sensors).ok()?;
        let modes = expected_modes(&assembly, &view, self.subject.conditions, hours);
        let errors = self.draw(&modes, 0, index).modes;
        Some(modes.into_iter().zip(&errors).map(|(mode, errors)| mode.with_errors(errors)).collect())
    }

    /// The outlook on a record.
    ///
    /// # Errors
    /// [`PlanError`] where no mode is expected, or none is like one of the model's.
    pub(super) fn outlook(&self, hours: f64, rivals: &[Rival]) -> Result<(Outlook, Vec<MeasuredMode>), PlanError> {
        let modes = self.modes(hours)?;
        let outlook = Outlook::new(self.setting(&modes), self.subject.site.effects, self.subject.truth, rivals)?;
        Ok((outlook, modes))
    }

    /// Discrepancies that a diagnosis of a record may take the model to have: those that suit the model as it is on a few drawn
    /// measurements, and shares of them.
    ///
    /// # Errors
    /// As [`Sight::outlook`].
    pub(super) fn discrepancies(&self, hours: f64) -> Result<Vec<Discrepancy>, PlanError> {
        let (outlook, _) = self.outlook(hours, &[])?;
        let mut found: Vec<Discrepancy> = Vec::new();
        for index in 0..MEASURED_DRAWS {
            let Some(measured) = self.measured(&outlook, hours, index) else { continue };
            let Some(whole) = outlook.discrepancy(self.setting(&measured)) else { continue };
            for discrepancy in SHARES.map(|share| whole.times(share)) {
                if !found.iter().any(|other| other.is_like(&discrepancy)) {
                    found.push(discrepancy);
                }
            }
        }
        Ok(found)
    }

    /// What the draws say of the effect, the first, and of its rivals, in a record of this length; `share` is how much of the effect
    /// there is.
    ///
    /// # Errors
    /// As [`Sight::outlook`].
    pub(super) fn weigh(
        &self,
        hours: f64,
        rivals: &[Rival],
        share: f64,
        discrepancies: &[Discrepancy],
    ) -> Result<Vec<Weighed>, PlanError> {
        let (outlook, modes) = self.outlook(hours, rivals)?;
        let draws: Vec<Draw> =
            (0..DRAWS as u64).map(|index| self.draw(&modes, outlook.scatter_numbers(), index)).collect();
        Ok(outlook.weigh(&draws, share, discrepancies))
    }
}

/// Hypotheses whose effects have this squared cosine are one for any measurement of these sensors.
pub(super) const IDENTICAL: f64 = 0.9999;

/// What the draws come to.
#[derive(Debug, Clone)]
pub(super) struct Judged {
    pub(super) record: RecordOutlook,
    /// The probability that it is found and counts: that it is larger than what the model's tolerance looks like, and errors fall with it.
    pub(super) probability_counted: f64,
    /// Expected logarithm of the evidence over the next best hypothesis, the model as it is included.
    pub(super) margin: f64,
    /// The strongest rival, and how alike it is.
    pub(super) strongest: Option<(Rival, f64)>,
}

impl Judged {
    /// Of what was weighed, the effect first; `twins` count as the effect itself.
    pub(super) fn of(hours: f64, weighed: &[Weighed], twins: &[Rival]) -> Option<Self> {
        let (own, rivals) = weighed.split_first()?;
        let rivals: Vec<&Weighed> = rivals.iter().filter(|other| !twins.contains(&other.rival)).collect();
        let draws = own.log_bayes_factors.len();
        let is_found = |draw: usize| own.log_bayes_factors[draw] > STANDS_OUT;
        let is_counted = |draw: usize| is_found(draw) && own.helps[draw];
        let over = |rival: &Weighed, draw: usize| own.log_bayes_factors[draw] - rival.log_bayes_factors[draw];
        let is_apart = |rival: &Weighed, draw: usize| {
            !rival.helps[draw] || over(rival, draw) >= STANDS_OUT && !rival.is_twin[draw]
        };
        let share =
            |is: &dyn Fn(usize) -> bool| (0..draws).filter(|&draw| is(draw)).count() as f64 / draws.max(1) as f64;
        // A hypothesis that cannot have the value that it needs has no evidence at all, so medians stand for what is expected.
        let middle = |values: &dyn Fn(usize) -> f64| {
            let mut values: Vec<f64> = (0..draws).map(|draw| values(draw).clamp(-MOST_LOG, MOST_LOG)).collect();
            median(&mut values).unwrap_or(0.0)
        };
        let strongest = rivals.iter().max_by(|a, b| {
            let confused = |rival: &Weighed| share(&|draw| !is_apart(rival, draw));
            let near = |rival: &Weighed| -middle(&|draw| over(rival, draw));
            confused(a).total_cmp(&confused(b)).then(near(a).total_cmp(&near(b)))
        });
        let margin =
            middle(&|draw| rivals.iter().map(|rival| over(rival, draw)).fold(own.log_bayes_factors[draw], f64::min));
        let record = RecordOutlook {
            hours,
            probability_found: share(&is_found),
            probability_named: share(&|draw| is_counted(draw) && rivals.iter().all(|rival| is_apart(rival, draw))),
            log_bayes_factor: middle(&|draw| own.log_bayes_factors[draw]),
            strongest_rival: strongest.map(|rival| rival.rival.to_string()),
            log_bayes_factor_over_rival: strongest.map(|rival| middle(&|draw| over(rival, draw))),
        };
        let probability_counted = share(&is_counted);
        Some(Self {
            record,
            probability_counted,
            margin,
            strongest: strongest.map(|rival| (rival.rival.clone(), rival.likeness)),
        })
    }
}

/// Logarithms of evidence beyond this are as good as certain.
const MOST_LOG: f64 = 1e4;

/// Rivals that are the effect for any measurement of these sensors.
pub(super) fn twins_of(weighed: &[Weighed]) -> Vec<Rival> {
    let others = weighed.iter().skip(1);
    others.filter(|other| other.likeness > IDENTICAL).map(|other| other.rival.clone()).collect()
}
