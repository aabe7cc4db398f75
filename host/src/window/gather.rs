//! From nodes' windows to windows of a whole setup, in the order of the grid.

use std::collections::{BTreeMap, BTreeSet};

use super::node_window::NodeWindow;
use super::placement::place_lines;
use crate::spectra::{LineGrid, WindowLines};

#[derive(Debug)]
struct Pending {
    nodes: BTreeSet<u16>,
    window: WindowLines,
}

/// Gathers what the nodes of a setup say about the same interval.
#[derive(Debug)]
pub(crate) struct GridAssembler {
    grid: LineGrid,
    channels: usize,
    channels_of: BTreeMap<u16, Vec<usize>>,
    pending: BTreeMap<u64, Pending>,
}

impl GridAssembler {
    /// For a setup with `channels` channels, of which node `n` has `channels_of[n]`.
    pub(crate) fn new(grid: LineGrid, channels: usize, channels_of: BTreeMap<u16, Vec<usize>>) -> Self {
        Self { grid, channels, channels_of, pending: BTreeMap::new() }
    }

    /// Adds a node's window and hands out the oldest windows as long as they are whole.
    pub(crate) fn add(&mut self, window: NodeWindow, on_window: &mut dyn FnMut(WindowLines)) {
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
    pub(crate) fn flush(&mut self, on_window: &mut dyn FnMut(WindowLines)) {
        for (_, pending) in std::mem::take(&mut self.pending) {
            on_window(pending.window);
        }
    }
}
