//! The user's command: it runs once for every event, with the event as JSON on its standard input.

use std::io::Write;
use std::process::{Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use super::{Notice, NotifyError};

/// How long it may take.
const LONGEST: Duration = Duration::from_secs(60);
/// How often it is looked whether it has ended.
const LOOK: Duration = Duration::from_millis(20);

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
        // Its arguments may hold a password.
        let failed = |why: String| NotifyError::Command { command: self.words[0].clone(), why };
        let spawned = Command::new(&self.words[0]).args(&self.words[1..]).stdin(Stdio::piped()).spawn();
        let mut child = spawned.map_err(|error| failed(format!("cannot be run: {error}")))?;
        if let Some(mut input) = child.stdin.take() {
            let line = format!("{}\n", notice.json);
            // A command that does not read is none the worse, and holds up nothing.
            thread::spawn(move || drop(input.write_all(line.as_bytes())));
        }
        let start = Instant::now();
        let status: Option<ExitStatus> = loop {
            let ended = child.try_wait().map_err(|error| failed(format!("cannot be waited for: {error}")))?;
            if ended.is_some() || start.elapsed() > LONGEST {
                break ended;
            }
            thread::sleep(LOOK);
        };
        match status {
            Some(status) if status.success() => Ok(()),
            Some(status) => Err(failed(format!("ended with {status}"))),
            None => {
                let _ = child.kill().and_then(|()| child.wait());
                Err(failed(format!("had not ended after {} s, and was stopped", LONGEST.as_secs())))
            }
        }
    }
}
