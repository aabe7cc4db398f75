//! Structures in space: the templates of a frame and a bridge from a recording to the group that is off, their lines in pictures and on the page, sensors by
//! node and beside nodes, groups that change as one, and what is told where something does not fit.

use std::fs;
use std::path::Path;

use assert_cmd::prelude::*;
use belfry_tests::belfry_command;
use predicates::prelude::*;
use predicates::str::contains;

use crate::said::json;

fn template(name: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    belfry_command().arg("init").arg(folder.path()).args(["--template", name]).assert().success();
    folder
}

/// Replaces text of study.toml, which is there.
fn edit(folder: &Path, from: &str, to: &str) {
    let file = folder.join("study.toml");
    let text = fs::read_to_string(&file).unwrap();
    assert!(text.contains(from), "{from}");
    fs::write(file, text.replacen(from, to, 1)).unwrap();
}

/// An hour of the template's own structure, each group off by what it is trusted to at random and one by much more: it is named, fitted within three of
/// its deviations, and the error falls. The model is that of the recording but for its groups, so this says nothing of models that are wrong
/// otherwise.
fn a_hidden_change_is_named(name: &str, group: &str, change: f64) -> tempfile::TempDir {
    let folder = template(name);
    let path = folder.path().to_str().unwrap();
    let effect = format!("group@{group}={change}");
    belfry_command()
        .args(["simulate", path, "--effect", &effect, "--scatter", "0.5", "--seed", "5", "--adopt"])
        .assert()
        .success();
    belfry_command().args(["identify", path, "--direct"]).assert().success();
    let before = json(&["compare", path]);
    let diagnosis = json(&["diagnose", path]);
    assert_eq!(diagnosis["verdict"], "effect", "{}", diagnosis["candidates"][0]);
    assert_eq!(diagnosis["candidates"][0]["where"], group, "{}", diagnosis["candidates"][0]);
    let value = &diagnosis["candidates"][0]["parameters"][0];
    let (found, std) = (value["value"].as_f64().unwrap(), value["std"].as_f64().unwrap());
    // Half a standard deviation of the group's own is in the truth as well.
    assert!((found - change).abs() < 3.0 * std, "{found} ± {std}, not {change}");
    belfry_command().args(["add", path, &format!("group@{group}")]).assert().success();
    let after = json(&["compare", path]);
    let error = |comparison: &serde_json::Value| comparison["mean_abs_frequency_error_percent"].as_f64().unwrap();
    assert!(error(&after) < 0.5 * error(&before), "{} -> {} %", error(&before), error(&after));
    folder
}

#[test]
fn the_soft_storey_of_a_frame_is_named() {
    let folder = a_hidden_change_is_named("frame", "storey2", -0.25);
    let comparison = json(&["compare", folder.path().to_str().unwrap()]);
    assert!(
        comparison["by_group"].as_array().unwrap().is_empty(),
        "a frame that is higher than wide is told by height"
    );
    assert_eq!(comparison["by_height"].as_array().unwrap().len(), 5);
}

#[test]
fn the_soft_span_of_a_bridge_is_named_and_drawn_in_space() {
    let folder = a_hidden_change_is_named("bridge", "span2", -0.2);
    let path = folder.path().to_str().unwrap();
    let comparison = json(&["compare", path]);
    let groups: Vec<&str> =
        comparison["by_group"].as_array().unwrap().iter().map(|group| group["group"].as_str().unwrap()).collect();
    assert!(groups.starts_with(&["span1", "span2", "span3"]), "{groups:?}");
    assert!(comparison["by_height"].as_array().unwrap().is_empty(), "heights say nothing of where a bridge fails");
    let without = &comparison["groups_without_sensors"];
    assert_eq!(without.to_string(), r#"["piers","bearing-west","bearing-pier1","bearing-pier2","bearing-east"]"#);
    belfry_command()
        .args(["compare", path])
        .assert()
        .success()
        .stdout(contains("no sensor at group piers, bearing-west"));
    belfry_command().args(["compare", path]).assert().success().stdout(contains("by group:").and(contains("span2")));
    for picture in ["mode_shapes.svg", "comparison.svg"] {
        let svg = fs::read_to_string(folder.path().join("results").join(picture)).unwrap();
        assert!(svg.contains("at rest"), "{picture} is drawn on the bridge's lines");
    }
    belfry_command().args(["report", path]).assert().success();
    let report = fs::read_to_string(folder.path().join("results/report.html")).unwrap();
    assert!(report.contains("\"is_spatial\":true") && report.contains("\"surfaces\":[["));
}

/// Modes of another tool at two nodes of the frame, for what needs no recording.
fn measured(sensors: &str) -> tempfile::TempDir {
    let folder = template("frame");
    let file = folder.path().join("study.toml");
    let text = fs::read_to_string(&file).unwrap();
    let model = &text[text.find("[model]").unwrap()..];
    let head = "[structure]\nname = \"Frame\"\n\n[measured]\nmodes = \"modes.csv\"\n\n";
    fs::write(&file, format!("{head}{sensors}\n{model}")).unwrap();
    fs::write(
        folder.path().join("modes.csv"),
        "mode,frequency_hz,frequency_std_hz,roof,second\n1,1.3015,0.002,1.0,0.5\n2,4.2050,0.005,1.0,-1.0\n",
    )
    .unwrap();
    folder
}

const AT_NODES: &str = "[[sensor]]\nchannel = \"roof\"\nmodel_node = \"A5\"\nazimuth_deg = 0\n\n[[sensor]]\nchannel = \"second\"\nmodel_node = \"A2\"\nazimuth_deg = 0\n";

#[test]
fn sensors_stand_at_nodes_by_name_or_beside_the_nearest() {
    let folder = measured(AT_NODES);
    let path = folder.path().to_str().unwrap();
    let by_name = json(&["compare", path]);
    // 30 cm off the corner, where a bracket holds it.
    edit(folder.path(), "model_node = \"A5\"", "elevation_m = 17.5\noffset_m = [0.0, -0.3]");
    belfry_command().args(["compare", path]).assert().success().stderr(contains(
        "channel roof stands at no node of the model: the nearest, A5, is 0.30 m away, and its motion is taken",
    ));
    assert_eq!(json(&["compare", path])["pairs"], by_name["pairs"], "it is the same node");
    edit(folder.path(), "offset_m = [0.0, -0.3]", "offset_m = [0.0, -30.0]");
    let far = "the nearest is A5 at [0.0, 0.0, 17.5], 30.00 m away; check units and axes";
    belfry_command().args(["compare", path]).assert().failure().stderr(contains(far));
    edit(folder.path(), "elevation_m = 17.5\noffset_m = [0.0, -30.0]", "model_node = \"A55\"");
    let unknown = "model_node = \"A55\", but";
    let said = contains(unknown).and(contains("dofs.csv has no such node; did you mean \"A5\"?"));
    belfry_command().args(["compare", path]).assert().failure().stderr(said);
    edit(folder.path(), "model_node = \"A55\"", "model_node = \"A0\"");
    belfry_command()
        .args(["compare", path])
        .assert()
        .success()
        .stderr(contains("channel roof stands where the model cannot move"));
    edit(folder.path(), "model_node = \"A0\"", "model_node = \"A5\"\nelevation_m = 3.0");
    let twice = "`sensor.elevation_m`: expected left out beside model_node";
    belfry_command().args(["compare", path]).assert().failure().stderr(contains(twice));
}

#[test]
fn lines_between_nodes_that_do_not_exist_are_told_with_their_line() {
    let folder = measured(AT_NODES);
    let path = folder.path().to_str().unwrap();
    let lines = folder.path().join("lines.csv");
    let text = fs::read_to_string(&lines).unwrap();
    fs::write(&lines, text.replacen("A0,A1", "A0,A11", 1)).unwrap();
    let said = contains("lines.csv, line 2, column `to`: `A11` where a node of").and(contains("such as A1"));
    belfry_command().args(["compare", path]).assert().failure().stderr(said);
    fs::write(&lines, text.replacen("A0,A1", "A0,A0", 1)).unwrap();
    belfry_command()
        .args(["compare", path])
        .assert()
        .failure()
        .stderr(contains("another node than before in this line"));
    fs::write(&lines, text).unwrap();
    edit(folder.path(), "dofs = \"dofs.csv\"\n", "");
    for node in ["A5", "A2"] {
        edit(folder.path(), &format!("model_node = \"{node}\""), "dof = 25");
    }
    let said = contains("`lines`: nothing says where the nodes stand").and(contains("points"));
    belfry_command().args(["compare", path]).assert().failure().stderr(said);
}

/// A model that is known by its modes alone has lines where a table says where its columns (`300x`) stand.
#[test]
fn a_model_of_modes_is_drawn_by_points() {
    let folder = tempfile::tempdir().unwrap();
    let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("foreign/runs");
    for entry in fs::read_dir(from).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.extension().is_some_and(|ending| ending == "csv" || ending == "toml") {
            fs::copy(&entry, folder.path().join(entry.file_name().unwrap())).unwrap();
        }
    }
    let (mut points, mut lines) = ("node,x_m,y_m,z_m\n0,0,0,0\n2,12,0,0\n".to_owned(), "from,to\n".to_owned());
    for storey in 1..=6 {
        for column in [0, 2] {
            points += &format!("{},{},0,{}\n", 100 * storey + column, 6 * column, 3.5 * f64::from(storey));
            lines += &format!("{},{}\n", 100 * (storey - 1) + column, 100 * storey + column);
        }
        lines += &format!("{},{}\n", 100 * storey, 100 * storey + 2);
    }
    fs::write(folder.path().join("points.csv"), points).unwrap();
    fs::write(folder.path().join("lines.csv"), lines).unwrap();
    edit(folder.path(), "modes = \"base.csv\"", "modes = \"base.csv\"\npoints = \"points.csv\"\nlines = \"lines.csv\"");
    let comparison = json(&["compare", folder.path().to_str().unwrap()]);
    assert_eq!(comparison["by_height"].as_array().unwrap().len(), 6, "channels have the places of their nodes");
    let svg = fs::read_to_string(folder.path().join("results/comparison.svg")).unwrap();
    assert!(svg.contains("at rest"));
}

/// Two storeys tied together are one group with one value for both, which has no less than nothing left.
#[test]
fn groups_that_are_tied_change_as_one() {
    let folder = measured(AT_NODES);
    let path = folder.path().to_str().unwrap();
    let add = |name: &str, value: f64| {
        let text = format!("\n[[model.effect]]\nkind = \"group\"\nwhere = \"{name}\"\nvalue = {value}\n");
        let file = folder.path().join("study.toml");
        fs::write(&file, fs::read_to_string(&file).unwrap() + &text).unwrap();
    };
    let whole = fs::read_to_string(folder.path().join("study.toml")).unwrap();
    let frequencies = || -> Vec<f64> {
        json(&["compare", path])["pairs"]
            .as_array()
            .unwrap()
            .iter()
            .map(|pair| pair["model_hz"].as_f64().unwrap())
            .collect()
    };
    add("storey3", -0.2);
    add("storey4", -0.2);
    let one_by_one = frequencies();
    let storey4 = whole.find("name = \"storey4\"").unwrap();
    let std = storey4 + whole[storey4..].find("std = 0.03").unwrap();
    let tied = format!("{}tied_to = \"storey3\"{}", &whole[..std], &whole[std + "std = 0.03".len()..]);
    fs::write(folder.path().join("study.toml"), &tied).unwrap();
    add("storey3", -0.2);
    for (together, apart) in frequencies().iter().zip(&one_by_one) {
        assert!((together / apart - 1.0).abs() < 1e-9, "{together} and {apart} Hz");
    }
    add("storey3", -0.9);
    belfry_command().args(["compare", path]).assert().failure().stderr(contains("would leave less than nothing of it"));
    fs::write(folder.path().join("study.toml"), &tied).unwrap();
    add("storey4", -0.2);
    belfry_command().args(["compare", path]).assert().failure().stderr(contains("storey4").and(contains("storey3")));
    fs::write(folder.path().join("study.toml"), tied.replace("tied_to = \"storey3\"", "tied_to = \"storey9\""))
        .unwrap();
    let said = contains("the name of another [[model.group]] that is itself not tied");
    belfry_command().args(["compare", path]).assert().failure().stderr(said);
}

/// N, mm and t have the frequencies of N, m and kg, and a thousandth of their masses.
#[test]
fn other_units_are_told() {
    let folder = measured(AT_NODES);
    let path = folder.path().to_str().unwrap();
    let scale = |file: &str, factor: f64| {
        let file = folder.path().join(file);
        let text = fs::read_to_string(&file).unwrap();
        let mut lines = text.lines().map(str::to_owned).collect::<Vec<_>>();
        for line in lines.iter_mut().skip(2) {
            let words: Vec<&str> = line.split(' ').collect();
            *line = format!("{} {} {:e}", words[0], words[1], words[2].parse::<f64>().unwrap() * factor);
        }
        fs::write(file, lines.join("\n") + "\n").unwrap();
    };
    let right = json(&["compare", path]);
    belfry_command().args(["compare", path]).assert().success().stderr(contains("masses in t").not());
    for file in ["floors", "storey1", "storey2", "storey3", "storey4", "storey5", "mass"] {
        scale(&format!("{file}.mtx"), 1e-3);
    }
    belfry_command()
        .args(["compare", path])
        .assert()
        .success()
        .stderr(contains(
            "a thousandth of what structures do: are its masses in t, and its forces in N with lengths in mm, or in kN with m?",
        ));
    let hz = |comparison: &serde_json::Value| comparison["pairs"][0]["model_hz"].as_f64().unwrap();
    assert!((hz(&json(&["compare", path])) / hz(&right) - 1.0).abs() < 1e-6, "frequencies are the same");
    let dofs = folder.path().join("dofs.csv");
    let text = fs::read_to_string(&dofs).unwrap();
    fs::write(&dofs, text.replace(",17.5\n", ",17500\n")).unwrap();
    belfry_command().args(["compare", path]).assert().failure().stderr(contains("are their places in mm?"));
}

/// Matrices that no structure of this kind has: each has a word of its own.
#[test]
fn what_is_no_model_of_a_structure_at_rest_is_told() {
    let folder = measured(AT_NODES);
    let path = folder.path().to_str().unwrap();
    let refused = |file: &str, text: &str, word: &str| {
        let file = folder.path().join(file);
        let before = fs::read_to_string(&file).unwrap();
        fs::write(&file, text).unwrap();
        belfry_command().args(["compare", path]).assert().failure().stderr(contains(word));
        fs::write(&file, before).unwrap();
    };
    let floors = fs::read_to_string(folder.path().join("floors.mtx")).unwrap();
    refused("floors.mtx", &floors.replacen("real symmetric", "complex symmetric", 1), "entries are complex");
    let gyroscopic = "%%MatrixMarket matrix coordinate real general\n180 180 2\n1 2 1e6\n2 1 -1e6\n";
    refused("floors.mtx", gyroscopic, "gyroscopic terms");
    refused("floors.mtx", &floors.replacen("180 180", "186 186", 1), "all must be of one size");
    // The columns of the lowest storey are what holds it.
    let nothing = "%%MatrixMarket matrix coordinate real symmetric\n180 180 1\n180 180 1\n";
    refused("storey1.mtx", nothing, "the structure can move freely");
    edit(folder.path(), "stiffness = \"storey5.mtx\"", "stiffness = [[\"storey4.mtx\", 2.0]]");
    belfry_command()
        .args(["compare", path])
        .assert()
        .failure()
        .stderr(contains("it changes the same as group `storey4`"));
    edit(folder.path(), "stiffness = [[\"storey4.mtx\", 2.0]]", "stiffness = [[\"storey4.mtx\", 0.0]]");
    belfry_command().args(["compare", path]).assert().failure().stderr(contains("it changes nothing of the model"));
}

/// Rows that are numbered otherwise than their table has them: by the next row, and by nodes in another order.
#[test]
fn numbering_that_does_not_match_is_told() {
    let folder = measured(AT_NODES);
    let path = folder.path().to_str().unwrap();
    let doubt = "dofs.csv: are the rows of the matrices numbered so?";
    belfry_command().args(["compare", path]).assert().success().stderr(contains(doubt).not());
    let file = folder.path().join("dofs.csv");
    let text = fs::read_to_string(&file).unwrap();
    let renumbered = |number: &dyn Fn(usize) -> usize| -> String {
        let line = |line: &str| {
            let (row, rest) = line.split_once(',').unwrap();
            row.parse().map_or_else(|_| line.to_owned(), |row: usize| format!("{},{rest}", number(row)))
        };
        text.lines().map(line).collect::<Vec<_>>().join("\n")
    };
    for number in [&|row: usize| row % 180 + 1, &|row: usize| (7 * row) % 180 + 1] as [&dyn Fn(usize) -> usize; 2] {
        fs::write(&file, renumbered(number)).unwrap();
        for command in ["compare", "diagnose"] {
            belfry_command().args([command, path]).assert().stderr(contains(doubt));
        }
        let plan = ["plan", path, "--effect", "group@storey2=-0.2", "--hours", "1"];
        belfry_command().args(plan).assert().stderr(contains(doubt));
    }
}

/// Floors that are numbered from the top in one file and from the ground in the other: rows are in balance all the same, and the heights of
/// groups say otherwise.
#[test]
fn floors_that_are_numbered_from_the_other_end_are_told() {
    let folder = measured(AT_NODES);
    let path = folder.path().to_str().unwrap();
    let doubt = "dofs.csv: do nodes stand where it says? `z_m` of group `storey1` is 0 to 3.5 m";
    belfry_command().args(["compare", path]).assert().success().stderr(contains("do nodes stand").not());
    let file = folder.path().join("dofs.csv");
    let upside_down = |line: &str| match line.rsplit_once(',') {
        Some((start, z)) if !line.starts_with(',') => {
            z.parse().map_or_else(|_| line.to_owned(), |z: f64| format!("{start},{}", 21.0 - z))
        }
        _ => line.to_owned(),
    };
    let sound = fs::read_to_string(&file).unwrap();
    fs::write(&file, sound.lines().map(upside_down).collect::<Vec<_>>().join("\n")).unwrap();
    let doubted = contains(doubt).and(contains("3 of 5 groups with heights are off"));
    belfry_command().args(["compare", path]).assert().success().stderr(doubted);
    // Heights in the middles of storeys are no doubt, nor is one group at a height of its own.
    fs::write(&file, sound).unwrap();
    for storey in 1..=5 {
        let span = format!("z_m = [{:.1}, {:.1}]", 3.5 * f64::from(storey - 1), 3.5 * f64::from(storey));
        edit(
            folder.path(),
            &span,
            &format!("z_m = {}", if storey == 5 { 1.0 } else { 3.5 * f64::from(storey) - 1.75 }),
        );
    }
    belfry_command().args(["compare", path]).assert().success().stderr(contains("do nodes stand").not());
}

/// Trace lines (dataset 82) draw a structure, and GRID cards place it: the chain of six nodes that the reader's tests have, from Nastran and pyuff.
#[test]
fn a_model_of_nastran_stands_at_its_grid_points_and_is_drawn_by_trace_lines() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../host/tests-data");
    let folder = tempfile::tempdir().unwrap();
    for name in ["pynastran_16.bdf", "pynastran_grids_16.bdf", "pyuff_lines.unv"] {
        fs::copy(data.join(name), folder.path().join(name)).unwrap();
    }
    let study = "[structure]\nname = \"Chain\"\n\n[measured]\nmodes = \"modes.csv\"\n\n\
        [[sensor]]\nchannel = \"12x\"\n\n[[sensor]]\nchannel = \"16x\"\n\n\
        [model]\nlines = \"pyuff_lines.unv\"\n\n\
        [model.matrices]\nfile = \"pynastran_16.bdf\"\nstiffness = \"KAAX\"\nmass = \"MAAX\"\n\
        nodes = [\"pynastran_grids_16.bdf\", 0.001]\n";
    fs::write(folder.path().join("study.toml"), study).unwrap();
    let modes = "mode,frequency_hz,frequency_std_hz,12x,16x\n1,0.86,0.002,0.47,1.0\n2,2.55,0.005,1.0,-0.9\n";
    fs::write(folder.path().join("modes.csv"), modes).unwrap();
    let path = folder.path().to_str().unwrap();
    let comparison = json(&["compare", path]);
    // A chain of n equal springs and masses, held at one end: 2 sqrt(k/m) sin((2 i - 1) pi / (4 n + 2)) / (2 pi).
    for (number, pair) in (1..).zip(comparison["pairs"].as_array().unwrap()) {
        let angle = f64::from(2 * number - 1) * std::f64::consts::PI / 26.0;
        let expected = 2.0 * (1e6_f64 / 2e3).sqrt() * angle.sin() / std::f64::consts::TAU;
        assert!((pair["model_hz"].as_f64().unwrap() / expected - 1.0).abs() < 1e-9, "{pair}");
    }
    let heights: Vec<f64> = comparison["by_height"]
        .as_array()
        .unwrap()
        .iter()
        .map(|level| level["elevation_m"].as_f64().unwrap())
        .collect();
    assert_eq!(heights, [6.0, 18.0], "millimetres of the deck are metres here");
    belfry_command().args(["report", path]).assert().success();
    let file = folder.path().join("study.toml");
    fs::write(&file, study.replace(", 0.001]", "]")).unwrap();
    belfry_command().args(["compare", path]).assert().failure().stderr(contains("may have a factor"));
    fs::write(&file, study.replace("[\"pynastran_grids_16.bdf\", 0.001]", "\"pynastran_grids_16.bdf\"")).unwrap();
    belfry_command().args(["compare", path]).assert().failure().stderr(contains("are their places in mm?"));
}
