//! Identification: from cross-spectral matrices to modes.
//!
//! Per-setup cross-spectral matrices flow in; modes with frequency, damping, shape and the uncertainty of each flow out.
