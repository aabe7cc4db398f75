//! Windows back to samples: inverse transforms, overlapped and added.

use belfry_numerics::{InverseTransform, inverse_transform};
use num_complex::Complex64;

use crate::spectra::{LineGrid, WindowLines};

/// Rebuilds the band-limited samples from windows: periodic Hann windows at 50 % overlap sum to one, so the inverse
/// transforms of neighbouring windows add up to what was measured in the band of the lines.
pub struct OverlapAdd {
    grid: LineGrid,
    epoch_s: f64,
    inverse: InverseTransform,
    /// What the last window leaves for the next half segment, one vector a channel; `None` where it was not sound.
    tail: Vec<Option<Vec<f64>>>,
    last_index: Option<u64>,
    spectrum: Vec<Complex64>,
    samples: Vec<f64>,
    halves: Vec<Option<Vec<f64>>>,
}

/// Half a segment of samples in the band.
#[derive(Debug)]
pub struct Hop<'a> {
    /// Time of the first sample in the recording, in s.
    pub start_s: f64,
    /// Samples at the decimated rate, one slice a channel, in the lines' unit without the 1/√Hz; `None` where a window that
    /// they come from was not sound.
    pub channels: &'a [Option<Vec<f64>>],
}

impl OverlapAdd {
    /// For the windows of one setup with `channels` channels; `epoch_s` is where in the recording the grid's epoch lies.
    pub fn new(grid: LineGrid, epoch_s: f64, channels: usize) -> Self {
        let inverse = inverse_transform(grid.segment);
        let (spectrum, samples) = (inverse.make_input_vec(), inverse.make_output_vec());
        Self {
            grid,
            epoch_s,
            inverse,
            tail: vec![None; channels],
            last_index: None,
            spectrum,
            samples,
            halves: vec![None; channels],
        }
    }

    /// Samples a hop.
    pub fn hop(&self) -> usize {
        self.grid.segment / 2
    }

    /// Takes the next window; hands out the half segment that it completes, if the window before it was there.
    pub fn push(&mut self, window: &WindowLines) -> Option<Hop<'_>> {
        let follows = self.last_index.is_some_and(|last| last + 1 == window.grid_index);
        self.last_index = Some(window.grid_index);
        let hop = self.hop();
        for channel in 0..self.tail.len() {
            let before = self.tail[channel].take();
            let lines = window.channels.get(channel).and_then(Option::as_ref);
            let now = lines.filter(|lines| lines.len() == self.grid.lines).is_some_and(|lines| {
                // |line|² is a one-sided density: the Hann window's squares sum to 3 N/8.
                let scale = (self.grid.sampling_rate_hz * 0.375 * self.grid.segment as f64 / 2.0).sqrt();
                self.spectrum.fill(Complex64::ZERO);
                let band = self.spectrum.iter_mut().skip(self.grid.first_line);
                for (place, line) in band.zip(lines) {
                    *place = Complex64::new(f64::from(line.re), f64::from(line.im)) * scale;
                }
                // The line at half the rate, where there is one, has no phase.
                if let Some(last) = self.spectrum.last_mut() {
                    last.im = 0.0;
                }
                self.inverse.process(&mut self.spectrum, &mut self.samples).is_ok()
            });
            let norm = 1.0 / self.grid.segment as f64;
            self.halves[channel] = match before {
                Some(mut half) if now && follows => {
                    half.iter_mut().zip(&self.samples).for_each(|(sum, sample)| *sum += sample * norm);
                    Some(half)
                }
                _ => None,
            };
            self.tail[channel] = now.then(|| self.samples[hop..].iter().map(|sample| sample * norm).collect());
        }
        let start_s = self.epoch_s + window.grid_index as f64 * hop as f64 / self.grid.sampling_rate_hz;
        follows.then_some(Hop { start_s, channels: &self.halves })
    }
}
