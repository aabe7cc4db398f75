//! Profiles: deviations are those of an independent computation, and truths that scatter otherwise lie within them.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::profile::Quantity;
use super::steps::Setting;
use super::testing::{measured, normal, site, study};
use super::*;
use crate::compare::Tolerance;
use crate::model::{Body, Segment, Stiffness, Structure};
use crate::modes::MeasuredMode;
use crate::progress::UNHEARD;
use crate::study::{Model, Sensor};

/// A shaft of eight segments, 80 m high, and sensors along both axes at four heights.
fn shaft() -> (Structure, Model, Vec<Sensor>) {
    let mut text = "z_bottom_m,z_top_m,bending_1_n_m2,bending_2_n_m2,axis_deg,shear_n,torsion_n_m2,mass_top_kg,inertia_x_kg_m2,inertia_y_kg_m2,inertia_z_kg_m2\n".to_owned();
    for segment in 0..8 {
        let (bottom_m, top_m) = (10 * segment, 10 * (segment + 1));
        text += &format!("{bottom_m},{top_m},4e11,2.5e11,0,6e9,2e11,2e5,2e6,2e6,4e6\n");
    }
    let at = |index: usize| ([20.0, 40.0, 60.0, 80.0][index / 2], [0.0, 90.0][index % 2], [0.0, 0.0]);
    site(&text, [0.04, 0.02, 25.0], (0..8).map(at))
}

fn frequencies(structure: &Structure, count: usize) -> DVector<f64> {
    let modes = structure.assemble().modes().unwrap();
    DVector::from_iterator(count, modes.frequency_hz.iter().take(count).map(|hz| hz.ln()))
}

/// The covariance of segments after eight frequencies were measured, by differences of frequencies and without independent numbers:
/// `Q - Q Gᵀ (G Q Gᵀ + R)⁻¹ G Q`.
#[test]
fn deviations_are_those_of_an_independent_computation() {
    let (structure, model, sensors) = shaft();
    let (count, std) = (8, 2e-3);
    let exact = frequencies(&structure, count);
    let modes: Vec<MeasuredMode> = exact
        .iter()
        .enumerate()
        .map(|(index, ln_hz)| MeasuredMode {
            covariance_factor: None,
            number: index + 1,
            frequency_hz: ln_hz.exp(),
            frequency_std_hz: Some(std * ln_hz.exp()),
            damping_ratio: None,
            damping_ratio_std: None,
            stated: None,
            shape: None,
        })
        .collect();
    let setting = Setting { bare: &structure, model: &model, sensors: &sensors, measured: &modes, tally: &UNHEARD };
    let profile = setting.profiles(&[]).unwrap().as_given;
    let tolerance = Tolerance::of(&structure, &model).unwrap();
    let Body::Beam(beam) = structure.body.clone() else { panic!("a beam was given") };
    let segments = beam.segments().len();
    let step = 1e-3;
    let slope = |change: &dyn Fn(f64) -> Structure| {
        (frequencies(&change(step), count) - frequencies(&change(-step), count)) / (2.0 * step)
    };
    let mut columns = Vec::new();
    for quantity in &tolerance.quantities {
        for segment in 0..segments {
            columns.push(slope(&|change: f64| {
                let mut beam = beam.clone();
                let segment = &mut beam.segments_mut()[segment];
                match quantity {
                    Some(stiffness) => segment.scale(*stiffness, 1.0 + change),
                    None => segment.scale_mass(1.0 + change),
                }
                Structure::new(beam)
            }));
        }
    }
    let by_segments = DMatrix::from_columns(&columns);
    // Where masses are moves frequencies too: one deviation is half of what a table lumps. Off the axis they do so by their square.
    let by_spread = slope(&|change: f64| {
        let mut structure = structure.clone();
        structure.spread_masses(0.5 * change);
        structure
    });
    let mut before = tolerance.covariance;
    // How the foot is held: an eighth of the radius of gyration of more or less length to bend where it is as the table has it, in both directions together.
    let radius_m = {
        let sum = |of: &dyn Fn(&Segment) -> f64| beam.segments().iter().map(of).sum::<f64>();
        (sum(&|segment| segment.inertia_kg_m2[2]) / sum(&|segment| segment.mass_top_kg)).sqrt()
    };
    let base_m = beam.z_base_m();
    let lowest = beam.segments().iter().take_while(|segment| segment.z_top_m - base_m < radius_m).count().max(1);
    let foot = 0.125 * radius_m / (beam.segments()[lowest - 1].z_top_m - base_m);
    let is_bending = |index: usize| {
        matches!(tolerance.quantities[index / segments], Some(Stiffness::Bending1 | Stiffness::Bending2))
    };
    let at_foot = |index: usize| if is_bending(index) && index % segments < lowest { foot } else { 0.0 };
    let at_foot = DVector::from_fn(before.nrows(), |index, _| at_foot(index));
    before += &at_foot * at_foot.transpose();
    let noise = DMatrix::identity(count, count) * std.powi(2) + &by_spread * by_spread.transpose();
    let gain = (&by_segments * &before * by_segments.transpose() + noise).try_inverse().unwrap();
    let after = &before - &before * by_segments.transpose() * gain * &by_segments * &before;
    for (index, quantity) in profile.quantities.iter().enumerate() {
        for (at, segment) in quantity.segments.iter().enumerate() {
            let row = index * segments + at;
            let (expected, prior) = (after[(row, row)].sqrt(), before[(row, row)].sqrt());
            assert!((segment.prior_std / prior - 1.0).abs() < 2e-3, "{:?} {at}", quantity.quantity);
            // Robust weights take a hundredth of the measurement's.
            assert!(
                (segment.std / expected - 1.0).abs() < 0.02,
                "{:?} {at}: {} stated, {expected} computed, {prior} before",
                quantity.quantity,
                segment.std
            );
        }
    }
    let learned = profile.quantities[0].segments[0].learned();
    assert!(learned > 0.3, "eight frequencies say something of the base: {learned}");
}

/// Stiffnesses and masses that scatter as waves over the height, with the deviation that the study states but otherwise correlated.
fn waves(structure: &Structure, model: &Model, random: &mut ChaCha8Rng) -> (Structure, Vec<Vec<f64>>) {
    let Body::Beam(mut beam) = structure.body.clone() else { panic!("a beam was given") };
    let top_m = beam.z_top_m();
    let mut wave = |std: f64| {
        let parts: Vec<[f64; 3]> = (0..4).map(|wave| [0.4 * f64::from(wave), normal(random), normal(random)]).collect();
        move |z_m: f64| -> f64 {
            let of = |[turns, cos, sin]: &[f64; 3]| {
                let angle = std::f64::consts::TAU * turns * z_m / top_m;
                cos * angle.cos() + sin * angle.sin()
            };
            1.0 + std * 0.5 * parts.iter().map(of).sum::<f64>()
        }
    };
    let stiffness = model.background_stiffness.unwrap();
    // One for all stiffnesses, and a smaller one for each.
    let common = wave(0.87 * stiffness);
    let own = [0.5, 0.5, 1.0, 1.0, 1.0].map(|share| wave(share * stiffness));
    let mass = wave(model.background_mass.unwrap());
    let mut factors = vec![Vec::new(); 6];
    for segment in beam.segments_mut() {
        let z_m = 0.5 * (segment.z_bottom_m + segment.z_top_m);
        for (at, stiffness) in Stiffness::ALL.into_iter().enumerate() {
            let factor = common(z_m) * own[at](z_m);
            segment.scale(stiffness, factor);
            factors[at].push(factor);
        }
        segment.scale_mass(mass(z_m));
        factors[5].push(mass(z_m));
    }
    (Structure::new(beam), factors)
}

/// Truths that scatter as waves lie within the deviations as often as they should: 68 % within one, 95 % within two.
#[test]
fn truths_of_another_scatter_lie_within_the_deviations() {
    let (structure, model, sensors) = shaft();
    let (mut all, mut within, mut learned) = (0usize, [0usize; 2], 0.0);
    for seed in 0..24 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let (truth, factors) = waves(&structure, &model, &mut random);
        let modes = measured(&truth, &sensors, 10, &mut random);
        let setting = Setting { bare: &structure, model: &model, sensors: &sensors, measured: &modes, tally: &UNHEARD };
        let profile = setting.profiles(&[]).unwrap().as_given;
        for (quantity, truth) in profile.quantities.iter().zip(&factors) {
            for (segment, truth) in quantity.segments.iter().zip(truth) {
                let off = ((segment.factor - truth) / segment.std).abs();
                all += 1;
                within[0] += usize::from(off < 1.0);
                within[1] += usize::from(off < 2.0);
                if quantity.quantity == Quantity::Bending1 {
                    learned += segment.learned();
                }
            }
        }
    }
    let share = within.map(|count| count as f64 / all as f64);
    eprintln!("{:.1} % within one deviation, {:.1} % within two", 100.0 * share[0], 100.0 * share[1]);
    assert!((0.55..0.85).contains(&share[0]) && share[1] > 0.88, "{share:?} of {all}");
    // Not because nothing is claimed.
    let learned = learned / (24.0 * 8.0);
    assert!(learned > 0.4, "{learned}");
}

/// An effect that stiffness could stand in for bends the profile without it, and leaves it straight within its deviations with it; its
/// value and covariance are those of the fit.
#[test]
fn an_effect_unbends_the_profile() {
    let (structure, model, sensors) = study();
    let hidden = "base-rotation=2e-14".parse().unwrap();
    let truth = structure.clone().and(&[hidden]).unwrap();
    let modes = measured(&truth, &sensors, 12, &mut ChaCha8Rng::seed_from_u64(5));
    let setting = Setting { bare: &structure, model: &model, sensors: &sensors, measured: &modes, tally: &UNHEARD };
    let start = ["base-rotation=1e-14", "added-mass@443.6m=1e4"].map(|word| word.parse().unwrap());
    let profiles = setting.profiles(&start).unwrap();
    let bent = |profile: &Profile| {
        let all = profile.quantities.iter().flat_map(|one| &one.segments);
        all.map(|segment| ((segment.factor - 1.0) / segment.prior_std).abs()).fold(0.0, f64::max)
    };
    let with = profiles.present();
    let (before, after) = (bent(&profiles.as_given), bent(with));
    assert!(after < 1.0 && before > 2.0 * after, "{before} {after}");
    let joint = with.joint.as_ref().unwrap();
    assert_eq!((joint.values.len(), with.effects.len()), (2, 2));
    let rotation = &joint.values[0];
    assert!((rotation.value - 2e-14).abs() < 3.0 * rotation.std, "{rotation:?}");
    for at in 0..2 {
        assert!((joint.covariance[at][at].sqrt() / joint.values[at].std - 1.0).abs() < 1e-9);
        assert!((joint.correlation[at][at] - 1.0).abs() < 1e-9);
    }
    assert_eq!(joint.covariance[0][1], joint.covariance[1][0]);
}
