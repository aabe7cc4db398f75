//! Recordings that are joined of blocks too short for their modes.
//!
//! Setups, their lines and the modes that were found flow in; a warning flows out for each setup whose blocks keep segments so short that
//! a mode has less than one line in its bandwidth.

use crate::identify::{MeasuredSetup, Mode};
use crate::spectra::{LineGrid, rows_for};
use crate::study::Setup;

/// A structure's damping where it is not known, or where lines are so coarse that they make a mode look wide.
const USUAL_DAMPING: f64 = 0.01;

/// A setup whose blocks are why its segments are not longer.
struct Limit<'a> {
    setup: &'a Setup,
    block_s: f64,
    grid: LineGrid,
    decimation: u32,
}

/// Says which setups' blocks are too short for which modes, or, where there are none, for one at the band's lower end.
pub(super) fn block_warnings(modes: &[Mode], measured: &[MeasuredSetup<'_>]) -> Vec<String> {
    measured.iter().filter_map(Limit::of).filter_map(|limit| limit.warning(modes)).collect()
}

impl<'a> Limit<'a> {
    fn of(measured: &MeasuredSetup<'a>) -> Option<Self> {
        let (setup, grid) = (measured.setup, *measured.spectrum.grid());
        let block_s = setup.block_s?;
        let decimation = (setup.sampling_rate_hz / grid.sampling_rate_hz).round() as u32;
        let limit = Self { setup, block_s, grid, decimation };
        let is_joined = measured.spectrum.averages() as f64 * 0.5 / grid.spacing_hz() > block_s;
        (is_joined && limit.block_for(2 * grid.segment) > block_s).then_some(limit)
    }

    /// The length of block in s that segments of so many points need: three of them, half over each other. In shorter blocks most windows
    /// are lost at joints, as windows do not begin anew in a block.
    fn block_for(&self, segment: usize) -> f64 {
        rows_for(3, self.decimation, segment) as f64 / self.setup.sampling_rate_hz
    }

    fn warning(&self, modes: &[Mode]) -> Option<String> {
        let segment_s = 1.0 / self.grid.spacing_hz();
        // Half-power bandwidths in Hz, the narrowest first.
        let mut narrow: Vec<(f64, String)> = modes
            .iter()
            .map(|mode| {
                let damping_ratio = mode.damping_ratio.min(USUAL_DAMPING);
                let what =
                    format!("The mode at {:.4} Hz with {:.2} % of damping", mode.frequency_hz, 100.0 * damping_ratio);
                (2.0 * damping_ratio * mode.frequency_hz, what)
            })
            .collect();
        if narrow.is_empty() {
            let low_hz = self.grid.frequency_hz(0);
            let what = format!(
                "A mode at the band's lower end of {low_hz:.4} Hz with {:.0} % of damping",
                100.0 * USUAL_DAMPING
            );
            narrow.push((2.0 * USUAL_DAMPING * low_hz, what));
        }
        narrow.retain(|(bandwidth_hz, _)| bandwidth_hz * segment_s < 1.0);
        narrow.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (bandwidth_hz, what) = narrow.first()?;
        let points = (self.grid.sampling_rate_hz / bandwidth_hz).log2().ceil().exp2() as usize;
        let others = match narrow.len() {
            1 => String::new(),
            2 => "; another mode is too narrow, too".to_owned(),
            count => format!("; {} other modes are too narrow, too", count - 1),
        };
        Some(format!(
            "setup \"{}\": its blocks of {} s (block_s) leave room for segments of {segment_s:.1} s. {what} is {bandwidth_hz:.4} Hz wide, which takes segments of {:.0} s and blocks of {:.0} s{others}. Damping may be far off, and modes may be missing: join longer blocks, or take block_s out if no time is missing between them",
            self.setup.name,
            self.block_s,
            1.0 / bandwidth_hz,
            self.block_for(points)
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::{Study, template};

    /// What is said of modes (frequency in Hz and damping ratio) in blocks of an hour's record at 50 Hz, with lines up to 1.5 Hz.
    fn said(block_s: f64, segment: usize, modes: &[(f64, f64)]) -> Option<String> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("study.toml"), template::CANTON_STUDY).unwrap();
        let study = Study::load(folder.path()).unwrap();
        let grid = LineGrid { sampling_rate_hz: 6.25, segment, first_line: 4, lines: 100 };
        let limit = Limit { setup: &study.setups[0], block_s, grid, decimation: 8 };
        if limit.block_for(2 * segment) <= block_s {
            return None;
        }
        let mode = |(frequency_hz, damping_ratio)| Mode { frequency_hz, damping_ratio, ..mode() };
        limit.warning(&modes.iter().copied().map(mode).collect::<Vec<_>>())
    }

    fn mode() -> Mode {
        crate::identify::accuracy::tests::found().modes.remove(0)
    }

    #[test]
    fn blocks_that_are_too_short_for_a_mode_are_told_with_the_lengths_that_it_takes() {
        let modes = [(0.11, 0.01), (0.4, 0.01), (1.4, 0.01)];
        // Segments of 41 s; the modes are 0.0022, 0.008 and 0.028 Hz wide.
        let text = said(100.0, 256, &modes).unwrap();
        assert!(
            text.contains("segments of 41.0 s. The mode at 0.1100 Hz with 1.00 % of damping is 0.0022 Hz"),
            "{text}"
        );
        assert!(
            text.contains("takes segments of 455 s and blocks of ") && text.contains("; another mode is"),
            "{text}"
        );
        assert_eq!(said(600.0, 256, &modes), None, "blocks that would hold longer segments are not to blame");
        assert_eq!(said(100.0, 256, &modes[2..]), None, "more than a line in its bandwidth");
        // Coarse lines make a mode look wide.
        assert!(said(100.0, 256, &[(0.11, 0.15)]).is_some());
        let text = said(100.0, 256, &[]).unwrap();
        assert!(text.contains("A mode at the band's lower end of 0.0977 Hz with 1 % of damping"), "{text}");
    }
}
