//! The model's side: eigenproblems, comparison and the direct update, on the Canton Tower's table and on a structure of the
//! footbridge's size.
//!
//! `cargo bench -p belfry-benches --bench model`

use std::hint::black_box;
use std::path::Path;
use std::time::Duration;

use belfry_host::compare::{ModelView, Pair, Tolerance, compare};
use belfry_host::model::{BeamTable, Structure};
use belfry_host::modes::{MeasuredMode, MeasuredShape};
use belfry_host::study::{Drawing, Model, ModelSource, Study, template};
use belfry_host::update::{Problem, Weights, solve, updated};
use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::DVector;

/// 189 segments: 945 degrees of freedom, two in five of them massless.
fn long_beam() -> BeamTable {
    let mut text = String::from(
        "z_bottom_m,z_top_m,bending_1_n_m2,bending_2_n_m2,axis_deg,shear_n,torsion_n_m2,mass_top_kg,inertia_x_kg_m2,inertia_y_kg_m2,inertia_z_kg_m2\n",
    );
    for index in 0..189 {
        text += &format!("{index},{},1e9,2e9,10,1e8,2e9,1000,0,0,5000\n", index + 1);
    }
    BeamTable::from_reader(text.as_bytes(), Path::new("long.csv")).expect("the table is sound")
}

fn eigenproblems(criterion: &mut Criterion) {
    let canton = BeamTable::from_reader(template::CANTON_BEAM.as_bytes(), Path::new("beam.csv")).expect("built in");
    for (name, beam) in [("185 DOFs", canton), ("945 DOFs, two fifths massless", long_beam())] {
        let assembly = Structure::new(beam).assemble();
        criterion.bench_function(&format!("all modes of {name}"), |bencher| {
            bencher.iter(|| black_box(&assembly).modes().expect("supported"));
        });
    }
}

fn update(criterion: &mut Criterion) {
    let study = Study::from_text(template::CANTON_STUDY, Path::new("canton")).expect("built in");
    let sensors: Vec<_> = study.sensors().into_iter().take(16).collect();
    let beam = |text: &str| BeamTable::from_reader(text.as_bytes(), Path::new("beam.csv")).expect("built in");
    let structure = Structure::new(beam(template::CANTON_BEAM));
    let assembly = structure.assemble();
    let view = ModelView::of(&assembly, &sensors).expect("sensors stand on the tower");
    let field = Structure::new(beam(template::CANTON_BEAM_FIELD)).assemble();
    let field = ModelView::of(&field, &sensors).expect("sensors stand on the tower");
    let modes = 10;
    let measured: Vec<MeasuredMode> = (0..modes)
        .map(|mode| {
            let values = DVector::from_column_slice(field.shape(mode)).normalize();
            let stds = Some(DVector::from_element(values.len(), 0.005));
            MeasuredMode {
                covariance_factor: None,
                number: mode + 1,
                frequency_hz: field.modes.frequency_hz[mode],
                frequency_std_hz: Some(1e-3 * field.modes.frequency_hz[mode]),
                stated: None,
                damping_ratio: None,
                damping_ratio_std: None,
                shape: Some(MeasuredShape { imaginary: None, sensors: (0..values.len()).collect(), values, stds }),
            }
        })
        .collect();
    let pairs: Vec<Pair> =
        (0..modes).map(|mode| Pair { measured: mode, model: mode, mac: None, subspace_mac: None }).collect();
    let problem = Problem::of(&view, &measured, &pairs, &Weights::default());
    criterion.bench_function("Psi, m = 10, p = 16", |bencher| {
        bencher.iter(|| solve(black_box(&problem)).expect("there are shapes"));
    });
    let solution = solve(&problem).expect("there are shapes");
    let used: Vec<usize> = (0..modes).collect();
    criterion.bench_function("K* and its eigenproblem, n = 185", |bencher| {
        bencher.iter(|| updated(&assembly, &view.modes, &used, &solution.psi, &problem.measured_lambda));
    });
    let model = Model {
        source: ModelSource::Beam("beam.csv".into()),
        background_stiffness: Some(0.03),
        background_mass: Some(0.01),
        correlation_length_m: Some(100.0),
        effects: Vec::new(),
        customs: Vec::new(),
        runs: Vec::new(),
        prior_odds: Vec::new(),
        drawing: Drawing::default(),
    };
    criterion.bench_function("comparison with the model's tolerance, 37 segments", |bencher| {
        bencher.iter(|| {
            let tolerance = Tolerance::of(&structure, &model);
            compare(&view, &measured, &sensors, tolerance.as_ref())
        });
    });
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20).measurement_time(Duration::from_secs(4));
    targets = eigenproblems, update
}
criterion_main!(benches);
