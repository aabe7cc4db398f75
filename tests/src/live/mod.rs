//! Nodes in real time behind sockets, and the command that collects from them: what it costs, and what a kill costs.

mod kills;
mod load;
mod nodes;

pub use kills::{KillReport, kills};
pub(crate) use load::cpu_s;
pub use load::{LoadReport, load};
