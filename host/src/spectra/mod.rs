//! Spectra: from windows of complex lines to an averaged cross-spectral matrix.
//!
//! [`plan`] chooses decimation and segment, windows come from sensor nodes or straight from a recording ([`direct`]), in the
//! same units and on the same grid either way; [`StandOut`] silences windows that are far off the others,
//! [`CrossSpectrumAccumulator`] sums outer products, and [`CrossSpectrum`]
//! is their average. [`FinerSpectrum`] has finer lines of a short record's windows.

mod accumulate;
mod cross_spectrum;
pub mod direct;
mod extent;
mod finer;
mod grid;
mod noisy;
pub mod plan;
mod stand_out;
mod sums;

pub use accumulate::{CrossSpectrumAccumulator, SpectraError, SpectraWarning};
pub use cross_spectrum::CrossSpectrum;
pub use extent::SetupExtent;
pub(crate) use extent::rows_for;
pub use finer::FinerSpectrum;
pub(crate) use grid::around;
pub use grid::{LineGrid, WindowLines};
pub use noisy::Alone;
pub use plan::{AfterGaps, Lines, PlanError, SpectralPlan};
pub use stand_out::{Silenced, StandOut};
pub(crate) use sums::{BAND_HALVES, ENVELOPE_HALF};
