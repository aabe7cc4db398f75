//! A net of springs under tension, whose springs are no two alike: reduced, and whole, with its parts changed far.

use std::fs;
use std::path::Path;

use nalgebra::{DMatrix, DVector};
use nalgebra_sparse::CscMatrix;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use belfry_numerics::{SparseFactor, count_below, lowest_sparse_modes};

use super::matrices::WholeMatrices;
use super::*;
use crate::study::{CustomSource, GroupTerms, MatrixTerm, Sensor};

const ALONG: usize = 20;
const ACROSS: usize = 12;
const NODES: usize = ALONG * ACROSS;
/// Modes that are measured.
const MEASURED: usize = 6;
/// Of four parts of the stiffness, and of the mass of one corner.
const CHANGES: [f64; 5] = [-0.5, 1.0, 0.4, -0.3, 0.6];

/// Springs between neighbours, of the quarter of the net that they are in, and to the ground; masses.
fn net(random: &mut ChaCha8Rng) -> ([DMatrix<f64>; 4], DMatrix<f64>, DMatrix<f64>) {
    let mut quarters = [0; 4].map(|_| DMatrix::zeros(NODES, NODES));
    for (i, j) in (0..ALONG).flat_map(|i| (0..ACROSS).map(move |j| (i, j))) {
        let quarter = &mut quarters[2 * usize::from(i >= ALONG / 2) + usize::from(j >= ACROSS / 2)];
        let neighbours = [(i + 1, j), (i, j + 1)].into_iter().filter(|&(i, j)| i < ALONG && j < ACROSS);
        for (other_i, other_j) in neighbours {
            let spring = 1e6 * random.random_range(0.5..2.0);
            let (one, other) = (i * ACROSS + j, other_i * ACROSS + other_j);
            quarter[(one, one)] += spring;
            quarter[(other, other)] += spring;
            quarter[(one, other)] -= spring;
            quarter[(other, one)] -= spring;
        }
    }
    let ground = DMatrix::from_diagonal(&DVector::from_fn(NODES, |_, _| 1e3 * random.random_range(0.5..2.0)));
    let mass = DMatrix::from_diagonal(&DVector::from_fn(NODES, |_, _| 100.0 * random.random_range(0.5..2.0)));
    (quarters, ground, mass)
}

fn group(name: &str, matrix: &DMatrix<f64>, of_mass: bool, folder: &Path) -> Custom {
    let file = format!("{name}.mtx");
    fs::write(folder.join(&file), matrix_market(matrix)).unwrap();
    let terms = vec![MatrixTerm { name: file, factor: 1.0 }];
    let (stiffness, mass) = if of_mass { (Vec::new(), terms) } else { (terms, Vec::new()) };
    let source = CustomSource {
        line: 1,
        name: name.to_owned(),
        file: None,
        stiffness,
        mass,
        segments: None,
        least: None,
        greatest: None,
        typical: None,
        tied_to: None,
        channels: Vec::new(),
        group: Some(GroupTerms { std: 0.1, span_m: None }),
    };
    Custom::read(&source, folder).unwrap()
}

/// The matrices and groups, whole.
fn whole(folder: &Path) -> (WholeMatrices, Vec<Custom>) {
    let ([a, b, c, d], ground, mass) = net(&mut ChaCha8Rng::seed_from_u64(11));
    let corner = DMatrix::from_fn(NODES, NODES, |i, j| if i == j && i < 30 { mass[(i, i)] } else { 0.0 });
    let mut groups: Vec<Custom> = [&a, &b, &c, &d]
        .into_iter()
        .enumerate()
        .map(|(at, part)| group(&format!("k{at}"), part, false, folder))
        .collect();
    groups.push(group("m", &corner, true, folder));
    let (stiffness, mass) = (CscMatrix::from(&(a + b + c + d + ground)), CscMatrix::from(&mass));
    (WholeMatrices { stiffness, mass, nodes: Vec::new(), places: std::sync::Arc::default() }, groups)
}

/// The structure as its files have it.
fn in_full((matrices, groups): (WholeMatrices, Vec<Custom>)) -> Structure {
    Structure::new(Body::Matrices(matrices.in_full(0).unwrap())).with_customs(groups.into())
}

/// The structure in few coordinates.
fn in_few((matrices, groups): (WholeMatrices, Vec<Custom>), highest_hz: f64) -> Structure {
    let (matrices, groups) = reduction::reduced(matrices, groups, Some(highest_hz)).unwrap();
    Structure::new(Body::Matrices(matrices)).with_customs(groups.into())
}

fn sensors() -> Vec<Sensor> {
    let dofs = (1..=NODES).step_by(13);
    dofs.map(|dof| Sensor { dof: Some(dof), ..Sensor::new(dof.to_string(), 0) }).collect()
}

/// Frequencies in Hz and shapes at the sensors, changed by [`CHANGES`] times `share`.
fn seen(structure: &Structure, share: f64) -> (Vec<f64>, DMatrix<f64>) {
    let mut changed = structure.clone();
    changed.change_groups(&CHANGES.map(|change| share * change));
    let assembly = changed.assemble();
    let modes = assembly.modes().unwrap();
    let shapes = assembly.sensor_rows(&sensors()).unwrap() * modes.shapes.columns(0, MEASURED);
    (modes.frequency_hz[..MEASURED].to_vec(), shapes)
}

/// Largest relative error of a frequency, and smallest MAC of a shape.
fn errors(one: &(Vec<f64>, DMatrix<f64>), other: &(Vec<f64>, DMatrix<f64>)) -> (f64, f64) {
    let frequency = one.0.iter().zip(&other.0).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max);
    let mac = |(a, b): (nalgebra::DVectorView<'_, f64>, nalgebra::DVectorView<'_, f64>)| {
        a.dot(&b).powi(2) / (a.norm_squared() * b.norm_squared())
    };
    (frequency, one.1.column_iter().zip(other.1.column_iter()).map(mac).fold(1.0, f64::min))
}

#[test]
fn a_reduced_model_moves_as_the_whole_one_does_however_far_its_groups_change() {
    let folder = tempfile::tempdir().unwrap();
    let (matrices, groups) = whole(folder.path());
    let whole = in_full((matrices.clone(), groups.clone()));
    let basis = whole.assemble().modal_basis().unwrap();
    let highest_hz = whole.assemble().modes().unwrap().frequency_hz[MEASURED - 1];
    let reduced = in_few((matrices, groups), highest_hz);
    assert!(reduced.dofs() < NODES / 2, "{} of {NODES}", reduced.dofs());
    for (share, of_frequency, of_mac) in [(0.0, 1e-9, 1e-9), (0.3, 1e-5, 1e-5), (1.0, 1e-4, 1e-4)] {
        let (frequency, mac) = errors(&seen(&reduced, share), &seen(&whole, share));
        println!("{share}: {frequency:e}, 1 - MAC {:e}, {} coordinates", 1.0 - mac, reduced.dofs());
        assert!(frequency < of_frequency && 1.0 - mac < of_mac, "{share}: {frequency:e}, 1 - MAC {:e}", 1.0 - mac);
    }
    // As many modes and no corrections are worse by far.
    let vectors = basis.vectors.columns(0, reduced.dofs()).into_owned();
    let mut changed = whole.clone();
    changed.change_groups(&CHANGES);
    let changed = changed.assemble();
    let within = |matrix: &DMatrix<f64>| vectors.tr_mul(&(matrix * &vectors));
    let coarse = eigenmodes(&within(&changed.stiffness), &within(&changed.mass)).unwrap().frequency_hz;
    let exact = seen(&whole, 1.0).0;
    let worst = coarse.iter().zip(&exact).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max);
    println!("modes alone: {worst:e}");
    let (corrected, _) = errors(&seen(&reduced, 1.0), &seen(&whole, 1.0));
    assert!(worst > 10.0 * corrected, "{worst:e} against {corrected:e}");
}

/// What is exported of a reduced model is K and M of all its degrees of freedom with what groups changed.
#[test]
fn the_whole_matrices_of_a_reduced_model_have_its_changes() {
    let folder = tempfile::tempdir().unwrap();
    let (matrices, groups) = whole(folder.path());
    let mut expected = in_full((matrices.clone(), groups.clone()));
    let mut reduced = in_few((matrices, groups), 1.0);
    assert!(expected.whole_matrices().is_none());
    expected.change_groups(&CHANGES);
    reduced.change_groups(&CHANGES);
    let (expected, found) = (expected.assemble(), reduced.whole_matrices().unwrap());
    for (expected, found) in [(&expected.stiffness, &found.stiffness), (&expected.mass, &found.mass)] {
        let difference = (expected - DMatrix::from(found)).amax();
        assert!(difference < 1e-12 * expected.amax(), "{difference:e}");
    }
}

/// A net that hangs on nothing, and one without mass.
#[test]
fn what_has_no_modes_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (mut matrices, groups) = whole(folder.path());
    let ([a, b, c, d], ..) = net(&mut ChaCha8Rng::seed_from_u64(11));
    let massless = WholeMatrices { mass: CscMatrix::zeros(NODES, NODES), ..matrices.clone() };
    assert_eq!(reduction::reduced(massless, groups.clone(), None).unwrap_err(), EigenError::Massless);
    matrices.stiffness = CscMatrix::from(&(a + b + c + d));
    assert_eq!(reduction::reduced(matrices, groups, None).unwrap_err(), EigenError::NotSupported);
}

/// Modes of equal frequency are all found, and motions without mass are none.
#[test]
fn the_lowest_modes_of_few_entries_are_those_of_all() {
    let (copies, links) = (9, 12);
    let size = copies * links;
    // Chains that are alike and do not touch: each frequency is there once a chain. Every third mass is none.
    let entry = |row: usize, column: usize| match (row / links == column / links, row.abs_diff(column)) {
        (true, 0) => 2.0,
        (true, 1) => -1.0,
        _ => 0.0,
    };
    let stiffness = DMatrix::from_fn(size, size, entry);
    let mass = DMatrix::from_fn(size, size, |row, column| f64::from(u8::from(row == column && row % 3 != 2)));
    let expected = ModalBasis::of(&stiffness, &mass).unwrap();
    let (sparse, sparse_mass) = (CscMatrix::from(&stiffness), CscMatrix::from(&mass));
    let factor = SparseFactor::of(&sparse, 1e-6).unwrap();
    let massive = copies * links * 2 / 3;
    for count in [1, 10, 30, massive, size] {
        let found = lowest_sparse_modes(&factor, &sparse, &sparse_mass, count).unwrap();
        assert_eq!(found.values.len(), count.min(massive));
        let off = found.values.iter().zip(&expected.inverse_lambda).map(|(a, b)| (a / b - 1.0).abs());
        assert!(off.fold(0.0, f64::max) < 1e-9, "{count} of {size}");
        let gram = found.vectors.transpose() * (&stiffness * &found.vectors);
        assert!((gram - DMatrix::identity(found.values.len(), found.values.len())).amax() < 1e-9);
        let left = &mass * &found.vectors
            - &stiffness * &found.vectors * DMatrix::from_diagonal(&DVector::from_column_slice(&found.values));
        assert!(left.amax() < 1e-7 * found.values[0], "{count}: {:e}", left.amax());
        let between = 0.5 * (expected.inverse_lambda[0] + expected.inverse_lambda[copies]);
        assert_eq!(count_below(&sparse, &sparse_mass, 1.0 / between), Some(copies));
    }
    // Most of all modes of a small one.
    let stiffness =
        DMatrix::from_fn(200, 200, |row, column| [2.0, -1.0].get(row.abs_diff(column)).copied().unwrap_or(0.0));
    let (sparse, ones) = (CscMatrix::from(&stiffness), CscMatrix::identity(200));
    let found = lowest_sparse_modes(&SparseFactor::of(&sparse, 1e-6).unwrap(), &sparse, &ones, 150).unwrap();
    for (mode, mu) in (1..).zip(&found.values) {
        let lambda = 4.0 * (f64::from(mode) * std::f64::consts::PI / 402.0).sin().powi(2);
        assert!((mu * lambda - 1.0).abs() < 1e-8, "mode {mode}");
    }
    assert_eq!(found.values.len(), 150);
}

#[test]
fn sensors_name_the_rows_of_the_whole_model() {
    let folder = tempfile::tempdir().unwrap();
    let reduced = in_few(whole(folder.path()), 1.0);
    let mut beyond = sensors();
    beyond[0].dof = Some(NODES + 1);
    let error = reduced.assemble().sensor_rows(&beyond).unwrap_err();
    assert_eq!(error, SensorError::NoSuchDof { channel: "1".to_owned(), dof: NODES + 1, dofs: NODES });
}
