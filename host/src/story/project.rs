//! A study's folder, and the steps that are taken in it.

use std::path::{Path, PathBuf};
use std::time::Duration;

use super::case::Case;
use super::change::{AutoEnd, ChangeReport, add, add_until_nothing_gains, remove};
use super::covalidated::{CURVES_FILE, CovalidationReport, CovalidationRequest, covalidate};
use super::error::StoryError;
use super::identified::{Method, ModesReport, identify, interval_for_temperatures};
use super::inputs::{AllInputs, Inputs};
use super::looked::{LookReport, look};
use super::motion::curves_csv;
use super::planned::{PlanRequest, planned};
use super::profiled::{self, profiles};
use super::since::{SinceReport, SinceRequest, since};
use super::trends;
use super::updated::{UpdateReport, update};
use super::watched::{self, NodesReport, WatchReport, WatchRequest};
use crate::archive::TimeRange;
use crate::compare::Comparison;
use crate::diagnose::Diagnosis;
use crate::diagnose::steps::{Profiles, Step, StepRecord};
use crate::files::{FolderLock, write_anew, write_whole};
use crate::identify::accuracy::{Wish, record_needed};
use crate::measure::Route;
use crate::model::{Assembly, Body, Freedoms, Wireframe, matrix_market, npy, sparse_matrix_market};
use crate::page::{Finding, PageData, report};
use crate::picture::{self, SeenInSpace};
use crate::plan::Plan;
use crate::progress::{OnProgress, counted, rows_of};
use crate::results::{
    CHANGE_FILE, COMPARISON_FILE, COVALIDATION_FILE, DIAGNOSIS_FILE, FINGERPRINTS_FILE, FINGERPRINTS_PICTURE,
    INPUTS_FILE, LOOK_FILE, MODES_FILE, PLAN_FILE, PROFILE_FILE, RECORD_FILE, REPORT_FILE, Results, ResultsError,
    SPECTRA_FILE, STABILISATION_FILE, UPDATE_FILE, WATCH_FILE,
};
use crate::study::Study;
use crate::trend::follow;
use crate::update::Weights;
use crate::watch::NodeLimits;

/// A study's folder. Every step writes what it finds into the folder `results`, whole or not at all, and makes sure that it can
/// before it computes anything.
#[derive(Debug)]
pub struct Project {
    study: Study,
    results: Results,
    /// The model against the modes, once it was asked for.
    case: Option<Case>,
}

/// How modes are to be identified.
#[derive(Debug, Clone, PartialEq)]
pub struct IdentifyRequest {
    /// How recordings are read.
    pub route: Route,
    /// How modes are identified.
    pub method: Method,
    /// Follow the modes over intervals of this length. Where a setup has temperatures they are followed in any case.
    pub every: Option<Duration>,
    /// Say how long a record a wished accuracy takes.
    pub wish: Option<Wish>,
}

impl IdentifyRequest {
    /// By this route and both methods, and nothing else.
    pub fn by(route: Route) -> Self {
        Self { route, method: Method::default(), every: None, wish: None }
    }
}

/// A comparison and where it is drawn.
#[derive(Debug)]
pub struct Compared {
    /// The figures.
    pub comparison: Comparison,
    /// The picture; none where there is nothing to draw.
    pub picture: Option<PathBuf>,
}

impl Project {
    /// Opens a study by its folder, or by the path of its `study.toml`.
    ///
    /// # Errors
    /// When `study.toml` cannot be read, or says something that cannot be meant.
    pub fn open(study: &Path) -> Result<Self, StoryError> {
        let study = Study::load(study)?;
        Ok(Self { results: Results::of(&study), study, case: None })
    }

    /// What the study says.
    pub fn study(&self) -> &Study {
        &self.study
    }

    /// Has windows of a range of time analysed alone, where they were collected live.
    pub fn analyse_only(&mut self, range: TimeRange) {
        self.study.range = range;
    }

    /// Where results are.
    pub fn results(&self) -> &Results {
        &self.results
    }

    /// Looks at what was recorded; writes what it saw, and draws it.
    ///
    /// # Errors
    /// When no setup can be read, or results cannot be written.
    pub fn look(&self, on_progress: OnProgress<'_>) -> Result<(LookReport, PathBuf), StoryError> {
        self.results.make_ready()?;
        let report = look(&self.study, on_progress)?;
        let picture = picture::look(&self.study.structure.name, &report)?;
        self.results.write_json(LOOK_FILE, &report)?;
        let picture = self.results.write("look.svg", picture.as_bytes())?;
        Ok((report, picture))
    }

    /// The study's model and its measured modes.
    ///
    /// # Errors
    /// When there is no model or no modes, or they do not go together.
    pub fn case(&mut self) -> Result<&Case, StoryError> {
        let case = match self.case.take() {
            Some(case) => case,
            None => Case::load(self.study.clone())?,
        };
        Ok(self.case.insert(case))
    }

    /// The case with some of the measured modes only; all where none are named.
    fn case_of(&mut self, modes: &[usize]) -> Result<Case, StoryError> {
        let mut case = self.case()?.clone();
        case.keep_modes(modes)?;
        Ok(case)
    }

    /// Notes what a result was computed from.
    fn note(&self, result: &str, inputs: Inputs) -> Result<(), StoryError> {
        // Another command may note its own.
        let _lock = FolderLock::take(self.results.folder(), || {})
            .map_err(|source| ResultsError::Write { file: self.results.path(INPUTS_FILE), source })?;
        // Where the file is not what it should be, nothing is known of the others.
        let mut all: AllInputs = self.results.read_json(INPUTS_FILE, "diagnose").ok().flatten().unwrap_or_default();
        all.of_result.insert(result.to_owned(), inputs);
        self.results.write_json(INPUTS_FILE, &all)?;
        Ok(())
    }

    /// The study as it stands on disk now.
    fn reload(&mut self) -> Result<(), StoryError> {
        self.study = Study::load(&self.study.folder)?;
        self.case = None;
        Ok(())
    }

    /// Identifies the modes of the study's recordings. Writes `modes.json`, pictures, and `trends.csv` where modes are followed.
    ///
    /// # Errors
    /// When no recording can be read, or no modes are found; the picture of the singular values is written even then.
    pub fn identify(
        &mut self,
        request: &IdentifyRequest,
        on_progress: OnProgress<'_>,
    ) -> Result<ModesReport, StoryError> {
        self.results.make_ready()?;
        let followed_before = self.followed_before();
        let mut report = identify(&self.study, request.route, request.method, on_progress)?;
        let name = &self.study.structure.name;
        let picture = picture::singular_values(name, &self.study.setups, &report.identification)?;
        let picture = self.results.write("singular_values.svg", picture.as_bytes())?;
        if let Some(no_modes) = report.no_modes(picture, self.earlier_modes()) {
            return Err(no_modes);
        }
        if let Some(picture) = picture::stabilisation(name, &report.identification)? {
            self.results.write("stabilisation.svg", picture.as_bytes())?;
            let setups = &report.identification.stabilisation;
            self.results.write_json(STABILISATION_FILE, &serde_json::json!({ "setups": setups }))?;
        }
        report.record_needed = request.wish.map(|wish| record_needed(&report.identification, wish));
        self.results.write_json(MODES_FILE, &report)?;
        self.results.write_json_short(SPECTRA_FILE, &report.spectra)?;
        self.results.write_json_short(RECORD_FILE, &report.records)?;
        self.case = None;
        let drawn = match self.frame() {
            Some(frame) => picture::shapes_in_space(name, &frame, &self.study.sensors(), &report.identification)?,
            None => picture::mode_shapes(name, &self.study.setups, &report.identification, &[])?,
        };
        if let Some(picture) = drawn {
            self.results.write("mode_shapes.svg", picture.as_bytes())?;
        }
        if let Some(picture) = picture::fits(name, &self.study.setups, &report.identification)? {
            self.results.write("fits.svg", picture.as_bytes())?;
        }
        if let Some(every) = request.every.or_else(|| interval_for_temperatures(&self.study, &report)) {
            match self.follow(&mut report, every, request.route, on_progress) {
                // What was identified stays, also where it cannot be followed.
                Err(StoryError::Follow(error)) if request.every.is_none() => {
                    let warning = format!("the modes are identified, but cannot be followed: {error}");
                    report.identification.warnings.push(warning);
                }
                followed => followed?,
            }
            self.results.write_json(MODES_FILE, &report)?;
        } else if let Some(every_s) = followed_before {
            let every = humantime::format_duration(Duration::from_secs_f64(every_s));
            report.identification.warnings.push(format!(
                "the modes before were followed every {every}, these are not: `--every {every}` follows them"
            ));
            self.results.write_json(MODES_FILE, &report)?;
        }
        Ok(report)
    }

    /// Lines of a structure in space, where the study has some; whether the model can be used is asked where it is.
    pub(crate) fn frame(&self) -> Option<Wireframe> {
        Wireframe::read(self.study.model.as_ref()?, &self.study.folder).ok()?.filter(|frame| !frame.is_upright())
    }

    /// The interval at which the modes of an earlier run were followed.
    fn followed_before(&self) -> Option<f64> {
        let modes = self.results.read_json::<serde_json::Value>(MODES_FILE, "identify").ok()??;
        modes["trends"]["every_s"].as_f64().filter(|every_s| (1.0..1e9).contains(every_s))
    }

    /// The modes of an earlier run, which stay where none are found now.
    fn earlier_modes(&self) -> Option<PathBuf> {
        let file = self.results.path(MODES_FILE);
        file.exists().then_some(file)
    }

    /// Looks how the nodes of a live study are. Writes `watch_nodes.json`, and what has begun and ended into `alarms.jsonl`.
    ///
    /// # Errors
    /// When a result cannot be read or written.
    pub fn watch_nodes(&self, limits: &NodeLimits) -> Result<NodesReport, StoryError> {
        self.results.make_ready()?;
        watched::watch_nodes(&self.study, &self.results, limits)
    }

    /// Measures the intervals that are new, and judges from all days whether the structure has changed. Goes on where an earlier watch
    /// stopped. Writes `watch.json`, `watch.jsonl`, `alarms.jsonl` and a picture.
    ///
    /// # Errors
    /// When no modes were identified, recordings cannot be read, intervals have another length than before, or a result cannot be
    /// written.
    pub fn watch(
        &mut self,
        request: &WatchRequest,
        nodes: NodesReport,
        on_progress: OnProgress<'_>,
    ) -> Result<WatchReport, StoryError> {
        self.results.make_ready()?;
        let report = watched::watch(&mut self.study, &self.results, request, nodes, on_progress)?;
        self.results.write_json(WATCH_FILE, &report)?;
        let modes: Vec<(usize, f64)> =
            report.modes.iter().filter(|mode| mode.is_judged).map(|mode| (mode.number, mode.frequency_hz)).collect();
        if let Some(picture) = picture::watch(&self.study.structure.name, &modes, &report.judgement)? {
            self.results.write("watch.svg", picture.as_bytes())?;
        }
        Ok(report)
    }

    fn follow(
        &self,
        report: &mut ModesReport,
        every: Duration,
        route: Route,
        on_progress: OnProgress<'_>,
    ) -> Result<(), StoryError> {
        let found = &report.identification;
        let on_rows = &mut rows_of("intervals", on_progress);
        let trend = follow(&self.study, found, &report.grid, every.as_secs_f64(), route, on_rows);
        let trend = trend.map_err(StoryError::Follow)?;
        self.write_bytes("trends.csv", trends::csv(&trend))?;
        if let Some(picture) = picture::trends(&self.study.structure.name, &self.study.setups, &trend)? {
            self.results.write("trends.svg", picture.as_bytes())?;
        }
        report.trends = Some(trend);
        Ok(())
    }

    /// Writes what was made in memory.
    fn write_bytes(&self, name: &str, bytes: std::io::Result<Vec<u8>>) -> Result<PathBuf, ResultsError> {
        let bytes = bytes.map_err(|source| ResultsError::Write { file: self.results.path(name), source })?;
        self.results.write(name, &bytes)
    }

    /// Holds the model against the measured modes. Writes `comparison.json` and a picture.
    ///
    /// # Errors
    /// As [`Project::case`], or when a result cannot be written.
    pub fn compare(&mut self) -> Result<Compared, StoryError> {
        self.results.make_ready()?;
        let case = self.case()?;
        let comparison = case.compare();
        let (name, sensors, measured) = (&case.study.structure.name, &case.sensors, &case.measured.modes);
        let has_effects = !case.model.effects.is_empty();
        let (assembly, view) = (&case.assembly, &case.view);
        let picture = match &case.model.wireframe {
            Some(frame) if !assembly.is_line() && view.at_sensors.nrows() > 0 => {
                let seen = SeenInSpace { frame, assembly, view };
                picture::comparison_in_space(name, &seen, sensors, measured, &comparison, has_effects)?
            }
            _ => picture::comparison(name, assembly, view, sensors, measured, &comparison, has_effects)?,
        };
        self.results.write_json(COMPARISON_FILE, &comparison)?;
        let write = |picture: String| self.results.write("comparison.svg", picture.as_bytes());
        Ok(Compared { picture: picture.map(write).transpose()?, comparison })
    }

    /// Updates the stiffness matrix with the measured `modes` (all that have a partner where none are named). Writes
    /// `update.json` and the matrices; for a beam table also `nodes.csv`, for a model that is reduced the factors of what is added to K, and for
    /// one of modes none.
    ///
    /// # Errors
    /// As [`Project::case`], when no mode has a partner, or when a result cannot be written.
    pub fn update(&mut self, modes: &[usize], weights: &Weights) -> Result<UpdateReport, StoryError> {
        let inputs = Inputs::of_model(self.case()?);
        let case = self.case_of(modes)?;
        self.results.make_ready()?;
        let updated = update(&case, weights)?;
        let written: &[&str] = match case.model.structure()?.whole_matrices() {
            // K* of a large model is full; its factors are not.
            Some(whole) => {
                let momentum = &whole.mass * case.assembly.at_rows(&updated.matrices.used_shapes).as_ref();
                self.results.write("stiffness.mtx", sparse_matrix_market(&whole.stiffness).as_bytes())?;
                self.results.write("mass.mtx", sparse_matrix_market(&whole.mass).as_bytes())?;
                self.write_bytes("update_factor.npy", npy(&momentum))?;
                self.write_bytes("psi.npy", npy(&updated.matrices.psi))?;
                &["stiffness.mtx", "mass.mtx", "update_factor.npy", "psi.npy"]
            }
            None if case.model.freedoms() == Freedoms::Modes => &[],
            None => {
                let stiffness = &updated.matrices.stiffness;
                self.results.write("stiffness_updated.mtx", matrix_market(stiffness).as_bytes())?;
                self.write_bytes("stiffness_updated.npy", npy(stiffness))?;
                self.results.write("mass.mtx", matrix_market(&case.assembly.mass).as_bytes())?;
                &["stiffness_updated.mtx", "stiffness_updated.npy", "mass.mtx", "nodes.csv"]
            }
        };
        if matches!(case.model.body, Body::Beam(_)) {
            self.results.write("nodes.csv", nodes_csv(&case.assembly).as_bytes())?;
        }
        // What a model of another kind has left is of no use beside this one.
        for name in UPDATED_MATRICES.into_iter().filter(|name| !written.contains(name)) {
            self.results.remove(name)?;
        }
        self.results.write_json(UPDATE_FILE, &updated.report)?;
        self.note(UPDATE_FILE, inputs)?;
        Ok(updated.report)
    }

    /// Predicts channels that are left out from the others. Writes `covalidation.json`, the curves and a picture.
    ///
    /// # Errors
    /// As [`Project::case`], when a channel is unknown or cannot be predicted, or when a result cannot be written.
    pub fn covalidate(
        &mut self,
        request: &CovalidationRequest,
        on_progress: OnProgress<'_>,
    ) -> Result<CovalidationReport, StoryError> {
        let inputs = Inputs::of_model(self.case()?).for_result(COVALIDATION_FILE, &self.results);
        let case = self.case_of(&request.modes)?;
        self.results.make_ready()?;
        let covalidation = covalidate(&case, request, on_progress)?;
        self.results.write(CURVES_FILE, curves_csv(&covalidation.curves).as_bytes())?;
        let picture = picture::covalidation(&case.study.structure.name, &covalidation.curves)?;
        self.results.write("covalidation.svg", picture.as_bytes())?;
        self.results.write_json(COVALIDATION_FILE, &covalidation.report)?;
        self.note(COVALIDATION_FILE, inputs)?;
        Ok(covalidation.report)
    }

    /// Says which physical effect the model lacks; kinds named in `without` are left out. Writes `diagnosis.json`, and as
    /// figures what each candidate would do to every number measured, and as a picture those of the first.
    ///
    /// # Errors
    /// As [`Project::case`], or when the effects in the model cannot be fitted.
    pub fn diagnose(&mut self, without: &[String], on_progress: OnProgress<'_>) -> Result<Diagnosis, StoryError> {
        self.results.make_ready()?;
        let case = self.case()?;
        let inputs = Inputs::of_model(case);
        let diagnosis = counted(on_progress, |tally| case.diagnose(without, tally))?;
        self.results.write_json(DIAGNOSIS_FILE, &diagnosis)?;
        self.note(DIAGNOSIS_FILE, inputs)?;
        if let Some(fingerprints) = &diagnosis.fingerprints {
            self.results.write_json(FINGERPRINTS_FILE, fingerprints)?;
            let picture = picture::fingerprints(&self.study.structure.name, fingerprints)?;
            self.results.write(FINGERPRINTS_PICTURE, picture.as_bytes())?;
        }
        Ok(diagnosis)
    }

    /// Compares two measurements of the structure, and says with a model what has changed between them. Writes `change.json` and a
    /// picture, whose path is returned.
    ///
    /// # Errors
    /// When modes or the model cannot be read, sensors of the two differ, they have no mode in common, or a result cannot be written.
    pub fn since(&self, request: &SinceRequest) -> Result<(SinceReport, PathBuf), StoryError> {
        self.results.make_ready()?;
        let report = since(&self.study, request)?;
        self.results.write_json(CHANGE_FILE, &report)?;
        let height = report.height_m().zip(report.z_range_m);
        let predicted = report.diagnosis.as_ref().map_or(&[][..], |diagnosis| &diagnosis.predicted);
        let picture = picture::change(&self.study.structure.name, &report.changes.modes, predicted, height)?;
        Ok((report, self.results.write("change.svg", picture.as_bytes())?))
    }

    /// What the measurement says of the stiffness and mass of the model's segments, without and with its effects, and with one effect more
    /// (`KIND[@WHERE]`) where one is named; the study stays as it is. Writes `profile.json`, a table and a picture.
    ///
    /// # Errors
    /// As [`Project::case`], when the model has no segments or the study trusts them, or the effects cannot be fitted.
    pub fn profile(&mut self, with: Option<&str>, on_progress: OnProgress<'_>) -> Result<Profiles, StoryError> {
        self.results.make_ready()?;
        let case = self.case()?;
        let inputs = Inputs::of_model(case);
        let profiles = counted(on_progress, |tally| profiles(case, with, tally))?;
        self.results.write_json(PROFILE_FILE, &profiles)?;
        self.note(PROFILE_FILE, inputs)?;
        self.write_bytes("profile.csv", profiled::csv(&profiles))?;
        let picture = picture::profile(&self.study.structure.name, &profiles)?;
        self.results.write("profile.svg", picture.as_bytes())?;
        Ok(profiles)
    }

    /// Says before a measurement what it will show of an effect. Writes `plan.json`.
    ///
    /// # Errors
    /// As [`planned`], or when the result cannot be written.
    pub fn plan(&self, request: &PlanRequest, on_progress: OnProgress<'_>) -> Result<Plan, StoryError> {
        self.results.make_ready()?;
        let plan = planned(&self.study, request, on_progress)?;
        self.results.write_json(PLAN_FILE, &plan)?;
        Ok(plan)
    }

    /// Puts an effect (`KIND[@WHERE][=VALUE]`) into the model and refits all of them together, in `study.toml` and the history.
    ///
    /// # Errors
    /// When the effect cannot be added; nothing is changed then.
    pub fn add(&mut self, effect: &str, on_progress: OnProgress<'_>) -> Result<ChangeReport, StoryError> {
        self.results.make_ready()?;
        let case = self.case()?;
        let report = counted(on_progress, |tally| add(case, effect, tally))?;
        self.reload()?;
        Ok(report)
    }

    /// Takes an effect out of the model and refits the others, in `study.toml` and the history.
    ///
    /// # Errors
    /// When the model has no such effect, or the others cannot be refitted; nothing is changed then.
    pub fn remove(&mut self, effect: &str, on_progress: OnProgress<'_>) -> Result<ChangeReport, StoryError> {
        self.results.make_ready()?;
        let case = self.case()?;
        let report = counted(on_progress, |tally| remove(case, effect, tally))?;
        self.reload()?;
        Ok(report)
    }

    /// Adds and drops effects until nothing is gained, in `study.toml` and the history where together they explain the
    /// measurement. `on_step` hears of every step.
    ///
    /// # Errors
    /// When the effects in the model cannot be fitted, or the study cannot be written.
    pub fn add_until_nothing_gains(
        &mut self,
        without: &[String],
        on_progress: OnProgress<'_>,
        on_step: &mut (dyn FnMut(&Step) + Send),
    ) -> Result<AutoEnd, StoryError> {
        self.results.make_ready()?;
        let case = self.case()?;
        let end = counted(on_progress, |tally| add_until_nothing_gains(case, without, tally, on_step))?;
        if end == AutoEnd::Adopted {
            self.reload()?;
        }
        Ok(end)
    }

    /// Writes everything known of the study into one HTML file: `report.html` among the results, or the one that is named.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn report(&self, output: Option<&Path>) -> Result<WrittenReport, StoryError> {
        let data = PageData::of(&self.study);
        let file = output.map_or_else(|| self.results.path(REPORT_FILE), Path::to_path_buf);
        let failed = |source: std::io::Error| ResultsError::Write { file: file.clone(), source };
        let json = serde_json::to_string(&data).map_err(|error| failed(error.into()))?;
        let page = report(&format!("{}: report", self.study.structure.name), &json);
        if output.is_none() {
            self.results.make_ready()?;
        }
        // A path that the user names is the user's, a link too.
        let write = if output.is_some() { write_whole } else { write_anew };
        write(&file, page.as_bytes()).map_err(failed)?;
        Ok(WrittenReport { bytes: page.len(), findings: data.findings, file })
    }

    /// How the error fell, step by step. Draws `history.svg`.
    ///
    /// # Errors
    /// When nothing was added yet, or the history cannot be read.
    pub fn history(&self) -> Result<Vec<StepRecord>, StoryError> {
        let steps = self.results.history()?;
        if steps.is_empty() {
            return Err(StoryError::NoHistory { study: self.study.folder.clone() });
        }
        let picture = picture::history(&self.study.structure.name, &steps)?;
        self.results.write("history.svg", picture.as_bytes())?;
        Ok(steps)
    }
}

/// A report that was written.
#[derive(Debug)]
pub struct WrittenReport {
    /// The file.
    pub file: PathBuf,
    /// Its size.
    pub bytes: usize,
    /// The sentences that it begins with.
    pub findings: Vec<Finding>,
}

/// What an update writes beside its figures, of one kind of model or another.
const UPDATED_MATRICES: [&str; 7] = [
    "stiffness_updated.mtx",
    "stiffness_updated.npy",
    "mass.mtx",
    "nodes.csv",
    "stiffness.mtx",
    "update_factor.npy",
    "psi.npy",
];

/// A beam's nodes as `[model] matrices` reads them: the base first, whose rows are left out.
fn nodes_csv(assembly: &Assembly) -> String {
    let heights = std::iter::once(assembly.z_base_m()).chain(assembly.node_elevations_m());
    let lines = heights.zip(1..).map(|(z_m, node)| format!("{node},{z_m}\n"));
    std::iter::once("node,z_m\n".to_owned()).chain(lines).collect()
}
