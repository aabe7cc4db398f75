//! `stiffness-loss@z`: damage or a weaker section around a height.

use super::{EffectError, EffectKind, Parameter, Place, Where, height, segments};
use crate::model::Structure;

/// A full loss would cut the structure in two, so the range ends short of it.
const RELATIVE: Parameter = Parameter { name: "relative", unit: "-", least: 0.0, greatest: 0.99 };

/// The segment that contains z loses the share `relative` of its bending, shear and torsion; where z is a node, both
/// segments that meet there do.
#[derive(Debug)]
pub(super) struct StiffnessLoss;

impl EffectKind for StiffnessLoss {
    fn name(&self) -> &'static str {
        "stiffness-loss"
    }

    fn place(&self) -> Place {
        Place::Height
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[RELATIVE]]
    }

    fn apply(&self, values: &[f64], place: Option<&Where>, structure: &mut Structure) -> Result<(), EffectError> {
        let z_m = height(self.name(), place, structure)?;
        let left = values.iter().fold(1.0, |factor, relative| factor * (1.0 - relative));
        for segment in segments(self.name(), structure)? {
            if (segment.z_bottom_m..=segment.z_top_m).contains(&z_m) {
                segment.bending_n_m2 = segment.bending_n_m2.map(|bending| bending * left);
                segment.shear_n = segment.shear_n.map(|shear| shear.map(|shear| shear * left));
                segment.torsion_n_m2 *= left;
            }
        }
        Ok(())
    }
}
