//! Why there is no plan.

use thiserror::Error;

use crate::compare::ViewError;
use crate::diagnose::DiagnoseError;
use crate::model::effect::EffectError;
use crate::table::TableError;

/// Why there is no plan.
#[derive(Debug, Error)]
pub enum PlanError {
    /// No sensors.
    #[error("the study has no sensors, and no places are given; add [[setup.sensor]], or give a table with --places")]
    NoSensors,
    /// No mode can be expected.
    #[error(
        "no mode of the model stands out from the noise between {:.4} and {:.4} Hz; look at band_hz in [analysis], at the places of the sensors, and at the noise",
        band_hz[0], band_hz[1]
    )]
    NoModes {
        /// The band.
        band_hz: [f64; 2],
    },
    /// The effect shows elsewhere than in modes.
    #[error(
        "{kind} does not show in how frequencies and shapes follow it; what can be planned for are the other kinds of `belfry effects`"
    )]
    NotInModes {
        /// The kind.
        kind: &'static str,
    },
    /// The effect has a value at which it is not there.
    #[error("{effect}: with this value it is not there; give one that is")]
    NoEffect {
        /// The effect.
        effect: String,
    },
    /// The model has the effect.
    #[error("{effect} is in the model already; plan for one that it lacks")]
    IsThere {
        /// The effect.
        effect: String,
    },
    /// The rival is the effect.
    #[error("{effect} is the effect itself; name another kind, or another place, with --against")]
    ItsOwnRival {
        /// The effect.
        effect: String,
    },
    /// The sensors do not see the model.
    #[error(transparent)]
    View(#[from] ViewError),
    /// The structure cannot have the effect.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// The model and the expected modes do not go together.
    #[error(transparent)]
    Diagnose(#[from] DiagnoseError),
    /// The table of places.
    #[error(transparent)]
    Places(#[from] TableError),
}
