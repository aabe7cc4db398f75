//! The plan: how far to decimate, and how long a segment is.
//!
//! Long segments resolve close modes, many segments make the average trustworthy. Where the study leaves the choice open,
//! the plan takes the finest line spacing that still leaves four averages a channel (and 32 in all), or two where these lines
//! are coarse for the lowest modes, or modes turn out to be narrower than they: with fewer the cross-spectral matrix nears
//! rank deficiency, and modal coherence loses its meaning (Brincker, Andersen, Jacobsen 2007).
//! What the host transforms itself may have longer segments than what nodes transform, as far as memory goes.

use belfry_shared::decimation::{Stages, USABLE_FRACTION};
use thiserror::Error;

use super::accumulate::MAX_GROUPS;
use super::extent::{SetupExtent, rows_for};
use super::grid::LineGrid;
use super::sums::triangle;
use crate::study::Analysis;

/// Averages a channel that picking modes by coherence needs: in noise alone nothing is picked with so few (`records --case still-short`).
pub const AVERAGES_A_CHANNEL: usize = 2;
/// Averages a channel that a chosen segment leaves where its lines are fine enough even so, which is less work for the same modes.
const PREFERRED_A_CHANNEL: usize = 4;
/// Lines are fine enough at this share of the band's lowest frequency, which is half of the lowest mode's or so. More lines would cost
/// averages, which tell machines from modes by how steady they are.
const FINE_SHARE: f64 = 0.5;
/// Averages that a chosen segment leaves at least, however few channels there are: with 32 a spectrum scatters by 18 %.
const LEAST_AVERAGES: usize = 32;
/// The first line where the band is open: below, the Hann window's main lobe mixes with what is left of mean and drift.
pub(crate) const LOWEST_LINE: usize = 4;
/// The shortest segment that a node can transform.
pub(crate) const SHORTEST_SEGMENT: usize = 256;
/// The longest.
const LONGEST_OF_NODES: usize = 4096;
/// The longest that the host transforms.
const LONGEST_SEGMENT: usize = 65_536;
/// Bytes that the sums over windows may take where segments are longer than a node's: a value and its groups for the jackknife.
const MOST_BYTES: usize = 160 << 20;
const BYTES_A_VALUE: usize = 2 * (2 * size_of::<f64>() + MAX_GROUPS * size_of::<f32>());
/// Largest decimation that is tried.
const MAX_DECIMATION: u32 = 1000;
/// Share of the Nyquist frequency that is used where nothing is decimated.
const USABLE_OF_RAW: f64 = 0.49;
/// Relative difference below which a ratio of sampling rates counts as whole.
const RATIO_TOLERANCE: f64 = 1e-4;

/// Why there is no plan.
#[derive(Debug, Error, PartialEq)]
pub enum PlanError {
    /// No segment fits into the recording.
    #[error(
        "the recording of {seconds:.1} s is too short: a segment of {segment} points at {decimated_rate_hz} Hz and the filter need {needed_s:.1} s; record longer or choose a shorter segment in [analysis]"
    )]
    TooShort {
        /// Which of the setups.
        setup: usize,
        /// Duration of the shortest setup.
        seconds: f64,
        /// Points of the shortest segment possible.
        segment: usize,
        /// Decimated sampling rate.
        decimated_rate_hz: f64,
        /// Duration needed.
        needed_s: f64,
    },
    /// No segment fits into the blocks that a recording is joined of.
    #[error(
        "the blocks of {block_s:.1} s (block_s in [[setup]]) are too short: two segments of {segment} points at {decimated_rate_hz} Hz, half over each other, and the filter need {needed_s:.1} s; join longer blocks, or take block_s out if no time is missing between them"
    )]
    BlocksTooShort {
        /// Which of the setups.
        setup: usize,
        /// Duration of a block.
        block_s: f64,
        /// Points of the shortest segment possible.
        segment: usize,
        /// Decimated sampling rate.
        decimated_rate_hz: f64,
        /// Duration needed.
        needed_s: f64,
    },
    /// The band leaves no lines.
    #[error(
        "no spectral line lies in band_hz = [{low_hz}, {high_hz}] at a spacing of {spacing_hz:.4} Hz: widen the band or lengthen the segment in [analysis]"
    )]
    EmptyBand {
        /// Lower edge.
        low_hz: f64,
        /// Upper edge.
        high_hz: f64,
        /// Line spacing.
        spacing_hz: f64,
    },
    /// The segment is longer than what nodes transform.
    #[error(
        "segment = {0} in [analysis] is for recordings that the host transforms itself: nodes transform {LONGEST_OF_NODES} points at most; add --direct or choose a shorter segment"
    )]
    TooLongForNodes(usize),
    /// No decimation serves the band and all setups.
    #[error(
        "no decimation of {rates} Hz reaches decimated_rate_hz = {wanted}: it must divide every sampling rate by a product of at most three numbers from 2 to 10"
    )]
    NoDecimation {
        /// The setups' sampling rates.
        rates: String,
        /// The rate wanted, or the one that the band needs.
        wanted: String,
    },
    /// The band reaches too high.
    #[error(
        "band_hz ends at {high_hz} Hz, but at {rate_hz} Hz only {usable_hz:.3} Hz are free of aliases: lower the band or raise the rate in [analysis]"
    )]
    BandTooHigh {
        /// Upper edge.
        high_hz: f64,
        /// Sampling rate after decimation.
        rate_hz: f64,
        /// Highest usable frequency.
        usable_hz: f64,
    },
}

/// Too few averages for the number of channels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FewAverages {
    /// Averages of all setups together.
    pub averages: usize,
    /// Averages wanted.
    pub wanted: usize,
    /// Channels of the largest setup.
    pub channels: usize,
    /// Minutes of recording that are missing at this line spacing.
    pub missing_min: f64,
}

impl std::fmt::Display for FewAverages {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} averages for {} channels, {} are needed for modes to be told from noise with confidence: record {:.0} min more, or shorten the segment in [analysis]",
            self.averages,
            self.channels,
            self.wanted,
            self.missing_min.ceil()
        )
    }
}

/// What gaps in the recordings were found to leave, once windows were made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AfterGaps {
    /// Points of the segments that too few were left of.
    pub too_long: usize,
    /// Points of the longest segment that probably leaves enough.
    pub longest: usize,
}

/// Which lines are wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lines {
    /// Fine enough for the band's lowest modes, of as many averages as that leaves.
    Enough,
    /// As fine as the fewest averages allow, for modes that are narrow.
    Finest,
    /// Of segments that gaps leave enough of.
    AfterGaps(AfterGaps),
}

/// Decimation, segment and lines for all setups of a study.
#[derive(Debug, Clone, PartialEq)]
pub struct SpectralPlan {
    /// Lines, segment and decimated rate; the same for all setups.
    pub grid: LineGrid,
    /// Each setup's decimation.
    pub decimations: Vec<u32>,
    /// Windows that each setup's recording gives.
    pub windows: Vec<usize>,
    /// Whether fewer averages a channel would leave finer lines.
    pub has_finer_lines: bool,
    /// Set where the averages are too few.
    pub few_averages: Option<FewAverages>,
    /// Why this rate and this segment, in one line.
    pub reason: String,
}

impl SpectralPlan {
    /// Chooses what `analysis` leaves open for setups that are picked together and whose windows nodes make.
    ///
    /// # Errors
    /// Where no segment fits into the recordings, or the band into the lines; a segment that no node transforms.
    pub fn choose(setups: &[SetupExtent], analysis: &Analysis) -> Result<Self, PlanError> {
        Self::choose_lines(setups, analysis, Lines::Enough, true)
    }

    /// The same where the host makes the windows.
    ///
    /// # Errors
    /// As [`SpectralPlan::choose`].
    pub fn choose_direct(setups: &[SetupExtent], analysis: &Analysis) -> Result<Self, PlanError> {
        Self::choose_lines(setups, analysis, Lines::Enough, false)
    }

    /// The same by either route, with these lines.
    ///
    /// # Errors
    /// As [`SpectralPlan::choose`].
    pub fn choose_lines(
        setups: &[SetupExtent],
        analysis: &Analysis,
        lines: Lines,
        by_nodes: bool,
    ) -> Result<Self, PlanError> {
        let longest = match (lines, analysis.segment) {
            (_, Some(segment)) if by_nodes && segment > LONGEST_OF_NODES => {
                return Err(PlanError::TooLongForNodes(segment));
            }
            (Lines::AfterGaps(AfterGaps { longest, .. }), _) => longest,
            _ if by_nodes => LONGEST_OF_NODES,
            _ => LONGEST_SEGMENT,
        };
        let rates = decimations(setups, analysis)?;
        let powers = std::iter::successors(Some(SHORTEST_SEGMENT), |segment| Some(2 * segment));
        let segments: Vec<usize> = match analysis.segment {
            Some(segment) => vec![segment],
            None => powers.take_while(|&segment| segment <= longest).collect(),
        };
        let channels = setups.iter().map(|setup| setup.channels).max().unwrap_or(0);
        let wanted = AVERAGES_A_CHANNEL * channels;
        let mut candidates: Vec<Candidate> = rates
            .iter()
            .flat_map(|rate| segments.iter().map(|&segment| Candidate::new(setups, rate, segment)))
            .collect();
        // Finest spacing first; of equal ones the one with the lower rate, which has less work for the same lines.
        candidates.sort_by(|a, b| a.spacing_hz().total_cmp(&b.spacing_hz()).then(a.rate_hz.total_cmp(&b.rate_hz)));
        let averages = |candidate: &&Candidate| -> usize { candidate.windows.iter().sum() };
        // Every setup by itself needs a matrix of full rank, with room for a few windows that gaps may cost.
        let full = |(windows, setup): (&usize, &SetupExtent)| *windows >= setup.channels + setup.channels / 4;
        let has = |candidate: &&Candidate, enough: usize| {
            averages(candidate) >= enough && candidate.windows.iter().zip(setups).all(full)
        };
        let complete = |candidate: &&Candidate| candidate.windows.iter().all(|&windows| windows > 0);
        let fits = |candidate: &&Candidate| {
            analysis.segment.is_some()
                || candidate.segment <= LONGEST_OF_NODES
                || candidate.grid(analysis).is_ok_and(|grid| bytes(setups, grid.lines) <= MOST_BYTES)
        };
        let finest = |enough: usize| {
            let mut possible = candidates.iter().filter(|candidate| complete(candidate) && fits(candidate));
            possible.find(|candidate| has(candidate, enough)).map(|candidate| (candidate, enough))
        };
        let [preferred, least] =
            [PREFERRED_A_CHANNEL, AVERAGES_A_CHANNEL].map(|a_channel| (a_channel * channels).max(LEAST_AVERAGES));
        let is_fine = |candidate: &Candidate| {
            let lowest_hz = analysis.band_hz.map_or(0.0, |[low_hz, _]| low_hz);
            lines != Lines::Finest && candidate.spacing_hz() <= FINE_SHARE * lowest_hz
        };
        let (best, enough) = finest(preferred)
            .filter(|(candidate, _)| is_fine(candidate))
            .or_else(|| finest(least))
            .or_else(|| Some((candidates.iter().filter(complete).max_by_key(averages)?, least)))
            .ok_or_else(|| too_short(setups, &candidates))?;
        let grid = best.grid(analysis)?;
        let has_finer_lines = finest(least).is_some_and(|(finer, _)| finer.spacing_hz() < best.spacing_hz());
        let averages: usize = best.windows.iter().sum();
        let few_averages = (averages < wanted).then(|| FewAverages {
            averages,
            wanted,
            channels,
            missing_min: (wanted - averages) as f64 * grid.segment as f64 / 2.0 / grid.sampling_rate_hz / 60.0,
        });
        let limits = Limits { longest, enough, lines };
        let reason = reason(setups, analysis, best, &grid, limits);
        Ok(Self {
            grid,
            decimations: best.decimations.clone(),
            windows: best.windows.clone(),
            has_finer_lines,
            few_averages,
            reason,
        })
    }

    /// Rows of a setup before the first decimated sample whose filter support lies within the recording; that sample is at
    /// the epoch of the grid.
    pub fn lead_rows(decimation: u32) -> u64 {
        Stages::of(decimation).map_or(0, |stages| u64::from(stages.first_full_output()) * u64::from(decimation))
    }
}

/// What limits the choice of a segment.
struct Limits {
    longest: usize,
    /// Averages that are wanted.
    enough: usize,
    lines: Lines,
}

/// Why the best candidate is the best, for the user.
fn reason(setups: &[SetupExtent], analysis: &Analysis, best: &Candidate, grid: &LineGrid, limits: Limits) -> String {
    let Limits { longest, enough, lines } = limits;
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
    } else if let Lines::AfterGaps(AfterGaps { too_long, .. }) = lines {
        format!("as gaps cost too many segments of {too_long}; {averages} averages, less what gaps cost of these")
    } else if averages < enough {
        format!("the most averages that this record gives, {averages}")
    } else if best.segment == longest && longest == LONGEST_OF_NODES {
        let finer = if averages >= 2 * enough { "; --direct has longer ones" } else { "" };
        format!("the longest that a node has; {averages} averages{finer}")
    } else {
        let narrow = if lines == Lines::Finest { ", as modes are narrow" } else { "" };
        format!("the finest lines that leave {enough} averages{narrow}; {averages} here")
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

/// A decimated rate and how each setup reaches it.
#[derive(Debug, Clone)]
struct Rate {
    hz: f64,
    decimations: Vec<u32>,
}

#[derive(Debug)]
struct Candidate {
    rate_hz: f64,
    decimations: Vec<u32>,
    segment: usize,
    windows: Vec<usize>,
}

impl Candidate {
    fn new(setups: &[SetupExtent], rate: &Rate, segment: usize) -> Self {
        let windows = setups
            .iter()
            .zip(&rate.decimations)
            .map(|(setup, &decimation)| setup.windows(decimation, segment))
            .collect();
        Self { rate_hz: rate.hz, decimations: rate.decimations.clone(), segment, windows }
    }

    fn spacing_hz(&self) -> f64 {
        self.rate_hz / self.segment as f64
    }

    fn grid(&self, analysis: &Analysis) -> Result<LineGrid, PlanError> {
        let spacing_hz = self.spacing_hz();
        let usable_hz = usable_hz(self.rate_hz, &self.decimations);
        let [low_hz, high_hz] = analysis.band_hz.unwrap_or([LOWEST_LINE as f64 * spacing_hz, usable_hz]);
        if high_hz > usable_hz * (1.0 + RATIO_TOLERANCE) {
            return Err(PlanError::BandTooHigh { high_hz, rate_hz: self.rate_hz, usable_hz });
        }
        let first_line = ((low_hz / spacing_hz - 1e-9).ceil() as usize).max(1);
        let last_line = ((high_hz / spacing_hz + 1e-9).floor() as usize).min(self.segment / 2 - 1);
        if last_line < first_line + 2 {
            return Err(PlanError::EmptyBand { low_hz, high_hz, spacing_hz });
        }
        let lines = last_line - first_line + 1;
        Ok(LineGrid { sampling_rate_hz: self.rate_hz, segment: self.segment, first_line, lines })
    }
}

fn usable_hz(rate_hz: f64, decimations: &[u32]) -> f64 {
    let decimated = decimations.iter().any(|&decimation| decimation > 1);
    rate_hz * if decimated { USABLE_FRACTION } else { USABLE_OF_RAW }
}

/// What the sums over all setups' windows take.
fn bytes(setups: &[SetupExtent], lines: usize) -> usize {
    let values = setups.iter().map(|setup| triangle(setup.channels)).sum::<usize>();
    values * lines * BYTES_A_VALUE
}

/// The decimated rates that are possible.
fn decimations(setups: &[SetupExtent], analysis: &Analysis) -> Result<Vec<Rate>, PlanError> {
    let Some(first) = setups.first() else { return Ok(Vec::new()) };
    let reach = |rate_hz: f64| -> Option<Rate> {
        let decimations = setups.iter().map(|setup| {
            let ratio = setup.sampling_rate_hz / rate_hz;
            let whole = ratio.round();
            let supported = (ratio - whole).abs() <= RATIO_TOLERANCE * ratio && Stages::of(whole as u32).is_some();
            supported.then_some(whole as u32)
        });
        Some(Rate { hz: rate_hz, decimations: decimations.collect::<Option<Vec<u32>>>()? })
    };
    let fail = |wanted: String| {
        let mut rates: Vec<String> = setups.iter().map(|setup| setup.sampling_rate_hz.to_string()).collect();
        rates.dedup();
        PlanError::NoDecimation { rates: rates.join(", "), wanted }
    };
    if let Some(rate_hz) = analysis.decimated_rate_hz {
        return reach(rate_hz).map(|rate| vec![rate]).ok_or_else(|| fail(rate_hz.to_string()));
    }
    let Some([_, high_hz]) = analysis.band_hz else {
        return reach(first.sampling_rate_hz).map(|rate| vec![rate]).ok_or_else(|| fail("one common rate".into()));
    };
    let rates: Vec<Rate> = (1..=MAX_DECIMATION)
        .filter_map(|decimation| reach(first.sampling_rate_hz / f64::from(decimation)))
        .filter(|rate| usable_hz(rate.hz, &rate.decimations) >= high_hz * (1.0 - 1e-9))
        .collect();
    if rates.is_empty() {
        let rate_hz = first.sampling_rate_hz;
        let usable_hz = rate_hz * USABLE_OF_RAW;
        return Err(if high_hz > usable_hz {
            PlanError::BandTooHigh { high_hz, rate_hz, usable_hz }
        } else {
            fail(format!("one that serves band_hz up to {high_hz}"))
        });
    }
    Ok(rates)
}

fn too_short(setups: &[SetupExtent], candidates: &[Candidate]) -> PlanError {
    let shortest = |candidate: &&Candidate| (candidate.segment as f64 / candidate.rate_hz * 1e6) as u64;
    let (segment, decimated_rate_hz, decimations) = candidates
        .iter()
        .min_by_key(shortest)
        .map_or((0, 0.0, &[][..]), |candidate| (candidate.segment, candidate.rate_hz, &candidate.decimations));
    let needed = |setup: &SetupExtent, decimation: u32| {
        let reach = Stages::of(decimation).map_or(0, |stages| 2 * stages.reach_rows());
        f64::from(reach) / setup.sampling_rate_hz + segment as f64 / decimated_rate_hz
    };
    let of_rows = |rows: u64, setup: &SetupExtent| rows as f64 / setup.sampling_rate_hz;
    // In a block there must be two windows, see `SetupExtent::windows`.
    let in_blocks = setups.iter().zip(decimations).enumerate().find_map(|(setup, (extent, &decimation))| {
        let block = extent.block_rows.filter(|&block| block < extent.rows)?;
        let needed = rows_for(2, decimation, segment);
        (block < needed).then(|| PlanError::BlocksTooShort {
            setup,
            block_s: of_rows(block, extent),
            segment,
            decimated_rate_hz,
            needed_s: of_rows(needed, extent),
        })
    });
    if let Some(error) = in_blocks {
        return error;
    }
    let seconds = |setup: &SetupExtent| of_rows(setup.rows, setup);
    let shortest = (0..setups.len()).min_by(|&a, &b| seconds(&setups[a]).total_cmp(&seconds(&setups[b]))).unwrap_or(0);
    PlanError::TooShort {
        setup: shortest,
        seconds: setups.get(shortest).map_or(0.0, seconds),
        segment,
        decimated_rate_hz,
        needed_s: setups.iter().zip(decimations).map(|(setup, &d)| needed(setup, d)).fold(0.0, f64::max),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn analysis(band_hz: [f64; 2]) -> Analysis {
        Analysis { band_hz: Some(band_hz), ..Analysis::default() }
    }

    #[test]
    fn an_hour_of_twenty_channels_gets_the_finest_spacing_with_eighty_averages() {
        let hour = SetupExtent { sampling_rate_hz: 50.0, rows: 180_000, channels: 20, block_rows: None };
        let plan = SpectralPlan::choose(&[hour], &analysis([0.05, 1.5])).unwrap();
        assert_eq!((plan.decimations[0], plan.grid.segment), (8, 512));
        assert_eq!((plan.windows[0], plan.few_averages), (86, None));
        assert_eq!(
            plan.reason,
            "Rate: 6.25 Hz (50 / 8), free of aliases in the band. Segments: 512 points, 81.9 s, the finest lines that leave 80 averages; 86 here. Lines: 118 from 0.061035 to 1.4893 Hz, every 0.012207 Hz."
        );
        assert!(plan.grid.frequency_hz(0) >= 0.05 && plan.grid.frequency_hz(plan.grid.lines - 1) <= 1.5);
    }

    #[test]
    fn ten_minutes_have_two_averages_a_channel_where_four_would_join_the_lowest_modes() {
        let ten_minutes = SetupExtent { sampling_rate_hz: 50.0, rows: 30_000, channels: 20, block_rows: None };
        let windows = |band_hz| SpectralPlan::choose(&[ten_minutes], &analysis(band_hz)).unwrap().windows[0];
        assert!((40..80).contains(&windows([0.05, 1.5])), "{}", windows([0.05, 1.5]));
        assert!(windows([1.0, 10.0]) >= 80, "{}", windows([1.0, 10.0]));
    }

    #[test]
    fn what_the_host_transforms_has_longer_segments_as_far_as_memory_goes() {
        let day = SetupExtent { sampling_rate_hz: 50.0, rows: 24 * 180_000, channels: 20, block_rows: None };
        let plan = |band_hz| SpectralPlan::choose_direct(&[day], &analysis(band_hz)).unwrap();
        assert_eq!(SpectralPlan::choose(&[day], &analysis([0.05, 1.5])).unwrap().grid.segment, 4096);
        let fine = plan([0.05, 1.5]);
        assert_eq!((fine.grid.segment, fine.windows[0]), (8192, 86));
        assert!(
            fine.reason.contains("8192 points, 1966.1 s, the finest lines that leave 80 averages"),
            "{}",
            fine.reason
        );
        // Five times the lines would not fit.
        let wide = plan([0.05, 15.0]);
        assert!(bytes(&[day], wide.grid.lines) <= MOST_BYTES && wide.windows[0] > 300, "{}", wide.reason);
        let long = Analysis { segment: Some(8192), ..analysis([0.05, 1.5]) };
        assert_eq!(SpectralPlan::choose_direct(&[day], &long).unwrap().grid.segment, 8192);
        let error = SpectralPlan::choose(&[day], &long).unwrap_err();
        assert!(error.to_string().contains("add --direct"), "{error}");
    }

    #[test]
    fn setups_picked_together_share_their_averages() {
        let setup = SetupExtent { sampling_rate_hz: 40.0, rows: 13_108, channels: 8, block_rows: None };
        let plan = SpectralPlan::choose(&[setup; 4], &analysis([0.5, 8.0])).unwrap();
        assert!(plan.windows.iter().sum::<usize>() >= 32);
        assert_eq!((plan.decimations[0], plan.grid.segment), (2, 1024));
    }

    #[test]
    fn what_the_study_fixes_stays_and_few_averages_are_said_with_the_time_that_is_missing() {
        let ten_minutes = SetupExtent { sampling_rate_hz: 50.0, rows: 30_000, channels: 20, block_rows: None };
        let fixed = Analysis { decimated_rate_hz: Some(5.0), segment: Some(512), ..analysis([0.05, 1.5]) };
        let plan = SpectralPlan::choose(&[ten_minutes], &fixed).unwrap();
        assert_eq!((plan.decimations[0], plan.grid.segment, plan.windows[0]), (10, 512, 10));
        let few = plan.few_averages.unwrap();
        // 30 more windows of 51.2 s.
        assert!((few.missing_min - 30.0 * 51.2 / 60.0).abs() < 0.01);
        assert!(few.to_string().contains("record 26 min more"), "{few}");
        assert!(plan.reason.contains("5 Hz (50 / 10), as [analysis] says. Segments: 512 points"), "{}", plan.reason);
    }

    #[test]
    fn where_gaps_make_segments_shorter_the_reason_says_so_and_not_that_the_study_does() {
        let hour = SetupExtent { sampling_rate_hz: 50.0, rows: 180_000, channels: 20, block_rows: None };
        let after_gaps = AfterGaps { too_long: 512, longest: 256 };
        let plan =
            SpectralPlan::choose_lines(&[hour], &analysis([0.05, 1.5]), Lines::AfterGaps(after_gaps), true).unwrap();
        assert_eq!(plan.grid.segment, 256);
        assert!(plan.reason.contains("256 points, 61.4 s, as gaps cost too many segments of 512"), "{}", plan.reason);
        assert!(!plan.reason.contains("[analysis]"), "{}", plan.reason);
    }

    #[test]
    fn narrow_modes_get_lines_twice_as_fine_and_the_reason_says_why() {
        let four_hours = SetupExtent { sampling_rate_hz: 50.0, rows: 720_000, channels: 16, block_rows: None };
        let plan = |lines| SpectralPlan::choose_lines(&[four_hours], &analysis([0.4, 0.98]), lines, false).unwrap();
        let (enough, finest) = (plan(Lines::Enough), plan(Lines::Finest));
        assert!((finest.grid.spacing_hz() / enough.grid.spacing_hz() - 0.5).abs() < 1e-9, "{}", finest.reason);
        assert!(finest.windows[0] >= 32 && finest.reason.contains(", as modes are narrow;"), "{}", finest.reason);
    }

    #[test]
    fn impossible_wishes_are_named() {
        let short = SetupExtent { sampling_rate_hz: 50.0, rows: 250, channels: 2, block_rows: None };
        let error = SpectralPlan::choose(&[short], &analysis([0.5, 10.0])).unwrap_err();
        assert!(matches!(error, PlanError::TooShort { seconds, .. } if seconds == 5.0), "{error}");
        let hour = SetupExtent { rows: 180_000, ..short };
        let joined = SetupExtent { block_rows: Some(300), ..hour };
        let error = SpectralPlan::choose(&[hour, joined], &analysis([0.5, 10.0])).unwrap_err();
        assert!(matches!(error, PlanError::BlocksTooShort { setup: 1, block_s: 6.0, .. }), "{error}");
        let PlanError::BlocksTooShort { needed_s, .. } = error else { unreachable!() };
        let enough = SetupExtent { block_rows: Some((needed_s * 50.0).round() as u64), ..hour };
        assert!(SpectralPlan::choose(&[hour, enough], &analysis([0.5, 10.0])).is_ok(), "{needed_s} s");
        let error = SpectralPlan::choose(&[hour], &analysis([0.5, 24.9])).unwrap_err();
        assert!(matches!(error, PlanError::BandTooHigh { .. }), "{error}");
        let odd = Analysis { decimated_rate_hz: Some(50.0 / 13.0), ..analysis([0.05, 1.0]) };
        let error = SpectralPlan::choose(&[hour], &odd).unwrap_err();
        assert!(matches!(error, PlanError::NoDecimation { .. }), "{error}");
        let error = SpectralPlan::choose(&[hour], &analysis([1.0, 1.0001])).unwrap_err();
        assert!(matches!(error, PlanError::EmptyBand { .. }), "{error}");
    }
}
