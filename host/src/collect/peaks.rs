//! Peaks for the live view: where a node's channels move most. Not an identification.

use belfry_shared::message::Configuration;

use crate::statistics::median;
use crate::window::{ChannelData, NodeWindow};

/// How much of the mean a new window is at least.
const LEAST_SHARE: f64 = 0.05;
/// Peaks that are shown.
const SHOWN: usize = 3;
/// A peak stands this much above the median density.
const ABOVE_MEDIAN: f64 = 4.0;
/// Peaks are at least this many lines apart: the main lobe of the Hann window.
const APART: usize = 4;

/// The running mean of all channels' densities, and its peaks.
#[derive(Debug, Clone)]
pub(super) struct PeakMeter {
    /// Frequency of each line in Hz.
    frequencies_hz: Vec<f64>,
    mean: Vec<f64>,
    windows: usize,
    peaks_hz: Vec<f64>,
}

impl PeakMeter {
    pub(super) fn new(configuration: &Configuration) -> Self {
        let rate_hz = configuration.sampling_rate_uhz as f64 * 1e-6 / f64::from(configuration.decimation.max(1));
        let spacing_hz = rate_hz / f64::from(configuration.segment.max(1));
        let lines = configuration.bands.iter().flat_map(|band| (band.first_line..).take(usize::from(band.lines)));
        let frequencies_hz: Vec<f64> = lines.map(|line| f64::from(line) * spacing_hz).collect();
        Self { mean: vec![0.0; frequencies_hz.len()], frequencies_hz, windows: 0, peaks_hz: Vec::new() }
    }

    /// Adds a window's densities.
    pub(super) fn add(&mut self, window: &NodeWindow) {
        let mut densities = vec![0.0; self.mean.len()];
        let mut channels = 0;
        for data in &window.channels {
            let of_channel: Vec<f64> = match data {
                ChannelData::Lines(lines) => lines.iter().map(|line| f64::from(line.norm_sqr())).collect(),
                ChannelData::Psd { densities, .. } => densities.iter().map(|&density| f64::from(density)).collect(),
                ChannelData::Unsound(_) => continue,
            };
            // Windows of another configuration have other lines.
            if of_channel.len() == densities.len() {
                densities.iter_mut().zip(of_channel).for_each(|(sum, density)| *sum += density);
                channels += 1;
            }
        }
        if channels == 0 {
            return;
        }
        self.windows += 1;
        let share = (1.0 / self.windows as f64).max(LEAST_SHARE);
        for (mean, density) in self.mean.iter_mut().zip(densities) {
            *mean += share * (density - *mean);
        }
        self.peaks_hz = self.find();
    }

    fn find(&self) -> Vec<f64> {
        let median = median(&mut self.mean.clone()).unwrap_or(0.0);
        let mut candidates: Vec<usize> = (0..self.mean.len())
            .filter(|&line| {
                let around = &self.mean[line.saturating_sub(APART)..(line + APART + 1).min(self.mean.len())];
                self.mean[line] > ABOVE_MEDIAN * median && around.iter().all(|&other| other <= self.mean[line])
            })
            .collect();
        candidates.sort_by(|&a, &b| self.mean[b].total_cmp(&self.mean[a]));
        candidates.iter().take(SHOWN).filter_map(|&line| self.frequencies_hz.get(line).copied()).collect()
    }

    /// The highest peaks, highest first; none before the first window.
    pub(super) fn peaks_hz(&self) -> &[f64] {
        &self.peaks_hz
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use belfry_shared::message::{Band, ChannelState, Summary, WindowName};
    use num_complex::Complex32;

    #[test]
    fn peaks_are_the_frequencies_that_stand_out_highest_first_and_unsound_channels_do_not_count() {
        let bands = [Band { first_line: 10, lines: 100 }];
        let configuration = Configuration {
            channels: 2,
            sampling_rate_uhz: 50_000_000,
            decimation: 10,
            segment: 1024,
            summary: Summary::Lines { bits: 10 },
            bands: bands.into_iter().collect(),
        };
        let mut meter = PeakMeter::new(&configuration);
        let lines: Vec<Complex32> = (0..100_u8)
            .map(|line| match line {
                20 => Complex32::new(9.0, 0.0),
                // The skirt of the first is no peak of its own.
                22 => Complex32::new(4.0, 0.0),
                60 => Complex32::new(0.0, 30.0),
                _ => Complex32::new(1.0, 0.1 * f32::from(line % 3)),
            })
            .collect();
        let window = NodeWindow {
            name: WindowName { node: 1, boot: 1, number: 0 },
            configuration_hash: 0,
            grid_index: 0,
            middle_offset_us: 0,
            drift_ppb: 0,
            channels: vec![ChannelData::Lines(lines), ChannelData::Unsound(ChannelState::Missing)],
        };
        meter.add(&window);
        let spacing_hz = 5.0 / 1024.0;
        assert_eq!(meter.peaks_hz(), [70.0 * spacing_hz, 30.0 * spacing_hz]);
    }
}
