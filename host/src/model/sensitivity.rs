//! How frequencies and shapes follow a small change of K and M: exact first derivatives over all eigenvectors.

use nalgebra::{Complex, DMatrix, DVector};

use super::eigen::ModalBasis;

/// A small change of a structure, per unit of what changes it.
#[derive(Debug, Clone)]
pub struct Change {
    /// The matrix rows that change, ascending.
    rows: Vec<usize>,
    /// Change of K there, rows x rows.
    stiffness: DMatrix<f64>,
    /// Change of M there.
    mass: DMatrix<f64>,
    /// Change of C there, where dashpots change.
    damping: Option<DMatrix<f64>>,
}

/// Derivatives of one mode by one change.
#[derive(Debug, Clone, PartialEq)]
pub struct ModeDerivative {
    /// Of the frequency's logarithm.
    pub ln_frequency: f64,
    /// Of the mass-normalised shape at the sensors, of the sign that [`ModalBasis::modes`] gives it.
    pub shape: DVector<f64>,
    /// Of the damping ratio that dashpots give it.
    pub damping_ratio: f64,
}

/// Two modes whose 1/lambda differ by less than this share count as one: their shapes turn without bound.
const DEGENERATE: f64 = 1e-9;

impl Change {
    /// Of the rows from `first_row` on, of K or of M.
    pub(super) fn local(first_row: usize, part: DMatrix<f64>, of_stiffness: bool) -> Self {
        let none = DMatrix::zeros(part.nrows(), part.ncols());
        let rows = (first_row..first_row + part.nrows()).collect();
        let (stiffness, mass) = if of_stiffness { (part, none) } else { (none, part) };
        Self { rows, stiffness, mass, damping: None }
    }

    /// From the rows that change, ascending, and the changes of K, M and C there, rows x rows.
    pub(super) fn of_rows(
        rows: Vec<usize>,
        stiffness: DMatrix<f64>,
        mass: DMatrix<f64>,
        damping: Option<DMatrix<f64>>,
    ) -> Self {
        Self { rows, stiffness, mass, damping }
    }

    /// From the whole matrices of the change (all but a few rows of them zero), DOFs x DOFs; of C where dashpots change.
    pub fn of(stiffness: &DMatrix<f64>, mass: &DMatrix<f64>, damping: Option<&DMatrix<f64>>) -> Self {
        let matrices = || [Some(stiffness), Some(mass), damping].into_iter().flatten();
        let changes = |row: usize| matrices().any(|matrix| matrix.column(row).iter().any(|&value| value != 0.0));
        let rows: Vec<usize> = (0..stiffness.nrows()).filter(|&row| changes(row)).collect();
        let part = |whole: &DMatrix<f64>| whole.select_rows(&rows).select_columns(&rows);
        Self { stiffness: part(stiffness), mass: part(mass), damping: damping.map(part), rows }
    }

    /// The rows that change, ascending.
    pub(super) fn rows(&self) -> &[usize] {
        &self.rows
    }

    /// `(s² dM + dK) x`, x at the rows that change.
    pub(super) fn undamped(&self, s: Complex<f64>, x: &DVector<Complex<f64>>) -> DVector<Complex<f64>> {
        let part = |matrix: &DMatrix<f64>| matrix.map(Complex::from) * x;
        part(&self.stiffness) + part(&self.mass) * (s * s)
    }

    /// `dC x`, x at the rows that change; `None` where no dashpot changes.
    pub(super) fn damped(&self, x: &DVector<Complex<f64>>) -> Option<DVector<Complex<f64>>> {
        self.damping.as_ref().map(|damping| damping.map(Complex::from) * x)
    }
}

/// First derivatives of ln f of the modes `modes` (0-based, with mass) by a change: `phiᵀ (dK - lambda dM) phi / (2 lambda)`
/// (Fox and Kapoor 1968, eq. 7).
pub fn frequency_derivatives(basis: &ModalBasis, modes: &[usize], change: &Change) -> Vec<f64> {
    // All modes at once, as below.
    let local = basis.vectors.select_columns(modes).select_rows(&change.rows);
    let (elastic, inertial) = (&change.stiffness * &local, &change.mass * &local);
    let slope = |(at, &mode): (usize, &usize)| {
        let local = local.column(at);
        // phi = x / sqrt(mu) and lambda = 1 / mu.
        0.5 * (local.dot(&elastic.column(at)) - local.dot(&inertial.column(at)) / basis.inverse_lambda[mode])
    };
    modes.iter().enumerate().map(slope).collect()
}

/// How an undamped mode follows forces at the DOFs: worth making where more than one change of a structure is looked at.
///
/// With K-orthonormal vectors x_j and mu_j = 1/lambda_j, `d lambda = phiᵀ (dK - lambda dM) phi` and
/// `d phi = -sum_(j≠i) x_j x_jᵀ (dK - lambda dM) phi / (1 - lambda mu_j) - phi phiᵀ dM phi / 2`: motions without mass
/// (mu_j = 0) take part, so nothing is truncated (Fox and Kapoor 1968, AIAA Journal 6, eq. 13, in K-orthonormal form).
#[derive(Debug, Clone)]
pub(super) struct UndampedResponse {
    /// 1/lambda.
    mu: f64,
    /// phi = x / sqrt(mu), of the sign that [`ModalBasis::modes`] gives it.
    shape: DVector<f64>,
    /// What the sensors see of it.
    seen: DVector<f64>,
    /// Change of what they see by a force at each DOF, sensors x DOFs: `-sum_(j≠i) s_j x_jᵀ / (1 - lambda mu_j)`.
    by_force: DMatrix<f64>,
}

impl UndampedResponse {
    /// Of the mode `mode` (0-based, with mass). `sensor_vectors` are the basis' vectors at the sensors, sensors x DOFs, `transposed` those at the
    /// DOFs, vectors x DOFs.
    pub(super) fn of(
        basis: &ModalBasis,
        sensor_vectors: &DMatrix<f64>,
        transposed: &DMatrix<f64>,
        mode: usize,
    ) -> Self {
        let mu = basis.inverse_lambda[mode];
        let mut shares = sensor_vectors.clone();
        for (other, mut share) in shares.column_iter_mut().enumerate() {
            let distance = 1.0 - basis.inverse_lambda[other] / mu;
            share *= if other == mode || distance.abs() < DEGENERATE { 0.0 } else { -distance.recip() };
        }
        let length = basis.sign(mode) / mu.sqrt();
        Self {
            mu,
            shape: basis.vectors.column(mode) * length,
            seen: sensor_vectors.column(mode) * length,
            by_force: shares * transposed,
        }
    }

    pub(super) fn derivative(&self, change: &Change) -> ModeDerivative {
        let local = self.shape.select_rows(&change.rows);
        let inertial = &change.mass * &local;
        let mut force = &change.stiffness * &local;
        force.axpy(-1.0 / self.mu, &inertial, 1.0);
        let mut shape = &self.seen * (-0.5 * local.dot(&inertial));
        for (&row, force) in change.rows.iter().zip(force.iter()) {
            shape.axpy(*force, &self.by_force.column(row), 1.0);
        }
        ModeDerivative { ln_frequency: 0.5 * local.dot(&force) * self.mu, shape, damping_ratio: 0.0 }
    }
}
