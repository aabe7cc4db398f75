//! Windows: decides when a segment is complete, transforms it channel by channel, and files what comes out.

use belfry_shared::frame::MAX_MESSAGE_BYTES;
use belfry_shared::message::{
    ChannelState, DensityPart, LinesPart, MAX_CHANNELS, MAX_DATA_BYTES, NodeMessage, PeaksPart, Summary, WindowHead,
    WindowName,
};
use belfry_shared::quantise::{encode_densities, encode_lines, encoded_bytes};
use belfry_shared::time::ClockModel;
use heapless::{Deque, Vec};
use num_complex::Complex32;

use crate::acquisition::{Acquisition, Rings};
use crate::outbox::{Keeping, Outbox};
use crate::plan::{ARENA_WORDS, Plan, lines_a_part};
use crate::psd::{DensityAverage, add_peaks};
use crate::schedule::{SampleMoment, WindowSpan};
use crate::spectrum::{LONGEST_SEGMENT, decimated_rate_hz, transform};

/// Most complete segments that wait for their transform.
const MAX_WAITING: usize = 4;

/// Running averages and the outbox's bytes, in one piece of memory.
pub(crate) struct Arena([f32; ARENA_WORDS]);

impl Arena {
    /// Empty memory.
    pub(crate) const START: Self = Self([0.0; ARENA_WORDS]);

    /// The running averages' cells and the outbox's ring. The ring lies in front, so that it keeps its place.
    pub(crate) fn split(&mut self, cells: usize) -> (&mut [f32], &mut [u8]) {
        let (ring, cells) = self.0.split_at_mut(ARENA_WORDS - cells.min(ARENA_WORDS));
        (cells, bytemuck::cast_slice_mut(ring))
    }
}

/// A segment whose samples are all there.
#[derive(Debug, Clone, Copy)]
struct CompleteSegment {
    span: WindowSpan,
    middle_offset_us: i32,
    drift_ppb: i32,
}

/// A window in the making, with its first segment.
#[derive(Debug, Clone)]
struct OpenWindow {
    first: CompleteSegment,
    segments: u16,
    parts: u16,
    states: Vec<ChannelState, MAX_CHANNELS>,
}

/// Makes windows of the acquisition's history.
pub(crate) struct WindowMaker {
    /// The next window to start.
    upcoming: Option<WindowSpan>,
    last_started: Option<u64>,
    /// Windows whose segment is not complete yet.
    started: Deque<WindowSpan, MAX_WAITING>,
    /// Windows whose segment is complete and waits for its transform.
    waiting: Deque<CompleteSegment, MAX_WAITING>,
    open: Option<OpenWindow>,
    channel: usize,
    average: DensityAverage,
    next_number: u32,
}

/// What segments are made of, and where.
pub(crate) struct Workshop<'a> {
    pub(crate) acquisition: &'a mut Acquisition,
    pub(crate) rings: &'a Rings,
    pub(crate) segment: &'a mut [f32; LONGEST_SEGMENT],
    /// The running averages.
    pub(crate) cells: &'a mut [f32],
    /// How much more lines get with the square of their frequency, for what the sensor's filters have attenuated; see [`belfry_shared::adxl355`].
    pub(crate) correction_per_hz2: f32,
}

/// Where finished parts go.
pub(crate) struct Files<'a> {
    pub(crate) outbox: &'a mut Outbox,
    pub(crate) ring: &'a mut [u8],
    pub(crate) name: WindowName,
    /// Whether they go to the store as well.
    pub(crate) keeping: Keeping,
}

impl Files<'_> {
    fn store(&mut self, part: u16, message: &NodeMessage<'_>) {
        let mut buffer = [0; MAX_MESSAGE_BYTES];
        // Parts are cut to fit. Should one not fit, the host misses it by the head's count of parts, asks for it, and gives up.
        if let Ok(bytes) = postcard::to_slice(message, &mut buffer) {
            self.outbox.push(self.ring, self.name.number, part, bytes, self.keeping);
        }
    }
}

impl WindowMaker {
    /// No windows yet.
    pub(crate) const START: Self = Self {
        upcoming: None,
        last_started: None,
        started: Deque::new(),
        waiting: Deque::new(),
        open: None,
        channel: 0,
        average: DensityAverage::START,
        next_number: 0,
    };

    /// Drops windows in the making; numbers go on.
    pub(crate) fn restart(&mut self) {
        self.upcoming = None;
        self.last_started = None;
        self.started.clear();
        self.waiting.clear();
        self.open = None;
        self.channel = 0;
        self.average = DensityAverage::START;
    }

    /// The number the next window will have.
    pub(crate) fn next_number(&self) -> u32 {
        self.next_number
    }

    /// Whether segments wait for their transform.
    pub(crate) fn is_busy(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Call this when the host has set the clock: the grid may have moved.
    pub(crate) fn reschedule(&mut self) {
        self.upcoming = None;
    }

    /// Call this for every new decimated sample: it starts windows and queues the segments that the sample completes.
    pub(crate) fn on_sample(&mut self, plan: &Plan, clock: &ClockModel, moment: SampleMoment) {
        if let Some(started) = self.started.front()
            && moment.index + 1 >= started.start + plan.segment() as u64
            && !self.waiting.is_full()
            && let Some(span) = self.started.pop_front()
        {
            // Only now, with what the host has measured of the clock meanwhile.
            let middle_offset_us = plan.schedule.middle_offset_us(clock, moment, &span, plan.segment());
            // Cannot fail: there is room. A segment that had to wait for it may be overwritten by its turn, and then says so.
            let _ = self.waiting.push_back(CompleteSegment { span, middle_offset_us, drift_ppb: clock.drift_ppb });
        }
        let upcoming = self.upcoming.unwrap_or_else(|| {
            let earliest = u64::from(plan.stages.first_full_output()).max(moment.index);
            let first = plan.schedule.first(clock, moment, earliest);
            if Some(first.grid_index) == self.last_started {
                plan.schedule.window(clock, moment, first.grid_index + 1)
            } else {
                first
            }
        });
        self.upcoming = Some(upcoming);
        if moment.index < upcoming.start || self.started.is_full() {
            return;
        }
        // Only now, with a sample from that moment, is the start known to the µs, whatever the crystal does.
        let span = plan.schedule.window(clock, moment, upcoming.grid_index);
        if span.start > moment.index {
            self.upcoming = Some(span);
            return;
        }
        self.last_started = Some(span.grid_index);
        self.upcoming = Some(plan.schedule.window(clock, moment, span.grid_index + 1));
        // Cannot fail: there is room.
        let _ = self.started.push_back(span);
    }

    /// Does one step of the work that waits: one channel of one segment. Returns whether there was any.
    pub(crate) fn work(&mut self, plan: &Plan, workshop: Workshop<'_>, files: &mut Files<'_>) -> bool {
        let Workshop { acquisition, rings, segment, cells, correction_per_hz2 } = workshop;
        let Some(&complete) = self.waiting.front() else { return false };
        let span = complete.span;
        files.name.number = self.next_number;
        let channel = self.channel;
        let mut state = acquisition.state(&plan.stages, channel, span.start, plan.segment());
        let mut parts = self.open.as_ref().map_or(0, |open| open.parts);
        if let (ChannelState::Sound { .. }, Some(buffer)) = (state, segment.get_mut(..plan.segment())) {
            if acquisition.fetch(rings, channel, span.start, buffer) {
                let lines = transform(buffer, decimated_rate_hz(&plan.configuration));
                if correction_per_hz2 > 0.0 {
                    correct_pass_band(plan, lines, correction_per_hz2);
                }
                match plan.configuration.summary {
                    Summary::Lines { bits } => file_lines(plan, files, channel, lines, bits, &mut parts),
                    Summary::Psd { .. } => self.average.add(&plan.configuration, cells, channel, lines),
                }
            } else {
                state = ChannelState::Overrun;
            }
        }
        let open =
            self.open.get_or_insert_with(|| OpenWindow { first: complete, segments: 0, parts: 0, states: Vec::new() });
        open.parts = parts;
        match open.states.get_mut(channel) {
            Some(known) if !matches!(state, ChannelState::Sound { .. }) => {
                if !matches!(known, ChannelState::Sound { .. }) {
                    *known = state;
                }
            }
            Some(known) => *known = state,
            // Cannot fail: a plan has no more channels than fit here.
            None => drop(open.states.push(state)),
        }
        self.channel += 1;
        if self.channel == plan.channels() {
            self.channel = 0;
            open.segments += 1;
            self.waiting.pop_front();
            acquisition.forget_faults_before(span.start + plan.segment() as u64 / 4);
            self.close_if_complete(plan, cells, files);
        }
        true
    }

    fn close_if_complete(&mut self, plan: &Plan, cells: &mut [f32], files: &mut Files<'_>) {
        let segments = match plan.configuration.summary {
            Summary::Lines { .. } => 1,
            Summary::Psd { segments } => segments,
        };
        let Some(mut open) = self.open.take_if(|open| open.segments >= segments) else { return };
        if let Summary::Psd { .. } = plan.configuration.summary {
            for (channel, state) in open.states.iter_mut().enumerate() {
                if let ChannelState::Sound { segments } = state {
                    *segments = self.average.segments(channel);
                    let densities = self.average.finish(&plan.configuration, cells, channel);
                    file_densities(plan, files, channel, densities, &mut open.parts);
                }
            }
            self.average = DensityAverage::START;
        }
        let head = WindowHead {
            name: files.name,
            configuration_hash: plan.hash,
            grid_index: open.first.span.grid_index,
            middle_offset_us: open.first.middle_offset_us,
            drift_ppb: open.first.drift_ppb,
            data_parts: open.parts,
            channels: open.states,
        };
        files.store(0, &NodeMessage::Head(head));
        self.next_number = self.next_number.wrapping_add(1);
    }
}

/// Divides the pass band of the sensor's filters out of the lines that are sent.
fn correct_pass_band(plan: &Plan, lines: &mut [Complex32], correction_per_hz2: f32) {
    let spacing_hz = decimated_rate_hz(&plan.configuration) / plan.segment() as f32;
    for band in &plan.configuration.bands {
        let (first, count) = (usize::from(band.first_line), usize::from(band.lines));
        for (index, line) in lines.iter_mut().enumerate().skip(first).take(count) {
            let frequency_hz = index as f32 * spacing_hz;
            *line *= 1.0 + correction_per_hz2 * frequency_hz * frequency_hz;
        }
    }
}

/// Files a channel's lines in the configured bands.
fn file_lines(plan: &Plan, files: &mut Files<'_>, channel: usize, lines: &[Complex32], bits: u8, parts: &mut u16) {
    let mut code = [0; MAX_DATA_BYTES];
    for band in &plan.configuration.bands {
        let first = usize::from(band.first_line);
        let Some(lines) = lines.get(first..first + usize::from(band.lines)) else { continue };
        let size = lines_a_part(bits);
        for (index, lines) in lines.chunks(size).enumerate() {
            let Some(code) = code.get_mut(..encoded_bytes(lines.len(), bits)) else { continue };
            *parts += 1;
            if encode_lines(lines, bits, code).is_err() {
                // Lines are finite, since readings are checked. Otherwise the host would ask for the part and give up.
                continue;
            }
            let part = LinesPart {
                name: files.name,
                part: *parts,
                channel: channel as u8,
                first_line: (first + index * size) as u16,
                lines: lines.len() as u16,
                bits,
                code,
            };
            files.store(*parts, &NodeMessage::Lines(part));
        }
    }
}

/// Files a channel's averaged densities in the configured bands, and their peaks.
fn file_densities(plan: &Plan, files: &mut Files<'_>, channel: usize, densities: &[f32], parts: &mut u16) {
    let configuration = &plan.configuration;
    let spacing_hz = decimated_rate_hz(configuration) / f32::from(configuration.segment);
    let mut code = [0; MAX_DATA_BYTES];
    let mut peaks = Vec::new();
    let mut rest = densities;
    for band in &configuration.bands {
        let (densities, others) = rest.split_at(usize::from(band.lines).min(rest.len()));
        rest = others;
        add_peaks(&mut peaks, densities, band.first_line, spacing_hz);
        for (index, densities) in densities.chunks(MAX_DATA_BYTES).enumerate() {
            let Some(code) = code.get_mut(..densities.len()) else { continue };
            *parts += 1;
            let Ok(base) = encode_densities(densities, code) else { continue };
            let first_line = band.first_line + (index * MAX_DATA_BYTES) as u16;
            let part = DensityPart { name: files.name, part: *parts, channel: channel as u8, first_line, base, code };
            files.store(*parts, &NodeMessage::Density(part));
        }
    }
    *parts += 1;
    let part = PeaksPart { name: files.name, part: *parts, channel: channel as u8, peaks };
    files.store(*parts, &NodeMessage::Peaks(part));
}
