//! The updated stiffness matrix, and the check that everything else stayed as it was.

use nalgebra::DMatrix;

use crate::model::{Assembly, EigenError, ModalBasis, Modes};

/// K* and what its eigenproblem says.
#[derive(Debug, Clone)]
pub struct UpdatedMatrices {
    /// K* = K + M Phi1 Psi Phi1ᵀ M, DOFs x DOFs, symmetric.
    pub stiffness: DMatrix<f64>,
    /// Its modes, solved anew.
    pub modes: Modes,
    /// The largest relative change of an eigenvalue that does not belong to the updated modes; 1 where one has appeared or
    /// vanished.
    pub max_relative_change_of_other_eigenvalues: f64,
    /// How many other eigenvalues there are.
    pub other_eigenvalues: usize,
}

/// Builds K* from the used model modes (0-based) and Psi, solves its eigenproblem anew, and holds it against the old one.
///
/// # Errors
/// [`EigenError`] where K* is no longer that of a supported structure.
pub fn updated(
    assembly: &Assembly,
    modes: &Modes,
    used: &[usize],
    psi: &DMatrix<f64>,
    measured_lambda: &[f64],
) -> Result<UpdatedMatrices, EigenError> {
    let momentum = &assembly.mass * modes.shapes.select_columns(used);
    let change = &momentum * psi * momentum.transpose();
    let stiffness = &assembly.stiffness + (&change + change.transpose()) * 0.5;
    let basis = ModalBasis::of(&stiffness, &assembly.mass)?;
    let solved = basis.modes(usize::MAX);
    let lambda = |frequency_hz: &f64| (std::f64::consts::TAU * frequency_hz).powi(2);
    let mut left: Vec<f64> = solved.frequency_hz.iter().map(lambda).collect();
    for &updated in measured_lambda {
        let nearest = left.iter().enumerate().min_by(|a, b| (a.1 - updated).abs().total_cmp(&(b.1 - updated).abs()));
        if let Some((index, _)) = nearest {
            left.remove(index);
        }
    }
    let others = modes.frequency_hz.iter().enumerate().filter(|(mode, _)| !used.contains(mode)).map(|(_, f)| lambda(f));
    let same_number = if others.clone().count() == left.len() { 0.0 } else { 1.0 };
    let change =
        others.clone().zip(&left).map(|(before, after)| (after / before - 1.0).abs()).fold(same_number, f64::max);
    Ok(UpdatedMatrices {
        stiffness,
        modes: solved,
        max_relative_change_of_other_eigenvalues: change,
        other_eigenvalues: others.count(),
    })
}

/// A symmetric matrix as a Matrix Market file (array, real, symmetric: the lower triangle, column after column), every
/// digit kept (Boisvert, Pozo, Remington 1996, NISTIR 5935).
pub fn matrix_market(matrix: &DMatrix<f64>) -> String {
    use std::fmt::Write;
    let size = matrix.nrows();
    let mut text = format!("%%MatrixMarket matrix array real symmetric\n{size} {size}\n");
    for column in 0..size {
        for row in column..size {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{:e}", matrix[(row, column)]);
        }
    }
    text
}

/// A matrix as a NumPy file.
///
/// # Errors
/// When the writer of the format fails.
pub fn npy(matrix: &DMatrix<f64>) -> std::io::Result<Vec<u8>> {
    use npyz::WriterBuilder;
    let mut bytes = Vec::new();
    let shape = [matrix.nrows() as u64, matrix.ncols() as u64];
    let mut writer = npyz::WriteOptions::new()
        .default_dtype()
        .shape(&shape)
        .order(npyz::Order::Fortran)
        .writer(&mut bytes)
        .begin_nd()?;
    writer.extend(matrix.iter())?;
    writer.finish()?;
    Ok(bytes)
}
