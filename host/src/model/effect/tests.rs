//! Effects: what the eigenproblem says of them.

use std::path::Path;

use std::sync::Arc;

use nalgebra::{DMatrix, DVector, RowDVector};

use super::*;
use crate::model::{
    Assembly, BeamTable, Body, Custom, DOFS_A_NODE, ModalBasis, Modes, Segment, Stiffness, Structure, phases_rad,
};
use crate::study::{Direction, Sensor};

const HEADER: &str = "z_bottom_m,z_top_m,bending_1_n_m2,bending_2_n_m2,axis_deg,shear_n,torsion_n_m2,mass_top_kg,inertia_x_kg_m2,inertia_y_kg_m2,inertia_z_kg_m2\n";

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

/// A ring at a node is one row of the table that is heavier, with half of the polar inertia about X and Y.
#[test]
fn an_added_ring_is_a_heavier_row_of_the_table() {
    let heavier = |text: String| BeamTable::from_reader(text.as_bytes(), Path::new("ring.csv")).unwrap();
    let mut text = String::from(HEADER);
    for index in 0..10 {
        let (bottom, top) = (10 * index, 10 * (index + 1));
        let row = if index == 6 { "1.3e5,4e5,4e5,11e5" } else { "1e5,1e5,1e5,5e5" };
        text.push_str(&format!("{bottom},{top},1e11,3e11,20,5e9,2e10,{row}\n"));
    }
    let expected = Structure::new(heavier(text)).assemble().modes().unwrap().frequency_hz;
    let found = frequencies(&["added-mass@70m=mass=3e4,polar_inertia=6e5"]);
    let alone = frequencies(&["added-mass@70m=3e4"]);
    let furthest = |other: &[f64]| expected.iter().zip(other).map(|(a, b)| (b / a - 1.0).abs()).fold(0.0, f64::max);
    assert!(furthest(&found) < 1e-9, "{}", furthest(&found));
    assert!(furthest(&alone) > 1e-2, "the inertia counts: {}", furthest(&alone));
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

/// Guys away from the axis hold its twist too: d ln f = k phi²/(2 w²) with the mode's own rotation about Z.
#[test]
fn guys_away_from_the_axis_raise_torsion_as_rayleigh_says() {
    let assembly = Structure::new(beam()).assemble();
    let modes = assembly.modes().unwrap();
    let stiffness = 1e3;
    let found = frequencies(&[&format!("lateral-support@63m=stiffness_x=0,stiffness_y=0,stiffness_z={stiffness}")]);
    let twist = &assembly.axis_motion(63.0) * &modes.shapes;
    let mut most: f64 = 0.0;
    for mode in 0..6 {
        let squared = twist[(4, mode)].powi(2);
        let omega = std::f64::consts::TAU * modes.frequency_hz[mode];
        let expected = 0.5 * stiffness * squared / (omega * omega);
        let change = (found[mode] / modes.frequency_hz[mode]).ln();
        assert!((change - expected).abs() < 1e-3 * expected + 1e-9, "mode {mode}: {change} {expected}");
        most = most.max(expected);
    }
    assert!(most > 1e-7, "torsion is among them: {most}");
}

fn segments(structure: &Structure) -> Vec<Segment> {
    structure.segments().unwrap()
}

#[test]
fn a_local_loss_takes_its_share_of_the_strain_energy() {
    let loss = 1e-4;
    let assembly = Structure::new(beam()).assemble();
    let modes = assembly.modes().unwrap();
    let effect: Effect = format!("stiffness-loss@35m={loss}").parse().unwrap();
    let one_softer = Structure::with_effects(beam(), &[effect]).unwrap();
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
    let two_softer = Structure::with_effects(beam(), &["stiffness-loss@40m=0.5".parse().unwrap()]).unwrap();
    let halved = segments(&two_softer).iter().filter(|segment| segment.torsion_n_m2 == 1e10).count();
    assert_eq!(halved, 2);
}

/// The static answer of the beam with effects to a moment about Y at its top.
fn answer_to_moment(words: &[&str]) -> DVector<f64> {
    let effects: Vec<Effect> = words.iter().map(|word| word.parse().unwrap()).collect();
    let stiffness = Structure::with_effects(beam(), &effects).unwrap().assemble().stiffness;
    let mut moment = DVector::zeros(stiffness.nrows());
    moment[9 * DOFS_A_NODE + 3] = MOMENT_N_M;
    stiffness.cholesky().unwrap().solve(&moment)
}

const MOMENT_N_M: f64 = 1e9;

/// With half of a panel's height, a moment at the top makes each panel sway by the rotation of its lower end: the kinematics of rigid
/// braces that meet in the middle of the girder above.
#[test]
fn without_shear_force_a_panel_sways_as_its_lower_end_rotates() {
    let coupled = answer_to_moment(&["coupled-shear=5"]);
    for panel in 1..10 {
        let at = |node: usize, dof: usize| coupled[node * DOFS_A_NODE + dof];
        let (sway, rotation) = (at(panel, 0) - at(panel - 1, 0), at(panel - 1, 3));
        assert!((sway / (10.0 * rotation) - 1.0).abs() < 1e-9, "panel {panel}: {sway} m");
    }
    // Rotations are those of the beam, and so is what sways along the other axis.
    let plain = answer_to_moment(&["coupled-shear=0"]);
    for row in (0..plain.len()).filter(|row| row % DOFS_A_NODE == 3) {
        assert!((coupled[row] / plain[row] - 1.0).abs() < 1e-9);
    }
    let along_y = answer_to_moment(&["coupled-shear=distance_x=0,distance_y=5"]);
    for row in (0..plain.len()).filter(|row| row % DOFS_A_NODE == 0) {
        assert!((along_y[row] - plain[row]).abs() < 1e-9 * plain.amax());
    }
}

/// A base that rotates turns what stands on it as a rigid body, whatever bending does: no segment is strained by that.
#[test]
fn a_base_rotates_a_coupled_beam_as_a_rigid_body() {
    let flexibility = 1e-11;
    let (clamped, rotating) = (
        answer_to_moment(&["coupled-shear=5"]),
        answer_to_moment(&["coupled-shear=5", &format!("base-rotation={flexibility}")]),
    );
    let angle = flexibility * MOMENT_N_M;
    for node in 0..10 {
        let z_m = 10.0 * (node + 1) as f64;
        let more = |dof: usize| rotating[node * DOFS_A_NODE + dof] - clamped[node * DOFS_A_NODE + dof];
        assert!((more(3) / angle - 1.0).abs() < 1e-6 && (more(0) / (angle * z_m) - 1.0).abs() < 1e-6, "node {node}");
    }
}

/// A joint is a short segment without stiffness of its own: the same modes as with a segment of 1 mm that bends by what
/// the joint turns, at a height between two nodes.
#[test]
fn a_joint_equals_a_short_soft_segment() {
    let flexibility = 2e-10;
    let joint: Effect = format!("connection-flexibility@57m={flexibility}").parse().unwrap();
    let jointed = Structure::with_effects(beam(), &[joint]).unwrap().assemble();
    let found = jointed.modes().unwrap().frequency_hz;
    let (hinge, mut text) = (1e-3, HEADER.to_owned());
    let bending = hinge / flexibility;
    for index in 0..10 {
        let (bottom, top) = (10 * index, 10 * (index + 1));
        if index == 5 {
            // Torsion and shear pass through the joint.
            text += &format!("50,{},1e11,3e11,20,5e9,2e10,1e-3,1e-3,1e-3,1e-3\n", 57.0 - hinge / 2.0);
            text += &format!(
                "{},{},{bending},{bending},0,,1e16,1e-3,1e-3,1e-3,1e-3\n",
                57.0 - hinge / 2.0,
                57.0 + hinge / 2.0
            );
            text += &format!("{},60,1e11,3e11,20,5e9,2e10,1e5,1e5,1e5,5e5\n", 57.0 + hinge / 2.0);
        } else {
            text += &format!("{bottom},{top},1e11,3e11,20,5e9,2e10,1e5,1e5,1e5,5e5\n");
        }
    }
    let hinged = BeamTable::from_reader(text.as_bytes(), Path::new("hinged.csv")).unwrap();
    let hinged = Structure::new(hinged).assemble();
    let (hinged_modes, jointed_modes) = (hinged.modes().unwrap(), jointed.modes().unwrap());
    // Below and above the joint, between the nodes: the kink is where it is.
    for mode in 0..6 {
        let motion = |assembly: &Assembly, modes: &Modes| {
            let at = |z_m: f64| assembly.axis_motion(z_m) * modes.shapes.column(mode);
            DMatrix::from_columns(&[at(100.0), at(55.0), at(56.9), at(57.5), at(59.0)])
        };
        let (one, other) = (motion(&hinged, &hinged_modes), motion(&jointed, &jointed_modes));
        let sign = one.dot(&other).signum();
        assert!((&one - &other * sign).norm() < 1e-3 * one.norm(), "mode {mode}");
    }
    let hinged = hinged_modes.frequency_hz;
    let sound = frequencies(&[]);
    for mode in 0..8 {
        // The short segment replaces 1 mm of sound beam, 1e-5 of it.
        assert!((hinged[mode] / found[mode] - 1.0).abs() < 5e-5, "mode {mode}: {} {}", hinged[mode], found[mode]);
    }
    assert!(found[1] < 0.95 * sound[1], "the joint must matter for the comparison to mean anything");
}

/// A uniform cantilever buckles under its own weight at q L³ = 7.837 EI (Greenhill 1881): there its first frequency is zero.
#[test]
fn weight_brings_the_first_frequency_to_zero_at_greenhills_load() {
    let (height, segments, mass) = (100.0, 100, 1e5);
    let bending = 9.806_65 * mass / (height / f64::from(segments)) * f64::powi(height, 3) / 7.837;
    let share = |share: f64| {
        let mut text = HEADER.to_owned();
        for index in 0..segments {
            text += &format!("{index},{},{bending},{bending},0,,1e12,{mass},0,0,1e5\n", index + 1);
        }
        let beam = BeamTable::from_reader(text.as_bytes(), Path::new("column.csv")).unwrap();
        let effect = Effect::new("p-delta", None, &[share]).unwrap();
        Structure::with_effects(beam, &[effect]).unwrap().assemble().modes().map(|modes| modes.frequency_hz[0])
    };
    let (none, half) = (share(0.0).unwrap(), share(0.5).unwrap());
    // Lambda falls almost linearly with the load. Mass at the tops of segments lifts the weight by half a segment: 1.5 %.
    assert!(((half / none).powi(2) - 0.5).abs() < 0.02, "{}", (half / none).powi(2));
    assert!(share(0.97).unwrap() < 0.2 * none);
    assert!(share(1.05).is_err(), "beyond the buckling load there is no stiffness left");
}

/// Five storeys of one element each lose as much stiffness to the weight as on a mesh twenty times finer, from pure bending to the
/// pure shear of a frame, and axes that are turned make no difference.
#[test]
fn weight_softens_shear_and_bending_alike_on_any_mesh() {
    let (storeys, storey_m, mass) = (5, 4.0, 1e5);
    let drop = |bending: f64, shear: &str, parts: usize| {
        let mut text = HEADER.to_owned();
        for index in 0..storeys * parts {
            let z_m = |index: usize| storey_m * index as f64 / parts as f64;
            let share = if (index + 1).is_multiple_of(parts) { 1.0 } else { 1e-9 };
            let (mass, polar) = (mass * share, 1e6 * share);
            let (bottom, top) = (z_m(index), z_m(index + 1));
            text += &format!("{bottom},{top},{bending},{},30,{shear},1e12,{mass},0,0,{polar}\n", 2.0 * bending);
        }
        let beam = BeamTable::from_reader(text.as_bytes(), Path::new("frame.csv")).unwrap();
        let first_hz = |effects: &[Effect]| {
            Structure::with_effects(beam.clone(), effects).unwrap().assemble().modes().unwrap().frequency_hz[0]
        };
        1.0 - (first_hz(&["p-delta=1".parse().unwrap()]) / first_hz(&[])).powi(2)
    };
    // Bending, both, and shear alone, with phi = 12 EI / (kGA L²) from 0 to 2e4.
    for (bending, shear) in [(1e10, ""), (1e10, "2e8"), (1e11, "1e8"), (2.7e12, "1e8")] {
        let (coarse, fine) = (drop(bending, shear, 1), drop(bending, shear, 20));
        assert!(fine > 0.02, "the weight must matter for the comparison to mean anything: {fine}");
        assert!((coarse / fine - 1.0).abs() < 2e-3, "EI {bending}, kGA {shear}: {coarse} {fine}");
    }
}

/// Weight that stands apart leans when the section turns: GJ becomes GJ - g J, J the rotational inertia above.
#[test]
fn weight_softens_torsion_by_its_radius_of_gyration() {
    let (torsion, polar) = (1e8, 2e6);
    let text = format!("{HEADER}0,10,1e13,1e13,0,,{torsion},1e5,1e5,1e5,{polar}\n");
    let beam = BeamTable::from_reader(text.as_bytes(), Path::new("one.csv")).unwrap();
    let torsion_hz = |share: f64| {
        let effect = Effect::new("p-delta", None, &[share]).unwrap();
        Structure::with_effects(beam.clone(), &[effect]).unwrap().assemble().modes().unwrap().frequency_hz[0]
    };
    let expected = 1.0 - 9.806_65 * polar / torsion;
    assert!(((torsion_hz(1.0) / torsion_hz(0.0)).powi(2) - expected).abs() < 1e-9);
}

/// A small spring adds its share of a mode's stiffness: k phi(z)² for a mode of modal mass one (Rayleigh's quotient).
#[test]
fn a_lateral_support_holds_a_mode_by_how_far_it_moves_there() {
    let assembly = Structure::new(beam()).assemble();
    let modes = assembly.modes().unwrap();
    let motion = assembly.axis_motion(60.0) * &modes.shapes;
    let (sound, stiffness) = (frequencies(&[]), 1e3);
    let held = frequencies(&["lateral-support@60m=1e3"]);
    for mode in 0..6 {
        let square = motion[(0, mode)].powi(2) + motion[(1, mode)].powi(2);
        let expected = stiffness * square / (std::f64::consts::TAU * sound[mode]).powi(2);
        let found = (held[mode] / sound[mode]).powi(2) - 1.0;
        assert!((found - expected).abs() < 1e-3 * expected + 1e-11, "mode {mode}: {found} where {expected}");
    }
}

/// A soft bed adds the integral of k phi² over its height, here by Simpson's rule on 2000 pieces, wherever between the nodes it ends.
#[test]
fn soil_along_a_foot_holds_a_mode_by_how_far_it_moves_there() {
    let assembly = Structure::new(beam()).assemble();
    let modes = assembly.modes().unwrap();
    let sound = frequencies(&[]);
    for (z_m, word) in
        [(33.0, "soil-springs@33m=stiffness_x=20,stiffness_y=5"), (7.0, "soil-springs@7m=stiffness_x=20,stiffness_y=5")]
    {
        let held = frequencies(&[word]);
        let density = |z_m: f64| {
            let motion = assembly.axis_motion(z_m) * &modes.shapes;
            motion.row(0).map(|x| 20.0 * x * x) + motion.row(1).map(|y| 5.0 * y * y)
        };
        let pieces = 2000;
        let step_m = z_m / f64::from(pieces);
        let sum = (0..=pieces).fold(density(0.0) * 0.0, |sum, at| {
            let weight = if at == 0 || at == pieces {
                1.0
            } else if at % 2 == 1 {
                4.0
            } else {
                2.0
            };
            sum + density(f64::from(at) * step_m) * (weight * step_m / 3.0)
        });
        for mode in 0..6 {
            let expected = sum[mode] / (std::f64::consts::TAU * sound[mode]).powi(2);
            let found = (held[mode] / sound[mode]).powi(2) - 1.0;
            assert!(
                (found - expected).abs() < 1e-3 * expected + 1e-10,
                "{word}, mode {mode}: {found} where {expected}"
            );
        }
    }
}

/// With everything rigid but one rotational spring at the top, a stiff mast is an inverted pendulum.
#[test]
fn an_outrigger_holds_and_a_tuned_mass_splits() {
    let sound = frequencies(&[]);
    let held = frequencies(&["outrigger@80m=5e9"]);
    assert!(held[0] > 1.01 * sound[0] && held.iter().zip(&sound).all(|(held, sound)| *held > sound * (1.0 - 1e-9)));

    // A mass of mu times the modal mass, tuned to the mode, splits it to f sqrt(1 + mu/2 ± sqrt(mu + mu²/4)) (Den Hartog
    // 1956, eq. 3.22); for the mass at the top the modal mass is 1/phi².
    let assembly = Structure::new(beam()).assemble();
    let modes = assembly.modes().unwrap();
    let motion = assembly.axis_motion(100.0) * &modes.shapes;
    let along = motion[(0, 0)].hypot(motion[(1, 0)]);
    let mu: f64 = 1e-3;
    let mass = mu / (along * along);
    let word = format!("tuned-mass-damper@100m=mass={mass},frequency={},damping_ratio=0.05", sound[0]);
    let split = frequencies(&[&word]);
    assert_eq!(split.len(), sound.len() + 2, "one more mode for each direction");
    let expected = |sign: f64| sound[0] * (1.0 + mu / 2.0 + sign * (mu + mu * mu / 4.0).sqrt()).sqrt();
    // The mode moves along one axis of the table, the damper along X and Y: between the twins stands the damper's motion
    // across, hardly moved by the second mode.
    let near = |wanted: f64| split.iter().map(|hz| (hz / wanted - 1.0).abs()).fold(f64::INFINITY, f64::min);
    // Other modes bend the twins by the square of mu.
    assert!(
        near(expected(1.0)) < 1e-3 && near(expected(-1.0)) < 1e-3,
        "{:?} {split:?}",
        [expected(-1.0), expected(1.0)]
    );
    let one_way = frequencies(&[&word.replace("0.05", "0.05,axis=x")]);
    assert_eq!(one_way.len(), sound.len() + 1);
}

#[test]
fn turned_axes_turn_the_shapes_and_leave_the_frequencies() {
    let sound = Structure::new(beam()).assemble().modes().unwrap();
    let turned = Structure::with_effects(beam(), &["axis-rotation=25".parse().unwrap()]).unwrap().assemble();
    let modes = turned.modes().unwrap();
    let azimuth = |shapes: &DMatrix<f64>| shapes[(46, 0)].atan2(shapes[(45, 0)]).to_degrees().rem_euclid(180.0);
    for (turned, sound) in modes.frequency_hz.iter().zip(&sound.frequency_hz).take(10) {
        assert!((turned / sound - 1.0).abs() < 1e-9);
    }
    let difference = (azimuth(&modes.shapes) - azimuth(&sound.shapes)).rem_euclid(180.0);
    assert!((difference - 25.0).abs() < 1e-6, "{difference}");
    // Matrices turn as tables do; their sensors see the same.
    let motion = turned.axis_motion(95.0) * &modes.shapes;
    assert!(
        ((motion[(1, 0)] / motion[(0, 0)]).atan().to_degrees().rem_euclid(180.0) - azimuth(&modes.shapes)).abs() < 1e-6
    );
}

#[test]
fn an_eccentric_mass_couples_and_keeps_the_mass() {
    let effect: Effect = "mass-eccentricity=x=0.8,y=-0.3".parse().unwrap();
    let assembly = Structure::with_effects(beam(), &[effect]).unwrap().assemble();
    let top = 45;
    assert_eq!((assembly.mass[(top + 1, top + 4)], assembly.mass[(top, top + 4)]), (0.8e5, 0.3e5));
    assert!((assembly.mass[(top + 4, top + 4)] - (5e5 + 1e5 * 0.73)).abs() < 1e-6);
    // Twisting about the centre of mass moves no mass sideways: the unit rotation about (x, y).
    let twist = RowDVector::from_row_slice(&[-0.3, -0.8, 0.0, 0.0, 1.0]);
    let block = assembly.mass.view((top, top), (5, 5)).into_owned();
    assert!((&twist * &block).columns(0, 2).amax() < 1e-6);
    assert!(frequencies(&["mass-eccentricity=x=0.8,y=-0.3"])[0] < frequencies(&[])[0]);
}

pub(super) fn sensor(channel: &str, node: u16, azimuth_deg: f64) -> Sensor {
    let direction = Some(Direction::AzimuthDeg(azimuth_deg));
    Sensor { elevation_m: Some(90.0), direction, ..Sensor::new(channel, node) }
}

#[test]
fn effects_on_sensors_change_what_they_see() {
    let sensors = [sensor("a", 1, 0.0), sensor("b", 1, 90.0), sensor("c", 2, 0.0)];
    let rows = |words: &[&str]| {
        let effects: Vec<Effect> = words.iter().map(|word| word.parse().unwrap()).collect();
        Structure::with_effects(beam(), &effects).unwrap().assemble().sensor_rows(&sensors).unwrap()
    };
    let sound = rows(&[]);
    assert_eq!(rows(&["sensor-gain@b=1.5"]).row(1), sound.row(1) * 1.5);
    assert_eq!(rows(&["sensor-polarity@cha"]).row(0), -sound.row(0));
    let swapped = rows(&["sensor-swap@a+b"]);
    assert_eq!((swapped.row(0), swapped.row(1)), (sound.row(1), sound.row(0)));
    let turned = rows(&["sensor-rotation@node1=30"]);
    let expected = sound.row(0) * 30f64.to_radians().cos() + sound.row(1) * 30f64.to_radians().sin();
    assert!((turned.row(0) - expected).amax() < 1e-12 && turned.row(2) == sound.row(2));
    assert!((rows(&["sensor-rotation=30"]).row(2) - turned.row(0)).amax() < 1e-12);

    let late: Effect = "clock-offset@2=0.1".parse().unwrap();
    let structure = Structure::with_effects(beam(), &[late]).unwrap();
    let delays = structure.assemble().sensing.delays_s(&sensors).unwrap();
    assert_eq!(delays.as_slice(), [0.0, 0.0, 0.1]);
    // Two equal components, one of them 0.1 s late at 0.5 Hz: 18° apart, each half of that from the mean.
    let phases = phases_rad(&[1.0, 0.0, 1.0], &delays, 0.5);
    assert!((phases[0] - 9f64.to_radians()).abs() < 1e-12 && (phases[2] + 9f64.to_radians()).abs() < 1e-12);

    let error = "sensor-gain@x=2".parse::<Effect>().unwrap().in_study(&sensors).unwrap_err().to_string();
    assert_eq!(error, "sensor-gain: the study has no channel x; there are a, b, c");
    let error = "clock-offset@node9=1".parse::<Effect>().unwrap().in_study(&sensors).unwrap_err().to_string();
    assert_eq!(error, "clock-offset: no sensor of the study belongs to node 9; there are 1, 2");
}

/// One after the other, whatever their order in the list: like effects add up.
#[test]
fn like_effects_add_up() {
    let assembled = |words: &[&str]| {
        let effects: Vec<Effect> = words.iter().map(|word| word.parse().unwrap()).collect();
        Structure::with_effects(beam(), &effects).unwrap().assemble()
    };
    let (two, one) = (assembled(&["added-mass@40m=1e4", "added-mass@40m=2e4"]), assembled(&["added-mass@40m=3e4"]));
    assert!((&two.mass - &one.mass).amax() < 1e-9 * one.mass.amax());
    let (two, one) = (assembled(&["base-rotation=1e-11", "base-rotation=3e-11"]), assembled(&["base-rotation=4e-11"]));
    assert!((&two.stiffness - &one.stiffness).amax() < 1e-9 * one.stiffness.amax());
    let mixed = ["mass-scale=0.1", "stiffness-scale=0.2", "outrigger@80m=5e9", "p-delta=1", "added-mass@60m=1e5"];
    let (there, back) = (assembled(&mixed), assembled(&mixed.iter().rev().copied().collect::<Vec<_>>()));
    assert_eq!((&there.stiffness, &there.mass), (&back.stiffness, &back.mass), "phases decide, not the list");
}

#[test]
fn relative_changes_need_something_to_change() {
    let rigid = HEADER.to_owned() + "0,10,1e11,3e11,20,,2e10,1e5,0,0,5e5\n10,20,1e11,3e11,20,,2e10,1e5,0,0,5e5\n";
    let rigid = BeamTable::from_reader(rigid.as_bytes(), Path::new("beam.csv")).unwrap();
    let with = |word: &str| Structure::with_effects(rigid.clone(), &[word.parse().unwrap()]);
    let error = |word: &str| with(word).unwrap_err().to_string();
    assert!(error("shear-flexibility=0.5").contains("give flexibility = ... in 1/N"));
    assert!(error("rotary-inertia=0.5").contains("give radius = ... in m"));
    let soft = with("shear-flexibility=flexibility=1e-9").unwrap();
    assert!(segments(&soft)[0].shear_n.iter().all(|shear| (shear.unwrap() / 1e9 - 1.0).abs() < 1e-12));
    let heavy = with("rotary-inertia=radius=2").unwrap();
    assert_eq!(segments(&heavy)[0].inertia_kg_m2, [4e5, 4e5, 5e5]);
}

/// What a segment's stiffness and mass do to K and M by the derivative and by taking a segment apart, with all that
/// depends on it: a soft base, a joint, weight above, turned axes.
#[test]
fn segment_changes_are_those_of_the_matrices() {
    let words = [
        "base-rotation=4e-11",
        "connection-flexibility@57m=1e-10",
        "axis-rotation=12",
        "coupled-shear=distance_x=4,distance_y=3",
        "wall-frame=share_x=0.2,share_y=0.3",
        "stiffness-scale=0.1",
    ];
    let effects: Vec<Effect> = words.iter().map(|word| word.parse().unwrap()).collect();
    let structure = Structure::with_effects(beam(), &effects).unwrap();
    let changes = structure.segment_changes();
    assert_eq!(changes.len(), 10);
    let basis: ModalBasis = structure.assemble().modal_basis().unwrap();
    let rows = nalgebra::DMatrix::identity(5, structure.dofs());
    for (index, change) in changes.iter().enumerate() {
        for stiffness in Stiffness::ALL.map(Some).into_iter().chain([None]) {
            let step = 1e-4;
            let moved = |by: f64| {
                let mut moved = structure.clone();
                let Body::Beam(beam) = &mut moved.body else { panic!("a beam was given") };
                let segment = &mut beam.segments_mut()[index];
                match stiffness {
                    Some(stiffness) => segment.scale(stiffness, 1.0 + by),
                    None => segment.scale_mass(1.0 + by),
                }
                moved.assemble().modes().unwrap().frequency_hz
            };
            let (above, below) = (moved(step), moved(-step));
            let change = stiffness.map_or(&change.mass, |stiffness| &change.stiffness[stiffness as usize]);
            let slopes = crate::model::Responses::of(&basis, None, &rows, &[0, 1, 4]).derivatives(change);
            for (slope, mode) in slopes.iter().zip([0, 1, 4]) {
                let expected = (above[mode] / below[mode]).ln() / (2.0 * step);
                // Second order in the steps.
                assert!((slope.ln_frequency - expected).abs() < 1e-5 + 1e-3 * expected.abs(), "segment {index}");
            }
        }
    }
}

#[test]
fn a_custom_change_is_what_its_files_say() {
    let custom = |segments: &str| {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("soft.csv"), segments).unwrap();
        let source = crate::study::CustomSource {
            line: 1,
            name: "soft".into(),
            file: None,
            stiffness: Vec::new(),
            mass: Vec::new(),
            segments: Some("soft.csv".into()),
            least: Some(0.0),
            greatest: Some(2.0),
            typical: None,
            tied_to: None,
            channels: Vec::new(),
            group: None,
        };
        Custom::read(&source, folder.path())
    };
    let soft =
        custom("z_bottom_m,z_top_m,bending_1,bending_2,shear,torsion,mass\n0,35,-0.2,-0.2,-0.2,-0.2,0\n").unwrap();
    let structure = Structure::new(beam()).with_customs(Arc::new([soft]));
    let changed = structure.clone().and(&["custom@soft=0.5".parse().unwrap()]).unwrap();
    let factors: Vec<f64> = segments(&changed).iter().map(|segment| segment.bending_n_m2[0] / 1e11).take(5).collect();
    // 10 % less up to 35 m; the fourth segment lies half below.
    for (found, expected) in factors.iter().zip([0.9, 0.9, 0.9, 0.95, 1.0]) {
        assert!((found - expected).abs() < 1e-12, "{factors:?}");
    }
    let refused = |word: &str| structure.clone().and(&[word.parse().unwrap()]).unwrap_err().to_string();
    assert_eq!(
        refused("custom@hard=1"),
        "custom@hard: no [[model.custom]] in study.toml has this name; there are soft"
    );
    assert!(refused("custom@soft=3").contains("it must be 0 to 2"));
    let error = custom("z_bottom_m,z_top_m,bend\n0,1,2\n").unwrap_err().to_string();
    assert!(error.contains("line 1: the column `bend` is unknown"), "{error}");
    let error = custom("z_bottom_m,z_top_m,shear\n0,1,much\n").unwrap_err().to_string();
    assert!(error.contains("line 2: column `shear`: `much` is not a number"), "{error}");
}

/// The few rows that differ are the whole difference, with and without dashpots.
#[test]
fn the_change_between_two_structures_is_the_difference_of_their_matrices() {
    let structure = || Structure::new(beam());
    let here = structure().assemble();
    for word in ["added-mass@100m=1e4", "base-rotation=1e-12", "stiffness-scale=0.1", "p-delta=1"] {
        let there = structure().and(&[word.parse().unwrap()]).unwrap().assemble();
        let found = here.change_to(&there, 0.5).unwrap();
        let whole = crate::model::Change::of(
            &((&there.stiffness - &here.stiffness) / 0.5),
            &((&there.mass - &here.mass) / 0.5),
            None,
        );
        assert_eq!(format!("{found:?}"), format!("{whole:?}"), "{word}");
    }
    assert!(here.change_to(&here, 1.0).is_none());
}

#[test]
fn an_effect_as_typed_is_read_again_as_itself() {
    for word in [
        "base-rotation=1.0812345678901e-14",
        "added-mass@443.6m=2e6",
        "sensor-polarity@ch04",
        "mass-eccentricity=x=-2.1,y=3",
    ] {
        let effect: Effect = word.parse().unwrap();
        let again: Effect = effect.typed().parse().unwrap();
        assert_eq!((again.record(), again.to_string()), (effect.record(), effect.to_string()), "{}", effect.typed());
    }
    let two: Effect = "tuned-mass-damper@78m=mass=2e5,frequency=0.53,damping_ratio=0.05".parse().unwrap();
    assert_eq!(two.typed(), "tuned-mass-damper@78m=mass=2e5,frequency=5.3e-1,damping_ratio=5e-2");
}
