//! UFF 58: text and binary, names, lengths, damage.

use super::*;

/// How the numbers of a dataset are written.
#[derive(Clone, Copy, Debug)]
enum Form {
    Text,
    Binary { big_endian: bool },
}

#[derive(Clone)]
struct Dataset {
    title: &'static str,
    node: i32,
    direction: i32,
    function: i32,
    ordinate: i32,
    double: bool,
    start_s: f64,
    step_s: f64,
    values: Vec<f64>,
}

fn response(node: i32, direction: i32, values: &[f64]) -> Dataset {
    Dataset {
        title: "Response",
        node,
        direction,
        function: 1,
        ordinate: 12,
        double: true,
        start_s: 0.0,
        step_s: 0.02,
        values: values.to_vec(),
    }
}

impl Dataset {
    /// As the format's description lays it out.
    fn bytes(&self, form: Form) -> Vec<u8> {
        let mut bytes = b"    -1\n    58".to_vec();
        let size = if self.double { 8 } else { 4 };
        if let Form::Binary { big_endian } = form {
            let (order, length) = (1 + i32::from(big_endian), size * self.values.len());
            bytes.extend(format!("b{order:6}{:6}{:12}{length:12}{:6}{:6}{:12}{:12}", 2, 11, 0, 0, 0, 0).bytes());
        }
        let axis = |kind: i32| format!("{kind:10}{:5}{:5}{:5} {:20} {:20}\n", 0, 0, 0, "NONE", "NONE");
        let header = format!(
            "\n{}\nNONE\n24-Nov-21 10:00:00\nNONE\nNONE\n{:5}{:10}{:5}{:10} {:10}{:10}{:4} {:10}{:10}{:4}\n\
             {:10}{:10}{:10}{:13.5e}{:13.5e}{:13.5e}\n{}{}{}{}",
            self.title,
            self.function,
            0,
            0,
            0,
            "a node",
            self.node,
            self.direction,
            "",
            0,
            0,
            if self.double { 4 } else { 2 },
            self.values.len(),
            1,
            self.start_s,
            self.step_s,
            0.0,
            axis(17),
            axis(self.ordinate),
            axis(0),
            axis(0),
        );
        bytes.extend(header.bytes());
        match form {
            Form::Text => {
                for line in self.values.chunks(if self.double { 4 } else { 6 }) {
                    let cells =
                        line.iter().map(|v| if self.double { format!("{v:20.11e}") } else { format!("{v:13.5e}") });
                    bytes.extend((cells.collect::<String>() + "\n").bytes());
                }
            }
            Form::Binary { big_endian } => {
                for value in &self.values {
                    let mut raw =
                        if self.double { value.to_be_bytes().to_vec() } else { (*value as f32).to_be_bytes().to_vec() };
                    if !big_endian {
                        raw.reverse();
                    }
                    bytes.extend(raw);
                }
            }
        }
        bytes.extend(b"    -1\n");
        bytes
    }
}

const FORMS: [Form; 3] = [Form::Text, Form::Binary { big_endian: false }, Form::Binary { big_endian: true }];

fn file(datasets: &[Dataset], form: Form) -> Vec<u8> {
    // A dataset of another number goes before, as most writers do.
    let mut bytes = b"    -1\n   151\nmodel\nNONE\n    -1\n".to_vec();
    bytes.extend(datasets.iter().flat_map(|dataset| dataset.bytes(form)));
    bytes
}

#[test]
fn text_and_both_byte_orders_give_the_same_rows() {
    // Numbers that five decimals hold, so that single precision as text does.
    let ramp = |scale: f64| (0..6001).map(|row| scale * f64::from(row)).collect::<Vec<f64>>();
    for form in FORMS {
        for double in [true, false] {
            let mut one = response(12, 1, &ramp(0.5));
            one.double = double;
            let two = Dataset { direction: -2, double: !double, ..response(7, -2, &ramp(-0.25)) };
            let bytes = file(&[one, two], form);
            for (channels, scales) in [(["12x", "7-y"], [0.5, -0.25]), (["7:-Y", "12:+X"], [-0.25, 0.5])] {
                let rows = rows_of(&setup(&channels, &["a.uff"]), "a.uff", &bytes);
                assert_eq!(rows.len(), 6001);
                let fits = |row: f64, values: &[f64]| values == scales.map(|scale| scale * row);
                assert!((0..).map(f64::from).zip(&rows).all(|(row, values)| fits(row, values)), "{form:?}");
            }
        }
    }
}

#[test]
fn channels_go_by_node_title_or_position() {
    let mut one = response(1, 1, &[1.0, 2.0]);
    one.title = "north";
    let mut two = response(0, 0, &[3.0, 4.0]);
    two.title = "17";
    let bytes = file(&[one, two], Form::Text);
    for names in [["1x", "17"], ["north", "17"], ["1", "2"]] {
        assert_eq!(rows_of(&setup(&names, &["a.unv"]), "a.unv", &bytes), [[1.0, 3.0], [2.0, 4.0]]);
    }
    let unknown = setup(&["2x"], &["a.uff"]);
    expect_error(&unknown, &[("a.uff", &bytes)], &["a.uff has no channel `2x`", "time responses `1x`, `17`"]);
    let twice = file(&[response(1, 1, &[1.0]), response(1, 1, &[1.0])], Form::Text);
    expect_error(&setup(&["1x"], &["a.uff"]), &[("a.uff", &twice)], &["more than one", "`1x`"]);
}

#[test]
fn titles_may_differ_between_files_whose_nodes_are_the_same() {
    let with_title = |title, value| Dataset { title, ..response(1, 1, &[value]) };
    let (one, two) = (file(&[with_title("9:00", 1.0)], Form::Text), file(&[with_title("10:00", 2.0)], FORMS[1]));
    let other = file(&[response(2, 1, &[1.0])], Form::Text);
    let files: [(&str, &[u8]); 2] = [("1.uff", &one), ("2.uff", &two)];
    let (rows, _) = read(&setup(&["1x"], &["*.uff"]), folder(&files).path()).unwrap();
    assert_eq!(rows, [[1.0], [2.0]]);
    expect_error(
        &setup(&["1"], &["*.uff"]),
        &[("1.uff", &one), ("2.uff", &other)],
        &["2.uff has the time responses `2x`"],
    );
}

#[test]
fn what_contradicts_the_setup_is_named() {
    let one = setup(&["1x"], &["a.uff"]);
    let good = response(1, 1, &[1.0, 2.0, 3.0]);
    let check = |datasets: &[Dataset], setup: &Setup, parts: &[&str]| {
        for form in FORMS {
            expect_error(setup, &[("a.uff", &file(datasets, form))], parts);
        }
    };
    let fast = Dataset { step_s: 0.01, ..good.clone() };
    check(&[fast], &one, &["a.uff, channel `1x`", "100.0000 Hz", "sampling_rate_hz is 50"]);
    let still = Dataset { step_s: 0.0, ..good.clone() };
    check(&[still], &one, &["a.uff, channel `1x`", "inf Hz"]);
    let velocity = Dataset { ordinate: 11, ..good.clone() };
    check(std::slice::from_ref(&velocity), &one, &["a.uff, channel `1x`", "velocity", "`unit`"]);
    let both = setup(&["1x", "2y"], &["a.uff"]);
    check(&[good.clone(), response(2, 2, &[1.0])], &both, &["channel `2y`", "1 samples", "has 3"]);
    let late = Dataset { start_s: 1.5, ..response(2, 2, &[1.0, 2.0, 3.0]) };
    check(&[good.clone(), late], &both, &["channel `2y`", "starts 1.5 s after"]);
    let spectrum = Dataset { function: 2, ..good.clone() };
    check(&[spectrum], &one, &["a.uff has no time response", "dataset 151, a function of type 2"]);
    check(&[response(1, 1, &[])], &one, &["a.uff is empty"]);
    let infinite = file(&[response(1, 1, &[1.0, f64::INFINITY])], Form::Text);
    expect_impossible(&one, "a.uff", &infinite, &["a.uff, row 2", "\"1x\"", "inf"]);
    let as_velocity = Setup { unit: Unit::MetrePerSecond, ..one.clone() };
    assert_eq!(rows_of(&as_velocity, "a.uff", &file(&[velocity], Form::Text)).len(), 3);
    let rows = rows_of(&one, "a.uff", &file(&[response(1, 1, &[1.0, f64::NAN, 3.0])], Form::Text));
    assert!(rows[1][0].is_nan() && rows[2][0] == 3.0);
}

#[test]
fn a_file_cut_short_is_refused() {
    let one = setup(&["1x"], &["a.uff"]);
    for form in FORMS {
        let whole = file(&[response(1, 1, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])], form);
        for length in 0..whole.len() - 5 {
            let folder = folder(&[("a.uff", &whole[..length])]);
            assert!(read(&one, folder.path()).is_err(), "{form:?} cut to {length} bytes");
        }
    }
    let text = String::from_utf8(file(&[response(1, 1, &[1.0; 6])], Form::Text)).unwrap();
    let check = |text: &str, parts: &[&str]| expect_error(&one, &[("a.uff", text.as_bytes())], parts);
    check(text.trim_end().trim_end_matches("-1"), &["a.uff, dataset 2", "-1", "missing"]);
    check(&text.replace("         6         1  ", "         7         1  "), &["row 7", "`1x` ends before"]);
    check(
        &text.replace("         6         1  ", "         5         1  "),
        &["row 6", "has 6 samples", "announces 5"],
    );
    let wrong = text.replacen("1.00000000000e0\n", "1.0 volt\n", 1);
    check(&wrong, &["a.uff, row", "`1x`", "not a number", "6E13.5"]);
    let binary = file(&[response(1, 1, &[1.0; 6])], FORMS[1]);
    let cut = &binary[..binary.len() - 20];
    expect_error(&one, &[("a.uff", cut)], &["a.uff, dataset 2", "48 bytes of samples announced"]);
}

/// What the Python package pyuff writes; `host/tests-data/README.md` says how.
#[test]
fn files_of_another_writer_are_read_to_their_last_digit() {
    let first = [0.5, -1.25, 3.0e-7, std::f64::consts::PI, -2.0e5, 6.0, 7.5];
    let second = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, -7.125];
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests-data"));
    for (file, digits) in [("pyuff_text.uff", 1e-11), ("pyuff_little.uff", 0.0), ("pyuff_big.uff", 0.0)] {
        for names in [["12x", "7-y"], ["channel 0", "channel 1"], ["1", "2"]] {
            let (rows, _) = read(&setup(&names, &[file]), folder).unwrap();
            assert_eq!(rows.len(), 7);
            for (row, expected) in rows.iter().zip(first.iter().zip(&second)) {
                assert!((row[0] - expected.0).abs() <= digits * expected.0.abs(), "{file}: {row:?}");
                assert_eq!(row[1], *expected.1, "{file}");
            }
        }
    }
}
