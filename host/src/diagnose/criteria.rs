//! When evidence is enough: the numbers that decide between verdicts.

/// Evidence of 20 to 1 makes an effect stand out: its natural logarithm.
pub const STANDS_OUT: f64 = 2.995_732_273_553_991;
/// A fit with a probability below this fails.
pub const FAILS: f64 = 0.01;
