//! `custom@name`: a hypothesis of the user's own, as matrices or as factors on segments, so that it can be tested without
//! writing Rust.

use std::sync::Arc;

use nalgebra::DMatrix;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given};
use super::parameter::Parameter;
use super::place::{PlaceKind, Where};
use crate::model::assembly::Assembly;
use crate::model::beam::Segment;
use crate::model::contribution::Contribution;
use crate::model::custom::Custom;
use crate::model::structure::Structure;

const ABOUT: About = About {
    name: "custom",
    physics: "A hypothesis of your own, given in study.toml as [[model.custom]] with a name: changes of K and M as matrices, \
              or relative changes of segments as a table. The value says how much of it there is.",
    formula: "K += value dK, M += value dM; or each segment's bending, shear, torsion and mass times (1 + value change)",
    fingerprint: "what your hypothesis predicts",
    look_alikes: &[],
    source: "yours",
    examples: &["custom@cables=0.5"],
};

const VALUE: Parameter =
    Parameter::ranged("value", "-", [f64::NEG_INFINITY, f64::INFINITY], 1.0, "how much of the given change there is");

/// The user's own change.
#[derive(Debug)]
pub(super) struct CustomChange;

impl EffectKind for CustomChange {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> PlaceKind {
        PlaceKind::Name
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[VALUE]]
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        let Some(Where::Name(name)) = given.place() else { return Err(given.wrong_place(self)) };
        let Some(custom) = structure.customs.iter().find(|custom| custom.name == *name).cloned() else {
            let known: Vec<&str> = structure.customs.iter().map(|custom| custom.name.as_str()).collect();
            let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
            return Err(EffectError::NoCustom { name: name.clone(), known });
        };
        let value = given.or_zero(VALUE.name);
        let [least, greatest] = custom.range;
        if !(least..=greatest).contains(&value) {
            let range = Parameter::ranged(VALUE.name, "-", custom.range, custom.typical, "").range();
            return Err(EffectError::OutOfRange { kind: ABOUT.name, parameter: VALUE.name, value, range });
        }
        if custom.changes_segments() {
            given.check_beam(self, structure)?;
        }
        let expected = structure.dofs();
        for matrix in custom.stiffness.iter().chain(&custom.mass) {
            if matrix.nrows() != expected {
                return Err(EffectError::CustomSize { name: name.clone(), found: matrix.nrows(), expected });
            }
        }
        Ok(Arc::new(Amount { custom, value }))
    }
}

/// So much of a hypothesis.
#[derive(Debug)]
struct Amount {
    custom: Custom,
    value: f64,
}

impl Contribution for Amount {
    fn change_segments(&self, segments: &mut [Segment]) {
        for segment in segments {
            self.custom.change(segment, self.value);
        }
    }

    fn add_matrices(&self, assembly: &mut Assembly) {
        let add = |matrix: &mut DMatrix<f64>, change: &Option<Arc<DMatrix<f64>>>| {
            if let Some(change) = change {
                *matrix += change.as_ref() * self.value;
            }
        };
        add(&mut assembly.stiffness, &self.custom.stiffness);
        add(&mut assembly.mass, &self.custom.mass);
    }
}
