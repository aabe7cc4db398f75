//! Running average of power spectral densities, and the peaks in it.

use belfry_kernels::add_power;
use belfry_shared::message::{Band, Configuration, MAX_CHANNELS, MAX_PEAKS, Peak};
use heapless::Vec;
use num_complex::Complex32;

/// Lines on either side that a peak must exceed, and against which its prominence is measured.
const NEIGHBOURS: usize = 2;
const SURROUNDINGS: usize = 16;
/// A peak's density over the mean of its surroundings, at least.
const PROMINENCE: f32 = 3.0;

/// A segment with so many times the power of those summed before it is no vibration but a blow or a spike, unless the one before it was
/// like that too: then the load has changed.
const FAR_OFF: f32 = 100.0;

/// Counts the segments summed; the sums lie in memory that the caller owns, channel by channel.
#[derive(Debug, Clone)]
pub(crate) struct DensityAverage {
    segments: [u16; MAX_CHANNELS],
    /// Mean power of the segments summed.
    power: [f32; MAX_CHANNELS],
    /// Whether the last segment was left out.
    left_out: [bool; MAX_CHANNELS],
}

impl DensityAverage {
    /// Nothing summed.
    pub(crate) const START: Self =
        Self { segments: [0; MAX_CHANNELS], power: [0.0; MAX_CHANNELS], left_out: [false; MAX_CHANNELS] };

    /// Segments in a channel's average.
    pub(crate) fn segments(&self, channel: usize) -> u16 {
        self.segments.get(channel).copied().unwrap_or(0)
    }

    /// Adds a segment's lines (all of them, from line 0) to a channel's sums; one segment that stands far off the others stays out, which
    /// their number then shows.
    pub(crate) fn add(
        &mut self,
        configuration: &Configuration,
        cells: &mut [f32],
        channel: usize,
        lines: &[Complex32],
    ) {
        let state = (self.segments.get_mut(channel), self.power.get_mut(channel), self.left_out.get_mut(channel));
        let (Some(segments), Some(power), Some(left_out)) = state else { return };
        let here = power_in_bands(configuration, lines);
        if *segments > 0 && !*left_out && here > FAR_OFF * *power {
            *left_out = true;
            return;
        }
        *left_out = false;
        // The only one before it was what stands off.
        if *segments == 1 && *power > FAR_OFF * here {
            *segments = 0;
        }
        let fresh = *segments == 0;
        *power = if fresh { here } else { *power + (here - *power) / (f32::from(*segments) + 1.0) };
        *segments = segments.saturating_add(1);
        let mut cells = channel_cells(configuration, cells, channel);
        if fresh {
            cells.fill(0.0);
        }
        for band in &configuration.bands {
            let first = usize::from(band.first_line);
            let band_cells = cells.split_off_mut(..usize::from(band.lines).min(cells.len()));
            if let (Some(sums), Some(lines)) = (band_cells, lines.get(first..first + usize::from(band.lines))) {
                add_power(sums, lines);
            }
        }
    }

    /// A channel's averaged densities, computed in place, all bands one after the other. Empty if nothing was summed.
    pub(crate) fn finish<'a>(&self, configuration: &Configuration, cells: &'a mut [f32], channel: usize) -> &'a [f32] {
        let segments = self.segments(channel);
        if segments == 0 {
            return &[];
        }
        let cells = channel_cells(configuration, cells, channel);
        for cell in cells.iter_mut() {
            *cell /= f32::from(segments);
        }
        cells
    }
}

/// The power of a segment's lines in all bands.
fn power_in_bands(configuration: &Configuration, lines: &[Complex32]) -> f32 {
    let of_band = |band: &Band| -> f32 {
        let first = usize::from(band.first_line);
        let lines = lines.get(first..first + usize::from(band.lines)).unwrap_or(&[]);
        lines.iter().map(Complex32::norm_sqr).sum()
    };
    configuration.bands.iter().map(of_band).sum()
}

fn channel_cells<'a>(configuration: &Configuration, cells: &'a mut [f32], channel: usize) -> &'a mut [f32] {
    let lines = configuration.lines();
    cells.get_mut(channel * lines..(channel + 1) * lines).unwrap_or(&mut [])
}

/// The highest peaks of one band's densities, highest first.
///
/// A peak exceeds two lines on either side and is three times the mean of the 16 lines on either side; its frequency is the
/// vertex of the parabola through the logarithms of three densities (at most 0.05 lines off for a Hann window's main lobe).
pub(crate) fn add_peaks(peaks: &mut Vec<Peak, MAX_PEAKS>, densities: &[f32], first_line: u16, spacing_hz: f32) {
    for middle in 1..densities.len().saturating_sub(1) {
        let from = middle.saturating_sub(SURROUNDINGS);
        let Some(&density) = densities.get(middle) else { continue };
        let around = densities.get(from..(middle + SURROUNDINGS + 1).min(densities.len())).unwrap_or(&[]);
        let near = densities.get(middle.saturating_sub(NEIGHBOURS)..(middle + NEIGHBOURS + 1).min(densities.len()));
        let tops = near.is_some_and(|near| near.iter().all(|&other| other <= density));
        let others = (around.iter().sum::<f32>() - density) / (around.len().max(2) - 1) as f32;
        if !tops || density <= PROMINENCE * others {
            continue;
        }
        let (Some(&below), Some(&above)) = (densities.get(middle - 1), densities.get(middle + 1)) else { continue };
        let shift = vertex(below, density, above);
        let peak = Peak { frequency_hz: (f32::from(first_line) + middle as f32 + shift) * spacing_hz, density };
        insert(peaks, peak);
    }
}

/// Offset of the vertex of the parabola through three logarithms, in lines.
fn vertex(below: f32, middle: f32, above: f32) -> f32 {
    let [below, middle, above] = [below, middle, above].map(|density| libm::logf(density.max(f32::MIN_POSITIVE)));
    let curvature = below - 2.0 * middle + above;
    if curvature < 0.0 { (0.5 * (below - above) / curvature).clamp(-0.5, 0.5) } else { 0.0 }
}

fn insert(peaks: &mut Vec<Peak, MAX_PEAKS>, peak: Peak) {
    let place = peaks.iter().position(|other| other.density < peak.density).unwrap_or(peaks.len());
    if peaks.is_full() {
        if place == peaks.len() {
            return;
        }
        peaks.pop();
    }
    // Cannot fail: there is room now, and the place is within the vector.
    let _ = peaks.insert(place, peak);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spectrum::transform;
    use belfry_shared::message::Summary;
    use std::vec;

    #[test]
    fn a_tone_between_lines_is_found_within_a_twentieth_of_a_line() {
        let rate = 5.0_f32;
        for shift in [-0.4_f32, -0.2, 0.0, 0.1, 0.3, 0.5] {
            let frequency = (40.0 + shift) * rate / 256.0;
            let mut buffer: std::vec::Vec<f32> = (0..256)
                .map(|n| (core::f32::consts::TAU * frequency * n as f32 / rate).sin() + 1e-3 * (n % 3) as f32)
                .collect();
            let densities: std::vec::Vec<f32> =
                transform(&mut buffer, rate)[10..100].iter().map(|l| l.norm_sqr()).collect();
            let mut peaks = Vec::new();
            add_peaks(&mut peaks, &densities, 10, rate / 256.0);
            assert!((peaks[0].frequency_hz - frequency).abs() < 0.05 * rate / 256.0, "{shift}: {peaks:?}");
        }
    }

    #[test]
    fn flat_noise_free_spectra_have_no_peak_and_full_lists_keep_the_highest() {
        let mut peaks = Vec::new();
        add_peaks(&mut peaks, &[1.0; 64], 1, 1.0);
        assert!(peaks.is_empty());
        let mut densities = vec![0.01; 400];
        for peak in 0..12 {
            densities[20 + 30 * peak] = 1.0 + peak as f32;
        }
        add_peaks(&mut peaks, &densities, 0, 1.0);
        let heights: std::vec::Vec<f32> = peaks.iter().map(|peak| peak.density).collect();
        assert_eq!(heights, [12.0, 11.0, 10.0, 9.0, 8.0, 7.0, 6.0, 5.0]);
    }

    /// Segments of some sizes, averaged: how many count, and their mean power in the only line.
    fn averaged(sizes: &[f32]) -> (u16, f32) {
        let mut bands = Vec::new();
        bands.push(Band { first_line: 1, lines: 1 }).unwrap();
        let summary = Summary::Psd { segments: 8 };
        let configuration =
            Configuration { channels: 1, sampling_rate_uhz: 1, decimation: 1, segment: 256, summary, bands };
        let (mut cells, mut average) = ([0.0; 1], DensityAverage::START);
        for &size in sizes {
            average.add(&configuration, &mut cells, 0, &[Complex32::new(size, 0.0); 2]);
        }
        (average.segments(0), average.finish(&configuration, &mut cells, 0)[0])
    }

    #[test]
    fn one_segment_with_a_blow_does_not_count_wherever_it_is_and_a_storm_does() {
        assert_eq!(averaged(&[1.0, 3.0, 1.0]), (3, 11.0 / 3.0));
        assert_eq!(averaged(&[1.0, 30.0, 1.0, 1.0]), (3, 1.0), "a blow amid calm");
        assert_eq!(averaged(&[30.0, 1.0, 1.0]), (2, 1.0), "a blow at first");
        assert_eq!(averaged(&[1.0, 1.0, 30.0]), (2, 1.0), "a blow at last");
        assert_eq!(averaged(&[30.0, 30.0, 1.0, 1.0]), (4, 1802.0 / 4.0), "a storm that ends");
        assert_eq!(averaged(&[1.0, 30.0, 30.0, 30.0]), (3, 1801.0 / 3.0), "a storm, but for its first segment");
    }

    #[test]
    fn the_average_is_the_mean_of_squared_lines_of_the_bands() {
        let mut bands = Vec::new();
        for (first_line, lines) in [(1, 2), (5, 1)] {
            bands.push(Band { first_line, lines }).unwrap();
        }
        let summary = Summary::Psd { segments: 2 };
        let configuration =
            Configuration { channels: 2, sampling_rate_uhz: 1, decimation: 1, segment: 256, summary, bands };
        let mut cells = [9.0; 6];
        let mut average = DensityAverage::START;
        let lines: std::vec::Vec<_> = (0..8).map(|k| Complex32::new(k as f32, 0.0)).collect();
        average.add(&configuration, &mut cells, 1, &lines);
        average.add(&configuration, &mut cells, 1, &[Complex32::new(0.0, 2.0); 8]);
        assert_eq!(average.finish(&configuration, &mut cells, 1), [2.5, 4.0, 14.5]);
        assert!(average.finish(&configuration, &mut cells, 0).is_empty());
    }
}
