//! All that a page shows of a study, gathered from its folder.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::findings::{Finding, Sources, findings};
use super::model::{Look, MODES_BEYOND, MacMatrix, ModelPart};
use super::packed::Packed;
use super::picks::Picks;
use super::says::{method, says};
use crate::archive::{Archive, NodeHealth};
use crate::compare::{Comparison, ModelView, compare, pair};
use crate::model::effect::{Effect, EffectRecord};
use crate::model::{Assembly, LayoutNode};
use crate::modes::as_reported;
use crate::results::{
    CHANGE_FILE, COMPARISON_FILE, COVALIDATION_FILE, DIAGNOSIS_FILE, FINGERPRINTS_FILE, INPUTS_FILE, MODES_FILE,
    PROFILE_FILE, RECORD_FILE, Results, SPECTRA_FILE, STABILISATION_FILE, UPDATE_FILE,
};
use crate::story::{
    AllInputs, CURVES_FILE, Case, EFFECTS, Inputs, StoryError, UpdateReport, data_mark, outdated, turned_by_update,
};
use crate::study::{Motion, STUDY_FILE, Sensor, Setup, Study, Unit};

/// What a page shows. Its parts are described beside the front end, in `host/page/README.md`.
#[derive(Debug, Clone, Serialize)]
pub struct PageData {
    belfry: Value,
    study: Value,
    /// Sentences, the most important first.
    pub findings: Vec<Finding>,
    /// Results that were computed from something else than what there is now, by their names, and why.
    pub stale: Map<String, Value>,
    modes: Value,
    picks: Picks,
    spectra: Value,
    stabilisation: Value,
    record: Value,
    model: Option<ModelSeen>,
    mac: Vec<MacMatrix>,
    comparison: Option<Comparisons>,
    update: Value,
    covalidation: Value,
    curves: Option<Curves>,
    diagnosis: Value,
    fingerprints: Value,
    profile: Value,
    history: Value,
    change: Value,
    nodes: Value,
    /// Sentences below the titles of pictures, by their names.
    says: Map<String, Value>,
    /// How it was done: sentences, and the commands that were run.
    method: Value,
}

/// The model as first given, and with its effects.
#[derive(Debug, Clone, Serialize)]
struct ModelSeen {
    effects: Vec<String>,
    /// The same with their values one by one.
    values: Vec<EffectRecord>,
    parts: Vec<ModelPart>,
}

#[derive(Debug, Clone, Serialize)]
struct Comparisons {
    given: Comparison,
    effects: Option<Comparison>,
}

/// Left-out channels, measured and predicted, over a stretch of the record.
#[derive(Debug, Clone, Serialize)]
struct Curves {
    start_s: f64,
    spacing_s: f64,
    points: usize,
    unit: &'static str,
    channels: Vec<Map<String, Value>>,
}

/// Significant digits of numbers on a page.
const DIGITS: i32 = 7;
/// The year 9999: what comes later has no such form.
const LATEST: Duration = Duration::from_secs(253_402_300_799);
/// Points of all left-out channels' curves together.
const CURVE_POINTS: usize = 24_000;

/// What every result has: a file without it is damaged, though it is JSON.
const PARTS: [(&str, &str); 10] = [
    (MODES_FILE, "modes"),
    (SPECTRA_FILE, "setups"),
    (STABILISATION_FILE, "setups"),
    (RECORD_FILE, "setups"),
    (UPDATE_FILE, "pairs"),
    (COVALIDATION_FILE, "channels"),
    (DIAGNOSIS_FILE, "verdict"),
    (FINGERPRINTS_FILE, "candidates"),
    (PROFILE_FILE, "as_given"),
    (CHANGE_FILE, "modes"),
];

/// Results that stand on a model and the measured modes, each with the command that makes it.
const OF_THE_MODEL: [(&str, &str, &str); 4] = [
    ("update", UPDATE_FILE, "update"),
    ("covalidation", COVALIDATION_FILE, "covalidate"),
    ("diagnosis", DIAGNOSIS_FILE, "diagnose"),
    ("profile", PROFILE_FILE, "profile"),
];

impl PageData {
    /// All that is known of a study. What was not computed is not there; what cannot be read is a warning.
    pub fn of(study: &Study) -> Self {
        let results = Results::of(study);
        let unread = RefCell::new(Vec::new());
        let note = |error: String| unread.borrow_mut().push(error);
        let file = |name: &str, step: &'static str| -> Value {
            match results.read_json::<Value>(name, step) {
                Ok(Some(object)) if !is_whole(name, &object) => {
                    note(format!("{} is damaged: run `belfry {step}` again", results.path(name).display()));
                    Value::Null
                }
                Ok(object) => object.map_or(Value::Null, rounded),
                Err(error) => {
                    note(error.to_string());
                    Value::Null
                }
            }
        };
        // Modes from elsewhere count; what was identified before has other numbers.
        let mut modes = if study.measured.is_some() { Value::Null } else { file(MODES_FILE, "identify") };
        if let Some(modes) = modes.get_mut("modes").and_then(Value::as_array_mut) {
            // As large as all else together, and drawn by nothing.
            for mode in modes.iter_mut().filter_map(Value::as_object_mut) {
                mode.remove("covariance_factor");
            }
        }
        let case = study.model.as_ref().map(|_| Case::load(study.clone()));
        let case = match case {
            Some(Ok(case)) => Some(case),
            // Before anything was identified there is nothing to compare, which is no fault.
            Some(Err(StoryError::NotIdentified { .. })) | None => None,
            Some(Err(error)) => {
                note(format!("the model cannot be compared with the modes: {error}"));
                None
            }
        };
        let inputs = case.as_ref().and_then(|_| {
            results.read_json(INPUTS_FILE, "diagnose").unwrap_or_else(|_| {
                note(format!(
                    "{} is damaged, so that nothing says whether results are of the model as it is now: run `belfry update`, `belfry covalidate`, `belfry diagnose` and `belfry profile` again",
                    results.path(INPUTS_FILE).display()
                ));
                None
            })
        });
        let AllInputs { of_result: inputs, .. } = inputs.unwrap_or_default();
        let present = case.as_ref().map(Inputs::of_model);
        let stale = case.as_ref().zip(present.as_ref()).map(|(case, now)| stale(case, now, &results, &inputs));
        let stale = stale.unwrap_or_default();
        // One of an earlier version has nothing to turn.
        let update: Option<UpdateReport> = results.read_json(UPDATE_FILE, "update").unwrap_or_default();
        let shown = update.as_ref().filter(|update| is_shown(update, present.as_ref(), inputs.get(UPDATE_FILE)));
        let seen = case.as_ref().and_then(|case| match Seen::of(case, shown) {
            Ok(seen) => Some(seen),
            Err(error) => {
                note(format!("the model cannot be drawn: {error}"));
                None
            }
        });
        if let (Value::Null, Some(case)) = (&modes, &case) {
            modes = published_modes(case);
        }
        results.history_damage().unwrap_or_default().into_iter().for_each(note);
        let steps = results.history().unwrap_or_else(|error| {
            note(error.to_string());
            Vec::new()
        });
        let steps: Vec<Value> = steps.iter().filter_map(|step| serde_json::to_value(step).ok()).collect();
        let history = rounded(Value::Array(steps));
        let (diagnosis, covalidation) = (file(DIAGNOSIS_FILE, "diagnose"), file(COVALIDATION_FILE, "covalidate"));
        let of_recordings = |name: &str| if study.measured.is_some() { Value::Null } else { file(name, "identify") };
        let [spectra, mut stabilisation, record] = [SPECTRA_FILE, STABILISATION_FILE, RECORD_FILE].map(of_recordings);
        let stabilisation = stabilisation.get_mut("setups").map(Value::take).unwrap_or_default();
        let (fingerprints, profile) = (file(FINGERPRINTS_FILE, "diagnose"), file(PROFILE_FILE, "profile"));
        let (update, change) = (file(UPDATE_FILE, "update"), file(CHANGE_FILE, "change"));
        let nodes = nodes(study).unwrap_or_else(|error| {
            note(error.to_string());
            Value::Null
        });
        let of_older = match outdated(study, &results.path(MODES_FILE)) {
            Ok(of_older) if study.measured.is_none() => of_older,
            _ => None,
        };
        let is_outdated = of_older.is_some();
        of_older.into_iter().for_each(note);
        let unread = unread.take();
        let comparison = seen.as_ref().map(|seen| seen.effects.as_ref().unwrap_or(&seen.given).1.clone());
        let sources = Sources {
            study,
            modes: &modes,
            comparison: comparison.as_ref(),
            diagnosis: &diagnosis,
            covalidation: &covalidation,
            history: &history,
            stale: &stale,
            is_outdated,
            has_windows: nodes.as_array().is_some_and(|nodes| !nodes.is_empty()),
            unread: &unread,
            warnings: case.as_ref().map_or(&[], |case| &case.warnings),
        };
        let findings = findings(&sources);
        let says = says(&sources, &spectra, &profile);
        let method = method(&sources, results.path(COMPARISON_FILE).exists(), &update, &profile);
        let (model, mac, comparison) = seen.map_or((None, Vec::new(), None), |seen| {
            let Seen { effects, given, mac, names, values } = seen;
            let (parts, comparisons) = match effects {
                Some((part, comparison)) => {
                    (vec![given.0, part], Comparisons { given: given.1, effects: Some(comparison) })
                }
                None => (vec![given.0], Comparisons { given: given.1, effects: None }),
            };
            (Some(ModelSeen { effects: names, values, parts }), mac, Some(comparisons))
        });
        Self {
            belfry: json!({ "version": env!("CARGO_PKG_VERSION"), "written": now() }),
            study: study_value(study),
            findings,
            stale,
            picks: Picks::of(study, &modes),
            modes,
            spectra,
            stabilisation,
            record,
            model,
            mac,
            comparison,
            update,
            curves: if covalidation.is_null() { None } else { curves(study, &results.path(CURVES_FILE)) },
            covalidation,
            diagnosis,
            fingerprints,
            profile,
            history,
            change,
            nodes,
            says,
            method,
        }
    }
}

/// A model with other effects than the study's, as the page draws it; nothing is written.
#[derive(Debug, Clone, Serialize)]
pub struct Tried {
    /// The model.
    pub model: ModelPart,
    /// Its MAC with what was measured.
    pub mac: Option<MacMatrix>,
    /// How it compares.
    pub comparison: Comparison,
}

impl Tried {
    /// Of these effects.
    ///
    /// # Errors
    /// When the structure cannot have them.
    pub fn of(case: &Case, effects: &[Effect]) -> Result<Self, StoryError> {
        let structure = case.model.bare().and(effects)?;
        let assembly = structure.assemble();
        let view = case.view_of(&assembly, MODES_BEYOND)?;
        // Without a test: that of a diagnosis would take longer than a slider waits, and another is not to be compared with it.
        let comparison = case.by_group_or_height(Comparison {
            chi_squared: None,
            degrees_of_freedom: None,
            p_value: None,
            ..compare(&view, &case.measured.modes, case.seen_sensors(), case.tolerance.as_ref())
        });
        let model = part("effects", case, &assembly, &structure.layout(), &view);
        Ok(Self { mac: mac_of("effects", case, &view), model, comparison })
    }
}

/// What a model and its measured modes give to be seen.
struct Seen {
    given: (ModelPart, Comparison),
    effects: Option<(ModelPart, Comparison)>,
    mac: Vec<MacMatrix>,
    names: Vec<String>,
    values: Vec<EffectRecord>,
}

impl Seen {
    fn of(case: &Case, update: Option<&UpdateReport>) -> Result<Self, StoryError> {
        let bare = case.model.bare();
        let assembly = bare.assemble();
        let view = ModelView::of(&assembly, case.seen_sensors())?;
        // Both comparisons look for the discrepancy that suits the model, which takes longer than all else.
        let has_effects = !case.model.effects.is_empty();
        let (given, with_effects) = rayon::join(|| case.compare_with(&[]), || has_effects.then(|| case.compare()));
        let given = (part("given", case, &assembly, &bare.layout(), &view), given?);
        let mut mac: Vec<MacMatrix> = mac_of("given", case, &view).into_iter().collect();
        let turned = update.and_then(|update| turned_by_update(case, &view, update).ok());
        mac.extend(turned.and_then(|(used, shapes)| {
            let columns = shapes.column_iter().map(|shape| shape.iter().copied().collect()).collect::<Vec<Vec<f64>>>();
            let numbered = used.iter().zip(&columns).map(|(model, shape)| (model + 1, shape.as_slice()));
            // The other modes have no shape after it.
            let numbers: Vec<usize> =
                update.into_iter().flat_map(|update| &update.pairs).map(|pair| pair.measured).collect();
            let modes = case.measured.modes.iter().filter(|mode| numbers.contains(&mode.number)).cloned();
            MacMatrix::of("updated", numbered, &modes.collect::<Vec<_>>())
        }));
        let effects = match with_effects {
            None => None,
            Some(comparison) => {
                mac.extend(mac_of("effects", case, &case.view));
                let layout = case.model.structure()?.layout();
                Some((part("effects", case, &case.assembly, &layout, &case.view), comparison))
            }
        };
        let in_model = &case.model.effects;
        let (names, values) = in_model.iter().map(|effect| (effect.typed(), effect.record())).unzip();
        Ok(Self { given, effects, mac, names, values })
    }
}

/// A version of the model.
fn part(name: &'static str, case: &Case, assembly: &Assembly, layout: &[LayoutNode], view: &ModelView) -> ModelPart {
    let measured = &case.measured.modes;
    let look = Look { layout, frame: case.model.wireframe.as_ref() };
    ModelPart::of(name, assembly, look, view, &pair(view, measured), measured)
}

/// MAC with the modes up to the highest that has a partner.
fn mac_of(what: &'static str, case: &Case, view: &ModelView) -> Option<MacMatrix> {
    let highest = pair(view, &case.measured.modes).iter().map(|pair| pair.model + 1).max()?;
    MacMatrix::of(what, (0..highest).map(|model| (model + 1, view.shape(model))), &case.measured.modes)
}

/// Modes that another tool has identified, as `modes.json` has them.
fn published_modes(case: &Case) -> Value {
    let modes = as_reported(&case.measured.modes, &case.sensors);
    rounded(json!({ "modes": modes, "harmonics": [], "rejected": [], "warnings": [] }))
}

fn study_value(study: &Study) -> Value {
    let folder = crate::command::in_shell(&study.folder);
    let sensor = |sensor: &Sensor| {
        json!({
            "channel": sensor.channel,
            "node": sensor.node,
            "elevation_m": sensor.elevation_m,
            "offset_m": sensor.offset_m,
            // How an axis leans or a fibre stretches is no motion of a point.
            "direction": sensor.direction.filter(|_| sensor.is_of_a_point()).map(|direction| direction.cosines()),
        })
    };
    let setups = study.setups.iter().map(|setup| {
        json!({
            "name": setup.name,
            "sampling_rate_hz": setup.sampling_rate_hz,
            "unit": unit(setup.unit),
            "live": setup.live,
            "files": setup.files,
            "channels": setup.sensors.iter().map(|sensor| &sensor.channel).collect::<Vec<_>>(),
        })
    });
    json!({
        "name": study.structure.name,
        "folder": folder,
        // A study that was read a moment ago; where it cannot be read again, the page does without its text.
        "toml": std::fs::read_to_string(study.folder.join(STUDY_FILE)).unwrap_or_default(),
        "has_model": study.model.is_some(),
        "setups": setups.collect::<Vec<Value>>(),
        "sensors": study.sensors().iter().map(sensor).collect::<Vec<Value>>(),
    })
}

fn unit(unit: Unit) -> &'static str {
    match unit {
        Unit::MetrePerSecondSquared => "m/s²",
        Unit::StandardGravity => "g",
        Unit::Volt => "V",
        Unit::MetrePerSecond => "m/s",
        Unit::Metre => "m",
        Unit::Radian => "rad",
        Unit::Strain => "1",
    }
}

/// How nodes have served, where windows were collected.
fn nodes(study: &Study) -> Result<Value, StoryError> {
    if !study.setups.iter().any(|setup| setup.live) {
        return Ok(Value::Null);
    }
    let Some(archive) = Archive::open(&study.folder)? else { return Ok(Value::Null) };
    let health = archive.health()?;
    let channels = |one: &NodeHealth| -> Vec<&str> {
        let setup = study.setups.iter().find(|setup| setup.name == one.setup);
        let sensors = setup.into_iter().flat_map(|setup| &setup.sensors).filter(|sensor| sensor.node == one.node);
        sensors.map(|sensor| sensor.channel.as_str()).collect()
    };
    let nodes = health.iter().map(|one| {
        json!({
            "node": one.node,
            "setup": one.setup,
            "channels": channels(one),
            "windows": one.windows,
            "lost_windows": one.lost_windows,
            "bad_windows": one.bad_windows,
            "restarts": one.restarts,
            "last_window": iso(Duration::from_secs_f64(one.last_received_s.max(0.0))),
        })
    });
    Ok(Value::Array(nodes.collect()))
}

/// Whether an update is of a model that is shown: of the one as it is, or, where effects alone have changed since, of the one as given.
fn is_shown(update: &UpdateReport, now: Option<&Inputs>, then: Option<&Inputs>) -> bool {
    let changed = now.zip(then).map(|(now, then)| now.changed_since(then)).unwrap_or_default();
    changed.is_empty() || update.effects.is_empty() && changed == [EFFECTS]
}

/// Results that were computed from something else than what there is now. Of those of an earlier version nothing is known.
fn stale(case: &Case, now: &Inputs, results: &Results, then: &BTreeMap<String, Inputs>) -> Map<String, Value> {
    let mut stale = Map::new();
    for (what, file, command) in OF_THE_MODEL {
        let Some(then) = then.get(file).filter(|_| results.path(file).exists()) else { continue };
        let now = now.clone().for_result(file, results);
        let changed = now.changed_since(then);
        if !changed.is_empty() {
            let sentence = format!("{} changed since: run `belfry {command}` again", changed.join(" and "));
            stale.insert(what.to_owned(), Value::from(sentence));
        }
    }
    // A history says itself what it is of.
    let last = results.history().ok().and_then(|mut steps| steps.pop()).filter(|step| !step.data.is_empty());
    if last.is_some_and(|step| data_mark(case).is_ok_and(|now| now != step.data)) {
        let sentence = "the measured modes or the model's tables changed since: run `belfry add` or `belfry remove`, which begin it anew";
        stale.insert("history".to_owned(), Value::from(sentence));
    }
    stale
}

/// Whether a result has what every one of its kind has.
fn is_whole(name: &str, object: &Value) -> bool {
    let part = PARTS.iter().find(|(file, _)| *file == name);
    // Nobody has asked for fingerprints where there is nothing to show.
    let is_empty = object.is_null() && name == FINGERPRINTS_FILE;
    is_empty || part.map_or(!object.is_null(), |(_, part)| object.get(part).is_some_and(|part| !part.is_null()))
}

/// Numbers to the digits that a page needs: the last ten are noise, and half of the file.
fn rounded(value: Value) -> Value {
    match value {
        Value::Number(number) => match number.as_f64().filter(|_| number.is_f64()) {
            Some(float) if float != 0.0 => {
                let digits = DIGITS - 1 - float.abs().log10().floor() as i32;
                // Far from one, a power of ten overflows.
                let round = |float: f64| format!("{float:.*e}", DIGITS as usize - 1).parse().unwrap_or(float);
                let short = if (0..=15).contains(&digits) {
                    let factor = 10_f64.powi(digits);
                    (float * factor).round() / factor
                } else {
                    round(float)
                };
                Value::from(short)
            }
            _ => Value::Number(number),
        },
        Value::Array(values) => Value::Array(values.into_iter().map(rounded).collect()),
        Value::Object(object) => Value::Object(object.into_iter().map(|(key, value)| (key, rounded(value))).collect()),
        other => other,
    }
}

/// The curves of left-out channels over the stretch in which the first of them moves most; `None` where there are none.
fn curves(study: &Study, file: &Path) -> Option<Curves> {
    let mut reader = csv::Reader::from_path(file).ok()?;
    let header: Vec<String> = reader.headers().ok()?.iter().map(str::to_owned).collect();
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); header.len()];
    for record in reader.records() {
        let record = record.ok()?;
        for (column, cell) in columns.iter_mut().zip(&record) {
            column.push(fast_float2::parse(cell).unwrap_or(f64::NAN));
        }
    }
    let (time_s, first) = (columns.first()?, columns.get(1)?);
    let spacing_s = time_s.get(1)? - time_s.first()?;
    let names: Vec<&str> = header.iter().filter_map(|name| name.strip_suffix("_measured")).collect();
    let points = (CURVE_POINTS / names.len().max(1)).min(time_s.len());
    let power = |from: usize| -> f64 {
        first[from..from + points].iter().filter(|value| value.is_finite()).map(|value| value * value).sum()
    };
    let starts = (0..=time_s.len() - points).step_by((points / 4).max(1));
    let from = starts.max_by(|a, b| power(*a).total_cmp(&power(*b)))?;
    let has = |setup: &&Setup| setup.sensors.iter().any(|sensor| Some(&sensor.channel.as_str()) == names.first());
    let setup = study.setups.iter().find(has);
    let channel = |name: &&str| -> Map<String, Value> {
        let of = |label: &str| {
            let index = header.iter().position(|column| *column == format!("{name}_{label}"))?;
            let packed = Packed::fine(columns[index][from..from + points].iter().copied());
            Some((label.to_owned(), serde_json::to_value(packed).ok()?))
        };
        let labels = ["measured", "model", "updated", "with_effects", "measured_shapes"];
        let named = ("channel".to_owned(), Value::from(*name));
        std::iter::once(named).chain(labels.into_iter().filter_map(of)).collect()
    };
    Some(Curves {
        start_s: time_s[from],
        spacing_s,
        points,
        unit: setup.map_or(Motion::Acceleration, Setup::motion).unit(),
        channels: names.iter().map(channel).collect(),
    })
}

/// The time now, to a second, as ISO 8601 has it.
fn now() -> String {
    iso(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default())
}

/// A time since the Unix epoch.
fn iso(since: Duration) -> String {
    humantime::format_rfc3339_seconds(UNIX_EPOCH + since.min(LATEST)).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_seven_digits_whatever_their_size() {
        for (there, back) in [
            (1.0 / 3.0, 0.333_333_3),
            (-123_456_789.5, -123_456_800.0),
            (6.543_210_987e-14, 6.543_211e-14),
            (1e300 / 3.0, 3.333_333e299),
            (0.0, 0.0),
        ] {
            let Value::Number(short) = rounded(json!(there)) else { panic!() };
            let short = short.as_f64().unwrap();
            assert!((short - back).abs() <= 1e-9 * back.abs(), "{there}: {short}");
        }
        assert_eq!(rounded(json!({ "a": [123_456_789, null, "x"] })), json!({ "a": [123_456_789, null, "x"] }));
    }
}
