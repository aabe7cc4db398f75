//! One setup's windows as a stream: reading ahead, making spectra and taking windows in, each on a thread of its own.

use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::thread::{self, ScopedJoinHandle};
use std::time::{Duration, Instant};

use super::fill::{Filled, Filler};
use super::jumps::{JumpFinder, Jumps};
use super::limits::{CutOff, Limits};
use super::spikes::{SpikeFilter, Spikes};
use super::{Material, MeasureError, Observer, Route, Timings};
use crate::archive::Collected;
use crate::fleet::{Fleet, FleetError, FleetReport};
use crate::record::{Block, RecordError, RecordReport, Recording};
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
}

/// What was found in the rows of a recording.
#[derive(Debug, Default)]
pub(super) struct Faults {
    /// Spikes that were replaced, channel by channel.
    pub(super) spikes: Vec<Spikes>,
    /// Missing samples that were filled, channel by channel.
    pub(super) filled: Vec<Filled>,
    /// Ends of ranges that were reached, channel by channel.
    pub(super) cut_off: Vec<CutOff>,
    /// Places where all channels jump.
    pub(super) jumps: Jumps,
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
    let Task { setup, material, plan, decimation, route } = task;
    let recording = match material {
        Material::Recording(recording) => *recording,
        Material::Archive(collected) => return stream_archive(setup, &collected, on_rows, observer, sink, timings),
    };
    let grid = plan.grid;
    let fleet_failed = |source| MeasureError::Fleet { setup: setup.name.clone(), source };
    let mut source = Source::new(setup, plan, decimation, route).map_err(fleet_failed)?;
    thread::scope(|scope| {
        let (block_sender, blocks) = sync_channel(BLOCKS_AHEAD);
        let (used_sender, used) = channel();
        let reader = scope.spawn(move || read_ahead(recording, &block_sender, &used));
        let (window_sender, windows) = sync_channel(WINDOWS_WAITING);
        let taker = scope.spawn(move || take_in(&windows, setup.sensors.len(), sink));
        let orders = setup.derivatives();
        let mut on_window = |mut window: WindowLines| {
            window.differentiate(&orders, &grid);
            observer(setup, &grid, &window);
            // The other end lives until this one is dropped; if it panicked, joining it says so.
            let _ = window_sender.send(window);
        };
        let mut rows = 0;
        let spectra = || -> Result<(Option<FleetReport>, Faults), FleetError> {
            let channels = setup.sensors.len();
            let (mut limits, mut jumps) = (Limits::new(channels), JumpFinder::new(channels));
            let (mut filter, mut filler) = (SpikeFilter::new(channels), Filler::new(channels));
            for block in &blocks {
                let start = Instant::now();
                let values = filter.push(block.values());
                limits.push(values);
                jumps.push(values);
                source.push(filler.push(values), &mut on_window)?;
                timings.spectra += start.elapsed();
                rows += block.row_count() as u64;
                on_rows(rows);
                // A reader that has come to the end wants no more.
                let _ = used_sender.send(block);
            }
            let start = Instant::now();
            let (last, spikes) = filter.finish();
            limits.push(&last);
            source.push(filler.push(&last), &mut on_window)?;
            let (last, filled) = filler.finish();
            source.push(&last, &mut on_window)?;
            let fleet = source.finish(&mut on_window)?;
            timings.spectra += start.elapsed();
            Ok((fleet, Faults { spikes, filled, cut_off: limits.finish(), jumps: jumps.finish() }))
        };
        let made = spectra();
        // A reader that is still ahead stops when nobody takes its blocks, the taker when no more windows can come.
        drop((blocks, window_sender));
        let (read, reading) = joined(reader);
        timings.reading += reading;
        let (silenced, averaging) = joined(taker);
        timings.averaging += averaging;
        let (fleet, faults) = made.map_err(fleet_failed)?;
        let record_failed = |source| MeasureError::Record { setup: setup.name.clone(), source: Box::new(source) };
        Ok(Streamed { report: Some(read.map_err(record_failed)?), fleet, faults, silenced })
    })
}

/// The same for windows that nodes have sent.
fn stream_archive(
    setup: &Setup,
    collected: &Collected,
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
            observer(setup, &grid, &window);
            let _ = window_sender.send(window);
        });
        timings.reading += start.elapsed();
        drop(window_sender);
        let (silenced, averaging) = joined(taker);
        timings.averaging += averaging;
        (read, silenced)
    });
    read.map_err(|source| MeasureError::Archive { setup: setup.name.clone(), source: Box::new(source) })?;
    Ok(Streamed { report: None, fleet: None, faults: Faults::default(), silenced })
}

/// A thread's result; its panic goes on here.
fn joined<T>(handle: ScopedJoinHandle<'_, T>) -> T {
    handle.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

/// Reads to the recording's end, or until nobody takes the blocks; how long reading took.
fn read_ahead(
    mut recording: Recording,
    blocks: &SyncSender<Block>,
    used: &Receiver<Block>,
) -> (Result<RecordReport, RecordError>, Duration) {
    let mut reading = Duration::ZERO;
    loop {
        let mut block = used.try_recv().unwrap_or_default();
        let start = Instant::now();
        let more = recording.next_block(&mut block);
        reading += start.elapsed();
        match more {
            Ok(true) if blocks.send(block).is_ok() => {}
            Ok(_) => return (Ok(recording.finish()), reading),
            Err(error) => return (Err(error), reading),
        }
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
