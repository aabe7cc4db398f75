//! Where the fits start: a mode's first frequency, damping and level.
//!
//! A pick's line and shape flow in; EFDD about the line, or the bell of a wide mode where that explains the lines best,
//! flows out.

use super::bell::{BellFit, DAMPING_RANGE};
use super::estimate::{LEEWAY_BANDWIDTHS, LEEWAY_LINES};
use super::matrices::{LEAST_LINES, Matrices, bell};
use super::resonance::{Quantity, Resonance};
use super::shape::{Shape, filtered};

/// Damping ratio assumed before anything is known.
const FIRST_DAMPING: f64 = 0.01;
/// Lines to either side that EFDD's start is read from.
const START_LINES: usize = 4;
/// Lines to either side that the start of a mode of wide bandwidth is read from, at most; bandwidths in lines that are tried; and
/// the narrowest that counts.
const MOST_START_LINES: usize = 150;
const WIDE_START_LINES: [f64; 3] = [10.0, 30.0, 90.0];
const WIDE_LINES: f64 = 6.0;
/// What is wider is the floor's own slope.
const MOST_DAMPING: f64 = 0.15;

/// The first fit of a mode that was picked at a line, `apart` lines from the next pick.
pub(super) fn first_bell(
    matrices: &Matrices<'_>,
    shape: &Shape,
    line: usize,
    apart: usize,
    quantity: Quantity,
) -> BellFit {
    let grid = matrices.grid();
    let (first, last) = (line.saturating_sub(START_LINES), (line + START_LINES).min(grid.lines - 1));
    let guess = Resonance { frequency_hz: grid.frequency_hz(line), damping_ratio: FIRST_DAMPING, quantity };
    let lines = matrices.free(first, last, LEAST_LINES);
    let resonance = bell(matrices, shape, &lines)
        .from_autocorrelation(0, lines.len() - 1, quantity)
        .filter(|r| (r.frequency_hz - guess.frequency_hz).abs() < 2.0 * grid.spacing_hz())
        .unwrap_or(guess);
    let narrow = known_bell(matrices, shape, line, resonance);
    wide_bell(matrices, shape, line, apart, resonance).unwrap_or(narrow)
}

/// The bell of a mode whose resonance is known, with the level that its line has.
pub(super) fn known_bell(matrices: &Matrices<'_>, shape: &Shape, line: usize, resonance: Resonance) -> BellFit {
    let duration_s = 1.0 / matrices.grid().spacing_hz();
    let level = filtered(shape, matrices.at(line)) / resonance.peak_density(duration_s);
    let (neighbours, expected) = (Vec::new(), Vec::new());
    BellFit { resonance, level, floor: 0.0, neighbours, expected, objective: f64::INFINITY, certainty: None }
}

/// The bell of a mode that is damped so much that its top is many lines wide: among these, noise makes peaks of its own, which
/// a search from the highest takes for the mode. `None` where the lines half-way to the next pick (`apart` lines away) are best
/// fitted by a mode of few lines; `narrow` is the one found at the top.
fn wide_bell(matrices: &Matrices<'_>, shape: &Shape, line: usize, apart: usize, narrow: Resonance) -> Option<BellFit> {
    let grid = matrices.grid();
    let reach = (apart / 2).min(MOST_START_LINES);
    let (first, last) = (line.saturating_sub(reach), (line + reach).min(grid.lines - 1));
    let bell = bell(matrices, shape, &matrices.free(first, last, LEAST_LINES));
    let here_hz = grid.frequency_hz(line);
    let fit = |lines: f64, damping_ratio: f64| {
        let leeway_hz = (LEEWAY_LINES + LEEWAY_BANDWIDTHS * lines) * grid.spacing_hz();
        bell.fit(Resonance { damping_ratio, ..narrow }, &[], [here_hz - leeway_hz, here_hz + leeway_hz])
    };
    let bandwidths = WIDE_START_LINES.into_iter().filter(|lines| *lines < reach as f64);
    let wide =
        bandwidths.filter_map(|lines| fit(lines, (0.5 * lines * grid.spacing_hz() / here_hz).min(DAMPING_RANGE[1])));
    let as_found = fit(narrow.bandwidth_hz() / grid.spacing_hz(), narrow.damping_ratio);
    let best = wide.chain(as_found).min_by(|a, b| a.objective.total_cmp(&b.objective))?;
    let is_wide = best.resonance.bandwidth_hz() > WIDE_LINES * grid.spacing_hz();
    let is_peak = best.resonance.damping_ratio < MOST_DAMPING
        && best.level * best.resonance.peak_density(1.0 / grid.spacing_hz()) > best.floor;
    (is_wide && is_peak).then_some(best)
}
