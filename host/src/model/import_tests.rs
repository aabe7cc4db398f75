//! Models from matrices: what is read, where sensors stand in it, and what is refused.

use std::fs;
use std::io::Write;
use std::path::Path;

use nalgebra::DMatrix;
use npyz::WriterBuilder;

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::tests::{Uniform, near};
use super::*;
use crate::study::{Direction, LayoutFile, MatrixSource, MatrixTerm, Sensor};

fn term(name: &str, factor: f64) -> MatrixTerm {
    MatrixTerm { name: name.to_owned(), factor }
}

fn files(stiffness: &str, mass: &str, layout: Option<LayoutFile>) -> MatrixSource {
    MatrixSource { file: None, stiffness: vec![term(stiffness, 1.0)], mass: vec![term(mass, 1.0)], layout }
}

fn sensor(elevation_m: f64, azimuth_deg: f64, offset_m: [f64; 2]) -> Sensor {
    let direction = Some(Direction::AzimuthDeg(azimuth_deg));
    Sensor { elevation_m: Some(elevation_m), direction, offset_m, ..Sensor::new("07", 1) }
}

/// A beam's matrices as files, with their heights.
fn write_beam(folder: &Path, beam: &BeamTable) -> Assembly {
    let assembly = Structure::new(beam.clone()).assemble();
    fs::write(folder.join("k.mtx"), matrix_market(&assembly.stiffness)).unwrap();
    fs::write(folder.join("m.npy"), npy(&assembly.mass).unwrap()).unwrap();
    let mut nodes = format!("node,z_m,mass_kg\n1,{},\n", beam.z_base_m());
    for (index, z_m) in assembly.node_elevations_m().iter().enumerate() {
        nodes += &format!("{},{z_m},7\n", index + 2);
    }
    fs::write(folder.join("nodes.csv"), nodes).unwrap();
    assembly
}

#[test]
fn a_beams_matrices_from_files_are_the_same_structure_between_its_nodes_too() {
    let folder = tempfile::tempdir().unwrap();
    // Axes turned and soft in shear: the shape functions must be found again in the matrices.
    let beam = Uniform { axis_deg: 30.0, shear: "2e6".to_owned(), segments: 8, ..Uniform::default() }.table();
    let own = write_beam(folder.path(), &beam);
    let source = files("k.mtx", "m.npy", Some(LayoutFile::Nodes("nodes.csv".into())));
    let imported = Structure::new(Body::Matrices(ImportedMatrices::read(&source, folder.path()).unwrap())).assemble();
    assert_eq!(imported.stiffness, own.stiffness);
    assert_eq!(imported.modes().unwrap().frequency_hz, own.modes().unwrap().frequency_hz);
    for z_m in [3.0, 12.5, 40.0, 77.7, 100.0] {
        let place = [sensor(z_m, 50.0, [2.0, -1.0])];
        let (there, expected) = (imported.sensor_rows(&place).unwrap(), own.sensor_rows(&place).unwrap());
        assert!((&there - &expected).amax() < 1e-6, "{z_m} m: {there} instead of {expected}");
    }
    let above = imported.sensor_rows(&[sensor(100.2, 0.0, [0.0; 2])]).unwrap_err().to_string();
    assert!(above.contains("channel 07") && above.contains("100.2") && above.contains("from 0 m to 100 m"), "{above}");
}

#[test]
fn lists_of_matrices_are_summed_with_their_factors() {
    let folder = tempfile::tempdir().unwrap();
    let own = write_beam(folder.path(), &Uniform::default().table());
    let mut source = files("k.mtx", "m.npy", None);
    source.stiffness = vec![term("k.mtx", 3.0), term("k.mtx", 1.0)];
    let imported = ImportedMatrices::read(&source, folder.path()).unwrap();
    assert!((imported.stiffness - &own.stiffness * 4.0).amax() < 1e-12 * own.stiffness.amax());
    // Four times the stiffness, twice the frequency; no layout, so sensors must name rows.
    let imported = Structure::new(Body::Matrices(ImportedMatrices::read(&source, folder.path()).unwrap())).assemble();
    near(imported.modes().unwrap().frequency_hz[0], 2.0 * own.modes().unwrap().frequency_hz[0], 1e-9);
    let unplaced = imported.sensor_rows(&[sensor(50.0, 0.0, [0.0; 2])]).unwrap_err().to_string();
    assert!(unplaced.contains("channel 07") && unplaced.contains("`dof`"), "{unplaced}");
    let by_row = Sensor { dof: Some(6), ..sensor(0.0, 0.0, [0.0; 2]) };
    let rows = imported.sensor_rows(&[by_row]).unwrap();
    assert_eq!((rows[(0, 5)], rows.sum()), (1.0, 1.0));
}

/// A shear building of three floors that only move along X: no rotations, so displacements between floors are straight.
#[test]
fn other_layouts_place_rows_by_node_and_direction() {
    let folder = tempfile::tempdir().unwrap();
    let (k, m) = (2e6, 1e4);
    #[rustfmt::skip]
    let stiffness = DMatrix::from_row_slice(3, 3, &[2.0 * k, -k, 0.0, -k, 2.0 * k, -k, 0.0, -k, k]);
    fs::write(folder.path().join("k.mtx"), matrix_market(&stiffness)).unwrap();
    fs::write(folder.path().join("m.mtx"), matrix_market(&(DMatrix::identity(3, 3) * m))).unwrap();
    let dofs = "row,node,dof,z_m\n,base,ux,0\n1,first,ux,3\n2,second,ux,6\n3,third,ux,9\n";
    fs::write(folder.path().join("dofs.csv"), dofs).unwrap();
    let source = files("k.mtx", "m.mtx", Some(LayoutFile::Dofs("dofs.csv".into())));
    let read = || ImportedMatrices::read(&source, folder.path());
    let building = Structure::new(Body::Matrices(read().unwrap())).assemble();
    // Fixed-free chain: omega_1 = 2 sqrt(k/m) sin(pi/14).
    let expected = 2.0 * (k / m).sqrt() * (std::f64::consts::PI / 14.0).sin() / std::f64::consts::TAU;
    near(building.modes().unwrap().frequency_hz[0], expected, 1e-12);
    let rows = building.sensor_rows(&[sensor(4.5, 180.0, [0.0; 2]), sensor(1.0, 0.0, [0.0; 2])]).unwrap();
    near(rows[(0, 0)], -0.5, 1e-6);
    near(rows[(0, 1)], -0.5, 1e-6);
    near(rows[(1, 0)], 1.0 / 3.0, 1e-6);

    // Nothing is known of motion along Y or Z.
    let across = building.sensor_rows(&[sensor(4.5, 90.0, [0.0; 2])]).unwrap_err().to_string();
    assert!(across.contains("channel 07: points along Y") && across.contains("no uy"), "{across}");
    let up = Sensor { direction: Some(Direction::Up), ..sensor(3.0, 0.0, [0.0; 2]) };
    assert!(building.sensor_rows(&[up]).unwrap_err().to_string().contains("along Z"));

    // In space: two corners of a floor.
    let corners = "row,node,dof,x_m,y_m,z_m\n1,a,ux,0,0,3\n2,a,uy,0,0,3\n3,b,uz,5,0,3\n";
    fs::write(folder.path().join("dofs.csv"), corners).unwrap();
    let frame = Structure::new(Body::Matrices(read().unwrap())).assemble();
    let up = Sensor { direction: Some(Direction::Up), ..sensor(3.0, 0.0, [5.0, 0.0]) };
    let rows = frame.sensor_rows(&[sensor(3.0, 90.0, [0.0; 2]), up]).unwrap();
    near(rows[(0, 1)], 1.0, 1e-12);
    assert_eq!(rows[(1, 2)], 1.0);
    let missing = frame.sensor_rows(&[sensor(3.0, 90.0, [5.0, 0.0])]).unwrap_err().to_string();
    assert!(missing.contains("no motion along Y there"), "{missing}");
    let nowhere = frame.sensor_rows(&[sensor(3.0, 0.0, [2.0, 0.0])]).unwrap_err().to_string();
    assert!(nowhere.contains("no node stands near [2.0, 0.0, 3.0]"), "{nowhere}");
    assert!(nowhere.contains("the nearest is a at [0.0, 0.0, 3.0], 2.00 m away"), "{nowhere}");
    // Within a tenth of the structure's size the nearest node's motion is taken.
    let beside = [sensor(3.0, 0.0, [0.4, 0.0])];
    near(frame.sensor_rows(&beside).unwrap()[(0, 0)], 1.0, 1e-12);
    near(frame.beside_nodes(&beside)[0].distance_m, 0.4, 1e-12);

    for (text, expected) in [
        ("row,node,dof,z_m\n4,a,ux,3\n", "line 2, column `row`: `4` where a row of the matrices, 1 to 3"),
        ("row,node,dof,z_m\n1,a,ux,3\n1,b,ux,4\n", "line 3, column `row`: `1`"),
        ("row,node,dof,z_m\n1,a,sideways,3\n", "line 2, column `dof`: `sideways`"),
        ("row,node,dof,z_m\n1,a,ux,3\n2,a,uy,4\n", "line 3, column `z_m`"),
        ("row,node,dof,z_m\n1,a,ux,high\n", "line 2, column `z_m`: `high`"),
        ("row,node,z_m\n1,a,3\n", "the column `dof` is missing"),
    ] {
        fs::write(folder.path().join("dofs.csv"), text).unwrap();
        let message = read().unwrap_err().to_string();
        assert!(message.contains("dofs.csv") && message.contains(expected), "{message}");
    }
}

#[test]
fn matrices_that_no_structure_has_are_refused_by_file_and_entry() {
    let folder = tempfile::tempdir().unwrap();
    let good = DMatrix::<f64>::from_row_slice(2, 2, &[2.0, -1.0, -1.0, 2.0]);
    fs::write(folder.path().join("m.npy"), npy(&good).unwrap()).unwrap();
    let told = |k: &DMatrix<f64>, expected: &[&str]| {
        fs::write(folder.path().join("k.npy"), npy(k).unwrap()).unwrap();
        let message = ImportedMatrices::read(&files("k.npy", "m.npy", None), folder.path()).unwrap_err().to_string();
        assert!(expected.iter().all(|part| message.contains(part)), "{message}");
    };
    told(
        &DMatrix::from_row_slice(2, 2, &[2.0, -1.0, -1.5, 2.0]),
        &["k.npy", "not symmetric", "row 1, column 2", "-1.5e0"],
    );
    told(
        &DMatrix::from_row_slice(2, 2, &[2.0, f64::NAN, f64::NAN, 2.0]),
        &["k.npy", "not a finite number", "row 2, column 1"],
    );
    told(&DMatrix::from_row_slice(1, 2, &[2.0, 1.0]), &["k.npy", "1 x 2", "square"]);
    told(&DMatrix::from_row_slice(3, 3, &[2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 2.0]), &["m.npy", "2 x 2", "3 x 3"]);
    told(&DMatrix::from_row_slice(2, 2, &[2.0, 0.0, 0.0, 0.0]), &["stiffness", "row 2", "above 0"]);
    let missing = ImportedMatrices::read(&files("none.mtx", "m.npy", None), folder.path()).unwrap_err().to_string();
    assert!(missing.contains("none.mtx"), "{missing}");
    let nameless = ImportedMatrices::read(&files("K", "m.npy", None), folder.path()).unwrap_err().to_string();
    assert!(nameless.contains("`K` is neither"), "{nameless}");
    // Symmetric and with a positive diagonal, but not positive definite: the eigenproblem says so.
    fs::write(folder.path().join("k.npy"), npy(&DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 2.0, 1.0])).unwrap())
        .unwrap();
    let read = ImportedMatrices::read(&files("k.npy", "m.npy", None), folder.path()).unwrap();
    let message = Structure::new(Body::Matrices(read)).assemble().modes().unwrap_err().to_string();
    assert!(message.contains("K is not positive definite"), "{message}");
}

#[test]
fn numpy_matrices_are_read_in_each_order_and_type_and_damaged_ones_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let good = DMatrix::<f64>::from_row_slice(2, 2, &[2.0, -1.0, -1.0, 2.0]);
    fs::write(folder.path().join("m.npy"), npy(&good).unwrap()).unwrap();
    let read = |header: &str, numbers: &[u8]| {
        let length = u16::try_from(header.len()).unwrap().to_le_bytes();
        let bytes = [b"\x93NUMPY\x01\0", &length[..], header.as_bytes(), numbers].concat();
        fs::write(folder.path().join("k.npy"), bytes).unwrap();
        ImportedMatrices::read(&files("k.npy", "m.npy", None), folder.path())
            .map(|read| read.stiffness)
            .map_err(|error| error.to_string())
    };
    let header =
        |descr: &str, shape: &str| format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
    // Not symmetric by less than rounding: which entry is which shows.
    let numbers = [2.0, -1.0, -1.0 + 1e-9, 3.0_f64];
    let expected = DMatrix::from_row_slice(2, 2, &[2.0, -1.0 + 0.5e-9, -1.0 + 0.5e-9, 3.0]);
    assert_eq!(read(&header("<f8", "(2, 2)"), &numbers.map(f64::to_le_bytes).concat()), Ok(expected.clone()));
    assert_eq!(read(&header(">f8", "(2, 2)"), &numbers.map(f64::to_be_bytes).concat()), Ok(expected));
    let whole = DMatrix::from_row_slice(2, 2, &[2.0, -1.0, -1.0, 3.0]);
    assert_eq!(
        read(&header("<f4", "(2, 2)"), &[2.0, -1.0, -1.0, 3.0_f32].map(f32::to_le_bytes).concat()),
        Ok(whole.clone())
    );
    assert_eq!(read(&header("|i1", "(2, 2)"), &[2, 255, 255, 3]), Ok(whole));

    let nested = format!("{{'': (4,), {}  True : True\n", "{".repeat(400));
    for (header, numbers, expected) in [
        (nested.as_str(), 8, "no `descr`"),
        (&header("<f8", "(2, 2)"), 31, "32 bytes of numbers announced, 31 there"),
        (&header("<f8", "(4,)"), 32, "an array of shape [4]; a matrix has two dimensions"),
        (&header("<f8", "(1, 1000000000000)"), 32, "1 x 1000000000000"),
        (&header("<f8", "(1000000000000, 1000000000000)"), 32, "too large"),
        (&header("<c16", "(2, 2)"), 64, "entries are complex"),
        (&header("|b1", "(2, 2)"), 4, "type `|b1`"),
        (&header("<f8", "(0, 0)"), 0, "0 x 0"),
    ] {
        let message = read(header, &vec![0; numbers]).unwrap_err();
        assert!(message.contains("k.npy") && message.contains(expected), "{message}");
    }
}

#[test]
fn effects_that_need_segments_say_that_matrices_have_none() {
    let folder = tempfile::tempdir().unwrap();
    let own = write_beam(folder.path(), &Uniform::default().table());
    let source = files("k.mtx", "m.npy", Some(LayoutFile::Nodes("nodes.csv".into())));
    let body = Body::Matrices(ImportedMatrices::read(&source, folder.path()).unwrap());
    let with = |word: &str| Structure::with_effects(body.clone(), &[word.parse().unwrap()]);
    for (word, reason) in [("stiffness-loss@50m=0.1", "needs a beam table"), ("p-delta=1", "a model of storeys")] {
        let error = with(word).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains(reason), "{error}");
    }
    // A mass needs a height only, and a base what stands on it: they act as on the beam, and sensors at the foot see as much.
    for effect in [
        "added-mass@33m=1000",
        "base-rotation=flexibility_x=1e-8,flexibility_y=3e-8",
        "base-translation=1e-5",
        "base-torsion=1e-8",
    ] {
        let on_matrices = with(effect).map_err(|error| error.to_string()).unwrap().assemble();
        let on_beam =
            Structure::with_effects(Uniform::default().table(), &[effect.parse().unwrap()]).unwrap().assemble();
        let [matrices_hz, beam_hz] = [&on_matrices, &on_beam].map(|assembly| assembly.modes().unwrap().frequency_hz);
        for mode in 0..6 {
            near(matrices_hz[mode], beam_hz[mode], 1e-6);
        }
        assert!((0..6).any(|mode| matrices_hz[mode] < 0.9999 * own.modes().unwrap().frequency_hz[mode]), "{effect}");
        let (at_foot, expected) = (on_matrices.axis_motion(0.0), on_beam.axis_motion(0.0));
        assert!((&at_foot - &expected).amax() <= 1e-6 * expected.amax().max(1e-12), "{effect}");
    }
}

/// Derivatives by a segment's stiffness and by its mass against differences of two solved models.
#[test]
fn modal_derivatives_are_what_two_solutions_differ_by() {
    for rotary_inertia in [0.0, 800.0] {
        let beam = Uniform { axis_deg: 20.0, segments: 10, rotary_inertia, ..Uniform::default() }.table();
        let with = |stiffness: f64, mass: f64| {
            let mut table = beam.clone();
            let segment = &mut table.segments_mut()[3];
            segment.bending_n_m2 = segment.bending_n_m2.map(|bending| bending * stiffness);
            segment.mass_top_kg *= mass;
            Structure::new(table).assemble()
        };
        let given = with(1.0, 1.0);
        let rows = given.sensor_rows(&[sensor(35.0, 10.0, [0.0; 2]), sensor(90.0, 70.0, [1.0, 2.0])]).unwrap();
        let basis = given.modal_basis().unwrap();
        let step = 1e-4;
        for (stiffness, mass) in [(step, 0.0), (0.0, step)] {
            let (above, below) = (with(1.0 + stiffness, 1.0 + mass), with(1.0 - stiffness, 1.0 - mass));
            let half = 1.0 / (2.0 * step);
            let change = Change::of(
                &((&above.stiffness - &below.stiffness) * half),
                &((&above.mass - &below.mass) * half),
                None,
            );
            let found = Responses::of(&basis, None, &rows, &[0, 1, 2, 5]).derivatives(&change);
            let (above, below, middle) = (above.modes().unwrap(), below.modes().unwrap(), basis.modes(usize::MAX));
            for (derivative, mode) in found.iter().zip([0, 1, 2, 5]) {
                let ln = (above.frequency_hz[mode] / below.frequency_hz[mode]).ln() * half;
                // Differences err by the square of the step.
                assert!((derivative.ln_frequency - ln).abs() < 1e-6, "mode {mode}: {} {ln}", derivative.ln_frequency);
                let sign = |shape: nalgebra::DVectorView<'_, f64>, like: nalgebra::DVectorView<'_, f64>| {
                    &rows * shape * shape.dot(&like).signum()
                };
                let like = middle.shapes.column(mode);
                let difference = (sign(above.shapes.column(mode), like) - sign(below.shapes.column(mode), like)) * half;
                let size = (&rows * middle.shapes.column(mode)).amax();
                assert!((&derivative.shape - &difference).amax() < 1e-4 * size, "{} {difference}", derivative.shape);
            }
        }
    }
}

/// The X plane of a beam, and one of the same with vertical motion besides.
#[test]
fn a_model_of_one_plane_keeps_its_shear_and_its_vertical_motion() {
    let folder = tempfile::tempdir().unwrap();
    let beam = Uniform { shear: "2e6".to_owned(), segments: 6, ..Uniform::default() }.table();
    let own = Structure::new(beam).assemble();
    let plane: Vec<usize> = (0..6).flat_map(|node| [5 * node, 5 * node + 3]).collect();
    let part = |whole: &DMatrix<f64>| whole.select_rows(&plane).select_columns(&plane);
    let mut stiffness: DMatrix<f64> = part(&own.stiffness).resize(18, 18, 0.0);
    let mut mass = part(&own.mass).resize(18, 18, 0.0);
    let mut dofs = "row,node,dof,z_m\n,0,ux,0\n,0,ry,0\n,0,uz,0\n".to_owned();
    for (node, z_m) in own.node_elevations_m().into_iter().enumerate() {
        stiffness[(12 + node, 12 + node)] = 1e9;
        mass[(12 + node, 12 + node)] = 1e4;
        for (dof, row) in [("ux", 2 * node), ("ry", 2 * node + 1), ("uz", 12 + node)] {
            dofs += &format!("{},{},{dof},{z_m}\n", row + 1, node + 1);
        }
    }
    fs::write(folder.path().join("k.mtx"), matrix_market(&stiffness)).unwrap();
    fs::write(folder.path().join("m.mtx"), matrix_market(&mass)).unwrap();
    fs::write(folder.path().join("dofs.csv"), &dofs).unwrap();
    let source = files("k.mtx", "m.mtx", Some(LayoutFile::Dofs("dofs.csv".into())));
    let read = || Structure::new(Body::Matrices(ImportedMatrices::read(&source, folder.path()).unwrap())).assemble();
    let imported = read();
    assert!(imported.guessed_spans_m().is_empty());
    for z_m in [5.0, 30.0, 71.0] {
        let place = [sensor(z_m, 0.0, [0.0; 2])];
        let expected = own.sensor_rows(&place).unwrap().select_columns(&plane);
        let there = imported.sensor_rows(&place).unwrap();
        assert!((there.columns(0, 12) - &expected).amax() < 1e-6, "{z_m} m: {there} instead of {expected}");
    }
    // Halfway up the second of six segments, off the axis by 2 m.
    let (low, high) = (own.node_elevations_m()[0], own.node_elevations_m()[1]);
    let up = Sensor { direction: Some(Direction::Up), ..sensor(0.5 * (low + high), 0.0, [2.0, 0.0]) };
    let rows = imported.sensor_rows(&[up]).unwrap();
    near(rows[(0, 12)], 0.5, 1e-12);
    near(rows[(0, 13)], 0.5, 1e-12);
    assert!(rows[(0, 1)] < 0.0, "ry lowers what stands at +X: {rows}");

    // Rotations that turn the other way round are no beam's: said, and interpolated along straight lines.
    for row in (1..12).step_by(2) {
        let mut flipped = stiffness.clone();
        flipped.row_mut(row).neg_mut();
        flipped.column_mut(row).neg_mut();
        stiffness = flipped;
    }
    fs::write(folder.path().join("k.mtx"), matrix_market(&stiffness)).unwrap();
    let left_handed = read();
    assert_eq!(left_handed.guessed_spans_m().len(), 5);
    let rows = left_handed.sensor_rows(&[sensor(0.5 * (low + high), 0.0, [0.0; 2])]).unwrap();
    near(rows[(0, 0)], 0.5, 1e-6);
    near(rows[(0, 2)], 0.5, 1e-6);
}

/// The library takes any digits for a number that fits into memory.
#[test]
fn matrix_market_files_of_impossible_sizes_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let header = "%%MatrixMarket matrix coordinate real general\n% made by hand\n";
    for (body, expected) in [
        ("99999999999999999999 1 1\n1 1 1\n", "line 3: `99999999999999999999`"),
        ("400000 400000 1\n1 1 1\n", "line 3: `400000`"),
        ("0 0 0\n", "line 3: `0`"),
        ("1 1 18446744073709551616\n1 1 1\n", "line 3: `18446744073709551616`"),
        ("1 1 1\n1 18446744073709551616 1\n", "line 4: `18446744073709551616`"),
        ("2 2 1\n3 1 1\n", "not a Matrix Market file"),
        ("2 2 1\n0 1 1\n", "not a Matrix Market file"),
        ("2 2\n1 1 1\n", "not a Matrix Market file"),
        ("", "not a Matrix Market file"),
    ] {
        fs::write(folder.path().join("k.mtx"), format!("{header}{body}")).unwrap();
        let refused = ImportedMatrices::read(&files("k.mtx", "k.mtx", None), folder.path()).unwrap_err().to_string();
        assert!(refused.contains("k.mtx") && refused.contains(expected), "{body}: {refused}");
    }
}

/// A SciPy file of one array each, uncompressed or not.
fn scipy_file(path: &Path, compression: CompressionMethod, arrays: &[(&str, Vec<u8>)]) {
    let mut archive = ZipWriter::new(fs::File::create(path).unwrap());
    for (name, bytes) in arrays {
        let options = SimpleFileOptions::default().compression_method(compression);
        archive.start_file(format!("{name}.npy"), options).unwrap();
        archive.write_all(bytes).unwrap();
    }
    archive.finish().unwrap();
}

fn array<T: npyz::AutoSerialize + Copy>(values: &[T]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let shape = [values.len() as u64];
    let mut writer = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(&mut bytes).begin_nd().unwrap();
    writer.extend(values.iter().copied()).unwrap();
    writer.finish().unwrap();
    bytes
}

/// SciPy's forms, CalculiX' and Abaqus' lines, and Matrix Market are one matrix; what is none is told.
#[test]
fn sparse_matrices_are_read_from_every_programs_files() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let expected = DMatrix::from_row_slice(3, 3, &[2.0, -1.0, 0.0, -1.0, 2.5, 0.0, 0.0, 0.0, 3.0]);
    fs::write(
        at("market.mtx"),
        "%%MatrixMarket matrix coordinate real symmetric\n3 3 4\n1 1 2\n2 1 -1\n2 2 2.5\n3 3 3\n",
    )
    .unwrap();
    fs::write(at("calculix.sti"), "1 1 2.0\n1 2 -1.D0\n2 2 2.5\n3 3 3.0\n").unwrap();
    fs::write(at("abaqus.mtx"), "1, 1, 2.\n2, 1, -1.\n1, 2, -1.\n2, 2, 2.5\n3, 3, 3.\n").unwrap();
    let (data, shape) = (array(&[2.0, -1.0, -1.0, 2.5, 3.0]), array(&[3_i64, 3]));
    let rows = |starts: Vec<u8>| {
        let indices = array(&[0_i32, 1, 0, 1, 2]);
        vec![("data", data.clone()), ("shape", shape.clone()), ("indices", indices), ("indptr", starts)]
    };
    scipy_file(&at("rows.npz"), CompressionMethod::Deflated, &rows(array(&[0_i32, 2, 4, 5])));
    // PyMAPDL hands out one triangle.
    let upper = [
        ("data", array(&[2.0, -1.0, 2.5, 3.0])),
        ("indices", array(&[0_i32, 1, 1, 2])),
        ("indptr", array(&[0_i32, 2, 3, 4])),
    ];
    scipy_file(&at("triangle.npz"), CompressionMethod::Stored, &[&upper[..], &[("shape", shape.clone())]].concat());
    let places = [("row", array(&[0_i64, 0, 1, 1, 2])), ("col", array(&[0_i64, 1, 0, 1, 2]))];
    let coordinates = [[("data", data.clone()), ("shape", shape.clone())], places].concat();
    scipy_file(&at("places.npz"), CompressionMethod::Stored, &coordinates);
    for file in ["market.mtx", "calculix.sti", "abaqus.mtx", "rows.npz", "places.npz", "triangle.npz"] {
        let read = ImportedMatrices::read(&files(file, file, None), folder.path());
        assert_eq!(read.unwrap_or_else(|error| panic!("{file}: {error}")).stiffness, expected, "{file}");
    }
    // A header that has lost a sign is no comment above lines without one.
    let market = fs::read_to_string(at("market.mtx")).unwrap();
    fs::write(at("damaged.mtx"), &market[1..]).unwrap();
    let error =
        ImportedMatrices::read(&files("damaged.mtx", "damaged.mtx", None), folder.path()).unwrap_err().to_string();
    assert!(error.contains("damaged.mtx") && error.contains("begins with %%MatrixMarket"), "{error}");
    // A mass that the last rows do not have.
    fs::write(at("light.mas"), "1 1 1.0\n2 2 1.0\n").unwrap();
    let light = ImportedMatrices::read(&files("calculix.sti", "light.mas", None), folder.path()).unwrap();
    assert_eq!(light.mass.diagonal().as_slice(), [1.0, 1.0, 0.0]);
    scipy_file(&at("outside.npz"), CompressionMethod::Stored, &rows(array(&[0_i32, 2, 4, 9])));
    scipy_file(&at("none.npz"), CompressionMethod::Stored, &[("data", data), ("shape", shape)]);
    fs::write(at("damaged.npz"), "PK, but no archive").unwrap();
    fs::write(at("nodes.mtx"), "1, 1, 1, 1, 2.0\n1, 1, 2\n").unwrap();
    fs::write(at("words.sti"), "1 1 2.0\n1 two 3.0\n").unwrap();
    for (file, expected) in [
        ("outside.npz", "row 3 has no entries 4 to 9"),
        ("none.npz", "scipy.sparse.save_npz"),
        ("damaged.npz", "not a .npz file"),
        ("nodes.mtx", "FORMAT=MATRIX INPUT"),
        ("words.sti", "line 2: `1 two 3.0`"),
    ] {
        let refused = ImportedMatrices::read(&files(file, file, None), folder.path()).unwrap_err().to_string();
        assert!(refused.contains(file) && refused.contains(expected), "{file}: {refused}");
    }
}

/// Of SciPy, NumPy and hdf5storage: a chain of springs with structural damping, and one with gyroscopic terms. Neither is a model of K and M, and
/// each format is refused in the same words.
#[test]
fn complex_and_unsymmetric_matrices_of_other_programs_are_told_alike() {
    let data = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests-data"));
    let refused = |file: Option<&str>, name: &str| {
        let source = MatrixSource { file: file.map(Into::into), ..files(name, name, None) };
        ImportedMatrices::read(&source, data).unwrap_err().to_string()
    };
    let (scipy, matlab73) = (Some("scipy_matrices.mat"), Some("hdf5storage_matrices.mat"));
    let complex = "entries are complex; K and M are real: export them without structural damping and gyroscopic terms";
    for (file, name) in [
        (None, "numpy_complex.npy"),
        (None, "scipy_complex.npz"),
        (None, "scipy_complex.mtx"),
        (scipy, "full"),
        (scipy, "few"),
        (matlab73, "full"),
        (matlab73, "few"),
    ] {
        let message = refused(file, name);
        assert!(message.contains(complex) && message.contains(file.unwrap_or(name)), "{name}: {message}");
    }
    let unsymmetric = "row 1, column 2 (counted from 1) holds -1.5e6, its mirror -5e5; stiffness and mass matrices are symmetric (gyroscopic terms";
    for (file, name) in [
        (None, "numpy_gyroscopic.npy"),
        (None, "scipy_gyroscopic.npz"),
        (None, "scipy_gyroscopic.mtx"),
        (scipy, "gyroscopic"),
        (matlab73, "gyroscopic"),
    ] {
        let message = refused(file, name);
        assert!(message.contains(unsymmetric) && message.contains(file.unwrap_or(name)), "{name}: {message}");
    }
}

/// Tables and matrices whose masses are in tonnes are asked about their units, others are not.
#[test]
fn masses_in_tonnes_are_noticed_of_beams_as_well() {
    let in_units = |mass: f64, turning: f64| {
        let mut beam = Uniform { rotary_inertia: 800.0, ..Uniform::default() }.table();
        for segment in beam.segments_mut() {
            segment.mass_top_kg *= mass;
            segment.inertia_kg_m2 = segment.inertia_kg_m2.map(|inertia| inertia * turning);
        }
        Structure::new(beam).assemble()
    };
    assert_eq!(in_units(1.0, 1.0).looks_like_tonnes(), None);
    // t and t m², t and t mm², and a beam that only sways.
    for turning in [1e-3, 1e3, 0.0] {
        assert!(in_units(1e-3, turning).looks_like_tonnes().is_some(), "{turning}");
    }
}

/// A chain of springs that nothing holds, of few and of many masses: rounding of its entries makes K positive definite or not.
#[test]
fn structures_that_rounding_alone_holds_are_told() {
    for rows in [20, 300] {
        for seed in 0..6 {
            let spring = |at: usize| 1e6 * (1.0 + 0.7 * ((at + 7 * seed) as f64).sin());
            let mut lines = String::new();
            for row in 0..rows {
                let [before, after] = [(row > 0).then(|| spring(row)), (row + 1 < rows).then(|| spring(row + 1))];
                let sum = before.unwrap_or(0.0) + after.unwrap_or(0.0);
                lines += &format!("{0} {0} {sum:.10e}\n", row + 1);
                if let Some(spring) = before {
                    lines += &format!("{} {} {:.10e}\n", row + 1, row, -spring);
                }
            }
            let folder = tempfile::tempdir().unwrap();
            let head = "%%MatrixMarket matrix coordinate real symmetric";
            fs::write(folder.path().join("k.mtx"), format!("{head}\n{rows} {rows} {}\n{lines}", 2 * rows - 1)).unwrap();
            let masses: String = (1..=rows).map(|row| format!("{row} {row} 1000\n")).collect();
            fs::write(folder.path().join("m.mtx"), format!("{head}\n{rows} {rows} {rows}\n{masses}")).unwrap();
            let text = "[structure]\nname = \"Chain\"\n[measured]\nmodes = \"modes.csv\"\n\
                [model.matrices]\nstiffness = \"k.mtx\"\nmass = \"m.mtx\"\n";
            fs::write(folder.path().join("study.toml"), text).unwrap();
            let study = crate::study::Study::load(folder.path()).unwrap();
            let modes = load(&study)
                .map_err(|error| error.to_string())
                .and_then(|model| model.as_given().modes().map_err(|error| error.to_string()));
            let told = modes.unwrap_err();
            assert!(told.contains("can move without strain"), "{rows} rows, {seed}: {told}");
        }
    }
}
