//! Transforms there and back.

use std::f64::consts::TAU;

use belfry_numerics::{complex_transform, forward_transform, inverse_complex_transform, inverse_transform};
use nalgebra::Complex;

#[test]
fn a_cosine_has_one_line_of_half_its_length_and_comes_back() {
    for length in [8, 30, 256] {
        let wave = |n: usize| 3.0 * (TAU * 2.0 * n as f64 / length as f64).cos();
        let samples: Vec<f64> = (0..length).map(wave).collect();
        let forward = forward_transform(length);
        let mut lines = forward.make_output_vec();
        forward.process(&mut samples.clone(), &mut lines).unwrap();
        for (index, line) in lines.iter().enumerate() {
            let expected = if index == 2 { 1.5 * length as f64 } else { 0.0 };
            assert!((line.re - expected).abs() + line.im.abs() < 1e-11, "line {index} of {length}: {line}");
        }
        let inverse = inverse_transform(length);
        let mut back = inverse.make_output_vec();
        inverse.process(&mut lines, &mut back).unwrap();
        assert!(back.iter().zip(&samples).all(|(back, sample)| (back / length as f64 - sample).abs() < 1e-14));
    }
}

#[test]
fn a_complex_wave_is_one_line_and_comes_back() {
    const LENGTH: usize = 24;
    let samples: Vec<Complex<f64>> =
        (0..LENGTH).map(|n| Complex::from_polar(2.0, TAU * 5.0 * n as f64 / LENGTH as f64)).collect();
    let mut lines = samples.clone();
    complex_transform(LENGTH).process(&mut lines);
    for (index, line) in lines.iter().enumerate() {
        let expected = if index == 5 { 2.0 * LENGTH as f64 } else { 0.0 };
        assert!((line - Complex::from(expected)).norm() < 1e-12, "line {index}: {line}");
    }
    inverse_complex_transform(LENGTH).process(&mut lines);
    assert!(lines.iter().zip(&samples).all(|(back, sample)| (back / LENGTH as f64 - sample).norm() < 1e-14));
}
