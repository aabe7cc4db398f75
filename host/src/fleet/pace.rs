//! A node's crystal, and samples at its moments from rows that were sampled by an exact clock.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use belfry_shared::message::MAX_CHANNELS;

use crate::link::memory::Nanoseconds;

/// Rows that a sample is interpolated from.
const SUPPORT: usize = 6;

type Row = [f64; MAX_CHANNELS];

/// What a node's clock counts: how fast it is at the moment is `drift + swing cos(TAU t / period + phase)`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Crystal {
    /// When it was switched on.
    pub(super) boot_ns: Nanoseconds,
    /// How much it gains in the mean.
    pub(super) drift: f64,
    /// How much more at most as it warms and cools.
    pub(super) swing: f64,
    /// Time from warmth to warmth in ns.
    pub(super) swing_period_ns: f64,
    /// Phase of the swing in rad.
    pub(super) phase: f64,
}

impl Crystal {
    /// One that is exact.
    pub(super) fn exact(boot_ns: Nanoseconds) -> Self {
        Self { boot_ns, drift: 0.0, swing: 0.0, swing_period_ns: 1.0, phase: 0.0 }
    }

    /// What it has counted by `now`, in ns.
    pub(super) fn count_ns(&self, now: Nanoseconds) -> f64 {
        self.count_at(now as f64)
    }

    fn count_at(&self, now_ns: f64) -> f64 {
        let boot_ns = self.boot_ns as f64;
        (now_ns - boot_ns) * (1.0 + self.drift) + self.swung_ns(now_ns, boot_ns)
    }

    /// What the swing gained from `boot_ns` to `now_ns`. A node asks for its time in every step of the simulation: two sines that
    /// nobody needs were a third of the demo's time.
    fn swung_ns(&self, now_ns: f64, boot_ns: f64) -> f64 {
        if self.swing == 0.0 {
            return 0.0;
        }
        let swung = |ns: f64| (TAU * ns / self.swing_period_ns + self.phase).sin();
        self.swing * self.swing_period_ns / TAU * (swung(now_ns) - swung(boot_ns))
    }

    /// When it has counted so much: the inverse of [`count_ns`](Self::count_ns), to a thousandth of a nanosecond.
    fn moment_ns(&self, count_ns: f64) -> f64 {
        let mut now_ns = self.boot_ns as f64 + count_ns / (1.0 + self.drift);
        // Each step is nearer by the swing's share, which is a matter of parts per million.
        for _ in 0..4 {
            now_ns += (count_ns - self.count_at(now_ns)) / (1.0 + self.drift);
        }
        now_ns
    }
}

/// Interpolates rows by the polynomial through six of them (Lagrange). A sine of a thirtieth of the sampling rate comes out
/// within 1e-6; what lies near the Nyquist rate does not, and is for the node's filter to remove.
pub(super) struct Resampler {
    rows: VecDeque<Row>,
    /// Time of the first row that was pushed, and between rows, in ns.
    first_ns: Nanoseconds,
    period_ns: f64,
    pushed: u64,
    /// What makes the samples, one every `period_ns` that it counts, and how many it has made.
    crystal: Crystal,
    taken: u64,
}

impl Resampler {
    pub(super) fn new(first_ns: Nanoseconds, period_ns: f64, crystal: Crystal) -> Self {
        Self { rows: VecDeque::with_capacity(SUPPORT), first_ns, period_ns, pushed: 0, crystal, taken: 0 }
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
            let count_ns = self.crystal.count_ns(self.first_ns) + self.taken as f64 * self.period_ns;
            let elapsed_ns = self.crystal.moment_ns(count_ns) - self.first_ns as f64;
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
        let crystal = Crystal { drift, ..Crystal::exact(-3_000_000_000) };
        let period_ns = 1e9 / rate_hz;
        let value = |seconds: f64| (std::f64::consts::TAU * frequency_hz * seconds + 0.3).sin();
        let first_ns = -7_000_000;
        let mut resampler = Resampler::new(first_ns, period_ns, crystal);
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

    #[test]
    fn a_crystal_that_swings_is_as_fast_as_it_says_and_its_moments_are_those_of_its_counts() {
        let day_ns = 86_400e9;
        let crystal =
            Crystal { boot_ns: -500_000_000_000, drift: 30e-6, swing: 5e-6, swing_period_ns: day_ns, phase: 0.7 };
        for hour in 0..30_u32 {
            let now = i64::from(hour) * 3_600_000_000_000;
            let moment_ns = crystal.moment_ns(crystal.count_ns(now));
            assert!((moment_ns - now as f64).abs() < 0.05, "{hour} h: {moment_ns}");
            let second = 1_000_000_000;
            let rate = (crystal.count_ns(now + second) - crystal.count_ns(now)) / second as f64 - 1.0;
            let expected = 30e-6 + 5e-6 * (TAU * f64::from(hour) / 24.0 + 0.7).cos();
            assert!((rate - expected).abs() < 1e-9, "{hour} h: {rate} for {expected}");
        }
    }
}
