//! The history of a study's model: a JSON object a line, oldest first.

use super::{HISTORY_FILE, Results, ResultsError};
use crate::diagnose::steps::StepRecord;

impl Results {
    /// The steps so far; none where nothing was done yet. Lines that are no steps are left out: [`Results::history_damage`] tells them.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn history(&self) -> Result<Vec<StepRecord>, ResultsError> {
        Ok(self.lines(HISTORY_FILE)?.objects.into_iter().map(|(_, step)| step).collect())
    }

    /// What is wrong with the history's file, a sentence a line that is left out.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn history_damage(&self) -> Result<Vec<String>, ResultsError> {
        let lines = self.lines::<StepRecord>(HISTORY_FILE)?;
        let file = self.path(HISTORY_FILE);
        let sentence = |(line, why): &(usize, serde_json::Error)| {
            format!("{}, line {line} is no step and is left out: {why}", file.display())
        };
        Ok(lines.broken.iter().map(sentence).chain(lines.half_a_line(&file)).collect())
    }

    /// Appends steps and returns them as they stand there: numbered on, with the mark of the `data` that they are of.
    ///
    /// # Errors
    /// When the history cannot be read or written; it is then as it was.
    pub fn append_history(&self, steps: &[StepRecord], data: &str) -> Result<Vec<StepRecord>, ResultsError> {
        if steps.is_empty() {
            return Ok(Vec::new());
        }
        let before = self.lines::<StepRecord>(HISTORY_FILE)?;
        // Lines that are broken have had numbers as well.
        let lines = before.objects.len() + before.broken.len();
        let first = before.objects.iter().map(|(_, step)| step.step + 1).max().unwrap_or(0).max(lines);
        let numbered: Vec<StepRecord> = (first..)
            .zip(steps)
            .map(|(step, record)| StepRecord { step, data: data.to_owned(), ..record.clone() })
            .collect();
        self.append(HISTORY_FILE, before, &numbered)?;
        Ok(numbered)
    }
}
