//! What a search finds: an effect at its best place, refitted, with how sure it and its height are.
//!
//! The searches (`search`, `far`, `damper`, `height`) make and improve it; `verdict` and `steps` weigh it.

use super::criteria::STANDS_OUT;
use super::fit::Fit;
use super::relief::Left;
use crate::model::effect::{Effect, EffectKind, Where};

/// Places that are named beside the best.
pub(super) const NEAR: f64 = 3.0;

/// A kind's best place, refitted.
pub(super) struct Found {
    /// The effect's kind.
    pub(super) kind: &'static dyn EffectKind,
    /// The fit with it; it is the last effect there.
    pub(super) fit: Fit,
    /// The logarithm of the evidence over that of the present model, averaged over the places of the kind.
    pub(super) log_bayes_factor: f64,
    /// How many places and sets of parameters the evidence was averaged over, and the logarithm of what that left of the best's.
    pub(super) hypotheses: usize,
    pub(super) log_share: f64,
    /// Other places that explain nearly as much: the logarithm of their evidence below that of the best.
    pub(super) near: Vec<(Where, f64)>,
    /// How well its height is known, for effects that may be at any height.
    pub(super) height: Option<HeightSpread>,
    /// Heights that were fitted.
    pub(super) known: Vec<AtHeight>,
    /// The fit with the discrepancy that suits it best, where that is another.
    pub(super) own: Option<Fit>,
    /// What it leaves of the present model's differences, once the search has ended.
    pub(super) left: Option<Left>,
    /// Whether the model's errors fall with it, as far as is known.
    pub(super) helps: bool,
}

/// How well a height is known, and how that spreads to the values.
#[derive(Debug, Clone)]
pub(super) struct HeightSpread {
    /// Standard deviation of the height in m.
    pub(super) std_m: f64,
    /// Standard deviations of the parameters' values that follow from it.
    pub(super) values: Vec<f64>,
}

/// The result of a fit with the effect at one height.
#[derive(Debug, Clone)]
pub(super) struct AtHeight {
    pub(super) z_m: f64,
    pub(super) log_evidence: f64,
    /// Of the effect's parameters.
    pub(super) values: Vec<f64>,
}

impl AtHeight {
    /// Of a fit's last effect, which is at a height.
    pub(super) fn of(fit: &Fit) -> Option<Self> {
        let effect = fit.state.effects.last()?;
        match effect.place() {
            Some(Where::Height(z_m)) => Some(Self {
                z_m: *z_m,
                log_evidence: fit.log_evidence(),
                values: effect.parameters().map(|(_, value)| value).collect(),
            }),
            _ => None,
        }
    }
}

impl Found {
    /// The last effect of a fit, whose evidence is higher by `gain`, at the place that it has, where nothing is known of others.
    pub(super) fn alone(kind: &'static dyn EffectKind, fit: Fit, gain: f64, hypotheses: usize) -> Self {
        let log_share = -(hypotheses as f64).ln();
        Self {
            kind,
            fit,
            log_bayes_factor: gain + log_share,
            hypotheses,
            log_share,
            near: Vec::new(),
            height: None,
            known: Vec::new(),
            own: None,
            left: None,
            helps: true,
        }
    }

    /// The effect found.
    pub(super) fn effect(&self) -> &Effect {
        &self.fit.state.effects[self.index()]
    }

    /// What it is at its best.
    pub(super) fn own(&self) -> &Fit {
        self.own.as_ref().unwrap_or(&self.fit)
    }

    /// Whether it explains enough to be named.
    pub(super) fn stands_out(&self) -> bool {
        self.log_bayes_factor > STANDS_OUT && self.fit.is_significant(self.index())
    }

    /// Its index among the effects of the fit.
    pub(super) fn index(&self) -> usize {
        self.fit.state.effects.len() - 1
    }
}
