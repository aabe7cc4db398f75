//! Where nodes may be: the ports of this computer, or those of a simulation.

use std::io;

use crate::link::port::{Port, serial_ports};
use crate::link::{Transport, with_cause};

/// The ports on which nodes may answer.
pub trait Ports {
    /// Their names at the moment. A node may be plugged in later, and a cable that is pulled may come back under another name.
    fn list(&self) -> Vec<String>;

    /// Opens a port.
    ///
    /// # Errors
    /// Why it cannot be opened, in a sentence.
    fn open(&self, name: &str) -> Result<Box<dyn Transport>, String>;
}

/// The ports of this computer.
#[derive(Debug, Clone)]
pub struct SystemPorts {
    /// The ones that are named; all serial ports where none is.
    pub named: Vec<String>,
    /// Baud rate of serial ports.
    pub baud: u32,
}

impl Ports for SystemPorts {
    fn list(&self) -> Vec<String> {
        if self.named.is_empty() { all_ports().unwrap_or_default() } else { self.named.clone() }
    }

    fn open(&self, name: &str) -> Result<Box<dyn Transport>, String> {
        match Port::open(name, self.baud) {
            Ok(port) => Ok(Box::new(port)),
            Err(error) => Err(with_cause(&error)),
        }
    }
}

/// Names of all serial ports.
///
/// # Errors
/// Where the system does not say.
pub fn all_ports() -> io::Result<Vec<String>> {
    Ok(serial_ports()?.into_iter().map(|(name, _)| name).collect())
}
