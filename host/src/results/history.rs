//! The history of a study's model: a JSON object a line, oldest first.

use super::{HISTORY_FILE, Results, ResultsError};
use crate::diagnose::steps::StepRecord;

impl Results {
    /// The steps so far; none where nothing was done yet. Lines that are no steps are left out: [`Results::history_damage`] tells them.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn history(&self) -> Result<Vec<StepRecord>, ResultsError> {
        Ok(steps_of(&self.read(HISTORY_FILE)?.unwrap_or_default()))
    }

    /// What is wrong with the history's file, a sentence a line that is left out.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn history_damage(&self) -> Result<Vec<String>, ResultsError> {
        let text = self.read(HISTORY_FILE)?.unwrap_or_default();
        let file = self.path(HISTORY_FILE);
        let whole = whole_lines(&text);
        let broken = whole.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
        let broken = broken.filter_map(|(index, line)| Some((index, step(line).err()?)));
        let mut sentences: Vec<String> = broken
            .map(|(index, why)| format!("{}, line {} is no step and is left out: {why}", file.display(), index + 1))
            .collect();
        if whole.len() < text.len() {
            sentences.push(format!(
                "{} ends in half a line, as a program leaves it that was stopped while it wrote; it is left out",
                file.display()
            ));
        }
        Ok(sentences)
    }

    /// Appends steps and returns them as they stand there: numbered on, with the mark of the `data` that they are of.
    ///
    /// # Errors
    /// When the history cannot be read or written; it is then as it was.
    pub fn append_history(&self, steps: &[StepRecord], data: &str) -> Result<Vec<StepRecord>, ResultsError> {
        if steps.is_empty() {
            return Ok(Vec::new());
        }
        let mut text = whole_lines(&self.read(HISTORY_FILE)?.unwrap_or_default()).to_owned();
        // Lines that are broken have had numbers as well.
        let lines = text.lines().filter(|line| !line.trim().is_empty()).count();
        let first = steps_of(&text).iter().map(|step| step.step + 1).max().unwrap_or(0).max(lines);
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

fn step(line: &str) -> serde_json::Result<StepRecord> {
    serde_json::from_str(line)
}

fn steps_of(text: &str) -> Vec<StepRecord> {
    text.lines().filter_map(|line| step(line).ok()).collect()
}

/// The text without a last line that lacks its end and is no step.
fn whole_lines(text: &str) -> &str {
    let end = text.rfind('\n').map_or(0, |end| end + 1);
    if text[end..].trim().is_empty() || step(&text[end..]).is_ok() { text } else { &text[..end] }
}
