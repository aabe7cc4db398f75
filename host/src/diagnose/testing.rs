//! What tests of the diagnosis share: the tower of the template, and its modes as they might be measured.

use std::path::Path;

use nalgebra::DVector;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::compare::ModelView;
use crate::model::{BeamTable, Structure};
use crate::modes::{MeasuredMode, MeasuredShape};
use crate::study::{Direction, Model, Sensor, Study, template};

pub(crate) fn study() -> (Structure, Model, Vec<Sensor>) {
    let beam = BeamTable::from_reader(template::CANTON_BEAM.as_bytes(), Path::new("beam.csv")).unwrap();
    let study = Study::from_text(template::CANTON_STUDY, Path::new("canton")).unwrap();
    (Structure::new(beam), study.model.clone().unwrap(), study.sensors())
}

/// A beam table with its tolerance (stiffness, mass, correlation length in m) and sensors: heights, azimuths in degrees and offsets in m.
pub(super) fn site(
    table: &str,
    [stiffness, mass, length_m]: [f64; 3],
    sensors: impl Iterator<Item = (f64, f64, [f64; 2])>,
) -> (Structure, Model, Vec<Sensor>) {
    let beam = BeamTable::from_reader(table.as_bytes(), Path::new("beam.csv")).unwrap();
    let (_, model, of_study) = study();
    let model = Model {
        background_stiffness: Some(stiffness),
        background_mass: Some(mass),
        correlation_length_m: Some(length_m),
        ..model
    };
    let sensor = |(index, (elevation_m, azimuth_deg, offset_m)): (usize, (f64, f64, [f64; 2]))| Sensor {
        channel: format!("s{index}"),
        point: format!("s{index}"),
        elevation_m: Some(elevation_m),
        direction: Some(Direction::AzimuthDeg(azimuth_deg)),
        offset_m,
        ..of_study[0].clone()
    };
    (Structure::new(beam), model, sensors.enumerate().map(sensor).collect())
}

pub(super) fn normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}

/// The first modes of a structure with effects, measured with relative deviations of 0.05 % on frequencies and 0.3 % of
/// the length on shapes.
pub(crate) fn measured(
    structure: &Structure,
    sensors: &[Sensor],
    modes: usize,
    random: &mut ChaCha8Rng,
) -> Vec<MeasuredMode> {
    let view = ModelView::of(&structure.assemble(), sensors).unwrap();
    let one = |mode: usize| {
        let shape = DVector::from_column_slice(view.shape(mode)).normalize();
        let imaginary = view.imaginary(mode).map_or_else(
            || DVector::zeros(shape.len()),
            |imaginary| imaginary / DVector::from_column_slice(view.shape(mode)).norm(),
        );
        let frequency_hz = view.modes.frequency_hz[mode];
        MeasuredMode {
            covariance_factor: None,
            number: mode + 1,
            frequency_hz: frequency_hz * (1.0 + 5e-4 * normal(random)),
            frequency_std_hz: Some(5e-4 * frequency_hz),
            stated: None,
            damping_ratio: Some(0.01 + view.damping_ratio(mode)),
            damping_ratio_std: None,
            shape: Some(MeasuredShape {
                sensors: (0..shape.len()).collect(),
                imaginary: Some(imaginary.map(|value| value + 3e-3 * normal(random))),
                stds: Some(DVector::from_element(shape.len(), 3e-3)),
                values: shape.map(|value| value + 3e-3 * normal(random)),
            }),
        }
    };
    (0..modes).map(one).collect()
}

/// A tower whose segments scatter, in units of what the study allows.
pub(crate) fn scattered(structure: &Structure, model: &Model, scatter: f64, seed: u64) -> Structure {
    let crate::model::Body::Beam(beam) = structure.body.clone() else { panic!("a beam was given") };
    Structure::new(crate::simulate::scattered(beam, model, scatter, seed))
}
