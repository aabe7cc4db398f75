//! Pictures, as SVG text.

mod comparison;
mod covalidation;
mod history;
mod shapes;
mod singular;
mod trends;

use plotters::style::RGBColor;
use thiserror::Error;

pub use comparison::comparison;
pub use covalidation::{Curves, Prediction, covalidation};
pub use history::history;
pub use shapes::{TrueShape, mode_shapes};
pub use singular::singular_values;
pub use trends::trends;

/// The colour of modes.
const MODE: RGBColor = RGBColor(190, 40, 40);

/// A picture could not be drawn.
#[derive(Debug, Error)]
#[error("the picture of {0} could not be drawn: {1}")]
pub struct PictureError(&'static str, String);
