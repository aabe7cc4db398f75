//! The steps of a study, as `belfry_host::story` takes them.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, anyhow};
use belfry_host::fleet::FleetOptions;
use belfry_host::identify::accuracy::{Wish, record_needed};
use belfry_host::model::effect;
use belfry_host::modes::as_reported;
use belfry_host::progress::OnProgress;
use belfry_host::results::{MODES_FILE, Versioned};
use belfry_host::story::{self, IdentifyRequest, Method, Project, Route};
use belfry_host::study::{Direction, Study};
use belfry_host::update::Weights;
use pyo3::prelude::*;
use pythonize::{depythonize, pythonize};
use serde::Serialize;
use serde_json::{Value, json};

use crate::caller::{exception, open_alone, work, wrong_argument};

/// Who hears of progress.
type Listener = Option<Py<PyAny>>;

/// Belfry's version.
#[pyfunction]
pub(crate) fn version() -> &'static str {
    env!("CARGO_PKG_VERSION")
}

/// A report as Python objects: those of its JSON, so that numbers which are not known are `None`.
fn in_python<'py>(py: Python<'py>, report: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(pythonize(py, report)?)
}

/// What the program prints with `--json`.
fn as_json(schema: &'static str, report: &impl Serialize) -> anyhow::Result<Value> {
    serde_json::to_value(Versioned::new(schema, report)).context("the report cannot be passed to Python")
}

/// Takes one step of a study.
fn step<'py>(
    py: Python<'py>,
    path: &Path,
    on_progress: Listener,
    step: impl FnOnce(&mut Project, OnProgress<'_>) -> anyhow::Result<Value> + Send,
) -> PyResult<Bound<'py, PyAny>> {
    let report = work(py, on_progress, |on_progress| {
        let (mut project, _lock) = open_alone(path, on_progress)?;
        step(&mut project, on_progress)
    })?;
    in_python(py, &report)
}

/// What a study is: its folder, the structure's name, and the sensors.
#[pyfunction]
pub(crate) fn study<'py>(py: Python<'py>, path: PathBuf) -> PyResult<Bound<'py, PyAny>> {
    let report = work(py, None, |_| {
        let study = Study::load(&path)?;
        let sensors = study.sensors().into_iter().map(|sensor| {
            let direction = sensor.direction.map(Direction::cosines);
            json!({
                "channel": sensor.channel,
                "point": sensor.point,
                "elevation_m": sensor.elevation_m,
                "direction": direction,
            })
        });
        let sensors: Vec<Value> = sensors.collect();
        Ok(json!({ "folder": study.folder, "name": study.structure.name, "sensors": sensors }))
    })?;
    in_python(py, &report)
}

fn method(name: &str) -> PyResult<Method> {
    match name {
        "both" => Ok(Method::Both),
        "spectra" => Ok(Method::Spectra),
        "subspace" => Ok(Method::Subspace),
        _ => Err(wrong_argument(format!("method: expected 'both', 'spectra' or 'subspace', found {name:?}"))),
    }
}

/// `belfry identify`.
#[pyfunction]
pub(crate) fn identify<'py>(
    py: Python<'py>,
    path: PathBuf,
    direct: bool,
    method: &str,
    every_s: Option<f64>,
    on_progress: Listener,
) -> PyResult<Bound<'py, PyAny>> {
    let every = every_s
        .map(Duration::try_from_secs_f64)
        .transpose()
        .ok()
        .filter(|every| every.is_none_or(|every| every >= Duration::from_secs(1)));
    let every = every.ok_or_else(|| wrong_argument("every_s: expected a second at least".to_owned()))?;
    let route = if direct { Route::Direct } else { Route::Nodes(FleetOptions::default()) };
    let request = IdentifyRequest { route, method: self::method(method)?, every, wish: Some(Wish::default()) };
    step(py, &path, on_progress, |project, on_progress| {
        as_json("identify-1", &project.identify(&request, on_progress)?)
    })
}

/// The modes of a recording in `folder`, of which `document` says what study.toml says of one. Nothing is written.
#[pyfunction]
pub(crate) fn identify_recording<'py>(
    py: Python<'py>,
    document: &Bound<'py, PyAny>,
    folder: PathBuf,
    method: &str,
    on_progress: Listener,
) -> PyResult<Bound<'py, PyAny>> {
    let document: toml::Table = depythonize(document)?;
    let method = self::method(method)?;
    let report = work(py, on_progress, |on_progress| {
        let text = toml::to_string(&document).context("the arguments cannot be written as study.toml")?;
        // Without the folder: errors name a study.toml that nobody has written.
        let mut study = Study::from_text(&text, Path::new(""))
            .context("an argument is not what it must be, in the words of a study.toml")?;
        study.folder = folder;
        let mut report = story::identify(&study, Route::Direct, method, on_progress)?;
        if let Some(reason) = report.why_no_modes() {
            return Err(anyhow!("no modes were found: {reason}"));
        }
        report.record_needed = Some(record_needed(&report.identification, Wish::default()));
        as_json("identify-1", &report)
    })?;
    in_python(py, &report)
}

/// The modes that a study has, which are checked: the file with the report of `belfry identify`, which Python reads to the last bit, or of modes
/// by another program what is known of them; and what the reader should know.
#[pyfunction]
pub(crate) fn modes<'py>(py: Python<'py>, path: PathBuf) -> PyResult<Bound<'py, PyAny>> {
    let report = work(py, None, |_| {
        let project = Project::open(&path)?;
        let (study, sensors) = (project.study(), project.study().sensors());
        let measured = story::measured_modes(study, &sensors)?;
        let (file, report) = match study.measured {
            Some(_) => (None, Some(json!({ "modes": as_reported(&measured.modes, &sensors), "warnings": [] }))),
            None => (Some(project.results().path(MODES_FILE)), None),
        };
        Ok(json!({ "file": file, "report": report, "warnings": measured.warnings }))
    })?;
    in_python(py, &report)
}

/// `belfry compare`.
#[pyfunction]
pub(crate) fn compare<'py>(py: Python<'py>, path: PathBuf, on_progress: Listener) -> PyResult<Bound<'py, PyAny>> {
    step(py, &path, on_progress, |project, _| as_json("compare-1", &project.compare()?.comparison))
}

/// `belfry update`.
#[pyfunction]
pub(crate) fn update<'py>(
    py: Python<'py>,
    path: PathBuf,
    modes: Vec<usize>,
    frequency_weight: f64,
    shape_weights: Vec<f64>,
    on_progress: Listener,
) -> PyResult<Bound<'py, PyAny>> {
    let weights = shape_weights.iter().chain([&frequency_weight]);
    if shape_weights.is_empty() || !weights.into_iter().all(|weight| weight.is_finite() && *weight > 0.0) {
        return Err(wrong_argument("frequency_weight, shape_weights: expected numbers above 0".to_owned()));
    }
    let weights = Weights { frequency: frequency_weight, shape: shape_weights };
    step(py, &path, on_progress, |project, _| as_json("update-1", &project.update(&modes, &weights)?))
}

/// `belfry diagnose`.
#[pyfunction]
pub(crate) fn diagnose<'py>(
    py: Python<'py>,
    path: PathBuf,
    without: Vec<String>,
    on_progress: Listener,
) -> PyResult<Bound<'py, PyAny>> {
    for kind in &without {
        effect::find(kind).map_err(|error| exception(&error.into()))?;
    }
    step(py, &path, on_progress, |project, on_progress| {
        as_json("diagnose-1", &project.diagnose(&without, on_progress)?)
    })
}

/// `belfry add`.
#[pyfunction]
pub(crate) fn add<'py>(
    py: Python<'py>,
    path: PathBuf,
    effect: String,
    on_progress: Listener,
) -> PyResult<Bound<'py, PyAny>> {
    step(py, &path, on_progress, |project, on_progress| as_json("add-1", &project.add(&effect, on_progress)?))
}
