//! Every kind of effect that there is: a new kind is a file beside this one and a line in [`KINDS`].

use super::error::EffectError;
use super::kind::EffectKind;
use super::{
    added_mass, amplitude_stiffness, axis_rotation, base_rotation, base_torsion, base_translation, chord_drift,
    clock_offset, connection_flexibility, coupled_shear, custom, foundation_mass, harmonic, lateral_support,
    mass_eccentricity, mass_scale, outrigger, overall_bending, p_delta, rotary_inertia, sensor_gain, sensor_polarity,
    sensor_rotation, sensor_swap, shear_flexibility, soil_springs, stiffness_loss, stiffness_scale,
    temperature_stiffness, tuned_mass_damper, wall_frame,
};
use crate::nearest::nearest;

/// Every kind there is.
pub const KINDS: &[&dyn EffectKind] = &[
    &stiffness_scale::KIND,
    &mass_scale::KIND,
    &base_rotation::KIND,
    &base_translation::KIND,
    &base_torsion::KIND,
    &foundation_mass::FoundationMass,
    &shear_flexibility::ShearFlexibility,
    &coupled_shear::CoupledShear,
    &wall_frame::WallFrame,
    &overall_bending::KIND,
    &chord_drift::KIND,
    &rotary_inertia::RotaryInertia,
    &p_delta::PDelta,
    &added_mass::AddedMass,
    &stiffness_loss::StiffnessLoss,
    &connection_flexibility::ConnectionFlexibility,
    &tuned_mass_damper::TunedMassDamper,
    &mass_eccentricity::MassEccentricity,
    &axis_rotation::AxisRotation,
    &outrigger::KIND,
    &lateral_support::KIND,
    &soil_springs::SoilSprings,
    &temperature_stiffness::KIND,
    &amplitude_stiffness::KIND,
    &sensor_gain::SensorGain,
    &sensor_polarity::SensorPolarity,
    &sensor_swap::SensorSwap,
    &sensor_rotation::SensorRotation,
    &clock_offset::ClockOffset,
    &harmonic::Harmonic,
    &custom::CustomChange,
    &custom::GroupChange,
];

/// The kind of a name.
///
/// # Errors
/// [`EffectError::UnknownKind`] lists the names there are.
pub fn find(name: &str) -> Result<&'static dyn EffectKind, EffectError> {
    KINDS.iter().copied().find(|kind| kind.name() == name).ok_or_else(|| {
        let known: Vec<_> = KINDS.iter().map(|kind| kind.name()).collect();
        EffectError::UnknownKind {
            kind: name.to_owned(),
            nearest: nearest(name, known.iter().copied(), 0.8),
            known: known.join(", "),
        }
    })
}
