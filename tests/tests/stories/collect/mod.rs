//! A user collects live. One story runs the command in real time; the others run nodes and host in simulated time.

mod bench;
mod disk;
mod fleet;
mod health;
mod keeping;
mod live;
mod mast;
mod ports;
mod seedlink;
mod store;
mod time;
