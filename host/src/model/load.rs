//! From a study's `[model]` to a body and the effects that the study has put into it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::DVector;
use thiserror::Error;

use super::DOFS_A_NODE;
use super::assembly::Assembly;
use super::beam::{BeamError, BeamTable};
use super::custom::{Custom, CustomError};
use super::effect::{Effect, EffectError};
use super::matrices::{ImportedMatrices, MatrixError};
use super::size::{self, TooManyUnknowns};
use super::structure::{Body, Structure};
use crate::study::{CustomSource, ModelSource, STUDY_FILE, Study};

/// A study's model, read.
#[derive(Debug, Clone)]
pub struct LoadedModel {
    /// What it is made of, as first given.
    pub body: Body,
    /// The effects that the study has put into it, in their order.
    pub effects: Vec<Effect>,
    /// The user's own hypotheses.
    pub customs: Arc<[Custom]>,
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
    /// A group that does not suit the model, or that no measurement could tell from another.
    #[error("{}, line {line}, [[model.group]] `{name}`: {reason}", file.display())]
    Group {
        /// The study's file.
        file: PathBuf,
        /// 1-based line.
        line: usize,
        /// The group.
        name: String,
        /// Why.
        reason: String,
    },
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

/// Reads the model of a study: its beam table or matrices, and its effects, checked against them.
///
/// # Errors
/// [`ModelError`] names the file and, in it, line, column or matrix entry.
pub fn load(study: &Study) -> Result<LoadedModel, ModelError> {
    let file = study.folder.join(STUDY_FILE);
    let model = study.model.as_ref().ok_or_else(|| ModelError::NoModel { file: file.clone() })?;
    let body = match &model.source {
        ModelSource::Beam(path) => Body::Beam(read_beam(&study.folder.join(path))?),
        ModelSource::Matrices(source) => Body::Matrices(ImportedMatrices::read(source, &study.folder)?),
    };
    let custom = |source: &CustomSource| {
        Custom::read(source, &study.folder).map_err(|error| ModelError::Custom {
            section: source.section(),
            file: file.clone(),
            line: source.line,
            source: Box::new(error),
        })
    };
    let customs: Arc<[Custom]> = model.customs.iter().map(custom).collect::<Result<Vec<_>, _>>()?.into();
    let mut changes: Vec<(&str, DVector<f64>)> = Vec::new();
    for (group, source) in customs.iter().zip(&model.customs).filter(|(one, _)| one.group.is_some()) {
        let failed =
            |reason| ModelError::Group { file: file.clone(), line: source.line, name: group.name.clone(), reason };
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
    Ok(LoadedModel { body, effects, customs })
}

/// Reads a beam table whose model fits into the memory.
///
/// # Errors
/// [`ModelError`] names the file, and its line or how many segments are too many.
pub fn read_beam(file: &Path) -> Result<BeamTable, ModelError> {
    let table = BeamTable::read(file)?;
    let segments = table.segments().len();
    let too_many = |why| ModelError::TooManySegments { file: file.to_owned(), segments, why };
    size::fits(segments.saturating_mul(DOFS_A_NODE)).map_err(too_many)?;
    Ok(table)
}

impl LoadedModel {
    /// The model as first given, without effects.
    pub fn as_given(&self) -> Assembly {
        Structure::new(self.body.clone()).assemble()
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
