//! Pictures: SVG text, and animated PNG or GIF for modes in motion.
//!
//! What was recorded, identified, compared, predicted or added flows in; one file's content a picture flows out.

mod animation;
mod canvas;
mod change;
mod comparison;
mod covalidation;
mod fingerprint;
mod fits;
mod gif;
mod glyphs;
mod history;
mod look;
mod over_time;
mod palette;
mod png;
mod profile;
mod raster;
mod scene;
mod shapes;
mod singular;
mod space;
mod stabilisation;
mod tower;
mod trends;
mod units;
mod watch;

pub use animation::{MovingFormat, MovingMode, MovingStructure, animation};
pub use canvas::PictureError;
pub use change::change;
pub use comparison::comparison;
pub use covalidation::{Curves, Prediction, covalidation};
pub use fingerprint::fingerprints;
pub use fits::fits;
pub use history::history;
pub use look::look;
pub use profile::profile;
pub use shapes::{TrueShape, mode_shapes};
pub use singular::singular_values;
pub use space::{SeenInSpace, comparison_in_space, shapes_in_space};
pub use stabilisation::stabilisation;
pub use trends::trends;
pub use watch::watch;
