//! How far a model is trusted, as few independent numbers of unit variance.

use nalgebra::{DMatrix, DVector};

use crate::compare::Tolerance;
use crate::model::{Body, Structure};
use crate::statistics::largest_first;

/// Directions of the background scatter with the most variance: relative changes of segments are `directions` times
/// standard normal numbers (Karhunen-Loève).
#[derive(Debug, Clone)]
pub(super) struct Background {
    /// Relative changes of stiffness, segments x numbers.
    stiffness: DMatrix<f64>,
    /// Relative changes of mass, segments x numbers.
    mass: DMatrix<f64>,
    /// Whether the last number says how far masses are spread between the nodes.
    has_spread: bool,
}

/// Share of the scatter's variance that is neglected.
const LEFT_OUT: f64 = 1e-4;
/// A table lumps masses at nodes where a structure has them spread; by how much is not known (one standard deviation of
/// [`Structure::spread_masses`]). Without it a table's own coarseness would look like masses and losses at its longest
/// segments.
const SPREAD: f64 = 0.5;
/// However the background scatters, a segment keeps at least this share of its stiffness and mass.
const LEAST_FACTOR: f64 = 0.1;

impl Background {
    /// From the tolerance of a model; without a tolerance nothing scatters.
    pub(super) fn of(structure: &Structure, model: &crate::study::Model) -> Self {
        let segments = match &structure.body {
            Body::Beam(beam) => beam.segments().len(),
            Body::Matrices(_) => 0,
        };
        let Some(tolerance) = Tolerance::of(structure, model) else {
            let none = DMatrix::zeros(segments, 0);
            return Self { stiffness: none.clone(), mass: none, has_spread: false };
        };
        let eigen = tolerance.covariance.clone().symmetric_eigen();
        let order = largest_first(eigen.eigenvalues.as_slice());
        let total: f64 = eigen.eigenvalues.iter().sum();
        let mut left = total;
        let kept: Vec<usize> = order
            .into_iter()
            .take_while(|&index| {
                let more = left > LEFT_OUT * total;
                left -= eigen.eigenvalues[index];
                more
            })
            .collect();
        let mut directions = eigen.eigenvectors.select_columns(&kept);
        for (mut column, &index) in directions.column_iter_mut().zip(&kept) {
            column *= eigen.eigenvalues[index].max(0.0).sqrt();
        }
        // The tolerance lists stiffness first, then mass, and leaves out what is trusted.
        let has_stiffness = model.background_stiffness.is_some_and(|deviation| deviation > 0.0);
        let part = |wanted: bool, first: usize| {
            if wanted { directions.rows(first, segments).into_owned() } else { DMatrix::zeros(segments, kept.len()) }
        };
        let has_mass = model.background_mass.is_some_and(|deviation| deviation > 0.0);
        Self {
            stiffness: part(has_stiffness, 0),
            mass: part(has_mass, if has_stiffness { segments } else { 0 }),
            has_spread: true,
        }
    }

    /// How many numbers there are.
    pub(super) fn size(&self) -> usize {
        self.scatter() + usize::from(self.has_spread)
    }

    /// How many of them scatter segments.
    fn scatter(&self) -> usize {
        self.stiffness.ncols()
    }

    /// Factors on each segment's stiffness and mass.
    fn factors(&self, numbers: &DVector<f64>) -> [DVector<f64>; 2] {
        let numbers = numbers.rows(0, self.scatter());
        [&self.stiffness, &self.mass].map(|part| (part * numbers).map(|change| (1.0 + change).max(LEAST_FACTOR)))
    }

    /// Scatters the segments of a structure.
    pub(super) fn apply(&self, numbers: &DVector<f64>, structure: &mut Structure) {
        let [stiffness, mass] = self.factors(numbers);
        if let Body::Beam(beam) = &mut structure.body
            && self.size() > 0
        {
            for (index, segment) in beam.segments_mut().iter_mut().enumerate() {
                segment.scale_stiffness(stiffness[index]);
                segment.scale_mass(mass[index]);
            }
            if self.has_spread {
                structure.spread_masses(SPREAD * numbers[self.scatter()]);
            }
        }
    }

    /// From derivatives by each segment's relative stiffness and mass (anything x segments) and by the spread of masses, at
    /// the scatter `numbers`, to derivatives by the numbers.
    pub(super) fn chain(
        &self,
        by_stiffness: &DMatrix<f64>,
        by_mass: &DMatrix<f64>,
        by_spread: &DVector<f64>,
        numbers: &DVector<f64>,
    ) -> DMatrix<f64> {
        let [stiffness, mass] = self.factors(numbers);
        let over = |part: &DMatrix<f64>, factors: &DVector<f64>| {
            let mut part = part.clone();
            for (mut row, factor) in part.row_iter_mut().zip(factors.iter()) {
                row /= *factor;
            }
            part
        };
        let scattered = by_stiffness * over(&self.stiffness, &stiffness) + by_mass * over(&self.mass, &mass);
        if !self.has_spread {
            return scattered;
        }
        let last = scattered.ncols();
        let mut chained = scattered.insert_column(last, 0.0);
        chained.set_column(last, &(by_spread * SPREAD));
        chained
    }
}
