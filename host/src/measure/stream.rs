//! One setup's windows as a stream: reading ahead, making spectra and taking windows in, each on a thread of its own.

use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::thread::{self, ScopedJoinHandle};
use std::time::{Duration, Instant};

use super::copies::CopyFinder;
use super::fill::{Filled, Filler};
use super::flat::{Flat, FlatFinder};
use super::jumps::{JumpFinder, Jumps};
use super::limits::{CutOff, Limits};
use super::overview::{Overview, Ranges, Waterfall};
use super::spikes::{SpikeFilter, Spikes};
use super::{Material, MeasureError, Observer, Route, Timings};
use crate::archive::{Collected, Damage};
use crate::fleet::{Fleet, FleetError, FleetReport};
use crate::record::{Block, RecordError, RecordReport, Recording, si_factor};
use crate::spectra::direct::Welch;
use crate::spectra::{Silenced, SpectralPlan, StandOut, WindowLines};
use crate::study::Setup;

/// Blocks that are read ahead.
const BLOCKS_AHEAD: usize = 4;
/// Windows that may wait to be taken in.
const WINDOWS_WAITING: usize = 4;

/// One setup to measure.
pub(super) struct Task<'a, 'p> {
    pub(super) setup: &'a Setup,
    pub(super) material: Material,
    pub(super) plan: &'p SpectralPlan,
    pub(super) decimation: u32,
    pub(super) route: Route,
    /// Rows and windows that are expected.
    pub(super) rows: u64,
    pub(super) windows: usize,
}

impl Task<'_, '_> {
    /// The material at one glance, of which nothing has come yet.
    fn overview(&self) -> Overview {
        let channels = self.setup.sensors.len();
        Overview {
            setup: self.setup.name.clone(),
            sampling_rate_hz: self.setup.sampling_rate_hz,
            ranges: Ranges::new(channels, self.rows),
            waterfall: Waterfall::new(&self.plan.grid, self.windows),
        }
    }
}

/// What is left when the last window has passed.
pub(super) struct Streamed {
    /// What the recording held, where there is one.
    pub(super) report: Option<RecordReport>,
    pub(super) fleet: Option<FleetReport>,
    /// What was found in the rows; nothing where nodes have sent the windows.
    pub(super) faults: Faults,
    /// Windows in which channels stood far off the others, channel by channel.
    pub(super) silenced: Vec<Silenced>,
    /// All of it at one glance.
    pub(super) overview: Overview,
    /// What is damaged in the archive, and left out.
    pub(super) damages: Vec<Damage>,
}

/// What was found in the rows of a recording.
#[derive(Debug, Default)]
pub(super) struct Faults {
    /// Spikes that were replaced, channel by channel.
    pub(super) spikes: Vec<Spikes>,
    /// Missing samples that were filled, channel by channel.
    pub(super) filled: Vec<Filled>,
    /// Pieces of one value, which were taken as missing, channel by channel.
    pub(super) flat: Vec<Flat>,
    /// Rows of the recording.
    pub(super) rows: u64,
    /// Ends of ranges that were reached, channel by channel.
    pub(super) cut_off: Vec<CutOff>,
    /// Places where all channels jump.
    pub(super) jumps: Jumps,
    /// Channels that are copies, each with the one that it is a copy of.
    pub(super) copies: Vec<[usize; 2]>,
}

/// Streams a setup's windows, in the order of the grid, past `observer` (on this thread) into `sink` (on another), which gets
/// them without the channels that stand far off.
///
/// # Errors
/// When the recording cannot be read or the nodes fail; windows that came before have been taken in.
pub(super) fn stream(
    task: Task<'_, '_>,
    on_rows: &mut dyn FnMut(u64),
    observer: Observer<'_>,
    sink: impl FnMut(WindowLines) + Send,
    timings: &mut Timings,
) -> Result<Streamed, MeasureError> {
    let mut overview = task.overview();
    let Task { setup, material, plan, decimation, route, .. } = task;
    let recording = match material {
        Material::Recording(recording) => *recording,
        Material::Archive(collected) => {
            return stream_archive(setup, &collected, overview, on_rows, observer, sink, timings);
        }
    };
    let grid = plan.grid;
    let fleet_failed = |source| MeasureError::Fleet { setup: setup.name.clone(), source };
    let mut source = Source::new(setup, plan, decimation, route).map_err(fleet_failed)?;
    thread::scope(|scope| {
        let (rows_sender, sound_rows) = sync_channel(BLOCKS_AHEAD);
        let (used_sender, used) = channel();
        let reader = scope.spawn(move || read_ahead(recording, Checks::of(setup), &rows_sender, &used));
        let (window_sender, windows) = sync_channel(WINDOWS_WAITING);
        let taker = scope.spawn(move || take_in(&windows, setup.sensors.len(), sink));
        let orders = setup.derivatives();
        let mut on_window = |mut window: WindowLines| {
            window.differentiate(&orders, &grid);
            overview.waterfall.push(&window);
            observer(setup, &grid, &window);
            // The other end lives until this one is dropped; if it panicked, joining it says so.
            let _ = window_sender.send(window);
        };
        let mut count = 0;
        let spectra = || -> Result<Option<FleetReport>, FleetError> {
            for rows in &sound_rows {
                let start = Instant::now();
                overview.ranges.push(&rows);
                source.push(&rows, &mut on_window)?;
                timings.spectra += start.elapsed();
                count += (rows.len() / setup.sensors.len().max(1)) as u64;
                on_rows(count);
                // A reader that has come to the end wants no more.
                let _ = used_sender.send(rows);
            }
            let start = Instant::now();
            let fleet = source.finish(&mut on_window)?;
            timings.spectra += start.elapsed();
            Ok(fleet)
        };
        let made = spectra();
        // A reader that is still ahead stops when nobody takes its rows, the taker when no more windows can come.
        drop((sound_rows, window_sender));
        let (read, faults, reading) = joined(reader);
        timings.reading += reading;
        let (silenced, averaging) = joined(taker);
        timings.averaging += averaging;
        let fleet = made.map_err(fleet_failed)?;
        let record_failed = |source| MeasureError::Record { setup: setup.name.clone(), source: Box::new(source) };
        Ok(Streamed {
            report: Some(read.map_err(record_failed)?),
            fleet,
            faults,
            silenced,
            overview,
            damages: Vec::new(),
        })
    })
}

/// The same for windows that nodes have sent.
fn stream_archive(
    setup: &Setup,
    collected: &Collected,
    mut overview: Overview,
    on_rows: &mut dyn FnMut(u64),
    observer: Observer<'_>,
    sink: impl FnMut(WindowLines) + Send,
    timings: &mut Timings,
) -> Result<Streamed, MeasureError> {
    let grid = collected.setup.grid;
    let rows_a_window = (grid.segment as u64 / 2) * u64::from(collected.setup.decimation);
    let (read, silenced) = thread::scope(|scope| {
        let (window_sender, windows) = sync_channel(WINDOWS_WAITING);
        let taker = scope.spawn(move || take_in(&windows, setup.sensors.len(), sink));
        let start = Instant::now();
        let mut count = 0;
        let read = collected.each_window(setup, &mut |window| {
            count += 1;
            on_rows(count * rows_a_window);
            overview.waterfall.push(&window);
            observer(setup, &grid, &window);
            let _ = window_sender.send(window);
        });
        timings.reading += start.elapsed();
        drop(window_sender);
        let (silenced, averaging) = joined(taker);
        timings.averaging += averaging;
        (read, silenced)
    });
    let damages =
        read.map_err(|source| MeasureError::Archive { setup: setup.name.clone(), source: Box::new(source) })?;
    Ok(Streamed { report: None, fleet: None, faults: Faults::default(), silenced, overview, damages })
}

/// A thread's result; its panic goes on here.
fn joined<T>(handle: ScopedJoinHandle<'_, T>) -> T {
    handle.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

/// Reads to the recording's end, or until nobody takes the rows, which it mends; what it found, and how long it took.
fn read_ahead(
    mut recording: Recording,
    mut checks: Checks,
    rows: &SyncSender<Vec<f64>>,
    used: &Receiver<Vec<f64>>,
) -> (Result<RecordReport, RecordError>, Faults, Duration) {
    let mut block = Block::new();
    let mut busy = Duration::ZERO;
    let read = loop {
        let mut sound = used.try_recv().unwrap_or_default();
        let start = Instant::now();
        let more = recording.next_block(&mut block);
        if let Ok(true) = more {
            checks.push(block.values(), &mut sound);
        }
        busy += start.elapsed();
        match more {
            Ok(true) if rows.send(sound).is_ok() => {}
            Ok(_) => break Ok(recording.finish()),
            Err(error) => break Err(error),
        }
    };
    let (last, faults) = checks.finish();
    let _ = rows.send(last);
    (read, faults, busy)
}

/// What rows go through before spectra are made of them.
pub(super) struct Checks {
    spikes: SpikeFilter,
    limits: Limits,
    jumps: JumpFinder,
    copies: CopyFinder,
    filler: Filler,
}

/// By channel, what makes its samples what was recorded.
fn as_recorded(setup: &Setup) -> Vec<f64> {
    setup.sensors.iter().map(|sensor| si_factor(setup.unit_of(sensor), sensor).map_or(1.0, f64::recip)).collect()
}

impl Checks {
    pub(super) fn of(setup: &Setup) -> Self {
        let stay = setup.sensors.iter().map(|sensor| sensor.reference).collect();
        let copies = CopyFinder::new(as_recorded(setup), stay);
        Self::new(setup.sensors.len(), setup.sampling_rate_hz, copies)
    }

    fn new(channels: usize, sampling_rate_hz: f64, copies: CopyFinder) -> Self {
        Self {
            copies,
            spikes: SpikeFilter::new(channels),
            limits: Limits::new(channels),
            jumps: JumpFinder::new(channels),
            filler: Filler::new(FlatFinder::new(channels, sampling_rate_hz)),
        }
    }

    /// Takes rows, row-major, NaN where a sample is missing; fills `sound` with those that are complete with them.
    pub(super) fn push(&mut self, rows: &[f64], sound: &mut Vec<f64>) {
        self.copies.push(rows);
        let rows = self.spikes.push(rows);
        self.limits.push(rows);
        self.jumps.push(rows);
        self.filler.push(rows, sound);
    }

    /// The last rows, and what was found.
    pub(super) fn finish(mut self) -> (Vec<f64>, Faults) {
        let (last, spikes) = self.spikes.finish();
        self.limits.push(&last);
        self.jumps.push(&last);
        let mut rows = Vec::new();
        self.filler.push(&last, &mut rows);
        let count = self.limits.rows();
        let (last, filled, flat) = self.filler.finish();
        rows.extend(last);
        let (cut_off, jumps, copies) = (self.limits.finish(), self.jumps.finish(), self.copies.finish());
        (rows, Faults { spikes, filled, flat, rows: count, cut_off, jumps, copies })
    }
}

/// Gives every window to `sink`, without the channels that stand far off; which those were, and how long it took.
fn take_in(
    windows: &Receiver<WindowLines>,
    channels: usize,
    mut sink: impl FnMut(WindowLines),
) -> (Vec<Silenced>, Duration) {
    let mut busy = Duration::ZERO;
    let mut stand_out = StandOut::new(channels);
    for window in windows {
        let start = Instant::now();
        stand_out.push(window, &mut sink);
        busy += start.elapsed();
    }
    let start = Instant::now();
    let silenced = stand_out.finish(&mut sink);
    (silenced, busy + start.elapsed())
}

/// What makes windows of rows.
enum Source {
    Nodes(Box<Fleet>),
    Direct(Box<Welch>),
}

impl Source {
    fn new(setup: &Setup, plan: &SpectralPlan, decimation: u32, route: Route) -> Result<Self, FleetError> {
        let grid = plan.grid;
        Ok(match route {
            Route::Nodes(options) => Self::Nodes(Box::new(Fleet::start(setup, decimation, &grid, &options)?)),
            Route::Direct => {
                let welch = Welch::new(grid, decimation, setup.sensors.len());
                Self::Direct(Box::new(welch.ok_or(FleetError::Settings {
                    decimation,
                    segment: grid.segment,
                    first_line: grid.first_line,
                    lines: grid.lines,
                })?))
            }
        })
    }

    fn push(&mut self, rows: &[f64], on_window: &mut dyn FnMut(WindowLines)) -> Result<(), FleetError> {
        match self {
            Self::Nodes(fleet) => fleet.push(rows, on_window),
            Self::Direct(welch) => {
                welch.push(rows, on_window);
                Ok(())
            }
        }
    }

    fn finish(self, on_window: &mut dyn FnMut(WindowLines)) -> Result<Option<FleetReport>, FleetError> {
        match self {
            Self::Nodes(fleet) => fleet.finish(on_window).map(Some),
            Self::Direct(_) => Ok(None),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_of_a_row_is_no_row_and_without_channels_there_is_none() {
        let rows: Vec<f64> = (0..600).map(|at| f64::from(at * at % 83)).collect();
        let checked = |channels: usize, rows: &[f64]| {
            let (mut checks, mut sound) =
                (Checks::new(channels, 50.0, CopyFinder::new(vec![1.0; channels], Vec::new())), Vec::new());
            checks.push(rows, &mut sound);
            let (last, faults) = checks.finish();
            sound.extend(last);
            (sound, format!("{faults:?}"))
        };
        assert_eq!(checked(3, &rows).0, rows);
        assert_eq!(checked(3, &rows[..599]), checked(3, &rows[..597]));
        assert!(checked(3, &rows[..2]).0.is_empty() && checked(0, &rows).0.is_empty());
        // Each check alone, too.
        let (mut whole, mut part, mut none) = (Limits::new(3), Limits::new(3), Limits::new(0));
        whole.push(&rows[..597]);
        part.push(&rows[..599]);
        none.push(&rows);
        assert_eq!((whole.finish(), none.finish()), (part.finish(), Vec::new()));
        assert!(SpikeFilter::new(3).push(&rows[..599]).len().is_multiple_of(3));
        assert!(SpikeFilter::new(0).push(&rows).is_empty());
        let mut filled = Vec::new();
        let mut filler = Filler::new(FlatFinder::new(3, 50.0));
        filler.push(&rows[..599], &mut filled);
        filled.extend(filler.finish().0);
        assert_eq!(filled, rows[..597]);
    }
}
