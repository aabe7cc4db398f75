//! Why there is no plan.

use std::path::PathBuf;

use thiserror::Error;

use crate::compare::ViewError;
use crate::diagnose::DiagnoseError;
use crate::model::effect::EffectError;

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
    Places(#[from] PlacesError),
}

/// Why a table of places cannot be used.
#[derive(Debug, Error)]
pub enum PlacesError {
    /// The file cannot be read.
    #[error("{}: cannot be read ({source})", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A line is no CSV.
    #[error("{}, line {line}: not a CSV row like its header ({reason})", file.display())]
    NotCsv {
        /// The file.
        file: PathBuf,
        /// 1-based line.
        line: u64,
        /// What the reader said.
        reason: String,
    },
    /// A column is missing, unknown or there twice.
    #[error(
        "{}, line 1: the column `{column}` {problem}; expected channel,elevation_m,azimuth_deg and, where a place is not on the axis, offset_x_m,offset_y_m",
        file.display()
    )]
    Column {
        /// The file.
        file: PathBuf,
        /// The column.
        column: String,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A cell cannot be meant.
    #[error("{}, line {line}, column `{column}`: `{value}` where {expected} was expected", file.display())]
    Value {
        /// The file.
        file: PathBuf,
        /// 1-based line.
        line: u64,
        /// The column.
        column: &'static str,
        /// The cell's text.
        value: String,
        /// What would have been right.
        expected: String,
    },
    /// No rows.
    #[error("{}: no places; expected one row per possible sensor", file.display())]
    Empty {
        /// The file.
        file: PathBuf,
    },
}
