//! How far a model is trusted, as few independent numbers of unit variance.

use nalgebra::{DMatrix, DVector};

use crate::compare::Tolerance;
use crate::model::{Body, Stiffness, Structure};
use crate::statistics::largest_first;

/// Directions of the background scatter with the most variance: relative changes of segments are `directions` times
/// standard normal numbers (Karhunen-Loève).
#[derive(Debug, Clone)]
pub(super) struct Background {
    /// Relative changes of what is not trusted, segments x numbers: a stiffness, or the mass where it is none.
    parts: Vec<(Option<Stiffness>, DMatrix<f64>)>,
    /// How many numbers scatter segments.
    scatter: usize,
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
            return Self { parts: Vec::new(), scatter: 0, has_spread: false };
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
        let part = |(index, quantity): (usize, &Option<Stiffness>)| {
            (*quantity, directions.rows(index * segments, segments).into_owned())
        };
        Self {
            parts: tolerance.quantities.iter().enumerate().map(part).collect(),
            scatter: kept.len(),
            has_spread: true,
        }
    }

    /// How many numbers there are.
    pub(super) fn size(&self) -> usize {
        self.scatter + usize::from(self.has_spread)
    }

    /// Whether there is none.
    pub(super) fn is_none(&self) -> bool {
        self.size() == 0
    }

    /// What is not trusted.
    pub(super) fn quantities(&self) -> impl Iterator<Item = Option<Stiffness>> {
        self.parts.iter().map(|(quantity, _)| *quantity)
    }

    /// Factors on each segment's part.
    fn factors(part: &DMatrix<f64>, numbers: &DVector<f64>) -> DVector<f64> {
        (part * numbers.rows(0, part.ncols())).map(|change| (1.0 + change).max(LEAST_FACTOR))
    }

    /// Scatters the segments of a structure.
    pub(super) fn apply(&self, numbers: &DVector<f64>, structure: &mut Structure) {
        if let Body::Beam(beam) = &mut structure.body {
            for (quantity, part) in &self.parts {
                for (segment, factor) in beam.segments_mut().iter_mut().zip(Self::factors(part, numbers).iter()) {
                    match quantity {
                        Some(stiffness) => segment.scale(*stiffness, *factor),
                        None => segment.scale_mass(*factor),
                    }
                }
            }
            if self.has_spread {
                structure.spread_masses(SPREAD * numbers[self.scatter]);
            }
        }
    }

    /// From derivatives by each segment's relative change of each quantity (anything x segments, in the order of
    /// [`Background::quantities`]) and by the spread of masses, at the scatter `numbers`, to derivatives by the numbers.
    pub(super) fn chain(
        &self,
        by_quantities: &[DMatrix<f64>],
        by_spread: &DVector<f64>,
        numbers: &DVector<f64>,
    ) -> DMatrix<f64> {
        let mut scattered = DMatrix::zeros(by_spread.len(), self.scatter);
        for ((_, part), by_quantity) in self.parts.iter().zip(by_quantities) {
            let mut relative = part.clone();
            for (mut row, factor) in relative.row_iter_mut().zip(Self::factors(part, numbers).iter()) {
                row /= *factor;
            }
            scattered += by_quantity * relative;
        }
        if !self.has_spread {
            return scattered;
        }
        let mut chained = scattered.insert_column(self.scatter, 0.0);
        chained.set_column(self.scatter, &(by_spread * SPREAD));
        chained
    }
}
