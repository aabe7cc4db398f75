//! The history of a study's model: a JSON object a line, oldest first.

use super::{HISTORY_FILE, Results, ResultsError};
use crate::diagnose::steps::StepRecord;

impl Results {
    /// The steps so far; none where nothing was done yet.
    ///
    /// # Errors
    /// When the file cannot be read; names the line.
    pub fn history(&self) -> Result<Vec<StepRecord>, ResultsError> {
        self.steps_of(whole_lines(&self.read(HISTORY_FILE)?.unwrap_or_default()))
    }

    fn steps_of(&self, text: &str) -> Result<Vec<StepRecord>, ResultsError> {
        let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
        let step = |(index, line): (usize, &str)| {
            serde_json::from_str(line).map_err(|source| ResultsError::Syntax {
                file: self.path(HISTORY_FILE),
                line: index + 1,
                step: "add",
                source,
            })
        };
        lines.map(step).collect()
    }

    /// A sentence, where the file ends in half a line, which is left out.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn torn_history(&self) -> Result<Option<String>, ResultsError> {
        let text = self.read(HISTORY_FILE)?.unwrap_or_default();
        let is_torn = whole_lines(&text).len() < text.len();
        Ok(is_torn.then(|| {
            format!(
                "{} ends in half a line, as a program leaves it that was stopped while it wrote; it is left out",
                self.path(HISTORY_FILE).display()
            )
        }))
    }

    /// Appends steps and returns them as they stand there: numbered on, with the mark of the `data` that they are of.
    ///
    /// # Errors
    /// When the history cannot be read or written; it is then as it was.
    pub fn append_history(&self, steps: &[StepRecord], data: &str) -> Result<Vec<StepRecord>, ResultsError> {
        let mut text = whole_lines(&self.read(HISTORY_FILE)?.unwrap_or_default()).to_owned();
        let first = self.steps_of(&text)?.last().map_or(0, |last| last.step + 1);
        let numbered: Vec<StepRecord> = (first..)
            .zip(steps)
            .map(|(step, record)| StepRecord { step, data: data.to_owned(), ..record.clone() })
            .collect();
        if !text.is_empty() && !text.ends_with('\n') {
            text.push('\n');
        }
        for step in &numbered {
            let line = serde_json::to_string(step)
                .map_err(|error| ResultsError::Write { file: self.path(HISTORY_FILE), source: error.into() })?;
            text += &line;
            text.push('\n');
        }
        self.write(HISTORY_FILE, text.as_bytes())?;
        Ok(numbered)
    }
}

/// The text without a last line that lacks its end and is no step.
fn whole_lines(text: &str) -> &str {
    let end = text.rfind('\n').map_or(0, |end| end + 1);
    let is_step = |line: &str| serde_json::from_str::<StepRecord>(line).is_ok();
    if text[end..].trim().is_empty() || is_step(&text[end..]) { text } else { &text[..end] }
}
