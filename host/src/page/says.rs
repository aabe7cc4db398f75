//! What pictures show, in a sentence each, and what was run to make them.
//!
//! What commands have written flows in; sentences by the names of their pictures flow out, so that page, report and commands count alike.

use serde_json::{Map, Value, json};

use super::findings::{Sources, identify_again, listed, name_of, strings};
use crate::command::p_is;
use crate::numbers::{counted, metres, probability_text, signed};

/// Errors of a step of the history, and what they are called.
const ERRORS: [(&str, &str); 3] = [
    ("mean_abs_frequency_error_percent", "the mean error of frequencies"),
    ("held_out_mode_error_percent", "that of modes left out"),
    ("held_out_error_percent", "that of sensors left out"),
];
/// How those that are left out are meant: two other numbers stand beside them, of motion that co-validation predicts.
const LEFT_OUT: &str = "Left out: each mode, or sensor, in turn is predicted by a fit to the others.";
/// How the error of predicted motion is meant.
const COVALIDATION: &str = "E_d is the share of the motion over time that the prediction misses. Shapes as measured have the noise of channels and shapes in them, which those of a model have not: a model whose error is no larger misses nothing that can be seen here. The history's error of left-out sensors is another one: of shapes, by fits to the other sensors.";
/// What the bars and cells of fingerprints are, and why they give another share than the table of candidates.
const FINGERPRINT: &str = "Bars and cells are what is left after all that measurement, tolerance and discrepancy may explain, in their standard deviations: what all modes have in common hardly counts, since segments could make it. \"Misfit left\" in the table of candidates is of plain differences, in which those far off count less; the two shares do not add up to 100 %.";
/// What the columns of candidates are.
const COLUMNS: &str = "ln Bayes factor: how much more probable the measurement is with the effect than without; 3 is 20 to 1. Chi-squared and p: what is left with it, segments adjusted within the tolerance. Misfit left: what it leaves of the plain differences of frequencies and shapes; an effect with which they do not fall has no probability.";
/// A segment is said to be off from this many deviations on.
const OFF: f64 = 2.0;

/// A sentence for each picture that stands on results alone.
pub(super) fn says(sources: &Sources<'_>, spectra: &Value, profile: &Value) -> Map<String, Value> {
    let steps = history(sources.history);
    let all = [
        ("error-steps", steps.clone()),
        ("history", steps),
        ("trends", trends(&sources.modes["trends"])),
        ("profile", profile_says(profile)),
        ("fits", fits(spectra)),
        ("modes-table", modes(sources)),
        ("candidates", candidates(sources.diagnosis)),
        ("covalidation", sources.covalidation.is_object().then(|| COVALIDATION.to_owned())),
        ("candidates-columns", sources.diagnosis.is_object().then(|| COLUMNS.to_owned())),
        ("fingerprint", sources.diagnosis.is_object().then(|| FINGERPRINT.to_owned())),
    ];
    all.into_iter().filter_map(|(name, text)| Some((name.to_owned(), Value::from(text?)))).collect()
}

/// How the errors fell since the measurement and the model are these.
fn history(history: &Value) -> Option<String> {
    let steps = history.as_array()?;
    let last = steps.last()?;
    let from = steps.iter().position(|step| step["data"] == last["data"])?;
    let steps = &steps[from..];
    let first = &steps[0];
    let errors = |step: &Value, other: &Value, say: &dyn Fn(f64, f64) -> String| -> String {
        let known = ERRORS.iter().filter_map(|(key, what)| {
            let (one, other) = (step[*key].as_f64()?, other[*key].as_f64()?);
            Some(format!("{what} {}", say(one, other)))
        });
        known.collect::<Vec<_>>().join(", ")
    };
    let here = |step: &Value| errors(step, step, &|error, _| format!("is {error:.2} %"));
    if steps.len() == 1 {
        return Some(format!("One step so far, the model as first seen: {}. {LEFT_OUT}", here(first)));
    }
    let name = |step: &Value| step["action"].as_str().unwrap_or_default().to_owned();
    let count = steps.len() - 1;
    if first["effects"] == last["effects"] {
        let error = |step: &&Value| step[ERRORS[0].0].as_f64().unwrap_or(f64::INFINITY);
        let best = steps.iter().min_by(|a, b| error(a).total_cmp(&error(b)))?;
        let least = match best == last || error(&best) >= error(&last) {
            true => String::new(),
            false => format!(" The least error of frequencies was {:.2} %, after \"{}\".", error(&best), name(best)),
        };
        return Some(format!(
            "After {}, the last of them \"{}\", the model has the same effects as at first: {}.{least} {LEFT_OUT}",
            counted(count as u64, "step"),
            name(last),
            here(last)
        ));
    }
    let went = errors(first, last, &|before, after| format!("went from {before:.2} to {after:.2} %"));
    let done: Vec<String> = steps[1..].iter().map(name).collect();
    Some(format!("{} ({}): {went}. {LEFT_OUT}", counted(count as u64, "step"), done.join("; ")))
}

/// Which modes change over time, by the test of the command.
fn trends(trends: &Value) -> Option<String> {
    let (modes, intervals) = (trends["modes"].as_array()?, trends["intervals"].as_array()?);
    let changed: Vec<&Value> = modes.iter().filter(|mode| mode["changes"] == true).collect();
    let every = humantime::format_duration(std::time::Duration::from_secs_f64(trends["every_s"].as_f64()?.max(0.0)));
    let slopes: Vec<f64> = changed.iter().filter_map(|mode| mode["percent_per_kelvin"]["value"].as_f64()).collect();
    let what = match changed.len() {
        0 => "no frequency changes more than the measurement's scatter".to_owned(),
        count => format!(
            "{count} {} more than the measurement's scatter ({})",
            if count == 1 { "frequency changes" } else { "frequencies change" },
            numbered("mode", changed.iter().map(|mode| &mode["number"]))
        ),
    };
    let range = slopes.iter().copied().reduce(f64::min).zip(slopes.iter().copied().reduce(f64::max));
    let slope = range.map_or_else(String::new, |(least, most)| {
        format!(", with temperature by {} to {} % a kelvin", signed(least, 3), signed(most, 3))
    });
    Some(format!(
        "{} followed through {} of {every}; {what}{slope}.",
        counted(modes.len() as u64, "mode"),
        counted(intervals.len() as u64, "interval")
    ))
}

/// Where stiffness or mass is off.
fn profile_says(profile: &Value) -> Option<String> {
    let last = match &profile["with_effects"] {
        Value::Null => &profile["as_given"],
        with => with,
    };
    let quantities = last["quantities"].as_array()?;
    // Change in percent, its deviation, and where.
    let mut off: Vec<(f64, f64, String)> = Vec::new();
    let change = |one: &Value| {
        let (factor, std) = one["factor"].as_f64().zip(one["std"].as_f64())?;
        (std > 0.0).then_some((100.0 * (factor - 1.0), 100.0 * std))
    };
    for quantity in quantities {
        let name = quantity["quantity"].as_str()?.replace("_1", ", 1st axis").replace("_2", ", 2nd axis");
        for segment in quantity["segments"].as_array()?.iter().filter(|segment| !segment["given"].is_null()) {
            let ends = segment["z_bottom_m"].as_f64().zip(segment["z_top_m"].as_f64());
            let Some(((change, std), (bottom_m, top_m))) = change(segment).zip(ends) else { continue };
            off.push((change, std, format!("{name} at {}", metres((bottom_m + top_m) / 2.0))));
        }
    }
    let groups = last["groups"].as_array().map_or(&[][..], Vec::as_slice);
    for group in groups {
        let Some(((change, std), name)) = change(group).zip(group["name"].as_str()) else { continue };
        off.push((change, std, format!("group {name}")));
    }
    let (each, none) = match (quantities.is_empty(), groups.is_empty()) {
        (true, _) => ("group of the model", "group"),
        (false, true) => ("segment of the table", "segment"),
        (false, false) => ("segment of the table and each group", "segment and no group"),
    };
    let most = |size: fn(&(f64, f64, String)) -> f64| off.iter().max_by(|a, b| size(a).total_cmp(&size(b)));
    let (surest, largest) = (most(|(change, std, _)| (change / std).abs())?, most(|(change, _, _)| change.abs())?);
    let effects = strings(last.get("effects"));
    let with = match effects.is_empty() {
        true => String::new(),
        false => format!(", fitted together with {}", listed(&effects)),
    };
    let said = |(change, std, place): &(f64, f64, String)| format!("{place} with {} ± {std:.1} %", signed(*change, 1));
    let deviations = (surest.0 / surest.1).abs();
    let finding = if deviations <= OFF {
        format!("No {none} is off by more than {OFF:.0} of its standard deviations.")
    } else if surest == largest {
        format!("Furthest off is {}, {deviations:.1} of its standard deviations.", said(surest))
    } else {
        format!(
            "Surest to be off is {}, {deviations:.1} of its standard deviations; the largest change is {}.",
            said(surest),
            said(largest)
        )
    };
    Some(format!("What the measurement says of each {each}{with}. {finding}"))
}

/// The verdict with its probability, the tests that go with it, and what the table's columns are.
fn candidates(diagnosis: &Value) -> Option<String> {
    let all = diagnosis["candidates"].as_array().filter(|all| !all.is_empty())?;
    let best = strings(diagnosis.get("best"));
    let groups: Vec<Vec<String>> = diagnosis["ambiguous"]
        .as_array()
        .into_iter()
        .flatten()
        .map(|group| group.as_str().map_or_else(|| strings(Some(group)), |one| vec![one.to_owned()]))
        .collect();
    let together = |names: &[String]| {
        let is_named = |one: &&Value| name_of(one).is_some_and(|name| names.contains(&name));
        probability_text(all.iter().filter(is_named).filter_map(|one| one["probability"].as_f64()).sum())
    };
    let test = |key: &str| -> Option<String> {
        let test = diagnosis.get(key).filter(|test| test.is_object())?;
        let (chi_squared, p_value) = (test["chi_squared"].as_f64()?, test["p_value"].as_f64()?);
        Some(format!(
            "chi-squared {chi_squared:.0} on {} degrees of freedom, {}",
            test["degrees_of_freedom"],
            p_is(p_value)
        ))
    };
    let named = listed(&best);
    let verdict = diagnosis["verdict"].as_str()?;
    let said = match verdict {
        "adequate" => match diagnosis["probabilities"]["adequate"].as_f64() {
            Some(adequate) => format!("Most probably the model lacks nothing: {}.", probability_text(adequate)),
            None => "Most probably the model lacks nothing.".to_owned(),
        },
        "ambiguous" => {
            let sets: Vec<String> = groups.iter().map(|names| listed(names)).collect();
            format!(
                "The data cannot tell {} apart; together they have {}.",
                sets.join(", or "),
                together(&groups.concat())
            )
        }
        "effect" if !named.is_empty() => format!("Most probably the model lacks {named}: {}.", together(&best)),
        _ => "Most probably the model lacks something that is not among the candidates.".to_owned(),
    };
    let leading = if groups.is_empty() { named.as_str() } else { "the best of these" };
    let tests = [
        test("present").map(|test| format!("The model as it is: {test}.")),
        test("present_beside_best").map(|test| format!("If it may miss no more than with {leading}: {test}.")),
        test("goodness_of_fit").filter(|_| verdict == "effect").map(|test| format!("With {named}: {test}.")),
    ];
    let all: Vec<String> = [said].into_iter().chain(tests.into_iter().flatten()).collect();
    Some(all.join(" "))
}

/// Whether the fits of modes leave anything.
fn fits(spectra: &Value) -> Option<String> {
    let fitted = spectra["fitted"].as_array()?;
    let numbers = |which: &dyn Fn(&&Value) -> bool| {
        let mut numbers: Vec<u64> = fitted.iter().filter(which).filter_map(|one| one["mode"].as_u64()).collect();
        numbers.sort_unstable();
        numbers.dedup();
        numbers
    };
    let (all, misfits) = (numbers(&|_| true), numbers(&|one| one["is_misfit"] == true));
    let said = match misfits.is_empty() {
        true => "No spectrum is further from its fit than averages of this number scatter by chance.".to_owned(),
        false => format!(
            "At {} the spectrum is further from its fit than averages scatter by chance: something else lies there.",
            numbered("mode", misfits.iter())
        ),
    };
    Some(format!(
        "The spectrum of {} behind its modal filter (dots), and the fit (line). {said}",
        if all.len() == 1 { "the mode".to_owned() } else { format!("each of {} modes", all.len()) }
    ))
}

/// Where the modes come from, and what a second method says of them.
fn modes(sources: &Sources<'_>) -> Option<String> {
    let modes = sources.modes["modes"].as_array()?;
    let count = counted(modes.len() as u64, "mode");
    if let Some(measured) = &sources.study.measured {
        return Some(format!(
            "{count} from {}, with the standard deviations that stand there.",
            measured.modes.display()
        ));
    }
    let asked: Vec<&Value> = modes.iter().filter(|mode| mode["second_opinion"].is_object()).collect();
    let no: Vec<&Value> = asked.iter().copied().filter(|mode| mode["second_opinion"]["agrees"] == false).collect();
    let second = match (asked.len(), no.len()) {
        (0, _) => "No second method was asked.".to_owned(),
        (has, 0) => {
            format!("A second method, which fits correlations instead of spectra, has {has} of them and agrees on all.")
        }
        (has, _) => format!(
            "A second method, which fits correlations instead of spectra, has {has} of them; it disagrees on {}.",
            numbered("mode", no.iter().map(|mode| &mode["number"]))
        ),
    };
    Some(format!("{count}, each with one standard deviation. {second}"))
}

/// How it was done: sentences that are true of this study, and the commands that have made what is there.
pub(super) fn method(sources: &Sources<'_>, has_compared: bool, update: &Value, profile: &Value) -> Value {
    let mut sentences: Vec<String> = Vec::new();
    let mut commands: Vec<Vec<String>> = Vec::new();
    let words = |command: &str| command.split(' ').map(str::to_owned).collect::<Vec<_>>();
    match &sources.study.measured {
        Some(measured) => {
            sentences.push(format!("Modes and their standard deviations are those of {}.", measured.modes.display()));
        }
        None if !sources.modes.is_null() => {
            sentences.push("Modes are fitted to averaged spectra; a second method fits subspaces of correlations. Standard deviations come from the scatter of the averages.".to_owned());
            sentences.extend(strings(sources.modes["segments"].get("reasons")));
            commands.push(words(&identify_again(sources.modes)));
        }
        None => {}
    }
    if sources.comparison.is_some() {
        sentences.push("The model is compared mode by mode, paired by shape and frequency. Chi-squared weighs differences by the measurement's deviations and by the model's stated tolerance.".to_owned());
    }
    if !sources.diagnosis.is_null() {
        sentences.push("Candidates are weighed by their evidence.".to_owned());
    }
    if !update.is_null() {
        sentences.push("The direct update is that of Lei, Wang, Shen (2012): K* = K + M Φ Ψ Φᵀ M.".to_owned());
    }
    let channels: Vec<&str> = sources.covalidation["channels"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(|channel| channel["channel"].as_str())
        .collect();
    let covalidate = if channels.is_empty() {
        vec!["covalidate".to_owned()]
    } else {
        vec!["covalidate".to_owned(), "--channels".to_owned(), channels.join(",")]
    };
    let run = [
        (vec!["compare".to_owned()], "", has_compared),
        (vec!["update".to_owned()], "update", !update.is_null()),
        (covalidate, "covalidation", !sources.covalidation.is_null()),
        (vec!["diagnose".to_owned()], "diagnosis", !sources.diagnosis.is_null()),
        (vec!["profile".to_owned()], "profile", !profile.is_null()),
    ];
    // What is shown is of the model with its effects, but for what is of an older state.
    let (older, newer): (Vec<_>, Vec<_>) =
        run.into_iter().filter(|(.., is)| *is).partition(|(_, result, _)| sources.stale.contains_key(*result));
    commands.extend(older.into_iter().map(|(words, ..)| words));
    for action in sources.history.as_array().into_iter().flatten().filter_map(|step| step["action"].as_str()) {
        // Earlier versions wrote `drop`.
        if let Some((verb @ ("add" | "remove" | "drop"), effect)) = action.split_once(' ')
            && !effect.contains(", ")
        {
            commands.push(vec![if verb == "add" { "add" } else { "remove" }.to_owned(), effect.to_owned()]);
        }
    }
    commands.extend(newer.into_iter().map(|(words, ..)| words));
    json!({ "sentences": sentences, "commands": commands })
}

/// "mode 3", "modes 3, 7".
fn numbered<T: ToString>(one: &str, numbers: impl Iterator<Item = T>) -> String {
    let numbers: Vec<String> = numbers.map(|number| number.to_string()).collect();
    format!("{one}{} {}", if numbers.len() == 1 { "" } else { "s" }, numbers.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(action: &str, effects: &[&str], error: f64) -> Value {
        json!({ "action": action, "effects": effects, "data": "a", "mean_abs_frequency_error_percent": error, "held_out_error_percent": 6.0 })
    }

    #[test]
    fn what_the_data_cannot_tell_apart_is_summed() {
        let one = |effect: &str, place: Value, probability: f64| json!({ "effect": effect, "where": place, "probability": probability });
        let diagnosis = json!({
            "verdict": "ambiguous", "best": [], "ambiguous": [["added-mass@12.5m", "base-rotation"]],
            "candidates": [one("added-mass", json!("12.5m"), 0.6), one("base-rotation", Value::Null, 0.3), one("p-delta", Value::Null, 0.01)],
            "present": { "chi_squared": 140.2, "degrees_of_freedom": 120, "p_value": 0.00001 },
        });
        assert_eq!(
            candidates(&diagnosis).unwrap(),
            "The data cannot tell added-mass@12.5m and base-rotation apart; together they have 90.0 %. The model as it is: chi-squared 140 on 120 degrees of freedom, p < 0.0001."
        );
        assert_eq!(candidates(&json!({})), None);
    }

    #[test]
    fn an_undone_step_is_no_fall() {
        let steps = [step("start", &[], 0.81), step("add base-rotation", &["base-rotation"], 0.11)];
        let fell = history(&json!(steps)).unwrap();
        assert!(
            fell.starts_with("1 step (add base-rotation): the mean error of frequencies went from 0.81 to 0.11 %"),
            "{fell}"
        );
        let undone = [&steps[..], &[step("remove base-rotation", &[], 0.81)]].concat();
        let said = history(&json!(undone)).unwrap();
        assert!(!said.contains("from 0.81") && said.contains("the same effects as at first"), "{said}");
        assert!(said.contains("The least error of frequencies was 0.11 %, after \"add base-rotation\"."), "{said}");
        // Steps of another measurement say nothing of this one.
        let mut other = step("start", &[], 9.0);
        other["data"] = json!("b");
        assert_eq!(history(&json!([vec![other], steps.to_vec()].concat())).unwrap(), fell);
    }

    #[test]
    fn the_surest_segment_and_the_one_that_is_furthest_off_are_told_apart() {
        let segment = |bottom: f64, factor: f64, std: f64| json!({ "z_bottom_m": bottom, "z_top_m": bottom + 10.0, "given": 1.0, "factor": factor, "std": std });
        let of = |segments: Value| json!({ "as_given": { "effects": [], "quantities": [{ "quantity": "bending_1", "segments": segments }] }, "with_effects": null });
        let said = profile_says(&of(json!([segment(0.0, 1.02, 0.005), segment(300.0, 0.9, 0.2)]))).unwrap();
        assert!(said.contains("Surest to be off is bending, 1st axis at 5.00 m with +2.0 ± 0.5 %, 4.0 of its standard deviations; the largest change is bending, 1st axis at 305 m with -10.0 ± 20.0 %."), "{said}");
        let said = profile_says(&of(json!([segment(0.0, 1.001, 0.005)]))).unwrap();
        assert!(said.ends_with("No segment is off by more than 2 of its standard deviations."), "{said}");
    }

    #[test]
    fn groups_are_told_as_segments_are() {
        let group = |name: &str, factor: f64| json!({ "name": name, "span_m": null, "factor": factor, "std": 0.02, "prior_std": 0.2 });
        let of = |groups: Value| json!({ "as_given": { "effects": [], "quantities": [], "groups": groups }, "with_effects": null });
        let said = profile_says(&of(json!([group("storey1", 0.7), group("storey2", 1.01)]))).unwrap();
        assert_eq!(
            said,
            "What the measurement says of each group of the model. Furthest off is group storey1 with -30.0 ± 2.0 %, 15.0 of its standard deviations."
        );
        let said = profile_says(&of(json!([group("storey2", 1.01)]))).unwrap();
        assert!(said.ends_with("No group is off by more than 2 of its standard deviations."), "{said}");
    }

    #[test]
    fn a_mode_changes_on_the_page_where_it_changes_for_the_command() {
        let mode = |number: usize, changes: bool| json!({ "number": number, "p_value_of_no_change": 0.005, "changes": changes, "percent_per_kelvin": { "value": -0.02, "std": 0.001 } });
        let of =
            |changes| json!({ "every_s": 3600.0, "modes": [mode(1, false), mode(2, changes)], "intervals": [{}, {}] });
        assert_eq!(
            trends(&of(false)).unwrap(),
            "2 modes followed through 2 intervals of 1h; no frequency changes more than the measurement's scatter."
        );
        assert!(trends(&of(true)).unwrap().contains("1 frequency changes more than the measurement's scatter (mode 2), with temperature by -0.020 to -0.020 % a kelvin."));
    }
}
