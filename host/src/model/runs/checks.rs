//! What runs say of each other: shapes that are not mass-normalised, changes that do not do what stiffness or mass would.

use nalgebra::{DMatrix, DVector};

use super::paired::{Common, Paired};
use super::{Run, RunChange, WELL_INSIDE};
use crate::model::matrices::ImportedMatrices;
use crate::modes::ComputedModes;

/// A change of a frequency is said not to be linear where the run of another size has this share of it otherwise than predicted.
const NOT_LINEAR: f64 = 0.1;
/// Less than this share of a frequency is not worth a word.
const NOT_WORTH: f64 = 1e-3;
/// Shares of modes in each other tell how these are scaled where they are at least this large.
const TELLING: f64 = 3e-3;
/// Shapes that are this far from mass-normalised (as a factor between two modes) are said to be.
const NOT_NORMALISED: f64 = 1.5;

/// Says where shapes are not mass-normalised. With shapes scaled by s, the share of mode j in the changed mode i is to that of i in j as
/// `-s_i² / s_j²` where K was changed, and as `-λ_i s_i² / (λ_j s_j²)` where M was.
pub(super) fn not_normalised<'a>(base: &ComputedModes, runs: impl Iterator<Item = &'a Paired<'a>>) -> Option<String> {
    let lambda = base.lambda();
    let size = lambda.len();
    let (mut normal, mut right) = (DMatrix::zeros(size, size), DVector::zeros(size));
    // At fewer places than modes, shares are a guess.
    for paired in runs.filter(|paired| paired.rows.len() >= size) {
        for (index, one) in paired.modes.iter().enumerate() {
            for other in &paired.modes[..index] {
                let (i, j) = (one.base, other.base);
                let (there, back) = (one.shares[j], other.shares[i]);
                let weight = there.abs().min(back.abs());
                if weight < TELLING || lambda[i].max(lambda[j]) > WELL_INSIDE * lambda.max() {
                    continue;
                }
                let of_mass = if paired.run.is_mass { (lambda[i] / lambda[j]).ln() } else { 0.0 };
                let ratio = ((there / back).abs().ln() - of_mass) / 2.0;
                let weight = weight * weight;
                for (at, sign) in [(i, 1.0), (j, -1.0)] {
                    normal[(at, at)] += weight;
                    right[at] += sign * weight * ratio;
                }
                normal[(i, j)] -= weight;
                normal[(j, i)] -= weight;
            }
        }
    }
    let told: Vec<usize> = (0..size).filter(|&mode| normal[(mode, mode)] > 0.0).collect();
    // All scales together may be anything; what nothing tells stays as it is.
    let ridge = 1e-3 * normal.diagonal().max();
    for mode in 0..size {
        normal[(mode, mode)] += ridge;
    }
    let scales: DVector<f64> = normal.cholesky()?.solve(&right);
    let largest = told.iter().copied().max_by(|&a, &b| scales[a].total_cmp(&scales[b]))?;
    let smallest = told.iter().copied().min_by(|&a, &b| scales[a].total_cmp(&scales[b]))?;
    let factor = (scales[largest] - scales[smallest]).exp();
    (factor > NOT_NORMALISED).then(|| {
        format!(
            "{}: its shapes do not look mass-normalised: by the runs, the mode at {:.4} Hz is scaled {factor:.1} times as large as that at {:.4} Hz; export mass-normalised shapes, or give each mode its `modal_mass`",
            base.file.display(),
            base.frequencies_hz[largest],
            base.frequencies_hz[smallest]
        )
    })
}

/// Says where a run of another size is not what the smallest lets expect.
pub(super) fn not_linear(
    name: &str,
    body: &ImportedMatrices,
    change: &RunChange,
    smallest: &Run,
    run: &Run,
) -> Option<String> {
    let by = run.change;
    if !change.admits(by) {
        return Some(format!(
            "{}: the run by {} of `{name}` says nothing of a change by {by}: stiffness or mass would become negative",
            run.modes.file.display(),
            smallest.change
        ));
    }
    let expected = change.modes(body, by)?;
    let coordinates = body.coordinates.as_ref()?;
    let expected = ComputedModes {
        file: run.modes.file.clone(),
        places: body.places.to_vec(),
        shapes: coordinates.as_ref() * &expected.shapes,
        frequencies_hz: expected.frequency_hz,
    };
    let wrong = |&(at, other): &(usize, usize)| (expected.frequencies_hz[at] / run.modes.frequencies_hz[other]).ln();
    let highest_hz = smallest.modes.frequencies_hz.last()? * WELL_INSIDE.sqrt();
    let mut pairs = Common::of(&expected, &run.modes).pairs(&expected, &run.modes);
    pairs.retain(|&(_, other)| run.modes.frequencies_hz[other] < highest_hz);
    let worst = pairs.iter().copied().max_by(|a, b| wrong(a).abs().total_cmp(&wrong(b).abs()))?;
    let moved = |&(_, other): &(usize, usize)| {
        let nearest = |hz: &f64| (run.modes.frequencies_hz[other] / hz).ln().abs();
        smallest.modes.frequencies_hz.iter().map(nearest).fold(f64::INFINITY, f64::min)
    };
    let most = pairs.iter().map(moved).fold(0.0, f64::max);
    (wrong(&worst).abs() > NOT_WORTH.max(NOT_LINEAR * most)).then(|| {
        format!(
            "{}: by {by} of `{name}` a mode has {:.4} Hz, where the run by {} lets expect {:.4} Hz: frequencies do not follow this change as stiffness or mass would make them; take values of this size as estimates",
            run.modes.file.display(),
            run.modes.frequencies_hz[worst.1],
            smallest.change,
            expected.frequencies_hz[worst.0],
        )
    })
}
