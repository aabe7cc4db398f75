//! Diagnosis: derivatives are those of what is fitted, hidden effects are found, sound models are left alone.

use std::collections::BTreeSet;
use std::path::Path;

use nalgebra::DVector;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::signals::shown;
use super::testing::{measured, normal, scattered, study};
use super::verdict::without_spoilt;
use super::*;
use crate::model::effect::{Effect, Where};
use crate::model::{BeamTable, Structure};
use crate::modes::MeasuredMode;
use crate::progress::{Progress, UNHEARD, counted};
use crate::study::template;

fn effects(words: &[&str]) -> Vec<Effect> {
    words.iter().map(|word| word.parse().unwrap()).collect()
}

/// A gain that is off by less than calibration leaves is no finding, however well it is seen; one that is off by more is.
#[test]
fn gains_within_calibration_are_no_effect() {
    let (structure, model, sensors) = study();
    let diagnosed = |factor: f64| {
        let truth = structure.clone().and(&effects(&[&format!("sensor-gain@ch13={factor}")])).unwrap();
        let view = crate::compare::ModelView::of(&truth.assemble(), &sensors).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(17);
        let mut modes = measured(&truth, &sensors, 12, &mut random);
        for (mode, measured) in modes.iter_mut().enumerate() {
            let exact = DVector::from_column_slice(view.shape(mode)).normalize();
            let shape = measured.shape.as_mut().unwrap();
            shape.values = exact.map(|value| value + 3e-4 * normal(&mut random));
            shape.stds = Some(DVector::from_element(exact.len(), 3e-4));
        }
        let problem = Problem::new(structure.clone(), &[], &model, &sensors, &modes).unwrap();
        diagnose(&problem, &[], &Signals::default(), &Options::default()).unwrap()
    };
    let within = diagnosed(1.008);
    assert_eq!(within.verdict, Verdict::Adequate, "{:?}", within.best);
    let is_told = |text: &String| text.contains("sensor-gain@ch13 stands out, but is not counted");
    assert!(within.warnings.iter().any(is_told), "{:?}", within.warnings);
    // Nor is it recommended.
    assert!(!within.candidates.iter().any(|one| one.effect == "sensor-gain" && one.stands_out()));
    let beyond = diagnosed(1.03);
    assert_eq!((beyond.verdict, &beyond.best[..]), (Verdict::Effect, &["sensor-gain@ch13".to_owned()][..]));
}

/// Whoever waits for a diagnosis hears how far it is: stage by stage, each to its last piece.
#[test]
fn a_diagnosis_tells_how_far_it_is() {
    let (structure, model, sensors) = study();
    let truth = structure.clone().and(&effects(&["added-mass@443.6m=4e6"])).unwrap();
    let modes = measured(&truth, &sensors, 12, &mut ChaCha8Rng::seed_from_u64(5));
    let problem = Problem::new(structure, &[], &model, &sensors, &modes).unwrap();
    let mut stages: Vec<Progress> = Vec::new();
    let mut hear = |told: Progress| match stages.last_mut() {
        Some(last) if last.stage == told.stage && last.done <= told.done => *last = told,
        _ => stages.push(told),
    };
    let diagnosis = counted(&mut hear, |tally| {
        diagnose(&problem.told_to(tally), &[], &Signals::default(), &Options::default()).unwrap()
    });
    assert_eq!(diagnosis.verdict, Verdict::Effect);
    assert!(stages.iter().all(|last| last.done == last.total), "{stages:?}");
    let places = stages.iter().find(|last| last.stage == "effects at every place").unwrap();
    assert!(places.total > 100, "{places:?}");
    for stage in ["a first look at effects", "effects fitted", "effects weighed", "the verdict with other tolerances"] {
        assert!(stages.iter().any(|last| last.stage == stage), "{stage}: {stages:?}");
    }
}

/// The Jacobian against central differences, background and every kind of effect, at a point away from nothing.
#[test]
fn derivatives_are_those_of_the_differences() {
    let words = [
        "base-rotation=flexibility_x=3e-15,flexibility_y=2e-15",
        "added-mass@350m=1e6",
        "connection-flexibility@443.6m=1e-13",
        "stiffness-loss@150m=0.2",
        "mass-eccentricity=x=0.3,y=-0.2",
        "outrigger@200m=1e12",
        "sensor-gain@ch07=1.1",
        "sensor-rotation@node3=4",
        "clock-offset@node4=0.03",
        "p-delta=0.4",
        "coupled-shear=4",
    ];
    check_derivatives(&words, 0.05, 1e-2);
    // How a beam is taken apart follows its own stiffness. Derivatives by segments leave that out, which shows where they are small.
    check_derivatives(&["wall-frame=0.1"], 0.1, 1.0);
}

/// Those by the background that are not below `least`, and all by effects.
fn check_derivatives(words: &[&str], tolerance: f64, least: f64) {
    let (structure, model, sensors) = study();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let modes = measured(&structure, &sensors, 12, &mut random);
    let problem = Problem::new(structure, &[], &model, &sensors, &modes).unwrap();
    let effects = effects(words);
    let numbers = DVector::from_fn(problem.background.size(), |_, _| 0.3 * normal(&mut random));
    let state = problem.state(effects.clone(), numbers.clone(), None).unwrap();
    let modes = state.modes.len();
    let close = |exact: &DVector<f64>, slope: &DVector<f64>, name: &str| {
        // How the phases of a late clock follow the structure is left out.
        let rows = if name.starts_with("clock") { exact.len() } else { modes };
        let error = (exact.rows(0, rows) - slope.rows(0, rows)).norm() / exact.rows(0, rows).norm();
        // One-sided differences, and the weight that the background's mass has on what is below it.
        assert!(
            error < if name == "spread" { 0.15 } else { tolerance },
            "{name}: off by {error:.3} of {:.3e}",
            exact.norm()
        );
    };
    let by_background = state.by_background(&problem);
    let (mut checked, mut all) = (0.0, 0.0);
    for index in 0..numbers.len() {
        let at = |step: f64| {
            let mut moved = numbers.clone();
            moved[index] += step;
            problem.state(effects.clone(), moved, None).unwrap().differences()
        };
        let slope = (at(1e-3) - at(-1e-3)) / 2e-3;
        all += slope.norm_squared();
        if slope.norm() > least {
            checked += slope.norm_squared();
            // Spreading masses changes an eccentric mass' coupling as well, which the derivative leaves out.
            let spread = index == problem.background.of_segments();
            close(&slope, &by_background.column(index).into_owned(), if spread { "spread" } else { "scatter" });
        }
    }
    // By how far they move the differences; many numbers are of segments that hardly scatter by themselves.
    assert!(checked > 0.999 * all, "columns of {checked:.3e} were checked, of {all:.3e} in all");
    let mut checked = BTreeSet::new();
    for knob in problem.all_knobs(&state) {
        let at = |units: f64| {
            let value = state.value(&knob) + units * knob.scale;
            let moved = super::knob::with_values(&effects, &[knob], &[value]);
            problem.state(moved, numbers.clone(), None).unwrap().differences()
        };
        let slope = (at(1e-3) - at(-1e-3)) / 2e-3;
        close(&slope, &state.by_knob(&problem, &knob).unwrap(), words[knob.effect]);
        checked.insert(knob.effect);
    }
    assert_eq!(checked.len(), words.len());
}

/// Diagnoses the tower with hidden effects and segments that scatter half as far as the study allows.
fn diagnosed(words: &[&str], seed: u64, options: &Options) -> Diagnosis {
    let (structure, model, sensors) = study();
    let truth = scattered(&structure, &model, 0.5, seed).and(&effects(words)).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let modes = measured(&truth, &sensors, 13, &mut random);
    let problem = Problem::new(structure, &[], &model, &sensors, &modes).unwrap();
    diagnose(&problem, &[], &Signals::default(), options).unwrap()
}

/// Effects that show in modes, and names under which they may be found.
const HIDDEN: [(&str, &[&str]); 18] = [
    ("base-rotation=8e-15", &["base-rotation"]),
    ("added-mass@443.6m=4e6", &["added-mass"]),
    ("stiffness-loss@285m=0.7", &["stiffness-loss"]),
    ("mass-eccentricity=x=2.5,y=-1", &["mass-eccentricity"]),
    ("sensor-polarity@ch08", &["sensor-polarity@ch08"]),
    ("stiffness-scale=0.2", &["stiffness-scale", "mass-scale"]),
    ("base-rotation=flexibility_x=1.5e-14,flexibility_y=3e-15", &["base-rotation"]),
    ("base-rotation=flexibility_x=1e-15,flexibility_y=1e-15,flexibility_diagonal=-1.5e-14", &["base-rotation"]),
    ("base-translation=6e-10", &["base-translation"]),
    ("shear-flexibility=0.3", &["shear-flexibility"]),
    ("p-delta=1", &["p-delta"]),
    ("coupled-shear=12", &["coupled-shear"]),
    ("wall-frame=0.25", &["wall-frame"]),
    ("connection-flexibility@443.6m=1e-12", &["connection-flexibility"]),
    ("outrigger@272m=3e12", &["outrigger"]),
    ("sensor-gain@ch13=1.3", &["sensor-gain@ch13"]),
    ("sensor-swap@ch05+ch14", &["sensor-swap@ch05+ch14"]),
    ("sensor-rotation@node6=15", &["sensor-rotation@node6"]),
];

#[test]
fn hidden_effects_are_named_with_their_place_and_value() {
    are_named(&HIDDEN[..2]);
}

/// The effect, or one of the names beside it, comes first. Where the value compares directly, it lies within four standard
/// deviations plus 10 % (scatter of the segments).
fn are_named(cases: &[(&str, &[&str])]) {
    for (seed, &(word, names)) in (1..).zip(cases) {
        let diagnosis = diagnosed(&[word], seed, &Options::default());
        let best = diagnosis.best.first().unwrap_or_else(|| panic!("{word}: {:?}", diagnosis.verdict));
        let named: Vec<&String> = diagnosis.ambiguous.iter().flatten().chain([best]).collect();
        assert!(names.iter().any(|name| best.starts_with(name)), "{word}: {best}, among {named:?}");
        let candidate = &diagnosis.candidates[0];
        let truth: Effect = word.parse().unwrap();
        for (parameter, value) in truth.parameters() {
            let found = candidate.parameters.iter().find(|found| found.name == parameter.name);
            // Of another twin, by other axes, or over another length: nothing to compare.
            if let (Some(found), true) = (found, candidate.effect == truth.kind() && candidate.parameters.len() == 1) {
                let std = found.std.unwrap();
                assert!((found.value - value).abs() < 4.0 * std + 0.1 * value.abs(), "{word}: {found:?}");
            }
        }
        if let (Some(Where::Height(z_m)), Some(found)) = (truth.place(), &candidate.r#where) {
            let found: f64 = found.trim_end_matches('m').parse().unwrap();
            assert!((found - z_m).abs() < 20.0, "{word}: {found} m");
        }
    }
}

/// A channel in g, masses far to one side, sensors and axes turned by 60 degrees, a mast with a second mast on top: no small step leads
/// there.
const FAR: [(&str, &[&str]); 6] = [
    ("sensor-gain@ch12=9.81", &["sensor-gain"]),
    ("mass-eccentricity=x=5,y=-4", &["mass-eccentricity"]),
    ("axis-rotation=60", &["axis-rotation", "sensor-rotation"]),
    ("sensor-gain@ch04=0.102", &["sensor-gain"]),
    ("added-mass@618m=5e4", &["added-mass"]),
    ("base-translation=2e-9", &["base-translation"]),
];

#[test]
fn effects_far_from_nothing_are_found() {
    are_found_far_away(&FAR[..1]);
}

fn are_found_far_away(cases: &[(&str, &[&str])]) {
    for (seed, &(word, kinds)) in (50..).zip(cases) {
        let diagnosis = diagnosed(&[word], seed, &Options::default());
        assert_ne!(diagnosis.verdict, Verdict::Unknown, "{word}: {:?}", diagnosis.candidates[0]);
        let found = &diagnosis.candidates.iter().find(|found| diagnosis.best.contains(&found.name())).unwrap();
        assert!(kinds.contains(&found.effect.as_str()), "{word}: {:?}", diagnosis.best);
        let truth: Effect = word.parse().unwrap();
        let (_, value) = truth.parameters().next().unwrap();
        if found.effect == truth.kind() {
            let estimate = &found.parameters[0];
            assert!((estimate.value - value).abs() < 4.0 * estimate.std.unwrap(), "{word}: {estimate:?}");
        }
    }
}

/// A damper splits the first modes in two; the twins have no partner in the model, and say where it is tuned to.
#[test]
fn a_tuned_mass_damper_is_found_by_its_twins() {
    let (structure, model, sensors) = study();
    let word = "tuned-mass-damper@420m=mass=3e6,frequency=0.11,damping_ratio=0.05";
    let truth = scattered(&structure, &model, 0.5, 61).and(&effects(&[word])).unwrap();
    let mut modes = measured(&truth, &sensors, 17, &mut ChaCha8Rng::seed_from_u64(61));
    // What moves the damper alone is damped as it is, and nobody sees it.
    modes.retain(|mode| mode.damping_ratio.unwrap() < 0.055);
    let problem = Problem::new(structure.clone(), &[], &model, &sensors, &modes).unwrap();
    let diagnosis = diagnose(&problem, &[], &Signals::default(), &Options::default()).unwrap();
    let found = &diagnosis.candidates[0];
    assert_eq!((diagnosis.verdict, found.effect.as_str()), (Verdict::Effect, "tuned-mass-damper"), "{found:?}");
    let value = |name: &str| found.parameters.iter().find(|parameter| parameter.name == name).unwrap();
    assert!((value("frequency").value / 0.11 - 1.0).abs() < 0.02, "{:?}", found.parameters);
    assert!((value("damping_ratio").value - 0.05).abs() < 0.03, "{:?}", found.parameters);
    // Mass and height go together: it is the mass at the mode that shows.
    assert!((1.5e6..6e6).contains(&value("mass").value), "{:?}", found.parameters);
    // Elsewhere it would have another mass: both say how sure they are.
    let z_m: f64 = found.r#where.as_ref().unwrap().trim_end_matches('m').parse().unwrap();
    assert!((z_m - 420.0).abs() < 3.0 * found.where_std_m.unwrap(), "{z_m} ± {:?} m", found.where_std_m);
    let mass = value("mass");
    assert!((mass.value - 3e6).abs() < 3.0 * mass.std.unwrap(), "{mass:?}");
    // In the model, all of the modes have a partner.
    let added: Effect = format!("{}=mass=3e6,frequency=0.11,damping_ratio=0.05", found.name()).parse().unwrap();
    let problem = Problem::new(structure, &[added], &model, &sensors, &modes).unwrap();
    assert!(problem.unpaired.is_empty() && problem.measured().len() == modes.len());
}

/// The tower with one stiffness for both directions of bending.
fn round_tower() -> Structure {
    let mut lines = template::CANTON_BEAM.lines();
    let round = |line: &str| {
        let mut cells: Vec<&str> = line.split(',').collect();
        cells[3] = cells[2];
        cells.join(",")
    };
    let head = lines.next().unwrap().to_owned();
    let table = std::iter::once(head).chain(lines.map(round)).collect::<Vec<_>>().join("\n");
    Structure::new(BeamTable::from_reader(table.as_bytes(), Path::new("beam.csv")).unwrap())
}

/// Tests of fit on sound towers that scatter as far as they may fail as often as they say, or less; on towers that scatter
/// four times as far they fail. Of those at three times 6 of 10 do: shear and the foot, which the tolerance knows least, take their share.
#[test]
fn tests_of_fit_hold_what_they_say() {
    let (structure, model, sensors) = study();
    let below = |scatter: f64, seeds: std::ops::Range<u64>, probability: f64| {
        let fails = |seed: &u64| {
            let truth = scattered(&structure, &model, scatter, *seed);
            let modes = measured(&truth, &sensors, 13, &mut ChaCha8Rng::seed_from_u64(*seed));
            let problem = Problem::new(structure.clone(), &[], &model, &sensors, &modes).unwrap();
            problem.present(&[]).unwrap().goodness_of_fit().p_value < probability
        };
        seeds.filter(fails).count()
    };
    // Of 20 draws at 10 %, more than 5 fall below with probability 1.1 % (binomial).
    let often = below(1.0, 300..320, 0.1);
    assert!(often <= 5, "{often} of 20 below 0.1");
    let caught = below(4.0, 330..340, 0.01);
    assert!(caught >= 8, "{caught} of 10 caught");
}

#[test]
fn sound_models_are_left_alone() {
    are_left_alone(100..101);
}

fn are_left_alone(seeds: std::ops::Range<u64>) {
    for seed in seeds {
        let diagnosis = diagnosed(&[], seed, &Options::default());
        assert_eq!(diagnosis.verdict, Verdict::Adequate, "seed {seed}: {:?}", diagnosis.candidates.first());
        assert!(diagnosis.best.is_empty() && diagnosis.ambiguous.is_empty());
    }
}

/// Effects, and the kinds that are not considered: the right one and its twins.
const OUTSIDE: [(&str, &[&str]); 5] = [
    ("added-mass@443.6m=5e6", &["added-mass"]),
    ("sensor-swap@ch05+ch14", &["sensor-swap"]),
    ("base-rotation=4e-14", &["base-rotation", "connection-flexibility", "stiffness-loss"]),
    ("mass-eccentricity=x=3,y=2", &["mass-eccentricity"]),
    ("stiffness-scale=0.5", &["stiffness-scale", "mass-scale"]),
];

#[test]
fn what_no_known_effect_explains_is_unknown() {
    are_unknown(&OUTSIDE[..1]);
}

/// Nothing else passes for what is hidden.
fn are_unknown(cases: &[(&str, &[&str])]) {
    for (seed, &(word, without)) in (200..).zip(cases) {
        let without = without.iter().map(|kind| (*kind).to_owned()).collect();
        let diagnosis = diagnosed(&[word], seed, &Options { without });
        let first = diagnosis.candidates.first();
        assert_eq!(diagnosis.verdict, Verdict::Unknown, "{word}: {first:?}, {:?}", diagnosis.discrepancy);
        assert!(diagnosis.goodness_of_fit.p_value < 0.01);
        assert!(!diagnosis.unexplained.by_mode.is_empty() && !diagnosis.unexplained.by_sensor.is_empty());
    }
}

/// Only the phases show a clock: positive delays are late samples, found with their sign.
/// Several effects at once: no single one passes, and the set has those that were hidden, each with its value.
fn have_hidden(cases: &[&[&str]]) {
    for (seed, words) in (51..).zip(cases) {
        let diagnosis = diagnosed(words, seed, &Options::default());
        assert_eq!(diagnosis.verdict, Verdict::Unknown, "{words:?}: {:?}", diagnosis.best);
        let set = diagnosis.partial.unwrap();
        let names: Vec<String> = set.effects.iter().map(PartialEffect::name).collect();
        assert_eq!(set.effects.len(), words.len(), "{words:?}: {names:?}");
        assert!(set.after.p_value > FAILS && set.before.p_value < 1e-6, "{words:?}: {:?}", set.after);
        assert!(set.after.chi_squared < 0.2 * set.before.chi_squared, "{words:?}: {:?}", set.after);
        assert!(
            set.mean_abs_frequency_error_percent_after < 0.5 * set.mean_abs_frequency_error_percent_before,
            "{words:?}: {set:?}"
        );
        for truth in effects(words) {
            let found = set.effects.iter().find(|found| found.effect == truth.kind());
            let found = found.unwrap_or_else(|| panic!("{truth} is not in {names:?}"));
            assert!(found.probability > 0.9 && found.log_bayes_factor > STANDS_OUT, "{found:?}");
            assert!(found.chi_squared_without > set.after.chi_squared, "{found:?}");
            let ((_, value), estimate) = (truth.parameters().next().unwrap(), &found.parameters[0]);
            let off = (estimate.value - value).abs();
            assert!(off < 4.0 * estimate.std.unwrap() + 0.1 * value.abs(), "{truth}: {estimate:?}");
        }
    }
}

/// Where the verdict is an effect, or that none is missing, there is no set.
#[test]
fn a_verdict_needs_no_set() {
    assert_eq!(diagnosed(&["base-rotation=8e-15"], 1, &Options::default()).partial, None);
}

#[test]
fn a_late_clock_is_found_by_its_phases() {
    is_late(0.04);
}

fn is_late(delay: f64) {
    let diagnosis = diagnosed(&[&format!("clock-offset@node3={delay}")], 7, &Options::default());
    assert_eq!(diagnosis.best, ["clock-offset@node3"]);
    let found = &diagnosis.candidates[0].parameters[0];
    assert!((found.value - delay).abs() < 4.0 * found.std.unwrap(), "{found:?}");
}

/// Twins by definition: K times 1.2 moves every frequency as M over 1.2 does.
#[test]
fn exact_twins_are_named_together_with_what_would_settle_it() {
    let diagnosis = diagnosed(&["mass-scale=-0.15"], 31, &Options::default());
    assert_eq!(diagnosis.verdict, Verdict::Ambiguous);
    let names = &diagnosis.ambiguous[0];
    assert!(names.contains(&"stiffness-scale".to_owned()) && names.contains(&"mass-scale".to_owned()), "{names:?}");
    assert!(diagnosis.next_measurement.unwrap().contains("a known mass added"));
}

#[test]
fn effects_that_are_one_and_the_same_are_refused_together() {
    let (structure, model, sensors) = study();
    let modes = measured(&structure, &sensors, 10, &mut ChaCha8Rng::seed_from_u64(3));
    let both = effects(&["stiffness-scale=0.1", "mass-scale=0.1"]);
    let setting =
        steps::Setting { bare: &structure, model: &model, sensors: &sensors, measured: &modes, tally: &UNHEARD };
    let error = setting.refit("add", &both).err().map(|error| error.to_string()).unwrap();
    assert!(error.contains("stiffness-scale and mass-scale cannot both be fitted"), "{error}");
    let twice = effects(&["added-mass@443.6m=1e5", "added-mass@443.6m=2e5"]);
    let error = setting.refit("add", &twice).err().map(|error| error.to_string()).unwrap();
    assert!(error.starts_with("added-mass@443.6m is in the model already"), "{error}");
    assert!(error.contains("give it another place, or take the first one out with `belfry remove`"), "{error}");
    let two: Vec<MeasuredMode> =
        modes.iter().take(2).map(|mode| MeasuredMode { shape: None, ..mode.clone() }).collect();
    let setting = steps::Setting { measured: &two, sensors: &[], ..setting };
    let error = setting.refit("add", &effects(&["base-rotation=1e-15", "p-delta=0.5"]));
    let error = error.err().map(|error| error.to_string()).unwrap();
    assert!(error.contains("2 measured numbers cannot determine the 2 parameters"), "{error}");
}

/// A line in a mode's peak moves what is identified there; without that mode the model fits, so the line is all that is wrong.
#[test]
fn a_forced_line_explains_the_mode_in_whose_peak_it_is() {
    let (structure, model, sensors) = study();
    let mut modes = measured(&structure, &sensors, 12, &mut ChaCha8Rng::seed_from_u64(6));
    modes[4].frequency_hz *= 0.97;
    let line_hz = 0.99 * modes[4].frequency_hz;
    let problem = Problem::new(structure, &[], &model, &sensors, &modes).unwrap();
    let line = |hz: f64| -> Signals {
        let harmonics = format!(r#"[{{"frequency_hz": {hz}, "kurtosis": 1.5}}]"#);
        serde_json::from_str(&format!(r#"{{"averages": 86, "harmonics": {harmonics}}}"#)).unwrap()
    };
    let near = diagnose(&problem, &[], &line(line_hz), &Options::default()).unwrap();
    assert_eq!(near.verdict, Verdict::Effect, "{:?}", near.candidates.first());
    assert!(near.best[0].starts_with("harmonic@"), "{:?}", near.best);
    let present = problem.fit_present(&[]).unwrap();
    let without = |hz: f64| without_spoilt(&problem, &present, &shown(&line(hz), &[], &[])[0]);
    assert!(without(line_hz).unwrap() >= FAILS);
    assert!(without(1.2 * line_hz).is_none_or(|p_value| p_value < FAILS), "a line elsewhere explains nothing here");
}

#[test]
fn forced_lines_and_trends_are_effects_of_their_own() {
    let (structure, model, sensors) = study();
    let modes = measured(&structure, &sensors, 12, &mut ChaCha8Rng::seed_from_u64(5));
    let problem = Problem::new(structure, &[], &model, &sensors, &modes).unwrap();
    let signals: Signals = serde_json::from_str(
        r#"{"averages": 86, "harmonics": [{"frequency_hz": 0.83, "kurtosis": 1.55}],
            "trends": {"modes": [{"number": 1, "percent_per_kelvin": {"value": -0.05, "std": 0.004}},
                                 {"number": 2, "percent_per_kelvin": {"value": -0.055, "std": 0.005}}]}}"#,
    )
    .unwrap();
    let diagnosis = diagnose(&problem, &[], &signals, &Options::default()).unwrap();
    let names: Vec<String> = diagnosis.candidates.iter().take(2).map(CandidateReport::name).collect();
    assert!(names.contains(&"harmonic@0.83hz".to_owned()) && names.contains(&"temperature-stiffness".to_owned()));
    assert_eq!(diagnosis.verdict, Verdict::Effect);
    let slope = diagnosis.candidates.iter().find(|candidate| candidate.effect == "temperature-stiffness").unwrap();
    // Stiffness goes twice as far as frequency.
    assert!((slope.parameters[0].value + 0.00104).abs() < 1e-4, "{:?}", slope.parameters);
}

/// All cases of what the tests above try a few of.
mod long {
    use super::*;

    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn an_early_clock_is_found_as_well() {
        is_late(-0.03);
    }

    /// On a round tower a damper splits both modes of a pair. Where identification merges the two on either side, each finds a
    /// partner in the model's pair, and only how far they are apart speaks of a damper.
    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn a_damper_is_found_by_a_pair_that_is_apart() {
        let (_, model, sensors) = study();
        let structure = round_tower();
        let word = "tuned-mass-damper@420m=mass=3e6,frequency=0.12,damping_ratio=0.02";
        let truth = scattered(&structure, &model, 0.3, 62).and(&effects(&[word])).unwrap();
        let mut modes = measured(&truth, &sensors, 15, &mut ChaCha8Rng::seed_from_u64(62));
        let [low, other_low, high, other_high] = [0, 1, 2, 3].map(|index| modes[index].frequency_hz);
        assert!((other_low / low).ln() < 0.05 && (other_high / high).ln() < 0.05 && (high / other_low).ln() > 0.08);
        modes.remove(2);
        modes.remove(1);
        let problem = Problem::new(structure, &[], &model, &sensors, &modes).unwrap();
        assert!(problem.unpaired.is_empty());
        let diagnosis = diagnose(&problem, &[], &Signals::default(), &Options::default()).unwrap();
        let found = &diagnosis.candidates[0];
        assert_eq!(
            (diagnosis.verdict, found.effect.as_str()),
            (Verdict::Effect, "tuned-mass-damper"),
            "{:#?} {:?}",
            &diagnosis.candidates,
            diagnosis.probabilities
        );
        assert!((found.parameters[1].value / 0.12 - 1.0).abs() < 0.03, "{:?}", found.parameters);
    }

    /// A place is found between the nodes, and its deviation is stated.
    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn an_effect_between_the_nodes_is_found_where_it_is() {
        let diagnosis = diagnosed(&["added-mass@300m=4e6"], 41, &Options::default());
        let found = &diagnosis.candidates[0];
        assert_eq!((diagnosis.verdict, found.effect.as_str()), (Verdict::Effect, "added-mass"));
        let z_m: f64 = found.r#where.as_ref().unwrap().trim_end_matches('m').parse().unwrap();
        let std_m = found.where_std_m.unwrap();
        assert!((z_m - 300.0).abs() < 4.0 * std_m + 1.0 && (0.1..10.0).contains(&std_m), "{z_m} ± {std_m} m");
        let mass = &found.parameters[0];
        assert!((mass.value - 4e6).abs() < 4.0 * mass.std.unwrap(), "{mass:?}");
    }

    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn every_hidden_effect_is_named() {
        are_named(&HIDDEN);
    }

    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn every_far_effect_is_found() {
        are_found_far_away(&FAR);
    }

    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn more_sound_models_are_left_alone() {
        are_left_alone(101..108);
    }

    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn nothing_passes_for_an_effect_outside_the_catalogue() {
        are_unknown(&OUTSIDE);
    }

    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn of_several_effects_at_once_the_set_has_those_that_were_hidden() {
        have_hidden(&[&["base-rotation=4e-14", "added-mass@300m=6e6", "stiffness-loss@200m=0.5"]]);
    }

    /// Two effects at once: adding step by step finds both, and a first pick that the second makes needless goes again.
    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn hidden_pairs_are_found_step_by_step_and_errors_on_what_was_left_out_fall() {
        let (structure, model, sensors) = study();
        let truth = structure.clone().and(&effects(&["base-rotation=4e-14", "sensor-gain@ch13=1.4"])).unwrap();
        let modes = measured(&truth, &sensors, 13, &mut ChaCha8Rng::seed_from_u64(9));
        let setting =
            steps::Setting { bare: &structure, model: &model, sensors: &sensors, measured: &modes, tally: &UNHEARD };
        let mut records = vec![setting.refit("start", &[]).unwrap().record];
        let mut tell = |step: &steps::Step| records.push(step.record.clone());
        let found = setting.auto(&[], &Signals::default(), &Options::default(), &mut tell).unwrap();
        let mut names: Vec<String> = found.iter().map(ToString::to_string).collect();
        names.sort();
        assert_eq!(names, ["base-rotation", "sensor-gain@ch13"]);
        let (first, last) = (&records[0], records.last().unwrap());
        assert!(last.p_value > FAILS.max(first.p_value), "{} to {}", first.p_value, last.p_value);
        assert!(last.mean_abs_frequency_error_percent < 0.1 * first.mean_abs_frequency_error_percent);
        assert!(last.held_out_mode_error_percent.unwrap() < 0.1 * first.held_out_mode_error_percent.unwrap());
        assert!(last.held_out_error_percent.unwrap() < 0.5 * first.held_out_error_percent.unwrap());
    }

    /// Three effects of which no single one explains the modes: a set of them is added at once, and what it leaves after it.
    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn effects_that_hide_each_other_are_added_as_a_set() {
        let words = ["base-rotation=8e-15", "added-mass@300m=6e6", "stiffness-loss@200m=0.5"];
        let (structure, model, sensors) = study();
        let truth = structure.clone().and(&effects(&words)).unwrap();
        let modes = measured(&truth, &sensors, 13, &mut ChaCha8Rng::seed_from_u64(51));
        let setting =
            steps::Setting { bare: &structure, model: &model, sensors: &sensors, measured: &modes, tally: &UNHEARD };
        let mut told = Vec::new();
        let mut tell = |step: &steps::Step| told.push((step.action.clone(), step.explains));
        let found = setting.auto(&[], &Signals::default(), &Options::default(), &mut tell).unwrap();
        let mut kinds: Vec<&str> = found.iter().map(Effect::kind).collect();
        kinds.sort_unstable();
        assert_eq!(kinds, ["added-mass", "base-rotation", "stiffness-loss"], "{told:?}");
        // The set's effects are listed, those of a step are not.
        assert!(told[0].0.contains(", ") && told.iter().all(|(_, explains)| *explains), "{told:?}");
    }

    /// The structure is stiffer than its model, where the only effect there can soften it.
    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn what_would_need_an_impossible_value_is_listed_as_such() {
        let (structure, model, sensors) = study();
        let modes = measured(&structure, &sensors, 13, &mut ChaCha8Rng::seed_from_u64(71));
        let soft = structure.and(&effects(&["base-translation=8e-10"])).unwrap();
        let problem = Problem::new(soft, &[], &model, &sensors, &modes).unwrap();
        let diagnosis = diagnose(&problem, &[], &Signals::default(), &Options::default()).unwrap();
        let rejected = diagnosis.candidates.iter().find(|candidate| candidate.effect == "base-translation").unwrap();
        assert!(!rejected.admissible && rejected.parameters[0].value < 0.0, "{rejected:?}");
        assert!(diagnosis.best.iter().all(|best| best != "base-translation"));
    }
}

/// Inertia grows with the square of its radius: the typical radius moves a frequency by as much as an effect is expected to, not by
/// the square of what one small step promises.
#[test]
fn a_typical_radius_moves_a_frequency_as_expected() {
    let (structure, model, sensors) = study();
    let modes = measured(&structure, &sensors, 12, &mut ChaCha8Rng::seed_from_u64(1));
    let problem = Problem::new(structure.clone(), &[], &model, &sensors, &modes).unwrap();
    let effect: Effect = "rotary-inertia=radius=1".parse().unwrap();
    let typical = problem.typical(&effect, 0, 1.0).unwrap().size;
    let frequencies = |structure: &Structure| structure.assemble().modes().unwrap().frequency_hz;
    let (sound, heavy) =
        (frequencies(&structure), frequencies(&structure.clone().and(&[effect.with_values(&[typical])]).unwrap()));
    let measured = problem.reference.get().unwrap().as_ref().unwrap().state.models.clone();
    let most = measured.iter().map(|&mode| (sound[mode] / heavy[mode]).ln()).fold(0.0, f64::max);
    // 5 % by the slope at nothing; less by the whole of it.
    assert!((0.02..0.08).contains(&most), "{typical} m moves a frequency by {most}");
}

/// 60 t of 600 m are what a tolerance of 3 % looks like, however exact the modes are; 4000 t are not.
#[test]
fn an_effect_no_larger_than_what_the_table_has_wrong_is_no_finding() {
    let (structure, model, sensors) = study();
    let looks_like_it = |word: &str| {
        let effects = effects(&[word]);
        let modes =
            measured(&structure.clone().and(&effects).unwrap(), &sensors, 12, &mut ChaCha8Rng::seed_from_u64(1));
        let problem = Problem::new(structure.clone(), &effects, &model, &sensors, &modes).unwrap();
        problem.present(&effects).unwrap().looks_like_the_table(0)
    };
    assert!(looks_like_it("added-mass@443.6m=6e4") && !looks_like_it("added-mass@443.6m=4e6"));
    // Of a gain no table says anything.
    assert!(!looks_like_it("sensor-gain@ch13=1.3"));
}

/// What holds a structure near its foot is how it is founded, which the tolerance has: an outrigger is looked for higher up.
#[test]
fn an_outrigger_is_looked_for_above_the_foot() {
    let (structure, model, sensors) = study();
    let modes = measured(&structure, &sensors, 12, &mut ChaCha8Rng::seed_from_u64(1));
    let [z_base_m, z_top_m] = structure.z_range_m().unwrap();
    let problem = Problem::new(structure, &[], &model, &sensors, &modes).unwrap();
    let present = problem.present(&[]).unwrap();
    let lowest_m = |name: &str| {
        let candidates = problem.candidates(crate::model::effect::find(name).unwrap(), &present);
        let height_m = |candidate: &super::candidates::Candidate| match candidate.place {
            Some(Where::Height(z_m)) => z_m,
            _ => f64::NAN,
        };
        candidates.iter().map(height_m).fold(f64::INFINITY, f64::min)
    };
    let share = |z_m: f64| (z_m - z_base_m) / (z_top_m - z_base_m);
    assert!((0.2..0.3).contains(&share(lowest_m("outrigger"))));
    assert!((0.1..0.2).contains(&share(lowest_m("lateral-support"))));
    assert!(share(lowest_m("added-mass")) < 0.1);
}
