//! Co-validation: windows of spectral lines flow in, how well a model's shapes predict left-out sensors from the others
//! flows out.
//!
//! `overlap` turns windows back into band-limited samples; [`Predictor`] predicts the left-out channels from the others
//! (Lei, Wang, Shen 2012, eqs. 15 to 17); [`Witness`] sums up measured and predicted motion as they come, so that a day
//! takes no more memory than an hour.

mod overlap;
mod predictor;
#[cfg(test)]
mod tests;
mod witness;

pub use overlap::{Hop, OverlapAdd};
pub use predictor::{PredictError, Predictor};
pub use witness::{Motion, Witness};
