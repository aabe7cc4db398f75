//! How far a model is trusted: its study's background tolerance, as sensitivities and a smooth covariance.

use nalgebra::DMatrix;

use crate::model::{BeamTable, Body, Change, Stiffness, Structure};
use crate::study::Model;

/// Segments' stiffnesses and mass as uncertain quantities.
#[derive(Debug, Clone)]
pub struct Tolerance {
    /// What each relative change of one segment's stiffnesses or mass does to K and M.
    pub(super) changes: Vec<Change>,
    /// Covariance of these relative changes, changes x changes.
    pub(crate) covariance: DMatrix<f64>,
    /// What changes of segments, each for all of them, base first: a stiffness, or the mass where it is none.
    pub(crate) quantities: Vec<Option<Stiffness>>,
}

/// Where the study gives no correlation length: this share of the structure's height.
const DEFAULT_CORRELATION: f64 = 1.0 / 6.0;
/// Stiffnesses have this part of their scatter in common: materials, and what stands on the drawings.
const IN_COMMON: f64 = 0.866;
/// What each has of its own, in shares of the tolerance. A section's bending follows from its drawing; torsion of lattices, frames and
/// thin walls is an estimate, and so is their shear. Where a structure bends, shear is what least was spent on: by formula or by unit
/// loads, which leave out how joints and ends deform, it is off by twice as much. With as much for shear as for torsion, sound lattice towers
/// of another finite element code, whose frequencies a table meets to 0.2 %, need up to 25 % more shear stiffness, and fail the test of fit.
/// Where storeys shear, their stiffness is what the study states its tolerance of. So shear has two: where all is bending, and where all
/// is shear.
const BENDING_ITS_OWN: f64 = 0.5;
const TORSION_ITS_OWN: f64 = 1.0;
const SHEAR_ITS_OWN: [f64; 2] = [2.0, 1.0];
/// Of that, what shear along each axis has of its own: as much as bending where all is bending and one formula gave both; all of it where all is
/// shear, for frames carry a building along one axis and walls along the other. With both in one, a sound shear building whose storeys were 1 %
/// softer along one axis and as the table has them along the other had a support at its foot, with 93 %.
const SHEAR_OF_AN_AXIS: [f64; 2] = [BENDING_ITS_OWN, 1.0];
/// That varies over the height as the kind of section does: over this many correlation lengths. Where storeys shear, frames, walls and what holds them
/// together vary from storey to storey, each as all of them in common do: by [`storeys`].
const OF_A_KIND: f64 = 3.0;
/// Of the variance that stiffnesses have in common, and of that of masses, this share is the whole structure's: its modulus, and the
/// loads that were estimated for all floors alike. Without it a table that is off as a whole by twice what it states is a finding.
const OF_THE_WHOLE: f64 = 0.25;
/// And this share is each segment's own: a storey that was cast later, a floor with other finishes. A smooth scatter cannot follow it, and
/// takes a segment that is off by itself for a loss, a joint or an outrigger. Geostatistics calls it the nugget (Matheron 1963,
/// "Principles of Geostatistics", Econ. Geol. 58, 1246). Of 44 sound structures that scatter up to twice as far as stated, each segment by
/// itself in a third of them, five had an effect named without these two shares and one with them.
const OF_A_SEGMENT: f64 = 0.25;

impl Tolerance {
    /// Of the segments of a beam and of groups; `None` where the study trusts its model, or the model has neither.
    pub fn of(structure: &Structure, model: &Model) -> Option<Self> {
        let segments = Self::of_segments(structure, model);
        let stds: Vec<f64> = structure.groups().map(|(_, group)| group.std).collect();
        if stds.is_empty() {
            return segments;
        }
        let mut all = segments.unwrap_or_else(|| Self {
            changes: Vec::new(),
            covariance: DMatrix::zeros(0, 0),
            quantities: Vec::new(),
        });
        all.changes.extend(structure.group_changes(&structure.assemble()));
        let first = all.covariance.nrows();
        all.covariance = all.covariance.resize(first + stds.len(), first + stds.len(), 0.0);
        for (at, std) in stds.iter().enumerate() {
            all.covariance[(first + at, first + at)] = std * std;
        }
        Some(all)
    }

    /// From `background_stiffness`, `background_mass` and `correlation_length_m` of a beam model; `None` where the study
    /// trusts its model, or the model has no segments.
    ///
    /// A relative factor a segment on each of its stiffnesses, of which one part is common to all of them and another its own, and one
    /// on its mass; Gaussian kernels over the heights of the segments' middles, beside what the whole structure and each segment have of
    /// their own.
    pub(crate) fn of_segments(structure: &Structure, model: &Model) -> Option<Self> {
        let Body::Beam(beam) = &structure.body else { return None };
        let [by_stiffness, by_mass] = deviations(model)?;
        let length_m = correlation_length_m([beam.z_base_m(), beam.z_top_m()], model);
        let has_shear = |axis: usize| beam.segments().iter().any(|segment| segment.shear_n[axis].is_some());
        let is_there = |stiffness: &Stiffness| match stiffness {
            Stiffness::Shear1 => has_shear(0),
            Stiffness::Shear2 => has_shear(1),
            _ => true,
        };
        let stiffnesses = Stiffness::ALL.into_iter().filter(|stiffness| by_stiffness > 0.0 && is_there(stiffness));
        let quantities: Vec<Option<Stiffness>> = stiffnesses.map(Some).chain((by_mass > 0.0).then_some(None)).collect();
        let segment_changes = structure.segment_changes();
        let change = |quantity: &Option<Stiffness>| -> Vec<Change> {
            let of = |change: &crate::model::SegmentChange| match quantity {
                Some(stiffness) => change.stiffness[*stiffness as usize].clone(),
                None => change.mass.clone(),
            };
            segment_changes.iter().map(of).collect()
        };
        let changes = quantities.iter().flat_map(change).collect();
        let (segments, shears) = (beam.segments().len(), share_of_shear(beam));
        let near = in_common(beam, length_m);
        let storeys = storeys(shears);
        let of_a_kind = kernel(beam, OF_A_KIND * length_m) * (1.0 - storeys) + &near * storeys;
        let mut covariance = DMatrix::zeros(segments * quantities.len(), segments * quantities.len());
        for (row, one) in quantities.iter().enumerate() {
            for (column, other) in quantities.iter().enumerate() {
                let part = match (one, other) {
                    (None, None) => &near * by_mass.powi(2),
                    (Some(one), Some(other)) => {
                        let own = of_a_kind_alone(*one, *other, shears);
                        (&near * IN_COMMON.powi(2) + &of_a_kind * own) * by_stiffness.powi(2)
                    }
                    _ => continue,
                };
                covariance.view_mut((row * segments, column * segments), (segments, segments)).copy_from(&part);
            }
        }
        Some(Self { changes, covariance, quantities })
    }
}

/// How far a structure is one of storeys, by the share of shear in how it sways: not at all where it bends more than it shears.
fn storeys(shears: f64) -> f64 {
    (2.0 * shears - 1.0).max(0.0)
}

/// What two stiffnesses of a section vary together by, beside what all have in common: a covariance, in squares of the tolerance; `shears` is the
/// share of shear in how the structure sways.
fn of_a_kind_alone(one: Stiffness, other: Stiffness, shears: f64) -> f64 {
    use Stiffness::{Bending1, Bending2, Shear1, Shear2, Torsion};
    let between = |[bends, sways]: [f64; 2]| (1.0 - shears) * bends + shears * sways;
    let shear = between(SHEAR_ITS_OWN).powi(2);
    match (one, other) {
        (Bending1, Bending1) | (Bending2, Bending2) => f64::powi(BENDING_ITS_OWN, 2),
        (Torsion, Torsion) => f64::powi(TORSION_ITS_OWN, 2),
        (Shear1, Shear1) | (Shear2, Shear2) => shear,
        (Shear1, Shear2) | (Shear2, Shear1) => shear - between(SHEAR_OF_AN_AXIS).powi(2),
        _ => 0.0,
    }
}

/// The share of shear in how far the top of a clamped beam moves under a force there, of both directions together.
fn share_of_shear(beam: &BeamTable) -> f64 {
    let z_top_m = beam.z_top_m();
    let (mut bending, mut shear) = (0.0, 0.0);
    for segment in beam.segments() {
        // The integral of the squared moment.
        let [below, above] = [z_top_m - segment.z_bottom_m, z_top_m - segment.z_top_m].map(|arm_m| arm_m.powi(3) / 3.0);
        bending += segment.bending_n_m2.iter().map(|stiffness| (below - above) / stiffness).sum::<f64>();
        shear += segment.shear_n.iter().flatten().map(|stiffness| segment.length_m() / stiffness).sum::<f64>();
    }
    shear / (shear + bending)
}

/// Standard deviations of segments' stiffness and mass that a study states; `None` where it trusts both.
fn deviations(model: &Model) -> Option<[f64; 2]> {
    let deviations = [model.background_stiffness.unwrap_or(0.0), model.background_mass.unwrap_or(0.0)];
    (deviations != [0.0; 2]).then_some(deviations)
}

/// Over which height errors go together: as a study states it, or else a share of the structure's height.
pub(crate) fn correlation_length_m([z_base_m, z_top_m]: [f64; 2], model: &Model) -> f64 {
    model.correlation_length_m.unwrap_or(DEFAULT_CORRELATION * (z_top_m - z_base_m))
}

/// Correlation between segments of what all stiffnesses, or the masses, have in common.
fn in_common(beam: &BeamTable, length_m: f64) -> DMatrix<f64> {
    let smooth = 1.0 - OF_THE_WHOLE - OF_A_SEGMENT;
    let mut correlation = (kernel(beam, length_m) * smooth).add_scalar(OF_THE_WHOLE);
    correlation.fill_diagonal(1.0);
    correlation
}

/// Correlation between segments: a Gaussian kernel over the heights of their middles.
fn kernel(beam: &BeamTable, length_m: f64) -> DMatrix<f64> {
    let middles_m: Vec<f64> =
        beam.segments().iter().map(|segment| 0.5 * (segment.z_bottom_m + segment.z_top_m)).collect();
    DMatrix::from_fn(middles_m.len(), middles_m.len(), |one, other| {
        let distance = (middles_m[one] - middles_m[other]) / length_m;
        (-0.5 * distance * distance).exp()
    })
}

/// Covariance of one relative factor a segment on all of its stiffnesses alike and of one on its mass, as a study states them: of what
/// it does not trust, stiffness first; `None` where it trusts its model.
pub(crate) fn one_factor_covariance(beam: &BeamTable, model: &Model) -> Option<DMatrix<f64>> {
    let kernel = kernel(beam, correlation_length_m([beam.z_base_m(), beam.z_top_m()], model));
    let deviations = deviations(model)?.into_iter().filter(|deviation| *deviation > 0.0);
    let parts: Vec<DMatrix<f64>> = deviations.map(|deviation| &kernel * deviation.powi(2)).collect();
    let size = kernel.nrows();
    let mut covariance = DMatrix::zeros(size * parts.len(), size * parts.len());
    for (index, part) in parts.iter().enumerate() {
        covariance.view_mut((index * size, index * size), (size, size)).copy_from(part);
    }
    Some(covariance)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn uniform(segments: usize, shear_n: f64) -> BeamTable {
        let head = "z_bottom_m,z_top_m,bending_1_n_m2,bending_2_n_m2,axis_deg,shear_n,torsion_n_m2,mass_top_kg,inertia_x_kg_m2,inertia_y_kg_m2,inertia_z_kg_m2";
        let row = |at: usize| format!("{},{},3e9,3e9,0,{shear_n},1e9,1e3,0,0,0\n", 10 * at, 10 * (at + 1));
        let rows: String = (0..segments).map(row).collect();
        BeamTable::from_reader(format!("{head}\n{rows}").as_bytes(), Path::new("beam.csv")).unwrap()
    }

    /// A study states the whole deviation of a segment. Neighbours have the smooth part in common, and all have that of the whole.
    #[test]
    fn segments_vary_as_far_as_stated_in_three_ways() {
        let correlation = in_common(&uniform(20, 1e7), 10.0);
        let smooth = 1.0 - OF_THE_WHOLE - OF_A_SEGMENT;
        let expected = [(0, 1.0), (1, OF_THE_WHOLE + smooth * (-0.5_f64).exp()), (19, OF_THE_WHOLE)];
        for (apart, expected) in expected {
            assert!((correlation[(0, apart)] - expected).abs() < 1e-9, "{apart}: {}", correlation[(0, apart)]);
        }
        assert!(correlation.cholesky().is_some());
    }

    /// Where all is shear its two axes have the material in common and no more; where all is bending, most of what one formula gave both.
    #[test]
    fn axes_share_shear_as_far_as_the_structure_bends() {
        let correlation = |shears: f64| {
            let own = |other: Stiffness| of_a_kind_alone(Stiffness::Shear1, other, shears);
            (IN_COMMON.powi(2) + own(Stiffness::Shear2)) / (IN_COMMON.powi(2) + own(Stiffness::Shear1))
        };
        assert!((correlation(1.0) - 0.75 / 1.75).abs() < 1e-3, "{}", correlation(1.0));
        assert!((correlation(0.0) - 4.5 / 4.75).abs() < 1e-3, "{}", correlation(0.0));
        assert!((0..10).all(|tenths| correlation(0.1 * f64::from(tenths)) > correlation(0.1 * f64::from(tenths + 1))));
    }

    /// A uniform cantilever: `H³ / 3 EI` against `H / GA`.
    #[test]
    fn shear_has_its_share_of_a_uniform_beam() {
        let share = |shear_n: f64| share_of_shear(&uniform(3, shear_n));
        // 3e-6 m/N by bending, and as much by shear.
        assert!((share(1e7) - 0.5).abs() < 1e-9, "{}", share(1e7));
        assert!(share(1e4) > 0.99 && share(1e10) < 0.01);
    }
}
