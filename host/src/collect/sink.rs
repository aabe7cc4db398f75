//! The way of one port's windows into the archive that all ports share.

use std::io::{self, ErrorKind};

use belfry_shared::message::{Heartbeat, WindowName};
use belfry_shared::time::{HostTime, WindowGrid};

use super::collector::Collector;
use super::event::Happening;
use super::lock::lock;
use crate::archive::{Archive, ArchiveError};
use crate::heartbeats::KeptHeartbeat;
use crate::link::with_cause;
use crate::patience::Patience;
use crate::window::{Configurations, KeptWindows, Loss, NodeWindow, WindowSink};

/// Puts windows of one node into the archive.
pub(super) struct ArchiveSink<'a> {
    pub(super) collector: &'a Collector<'a>,
    pub(super) port: &'a str,
    pub(super) configurations: &'a Configurations,
    pub(super) now: HostTime,
    /// Sees every window that is kept, and when it began.
    pub(super) on_window: &'a mut dyn FnMut(&NodeWindow, HostTime),
}

impl ArchiveSink<'_> {
    /// Writes into the archive, unless that has failed a moment ago. What may pass by itself is to be tried again, and is said once when it
    /// begins and once when it is over.
    fn write(&self, write: impl FnOnce(&mut Archive) -> Result<(), ArchiveError>) -> io::Result<()> {
        let collector = self.collector;
        if lock(&collector.patience).is_waiting(collector.steady()) {
            return Err(ErrorKind::WouldBlock.into());
        }
        let written = write(&mut lock(&collector.archive));
        let mut patience = lock(&collector.patience);
        match written {
            Ok(()) => {
                self.note(&mut patience, None);
                Ok(())
            }
            Err(error) if error.may_pass() => {
                self.note(&mut patience, Some(with_cause(&error)));
                Err(ErrorKind::WouldBlock.into())
            }
            Err(error) => Err(io::Error::other(error)),
        }
    }

    /// Takes note of how writing went, with why it failed; says so once when it begins to fail, and once when that is over.
    fn note(&self, patience: &mut Patience, failure: Option<String>) {
        let now = self.collector.steady();
        let what = match failure {
            None => patience.worked(now).map(|after| Happening::ArchiveBack { after }),
            Some(reason) => patience.failed(now).then_some(Happening::ArchiveAway { reason }),
        };
        if let Some(what) = what {
            self.collector.happened(self.port, None, what);
        }
    }
}

/// Why the archive could not be read, for a session.
fn unread(error: ArchiveError) -> io::Error {
    if error.may_pass() { ErrorKind::WouldBlock.into() } else { io::Error::other(error) }
}

impl WindowSink for ArchiveSink<'_> {
    fn store(&mut self, window: NodeWindow) -> io::Result<()> {
        let configuration = self.configurations.by_hash(window.configuration_hash);
        let configuration = configuration.ok_or_else(|| io::Error::other("a window of an unknown configuration"))?;
        let setup = &self.collector.collection().setup;
        self.write(|archive| archive.store(setup, configuration, &window, self.now))?;
        let (sampling_rate_uhz, hop_samples) = (configuration.sampling_rate_uhz, configuration.hop_samples());
        (self.on_window)(&window, WindowGrid { sampling_rate_uhz, hop_samples }.start(window.grid_index));
        Ok(())
    }

    fn is_ready(&self) -> bool {
        !lock(&self.collector.patience).is_waiting(self.collector.steady())
    }

    fn kept(&mut self, node: u16, boot: u32, _: u32) -> io::Result<Option<KeptWindows>> {
        lock(&self.collector.archive).kept(node, boot).map_err(unread)
    }

    fn start(&mut self, name: &WindowName) -> io::Result<Option<u64>> {
        lock(&self.collector.archive).start(name).map_err(unread)
    }

    fn meet(&mut self, node: u16, boot: u32, first_window: u32) -> io::Result<()> {
        let setup = &self.collector.collection().setup;
        self.write(|archive| archive.meet(setup, node, boot, first_window, self.now))
    }

    fn end_before(&mut self, node: u16, boot: u32) -> io::Result<()> {
        self.write(|archive| archive.end_before(node, boot, self.now))
    }

    /// Heartbeats come again, so that none of them holds windows up: those that cannot be written wait, as long as there is room.
    fn heartbeat(&mut self, now: HostTime, heartbeat: &Heartbeat) {
        let collector = self.collector;
        let mut log = lock(&collector.heartbeats);
        log.push(&KeptHeartbeat::new(now, heartbeat));
        let mut patience = lock(&collector.heartbeat_patience);
        if !patience.is_waiting(collector.steady()) {
            let failure = log.write().err();
            let reason = failure.map(|error| format!("{} cannot be written: {error}", log.file().display()));
            self.note(&mut patience, reason);
        }
    }

    fn lost(&mut self, loss: &Loss) -> io::Result<()> {
        self.write(|archive| archive.lose(loss, self.now))
    }
}
