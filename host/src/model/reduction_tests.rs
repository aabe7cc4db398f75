//! A net of springs under tension, whose springs are no two alike: reduced, and whole, with its parts changed far.

use std::fs;
use std::path::Path;

use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

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
        group: Some(GroupTerms { std: 0.1, span_m: None }),
    };
    Custom::read(&source, folder).unwrap()
}

/// The structure, whole.
fn whole(folder: &Path) -> Structure {
    let ([a, b, c, d], ground, mass) = net(&mut ChaCha8Rng::seed_from_u64(11));
    let corner = DMatrix::from_fn(NODES, NODES, |i, j| if i == j && i < 30 { mass[(i, i)] } else { 0.0 });
    let mut groups: Vec<Custom> = [&a, &b, &c, &d]
        .into_iter()
        .enumerate()
        .map(|(at, part)| group(&format!("k{at}"), part, false, folder))
        .collect();
    groups.push(group("m", &corner, true, folder));
    let matrices = ImportedMatrices { stiffness: a + b + c + d + ground, mass, nodes: Vec::new(), coordinates: None };
    Structure::new(Body::Matrices(matrices)).with_customs(groups.into())
}

fn sensors() -> Vec<Sensor> {
    let sensor = |dof: usize| Sensor {
        channel: dof.to_string(),
        point: String::new(),
        node: 0,
        elevation_m: None,
        direction: None,
        offset_m: [0.0; 2],
        reference: false,
        unit: None,
        sensitivity_v_per_m_s2: None,
        dof: Some(dof),
    };
    (0..NODES).step_by(13).map(|row| sensor(row + 1)).collect()
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
    let whole = whole(folder.path());
    let basis = whole.assemble().modal_basis().unwrap();
    let highest_hz = whole.assemble().modes().unwrap().frequency_hz[MEASURED - 1];
    let reduced = whole.reduced(&basis, highest_hz);
    assert!(reduced.dofs() < NODES / 2, "{} of {NODES}", reduced.dofs());
    for (share, of_frequency, of_mac) in [(0.0, 1e-9, 1e-9), (0.3, 1e-5, 1e-5), (1.0, 1e-4, 1e-4)] {
        let (frequency, mac) = errors(&seen(&reduced, share), &seen(&whole, share));
        println!("{share}: {frequency:e}, 1 - MAC {:e}, {} coordinates", 1.0 - mac, reduced.dofs());
        assert!(frequency < of_frequency && 1.0 - mac < of_mac, "{share}: {frequency:e}, 1 - MAC {:e}", 1.0 - mac);
    }
    // As many modes and no corrections are worse by far.
    let modes_alone = whole.clone().with_customs(whole.customs[..0].into()).reduced(&basis, 100.0 * highest_hz);
    let vectors = basis.vectors.columns(0, reduced.dofs()).into_owned();
    assert!(modes_alone.dofs() >= vectors.ncols());
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

#[test]
fn sensors_name_the_rows_of_the_whole_model() {
    let folder = tempfile::tempdir().unwrap();
    let whole = whole(folder.path());
    let basis = whole.assemble().modal_basis().unwrap();
    let reduced = whole.reduced(&basis, 1.0);
    let mut beyond = sensors();
    beyond[0].dof = Some(NODES + 1);
    let error = reduced.assemble().sensor_rows(&beyond).unwrap_err();
    assert_eq!(error, SensorError::NoSuchDof { channel: "1".to_owned(), dof: NODES + 1, dofs: NODES });
}
