//! A model of CalculiX, a finite element program of its own, as it writes it: matrices and the names of their rows, read as they are.

use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::Command;

use crate::said::json;

/// Elements along each axis, and their sizes in m: a cantilever that is wider along Y.
const ELEMENTS: [usize; 3] = [2, 2, 20];
const SIZES_M: [f64; 3] = [0.5, 0.65, 1.0];

fn node(at: [usize; 3]) -> usize {
    (at[2] * (ELEMENTS[1] + 1) + at[1]) * (ELEMENTS[0] + 1) + at[0] + 1
}

fn places(counts: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    (0..counts[2]).flat_map(move |k| (0..counts[1]).flat_map(move |j| (0..counts[0]).map(move |i| [i, j, k])))
}

/// The input of a cantilever of solid elements whose lower half has a modulus of its own, and what is asked of it.
fn input(lower_n_m2: f64, step: &str) -> String {
    let mut text = "*NODE,NSET=ALL\n".to_owned();
    for at in places(ELEMENTS.map(|count| count + 1)) {
        let place: Vec<String> = at.iter().zip(SIZES_M).map(|(at, size)| (*at as f64 * size).to_string()).collect();
        writeln!(text, "{},{}", node(at), place.join(",")).unwrap();
    }
    for (name, is_upper) in [("LOW", false), ("HIGH", true)] {
        writeln!(text, "*ELEMENT,TYPE=C3D8I,ELSET={name}").unwrap();
        for (number, [i, j, k]) in places(ELEMENTS).enumerate().filter(|(_, at)| (at[2] >= 10) == is_upper) {
            let corners = [[0, 0], [1, 0], [1, 1], [0, 1]];
            let corner = |up: usize| corners.map(|[x, y]| node([i + x, j + y, k + up]).to_string());
            writeln!(text, "{},{}", number + 1, [corner(0), corner(1)].concat().join(",")).unwrap();
        }
    }
    let base: Vec<String> = places([ELEMENTS[0] + 1, ELEMENTS[1] + 1, 1]).map(|at| node(at).to_string()).collect();
    writeln!(text, "*NSET,NSET=BASE\n{}\n*BOUNDARY\nBASE,1,3", base.join(",\n")).unwrap();
    for (name, modulus) in [("LOW", lower_n_m2), ("HIGH", 3e10)] {
        writeln!(
            text,
            "*MATERIAL,NAME=M{name}\n*ELASTIC\n{modulus:e},0.2\n*DENSITY\n2500\n*SOLID SECTION,ELSET={name},MATERIAL=M{name}"
        )
        .unwrap();
    }
    text + "*STEP\n" + step + "\n*END STEP\n"
}

fn calculix(folder: &Path, name: &str, text: &str) {
    fs::write(folder.join(format!("{name}.inp")), text).unwrap();
    let run = Command::new("ccx").arg(name).current_dir(folder).output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stdout));
}

/// The frequencies in Hz that CalculiX finds itself.
fn frequencies_hz(folder: &Path, name: &str) -> Vec<f64> {
    let text = fs::read_to_string(folder.join(format!("{name}.dat"))).unwrap();
    let rows = text.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
    let rows = rows.filter(|words| words.len() == 5 && words[0].parse::<usize>().is_ok());
    rows.map(|words| words[3].parse().unwrap()).collect()
}

/// Its matrices have its frequencies in Belfry; a lower half that is softer than the model has it is named, by name and value.
#[test]
#[cfg_attr(not(calculix), ignore = "CalculiX (ccx) is not installed; ./test installs it")]
fn a_model_of_calculix_is_read_reduced_and_diagnosed() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let path = at.to_str().unwrap();
    let matrices = "*FREQUENCY,SOLVER=MATRIXSTORAGE\n8";
    calculix(at, "model", &input(3e10, matrices));
    // What the lower half has of K: the difference to twice its modulus.
    calculix(at, "low", &input(6e10, matrices));
    calculix(at, "sound", &input(3e10, "*FREQUENCY\n8"));
    calculix(at, "soft", &input(2.4e10, "*FREQUENCY\n8"));
    let (sound_hz, soft_hz) = (frequencies_hz(at, "sound"), frequencies_hz(at, "soft"));
    let modes = |hz: &[f64]| {
        let row = |(at, hz): (usize, &f64)| format!("{},{hz},{}\n", at + 1, hz * 1e-3);
        let rows: String = hz.iter().take(6).enumerate().map(row).collect();
        format!("mode,frequency_hz,frequency_std_hz\n{rows}")
    };
    fs::write(
        at.join("study.toml"),
        format!(
            r#"[structure]
name = "Cantilever"

[measured]
modes = "modes.csv"

[[sensor]]
channel = "{top}x"

[[sensor]]
channel = "{top}y"

[model.matrices]
stiffness = "model.sti"
mass = "model.mas"
dofs = "model.dof"

[[model.group]]
name = "lower"
stiffness = ["low.sti", ["model.sti", -1]]
std = 0.02

[[model.group]]
name = "upper"
stiffness = [["model.sti", 2], ["low.sti", -1]]
std = 0.02
"#,
            top = node(ELEMENTS)
        ),
    )
    .unwrap();
    fs::write(at.join("modes.csv"), modes(&sound_hz)).unwrap();
    let compared = json(&["compare", path]);
    for pair in compared["pairs"].as_array().unwrap() {
        // CalculiX prints seven digits.
        let error = pair["frequency_error_percent"].as_f64().unwrap().abs();
        assert!(error < 1e-4, "{pair}");
    }
    fs::write(at.join("modes.csv"), modes(&soft_hz)).unwrap();
    let diagnosis = json(&["diagnose", path]);
    assert_eq!(diagnosis["verdict"], "effect", "{diagnosis}");
    let best = &diagnosis["candidates"][0];
    assert_eq!((best["effect"].as_str(), best["where"].as_str()), (Some("group"), Some("lower")), "{best}");
    let value = &best["parameters"][0];
    let (value, std) = (value["value"].as_f64().unwrap(), value["std"].as_f64().unwrap());
    assert!((value + 0.2).abs() < 2.0 * std + 0.01, "{value} ± {std}");
}
