//! The study: a folder with `study.toml`, which says what was measured where, and what to make of it.
//!
//! Text flows in, validated types flow out; every error names the file, the line and what was expected.

pub mod alarms;
mod check;
pub mod edit;
mod error;
mod parse;
mod places;
mod section;
pub mod template;
mod types;

use std::path::Path;

pub use error::{FilePosition, StudyError};
pub use places::{Places, PlacesError};
pub(crate) use types::band_at;
pub use types::{
    Analysis, CustomSource, Direction, Drawing, Effect, GroupTerms, LayoutFile, MatrixSource, MatrixTerm,
    MeasuredSource, ModeChoice, Model, ModelSource, Motion, NO_KINDS, RunSource, STANDARD_GRAVITY_M_S2, STUDY_FILE,
    Sensor, Setup, Structure, Study, Unit,
};

impl Study {
    /// The study's folder, from its path or that of its `study.toml`.
    pub fn folder_of(path: &Path) -> &Path {
        match path.parent() {
            Some(parent) if path.ends_with(STUDY_FILE) && !path.is_dir() => {
                if parent == Path::new("") {
                    Path::new(".")
                } else {
                    parent
                }
            }
            _ => path,
        }
    }

    /// Reads and checks `study.toml` in `folder`; the path of the file itself will do as well.
    ///
    /// # Errors
    /// When the file cannot be read, is no TOML, or says something that cannot be meant; the first fault in reading
    /// order of the checks is reported.
    pub fn load(folder: &Path) -> Result<Self, StudyError> {
        let folder = Self::folder_of(folder);
        let file = folder.join(STUDY_FILE);
        let bytes =
            crate::files::read_plain(&file).map_err(|source| StudyError::Read { file: file.clone(), source })?;
        let text = String::from_utf8(bytes).map_err(|error| {
            let good = error.utf8_error().valid_up_to();
            let line = section::line_of(error.as_bytes(), good);
            StudyError::Syntax { file, line, message: "there is a byte that is not UTF-8 text".to_owned() }
        })?;
        let mut study = Self::from_text(&text, folder)?;
        places::place_sensors(&mut study)?;
        Ok(study)
    }

    /// Reads and checks the text of a `study.toml` that stands in `folder`; touches no file.
    ///
    /// # Errors
    /// As [`Study::load`], reading aside.
    pub fn from_text(text: &str, folder: &Path) -> Result<Self, StudyError> {
        parse::study(text, folder)
    }
}

#[cfg(test)]
mod tests;
