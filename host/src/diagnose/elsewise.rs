//! What the verdict would be, had the study stated another tolerance.
//!
//! How far segments scatter is fitted, about what the study states. So the verdict holds where that is somewhat wrong; where it is
//! not, the reader is told. The fits of the search flow in; a verdict for half and for double of the stated tolerance flows out.

use serde::Serialize;

use super::discrepancy::Discrepancy;
use super::fit::Fit;
use super::found::Found;
use super::posterior::{Hypothesis, posterior};
use super::problem::Problem;
use super::report::Verdict;
use super::search::CLEAR;
use crate::model::effect::find;

/// What the tolerance is multiplied with.
const TIMES: [f64; 2] = [0.5, 2.0];
/// Effects that could be named then.
const CONTEND: usize = 3;

/// A verdict that is another with another tolerance.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Elsewise {
    /// What the stated tolerance would be multiplied with.
    pub tolerance_times: f64,
    /// The verdict then.
    pub verdict: Verdict,
    /// The effect that would be named.
    pub best: Option<String>,
}

impl Elsewise {
    /// In words.
    pub(super) fn told(&self) -> String {
        let much = if self.tolerance_times < 1.0 { "half of" } else { "twice" };
        let verdict = match (&self.best, self.verdict) {
            (Some(best), _) => best.as_str(),
            (None, Verdict::Adequate) => "adequate",
            (None, _) => "unknown",
        };
        format!(
            "the verdict rests on the model's tolerance: with {much} the deviations that study.toml states it would be: {verdict}"
        )
    }
}

impl Problem {
    /// Where half or double of the stated tolerance leads to another verdict than `verdict`, with another effect named than `best`.
    pub(super) fn elsewise(
        &self,
        present: &Fit,
        found: &[Found],
        verdict: Verdict,
        best: Option<&str>,
    ) -> Vec<Elsewise> {
        if self.background.is_none() {
            return Vec::new();
        }
        let verdict = if verdict == Verdict::Ambiguous { Verdict::Effect } else { verdict };
        // Groups and hypotheses of the user's own are told by name.
        let kind = |name: &str| {
            let kind = name.split('@').next().unwrap_or(name);
            let is_of_the_study = find(kind).is_ok_and(|kind| kind.is_of_the_study());
            if is_of_the_study { name.to_owned() } else { kind.to_owned() }
        };
        let there = |times: f64| self.tally.piece(|| self.verdict_at(times, present, found));
        let differs = |other: &Elsewise| {
            other.verdict != verdict
                || (verdict == Verdict::Effect && other.best.as_deref().map(kind) != best.map(kind))
        };
        self.tally.stage("the verdict with other tolerances", TIMES.len());
        TIMES.into_iter().filter_map(there).filter(differs).collect()
    }

    /// The verdict with this many times the stated tolerance: evidence near the fits that were found, and a fit to test.
    fn verdict_at(&self, times: f64, present: &Fit, found: &[Found]) -> Option<Elsewise> {
        let problem = self.stated(times);
        // Evidence there, and the discrepancy that suits best.
        let there = |fit: &Fit| -> (Discrepancy, f64) {
            let (discrepancy, gain) = problem.best_discrepancy(fit);
            let start = Discrepancy { expected_scatter: times, ..fit.discrepancy };
            (discrepancy, fit.log_evidence() - fit.discrepancy.log_prior() + start.log_prior() + gain)
        };
        let (own, evidence) = there(present);
        let odds = &self.prior_odds;
        // How badly the best fits there bounds how probable something else is, so only the best is fitted there.
        let mut weighed: Vec<(Hypothesis, Option<&Found>, &Fit, Discrepancy)> =
            vec![(odds.of_adequate(0.0), None, present, own)];
        let helpful = || found.iter().filter(|found| found.helps);
        let most = helpful().next().map_or(0.0, |first| first.log_bayes_factor);
        let contend = helpful().take(CONTEND).filter(|found| found.log_bayes_factor > most - CLEAR);
        weighed.extend(contend.map(|found| {
            let (discrepancy, with) = there(found.own());
            let log_bayes_factor = with - evidence + found.log_share;
            let hypothesis = Hypothesis { log_bayes_factor, ..odds.of_found(found, 0.0) };
            (hypothesis, Some(found), found.own(), discrepancy)
        }));
        let log_weight = |at: &usize| weighed[*at].0.log_weight();
        let best = (0..weighed.len()).max_by(|a, b| log_weight(a).total_cmp(&log_weight(b)))?;
        let (_, leading, fit, discrepancy) = &weighed[best];
        let (leading, refitted) = (*leading, problem.with_discrepancy(*discrepancy).refitted(fit).ok()?);
        weighed[best].0.p_value = refitted.goodness_of_fit().p_value;
        let hypotheses: Vec<Hypothesis> = weighed.iter().map(|(hypothesis, ..)| *hypothesis).collect();
        let (each, something_else) = posterior(&hypotheses, odds.something_else());
        let (verdict, best) = match leading {
            _ if something_else > each[best] => (Verdict::Unknown, None),
            Some(found) => (Verdict::Effect, Some(found.effect().to_string())),
            None => (Verdict::Adequate, None),
        };
        Some(Elsewise { tolerance_times: times, verdict, best })
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::super::testing::{measured, scattered, study};
    use super::super::{Options, Signals, diagnose};
    use super::*;
    use crate::model::effect::Effect;

    /// What would be with another tolerance, of a tower with an effect.
    fn others(word: &str) -> (Verdict, Vec<Elsewise>) {
        let (structure, model, sensors) = study();
        let effects: Vec<Effect> = vec![word.parse().unwrap()];
        let truth = scattered(&structure, &model, 0.5, 41).and(&effects).unwrap();
        let modes = measured(&truth, &sensors, 13, &mut ChaCha8Rng::seed_from_u64(41));
        let problem = Problem::new(structure, &[], &model, &sensors, &modes).unwrap();
        let diagnosis = diagnose(&problem, &[], &Signals::default(), &Options::default()).unwrap();
        (diagnosis.verdict, diagnosis.elsewise)
    }

    /// A mass far beyond any tolerance is one at half and at double of it.
    #[test]
    fn a_strong_effect_rests_on_no_tolerance() {
        assert_eq!(others("added-mass@443.6m=4e6"), (Verdict::Effect, Vec::new()));
    }

    #[test]
    fn what_would_be_is_told_in_words() {
        let told = |tolerance_times: f64, verdict: Verdict, best: Option<&str>| {
            Elsewise { tolerance_times, verdict, best: best.map(str::to_owned) }.told()
        };
        assert!(
            told(0.5, Verdict::Effect, Some("p-delta"))
                .ends_with("with half of the deviations that study.toml states it would be: p-delta")
        );
        assert!(
            told(2.0, Verdict::Adequate, None)
                .ends_with("with twice the deviations that study.toml states it would be: adequate")
        );
    }
}
