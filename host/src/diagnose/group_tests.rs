//! Groups of a model given as matrices: what one lacks is named, what all scatter by is learned.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::testing::normal;
use super::*;
use crate::model::{Structure, load};
use crate::modes::{MeasuredMode, MeasuredShape};
use crate::study::{Model, Sensor, Study};

const STOREYS: usize = 8;
const STIFFNESS_N_PER_M: f64 = 2e8;
const MASS_KG: f64 = 4e5;
/// How far a storey is trusted.
const STD: f64 = 0.05;

/// A storey's part of K, of unit stiffness.
fn part(storey: usize) -> DMatrix<f64> {
    let mut part = DMatrix::zeros(STOREYS, STOREYS);
    part[(storey, storey)] = 1.0;
    if storey > 0 {
        part[(storey - 1, storey - 1)] = 1.0;
        part[(storey, storey - 1)] = -1.0;
        part[(storey - 1, storey)] = -1.0;
    }
    part
}

fn written(matrix: &DMatrix<f64>) -> String {
    let mut text = format!("%%MatrixMarket matrix array real general\n{} {}\n", matrix.nrows(), matrix.ncols());
    matrix.iter().for_each(|entry| writeln!(text, "{entry:e}").unwrap());
    text
}

/// The file that says where the floors are, in the words of a study.
const DOFS: &str = ", dofs = \"dofs.csv\"";
/// Height of a storey.
const STOREY_M: f64 = 3.0;

/// The study's files, with a group a storey and `more` at the end.
fn files(folder: &Path, more: &str) -> Study {
    files_with(folder, &[STIFFNESS_N_PER_M; STOREYS], "", more)
}

/// The same of storeys of these stiffnesses, with more about the matrices in `of_matrices`.
fn files_with(folder: &Path, stiffness_n_per_m: &[f64], of_matrices: &str, more: &str) -> Study {
    let floor = |storey: usize| format!("{storey},{storey},ux,{}\n", STOREY_M * storey as f64);
    let floors: String = (1..=STOREYS).map(floor).collect();
    fs::write(folder.join("dofs.csv"), format!("row,node,dof,z_m\n,0,ux,0\n{floors}")).unwrap();
    let whole: DMatrix<f64> = (0..STOREYS).map(|storey| part(storey) * stiffness_n_per_m[storey]).sum();
    fs::write(folder.join("k.mtx"), written(&whole)).unwrap();
    fs::write(folder.join("m.mtx"), written(&(DMatrix::identity(STOREYS, STOREYS) * MASS_KG))).unwrap();
    let mut text = "[structure]\nname = \"frame\"\n\n[measured]\nmodes = \"modes.csv\"\n\n".to_owned();
    for storey in 1..=STOREYS {
        write!(text, "[[sensor]]\nchannel = \"{storey}\"\ndof = {storey}\n\n").unwrap();
    }
    writeln!(text, "[model]\nmatrices = {{ stiffness = \"k.mtx\", mass = \"m.mtx\"{of_matrices} }}\n").unwrap();
    for storey in 1..=STOREYS {
        fs::write(folder.join(format!("{storey}.mtx")), written(&(part(storey - 1) * stiffness_n_per_m[storey - 1])))
            .unwrap();
        write!(text, "[[model.group]]\nname = \"storey{storey}\"\nstiffness = \"{storey}.mtx\"\nstd = {STD}\n")
            .unwrap();
        let top_m = STOREY_M * storey as f64;
        write!(text, "z_m = [{:.1}, {top_m:.1}]\n\n", top_m - STOREY_M).unwrap();
    }
    text.push_str(more);
    fs::write(folder.join("modes.csv"), "mode,frequency_hz\n1,1.0\n").unwrap();
    fs::write(folder.join("study.toml"), &text).unwrap();
    Study::from_text(&text, folder).unwrap()
}

fn model() -> (Structure, Model, Vec<Sensor>) {
    let folder = tempfile::tempdir().unwrap();
    let study = files(folder.path(), "");
    (load(&study).unwrap().bare(), study.model.clone().unwrap(), study.sensors())
}

/// Modes of storeys with these factors, by a plain eigenproblem, as measured to 0.1 % and 0.5 % of a shape's length.
fn measured(factors: &[f64], modes: usize, random: &mut ChaCha8Rng) -> Vec<MeasuredMode> {
    measured_of(storeys(factors), modes, random)
}

/// K of storeys with these factors.
fn storeys(factors: &[f64]) -> DMatrix<f64> {
    factors.iter().enumerate().map(|(storey, factor)| part(storey) * (factor * STIFFNESS_N_PER_M)).sum()
}

/// The same of any K.
fn measured_of(stiffness: DMatrix<f64>, modes: usize, random: &mut ChaCha8Rng) -> Vec<MeasuredMode> {
    let eigen = (stiffness / MASS_KG).symmetric_eigen();
    let mut order: Vec<usize> = (0..STOREYS).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let one = |(index, &at): (usize, &usize)| {
        let hz = eigen.eigenvalues[at].sqrt() / std::f64::consts::TAU;
        let shape: DVector<f64> = eigen.eigenvectors.column(at).into_owned();
        MeasuredMode {
            covariance_factor: None,
            number: index + 1,
            frequency_hz: hz * (1.0 + 1e-3 * normal(random)),
            frequency_std_hz: Some(1e-3 * hz),
            stated: None,
            damping_ratio: None,
            damping_ratio_std: None,
            shape: Some(MeasuredShape {
                sensors: (0..STOREYS).collect(),
                imaginary: None,
                stds: Some(DVector::from_element(STOREYS, 5e-3)),
                values: shape.map(|value| value + 5e-3 * normal(random)),
            }),
        }
    };
    order.iter().take(modes).enumerate().map(one).collect()
}

fn scattered(random: &mut ChaCha8Rng) -> Vec<f64> {
    (0..STOREYS).map(|_| 1.0 + STD * normal(random)).collect()
}

fn diagnosed(modes: &[MeasuredMode]) -> (Problem, Diagnosis) {
    let (structure, model, sensors) = model();
    let problem = Problem::new(structure, &[], &model, &sensors, modes).unwrap();
    let diagnosis = diagnose(&problem, &[], &Signals::default(), &Options::default()).unwrap();
    (problem, diagnosis)
}

#[test]
fn the_storey_that_lacks_stiffness_is_named_with_its_value() {
    for (seed, storey, change) in [(1, 3, -0.3), (2, 1, -0.35), (3, 6, 0.5)] {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut factors = scattered(&mut random);
        factors[storey - 1] *= 1.0 + change;
        let (_, diagnosis) = diagnosed(&measured(&factors, 5, &mut random));
        assert_eq!(diagnosis.best, [format!("group@storey{storey}")], "seed {seed}: {:?}", diagnosis.candidates);
        let value = &diagnosis.candidates[0].parameters[0];
        let std = value.std.unwrap();
        assert!((value.value - change).abs() < 3.0 * std && std < 0.15, "seed {seed}: {value:?}");
    }
}

/// Columns get longer and shorter: sways of a cantilever, integrated in steps of 10 mm, are added to those of the storeys. Where the model has its
/// storeys by drawings, it leaves that out; where it has them by the sway under a load, they have it in one.
#[test]
fn bending_of_the_whole_is_named_with_its_size_whether_storeys_have_it_or_not() {
    let height_m = |floor: usize| STOREY_M * (floor + 1) as f64;
    let bent = DMatrix::from_fn(STOREYS, STOREYS, |at, force| {
        let steps = (100.0 * height_m(at).min(height_m(force))).round() as usize;
        let middles = (0..steps).map(|step| 0.01 * (step as f64 + 0.5));
        middles.map(|s_m| 0.01 * (height_m(at) - s_m) * (height_m(force) - s_m)).sum()
    });
    let loads = DVector::from_fn(STOREYS, |floor, _| height_m(floor));
    let top = |flexibility: &DMatrix<f64>| (flexibility * &loads)[STOREYS - 1];
    let drawn = storeys(&[1.0; STOREYS]).try_inverse().unwrap();
    let cases = [(31, 0.3, false), (32, 0.6, false), (33, 0.15, false), (34, 0.3, true), (35, 0.6, true)];
    for (seed, ratio, by_sway) in cases {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let bent = &bent * (ratio * top(&drawn) / top(&bent));
        let sway = (&drawn + &bent) * &loads;
        let by_load = |storey: usize| {
            let below = if storey > 0 { sway[storey - 1] } else { 0.0 };
            loads.rows(storey, STOREYS - storey).sum() / (sway[storey] - below)
        };
        let stiffness: Vec<f64> =
            (0..STOREYS).map(|storey| if by_sway { by_load(storey) } else { STIFFNESS_N_PER_M }).collect();
        let folder = tempfile::tempdir().unwrap();
        let study = files_with(folder.path(), &stiffness, DOFS, "");
        let (structure, model, sensors) = (load(&study).unwrap().bare(), study.model.clone().unwrap(), study.sensors());
        let flexibility = storeys(&scattered(&mut random)).try_inverse().unwrap() + bent;
        let modes = measured_of(flexibility.try_inverse().unwrap(), 5, &mut random);
        let problem = Problem::new(structure, &[], &model, &sensors, &modes).unwrap();
        let diagnosis = diagnose(&problem, &[], &Signals::default(), &Options::default()).unwrap();
        let (kind, truth) = if by_sway { ("overall-bending", ratio / (1.0 + ratio)) } else { ("chord-drift", ratio) };
        assert_eq!(diagnosis.best, [kind], "seed {seed}: {:?}", diagnosis.candidates);
        let value = &diagnosis.candidates[0].parameters[0];
        assert!((value.value - truth).abs() < 3.0 * value.std.unwrap(), "seed {seed}: {value:?} of {truth}");
    }
}

#[test]
fn storeys_within_what_they_are_trusted_to_are_adequate_and_learned() {
    let mut squares = 0.0;
    for seed in 11..15 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let factors = scattered(&mut random);
        let modes = measured(&factors, 5, &mut random);
        let (problem, diagnosis) = diagnosed(&modes);
        assert_eq!(diagnosis.verdict, Verdict::Adequate, "seed {seed}: {:?}", diagnosis.candidates.first());
        let (problem, fit) = problem.fit_settled(&[]).unwrap();
        let groups = Profile::of(&problem, &fit).groups;
        assert_eq!(groups.len(), STOREYS);
        assert_eq!((groups[1].name.as_str(), groups[1].span_m), ("storey2", Some([3.0, 6.0])));
        for (group, truth) in groups.iter().zip(&factors) {
            squares += ((group.factor - truth) / group.std).powi(2) / (4 * STOREYS) as f64;
            assert!(group.std < 0.5 * group.prior_std, "{group:?}");
        }
    }
    // Of 32 numbers 95 % of means lie between 0.57 and 1.55.
    assert!((0.4..1.8).contains(&squares), "{squares}");
}

/// How differences follow each group is what their differences say.
#[test]
fn derivatives_by_groups_are_those_of_the_differences() {
    let (structure, model, sensors) = model();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let modes = measured(&scattered(&mut random), 5, &mut random);
    let problem = Problem::new(structure, &[], &model, &sensors, &modes).unwrap();
    let numbers = DVector::from_fn(problem.background.size(), |_, _| 0.5 * normal(&mut random));
    let state = problem.state(Vec::new(), numbers.clone(), None).unwrap();
    let slopes = state.by_background(&problem);
    for group in 0..STOREYS {
        let at = |step: f64| {
            let mut moved = numbers.clone();
            moved[problem.background.first_of_groups() + group] += step;
            problem.state(Vec::new(), moved, None).unwrap().differences()
        };
        let exact = (at(1e-3) - at(-1e-3)) / 2e-3;
        let error = (&exact - slopes.column(problem.background.first_of_groups() + group)).norm() / exact.norm();
        assert!(error < 1e-3, "storey {}: off by {error}", group + 1);
    }
}

#[test]
fn groups_that_are_no_groups_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("nothing.mtx"), written(&DMatrix::zeros(STOREYS, STOREYS))).unwrap();
    fs::write(folder.path().join("small.mtx"), written(&DMatrix::identity(3, 3))).unwrap();
    fs::write(folder.path().join("twice.mtx"), written(&(part(2) * 2.0))).unwrap();
    let refused = |file: &str| {
        let more = format!("[[model.group]]\nname = \"last\"\nstiffness = \"{file}\"\nstd = 0.1\n");
        load(&files(folder.path(), &more)).unwrap_err().to_string()
    };
    assert!(refused("nothing.mtx").contains("`last`: it changes nothing of the model"), "{}", refused("nothing.mtx"));
    assert!(
        refused("small.mtx").contains("its matrices are 3 x 3, those of the model 8 x 8"),
        "{}",
        refused("small.mtx")
    );
    assert!(refused("twice.mtx").contains("the same as group `storey3`, up to a factor"), "{}", refused("twice.mtx"));
}

/// A storey loses less than it was trusted to before: nothing has been built anew since, so the change is named all the same.
#[test]
fn a_storey_that_has_changed_is_named_though_the_model_may_be_wrong_by_more() {
    let folder = tempfile::tempdir().unwrap();
    let study = files(folder.path(), "");
    let mut random = ChaCha8Rng::seed_from_u64(21);
    let mut factors = scattered(&mut random);
    let before = measured(&factors, 5, &mut random);
    factors[4] *= 0.96;
    let now = measured(&factors, 5, &mut random);
    let (structure, model, sensors) = (load(&study).unwrap().bare(), study.model.clone().unwrap(), study.sensors());
    let setting = steps::Setting {
        bare: &structure,
        model: &model,
        sensors: &sensors,
        measured: &before,
        tally: &crate::progress::UNHEARD,
    };
    let change = diagnose_change(&setting, &[], &now, 1e-6, &Options::default()).unwrap();
    assert_eq!(change.best, ["group@storey5"], "{:?}", change.candidates.first());
    let value = &change.candidates[0].parameters[0];
    assert!((value.value + 0.04).abs() < 3.0 * value.std.unwrap() && value.std.unwrap() < 0.02, "{value:?}");
}
