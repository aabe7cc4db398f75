//! From a study's `[model]` to a body and the effects that the study has put into it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::DVector;
use thiserror::Error;

use super::DOFS_A_NODE;
use super::assembly::Assembly;
use super::beam::{BeamError, BeamTable};
use super::custom::{Custom, CustomError, of_other_size};
use super::effect::{Effect, EffectError};
use super::eigen::EigenError;
use super::matrices::{MatrixError, WholeMatrices, dense_bytes};
use super::node_files::KnownRows;
use super::runs::{self, RunError};
use super::size::{self, TooManyUnknowns};
use super::structure::{Body, Structure};
use super::wireframe::{Wireframe, WireframeError};
use super::{numbering, reduction};
use crate::study::{CustomSource, MatrixSource, Model, ModelSource, STUDY_FILE, Study};

/// A study's model, read.
#[derive(Debug, Clone)]
pub struct LoadedModel {
    /// What it is made of, as first given.
    pub body: Body,
    /// The effects that the study has put into it, in their order.
    pub effects: Vec<Effect>,
    /// The user's own hypotheses.
    pub customs: Arc<[Custom]>,
    /// What the reader should know of its files.
    pub warnings: Vec<String>,
    /// What it looks like, where the study says so.
    pub wireframe: Option<Wireframe>,
}

/// What the degrees of freedom of a model are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Freedoms {
    /// Those of its beam or its matrices.
    Own,
    /// Few, for the many of its matrices.
    Reduced,
    /// Its modes: it has no matrices.
    Modes,
}

/// Why a study has no usable model.
#[derive(Debug, Error)]
pub enum ModelError {
    /// There is no `[model]`.
    #[error("{}: no [model] to compare with the measurement; add one, for instance\n  [model]\n  beam = \"beam.csv\"", file.display())]
    NoModel {
        /// The study's file.
        file: PathBuf,
    },
    /// The beam table.
    #[error(transparent)]
    Beam(#[from] BeamError),
    /// A table of more segments than fit into memory.
    #[error("{}, {segments} segments: {why}; join segments, or bring reduced matrices", file.display())]
    TooManySegments {
        /// The table.
        file: PathBuf,
        /// Its segments.
        segments: usize,
        /// What it would take.
        why: TooManyUnknowns,
    },
    /// The matrices.
    #[error(transparent)]
    Matrices(#[from] MatrixError),
    /// Modes of the user's own program.
    #[error(transparent)]
    Runs(#[from] RunError),
    /// A hypothesis of the user's own.
    #[error("{}, line {line}, [[model.{section}]]: {source}", file.display())]
    Custom {
        /// `custom` or `group`.
        section: &'static str,
        /// The study's file.
        file: PathBuf,
        /// 1-based line.
        line: usize,
        /// Why.
        source: Box<CustomError>,
    },
    /// A group or a hypothesis that does not suit the model, or a group that no measurement could tell from another.
    #[error("{}, line {line}, [[model.{section}]] `{name}`: {reason}", file.display())]
    Group {
        /// `custom` or `group`.
        section: &'static str,
        /// The study's file.
        file: PathBuf,
        /// 1-based line.
        line: usize,
        /// The group.
        name: String,
        /// Why.
        reason: String,
    },
    /// What it looks like.
    #[error(transparent)]
    Wireframe(#[from] WireframeError),
    /// The modes of a model of many degrees of freedom.
    #[error("[model] matrices: {0}")]
    Reduction(#[from] EigenError),
    /// An effect of the study.
    #[error("{}, line {line}, [[model.effect]]: {source}", file.display())]
    Effect {
        /// The study's file.
        file: PathBuf,
        /// 1-based line.
        line: usize,
        /// Why.
        source: EffectError,
    },
}

/// `[model]` of a study.
///
/// # Errors
/// [`ModelError::NoModel`].
pub fn section(study: &Study) -> Result<&Model, ModelError> {
    study.model.as_ref().ok_or_else(|| ModelError::NoModel { file: study.folder.join(STUDY_FILE) })
}

/// Reads the model of a study: its beam table, matrices or modes, and its effects, checked against them.
///
/// # Errors
/// [`ModelError`] names the file and, in it, line, column or matrix entry.
pub fn load(study: &Study) -> Result<LoadedModel, ModelError> {
    load_up_to(study, None)
}

/// As [`load`], for modes up to `highest_hz` where that is known: a model of many degrees of freedom is reduced to what moves up to there.
///
/// # Errors
/// As there.
pub fn load_up_to(study: &Study, highest_hz: Option<f64>) -> Result<LoadedModel, ModelError> {
    let file = study.folder.join(STUDY_FILE);
    let model = section(study)?;
    let custom = |source: &CustomSource, known: &KnownRows| {
        Custom::read_whole(source, &study.folder, known).map_err(|error| ModelError::Custom {
            section: source.section(),
            file: file.clone(),
            line: source.line,
            source: Box::new(error),
        })
    };
    let customs = |known: &KnownRows| {
        model.customs.iter().map(|source| custom(source, known)).collect::<Result<Vec<Custom>, _>>()
    };
    let tied = |customs: Vec<Custom>| join_tied(customs, &model.customs, &file);
    let in_full = |customs: Vec<Custom>| customs.into_iter().map(Custom::in_full).collect();
    let mut warnings = Vec::new();
    let (body, customs): (Body, Vec<Custom>) = match &model.source {
        ModelSource::Beam(path) => {
            (Body::Beam(read_beam(&study.folder.join(path))?), in_full(tied(customs(&KnownRows::default())?)?))
        }
        ModelSource::Matrices(source) => {
            let whole = WholeMatrices::read(source, &study.folder)?;
            warnings.extend(doubt_of_numbers(&whole, source));
            let known = KnownRows { least: whole.stiffness.nrows(), places: whole.places.clone() };
            let customs = tied(customs(&known)?)?;
            warnings.extend(doubt_of_heights(&whole, &customs, source));
            if reduction::is_worthwhile(&whole) {
                check_sizes(&whole, &customs, model, &file)?;
                let (matrices, customs) = reduction::reduced(whole, customs, highest_hz)?;
                (Body::Matrices(matrices), customs)
            } else {
                // Each has a matrix, and what it changes of K and M is kept beside it.
                (Body::Matrices(whole.in_full(4 * customs.len())?), in_full(customs))
            }
        }
        ModelSource::Modes(base) => {
            let of_runs = runs::read(base, &model.runs, &study.folder)?;
            warnings = of_runs.warnings;
            let change = |source: &CustomSource| {
                let (_, change) = of_runs.changes.iter().find(|(name, _)| *name == source.name)?;
                Some(Custom::of_run(source, change))
            };
            (Body::Matrices(of_runs.body), tied(model.customs.iter().filter_map(change).collect())?)
        }
    };
    let customs: Arc<[Custom]> = customs.into();
    let mut changes: Vec<(&str, DVector<f64>)> = Vec::new();
    for (group, source) in customs.iter().zip(untied(&model.customs)).filter(|(one, _)| one.group.is_some()) {
        let failed = |reason| ModelError::Group {
            section: source.section(),
            file: file.clone(),
            line: source.line,
            name: group.name.clone(),
            reason,
        };
        changes.push((&group.name, group.change_of_group(&body, &changes).map_err(failed)?));
    }
    let sensors = study.sensors();
    let mut structure = Structure::new(body.clone()).with_customs(customs.clone());
    let mut effects = Vec::new();
    for written in &model.effects {
        let failed = |source| ModelError::Effect { file: file.clone(), line: written.line, source };
        let effect = Effect::from_study(written).and_then(|effect| effect.in_study(&sensors)).map_err(failed)?;
        structure = structure.and(std::slice::from_ref(&effect)).map_err(failed)?;
        effects.push(effect);
    }
    let wireframe = Wireframe::read(model, &study.folder)?;
    Ok(LoadedModel { body, effects, customs, warnings, wireframe })
}

/// Asks whether rows are numbered as their table says, where K says otherwise.
fn doubt_of_numbers(whole: &WholeMatrices, source: &MatrixSource) -> Option<String> {
    let numbering::Unbalanced { motion, balanced, rows } = numbering::unbalanced(&whole.stiffness, &whole.nodes)?;
    let file = source.layout.as_ref()?.file().display();
    Some(format!(
        "{file}: are the rows of the matrices numbered so? A structure that moves {motion} as a rigid body meets forces at its supports alone, but by these numbers {} of {rows} rows do; look at the order of rows, which count from 1, and at nodes and directions",
        rows - balanced
    ))
}

/// Asks whether nodes stand where their table says, where several groups with heights of their own touch nodes that are a storey off.
fn doubt_of_heights(whole: &WholeMatrices, customs: &[Custom], source: &MatrixSource) -> Option<String> {
    let mut levels_m: Vec<f64> = whole.nodes.iter().map(|node| node.position_m[2]).collect();
    levels_m.sort_by(f64::total_cmp);
    let storey_m = levels_m.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
    if storey_m < LEAST_STOREY_M {
        return None;
    }
    let mut with_heights = 0;
    let elsewhere = |group: &Custom| {
        let [low_m, high_m] = group.group?.span_m?;
        let touched = whole.nodes.iter().filter(|node| node.rows.iter().flatten().any(|&row| group.touches(row)));
        let touched_m: Vec<f64> = touched.map(|node| node.position_m[2]).collect();
        if touched_m.is_empty() {
            return None;
        }
        with_heights += 1;
        let middle_m = touched_m.iter().sum::<f64>() / touched_m.len() as f64;
        // Of a part at the ground only the upper nodes have rows.
        let is_there = (low_m - storey_m..=high_m + storey_m).contains(&middle_m);
        (!is_there).then(|| (group.name.clone(), [low_m, high_m], middle_m))
    };
    let doubtful: Vec<(String, [f64; 2], f64)> = customs.iter().filter_map(elsewhere).collect();
    // One alone may be a slip in its z_m, or stand by an arm.
    let [(name, [low_m, high_m], middle_m), _, ..] = &doubtful[..] else { return None };
    let file = source.layout.as_ref()?.file().display();
    let span = if low_m < high_m { format!("{low_m} to {high_m} m") } else { format!("{low_m} m") };
    Some(format!(
        "{file}: do nodes stand where it says? `z_m` of group `{name}` is {span}, but the nodes that its matrix touches are at {middle_m:.1} m on \
         average, and {} of {with_heights} groups with heights are off like this; look at the order of rows, or at z_m",
        doubtful.len()
    ))
}

/// Where heights differ by less nothing stands above anything.
const LEAST_STOREY_M: f64 = 0.1;

/// Hypotheses and groups that are tied to no other.
fn untied(sources: &[CustomSource]) -> impl Iterator<Item = &CustomSource> {
    sources.iter().filter(|source| source.tied_to.is_none())
}

/// Hypotheses and groups, those that are tied to others in them; `customs` are those of `sources`, in their order.
fn join_tied(customs: Vec<Custom>, sources: &[CustomSource], file: &Path) -> Result<Vec<Custom>, ModelError> {
    let (free, tied): (Vec<_>, Vec<_>) =
        customs.into_iter().zip(sources).partition(|(_, source)| source.tied_to.is_none());
    let mut free: Vec<Custom> = free.into_iter().map(|(custom, _)| custom).collect();
    for (custom, source) in tied {
        // The study's reader has found it.
        let Some(with) = free.iter_mut().find(|other| source.tied_to.as_ref() == Some(&other.name)) else { continue };
        with.tie(custom).map_err(|reason| ModelError::Group {
            section: source.section(),
            file: file.to_owned(),
            line: source.line,
            name: source.name.clone(),
            reason,
        })?;
    }
    Ok(free)
}

/// Matrices that are reduced together are of one size.
fn check_sizes(whole: &WholeMatrices, customs: &[Custom], model: &Model, file: &Path) -> Result<(), ModelError> {
    let expected = whole.stiffness.nrows();
    let other = |(custom, source): (&Custom, &CustomSource)| {
        let found = custom.other_whole_size(expected)?;
        let reason = of_other_size(found, expected);
        let (file, line, name) = (file.to_owned(), source.line, source.name.clone());
        Some(ModelError::Group { section: source.section(), file, line, name, reason })
    };
    customs.iter().zip(untied(&model.customs)).find_map(other).map_or(Ok(()), Err)
}

/// Reads a beam table whose model fits into the memory.
///
/// # Errors
/// [`ModelError`] names the file, and its line or how many segments are too many.
pub fn read_beam(file: &Path) -> Result<BeamTable, ModelError> {
    let table = BeamTable::read(file)?;
    let segments = table.segments().len();
    let too_many = |why| ModelError::TooManySegments { file: file.to_owned(), segments, why };
    size::fits_in_full(segments.saturating_mul(DOFS_A_NODE)).map_err(too_many)?;
    Ok(table)
}

impl LoadedModel {
    /// The model as first given, without effects.
    pub fn as_given(&self) -> Assembly {
        Structure::new(self.body.clone()).assemble()
    }

    /// What its degrees of freedom are.
    pub fn freedoms(&self) -> Freedoms {
        match &self.body {
            Body::Matrices(matrices) if matrices.whole.is_some() => Freedoms::Reduced,
            Body::Matrices(matrices) if matrices.coordinates.is_some() => Freedoms::Modes,
            _ => Freedoms::Own,
        }
    }

    /// All that its files say of K and M as first given, to tell whether they have changed.
    pub fn bytes(&self) -> Vec<u8> {
        match &self.body {
            Body::Matrices(matrices) => matrices.bytes(),
            Body::Beam(_) => {
                let given = self.as_given();
                dense_bytes([&given.stiffness, &given.mass].into_iter())
            }
        }
    }

    /// The structure without effects; effects may name the user's own hypotheses.
    pub fn bare(&self) -> Structure {
        Structure::new(self.body.clone()).with_customs(self.customs.clone())
    }

    /// The structure with the study's effects.
    ///
    /// # Errors
    /// None that [`load`] would not have found.
    pub fn structure(&self) -> Result<Structure, EffectError> {
        self.bare().and(&self.effects)
    }
}
