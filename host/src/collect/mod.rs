//! Collecting live: from ports with nodes on them to windows in a study's archive.
//!
//! A study says what its nodes are to measure ([`Collection`]). A [`Collector`] knows all nodes, a [`PortServer`] serves one
//! port: it opens it, greets whoever is there, and passes on windows. A node is known by its greeting, not by its port:
//! cables may be swapped, ports may vanish and come back under another name. Nothing is acknowledged before the archive has
//! it on disk, so a stop at any moment loses nothing.
//!
//! All of this takes its time from a [`Clock`] and its lines from [`Ports`], and never waits. [`collect`] runs it in real time,
//! a thread a port; simulated nodes run it in simulated time.

mod clock;
mod collection;
mod collector;
mod event;
mod lock;
mod peaks;
mod ports;
mod report;
mod server;
mod settings;
mod sink;
mod status;
mod threads;
mod words;

pub use clock::{Clock, SystemClock};
pub use collection::Collection;
pub use collector::{CollectError, Collector};
pub use event::{Event, Happening};
pub use ports::{Ports, SystemPorts, all_ports};
pub use report::{PortReport, Report};
pub use server::PortServer;
pub use settings::{CollectOptions, CollectionError};
pub use status::{Gaps, PortState, PortStatus};
pub use threads::{OnLook, collect};
pub use words::Words;
pub(crate) use words::{fault_in_words, gap_in_words, seconds_in_words};
