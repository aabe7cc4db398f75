//! How far a model is trusted, as few independent numbers of unit variance.

use nalgebra::{DMatrix, DVector};

use crate::compare::Tolerance;
use crate::model::{Body, Distortion, Segment, Stiffness, Structure};
use crate::statistics::largest_first;

/// Directions of the background scatter with the most variance: relative changes of segments are `directions` times
/// standard normal numbers (Karhunen-Loève).
#[derive(Debug, Clone)]
pub(super) struct Background {
    /// Relative changes of what is not trusted, segments x numbers: a stiffness, or the mass where it is none. The last number is that
    /// of the foot. More numbers say how far masses are spread between the nodes, how far their centres are off the axis, and how far
    /// sections narrow.
    parts: Vec<(Option<Stiffness>, DMatrix<f64>)>,
    /// How many numbers scatter segments, and then groups.
    scatter: usize,
    /// How far each group scatters: one standard deviation.
    groups: Vec<f64>,
    /// How large the scatter is, in units of what the study states.
    size: f64,
    /// One standard deviation of how far centres of mass are off the axis, in m.
    eccentricity_m: f64,
    /// How many numbers, after all others, say what families of modes have in common.
    families: usize,
}

/// How many numbers say how the foot is held, how many where masses are, and how many how far sections narrow.
const OF_FOOT: usize = 1;
const OF_MASSES: usize = 3;
const OF_SECTIONS: usize = 1;

/// Share of the scatter's variance that is neglected.
const LEFT_OUT: f64 = 1e-4;
/// A table lumps masses at nodes where a structure has them spread; by how much is not known (one standard deviation of
/// [`Structure::spread_masses`]). Without it a table's own coarseness would look like masses and losses at its longest
/// segments.
const SPREAD: f64 = 0.5;
/// A table has the stiffness of lengths whose sections are free to warp and to shear. Where a structure is clamped they are not: it bends as
/// if it were shorter by this share of the radius of gyration (one standard deviation). Without it, three of three sound lattice towers of
/// another finite element code, which bend as if they were shorter by a sixth of it, had an outrigger at their foot.
const AT_THE_FOOT: f64 = 0.2;
/// Nothing that a table leaves out makes a clamped foot softer, so it bends as if it were longer by this share of that only. A footing that
/// gives more is an effect; with as much on both sides a rotation of the base that moved frequencies by 4 % was taken for the tolerance's.
const SOFTER: f64 = 0.25;
/// From the one side to the other within about this many standard deviations, so that a fit can follow.
const KNEE: f64 = 0.5;
/// Centres of mass are on the axis of a table to within this share of the radius of gyration: 0.15 m for a tower of 20 m. Closer no
/// drawing tells where plant and finishes are, and without it eccentricities of some centimetres, which turn neighbouring modes a
/// little, would be effects.
const ECCENTRICITY: f64 = 0.0075;
/// One standard deviation of [`Distortion::narrowing`]: whether floors hold sections in shape, no table says. Of structures of another
/// finite element code, oval shell tubes narrow with a ratio of 0.11 in every mode of bending and lattices of legs and braces with 0.26 to
/// 0.46, so that sensors at their corners move by up to 2.5 % of a mode's top; frames with floors do not.
const NARROWING: f64 = 0.2;
/// However the background scatters, a segment keeps at least this share of its stiffness and mass.
const LEAST_FACTOR: f64 = 0.1;

impl Background {
    /// From the tolerance of a model; without a tolerance nothing scatters.
    pub(super) fn of(structure: &Structure, model: &crate::study::Model) -> Self {
        let segments = match &structure.body {
            Body::Beam(beam) => beam.segments().len(),
            Body::Matrices(_) => 0,
        };
        let groups: Vec<f64> = structure.groups().map(|(_, group)| group.std).collect();
        let Some(tolerance) = Tolerance::of_segments(structure, model) else {
            let (parts, scatter) = (Vec::new(), groups.len());
            return Self { parts, scatter, groups, size: 1.0, eccentricity_m: 0.0, families: 0 };
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
        let radius_m = radius_of_gyration_m(structure);
        let foot = foot(structure, radius_m);
        let part = |(index, quantity): (usize, &Option<Stiffness>)| {
            let by_scatter = directions.rows(index * segments, segments).into_owned();
            let mut part = by_scatter.insert_columns(kept.len(), groups.len() + OF_FOOT, 0.0);
            if matches!(quantity, Some(Stiffness::Bending1 | Stiffness::Bending2)) {
                part.column_mut(kept.len() + groups.len()).rows_mut(0, foot.len()).copy_from(&foot);
            }
            (*quantity, part)
        };
        Self {
            parts: tolerance.quantities.iter().enumerate().map(part).collect(),
            scatter: kept.len() + groups.len(),
            groups,
            size: 1.0,
            eccentricity_m: ECCENTRICITY * radius_m,
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
        for (_, part) in &mut other.parts {
            let mut by_scatter = part.columns_mut(0, self.scatter);
            by_scatter *= size / self.size;
        }
        for group in &mut other.groups {
            *group *= size / self.size;
        }
        other.size = size;
        other
    }

    /// The same with the numbers that scatter segments along these directions alone: numbers x directions, at right angles.
    pub(super) fn along(&self, directions: &DMatrix<f64>) -> Self {
        let (of_segments, seen) = (self.first_of_groups(), directions.ncols());
        let turned = |part: &DMatrix<f64>| {
            let mut turned = part.clone().remove_columns(seen, of_segments - seen);
            turned.columns_mut(0, seen).copy_from(&(part.columns(0, of_segments) * directions));
            turned
        };
        let parts = self.parts.iter().map(|(quantity, part)| (*quantity, turned(part))).collect();
        Self { parts, scatter: seen + self.groups.len(), ..self.clone() }
    }

    /// How many numbers scatter segments and groups: the first ones.
    pub(super) fn scatter(&self) -> usize {
        self.scatter
    }

    /// How large the scatter is, in units of what the study states.
    pub(super) fn times(&self) -> f64 {
        self.size
    }

    /// How many numbers there are.
    pub(super) fn size(&self) -> usize {
        self.first_of_families() + self.families
    }

    /// The place of the first number of a family of modes.
    pub(super) fn first_of_families(&self) -> usize {
        self.of_segments() + if self.has_segments() { OF_MASSES + OF_SECTIONS } else { 0 }
    }

    /// How many numbers change segments and groups, by their scatter and at the foot; those of masses and of sections come after them.
    pub(super) fn of_segments(&self) -> usize {
        self.scatter + if self.has_segments() { OF_FOOT } else { 0 }
    }

    /// Whether neither segments nor groups scatter.
    pub(super) fn is_none(&self) -> bool {
        self.parts.is_empty() && self.groups.is_empty()
    }

    /// Whether segments scatter.
    pub(super) fn has_segments(&self) -> bool {
        !self.parts.is_empty()
    }

    /// How far each group scatters: one standard deviation of its relative change.
    pub(super) fn groups(&self) -> &[f64] {
        &self.groups
    }

    /// The place of the first group's number.
    pub(super) fn first_of_groups(&self) -> usize {
        self.scatter - self.groups.len()
    }

    /// Relative changes of groups.
    pub(super) fn changes_of_groups(&self, numbers: &DVector<f64>) -> Vec<f64> {
        let first = self.first_of_groups();
        let change = |(at, std): (usize, &f64)| (std * numbers[first + at]).max(LEAST_FACTOR - 1.0);
        self.groups.iter().enumerate().map(change).collect()
    }

    /// What is not trusted.
    pub(super) fn quantities(&self) -> impl Iterator<Item = Option<Stiffness>> {
        self.parts.iter().map(|(quantity, _)| *quantity)
    }

    /// What is not trusted, with the relative changes of segments at `numbers` and their derivatives by each number, segments x numbers.
    pub(super) fn changes(
        &self,
        numbers: &DVector<f64>,
    ) -> impl Iterator<Item = (Option<Stiffness>, DVector<f64>, DMatrix<f64>)> {
        let (foot, shaped) = (self.scatter, self.shaped(numbers));
        let change = move |(quantity, part): &(Option<Stiffness>, DMatrix<f64>)| {
            let mut by_numbers = part.clone();
            by_numbers.column_mut(foot).scale_mut(slope_at_the_foot(numbers[foot]));
            (*quantity, part * &shaped, by_numbers)
        };
        self.parts.iter().map(change)
    }

    /// How far masses are spread and off the axis, in units of their numbers: a share of what a table lumps, then along X and Y in m.
    /// `None` where nothing is said of masses.
    pub(super) fn units_of_masses(&self) -> Option<[f64; OF_MASSES]> {
        self.has_segments().then_some([SPREAD, self.eccentricity_m, self.eccentricity_m])
    }

    /// How far sections distort by this number.
    pub(super) fn distortion(number: f64) -> Distortion {
        Distortion { narrowing: NARROWING * number, ..Distortion::default() }
    }

    /// The place of the number that says how far sections narrow; `None` where nothing is said of them.
    pub(super) fn of_sections(&self) -> Option<usize> {
        self.has_segments().then(|| self.of_segments() + OF_MASSES)
    }

    /// The numbers by which segments change, the foot's by as much as it is felt.
    fn shaped(&self, numbers: &DVector<f64>) -> DVector<f64> {
        let mut shaped = numbers.rows(0, self.of_segments()).into_owned();
        if self.has_segments() {
            shaped[self.scatter] = felt_at_the_foot(shaped[self.scatter]);
        }
        shaped
    }

    /// The factor of a segment's relative change.
    pub(super) fn factor(change: f64) -> f64 {
        (1.0 + change).max(LEAST_FACTOR)
    }

    /// Scatters the segments and groups of a structure.
    pub(super) fn apply(&self, numbers: &DVector<f64>, structure: &mut Structure) {
        structure.change_groups(&self.changes_of_groups(numbers));
        if let Body::Beam(beam) = &mut structure.body {
            let shaped = self.shaped(numbers);
            for (quantity, part) in &self.parts {
                for (segment, change) in beam.segments_mut().iter_mut().zip((part * &shaped).iter()) {
                    match quantity {
                        Some(stiffness) => segment.scale(*stiffness, Self::factor(*change)),
                        None => segment.scale_mass(Self::factor(*change)),
                    }
                }
            }
            if let Some(units) = self.units_of_masses() {
                let first = self.of_segments();
                let [share, x_m, y_m] = [0, 1, 2].map(|at| units[at] * numbers[first + at]);
                structure.spread_masses(share);
                structure.shift_masses([x_m, y_m]);
            }
            if let Some(at) = self.of_sections() {
                structure.distort_sections(Self::distortion(numbers[at]));
            }
        }
    }

    /// From derivatives by each segment's relative change of each quantity (anything x segments, in the order of
    /// [`Background::quantities`]), by each group's relative change, by the spread of masses and by their eccentricity along X and Y, and
    /// by one standard deviation of how far sections narrow, at the scatter `numbers`, to derivatives by the numbers, without those of
    /// families.
    pub(super) fn chain(
        &self,
        by_quantities: &[DMatrix<f64>],
        by_groups: &DMatrix<f64>,
        by_others: &[DVector<f64>],
        numbers: &DVector<f64>,
    ) -> DMatrix<f64> {
        let by_segments = self.of_segments();
        let mut scattered = DMatrix::zeros(by_groups.nrows(), by_segments);
        for (at, (by_group, std)) in by_groups.column_iter().zip(&self.groups).enumerate() {
            scattered.set_column(self.first_of_groups() + at, &(by_group * *std));
        }
        for ((_, changes, mut relative), by_quantity) in self.changes(numbers).zip(by_quantities) {
            for (mut row, change) in relative.row_iter_mut().zip(changes.iter()) {
                row /= Self::factor(*change);
            }
            scattered += by_quantity * relative;
        }
        let Some(units) = self.units_of_masses() else { return scattered };
        let mut chained = scattered.insert_columns(by_segments, by_others.len(), 0.0);
        let units = units.into_iter().chain([1.0; OF_SECTIONS]);
        for (at, (by_other, unit)) in by_others.iter().zip(units).enumerate() {
            chained.set_column(by_segments + at, &(by_other * unit));
        }
        chained
    }
}

/// How far the foot's number is felt: as it is where it stiffens, by a share of it where it softens.
fn felt_at_the_foot(number: f64) -> f64 {
    let [mean, half] = [(1.0 + SOFTER) / 2.0, (1.0 - SOFTER) / 2.0];
    mean * number + half * (number.hypot(KNEE) - KNEE)
}

/// Its derivative.
fn slope_at_the_foot(number: f64) -> f64 {
    (1.0 + SOFTER) / 2.0 + (1.0 - SOFTER) / 2.0 * number / number.hypot(KNEE)
}

/// One standard deviation of the relative change of bending stiffness, of the lowest segments as far up as the radius of gyration.
fn foot(structure: &Structure, radius_m: f64) -> DVector<f64> {
    let segments = structure.segments().unwrap_or_default();
    let Some(base_m) = segments.first().map(|first| first.z_bottom_m) else { return DVector::zeros(0) };
    let count = segments.iter().take_while(|segment| segment.z_top_m - base_m < radius_m).count();
    let lowest = &segments[..segments.len().min(count.max(1))];
    let length_m: f64 = lowest.iter().map(Segment::length_m).sum();
    DVector::repeat(lowest.len(), AT_THE_FOOT * radius_m / length_m)
}

/// Of all masses of a table about Z.
fn radius_of_gyration_m(structure: &Structure) -> f64 {
    let segments = structure.segments().unwrap_or_default();
    let sum = |of: &dyn Fn(&Segment) -> f64| segments.iter().map(of).sum::<f64>();
    let mass_kg = sum(&|segment| segment.mass_top_kg);
    let inertia_kg_m2 = sum(&|segment| segment.inertia_kg_m2[2]);
    if mass_kg > 0.0 { (inertia_kg_m2 / mass_kg).sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A clamped foot stiffens by as much as it may, and softens by a quarter of that; between them slopes follow.
    #[test]
    fn a_foot_is_stiffer_rather_than_softer() {
        assert_eq!(felt_at_the_foot(0.0), 0.0);
        // The knee costs the half of the difference of slopes times its width.
        let knee = 0.5 * (1.0 - SOFTER) * KNEE;
        for (number, slope) in [(40.0, 1.0), (-40.0, SOFTER)] {
            assert!((felt_at_the_foot(number) - slope * number + knee).abs() < 0.01, "{number}");
            assert!((slope_at_the_foot(number) - slope).abs() < 1e-3, "{number}");
        }
        for number in [-2.0, -0.3, 0.0, 0.2, 1.5] {
            let step = 1e-5;
            let slope = (felt_at_the_foot(number + step) - felt_at_the_foot(number - step)) / (2.0 * step);
            assert!((slope_at_the_foot(number) - slope).abs() < 1e-9, "{number}");
        }
    }
}
