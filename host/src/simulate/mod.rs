//! Simulation: recordings of a structure whose truth is known.
