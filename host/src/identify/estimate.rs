//! Estimating one setup's modes: shapes by modal filtering, frequency and damping from each mode's bell, and the jackknife.

mod refit;

use nalgebra::DMatrix;
use num_complex::Complex64;
use rayon::prelude::*;

use super::bell::{BellFit, DAMPING_RANGE};
use super::cluster::clusters;
use super::curve::Curve;
use super::finer;
use super::joint::{JointFit, SlopePrior};
use super::joint_fit::Certainty;
use super::matrices::{LEAST_LINES, Matrices, Source, bell};
use super::pick::Pick;
use super::plane;
use super::resonance::{Quantity, Resonance};
use super::scatter::{GroupChanges, ShapeScatter, changes, deviation, noise_outside, noise_share, student};
use super::setup_mode::{SetupMode, SetupModes, is_stuck};
use super::shape::{Shape, align, drop_scatter, modal_filter, normalise, phase_collinearity};
use super::start::{first_bell, known_bell};
use crate::spectra::{CrossSpectrum, LineGrid};
use crate::statistics::{MEDIAN_OF_ABSOLUTE, median};
use refit::Refit;

/// Rounds of shapes and bells, each with the other's result.
pub(super) const ROUNDS: usize = 4;
/// Rounds of joint fits and shapes, and steps of each fit.
const JOINT_ROUNDS: usize = 3;
const WHOLE: Effort = Effort { steps: 30, certainty: true };
/// A replicate's fit starts from the whole record's.
const REPLICATE: Effort = Effort { steps: 4, certainty: false };
/// The exponent of the force's density over frequency beforehand, beside a white one's 0: wind has -5/3, and displacements
/// taken for accelerations -4.
const ANY_SLOPE: SlopePrior = SlopePrior { mean: 0.0, std: 2.0 };
/// How much it differs from mode to mode at least, once so many modes have determined it.
const SHARED_SLOPE_STD: f64 = 0.3;
const SHARED_BY: usize = 5;
/// A mode whose bandwidth is below this many lines is left as it was found: what is fitted jointly is then the window's
/// shape, over lines that reach far from the mode.
const RESOLVED_LINES: f64 = 1.0;
/// Windows at half overlap, and lines that Hann's window joins, hold as much as this many times fewer independent ones: 2 for
/// the overlap, and what the record's ends and the window's uneven weight lose.
const OVERLAP: f64 = 2.11;
/// Modes this near to a cluster's lines are stopped by its filters.
const STOPPED_LINES: f64 = 4.0;
/// So are those whose tails there are more than this share of the cluster's own: to stop more passes more of what no filter stops
/// than it takes away.
const TAIL_SHARE: f64 = 0.1;
/// Fewer channels cannot tell close modes from noise.
pub(super) const JOINT_CHANNELS: usize = 4;
/// Neighbours that a modal filter stops, at most.
const MAX_NEIGHBOURS: usize = 4;
/// A neighbour is stopped when its response at the mode's resonance is more than this share of the mode's own, or when it is
/// no further away than this many lines.
const NEIGHBOUR_SHARE: f64 = 0.01;
const NEIGHBOUR_LINES: f64 = 3.0;
/// Half-width of the bell in lines and in bandwidths of the mode, whichever is more, and its limits in lines; the upper one is
/// that of modes whose bandwidth is a few lines.
const BELL_LINES: f64 = 5.0;
const BELL_BANDWIDTHS: f64 = 3.0;
const BELL_LIMITS: [f64; 2] = [3.0, 40.0];
const MOST_BANDWIDTHS: f64 = 3.0;
/// How far the fit may take a mode from its pick, in lines and in bandwidths together.
pub(super) const LEEWAY_LINES: f64 = 2.0;
pub(super) const LEEWAY_BANDWIDTHS: f64 = 0.5;
/// A bandwidth counts as no more than this share of the frequency there: a fit that runs away has no end of it.
const WIDEST: f64 = 0.16;

/// The running state: all modes' shapes and bells.
#[derive(Debug, Clone)]
pub(super) struct State {
    picked_hz: Vec<f64>,
    /// How far from there a mode may be whose bandwidth is next to nothing.
    picked_within_hz: Vec<f64>,
    /// Bands that the user has chosen.
    bands_hz: Vec<Option<[f64; 2]>>,
    /// Which are machines, whose sidebands are fitted by themselves.
    pub(super) is_machine: Vec<bool>,
    /// Which modes are to be estimated, with the clusters that they are in; the others stay as they are.
    pub(super) wanted: Vec<bool>,
    shapes: Vec<Shape>,
    pub(super) fits: Vec<BellFit>,
    pub(super) curves: Vec<Curve>,
    clusters: Vec<Cluster>,
    slope: SlopePrior,
}

/// Modes that are fitted together.
#[derive(Debug, Clone)]
struct Cluster {
    modes: Vec<usize>,
    fit: JointFit,
    /// How sure the likelihood is of them, where it was asked.
    certainty: Vec<Certainty>,
}

/// Rounds of modes that few channels see, once they are near their place.
const MIXED_ROUNDS: usize = 3;

/// What a joint fit is worth.
struct Effort {
    /// Steps, at most.
    steps: usize,
    /// Whether it is asked how sure the likelihood is.
    certainty: bool,
}

/// Estimates every pick in one setup (`setup` is its index among the picks' shapes) from the lines that are not `taken` by tones.
/// Modes that are narrow for these lines are estimated once more from finer ones.
pub(super) fn estimate(
    spectrum: &CrossSpectrum,
    quantity: Quantity,
    setup: usize,
    picks: &[Pick],
    taken: &[usize],
) -> SetupModes {
    let source = Source::Averages(spectrum);
    let matrices = Matrices::new(source, None, taken);
    let mut state = State::start(quantity, setup, picks, &matrices);
    // One by one, close modes would leave the place where all were seen together.
    state.wanted = picks.iter().map(|pick| !pick.is_known).collect();
    for _ in 0..ROUNDS {
        state.improve(&matrices);
    }
    state.wanted.fill(true);
    state.fit_clusters(&matrices);
    let mut modes = finer::refined(state.concluded(source, taken), spectrum, &state, taken);
    plane::widen_lone(&matrices, &mut modes[..picks.iter().filter(|pick| !pick.is_machine).count()]);
    SetupModes { modes }
}

impl State {
    fn start(quantity: Quantity, setup: usize, picks: &[Pick], matrices: &Matrices<'_>) -> Self {
        let grid = matrices.grid();
        let shapes: Vec<Shape> = picks.iter().map(|pick| pick.shapes[setup].clone()).collect();
        // Lines to the next pick.
        let apart = |line: usize| {
            let others = picks.iter().map(|other| other.line.abs_diff(line)).filter(|distance| *distance > 0);
            others.min().unwrap_or(grid.lines)
        };
        let fits = picks
            .iter()
            .zip(&shapes)
            .map(|(pick, shape)| match pick.suggested {
                Some((frequency_hz, damping_ratio)) => {
                    let resonance = Resonance { frequency_hz, damping_ratio, quantity };
                    known_bell(matrices, shape, pick.line, resonance)
                }
                None => first_bell(matrices, shape, pick.line, apart(pick.line), quantity),
            })
            .collect();
        let picked_hz = picks.iter().map(|pick| pick.frequency_hz(grid)).collect();
        let curves = vec![Curve::default(); picks.len()];
        let picked_within_hz = picks.iter().map(|pick| pick.within_lines * grid.spacing_hz()).collect();
        let wanted = vec![true; picks.len()];
        let is_machine = picks.iter().map(|pick| pick.is_machine).collect();
        Self {
            picked_hz,
            is_machine,
            wanted,
            picked_within_hz,
            bands_hz: picks.iter().map(|pick| pick.band_hz).collect(),
            shapes,
            fits,
            curves,
            clusters: Vec::new(),
            slope: ANY_SLOPE,
        }
    }

    /// What is estimated of all modes from these matrices, with the scatter from replicates that leave out a group each.
    pub(super) fn concluded(&self, source: Source<'_>, taken: &[usize]) -> Vec<SetupMode> {
        let replicate = |group: usize| {
            let mut replicate = self.clone();
            replicate.refit_clusters(&Matrices::new(source, Some(group), taken), &REPLICATE);
            replicate
        };
        let replicates: Vec<Self> = (0..source.groups()).into_par_iter().map(replicate).collect();
        let spacing_hz = source.grid().spacing_hz();
        (0..self.fits.len()).map(|mode| self.conclude(mode, &replicates, spacing_hz)).collect()
    }

    /// One round: every mode's shape with the other modes' shapes, then its bell with the other modes' bells.
    pub(super) fn improve(&mut self, matrices: &Matrices<'_>) {
        let grid = matrices.grid();
        let before = self.shapes.clone();
        let wanted: Vec<usize> = (0..self.shapes.len()).filter(|&mode| self.wanted[mode]).collect();
        for &mode in &wanted {
            let here = self.fits[mode].resonance;
            let mut stopped: Vec<&Shape> = vec![&before[mode]];
            stopped.extend(self.stopped_beside(mode, grid.spacing_hz()).iter().map(|&other| &before[other]));
            let Some(filter) = modal_filter(&stopped) else { continue };
            // Only the lines at resonance: away from it the modes' cross spectra, which the filter cannot stop, weigh more.
            let reach = (0.5 * here.bandwidth_hz() / grid.spacing_hz()).round().max(1.0) as usize;
            let centre = grid.nearest_line(here.frequency_hz);
            let mut sum: Shape = Shape::zeros(filter.len());
            let (first, last) = (centre.saturating_sub(reach), (centre + reach).min(grid.lines - 1));
            for line in matrices.free(first, last, 1) {
                sum += matrices.at(line) * &filter;
            }
            let norm = sum.norm();
            if norm.is_finite() && norm > 0.0 {
                self.shapes[mode] = sum / Complex64::from(norm);
            }
        }
        for mode in wanted {
            // What few channels cannot stop stays in the spectrum, and is fitted with the mode.
            let is_mixed = self.shapes[mode].len() < JOINT_CHANNELS;
            let stopped_beside = self.stopped_beside(mode, grid.spacing_hz());
            let neighbours = if is_mixed { self.neighbours(mode, grid.spacing_hz()) } else { stopped_beside.clone() };
            let (first, last) = self.range(mode, &neighbours, grid);
            let mut stopped: Vec<&Shape> = vec![&self.shapes[mode]];
            stopped.extend(stopped_beside.iter().map(|&other| &self.shapes[other]));
            let Some(filter) = modal_filter(&stopped) else { continue };
            let lines = matrices.free(first, last, LEAST_LINES);
            let mut bell = bell(matrices, &filter, &lines);
            bell.mixed = is_mixed.then(|| matrices.source.averages() as f64 / OVERLAP);
            let others: Vec<Resonance> = neighbours.iter().map(|&other| self.fits[other].resonance).collect();
            let here = self.fits[mode].resonance;
            if let Some(fit) = bell.fit(here, &others, self.limits_hz(mode)) {
                self.curves[mode] = Curve::of_bell(&fit, bell);
                self.fits[mode] = fit;
            }
        }
    }

    /// Fits close modes together, from what is known of them one by one. With few channels there is nothing to tell them
    /// apart by, and no cluster.
    pub(super) fn fit_clusters(&mut self, matrices: &Matrices<'_>) {
        let grid = matrices.grid();
        let channels = matrices.source.channels();
        if channels < JOINT_CHANNELS {
            return;
        }
        // Another force shakes a machine's place, and its shape is no mode's.
        // A mode with a band of its own is fitted by itself: the lines of a cluster are those of all its modes.
        let is_free = |mode: &usize| !self.is_machine[*mode] && self.bands_hz[*mode].is_none();
        let modes: Vec<usize> = (0..self.fits.len()).filter(is_free).collect();
        let resonances: Vec<Resonance> = modes.iter().map(|&mode| self.fits[mode].resonance).collect();
        let spacing_hz = grid.spacing_hz();
        let is_resolved = |mode: &usize| self.fits[*mode].resonance.bandwidth_hz() >= RESOLVED_LINES * spacing_hz;
        self.clusters = clusters(&resonances, spacing_hz, channels)
            .into_iter()
            .map(|places| places.into_iter().map(|place| modes[place]).collect::<Vec<usize>>())
            .filter(|modes| modes.iter().all(is_resolved) && modes.iter().any(|&mode| self.wanted[mode]))
            .map(|modes| {
                let fits = || modes.iter().map(|&mode| &self.fits[mode]);
                let levels = fits().map(|fit| fit.level.max(f64::MIN_POSITIVE)).collect();
                let fit = JointFit::start(fits().map(|fit| fit.resonance).collect(), levels);
                Cluster { modes, fit, certainty: Vec::new() }
            })
            .collect();
        for round in 0..JOINT_ROUNDS {
            if round + 1 == JOINT_ROUNDS {
                self.share_slope();
            }
            self.refit_clusters(matrices, &WHOLE);
        }
    }

    /// One force shakes all modes, so its colour is nearly the same at all of them: estimated from many modes together it no
    /// longer costs each mode's frequency half of its accuracy.
    fn share_slope(&mut self) {
        let mut slopes: Vec<f64> =
            self.clusters.iter().flat_map(|cluster| cluster.fit.slopes.iter().copied()).collect();
        slopes.sort_by(f64::total_cmp);
        if slopes.len() < SHARED_BY {
            return;
        }
        // Without the outermost quarters: a mode that fits badly must not decide for all.
        let middle = &slopes[slopes.len() / 4..slopes.len() - slopes.len() / 4];
        let mean = middle.iter().sum::<f64>() / middle.len() as f64;
        // Where they differ by more than they are uncertain, forces on different modes are correlated, and each mode has its own.
        let median_of = |values: &mut dyn Iterator<Item = f64>| median(&mut values.collect::<Vec<_>>()).unwrap_or(0.0);
        let scatter = median_of(&mut slopes.iter().map(|slope| (slope - mean).abs())) / MEDIAN_OF_ABSOLUTE;
        let certainties = self.clusters.iter().flat_map(|cluster| &cluster.certainty);
        let uncertain = median_of(&mut certainties.map(|certainty| certainty.slope_std));
        let own = (scatter * scatter - uncertain * uncertain).max(0.0).sqrt();
        self.slope = SlopePrior { mean, std: own.clamp(SHARED_SLOPE_STD, ANY_SLOPE.std) };
    }

    /// Goes on from an earlier joint fit of the same clusters; modes without a cluster that can be fitted go on one by one.
    fn refit_clusters(&mut self, matrices: &Matrices<'_>, effort: &Effort) {
        let before = self.clone();
        let mut failed: Vec<usize> = (0..self.fits.len())
            .filter(|&mode| self.wanted[mode] && self.clusters.iter().all(|cluster| !cluster.modes.contains(&mode)))
            .collect();
        let refit = |cluster: &Cluster| before.refit(cluster, matrices, effort);
        // One by one in replicates, which are made side by side already.
        let at_least = if matrices.is_whole() { 1 } else { self.clusters.len() };
        let refits: Vec<_> = self.clusters.par_iter().with_min_len(at_least).map(refit).collect();
        for (cluster, refit) in self.clusters.iter_mut().zip(refits) {
            let modes = &cluster.modes;
            let Some(Refit { fit, shapes, certainty, curves }) = refit else {
                cluster.certainty.clear();
                failed.extend(modes);
                continue;
            };
            let growths: Vec<f64> = shapes.iter().map(|(_, growth)| *growth).collect();
            cluster.fit = fit.unmixed(&growths);
            cluster.certainty = certainty.unwrap_or_default();
            for (((index, &mode), (shape, _)), curve) in modes.iter().enumerate().zip(shapes).zip(curves) {
                self.curves[mode] = curve;
                self.fits[mode].resonance = cluster.fit.resonances[index];
                self.fits[mode].level = cluster.fit.levels[index];
                self.shapes[mode] = shape;
            }
        }
        if !failed.is_empty() {
            let mut alone = before;
            // Few channels leave neighbours in each other's spectra, whose fits wait for each other.
            let is_mixed = matrices.source.channels() < JOINT_CHANNELS;
            for _ in 0..if is_mixed { MIXED_ROUNDS } else { 1 } {
                alone.improve(matrices);
            }
            for mode in failed {
                self.fits[mode] = alone.fits[mode].clone();
                self.shapes[mode] = alone.shapes[mode].clone();
                self.curves[mode] = alone.curves[mode].clone();
            }
        }
    }

    /// The modes that filters of a cluster stop: those that reach into its modes' bells, and those near its lines; the
    /// nearest, as many as the channels can tell apart.
    fn stopped(&self, cluster: &[usize], [lowest_hz, highest_hz]: [f64; 2], grid: &LineGrid) -> Vec<usize> {
        let spacing_hz = grid.spacing_hz();
        let outside_hz = |other: usize| self.outside_hz(other, [lowest_hz, highest_hz]);
        let mut stopped: Vec<usize> = cluster.iter().flat_map(|&mode| self.stopped_beside(mode, spacing_hz)).collect();
        let response = |mode: usize, hz: f64| {
            let fit = &self.fits[mode];
            fit.level * fit.resonance.resonant_density(hz, 1.0 / spacing_hz)
        };
        let reaches_in = |other: usize| {
            let edge_hz = self.fits[other].resonance.frequency_hz.clamp(lowest_hz, highest_hz);
            let own: f64 = cluster.iter().map(|&mode| response(mode, edge_hz)).sum();
            response(other, edge_hz) > TAIL_SHARE * own
        };
        stopped.extend(
            (0..self.fits.len()).filter(|&other| outside_hz(other) < STOPPED_LINES * spacing_hz || reaches_in(other)),
        );
        stopped.sort_by(|&a, &b| outside_hz(a).total_cmp(&outside_hz(b)).then(a.cmp(&b)));
        stopped.dedup();
        stopped.retain(|other| !cluster.contains(other));
        let channels = self.shapes.first().map_or(0, Shape::len);
        stopped.truncate((channels / 2).saturating_sub(cluster.len()));
        stopped
    }

    /// How far a mode's frequency is outside of a range.
    fn outside_hz(&self, mode: usize, [lowest_hz, highest_hz]: [f64; 2]) -> f64 {
        let hz = self.fits[mode].resonance.frequency_hz;
        (lowest_hz - hz).max(hz - highest_hz).max(0.0)
    }

    /// How far from its pick the fit may take a mode.
    fn leeway_hz(&self, mode: usize) -> f64 {
        let bandwidth_hz = self.fits[mode].resonance.bandwidth_hz().min(WIDEST * self.picked_hz[mode]);
        self.picked_within_hz[mode] + LEEWAY_BANDWIDTHS * bandwidth_hz
    }

    /// Where the fit may take a mode.
    fn limits_hz(&self, mode: usize) -> [f64; 2] {
        let leeway_hz = self.leeway_hz(mode);
        let [from, to] = self.bands_hz[mode].unwrap_or([0.0, f64::INFINITY]);
        [(self.picked_hz[mode] - leeway_hz).max(from), (self.picked_hz[mode] + leeway_hz).min(to)]
    }

    /// The modes whose bells reach into this mode's, strongest first.
    fn neighbours(&self, mode: usize, spacing_hz: f64) -> Vec<usize> {
        let here = self.fits[mode].resonance.frequency_hz;
        let response = |other: usize| {
            let fit = &self.fits[other];
            // The smooth part of far modes is left to the noise: filters that stop them too pass more of everything else.
            fit.level * fit.resonance.resonant_density(here, 1.0 / spacing_hz)
        };
        let least = NEIGHBOUR_SHARE * response(mode);
        let is_near =
            |other: usize| (self.fits[other].resonance.frequency_hz - here).abs() <= NEIGHBOUR_LINES * spacing_hz;
        let mut neighbours: Vec<usize> = (0..self.fits.len())
            .filter(|&other| other != mode && (response(other) > least || is_near(other)))
            .collect();
        neighbours.sort_by(|&a, &b| response(b).total_cmp(&response(a)));
        neighbours.truncate(MAX_NEIGHBOURS);
        neighbours
    }

    /// The neighbours that a mode's filter stops: it needs more channels than those.
    fn stopped_beside(&self, mode: usize, spacing_hz: f64) -> Vec<usize> {
        let mut neighbours = self.neighbours(mode, spacing_hz);
        neighbours.truncate(self.shapes[mode].len().saturating_sub(2));
        neighbours
    }

    /// The modes that are as close to a mode as it is wide.
    fn partners(&self, mode: usize, spacing_hz: f64) -> Vec<usize> {
        let here = self.fits[mode].resonance;
        let is_close = |other: &usize| {
            let there = self.fits[*other].resonance;
            let width_hz = here.bandwidth_hz().max(there.bandwidth_hz()).max(spacing_hz);
            *other != mode && (there.frequency_hz - here.frequency_hz).abs() < width_hz
        };
        let mut partners: Vec<usize> = (0..self.fits.len()).filter(is_close).collect();
        // In a plane that has half of the channels there is nothing to be seen outside.
        partners.truncate((self.shapes[mode].len() / 2).saturating_sub(1));
        partners
    }

    /// The lines of a mode's bell: those of the band that the user has chosen, else wide enough not to cut it, ending half-way to modes
    /// that the filter does not stop.
    fn range(&self, mode: usize, neighbours: &[usize], grid: &LineGrid) -> (usize, usize) {
        if let Some([from, to]) = self.bands_hz[mode] {
            return (grid.nearest_line(from), grid.nearest_line(to));
        }
        let spacing_hz = grid.spacing_hz();
        let here = self.fits[mode].resonance;
        let half_hz = (BELL_BANDWIDTHS * here.bandwidth_hz()).max(BELL_LINES * spacing_hz);
        let mut sides_hz = [half_hz, half_hz];
        for (other, fit) in self.fits.iter().enumerate() {
            let distance_hz = fit.resonance.frequency_hz - here.frequency_hz;
            if other != mode && !neighbours.contains(&other) {
                let side = &mut sides_hz[usize::from(distance_hz > 0.0)];
                *side = side.min(distance_hz.abs() / 2.0);
            }
        }
        // Of a mode that is damped a lot, the same number of bandwidths is more lines.
        let most =
            BELL_LIMITS[1].max(MOST_BANDWIDTHS * here.bandwidth_hz().min(WIDEST * here.frequency_hz) / spacing_hz);
        let [below, above] = sides_hz.map(|side| (side / spacing_hz).clamp(BELL_LIMITS[0], most).round() as usize);
        let centre = grid.nearest_line(here.frequency_hz);
        (centre.saturating_sub(below), (centre + above).min(grid.lines - 1))
    }

    /// A mode's estimate with its jackknife deviations.
    fn conclude(&self, mode: usize, replicates: &[Self], spacing_hz: f64) -> SetupMode {
        let mut shape = self.shapes[mode].clone();
        normalise(&mut shape);
        let aligned: Vec<Shape> = replicates
            .iter()
            .map(|replicate| {
                let mut other = replicate.shapes[mode].clone();
                align(&mut other, &shape);
                other
            })
            .collect();
        let scatter = ShapeScatter::of(shape.len(), &aligned);
        let partners: Vec<&Shape> = self.partners(mode, spacing_hz).iter().map(|&other| &self.shapes[other]).collect();
        let shape_noise = match partners.is_empty() {
            true => noise_share(&shape, &scatter.component),
            false => noise_outside(&shape, &partners, &aligned),
        };
        let collinearity = phase_collinearity(shape.as_slice());
        drop_scatter(&mut shape, &scatter.imaginary);
        let of = |value: &dyn Fn(&Self) -> f64| changes(&replicates.iter().map(value).collect::<Vec<_>>());
        let changes = GroupChanges {
            frequency_hz: of(&|state| state.fits[mode].resonance.frequency_hz),
            damping_ratio: of(&|state| state.fits[mode].resonance.damping_ratio),
            beside: DMatrix::zeros(scatter.real_changes.nrows(), 0),
            shape: scatter.real_changes,
        };
        let curve = self.curves[mode].clone();
        let misfit = curve.misfit(&replicates.iter().map(|replicate| &replicate.curves[mode]).collect::<Vec<_>>());
        let distance_hz = (self.fits[mode].resonance.frequency_hz - self.picked_hz[mode]).abs();
        let fit = &self.fits[mode];
        // The jackknife sees what the model leaves out and changes from group to group, the likelihood what is the same in all
        // groups, as the prior's part in the slope: the wider counts.
        let place = |cluster: &Cluster| cluster.modes.iter().position(|&other| other == mode);
        let of_cluster = |cluster: &Cluster| {
            let certainty = cluster.certainty.get(place(cluster)?)?;
            Some([certainty.frequency_std_hz, certainty.damping_std])
        };
        let certainty = self.clusters.iter().find_map(of_cluster).or(fit.certainty).filter(|_| !replicates.is_empty());
        let [least_std_hz, least_damping_std] = certainty.unwrap_or_default();
        // At the end of its range a fit does not move from replicate to replicate, so its scatter means nothing.
        let [least, most] = DAMPING_RANGE;
        let is_bounded = !(1.001 * least..0.999 * most).contains(&fit.resonance.damping_ratio);
        let deviation = |changes: &[f64]| if is_bounded { f64::INFINITY } else { deviation(changes) };
        SetupMode {
            // The fit's level is the power of the modal response along a shape of unit length.
            level: fit.level.max(0.0).sqrt() / shape.norm(),
            peak_density: fit.level * fit.resonance.peak_density(1.0 / spacing_hz),
            found: distance_hz < 0.96 * self.leeway_hz(mode) && !is_stuck(&fit.resonance, &changes),
            resonance: self.fits[mode].resonance,
            shape,
            frequency_std_hz: deviation(&changes.frequency_hz).max(least_std_hz),
            damping_std: deviation(&changes.damping_ratio).max(least_damping_std),
            shape_std: scatter.component.iter().map(|std| student(replicates.len()) * std).collect(),
            shape_noise,
            curve,
            misfit,
            changes,
            collinearity,
            in_plane: false,
            spacing_hz,
        }
    }
}
