//! Shapes from residues: what each channel has of a mode's pole.
//!
//! A cluster's joint fit, the filters it saw its modes through and the channels' matrices flow in; shapes flow out. The cross
//! spectrum of a channel k with a filtered response is, under forces that are white but otherwise as they please,
//! `C_k = sum over modes s of (a_ks h_s + b_ks h_s*) + smooth`, h_s the pole's half density. Forces on different modes are correlated as
//! a rule, and then b_ks is not a_ks, and modes far away leave something that is smooth. But a_ks is the mode's own motion at
//! the channel, times a factor that all channels share (the half spectrum's residue; Peeters and De Roeck 1999,
//! Guillaume et al. 1998), whatever the forces' correlation. A regression at resonance takes b for a.

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

use super::joint::{JointFit, Seen};
use super::resonance::Resonance;
use super::shape::Shape;

/// What is expected of a_ks - b_ks, and of the motion of other modes that is correlated with this one's, over the size that
/// the levels give: enough for the data to decide wherever they can.
const CORRELATED: f64 = 1.0;
/// The same for modes of the cluster, whose forces the joint fit expects to be correlated by about as much.
const CORRELATED_INSIDE: f64 = 0.4;
/// Lines beyond as many as there are unknowns.
const LEAST_SPARE_LINES: usize = 3;
/// What modes outside leave is smooth: a constant and a slope, and one polynomial more for every so many bandwidths of the
/// cluster's widest mode that its lines span.
const BANDWIDTHS_OF_A_TERM: f64 = 5.0;
/// Polynomials at most, and lines to spare that each one more asks for: where lines are few, it would take what tells the
/// modes apart.
const MOST_TERMS: usize = 8;
const SPARE_LINES_OF_A_TERM: usize = 40;

/// A mode whose pole lies near the lines and that filters stop.
pub(super) struct Beside {
    /// Where it is.
    pub(super) resonance: Resonance,
    /// Its level.
    pub(super) level: f64,
}

/// The motion of all channels with the pole of each of the cluster's modes, so that what its filter (a row of `filters`,
/// modes x channels) makes of it is 1; `None` where there are too few lines to tell it from the rest. `beside` has the nearest
/// first, `noise` is a channel's density beside the modes, and `expected` what the filters should see of everything, line by line.
pub(super) fn residues(
    fit: &JointFit,
    filters: &DMatrix<Complex64>,
    beside: &[Beside],
    noise: f64,
    seen: &Seen,
    expected: &[DMatrix<Complex64>],
    matrices: &[&DMatrix<Complex64>],
) -> Option<Vec<Shape>> {
    let size = fit.resonances.len();
    let lines = seen.frequency_hz.len();
    // Those further away are smooth here.
    let told_apart = lines.checked_sub(2 + LEAST_SPARE_LINES)? / 2;
    let beside = &beside[..beside.len().min(told_apart.saturating_sub(size))];
    let poles: Vec<(Vec<Complex64>, f64)> = (0..size)
        .map(|mode| (pole(&fit.resonances[mode], fit.slopes[mode], seen), fit.levels[mode]))
        .chain(beside.iter().map(|other| (pole(&other.resonance, seen.slope.mean, seen), other.level)))
        .collect();
    let middle_hz = 0.5 * (seen.frequency_hz[0] + seen.frequency_hz[lines - 1]);
    let half_width_hz = (0.5 * (seen.frequency_hz[lines - 1] - seen.frequency_hz[0])).max(f64::MIN_POSITIVE);
    let widest_hz = fit.resonances.iter().map(Resonance::bandwidth_hz).fold(f64::MIN_POSITIVE, f64::max);
    let more = (2.0 * half_width_hz / (BANDWIDTHS_OF_A_TERM * widest_hz)) as usize;
    let spare = lines.checked_sub(2 * poles.len() + LEAST_SPARE_LINES)?;
    if spare < 2 {
        return None;
    }
    let terms = (2 + more).min(MOST_TERMS).min(2 + (spare - 2) / SPARE_LINES_OF_A_TERM);
    let unknowns = 2 * poles.len() + terms;
    // Columns: the sum and the difference of each pole and its conjugate, then the polynomials (Chebyshev's).
    let basis = DMatrix::from_fn(lines, unknowns, |line, column| {
        if let Some((pole, _)) = poles.get(column / 2) {
            let (half, other) = (pole[line], pole[line].conj());
            if column % 2 == 0 { half + other } else { half - other }
        } else {
            let place = ((seen.frequency_hz[line] - middle_hz) / half_width_hz).clamp(-1.0, 1.0);
            Complex64::from(((column - 2 * poles.len()) as f64 * place.acos()).cos())
        }
    });
    let channels = filters.ncols();
    let of_mode = |mode: usize| -> Option<Shape> {
        let row = filters.rows(mode, 1).adjoint();
        // Variance of the cross spectrum with noise on the channel.
        let variance = |line: usize| expected[line][(mode, mode)].re * noise / seen.averages.max(1.0);
        let variance: Vec<f64> = (0..lines).map(variance).collect();
        let weighted = DMatrix::from_fn(unknowns, lines, |column, line| basis[(line, column)].conj() / variance[line]);
        let mut normal = &weighted * &basis;
        for (place, (_, level)) in poles.iter().enumerate() {
            let share = if place < size && place != mode { CORRELATED_INSIDE } else { CORRELATED };
            let typical = share * (fit.levels[mode] * level / channels as f64).sqrt();
            let prior = 1.0 / (typical * typical);
            // The sum of the mode's own pole and its conjugate is what is looked for.
            if place != mode {
                normal[(2 * place, 2 * place)] += Complex64::from(prior);
            }
            normal[(2 * place + 1, 2 * place + 1)] += Complex64::from(prior);
        }
        let mut wanted: DVector<Complex64> = DVector::zeros(unknowns);
        wanted[2 * mode] = Complex64::ONE;
        wanted[2 * mode + 1] = Complex64::ONE;
        // a = wanted . normal⁻¹ weighted C, and the normal matrix is Hermitian.
        let solution = normal.cholesky()?.solve(&wanted);
        let weights = weighted.adjoint() * solution;
        let mut motion = Shape::zeros(channels);
        for (matrix, weight) in matrices.iter().zip(weights.iter()) {
            motion.gemv(weight.conj(), matrix, &row.column(0), Complex64::ONE);
        }
        let own = (filters.rows(mode, 1) * &motion)[0];
        let motion = motion / own;
        motion.iter().all(|value| value.is_finite()).then_some(motion)
    };
    (0..size).map(of_mode).collect()
}

/// A mode's pole over the lines.
fn pole(resonance: &Resonance, slope: f64, seen: &Seen) -> Vec<Complex64> {
    let shape = resonance.line_shape(seen.duration_s);
    seen.frequency_hz.iter().map(|&hz| shape.pole(hz, slope)).collect()
}
