//! The user's command: it runs once for every event, with the event as JSON on its standard input.

use std::io::Write;
use std::process::{Command, Stdio};

use super::{Notice, NotifyError};

/// A command with its arguments.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Hook {
    words: Vec<String>,
}

impl Hook {
    /// The command of a line, with quotes as a shell has them; `None` where it is none.
    pub fn parse(line: &str) -> Option<Self> {
        shlex::split(line).filter(|words| !words.is_empty()).map(|words| Self { words })
    }

    /// Runs it with an event.
    pub(super) fn run(&self, notice: &Notice) -> Result<(), NotifyError> {
        let failed = |why: String| NotifyError::Command { command: self.words.join(" "), why };
        let spawned = Command::new(&self.words[0]).args(&self.words[1..]).stdin(Stdio::piped()).spawn();
        let mut child = spawned.map_err(|error| failed(format!("cannot be run: {error}")))?;
        // A command that does not read is none the worse.
        if let Some(mut input) = child.stdin.take() {
            let _ = input.write_all(format!("{}\n", notice.json).as_bytes());
        }
        let status = child.wait().map_err(|error| failed(format!("cannot be waited for: {error}")))?;
        if status.success() { Ok(()) } else { Err(failed(format!("ended with {status}"))) }
    }
}
