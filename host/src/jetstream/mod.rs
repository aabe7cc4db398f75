//! A fleet of structures over NATS JetStream: gateways publish the windows of their archives, workers make modes, results and alarms of them.
//!
//! A [`Gateway`] runs beside a collection and publishes what the archive has, in its order, each window once. A structure is added with its
//! study ([`add`]); then [`work`] finds it. What a worker publishes is decided by what stands in the stream alone, in its order, and each result says
//! where the next begins, so that whoever takes a structure over gets the same. The protocol is written down in `docs/fleet.md`.

mod bundle;
mod day_table;
mod error;
mod follow;
mod gateway;
mod heartbeats;
mod ledger;
mod listen;
mod names;
mod overview;
mod position;
mod reading;
mod server;
mod session;
mod share;
mod structure;
mod worker;

pub use error::StreamError;
pub use follow::IntervalResult;
pub use gateway::{Gateway, GatewayNews};
pub use overview::{Detail, Overview, Reader as FleetReader, Row, RowState};
pub use server::Address;
pub use structure::{Added, ToAdd, add};
pub use worker::{WorkNews, WorkOptions, work};
