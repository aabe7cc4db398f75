//! How frequencies and shapes follow a small change of K and M: exact first derivatives over all eigenvectors.

use nalgebra::{Complex, DMatrix, DVector};

use super::eigen::ModalBasis;

/// A small change of a structure, per unit of what changes it.
#[derive(Debug, Clone)]
pub struct Change {
    /// The matrix rows that change, ascending.
    rows: Vec<usize>,
    /// Change of K there, rows x rows; `None` where it stays.
    stiffness: Option<DMatrix<f64>>,
    /// Change of M there.
    mass: Option<DMatrix<f64>>,
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
        let rows = (first_row..first_row + part.nrows()).collect();
        let (stiffness, mass) = if of_stiffness { (Some(part), None) } else { (None, Some(part)) };
        Self { rows, stiffness, mass, damping: None }
    }

    /// From the rows that change, ascending, and the changes of K, M and C there, rows x rows.
    pub(super) fn of_rows(
        rows: Vec<usize>,
        stiffness: DMatrix<f64>,
        mass: DMatrix<f64>,
        damping: Option<DMatrix<f64>>,
    ) -> Self {
        let [stiffness, mass] = [stiffness, mass].map(unless_zero);
        Self { rows, stiffness, mass, damping }
    }

    /// From the whole matrices of the change (all but a few rows of them zero), DOFs x DOFs; of C where dashpots change.
    pub fn of(stiffness: &DMatrix<f64>, mass: &DMatrix<f64>, damping: Option<&DMatrix<f64>>) -> Self {
        let matrices = || [Some(stiffness), Some(mass), damping].into_iter().flatten();
        let changes = |row: usize| matrices().any(|matrix| matrix.column(row).iter().any(|&value| value != 0.0));
        let rows: Vec<usize> = (0..stiffness.nrows()).filter(|&row| changes(row)).collect();
        let part = |whole: &DMatrix<f64>| whole.select_rows(&rows).select_columns(&rows);
        let [stiffness, mass] = [stiffness, mass].map(|whole| unless_zero(part(whole)));
        Self { stiffness, mass, damping: damping.map(part), rows }
    }

    /// The rows that change, ascending.
    pub(crate) fn rows(&self) -> &[usize] {
        &self.rows
    }

    /// `(s² dM + dK) x`, x at the rows that change.
    pub(super) fn undamped(&self, s: Complex<f64>, x: &DVector<Complex<f64>>) -> DVector<Complex<f64>> {
        let mut force = DVector::zeros(x.len());
        if let Some(stiffness) = &self.stiffness {
            force += stiffness.map(Complex::from) * x;
        }
        if let Some(mass) = &self.mass {
            force += mass.map(Complex::from) * x * (s * s);
        }
        force
    }

    /// What it does in modes of mass-normalised `shapes`, DOFs x modes, and lambda = 1 / mu.
    pub(crate) fn loads(&self, shapes: &DMatrix<f64>, mu: &[f64]) -> Loads {
        let local = shapes.select_rows(&self.rows);
        let by = |matrix: &Option<DMatrix<f64>>| matrix.as_ref().map(|matrix| matrix * &local);
        let (elastic, inertial) = (by(&self.stiffness), by(&self.mass));
        let mut forces = elastic.unwrap_or_else(|| DMatrix::zeros(local.nrows(), local.ncols()));
        let mut stretch = vec![0.0; mu.len()];
        if let Some(inertial) = inertial {
            for (mode, mu) in mu.iter().enumerate() {
                stretch[mode] = -0.5 * local.column(mode).dot(&inertial.column(mode));
                forces.column_mut(mode).axpy(-1.0 / mu, &inertial.column(mode), 1.0);
            }
        }
        let ln_frequency = |(mode, mu): (usize, &f64)| 0.5 * local.column(mode).dot(&forces.column(mode)) * mu;
        let ln_frequency = mu.iter().enumerate().map(ln_frequency).collect();
        Loads { forces, stretch, ln_frequency }
    }

    /// `dC x`, x at the rows that change; `None` where no dashpot changes.
    pub(super) fn damped(&self, x: &DVector<Complex<f64>>) -> Option<DVector<Complex<f64>>> {
        self.damping.as_ref().map(|damping| damping.map(Complex::from) * x)
    }
}

/// What a change does in the motion of some modes.
pub(crate) struct Loads {
    /// `(dK - lambda dM) phi` of each at the rows that change, rows x modes.
    pub(crate) forces: DMatrix<f64>,
    /// `-phiᵀ dM phi / 2` of each: by this share the mass-normalised shape gets longer.
    pub(crate) stretch: Vec<f64>,
    /// The derivative of each frequency's logarithm.
    pub(crate) ln_frequency: Vec<f64>,
}

fn unless_zero(matrix: DMatrix<f64>) -> Option<DMatrix<f64>> {
    matrix.iter().any(|&value| value != 0.0).then_some(matrix)
}

/// First derivatives of ln f of the modes `modes` (0-based, with mass) by a change: `phiᵀ (dK - lambda dM) phi / (2 lambda)`
/// (Fox and Kapoor 1968, eq. 7).
pub fn frequency_derivatives(basis: &ModalBasis, modes: &[usize], change: &Change) -> Vec<f64> {
    let mu: Vec<f64> = modes.iter().map(|&mode| basis.inverse_lambda[mode]).collect();
    let mut shapes = basis.vectors.select_columns(modes);
    // phi = x / sqrt(mu) and lambda = 1 / mu.
    shapes.column_iter_mut().zip(&mu).for_each(|(mut shape, mu)| shape /= mu.sqrt());
    change.loads(&shapes, &mu).ln_frequency
}

/// How an undamped mode follows forces at the DOFs: worth making where more than one change of a structure is looked at.
///
/// With K-orthonormal vectors x_j and mu_j = 1/lambda_j, `d lambda = phiᵀ (dK - lambda dM) phi` and
/// `d phi = -sum_(j≠i) x_j x_jᵀ (dK - lambda dM) phi / (1 - lambda mu_j) - phi phiᵀ dM phi / 2`: motions without mass
/// (mu_j = 0) take part, so nothing is truncated (Fox and Kapoor 1968, AIAA Journal 6, eq. 13, in K-orthonormal form).
#[derive(Debug, Clone)]
pub(crate) struct UndampedResponse {
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
    /// Of the mode `mode` (0-based, with mass). `sensor_vectors` are the basis' vectors at the sensors, sensors x vectors, `transposed` those at
    /// the DOFs, vectors x DOFs, and `left_out` is [`ModalBasis::left_out`].
    pub(super) fn of(
        basis: &ModalBasis,
        sensor_vectors: &DMatrix<f64>,
        transposed: &DMatrix<f64>,
        left_out: &[DMatrix<f64>],
        mode: usize,
    ) -> Self {
        let mu = basis.inverse_lambda[mode];
        let mut shares = sensor_vectors.clone();
        for (other, mut share) in shares.column_iter_mut().enumerate() {
            let distance = 1.0 - basis.inverse_lambda[other] / mu;
            share *= if other == mode || distance.abs() < DEGENERATE { 0.0 } else { -distance.recip() };
        }
        let mut by_force = shares * transposed;
        // 1 / (1 - lambda mu_j) as a series.
        for (power, part) in left_out.iter().enumerate() {
            let factor = mu.powi(-(power as i32));
            by_force.zip_apply(part, |entry, part| *entry -= factor * part);
        }
        let length = basis.sign(mode) / mu.sqrt();
        Self { mu, shape: basis.vectors.column(mode) * length, seen: sensor_vectors.column(mode) * length, by_force }
    }

    /// 1/lambda.
    pub(crate) fn mu(&self) -> f64 {
        self.mu
    }

    /// The mass-normalised shape.
    pub(crate) fn shape(&self) -> &DVector<f64> {
        &self.shape
    }

    /// What the sensors see of it.
    pub(crate) fn seen(&self) -> &DVector<f64> {
        &self.seen
    }

    /// Change of what they see by a force at each DOF, sensors x DOFs.
    pub(crate) fn by_force(&self) -> &DMatrix<f64> {
        &self.by_force
    }

    pub(super) fn derivative(&self, change: &Change) -> ModeDerivative {
        let shape = DMatrix::from_column_slice(self.shape.len(), 1, self.shape.as_slice());
        let Loads { forces, stretch, ln_frequency } = change.loads(&shape, &[self.mu]);
        let mut shape = &self.seen * stretch[0];
        for (&row, force) in change.rows.iter().zip(forces.iter()) {
            shape.axpy(*force, &self.by_force.column(row), 1.0);
        }
        ModeDerivative { ln_frequency: ln_frequency[0], shape, damping_ratio: 0.0 }
    }
}
