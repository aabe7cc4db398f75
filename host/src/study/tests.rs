//! What a study may say, and that every fault is told with its file, line, key and remedy.

use std::path::{Path, PathBuf};

use proptest::prelude::*;

use super::*;

/// A sound study; the faults below change one thing of it. Line 1 is the first line of text.
const SOUND: &str = r#"[structure]
name = "Mast"
[[setup]]
name = "one"
files = ["a_*.csv"]
sampling_rate_hz = 50
unit = "m/s2"
[[setup.sensor]]
channel = "x"
node = 1
elevation_m = 10.5
azimuth_deg = 18
offset_m = [-1, 2.5]
[[setup.sensor]]
channel = "z"
point = "top"
node = 2
azimuth_deg = "up"
reference = true
[analysis]
band_hz = [0.5, 10.0]
decimated_rate_hz = 25.0
segment = 1024
[model]
beam = "beam.csv"
background_stiffness = 0.03
"#;

fn load(text: &str) -> Result<Study, StudyError> {
    Study::from_text(text, Path::new("somewhere"))
}

/// Checks that the sound study with `old` replaced by `new` fails in `line`, with a message that holds all `parts`.
#[track_caller]
fn assert_fault(old: &str, new: &str, line: usize, parts: &[&str]) -> String {
    assert!(SOUND.contains(old), "the sound study has no {old:?}");
    assert_told(&SOUND.replacen(old, new, 1), line, parts)
}

#[track_caller]
fn assert_told(text: &str, line: usize, parts: &[&str]) -> String {
    let error = load(text).expect_err("a fault");
    let message = error.to_string();
    let file = Path::new("somewhere").join(STUDY_FILE);
    let place = format!("{}, line {line}", file.display());
    assert!(message.starts_with(&format!("{place}:")) || message.starts_with(&format!("{place},")), "{message}");
    for part in parts {
        assert!(message.contains(part), "no {part:?} in: {message}");
    }
    message
}

#[test]
fn a_sound_study_is_read_with_every_value_in_its_place() {
    let study = load(SOUND).unwrap();
    assert_eq!(study.folder, PathBuf::from("somewhere"));
    assert_eq!(study.structure.name, "Mast");
    let setup = &study.setups[0];
    assert_eq!((setup.name.as_str(), setup.files.as_slice()), ("one", ["a_*.csv".to_owned()].as_slice()));
    assert_eq!((setup.sampling_rate_hz, setup.unit, &setup.variable), (50.0, Unit::MetrePerSecondSquared, &None));
    let first = Sensor {
        channel: "x".to_owned(),
        point: "x".to_owned(),
        node: 1,
        elevation_m: Some(10.5),
        direction: Some(Direction::AzimuthDeg(18.0)),
        offset_m: [-1.0, 2.5],
        reference: false,
        unit: None,
        sensitivity_v_per_m_s2: None,
        gain: None,
        gain_std: None,
        offset_m_s2: None,
        dof: None,
        model_node: None,
    };
    let second = Sensor {
        channel: "z".to_owned(),
        point: "top".to_owned(),
        node: 2,
        elevation_m: None,
        direction: Some(Direction::Up),
        offset_m: [0.0, 0.0],
        reference: true,
        ..first.clone()
    };
    assert_eq!(setup.sensors, [first, second]);
    let analysis = Analysis {
        band_hz: Some([0.5, 10.0]),
        decimated_rate_hz: Some(25.0),
        segment: Some(1024),
        ..Analysis::default()
    };
    assert_eq!(study.analysis, analysis);
    let model = study.model.unwrap();
    let beam = ModelSource::Beam(PathBuf::from("beam.csv"));
    assert_eq!((model.source, model.background_stiffness), (beam, Some(0.03)));
}

#[test]
fn only_structure_and_setup_have_to_be_there() {
    let end = SOUND.find("[analysis]").unwrap();
    let study = load(&SOUND[..end]).unwrap();
    assert_eq!((study.analysis, study.model), (Analysis::default(), None));
}

#[test]
fn units_and_sensitivities_belong_together() {
    for (name, unit) in
        [("g", Unit::StandardGravity), ("m/s", Unit::MetrePerSecond), ("rad", Unit::Radian), ("strain", Unit::Strain)]
    {
        let study = load(&SOUND.replace("m/s2", name)).unwrap();
        assert_eq!(study.setups[0].unit, unit);
    }
    let sensitivity = "\nsensitivity_v_per_m_s2 = 0.1";
    let volts = SOUND.replace("m/s2", "V").replace("node = 1", &format!("node = 1{sensitivity}"));
    assert_told(&volts, 15, &["\"z\"", "sensitivity_v_per_m_s2", "V"]);
    let volts = volts.replace("node = 2", &format!("node = 2{sensitivity}"));
    assert_eq!(load(&volts).unwrap().setups[0].sensors[1].sensitivity_v_per_m_s2, Some(0.1));
    assert_told(&volts.replace("\"V\"", "\"g\""), 11, &["sensitivity_v_per_m_s2", "\"x\"", "remove it"]);
    assert_told(&volts.replacen("= 0.1", "= -0.1", 1), 11, &["above 0", "-0.1"]);
    let with_gain = |gain: &str| SOUND.replace("node = 1", &format!("node = 1\ngain = {gain}"));
    assert_eq!(load(&with_gain("1.04")).unwrap().setups[0].sensors[0].gain, Some(1.04));
    for wrong in ["9.81", "0.2", "-1.0", "nan"] {
        assert_told(&with_gain(wrong), 11, &["gain", "0.5 to 2"]);
    }
    let calibrated = load(&with_gain("1.04\ngain_std = 2e-4\noffset_m_s2 = -0.2")).unwrap();
    let sensor = &calibrated.setups[0].sensors[0];
    assert_eq!((sensor.gain_std, sensor.offset_m_s2), (Some(2e-4), Some(-0.2)));
    assert_told(&with_gain("1.04\ngain_std = 0"), 12, &["gain_std", "above 0"]);
    let velocity = with_gain("1.04\noffset_m_s2 = -0.2\nunit = \"m/s\"");
    assert_told(&velocity, 12, &["offset_m_s2", "no acceleration"]);
}

#[test]
fn faults_of_writing_are_told_with_their_line() {
    assert_fault("name = \"Mast\"", "name = \"Mast", 2, &["toml.io"]);
    assert_fault("node = 2", "node = 2\nnode = 3", 18, &["duplicate"]);
    assert_fault("name = \"Mast\"", "naem = \"Mast\"", 2, &["`structure.naem`", "did you mean `name`"]);
    assert_fault("elevation_m", "elevation", 11, &["`setup.sensor.elevation`", "did you mean `elevation_m`"]);
    assert_fault("segment = 1024", "segments = 1024", 23, &["`analysis.segments`", "did you mean `segment`"]);
    let message = assert_fault("[model]", "[weather]", 24, &["`weather`", "known here: structure, setup"]);
    assert!(!message.contains("did you mean"), "{message}");
    assert_fault("node = 1", "node = \"1\"", 10, &["`setup.sensor.node`", "a string", "number of the sensor node"]);
    assert_fault("files = [\"a_*.csv\"]", "files = \"a.csv\"", 5, &["`setup.files`", "a list", "a string"]);
    assert_fault("[\"a_*.csv\"]", "[\n\"a\",\n3]", 7, &["`setup.files`", "an integer"]);
    assert_fault("[[setup]]", "[setup]", 3, &["`setup`", "double brackets", "a table"]);
    assert_fault("reference = true", "reference = 1", 19, &["true or false", "an integer"]);
    assert_fault("[-1, 2.5]", "[-1, 2.5, 0]", 13, &["`setup.sensor.offset_m`", "[-1, 2.5, 0]"]);
    assert_fault("name = \"one\"\n", "", 3, &["[[setup]] needs `name`"]);
    assert_fault("node = 2\n", "", 14, &["[[setup.sensor]] needs `node`"]);
    assert_fault("unit = \"m/s2\"\n", "", 3, &["[[setup]] needs `unit`", "\"m/s2\""]);
    assert_fault("[structure]\nname = \"Mast\"\n", "", 1, &["the study needs `structure`"]);
    assert_fault("\"one\"", "\" \"", 4, &["`setup.name`"]);
}

#[test]
fn faults_of_value_are_told_with_what_was_expected() {
    assert_fault("m/s2", "m/s^2", 7, &["`setup.unit`", "\"m/s^2\"", "\"m/s2\", \"g\", \"V\""]);
    for rate in ["0", "-50.0", "nan", "inf", "1e999"] {
        assert_fault("= 50", &format!("= {rate}"), 6, &["`setup.sampling_rate_hz`", "above 0", rate]);
        assert_fault("= 25.0", &format!("= {rate}"), 22, &["`analysis.decimated_rate_hz`", "above 0", rate]);
    }
    for node in ["0", "-1", "65536", "99999999999999999999"] {
        assert_fault("node = 1", &format!("node = {node}"), 10, &["`setup.sensor.node`", "from 1 to 65535", node]);
    }
    for azimuth in ["\"north\"", "nan", "true", "\"18\""] {
        assert_fault("= 18", &format!("= {azimuth}"), 12, &["`setup.sensor.azimuth_deg`", "degrees", "\"up\""]);
    }
    assert_fault("10.5", "-inf", 11, &["`setup.sensor.elevation_m`", "-inf"]);
    for segment in ["128", "1000", "131072", "-256", "0"] {
        assert_fault("1024", segment, 23, &["`analysis.segment`", "a power of two from 256 to 65536", segment]);
    }
    assert_fault("\"a_*.csv\"", "\"a_***.csv\"", 5, &["`setup.files`", "a_***.csv"]);
    assert_fault("[\"a_*.csv\"]", "[]", 5, &["`setup.files`", "found []"]);
    assert_fault("node = 1", "node = 1\ndof = 0", 11, &["`setup.sensor.dof`", "from 1"]);
    assert_fault("0.03", "-0.03", 26, &["`model.background_stiffness`", "-0.03"]);
    assert_fault("0.03", "3", 26, &["`model.background_stiffness`", "0.03, which is 3 %"]);
}

#[test]
fn bands_and_rates_fit_the_recording() {
    assert_fault("[0.5, 10.0]", "[10.0, 0.5]", 21, &["`analysis.band_hz`", "lower frequency first"]);
    assert_fault("[0.5, 10.0]", "[0.5, 0.5]", 21, &["lower frequency first"]);
    assert_fault("[0.5, 10.0]", "[0.0, 10.0]", 21, &["above 0", "[0.0, 10.0]"]);
    // 0.4 times 25 Hz is 10 Hz: exactly there is fine (the sound study), above is not.
    assert_fault("[0.5, 10.0]", "[0.5, 10.1]", 21, &["10.1 Hz", "\"one\"", "10 Hz", "0.4 times", "raise"]);
    let full_rate = SOUND.replace("decimated_rate_hz = 25.0\n", "");
    assert!(load(&full_rate.replace("10.0]", "25.0]")).is_ok());
    assert_told(&full_rate.replace("10.0]", "25.1]"), 21, &["25.1 Hz", "25 Hz", "half the sampling rate"]);
    // 50/13 is whole but has no stages, 50/3 and 100 are not reached at all.
    for rate in ["3.8461538", "15.0", "100.0"] {
        assert_fault("= 25.0", &format!("= {rate}"), 22, &["`analysis.decimated_rate_hz`", "50 Hz", "whole number"]);
    }
    let thirds = SOUND.replace("= 50\n", "= 100\n").replace("= 25.0", "= 33.3333");
    assert!(load(&thirds).is_ok(), "a third of 100 Hz as one types it");
}

#[test]
fn names_stand_once_and_nodes_have_four_channels() {
    assert_fault("\"z\"", "\"x\"", 15, &["`setup.sensor.channel`", "\"x\"", "line 9"]);
    assert_fault("\"top\"", "\"x\"", 16, &["`setup.sensor.point`", "\"x\"", "line 8", "`point`"]);
    let more = (0..4).map(|n| format!("[[setup.sensor]]\nchannel = \"more{n}\"\nnode = 1\n")).collect::<String>();
    let crowded = SOUND.replace("[analysis]", &format!("{more}[analysis]"));
    assert_told(&crowded, 31, &["`setup.sensor.node`", "\"more3\"", "node 1", "\"one\"", "at most 4"]);
}

#[test]
fn a_study_measures_something() {
    let message = load("[structure]\nname = \"a\"\n").unwrap_err().to_string();
    assert!(message.contains("[[setup]]") && message.contains("[[sensor]]"), "{message}");
    let start = SOUND.find("[[setup.sensor]]").unwrap();
    assert_told(&SOUND[..start], 3, &["[[setup]] needs `sensor`"]);
}

#[test]
fn live_setups_have_no_files_and_measure_accelerations() {
    let live = SOUND.replace("files = [\"a_*.csv\"]", "live = true");
    let setup = load(&live).unwrap().setups.remove(0);
    assert!(setup.live && setup.files.is_empty() && setup.unit == Unit::MetrePerSecondSquared);
    let without_unit = live.replace("unit = \"m/s2\"\n", "");
    assert!(!without_unit.contains("unit") && load(&without_unit).unwrap().setups[0].live);
    assert!(!load(&SOUND.replace("unit", "live = false\nunit")).unwrap().setups[0].live);
    assert_fault("unit", "live = true\nunit", 5, &["`setup.files`", "from the nodes"]);
    assert_fault("files = [\"a_*.csv\"]", "live = true\nvariable = \"a\"", 6, &["`setup.variable`", "from the nodes"]);
    let volts = live.replace("unit = \"m/s2\"", "unit = \"g\"");
    assert_told(&volts, 7, &["`setup.unit`", "in which nodes measure"]);
}

/// Two setups; `second` is the second setup's sensors.
fn two_setups(second: &str) -> String {
    let setup = "[[setup]]\nname = \"two\"\nfiles = [\"b\"]\nsampling_rate_hz = 50\nunit = \"g\"\n";
    SOUND.replace("[analysis]", &format!("{setup}{second}[analysis]"))
}

#[test]
fn setups_are_tied_together_by_reference_points() {
    let tied = "[[setup.sensor]]\nchannel = \"7\"\npoint = \"top\"\nnode = 1\nreference = true\nazimuth_deg = \"up\"\n";
    assert_eq!(load(&two_setups(tied)).unwrap().setups.len(), 2);
    let parts = ["`setup`", "\"one\" has top", "\"two\" has none", "reference = true"];
    assert_told(&two_setups(&tied.replace("true", "false")), 20, &parts);
    assert_told(&two_setups(&tied.replace("top", "elsewhere")), 20, &["\"two\" has elsewhere", "`point`"]);
    assert_told(&two_setups(&tied.replace("\"up\"", "18")), 25, &["\"top\"", "line 14", "stays in place"]);
    let same_name = two_setups(tied).replace("\"two\"", "\"one\"");
    assert_told(&same_name, 21, &["`setup.name`", "\"one\"", "line 4"]);
}

#[test]
fn modes_from_elsewhere_and_matrices_stand_in_for_recordings_and_beam_tables() {
    let elsewhere = "[structure]\nname = \"a\"\n[measured]\nmodes = \"modes.csv\"\n[[sensor]]\nchannel = \"1\"\n\
                     dof = 3\n[model]\nmatrices = { file = \"m.mat\", stiffness = [\"k\", [\"spring\", 0.5]], mass = \"m.mtx\" }\n";
    let study = load(elsewhere).unwrap();
    assert!(study.setups.is_empty());
    assert_eq!(study.measured.as_ref().unwrap().modes, PathBuf::from("modes.csv"));
    assert_eq!(study.sensors()[0].dof, Some(3));
    let ModelSource::Matrices(matrices) = study.model.unwrap().source else { panic!("matrices were given") };
    let term = |name: &str, factor| MatrixTerm { name: name.to_owned(), factor };
    assert_eq!(matrices.stiffness, [term("k", 1.0), term("spring", 0.5)]);
    assert_eq!(matrices.mass, [term("m.mtx", 1.0)]);
    assert_eq!(matrices.file, Some(PathBuf::from("m.mat")));

    let frequencies_alone = "[structure]\nname = \"a\"\n[measured]\nmodes = \"modes.csv\"\n";
    assert!(load(frequencies_alone).unwrap().sensors().is_empty());
    assert_told(&format!("{SOUND}[measured]\nmodes = \"m.csv\"\n"), 27, &["[[setup]] (line 3", "remove one"]);
    assert_told(&format!("{SOUND}[[sensor]]\nchannel = \"1\"\n"), 27, &["[[setup.sensor]]"]);
    assert_told(&elsewhere.replace("[measured]\nmodes = \"modes.csv\"\n", ""), 1, &["needs `measured`"]);
    let wrong = |from: &str, to: &str, expected: &[&str]| assert_told(&elsewhere.replace(from, to), 9, expected);
    wrong("\"m.mtx\"", "[]", &["`model.matrices.mass`", "found []"]);
    wrong("0.5", "\"half\"", &["`model.matrices.stiffness`", "[name, factor]"]);
    wrong("file =", "fiel =", &["did you mean `file`"]);
    wrong("mass =", "nodes = \"n.csv\", dofs = \"d.csv\", mass =", &["either `nodes` or `dofs`"]);
}

#[test]
fn effects_are_kept_as_written() {
    let effect = "[[model.effect]]\nkind = \"tuned-mass-damper\"\nwhere = \"80m\"\nmass = 4e5\naxis = \"x\"\n";
    let study = load(&format!("{SOUND}{effect}")).unwrap();
    let effect = &study.model.unwrap().effects[0];
    assert_eq!(effect.line, 27);
    assert_eq!((effect.kind.as_str(), effect.location.as_deref()), ("tuned-mass-damper", Some("80m")));
    assert_eq!(effect.parameters["mass"].as_float(), Some(4e5));
    assert_eq!(effect.parameters["axis"].as_str(), Some("x"));

    assert_fault("beam = ", "matrices = {}\nbeam = ", 24, &["`model`", "more than one"]);
    assert_fault("beam = \"beam.csv\"\n", "", 24, &["has none"]);
    assert_told(&format!("{SOUND}[[model.effect]]\nvalue = 1\n"), 27, &["[[model.effect]] needs `kind`"]);
    let huge = format!("{SOUND}[[model.effect]]\nkind = \"p-delta\"\nvalue = 99999999999999999999\n");
    assert_told(&huge, 29, &["`model.effect.value`"]);
}

#[test]
fn a_model_of_modes_has_runs() {
    let start = SOUND.find("beam = ").unwrap();
    let before = &SOUND[..start];
    let runs = "modes = \"base.csv\"\n[[model.group]]\nname = \"soil\"\nstd = 0.2\n[[model.run]]\nchanged = \"soil\"\nby = 0.1\nquantity = \"mass\"\nmodes = \"soil.csv\"\n[[model.run]]\nchanged = \"soil\"\nby = -0.1\nquantity = \"mass\"\nmodes = \"m.csv\"\n";
    let model = load(&format!("{before}{runs}")).unwrap().model.unwrap();
    assert_eq!(model.source, ModelSource::Modes("base.csv".into()));
    let run = |line, change, is_mass, modes: &str| RunSource {
        line,
        changed: "soil".to_owned(),
        change,
        is_mass,
        modes: modes.into(),
    };
    assert_eq!(model.runs, [run(29, 0.1, true, "soil.csv"), run(34, -0.1, true, "m.csv")]);
    let wrong = |from: &str, to: &str, line, parts: &[&str]| {
        assert_told(&format!("{before}{}", runs.replacen(from, to, 1)), line, parts);
    };
    wrong("changed = \"soil\"", "changed = \"sole\"", 30, &["`model.run.changed`", "the name of a [[model.group]]"]);
    wrong("by = 0.1", "by = 0", 31, &["`model.run.by`", "1e-6 to 1000 in size"]);
    wrong("by = -0.1", "by = -1.5", 36, &["`model.run.by`", "above -1"]);
    wrong("\"mass\"", "\"weight\"", 32, &["`model.run.quantity`", "\"stiffness\" or \"mass\""]);
    wrong("std = 0.2", "std = 0.2\nstiffness = \"k.mtx\"", 27, &["`model.group.name`", "a [[model.run]] says"]);
    wrong("std = 0.2", "std = 0.2\n[[model.group]]\nname = \"piles\"\nstd = 0.1", 30, &["has as `changed`"]);
    wrong(
        "modes = \"base.csv\"",
        "beam = \"beam.csv\"",
        27,
        &["`model.group.name`", "`stiffness`, `mass` or `segments`"],
    );
    wrong("quantity = \"mass\"\nmodes = \"m.csv\"", "modes = \"m.csv\"", 35, &["the same in all runs of one name"]);
    let run_alone = "[[model.run]]\nchanged = \"soil\"\nby = 0.1\nmodes = \"soil.csv\"\n";
    assert_told(&format!("{SOUND}{run_alone}"), 27, &["`model.run`", "without [model] modes"]);
}

#[test]
fn a_folder_without_a_readable_study_is_told_by_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(STUDY_FILE);
    let message = Study::load(folder.path()).unwrap_err().to_string();
    assert!(message.contains(&file.display().to_string()) && message.contains("belfry init"), "{message}");
    std::fs::write(&file, b"[structure]\nname = \"\xff\"\n").unwrap();
    let message = Study::load(folder.path()).unwrap_err().to_string();
    assert!(message.contains("line 2") && message.contains("UTF-8"), "{message}");
    // What editors on Windows write: a byte order mark and CRLF.
    std::fs::write(&file, format!("\u{feff}{}", SOUND.replace('\n', "\r\n"))).unwrap();
    assert_eq!(Study::load(folder.path()).unwrap().setups, load(SOUND).unwrap().setups);
}

#[test]
fn a_change_keeps_the_line_ends_and_the_mark_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(STUDY_FILE);
    let choice = ModeChoice { add_hz: vec![0.5], ..ModeChoice::default() };
    let changed = |before: &str| {
        std::fs::write(&file, before).unwrap();
        edit::set_mode_choice(folder.path(), &choice).unwrap();
        std::fs::read_to_string(&file).unwrap()
    };
    let plain = changed(SOUND);
    assert!(plain.contains("add_modes_hz") && !plain.contains('\r'));
    assert_eq!(changed(&SOUND.replace('\n', "\r\n")), plain.replace('\n', "\r\n"));
    let marked = format!("\u{feff}{}", SOUND.replace('\n', "\r\n"));
    assert_eq!(changed(&marked), format!("\u{feff}{}", plain.replace('\n', "\r\n")));
}

#[test]
fn more_sensors_than_can_be_analysed_are_refused_at_once() {
    let head = &SOUND[..SOUND.find("[[setup.sensor]]").unwrap()];
    let sensors: String =
        (0..65_537).map(|n| format!("[[setup.sensor]]\nchannel = \"c{n}\"\nnode = {}\n", n / 4 + 1)).collect();
    let start = std::time::Instant::now();
    let message = load(&format!("{head}{sensors}")).unwrap_err().to_string();
    assert!(message.contains("65537 sensors") && message.contains("4096"), "{message}");
    assert!(start.elapsed() < std::time::Duration::from_secs(10), "{:?}", start.elapsed());
}

#[test]
fn the_templates_are_sound_studies() {
    let blank = load(template::BLANK_STUDY).unwrap();
    assert_eq!(blank.setups[0].sensors.len(), 2);
    let canton = load(template::CANTON_STUDY).unwrap();
    let setup = &canton.setups[0];
    assert_eq!((setup.name.as_str(), setup.sampling_rate_hz), ("january", 50.0));
    assert_eq!(setup.files, ["accdata_*.txt"]);
    assert_eq!(canton.analysis.band_hz, Some([0.05, 1.5]));
    let per_node = |node| setup.sensors.iter().filter(|sensor| sensor.node == node).count();
    assert_eq!((1..=8).map(per_node).collect::<Vec<_>>(), [2, 2, 2, 4, 2, 2, 2, 4]);
}

#[test]
fn the_blank_template_explains_every_key_with_a_value_that_loads() {
    let uncommented = template::BLANK_STUDY
        .lines()
        .map(|line| {
            line.strip_prefix("# ").filter(|line| line.contains(" = ") || line.starts_with('[')).unwrap_or(line)
        })
        .map(|line| format!("{line}\n"))
        .collect::<String>()
        .replace("unit = \"m/s2\"", "unit = \"V\"")
        .replacen("node = 1", "node = 1\nsensitivity_v_per_m_s2 = 0.1", 1);
    // What stands in the file one instead of the other: beam or matrices, setups or modes measured elsewhere.
    let (with_setups, elsewhere) = uncommented.split_once("[measured]").unwrap();
    let without = |text: &str, key: &str| -> String {
        text.lines().filter(|line| !line.starts_with(key)).map(|line| format!("{line}\n")).collect()
    };
    // And files or live nodes.
    let live = without(&without(&without(with_setups, "matrices = "), "files = "), "variable = ");
    let live = without(&live, "sensitivity_v_per_m_s2 = ").replace("unit = \"V\"", "unit = \"m/s2\"");
    assert!(load(&live).unwrap().setups[0].live);
    let with_setups = &without(with_setups, "live = ");
    let study = load(&without(with_setups, "matrices = ")).unwrap();
    assert_eq!(study.setups[0].sensors[1].dof, Some(123));
    assert_eq!(study.analysis.segment, Some(4096));
    let model = study.model.unwrap();
    assert_eq!((model.background_mass, model.effects.len()), (Some(0.01), 1));
    let matrices = load(&without(with_setups, "beam = ")).unwrap().model.unwrap();
    assert!(matches!(matrices.source, ModelSource::Matrices(source) if source.stiffness[1].factor == 0.8));
    let study = load(&format!("[structure]\nname = \"x\"\n[measured]{elsewhere}")).unwrap();
    assert_eq!(study.measured.unwrap().sensors[0].elevation_m, Some(20.0));
}

#[test]
fn groups_are_read_and_their_faults_named_by_line() {
    let text = |group: &str| {
        format!(
            "[structure]\nname = \"x\"\n[measured]\nmodes = \"m.csv\"\n[model]\nbeam = \"b.csv\"\n[[model.custom]]\nname = \"cables\"\nstiffness = \"k.mtx\"\n[[model.group]]\n{group}"
        )
    };
    let groups = |group: &str| load(&text(group)).map(|study| study.model.unwrap().customs);
    let read = groups("name = \"soil\"\nstiffness = \"s.mtx\"\nstd = 0.3\nz_m = [0.0, 2.5]\n").unwrap();
    assert_eq!((read[0].section(), read[1].section()), ("custom", "group"));
    assert_eq!(read[1].group, Some(GroupTerms { std: 0.3, span_m: Some([0.0, 2.5]) }));
    let at_one_height = groups("name = \"soil\"\nstiffness = \"s.mtx\"\nstd = 0.3\nz_m = 2.5\n").unwrap();
    assert_eq!(at_one_height[1].group.unwrap().span_m, Some([2.5, 2.5]));
    assert_eq!(groups("name = \"soil\"\nstiffness = \"s.mtx\"\nstd = 1.0\n").unwrap()[1].group.unwrap().std, 1.0);
    let refused = |group: &str| groups(group).unwrap_err().to_string();
    for (group, expected) in [
        ("name = \"soil\"\nstiffness = \"s.mtx\"\n", "`std`"),
        ("name = \"soil\"\nstiffness = \"s.mtx\"\nstd = -0.1\n", "-0.1"),
        ("name = \"soil\"\nstiffness = \"s.mtx\"\nstd = 3\n", "up to 1 such as 0.1, which is 10 %"),
        ("name = \"soil\"\nstiffness = \"s.mtx\"\nstd = 0.1\nz_m = [3.0, 1.0]\n", "z_m"),
        ("name = \"soil\"\nstd = 0.1\n", "what it changes"),
        ("name = \"cables\"\nstiffness = \"s.mtx\"\nstd = 0.1\n", "cables"),
    ] {
        assert!(refused(group).contains(expected), "{}", refused(group));
    }
}

#[test]
fn the_canton_template_is_the_benchmarks_table_of_channels() {
    let mut table =
        csv::Reader::from_path(concat!(env!("CARGO_MANIFEST_DIR"), "/templates/canton/channels.csv")).unwrap();
    let study = load(template::CANTON_STUDY).unwrap();
    let rows = table.records().map(Result::unwrap).collect::<Vec<_>>();
    assert_eq!(rows.len(), study.setups[0].sensors.len());
    for (row, sensor) in rows.iter().zip(&study.setups[0].sensors) {
        let number = |column: usize| row[column].parse::<f64>().unwrap();
        assert_eq!((&row[0], row[1].parse()), (sensor.channel.as_str(), Ok(sensor.node)));
        assert_eq!(sensor.elevation_m, Some(number(2)));
        assert_eq!(sensor.direction, Some(Direction::AzimuthDeg(number(4))));
        assert_eq!(sensor.offset_m, [number(5), number(6)]);
    }
}

#[test]
fn the_heritage_court_study_covers_every_column_and_ties_four_setups_by_two_references() {
    let study = Study::load(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../studies/heritage-court"))).unwrap();
    let sizes = study.setups.iter().map(|setup| setup.sensors.len()).collect::<Vec<_>>();
    assert_eq!(sizes, [6, 8, 8, 8]);
    for setup in &study.setups {
        let mut columns = setup.sensors.iter().map(|s| s.channel.parse().unwrap()).collect::<Vec<usize>>();
        columns.sort_unstable();
        assert_eq!(columns, (1..=setup.sensors.len()).collect::<Vec<_>>());
        // The references are the last two columns.
        let is_last = |sensor: &Sensor| sensor.channel.parse::<usize>().unwrap() + 2 > setup.sensors.len();
        assert!(setup.sensors.iter().all(|sensor| sensor.reference == is_last(sensor)));
    }
}

#[test]
fn nesting_without_end_is_an_error_and_not_an_overflow() {
    assert!(load(&format!("a = {}", "[".repeat(200_000))).is_err());
    assert!(load(&format!("[{}a]", "a.".repeat(200_000))).is_err());
}

proptest! {
    #[test]
    fn arbitrary_text_never_panics(text in any::<String>()) {
        let _ = load(&text).map_err(|error| error.to_string());
    }

    /// Arbitrary text is hardly ever TOML; a sound study with a piece overwritten comes further.
    #[test]
    fn a_study_with_a_piece_overwritten_never_panics(
        start in 0..SOUND.len(), length in 0_usize..30, piece in r#"[\[\]{}"'=.,0-9a-z\n -]{0,20}|-?inf|nan|\PC{0,5}"#,
    ) {
        let end = (start + length).min(SOUND.len());
        let text = format!("{}{piece}{}", &SOUND[..start], &SOUND[end..]);
        let _ = load(&text).map_err(|error| error.to_string());
    }

    #[test]
    fn a_key_with_an_arbitrary_value_never_panics(
        line in 0..SOUND.lines().count(), value in r#"-?[0-9]{1,25}|-?[0-9]{1,5}\.[0-9]{1,5}(e[0-9]{1,4})?|"\PC{0,9}"|\[[0-9,]{0,9}\]|\{\}|true|1979-05-27"#,
    ) {
        let replace = |(index, text): (usize, &str)| match text.split_once(" = ") {
            Some((key, _)) if index == line => format!("{key} = {value}\n"),
            _ => format!("{text}\n"),
        };
        let text = SOUND.lines().enumerate().map(replace).collect::<String>();
        let _ = load(&text).map_err(|error| error.to_string());
    }
}

#[test]
fn a_sensor_may_have_a_unit_and_a_direction_of_its_own() {
    let text = SOUND.replace("offset_m = [-1, 2.5]", "offset_m = [-1, 2.5]\nunit = \"m/s\"\ninclination_deg = -30");
    let study = load(&text).unwrap();
    let setup = &study.setups[0];
    assert_eq!(setup.unit_of(&setup.sensors[0]), Unit::MetrePerSecond);
    assert_eq!(setup.unit_of(&setup.sensors[1]), Unit::MetrePerSecondSquared);
    // Of both kinds, accelerations are made.
    assert_eq!((setup.motion(), setup.derivatives()), (Motion::Acceleration, vec![1, 0]));
    let [x, y, z] = setup.sensors[0].direction.unwrap().cosines();
    let (sin, cos) = 18_f64.to_radians().sin_cos();
    let along = 0.75_f64.sqrt();
    assert!((x - along * cos).abs() < 1e-12 && (y - along * sin).abs() < 1e-12 && (z + 0.5).abs() < 1e-12);
    let all = SOUND.replace("unit = \"m/s2\"", "unit = \"m/s\"");
    let study = load(&all).unwrap();
    assert_eq!((study.setups[0].motion(), study.setups[0].derivatives()), (Motion::Velocity, vec![0, 0]));
    let displacements = load(&SOUND.replace("unit = \"m/s2\"", "unit = \"m\"")).unwrap();
    assert_eq!(
        (displacements.setups[0].motion(), displacements.setups[0].derivatives()),
        (Motion::Acceleration, vec![2, 2])
    );
}

#[test]
fn units_and_inclinations_that_cannot_be_are_told() {
    assert_fault("offset_m = [-1, 2.5]", "unit = \"mm\"", 13, &["mm"]);
    assert_fault("offset_m = [-1, 2.5]", "inclination_deg = 120", 13, &["inclination_deg", "from -90 to 90"]);
    assert_fault("azimuth_deg = \"up\"", "azimuth_deg = \"up\"\ninclination_deg = 10", 19, &["beside an azimuth_deg"]);
    // Only volts have a sensitivity.
    assert_fault("offset_m = [-1, 2.5]", "unit = \"V\"", 8, &["sensitivity"]);
}
