//! A command that the page has asked for, as a program of its own.

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::{Child, Command};

use crate::command::{PROGRESS_LINES, in_shell};

/// A command that says nothing is told of so often.
const TELL_EVERY: Duration = Duration::from_secs(1);
/// Lines of a command's output that are kept.
const LINES_KEPT: usize = 40;

/// Commands that the page may ask for, and what they may be given: flags, and whether a word of their own.
const ALLOWED: [(&str, &[&str], bool); 8] = [
    ("identify", &["--direct", "--every"], false),
    ("compare", &[], false),
    ("update", &[], false),
    ("covalidate", &["--direct", "--channels"], true),
    ("diagnose", &["--auto"], false),
    ("profile", &[], false),
    ("add", &[], true),
    ("remove", &[], true),
];

/// Of these, those that read windows, which take a range of time.
const OF_WINDOWS: [&str; 2] = ["identify", "covalidate"];

/// What takes steps for the page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stepper {
    /// This program.
    pub program: PathBuf,
    /// The range of time among collected windows, as it is typed: `--last`, `7d`.
    pub range: Vec<String>,
}

/// How far a command is, or how it ended.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct JobStatus {
    pub(super) id: u64,
    /// What a user would type.
    pub(super) command: String,
    pub(super) state: JobState,
    /// What it is at, and how far; nothing where it does not say.
    pub(super) stage: Option<String>,
    pub(super) done: u64,
    pub(super) total: u64,
    pub(super) elapsed_s: f64,
    /// What it says on its error output, the last lines of it.
    pub(super) output: String,
}

/// What a command has come to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum JobState {
    Running,
    Done,
    Failed,
    Cancelled,
}

/// A command to run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Order {
    program: PathBuf,
    /// The command, the study, and the rest.
    arguments: Vec<String>,
    study: PathBuf,
}

impl Order {
    /// A command by its words, as `["add", "base-rotation"]`, on a study.
    ///
    /// # Errors
    /// A sentence, where the page may not ask for that.
    pub(super) fn of(words: &[String], stepper: &Stepper, study: &Path) -> Result<Self, String> {
        let (command, rest) = words.split_first().ok_or("no command was named")?;
        let known = ALLOWED.iter().find(|(name, ..)| name == command);
        let (_, flags, takes_word) =
            known.ok_or_else(|| format!("{command} is nothing that the page can do; run it in a terminal"))?;
        for word in rest {
            let flag = word.split_once('=').map_or(word.as_str(), |(flag, _)| flag);
            let is_allowed = if word.starts_with('-') { flags.contains(&flag) } else { *takes_word };
            if !is_allowed {
                return Err(format!("{command} takes no {word} here; run it in a terminal"));
            }
        }
        let range = if OF_WINDOWS.contains(&command.as_str()) { &stepper.range[..] } else { &[] };
        let arguments = std::iter::once(command).chain(rest).chain(range).cloned().collect();
        Ok(Self { program: stepper.program.clone(), arguments, study: study.to_owned() })
    }

    /// What a user would type.
    pub(super) fn typed(&self) -> String {
        let (command, rest) =
            self.arguments.split_first().map_or(("", &[][..]), |(first, rest)| (first.as_str(), rest));
        let rest = rest.iter().map(|word| format!(" {}", in_shell(Path::new(word))));
        format!("belfry {command} {}{}", in_shell(&self.study), rest.collect::<String>())
    }

    /// Starts it.
    pub(super) fn start(&self) -> std::io::Result<Child> {
        let (command, rest) =
            self.arguments.split_first().map_or(("", &[][..]), |(first, rest)| (first.as_str(), rest));
        Command::new(&self.program)
            .arg(command)
            .arg(&self.study)
            .args(rest)
            .env(PROGRESS_LINES, "1")
            .env("NO_COLOR", "1")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
    }
}

/// A line of progress, as commands print it where `PROGRESS_LINES` asks for it.
#[derive(Debug, Deserialize)]
struct ProgressLine {
    stage: String,
    done: u64,
    total: u64,
}

/// Follows a command to its end, and tells of every change.
pub(super) async fn follow(mut child: Child, mut status: JobStatus, tell: impl Fn(&JobStatus)) -> JobStatus {
    let start = Instant::now();
    let mut kept: Vec<String> = Vec::new();
    if let Some(output) = child.stderr.take() {
        let mut lines = BufReader::new(output).lines();
        loop {
            let said = match tokio::time::timeout(TELL_EVERY, lines.next_line()).await {
                Ok(Ok(Some(line))) => Some(line),
                Ok(_) => break,
                // Nothing was said; the time goes on.
                Err(_) => None,
            };
            match said.as_deref().map(serde_json::from_str::<ProgressLine>) {
                Some(Ok(ProgressLine { stage, done, total })) => {
                    (status.stage, status.done, status.total) = (Some(stage), done, total);
                }
                Some(Err(_)) => {
                    kept.extend(said);
                    let from = kept.len().saturating_sub(LINES_KEPT);
                    kept.drain(..from);
                    status.output = kept.join("\n");
                }
                None => {}
            }
            status.elapsed_s = start.elapsed().as_secs_f64();
            tell(&status);
        }
    }
    let ended = child.wait().await;
    status.elapsed_s = start.elapsed().as_secs_f64();
    (status.stage, status.state) =
        (None, if ended.is_ok_and(|ended| ended.success()) { JobState::Done } else { JobState::Failed });
    status
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_runs_commands_of_belfry_on_its_study_and_nothing_else() {
        let of = |words: &[&str]| {
            let words: Vec<String> = words.iter().map(|word| (*word).to_owned()).collect();
            let stepper =
                Stepper { program: "/bin/belfry".into(), range: ["--last", "7d"].map(str::to_owned).to_vec() };
            Order::of(&words, &stepper, Path::new("my tower"))
        };
        assert_eq!(of(&["add", "added-mass@443.6m"]).unwrap().typed(), "belfry add 'my tower' added-mass@443.6m");
        assert_eq!(of(&["identify", "--direct"]).unwrap().typed(), "belfry identify 'my tower' --direct --last 7d");
        for words in [
            &[][..],
            &["init"],
            &["export", "--output"],
            &["identify", "--json"],
            &["identify", "elsewhere"],
            &["report", "--output", "/etc/passwd"],
            &["add", "--json"],
        ] {
            assert!(of(words).is_err(), "{words:?}");
        }
    }
}
