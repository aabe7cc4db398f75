//! The schedule: which decimated samples make the next window, so that all nodes' windows start on one grid of host time.

use belfry_shared::division::{quotient, quotient_rounded_down, quotient_towards_zero};
use belfry_shared::message::Configuration;
use belfry_shared::time::{ClockModel, HostTime, NodeTime, WindowGrid};

/// Which samples make a window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct WindowSpan {
    /// Index on the grid of host time.
    pub(crate) grid_index: u64,
    /// Index of its first decimated sample.
    pub(crate) start: u64,
}

/// A decimated sample and when it was, on the node's clock.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SampleMoment {
    /// Index of the decimated sample.
    pub(crate) index: u64,
    /// When it was.
    pub(crate) time: NodeTime,
}

/// Turns grid times into sample indices.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Schedule {
    grid: WindowGrid,
    /// Decimated sampling period in ps.
    period_ps: u64,
}

impl Schedule {
    /// The schedule of a (checked) configuration.
    pub(crate) fn new(configuration: &Configuration) -> Self {
        Self {
            grid: WindowGrid {
                sampling_rate_uhz: configuration.sampling_rate_uhz,
                hop_samples: configuration.hop_samples(),
            },
            period_ps: rows_to_ps(u64::from(configuration.decimation), configuration.sampling_rate_uhz),
        }
    }

    /// How far `time` is from the nearest multiple of the decimated period, in ps: decimated samples centred on such
    /// multiples put windows on the grid without a remainder.
    pub(crate) fn phase_ps(&self, time: HostTime) -> i64 {
        let period = self.period_ps.max(1);
        let half = i128::from(period / 2);
        let since_half = i128::from(time.0) * 1_000_000 + half;
        let remainder = since_half - quotient_rounded_down(since_half, period) * i128::from(period);
        (remainder - half) as i64
    }

    /// The first window that starts no earlier than sample `earliest` (to within half a decimated period).
    pub(crate) fn first(&self, clock: &ClockModel, moment: SampleMoment, earliest: u64) -> WindowSpan {
        let samples = i128::from(earliest) - i128::from(moment.index);
        let ahead_ps = samples * i128::from(self.period_ps) - i128::from(self.period_ps / 2);
        let ahead_us = quotient_towards_zero(ahead_ps, 1_000_000);
        let time = HostTime(clock.host_time(moment.time).0.saturating_add(ahead_us as i64));
        self.window(clock, moment, self.grid.first_at_or_after(time))
    }

    /// The window of a grid index, seen from a recent sample.
    pub(crate) fn window(&self, clock: &ClockModel, moment: SampleMoment, grid_index: u64) -> WindowSpan {
        let here = clock.host_time(moment.time);
        let ahead_host_ps = (i128::from(self.grid.start(grid_index).0) - i128::from(here.0)) * 1_000_000;
        // Samples are a period of the node's clock apart.
        let ahead_ps = ahead_host_ps - drifted(ahead_host_ps, clock);
        let period = self.period_ps.max(1);
        let samples = quotient_rounded_down(ahead_ps + i128::from(period / 2), period);
        WindowSpan { grid_index, start: moment.index.saturating_add_signed(samples as i64) }
    }

    /// When the middle of a window was, minus when it should have been by the grid, in µs; seen from a recent sample.
    ///
    /// The middle counts, since a Hann segment's phases are those of its middle: samples of a crystal that is 50 ppm off gather
    /// 20 ms over half a segment of 819 s.
    pub(crate) fn middle_offset_us(
        &self,
        clock: &ClockModel,
        moment: SampleMoment,
        span: &WindowSpan,
        segment: usize,
    ) -> i32 {
        let samples = i128::from(moment.index) - i128::from(span.start) - (segment / 2) as i128;
        let node_ps = samples * i128::from(self.period_ps);
        let host_ps = node_ps + drifted(node_ps, clock);
        let middle_us = i128::from(clock.host_time(moment.time).0) - quotient_towards_zero(host_ps, 1_000_000);
        // Windows overlap by half: a middle is where the next window starts.
        let due_us = i128::from(self.grid.start(span.grid_index + 1).0);
        (middle_us - due_us).clamp(i128::from(i32::MIN), i128::from(i32::MAX)) as i32
    }
}

/// What a clock gathers over so many ps.
fn drifted(ps: i128, clock: &ClockModel) -> i128 {
    quotient_towards_zero(ps * i128::from(clock.drift_ppb), 1_000_000_000)
}

/// The duration of `rows` sampling periods in ps.
pub(crate) fn rows_to_ps(rows: u64, sampling_rate_uhz: u64) -> u64 {
    let ps = quotient(u128::from(rows) * 1_000_000_000_000_000_000, u128::from(sampling_rate_uhz.max(1)));
    u64::try_from(ps).unwrap_or(u64::MAX)
}

/// The same in whole µs; every row asks for it, and a division of 128 bits takes the core hundreds of instructions more.
pub(crate) fn rows_to_us(rows: u64, sampling_rate_uhz: u64) -> u64 {
    match rows.checked_mul(1_000_000_000_000) {
        Some(product) => product / sampling_rate_uhz.max(1),
        None => rows_to_ps(rows, sampling_rate_uhz) / 1_000_000,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use belfry_shared::message::Summary;
    use heapless::Vec;

    fn configuration() -> Configuration {
        Configuration {
            channels: 1,
            sampling_rate_uhz: 50_000_000,
            decimation: 10,
            segment: 256,
            summary: Summary::Lines { bits: 8 },
            bands: Vec::new(),
        }
    }

    #[test]
    fn windows_start_at_the_sample_nearest_to_the_grid_and_say_how_far_off_it_is() {
        let schedule = Schedule::new(&configuration());
        // Host and node agree; sample 100 was at 7.03 s, samples are 0.2 s apart, the hop is 25.6 s.
        let clock = ClockModel { node: NodeTime(0), host: HostTime(0), drift_ppb: 0 };
        let moment = SampleMoment { index: 100, time: NodeTime(7_030_000) };
        let first = schedule.first(&clock, moment, 90);
        // 25.6 s is 18.57 s (92.85 samples) later: sample 193 at 25.63 s.
        assert_eq!(first, WindowSpan { grid_index: 1, start: 193 });
        assert_eq!(schedule.middle_offset_us(&clock, moment, &first, 256), 30_000);
        assert_eq!(schedule.window(&clock, moment, 2).start, 321);
    }

    #[test]
    fn a_drifting_clock_moves_the_start_by_one_sample_when_half_a_sample_has_gathered() {
        let schedule = Schedule::new(&configuration());
        // The node's clock runs 20 ppm slow: 0.1 s (half a sample) are gathered after 5000 s, in window 195 (4992 s) of
        // 25.6 s hops. Samples are 0.2 s of the node's clock apart; any sample serves as the moment.
        let clock = ClockModel { node: NodeTime(0), host: HostTime(0), drift_ppb: 20_000 };
        for index in [0, 24_000, 30_000] {
            let moment = SampleMoment { index, time: NodeTime(index * 200_000) };
            let spans = [195_u64, 196].map(|grid_index| schedule.window(&clock, moment, grid_index));
            assert_eq!(spans.map(|span| span.start as i64 - (span.grid_index * 128) as i64), [0, -1]);
            // Starts: 4992 s x 20 ppm = 99.84 ms late; a sample earlier, 5017.6 s x 20 ppm - 200 ms = 99.65 ms early. Middles:
            // another 25.6 s x 20 ppm later.
            let late_us = spans.map(|span| schedule.middle_offset_us(&clock, moment, &span, 256));
            assert!((late_us[0] - 100_352).abs() < 5 && (late_us[1] + 99_136).abs() < 10, "{late_us:?}");
        }
    }

    #[test]
    fn whole_microseconds_are_those_of_the_picoseconds() {
        for rate_uhz in [50_000_000, 1_000_000_000, 33_333_333, 7] {
            for rows in [0, 1, 7, 999, 123_456, 18_446_744, 18_446_745, 4_000_000_000] {
                let ps = u128::from(rows) * 1_000_000_000_000_000_000 / u128::from(rate_uhz);
                if ps <= u128::from(u64::MAX) {
                    assert_eq!(rows_to_us(rows, rate_uhz), rows_to_ps(rows, rate_uhz) / 1_000_000);
                }
            }
        }
    }

    #[test]
    fn the_phase_is_the_distance_to_the_next_multiple_of_the_decimated_period() {
        let schedule = Schedule::new(&configuration());
        assert_eq!(schedule.phase_ps(HostTime(400_000)), 0);
        assert_eq!(schedule.phase_ps(HostTime(-390_000)), 10_000 * 1_000_000);
        assert_eq!(schedule.phase_ps(HostTime(390_000)), -10_000 * 1_000_000);
    }
}
