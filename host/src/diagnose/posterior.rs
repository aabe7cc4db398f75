//! How probable it is that the model lacks nothing, one effect or another, or something else: numbers that sum to one.
//!
//! Prior odds, the evidence for each hypothesis and how well it fits flow in; probabilities flow out, and the most probable hypothesis is
//! the verdict. Something else than a hypothesis explains the data the better, the less the hypothesis fits them: at most by
//! `-1 / (e p ln p)` times (Sellke, Bayarri and Berger 2001, Am. Stat. 55, 62), for p the probability of as much misfit. So each hypothesis
//! shares its weight with something else by the p-value of its own fit: one with p = 0.01 leaves something else, if that is probable with
//! 5 % before, 30 % of it; one with p = 1e-4, 95 %. A hypothesis with next to no evidence says nothing, however well it fits, for it may
//! fit because it lets the model miss that much; and one that fits lends nothing to another that does not.

use serde::Serialize;

use super::found::Found;
use super::prior::PriorOdds;
use super::problem::Problem;

/// A hypothesis to be weighed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hypothesis {
    /// Its odds before.
    pub(super) prior_odds: f64,
    /// Natural logarithm of the evidence for it over that for the model as it is.
    pub(super) log_bayes_factor: f64,
    /// Probability of as much misfit as it leaves.
    pub(super) p_value: f64,
}

impl Hypothesis {
    /// Logarithm of its odds after, against a model of odds 1 without an effect.
    pub(super) fn log_weight(&self) -> f64 {
        self.prior_odds.ln() + self.log_bayes_factor
    }
}

/// What is not a candidate.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Probabilities {
    /// That the model lacks nothing.
    pub adequate: f64,
    /// That what it lacks is no single effect of the catalogue.
    pub something_else: f64,
}

impl PriorOdds {
    /// That the model lacks nothing.
    pub(super) fn of_adequate(&self, p_value: f64) -> Hypothesis {
        Hypothesis { prior_odds: self.adequate(), log_bayes_factor: 0.0, p_value }
    }

    /// Logarithm of the odds after of what was found, against a model of odds 1 without an effect, whether or not it helps.
    pub(super) fn log_odds_of(&self, found: &Found) -> f64 {
        self.kind(found.kind).ln() + found.log_bayes_factor
    }

    /// That it lacks what was found. What makes the model no better is not what it lacks, however well it fits beside a scatter that
    /// stands against it.
    pub(super) fn of_found(&self, found: &Found, p_value: f64) -> Hypothesis {
        let prior_odds = if found.helps { self.kind(found.kind) } else { 0.0 };
        Hypothesis { prior_odds, log_bayes_factor: found.log_bayes_factor, p_value }
    }
}

impl Problem {
    /// The most probable effect of those found, if it is more probable than that the model lacks nothing.
    pub(super) fn leading<'a>(&self, found: &'a [Found]) -> Option<&'a Found> {
        self.leading_position(found).map(|position| &found[position])
    }

    /// Where it stands among them.
    pub(super) fn leading_position(&self, found: &[Found]) -> Option<usize> {
        // How well they fit says nothing of their odds against each other.
        let log_weight = |at: &usize| self.prior_odds.of_found(&found[*at], 1.0).log_weight();
        let best = (0..found.len()).max_by(|a, b| log_weight(a).total_cmp(&log_weight(b)));
        best.filter(|best| log_weight(best) > self.prior_odds.of_adequate(1.0).log_weight())
    }
}

/// Probabilities of the hypotheses, and of something else; `else_odds` are its odds before, against all of them together.
pub(super) fn posterior(hypotheses: &[Hypothesis], else_odds: f64) -> (Vec<f64>, f64) {
    let greatest = hypotheses.iter().map(Hypothesis::log_weight).fold(f64::NEG_INFINITY, f64::max);
    if !greatest.is_finite() {
        return (vec![0.0; hypotheses.len()], 1.0);
    }
    let weights: Vec<f64> = hypotheses.iter().map(|one| (one.log_weight() - greatest).exp()).collect();
    let total: f64 = weights.iter().sum();
    let kept = |one: &Hypothesis| 1.0 / (1.0 + else_odds * log_against(one.p_value).exp());
    let probabilities: Vec<f64> =
        weights.iter().zip(hypotheses).map(|(weight, one)| weight / total * kept(one)).collect();
    let something_else = (1.0 - probabilities.iter().sum::<f64>()).max(0.0);
    (probabilities, something_else)
}

/// Logarithm of the highest Bayes factor against a hypothesis that a p-value allows; infinite where that is too small for a number.
fn log_against(p_value: f64) -> f64 {
    if p_value < f64::MIN_POSITIVE {
        return f64::INFINITY;
    }
    let log_p = p_value.ln();
    if log_p < -1.0 { -1.0 - log_p - (-log_p).ln() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hypothesis(prior_odds: f64, log_bayes_factor: f64, p_value: f64) -> Hypothesis {
        Hypothesis { prior_odds, log_bayes_factor, p_value }
    }

    #[test]
    fn probabilities_sum_to_one_and_follow_odds_and_evidence() {
        let all = [hypothesis(20.0, 0.0, 0.5), hypothesis(1.0, 20f64.ln(), 0.5), hypothesis(2.0, -50.0, 0.9)];
        let (found, other) = posterior(&all, 1.0 / 19.0);
        assert!((found.iter().sum::<f64>() + other - 1.0).abs() < 1e-12);
        // Evidence of 20 to 1 makes up for odds of 1 to 20.
        assert!((found[0] - found[1]).abs() < 1e-12 && (other - 0.05).abs() < 1e-9 && found[2] < 1e-20);
    }

    #[test]
    fn something_else_is_the_more_probable_the_less_the_best_fits() {
        let other = |p_value: f64| posterior(&[hypothesis(20.0, 0.0, p_value)], 1.0 / 19.0).1;
        // 1 / (e 0.01 ln 100) = 8.0; with odds of 1 to 19 before, 30 %.
        assert!((other(0.01) - 0.296).abs() < 0.005, "{}", other(0.01));
        assert!(other(1e-4) > 0.94 && other(0.0) > 0.999 && other(1.0) < 0.06);
        assert_eq!(posterior(&[], 0.1), (Vec::new(), 1.0));
    }

    /// An effect that fits leaves no room for something else, however badly the model without it fits.
    #[test]
    fn a_hypothesis_that_fits_bounds_something_else() {
        let all = [hypothesis(20.0, 0.0, 0.0), hypothesis(1.0, 120.0, 0.7), hypothesis(0.5, 100.0, 1e-9)];
        let (found, other) = posterior(&all, 1.0 / 19.0);
        assert!((other - 0.05).abs() < 1e-6 && (found[1] - 0.95).abs() < 1e-6, "{found:?} {other}");
        // One with next to no evidence does not, nor does one that fits and is far less probable.
        let all = [hypothesis(20.0, 0.0, 0.0), hypothesis(1.0, 24.0, 1e-51), hypothesis(1.0, -900.0, 1e-20)];
        assert!(posterior(&all, 1.0 / 19.0).1 > 0.99);
        let all = [hypothesis(20.0, 0.0, 0.0), hypothesis(1.0, 120.0, 1e-51), hypothesis(1.0, 60.0, 0.5)];
        assert!(posterior(&all, 1.0 / 19.0).1 > 0.99);
        // A model that fails is not adequate because an effect of little evidence passes.
        let all = [hypothesis(20.0, 0.0, 4e-4), hypothesis(1.0, 6.8f64.ln(), 0.013)];
        let (found, other) = posterior(&all, 1.0 / 19.0);
        assert!(other > found[0] + found[1] && found[1] > 0.15, "{found:?} {other}");
        // Where none fits, it is the most probable.
        let all = [hypothesis(20.0, 0.0, 0.0), hypothesis(1.0, 120.0, 1e-7)];
        assert!(posterior(&all, 1.0 / 19.0).1 > 0.99);
    }
}
