//! Other people's data, read where they are: matrices of two published models and a recording of a real building.

use std::path::Path;

use belfry_host::record::mat::read_matrix;
use belfry_host::record::{Block, Recording};
use belfry_host::study::Study;
use belfry_tests::published;

#[test]
#[cfg_attr(not(canton_data), ignore = "needs ../shared/canton")]
fn the_canton_matrices_read_as_published() {
    let path = published("canton").join("system_matrices.mat");
    let (stiffness, mass) = (read_matrix(&path, "kk_global").unwrap(), read_matrix(&path, "mm_global").unwrap());
    for matrix in [&stiffness, &mass] {
        assert_eq!(matrix.shape(), (185, 185));
        // Both come from an energy; what is left of symmetry is the rounding of the published model.
        assert!((matrix - matrix.transpose()).amax() <= 1e-6 * matrix.amax());
    }
    assert!(mass.diagonal().iter().all(|value| *value > 0.0));
}

#[test]
#[cfg_attr(not(footbridge_data), ignore = "needs ../shared/pedestrian-bridge")]
fn the_pedestrian_bridge_reads_compressed() {
    let path = published("pedestrian-bridge").join("ExpModeInfo_FEM.mat");
    let eigenvalues = read_matrix(&path, "lambdaExp").unwrap();
    let published_hz = [4.063, 4.550, 6.823, 8.653, 11.498];
    assert_eq!(eigenvalues.len(), published_hz.len());
    for (eigenvalue, published_hz) in eigenvalues.iter().zip(published_hz) {
        // The frequencies are published with three decimals.
        assert!((eigenvalue.sqrt() / std::f64::consts::TAU - published_hz).abs() < 6e-4, "{eigenvalue}");
    }
    assert_eq!(read_matrix(&path, "psiExp_m").unwrap().shape(), (58, 5));
}

#[test]
#[cfg_attr(not(heritage_court_data), ignore = "needs ../shared/heritage-court")]
fn the_heritage_court_recording_reads_as_published() {
    let study = Study::load(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../studies/heritage-court"))).unwrap();
    let setup = &study.setups[0];
    let mut recording = Recording::open(setup, &study.folder).unwrap();
    let (mut block, mut rows) = (Block::new(), Vec::new());
    while recording.next_block(&mut block).unwrap() {
        rows.extend(block.rows().map(<[f64]>::to_vec));
    }
    assert_eq!(rows.len(), 13_108);
    // The study names the file's last two columns, the references, first.
    let column = |name: &str| setup.sensors.iter().position(|sensor| sensor.channel == name).unwrap();
    assert_eq!([rows[0][column("1")], rows[0][column("2")]], [-8.1722275e-2, 1.9509477e-1]);
    let report = recording.finish();
    assert_eq!(report.warnings, []);
    assert!(report.channels.iter().all(|channel| channel.missing == 0 && channel.rms > 0.0));
}
