//! The link to the sensor nodes: transports, the host's end of the protocol, and nodes simulated in process.
//!
//! Bytes flow in from a [`Transport`], whole windows flow out of a [`Session`] into a [`WindowSink`], each exactly once. The
//! session does not know whether its bytes come from a serial port or from [`memory`]; it is told the time.

pub mod assembly;
pub mod clock;
pub mod collect;
pub mod fleet;
pub mod memory;
pub mod port;
pub mod replay;
pub mod session;

use std::io;

pub use assembly::{ChannelData, Configurations, NodeWindow};
pub use session::{Session, SessionError, SessionStatistics};

/// A byte stream to a node that never blocks.
pub trait Transport {
    /// Takes bytes to send.
    fn write(&mut self, bytes: &[u8]) -> io::Result<()>;
    /// Fills `buffer` with bytes that have arrived and returns how many; 0 where there are none.
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize>;
}

/// Where whole windows go. A window counts as delivered when `store` has returned; only then is it acknowledged.
pub trait WindowSink {
    /// Keeps a window.
    fn store(&mut self, window: NodeWindow) -> io::Result<()>;

    /// What is kept already of a node's life when it greets; `None` where it is met for the first time, so that what it holds was
    /// asked for by others. `oldest_window` is the oldest that it still has.
    fn kept(&mut self, node: u16, boot: u32, oldest_window: u32) -> io::Result<Option<KeptWindows>> {
        let _ = (node, boot);
        Ok(Some(KeptWindows { first: oldest_window, numbers: Vec::new(), last: None }))
    }

    /// Notes that a node's life serves here from now on; where it is met for the first time, from window `first_window` on.
    fn meet(&mut self, node: u16, boot: u32, first_window: u32) -> io::Result<()> {
        let _ = (node, boot, first_window);
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
    /// Number and start (in hops since the epoch) of the last of them: a lower number with a later start is another life's.
    pub last: Option<(u32, u64)>,
}

impl WindowSink for Vec<NodeWindow> {
    fn store(&mut self, window: NodeWindow) -> io::Result<()> {
        self.push(window);
        Ok(())
    }
}

/// An error with what is behind it, in one sentence.
pub(crate) fn with_cause(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        let told = cause.to_string();
        if !text.contains(&told) {
            text += &format!(": {told}");
        }
        source = cause.source();
    }
    text
}
