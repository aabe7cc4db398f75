//! Why an effect is refused.

use thiserror::Error;

use super::place::PlaceKind;

/// Why an effect was refused.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum EffectError {
    /// The word has no value.
    #[error("`{word}`: no value; expected {expected}, for instance {examples}")]
    NoValue {
        /// What was typed.
        word: String,
        /// What a value looks like.
        expected: String,
        /// How the kind is typed.
        examples: String,
    },
    /// No such kind.
    #[error("no effect is called `{kind}`{}; there are {known}", nearest.map_or_else(String::new, |nearest| format!(" (did you mean {nearest}?)")))]
    UnknownKind {
        /// What was typed.
        kind: String,
        /// The name it was most likely meant to be.
        nearest: Option<&'static str>,
        /// The kinds there are.
        known: String,
    },
    /// The kind acts elsewhere.
    #[error("{kind} needs {expected}, but got {found}")]
    WrongPlace {
        /// The kind.
        kind: &'static str,
        /// What it needs.
        expected: &'static str,
        /// What it got.
        found: String,
    },
    /// The kind acts on the whole structure.
    #[error("{kind} acts on the whole structure and takes no @WHERE; leave out {found}")]
    NoPlace {
        /// The kind.
        kind: &'static str,
        /// What it got.
        found: String,
    },
    /// The height is not on the beam.
    #[error("{kind}@{z_m}m: the beam stands from {z_base_m} m to {z_top_m} m")]
    OutsideBeam {
        /// The kind.
        kind: &'static str,
        /// The height asked for.
        z_m: f64,
        /// Where the beam starts.
        z_base_m: f64,
        /// Where it ends.
        z_top_m: f64,
    },
    /// The model's nodes do not stand above each other.
    #[error(
        "{kind} acts at a height, but the nodes of the model's matrices do not stand above each other; give them `nodes`, or use a beam table"
    )]
    NoHeights {
        /// The kind.
        kind: &'static str,
    },
    /// The effect changes segments, and matrices have none.
    #[error(
        "{kind} changes beam segments or what stands between them, and a model of matrices has none; it needs a beam table"
    )]
    NeedsBeam {
        /// The kind.
        kind: &'static str,
    },
    /// The effect resists rotation, and nothing in the model rotates.
    #[error("{kind} resists rotation, and the model's matrices have no rows for rotations (rx, ry)")]
    NoRotations {
        /// The kind.
        kind: &'static str,
    },
    /// The effect lets the base give way, and the model shows none.
    #[error(
        "{kind} needs a base: a beam table, or matrices whose nodes stand above each other, of which the lowest alone are tied to the ground"
    )]
    NeedsBase {
        /// The kind.
        kind: &'static str,
    },
    /// The effect is one of storeys, and the model is none of them.
    #[error(
        "{kind} acts on a model of storeys: matrices with a row for each floor, heights of the floors in `dofs`, and nothing but the next floors' shear between them"
    )]
    NeedsStoreys {
        /// The kind.
        kind: &'static str,
    },
    /// The model has nothing that the effect could scale.
    #[error("{kind}: {missing}; give {instead}")]
    NothingToScale {
        /// The kind.
        kind: &'static str,
        /// What the table lacks.
        missing: &'static str,
        /// What to give instead.
        instead: &'static str,
    },
    /// The channel is not in the study.
    #[error("{kind}: the study has no channel {channel}; there are {known}")]
    NoChannel {
        /// The kind.
        kind: &'static str,
        /// What was asked for.
        channel: String,
        /// The channels there are.
        known: String,
    },
    /// The node is not in the study.
    #[error("{kind}: no sensor of the study belongs to node {node}; there are {known}")]
    NoNode {
        /// The kind.
        kind: &'static str,
        /// What was asked for.
        node: u16,
        /// The nodes there are.
        known: String,
    },
    /// The custom change or the group is not defined.
    #[error("{kind}@{name}: no [[model.{kind}]] in study.toml has this name; there are {known}")]
    NoCustom {
        /// The kind.
        kind: &'static str,
        /// What was asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// The matrices of a custom change or a group do not fit the model.
    #[error("{kind}@{name}: its matrices are {found} x {found}, those of the model {expected} x {expected}")]
    CustomSize {
        /// The kind.
        kind: &'static str,
        /// The name.
        name: String,
        /// Rows of the custom matrix.
        found: usize,
        /// Rows of the model's.
        expected: usize,
    },
    /// The names of parameters given are not those of the kind.
    #[error("{kind}: `{value}` is not a value for it; expected {expected}, for instance {examples}")]
    BadValue {
        /// The kind.
        kind: &'static str,
        /// What was typed.
        value: String,
        /// What would have been right.
        expected: String,
        /// How the kind is typed.
        examples: String,
    },
    /// Of a group less than nothing would be left.
    #[error(
        "{kind}@{name}: {value} more would leave less than nothing of it, as all effects on it together are {total:.3}; above -1 something is left"
    )]
    NothingLeft {
        /// The kind.
        kind: &'static str,
        /// The group.
        name: String,
        /// The effect's value.
        value: f64,
        /// With all effects before it.
        total: f64,
    },
    /// A value outside its bounds.
    #[error("{kind}: {parameter} = {value} is out of range; it must be {range}")]
    OutOfRange {
        /// The kind.
        kind: &'static str,
        /// The parameter.
        parameter: &'static str,
        /// Its value.
        value: f64,
        /// The range in words, with the unit.
        range: String,
    },
}

impl EffectError {
    /// The error that an effect of a kind does not act at `found`, the part after the @.
    pub(super) fn wrong_place(kind: &'static str, place: PlaceKind, found: Option<&str>) -> Self {
        let found = found.map_or_else(|| "nothing".to_owned(), |found| format!("@{found}"));
        match place {
            PlaceKind::Nowhere => Self::NoPlace { kind, found },
            _ => Self::WrongPlace { kind, expected: place.in_words(), found },
        }
    }
}
