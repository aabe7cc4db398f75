//! The catalogue of physical effects that a model may lack, one file each.
//!
//! A word such as `base-rotation=7e-15` or `added-mass@443.6m=2e5` flows in; an [`Effect`] with its kind, place and
//! values flows out, and with it the [`Contribution`](super::Contribution) that it makes to a
//! [`Structure`](super::Structure). A new kind is a file with an [`EffectKind`] and its contribution, declared here and
//! listed in [`KINDS`]; what searches, fits, explains and edits effects asks the kind.

mod added_mass;
mod amplitude_stiffness;
mod axis_rotation;
mod base;
mod base_rotation;
mod base_torsion;
mod base_translation;
mod catalogue;
mod chord_drift;
mod clock_offset;
mod connection_flexibility;
mod coupled_shear;
mod custom;
mod error;
mod foundation_mass;
#[cfg(test)]
mod foundation_tests;
mod frame_bending;
mod given;
mod ground_springs;
mod harmonic;
mod kind;
mod lateral_support;
pub(super) mod mass_eccentricity;
mod mass_scale;
mod outrigger;
mod overall_bending;
mod p_delta;
mod parameter;
mod parse;
mod place;
mod rotary_inertia;
mod scale;
mod sensor_gain;
mod sensor_polarity;
mod sensor_rotation;
mod sensor_swap;
mod shear_flexibility;
mod soil_springs;
mod stiffness_loss;
mod stiffness_scale;
mod target;
mod temperature_stiffness;
#[cfg(test)]
mod tests;
mod trend;
pub(super) mod tuned_mass_damper;
mod wall_frame;
#[cfg(test)]
mod wall_frame_tests;
#[cfg(test)]
mod word_tests;

pub use catalogue::{KINDS, find};
pub use error::EffectError;
pub use given::{Effect, EffectRecord, ParameterRecord};
pub use kind::{About, EffectKind, Evidence, Given, LookAlike};
pub use parameter::{Parameter, Prior, TYPICAL_SHIFT};
pub use parse::{named, named_in_study};
pub use place::{PlaceKind, Where};
