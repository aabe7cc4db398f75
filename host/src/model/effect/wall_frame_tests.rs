//! Walls with frames beside them, against the closed form of Heidebrecht and Stafford Smith (1973).

use std::path::Path;

use nalgebra::DVector;

use super::Effect;
use crate::model::beam::BeamTable;
use crate::model::{DOFS_A_NODE, Structure};

/// EI of the wall in N m², its height in m.
const WALL_N_M2: f64 = 2e12;
const HEIGHT_M: f64 = 60.0;
const SEGMENTS: usize = 60;

/// α H of a wall of 60 m with frames beside it: frames of GA = α² EI.
const ALPHA_HEIGHT: f64 = 1.2;

/// The table of one beam that answers to a moment at the top as the uniform wall and its frames: of the moment the wall has
/// cosh(α z) / cosh(α H) left at a height.
fn merged() -> BeamTable {
    let mut text = String::from(
        "z_bottom_m,z_top_m,bending_1_n_m2,bending_2_n_m2,axis_deg,shear_n,torsion_n_m2,mass_top_kg,inertia_x_kg_m2,inertia_y_kg_m2,inertia_z_kg_m2\n",
    );
    let length_m = HEIGHT_M / SEGMENTS as f64;
    for index in 0..SEGMENTS {
        let (bottom, top) = (length_m * index as f64, length_m * (index + 1) as f64);
        let left = (ALPHA_HEIGHT * (bottom + 0.5 * length_m) / HEIGHT_M).cosh() / ALPHA_HEIGHT.cosh();
        let bending = WALL_N_M2 / left;
        text.push_str(&format!("{bottom},{top},{bending},{bending},30,,2e10,1e5,1e5,1e5,5e5\n"));
    }
    BeamTable::from_reader(text.as_bytes(), Path::new("beam.csv")).unwrap()
}

fn share() -> f64 {
    1.0 - 1.0 / ALPHA_HEIGHT.cosh()
}

/// Forces on all nodes along X, moments about Y.
fn answer(words: &[String], [force_n, top_moment_n_m]: [f64; 2]) -> DVector<f64> {
    let effects: Vec<Effect> = words.iter().map(|word| word.parse().unwrap()).collect();
    let stiffness = Structure::with_effects(merged(), &effects).unwrap().assemble().stiffness;
    let mut forces = DVector::zeros(stiffness.nrows());
    for node in 0..SEGMENTS {
        forces[node * DOFS_A_NODE] = force_n;
    }
    // A floor at the top has half as much below it.
    forces[(SEGMENTS - 1) * DOFS_A_NODE] *= 0.5;
    forces[(SEGMENTS - 1) * DOFS_A_NODE + 3] = top_moment_n_m;
    stiffness.cholesky().unwrap().solve(&forces)
}

#[test]
fn a_moment_at_the_top_moves_wall_and_frames_as_it_moved_the_beam() {
    let (one, apart) = (answer(&[], [0.0, 1e9]), answer(&[format!("wall-frame={}", share())], [0.0, 1e9]));
    for row in 0..one.len() {
        // Moments are linear along the wall's segments, and were constant along those of the beam: by 1 / (4 SEGMENTS²).
        assert!(
            (apart[row] - one[row]).abs() < 1e-4 * one.amax() / HEIGHT_M.powi((row % DOFS_A_NODE / 2) as i32),
            "{row}"
        );
    }
}

/// Stafford Smith and Coull (1991), eq. 11.13: w the load per metre.
#[test]
fn wall_and_frames_sway_under_wind_as_in_closed_form() {
    let load_n_m = 1e4;
    let length_m = HEIGHT_M / SEGMENTS as f64;
    let found = answer(&[format!("wall-frame={}", share())], [load_n_m * length_m, 0.0]);
    let a = ALPHA_HEIGHT;
    for node in (0..SEGMENTS).filter(|node| node % 10 == 9) {
        let z = (node + 1) as f64 / SEGMENTS as f64;
        let bent = (a * a.sinh() + 1.0) / a.cosh() * ((a * z).cosh() - 1.0) - a * (a * z).sinh();
        let sway_m = load_n_m * HEIGHT_M.powi(4) / (WALL_N_M2 * a.powi(4)) * (bent + a * a * (z - 0.5 * z * z));
        let ratio = found[node * DOFS_A_NODE] / sway_m;
        assert!((ratio - 1.0).abs() < 1e-3, "node {node}: {ratio}");
    }
    // One beam for both is 6 % off at the top.
    let merged = answer(&[], [load_n_m * length_m, 0.0]);
    let top = (SEGMENTS - 1) * DOFS_A_NODE;
    assert!((merged[top] / found[top] - 1.0).abs() > 0.03, "{}", merged[top] / found[top]);
}

#[test]
fn shares_of_one_direction_leave_the_other_and_torsion_as_they_are() {
    let effects: [Effect; 1] = ["wall-frame=share_x=0.3,share_y=0".parse().unwrap()];
    let straight =
        |table: BeamTable, effects: &[Effect]| Structure::with_effects(table, effects).unwrap().assemble().stiffness;
    let mut table = merged();
    for segment in table.segments_mut() {
        segment.axis_deg = 0.0;
    }
    let (one, apart) = (straight(table.clone(), &[]), straight(table, &effects));
    for row in 0..one.nrows() {
        for column in 0..one.ncols() {
            let along_x = [row, column].iter().all(|at| [0, 3].contains(&(at % DOFS_A_NODE)));
            assert_eq!(
                along_x && one[(row, column)] != 0.0,
                apart[(row, column)] != one[(row, column)],
                "{row}, {column}"
            );
        }
    }
}
