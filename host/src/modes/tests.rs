//! Files of modes: each format, what is missing in it, and what is refused.

use std::path::Path;

use proptest::prelude::*;

use super::*;

fn sensors(channels: &[&str]) -> Vec<Sensor> {
    channels.iter().map(|channel| Sensor { point: format!("point {channel}"), ..Sensor::new(*channel, 0) }).collect()
}

fn read_text(name: &str, text: &str, channels: &[&str]) -> Result<MeasuredModes, MeasuredError> {
    parse(Path::new(name), text.as_bytes(), &sensors(channels))
}

fn assert_told(name: &str, text: &str, channels: &[&str], expected: &[&str]) {
    let message = read_text(name, text, channels).unwrap_err().to_string();
    assert!(message.contains(name) && expected.iter().all(|part| message.contains(part)), "{message}");
}

#[test]
fn a_csv_table_has_a_column_a_channel_and_needs_only_frequencies() {
    let text = "mode,frequency_hz,frequency_std_hz,damping_ratio,top,top_std,mid\n\
                2,1.5,0.01,0.01,-1.0,0.02,0.5\n1,0.5,,,2.0,0.04,1.0\n";
    let modes = read_text("modes.csv", text, &["mid", "top"]).unwrap();
    assert!(modes.warnings.is_empty(), "{:?}", modes.warnings);
    // Lowest first, the largest component 1, deviations scaled alike; sensors in the study's order.
    assert_eq!(modes.modes.iter().map(|mode| mode.number).collect::<Vec<_>>(), [1, 2]);
    let first = &modes.modes[0];
    assert_eq!((first.frequency_std_hz, first.damping_ratio), (None, None));
    let shape = first.shape.as_ref().unwrap();
    assert_eq!((shape.sensors.as_slice(), shape.values.as_slice()), ([0, 1].as_slice(), [0.5, 1.0].as_slice()));
    let stds = shape.stds.as_ref().unwrap();
    assert!(stds[0].is_nan() && (stds[1] - 0.02).abs() < 1e-15);
    assert_eq!(modes.modes[1].shape.as_ref().unwrap().values.as_slice(), [-0.5, 1.0]);
    assert_eq!(modes.modes[1].frequency_std_hz, Some(0.01));

    let alone = read_text("table1.csv", "mode,type,measured_hz\n1,BY,0.094\n2,BX,0.138\n", &[]).unwrap();
    assert!(alone.modes.iter().all(|mode| mode.shape.is_none()) && alone.warnings.is_empty());
}

#[test]
fn a_file_may_state_which_of_the_models_modes_each_is() {
    let text = "mode,frequency_hz,model_mode\n1,0.5,\n2,1.5,3\n3,1.4,2\n";
    let mut modes = read_text("modes.csv", text, &[]).unwrap();
    let numbers: Vec<Option<usize>> =
        modes.modes.iter().map(|mode| mode.stated.as_ref().map(|stated| stated.number)).collect();
    assert_eq!(numbers, [None, Some(2), Some(3)]);
    assert!(modes.has_stated() && !are_known(&modes.modes) && are_known(&modes.modes[1..]));
    // A model of two modes has no third; the file's line says where that stands.
    let identity = nalgebra::DMatrix::identity(2, 2);
    let two = crate::model::Modes { frequency_hz: vec![1.0, 2.0], shapes: identity.clone() };
    let error = modes.find_stated(&identity, &two).unwrap_err().to_string();
    assert!(error.contains("modes.csv, line 3: model_mode 3, but the model as first given has 2 modes"), "{error}");
}

#[test]
fn a_covariance_factor_follows_its_shape_to_another_sign_length_and_order() {
    let file = |factor: &str| {
        format!(
            r#"{{"modes":[{{"frequency_hz":2.0,"frequency_std_hz":0.1,"shape":[
            {{"channel":"b","re":-4.0,"im":0.0,"std":0.4}},{{"channel":"a","re":2.0,"im":0.0,"std":0.2}}]{factor}}}]}}"#
        )
    };
    let read = |factor: &str| read_text("modes.json", &file(factor), &["a", "b"]).unwrap().modes.remove(0);
    let factor = r#","covariance_factor":{"group":7,"frequency_hz":[0.05,0.02],"damping_ratio":[0.0,0.0],"shape":[[0.4,0.0],[0.1,-0.1]]}"#;
    let mode = read(factor);
    let (shape, factor) = (mode.shape.unwrap(), mode.covariance_factor.unwrap());
    assert_eq!(
        (shape.values.as_slice(), shape.stds.unwrap().as_slice()),
        ([-0.5, 1.0].as_slice(), [0.05, 0.1].as_slice())
    );
    assert_eq!((factor.group, factor.frequency_hz.as_slice()), (7, [0.05, 0.02].as_slice()));
    let expected = nalgebra::dmatrix![0.1 / -4.0, -0.1 / -4.0; 0.4 / -4.0, 0.0];
    assert!((factor.shape - expected).amax() < 1e-15);
    // What is not of this form says nothing.
    for other in [
        "",
        r#","covariance_factor":3"#,
        r#","covariance_factor":{"group":7,"frequency_hz":[0.05],"damping_ratio":[0.0],"shape":[[0.4]]}"#,
    ] {
        assert_eq!(read(other).covariance_factor, None, "{other}");
    }
}

#[test]
fn components_that_are_missing_are_named_and_the_rest_is_kept() {
    let text = "mode,frequency_hz,a,b,c\n1,0.5,1.0,NaN,0.5\n2,0.7,,,\n";
    let modes = read_text("modes.csv", text, &["a", "b", "c", "d"]).unwrap();
    assert_eq!(modes.modes[0].shape.as_ref().unwrap().sensors, [0, 2]);
    assert_eq!(modes.modes[1].shape, None);
    let all = modes.warnings.join("\n");
    assert!(all.contains("mode 1: the shape has no component at channel b"), "{all}");
    assert!(all.contains("mode 2: no shape") && all.contains("no mode has a component at channel b, d"), "{all}");
}

#[test]
fn what_is_no_shape_or_no_deviation_is_said() {
    let text = "mode,frequency_hz,a,a_std,b,c\n1,0.5,1.0,-0.1,0.5,0.2\n2,0.7,,,0.3,\n";
    let modes = read_text("modes.csv", text, &["a", "b", "c"]).unwrap();
    assert_eq!(modes.modes[0].shape.as_ref().unwrap().stds, None);
    assert_eq!(modes.modes[1].shape, None);
    let all = modes.warnings.join("\n");
    assert!(all.contains("mode 1: the deviation at channel a is negative"), "{all}");
    assert!(all.contains("mode 2: a component at channel b alone is no shape"), "{all}");
    // A channel that one mode leaves out and others have.
    let text = r#"{"modes":[{"number":1,"frequency_hz":1.0,"shape":[{"channel":"a","re":1.0},{"channel":"b","re":0.5}]},
        {"number":2,"frequency_hz":2.0,"shape":[{"channel":"a","re":1.0},{"channel":"b","re":-0.5},{"channel":"c","re":0.1}]}]}"#;
    let modes = read_text("modes.json", text, &["a", "b", "c"]).unwrap();
    assert_eq!(modes.warnings.len(), 1, "{:?}", modes.warnings);
    assert!(modes.warnings[0].contains("mode 1: the shape has no component at channel c"), "{:?}", modes.warnings);
}

#[test]
fn csv_slips_are_told_by_line_and_column() {
    let csv = "modes.csv";
    assert_told(csv, "mode,frequency_hz,tpo\n1,0.5,1\n", &["top"], &["`tpo` is no channel", "it has top"]);
    assert_told(csv, "mode,a\n1,0.5\n", &["a"], &["line 1", "`frequency_hz` is missing"]);
    assert_told(csv, "mode,frequency_hz,a\n1,0.5,1\n2,-0.5,1\n", &["a"], &["line 3, column `frequency_hz`: `-0.5`"]);
    assert_told(csv, "mode,frequency_hz,a\n1,0.5,inf\n", &["a"], &["line 2, column `a`: `inf`"]);
    assert_told(csv, "mode,frequency_hz,a\n1,0.5,high\n", &["a"], &["line 2, column `a`: `high`"]);
    assert_told(csv, "mode,frequency_hz,a,b\n1,0.5,0,0\n", &["a", "b"], &["mode 1", "zero"]);
    assert_told(csv, "mode,frequency_hz\n1,0.5\n1,0.6\n", &[], &["two modes have the number 1"]);
    assert_told(csv, "mode,frequency_hz,a,a\n1,0.5,1,1\n", &["a"], &["mode 1: channel a has two components"]);
    assert_told(csv, "mode,frequency_hz,model_mode\n1,0.5,\n2,0.6,0\n", &[], &["line 3, column `model_mode`: `0`"]);
    assert_told(csv, "mode,frequency_hz,model_mode\n1,0.5,first\n", &[], &["line 2, column `model_mode`: `first`"]);
    let twice = "mode,frequency_hz,model_mode\n1,0.5,4\n2,0.6,\n7,0.7,4\n";
    assert_told(csv, twice, &[], &["line 4: model_mode 4", "measured mode 1 already"]);
    assert_told(csv, "mode,frequency_hz\n", &[], &["no modes"]);
    assert_told(csv, "mode,frequency_hz\n1,0.5,7\n", &[], &["line 2"]);
}

#[test]
fn complex_shapes_are_turned_to_where_they_are_most_real() {
    // A real shape times exp(i 1 rad).
    let (cos, sin) = (1f64.cos(), 1f64.sin());
    let cell = |value: f64| format!("{}{:+}i", value * cos, value * sin);
    let text = format!("frequency_hz,a,b,c\n0.5,{},{},{}\n", cell(0.3), cell(-2.0), cell(1.0));
    let modes = read_text("modes.csv", &text, &["a", "b", "c"]).unwrap();
    let values = &modes.modes[0].shape.as_ref().unwrap().values;
    for (found, expected) in values.iter().zip([-0.15, 1.0, -0.5]) {
        assert!((found - expected).abs() < 1e-12, "{values}");
    }
    assert!(modes.warnings.is_empty());
    let travelling = read_text("modes.csv", "frequency_hz,a,b\n0.5,1,0+0.9j\n", &["a", "b"]).unwrap();
    assert!(travelling.warnings[0].contains("complex"), "{:?}", travelling.warnings);
}

#[test]
fn what_identify_writes_is_read_by_point_and_channel() {
    let text = r#"{"modes":[{"number":1,"frequency_hz":0.5,"frequency_std_hz":0.001,"damping_ratio":0.01,
        "damping_ratio_std":0.001,"phase_collinearity":1.0,"shape":[
        {"channel":"b","point":"point b","re":0.5,"im":0.0,"std":0.01},
        {"channel":"one/a","point":"point a","re":1.0,"im":0.0,"std":null}]}],"averages":40,"warnings":[]}"#;
    let modes = read_text("modes.json", text, &["a", "b"]).unwrap();
    let shape = modes.modes[0].shape.as_ref().unwrap();
    assert_eq!((shape.sensors.as_slice(), shape.values.as_slice()), ([0, 1].as_slice(), [1.0, 0.5].as_slice()));
    assert_eq!(read_text("modes", "{\"modes\":[{\"frequency_hz\":2}]}", &[]).unwrap().modes[0].frequency_hz, 2.0);
    assert_told("modes.json", "{\"modes\":\n[{\"frequency\":1}]}", &[], &["line 2", "frequency_hz"]);
    let unknown = "{\"modes\":[{\"frequency_hz\":2,\"shape\":[{\"channel\":\"x\",\"re\":1}]}]}";
    assert_told("modes.json", unknown, &["a"], &["`x`", "it has a"]);
    assert_told("modes.json", "{\"modes\":[{\"frequency_hz\":0}]}", &[], &["mode 1", "0 Hz"]);
}

/// A dataset 55 as the format's description lays it out: five text lines, records 6 to 8, then nodes.
fn dataset_55(analysis: i32, data_type: i32, reals: &str, nodes: &str) -> String {
    format!(
        "    -1\n    55\nbelfry\nNONE\nNONE\nNONE\nNONE\n         1{analysis:10}         3        12{data_type:10}         3\n         \
         2         4         0         7\n{reals}\n{nodes}    -1\n"
    )
}

#[test]
fn a_universal_file_names_channels_by_node_and_direction() {
    let skipped = "    -1\n   151\nsomething\nelse\n    -1\n";
    let nodes =
        "        12\n  1.00000E+00  0.00000D+00  0.00000E+00\n        13\n  0.00000E+00 -5.00000D-01  0.00000E+00\n";
    let text = skipped.to_owned() + &dataset_55(2, 2, "  1.25000E+00  1.00000E+00  1.00000E-02  0.00000E+00", nodes);
    let modes = read_text("modes.uff", &text, &["12x", "13:+Y"]).unwrap();
    let mode = &modes.modes[0];
    assert_eq!((mode.number, mode.frequency_hz, mode.damping_ratio), (7, 1.25, Some(0.01)));
    assert_eq!(mode.shape.as_ref().unwrap().values.as_slice(), [1.0, -0.5]);
    assert_told("modes.uff", &text, &["12x", "14y"], &["node 13, direction y belongs to no sensor", "12x, 14y"]);
    // Complex: eigenvalue -0.1 + 10 i, values in pairs.
    let nodes = "1\n0 1  0 0  0 0\n2\n0 2  0 0  0 0\n";
    let text = dataset_55(3, 5, "-0.1 10.0 0 0 0 0", nodes);
    let modes = read_text("file", &text, &["left", "right"]).unwrap();
    let circular = (0.01f64 + 100.0).sqrt();
    assert!((modes.modes[0].frequency_hz - circular / std::f64::consts::TAU).abs() < 1e-12);
    assert!((modes.modes[0].damping_ratio.unwrap() - 0.1 / circular).abs() < 1e-12);
    // Labels 1 and 2, one direction each, two sensors: in order.
    assert_eq!(modes.modes[0].shape.as_ref().unwrap().values.as_slice(), [0.5, 1.0]);
    assert_told("modes.uff", "    -1\n  2414\n", &[], &["2414", "dataset 55"]);
    let cut = text.split("2\n0 2").next().unwrap().to_owned() + "2\n0 2\n";
    assert_told("modes.uff", &cut, &["left", "right"], &["ends where a node's values"]);
    let cut = text.trim_end().strip_suffix("-1").unwrap().trim_end();
    assert_told("modes.uff", cut, &["left", "right"], &["cut off"]);
    // That the order was taken is said.
    assert!(modes.warnings[0].contains("nodes 1 to 2 are taken for the study's channels"), "{:?}", modes.warnings);
}

proptest! {
    #[test]
    fn no_bytes_make_a_reader_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300), kind in 0..3usize) {
        let name = ["modes.json", "modes.csv", "modes.uff"][kind];
        let _ = parse(Path::new(name), &bytes, &sensors(&["1", "2x"]));
    }

    #[test]
    fn no_universal_file_makes_a_reader_panic(words in proptest::collection::vec("(-1|55|0|2|7|1e9|x|99999999999999999999|\n)", 0..80)) {
        let text = format!("    -1\n    55\n1\n2\n3\n4\n5\n{}", words.join(" "));
        let _ = parse(Path::new("modes.uff"), text.as_bytes(), &sensors(&["1", "2x"]));
    }
}
