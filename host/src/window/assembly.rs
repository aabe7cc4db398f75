//! Assembly: from parts, in any order and more than once, to whole windows, each exactly once.

use std::collections::BTreeMap;

use belfry_shared::message::{Again, MAX_AGAIN, NodeMessage, WindowHead, WindowName};
use belfry_shared::time::HostTime;

use super::configuration::Configurations;
use super::loss::{Loss, LossReason, without};
use super::node_window::NodeWindow;
use super::parts::{build, fits};
use super::sink::KeptWindows;

/// Windows ahead of the oldest missing one that are kept; a number further ahead is taken for a fault.
const MAX_AHEAD: u32 = 1 << 16;
/// Parts a window may have; a head that says more is taken for a fault.
const MAX_DATA_PARTS: u16 = 4096;
/// Bytes of unfinished windows that are kept, with what it takes to keep them. A node's outbox has less than a tenth.
const MOST_BYTES: usize = 1 << 20;
/// What a window and a part take beside their bytes, about.
const WINDOW_BYTES: usize = 256;
const PART_BYTES: usize = 64;
/// How often a part is asked again before its window is given up.
const MAX_ASKS: u32 = 30;

#[derive(Debug, Default)]
struct Partial {
    head: Option<WindowHead>,
    /// Encoded messages by part number.
    parts: BTreeMap<u16, Vec<u8>>,
    last_asked: Option<HostTime>,
    asks: u32,
    /// How many parts of the node's life had come when it was asked last.
    parts_before: u64,
    /// Whether its head was refused for its time.
    is_misdated: bool,
}

impl Partial {
    /// About what it takes in memory.
    fn bytes(&self) -> usize {
        WINDOW_BYTES + self.parts.values().map(|part| PART_BYTES + part.capacity()).sum::<usize>()
    }

    fn is_whole(&self) -> bool {
        self.head.as_ref().is_some_and(|head| self.parts.len() == usize::from(head.data_parts))
    }
}

#[derive(Debug)]
enum Progress {
    Partial(Partial),
    /// Whole, and held by the host until it can be stored.
    Waiting,
    Done,
}

impl Progress {
    /// Whether the host has all of it.
    fn is_had(&self) -> bool {
        !matches!(self, Self::Partial(_))
    }
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
    /// There is no room for it before older windows are whole; it is asked again.
    NoRoom,
    /// It was measured with a configuration that is not known here, for another study: a window that is only done when
    /// [`Assembler::stored`] says so.
    Foreign,
}

/// Assembles one boot's windows.
#[derive(Debug)]
pub struct Assembler {
    node: u16,
    boot: u32,
    /// All windows with lower numbers are done or given up.
    below: u32,
    /// One above the highest number known to exist.
    known: u32,
    windows: BTreeMap<u32, Progress>,
    /// What unfinished windows take in memory, as of the last count and what has come since: never too little.
    bytes: usize,
    /// Parts that have come, each once.
    parts_taken: u64,
    /// Of windows kept from before: the last one's number and start.
    last_kept: Option<(u32, u64)>,
    first_wanted: u32,
    /// First and last numbers of windows that were lost before, where they are too many to be noted one by one.
    lost_before: Vec<[u32; 2]>,
    /// The same of windows that are listed as lost, but may come.
    listed_before: Vec<[u32; 2]>,
    lost: u64,
    /// What of it has not been taken down yet.
    losses: Vec<Loss>,
}

impl Assembler {
    /// An assembler for a node's boot, before its first window.
    pub fn new(node: u16, boot: u32) -> Self {
        Self::resuming(node, boot, &KeptWindows::default())
    }

    /// An assembler for a node's boot of which windows are kept from before.
    pub fn resuming(node: u16, boot: u32, kept: &KeptWindows) -> Self {
        let wanted = kept.numbers.iter().filter(|&&number| number >= kept.first);
        let mut windows: BTreeMap<u32, Progress> = wanted.map(|&number| (number, Progress::Done)).collect();
        // Nothing is asked of what was lost before, and it is not lost again.
        let (few, many): (Vec<[u32; 2]>, Vec<[u32; 2]>) =
            kept.lost.iter().copied().partition(|[first, last]| last.saturating_sub(*first) < MAX_AHEAD);
        let lost = few.into_iter().flat_map(|[first, last]| first.max(kept.first)..=last);
        windows.extend(lost.map(|number| (number, Progress::Done)));
        let known = windows.last_key_value().map_or(kept.first, |(&last, _)| last.saturating_add(1));
        let mut assembler = Self {
            node,
            boot,
            below: kept.first,
            known,
            windows,
            bytes: 0,
            parts_taken: 0,
            last_kept: kept.last,
            first_wanted: kept.first,
            lost_before: many,
            listed_before: kept.damaged.clone(),
            lost: 0,
            losses: Vec::new(),
        };
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

    /// The windows given up since the last call, and why.
    pub fn take_losses(&mut self) -> Vec<Loss> {
        std::mem::take(&mut self.losses)
    }

    /// Whether all windows known to exist are done or given up.
    pub fn is_complete(&self) -> bool {
        self.below >= self.known
    }

    /// Whether a window's name is one up to the last that was kept from before, and it begins later than that one. Either the node has
    /// started anew under its old name, or the window is late and the node's time was set back meanwhile: what is kept under the name tells
    /// which, [`Assembler::was_wanted`] where nothing is.
    pub fn is_out_of_order(&self, head: &WindowHead) -> bool {
        let is_ours = (head.name.node, head.name.boot) == (self.node, self.boot);
        is_ours && self.last_kept.is_some_and(|(last, start)| head.name.number <= last && head.grid_index > start)
    }

    /// Whether a window may still have to come: earlier ones were not wanted, or have been dropped since they came.
    pub fn was_wanted(&self, number: u32) -> bool {
        number >= self.first_wanted
    }

    /// Takes a part: the message and its encoding.
    pub fn take(&mut self, configurations: &Configurations, message: &NodeMessage<'_>, encoded: &[u8]) -> Outcome {
        let Some((name, part)) = message.part() else { return Outcome::Contradiction };
        if matches!(message, NodeMessage::Head(head) if head.data_parts > MAX_DATA_PARTS) {
            return Outcome::Contradiction;
        }
        if (name.node, name.boot) != (self.node, self.boot) {
            return Outcome::Contradiction;
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
        if !self.makes_room(name.number, encoded.len()) {
            return Outcome::NoRoom;
        }
        let progress = self.windows.entry(name.number).or_insert_with(|| Progress::Partial(Partial::default()));
        let Progress::Partial(partial) = progress else { return Outcome::Duplicate };
        match message {
            NodeMessage::Head(_) if partial.head.is_some() => return Outcome::Duplicate,
            NodeMessage::Head(head) => partial.head = Some(head.clone()),
            _ if partial.parts.contains_key(&part) => return Outcome::Duplicate,
            _ => drop(partial.parts.insert(part, encoded.to_vec())),
        }
        self.parts_taken += 1;
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
                self.give_up(name.number, LossReason::Unreadable);
                Outcome::Contradiction
            }
        }
    }

    /// Makes room for a part of a window, at the cost of newer ones, which are then asked again; whether there is room. The oldest
    /// window always has it, so that every window comes in its turn.
    fn makes_room(&mut self, number: u32, length: usize) -> bool {
        let needed = WINDOW_BYTES + PART_BYTES + length;
        if self.bytes + needed > MOST_BYTES {
            self.bytes = self.partials().map(|(_, partial)| partial.bytes()).sum();
        }
        while self.bytes + needed > MOST_BYTES {
            let newest = self.partials().next_back().map(|(&newest, partial)| (newest, partial.bytes()));
            match newest {
                Some((newest, bytes)) if newest > number => {
                    self.windows.remove(&newest);
                    self.bytes -= bytes;
                }
                _ if number == self.below => break,
                _ => return false,
            }
        }
        self.bytes += needed;
        true
    }

    fn partials(&self) -> impl DoubleEndedIterator<Item = (&u32, &Partial)> {
        self.windows.iter().filter_map(|(number, progress)| match progress {
            Progress::Partial(partial) => Some((number, partial)),
            _ => None,
        })
    }

    /// Forgets the parts of unfinished windows, of a life that is over.
    pub fn forget_parts(&mut self) {
        self.windows.retain(|_, progress| progress.is_had());
        self.bytes = 0;
    }

    /// Notes that the head of a window that was asked for is dated at a time that has not been, so that it is not taken.
    pub fn misdated(&mut self, name: WindowName) {
        if (name.node, name.boot) == (self.node, self.boot)
            && let Some(Progress::Partial(partial)) = self.windows.get_mut(&name.number)
        {
            partial.is_misdated = true;
        }
    }

    /// Marks a whole window as stored.
    pub fn stored(&mut self, number: u32) {
        if number >= self.below {
            self.windows.insert(number, Progress::Done);
            self.advance();
        }
    }

    /// Marks a whole window as one that waits to be stored: it is neither acknowledged nor asked again, nor lost when the node drops it.
    pub fn waits(&mut self, number: u32) {
        self.windows.insert(number, Progress::Waiting);
    }

    /// Forgets a whole window that could not be stored, so that it is asked again.
    pub fn unstored(&mut self, number: u32) {
        self.windows.insert(number, Progress::Partial(Partial::default()));
    }

    /// Windows known to exist that are neither done nor given up: what is lost if the node has restarted.
    pub fn missing(&self) -> u64 {
        let done = self.windows.values().filter(|progress| progress.is_had()).count();
        u64::from(self.known.saturating_sub(self.below)).saturating_sub(done as u64)
    }

    fn give_up(&mut self, number: u32, reason: LossReason) {
        self.windows.insert(number, Progress::Done);
        self.lose(number, number, reason);
        self.advance();
    }

    fn lose(&mut self, first: u32, last: u32, reason: LossReason) {
        for [first, last] in without([first, last], &self.listed_before) {
            let loss = Loss { node: self.node, boot: self.boot, first, last: Some(last), reason };
            self.lost += loss.windows().unwrap_or(0);
            if !self.losses.last_mut().is_some_and(|before| before.join(&loss)) {
                self.losses.push(loss);
            }
        }
    }

    fn advance(&mut self) {
        loop {
            let below = self.below;
            if matches!(self.windows.first_key_value(), Some((&number, Progress::Done)) if number == below) {
                self.windows.pop_first();
                self.below = below.saturating_add(1);
                continue;
            }
            self.lost_before.retain(|&[_, last]| last >= below);
            let Some(&[_, last]) = self.lost_before.iter().find(|[first, last]| (*first..=*last).contains(&below))
            else {
                return;
            };
            self.below = last.saturating_add(1);
            self.windows = self.windows.split_off(&self.below);
            self.known = self.known.max(self.below);
            if last == u32::MAX {
                return;
            }
        }
    }

    /// Takes what a heartbeat says: windows below `next` exist, those below `oldest` are gone from the node.
    pub fn heartbeat(&mut self, oldest: u32, next: u32) {
        let gone = oldest.min(next);
        if gone > self.below {
            let kept = self.windows.split_off(&gone);
            let had = std::mem::replace(&mut self.windows, kept).into_iter();
            let mut next = self.below;
            for number in had.filter(|(_, progress)| progress.is_had()).map(|(number, _)| number).chain([gone]) {
                if number > next {
                    self.lose(next, number - 1, LossReason::Overwritten);
                }
                next = number.saturating_add(1);
            }
            self.below = gone;
            self.advance();
        }
        // More cannot wait in any node; the rest comes into reach as windows are done.
        self.known = self.known.max(next.min(self.below.saturating_add(MAX_AHEAD)));
    }

    /// Takes note that the node has none of its windows any more.
    pub fn overwritten(&mut self) {
        self.heartbeat(self.known, self.known);
    }

    /// What to ask again at `now`, of windows not asked since `before`; at most [`MAX_AGAIN`] ranges.
    ///
    /// An ask counts towards giving up only if the node has `answered` what the host said since the last one, and no part came: a line that is away,
    /// or carries only what the node says, costs no window, nor does a node that has many to deliver.
    /// `settled` is the number below which parts are overdue: all windows known when the line has fallen silent, all but the
    /// newest while it is busy.
    pub fn overdue(&mut self, now: HostTime, before: HostTime, answered: HostTime, busy: bool) -> Vec<Again> {
        let settled = if busy { self.known.saturating_sub(1) } else { self.known };
        let mut ranges: Vec<Again> = Vec::new();
        let mut hopeless = Vec::new();
        for number in self.below..settled {
            if ranges.len() >= MAX_AGAIN {
                break;
            }
            let progress = self.windows.entry(number).or_insert_with(|| Progress::Partial(Partial::default()));
            let Progress::Partial(partial) = progress else { continue };
            // One that was asked later than now was asked before the host's clock was set back.
            if partial.last_asked.is_some_and(|asked| asked > before && asked <= now) {
                continue;
            }
            if partial.asks >= MAX_ASKS {
                let reason = if partial.is_misdated { LossReason::Misdated } else { LossReason::Unreadable };
                hopeless.push((number, reason));
                continue;
            }
            let is_idle = partial.parts_before == self.parts_taken;
            if partial.last_asked.is_none_or(|asked| answered > asked && is_idle) {
                partial.asks += 1;
            }
            partial.parts_before = self.parts_taken;
            partial.last_asked = Some(now);
            for (first_part, last_part) in missing_parts(partial) {
                ranges.push(Again { first_window: number, last_window: number, first_part, last_part });
            }
        }
        for (number, reason) in hopeless {
            self.give_up(number, reason);
        }
        join_whole_windows(&mut ranges);
        ranges.truncate(MAX_AGAIN);
        ranges
    }
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

#[cfg(test)]
mod tests;
