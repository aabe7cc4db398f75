//! Why a plan is as it is, in a line for the user.

use super::extent::SetupExtent;
use super::grid::LineGrid;
use super::plan::{AfterGaps, Candidate, LONGEST_OF_NODES};
use crate::study::Analysis;

/// What limits the choice of a segment.
pub(super) struct Limits {
    pub(super) longest: usize,
    /// Averages that are wanted.
    pub(super) enough: usize,
    pub(super) after_gaps: Option<AfterGaps>,
}

/// Why the best candidate is the best, for the user.
pub(super) fn reason(
    setups: &[SetupExtent],
    analysis: &Analysis,
    best: &Candidate,
    grid: &LineGrid,
    limits: Limits,
) -> String {
    let Limits { longest, enough, after_gaps } = limits;
    let rate = if best.decimations.iter().all(|&decimation| decimation == 1) {
        format!("{} Hz, as recorded", short(best.rate_hz))
    } else {
        let mut ways: Vec<String> = setups
            .iter()
            .zip(&best.decimations)
            .map(|(setup, decimation)| format!("{} / {decimation}", short(setup.sampling_rate_hz)))
            .collect();
        ways.dedup();
        let why =
            if analysis.decimated_rate_hz.is_some() { "as [analysis] says" } else { "free of aliases in the band" };
        format!("{} Hz ({}), {why}", short(best.rate_hz), ways.join(", "))
    };
    let averages: usize = best.windows.iter().sum();
    let why = if analysis.segment.is_some() {
        format!("as [analysis] says; {averages} averages")
    } else if let Some(AfterGaps { too_long, .. }) = after_gaps {
        format!("as gaps cost too many segments of {too_long}; {averages} averages, less what gaps cost of these")
    } else if averages < enough {
        format!("the most averages that this record gives, {averages}")
    } else if best.segment == longest && longest == LONGEST_OF_NODES {
        let finer = if averages >= 2 * enough { "; --direct has longer ones" } else { "" };
        format!("the longest that a node has; {averages} averages{finer}")
    } else {
        format!("the finest lines that leave {enough} averages; {averages} here")
    };
    let last_hz = grid.frequency_hz(grid.lines - 1);
    format!(
        "Rate: {rate}. Segments: {} points, {:.1} s, {why}. Lines: {} from {} to {} Hz, every {} Hz.",
        grid.segment,
        1.0 / grid.spacing_hz(),
        grid.lines,
        short(grid.frequency_hz(0)),
        short(last_hz),
        short(grid.spacing_hz()),
    )
}

/// A number in at most five digits.
fn short(value: f64) -> String {
    let digits = (4 - value.abs().max(1e-12).log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}
