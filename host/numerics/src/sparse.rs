//! Large symmetric matrices with few entries that are not zero: factors, the modes of lowest frequency by block Lanczos iteration, and a
//! count of those below a frequency.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::cholesky::supernodal::SupernodalLdltRef;
use faer::sparse::linalg::cholesky::{SymbolicCholesky, SymbolicCholeskyRaw, factorize_symbolic_cholesky};
use faer::sparse::linalg::solvers::Llt;
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{MatRef, Par, Side};
use nalgebra::DMatrix;
use nalgebra_sparse::CscMatrix;

use crate::eigen::{EigenPairs, symmetric_pairs};

/// A matrix as the solvers' library sees it.
fn view(matrix: &CscMatrix<f64>) -> SparseColMatRef<'_, usize, f64> {
    let (columns, rows, values) = matrix.csc_data();
    let symbolic = SymbolicSparseColMatRef::new_checked(matrix.nrows(), matrix.ncols(), columns, None, rows);
    SparseColMatRef::new(symbolic, values)
}

/// The Cholesky factor of a symmetric positive definite matrix, its rows put into an order that keeps it sparse (Amestoy, Davis, Duff 2004,
/// "Algorithm 837: AMD", ACM Trans. Math. Softw. 30, 381).
#[derive(Debug, Clone)]
pub struct SparseFactor(Llt<usize, f64>);

impl SparseFactor {
    /// Of a matrix with both triangles; `None` where it is not positive definite, or so near to singular that what it solves is off by more
    /// than the share `negligible`.
    ///
    /// # Panics
    /// Where the matrix is not square.
    pub fn of(matrix: &CscMatrix<f64>, negligible: f64) -> Option<Self> {
        let factor = Self(view(matrix).sp_cholesky(Side::Lower).ok()?);
        // Motion that the matrix does not resist is what a solution has too much of.
        let known = spread_vectors(matrix.nrows(), 1, 0);
        let error = factor.solve(&(matrix * &known)) - &known;
        (error.norm() <= negligible * known.norm()).then_some(factor)
    }

    /// Solves `matrix x = b` for the columns of `right`.
    pub fn solve(&self, right: &DMatrix<f64>) -> DMatrix<f64> {
        let right_view = MatRef::from_column_major_slice(right.as_slice(), right.nrows(), right.ncols());
        let solved = self.0.solve(right_view);
        let values = solved.col_iter().flat_map(|column| column.iter().copied());
        DMatrix::from_iterator(right.nrows(), right.ncols(), values)
    }
}

/// Where a factor has entries that are not zero.
fn symbolic_factor(matrix: SparseColMatRef<'_, usize, f64>) -> Option<SymbolicCholesky<usize>> {
    factorize_symbolic_cholesky(matrix.symbolic(), Side::Lower, Default::default(), Default::default()).ok()
}

/// How many numbers a factor of such a matrix has; `None` where they cannot be counted.
pub fn factor_entries(matrix: &CscMatrix<f64>) -> Option<usize> {
    symbolic_factor(view(matrix)).map(|symbolic| symbolic.len_val())
}

/// Vectors of numbers between -1 and 1 that look random and are the same each time.
fn spread_vectors(rows: usize, columns: usize, seed: u64) -> DMatrix<f64> {
    // The sequence of SplitMix64 (Steele, Lea, Flood 2014).
    let mut state = seed.wrapping_mul(0xd134_2543_de82_ef95);
    DMatrix::from_fn(rows, columns, |_, _| {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        2.0 * ((bits ^ (bits >> 31)) >> 11) as f64 / (1_u64 << 53) as f64 - 1.0
    })
}

/// So many vectors are iterated at once.
const BLOCK: usize = 6;
/// An eigenvalue is found where what its vector leaves is below this share of it.
const FOUND: f64 = 1e-10;
/// The basis grows to this many times what is asked for, and so much more, before it is given up.
const MOST_TIMES: usize = 6;
const MOST_MORE: usize = 60;
/// Eigenvalues that differ by less than this share are not told apart.
const APART: f64 = 1e-6;
/// A direction is none where orthogonalisation leaves less than this share of it; nor is a motion that has less than this share of mass.
const NOTHING: f64 = 1e-10;

/// The `count` eigenpairs of `mass x = mu stiffness x` of largest mu (lowest frequency), largest first, `xᵀ stiffness x = 1`; fewer where the
/// mass allows no more. Matrices have both triangles, `mass` may be singular. `None` where the iteration does not converge.
///
/// Block Lanczos iteration with `K⁻¹ M` in the inner product of K, all vectors kept at right angles (Grimes, Lewis, Simon 1994, "A shifted
/// block Lanczos algorithm for solving sparse symmetric generalized eigenproblems", SIAM J. Matrix Anal. Appl. 15, 228). That no mode is left
/// out is checked by the count of eigenvalues (Sturm); where one is, the iteration goes on from other vectors.
///
/// # Panics
/// Where sizes do not fit.
pub fn lowest_sparse_modes(
    factor: &SparseFactor,
    stiffness: &CscMatrix<f64>,
    mass: &CscMatrix<f64>,
    count: usize,
) -> Option<EigenPairs<f64>> {
    let rows = stiffness.nrows();
    if count == 0 {
        return Some(EigenPairs { values: Vec::new(), vectors: DMatrix::zeros(rows, 0) });
    }
    let most = (MOST_TIMES * count + MOST_MORE).min(rows);
    // Two blocks may come at once, none of which is cut short.
    let mut basis = Basis::new(rows, most + 2 * BLOCK);
    let mut seed = 0;
    let mut fresh = || {
        seed += 1;
        factor.solve(&(mass * spread_vectors(rows, BLOCK, seed)))
    };
    basis.add(fresh(), stiffness, mass);
    let mut due = (2 * count).min(most);
    loop {
        let before = basis.size;
        let coupling = basis.add(factor.solve(&basis.inertia), stiffness, mass);
        let is_whole = coupling.nrows() == 0 || basis.size >= most;
        if before < due && !is_whole {
            continue;
        }
        due = before + 4 * BLOCK;
        let pairs = symmetric_pairs(&basis.projected.view((0, 0), (before, before)).into_owned())?;
        let greatest = pairs.values.first().copied().filter(|mu| *mu > 0.0)?;
        let has_mass = |mu: &&f64| **mu > NOTHING * greatest;
        let wanted = pairs.values.iter().take(count).take_while(has_mass).count();
        // What K⁻¹ M takes out of the basis comes from its last block.
        let last = before - coupling.ncols();
        let left = &coupling * pairs.vectors.view((last, 0), (coupling.ncols(), wanted));
        let is_found = left.column_iter().zip(&pairs.values).all(|(left, mu)| left.norm() <= FOUND * mu);
        let found = |basis: &Basis| EigenPairs {
            values: pairs.values[..wanted].to_vec(),
            vectors: basis.vectors.columns(0, before) * pairs.vectors.columns(0, wanted),
        };
        if is_found {
            // Counted next to the last one, where modes of one frequency count together.
            let least = pairs.values[wanted - 1] * (1.0 - APART);
            let there = pairs.values.iter().take_while(|mu| **mu > least).count();
            if count_below(stiffness, mass, 1.0 / least).is_none_or(|below| below <= there) {
                return Some(found(&basis));
            }
        }
        // A basis of all rows is judged once more, for then nothing is left.
        if basis.size >= most && (most < rows || coupling.nrows() == 0 && !is_found) {
            return None;
        }
        if is_found || coupling.nrows() == 0 {
            // Nothing is known yet of what K⁻¹ M makes of the block that was added: it goes on beside the fresh one.
            let waiting = std::mem::replace(&mut basis.inertia, DMatrix::zeros(rows, 0));
            if basis.add(fresh(), stiffness, mass).nrows() == 0 {
                // No motion with mass is left.
                return is_found.then(|| found(&basis));
            }
            let columns: Vec<_> = waiting.column_iter().chain(basis.inertia.column_iter()).collect();
            basis.inertia = DMatrix::from_columns(&columns);
        }
    }
}

/// Vectors at right angles in the inner product of K.
struct Basis {
    /// Room for all, the first `size` are there: rows x vectors.
    vectors: DMatrix<f64>,
    size: usize,
    /// M in the span of the vectors.
    projected: DMatrix<f64>,
    /// M times the last block: what the iteration goes on from.
    inertia: DMatrix<f64>,
}

impl Basis {
    fn new(rows: usize, most: usize) -> Self {
        let (vectors, projected) = (DMatrix::zeros(rows, most), DMatrix::zeros(most, most));
        Self { vectors, size: 0, projected, inertia: DMatrix::zeros(rows, 0) }
    }

    /// Adds the directions of a block that are new; what the block has of them, new x block.
    fn add(&mut self, block: DMatrix<f64>, stiffness: &CscMatrix<f64>, mass: &CscMatrix<f64>) -> DMatrix<f64> {
        let forces = stiffness * &block;
        let longest = block.column_iter().zip(forces.column_iter()).map(|(one, force)| one.dot(&force));
        let longest = longest.fold(0.0, f64::max);
        let block = self.without_known(block, stiffness);
        let Some(gram) = symmetric_pairs(&(block.transpose() * (stiffness * &block))) else {
            return DMatrix::zeros(0, block.ncols());
        };
        let room = self.vectors.ncols() - self.size;
        let is_new = |length: &&f64| **length > NOTHING * NOTHING * longest;
        let new = gram.values.iter().take_while(is_new).count().min(room);
        let mut turned = gram.vectors.columns(0, new).into_owned();
        let mut coupling = turned.transpose();
        for (at, length) in gram.values.iter().take(new).enumerate() {
            turned.column_mut(at).unscale_mut(length.sqrt());
            coupling.row_mut(at).scale_mut(length.sqrt());
        }
        // What is left of directions that nearly vanish has lost its right angles.
        let mut directions = self.without_known(block * turned, stiffness);
        let gram = directions.transpose() * (stiffness * &directions);
        if let Some(inverse) = gram.cholesky().and_then(|factor| factor.l().transpose().try_inverse()) {
            directions *= inverse;
        }
        self.vectors.columns_mut(self.size, new).copy_from(&directions);
        self.size += new;
        self.inertia = mass * &directions;
        let part = self.inertia.transpose() * self.vectors.columns(0, self.size);
        let from = self.size - new;
        self.projected.view_mut((from, 0), part.shape()).copy_from(&part);
        self.projected.view_mut((0, from), (self.size, new)).copy_from(&part.transpose());
        coupling
    }

    /// A block less what it has of the vectors; twice, for once leaves rounding (Kahan, Parlett).
    fn without_known(&self, mut block: DMatrix<f64>, stiffness: &CscMatrix<f64>) -> DMatrix<f64> {
        let known = self.vectors.columns(0, self.size);
        for _ in 0..2 {
            let shares = (stiffness * &block).transpose() * known;
            block -= known * shares.transpose();
        }
        block
    }
}

/// How many eigenvalues of `stiffness x = lambda mass x` lie below `value`: negative pivots of `stiffness - value mass` (Sylvester's law of
/// inertia). `None` where a pivot vanishes.
///
/// # Panics
/// Where the two are not of the same size.
pub fn count_below(stiffness: &CscMatrix<f64>, mass: &CscMatrix<f64>, value: f64) -> Option<usize> {
    let difference = stiffness - &(mass * value);
    let matrix = view(&difference);
    let symbolic = symbolic_factor(matrix)?;
    let mut values = vec![0.0; symbolic.len_val()];
    let scratch = symbolic.factorize_numeric_ldlt_scratch::<f64>(Par::Seq, Default::default());
    let mut memory = MemBuffer::new(scratch);
    symbolic
        .factorize_numeric_ldlt(
            &mut values,
            matrix,
            Side::Lower,
            Default::default(),
            Par::Seq,
            MemStack::new(&mut memory),
            Default::default(),
        )
        .ok()?;
    let pivots: Vec<f64> = match symbolic.raw() {
        SymbolicCholeskyRaw::Simplicial(simplicial) => {
            simplicial.col_ptr()[..simplicial.ncols()].iter().map(|&at| values[at]).collect()
        }
        SymbolicCholeskyRaw::Supernodal(supernodal) => {
            let factor = SupernodalLdltRef::new(supernodal, &values);
            let blocks = (0..supernodal.n_supernodes()).map(|at| factor.supernode(at).val());
            blocks.flat_map(|block| (0..block.ncols()).map(move |at| block[(at, at)])).collect()
        }
    };
    pivots.iter().all(|pivot| pivot.is_finite()).then(|| pivots.iter().filter(|pivot| **pivot < 0.0).count())
}
