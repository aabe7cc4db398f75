//! Delivery of one node's windows: parts flow in, whole windows flow into the sink, and what to acknowledge and to ask again
//! flows out. A node that starts anew begins another life, whose windows are counted from zero. Where it has a store, it still delivers the
//! windows of its earlier lives, one life after the other.

use std::collections::VecDeque;
use std::io::ErrorKind;

use belfry_shared::message::{Acknowledgement, Hello, Kept, NodeMessage, WindowHead};
use belfry_shared::time::{HostTime, WindowGrid};

use super::error::SessionError;
use crate::window::{Assembler, ChannelData, Configurations, KeptWindows, Loss, NodeWindow, Outcome, WindowSink};

/// Earlier lives of a node that are remembered.
const LIVES_KEPT: usize = 8;

/// Bytes of windows that are held until they can be stored, of each node: hours of a tower's.
const MOST_WAITING_BYTES: usize = 1 << 20;

/// A window that begins further ahead of the host's clock, or further behind, was not measured then, whatever its head says.
const MOST_AHEAD_US: i64 = 86_400_000_000;
const MOST_BEHIND_US: i64 = 10 * 366 * 86_400_000_000;

/// What has become of parts and windows.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct DeliveryCounts {
    pub(super) duplicate_parts: u64,
    pub(super) contradictions: u64,
    pub(super) asked_again: u64,
    pub(super) windows: u64,
    pub(super) foreign_windows: u64,
}

/// The windows of one node.
#[derive(Debug)]
pub(super) struct Delivery {
    node: u16,
    configurations: Configurations,
    /// Whether windows that another study asked for are given up.
    pub(super) drops_foreign: bool,
    /// The node's present life; `None` before it has greeted.
    pub(super) present: Option<Assembler>,
    /// Its earlier lives, oldest first.
    earlier: Vec<Assembler>,
    /// The earlier life of which the node still has windows.
    kept_boot: Option<u32>,
    /// Whether the lives before the present one have been ended.
    has_ended_earlier: bool,
    forgotten_losses: u64,
    /// Windows that the sink could not take yet, oldest first. They are not acknowledged, so that the node keeps them too as long as it has
    /// room.
    waiting: VecDeque<Box<NodeWindow>>,
    /// What is lost, and has not been taken down yet.
    losses: VecDeque<Loss>,
    /// Whether the node has something to forget.
    acknowledge: bool,
    /// The same of the earlier life that it still has.
    acknowledge_kept: bool,
    counts: DeliveryCounts,
}

impl Delivery {
    pub(super) fn new(node: u16, configurations: Configurations) -> Self {
        Self {
            node,
            configurations,
            drops_foreign: false,
            present: None,
            earlier: Vec::new(),
            kept_boot: None,
            has_ended_earlier: false,
            forgotten_losses: 0,
            waiting: VecDeque::new(),
            losses: VecDeque::new(),
            acknowledge: false,
            acknowledge_kept: false,
            counts: DeliveryCounts::default(),
        }
    }

    pub(super) fn configurations(&self) -> &Configurations {
        &self.configurations
    }

    pub(super) fn counts(&self) -> DeliveryCounts {
        self.counts
    }

    /// The boot id of the node's present life.
    pub(super) fn boot(&self) -> Option<u32> {
        self.present.as_ref().map(Assembler::boot)
    }

    /// Whether all windows known to exist are stored or given up.
    pub(super) fn has_all(&self) -> bool {
        let kept = self.earlier.iter().filter(|life| Some(life.boot()) == self.kept_boot);
        self.present.iter().chain(kept).all(Assembler::is_complete)
    }

    /// Whether the node is to be told what is stored.
    pub(super) fn must_acknowledge(&self) -> bool {
        self.acknowledge || self.acknowledge_kept
    }

    /// Takes note that a life has windows for the node to forget.
    fn will_acknowledge(&mut self, boot: u32) {
        if self.boot() == Some(boot) {
            self.acknowledge = true;
        } else {
            self.acknowledge_kept |= self.kept_boot == Some(boot);
        }
    }

    /// Windows that no longer exist anywhere, of all lives.
    pub(super) fn lost(&self) -> u64 {
        let missing = |life: &Assembler| if Some(life.boot()) == self.kept_boot { 0 } else { life.missing() };
        let earlier: u64 = self.earlier.iter().map(|life| life.lost() + missing(life)).sum();
        self.forgotten_losses + earlier + self.present.as_ref().map_or(0, Assembler::lost)
    }

    /// Begins a life of which windows from `first_window` on are wanted.
    pub(super) fn begin(&mut self, boot: u32, first_window: u32) {
        let kept = KeptWindows { first: first_window, ..KeptWindows::default() };
        self.present = Some(Assembler::resuming(self.node, boot, &kept));
    }

    /// Takes note of a greeting; whether the node has another life than before.
    pub(super) fn greeted(&mut self, hello: &Hello, sink: &mut dyn WindowSink) -> Result<bool, SessionError> {
        let is_new_life = self.boot() != Some(hello.boot);
        if is_new_life {
            // What the old life still had is lost with it. What is known of it stays, for a frame of it may come late, and
            // its windows must not be taken for new ones.
            let known = self.earlier.iter().position(|assembler| assembler.boot() == hello.boot);
            let next = match known {
                Some(index) => self.earlier.remove(index),
                None => self.met(hello, sink)?,
            };
            let mut last = self.present.replace(next);
            last.iter_mut().for_each(Assembler::forget_parts);
            self.earlier.extend(last);
            self.forget_oldest_life();
            self.has_ended_earlier = false;
        }
        self.holds(hello.boot, hello.oldest_window, hello.next_window);
        self.keeps(hello, sink)?;
        Ok(is_new_life)
    }

    fn forget_oldest_life(&mut self) {
        let forgets = |life: &Assembler| Some(life.boot()) != self.kept_boot;
        if self.earlier.len() > LIVES_KEPT
            && let Some(oldest) = self.earlier.iter().position(forgets)
        {
            let mut oldest = self.earlier.remove(oldest);
            self.losses.extend(oldest.take_losses());
            self.forgotten_losses += oldest.lost() + oldest.missing();
        }
    }

    /// Takes note of what the node says to have kept of its earlier lives.
    fn keeps(&mut self, hello: &Hello, sink: &mut dyn WindowSink) -> Result<(), SessionError> {
        let node = self.node;
        let fail = |source| SessionError::Store { node, source };
        let kept = hello.kept.filter(|kept| kept.has_windows() && kept.boot != hello.boot);
        let kept_boot = kept.map(|kept| kept.boot);
        if self.kept_boot != kept_boot {
            kept_life(&mut self.earlier, self.kept_boot).into_iter().for_each(Assembler::overwritten);
            self.kept_boot = None;
            self.acknowledge_kept = false;
        }
        let Some(Kept { boot, oldest_window, next_window, .. }) = kept else {
            return self.end_earlier(hello.boot, sink);
        };
        if !self.earlier.iter().any(|life| life.boot() == boot) {
            let known = sink.kept(node, boot, oldest_window).map_err(fail)?;
            if known.is_none() && !self.drops_foreign {
                return Err(SessionError::ForeignWindows { node });
            }
            let known = known.unwrap_or_else(|| {
                self.counts.foreign_windows += u64::from(next_window - oldest_window);
                KeptWindows { first: next_window, ..KeptWindows::default() }
            });
            self.earlier.push(Assembler::resuming(node, boot, &known));
        }
        self.kept_boot = Some(boot);
        self.has_ended_earlier = false;
        self.forget_oldest_life();
        if let Some(life) = kept_life(&mut self.earlier, self.kept_boot) {
            life.heartbeat(oldest_window, next_window);
            self.acknowledge_kept |= oldest_window < life.below();
        }
        Ok(())
    }

    /// Takes note that the node has nothing of its earlier lives.
    fn end_earlier(&mut self, boot: u32, sink: &mut dyn WindowSink) -> Result<(), SessionError> {
        if self.has_ended_earlier {
            return Ok(());
        }
        let node = self.node;
        let fail = |source| SessionError::Store { node, source };
        // What is lost for a reason of its own is listed with it first.
        self.note_losses(sink)?;
        if !self.losses.is_empty() {
            return Err(fail(ErrorKind::WouldBlock.into()));
        }
        sink.end_before(node, boot).map_err(fail)?;
        self.has_ended_earlier = true;
        Ok(())
    }

    /// What there is to assemble of a life that is seen for the first time.
    fn met(&mut self, hello: &Hello, sink: &mut dyn WindowSink) -> Result<Assembler, SessionError> {
        let node = self.node;
        let fail = |source| SessionError::Store { node, source };
        let kept = sink.kept(node, hello.boot, hello.oldest_window).map_err(fail)?;
        let held = hello.next_window.saturating_sub(hello.oldest_window);
        if kept.is_none() && held > 0 && !self.drops_foreign {
            return Err(SessionError::ForeignWindows { node });
        }
        sink.meet(node, hello.boot, hello.next_window).map_err(fail)?;
        if kept.is_none() {
            self.counts.foreign_windows += u64::from(held);
        }
        let kept = kept.unwrap_or(KeptWindows { first: hello.next_window, ..KeptWindows::default() });
        Ok(Assembler::resuming(node, hello.boot, &kept))
    }

    /// Takes note of which windows the node holds; `false` where it does so in another life.
    pub(super) fn holds(&mut self, boot: u32, oldest_window: u32, next_window: u32) -> bool {
        let Some(assembler) = self.present.as_mut().filter(|assembler| assembler.boot() == boot) else { return false };
        assembler.heartbeat(oldest_window, next_window);
        // Also repeats an acknowledgement that was lost.
        self.acknowledge |= oldest_window < assembler.below();
        true
    }

    /// Takes note of something that cannot be.
    pub(super) fn contradicted(&mut self) {
        self.counts.contradictions += 1;
    }

    /// Whether a window may have begun when its head says, as of `now`.
    fn is_plausible(&self, head: &WindowHead, now: HostTime) -> bool {
        let Some(configuration) = self.configurations.by_hash(head.configuration_hash) else { return true };
        let (sampling_rate_uhz, hop_samples) = (configuration.sampling_rate_uhz, configuration.hop_samples());
        let start = WindowGrid { sampling_rate_uhz, hop_samples }.start(head.grid_index);
        (now.0.saturating_sub(MOST_BEHIND_US)..=now.0.saturating_add(MOST_AHEAD_US)).contains(&start.0)
    }

    /// Takes a part of a window; a window that is whole with it goes into the sink. `now` is the host's time, where windows are
    /// measured in it.
    pub(super) fn take(
        &mut self,
        now: Option<HostTime>,
        part: &NodeMessage<'_>,
        encoded: &[u8],
        sink: &mut dyn WindowSink,
    ) -> Result<(), SessionError> {
        let node = self.node;
        if let (NodeMessage::Head(head), Some(now)) = (part, now)
            && !self.is_plausible(head, now)
        {
            self.contradicted();
            let life = life_of(head.name.boot, &mut self.present, &mut self.earlier, self.kept_boot);
            life.into_iter().for_each(|life| life.misdated(head.name));
            return Ok(());
        }
        let Some(boot) = part.part().map(|(name, _)| name.boot) else { return Ok(()) };
        let Some(assembler) = life_of(boot, &mut self.present, &mut self.earlier, self.kept_boot) else {
            return Ok(());
        };
        if let NodeMessage::Head(head) = part
            && assembler.is_out_of_order(head)
        {
            let is_another = match sink.start(&head.name) {
                Ok(Some(start)) => start != head.grid_index,
                Ok(None) => !assembler.was_wanted(head.name.number),
                // It is asked for again.
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(source) => return Err(SessionError::Store { node, source }),
            };
            if is_another {
                return Err(SessionError::RepeatedLife { node });
            }
        }
        match assembler.take(&self.configurations, part, encoded) {
            Outcome::Taken | Outcome::NoRoom => {}
            Outcome::Foreign if self.drops_foreign => {
                if let NodeMessage::Head(head) = part {
                    assembler.stored(head.name.number);
                }
                self.counts.foreign_windows += 1;
                self.will_acknowledge(boot);
            }
            Outcome::Foreign => return Err(SessionError::ForeignWindows { node }),
            Outcome::Duplicate => {
                self.counts.duplicate_parts += 1;
                self.will_acknowledge(boot);
            }
            Outcome::Contradiction => self.counts.contradictions += 1,
            Outcome::Whole(window) => {
                let number = window.name.number;
                // One after the other, as they came.
                let stored = if self.waiting.is_empty() {
                    sink.store((*window).clone())
                } else {
                    Err(ErrorKind::WouldBlock.into())
                };
                match stored {
                    Ok(()) => {
                        assembler.stored(number);
                        self.counts.windows += 1;
                        self.will_acknowledge(boot);
                    }
                    Err(error) if error.kind() != ErrorKind::WouldBlock => {
                        assembler.unstored(number);
                        return Err(SessionError::Store { node, source: error });
                    }
                    Err(_) if bytes(&self.waiting) < MOST_WAITING_BYTES => {
                        assembler.waits(number);
                        self.waiting.push_back(window);
                    }
                    // It is asked again when there is room.
                    Err(_) => assembler.unstored(number),
                }
            }
        }
        Ok(())
    }

    /// Stores the windows that wait, once the sink is ready.
    pub(super) fn retry(&mut self, sink: &mut dyn WindowSink) -> Result<(), SessionError> {
        while let Some(window) = self.waiting.front().filter(|_| sink.is_ready()) {
            let name = window.name;
            match sink.store((**window).clone()) {
                Ok(()) => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(source) => return Err(SessionError::Store { node: self.node, source }),
            }
            self.waiting.pop_front();
            let mut lives = self.earlier.iter_mut().chain(&mut self.present);
            if let Some(assembler) = lives.find(|assembler| assembler.boot() == name.boot) {
                assembler.stored(name.number);
            }
            self.counts.windows += 1;
            self.will_acknowledge(name.boot);
        }
        self.note_losses(sink)
    }

    /// Has the sink take down what is lost, once it is ready.
    fn note_losses(&mut self, sink: &mut dyn WindowSink) -> Result<(), SessionError> {
        for loss in self.earlier.iter_mut().chain(&mut self.present).flat_map(Assembler::take_losses) {
            if !self.losses.back_mut().is_some_and(|before| before.join(&loss)) {
                self.losses.push_back(loss);
            }
        }
        while let Some(loss) = self.losses.front().filter(|_| sink.is_ready()) {
            match sink.lost(loss) {
                Ok(()) => drop(self.losses.pop_front()),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(source) => return Err(SessionError::Store { node: self.node, source }),
            }
        }
        Ok(())
    }

    /// What to tell the node of its windows: of the earlier life that it still has, and of its present one.
    pub(super) fn acknowledgements(&mut self, overdue: Option<Overdue>) -> Vec<Acknowledgement> {
        let has_room = bytes(&self.waiting) < MOST_WAITING_BYTES;
        let kept = kept_life(&mut self.earlier, self.kept_boot);
        // Of an earlier life, no window is on its way that nobody has asked for.
        let overdue_kept = overdue.map(|overdue| Overdue { is_busy: false, ..overdue });
        let lives =
            [(kept, &mut self.acknowledge_kept, overdue_kept), (self.present.as_mut(), &mut self.acknowledge, overdue)];
        let mut said = Vec::new();
        for (life, acknowledge, overdue) in lives {
            let Some(life) = life else { continue };
            // What is asked for has to have room.
            let again = match overdue.filter(|_| has_room) {
                Some(Overdue { now, before, answered, is_busy }) => life.overdue(now, before, answered, is_busy),
                None => Vec::new(),
            };
            if !again.is_empty() || std::mem::take(acknowledge) {
                *acknowledge = false;
                self.counts.asked_again += again.len() as u64;
                said.push(Acknowledgement {
                    boot: life.boot(),
                    below: life.below(),
                    again: again.into_iter().collect(),
                });
            }
        }
        said
    }
}

/// Which parts to ask again, as [`Assembler::overdue`] says.
#[derive(Debug, Clone, Copy)]
pub(super) struct Overdue {
    pub(super) now: HostTime,
    pub(super) before: HostTime,
    pub(super) answered: HostTime,
    pub(super) is_busy: bool,
}

/// The life to which a part belongs that the node sends: its present one, or the earlier one that it still has. What is of neither is judged by
/// the present one, as a contradiction.
fn life_of<'a>(
    boot: u32,
    present: &'a mut Option<Assembler>,
    earlier: &'a mut [Assembler],
    kept_boot: Option<u32>,
) -> Option<&'a mut Assembler> {
    kept_life(earlier, kept_boot).filter(|life| life.boot() == boot).or(present.as_mut())
}

/// The earlier life of which the node still has windows.
fn kept_life(earlier: &mut [Assembler], kept_boot: Option<u32>) -> Option<&mut Assembler> {
    earlier.iter_mut().find(|life| Some(life.boot()) == kept_boot)
}

/// About what windows take in memory.
fn bytes(windows: &VecDeque<Box<NodeWindow>>) -> usize {
    let of = |data: &ChannelData| match data {
        ChannelData::Unsound(_) => 0,
        ChannelData::Lines(lines) => size_of_val(lines.as_slice()),
        ChannelData::Psd { densities, peaks, .. } => size_of_val(densities.as_slice()) + size_of_val(peaks.as_slice()),
    };
    windows.iter().map(|window| size_of::<NodeWindow>() + window.channels.iter().map(of).sum::<usize>()).sum()
}
