//! Picking modes: peaks of the pooled first singular value, then what is left when the modes found are taken out.
//!
//! All setups are picked together: their first singular values are averaged as logarithms, so that every mode exists in
//! every setup and no strong setup drowns a weak one. A peak counts as a mode when
//! - it stands out of its surroundings by more than the scatter of averaged spectra explains ([`PROMINENCE_SIGMAS`]),
//! - it is above the largest singular value that noise alone would give ([`noise_edge`]),
//! - neighbouring lines move in its shape (modal coherence) and no earlier pick has its shape within its modal domain
//!   (Brincker, Andersen, Jacobsen 2007).
//!
//! Close modes hide below a stronger one's bell. So the picked shapes near by are projected out of the matrices, and the
//! first singular value of what remains is searched in the same way.

use std::cell::OnceCell;
use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use rayon::prelude::*;

use super::Suggestion;
use super::estimate::LEEWAY_LINES;
use super::kurtosis::{Kurtosis, kurtosis};
use super::matrices::Source;
use super::setup::MeasuredSetup;
use super::shape::{Shape, filtered, mac};
use super::singular::{Leading, NOISE_EDGE_CHANNELS, SingularValues, edge_over_density, leading, noise_edge};
use crate::spectra::{LineGrid, around};

/// How many standard deviations (of the difference of two pooled log spectra) a peak must stand out by.
const PROMINENCE_SIGMAS: f64 = 4.0;
/// The same with so few channels that nothing else separates noise from modes.
const PROMINENCE_SIGMAS_ALONE: f64 = 5.0;
/// How far a peak must be above the noise's largest singular value.
pub(super) const NOISE_FACTOR: f64 = 2.0;
/// What is left below a mode must be at least this share of the mode itself: smaller remains can be its own distortion.
const LEAST_REMAINS: f64 = 1e-2;
/// A peak is so many standard deviations above what lies about it. Noise moves most as its own peak does, so that this alone lets more of it
/// pass than a normal variable's tail; with the other tests none of 500 records of noise has a mode (`studies records --case still`).
const CHANCE_SIGMAS: f64 = 5.0;
/// Lines of a peak that are looked at together, at most.
const WIDEST_PEAK: usize = 64;
/// So many neighbouring lines of Hann's window hold as much as one: squares of their correlations, 2/3 and 1/6, on either side.
const JOINED_LINES: f64 = 1.94;
/// MAC above which neighbouring lines count as moving alike.
const COHERENT: f64 = 0.8;
/// Two directions count as a pair where the second singular value is this share of the first, and there are channels enough for a
/// plane to be seldom met by chance.
pub(super) const PAIR_SHARE: f64 = 0.1;
pub(super) const PAIR_CHANNELS: usize = 6;
/// MAC above which a peak belongs to a mode picked already, when it is within that mode's domain.
const SAME_MODE: f64 = 0.8;
/// A mode's domain to either side: this many lines or this share of its frequency (a dozen bandwidths of a structure of
/// little damping), whichever is more.
const DOMAIN_LINES: usize = 16;
const DOMAIN_SHARE: f64 = 0.06;
/// Lines that the band's edge hides.
const EDGE_LINES: usize = 2;
/// Modes looked for below one another.
const MAX_LAYERS: usize = 4;
/// Increase of a log spectrum's variance by 50 % overlap of Hann windows (Welch 1967).
pub(super) const OVERLAP_VARIANCE: f64 = 1.06;
/// A mode (or harmonic) found.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Pick {
    /// Index of its line.
    pub(super) line: usize,
    /// Its shape in every setup, of unit length; the start for what follows.
    pub(super) shapes: Vec<Shape>,
    /// Kurtosis of the response at the line.
    pub(super) kurtosis: Kurtosis,
    /// Whether the user asked for it: it then stays, whatever the data say.
    pub(super) by_user: bool,
    /// Frequency in Hz and damping ratio, where another method suggests the mode.
    pub(super) suggested: Option<(f64, f64)>,
    /// Whether the suggestion has seen all modes about, so that a joint fit may start from it.
    pub(super) is_known: bool,
    /// Whether it is one of two in a plane of which the record need not tell the directions.
    pub(super) is_twin: bool,
    /// Whether another method was asked, and does not have the mode.
    pub(super) unseen: bool,
    /// How far from the pick a mode may be whose bandwidth is next to nothing, in lines.
    pub(super) within_lines: f64,
    /// Whether it is no mode but a machine, fitted beside the modes that its sidebands reach.
    pub(super) is_machine: bool,
    /// The band that the user has chosen for its fit.
    pub(super) band_hz: Option<[f64; 2]>,
    /// The frequency at which the user has asked for it.
    pub(super) asked_hz: Option<f64>,
}

impl Pick {
    /// A mode at a line, of which nothing else is known.
    pub(super) fn new(line: usize, shapes: Vec<Shape>) -> Self {
        Self {
            line,
            shapes,
            kurtosis: Kurtosis::OF_A_MODE,
            by_user: false,
            suggested: None,
            is_known: false,
            is_twin: false,
            unseen: false,
            within_lines: LEEWAY_LINES,
            is_machine: false,
            band_hz: None,
            asked_hz: None,
        }
    }

    /// Where it is in Hz.
    pub(super) fn frequency_hz(&self, grid: &LineGrid) -> f64 {
        self.suggested.map_or_else(|| grid.frequency_hz(self.line), |(frequency_hz, _)| frequency_hz)
    }

    /// Whether it is so far from a mode's kurtosis that nothing else need be known.
    pub(super) fn is_harmonics(&self) -> bool {
        self.kurtosis.is_harmonics()
    }
}

/// Finds modes and harmonics, lowest first.
pub(super) fn pick(grid: &LineGrid, measured: &[MeasuredSetup<'_>], singular: &[SingularValues]) -> Vec<Pick> {
    let mut picks = peaks(&sources(measured), singular, 0..grid.lines);
    for pick in &mut picks {
        pick.kurtosis = kurtosis(measured, pick);
    }
    picks
}

/// Where the setups' matrices come from, unless they have finer lines.
pub(super) fn sources<'a>(measured: &'a [MeasuredSetup<'_>]) -> Vec<Source<'a>> {
    measured.iter().map(|m| Source::Averages(&m.spectrum)).collect()
}

/// The peaks of these lines that pass for modes, lowest first; `singular` has these lines at least.
pub(super) fn peaks(sources: &[Source<'_>], singular: &[SingularValues], lines: Range<usize>) -> Vec<Pick> {
    let Some(grid) = sources.first().map(Source::grid) else { return Vec::new() };
    let prominence = prominence(sources);
    let whole = Layer::new(sources, singular, &[], lines.clone());
    let mut picks = whole.modes(prominence, 1);
    // Below each mode, with the modes around it taken out, until nothing more is found.
    let mut next = 0;
    while next < picks.len() {
        let centre = picks[next].line;
        for _ in 0..MAX_LAYERS {
            let domain = domain_lines(grid, centre);
            let near: Vec<&Pick> = picks.iter().filter(|pick| pick.line.abs_diff(centre) <= 2 * domain).collect();
            if 2 * near.len() > least_channels(sources) {
                break;
            }
            let region = around(centre, domain, grid.lines);
            let region = region.start.max(lines.start)..region.end.min(lines.end);
            let below = Layer::new(sources, singular, &near, region);
            let found = below
                .modes(prominence, 2)
                .into_iter()
                .find(|pick| !near.iter().any(|other| is_same(grid, pick, other)));
            let Some(found) = found else { break };
            picks.push(found);
        }
        next += 1;
    }
    picks.sort_by_key(|pick| pick.line);
    picks
}

/// Channels of the setup that has fewest.
fn least_channels(sources: &[Source<'_>]) -> usize {
    sources.iter().map(Source::channels).min().unwrap_or(0)
}

/// The pick of a mode that another method suggests.
pub(super) fn suggested(grid: &LineGrid, measured: &[MeasuredSetup<'_>], suggestion: &Suggestion) -> Pick {
    let mut pick = Pick {
        suggested: Some((suggestion.frequency_hz, suggestion.damping_ratio)),
        ..Pick::new(grid.nearest_line(suggestion.frequency_hz), suggestion.shapes.clone())
    };
    pick.kurtosis = kurtosis(measured, &pick);
    pick
}

/// The highest point within `leeway_hz` of a frequency of what is left when the other picks near by are taken out, and
/// whether it would pass for a mode by itself.
pub(super) fn peak_near(
    grid: &LineGrid,
    measured: &[MeasuredSetup<'_>],
    singular: &[SingularValues],
    picks: &[Pick],
    frequency_hz: f64,
    leeway_hz: f64,
) -> (Pick, bool) {
    let centre = grid.nearest_line(frequency_hz);
    let domain = domain_lines(grid, centre);
    let sources = sources(measured);
    let mut near: Vec<&Pick> = picks.iter().filter(|pick| pick.line.abs_diff(centre) <= 2 * domain).collect();
    near.sort_by_key(|pick| pick.line.abs_diff(centre));
    near.truncate(least_channels(&sources) / 2);
    let region = around(centre, domain, grid.lines);
    let layer = Layer::new(&sources, singular, &near, region.clone());
    let reach = (leeway_hz / grid.spacing_hz()).round().max(1.0) as usize;
    let highest = region
        .filter(|line| line.abs_diff(centre) <= reach)
        .map(|line| line - layer.first_line)
        .max_by(|&a, &b| layer.log_first[a].total_cmp(&layer.log_first[b]))
        .unwrap_or(0);
    let pick = Pick { by_user: true, ..layer.pick(highest) };
    let stands_out = layer.modes(prominence(&sources), 1).iter().any(|mode| mode.line == pick.line);
    (pick, stands_out)
}

/// How far a peak must stand out, in ln density.
fn prominence(sources: &[Source<'_>]) -> f64 {
    let averages: usize = sources.iter().map(Source::averages).sum();
    let tells_noise = sources.iter().all(|source| source.channels() >= NOISE_EDGE_CHANNELS);
    let sigmas = if tells_noise { PROMINENCE_SIGMAS } else { PROMINENCE_SIGMAS_ALONE };
    sigmas * scatter(averages)
}

/// Standard deviation of the difference of two log spectra of so many averages.
fn scatter(averages: usize) -> f64 {
    (2.0 * OVERLAP_VARIANCE / averages.max(1) as f64).sqrt()
}

/// Peaks of a log spectrum that stand out of their surroundings by so much: how far each does, and its index.
fn prominent(curve: &[f64], prominence: f64) -> impl Iterator<Item = (f64, usize)> {
    (EDGE_LINES..curve.len().saturating_sub(EDGE_LINES))
        .filter(|&line| curve[line] > curve[line - 1] && curve[line] >= curve[line + 1])
        .map(|line| (curve[line] - saddle(curve, line), line))
        .filter(move |&(height, _)| height >= prominence)
}

/// Indices of the peaks of a spectrum of so many averages that stand out of their surroundings by more than averages scatter, whatever else
/// they may be.
pub(crate) fn peaks_of(spectrum: &[f64], averages: usize) -> Vec<usize> {
    let log: Vec<f64> = spectrum.iter().map(|value| value.max(f64::MIN_POSITIVE).ln()).collect();
    prominent(&log, PROMINENCE_SIGMAS * scatter(averages)).map(|(_, line)| line).collect()
}

/// A mode's domain in lines to either side.
pub(super) fn domain_lines(grid: &LineGrid, line: usize) -> usize {
    DOMAIN_LINES.max((DOMAIN_SHARE * grid.frequency_hz(line) / grid.spacing_hz()).ceil() as usize)
}

/// Whether two picks are one mode: alike in shape, pooled over the setups, and within each other's domain.
fn is_same(grid: &LineGrid, a: &Pick, b: &Pick) -> bool {
    a.line.abs_diff(b.line) <= domain_lines(grid, b.line) && pooled_mac(&a.shapes, &b.shapes) > SAME_MODE
}

fn pooled_mac(a: &[Shape], b: &[Shape]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| mac(a, b)).sum();
    sum / a.len().max(1) as f64
}

/// The pooled spectrum of some lines, with some picks taken out.
struct Layer<'a> {
    sources: &'a [Source<'a>],
    /// The whole matrices' decomposition.
    singular: &'a [SingularValues],
    first_line: usize,
    /// One decomposition a line and setup: `lines[line][setup]`.
    lines: Vec<Vec<Leading>>,
    /// Mean over setups of ln of the first singular value.
    log_first: Vec<f64>,
    /// The same before anything was taken out.
    log_original: Vec<f64>,
    /// Mean over setups of ln of the level noise alone would reach.
    log_edge: Vec<Option<f64>>,
}

impl<'a> Layer<'a> {
    fn new(sources: &'a [Source<'a>], singular: &'a [SingularValues], out: &[&Pick], region: Range<usize>) -> Self {
        let setups = sources.len().max(1) as f64;
        let mean_log =
            |values: &mut dyn Iterator<Item = f64>| values.map(|v| v.max(f64::MIN_POSITIVE).ln()).sum::<f64>() / setups;
        let mut layer = Self {
            sources,
            singular,
            first_line: region.start,
            lines: Vec::with_capacity(region.len()),
            log_first: Vec::new(),
            log_original: Vec::new(),
            log_edge: Vec::new(),
        };
        let decomposed = |line: usize| -> Vec<Leading> {
            let each = sources.iter().zip(singular).enumerate();
            each.map(|(setup, (source, singular))| {
                if out.is_empty() {
                    singular.at(line).clone()
                } else {
                    let shapes: Vec<&Shape> = out.iter().map(|pick| &pick.shapes[setup]).collect();
                    leading(projected(source.matrix(line, None), &shapes))
                }
            })
            .collect()
        };
        let decomposed: Vec<Vec<Leading>> = region.clone().into_par_iter().map(decomposed).collect();
        for (line, decompositions) in region.zip(decomposed) {
            layer.log_first.push(mean_log(&mut decompositions.iter().map(|d| d.value)));
            layer.log_original.push(mean_log(&mut singular.iter().map(|s| s.at(line).value)));
            let edges: Option<Vec<f64>> = decompositions
                .iter()
                .zip(sources)
                .map(|(d, source)| noise_edge(&d.values, out.len(), source.averages()))
                .collect();
            layer.log_edge.push(edges.map(|edges| mean_log(&mut edges.into_iter())));
            layer.lines.push(decompositions);
        }
        layer
    }

    /// The modes in these lines: peaks of sufficient prominence (in ln density) that are significant, and coherent with at
    /// least `sides` of their neighbouring lines; most prominent first.
    fn modes(&self, prominence: f64, sides: usize) -> Vec<Pick> {
        let mut peaks: Vec<(f64, usize)> = prominent(&self.log_first, prominence)
            .filter(|&(_, line)| {
                self.is_significant(line)
                    && self.coherence(line, sides) >= COHERENT
                    && self.is_above_own_noise(line)
                    && self.is_beyond_chance(line)
            })
            .collect();
        peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
        peaks.into_iter().map(|(_, line)| self.pick(line)).collect()
    }

    fn is_significant(&self, line: usize) -> bool {
        let above_noise = self.log_edge[line].is_none_or(|edge| self.log_first[line] >= edge + NOISE_FACTOR.ln());
        above_noise && self.log_first[line] >= self.log_original[line] + LEAST_REMAINS.ln()
    }

    /// Whether a line is above the noise of the channels that move there: where channels have noise of different size, the largest one's is
    /// always far above the mean of all.
    fn is_above_own_noise(&self, line: usize) -> bool {
        let excess = |((here, source), singular): ((&Leading, &Source<'_>), &SingularValues)| -> Option<f64> {
            let whole = self.first_line + line;
            let near = around(whole, domain_lines(source.grid(), whole), source.grid().lines);
            let noise = singular.noise(near, source.averages()).filter(|noise| noise.len() >= NOISE_EDGE_CHANNELS)?;
            let density: f64 = here.vector.iter().zip(&noise).map(|(part, noise)| part.norm_sqr() * noise).sum();
            Some((here.value / (density * edge_over_density(noise.len(), source.averages()))).ln())
        };
        let excesses: Option<Vec<f64>> =
            self.lines[line].iter().zip(self.sources).zip(self.singular).map(excess).collect();
        excesses.is_none_or(|all| all.iter().sum::<f64>() >= all.len() as f64 * NOISE_FACTOR.ln())
    }

    /// Whether a peak is more than chance makes of what lies about it, over one line or several: between peaks of noise, too, the ground
    /// is as low as a saddle beside a mode. What moves as the peak does is looked at, in lines of the peak against as many on either side.
    fn is_beyond_chance(&self, line: usize) -> bool {
        let Some(last) = self.sources.iter().map(|source| source.grid().lines - 1).min() else { return false };
        let centre = self.first_line + line;
        let largest = WIDEST_PEAK.min(last);
        let lines = around(centre, 3 * largest, last + 1);
        // The density that moves as the peak does, setup by setup and line by line, each worked out once.
        let densities = vec![vec![OnceCell::new(); lines.len()]; self.sources.len()];
        // Mean over setups of the logarithm of its mean over lines.
        let log_mean = |range: Range<usize>| -> Option<f64> {
            let of_setup = |((here, source), known): ((&Leading, &Source<'_>), &Vec<OnceCell<f64>>)| {
                let density = |at: usize| {
                    *known[at - lines.start].get_or_init(|| filtered(&here.vector, &source.matrix(at, None)))
                };
                let sum: f64 = range.clone().map(density).sum();
                (sum / range.len() as f64).max(f64::MIN_POSITIVE).ln()
            };
            let setups = self.lines[line].iter().zip(self.sources).zip(&densities);
            (!range.is_empty()).then(|| setups.map(of_setup).sum::<f64>() / self.sources.len() as f64)
        };
        let averages: usize = self.sources.iter().map(Source::averages).sum();
        let variance =
            |lines: usize| OVERLAP_VARIANCE / averages.max(1) as f64 * (JOINED_LINES / lines as f64).min(1.0);
        let is_beyond = |half: usize| -> Option<bool> {
            let (first, after) = (centre.checked_sub(half)?, centre + half + 1);
            if first < lines.start || after > lines.end {
                return None;
            }
            let wide = (after - first).max(2);
            let [below, above] = [
                first.checked_sub(1 + wide).filter(|from| *from >= lines.start).map(|from| from..first - 1),
                Some(after + 1..after + 1 + wide).filter(|range| range.end <= lines.end),
            ];
            let sides: Vec<f64> = [below, above].into_iter().flatten().filter_map(&log_mean).collect();
            let level = sides.iter().sum::<f64>() / sides.len() as f64;
            let std = (variance(after - first) + variance(wide) / sides.len() as f64).sqrt();
            (!sides.is_empty()).then_some(log_mean(first..after)? - level > CHANCE_SIGMAS * std)
        };
        let halves = std::iter::successors(Some(0), |half| Some(2 * half + 1));
        halves.take_while(|half| 2 * half < largest).any(|half| is_beyond(half) == Some(true))
    }

    /// Modal coherence: how alike in shape a line is to its more alike (one side) or less alike (both sides) neighbour.
    ///
    /// Of two modes so close that the record does not tell them apart the first vector is any direction in their plane, another one
    /// at every line: there it counts how far the neighbour moves in the plane.
    fn coherence(&self, line: usize, sides: usize) -> f64 {
        let alike = |other: usize| {
            let pairs = self.lines[line].iter().zip(&self.lines[other]);
            pairs.map(|(a, b)| likeness(a, &b.vector)).sum::<f64>() / self.lines[line].len().max(1) as f64
        };
        let (left, right) = (alike(line - 1), alike(line + 1));
        if sides == 1 { left.max(right) } else { left.min(right) }
    }

    fn pick(&self, line: usize) -> Pick {
        let shapes = self.lines[line].iter().map(|setup| setup.vector.clone()).collect();
        Pick::new(self.first_line + line, shapes)
    }
}

/// How alike a motion is to what moves at a line: to its first vector, or to the plane of its first two where both are strong.
fn likeness(line: &Leading, motion: &Shape) -> f64 {
    let first = mac(&line.vector, motion);
    let is_pair = line.values.len() >= PAIR_CHANNELS && line.values[1] >= PAIR_SHARE * line.value;
    match &line.second {
        Some(second) if is_pair => first + mac(second, motion),
        _ => first,
    }
}

/// The higher of the two lowest points between a peak and the next higher ground on either side; the band's edge counts as
/// ground at its own height, so that a tail that leaves the band is no peak.
fn saddle(curve: &[f64], peak: usize) -> f64 {
    let height = curve[peak];
    let lowest = |line: &mut dyn Iterator<Item = f64>| {
        let mut low = height;
        for value in line {
            if value > height {
                break;
            }
            low = low.min(value);
        }
        low
    };
    let left = lowest(&mut curve[..peak].iter().rev().copied());
    let right = lowest(&mut curve[peak + 1..].iter().copied());
    left.max(right)
}

/// The matrix without what moves in the given shapes: P G P, P = I - Q Q^H.
pub(super) fn projected(matrix: DMatrix<Complex64>, shapes: &[&Shape]) -> DMatrix<Complex64> {
    let mut basis: Vec<DVector<Complex64>> = Vec::new();
    for shape in shapes {
        let mut direction = (*shape).clone();
        for other in &basis {
            let along = other.dotc(&direction);
            direction.axpy(-along, other, Complex64::ONE);
        }
        let norm = direction.norm();
        if norm > 1e-3 * shape.norm() {
            basis.push(direction / Complex64::from(norm));
        }
    }
    let mut matrix = matrix;
    for direction in &basis {
        let row = direction.adjoint() * &matrix;
        matrix -= direction * row;
        let column = &matrix * direction;
        matrix -= column * direction.adjoint();
    }
    // Rounding must not spoil the Hermitian symmetry that the decomposition relies on.
    (&matrix + matrix.adjoint()) * Complex64::from(0.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::plane::tests::{recorded, two_modes};

    #[test]
    fn the_saddle_is_the_higher_of_the_two_valleys_beside_a_peak() {
        let curve = [5.0, 1.0, 3.0, 0.5, 2.0, 1.5, 9.0];
        assert_eq!(saddle(&curve, 2), 1.0);
        assert_eq!(saddle(&curve, 4), 1.5);
        assert_eq!(saddle(&curve, 6), 9.0, "nothing to the right: the edge is ground");
    }

    /// With a hundred averages a peak has to be exp(0.58) = 1.8 times as high as the saddle.
    #[test]
    fn peaks_stand_out_by_more_than_averages_scatter() {
        let spectrum = [1.0, 1.0, 1.0, 2.0, 1.0, 1.0, 1.7, 1.0, 1.0, 9.0, 1.0];
        assert_eq!(peaks_of(&spectrum, 100), [3], "the second is too low, the third too near the end");
        assert_eq!(peaks_of(&spectrum, 400), [3, 6]);
    }

    #[test]
    fn lines_at_the_ends_of_the_band_are_looked_at_as_far_as_there_are_lines() {
        let spectrum = recorded(&two_modes(0.53), 1);
        let sources = [Source::Averages(&spectrum)];
        let singular = [SingularValues::of(&sources[0])];
        let lines = sources[0].grid().lines;
        let whole = Layer::new(&sources, &singular, &[], 0..lines);
        let beyond: Vec<usize> = (0..lines).filter(|&line| whole.is_beyond_chance(line)).collect();
        let hz = |line: usize| sources[0].grid().frequency_hz(line);
        assert!(beyond.iter().any(|&line| (hz(line) - 0.5).abs() < 0.01), "the mode itself");
        assert!(
            beyond.iter().all(|&line| (0.4..0.65).contains(&hz(line))),
            "{:?}",
            beyond.iter().map(|&line| hz(line)).collect::<Vec<_>>()
        );
    }

    #[test]
    fn projecting_a_shape_out_leaves_the_others() {
        let a: Shape = DVector::from_vec([1.0, 1.0, 0.0].map(Complex64::from).to_vec());
        let b: Shape = DVector::from_vec([0.0, 1.0, 1.0].map(Complex64::from).to_vec());
        let matrix = &a * a.adjoint() * Complex64::from(9.0) + &b * b.adjoint();
        let left = leading(projected(matrix, &[&a]));
        // What is left of b is its part orthogonal to a: length² 2 - 1/2.
        assert!((left.value - 1.5).abs() < 1e-12 && left.values[1].abs() < 1e-12);
        assert!(left.vector.dotc(&a).norm() < 1e-12);
    }
}
