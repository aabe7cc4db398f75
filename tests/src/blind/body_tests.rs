//! The simulated structures against closed forms and against their own coarse tables.

use super::*;
use crate::blind::structures::NAMES;

/// A uniform slender cantilever of 100 m in 30 segments.
fn uniform() -> Structure {
    let row = |at: usize| Segment {
        z_bottom_m: 100.0 / 30.0 * at as f64,
        z_top_m: 100.0 / 30.0 * (at + 1) as f64,
        bending_n_m2: [1e12, 4e12],
        axis_deg: 30.0,
        shear_n: [1e16; 2],
        torsion_n_m2: 1e12,
        mass_top_kg: if at == 29 { 0.5e5 } else { 1e5 },
        inertia_kg_m2: [1e4, 1e4, 1e6],
    };
    Structure {
        name: "uniform",
        segments: (0..30).map(row).collect(),
        channels: Vec::new(),
        band_hz: [0.1, 5.0],
        sampling_rate_hz: 16.0,
    }
}

#[test]
fn a_uniform_cantilever_has_the_textbook_ratios() {
    let frequencies = Body::fine(&uniform()).modes(8).expect("stable").frequencies_hz;
    // Axis 2 is twice as fast: its modes are every second one but for the order.
    let first = 1.875_104_f64.powi(2) / std::f64::consts::TAU * (1e12_f64 / 3e4).sqrt() / 1e4;
    let near = |ratio: f64| frequencies.iter().map(|f| (f / (first * ratio) - 1.0).abs()).fold(1.0, f64::min);
    for ratio in [1.0, 2.0, 6.267, 2.0 * 6.267, 17.55] {
        // Lumping and the small rotary inertia are left.
        assert!(near(ratio) < 4e-3, "{ratio} of {first} Hz among {frequencies:?}");
    }
}

#[test]
fn a_base_spring_and_a_tip_mass_act_as_rayleigh_says() {
    // Lumped at the top of a light beam: 1/w² adds up (Dunkerley is exact for one mass).
    let mut structure = uniform();
    for row in &mut structure.segments {
        row.mass_top_kg = 1.0;
        row.inertia_kg_m2 = [0.1, 0.1, 1.0];
    }
    let mut body = Body::fine(&structure);
    let top = body.nodes.len() - 1;
    body.nodes[top].mass_kg = 2e6;
    let flexibility = 1e-10;
    body.base_flexibility[2] = flexibility;
    body.base_flexibility[3] = flexibility;
    let frequency = body.modes(2).expect("stable").frequencies_hz[0];
    let compliance = 1e6 / (3.0 * 1e12) + flexibility * 1e4;
    let expected = (1.0 / (compliance * 2e6)).sqrt() / std::f64::consts::TAU;
    assert!((frequency / expected - 1.0).abs() < 1e-4, "{frequency} Hz, not {expected} Hz");
}

#[test]
fn nominal_truth_is_the_coarse_table_model() {
    for name in NAMES {
        let structure = Structure::named(name).expect("the reference data are there");
        let (fine, coarse) = (Body::fine(&structure), Body::coarse(&structure));
        let [a, b] = [&fine, &coarse].map(|body| body.modes(20).expect("stable"));
        let in_band = |f: &f64| *f < structure.band_hz[1];
        let count = a.frequencies_hz.iter().filter(|f| in_band(f)).count();
        assert!(count >= 7, "{name} has {count} modes in its band");
        for (f, g) in a.frequencies_hz.iter().zip(&b.frequencies_hz).take(count) {
            assert!((f / g - 1.0).abs() < 5e-3, "{name}: {f} Hz finely, {g} Hz coarsely");
        }
        let [fine_mass, coarse_mass] =
            [&fine, &coarse].map(|b| (b.total_mass_kg(), b.nodes.iter().map(|n| n.mass_kg * n.z_m).sum::<f64>()));
        assert!((fine_mass.0 / coarse_mass.0 - 1.0).abs() < 1e-12 && (fine_mass.1 / coarse_mass.1 - 1.0).abs() < 1e-12);
    }
}

#[test]
fn weight_lowers_the_first_frequency_until_it_buckles() {
    // Greenhill: a column buckles under its own weight q L at q L³/EI = 7.837.
    let structure = uniform();
    let mut body = Body::fine(&structure);
    let own = GRAVITY_M_S2 * 3e4 * 1e6 / 1e12;
    body.weight = 0.97 * 7.837 / own;
    assert!(body.modes(1).is_some());
    body.weight = 1.04 * 7.837 / own;
    assert!(body.modes(1).is_none());
}

#[test]
fn an_offset_sensor_sees_torsion() {
    let body = Body::fine(&uniform());
    let row = body.motion_row(50.0, 90.0, [2.0, 0.0]);
    let turning: f64 = row.iter().filter(|(dof, _)| dof % DOFS == 4).map(|(_, value)| value).sum();
    let moving: f64 = row.iter().filter(|(dof, _)| dof % DOFS == 1).map(|(_, value)| value).sum();
    assert!((turning - 2.0).abs() < 1e-12 && (moving - 1.0).abs() < 1e-9);
}
