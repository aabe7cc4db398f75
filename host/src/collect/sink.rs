//! The way of one port's windows into the archive that all ports share.

use std::io;
use std::sync::Mutex;

use belfry_shared::time::{HostTime, WindowGrid};

use super::lock::lock;
use crate::archive::Archive;
use crate::window::{Configurations, KeptWindows, NodeWindow, WindowSink};

/// Puts windows of one node into the archive.
pub(super) struct ArchiveSink<'a> {
    pub(super) archive: &'a Mutex<Archive>,
    pub(super) setup: &'a str,
    pub(super) configurations: &'a Configurations,
    pub(super) now: HostTime,
    /// Sees every window that is kept, and when it began.
    pub(super) on_window: &'a mut dyn FnMut(&NodeWindow, HostTime),
}

impl WindowSink for ArchiveSink<'_> {
    fn store(&mut self, window: NodeWindow) -> io::Result<()> {
        let configuration = self.configurations.by_hash(window.configuration_hash);
        let configuration = configuration.ok_or_else(|| io::Error::other("a window of an unknown configuration"))?;
        lock(self.archive).store(self.setup, configuration, &window, self.now).map_err(io::Error::other)?;
        let (sampling_rate_uhz, hop_samples) = (configuration.sampling_rate_uhz, configuration.hop_samples());
        (self.on_window)(&window, WindowGrid { sampling_rate_uhz, hop_samples }.start(window.grid_index));
        Ok(())
    }

    fn kept(&mut self, node: u16, boot: u32, _: u32) -> io::Result<Option<KeptWindows>> {
        lock(self.archive).kept(node, boot).map_err(io::Error::other)
    }

    fn meet(&mut self, node: u16, boot: u32, first_window: u32) -> io::Result<()> {
        lock(self.archive).meet(self.setup, node, boot, first_window, self.now).map_err(io::Error::other)
    }
}
