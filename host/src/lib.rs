//! Belfry's host: from recordings and sensor nodes to modes, and from modes to what a model lacks.
//!
//! Start with [`story`]: a [`story::Project`] opens a study and takes its steps, as the commands of `belfry` do.
//!
//! Below it, data goes one way, one folder a step. [`study`] says what stands where and [`record`] reads what was
//! measured. [`window`] is what a node sends of it, [`link`] talks to the nodes, [`archive`] keeps their windows, [`heartbeats`] what they say of themselves,
//! [`keys`] holds their keys, [`collect`] does all of this live, [`calibrate`] finds out what their axes read, and [`fleet`] simulates nodes. [`spectra`] averages; [`measure`] runs a study through all of
//! these. [`identify`] makes modes of it, and [`trend`] follows them over the hours. [`modes`] reads modes, its own or
//! another tool's. [`change`] compares two measurements of one structure. [`compare`] holds a [`model`] against them, [`update`] changes its stiffness matrix until they agree,
//! [`covalidate`] predicts sensors that it was not shown, and [`diagnose`] says which physical effect it lacks. [`plan`] says before
//! a measurement what it will show.
//! [`results`] is the folder that all of this is written to, [`picture`] draws it, [`page`] shows it all and [`serve`] serves that page, [`export`] writes it for other tools. [`jetstream`] does the same for thousands of structures.
//! [`simulate`] goes the other way and makes recordings of a structure whose truth is known. [`files`] writes files whole
//! or not at all, [`progress`] says how far long work is, and [`table`] reads small CSV tables. [`command`] holds a file for each subcommand of the `belfry` program; nothing else prints.

pub mod archive;
mod assignment;
pub mod calibrate;
pub mod change;
pub mod collect;
mod colour;
pub mod command;
pub mod compare;
pub mod covalidate;
pub mod diagnose;
pub mod export;
pub mod files;
pub mod fleet;
mod hash;
pub mod heartbeats;
pub mod identify;
pub mod jetstream;
mod joints;
pub mod keys;
pub mod link;
pub mod measure;
pub mod model;
pub mod modes;
mod nearest;
pub mod notify;
mod numbers;
pub mod page;
mod patience;
pub mod picture;
pub mod plan;
mod processor;
pub mod progress;
pub mod record;
mod regression;
pub mod results;
pub mod seedlink;
pub mod serve;
pub mod simulate;
mod spanning;
pub mod spectra;
mod statistics;
pub mod story;
pub mod study;
pub mod table;
pub mod trend;
pub mod update;
pub mod watch;
pub mod window;
