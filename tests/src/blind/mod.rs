//! The blind bench of `belfry diagnose`: structures with a hidden defect, recordings of them, and the score of what is said of them.
//!
//! A seed and a case's number flow in; a study with a recording flows out, is given to the `belfry` program, and its answer is
//! held against what was hidden. The structures are simulated by finite elements of their own, on a finer mesh than the
//! study's: nothing here uses belfry's model, effects or simulation.

mod answer;
mod banded;
mod body;
mod cases;
mod damped;
mod effect;
mod element;
mod honesty;
mod magnitude;
mod motion;
mod outside;
mod recording;
mod report;
mod run;
mod scatter;
mod score;
mod structures;
mod study;
mod table;
mod visibility;
mod wind;
mod world;

pub use cases::{Case, Category, Kinds, Options};
pub use report::print_summary;
pub use run::{Bench, BenchError};
pub use score::{CaseRecord, line};
pub use structures::Structure;
pub use world::{Kernel, Loads, World, Worlds};
