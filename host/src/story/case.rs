//! A study's model and its measured modes, seen by the same sensors: what comparison, update, co-validation and diagnosis
//! start from.

use std::path::Path;

use serde::Deserialize;

use super::error::StoryError;
use super::inputs::Inputs;
use super::parts::Parts;
use crate::compare::{Comparison, ModelView, Pair, Tolerance, ViewError, candidates, compare, pair, searched};
use crate::diagnose::steps::Setting;
use crate::diagnose::{Diagnosis, Options, Signals, diagnose, fit_as_given};
use crate::model::effect::Effect;
use crate::model::{Assembly, BesideNode, Body, LoadedModel, Structure, load_up_to, section};
use crate::modes::{MeasuredError, MeasuredModes, read};
use crate::plan::{Site, advice, advice_beside};
use crate::progress::{Tally, UNHEARD};
use crate::results::{MODES_FILE, Results};
use crate::study::{Sensor, Study};

/// Modes that are looked for beyond those that are needed, for a structure whose modes come in another order or lie lower.
const MORE_MODES: usize = 8;

/// A study's model against its measured modes.
#[derive(Debug, Clone)]
pub struct Case {
    /// What the study says.
    pub study: Study,
    /// Its model, read.
    pub model: LoadedModel,
    /// The sensors that shapes stand at.
    pub sensors: Vec<Sensor>,
    /// The measured modes.
    pub measured: MeasuredModes,
    /// The structure as first given.
    bare: Structure,
    /// The model with the study's effects.
    pub assembly: Assembly,
    /// What the sensors see of it.
    pub view: ModelView,
    /// How far the model is trusted, where the study says so.
    pub tolerance: Option<Tolerance>,
    /// What the reader should know.
    pub warnings: Vec<String>,
    /// Its groups with the sensors at them, where it is no tower.
    parts: Parts,
}

impl Case {
    /// Reads a study's model and its measured modes.
    ///
    /// # Errors
    /// When the study has no model or no modes, one of them cannot be read, or they do not go together.
    pub fn load(study: Study) -> Result<Self, StoryError> {
        section(&study)?;
        let measured = measured_modes(&study, &study.sensors())?;
        Self::of(study, measured)
    }

    /// A study's model and measured modes that may be others than its own.
    ///
    /// # Errors
    /// When the study has no model, it cannot be read, or it does not go with the modes.
    pub(super) fn of(study: Study, measured: MeasuredModes) -> Result<Self, StoryError> {
        let highest_hz = measured.modes.iter().map(|mode| mode.frequency_hz).reduce(f64::max);
        let model = load_up_to(&study, highest_hz)?;
        Self::with(study, model, measured)
    }

    fn with(study: Study, model: LoadedModel, mut measured: MeasuredModes) -> Result<Self, StoryError> {
        let sensors = study.sensors();
        if measured.has_stated() {
            let given = model.as_given();
            measured.find_stated(&given.mass, &given.modes().map_err(ViewError::Eigen)?)?;
        }
        let mut warnings = measured.warnings.clone();
        let structure = model.structure()?;
        let assembly = structure.assemble();
        let has_shapes = measured.modes.iter().any(|mode| mode.shape.is_some());
        let view = match ModelView::of(&assembly, &sensors) {
            // Where frequencies alone were measured, sensors need no place.
            Err(ViewError::Sensor(error)) if !has_shapes => {
                warnings.push(format!("{error}; no shape was measured, so frequencies are compared all the same"));
                ModelView::of(&assembly, &[])?
            }
            view => view?,
        };
        warnings.extend(model_warnings(&study, &model, &assembly, &sensors));
        let tolerance = study.model.as_ref().and_then(|model| Tolerance::of(&structure, model));
        let bare = model.bare();
        let parts = Parts::of(section(&study)?, &bare, &assembly, &sensors);
        Ok(Self { study, model, sensors, measured, bare, assembly, view, tolerance, warnings, parts })
    }

    /// The model as first given, seen by the same sensors.
    ///
    /// # Errors
    /// When it has no modes.
    pub fn view_as_given(&self) -> Result<ModelView, StoryError> {
        Ok(ModelView::of(&self.model.as_given(), self.seen_sensors())?)
    }

    /// The lowest modes of another structure, as the sensors see them; all modes, where the lowest are not found sooner, or do not reach
    /// `beyond` the highest that has a partner.
    ///
    /// # Errors
    /// When it has no modes.
    pub(crate) fn view_of(&self, assembly: &Assembly, beyond: usize) -> Result<ModelView, StoryError> {
        let (measured, sensors) = (&self.measured.modes, self.seen_sensors());
        let needed = |view: &ModelView| {
            let pairs = pair(view, measured);
            let highest = pairs.iter().map(|pair| pair.model + 1).max().unwrap_or(0);
            // A measured mode without a partner is held against those of the model one by one.
            let lonely = if pairs.len() < measured.len() { searched(measured.len()) } else { 0 };
            (highest.max(lonely) + beyond, candidates(view, measured) + beyond)
        };
        let (sharp, count) = needed(&self.view);
        let view = self.view.near(assembly, sensors, sharp + MORE_MODES, (count + MORE_MODES).max(3 * sharp))?;
        let (sharp, count) = needed(&view);
        let is_whole = view.basis.sharp() == view.basis.vectors.ncols();
        let is_enough = is_whole || sharp <= view.basis.sharp() && count <= view.modes.frequency_hz.len();
        if is_enough { Ok(view) } else { Ok(ModelView::of(assembly, sensors)?) }
    }

    /// Keeps only the measured modes of these numbers; none given keeps all.
    ///
    /// # Errors
    /// [`StoryError::UnknownMode`].
    pub fn keep_modes(&mut self, numbers: &[usize]) -> Result<(), StoryError> {
        if numbers.is_empty() {
            return Ok(());
        }
        let modes = &mut self.measured.modes;
        if let Some(&number) = numbers.iter().find(|number| modes.iter().all(|mode| mode.number != **number)) {
            let known: Vec<String> = modes.iter().map(|mode| mode.number.to_string()).collect();
            return Err(StoryError::UnknownMode { number, file: self.measured.file.clone(), known: known.join(", ") });
        }
        modes.retain(|mode| numbers.contains(&mode.number));
        Ok(())
    }

    /// Pairs of the measured modes with the model's.
    pub fn pairs(&self) -> Vec<Pair> {
        pair(&self.view, &self.measured.modes)
    }

    /// Model against measurement.
    pub fn compare(&self) -> Comparison {
        let comparison = compare(&self.view, &self.measured.modes, &self.sensors, self.tolerance.as_ref());
        self.tested(comparison, &self.model.effects)
    }

    /// A comparison with the test of a diagnosis in the place of its own, which takes the tolerance for linear: so all commands
    /// state one chi-squared of one model.
    fn tested(&self, mut comparison: Comparison, effects: &[Effect]) -> Comparison {
        self.parts.tell(&mut comparison);
        let problem = self.setting(&UNHEARD).ok().and_then(|setting| setting.problem_as_seen(effects).ok());
        let Some((test, allowed)) = problem.and_then(|problem| fit_as_given(&problem, effects)) else {
            return comparison;
        };
        let mut warnings = comparison.warnings;
        let wide = allowed.scatter_in_words().filter(|_| allowed.scatter > 1.0);
        let allowed: Vec<String> =
            [allowed.missed_in_words().map(|missed| format!("the model misses {missed} beyond its tolerance")), wide]
                .into_iter()
                .flatten()
                .collect();
        if !allowed.is_empty() {
            warnings.push(format!(
                "the test of fit takes it as given that {}, whatever the reason; `belfry diagnose` weighs that against effects that could be missing",
                allowed.join(" and ")
            ));
        }
        Comparison {
            warnings,
            chi_squared: Some(test.chi_squared),
            degrees_of_freedom: Some(test.degrees_of_freedom),
            p_value: Some(test.p_value),
            ..comparison
        }
    }

    /// The model with other effects against the measurement.
    ///
    /// # Errors
    /// When the structure cannot have these effects.
    pub fn compare_with(&self, effects: &[Effect]) -> Result<Comparison, StoryError> {
        let structure = self.model.bare().and(effects)?;
        let sensors = self.seen_sensors();
        let view = ModelView::of(&structure.assemble(), sensors)?;
        let tolerance = self.study.model.as_ref().and_then(|model| Tolerance::of(&structure, model));
        Ok(self.tested(compare(&view, &self.measured.modes, sensors, tolerance.as_ref()), effects))
    }

    /// Which effect the model lacks; kinds named in `without` are left out. `tally` hears how far it is.
    ///
    /// # Errors
    /// When the effects in the model cannot be fitted to these data.
    pub fn diagnose(&self, without: &[String], tally: &Tally) -> Result<Diagnosis, StoryError> {
        let effects = &self.model.effects;
        let options = Options { without: without.to_vec() };
        let setting = self.setting(tally)?;
        let mut diagnosis = diagnose(&setting.problem(effects)?, effects, &self.signals()?, &options)?;
        let Setting { bare, model, sensors, measured, .. } = setting;
        let (site, hours) = (Site { bare, model, effects, sensors }, self.record_hours());
        let planned = advice(&site, measured, &diagnosis, hours);
        diagnosis.next_measurement = planned.or(diagnosis.next_measurement);
        self.parts.tell_left(&mut diagnosis.unexplained);
        if let Some(partial) = &mut diagnosis.partial {
            self.parts.tell_left(&mut partial.unexplained);
            let planned = advice_beside(&site, measured, partial, hours);
            partial.next_measurement = planned.or(partial.next_measurement.take());
        }
        Ok(diagnosis)
    }

    /// Length of the record that the modes were identified from, where their file tells.
    fn record_hours(&self) -> Option<f64> {
        #[derive(Deserialize)]
        struct Record {
            record_s: f64,
        }
        let text = std::fs::read_to_string(&self.measured.file).ok()?;
        serde_json::from_str::<Record>(&text).ok().map(|record| record.record_s / 3600.0)
    }

    /// What a diagnosis and fits of effects start from.
    pub(super) fn setting<'a>(&'a self, tally: &'a Tally) -> Result<Setting<'a>, StoryError> {
        let model = section(&self.study)?;
        let (sensors, measured) = (self.seen_sensors(), &self.measured.modes);
        Ok(Setting { bare: &self.bare, model, sensors, measured, tally })
    }

    /// A comparison whose misfit is told by group where the structure is no tower.
    pub(crate) fn by_group_or_height(&self, mut comparison: Comparison) -> Comparison {
        self.parts.tell(&mut comparison);
        comparison
    }

    /// The sensors that take part: none where no shape was measured and they have no place.
    pub(crate) fn seen_sensors(&self) -> &[Sensor] {
        if self.view.at_sensors.nrows() == 0 { &[] } else { &self.sensors }
    }

    /// What identification has seen besides modes; nothing for modes of other tools.
    pub(super) fn signals(&self) -> Result<Signals, StoryError> {
        let file = &self.measured.file;
        if file.extension().is_none_or(|extension| extension != "json") {
            return Ok(Signals::default());
        }
        let unreadable = |source| MeasuredError::Unreadable { file: file.clone(), source };
        let text = std::fs::read_to_string(file).map_err(unreadable)?;
        // Another tool's JSON has modes only.
        Ok(serde_json::from_str(&text).unwrap_or_default())
    }

    /// Names of the effects that the study has in its model.
    pub fn effect_names(&self) -> Vec<String> {
        self.model.effects.iter().map(ToString::to_string).collect()
    }
}

/// Channels that see nothing of any motion of the model.
fn still_channels<'a>(assembly: &Assembly, sensors: &'a [Sensor]) -> Vec<&'a str> {
    let seen = assembly.sensor_rows(sensors);
    let is_still = |index: usize| seen.as_ref().is_ok_and(|rows| rows.row(index).iter().all(|share| *share == 0.0));
    sensors
        .iter()
        .enumerate()
        .filter(|(index, _)| is_still(*index))
        .map(|(_, sensor)| sensor.channel.as_str())
        .collect()
}

/// What the reader should know of a model that was read.
pub(super) fn model_warnings(
    study: &Study,
    model: &LoadedModel,
    assembly: &Assembly,
    sensors: &[Sensor],
) -> Vec<String> {
    let mut warnings = model.warnings.clone();
    let section = study.model.as_ref();
    let trusts = section.is_some_and(|model| model.background_stiffness.or(model.background_mass).is_some());
    if trusts && matches!(model.body, Body::Matrices(_)) {
        warnings.push(
            "[model] background_stiffness and background_mass scatter the segments of a beam table; matrices have none, so they are not used"
                .to_owned(),
        );
    }
    if let Some([mass, volume_m3]) = assembly.looks_like_tonnes() {
        let in_si = match model.body {
            Body::Beam(_) => "bring the table in N, m and kg, as its columns say",
            Body::Matrices(_) => {
                "export it in N, m and kg, or give every matrix of K and M the factor 1000, as in [[\"K\", 1000.0]]"
            }
        };
        warnings.push(format!(
            "the model weighs {mass:.3} kg in {volume_m3:.0} m³, a thousandth of what structures do: are its masses in t, and its forces in N with lengths in mm, or in kN with m? Frequencies are the same in such units, but masses and stiffnesses are not; {in_si}"
        ));
    }
    let is_imported = matches!(model.body, Body::Matrices(_));
    let still = if is_imported { still_channels(assembly, sensors) } else { Vec::new() };
    if !still.is_empty() {
        let (channels, stand) = match still.len() {
            1 => ("channel", "stands"),
            _ => ("channels", "stand"),
        };
        warnings.push(format!(
            "{channels} {} {stand} where the model cannot move, at a support or at a degree of freedom that is fixed: is that the right node and direction?",
            still.join(", ")
        ));
    }
    for BesideNode { channel, node, distance_m } in assembly.beside_nodes(sensors) {
        warnings.push(format!(
            "channel {channel} stands at no node of the model: the nearest, {node}, is {distance_m:.2} m away, and its motion is taken"
        ));
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

/// The modes that a study has, at the sensors of the same or of another study: those of `[measured]`, else what `belfry identify` has found.
///
/// # Errors
/// When there are none yet, or they cannot be read.
pub fn measured_modes(study: &Study, sensors: &[Sensor]) -> Result<MeasuredModes, StoryError> {
    if let Some(measured) = &study.measured {
        return Ok(read(&study.folder.join(&measured.modes), sensors)?);
    }
    let file = Results::of(study).path(MODES_FILE);
    if !file.exists() {
        return Err(StoryError::NotIdentified { file, study: study.folder.clone() });
    }
    let mut measured = read(&file, sensors)?;
    measured.warnings.extend(outdated(study, &file)?);
    Ok(measured)
}

/// Says where modes are older than what they were identified from.
pub(crate) fn outdated(study: &Study, file: &Path) -> Result<Option<String>, StoryError> {
    #[derive(Deserialize)]
    struct From {
        #[serde(default)]
        inputs: Inputs,
    }
    let from: Option<From> = Results::of(study).read_json(MODES_FILE, "identify")?;
    let now = Inputs::of(study);
    let changed = from.as_ref().map(|from| now.changed_since(&from.inputs)).unwrap_or_default();
    Ok((!changed.is_empty()).then(|| {
        format!(
            "{} is older than these changes: {}; run `belfry identify {}` again",
            file.display(),
            changed.join(", "),
            study.folder.display()
        )
    }))
}
