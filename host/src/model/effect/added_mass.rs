//! `added-mass@z`: a mass that the model does not know, such as plant or cladding.

use super::{EffectError, EffectKind, Parameter, Place, Where, height};
use crate::model::{AddedMass, Structure};

const MASS: Parameter = Parameter { name: "mass", unit: "kg", least: 0.0, greatest: f64::INFINITY };

/// A point mass on the beam axis: it moves sideways and has no rotational inertia of its own. Between nodes it enters M
/// through the element's shape functions.
#[derive(Debug)]
pub(super) struct AddedMassAt;

impl EffectKind for AddedMassAt {
    fn name(&self) -> &'static str {
        "added-mass"
    }

    fn place(&self) -> Place {
        Place::Height
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[MASS]]
    }

    fn apply(&self, values: &[f64], place: Option<&Where>, structure: &mut Structure) -> Result<(), EffectError> {
        let z_m = height(self.name(), place, structure)?;
        structure.added_masses.extend(values.iter().map(|&mass_kg| AddedMass { z_m, mass_kg }));
        Ok(())
    }
}
