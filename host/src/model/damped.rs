//! Modes of a structure on which dashpots hang: the quadratic eigenproblem `(s² M + s C + K) q = 0`.
//!
//! A [`ModalBasis`] and a damping matrix flow in; poles and complex shapes of the modes that the dashpots move flow out, and
//! how they follow a change of the matrices. Only dashpots that the model knows are in C: a structure's own damping is small
//! and changes neither frequencies nor shapes by what is of interest here.

use std::f64::consts::TAU;

use belfry_numerics::{EigenPairs, dashpot_modes, general_eigen};
use nalgebra::{Complex, DMatrix, DMatrixView, DVector};

use super::eigen::{EigenError, ModalBasis, Modes};
use super::sensitivity::{Change, ModeDerivative, frequency_derivatives};

type Vector = DVector<Complex<f64>>;

/// Modes of a structure with dashpots, those with mass, lowest frequency |s|/(2 pi) first.
#[derive(Debug, Clone, PartialEq)]
pub struct DampedModes {
    /// What each mode is.
    modes: Vec<Mode>,
    /// The undamped modes, from the lowest, that the dashpots mix.
    mixed: usize,
    /// Every pole of the mixed modes in 1/s, conjugates and those that do not turn included.
    poles: Vec<Complex<f64>>,
    /// Their vectors q in mass-normalised undamped modes, mixed x poles.
    vectors: DMatrix<Complex<f64>>,
    /// `qᵀ (2 s + C) q` of each, C in the same modes.
    norms: Vec<Complex<f64>>,
    /// C in undamped modes, mixed x mixed.
    damping: DMatrix<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Mode {
    /// An undamped mode that no dashpot moves.
    Undamped(usize),
    /// Of a pole.
    Damped(usize),
}

/// Modes are mixed up to REACH times the highest frequency at which the dashpots still give FAIR of the largest damping
/// ratio. Above it they hardly couple modes.
const REACH: f64 = 6.0;
/// A fair share of the largest damping ratio.
const FAIR: f64 = 0.1;
/// Poles closer than this share are one: their vectors turn without bound.
const DEGENERATE: f64 = 1e-9;

/// Poles and vectors of `(s² + s C + diag(omega²)) q = 0` by the first-order form `[0 I; -Omega² -C]` (Géradin and Rixen 2015, "Mechanical
/// Vibrations", section 3.3), in units of the highest frequency (at least 1 rad/s).
fn of_first_order(omega: &[f64], damping: &DMatrix<f64>) -> Result<EigenPairs<Complex<f64>>, EigenError> {
    let count = omega.len();
    let unit = omega.iter().copied().fold(1.0, f64::max);
    let mut state = DMatrix::zeros(2 * count, 2 * count);
    for a in 0..count {
        state[(a, count + a)] = 1.0;
        state[(count + a, a)] = -(omega[a] / unit).powi(2);
        for b in 0..count {
            state[(count + a, count + b)] = -damping[(a, b)] / unit;
        }
    }
    let EigenPairs { values, vectors } = general_eigen(&state).ok_or(EigenError::NotConverged { dofs: 2 * count })?;
    let values = values.into_iter().map(|value| value * unit).collect();
    Ok(EigenPairs { values, vectors: vectors.rows(0, count).into_owned() })
}

impl DampedModes {
    /// Of a structure with the undamped modes `basis` and the damping matrix `damping` (N s/m, DOFs x DOFs).
    ///
    /// # Errors
    /// [`EigenError::NotConverged`].
    pub fn of(basis: &ModalBasis, damping: &DMatrix<f64>) -> Result<Self, EigenError> {
        let massive = basis.inverse_lambda.iter().take_while(|&&mu| mu > 0.0).count();
        let omega = |mode: usize| basis.inverse_lambda[mode].sqrt().recip();
        // phi = x / sqrt(mu); zeta = phiᵀ C phi / (2 omega)
        let vectors = basis.vectors.columns(0, massive);
        let along = damping * vectors;
        let ratio = |mode: usize| 0.5 * vectors.column(mode).dot(&along.column(mode)) * omega(mode);
        let largest = (0..massive).map(ratio).fold(0.0, f64::max);
        let highest = (0..massive).rev().find(|&mode| ratio(mode) > FAIR * largest).map_or(0.0, omega);
        let mixed = (0..massive).filter(|&mode| omega(mode) <= REACH * highest).count();
        let damping =
            DMatrix::from_fn(mixed, mixed, |a, b| vectors.column(a).dot(&along.column(b)) * omega(a) * omega(b));
        let omegas: Vec<f64> = (0..mixed).map(omega).collect();
        let EigenPairs { values: poles, vectors } = match dashpot_modes(&omegas, &damping) {
            Some(modes) => modes,
            None => of_first_order(&omegas, &damping)?,
        };
        let damped = Complexes::of(&vectors).after(&damping);
        let norm = |(index, pole): (usize, &Complex<f64>)| {
            let q = vectors.column(index);
            let by_dashpots: Complex<f64> =
                q.iter().enumerate().map(|(row, value)| value * damped.at(row, index)).sum();
            q.dot(&q) * pole * 2.0 + by_dashpots
        };
        let norms = poles.iter().enumerate().map(norm).collect();
        let turning = (0..2 * mixed).filter(|&pole| poles[pole].im > 0.0).map(Mode::Damped);
        let mut modes: Vec<(f64, Mode)> = turning
            .chain((mixed..massive).map(Mode::Undamped))
            .map(|mode| match mode {
                Mode::Damped(pole) => (poles[pole].norm(), mode),
                Mode::Undamped(index) => (omega(index), mode),
            })
            .collect();
        modes.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(Self { modes: modes.into_iter().map(|(_, mode)| mode).collect(), mixed, poles, vectors, norms, damping })
    }

    /// Frequencies |s|/(2 pi), and shapes as far as they are in phase with what `rows` (motions x DOFs) see of them: turned to
    /// the phase at which those are the largest.
    pub fn modes(&self, basis: &ModalBasis, rows: &DMatrix<f64>) -> Modes {
        let undamped = basis.modes(usize::MAX);
        let mut shapes = DMatrix::zeros(undamped.shapes.nrows(), self.modes.len());
        let mut frequency_hz = Vec::with_capacity(self.modes.len());
        for (mut shape, mode) in shapes.column_iter_mut().zip(&self.modes) {
            match *mode {
                Mode::Undamped(index) => {
                    frequency_hz.push(undamped.frequency_hz[index]);
                    shape.copy_from(&undamped.shapes.column(index));
                }
                Mode::Damped(pole) => {
                    frequency_hz.push(self.poles[pole].norm() / TAU);
                    let whole = self.motion(basis, pole);
                    let turn = self.turn(pole, &product(rows.as_view(), &whole), &whole);
                    shape.copy_from(&whole.map(|value| (value * turn).re));
                }
            }
        }
        Modes { frequency_hz, shapes }
    }

    /// Damping ratio of a mode: of the dashpots alone.
    pub fn damping_ratio(&self, mode: usize) -> f64 {
        match self.modes.get(mode) {
            Some(&Mode::Damped(pole)) => -self.poles[pole].re / self.poles[pole].norm(),
            _ => 0.0,
        }
    }

    /// A vector in DOFs.
    fn motion(&self, basis: &ModalBasis, pole: usize) -> Vector {
        let scaled = self.in_basis(basis, &self.vectors.column(pole).into_owned());
        product(basis.vectors.columns(0, self.mixed), &scaled)
    }

    /// From mass-normalised to K-orthonormal vectors of the basis.
    fn in_basis(&self, basis: &ModalBasis, q: &Vector) -> Vector {
        q.map_with_location(|mode, _, value| value / basis.inverse_lambda[mode].sqrt())
    }

    /// The factor that turns a vector of a pole, which is `whole` in DOFs and which rows see as `seen`, to the phase at which
    /// they are the largest, with a positive largest component, and of the length 1 in mass.
    fn turn(&self, pole: usize, seen: &Vector, whole: &Vector) -> Complex<f64> {
        let length = self.vectors.column(pole).norm();
        let turn = Complex::from_polar(1.0 / length, -0.5 * seen.dot(seen).arg());
        let largest = whole
            .iter()
            .map(|value| (value * turn).re)
            .fold(0.0, |most: f64, value| if value.abs() > most.abs() { value } else { most });
        if largest < 0.0 { -turn } else { turn }
    }

    /// As [`frequency_derivatives`]: `d ln|s| = Re(ds/s)`, `ds = -qᵀ dP q / (qᵀ (2 s M + C) q)` with
    /// `dP = s² dM + s dC + dK` (Lancaster 1966, "Lambda-matrices and Vibrating Systems", section 9.8).
    pub fn frequency_derivatives(&self, basis: &ModalBasis, modes: &[usize], change: &Change) -> Vec<f64> {
        let of = |&mode: &usize| match self.modes[mode] {
            Mode::Undamped(index) => frequency_derivatives(basis, &[index], change).first().copied().unwrap_or(0.0),
            Mode::Damped(pole) => {
                let local = self.motion(basis, pole).select_rows(change.rows());
                let s = self.poles[pole];
                let mut force = change.undamped(s, &local);
                if let Some(dashpots) = change.damped(&local) {
                    force += dashpots * s;
                }
                (-local.dot(&force) / self.norms[pole] / s).re
            }
        };
        modes.iter().map(of).collect()
    }

    /// How the mode `mode` follows forces at the DOFs; where no dashpot moves it, which undamped mode it is. `sensor_vectors` are the basis' vectors
    /// at the sensors, which are also the rows to whose phase [`DampedModes::modes`] turned the shapes, `transposed` those at the DOFs.
    pub(super) fn response(
        &self,
        basis: &ModalBasis,
        sensor_vectors: &DMatrix<f64>,
        transposed: &DMatrix<f64>,
        mixing: &Mixing,
        mode: usize,
    ) -> Result<DampedResponse, usize> {
        match self.modes[mode] {
            Mode::Undamped(index) => Err(index),
            Mode::Damped(pole) => Ok(self.response_of(basis, sensor_vectors, transposed, mixing, pole)),
        }
    }

    /// The vectors of all poles at the sensors and at the DOFs.
    pub(super) fn mixing(&self, basis: &ModalBasis, sensor_vectors: &DMatrix<f64>) -> Mixing {
        let scaled = |vectors: DMatrixView<'_, f64>| {
            let mut vectors = vectors.into_owned();
            for (mut vector, mu) in vectors.column_iter_mut().zip(&basis.inverse_lambda) {
                vector /= mu.sqrt();
            }
            vectors
        };
        let vectors = Complexes::of(&self.vectors);
        let at_sensors = vectors.after(&scaled(sensor_vectors.columns(0, self.mixed)));
        let at_dofs = vectors.after(&scaled(basis.vectors.columns(0, self.mixed)));
        Mixing { at_sensors, at_dofs: at_dofs.transpose() }
    }

    /// With the residues of the receptance, `P(s)⁻¹ = sum_m q_m q_mᵀ / ((s - s_m) n_m)`, a vector changes by
    /// `-sum_(m≠k) q_m q_mᵀ dP q_k / ((s_k - s_m) n_m)`, up to its own multiple, and in undamped modes by what their receptance
    /// makes of the force.
    fn response_of(
        &self,
        basis: &ModalBasis,
        sensor_vectors: &DMatrix<f64>,
        transposed: &DMatrix<f64>,
        mixing: &Mixing,
        pole: usize,
    ) -> DampedResponse {
        let s = self.poles[pole];
        let weight = |(other, &norm): (usize, &Complex<f64>)| {
            let distance = s - self.poles[other];
            if distance.norm() > DEGENERATE * s.norm() { -(distance * norm).inv() } else { Complex::ZERO }
        };
        let weights: Vec<Complex<f64>> = self.norms.iter().enumerate().map(weight).collect();
        let by_mixed = mixing.at_sensors.times_columns(&weights).times(&mixing.at_dofs);
        // Dashpots mix no further modes, nor does their change.
        let others = basis.inverse_lambda.len() - self.mixed;
        let weights: Vec<Complex<f64>> =
            basis.inverse_lambda[self.mixed..].iter().map(|&mu| -(s * s * mu + 1.0).inv()).collect();
        let (unmixed, transposed) = (sensor_vectors.columns(self.mixed, others), transposed.rows(self.mixed, others));
        let part = |of: fn(&Complex<f64>) -> f64| {
            let mut unmixed = unmixed.into_owned();
            unmixed.column_iter_mut().zip(&weights).for_each(|(mut column, weight)| column *= of(weight));
            unmixed * transposed
        };
        let by_force =
            Complexes { re: part(|weight| weight.re) + &by_mixed.re, im: part(|weight| weight.im) + &by_mixed.im };
        let own = self.in_basis(basis, &self.vectors.column(pole).into_owned());
        let (seen, whole) = (product(sensor_vectors.columns(0, self.mixed), &own), self.motion(basis, pole));
        let turn = self.turn(pole, &seen, &whole);
        DampedResponse { pole: s, norm: self.norms[pole], whole, seen, turn, by_force, by_mixed }
    }
}

/// The vectors of all poles of [`DampedModes`].
pub(super) struct Mixing {
    /// Sensors x poles.
    at_sensors: Complexes,
    /// Poles x DOFs.
    at_dofs: Complexes,
}

/// How a mode that dashpots move follows forces at the DOFs.
#[derive(Debug, Clone)]
pub(super) struct DampedResponse {
    pole: Complex<f64>,
    /// `qᵀ (2 s + C) q`.
    norm: Complex<f64>,
    /// Its vector in DOFs, and at the sensors.
    whole: Vector,
    seen: Vector,
    /// What turns it to the phase in which its shape is given.
    turn: Complex<f64>,
    /// Change of what the sensors see by a force at each DOF, sensors x DOFs: by all modes, and by those alone that the dashpots mix.
    by_force: Complexes,
    by_mixed: Complexes,
}

impl DampedResponse {
    pub(super) fn derivative(&self, change: &Change) -> ModeDerivative {
        let s = self.pole;
        let local = self.whole.select_rows(change.rows());
        let mut force = change.undamped(s, &local);
        let mut change_seen = Vector::zeros(self.seen.len());
        self.by_force.add_columns(change.rows(), &force, &mut change_seen);
        if let Some(dashpots) = change.damped(&local) {
            let by_dashpots = dashpots * s;
            self.by_mixed.add_columns(change.rows(), &by_dashpots, &mut change_seen);
            force += by_dashpots;
        }
        // The phase at which the sensors see the most turns with them.
        let square = self.seen.dot(&self.seen);
        let turns = if square.norm() > 0.0 { (self.seen.dot(&change_seen) / square).im } else { 0.0 };
        let across = |change: Complex<f64>, seen: Complex<f64>| (change - seen * Complex::new(0.0, turns)) * self.turn;
        let shape = change_seen.zip_map(&self.seen, |change, seen| across(change, seen).re);
        // d ln s = d ln|s| + i d arg s, and the damping ratio is -cos(arg s).
        let ln_pole = -local.dot(&force) / self.norm / s;
        ModeDerivative { ln_frequency: ln_pole.re, shape, damping_ratio: s.arg().sin() * ln_pole.im }
    }
}

/// A complex matrix as two real ones, whose products are several times as fast.
#[derive(Debug, Clone)]
struct Complexes {
    re: DMatrix<f64>,
    im: DMatrix<f64>,
}

impl Complexes {
    fn of(matrix: &DMatrix<Complex<f64>>) -> Self {
        Self { re: matrix.map(|value| value.re), im: matrix.map(|value| value.im) }
    }

    fn at(&self, row: usize, column: usize) -> Complex<f64> {
        Complex::new(self.re[(row, column)], self.im[(row, column)])
    }

    /// A real matrix times this one.
    fn after(&self, matrix: &DMatrix<f64>) -> Self {
        Self { re: matrix * &self.re, im: matrix * &self.im }
    }

    fn transpose(&self) -> Self {
        Self { re: self.re.transpose(), im: self.im.transpose() }
    }

    fn times(&self, other: &Self) -> Self {
        Self { re: &self.re * &other.re - &self.im * &other.im, im: &self.re * &other.im + &self.im * &other.re }
    }

    /// Each column times a number.
    fn times_columns(&self, factors: &[Complex<f64>]) -> Self {
        let (mut re, mut im) = (self.re.clone(), self.im.clone());
        for ((mut re, mut im), factor) in re.column_iter_mut().zip(im.column_iter_mut()).zip(factors) {
            for (re, im) in re.iter_mut().zip(im.iter_mut()) {
                let value = Complex::new(*re, *im) * factor;
                (*re, *im) = (value.re, value.im);
            }
        }
        Self { re, im }
    }

    /// Adds these columns, each times a number.
    fn add_columns(&self, columns: &[usize], factors: &Vector, sum: &mut Vector) {
        for (&column, factor) in columns.iter().zip(factors.iter()) {
            let (re, im) = (self.re.column(column), self.im.column(column));
            for (sum, (re, im)) in sum.iter_mut().zip(re.iter().zip(im.iter())) {
                *sum += Complex::new(*re, *im) * factor;
            }
        }
    }
}

/// A real matrix times a complex vector, as two real products: half the work, and no complex copy of the matrix.
fn product(matrix: DMatrixView<'_, f64>, vector: &Vector) -> Vector {
    let part = |of: fn(&Complex<f64>) -> f64| matrix * DVector::from_iterator(vector.len(), vector.iter().map(of));
    part(|value| value.re).zip_map(&part(|value| value.im), Complex::new)
}

#[cfg(test)]
mod tests;
