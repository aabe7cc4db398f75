//! Why there is no diagnosis, and why a kind of effect is not found.
//!
//! What is wrong flows in from the fit and the search; sentences that say what to do flow out.

use thiserror::Error;

use crate::compare::ViewError;
use crate::model::effect::{Effect, EffectError};

/// Why there is no diagnosis.
#[derive(Debug, Error)]
pub enum DiagnoseError {
    /// The model cannot be seen by the sensors, or has no modes.
    #[error(transparent)]
    View(#[from] ViewError),
    /// An effect does not fit the structure.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// Nothing to compare.
    #[error(
        "no measured mode resembles any of the model's: check units, heights and azimuths (belfry compare shows both)"
    )]
    NoPairs,
    /// Too few modes for the effects.
    #[error(
        "{numbers} measured numbers cannot determine the {parameters} parameters of {effects}; remove effects, or measure more modes or shapes"
    )]
    TooFewModes {
        /// Numbers compared.
        numbers: usize,
        /// Parameters of the effects.
        parameters: usize,
        /// The effects.
        effects: String,
    },
    /// The same effect twice.
    #[error(
        "{effect} is in the model already, and a second one there is the same effect; give it another place, or take the first one out with `belfry remove`"
    )]
    Twice {
        /// The effect.
        effect: String,
    },
    /// Values of one effect that change the structure in the same way.
    #[error(
        "{effect}: from these data its values cannot be told apart; give it with fewer values, see `belfry effects {kind}`"
    )]
    SameValues {
        /// The effect.
        effect: String,
        /// Its kind.
        kind: &'static str,
    },
    /// Effects that change the structure in the same way.
    #[error(
        "{one} and {other} cannot both be fitted: from these data they are one and the same effect; remove one of them"
    )]
    SameEffect {
        /// An effect.
        one: String,
        /// The other.
        other: String,
    },
    /// The effect explains nothing with an admissible value.
    #[error("{effect} explains nothing here: {reason}; nothing was added")]
    NothingGained {
        /// The effect.
        effect: String,
        /// Why.
        reason: NoneFound,
    },
    /// The fit does not reach a structure that stands.
    #[error("with {effects} the structure is unstable: {reason}")]
    NoStructure {
        /// The effects.
        effects: String,
        /// Why.
        reason: String,
    },
}

impl DiagnoseError {
    /// That the structure with these effects is unstable.
    pub(super) fn no_structure(effects: &[Effect], reason: String) -> Self {
        Self::NoStructure { effects: in_words(effects), reason }
    }
}

/// Effects by name, "and" between them.
pub(super) fn in_words(effects: &[Effect]) -> String {
    effects.iter().map(Effect::to_string).collect::<Vec<_>>().join(" and ")
}

/// Why a kind of effect is not found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NoneFound {
    /// The data point to a value outside its bounds.
    OutOfBounds {
        /// Such a value, by one linear step.
        value: f64,
    },
    /// The structure has no place for it.
    NoPlace,
    /// The effects in the model do the same.
    LikeOthers,
    /// It moves nothing that was measured.
    Unseen,
}

impl std::fmt::Display for NoneFound {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::OutOfBounds { value } => write!(formatter, "the data point to a value of about {value:.3e}, which is outside its bounds"),
            Self::NoPlace => formatter.write_str("this structure has no place for it, or it is in the model already (`belfry effects` lists what it needs)"),
            Self::LikeOthers => formatter.write_str("these data cannot tell it from the effects that the model has already"),
            Self::Unseen => formatter.write_str("nothing that was measured hints at it; give a value to start from, as in `=VALUE`"),
        }
    }
}
