//! Files of JSON objects, one a line, oldest first: what they say, what is damaged in them, and how more is appended.

use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Results, ResultsError, Versioned};

/// What a file of objects says.
pub(crate) struct Lines<T> {
    /// Its text, without a last line that lacks its end and is no object.
    text: String,
    /// The objects, each with the number of its line, from 1.
    pub(crate) objects: Vec<(usize, T)>,
    /// Numbers of lines that are none, and why.
    pub(crate) broken: Vec<(usize, serde_json::Error)>,
    /// Whether it ended in half a line.
    is_cut: bool,
}

impl<T: DeserializeOwned> Lines<T> {
    pub(super) fn of(mut text: String) -> Self {
        let end = text.rfind('\n').map_or(0, |end| end + 1);
        let last = &text[end..];
        let is_cut = !last.trim().is_empty() && serde_json::from_str::<T>(last).is_err();
        if is_cut {
            text.truncate(end);
        }
        let (mut objects, mut broken) = (Vec::new(), Vec::new());
        for (number, line) in (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty()) {
            match serde_json::from_str(line) {
                Ok(object) => objects.push((number, object)),
                Err(error) => broken.push((number, error)),
            }
        }
        Self { text, objects, broken, is_cut }
    }

    /// A sentence about the half of a line that the file ends in, where it does.
    pub(crate) fn half_a_line(&self, file: &Path) -> Option<String> {
        self.is_cut.then(|| {
            format!(
                "{} ends in half a line, as a program leaves it that was stopped while it wrote; it is left out",
                file.display()
            )
        })
    }
}

impl Results {
    /// The objects of a file; none where there is no file.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub(crate) fn lines<T: DeserializeOwned>(&self, name: &str) -> Result<Lines<T>, ResultsError> {
        Ok(Lines::of(self.read(name)?.unwrap_or_default()))
    }

    /// Writes a file with more objects behind its lines. Those that are broken stay, for somebody may mend them.
    ///
    /// # Errors
    /// When the file cannot be written; it is then as it was.
    pub(crate) fn append<T: Serialize>(&self, name: &str, before: Lines<T>, objects: &[T]) -> Result<(), ResultsError> {
        let mut text = before.text;
        if !text.is_empty() && !text.ends_with('\n') {
            text.push('\n');
        }
        for object in objects {
            let line = serde_json::to_string(&Versioned::of_result(name, object))
                .map_err(|error| ResultsError::Write { file: self.path(name), source: error.into() })?;
            text += &line;
            text.push('\n');
        }
        self.write(name, text.as_bytes()).map(drop)
    }
}
