//! A simulated line as a cable between a node and the host: either end sees when the other has let go.

use std::io;
use std::rc::{Rc, Weak};

use belfry_host::link::Transport;
use belfry_host::link::memory::{HostEnd, Line};

/// The host's end; it fails once the cable is pulled.
pub struct Plug {
    end: HostEnd,
    cable: Weak<()>,
    /// The node sees that the host has let go.
    _held: Rc<()>,
}

/// The node's end; dropping it pulls the cable.
pub struct Connection {
    /// What goes over it.
    pub line: Line,
    /// The host sees that the cable is pulled.
    _cable: Rc<()>,
    host: Weak<()>,
}

/// Plugs both ends of a line in.
pub fn connect(line: Line) -> (Connection, Plug) {
    let (cable, held) = (Rc::new(()), Rc::new(()));
    let (host, pulled) = (Rc::downgrade(&held), Rc::downgrade(&cable));
    let plug = Plug { end: line.host_end(), cable: pulled, _held: held };
    (Connection { line, _cable: cable, host }, plug)
}

impl Connection {
    /// Whether the host still has its end.
    pub fn is_held(&self) -> bool {
        self.host.upgrade().is_some()
    }
}

impl Plug {
    fn check(&self) -> io::Result<()> {
        self.cable.upgrade().map(drop).ok_or_else(|| io::Error::other("the cable is pulled"))
    }
}

impl Transport for Plug {
    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.check()?;
        self.end.write(bytes)
    }

    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.check()?;
        self.end.read(buffer)
    }
}
