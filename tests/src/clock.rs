//! Time on real lines: nodes that sample by their own crystals over lines that jitter, against perfectly timed ones.

use std::fmt;
use std::path::Path;

use belfry_host::fleet::{Fleet, FleetOptions, Pace};
use belfry_host::identify::{Identification, MeasuredSetup, identify};
use belfry_host::link::memory::Faults;
use belfry_host::model::BeamTable;
use belfry_host::simulate::{Options, Simulation};
use belfry_host::spectra::{CrossSpectrumAccumulator, LineGrid, SetupExtent, SpectralPlan, WindowLines};
use belfry_host::study::{Setup, Study, template};
use belfry_host::window::channels_by_node;

/// The frequency at which phases are stated.
const PHASE_AT_HZ: f64 = 1.25;
/// What a day is to reach: 1 - MAC, and phases at 1.25 Hz in degrees.
pub const MAC_LOSS: f64 = 1e-4;
/// See [`MAC_LOSS`].
pub const PHASE_DEG: f64 = 0.2;
/// Rows that are simulated at a time.
const BLOCK_ROWS: usize = 4096;
/// Components of a shape below this share of its largest have no phase worth stating.
const LEAST_COMPONENT: f64 = 0.1;

/// What is studied.
#[derive(Debug, Clone, Copy)]
pub struct ClockStudy {
    /// Length of the recording.
    pub hours: f64,
    /// How far crystals are off; every other node's fast, the others' slow.
    pub crystal_ppm: f64,
    /// How much further as they warm and cool in the course of a day, each node's at hours of its own.
    pub swing_ppm: f64,
    /// How late frames may arrive, either way.
    pub jitter_ms: f64,
    /// Draws loads, noise, boots and jitter.
    pub seed: u64,
}

/// What came of it.
#[derive(Debug, Clone)]
pub struct ClockReport {
    /// Windows of both that were compared.
    pub windows: usize,
    /// Frequency in Hz, 1 - MAC, and the largest phase difference of a component at 1.25 Hz in degrees, mode by mode.
    pub modes: Vec<(f64, f64, f64)>,
    /// Mean and RMS over the windows of each node's segment start against the perfectly timed, in µs.
    pub nodes: Vec<(u16, f64, f64)>,
}

impl ClockReport {
    /// The largest 1 - MAC.
    pub fn worst_mac_loss(&self) -> f64 {
        self.modes.iter().map(|mode| mode.1).fold(0.0, f64::max)
    }

    /// How far apart nodes' segments are in the mean, as a phase at 1.25 Hz in degrees: what clocks do to every component of every
    /// shape, also where too few averages leave phases of their own.
    pub fn nodes_apart_deg(&self) -> f64 {
        let means = self.nodes.iter().map(|node| node.1);
        let apart_us = means.clone().fold(f64::MIN, f64::max) - means.fold(f64::MAX, f64::min);
        360.0 * PHASE_AT_HZ * apart_us * 1e-6
    }

    /// The largest phase difference at 1.25 Hz of components that are not small, in degrees.
    pub fn worst_phase_deg(&self) -> f64 {
        self.modes.iter().map(|mode| mode.2).fold(0.0, f64::max)
    }
}

impl fmt::Display for ClockReport {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(formatter, "{} windows", self.windows)?;
        for (frequency_hz, mac_loss, phase_deg) in &self.modes {
            writeln!(
                formatter,
                "{frequency_hz:8.4} Hz: 1 - MAC {mac_loss:.1e}, phases within {phase_deg:.3}° at {PHASE_AT_HZ} Hz"
            )?;
        }
        for (node, mean_us, rms_us) in &self.nodes {
            writeln!(
                formatter,
                "node {node}: segments' middles are {mean_us:+.1} µs off the grid in the mean, {rms_us:.1} µs RMS"
            )?;
        }
        write!(
            formatter,
            "worst: 1 - MAC {:.1e} (reach {MAC_LOSS:.0e}), phase {:.3}° (reach {PHASE_DEG}); nodes are {:.3}° apart in the mean",
            self.worst_mac_loss(),
            self.worst_phase_deg(),
            self.nodes_apart_deg(),
        )
    }
}

/// The windows of one fleet as they come, and their average.
struct Side {
    fleet: Fleet,
    waiting: Vec<WindowLines>,
    average: CrossSpectrumAccumulator,
}

impl Side {
    fn new(setup: &Setup, decimation: u32, grid: &LineGrid, options: &FleetOptions) -> Result<Self, String> {
        Ok(Self {
            fleet: Fleet::start(setup, decimation, grid, options).map_err(|error| error.to_string())?,
            waiting: Vec::new(),
            average: CrossSpectrumAccumulator::new(*grid, setup.sensors.len()).map_err(|error| error.to_string())?,
        })
    }

    fn push(&mut self, rows: &[f64]) -> Result<(), String> {
        let waiting = &mut self.waiting;
        self.fleet.push(rows, &mut |window| waiting.push(window)).map_err(|error| error.to_string())
    }

    fn finish(self) -> Result<(Vec<WindowLines>, CrossSpectrumAccumulator), String> {
        let Self { fleet, mut waiting, average } = self;
        fleet.finish(&mut |window| waiting.push(window)).map_err(|error| error.to_string())?;
        Ok((waiting, average))
    }
}

/// Sums over windows of how late a node's segments started.
#[derive(Debug, Clone, Copy, Default)]
struct Lateness {
    windows: usize,
    sum_s: f64,
    squares_s2: f64,
}

/// How much later than `exact` the lines of `timed` were taken, in s: the least-squares slope of their phases,
/// sum w Im(t e*) / sum w² |e|² with w = 2 pi f.
fn lateness_s(grid: &LineGrid, timed: &WindowLines, exact: &WindowLines, channels: &[usize]) -> Option<f64> {
    let (mut product, mut square) = (0.0, 0.0);
    for &channel in channels {
        let (timed, exact) = (timed.channels.get(channel)?.as_ref()?, exact.channels.get(channel)?.as_ref()?);
        for (line, (timed, exact)) in timed.iter().zip(exact).enumerate() {
            let omega = std::f64::consts::TAU * grid.frequency_hz(line);
            product += omega * f64::from((timed * exact.conj()).im);
            square += omega * omega * f64::from(exact.norm_sqr());
        }
    }
    (square > 0.0).then(|| product / square)
}

/// Plays the simulated tower of the built-in study to both kinds of nodes.
///
/// # Errors
/// When the simulation or a node fails, or modes cannot be identified.
pub fn run(study: &ClockStudy) -> Result<ClockReport, String> {
    let told = |error: &dyn fmt::Display| error.to_string();
    let study_of_tower = Study::from_text(template::CANTON_STUDY, Path::new(".")).map_err(|error| told(&error))?;
    let setup = study_of_tower.setups.first().ok_or("the built-in study has no setup")?;
    let beam = BeamTable::from_reader(template::CANTON_BEAM.as_bytes(), Path::new("beam.csv"))
        .map_err(|error| told(&error))?;
    let options = Options { seed: study.seed, ..Options::default() };
    let mut simulation = Simulation::of_beam(beam, &[], setup, &options).map_err(|error| told(&error))?;
    let rows = (study.hours * 3600.0 * setup.sampling_rate_hz) as u64;
    let extent =
        SetupExtent { sampling_rate_hz: setup.sampling_rate_hz, rows, channels: setup.sensors.len(), block_rows: None };
    let plan = SpectralPlan::choose(&[extent], &study_of_tower.analysis).map_err(|error| told(&error))?;
    let (grid, decimation) = (plan.grid, *plan.decimations.first().ok_or("no plan")?);
    let perfect =
        FleetOptions { pace: Pace::Crystal { ppm: 0.0, swing_ppm: 0.0 }, seed: study.seed, ..FleetOptions::default() };
    let jitter_us = (study.jitter_ms * 1000.0) as u32;
    let real = FleetOptions {
        pace: Pace::Crystal { ppm: study.crystal_ppm, swing_ppm: study.swing_ppm },
        faults: Faults { jitter_us, ..Faults::default() },
        ..perfect
    };
    let mut exact = Side::new(setup, decimation, &grid, &perfect)?;
    let mut timed = Side::new(setup, decimation, &grid, &real)?;
    let nodes = channels_by_node(setup);
    let mut lateness = vec![Lateness::default(); nodes.len()];
    let mut compared = 0;
    let mut compare = |exact: &mut Vec<WindowLines>, timed: &mut Vec<WindowLines>| {
        while let (Some(a), Some(b)) = (exact.first(), timed.first()) {
            // Where one side has left a window out, the other's has no partner.
            if a.grid_index != b.grid_index {
                if a.grid_index < b.grid_index {
                    drop(exact.remove(0))
                } else {
                    drop(timed.remove(0))
                };
                continue;
            }
            compared += 1;
            for (channels, lateness) in nodes.values().zip(&mut lateness) {
                if let Some(late_s) = lateness_s(&grid, b, a, channels) {
                    lateness.windows += 1;
                    lateness.sum_s += late_s;
                    lateness.squares_s2 += late_s * late_s;
                }
            }
            drop((exact.remove(0), timed.remove(0)));
        }
    };
    let mut done = 0;
    let (mut exact_windows, mut timed_windows) = (Vec::new(), Vec::new());
    let average = |side: &mut CrossSpectrumAccumulator, windows: &[WindowLines]| -> Result<(), String> {
        windows.iter().try_for_each(|window| side.add(window.clone()).map_err(|error| error.to_string()))
    };
    while done < rows {
        let mut block: Vec<f64> = Vec::new();
        while block.len() < BLOCK_ROWS * setup.sensors.len() && done < rows {
            let next = simulation.next_rows((rows - done) as usize);
            done += (next.len() / setup.sensors.len()) as u64;
            block.extend(next.iter().map(|&value| f64::from(value)));
        }
        for (side, windows) in [(&mut exact, &mut exact_windows), (&mut timed, &mut timed_windows)] {
            side.push(&block)?;
            let fresh = std::mem::take(&mut side.waiting);
            average(&mut side.average, &fresh)?;
            windows.extend(fresh);
        }
        compare(&mut exact_windows, &mut timed_windows);
    }
    let mut identified = Vec::new();
    for (side, windows) in [(exact, &mut exact_windows), (timed, &mut timed_windows)] {
        let (rest, mut spectrum) = side.finish()?;
        average(&mut spectrum, &rest)?;
        windows.extend(rest);
        let (spectrum, _) = spectrum.finish().map_err(|error| told(&error))?;
        let modes = &study_of_tower.analysis.modes;
        identified.push(identify(&[MeasuredSetup { setup, spectrum }], modes).map_err(|error| told(&error))?);
    }
    compare(&mut exact_windows, &mut timed_windows);
    let [exact, timed] = identified.as_slice() else { return Err("two identifications".into()) };
    let of_node = |(node, late): (&u16, &Lateness)| {
        let count = late.windows.max(1) as f64;
        (*node, 1e6 * late.sum_s / count, 1e6 * (late.squares_s2 / count).sqrt())
    };
    let nodes = nodes.keys().zip(&lateness).map(of_node).collect();
    Ok(ClockReport { windows: compared, modes: modes(exact, timed)?, nodes })
}

/// Mode by mode: frequency, 1 - MAC, and the largest phase difference of a component at 1.25 Hz.
fn modes(exact: &Identification, timed: &Identification) -> Result<Vec<(f64, f64, f64)>, String> {
    if exact.modes.len() != timed.modes.len() {
        return Err(format!(
            "{} modes of perfectly timed nodes, {} of the others: in a short record a weak one may be picked on one side alone",
            exact.modes.len(),
            timed.modes.len()
        ));
    }
    let compared = exact.modes.iter().zip(&timed.modes).map(|(exact, timed)| {
        let pairs: Vec<_> = exact.shape.iter().zip(&timed.shape).collect();
        let product = pairs
            .iter()
            .fold((0.0, 0.0), |sum, (a, b)| (sum.0 + a.re * b.re + a.im * b.im, sum.1 + a.re * b.im - a.im * b.re));
        let squares = |of: fn(&(f64, f64, f64, f64)) -> f64| -> f64 {
            pairs.iter().map(|(a, b)| of(&(a.re, a.im, b.re, b.im))).sum()
        };
        let (norm_a, norm_b) = (squares(|c| c.0 * c.0 + c.1 * c.1), squares(|c| c.2 * c.2 + c.3 * c.3));
        let mac = (product.0 * product.0 + product.1 * product.1) / (norm_a * norm_b);
        let common = f64::atan2(product.1, product.0);
        let largest = pairs.iter().map(|(a, _)| a.re.hypot(a.im)).fold(0.0, f64::max);
        let phase = pairs
            .iter()
            .filter(|(a, _)| a.re.hypot(a.im) >= LEAST_COMPONENT * largest)
            .map(|(a, b)| {
                let turn = f64::atan2(a.re * b.im - a.im * b.re, a.re * b.re + a.im * b.im) - common;
                f64::atan2(turn.sin(), turn.cos()).abs().to_degrees()
            })
            .fold(0.0, f64::max);
        (exact.frequency_hz, 1.0 - mac, phase * PHASE_AT_HZ / exact.frequency_hz)
    });
    Ok(compared.collect())
}
