//! What a study has shown, in plain sentences, the most important first.
//!
//! What commands have written, and the comparison as it stands, flow in; a sentence for each finding, warning and next step flows out.

use serde::Serialize;
use serde_json::{Map, Value};

use crate::compare::Comparison;
use crate::diagnose::FAILS;
use crate::numbers::{is_or_are, mac_words, metres, signed, with_std};
use crate::study::Study;

/// A sentence.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What it is.
    pub kind: Kind,
    /// The sentence.
    pub text: String,
    /// A command that it asks for, without `belfry` and the study.
    pub command: Option<String>,
}

/// What a sentence is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// What was found.
    Finding,
    /// A warning.
    Warning,
    /// What to do next.
    Next,
}

/// What findings are made of.
#[derive(Clone, Copy)]
pub(super) struct Sources<'a> {
    pub(super) study: &'a Study,
    pub(super) modes: &'a Value,
    pub(super) comparison: Option<&'a Comparison>,
    pub(super) diagnosis: &'a Value,
    pub(super) covalidation: &'a Value,
    pub(super) history: &'a Value,
    pub(super) stale: &'a Map<String, Value>,
    /// Whether the modes are older than what they were identified from.
    pub(super) is_outdated: bool,
    /// Whether anything has come from nodes.
    pub(super) has_windows: bool,
    /// What cannot be read, and why.
    pub(super) unread: &'a [String],
    /// Of the model and the modes.
    pub(super) warnings: &'a [String],
}

/// All sentences.
pub(super) fn findings(sources: &Sources<'_>) -> Vec<Finding> {
    let say = |kind: Kind| move |text: String| Finding { kind, text, command: None };
    let found = [verdict(sources), fall(sources), compared(sources), identified(sources), predicted(sources)];
    let mut all: Vec<Finding> = found.into_iter().flatten().map(say(Kind::Finding)).collect();
    let cannot = sources.unread.iter().cloned().map(sentence);
    let stale = stale(sources.stale);
    let of = |value: &Value| strings(value.get("warnings"));
    let current = |what: &str, value| if sources.stale.contains_key(what) { Vec::new() } else { of(value) };
    let from_files = of(sources.modes)
        .into_iter()
        .chain(current("diagnosis", sources.diagnosis))
        .chain(current("covalidation", sources.covalidation));
    let of_case =
        sources.comparison.map_or(&[][..], |comparison| &comparison.warnings).iter().chain(sources.warnings).cloned();
    let mut warned: Vec<String> = Vec::new();
    for warning in cannot.into_iter().chain(stale).chain(from_files.chain(of_case).map(sentence)) {
        if !warned.contains(&warning) {
            warned.push(warning);
        }
    }
    all.extend(warned.into_iter().map(say(Kind::Warning)));
    all.extend(next(sources));
    all
}

/// What is of an older state: results of which the same has changed in one sentence.
fn stale(stale: &Map<String, Value>) -> Vec<String> {
    let mut causes: Vec<(&str, Vec<&str>)> = Vec::new();
    for (what, why) in stale {
        let cause = why.as_str().and_then(|why| why.split_once(": run")).map_or("something", |(cause, _)| cause);
        match causes.iter_mut().find(|(known, _)| *known == cause) {
            Some((_, of)) => of.push(what),
            None => causes.push((cause, vec![what])),
        }
    }
    let sentence = |(cause, of): (&str, Vec<&str>)| {
        let names: Vec<String> = of.into_iter().map(str::to_owned).collect();
        let is_are = is_or_are(names.len() as u64);
        format!("{} {is_are} of an older state: {cause}.", capital(&listed(&names)))
    };
    causes.into_iter().map(sentence).collect()
}

/// What the diagnosis says.
fn verdict(sources: &Sources<'_>) -> Option<String> {
    let diagnosis = sources.diagnosis.as_object().filter(|_| !sources.stale.contains_key("diagnosis"))?;
    let probability = |name: &str| -> Option<f64> {
        let candidates = diagnosis.get("candidates")?.as_array()?.iter();
        candidates.filter(|one| name_of(one).as_deref() == Some(name)).find_map(|one| one.get("probability")?.as_f64())
    };
    let p_value = |test: &str| diagnosis.get(test)?.get("p_value")?.as_f64();
    let missed = |size: &str| diagnosis.get("discrepancy").and_then(|sizes| sizes.get(size)).and_then(Value::as_f64);
    let misses_more =
        ["frequency", "family", "shape", "smooth"].iter().any(|size| missed(size).is_some_and(|size| size > 0.0));
    let in_percent = |probability: f64| match 100.0 * probability {
        sure if sure > 99.0 => "more than 99 %".to_owned(),
        percent => format!("{percent:.0} %"),
    };
    Some(match diagnosis.get("verdict")?.as_str()? {
        "adequate" if p_value("present").is_some_and(|p_value| p_value < FAILS) => {
            "The model misses more than its tolerance says, but no effect accounts for that.".to_owned()
        }
        "adequate" if misses_more => {
            "The model explains the measurement within its tolerance and what it misses besides; no effect is called for.".to_owned()
        }
        "adequate" => "The model explains the measurement within its tolerance; no effect is called for.".to_owned(),
        "effect" => {
            let best = strings(diagnosis.get("best")).first()?.clone();
            // A diagnosis of before it was added, which an earlier version wrote.
            if has(sources.study, &best) {
                return None;
            }
            match probability(&best) {
                Some(known) => format!("The model lacks {best}, with a probability of {}.", in_percent(known)),
                None => format!("The model lacks {best}."),
            }
        }
        "ambiguous" => {
            let groups = diagnosis.get("ambiguous")?.as_array()?.iter();
            let names: Vec<String> = groups.flat_map(|group| strings(Some(group))).collect();
            format!("The model lacks an effect, and this measurement cannot tell which of these: {}.", names.join(", "))
        }
        _ => {
            let partial = diagnosis.get("partial").and_then(|partial| partial.get("effects")).and_then(Value::as_array);
            let names: Vec<String> = partial.into_iter().flatten().filter_map(name_of).collect();
            let lead = if names.is_empty() {
                String::new()
            } else {
                format!(" What explains most of it, as a lead and no finding: {}.", names.join(", "))
            };
            format!("No single effect of the catalogue explains where the model fails.{lead}")
        }
    })
}

/// How far the error fell.
fn fall(sources: &Sources<'_>) -> Option<String> {
    let steps = sources.history.as_array()?;
    let last = steps.last()?;
    // Steps of one measurement can be compared.
    let first = steps.iter().find(|step| step.get("data") == last.get("data"))?;
    let effects = strings(last.get("effects"));
    // A step of another model, or one that began with effects, says nothing of those that are in it now.
    let now = sources.study.model.as_ref().map_or(0, |model| model.effects.len());
    let is_of_now = effects.iter().all(|effect| has(sources.study, effect));
    let is_older = sources.is_outdated || sources.stale.contains_key("history");
    if is_older || !is_of_now || now != effects.len() || !strings(first.get("effects")).is_empty() {
        return None;
    }
    let error = |step: &Value, key: &str| step.get(key)?.as_f64();
    let pair = |key: &str| error(first, key).zip(error(last, key));
    let (before, after) = pair("mean_abs_frequency_error_percent")?;
    if effects.is_empty() || first == last {
        return None;
    }
    let left_out = pair("held_out_error_percent").map_or_else(String::new, |(before, after)| {
        format!(", that at sensors which were left out of the fit from {before:.1} to {after:.1} %")
    });
    let moved = if after < before { "fell" } else { "went" };
    let values = last.get("joint").and_then(|joint| joint.get("values")).and_then(Value::as_array);
    let value_of = |effect: &String| {
        let of = |value: &&Value| value.get("effect").and_then(Value::as_str) == Some(effect.as_str());
        let mut known = values.into_iter().flatten().filter(of);
        let (first, None) = (known.next()?, known.next()) else { return None };
        let number = |key: &str| first.get(key).and_then(Value::as_f64);
        let unit = first.get("unit").and_then(Value::as_str).filter(|unit| *unit != "-").unwrap_or_default();
        Some(format!("{effect} ({} {unit}", with_std(number("value")?, number("std")?)).trim_end().to_owned() + ")")
    };
    let effects: Vec<String> = effects.into_iter().map(|effect| value_of(&effect).unwrap_or(effect)).collect();
    Some(format!(
        "With {} in the model, the mean frequency error {moved} from {before:.2} to {after:.2} %{left_out}.",
        listed(&effects)
    ))
}

/// Where the model fails now.
fn compared(sources: &Sources<'_>) -> Option<String> {
    let comparison = sources.comparison?;
    let worst = comparison
        .pairs
        .iter()
        .max_by(|a, b| a.frequency_error_percent.abs().total_cmp(&b.frequency_error_percent.abs()))?;
    let mac = comparison.mean_mac.map_or_else(String::new, |mac| format!(", and a mean MAC of {}", mac_words(mac, 4)));
    let by_height = comparison.by_height.iter().map(|level| (level.misfit, metres(level.elevation_m)));
    let by_group = comparison.by_group.iter().map(|group| (group.misfit, format!("group {}", group.group)));
    let at = by_height.chain(by_group).max_by(|a, b| a.0.total_cmp(&b.0));
    let height = at.map_or_else(String::new, |(_, place)| format!("; shapes are furthest off at {place}"));
    Some(format!(
        "{} of the measured modes have a partner in the model, with a mean frequency error of {:.2} %{mac}. The worst is mode {} at {:.4} Hz ({} %){height}.",
        comparison.pairs.len(),
        comparison.mean_abs_frequency_error_percent?,
        worst.measured,
        worst.measured_hz,
        signed(worst.frequency_error_percent, 2),
    ))
}

/// What was identified, and how well.
fn identified(sources: &Sources<'_>) -> Option<String> {
    let modes = sources.modes.get("modes")?.as_array()?;
    let of = |key: &'static str| modes.iter().filter_map(move |mode| mode.get(key)?.as_f64());
    let (lowest, highest) = (of("frequency_hz").next()?, of("frequency_hz").next_back()?);
    let relative = |value: &'static str, std: &'static str| {
        let mut shares: Vec<f64> = modes
            .iter()
            .filter_map(|mode| Some(100.0 * mode.get(std)?.as_f64()? / mode.get(value)?.as_f64()?))
            .filter(|share| share.is_finite())
            .collect();
        shares.sort_by(f64::total_cmp);
        Some((*shares.get(shares.len() / 2)?, *shares.last()?))
    };
    let record = sources.modes.get("record_s").and_then(Value::as_f64).filter(|record_s| *record_s > 0.0);
    let from = record.map_or_else(String::new, |record_s| format!(" from {:.1} h of recording", record_s / 3600.0));
    let sure = relative("frequency_hz", "frequency_std_hz").map_or_else(String::new, |(median, worst)| {
        format!(" Frequencies are known to {median:.2} % (worst {worst:.2} %)")
    });
    let damping = relative("damping_ratio", "damping_ratio_std")
        .map_or_else(String::new, |(median, worst)| format!(", damping to {median:.0} % (worst {worst:.0} %)"));
    let sure = if sure.is_empty() { sure } else { sure + &damping + "." };
    let forced = sources.modes.get("harmonics").and_then(Value::as_array).map_or(0, Vec::len);
    let forced = match forced {
        0 => String::new(),
        1 => " One forced line, as of a machine, is no mode.".to_owned(),
        count => format!(" {count} forced lines, as of machines, are no modes."),
    };
    let several = if modes.len() == 1 { "mode was" } else { "modes were" };
    // Another tool has identified these.
    let how = match &sources.study.measured {
        Some(measured) => format!("read from {}", measured.modes.display()),
        None => "identified".to_owned(),
    };
    Some(format!("{} {several} {how}, between {lowest:.3} and {highest:.3} Hz{from}.{sure}{forced}", modes.len()))
}

/// How well left-out sensors are predicted.
fn predicted(sources: &Sources<'_>) -> Option<String> {
    if sources.stale.contains_key("covalidation") {
        return None;
    }
    let channels = sources.covalidation.get("channels")?.as_array().filter(|channels| !channels.is_empty())?;
    // A mean would hide the worst.
    let range = |key: &str| -> Option<String> {
        let errors = channels.iter().filter_map(|one| one.get("error_percent")?.get(key)?.as_f64());
        let (least, most) =
            errors.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), error| (a.min(error), b.max(error)));
        match (format!("{least:.1}"), format!("{most:.1}")) {
            _ if most < least => None,
            (least, most) if least == most => Some(format!("{least} %")),
            (least, most) => Some(format!("{least} to {most} %")),
        }
    };
    let names: Vec<String> = channels.iter().filter_map(|one| Some(one.get("channel")?.as_str()?.to_owned())).collect();
    let model = range("model")?;
    let with = range("with_effects").map_or_else(String::new, |error| format!(", by that with effects {error}"));
    let best = range("measured_shapes").map_or_else(String::new, |error| {
        format!("; the measured shapes themselves leave {error}, by noise of the channels and of the shapes, and a model that is no further off misses nothing that can be seen here")
    });
    let several = if names.len() == 1 { "channel" } else { "channels" };
    Some(format!(
        "Motion at the left-out {several} {}, predicted from the others: by the model as given {model} off{with}{best}.",
        listed(&names)
    ))
}

/// The next step.
fn next(sources: &Sources<'_>) -> Vec<Finding> {
    let step = |text: &str, command: Option<String>| Finding { kind: Kind::Next, text: text.to_owned(), command };
    let run = |text: &str, command: &str| vec![step(text, Some(command.to_owned()))];
    let measurement = sources.diagnosis.get("next_measurement").and_then(Value::as_str);
    if sources.modes.is_null() && sources.study.measured.is_none() {
        // The server runs nothing that ends only when it is stopped.
        if !sources.has_windows
            && !sources.study.setups.is_empty()
            && sources.study.setups.iter().all(|setup| setup.live)
        {
            let text = "Collect from the nodes, in a terminal: nothing has come from them yet.";
            return vec![step(text, Some("collect".to_owned()))];
        }
        let text =
            "Identify the modes. Spectra, time histories, shapes and all that follows are drawn from what that finds.";
        return run(text, "identify");
    }
    if sources.is_outdated {
        return run("Identify the modes again.", &identify_again(sources.modes));
    }
    if sources.study.model.is_none() {
        return vec![step("Name a model in study.toml ([model]) to compare with.", None)];
    }
    if sources.diagnosis.is_null() || sources.stale.contains_key("diagnosis") {
        return run("Ask which effect the model lacks.", "diagnose");
    }
    let mut steps: Vec<Finding> =
        measurement.into_iter().map(|what| step(&format!("To settle it, measure: {what}."), None)).collect();
    let names = match sources.diagnosis.get("verdict").and_then(Value::as_str) {
        Some("effect") => strings(sources.diagnosis.get("best")),
        Some("ambiguous") => {
            let groups = sources.diagnosis.get("ambiguous").and_then(Value::as_array);
            groups.into_iter().flatten().flat_map(|group| strings(Some(group))).collect()
        }
        _ => Vec::new(),
    };
    let where_known = names.len() > 1;
    let missing = names.into_iter().filter(|name| !has(sources.study, name));
    steps.extend(missing.map(|name| {
        let text = if where_known {
            format!("Add {name} only if you know that it is there.")
        } else {
            format!("Add {name} to the model and refit.")
        };
        step(&text, Some(format!("add {name}")))
    }));
    if sources.covalidation.is_null() && !sources.study.setups.is_empty() {
        steps.extend(run("Predict sensors that the model is not shown.", "covalidate"));
    }
    steps
}

/// The command that identifies modes the way these were: through nodes or not, with trends or without.
pub(super) fn identify_again(modes: &Value) -> String {
    let direct = (modes.is_object() && modes["link"].is_null()).then(|| " --direct".to_owned());
    let every = modes["trends"]["every_s"].as_f64().map(|every_s| format!(" --every={every_s}s"));
    ["identify".to_owned()].into_iter().chain(direct).chain(every).collect()
}

/// Whether an effect is in the model.
fn has(study: &Study, name: &str) -> bool {
    study.model.iter().flat_map(|model| &model.effects).any(|effect| match &effect.location {
        Some(place) => name == format!("{}@{place}", effect.kind),
        None => name == effect.kind,
    })
}

/// An effect's name with its place.
pub(super) fn name_of(effect: &Value) -> Option<String> {
    let kind = effect.get("effect")?.as_str()?;
    Some(match effect.get("where").and_then(Value::as_str) {
        Some(place) => format!("{kind}@{place}"),
        None => kind.to_owned(),
    })
}

pub(super) fn strings(value: Option<&Value>) -> Vec<String> {
    let texts = value.and_then(Value::as_array).into_iter().flatten();
    texts.filter_map(|text| text.as_str().map(str::to_owned)).collect()
}

/// As a sentence lists them.
pub(super) fn listed(names: &[String]) -> String {
    match names {
        [] => String::new(),
        [one] => one.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

/// A path or a key stays as it is written.
pub(crate) fn capital(text: &str) -> String {
    if text.split(' ').next().is_some_and(|word| word.contains(['/', '_', '.'])) {
        return text.to_owned();
    }
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// Warnings are clauses; on a page they stand as sentences.
fn sentence(warning: String) -> String {
    let text = capital(&warning);
    if text.ends_with(['.', '?', '!']) { text } else { text + "." }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn said(sources: &Sources<'_>) -> Vec<(Kind, String)> {
        findings(sources).into_iter().map(|finding| (finding.kind, finding.text)).collect()
    }

    #[test]
    fn findings_come_before_warnings_and_these_before_the_next_step() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("beam.csv"), crate::study::template::CANTON_BEAM).unwrap();
        let added = "\n[[model.effect]]\nkind = \"added-mass\"\nwhere = \"443.6m\"\nvalue = 2e5\n";
        let study =
            Study::from_text(&format!("{}{added}", crate::study::template::CANTON_STUDY), folder.path()).unwrap();
        let mode = |hz: f64, std: f64| json!({ "frequency_hz": hz, "frequency_std_hz": std, "damping_ratio": 0.01, "damping_ratio_std": 0.001 });
        let modes = json!({ "modes": [mode(0.1, 2e-4), mode(1.0, 5e-4)], "record_s": 7200.0, "harmonics": [{}], "warnings": ["channel \"07\" is noisy"] });
        let diagnosis = json!({
            "verdict": "effect", "best": ["base-rotation"], "ambiguous": [],
            "candidates": [{ "effect": "base-rotation", "where": null, "probability": 0.9999 }],
            "warnings": [], "next_measurement": null,
        });
        let step = |effects: &[&str], error: f64, left: f64| json!({ "data": "a", "effects": effects, "mean_abs_frequency_error_percent": error, "held_out_error_percent": left });
        let history = json!([{ "data": "older", "mean_abs_frequency_error_percent": 9.0 }, step(&[], 0.81, 6.03), step(&["added-mass@443.6m"], 0.11, 5.28)]);
        let (none, stale) = (Value::Null, Map::new());
        let sources = Sources {
            study: &study,
            modes: &modes,
            comparison: None,
            diagnosis: &diagnosis,
            covalidation: &none,
            history: &history,
            stale: &stale,
            is_outdated: false,
            has_windows: false,
            unread: &[],
            warnings: &[],
        };
        let texts = said(&sources);
        assert_eq!(
            texts[0],
            (Kind::Finding, "The model lacks base-rotation, with a probability of more than 99 %.".to_owned())
        );
        assert!(
            texts[1]
                .1
                .contains("fell from 0.81 to 0.11 %, that at sensors which were left out of the fit from 6.0 to 5.3 %"),
            "{texts:?}"
        );
        assert!(texts[2].1.starts_with("2 modes were identified, between 0.100 and 1.000 Hz from 2.0 h of recording. Frequencies are known to 0.20 % (worst 0.20 %)"), "{texts:?}");
        assert!(texts.contains(&(Kind::Warning, "Channel \"07\" is noisy.".to_owned())));
        let kinds: Vec<Kind> = texts.iter().map(|(kind, _)| *kind).collect();
        assert!(kinds.is_sorted_by_key(|kind| *kind as usize), "{kinds:?}");
        let known = json!({ "verdict": "effect", "best": ["added-mass@443.6m"] });
        assert!(
            !said(&Sources { diagnosis: &known, ..sources })
                .iter()
                .any(|(_, text)| { text.contains("lacks") || text.starts_with("Add added-mass") })
        );
        // What was fitted with another model is no finding of this one.
        let mut other = study.clone();
        other.model.as_mut().unwrap().effects.clear();
        assert!(!said(&Sources { study: &other, ..sources }).iter().any(|(_, text)| text.contains("fell from")));
        // After a new identification it is one of older modes.
        for older in [
            Sources { is_outdated: true, ..sources },
            Sources {
                stale: &[("history".to_owned(), json!("the measured modes changed since: run"))].into_iter().collect(),
                ..sources
            },
        ] {
            assert!(!said(&older).iter().any(|(_, text)| text.contains("fell from")));
        }
        // A diagnosis of another state of the study is none either.
        let stale: Map<String, Value> = ["diagnosis", "update"]
            .map(|what| (what.to_owned(), json!(format!("the sensors changed since: run `belfry {what}` again"))))
            .into_iter()
            .collect();
        let texts = said(&Sources { stale: &stale, ..sources });
        assert!(!texts.iter().any(|(_, text)| text.contains("The model lacks")), "{texts:?}");
        assert!(texts.contains(&(
            Kind::Warning,
            "Diagnosis and update are of an older state: the sensors changed since.".to_owned()
        )));
        assert!(texts.contains(&(Kind::Next, "Ask which effect the model lacks.".to_owned())));
        let sources = Sources { modes: &none, diagnosis: &none, history: &none, stale: &Map::new(), ..sources };
        assert_eq!(
            findings(&sources),
            [Finding {
                kind: Kind::Next,
                text: "Identify the modes. Spectra, time histories, shapes and all that follows are drawn from what that finds.".to_owned(),
                command: Some("identify".to_owned())
            }]
        );
        // Of nodes that have sent nothing, there is nothing to identify.
        let mut live = study.clone();
        live.setups.iter_mut().for_each(|setup| setup.live = true);
        let next = findings(&Sources { study: &live, ..sources });
        assert_eq!(next.iter().map(|one| one.command.as_deref()).collect::<Vec<_>>(), [Some("collect")]);
        let next = findings(&Sources { study: &live, has_windows: true, ..sources });
        assert_eq!(next[0].command.as_deref(), Some("identify"));
    }
}
