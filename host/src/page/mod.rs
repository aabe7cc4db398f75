//! What is seen of a study: one page, in a file of its own or served on this machine.
//!
//! A study's folder flows in; [`PageData`], which is all that pictures and tables show, and the page around it as HTML, flow out. The front
//! end stands in `host/page`, whose README says what its modules and this data promise each other.

mod data;
mod document;
mod findings;
mod model;
mod packed;
mod picks;
mod says;
mod spectra;

pub use data::{PageData, Tried};
pub use document::{Asset, assets, report, served, served_fleet};
pub(crate) use findings::capital;
pub use findings::{Finding, Kind};
pub use model::{MacMatrix, ModelPart};
pub use packed::{Packed, PackedType};
pub use picks::Picks;
pub use spectra::{Records, Spectra};
