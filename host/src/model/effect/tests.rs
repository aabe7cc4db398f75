//! Effects: their words, their bounds, and what the eigenproblem says of them.

use std::path::Path;

use super::*;
use crate::model::{BeamTable, Body, Segment};

fn beam() -> BeamTable {
    let mut text = String::from(
        "z_bottom_m,z_top_m,bending_1_n_m2,bending_2_n_m2,axis_deg,shear_n,torsion_n_m2,mass_top_kg,inertia_x_kg_m2,inertia_y_kg_m2,inertia_z_kg_m2\n",
    );
    for index in 0..10 {
        let (bottom, top) = (10 * index, 10 * (index + 1));
        text.push_str(&format!("{bottom},{top},1e11,3e11,20,5e9,2e10,1e5,1e5,1e5,5e5\n"));
    }
    BeamTable::from_reader(text.as_bytes(), Path::new("beam.csv")).unwrap()
}

fn frequencies(words: &[&str]) -> Vec<f64> {
    let effects: Vec<Effect> = words.iter().map(|word| word.parse().unwrap()).collect();
    Structure::with_effects(beam(), &effects).unwrap().assemble().modes().unwrap().frequency_hz
}

fn refusal(word: &str) -> String {
    word.parse::<Effect>().unwrap_err().to_string()
}

#[test]
fn words_become_effects_and_back() {
    let effect: Effect = "added-mass@443.6m=2e5".parse().unwrap();
    assert_eq!(effect.to_string(), "added-mass@443.6m");
    assert_eq!(effect.place(), Some(&Where::Height(443.6)));
    let record = effect.record();
    assert_eq!(record.r#where.as_deref(), Some("443.6m"));
    assert_eq!(record.parameters[0], ParameterRecord { name: "mass".into(), value: 2e5, unit: "kg".into() });
    let json = serde_json::to_value(&record).unwrap();
    assert_eq!(json["where"], "443.6m");

    let both: Effect = "base-rotation=flexibility_y=2e-14,flexibility_x=1e-14".parse().unwrap();
    let values: Vec<_> = both.parameters().map(|(parameter, value)| (parameter.name, value)).collect();
    assert_eq!(values, [("flexibility_x", 1e-14), ("flexibility_y", 2e-14)]);

    for text in ["443.6m", "ch07", "ch04+ch05", "node3", "0.83hz", "-10m"] {
        assert_eq!(text.parse::<Where>().unwrap().to_string(), text);
    }
}

#[test]
fn wrong_words_are_refused_with_what_was_expected() {
    assert_eq!(
        refusal("base-rotaton=1e-14"),
        "no effect is called `base-rotaton`; there are stiffness-scale, mass-scale, base-rotation, base-translation, added-mass, stiffness-loss"
    );
    for (word, part) in [
        ("stiffness-loss@50m=1.5", "stiffness-loss: relative = 1.5 is out of range; it must be 0 to 0.99"),
        ("base-rotation=-1e-15", "flexibility = -0.000000000000001 is out of range; it must be 0 or more rad/(N m)"),
        ("added-mass@50m=nan", "mass = NaN is out of range; it must be 0 or more kg"),
        ("added-mass=5", "needs a height such as @225.2m, not nothing"),
        ("added-mass@ch07=5", "not @ch07"),
        ("mass-scale@50m=0.1", "takes no @WHERE"),
        ("added-mass@50=5", "`50` is no place"),
        ("mass-scale", "no value"),
        ("mass-scale=", "no value"),
        ("mass-scale=much", "`much` is not a value for it; expected relative (-0.9 to 9)"),
        ("base-rotation=flexibility_x=1e-14", "expected flexibility (0 or more rad/(N m)), or flexibility_x"),
    ] {
        let error = refusal(word);
        assert!(error.contains(part), "{word}: {error}");
    }
    let above: Effect = "added-mass@100.5m=5".parse().unwrap();
    let error = Structure::with_effects(beam(), &[above]).unwrap_err().to_string();
    assert_eq!(error, "added-mass@100.5m: the beam stands from 0 m to 100 m");
}

#[test]
fn scales_move_all_frequencies_by_the_square_root_and_are_twins() {
    let sound = frequencies(&[]);
    let stiffer = frequencies(&["stiffness-scale=0.21"]);
    let twin = frequencies(&[&format!("mass-scale={}", 1.0 / 1.21 - 1.0)]);
    for ((sound, stiffer), twin) in sound.iter().zip(stiffer).zip(twin) {
        // Rounding of the eigenproblem: the highest eigenvalue is 1e6 times the lowest.
        assert!((stiffer / sound - 1.1).abs() < 1e-8);
        assert!((twin / stiffer - 1.0).abs() < 1e-8);
    }
}

/// The condensed base is exact: the same modes as with the base DOFs kept and a spring put under them. The spring model
/// is made of a first segment so short and stiff that it is rigid, hinged by its own bending flexibility L/EI.
#[test]
fn base_flexibility_equals_a_soft_hinge_segment() {
    let flexibility = 4e-11;
    let found = frequencies(&[&format!("base-rotation={flexibility}")]);
    let mut text = String::from(
        "z_bottom_m,z_top_m,bending_1_n_m2,bending_2_n_m2,axis_deg,shear_n,torsion_n_m2,mass_top_kg,inertia_x_kg_m2,inertia_y_kg_m2,inertia_z_kg_m2\n",
    );
    let hinge = 1e-3;
    let bending = hinge / flexibility;
    text.push_str(&format!("{},0,{bending},{bending},0,,1e14,1e-3,1e-3,1e-3,1e-3\n", -hinge));
    for index in 0..10 {
        text.push_str(&format!("{},{},1e11,3e11,20,5e9,2e10,1e5,1e5,1e5,5e5\n", 10 * index, 10 * (index + 1)));
    }
    let hinged = BeamTable::from_reader(text.as_bytes(), Path::new("hinged.csv")).unwrap();
    let hinged = Structure::new(hinged).assemble().modes().unwrap().frequency_hz;
    let sound = frequencies(&[]);
    for mode in 0..8 {
        // The hinge is 1 mm long on 100 m, its rotation centre half a millimetre low.
        assert!((hinged[mode] / found[mode] - 1.0).abs() < 5e-5, "mode {mode}: {} {}", hinged[mode], found[mode]);
    }
    assert!(found[0] < 0.95 * sound[0], "the flexibility must matter for the comparison to mean anything");
}

#[test]
fn each_base_axis_frees_its_own_direction() {
    let (x, y) =
        (frequencies(&["base-rotation=flexibility_x=4e-11,flexibility_y=0"]), frequencies(&["base-rotation=4e-11"]));
    let sound = frequencies(&[]);
    // Rotation about X frees motion in Y only; both axes free both.
    assert!(y[0] < x[0] && x[0] < sound[0]);
    let slide = frequencies(&["base-translation=1e-9"]);
    assert!(slide[0] < sound[0]);
    assert_eq!(frequencies(&["base-translation=0"]), sound);
}

#[test]
fn a_small_added_mass_lowers_a_frequency_as_rayleigh_says() {
    let assembly = Structure::new(beam()).assemble();
    let modes = assembly.modes().unwrap();
    for z_m in [100.0, 63.0] {
        let mass = 10.0;
        let found = frequencies(&[&format!("added-mass@{z_m}m={mass}")]);
        let motion = assembly.axis_motion(z_m) * &modes.shapes;
        for mode in 0..5 {
            let squared = motion[(0, mode)].powi(2) + motion[(1, mode)].powi(2);
            // d ln f = -m phi²/2; the second order is m phi² (1e-4 and less) of the first.
            let expected = -0.5 * mass * squared;
            let change = (found[mode] / modes.frequency_hz[mode]).ln();
            assert!((change - expected).abs() < 1e-3 * expected.abs() + 1e-8, "mode {mode}: {change} {expected}");
        }
    }
}

fn segments(structure: &Structure) -> &[Segment] {
    let Body::Beam(beam) = &structure.body else { panic!("not a beam") };
    beam.segments()
}

#[test]
fn a_local_loss_takes_its_share_of_the_strain_energy() {
    let loss = 1e-4;
    let assembly = Structure::new(beam()).assemble();
    let modes = assembly.modes().unwrap();
    let mut one_softer = Structure::new(beam());
    let effect: Effect = format!("stiffness-loss@35m={loss}").parse().unwrap();
    effect.apply(&mut one_softer).unwrap();
    let changed: Vec<_> =
        segments(&one_softer).iter().zip(beam().segments()).map(|(now, before)| now != before).collect();
    assert_eq!(changed.iter().filter(|&&changed| changed).count(), 1);
    assert!(changed[3], "35 m lies in the fourth segment");
    let softer = one_softer.assemble();
    let difference = &softer.stiffness - &assembly.stiffness;
    let found = softer.modes().unwrap();
    for mode in 0..5 {
        let shape = modes.shapes.column(mode);
        let lambda = (std::f64::consts::TAU * modes.frequency_hz[mode]).powi(2);
        let expected = 0.5 * (shape.transpose() * &difference * shape)[0] / lambda;
        let change = (found.frequency_hz[mode] / modes.frequency_hz[mode]).ln();
        // Second order in the loss: 1e-4 of the first.
        assert!((change - expected).abs() < 1e-3 * expected.abs() + 1e-9, "mode {mode}: {change} {expected}");
    }
    // On a node, both segments that meet there.
    let mut two_softer = Structure::new(beam());
    "stiffness-loss@40m=0.5".parse::<Effect>().unwrap().apply(&mut two_softer).unwrap();
    let halved = segments(&two_softer).iter().filter(|segment| segment.torsion_n_m2 == 1e10).count();
    assert_eq!(halved, 2);
}
