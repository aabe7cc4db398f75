//! A model that is exported is read back as the same model: its modes, what sensors see of them, and what was left out.

use std::fs;
use std::path::Path;

use ::parquet::record::Field;

use super::model::{MatrixFormat, ModelExport, left_out};
use super::tests::parquet_rows;
use crate::model::effect::Effect;
use crate::model::{Assembly, BeamTable, Modes, Structure, load};
use crate::modes::read;
use crate::study::{Sensor, Study, template};

fn tower() -> (Structure, Vec<Sensor>) {
    let beam = BeamTable::from_reader(template::CANTON_BEAM.as_bytes(), Path::new("beam.csv")).unwrap();
    let study = Study::from_text(template::CANTON_STUDY, Path::new("canton")).unwrap();
    (Structure::new(beam), study.sensors())
}

fn effects(words: &[&str]) -> Vec<Effect> {
    words.iter().map(|word| word.parse().unwrap()).collect()
}

fn exported(folder: &Path, bare: &Structure, structure: &Structure, format: MatrixFormat) -> Vec<String> {
    let (_, sensors) = tower();
    let export = ModelExport { title: "Tower", bare, structure, sensors: &sensors, frame: None };
    export.write(folder, format).unwrap().1
}

/// What a study makes of exported matrices.
fn read_back(folder: &Path, ending: &str) -> Assembly {
    let model = format!(
        "[model]\nmatrices = {{ stiffness = \"stiffness.{ending}\", mass = \"mass.{ending}\", dofs = \"dofs.csv\" }}\n"
    );
    let text = template::CANTON_STUDY;
    let before = text.find("[model]").unwrap();
    let study = Study::from_text(&(text[..before].to_owned() + &model), folder).unwrap();
    load(&study).unwrap().as_given()
}

fn frequency_error(one: &Modes, other: &Modes) -> f64 {
    let pairs = one.frequency_hz.iter().zip(&other.frequency_hz).take(30);
    pairs.map(|(one, other)| (one / other - 1.0).abs()).fold(0.0, f64::max)
}

/// Springs at the base, a joint, masses off the axis, and what scatter of a fitted background does to M: all of it is in the matrices.
#[test]
fn a_model_is_read_back_with_its_modes_and_what_sensors_see() {
    let (bare, sensors) = tower();
    let with =
        effects(&["added-mass@443.6m=2e6", "p-delta=1", "mass-eccentricity=x=0.3,y=-0.2", "outrigger@272m=1e12"]);
    let mut structure = bare.clone().and(&with).unwrap();
    structure.spread_masses(0.4);
    let assembly = structure.assemble();
    let modes = assembly.modes().unwrap();
    let seen = assembly.sensor_rows(&sensors).unwrap() * modes.shapes.columns(0, 12);
    for (format, ending) in [(MatrixFormat::MatrixMarket, "mtx"), (MatrixFormat::Numpy, "npy")] {
        let folder = tempfile::tempdir().unwrap();
        let warnings = exported(folder.path(), &bare, &structure, format);
        assert!(warnings.is_empty(), "{warnings:?}");
        let back = read_back(folder.path(), ending);
        let modes_back = back.modes().unwrap();
        assert!(frequency_error(&modes, &modes_back) < 1e-9);
        // Between nodes the share of shear is recovered from K; with compression it is another by its share of the buckling load.
        let seen_back = back.sensor_rows(&sensors).unwrap() * modes_back.shapes.columns(0, 12);
        let error = (&seen - &seen_back).amax() / seen.amax();
        assert!(error < 2e-3, "{error}");
    }
}

/// The modes in the files are those of the model at the sensors, and Belfry reads them as measured modes.
#[test]
fn modes_are_written_at_sensors_and_at_every_degree_of_freedom() {
    let (bare, sensors) = tower();
    let with = effects(&["added-mass@443.6m=2e6", "sensor-polarity@ch08"]);
    // The channel is turned for the study's sensors only, which name it so.
    let structure = bare.clone().and(&with).unwrap();
    let assembly = structure.assemble();
    let folder = tempfile::tempdir().unwrap();
    exported(folder.path(), &bare, &structure, MatrixFormat::MatrixMarket);
    let modes = assembly.modes().unwrap();
    let perfect = bare.clone().and(&with[..1]).unwrap().assemble();
    let seen = perfect.sensor_rows(&sensors).unwrap() * &modes.shapes;
    for (file, tolerance) in [("model_modes.csv", 1e-9), ("model_modes.uff", 1e-4)] {
        let read = read(&folder.path().join(file), &sensors).unwrap().modes;
        assert_eq!(read.len(), 30);
        for (index, mode) in read.iter().enumerate() {
            assert!((mode.frequency_hz / modes.frequency_hz[index] - 1.0).abs() < tolerance, "{file}");
            let shape = mode.shape.as_ref().unwrap();
            let there = seen.column(index);
            let mac = shape.values.dot(&there).powi(2) / (shape.values.norm_squared() * there.norm_squared());
            assert!(mac > 1.0 - 1e-8, "{file}, mode {}: MAC {mac}", index + 1);
        }
    }
    let text = fs::read_to_string(folder.path().join("model_shapes.csv")).unwrap();
    let last = text.lines().last().unwrap().split(',').collect::<Vec<_>>();
    let dofs = assembly.dofs();
    assert_eq!((last[0], last[2]), (dofs.to_string().as_str(), "rz"));
    assert_eq!(last[4].parse::<f64>().unwrap(), modes.shapes[(dofs - 1, 0)]);
    // The same table, to the last bit.
    let (names, rows) = parquet_rows(&folder.path().join("model_shapes.parquet"));
    let cell = |field: &Field| match field {
        Field::Long(number) => number.to_string(),
        Field::Str(text) => text.clone(),
        Field::Double(number) => number.to_string(),
        _ => String::new(),
    };
    let lines =
        rows.iter().map(|row| row.get_column_iter().map(|(_, field)| cell(field)).collect::<Vec<_>>().join(","));
    let table: Vec<String> = std::iter::once(names.join(",")).chain(lines).collect();
    assert_eq!(table, text.lines().collect::<Vec<_>>());
    assert_eq!(parquet_rows(&folder.path().join("model_modes.parquet")).1.len(), 30 * sensors.len());
}

/// Faults of sensors and forced lines change neither K nor M; everything else does.
#[test]
fn effects_that_are_no_part_of_the_matrices_are_named() {
    let (bare, _) = tower();
    let all = effects(&[
        "base-rotation=8e-15",
        "sensor-polarity@ch08",
        "harmonic@0.83hz",
        "p-delta=1",
        "clock-offset@node4=0.03",
    ]);
    assert_eq!(left_out(&bare, &all).unwrap(), ["sensor-polarity@ch08", "harmonic@0.83hz", "clock-offset@node4"]);
}

/// The motion of a base that gives way is eliminated from the matrices; what is written says so, and where it matters.
#[test]
fn a_base_that_moves_is_told() {
    let (bare, sensors) = tower();
    let structure = bare.clone().and(&effects(&["base-rotation=8e-15"])).unwrap();
    let assembly = structure.assemble();
    let folder = tempfile::tempdir().unwrap();
    let warnings = exported(folder.path(), &bare, &structure, MatrixFormat::MatrixMarket);
    assert!(warnings.len() == 1 && warnings[0].contains("the base moves"), "{warnings:?}");
    let back = read_back(folder.path(), "mtx");
    assert!(frequency_error(&assembly.modes().unwrap(), &back.modes().unwrap()) < 1e-9);
    // Nodes move as they do; so do sensors above the first of them.
    let rows =
        |assembly: &Assembly| assembly.sensor_rows(&sensors).unwrap() * assembly.modes().unwrap().shapes.column(0);
    assert!((rows(&assembly) - rows(&back)).amax() < 2e-3 * rows(&assembly).amax());
}

/// Imported matrices keep the names and places of their nodes; a damper's own degrees of freedom stand at none.
#[test]
fn imported_models_keep_their_nodes() {
    let (bare, _) = tower();
    let folder = tempfile::tempdir().unwrap();
    exported(folder.path(), &bare, &bare, MatrixFormat::MatrixMarket);
    let text = fs::read_to_string(folder.path().join("dofs.csv")).unwrap();
    let again = tempfile::tempdir().unwrap();
    let source = crate::study::MatrixSource {
        file: None,
        stiffness: vec![crate::study::MatrixTerm { name: "stiffness.mtx".into(), factor: 1.0 }],
        mass: vec![crate::study::MatrixTerm { name: "mass.mtx".into(), factor: 1.0 }],
        layout: Some(crate::study::LayoutFile::Dofs("dofs.csv".into())),
    };
    let matrices = crate::model::ImportedMatrices::read(&source, folder.path()).unwrap();
    let imported = Structure::new(crate::model::Body::Matrices(matrices));
    let with = effects(&["tuned-mass-damper@300m=mass=1e5,frequency=0.14,damping_ratio=0.05"]);
    let structure = imported.clone().and(&with).unwrap();
    let warnings = exported(again.path(), &imported, &structure, MatrixFormat::MatrixMarket);
    assert_eq!(fs::read_to_string(again.path().join("dofs.csv")).unwrap(), text);
    assert!(again.path().join("damping.mtx").exists());
    assert!(warnings.iter().any(|warning| warning.contains("dampers")), "{warnings:?}");
}
