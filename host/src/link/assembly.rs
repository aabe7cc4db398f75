//! Assembly: from parts, in any order and more than once, to whole windows, each exactly once.

use std::collections::BTreeMap;

use belfry_shared::message::{
    Again, ChannelState, Configuration, MAX_AGAIN, NodeMessage, Peak, Summary, WindowHead, WindowName,
};
use belfry_shared::quantise::{decode_density, decode_lines, encoded_bytes};
use belfry_shared::time::HostTime;
use num_complex::Complex32;

use super::KeptWindows;

/// Windows ahead of the oldest missing one that are kept; a number further ahead is taken for a fault.
const MAX_AHEAD: u32 = 1 << 16;
/// Parts a window may have; a head that says more is taken for a fault.
const MAX_DATA_PARTS: u16 = 4096;
/// How often a part is asked again before its window is given up.
const MAX_ASKS: u32 = 30;

/// A whole window as a node sent it.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeWindow {
    /// Its name.
    pub name: WindowName,
    /// Hash of the configuration it was measured with.
    pub configuration_hash: u32,
    /// Start in hops since the epoch.
    pub grid_index: u64,
    /// When the segment's middle was, minus when it should have been by the grid, in µs.
    pub middle_offset_us: i32,
    /// How much faster the host's clock runs than the node's, in parts per thousand million.
    pub drift_ppb: i32,
    /// Each channel's data.
    pub channels: Vec<ChannelData>,
}

/// One channel's data in a window.
#[derive(Debug, Clone, PartialEq)]
pub enum ChannelData {
    /// No sound data, and why.
    Unsound(ChannelState),
    /// Complex lines of all bands, one after the other, in m/s²/√Hz.
    Lines(Vec<Complex32>),
    /// Averaged densities of all bands in (m/s²)²/Hz, and the highest peaks.
    Psd {
        /// Segments averaged.
        segments: u16,
        /// The densities.
        densities: Vec<f32>,
        /// The peaks, highest first.
        peaks: Vec<Peak>,
    },
}

/// What a node's windows can have been measured with.
#[derive(Debug, Clone, PartialEq)]
pub struct Configurations {
    /// What it is to measure with now.
    pub current: Configuration,
    /// What it measured with before: its outbox may still hold such windows.
    pub earlier: Vec<Configuration>,
}

impl Configurations {
    /// One, and none before.
    pub fn only(current: Configuration) -> Self {
        Self { current, earlier: Vec::new() }
    }

    fn iter(&self) -> impl Iterator<Item = &Configuration> {
        std::iter::once(&self.current).chain(&self.earlier)
    }

    /// The one of a hash.
    pub fn by_hash(&self, hash: u32) -> Option<&Configuration> {
        self.iter().find(|configuration| configuration.hash() == hash)
    }
}

#[derive(Debug, Default)]
struct Partial {
    head: Option<WindowHead>,
    /// Encoded messages by part number.
    parts: BTreeMap<u16, Vec<u8>>,
    last_asked: Option<HostTime>,
    asks: u32,
}

impl Partial {
    fn is_whole(&self) -> bool {
        self.head.as_ref().is_some_and(|head| self.parts.len() == usize::from(head.data_parts))
    }
}

#[derive(Debug)]
enum Progress {
    Partial(Partial),
    Done,
}

/// What became of a part.
#[derive(Debug, PartialEq)]
pub enum Outcome {
    /// Taken; the window is not whole yet.
    Taken,
    /// Known already.
    Duplicate,
    /// With it the window is whole.
    Whole(Box<NodeWindow>),
    /// It contradicts the configuration or other parts.
    Contradiction,
    /// It has the name of a window that is kept, but is a later one: the node has started anew under its old name.
    Repeated,
    /// It was measured with a configuration that is not known here, for another study: a window that is only done when
    /// [`Assembler::stored`] says so.
    Foreign,
}

/// Assembles one boot's windows.
#[derive(Debug)]
pub struct Assembler {
    boot: u32,
    /// All windows with lower numbers are done or given up.
    below: u32,
    /// One above the highest number known to exist.
    known: u32,
    windows: BTreeMap<u32, Progress>,
    /// Of windows kept from before: the last one's number and start.
    last_kept: Option<(u32, u64)>,
    lost: u64,
}

impl Assembler {
    /// An assembler for a boot, before its first window.
    pub fn new(boot: u32) -> Self {
        Self::resuming(boot, &KeptWindows::default())
    }

    /// An assembler for a boot of which windows are kept from before.
    pub fn resuming(boot: u32, kept: &KeptWindows) -> Self {
        let wanted = kept.numbers.iter().filter(|&&number| number >= kept.first);
        let windows: BTreeMap<u32, Progress> = wanted.map(|&number| (number, Progress::Done)).collect();
        let known = windows.last_key_value().map_or(kept.first, |(&last, _)| last.saturating_add(1));
        let mut assembler = Self { boot, below: kept.first, known, windows, last_kept: kept.last, lost: 0 };
        assembler.advance();
        assembler
    }

    /// The boot whose windows it takes.
    pub fn boot(&self) -> u32 {
        self.boot
    }

    /// All windows with lower numbers are done or given up.
    pub fn below(&self) -> u32 {
        self.below
    }

    /// Windows given up: dropped by the node before they were delivered, or unreadable.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Whether all windows known to exist are done or given up.
    pub fn is_complete(&self) -> bool {
        self.below >= self.known
    }

    /// Takes a part: the message and its encoding.
    pub fn take(&mut self, configurations: &Configurations, message: &NodeMessage<'_>, encoded: &[u8]) -> Outcome {
        let (name, part) = match message {
            NodeMessage::Head(head) if head.data_parts > MAX_DATA_PARTS => return Outcome::Contradiction,
            NodeMessage::Head(head) => (head.name, 0),
            NodeMessage::Lines(lines) => (lines.name, lines.part),
            NodeMessage::Density(density) => (density.name, density.part),
            NodeMessage::Peaks(peaks) => (peaks.name, peaks.part),
            _ => return Outcome::Contradiction,
        };
        if name.boot != self.boot {
            return Outcome::Contradiction;
        }
        if let (NodeMessage::Head(head), Some((last, start))) = (message, self.last_kept)
            && name.number <= last
            && head.grid_index > start
        {
            return Outcome::Repeated;
        }
        if name.number < self.below {
            return Outcome::Duplicate;
        }
        let is_head = matches!(message, NodeMessage::Head(_));
        if name.number - self.below >= MAX_AHEAD || is_head != (part == 0) || part > MAX_DATA_PARTS {
            return Outcome::Contradiction;
        }
        if let NodeMessage::Head(head) = message
            && configurations.by_hash(head.configuration_hash).is_none()
        {
            if matches!(self.windows.get(&name.number), Some(Progress::Done)) {
                return Outcome::Duplicate;
            }
            self.known = self.known.max(name.number.saturating_add(1));
            return Outcome::Foreign;
        }
        if !configurations.iter().any(|configuration| fits(configuration, message)) {
            return Outcome::Contradiction;
        }
        self.known = self.known.max(name.number.saturating_add(1));
        let progress = self.windows.entry(name.number).or_insert_with(|| Progress::Partial(Partial::default()));
        let Progress::Partial(partial) = progress else { return Outcome::Duplicate };
        match message {
            NodeMessage::Head(_) if partial.head.is_some() => return Outcome::Duplicate,
            NodeMessage::Head(head) => partial.head = Some(head.clone()),
            _ if partial.parts.contains_key(&part) => return Outcome::Duplicate,
            _ => drop(partial.parts.insert(part, encoded.to_vec())),
        }
        if !partial.is_whole() {
            return Outcome::Taken;
        }
        let built = partial
            .head
            .as_ref()
            .and_then(|head| build(configurations.by_hash(head.configuration_hash)?, head, &partial.parts));
        match built {
            Some(window) => Outcome::Whole(Box::new(window)),
            None => {
                self.give_up(name.number);
                Outcome::Contradiction
            }
        }
    }

    /// Marks a whole window as stored.
    pub fn stored(&mut self, number: u32) {
        if number >= self.below {
            self.windows.insert(number, Progress::Done);
            self.advance();
        }
    }

    /// Forgets a whole window that could not be stored, so that it is asked again.
    pub fn unstored(&mut self, number: u32) {
        self.windows.insert(number, Progress::Partial(Partial::default()));
    }

    /// Windows known to exist that are neither done nor given up: what is lost if the node has restarted.
    pub fn missing(&self) -> u64 {
        let done = self.windows.values().filter(|progress| matches!(progress, Progress::Done)).count();
        u64::from(self.known.saturating_sub(self.below)).saturating_sub(done as u64)
    }

    fn give_up(&mut self, number: u32) {
        self.windows.insert(number, Progress::Done);
        self.lost += 1;
        self.advance();
    }

    fn advance(&mut self) {
        while matches!(self.windows.first_key_value(), Some((&number, Progress::Done)) if number == self.below) {
            self.windows.pop_first();
            self.below = self.below.saturating_add(1);
        }
    }

    /// Takes what a heartbeat says: windows below `next` exist, those below `oldest` are gone from the node.
    pub fn heartbeat(&mut self, oldest: u32, next: u32) {
        let gone = oldest.min(next);
        if gone > self.below {
            let kept = self.windows.split_off(&gone);
            let done = self.windows.values().filter(|progress| matches!(progress, Progress::Done)).count();
            self.lost += u64::from(gone - self.below) - done as u64;
            self.windows = kept;
            self.below = gone;
            self.advance();
        }
        // More cannot wait in any node; the rest comes into reach as windows are done.
        self.known = self.known.max(next.min(self.below.saturating_add(MAX_AHEAD)));
    }

    /// What to ask again at `now`, of windows not asked since `before`; at most [`MAX_AGAIN`] ranges.
    ///
    /// An ask counts towards giving up only if the node was `heard` since the last one: a line that is away costs no window.
    /// `settled` is the number below which parts are overdue: all windows known when the line has fallen silent, all but the
    /// newest while it is busy.
    pub fn overdue(&mut self, now: HostTime, before: HostTime, heard: HostTime, busy: bool) -> Vec<Again> {
        let settled = if busy { self.known.saturating_sub(1) } else { self.known };
        let mut ranges: Vec<Again> = Vec::new();
        let mut hopeless = Vec::new();
        for number in self.below..settled {
            if ranges.len() >= MAX_AGAIN {
                break;
            }
            let progress = self.windows.entry(number).or_insert_with(|| Progress::Partial(Partial::default()));
            let Progress::Partial(partial) = progress else { continue };
            if partial.last_asked.is_some_and(|asked| asked > before) {
                continue;
            }
            if partial.asks >= MAX_ASKS {
                hopeless.push(number);
                continue;
            }
            if partial.last_asked.is_none_or(|asked| heard > asked) {
                partial.asks += 1;
            }
            partial.last_asked = Some(now);
            for (first_part, last_part) in missing_parts(partial) {
                ranges.push(Again { first_window: number, last_window: number, first_part, last_part });
            }
        }
        for number in hopeless {
            self.give_up(number);
        }
        join_whole_windows(&mut ranges);
        ranges.truncate(MAX_AGAIN);
        ranges
    }
}

/// Whether a part can belong to a window of the configuration.
fn fits(configuration: &Configuration, message: &NodeMessage<'_>) -> bool {
    let in_band = |first_line: u16, count: usize| position(configuration, first_line, count).is_some();
    let is_channel = |channel: u8| channel < configuration.channels;
    match (message, configuration.summary) {
        (NodeMessage::Head(head), _) => head.channels.len() == usize::from(configuration.channels),
        (NodeMessage::Lines(part), Summary::Lines { bits }) => {
            let lines = usize::from(part.lines);
            part.bits == bits
                && lines > 0
                && is_channel(part.channel)
                && in_band(part.first_line, lines)
                && part.code.len() == encoded_bytes(lines, bits)
        }
        (NodeMessage::Density(part), Summary::Psd { .. }) => {
            !part.code.is_empty() && is_channel(part.channel) && in_band(part.first_line, part.code.len())
        }
        (NodeMessage::Peaks(part), Summary::Psd { .. }) => is_channel(part.channel),
        _ => false,
    }
}

/// Position of a run of lines among all bands' lines; `None` where no band holds it.
fn position(configuration: &Configuration, first_line: u16, count: usize) -> Option<usize> {
    let mut before = 0;
    for band in &configuration.bands {
        let offset = first_line.wrapping_sub(band.first_line);
        if first_line >= band.first_line && usize::from(offset) + count <= usize::from(band.lines) {
            return Some(before + usize::from(offset));
        }
        before += usize::from(band.lines);
    }
    None
}

/// Runs of part numbers that a window still lacks.
fn missing_parts(partial: &Partial) -> Vec<(u16, u16)> {
    if partial.head.is_none() && partial.parts.is_empty() {
        return vec![(0, u16::MAX)];
    }
    let mut runs = Vec::new();
    if partial.head.is_none() {
        runs.push((0, 0));
    }
    let mut next = 1;
    for &part in partial.parts.keys() {
        if part > next {
            runs.push((next, part - 1));
        }
        next = part.saturating_add(1);
    }
    match &partial.head {
        Some(head) if next <= head.data_parts => runs.push((next, head.data_parts)),
        Some(_) => {}
        // How many parts there are is not known yet.
        None => runs.push((next, u16::MAX)),
    }
    runs
}

/// Joins neighbouring windows that are wanted whole.
fn join_whole_windows(ranges: &mut Vec<Again>) {
    ranges.dedup_by(|next, previous| {
        let whole = |range: &Again| (range.first_part, range.last_part) == (0, u16::MAX);
        let joined = whole(next) && whole(previous) && next.first_window == previous.last_window + 1;
        if joined {
            previous.last_window = next.last_window;
        }
        joined
    });
}

/// Decodes a whole window; `None` where its parts contradict each other or the configuration.
fn build(configuration: &Configuration, head: &WindowHead, parts: &BTreeMap<u16, Vec<u8>>) -> Option<NodeWindow> {
    let total = configuration.lines();
    let mut channels: Vec<ChannelData> = head
        .channels
        .iter()
        .map(|&state| match (state, configuration.summary) {
            (ChannelState::Sound { .. }, Summary::Lines { .. }) => {
                ChannelData::Lines(vec![Complex32::default(); total])
            }
            (ChannelState::Sound { segments }, Summary::Psd { .. }) => {
                ChannelData::Psd { segments, densities: vec![0.0; total], peaks: Vec::new() }
            }
            (state, _) => ChannelData::Unsound(state),
        })
        .collect();
    let mut filled = vec![0; channels.len()];
    for encoded in parts.values() {
        match belfry_shared::message::decode::<NodeMessage<'_>>(encoded).ok()? {
            NodeMessage::Lines(part) => {
                let count = usize::from(part.lines);
                let start = position(configuration, part.first_line, count)?;
                let ChannelData::Lines(lines) = channels.get_mut(usize::from(part.channel))? else { return None };
                decode_lines(part.code, part.bits, lines.get_mut(start..start + count)?).ok()?;
                filled[usize::from(part.channel)] += count;
            }
            NodeMessage::Density(part) => {
                let start = position(configuration, part.first_line, part.code.len())?;
                let ChannelData::Psd { densities, .. } = channels.get_mut(usize::from(part.channel))? else {
                    return None;
                };
                for (density, &code) in densities.get_mut(start..start + part.code.len())?.iter_mut().zip(part.code) {
                    *density = decode_density(part.base, code);
                }
                filled[usize::from(part.channel)] += part.code.len();
            }
            NodeMessage::Peaks(part) => {
                let ChannelData::Psd { peaks, .. } = channels.get_mut(usize::from(part.channel))? else { return None };
                *peaks = part.peaks.to_vec();
            }
            _ => return None,
        }
    }
    let all_filled = channels
        .iter()
        .zip(&filled)
        .all(|(channel, &filled)| filled == if matches!(channel, ChannelData::Unsound(_)) { 0 } else { total });
    all_filled.then_some(NodeWindow {
        name: head.name,
        configuration_hash: head.configuration_hash,
        grid_index: head.grid_index,
        middle_offset_us: head.middle_offset_us,
        drift_ppb: head.drift_ppb,
        channels,
    })
}

#[cfg(test)]
mod tests;
