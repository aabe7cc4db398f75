//! `custom@name`: a hypothesis of the user's own, as matrices or as factors on segments, so that it can be tested without
//! writing Rust. `group@name`: a part of the model that the study names, which may be stiffer or softer than the model has it.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use super::place::{PlaceKind, Where};
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

const ABOUT_GROUP: About = About {
    name: "group",
    physics: "A part of the model that study.toml names as [[model.group]]: columns of a storey, braces, soil springs. The value is by how much \
              of itself it is stiffer, or heavier, than the model has it, beyond what the study trusts it to.",
    formula: "K += change dK, M += change dM, where dK and dM are the group's own part of K and M",
    fingerprint: "what the group's own stiffness or mass does to frequencies and shapes",
    look_alikes: &[LookAlike { kind: "stiffness-scale", separated_by: "modes that move other groups" }],
    source: "sub-structure updating: Mottershead and Friswell 1993, J. Sound Vib. 167, section 4",
    examples: &["group@storey3=-0.2"],
};

const VALUE: Parameter =
    Parameter::ranged("value", "-", [f64::NEG_INFINITY, f64::INFINITY], 1.0, "how much of the given change there is");

const CHANGE: Parameter = Parameter::ranged(
    "change",
    "-",
    [-1.0, f64::INFINITY],
    0.3,
    "share of itself by which the group is stiffer or heavier",
);

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
        named(self, given, structure, &VALUE)
    }
}

/// A group of the model that is stiffer or softer, heavier or lighter, than the model has it.
#[derive(Debug)]
pub(super) struct GroupChange;

impl EffectKind for GroupChange {
    fn about(&self) -> &'static About {
        &ABOUT_GROUP
    }

    fn place(&self) -> PlaceKind {
        PlaceKind::Group
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[CHANGE]]
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        named(self, given, structure, &CHANGE)
    }
}

/// So much of what a study has under this name.
fn named(
    kind: &dyn EffectKind,
    given: &Given<'_>,
    structure: &Structure,
    parameter: &Parameter,
) -> Result<Arc<dyn Contribution>, EffectError> {
    let Some(Where::Name(name)) = given.place() else { return Err(given.wrong_place(kind)) };
    let is_of_kind = |custom: &&Custom| custom.group.is_some() == (kind.place() == PlaceKind::Group);
    let of_kind: Vec<&Custom> = structure.customs.iter().filter(is_of_kind).collect();
    let Some(custom) = of_kind.iter().find(|custom| custom.name == *name) else {
        let known: Vec<&str> = of_kind.iter().map(|custom| custom.name.as_str()).collect();
        let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
        return Err(EffectError::NoCustom { kind: kind.name(), name: name.clone(), known });
    };
    let value = given.or_zero(parameter.name);
    let [least, greatest] = custom.range;
    if !(least..=greatest).contains(&value) {
        let range = Parameter::ranged(parameter.name, "-", custom.range, custom.typical, "").range();
        return Err(EffectError::OutOfRange { kind: kind.name(), parameter: parameter.name, value, range });
    }
    // Changes of segments are factors, which never turn a stiffness round.
    let total = structure.amount_of(name) + value;
    if custom.group.is_some() && !custom.changes_segments() && total < -1.0 {
        return Err(EffectError::NothingLeft { kind: kind.name(), name: name.clone(), value, total });
    }
    if custom.changes_segments() {
        given.check_beam(kind, structure)?;
    }
    let expected = structure.dofs();
    if let Some(found) = custom.other_size(expected) {
        return Err(EffectError::CustomSize { kind: kind.name(), name: name.clone(), found, expected });
    }
    Ok(Arc::new(custom.times(value)))
}
