//! The node's own code in this process, without time and without a sensor: what a recording gives on this computer.

use std::io;

use belfry_firmware::{Identity, Memory, Node};
use belfry_shared::time::NodeTime;

use crate::link::Transport;

/// The node's own code, in process, at the other end of a line that carries everything at once.
pub struct InProcess {
    node: Node<Box<Memory>>,
}

impl std::fmt::Debug for InProcess {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("InProcess")
    }
}

impl InProcess {
    /// A node as it starts.
    pub fn new(identity: Identity) -> Self {
        Self { node: Node::new(identity, Box::new(Memory::new())) }
    }
}

impl Transport for InProcess {
    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        for &byte in bytes {
            self.node.receive(NodeTime(0), byte);
        }
        Ok(())
    }

    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.node.poll(NodeTime(0)) {}
        Ok(self.node.transmit(NodeTime(0), buffer))
    }
}
