//! Recordings: what a setup's files hold, streamed in blocks, never read whole.
//!
//! Files flow in; rows in the study's channel order and in SI units flow out, with NaN where a sample is missing.
