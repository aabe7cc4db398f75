//! Springs and mass under the base, values of X and Y apart, and which nodes an eccentric mass concerns.

use std::path::Path;

use super::*;
use crate::model::{BeamTable, Structure};

const HEADER: &str = "z_bottom_m,z_top_m,bending_1_n_m2,bending_2_n_m2,axis_deg,shear_n,torsion_n_m2,mass_top_kg,inertia_x_kg_m2,inertia_y_kg_m2,inertia_z_kg_m2\n";

/// Ten segments of 10 m, stiffer by a factor, above rows of the table's own.
fn beam(below: &str, factor: f64) -> BeamTable {
    turned_beam(below, factor, 20)
}

/// The same with its first axis at this angle in degrees.
fn turned_beam(below: &str, factor: f64, axis_deg: i32) -> BeamTable {
    let mut text = HEADER.to_owned() + below;
    for index in 0..10 {
        let [bending, shear, torsion] = [1e11, 5e9, 2e10].map(|stiffness| stiffness * factor);
        text += &format!(
            "{},{},{bending},{},{axis_deg},{shear},{torsion},1e5,1e5,1e5,5e5\n",
            10 * index,
            10 * (index + 1),
            3.0 * bending
        );
    }
    BeamTable::from_reader(text.as_bytes(), Path::new("beam.csv")).unwrap()
}

fn frequencies(table: BeamTable, words: &[&str]) -> Vec<f64> {
    let effects: Vec<Effect> = words.iter().map(|word| word.parse().unwrap()).collect();
    Structure::with_effects(table, &effects).unwrap().assemble().modes().unwrap().frequency_hz
}

fn assert_alike(one: &[f64], other: &[f64], modes: usize, tolerance: f64) {
    for mode in 0..modes {
        assert!((one[mode] / other[mode] - 1.0).abs() < tolerance, "mode {mode}: {} {}", one[mode], other[mode]);
    }
}

/// A torsional spring under the base is a short shaft of the flexibility L/GJ, and leaves bending alone.
#[test]
fn a_base_that_twists_equals_a_soft_shaft() {
    let flexibility = 2e-9;
    let found = frequencies(beam("", 1.0), &[&format!("base-torsion={flexibility}")]);
    let shaft = format!("-1e-3,0,1e16,1e16,0,,{},1e-3,1e-3,1e-3,1e-3\n", 1e-3 / flexibility);
    assert_alike(&found, &frequencies(beam(&shaft, 1.0), &[]), 8, 5e-5);
    let sound = frequencies(beam("", 1.0), &[]);
    let moved = (0..8).filter(|&mode| (found[mode] / sound[mode] - 1.0).abs() > 1e-6).count();
    assert!((1..=3).contains(&moved), "the torsional modes among the first eight: {moved}");
}

/// Rocking about a point below the base is rocking at the foot of a rigid block that reaches down to it; with both signs of the
/// motion right, for sway and rocking are coupled.
#[test]
fn rocking_about_a_point_below_is_that_of_a_rigid_block() {
    let block = "-6,0,1e19,1e19,0,,1e19,1e-3,1e-3,1e-3,1e-3\n";
    let expected = frequencies(beam(block, 1.0), &["base-rotation=4e-11"]);
    let found = frequencies(beam("", 1.0), &["base-rotation=flexibility=4e-11,depth=6"]);
    assert_alike(&found, &expected, 8, 1e-5);
    let at_the_base = frequencies(beam("", 1.0), &["base-rotation=4e-11"]);
    assert!(found[0] < 0.999 * at_the_base[0], "{} {}", found[0], at_the_base[0]);
}

/// A base that turns about a diagonal is one that turns about X, seen from axes turned by 45 degrees; the sign says which diagonal.
#[test]
fn a_diagonal_is_an_axis_that_is_turned() {
    let about_x = frequencies(turned_beam("", 1.0, 20), &["base-rotation=flexibility_x=4e-11,flexibility_y=0"]);
    let about_diagonal = |axis_deg: i32, diagonal: f64| {
        let word = format!("base-rotation=flexibility_x=0,flexibility_y=0,flexibility_diagonal={diagonal:e}");
        frequencies(turned_beam("", 1.0, axis_deg), &[&word])
    };
    assert_alike(&about_diagonal(65, 4e-11), &about_x, 10, 1e-9);
    assert_alike(&about_diagonal(-25, -4e-11), &about_x, 10, 1e-9);
    assert!((about_diagonal(65, -4e-11)[0] / about_x[0] - 1.0).abs() > 1e-3);
}

/// A mass at the base does nothing where the base is clamped; on a spring it is the mass of one more node, as long as it stays below
/// its own frequency on the spring (16 Hz here; Guyan's error grows with the square of the ratio).
#[test]
fn a_foundation_has_mass_where_the_base_moves() {
    let sound = frequencies(beam("", 1.0), &[]);
    assert_eq!(frequencies(beam("", 1.0), &["foundation-mass=1e5"]), sound);
    let flexibility = 1e-9;
    let spring = format!("-1e-3,0,1e16,1e16,0,{},1e16,1e5,1e-3,1e-3,1e-3\n", 1e-3 / flexibility);
    let soft = format!("base-translation={flexibility}");
    let found = frequencies(beam("", 1.0), &[&soft, "foundation-mass=1e5"]);
    assert_alike(&found, &frequencies(beam(&spring, 1.0), &[]), 6, 5e-5);
    let without = frequencies(beam("", 1.0), &[&soft]);
    assert!(found[4] < 0.9999 * without[4], "{} {}", found[4], without[4]);
}

/// Concrete that is stiffer makes no stiffer soil: all of the table times a factor, on the same springs.
#[test]
fn a_stiffer_structure_stands_on_the_same_soil() {
    let soil = ["base-rotation=4e-11", "base-translation=1e-9"];
    let scaled = frequencies(beam("", 1.0), &[soil[0], soil[1], "stiffness-scale=0.2"]);
    assert_alike(&scaled, &frequencies(beam("", 1.2), &soil), 10, 1e-9);
}

/// Values of X and Y may differ: one of two alike is that for both, and a value of one axis leaves the other direction alone.
#[test]
fn outriggers_and_joints_have_axes() {
    let table = || {
        let text = HEADER.to_owned()
            + &(0..10)
                .map(|index| format!("{},{},1e11,3e11,0,5e9,2e10,1e5,1e5,1e5,5e5\n", 10 * index, 10 * (index + 1)))
                .collect::<String>();
        BeamTable::from_reader(text.as_bytes(), Path::new("beam.csv")).unwrap()
    };
    let sound = frequencies(table(), &[]);
    for (kind, name, value) in [
        ("outrigger@60m", "stiffness", 1e10),
        ("lateral-support@60m", "stiffness", 1e7),
        ("connection-flexibility@57m", "flexibility", 1e-10),
    ] {
        let both = frequencies(table(), &[&format!("{kind}={value:e}")]);
        let each = frequencies(table(), &[&format!("{kind}={name}_x={value:e},{name}_y={value:e}")]);
        assert_alike(&both, &each, 10, 1e-9);
        let one = frequencies(table(), &[&format!("{kind}={name}_x={value:e},{name}_y=0")]);
        let of_both = one.iter().filter(|&hz| both.iter().any(|other| (hz / other - 1.0).abs() < 1e-9)).count();
        let of_sound = one.iter().filter(|&hz| sound.iter().any(|other| (hz / other - 1.0).abs() < 1e-9)).count();
        assert!(of_both > 8 && of_sound > 8, "{kind}: {of_both} modes as with both, {of_sound} as without");
    }
}

/// A tower with a waist and a mast: the waist, whose radius of gyration is less than half of the widest, is as eccentric as the rest; a
/// mast, where the radius drops at once, is not.
#[test]
fn a_waist_is_eccentric_and_a_mast_is_not() {
    let radii_m: [f64; 8] = [20.0, 15.0, 11.0, 8.0, 9.0, 14.0, 3.0, 2.0];
    let mut text = HEADER.to_owned();
    for (index, radius_m) in radii_m.into_iter().enumerate() {
        let mass_kg = if radius_m < 5.0 { 2e3 } else { 1e5 };
        text += &format!(
            "{},{},1e11,3e11,20,5e9,2e10,{mass_kg},1e5,1e5,{}\n",
            10 * index,
            10 * (index + 1),
            mass_kg * radius_m * radius_m
        );
    }
    let table = BeamTable::from_reader(text.as_bytes(), Path::new("beam.csv")).unwrap();
    let effect: Effect = "mass-eccentricity=x=0.8,y=-0.3".parse().unwrap();
    let assembly = Structure::with_effects(table, &[effect]).unwrap().assemble();
    for (index, is_eccentric) in [true, true, true, true, true, true, false, false].into_iter().enumerate() {
        let (uy, rz) = (5 * index + 1, 5 * index + 4);
        assert_eq!(assembly.mass[(uy, rz)] != 0.0, is_eccentric, "node {index}");
    }
}
