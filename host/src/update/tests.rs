//! The update: what it meets, what it leaves alone, and that no other method does better on the same problems.

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::*;
use crate::compare::{ModelView, Pair};
use crate::model::effect::Effect;
use crate::model::{BeamTable, Body, Structure, matrix_market, npy};
use crate::modes::{MeasuredMode, MeasuredShape};
use crate::study::{Sensor, Study, template};

/// Towers from this seed on differ twice as much from their model, and are measured five times worse.
const HARD: u64 = 11;

/// The Canton Tower's table, its sensors, and a relative of it with other stiffness, softer at the base.
struct Towers {
    model: Structure,
    other: Structure,
    sensors: Vec<Sensor>,
}

fn towers(seed: u64, sensors: usize) -> Towers {
    let table = BeamTable::from_reader(template::CANTON_BEAM.as_bytes(), Path::new("beam.csv")).unwrap();
    let study = Study::from_text(template::CANTON_STUDY, Path::new("canton")).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut other = Structure::new(table.clone());
    // Smooth scatter over the height, and another base.
    let size = if seed < HARD { 0.2 } else { 0.4 };
    let waves: Vec<(f64, f64)> =
        (1..5).map(|_| (random.random_range(-size..size), random.random_range(0.0..TAU))).collect();
    if let Body::Beam(beam) = &mut other.body {
        for segment in beam.segments_mut() {
            let z = segment.z_top_m / 618.0;
            let scatter: f64 =
                waves.iter().zip(1..).map(|((a, phase), k)| a * (k as f64 * z * 3.0 + phase).sin()).sum();
            segment.bending_n_m2 = segment.bending_n_m2.map(|bending| bending * scatter.exp());
            segment.axis_deg += 20.0 * scatter;
        }
    }
    let soft = [random.random_range(0.0..2e-14), random.random_range(0.0..2e-14)];
    let other = other.and(&[Effect::new("base-rotation", None, &soft).unwrap()]).unwrap();
    Towers { model: Structure::new(table), other, sensors: study.sensors().into_iter().take(sensors).collect() }
}

/// Measured modes of a structure, with errors of up to 1 % (hard ones: 5 %) of the largest component on the shapes.
fn measured(structure: &Structure, sensors: &[Sensor], modes: usize, seed: u64) -> Vec<MeasuredMode> {
    let view = ModelView::of(&structure.assemble(), sensors).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(seed + 1000);
    let error = if seed < HARD { 0.01 } else { 0.05 };
    (0..modes)
        .map(|mode| {
            let shape = DVector::from_column_slice(view.shape(mode));
            let largest = shape[shape.icamax()];
            let values = (shape / largest).map(|value| value + random.random_range(-error..error));
            MeasuredMode {
                covariance_factor: None,
                number: mode + 1,
                frequency_hz: view.modes.frequency_hz[mode],
                frequency_std_hz: Some(1e-4),
                stated: None,
                damping_ratio: None,
                damping_ratio_std: None,
                shape: Some(MeasuredShape {
                    imaginary: None,
                    sensors: (0..sensors.len()).collect(),
                    values,
                    stds: None,
                }),
            }
        })
        .collect()
}

fn in_order(modes: usize) -> Vec<Pair> {
    (0..modes).map(|mode| Pair { measured: mode, model: mode, mac: None, subspace_mac: None }).collect()
}

struct Case {
    towers: Towers,
    view: ModelView,
    problem: Problem,
}

fn case(seed: u64, sensors: usize, modes: usize) -> Case {
    let towers = towers(seed, sensors);
    let view = ModelView::of(&towers.model.assemble(), &towers.sensors).unwrap();
    let measured = measured(&towers.other, &towers.sensors, modes, seed);
    let problem = Problem::of(&view, &measured, &in_order(modes), &Weights::default());
    Case { towers, view, problem }
}

#[test]
fn the_used_frequencies_are_met_and_every_other_eigenpair_stays() {
    let modes = 10;
    let Case { towers, view, problem } = case(1, 16, modes);
    let solution = solve(&problem).unwrap();
    let assembly = towers.model.assemble();
    let used: Vec<usize> = (0..modes).collect();
    let updated = updated(&assembly, &view.modes, &used, &solution.psi, &problem.measured_lambda).unwrap();
    assert!(updated.max_relative_change_of_other_eigenvalues < 1e-9);
    assert_eq!(updated.others.len(), assembly.dofs() - modes);
    assert!(updated.max_turn_of_other_shapes < 1e-9, "turned by {:.1e}", updated.max_turn_of_other_shapes);
    assert_eq!(updated.others[0].mode, modes);
    for lambda in &problem.measured_lambda {
        let hz = lambda.sqrt() / TAU;
        let nearest = updated.modes.frequency_hz.iter().map(|found| (found / hz - 1.0).abs()).fold(f64::MAX, f64::min);
        assert!(nearest < 1e-9, "{hz} Hz is off by {nearest:.1e}");
    }
    // Shapes of modes that were not used: the residual of the old vectors in the new problem.
    for mode in modes..modes + 5 {
        let shape = view.modes.shapes.column(mode);
        let lambda = (TAU * view.modes.frequency_hz[mode]).powi(2);
        let inertial = &assembly.mass * shape * lambda;
        let residual = &updated.stiffness * shape - &inertial;
        assert!(residual.amax() < 1e-6 * inertial.amax(), "mode {mode}");
    }
    // And the eigenvectors of K* are Phi1 V: their MAC at the sensors is what the solution says.
    let at_sensors = ModelView::of(&assembly, &towers.sensors).unwrap().sensor_rows * &updated.modes.shapes;
    for (index, lambda) in problem.measured_lambda.iter().enumerate() {
        let hz = lambda.sqrt() / TAU;
        let distance = |mode: &usize| (updated.modes.frequency_hz[*mode] - hz).abs();
        let mode = (0..20).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap();
        let (_, measured) = problem.measured[index].as_ref().unwrap();
        let shape = at_sensors.column(mode);
        let mac = shape.dot(measured).powi(2) / (shape.norm_squared() * measured.norm_squared());
        assert!((mac - solution.mac[index].unwrap()).abs() < 1e-6);
    }
}

#[test]
fn psi_is_symmetric_and_belongs_to_an_orthogonal_matrix() {
    let Case { problem, .. } = case(2, 16, 10);
    let solution = solve(&problem).unwrap();
    assert_eq!(solution.psi, solution.psi.transpose());
    let gram = solution.rotation.tr_mul(&solution.rotation);
    assert!((gram - DMatrix::identity(10, 10)).amax() < 1e-12);
    for (mac, ceiling) in solution.mac.iter().zip(&solution.mac_ceiling) {
        assert!(mac.unwrap() <= ceiling.unwrap() + 1e-12);
    }
}

#[test]
fn a_structure_in_the_models_span_is_found_again() {
    // Measured shapes that are an orthogonal mixture of the model's own: Psi reproduces it, MAC 1.
    let Case { view, mut problem, .. } = case(3, 16, 6);
    let mut mixture = DMatrix::identity(6, 6);
    for (i, j, angle) in [(0, 1, 0.7), (2, 3, -0.4), (1, 4, 0.3), (3, 5, 0.9)] {
        let mut turn = DMatrix::identity(6, 6);
        let (sin, cos) = f64::sin_cos(angle);
        (turn[(i, i)], turn[(j, j)], turn[(i, j)], turn[(j, i)]) = (cos, cos, -sin, sin);
        mixture *= turn;
    }
    let shapes = view.at_sensors.columns(0, 6) * &mixture;
    problem.measured = shapes.column_iter().map(|shape| Some(((0..16).collect(), shape.into_owned()))).collect();
    let solution = solve(&problem).unwrap();
    assert!(solution.objective < 1e-12, "objective {:.1e}", solution.objective);
    for (found, made) in solution.rotation.column_iter().zip(mixture.column_iter()) {
        assert!((found.dot(&made).abs() - 1.0).abs() < 1e-6);
    }
}

#[test]
fn more_modes_than_sensors_are_said_to_be_undetermined() {
    let Case { problem, .. } = case(4, 6, 10);
    let solution = solve(&problem).unwrap();
    let warning = &solution.warnings[0];
    assert!(warning.starts_with("10 modes at 6 sensors") && warning.contains("so 4 of the 10 directions"), "{warning}");
    assert!(solution.psi.iter().all(|value| value.is_finite()));
    // Enough sensors, but one mode is known at few of them.
    let Case { mut problem, .. } = case(4, 16, 10);
    assert!(solve(&problem).unwrap().warnings.is_empty());
    problem.measured[1] =
        problem.measured[1].as_ref().map(|(_, values)| (vec![0, 3, 7], values.rows(0, 3).into_owned()));
    let warnings = solve(&problem).unwrap().warnings;
    assert!(warnings.len() == 1 && warnings[0].starts_with("for pair 2, 10 modes at 3 sensors"), "{warnings:?}");
}

#[test]
fn without_shapes_there_is_nothing_to_update() {
    let Case { mut problem, .. } = case(5, 16, 3);
    problem.measured = vec![None; 3];
    assert_eq!(solve(&problem).unwrap_err(), UpdateError::NoShapes);
    problem.model_lambda.clear();
    assert_eq!(solve(&problem).unwrap_err(), UpdateError::NoPairs);
}

#[test]
fn one_mode_without_a_shape_leaves_the_others_and_is_named() {
    let Case { mut problem, .. } = case(6, 16, 5);
    problem.measured[2] = None;
    let solution = solve(&problem).unwrap();
    assert_eq!(solution.mac[2], None);
    assert!(solution.mac[1].unwrap() > 0.95);
    assert!(solution.warnings.iter().any(|warning| warning.contains("pair 3")));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]
    /// What is printed as a Matrix Market file reads back bit for bit, and so does the NumPy file.
    #[test]
    fn exported_matrices_come_back_unchanged(values in proptest::collection::vec(-1e18..1e18f64, 6)) {
        let matrix = DMatrix::from_row_slice(3, 3, &[
            values[0].abs() + 1e19, values[1], values[2], values[1], values[3].abs() + 1e19, values[4], values[2], values[4],
            values[5].abs() + 1e19,
        ]);
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("k.mtx"), matrix_market(&matrix)).unwrap();
        std::fs::write(folder.path().join("k.npy"), npy(&matrix).unwrap()).unwrap();
        let term = |name: &str| vec![crate::study::MatrixTerm { name: name.to_owned(), factor: 1.0 }];
        let source = crate::study::MatrixSource { file: None, stiffness: term("k.mtx"), mass: term("k.npy"), layout: None };
        let read = crate::model::ImportedMatrices::read(&source, folder.path()).unwrap();
        prop_assert_eq!(&read.stiffness, &matrix);
        prop_assert_eq!(&read.mass, &matrix);
    }
}

/// Problems and what SLSQP makes of them, for `tests/psi/slsqp.py`.
#[derive(Serialize, Deserialize)]
struct Recorded {
    problems: Vec<RecordedProblem>,
}

#[derive(Serialize, Deserialize)]
struct RecordedProblem {
    model_lambda: Vec<f64>,
    measured_lambda: Vec<f64>,
    /// Sensors x modes.
    shapes: Vec<Vec<f64>>,
    /// Modes x sensors.
    measured_shapes: Vec<Vec<f64>>,
    weights: Vec<f64>,
    frequency_weight: f64,
    /// The best objective of twenty SLSQP runs; written by the script.
    slsqp_best_objective: Option<f64>,
    slsqp_median_objective: Option<f64>,
    slsqp_largest_frequency_error_percent: Option<f64>,
    slsqp_seconds_a_run: Option<f64>,
}

fn recorded_file() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/psi/problems.json")
}

#[test]
#[ignore = "writes tests/psi/problems.json anew; run tests/psi/slsqp.py afterwards"]
fn write_psi_problems() {
    let rows = |matrix: &DMatrix<f64>| matrix.row_iter().map(|row| row.iter().copied().collect()).collect();
    let problems = (1..=5).chain(HARD..HARD + 5).map(|seed| {
        let problem = case(seed, 16, 10).problem;
        RecordedProblem {
            shapes: rows(&problem.shapes),
            measured_shapes: problem.measured.iter().map(|m| m.as_ref().unwrap().1.iter().copied().collect()).collect(),
            model_lambda: problem.model_lambda,
            measured_lambda: problem.measured_lambda,
            weights: problem.weights,
            frequency_weight: Weights::default().frequency,
            slsqp_best_objective: None,
            slsqp_median_objective: None,
            slsqp_largest_frequency_error_percent: None,
            slsqp_seconds_a_run: None,
        }
    });
    let recorded = Recorded { problems: problems.collect() };
    std::fs::create_dir_all(recorded_file().parent().unwrap()).unwrap();
    std::fs::write(recorded_file(), serde_json::to_string(&recorded).unwrap()).unwrap();
}

/// The problems of ten towers, m = 10, p = 16: the objective is not above the best of twenty SLSQP runs over Psi's entries.
#[test]
fn no_slsqp_run_on_the_same_problem_does_better() {
    let recorded: Recorded = serde_json::from_str(&std::fs::read_to_string(recorded_file()).unwrap()).unwrap();
    assert_eq!(recorded.problems.len(), 10);
    for (index, recorded) in recorded.problems.iter().enumerate() {
        let sensors = recorded.shapes.len();
        let problem = Problem {
            model_lambda: recorded.model_lambda.clone(),
            measured_lambda: recorded.measured_lambda.clone(),
            shapes: DMatrix::from_fn(sensors, recorded.model_lambda.len(), |row, column| recorded.shapes[row][column]),
            measured: recorded
                .measured_shapes
                .iter()
                .map(|shape| Some(((0..sensors).collect(), DVector::from_column_slice(shape))))
                .collect(),
            weights: recorded.weights.clone(),
        };
        let solution = solve(&problem).unwrap();
        let best = recorded.slsqp_best_objective.expect("the script has filled it in");
        eprintln!("tower {}: objective {:.4e}, SLSQP {best:.4e}", index + 1, solution.objective);
        assert!(solution.objective <= best * (1.0 + 1e-9), "tower {}: {} > {best}", index + 1, solution.objective);
    }
}
