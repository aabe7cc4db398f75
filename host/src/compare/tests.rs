//! Comparison: pairs whatever the order, tests that are honest, misfit where it is.

use std::path::Path;

use nalgebra::{Cholesky, DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::model::effect::Effect;
use crate::model::{BeamTable, Body, Structure, eccentricity_changes};
use crate::modes::MeasuredShape;
use crate::study::{Model, ModelSource, Study, template};

fn tower() -> (BeamTable, Vec<Sensor>) {
    let beam = BeamTable::from_reader(template::CANTON_BEAM.as_bytes(), Path::new("beam.csv")).unwrap();
    let study = Study::from_text(template::CANTON_STUDY, Path::new("canton")).unwrap();
    (beam, study.sensors())
}

fn seen(structure: &Structure, sensors: &[Sensor]) -> ModelView {
    ModelView::of(&structure.assemble(), sensors).unwrap()
}

fn deviates(std: f64, random: &mut ChaCha8Rng) -> f64 {
    let unit: f64 = StandardNormal.sample(random);
    std * unit
}

/// Measured modes with relative deviations of 0.1 % on frequencies and 1 % of the length on shapes.
fn measure(view: &ModelView, modes: impl IntoIterator<Item = usize>, random: &mut ChaCha8Rng) -> Vec<MeasuredMode> {
    let one = |(number, mode): (usize, usize)| {
        let shape = DVector::from_column_slice(view.shape(mode)).normalize();
        let values = shape.map(|value| value + deviates(0.01, random));
        let frequency_hz = view.modes.frequency_hz[mode];
        MeasuredMode {
            covariance_factor: None,
            number: number + 1,
            frequency_hz: frequency_hz * (1.0 + deviates(1e-3, random)),
            frequency_std_hz: Some(1e-3 * frequency_hz),
            stated: None,
            damping_ratio: None,
            damping_ratio_std: None,
            shape: Some(MeasuredShape {
                imaginary: None,
                sensors: (0..values.len()).collect(),
                stds: Some(DVector::from_element(values.len(), 0.01)),
                values,
            }),
        }
    };
    modes.into_iter().enumerate().map(one).collect()
}

#[test]
fn pairs_follow_shapes_where_the_order_of_frequencies_is_wrong() {
    let (beam, sensors) = tower();
    let view = seen(&Structure::new(beam), &sensors);
    let mut random = ChaCha8Rng::seed_from_u64(1);
    // Measured in another order than the model's, and 15 % higher; mode 2 is not measured.
    let mut measured = measure(&view, [3, 0, 2, 5, 4], &mut random);
    let frequencies = [0, 2, 3, 4, 5].map(|mode: usize| view.modes.frequency_hz[mode] * 1.15);
    for (mode, frequency_hz) in
        measured.iter_mut().zip([frequencies[1], frequencies[0], frequencies[2], frequencies[3], frequencies[4]])
    {
        mode.frequency_hz = frequency_hz;
    }
    let pairs = pair(&view, &measured);
    assert_eq!(pairs.iter().map(|pair| pair.model).collect::<Vec<_>>(), [3, 0, 2, 5, 4]);
    let comparison = compare(&view, &measured, &sensors, None);
    assert_eq!(comparison.unpaired.len(), 1);
    assert_eq!((comparison.unpaired[0].side, comparison.unpaired[0].number), (Side::Model, 2));
}

#[test]
fn a_measured_mode_that_the_model_lacks_stays_alone_and_is_named() {
    let (beam, sensors) = tower();
    let view = seen(&Structure::new(beam), &sensors);
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let mut measured = measure(&view, 0..4, &mut random);
    // A local mode: one sensor moves.
    let mut values = DVector::from_element(20, 0.0);
    values[6] = 1.0;
    let shape = MeasuredShape { imaginary: None, sensors: (0..20).collect(), values, stds: None };
    measured.push(MeasuredMode {
        covariance_factor: None,
        number: 5,
        frequency_hz: 0.37,
        frequency_std_hz: None,
        stated: None,
        damping_ratio: None,
        damping_ratio_std: None,
        shape: Some(shape),
    });
    let comparison = compare(&view, &measured, &sensors, None);
    assert_eq!(comparison.pairs.len(), 4);
    let lone = &comparison.unpaired[0];
    assert_eq!((lone.side, lone.number), (Side::Measured, 5));
    assert!(lone.nearest.is_some() && lone.nearest_mac.unwrap() < 0.5);
}

/// Frequencies alone, each stated to be a mode of the model as first given: the pairs hold where an effect brings the model's modes into
/// another order, and where a measured frequency is nearer to another mode.
#[test]
fn stated_pairs_are_followed_through_effects() {
    let (beam, _) = tower();
    let structure = Structure::new(beam);
    let given = structure.assemble();
    let modes = given.modes().unwrap();
    let twists = |assembly: &crate::model::Assembly, modes: &crate::model::Modes, mode: usize| {
        let [x, y, _, torsion] = assembly.energies(modes.shapes.column(mode)).unwrap();
        torsion > x + y
    };
    let torsion = (0..10).find(|&mode| twists(&given, &modes, mode)).unwrap();
    let stated = |model: usize, frequency_hz: f64| format!("{},{frequency_hz},{}\n", model + 1, model + 1);
    // The first mode of torsion measured where the model has the mode below it, which was measured above it.
    let hz = |mode: usize| modes.frequency_hz[mode];
    let rows: String = (0..torsion - 1).map(|mode| stated(mode, hz(mode))).collect();
    let rows = rows + &stated(torsion - 1, hz(torsion)) + &stated(torsion, hz(torsion - 1));
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("modes.csv");
    std::fs::write(&file, format!("mode,frequency_hz,model_mode\n{rows}")).unwrap();
    let mut measured = crate::modes::read(&file, &[]).unwrap();
    measured.find_stated(&given.mass, &modes).unwrap();
    let soft = structure.clone().and(&["base-torsion=3e-12".parse().unwrap()]).unwrap();
    for (structure, moves) in [(structure, false), (soft, true)] {
        let view = seen(&structure, &[]);
        let pairs = pair(&view, &measured.modes);
        assert_eq!(pairs.len(), torsion + 1);
        for pair in &pairs {
            let number = measured.modes[pair.measured].number - 1;
            let is_torsion = twists(&structure.assemble(), &view.modes, pair.model);
            assert_eq!(is_torsion, number == torsion, "mode {number} is paired with {}", pair.model);
            if is_torsion {
                assert_eq!(pair.model < torsion, moves, "the effect must change the order: {}", pair.model);
            } else if !moves {
                assert_eq!(pair.model, number);
            }
        }
        let report = compare(&view, &measured.modes, &[], None);
        assert!(report.pairs.iter().all(|pair| pair.stated));
        assert!(report.warnings.iter().all(|warning| !warning.contains("guess")), "{:?}", report.warnings);
    }
}

#[test]
fn frequencies_alone_pair_by_nearness() {
    let (beam, _) = tower();
    let view = seen(&Structure::new(beam), &[]);
    let measured: Vec<MeasuredMode> = (0..5)
        .map(|mode| MeasuredMode {
            covariance_factor: None,
            number: mode + 1,
            frequency_hz: view.modes.frequency_hz[mode] * 1.02,
            frequency_std_hz: Some(1e-3),
            stated: None,
            damping_ratio: None,
            damping_ratio_std: None,
            shape: None,
        })
        .collect();
    let comparison = compare(&view, &measured, &[], None);
    assert_eq!(comparison.pairs.iter().map(|pair| pair.model).collect::<Vec<_>>(), [1, 2, 3, 4, 5]);
    assert!((comparison.mean_abs_frequency_error_percent.unwrap() - 100.0 * (1.0 - 1.0 / 1.02)).abs() < 1e-9);
    assert_eq!((comparison.mean_mac, comparison.degrees_of_freedom), (None, Some(5)));
}

#[test]
fn close_modes_that_turned_within_their_plane_are_held_to_the_plane() {
    // Nearly the same stiffness both ways: the two first modes point where little decides.
    let (mut beam, sensors) = tower();
    for segment in beam.segments_mut() {
        segment.bending_n_m2[1] = segment.bending_n_m2[0] * 1.03;
        segment.shear_n[1] = segment.shear_n[0];
        segment.axis_deg = 0.0;
    }
    let model = Structure::new(beam.clone());
    for segment in beam.segments_mut() {
        segment.axis_deg = 40.0;
    }
    let view = seen(&model, &sensors);
    let measured = measure(&seen(&Structure::new(beam), &sensors), 0..2, &mut ChaCha8Rng::seed_from_u64(3));
    let comparison = compare(&view, &measured, &sensors, None);
    assert_eq!(comparison.pairs.len(), 2);
    for pair in &comparison.pairs {
        assert!(pair.mac.unwrap() < 0.9, "turned by 40 degrees: {:?}", pair.mac);
        assert!(pair.subspace_mac.unwrap() > 0.99, "{:?}", pair.subspace_mac);
    }
    // Which way the pair stands within its plane is decided by nothing that a model could be blamed for.
    assert_eq!(comparison.degrees_of_freedom, Some(2 * (1 + 18)));
    assert!(comparison.p_value.unwrap() > 1e-3, "{:?}", comparison.p_value);
    // A shape outside the plane is a difference.
    let mut bent = measured.clone();
    let shape = bent[0].shape.as_mut().unwrap();
    shape.values[19] *= 1.5;
    assert!(compare(&view, &bent, &sensors, None).p_value.unwrap() < 1e-6);
}

#[test]
fn chi_squared_of_a_right_model_is_as_large_as_its_degrees_of_freedom() {
    let (beam, sensors) = tower();
    let view = seen(&Structure::new(beam), &sensors);
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let runs = 40;
    let mut sum = 0.0;
    for _ in 0..runs {
        let measured = measure(&view, 0..8, &mut random);
        let test = compare(&view, &measured, &sensors, None);
        assert_eq!(test.degrees_of_freedom, Some(8 * 20));
        assert!(test.p_value.unwrap() > 1e-5);
        sum += test.chi_squared.unwrap();
    }
    // The mean of 40 chi-squared variables of 160 degrees has a deviation of sqrt(2 160 / 40) = 2.8.
    assert!((sum / f64::from(runs) - 160.0).abs() < 12.0, "mean {}", sum / f64::from(runs));
}

/// Towers whose segments scatter as the study allows: rejected without the tolerance, as expected with it.
#[test]
fn the_models_tolerance_explains_what_it_allows() {
    let (beam, sensors) = tower();
    let structure = Structure::new(beam.clone());
    let view = seen(&structure, &sensors);
    let model = Model {
        source: ModelSource::Beam("beam.csv".into()),
        background_stiffness: Some(0.01),
        background_mass: Some(0.005),
        correlation_length_m: Some(100.0),
        effects: Vec::new(),
        customs: Vec::new(),
        runs: Vec::new(),
        prior_odds: Vec::new(),
        drawing: crate::study::Drawing::default(),
    };
    let tolerance = Tolerance::of(&structure, &model).unwrap();
    let segments = beam.segments().len();
    let quantities = tolerance.quantities.len();
    assert_eq!(tolerance.covariance.nrows(), quantities * segments);
    // A Gaussian kernel over many near segments is singular to rounding.
    let jitter = DMatrix::identity(quantities * segments, quantities * segments) * 1e-12;
    let factor = Cholesky::new(&tolerance.covariance + jitter).unwrap().l();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let (mut with, mut without) = (0.0, 0.0);
    let runs = 12;
    for _ in 0..runs {
        let scatter = &factor * DVector::from_fn(quantities * segments, |_, _| deviates(1.0, &mut random));
        let mut other = Structure::new(beam.clone());
        let Body::Beam(table) = &mut other.body else { panic!("a beam was given") };
        for (index, segment) in table.segments_mut().iter_mut().enumerate() {
            for (at, quantity) in tolerance.quantities.iter().enumerate() {
                let factor = 1.0 + scatter[at * segments + index];
                match quantity {
                    Some(stiffness) => segment.scale(*stiffness, factor),
                    None => segment.scale_mass(factor),
                }
            }
        }
        let measured = measure(&seen(&other, &sensors), 0..8, &mut random);
        with += compare(&view, &measured, &sensors, Some(&tolerance)).chi_squared.unwrap();
        without += compare(&view, &measured, &sensors, None).chi_squared.unwrap();
    }
    let (with, without) = (with / f64::from(runs), without / f64::from(runs));
    // Deviation of the mean of 12: 5.2; second-order effects of the scatter add a little.
    assert!((140.0..200.0).contains(&with), "with tolerance {with}");
    assert!(without > 1.5 * 160.0, "without {without}");
}

#[test]
fn misfit_and_comac_point_at_the_sensor_that_is_wrong() {
    let (beam, sensors) = tower();
    let view = seen(&Structure::new(beam), &sensors);
    let mut measured = measure(&view, 0..6, &mut ChaCha8Rng::seed_from_u64(6));
    for mode in &mut measured {
        // Channel 13 stands the wrong way round.
        let shape = mode.shape.as_mut().unwrap();
        shape.values[12] = -shape.values[12];
    }
    let comparison = compare(&view, &measured, &sensors, None);
    let worst = comparison.by_sensor.iter().max_by(|a, b| a.misfit.total_cmp(&b.misfit)).unwrap();
    assert_eq!(worst.channel, "13");
    let level = comparison.by_height.iter().max_by(|a, b| a.misfit.total_cmp(&b.misfit)).unwrap();
    assert!((level.elevation_m - 332.15).abs() < 1e-9);
    assert!(comparison.by_height.windows(2).all(|pair| pair[0].elevation_m < pair[1].elevation_m));
}

#[test]
fn components_that_are_missing_are_left_out_of_mac_and_residual() {
    let (beam, sensors) = tower();
    let view = seen(&Structure::new(beam), &sensors);
    let mut measured = measure(&view, 0..3, &mut ChaCha8Rng::seed_from_u64(7));
    let shape = measured[1].shape.as_mut().unwrap();
    *shape = MeasuredShape {
        imaginary: None,
        sensors: vec![2, 5, 9],
        values: DVector::from_column_slice(&[shape.values[2], shape.values[5], shape.values[9]]),
        stds: None,
    };
    let comparison = compare(&view, &measured, &sensors, None);
    assert_eq!(comparison.degrees_of_freedom, Some(20 + 3 + 20));
    assert!(comparison.pairs[1].mac.unwrap() > 0.98);
    let frequency_only = MeasuredMode { shape: None, ..measured[0].clone() };
    assert_eq!(compare(&view, &[frequency_only], &sensors, None).degrees_of_freedom, Some(1));
    let nothing = compare(&view, &[], &sensors, None);
    assert_eq!((nothing.chi_squared, nothing.warnings.len()), (None, 0));
    assert_eq!(comparison.warnings.len(), 1, "{:?}", comparison.warnings);
    assert!(comparison.warnings[0].starts_with("mode 2: the measurement states no deviation of"));
}

/// Errors of three modes' frequencies and shapes, drawn with a covariance that joins numbers and modes: chi-squared has the mean and
/// the scatter that it should, where weighing each number alone makes it scatter several times as much.
#[test]
fn correlated_errors_are_weighed_by_their_covariance() {
    let (beam, sensors) = tower();
    let view = seen(&Structure::new(beam), &sensors);
    let mut random = ChaCha8Rng::seed_from_u64(8);
    const COLUMNS: usize = 3;
    const OWN: f64 = 0.3;
    const DRAWS: usize = 400;
    let count = view.at_sensors.nrows();
    // Frequencies have relative errors of 0.1 %, components of 1 % of the length; all but 9 % of the variance is in three columns.
    let factors: Vec<DMatrix<f64>> = (0..3)
        .map(|_| {
            let mut factor = DMatrix::from_fn(1 + count, COLUMNS, |_, _| deviates(1.0, &mut random));
            factor.row_iter_mut().for_each(|mut row| row *= (1.0 - OWN * OWN).sqrt() / row.norm());
            factor
        })
        .collect();
    let (mut joint, mut alone) = (Vec::new(), Vec::new());
    let mut freedom = 0;
    for _ in 0..DRAWS {
        let common = DVector::from_fn(COLUMNS, |_, _| deviates(1.0, &mut random));
        let mut measured = measure(&view, 0..3, &mut random);
        for (index, (mode, factor)) in measured.iter_mut().zip(&factors).enumerate() {
            let errors = (factor * &common).map(|error| error + deviates(OWN, &mut random));
            let frequency_hz = view.modes.frequency_hz[index];
            mode.frequency_hz = frequency_hz * (1.0 + 1e-3 * errors[0]);
            let shape = mode.shape.as_mut().unwrap();
            // Half as long and the other way, as a file may have it.
            let exact = DVector::from_column_slice(view.shape(index)).normalize();
            shape.values = (exact + 0.01 * errors.rows(1, count)) * -0.5;
            shape.stds = Some(DVector::from_element(count, 0.005));
            mode.covariance_factor = Some(crate::modes::MeasuredCovarianceFactor {
                group: 1,
                frequency_hz: factor.row(0) * (1e-3 * frequency_hz),
                shape: factor.rows(1, count) * (-0.5 * 0.01),
            });
        }
        let with = compare(&view, &measured, &sensors, None);
        freedom = with.degrees_of_freedom.unwrap();
        joint.push(with.chi_squared.unwrap());
        measured.iter_mut().for_each(|mode| mode.covariance_factor = None);
        alone.push(compare(&view, &measured, &sensors, None).chi_squared.unwrap());
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / DRAWS as f64;
    let variance =
        |values: &[f64]| mean(&values.iter().map(|value| (value - mean(values)).powi(2)).collect::<Vec<_>>());
    let n = freedom as f64;
    assert!((mean(&joint) / n - 1.0).abs() < 0.05, "{} {n}", mean(&joint));
    assert!((0.7..1.4).contains(&(variance(&joint) / (2.0 * n))), "{}", variance(&joint) / (2.0 * n));
    assert!(variance(&alone) > 5.0 * variance(&joint), "{} {}", variance(&alone), variance(&joint));
}

/// One product of what is made once and the change says the same as the derivatives of every mode do, for close modes, sensors that are late
/// and modes that a sensor did not see.
#[test]
fn differences_follow_a_change_as_the_modes_do() {
    let (beam, sensors) = tower();
    let late: Effect = "clock-offset@2=0.1".parse().unwrap();
    let structure = Structure::new(beam).and(&[late.in_study(&sensors).unwrap()]).unwrap();
    let view = seen(&structure, &sensors);
    let mut random = ChaCha8Rng::seed_from_u64(9);
    let mut measured = measure(&view, 0..6, &mut random);
    measured[1] = measured[1].at_sensors(&|sensor| sensor != 3);
    measured[2].shape = None;
    let pairs = pair(&view, &measured);
    let close = |pair: &Pair| if pair.model > 3 { vec![4, 5] } else { vec![pair.model] };
    let residual = Residual::of(&view, &measured, &pairs, &close);
    let models = residual.models();
    let responses = view.responses(&models);
    let following = Following::of(&view, &residual, &responses, &models).unwrap();
    let changes = structure.segment_changes();
    let [eccentric, _] = eccentricity_changes(&structure.assemble());
    let all = changes.iter().flat_map(|change| change.stiffness.iter().chain([&change.mass])).chain([&eccentric]);
    for change in all {
        let of_modes = residual.slope(&models, &view.derivatives(&responses, &models, change));
        let along = following.along(change);
        assert!((&along - &of_modes).amax() <= 1e-9 * of_modes.amax(), "{along} {of_modes}");
    }
}

#[test]
fn a_complement_is_at_right_angles_to_all_that_it_is_the_complement_of() {
    let mut random = ChaCha8Rng::seed_from_u64(10);
    for count in 0..=5 {
        let columns = DMatrix::from_fn(5, count, |_, _| deviates(1.0, &mut random));
        let outside = complement(&columns).unwrap();
        assert_eq!(outside.shape(), (5, 5 - count));
        assert!((outside.tr_mul(&outside) - DMatrix::identity(5 - count, 5 - count)).norm() < 1e-14);
        assert!(outside.tr_mul(&columns).norm() < 1e-14 * columns.norm().max(1.0));
    }
    assert_eq!(complement(&DMatrix::zeros(2, 3)), None);
}

/// From the lowest modes of a structure near one that is known, its modes and their derivatives come out as from all modes.
#[test]
fn the_lowest_modes_near_known_ones_say_what_all_say() {
    let (beam, sensors) = tower();
    let known = seen(&Structure::new(beam.clone()), &sensors);
    let changed: Effect = "stiffness-loss@100m=0.4".parse().unwrap();
    let mut structure = Structure::new(beam).and(&[changed]).unwrap();
    structure.spread_masses(0.3);
    structure.shift_masses([0.1, -0.2]);
    let (whole, assembly) = (seen(&structure, &sensors), structure.assemble());
    let basis = assembly.modal_basis_near(&known.basis, 15, 45).unwrap();
    assert_eq!(basis.vectors.ncols(), 45);
    let lowest = ModelView::of_basis(basis.into(), None, whole.sensor_rows.clone(), None);
    let modes: Vec<usize> = (0..12).collect();
    let [all_responses, responses] = [&whole, &lowest].map(|view| view.responses(&modes));
    let changes = structure.segment_changes();
    for (mode, of_all) in modes.iter().zip(&whole.modes.frequency_hz) {
        assert!((lowest.modes.frequency_hz[*mode] / of_all - 1.0).abs() < 1e-10);
        let (shape, of_all) = (lowest.at_sensors.column(*mode), whole.at_sensors.column(*mode));
        assert!((shape - of_all).norm() < 1e-6 * of_all.norm(), "mode {mode}");
    }
    for change in
        changes.iter().step_by(5).flat_map(|change| [&change.stiffness[0], &change.stiffness[2], &change.mass])
    {
        let of_all = whole.derivatives(&all_responses, &modes, change);
        let largest = of_all.iter().map(|derivative| derivative.shape.norm()).fold(0.0, f64::max);
        for (derivative, of_all) in lowest.derivatives(&responses, &modes, change).iter().zip(&of_all) {
            assert!((derivative.ln_frequency - of_all.ln_frequency).abs() < 1e-6 * of_all.ln_frequency.abs().max(1e-3));
            assert!((&derivative.shape - &of_all.shape).norm() < 1e-4 * largest);
        }
    }
}
