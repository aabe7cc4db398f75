//! What is likely before anything is measured: odds of each kind of effect against a sound model, and of something else.
//!
//! Kinds flow in; odds flow out. [`ADEQUATE`] and the odds of one for most kinds say that a model of twenty lacks any one kind, which is
//! the evidence of 20 to 1 that an effect must gain to stand out. They are an engineer's judgement, and `prior_odds` in study.toml changes
//! them.

use crate::model::effect::EffectKind;
use crate::study::NO_KINDS;

/// Odds of a model that lacks nothing.
pub(super) const ADEQUATE: f64 = 20.0;
/// Probability that something else is missing, which is no single effect of the catalogue: structures have surprises of their own.
pub(super) const SOMETHING_ELSE: f64 = 0.05;
/// Kinds that are more or less likely than most: foundations are clamped in most models; a standard's modulus and estimated loads are
/// off as a rule; the weight above is left out by every linear model; few towers have arms to outer columns, guys, soil along their shaft or dampers that their drawings do not show; and bracing that shears as it bends, or frames
/// beside a wall, are what a kind of structure has: whoever made its table knows, and most others have neither.
const LIKELY: [(&str, f64); 11] = [
    ("base-rotation", 2.0),
    ("stiffness-scale", 2.0),
    ("mass-scale", 2.0),
    ("p-delta", 2.0),
    ("outrigger", 0.5),
    ("lateral-support", 0.5),
    ("soil-springs", 0.5),
    ("tuned-mass-damper", 0.5),
    ("foundation-mass", 0.5),
    ("coupled-shear", 0.2),
    ("wall-frame", 0.2),
];

/// Odds by name: those of a study, or else the usual ones.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct PriorOdds {
    given: Vec<(String, f64)>,
}

impl PriorOdds {
    /// As a study gives them, of some kinds or none.
    pub(super) fn of(given: &[(String, f64)]) -> Self {
        Self { given: given.to_vec() }
    }

    fn given(&self, name: &str) -> Option<f64> {
        self.given.iter().find(|(other, _)| other == name).map(|(_, odds)| *odds)
    }

    /// Of a kind of effect.
    pub(super) fn kind(&self, kind: &dyn EffectKind) -> f64 {
        let usual = || LIKELY.iter().find(|(name, _)| *name == kind.name()).map_or(1.0, |(_, odds)| *odds);
        self.given(kind.name()).unwrap_or_else(usual)
    }

    /// Of a model that lacks nothing.
    pub(super) fn adequate(&self) -> f64 {
        self.given(NO_KINDS[0]).unwrap_or(ADEQUATE)
    }

    /// Of something else, against all the rest together.
    pub(super) fn something_else(&self) -> f64 {
        let probability = self.given(NO_KINDS[1]).unwrap_or(SOMETHING_ELSE).clamp(0.0, 0.99);
        probability / (1.0 - probability)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effect::find;

    /// Evidence of 20 to 1 is what an effect must gain to stand out; most kinds are as probable as none then.
    #[test]
    fn odds_are_those_of_the_study_or_else_the_usual_ones() {
        let [rotation, added] = ["base-rotation", "added-mass"].map(|name| find(name).unwrap());
        let usual = PriorOdds::default();
        assert_eq!((usual.kind(rotation), usual.kind(added), usual.adequate()), (2.0, 1.0, super::ADEQUATE));
        assert!((super::super::criteria::STANDS_OUT.exp() - usual.adequate()).abs() < 1e-9);
        assert!((usual.something_else() - 1.0 / 19.0).abs() < 1e-12);
        let given = PriorOdds::of(&[("base-rotation".to_owned(), 10.0), ("something-else".to_owned(), 0.5)]);
        assert_eq!((given.kind(rotation), given.kind(added), given.something_else()), (10.0, 1.0, 1.0));
        assert!(LIKELY.iter().all(|(name, _)| find(name).is_ok()));
    }
}
