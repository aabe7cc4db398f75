//! From nodes' windows to windows of a whole setup, in the order of the grid.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::TAU;

use num_complex::{Complex32, Complex64};

use crate::link::{ChannelData, NodeWindow};
use crate::spectra::{LineGrid, WindowLines};

#[derive(Debug)]
struct Pending {
    nodes: BTreeSet<u16>,
    window: WindowLines,
}

/// Gathers what the nodes of a setup say about the same interval.
#[derive(Debug)]
pub(super) struct GridAssembler {
    grid: LineGrid,
    channels: usize,
    channels_of: BTreeMap<u16, Vec<usize>>,
    pending: BTreeMap<u64, Pending>,
}

impl GridAssembler {
    /// For a setup with `channels` channels, of which node `n` has `channels_of[n]`.
    pub(super) fn new(grid: LineGrid, channels: usize, channels_of: BTreeMap<u16, Vec<usize>>) -> Self {
        Self { grid, channels, channels_of, pending: BTreeMap::new() }
    }

    /// Adds a node's window and hands out the oldest windows as long as they are whole.
    pub(super) fn add(&mut self, window: NodeWindow, on_window: &mut dyn FnMut(WindowLines)) {
        let Some(channels) = self.channels_of.get(&window.name.node) else { return };
        let pending = self.pending.entry(window.grid_index).or_insert_with(|| Pending {
            nodes: BTreeSet::new(),
            window: WindowLines { grid_index: window.grid_index, channels: vec![None; self.channels] },
        });
        if !pending.nodes.insert(window.name.node) {
            return;
        }
        place_lines(&self.grid, window, channels, &mut pending.window);
        while let Some(first) = self.pending.first_entry()
            && first.get().nodes.len() == self.channels_of.len()
        {
            on_window(first.remove().window);
        }
    }

    /// Hands out what is left, whole or not.
    pub(super) fn flush(&mut self, on_window: &mut dyn FnMut(WindowLines)) {
        for (_, pending) in std::mem::take(&mut self.pending) {
            on_window(pending.window);
        }
    }
}

/// Puts a node's lines where its `channels` stand in a window of the whole setup, as if its segment had started on the grid.
pub(crate) fn place_lines(grid: &LineGrid, window: NodeWindow, channels: &[usize], whole: &mut WindowLines) {
    for (data, &channel) in window.channels.into_iter().zip(channels) {
        if let (ChannelData::Lines(mut lines), Some(place)) = (data, whole.channels.get_mut(channel)) {
            remove_offset(grid, window.start_offset_us, &mut lines);
            *place = Some(lines);
        }
    }
}

/// Turns lines of a segment that started `offset_us` late into those of one that started on the grid: a signal seen from a
/// later start leads by 2 pi f times the delay.
fn remove_offset(grid: &LineGrid, offset_us: i32, lines: &mut [Complex32]) {
    if offset_us == 0 {
        return;
    }
    let spacing_hz = grid.sampling_rate_hz / grid.segment as f64;
    for (index, line) in lines.iter_mut().enumerate() {
        let frequency_hz = (grid.first_line + index) as f64 * spacing_hz;
        let turn = Complex64::cis(-TAU * frequency_hz * f64::from(offset_us) * 1e-6);
        *line *= Complex32::new(turn.re as f32, turn.im as f32);
    }
}
