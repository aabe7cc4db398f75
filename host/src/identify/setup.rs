//! A setup with its averaged cross spectra: what identification starts from.
//!
//! The study says what stands where; the spectra come from [`crate::spectra`].

use super::resonance::Quantity;
use crate::spectra::CrossSpectrum;
use crate::study::{Motion, Setup};

/// A setup with its averaged cross spectra.
#[derive(Debug, Clone)]
pub struct MeasuredSetup<'a> {
    /// What stands where.
    pub setup: &'a Setup,
    /// Its cross-spectral matrices.
    pub spectrum: CrossSpectrum,
}

/// What a setup's recording is of.
pub(super) fn quantity(setup: &Setup) -> Quantity {
    if setup.motion() == Motion::Velocity { Quantity::Velocity } else { Quantity::Acceleration }
}
