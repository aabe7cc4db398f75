//! Recordings of structures whose modes are known, made otherwise than `belfry simulate` makes them: line by line in the
//! frequency domain, with forces that are correlated between modes or coherent along the height, coloured, and with faults as
//! sensors have them.
//!
//! A [`Case`] and a seed flow in; a study with its recording, the true modes beside it, and how `belfry identify` stands to
//! them, mode by mode, flow out.

mod cases;
mod fault;
mod found;
mod load;
mod machine;
mod record;
mod score;
mod structure;
mod study;
mod whole_mode;

pub use cases::{CASES, Case, case};
pub use fault::Fault;
pub use machine::Machine;
pub use score::{CaseScore, ModeScore, run};
