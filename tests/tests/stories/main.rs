//! End-to-end tests, one module a story that a user would tell, in one program.
//!
//! A test whose data or emulator is absent is ignored with the reason (`build.rs` finds out); `./test` counts those at its end.

mod analysis;
mod bad_input;
mod blind;
mod calculix;
mod calibrate;
mod campaign;
mod change;
mod collect;
mod demo;
mod diagnose;
mod documents;
mod durable;
mod faults;
mod fitted;
mod hardware;
mod identify;
mod init;
mod keys;
mod link;
mod look;
mod model;
mod moving;
mod next;
mod opensees;
mod outcome;
mod page;
mod partial;
mod plan;
mod published;
mod real_records;
mod runs;
mod said;
mod schemas;
mod shell;
mod space;
mod together;
mod watch;
