//! The archive at its size: what a day of the stand-in tower's nodes takes, and how long a range of a month takes to read.

use std::fmt;
use std::fs;
use std::path::Path;
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use belfry_host::archive::{ARCHIVE_FILE, Archive, TimeRange};
use belfry_host::fleet::{Fleet, FleetOptions, Pace};
use belfry_host::measure::{Route, measure};
use belfry_host::model::BeamTable;
use belfry_host::simulate::{Options, Simulation};
use belfry_host::spectra::{Lines, SetupExtent, SpectralPlan};
use belfry_host::study::{Setup, Study, template};
use belfry_host::window::{NodeWindow, channels_by_node, node_configuration};
use belfry_shared::message::Configuration;
use belfry_shared::time::HostTime;

/// What a day is to take at most.
pub const BYTES_A_DAY: u64 = 20_000_000;
/// What a range is measured over, in days; the first is everything.
const RANGES_DAYS: [Option<u64>; 3] = [None, Some(7), Some(1)];
/// Seconds of a day.
const DAY_S: f64 = 86_400.0;
/// In hops of 492 s since the Unix epoch: 2026-01-27.
const FIRST_START: u64 = 3_600_000;
/// Each is measured so often, in turn; the quickest counts.
const TIMES: usize = 3;

/// What came of it.
#[derive(Debug, Clone)]
pub struct ArchiveReport {
    /// Windows of nodes in the archive.
    pub windows: usize,
    /// Days from its first window to its last.
    pub days: f64,
    /// Its size.
    pub bytes: u64,
    /// For each range: its name, the averages, and the time to average it.
    pub ranges: Vec<(String, usize, Duration)>,
}

impl ArchiveReport {
    /// Bytes of a day.
    pub fn bytes_a_day(&self) -> u64 {
        (self.bytes as f64 / self.days) as u64
    }
}

impl fmt::Display for ArchiveReport {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let megabytes = |bytes: u64| bytes as f64 * 1e-6;
        write!(
            formatter,
            "{:.1} days, {} windows of nodes: {:.1} MB, {:.1} MB a day (at most {:.0})",
            self.days,
            self.windows,
            megabytes(self.bytes),
            megabytes(self.bytes_a_day()),
            megabytes(BYTES_A_DAY)
        )?;
        let whole = self.ranges.first().map_or(Duration::ZERO, |range| range.2);
        for (name, averages, time) in &self.ranges {
            let share = time.as_secs_f64() / whole.as_secs_f64().max(1e-9);
            write!(formatter, "\n{name}: {averages} averages in {:.2} s, {share:.3} of all", time.as_secs_f64())?;
        }
        Ok(())
    }
}

/// Writes `days` days of windows into an archive in `folder`: a day is simulated, and comes again and again.
///
/// # Errors
/// When the simulation, a node or the archive fails.
pub fn run(days: u64, seed: u64, folder: &Path) -> Result<ArchiveReport, String> {
    let text = template::CANTON_STUDY;
    let files = text.lines().find(|line| line.trim_start().starts_with("files")).ok_or("the study has no files")?;
    fs::write(folder.join("study.toml"), text.replace(files, "live = true")).map_err(told)?;
    fs::write(folder.join("beam.csv"), template::CANTON_BEAM).map_err(told)?;
    let mut study = Study::load(folder).map_err(told)?;
    let setup = study.setups.first().ok_or("the built-in study has no setup")?.clone();
    let day = simulated(&study, &setup, seed, DAY_S)?;
    let mut archive = Archive::create(folder).map_err(told)?;
    let mut asked: Vec<(u16, Configuration)> = Vec::new();
    for (node, channels) in channels_by_node(&setup) {
        let names: Vec<&str> = channels.iter().map(|&channel| setup.sensors[channel].channel.as_str()).collect();
        let configuration = day.configuration(&setup, channels.len())?;
        archive.ask(&setup.name, node, &configuration, &names, HostTime(0)).map_err(told)?;
        asked.push((node, configuration));
    }
    let first = day.windows.iter().map(|window| window.grid_index).min().ok_or("no window")?;
    let last = day.windows.iter().map(|window| (window.name.number, window.grid_index)).max().ok_or("no window")?;
    let mut windows = 0;
    for number in 0..days {
        for window in &day.windows {
            let mut window = window.clone();
            window.name.number += u32::try_from(number).map_err(told)? * (last.0 + 1);
            window.grid_index = FIRST_START + window.grid_index - first + number * (last.1 - first + 1);
            let (_, configuration) =
                asked.iter().find(|(node, _)| *node == window.name.node).ok_or("a node that was not asked")?;
            archive.store(&setup.name, configuration, &window, HostTime(0)).map_err(told)?;
            windows += 1;
        }
    }
    drop(archive);
    let bytes = fs::metadata(folder.join(ARCHIVE_FILE)).map_err(told)?.len();
    let hop_samples = asked.first().map_or(0, |(_, configuration)| configuration.hop_samples());
    let hop_s = hop_samples as f64 / setup.sampling_rate_hz;
    let days_long = (days * (last.1 - first + 1)) as f64 * hop_s / 86_400.0;
    let mut ranges: Vec<(String, usize, Duration)> = Vec::new();
    for _ in 0..TIMES {
        for (index, wanted) in RANGES_DAYS.into_iter().filter(|wanted| wanted.is_none_or(|of| of < days)).enumerate() {
            let last = wanted.map(|days| Duration::from_secs(86_400 * days));
            study.range = TimeRange { last, ..TimeRange::ALL };
            let start = Instant::now();
            let measured = measure(&study, Route::Direct, Lines::Enough, &mut |_, _| {}).map_err(told)?;
            let time = start.elapsed();
            let averages = measured.setups.iter().map(|setup| setup.spectrum.averages()).sum();
            match ranges.get_mut(index) {
                Some(range) => range.2 = range.2.min(time),
                None => {
                    let name = wanted.map_or("all".to_owned(), |days| format!("--last {days}d"));
                    ranges.push((name, averages, time));
                }
            }
        }
    }
    Ok(ArchiveReport { windows, days: days_long, bytes, ranges })
}

pub(crate) fn told(error: impl fmt::Display) -> String {
    error.to_string()
}

/// A while of nodes' windows.
pub(crate) struct Simulated {
    plan: SpectralPlan,
    options: FleetOptions,
    pub(crate) windows: Vec<NodeWindow>,
}

impl Simulated {
    pub(crate) fn configuration(&self, setup: &Setup, channels: usize) -> Result<Configuration, String> {
        let decimation = *self.plan.decimations.first().ok_or("no plan")?;
        node_configuration(setup.sampling_rate_hz, decimation, &self.plan.grid, channels, self.options.summary)
            .ok_or_else(|| "the nodes cannot be told these settings".to_owned())
    }
}

/// Plays the simulated tower to nodes with crystals of their own.
pub(crate) fn simulated(study: &Study, setup: &Setup, seed: u64, seconds: f64) -> Result<Simulated, String> {
    let beam = BeamTable::from_reader(template::CANTON_BEAM.as_bytes(), Path::new("beam.csv")).map_err(told)?;
    let mut simulation =
        Simulation::of_beam(beam, &[], setup, &Options { seed, ..Options::default() }).map_err(told)?;
    let (sampling_rate_hz, channels) = (setup.sampling_rate_hz, setup.sensors.len());
    let rows = (seconds * sampling_rate_hz) as u64;
    let extent = SetupExtent { sampling_rate_hz, rows, channels, block_rows: None };
    let plan = SpectralPlan::choose(&[extent], &study.analysis).map_err(told)?;
    let decimation = *plan.decimations.first().ok_or("no plan")?;
    let options = FleetOptions { pace: Pace::Crystal { ppm: 20.0, swing_ppm: 0.0 }, seed, ..FleetOptions::default() };
    let (sender, windows) = channel();
    let mut fleet = Fleet::start(setup, decimation, &plan.grid, &options).map_err(told)?.with_windows_to(sender);
    let mut done = 0;
    while done < rows {
        let next = simulation.next_rows((rows - done) as usize);
        done += (next.len() / channels) as u64;
        let block: Vec<f64> = next.iter().map(|&value| f64::from(value)).collect();
        fleet.push(&block, &mut |_| {}).map_err(told)?;
    }
    fleet.finish(&mut |_| {}).map_err(told)?;
    Ok(Simulated { plan, options, windows: windows.iter().collect() })
}
