//! Which poles are modes: those that return from order to order.
//!
//! A sub-band's subspace flows in. Poles of all orders are screened, linked from order to order to clusters (the automatic
//! stabilisation diagram of Reynders, Houbrechts and De Roeck 2012), and each cluster that lasts gives one pole with its
//! uncertainty, at the order where that is least. All poles of the diagram and the stable ones flow out.

use std::cell::OnceCell;
use std::f64::consts::TAU;

use super::DiagramPole;
use super::covariance::{Covariances, Reading, SubBand};
use super::subspace::{Model, Subspace};
use super::uncertainty::{Change, Moved};
use crate::identify::scatter::{ShapeScatter, jackknife, noise_share};
use crate::identify::shape::{Shape, mac, normalise};
use crate::spectra::CrossSpectrum;
use crate::statistics::median;

/// Shares of the lags that are analysed, and the fewest lags.
const SHARES_OF_LAGS: [f64; 2] = [1.0, 0.5];
const LEAST_LAGS: usize = 6;
/// A mode of a structure has a damping ratio in this range.
const DAMPING_RANGE: [f64; 2] = [1e-5, 0.2];
/// Two poles of successive orders are one where they differ by less than these shares of the bandwidth and of the line spacing...
const SAME_OF_BANDWIDTH: f64 = 0.15;
const SAME_OF_LINE: f64 = 0.1;
/// ...in frequency, twice as much in bandwidth, and are as alike in shape as this.
const SAME_MAC: f64 = 0.9;
/// A cluster may miss an order.
const MOST_MISSED: usize = 1;
/// Orders that a stable cluster lasts.
const LEAST_ORDERS: usize = 4;
/// Orders at which a cluster is estimated with its uncertainty, at most.
const MOST_ESTIMATES: usize = 6;
/// An estimate agrees with the median of its cluster within so many of its standard deviations.
const AGREES: f64 = 0.5;
/// A stable pole's standard deviations: of the frequency in line spacings and bandwidths together, of the damping ratio as a share
/// of it, of the shape as a share of its length.
const MOST_FREQUENCY_STD: f64 = 0.25;
const MOST_DAMPING_STD: f64 = 0.6;
const MOST_SHAPE_STD: f64 = 0.5;

/// A pole that is stable.
#[derive(Debug, Clone)]
pub(super) struct StablePole {
    /// The order of its estimate, and all orders that show it.
    pub(super) order: usize,
    pub(super) orders: Vec<usize>,
    pub(super) frequency_hz: f64,
    pub(super) frequency_std_hz: f64,
    pub(super) damping_ratio: f64,
    pub(super) damping_ratio_std: f64,
    /// Shape at the setup's channels, largest component 1.
    pub(super) shape: Shape,
    pub(super) shape_std: Vec<f64>,
    /// Mean square of its response, all channels together.
    pub(super) power: f64,
    /// How much of the response at its frequency it explains; not known before all sub-bands are.
    pub(super) share: f64,
}

/// What a sub-band holds.
#[derive(Debug, Clone, Default)]
pub(super) struct Diagram {
    pub(super) dots: Vec<DiagramPole>,
    pub(super) poles: Vec<StablePole>,
}

/// A pole of some order.
#[derive(Debug, Clone)]
struct Candidate {
    order: usize,
    /// Its place in the model.
    place: usize,
    frequency_hz: f64,
    bandwidth_hz: f64,
    damping_ratio: f64,
    shape: Shape,
}

/// Frequency in Hz and damping ratio of a pole in 1/s, both as exact as the pole: its magnitude and its lean.
fn modal(pole: num_complex::Complex64) -> (f64, f64) {
    (pole.norm() / TAU, -pole.re / pole.norm())
}

/// Analyses a sub-band: all its lags, for modes of long memory, and the first of them, for those whose covariances die out
/// earlier and leave only noise in the later ones.
pub(super) fn analyse(spectrum: &CrossSpectrum, band: SubBand) -> Diagram {
    let Some((reading, covariances)) = Reading::new(spectrum, band) else { return Diagram::default() };
    let mut diagram = Diagram::default();
    let groups = OnceCell::new();
    for share in SHARES_OF_LAGS {
        let lags = (share * covariances.lags() as f64).round() as usize;
        let part =
            Part { spectrum, band: &band, reading: &reading, covariances: covariances.first(lags), groups: &groups };
        part.analyse(&mut diagram);
    }
    diagram
}

/// Some lags of a sub-band.
struct Part<'a> {
    spectrum: &'a CrossSpectrum,
    band: &'a SubBand,
    reading: &'a Reading,
    covariances: Covariances,
    /// All lags without each group of windows, once a cluster asks for its uncertainty.
    groups: &'a OnceCell<Vec<Covariances>>,
}

impl Part<'_> {
    fn analyse(&self, diagram: &mut Diagram) {
        if self.covariances.lags() < LEAST_LAGS {
            return;
        }
        let Some(subspace) = Subspace::of(&self.covariances) else { return };
        let models: Vec<Model> = (1..=subspace.most_orders()).filter_map(|order| subspace.model(order)).collect();
        let spacing_hz = self.spectrum.grid().spacing_hz();
        let mut clusters: Vec<Vec<Candidate>> = Vec::new();
        let mut dots = Vec::new();
        for model in &models {
            let candidates = candidates(model, self.reading, self.band);
            dots.extend(candidates.iter().map(|pole| DiagramPole {
                order: pole.order,
                frequency_hz: pole.frequency_hz,
                damping_ratio: pole.damping_ratio,
            }));
            link(&mut clusters, candidates, spacing_hz);
        }
        // The diagram shows one choice of lags.
        if diagram.dots.is_empty() {
            diagram.dots = dots;
        }
        clusters.retain(|cluster| cluster.len() >= LEAST_ORDERS);
        if clusters.is_empty() {
            return;
        }
        let changes = self.changes(&subspace);
        let estimated: Vec<Vec<&Candidate>> = clusters.iter().map(|cluster| spread(cluster)).collect();
        let is_needed = |order: usize| estimated.iter().flatten().any(|pole| pole.order == order);
        let moved: Vec<(&Model, Vec<Moved>)> = models
            .iter()
            .filter(|model| is_needed(model.order))
            .map(|model| (model, changes.iter().map(|change| change.of(&subspace, model)).collect()))
            .collect();
        diagram.poles.extend(clusters.iter().zip(&estimated).filter_map(|(cluster, estimated)| {
            let estimates = estimated.iter().filter_map(|pole| {
                let (model, moved) = moved.iter().find(|(model, _)| model.order == pole.order)?;
                Some(estimate(pole, cluster, self.reading, &subspace, model, moved))
            });
            let determined: Vec<StablePole> = estimates.filter(|pole| is_determined(pole, spacing_hz)).collect();
            best(determined)
        }));
    }

    /// What leaving out each group of windows does to the covariances; nothing is known of uncertainty with fewer than two.
    fn changes(&self, subspace: &Subspace) -> Vec<Change> {
        let groups = self.groups.get_or_init(|| {
            let count = if self.spectrum.group_count() > 1 { self.spectrum.group_count() } else { 0 };
            (0..count).map(|group| self.reading.without(self.spectrum, group)).collect()
        });
        let lags = self.covariances.lags();
        groups.iter().map(|without| Change::new(subspace, &self.covariances, &without.first(lags))).collect()
    }
}

impl StablePole {
    /// How uncertain it is, to be held against another estimate of the same mode.
    pub(super) fn doubt(&self) -> f64 {
        self.frequency_std_hz * self.damping_ratio_std
    }
}

/// The poles of a model that could be modes in the middle of the sub-band.
fn candidates(model: &Model, reading: &Reading, band: &SubBand) -> Vec<Candidate> {
    let candidate = |place: usize| {
        let (frequency_hz, damping_ratio) = modal(reading.pole(model.poles[place]));
        let bandwidth_hz = 2.0 * damping_ratio * frequency_hz;
        let is_within = |value: f64, [least, most]: [f64; 2]| value >= least && value <= most;
        let is_mode = is_within(damping_ratio, DAMPING_RANGE)
            && is_within(frequency_hz, band.middle_hz)
            && is_within(bandwidth_hz, band.bandwidths_hz);
        is_mode.then(|| Candidate {
            order: model.order,
            place,
            frequency_hz,
            bandwidth_hz,
            damping_ratio,
            shape: model.shape(place),
        })
    };
    (0..model.order).filter_map(candidate).collect()
}

/// Adds an order's poles to the clusters that they continue, nearest first; those left over begin clusters of their own.
fn link(clusters: &mut Vec<Vec<Candidate>>, candidates: Vec<Candidate>, spacing_hz: f64) {
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (at, cluster) in clusters.iter().enumerate() {
        let Some(last) = cluster.last() else { continue };
        for (index, candidate) in candidates.iter().enumerate() {
            let distance = distance(last, candidate, spacing_hz);
            if candidate.order <= last.order + 1 + MOST_MISSED && distance < 1.0 {
                pairs.push((distance, at, index));
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut left: Vec<Option<Candidate>> = candidates.into_iter().map(Some).collect();
    let mut is_continued = vec![false; clusters.len()];
    for (_, cluster, index) in pairs {
        if !is_continued[cluster]
            && let Some(candidate) = left[index].take()
        {
            clusters[cluster].push(candidate);
            is_continued[cluster] = true;
        }
    }
    clusters.extend(left.into_iter().flatten().map(|candidate| vec![candidate]));
}

/// How far two poles are from being one mode; below 1 they are.
fn distance(a: &Candidate, b: &Candidate, spacing_hz: f64) -> f64 {
    let leeway_hz = SAME_OF_BANDWIDTH * a.bandwidth_hz.max(b.bandwidth_hz) + SAME_OF_LINE * spacing_hz;
    let frequency = (a.frequency_hz - b.frequency_hz).abs() / leeway_hz;
    let bandwidth = (a.bandwidth_hz - b.bandwidth_hz).abs() / (2.0 * leeway_hz);
    let shape = (1.0 - mac(&a.shape, &b.shape)) / (1.0 - SAME_MAC);
    frequency.max(bandwidth).max(shape)
}

/// Poles of a cluster at orders far from one another, as many as are estimated with their uncertainty.
fn spread(cluster: &[Candidate]) -> Vec<&Candidate> {
    let count = cluster.len().min(MOST_ESTIMATES);
    (0..count).map(|index| &cluster[index * (cluster.len() - 1) / (count - 1).max(1)]).collect()
}

/// A cluster's estimate at the order of one of its poles.
fn estimate(
    pole: &Candidate,
    cluster: &[Candidate],
    reading: &Reading,
    subspace: &Subspace,
    model: &Model,
    moved: &[Moved],
) -> StablePole {
    let continuous = reading.pole(model.poles[pole.place]);
    let (magnitude, zeta) = (continuous.norm(), pole.damping_ratio);
    let slopes = moved.iter().map(|moved| {
        let change = reading.pole_change(model.poles[pole.place], moved.poles[pole.place]);
        // Of the magnitude |s|, and of -Re s / |s|.
        let growth = (continuous.conj() * change).re / magnitude;
        (growth / TAU, (-change.re - zeta * growth) / magnitude)
    });
    let (frequencies, dampings): (Vec<f64>, Vec<f64>) = slopes.unzip();
    let raw = model.shape(pole.place);
    let mut shape = raw.clone();
    normalise(&mut shape);
    let scale = raw.dotc(&shape) / raw.norm_squared();
    let shapes: Vec<Shape> = moved.iter().map(|moved| moved.shape(model, pole.place) * scale).collect();
    let shape_std = ShapeScatter::of(shape.len(), &shapes).component;
    StablePole {
        order: pole.order,
        orders: cluster.iter().map(|pole| pole.order).collect(),
        frequency_hz: pole.frequency_hz,
        frequency_std_hz: jackknife(&frequencies),
        damping_ratio: zeta,
        damping_ratio_std: jackknife(&dampings),
        shape,
        shape_std,
        power: reading.variance(subspace.part(model, pole.place), model.poles[pole.place]),
        share: 0.0,
    }
}

/// The surest of a cluster's estimates, of those that agree with most of them: the lowest orders, which have no pole for some
/// neighbour, are sure of a wrong value.
fn best(estimates: Vec<StablePole>) -> Option<StablePole> {
    let middle =
        |of: fn(&StablePole) -> f64| median(&mut estimates.iter().map(of).collect::<Vec<_>>()).unwrap_or(f64::NAN);
    let frequency_hz = middle(|pole| pole.frequency_hz);
    let damping_ratio = middle(|pole| pole.damping_ratio);
    let distance = |pole: &StablePole| {
        let frequency = (pole.frequency_hz - frequency_hz).abs() / pole.frequency_std_hz;
        frequency.max((pole.damping_ratio - damping_ratio).abs() / pole.damping_ratio_std)
    };
    // What the median itself is off is left to it.
    let rank = |pole: &StablePole| ((distance(pole) / AGREES).max(1.0), pole.doubt());
    let (ranks, poles): (Vec<_>, Vec<_>) = estimates.iter().map(|pole| (rank(pole), pole)).unzip();
    let compare = |&a: &usize, &b: &usize| ranks[a].0.total_cmp(&ranks[b].0).then(ranks[a].1.total_cmp(&ranks[b].1));
    let best = (0..poles.len()).min_by(compare)?;
    Some(poles[best].clone())
}

/// Whether the data determine a pole, as far as its uncertainty is known.
fn is_determined(pole: &StablePole, spacing_hz: f64) -> bool {
    let bandwidth_hz = 2.0 * pole.damping_ratio * pole.frequency_hz;
    [
        pole.frequency_std_hz / (MOST_FREQUENCY_STD * (spacing_hz + bandwidth_hz)),
        pole.damping_ratio_std / (MOST_DAMPING_STD * pole.damping_ratio),
        noise_share(&pole.shape, &pole.shape_std) / MOST_SHAPE_STD,
    ]
    .iter()
    .all(|doubt| !doubt.is_finite() || *doubt < 1.0)
}
