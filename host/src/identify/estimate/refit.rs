//! One cluster's joint fit, from what is known of all modes.
//!
//! The lines of the cluster's bells flow in, through filters that stop the modes beside it; its modes, fitted together, their shapes
//! and curves flow out.

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::{Cluster, Effort, OVERLAP, State};
use crate::identify::cluster::{Filters, noise_variance, regressed_shapes, seen};
use crate::identify::curve::Curve;
use crate::identify::joint::JointFit;
use crate::identify::joint_fit::Certainty;
use crate::identify::matrices::{LEAST_LINES, Matrices};
use crate::identify::residue::{Beside, residues};
use crate::identify::shape::{Shape, of_unit_length};

/// A mode whose distance from a cluster's lines is below this share of their width is not smooth there.
const BESIDE: f64 = 0.5;

/// What a fit gives of a cluster; the lists in the order of its modes.
pub(super) struct Refit {
    pub(super) fit: JointFit,
    /// Shapes of unit length, with the factors on the levels that go with them.
    pub(super) shapes: Vec<(Shape, f64)>,
    /// How sure the likelihood is, where it was asked and has an answer.
    pub(super) certainty: Option<Vec<Certainty>>,
    pub(super) curves: Vec<Curve>,
}

impl State {
    /// Fits a cluster's modes together once more, from their last fit. `None` where that is not possible.
    pub(super) fn refit(&self, cluster: &Cluster, matrices: &Matrices<'_>, effort: &Effort) -> Option<Refit> {
        let grid = matrices.grid();
        let modes = &cluster.modes;
        let ranges = modes.iter().map(|&mode| {
            let inside: Vec<usize> = modes.iter().copied().filter(|&other| other != mode).collect();
            self.range(mode, &inside, grid)
        });
        let (first, last) = ranges.fold((usize::MAX, 0), |(a, b), (first, last)| (a.min(first), b.max(last)));
        let range_hz = [grid.frequency_hz(first), grid.frequency_hz(last)];
        let stopped = self.stopped(modes, range_hz, grid);
        let own: Vec<&Shape> = modes.iter().map(|&mode| &self.shapes[mode]).collect();
        let others: Vec<&Shape> = stopped.iter().map(|&mode| &self.shapes[mode]).collect();
        let free = matrices.free(first, last, LEAST_LINES);
        let lines: Vec<&DMatrix<Complex64>> = free.iter().map(|&line| matrices.at(line)).collect();
        let all: Vec<&Shape> = own.iter().chain(&others).copied().collect();
        let noise = noise_variance(&all, &lines);
        let filters = Filters::new(&own, &others, noise)?;
        let frequency_hz = free.iter().map(|&line| grid.frequency_hz(line)).collect();
        let averages = matrices.source.averages() as f64 / OVERLAP;
        let seen = seen(&filters, &lines, frequency_hz, 1.0 / grid.spacing_hz(), averages, self.slope);
        let limits: Vec<[f64; 2]> = modes.iter().map(|&mode| self.limits_hz(mode)).collect();
        let fit = cluster.fit.fit(&seen, &limits, effort.steps)?;
        let certainty = if effort.certainty { fit.certainty(&seen) } else { None };
        let spectra = fit.modal_spectra(&seen.frequency_hz, seen.duration_s);
        let expected = fit.expected(&spectra, &seen);
        let of_curves = effort.certainty.then_some([spectra.as_slice(), expected.as_slice()]);
        let curves: Vec<Curve> = (0..modes.len()).map(|place| Curve::of_joint(&seen, of_curves, place)).collect();
        let width_hz = range_hz[1] - range_hz[0];
        let is_near = |other: &&usize| self.outside_hz(**other, range_hz) < BESIDE * width_hz;
        let beside: Vec<Beside> = stopped
            .iter()
            .filter(is_near)
            .map(|&other| Beside { resonance: self.fits[other].resonance, level: self.fits[other].level })
            .collect();
        let shapes = match residues(&fit, &filters.rows, &beside, noise, &seen, &expected, &lines) {
            Some(shapes) => shapes.into_iter().map(of_unit_length).collect::<Option<Vec<_>>>()?,
            None => regressed_shapes(&fit, &filters, &seen, &lines)?,
        };
        Some(Refit { fit, shapes, certainty, curves })
    }
}
