//! Where whole windows go: a list, or an archive on the disk.

use std::io;

use belfry_shared::message::{Heartbeat, WindowName};
use belfry_shared::time::HostTime;

use super::loss::Loss;
use super::node_window::NodeWindow;

/// Where whole windows go. A window counts as delivered when `store` has returned; only then is it acknowledged.
///
/// An error of the kind [`io::ErrorKind::WouldBlock`] passes by itself: what failed is to be tried again once the sink is ready. Any other ends
/// the session.
pub trait WindowSink {
    /// Keeps a window.
    fn store(&mut self, window: NodeWindow) -> io::Result<()>;

    /// Whether it is worth trying.
    fn is_ready(&self) -> bool {
        true
    }

    /// What is kept already of a node's life when it greets; `None` where it is met for the first time, so that what it holds was
    /// asked for by others. `oldest_window` is the oldest that it still has.
    fn kept(&mut self, node: u16, boot: u32, oldest_window: u32) -> io::Result<Option<KeptWindows>> {
        let _ = (node, boot);
        Ok(Some(KeptWindows { first: oldest_window, ..KeptWindows::default() }))
    }

    /// Notes that a node's life serves here from now on; where it is met for the first time, from window `first_window` on.
    fn meet(&mut self, node: u16, boot: u32, first_window: u32) -> io::Result<()> {
        let _ = (node, boot, first_window);
        Ok(())
    }

    /// Notes that a node has no windows any more of the boots before this one: what has not come of them is lost.
    fn end_before(&mut self, node: u16, boot: u32) -> io::Result<()> {
        let _ = (node, boot);
        Ok(())
    }

    /// When a window begins that is kept under this name, in hops since the epoch; `None` where none is.
    fn start(&mut self, name: &WindowName) -> io::Result<Option<u64>> {
        let _ = name;
        Ok(None)
    }

    /// Sees a sign of life that has come at `now`.
    fn heartbeat(&mut self, now: HostTime, heartbeat: &Heartbeat) {
        let _ = (now, heartbeat);
    }

    /// Notes that windows no longer exist anywhere.
    fn lost(&mut self, loss: &Loss) -> io::Result<()> {
        let _ = loss;
        Ok(())
    }
}

/// The windows of one life of a node that are kept from before.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct KeptWindows {
    /// The first window that is wanted: the next there was when this life was met first.
    pub first: u32,
    /// Numbers of the windows that are kept, in any order.
    pub numbers: Vec<u32>,
    /// First and last numbers of those that are known to be lost, in any order.
    pub lost: Vec<[u32; 2]>,
    /// The same of those that a damaged archive no longer had. They are listed as lost, but the node may still have some: they come if it does, and
    /// are not lost a second time if it does not.
    pub damaged: Vec<[u32; 2]>,
    /// Number and start (in hops since the epoch) of the last of them: a lower number with a later start is another life's.
    pub last: Option<(u32, u64)>,
}

impl WindowSink for Vec<NodeWindow> {
    fn store(&mut self, window: NodeWindow) -> io::Result<()> {
        self.push(window);
        Ok(())
    }
}
