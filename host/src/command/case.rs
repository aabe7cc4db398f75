//! What `compare`, `update` and `covalidate` start from: a study's model and its measured modes, seen by the same sensors.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};

use super::Console;
use crate::compare::{Comparison, ModelView, Pair, Tolerance, ViewError, compare, pair};
use crate::diagnose::Signals;
use crate::diagnose::steps::Setting;
use crate::model::{Assembly, Body, LoadedModel, Structure, load};
use crate::modes::{MeasuredModes, read};
use crate::study::{Sensor, Study};

/// A study's model against its measured modes.
pub(super) struct Case {
    pub(super) study: Study,
    pub(super) model: LoadedModel,
    pub(super) sensors: Vec<Sensor>,
    pub(super) measured: MeasuredModes,
    /// The structure as first given.
    bare: Structure,
    /// The model with the study's effects.
    pub(super) assembly: Assembly,
    pub(super) view: ModelView,
    pub(super) tolerance: Option<Tolerance>,
}

/// The folder of a study's results.
pub(super) fn results_folder(study: &Study) -> PathBuf {
    study.folder.join("results")
}

impl Case {
    /// Reads a study, its model and its measured modes; warnings go to the console.
    pub(super) fn load(folder: &Path, console: &Console) -> anyhow::Result<Self> {
        let study = Study::load(folder)?;
        let model = load(&study)?;
        let sensors = study.sensors();
        let measured = measured_modes(&study, &sensors)?;
        for warning in &measured.warnings {
            console.warn(warning);
        }
        let structure = model.structure()?;
        let assembly = structure.assemble();
        let has_shapes = measured.modes.iter().any(|mode| mode.shape.is_some());
        let view = match ModelView::of(&assembly, &sensors) {
            // Where frequencies alone were measured, sensors need no place.
            Err(ViewError::Sensor(error)) if !has_shapes => {
                console.warn(format!("{error}; no shape was measured, so frequencies are compared all the same"));
                ModelView::of(&assembly, &[])?
            }
            view => view?,
        };
        for warning in model_warnings(&study, &model, &assembly, &sensors) {
            console.warn(warning);
        }
        let tolerance = study.model.as_ref().and_then(|model| Tolerance::of(&structure, model));
        let bare = model.bare();
        Ok(Self { study, model, sensors, measured, bare, assembly, view, tolerance })
    }

    /// The model as first given, seen by the same sensors.
    pub(super) fn view_as_given(&self) -> anyhow::Result<ModelView> {
        Ok(ModelView::of(&self.model.as_given(), &self.sensors)?)
    }

    /// Keeps only the measured modes of these numbers; none given keeps all.
    pub(super) fn keep_modes(&mut self, numbers: &[usize]) -> anyhow::Result<()> {
        if numbers.is_empty() {
            return Ok(());
        }
        let known: Vec<String> = self.measured.modes.iter().map(|mode| mode.number.to_string()).collect();
        if let Some(unknown) =
            numbers.iter().find(|number| self.measured.modes.iter().all(|mode| mode.number != **number))
        {
            bail!(
                "--modes: there is no measured mode {unknown}; {} has {}",
                self.measured.file.display(),
                known.join(", ")
            );
        }
        self.measured.modes.retain(|mode| numbers.contains(&mode.number));
        Ok(())
    }

    /// Pairs of the measured modes with the model's.
    pub(super) fn pairs(&self) -> Vec<Pair> {
        pair(&self.view, &self.measured.modes)
    }

    /// Model against measurement.
    pub(super) fn compare(&self) -> Comparison {
        compare(&self.view, &self.measured.modes, &self.sensors, self.tolerance.as_ref())
    }

    /// What `belfry diagnose` and `belfry add` start from.
    pub(super) fn setting(&self) -> anyhow::Result<Setting<'_>> {
        let model = self.study.model.as_ref().context("the study has no [model]")?;
        Ok(Setting { bare: &self.bare, model, sensors: self.seen_sensors(), measured: &self.measured.modes })
    }

    /// The sensors that take part: those without a place take none where no shape was measured.
    pub(super) fn seen_sensors(&self) -> &[Sensor] {
        if self.view.at_sensors.nrows() == 0 { &[] } else { &self.sensors }
    }

    /// What identification has seen besides modes; nothing for modes of other tools.
    pub(super) fn signals(&self) -> anyhow::Result<Signals> {
        if self.measured.file.extension().is_none_or(|extension| extension != "json") {
            return Ok(Signals::default());
        }
        let text = std::fs::read_to_string(&self.measured.file)
            .with_context(|| format!("cannot read {}", self.measured.file.display()))?;
        // Another tool's JSON has modes only.
        Ok(serde_json::from_str(&text).unwrap_or_default())
    }

    /// Names of the effects that the study has in its model.
    pub(super) fn effect_names(&self) -> Vec<String> {
        self.model.effects.iter().map(ToString::to_string).collect()
    }
}

/// What the reader should know of a model that was read.
fn model_warnings(study: &Study, model: &LoadedModel, assembly: &Assembly, sensors: &[Sensor]) -> Vec<String> {
    let mut warnings = Vec::new();
    let section = study.model.as_ref();
    let trusts = section.is_some_and(|model| model.background_stiffness.or(model.background_mass).is_some());
    if trusts && matches!(model.body, Body::Matrices(_)) {
        warnings.push(
            "[model] background_stiffness and background_mass scatter the segments of a beam table; matrices have none, so they are not used"
                .to_owned(),
        );
    }
    let guessed = assembly.guessed_spans_m();
    if !guessed.is_empty() {
        let spans: Vec<String> = guessed.iter().map(|[bottom, top]| format!("{bottom} to {top} m")).collect();
        let inside = |z_m: f64| guessed.iter().any(|[bottom_m, top_m]| *bottom_m < z_m && z_m < *top_m);
        let channels: Vec<&str> = sensors
            .iter()
            .filter(|sensor| sensor.elevation_m.is_some_and(inside))
            .map(|sensor| sensor.channel.as_str())
            .collect();
        let mut warning = format!(
            "between these nodes the model's matrices are not those of a beam: {}; are all nodes there, at their heights, and do rotations turn right-handed?",
            spans.join(", ")
        );
        if !channels.is_empty() {
            warning += &format!(" Motion at channel {} is taken from straight lines", channels.join(", "));
        }
        warnings.push(warning);
    }
    warnings
}

/// The modes that a study has: those of `[measured]`, else what `belfry identify` has found.
fn measured_modes(study: &Study, sensors: &[Sensor]) -> anyhow::Result<MeasuredModes> {
    if let Some(measured) = &study.measured {
        return Ok(read(&study.folder.join(&measured.modes), sensors)?);
    }
    let file = results_folder(study).join("modes.json");
    if !file.exists() {
        bail!("{}: the study has no modes yet; run `belfry identify {}` first", file.display(), study.folder.display());
    }
    Ok(read(&file, sensors)?)
}

/// Writes an object as JSON into the study's results.
pub(super) fn write_json(study: &Study, name: &str, object: &impl serde::Serialize) -> anyhow::Result<PathBuf> {
    let text = serde_json::to_string_pretty(object)? + "\n";
    write_result(study, name, text.as_bytes())
}

/// Writes a file into the study's results.
pub(super) fn write_result(study: &Study, name: &str, bytes: &[u8]) -> anyhow::Result<PathBuf> {
    let folder = results_folder(study);
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let path = folder.join(name);
    std::fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(path)
}
