//! What a change that a watch has found most probably is, by the study's model.
//!
//! The modes that are followed and an alarm flow in; a [`Cause`] flows out. The modes now are those before with their frequencies moved as
//! the alarm says, surroundings taken off. Of shapes nothing is claimed, since a watch follows frequencies alone. Errors of the sizes
//! are taken as independent from mode to mode.

use std::f64::consts::SQRT_2;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::case::Case;
use super::error::StoryError;
use crate::compare::exceeding;
use crate::diagnose::{ChangeDiagnosis, ChangeVerdict, Direction, Estimate, Options, diagnose_change};
use crate::modes::{MeasuredMode, MeasuredModes, read};
use crate::progress::UNHEARD;
use crate::study::Study;
use crate::watch::{Alarm, State};

/// What has most probably happened to the structure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cause {
    /// What is most probable.
    pub verdict: ChangeVerdict,
    /// Whether the effects have come or gone.
    pub direction: Direction,
    /// Names of those that explain the change alike, or of the one that does; empty where none does.
    pub named: Vec<String>,
    /// The most probable effects, the first first.
    pub effects: Vec<ProbableEffect>,
    /// Probability of something that is no single effect of the catalogue.
    pub something_else: f64,
}

/// An effect that may have come or gone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ProbableEffect {
    /// Its name, with its place.
    pub effect: String,
    /// How probable it is.
    pub probability: f64,
    /// Its values.
    pub parameters: Vec<Estimate>,
}

/// Effects that are told.
const TOLD: usize = 3;
/// An effect that is less probable is not.
const WORTH_TELLING: f64 = 0.01;

/// What the change of an alarm is, beside those of the alarms `before` it that were not withdrawn; `reference` is the file of the modes that are followed.
///
/// # Errors
/// Where the modes or the model cannot be read, or the model cannot be fitted.
pub(super) fn cause(study: &Study, reference: &Path, alarm: &Alarm, before: &[Alarm]) -> Result<Cause, StoryError> {
    let followed = read(reference, &study.sensors())?;
    let modes = followed.modes.iter().filter_map(|mode| moved(mode, alarm, before));
    let (before, now): (Vec<MeasuredMode>, Vec<MeasuredMode>) = modes.unzip();
    let squares: f64 = alarm.modes.iter().map(|shift| (shift.percent / shift.std_percent).powi(2)).sum();
    let p_value = exceeding(squares, alarm.modes.len() as f64);
    let case = Case::of(study.clone(), MeasuredModes { modes: before, ..followed })?;
    let setting = case.setting(&UNHEARD)?;
    let found = diagnose_change(&setting, &case.model.effects, &now, p_value, &Options::default());
    Ok(found.map(Cause::of)?)
}

/// A mode before and after an alarm's change; `None` where the alarm says nothing of it.
fn moved(mode: &MeasuredMode, alarm: &Alarm, before: &[Alarm]) -> Option<(MeasuredMode, MeasuredMode)> {
    let by = |alarm: &Alarm| alarm.modes.iter().find(|shift| shift.number == mode.number).copied();
    let shift = by(alarm)?;
    let lasting = before.iter().filter(|earlier| earlier.state != State::Withdrawn).filter_map(by);
    let before_hz = mode.frequency_hz * lasting.map(|shift| 1.0 + 0.01 * shift.percent).product::<f64>();
    let now_hz = before_hz * (1.0 + 0.01 * shift.percent);
    // The size of the change is known, not both frequencies: each has half of its variance.
    let std = 0.01 * shift.std_percent / SQRT_2;
    let at = |frequency_hz: f64| MeasuredMode {
        frequency_hz,
        frequency_std_hz: Some(std * frequency_hz),
        covariance_factor: None,
        ..mode.clone()
    };
    Some((at(before_hz), MeasuredMode { shape: None, damping_ratio: None, damping_ratio_std: None, ..at(now_hz) }))
}

impl Cause {
    fn of(diagnosis: ChangeDiagnosis) -> Self {
        let named = match diagnosis.verdict {
            ChangeVerdict::Ambiguous => diagnosis.ambiguous.into_iter().flatten().collect(),
            _ => diagnosis.best,
        };
        let effects = diagnosis.candidates.into_iter().filter_map(|candidate| {
            let probability = candidate.probability.filter(|probability| *probability >= WORTH_TELLING)?;
            Some(ProbableEffect { effect: candidate.name(), probability, parameters: candidate.parameters })
        });
        Self {
            verdict: diagnosis.verdict,
            direction: diagnosis.direction,
            named,
            effects: effects.take(TOLD).collect(),
            something_else: diagnosis.probabilities.something_else,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::watch::ModeShift;

    fn alarm(number: usize, percent: f64, state: State) -> Alarm {
        let modes = vec![ModeShift { number, percent, std_percent: 0.02 }];
        Alarm { raised_s: 0.0, first_day_s: 0.0, between_s: [0.0; 2], log_evidence: 10.0, state, modes }
    }

    /// Changes that last are part of what was before; those that were withdrawn never were.
    #[test]
    fn a_change_is_held_against_what_was_known_before_it() {
        let mode = MeasuredMode {
            number: 2,
            frequency_hz: 1.0,
            frequency_std_hz: Some(0.1),
            damping_ratio: Some(0.01),
            damping_ratio_std: None,
            stated: None,
            shape: None,
            covariance_factor: None,
        };
        let earlier = [alarm(2, -1.0, State::Lasting), alarm(2, 5.0, State::Withdrawn), alarm(1, 9.0, State::Lasting)];
        let (before, now) = moved(&mode, &alarm(2, -0.5, State::Open), &earlier).unwrap();
        assert!((before.frequency_hz - 0.99).abs() < 1e-12 && (now.frequency_hz - 0.99 * 0.995).abs() < 1e-12);
        let relative = |mode: &MeasuredMode| mode.frequency_std_hz.unwrap() / mode.frequency_hz;
        assert!((relative(&before).hypot(relative(&now)) - 2e-4).abs() < 1e-12);
        assert!(moved(&mode, &alarm(3, -0.5, State::Open), &[]).is_none());
    }
}
