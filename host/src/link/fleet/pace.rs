//! Samples at the moments of a node's own crystal, from rows that were sampled by an exact clock.

use std::collections::VecDeque;

use belfry_shared::message::MAX_CHANNELS;

use crate::link::memory::Nanoseconds;

/// Rows that a sample is interpolated from.
const SUPPORT: usize = 6;

type Row = [f64; MAX_CHANNELS];

/// Interpolates rows by the polynomial through six of them (Lagrange). A sine of a thirtieth of the sampling rate comes out
/// within 1e-6; what lies near the Nyquist rate does not, and is for the node's filter to remove.
pub(super) struct Resampler {
    rows: VecDeque<Row>,
    /// Time of the first row that was pushed, and between rows, in ns.
    first_ns: Nanoseconds,
    period_ns: f64,
    pushed: u64,
    /// The node's own period, and samples taken.
    own_period_ns: f64,
    taken: u64,
}

impl Resampler {
    pub(super) fn new(first_ns: Nanoseconds, period_ns: f64, own_period_ns: f64) -> Self {
        Self { rows: VecDeque::with_capacity(SUPPORT), first_ns, period_ns, pushed: 0, own_period_ns, taken: 0 }
    }

    /// Takes a row, and gives the samples whose moments now lie in the middle of the rows kept.
    pub(super) fn push(&mut self, row: Row, mut on_sample: impl FnMut(Nanoseconds, &Row)) {
        if self.rows.len() == SUPPORT {
            self.rows.pop_front();
        }
        self.rows.push_back(row);
        self.pushed += 1;
        if self.rows.len() < SUPPORT {
            return;
        }
        // In periods after the oldest row that is kept.
        let oldest = (self.pushed - SUPPORT as u64) as f64;
        loop {
            let elapsed_ns = self.taken as f64 * self.own_period_ns;
            let place = elapsed_ns / self.period_ns - oldest;
            if place > (SUPPORT / 2) as f64 {
                return;
            }
            self.taken += 1;
            // The first moments lie before the middle, and are left out.
            if place >= (SUPPORT / 2 - 1) as f64 {
                on_sample(self.first_ns + elapsed_ns.round() as Nanoseconds, &self.at(place));
            }
        }
    }

    fn at(&self, place: f64) -> Row {
        let mut sample = [0.0; MAX_CHANNELS];
        for (index, row) in self.rows.iter().enumerate() {
            let others = (0..SUPPORT).filter(|&other| other != index);
            let weight: f64 = others.map(|other| (place - other as f64) / (index as f64 - other as f64)).product();
            sample.iter_mut().zip(row).for_each(|(sum, value)| *sum += weight * value);
        }
        sample
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_those_of_the_signal_at_the_crystals_own_moments() {
        let (rate_hz, frequency_hz, drift) = (50.0, 1.5, 200e-6);
        let period_ns = 1e9 / rate_hz;
        let value = |seconds: f64| (std::f64::consts::TAU * frequency_hz * seconds + 0.3).sin();
        let first_ns = -7_000_000;
        let mut resampler = Resampler::new(first_ns, period_ns, period_ns / (1.0 + drift));
        let mut moments = Vec::new();
        for row in 0..50_000 {
            let seconds = first_ns as f64 * 1e-9 + f64::from(row) / rate_hz;
            resampler.push([value(seconds), 0.0, 0.0, 0.0], |moment, sample| {
                assert!((sample[0] - value(moment as f64 * 1e-9)).abs() < 2e-6, "at {moment}");
                moments.push(moment);
            });
        }
        // The crystal is fast: ten samples more in 1000 s, and all at its own distance.
        assert!((moments.len() as f64 - 50_010.0).abs() < 7.0, "{}", moments.len());
        let own_ns = period_ns / (1.0 + drift);
        assert!(moments.windows(2).all(|pair| ((pair[1] - pair[0]) as f64 - own_ns).abs() < 1.5));
    }
}
