//! Scouting: a first, coarse look at a recording for which the study names no band.
//!
//! All of a recording's band is rarely of interest, and long segments of it cannot be had: a tower at 0.1 Hz that is
//! recorded at 50 Hz needs lines a hundred times finer than a machine. So the first hours are looked at over the whole band;
//! as long as more modes show than are asked of a structure, the band is narrowed to the lowest of them and the look
//! taken again with the finer lines that this allows.

use std::path::Path;

use crate::identify::{MeasuredSetup, mode_frequencies_hz};
use crate::record::{Block, Recording};
use crate::spectra::direct::Welch;
use crate::spectra::plan::LOWEST_LINE;
use crate::spectra::{CrossSpectrumAccumulator, SetupExtent, SpectralPlan, StandOut};
use crate::study::{Analysis, Setup};

/// Rows of each setup that are looked at, in s.
const LOOK_S: f64 = 2.0 * 3600.0;
/// Modes that a band is to hold at most: as many as a dozen sensors tell apart.
const MODES: usize = 16;
/// Looks taken at most; each narrows the band to what it shows.
const LOOKS: usize = 5;
/// The band beyond the lowest and highest mode, as a factor.
const BELOW: f64 = 0.5;
const ABOVE: f64 = 1.2;
/// Where a look shows nothing, the next is taken at this share of its band.
const NOTHING: f64 = 0.125;
/// Share of the sampling rate up to which is looked: recorders have a filter above.
const UP_TO: f64 = 0.4;
/// The next look is taken where its lines are this many times as fine.
const FINER: f64 = 2.0;

/// The band chosen and why, or `None` where nothing stands out.
pub(super) fn band(
    folder: &Path,
    setups: &[&Setup],
    extents: &[SetupExtent],
    analysis: &Analysis,
) -> Option<([f64; 2], String)> {
    let looked: Vec<SetupExtent> = extents
        .iter()
        .map(|extent| SetupExtent { rows: extent.rows.min((LOOK_S * extent.sampling_rate_hz) as u64), ..*extent })
        .collect();
    let rate_hz = extents.iter().map(|extent| extent.sampling_rate_hz).fold(f64::INFINITY, f64::min);
    let mut plan =
        finer(&looked, analysis, UP_TO * rate_hz).or_else(|| SpectralPlan::choose(&looked, analysis).ok())?;
    let mut found: Option<[f64; 2]> = None;
    let (mut modes, mut most_hz) = (0, f64::INFINITY);
    // What looks showed above the band.
    let mut above_hz: Vec<f64> = Vec::new();
    for number in 0..LOOKS {
        let frequencies_hz = look(folder, setups, &looked, &plan);
        let lowest = &frequencies_hz[..frequencies_hz.len().min(MODES)];
        let whole_hz = [plan.grid.frequency_hz(0), plan.grid.frequency_hz(plan.grid.lines - 1)];
        let high_hz = if let (Some(first), Some(last)) = (lowest.first(), lowest.last()) {
            // Half-way to the next peak at most, so that no half mode stands at the end.
            let next_hz = frequencies_hz.get(lowest.len()).map_or(f64::INFINITY, |next| 0.5 * (last + next));
            most_hz = next_hz.min(whole_hz[1]);
            let high_hz = (ABOVE * last).min(most_hz);
            modes = lowest.len();
            found = Some([(BELOW * first).max(whole_hz[0]), high_hz]);
            above_hz.retain(|hz| *hz > whole_hz[1]);
            above_hz.extend(&frequencies_hz[modes..]);
            high_hz
        } else {
            NOTHING * whole_hz[1]
        };
        // The finer lines of a narrower band show what lies below the first look's lowest, too.
        let next = finer(&looked, analysis, high_hz);
        let is_finer = |next: &SpectralPlan| FINER * next.grid.spacing_hz() <= plan.grid.spacing_hz();
        let Some(next) = next.filter(is_finer) else {
            // Where the record is so short that its length limits even the whole band's lines, a narrower one gains nothing, and hides
            // modes that this look does not see.
            if let (0, Some([_, high_hz])) = (number, &mut found) {
                *high_hz = most_hz;
            }
            break;
        };
        plan = next;
    }
    let minutes = looked.iter().map(|extent| extent.rows as f64 / extent.sampling_rate_hz / 60.0).sum::<f64>();
    above_hz.sort_by(f64::total_cmp);
    found.map(|band_hz| {
        let above = match above_hz.as_slice() {
            [] => String::new(),
            [one_hz] => format!("; a peak at {one_hz:.4} Hz stands above"),
            [first_hz, .., last_hz] => {
                format!("; {} peaks from {first_hz:.4} to {last_hz:.4} Hz stand above", above_hz.len())
            }
        };
        let reason = format!(
            "Band: {:.4} to {:.4} Hz, around the lowest {modes} modes of a first look at {minutes:.0} min{above} (band_hz in [analysis] fixes it).",
            band_hz[0], band_hz[1]
        );
        (band_hz, reason)
    })
}

/// The plan for a band up to `high_hz`, from the lowest frequency that its lines show.
fn finer(looked: &[SetupExtent], analysis: &Analysis, high_hz: f64) -> Option<SpectralPlan> {
    let up_to = |low_hz: f64| {
        SpectralPlan::choose(looked, &Analysis { band_hz: Some([low_hz, high_hz]), ..analysis.clone() }).ok()
    };
    let spacing_hz = up_to(1e-3 * high_hz)?.grid.spacing_hz();
    up_to(LOWEST_LINE as f64 * spacing_hz)
}

/// Frequencies of the modes that the looked-at rows show, lowest first; none where a recording cannot be read, which is told
/// when it is measured.
fn look(folder: &Path, setups: &[&Setup], extents: &[SetupExtent], plan: &SpectralPlan) -> Vec<f64> {
    let measured: Option<Vec<MeasuredSetup<'_>>> = setups
        .iter()
        .zip(extents)
        .zip(&plan.decimations)
        .map(|((setup, extent), &decimation)| look_at(folder, setup, extent.rows, decimation, plan))
        .collect();
    measured.map(|measured| mode_frequencies_hz(&measured)).unwrap_or_default()
}

fn look_at<'a>(
    folder: &Path,
    setup: &'a Setup,
    rows: u64,
    decimation: u32,
    plan: &SpectralPlan,
) -> Option<MeasuredSetup<'a>> {
    let mut recording = Recording::open(setup, folder).ok()?;
    let mut welch = Welch::new(plan.grid, decimation, setup.sensors.len())?;
    let mut accumulator = CrossSpectrumAccumulator::new(plan.grid, setup.sensors.len()).ok()?;
    let mut block = Block::new();
    let mut seen = 0;
    let mut refused = false;
    let mut average = |window| refused |= accumulator.add(window).is_err();
    let orders = setup.derivatives();
    let mut stand_out = StandOut::new(setup.sensors.len());
    while seen < rows && recording.next_block(&mut block).ok()? {
        welch.push(block.values(), &mut |mut window| {
            window.differentiate(&orders, &plan.grid);
            stand_out.push(window, &mut average);
        });
        seen += block.row_count() as u64;
    }
    stand_out.finish(&mut average);
    let (spectrum, _) = accumulator.finish().ok().filter(|_| !refused)?;
    let (spectrum, _) = spectrum.without_noisy_channels();
    Some(MeasuredSetup { setup, spectrum })
}
