//! How far a model is trusted, as few independent numbers of unit variance.

use nalgebra::{DMatrix, DVector};

use crate::compare::Tolerance;
use crate::model::{Body, Segment, Stiffness, Structure};
use crate::statistics::largest_first;

/// Directions of the background scatter with the most variance: relative changes of segments are `directions` times
/// standard normal numbers (Karhunen-Loève).
#[derive(Debug, Clone)]
pub(super) struct Background {
    /// Relative changes of what is not trusted, segments x numbers: a stiffness, or the mass where it is none.
    parts: Vec<(Option<Stiffness>, DMatrix<f64>)>,
    /// How many numbers scatter segments.
    scatter: usize,
    /// How large the scatter is, in units of what the study states.
    size: f64,
    /// Whether the last three numbers say how far masses are spread between the nodes, and how far their centres are off the axis.
    moves_masses: bool,
    /// One standard deviation of the latter, in m.
    eccentricity_m: f64,
    /// How many numbers, after all others, say what families of modes have in common.
    families: usize,
}

/// How many numbers say where masses are.
const OF_MASSES: usize = 3;

/// Share of the scatter's variance that is neglected.
const LEFT_OUT: f64 = 1e-4;
/// A table lumps masses at nodes where a structure has them spread; by how much is not known (one standard deviation of
/// [`Structure::spread_masses`]). Without it a table's own coarseness would look like masses and losses at its longest
/// segments.
const SPREAD: f64 = 0.5;
/// Centres of mass are on the axis of a table to within this share of the radius of gyration: 0.15 m for a tower of 20 m. Closer no
/// drawing tells where plant and finishes are, and without it eccentricities of some centimetres, which turn neighbouring modes a
/// little, would be effects.
const ECCENTRICITY: f64 = 0.0075;
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
            return Self {
                parts: Vec::new(),
                scatter: 0,
                size: 1.0,
                moves_masses: false,
                eccentricity_m: 0.0,
                families: 0,
            };
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
            size: 1.0,
            moves_masses: true,
            eccentricity_m: ECCENTRICITY * radius_of_gyration_m(structure),
            families: 0,
        }
    }

    /// The same with numbers for families of modes.
    pub(super) fn with_families(self, families: usize) -> Self {
        Self { families, ..self }
    }

    /// The same, where segments scatter this many times as far as the study states.
    pub(super) fn sized(&self, size: f64) -> Self {
        let mut other = self.clone();
        other.parts.iter_mut().for_each(|(_, part)| *part *= size / self.size);
        other.size = size;
        other
    }

    /// How many numbers scatter segments: the first ones.
    pub(super) fn scatter(&self) -> usize {
        self.scatter
    }

    /// How many numbers there are.
    pub(super) fn size(&self) -> usize {
        self.first_of_families() + self.families
    }

    /// The place of the first number of a family of modes.
    pub(super) fn first_of_families(&self) -> usize {
        self.scatter + if self.moves_masses { OF_MASSES } else { 0 }
    }

    /// Whether segments scatter not at all.
    pub(super) fn is_none(&self) -> bool {
        self.first_of_families() == 0
    }

    /// What is not trusted.
    pub(super) fn quantities(&self) -> impl Iterator<Item = Option<Stiffness>> {
        self.parts.iter().map(|(quantity, _)| *quantity)
    }

    /// What is not trusted, with the relative changes of segments by each number, segments x numbers.
    pub(super) fn parts(&self) -> impl Iterator<Item = (Option<Stiffness>, &DMatrix<f64>)> {
        self.parts.iter().map(|(quantity, part)| (*quantity, part))
    }

    /// How far masses are spread and off the axis, in units of their numbers: a share of what a table lumps, then along X and Y in m.
    /// `None` where nothing is said of masses.
    pub(super) fn units_of_masses(&self) -> Option<[f64; OF_MASSES]> {
        self.moves_masses.then_some([SPREAD, self.eccentricity_m, self.eccentricity_m])
    }

    /// Factors on each segment's part.
    pub(super) fn factors(part: &DMatrix<f64>, numbers: &DVector<f64>) -> DVector<f64> {
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
            if let Some(units) = self.units_of_masses() {
                let [share, x_m, y_m] = [0, 1, 2].map(|at| units[at] * numbers[self.scatter + at]);
                structure.spread_masses(share);
                structure.shift_masses([x_m, y_m]);
            }
        }
    }

    /// From derivatives by each segment's relative change of each quantity (anything x segments, in the order of
    /// [`Background::quantities`]), by the spread of masses and by their eccentricity along X and Y, at the scatter `numbers`, to
    /// derivatives by the numbers, without those of families.
    pub(super) fn chain(
        &self,
        by_quantities: &[DMatrix<f64>],
        by_masses: &[DVector<f64>; OF_MASSES],
        numbers: &DVector<f64>,
    ) -> DMatrix<f64> {
        let mut scattered = DMatrix::zeros(by_masses[0].len(), self.scatter);
        for ((_, part), by_quantity) in self.parts.iter().zip(by_quantities) {
            let mut relative = part.clone();
            for (mut row, factor) in relative.row_iter_mut().zip(Self::factors(part, numbers).iter()) {
                row /= *factor;
            }
            scattered += by_quantity * relative;
        }
        let Some(units) = self.units_of_masses() else { return scattered };
        let mut chained = scattered.insert_columns(self.scatter, OF_MASSES, 0.0);
        for (at, (by_mass, unit)) in by_masses.iter().zip(units).enumerate() {
            chained.set_column(self.scatter + at, &(by_mass * unit));
        }
        chained
    }
}

/// Of all masses of a table about Z.
fn radius_of_gyration_m(structure: &Structure) -> f64 {
    let segments = structure.segments().unwrap_or_default();
    let sum = |of: &dyn Fn(&Segment) -> f64| segments.iter().map(of).sum::<f64>();
    let mass_kg = sum(&|segment| segment.mass_top_kg);
    let inertia_kg_m2 = sum(&|segment| segment.inertia_kg_m2[2]);
    if mass_kg > 0.0 { (inertia_kg_m2 / mass_kg).sqrt() } else { 0.0 }
}
