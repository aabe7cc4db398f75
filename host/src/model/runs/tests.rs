//! Runs of a program that knows a structure whole: springs and masses, of which Belfry is given modes alone.

use std::fs;
use std::path::PathBuf;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::model::{Body, Custom, Structure, eigenmodes};
use crate::study::{CustomSource, GroupTerms, Sensor};

/// Nodes of a line of springs to its neighbours, the ones after them, and the ground.
const NODES: usize = 60;
/// Modes that the program writes, of which a third is compared.
const MODES: usize = 24;
const COMPARED: usize = 8;

/// K of three parts, each a third of the line, and M.
fn structure() -> ([DMatrix<f64>; 3], DMatrix<f64>) {
    let random = &mut ChaCha8Rng::seed_from_u64(3);
    let mut parts = [0; 3].map(|_| DMatrix::zeros(NODES, NODES));
    for one in 0..NODES {
        let part = &mut parts[3 * one / NODES];
        part[(one, one)] += 2e4 * random.random_range(0.5..2.0);
        for other in [one + 1, one + 2].into_iter().filter(|other| *other < NODES) {
            let spring = 1e6 * random.random_range(0.5..2.0);
            part[(one, one)] += spring;
            part[(other, other)] += spring;
            part[(one, other)] -= spring;
            part[(other, one)] -= spring;
        }
    }
    let mass = DMatrix::from_diagonal(&DVector::from_fn(NODES, |_, _| 100.0 * random.random_range(0.5..2.0)));
    (parts, mass)
}

/// How a file is written: its shapes' factors by mode (as a program that does not normalise by mass), and its order.
struct Writing {
    places: Vec<usize>,
    factor: fn(usize) -> f64,
    reversed: bool,
}

impl Writing {
    fn usual() -> Self {
        Self { places: (0..NODES).step_by(2).collect(), factor: |_| 1.0, reversed: false }
    }
}

fn write(folder: &Path, name: &str, stiffness: &DMatrix<f64>, mass: &DMatrix<f64>, writing: &Writing) -> PathBuf {
    let modes = eigenmodes(stiffness, mass).unwrap();
    let header: Vec<String> = writing.places.iter().map(|place| format!("n{place}")).collect();
    let row = |mode: usize| {
        let shape: Vec<String> = writing
            .places
            .iter()
            .map(|&place| format!("{:.7e}", modes.shapes[(place, mode)] * (writing.factor)(mode)))
            .collect();
        format!("{:.9e},{}", modes.frequency_hz[mode], shape.join(","))
    };
    let mut rows: Vec<String> = (0..MODES).map(row).collect();
    if writing.reversed {
        rows.reverse();
    }
    fs::write(folder.join(name), format!("frequency_hz,{}\n{}\n", header.join(","), rows.join("\n"))).unwrap();
    PathBuf::from(name)
}

fn run(changed: &str, change: f64, is_mass: bool, modes: PathBuf) -> RunSource {
    RunSource { line: 1, changed: changed.to_owned(), change, is_mass, modes }
}

fn group(name: &str) -> CustomSource {
    CustomSource {
        line: 1,
        name: name.to_owned(),
        file: None,
        stiffness: Vec::new(),
        mass: Vec::new(),
        segments: None,
        least: None,
        greatest: None,
        typical: None,
        tied_to: None,
        channels: Vec::new(),
        group: Some(GroupTerms { std: 0.1, span_m: None }),
    }
}

fn sensors(places: &[usize]) -> Vec<Sensor> {
    places.iter().map(|place| Sensor::new(format!("n{place}"), 0)).collect()
}

/// The structure as it is, and its file.
struct Base {
    parts: [DMatrix<f64>; 3],
    whole: DMatrix<f64>,
    mass: DMatrix<f64>,
    file: PathBuf,
}

impl Base {
    fn of(folder: &Path, writing: &Writing) -> Self {
        let (parts, mass) = structure();
        let whole: DMatrix<f64> = parts.iter().sum();
        let file = write(folder, "base.csv", &whole, &mass, writing);
        Self { parts, whole, mass, file }
    }
}

/// The model of modes, of three parts and the mass of the first third.
fn of_runs(folder: &Path, writing: &Writing) -> (Structure, Vec<String>) {
    let Base { parts, whole, mass, file: base } = Base::of(folder, writing);
    let mut runs = Vec::new();
    for (at, part) in parts.iter().enumerate() {
        let name = format!("part{at}");
        runs.push(run(
            &name,
            0.1,
            false,
            write(folder, &format!("{name}.csv"), &(&whole + part * 0.1), &mass, writing),
        ));
        let twice = write(folder, &format!("{name}-20.csv"), &(&whole + part * 0.2), &mass, writing);
        runs.push(run(&name, 0.2, false, twice));
    }
    let heavier = &mass + first_third(&mass) * 0.1;
    runs.push(run("mass0", 0.1, true, write(folder, "mass0.csv", &whole, &heavier, writing)));
    let read = read(&base, &runs, folder).unwrap();
    let customs: Vec<Custom> = read.changes.iter().map(|(name, change)| Custom::of_run(&group(name), change)).collect();
    (Structure::new(Body::Matrices(read.body)).with_customs(customs.into()), read.warnings)
}

fn first_third(mass: &DMatrix<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(NODES, NODES, |row, column| if row < NODES / 3 { mass[(row, column)] } else { 0.0 })
}

/// Frequencies and shapes at the sensors of the structure itself, its parts changed by so much.
fn truth(changes: [f64; 4], places: &[usize]) -> (Vec<f64>, DMatrix<f64>) {
    let (parts, mass) = structure();
    let stiffness = parts.iter().zip(&changes).map(|(part, change)| part * (1.0 + change)).sum::<DMatrix<f64>>();
    let mass = &mass + first_third(&mass) * changes[3];
    let modes = eigenmodes(&stiffness, &mass).unwrap();
    (modes.frequency_hz[..COMPARED].to_vec(), modes.shapes.select_rows(places).columns(0, COMPARED).into_owned())
}

/// Largest errors: of frequencies, and of shapes as 1 - MAC.
fn errors(of_runs: &Structure, changes: [f64; 4], places: &[usize]) -> [f64; 2] {
    let mut changed = of_runs.clone();
    changed.change_groups(&changes);
    let assembly = changed.assemble();
    let modes = assembly.modes().unwrap();
    let shapes = assembly.sensor_rows(&sensors(places)).unwrap() * &modes.shapes;
    let (expected_hz, expected) = truth(changes, places);
    let frequency = modes.frequency_hz.iter().zip(&expected_hz).map(|(a, b)| (a / b - 1.0).abs());
    let mac = |(a, b): (nalgebra::DVectorView<'_, f64>, nalgebra::DVectorView<'_, f64>)| {
        1.0 - a.dot(&b).powi(2) / (a.norm_squared() * b.norm_squared())
    };
    let shape = shapes.column_iter().zip(expected.column_iter()).map(mac);
    [frequency.fold(0.0, f64::max), shape.fold(0.0, f64::max)]
}

/// How far frequencies have moved.
fn moved(changes: [f64; 4]) -> f64 {
    let (before, after) = (truth([0.0; 4], &[0]).0, truth(changes, &[0]).0);
    before.iter().zip(&after).map(|(before, after)| (after / before - 1.0).abs()).fold(0.0, f64::max)
}

/// Modes of single small changes are met, and say what all changes together do, also four times as large: to a fifteenth and to a seventh of
/// what frequencies move by, where 24 modes of a chain that is known whole leave a thirtieth.
#[test]
fn a_model_of_modes_changes_as_the_structure_does() {
    let folder = tempfile::tempdir().unwrap();
    let writing = Writing::usual();
    let (of_runs, warnings) = of_runs(folder.path(), &writing);
    assert!(warnings.is_empty(), "{warnings:?}");
    for changes in [[0.0; 4], [0.1, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.1]] {
        let [frequency, shape] = errors(&of_runs, changes, &writing.places);
        println!("{changes:?}: {frequency:.1e}, {shape:.1e}");
        assert!(frequency < 1e-6 && shape < 1e-5, "{changes:?}: {frequency:e}, {shape:e}");
    }
    for (changes, of_moved, of_shape) in
        [([0.2, -0.1, 0.15, 0.1], 1.0 / 15.0, 1e-3), ([-0.3, 0.4, 0.2, -0.2], 1.0 / 7.0, 5e-3)]
    {
        let ([frequency, shape], moved) = (errors(&of_runs, changes, &writing.places), moved(changes));
        println!("{changes:?}: {frequency:.1e} of {moved:.1e}, {shape:.1e}");
        assert!(frequency < of_moved * moved && shape < of_shape, "{changes:?}: {frequency:e}, {shape:e}");
    }
}

/// Fewer places than modes, and files that have their modes in the opposite order and their shapes upside down.
#[test]
fn few_places_and_another_order_will_do() {
    let folder = tempfile::tempdir().unwrap();
    let places = (0..NODES).step_by(6).collect();
    let writing = Writing { places, factor: |mode| if mode % 3 == 0 { -1.0 } else { 1.0 }, reversed: true };
    let (of_runs, warnings) = of_runs(folder.path(), &writing);
    assert!(warnings.is_empty(), "{warnings:?}");
    let changes = [0.2, -0.1, 0.15, 0.1];
    let [frequency, shape] = errors(&of_runs, changes, &writing.places);
    println!("{frequency:.1e}, {shape:.1e}");
    assert!(frequency < 0.1 * moved(changes) && shape < 1e-3, "{frequency:e}, {shape:e}");
}

/// Shapes of a largest component of 1, as many programs write them, are told; with their modal masses they are as good as others.
#[test]
fn shapes_that_are_not_mass_normalised_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let factor = |mode: usize| 1.0 + mode as f64;
    let (_, warnings) = of_runs(folder.path(), &Writing { factor, ..Writing::usual() });
    let told = warnings.iter().any(|warning| warning.contains("base.csv") && warning.contains("mass-normalised"));
    assert!(told, "{warnings:?}");
    for file in ["base", "part0", "part1", "part2", "part0-20", "part1-20", "part2-20", "mass0"] {
        let path = folder.path().join(format!("{file}.csv"));
        let text = fs::read_to_string(&path).unwrap();
        let mut lines = text.lines();
        let mut with = vec![format!("modal_mass,{}", lines.next().unwrap())];
        with.extend(lines.enumerate().map(|(mode, line)| format!("{},{line}", factor(mode).powi(2))));
        fs::write(&path, with.join("\n")).unwrap();
    }
    let change = run("part0", 0.1, false, "part0.csv".into());
    let read = read(Path::new("base.csv"), &[change], folder.path()).unwrap();
    assert!(read.warnings.is_empty(), "{:?}", read.warnings);
}

/// A run of twice the change that does not do twice as much is told.
#[test]
fn a_change_that_is_not_linear_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let usual = Writing::usual();
    let Base { parts, whole, mass, file: base } = Base::of(folder.path(), &usual);
    let once = write(folder.path(), "once.csv", &(&whole + &parts[1] * 0.1), &mass, &usual);
    // As if a joint opened.
    let twice = write(folder.path(), "twice.csv", &(&whole + &parts[1] * 0.12), &mass, &usual);
    let runs = [run("part1", 0.2, false, twice), run("part1", 0.1, false, once)];
    let warnings = read(&base, &runs, folder.path()).unwrap().warnings;
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    for part in ["twice.csv", "by 0.2 of `part1`", "the run by 0.1"] {
        assert!(warnings[0].contains(part), "no {part} in {warnings:?}");
    }
}

/// No admissible change takes K or M to where it is not positive.
#[test]
fn changes_stay_where_the_structure_has_modes() {
    let folder = tempfile::tempdir().unwrap();
    let (of_runs, _) = of_runs(folder.path(), &Writing::usual());
    for (at, (custom, _)) in of_runs.groups().enumerate() {
        for value in custom.range {
            let mut changes = [0.0; 4];
            changes[at] = value;
            let mut changed = of_runs.clone();
            changed.change_groups(&changes);
            assert!(changed.assemble().modes().is_ok(), "{} by {value}", custom.name);
        }
    }
}

#[test]
fn runs_that_say_nothing_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let usual = Writing::usual();
    let Base { parts, whole, mass, file: base } = Base::of(folder.path(), &usual);
    let refused = |file: &str| read(&base, &[run("a", 0.1, false, file.into())], folder.path()).unwrap_err();
    write(folder.path(), "same.csv", &whole, &mass, &usual);
    assert!(matches!(refused("same.csv"), RunError::NothingChanged { .. }));
    let others = Writing { places: vec![1, 3, 5], ..Writing::usual() };
    write(folder.path(), "elsewhere.csv", &(&whole * 1.01), &mass, &others);
    assert!(matches!(refused("elsewhere.csv"), RunError::NoCommonPlace { .. }));
    // Another structure altogether.
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let chaos = DMatrix::from_fn(NODES, NODES, |_, _| random.random_range(-1.0..1.0));
    let other = &whole + &chaos * chaos.transpose() * 3e5;
    write(folder.path(), "other.csv", &other, &mass, &usual);
    assert!(matches!(refused("other.csv"), RunError::OtherModes { .. }), "{}", refused("other.csv"));
    for (text, expected) in [
        ("", "frequency_hz"),
        ("frequency_hz,n0,n2\n1.0,0.5,\n", "mode 1: no component at n2"),
        ("frequency_hz,n0,n2\n1.0,0.5,0.2i\n", "mode 1, n2: the shape is complex"),
        ("frequency_hz,n0,n2\n0,0.5,0.2\n", "line 2, column `frequency_hz`"),
        ("frequency_hz,n0,n2\n1,0,0\n", "mode 1: every known component"),
        ("frequency_hz,n0,modal_mass\n1,1,-2\n", "line 2, column `modal_mass`"),
        ("frequency_hz,n0,n2\n", "no modes"),
    ] {
        fs::write(folder.path().join("bad.csv"), text).unwrap();
        let error = refused("bad.csv").to_string();
        assert!(error.contains("bad.csv") && error.contains(expected), "{error}");
    }
    assert!(refused("none.csv").to_string().contains("[[model.run]]"));
    // So is a second run of a change, from which only its bend is taken.
    let part = write(folder.path(), "part.csv", &(&whole + &parts[0] * 0.1), &mass, &usual);
    let both = [run("a", 0.1, false, part), run("a", 0.2, false, "elsewhere.csv".into())];
    assert!(matches!(read(&base, &both, folder.path()).unwrap_err(), RunError::NoCommonPlace { .. }));
}

/// Shapes alone may have changed in a file, its frequencies not.
#[test]
fn other_shapes_are_another_model() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = |factor| {
        let Base { file, .. } = Base::of(folder.path(), &Writing { factor, ..Writing::usual() });
        read(&file, &[], folder.path()).unwrap().body.bytes()
    };
    let usual = bytes(|_| 1.0);
    assert_eq!(usual, bytes(|_| 1.0));
    assert_ne!(usual, bytes(|mode| if mode == 3 { 2.0 } else { 1.0 }));
}
