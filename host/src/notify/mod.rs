//! Who hears of a watch's events besides `alarms.jsonl`: a command of the user's, an e-mail, a broker.
//!
//! The file is the queue. `watch_told.json` counts the lines that each destination has received, so what cannot be sent is sent later, in order, by
//! this watch or the next; a destination that fails holds up no other, and an event that a destination fails at holds up none behind it. Of two watches
//! of one study, one sends at a time. One that is killed between sending an event and noting it sends it again: an e-mail then has the same Message-ID.

mod command;
mod email;
mod mqtt;
mod tls;

use std::collections::BTreeSet;
use std::io;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use command::Hook;

use crate::files::{FolderLock, open_lock};
use crate::results::{ALARMS_FILE, Results, ResultsError, TOLD_FILE};
use crate::story::WatchEvent;
use crate::study::Study;

/// Locked by who sends.
const LOCK_FILE: &str = "watch_told.lock";

/// An event as it is sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Notice {
    /// In words: a sentence or two.
    pub words: String,
    /// As a line of JSON.
    pub json: String,
}

/// Why a destination did not get an event.
#[derive(Debug, Error)]
pub enum NotifyError {
    /// The user's command has failed.
    #[error("--on-alarm: `{command}` {why}")]
    Command {
        /// The command.
        command: String,
        /// What is wrong.
        why: String,
    },
    /// A file that study.toml names cannot be used.
    #[error("{}: {why}", file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        why: String,
    },
    /// The mail server has not taken an e-mail.
    #[error("e-mail by {server}: {why}")]
    Email {
        /// The server.
        server: String,
        /// What was said.
        why: String,
    },
    /// The broker has not taken a message.
    #[error("MQTT by {server}: {why}")]
    Mqtt {
        /// The broker.
        server: String,
        /// What was said.
        why: String,
    },
    /// The system gives no connection.
    #[error("{what}")]
    System {
        /// What it does not give.
        what: &'static str,
        /// What it said.
        source: io::Error,
    },
}

/// What has become of events.
#[derive(Debug, Default)]
pub struct Delivered {
    /// What could not be sent, and is tried again: one of a destination.
    pub failures: Vec<NotifyError>,
    /// Who does not take an event that others have got. It is not tried again.
    pub refused: Vec<NotifyError>,
}

/// How far each destination came; `None` of one that there was not yet.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
struct Told {
    command: Option<Mark>,
    email: Option<Mark>,
    mqtt: Option<Mark>,
}

/// How far a destination came in `alarms.jsonl`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Mark {
    /// The last line that it has got.
    line: usize,
    /// Lines before that one that it has failed at.
    missed: BTreeSet<usize>,
}

impl Told {
    /// The first line that anyone waits for.
    fn first_waiting(&self) -> Option<usize> {
        [&self.command, &self.email, &self.mqtt].into_iter().flatten().map(Mark::first_waiting).min()
    }
}

impl Mark {
    fn first_waiting(&self) -> usize {
        self.missed.first().copied().unwrap_or(self.line + 1)
    }

    /// The same in a file that has no lines behind `last`: it may have been begun anew.
    fn within(mut self, last: usize) -> Self {
        self.line = self.line.min(last);
        self.missed.retain(|line| *line <= last);
        self
    }
}

/// All destinations of a study.
#[derive(Debug)]
pub struct Notifier<'a> {
    study: &'a Study,
    hook: Option<&'a Hook>,
}

impl<'a> Notifier<'a> {
    /// Those of `[alarms]`, and the user's command.
    pub fn new(study: &'a Study, hook: Option<&'a Hook>) -> Self {
        Self { study, hook }
    }

    /// Notes that a destination that is new need not hear of what was before.
    ///
    /// # Errors
    /// When the files of results cannot be read or written.
    pub fn begin(&self) -> Result<(), ResultsError> {
        let results = Results::of(self.study);
        let beginning = || -> Result<(Told, Told), ResultsError> {
            let before = told(&results)?;
            let last = results.lines::<WatchEvent>(ALARMS_FILE)?.objects.last().map_or(0, |(line, _)| *line);
            let now = |mark: &Option<Mark>, is_there: bool| {
                let new = || Mark { line: last, ..Mark::default() };
                is_there.then(|| mark.clone().unwrap_or_else(new).within(last))
            };
            let after = Told {
                // A watch without the command may run beside one with it, whose events wait.
                command: if self.hook.is_some() { now(&before.command, true) } else { before.command.clone() },
                email: now(&before.email, self.study.alarms.email.is_some()),
                mqtt: now(&before.mqtt, self.study.alarms.mqtt.is_some()),
            };
            Ok((before, after))
        };
        let (before, after) = beginning()?;
        if before == after {
            return Ok(());
        }
        results.make_ready()?;
        // What another watch has told meanwhile stays told.
        let _lock = lock(&results)?;
        write(&results, &beginning()?.1)
    }

    /// Gives every destination the events that it has not got yet. It waits for another watch that does so.
    ///
    /// # Errors
    /// When the files of results cannot be read or written.
    pub fn deliver(&self, words: impl Fn(&WatchEvent) -> String) -> Result<Delivered, ResultsError> {
        let results = Results::of(self.study);
        if told(&results)?.first_waiting().is_none() {
            return Ok(Delivered::default());
        }
        let _lock = lock(&results)?;
        let before = told(&results)?;
        let Some(first) = before.first_waiting() else { return Ok(Delivered::default()) };
        let lines = results.lines::<WatchEvent>(ALARMS_FILE)?;
        let notices: Vec<(usize, Notice)> = lines
            .objects
            .iter()
            .filter(|(line, _)| *line >= first)
            .filter_map(|(line, event)| {
                let json = serde_json::to_string(event).ok()?;
                Some((*line, Notice { words: words(event), json }))
            })
            .collect();
        let folder = &self.study.folder;
        let mut queue = Queue { results: &results, notices, told: before, delivered: Delivered::default() };
        if let Some(email) = &self.study.alarms.email {
            let send = |notice: &Notice| email::send(email, folder, &self.study.structure.name, notice);
            queue.give(|told| &mut told.email, send)?;
        }
        if let Some(mqtt) = &self.study.alarms.mqtt {
            let send = |notice: &Notice| mqtt::publish(mqtt, folder, notice).map(|()| Vec::new());
            queue.give(|told| &mut told.mqtt, send)?;
        }
        // Last: it may take its time.
        if let Some(hook) = self.hook {
            let send = |notice: &Notice| hook.run(notice).map(|()| Vec::new());
            queue.give(|told| &mut told.command, send)?;
        }
        Ok(queue.delivered)
    }
}

/// Events that destinations wait for.
struct Queue<'a> {
    results: &'a Results,
    /// With their lines.
    notices: Vec<(usize, Notice)>,
    told: Told,
    delivered: Delivered,
}

impl Queue<'_> {
    /// Gives a destination its events, in order, and then those that it has failed at before; each is noted when it has been taken. `send` says who
    /// refused it. An event that it fails at is tried again the next time. Where it takes the one behind it, others go on; where it fails at
    /// that as well, nothing is to be expected of it now.
    fn give(
        &mut self,
        of: fn(&mut Told) -> &mut Option<Mark>,
        send: impl Fn(&Notice) -> Result<Vec<NotifyError>, NotifyError>,
    ) -> Result<(), ResultsError> {
        let Some(Mark { line: done, missed }) = of(&mut self.told).clone() else { return Ok(()) };
        let new = self.notices.iter().filter(|(line, _)| *line > done);
        let again = self.notices.iter().filter(|(line, _)| missed.contains(line));
        let (mut failed, mut failures) = (None, Vec::new());
        for (line, notice) in new.chain(again) {
            match send(notice) {
                Ok(refused) => self.delivered.refused.extend(refused),
                Err(error) => {
                    failures.push(error);
                    if *line > done && failed.replace(*line).is_some() {
                        break;
                    }
                    continue;
                }
            }
            if let Some(mark) = of(&mut self.told) {
                mark.missed.remove(line);
                if *line > done {
                    mark.line = *line;
                    mark.missed.extend(failed.take());
                }
            }
            write(self.results, &self.told)?;
        }
        // One of them says what is wrong with the destination.
        self.delivered.failures.extend(failures.into_iter().next());
        Ok(())
    }
}

fn told(results: &Results) -> Result<Told, ResultsError> {
    Ok(results.read_json(TOLD_FILE, "watch")?.unwrap_or_default())
}

fn write(results: &Results, told: &Told) -> Result<(), ResultsError> {
    results.write_json_short(TOLD_FILE, told).map(drop)
}

/// Waits until no other watch sends, or notes who has got what.
fn lock(results: &Results) -> Result<FolderLock, ResultsError> {
    let file = results.path(LOCK_FILE);
    let locked = open_lock(&file).and_then(|file| FolderLock::on(file, || {}));
    locked.map_err(|source| ResultsError::Write { file, source })
}

/// The password in a file: its first line.
fn password(file: PathBuf) -> Result<String, NotifyError> {
    let wrong = |why: String| NotifyError::File { file: file.clone(), why };
    let text = std::fs::read_to_string(&file).map_err(|error| wrong(error.to_string()))?;
    let line = text.lines().next().filter(|line| !line.is_empty());
    line.map(str::to_owned).ok_or_else(|| wrong("its first line is to be the password".to_owned()))
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;
    use crate::study::template;

    #[test]
    fn an_event_that_a_destination_fails_at_holds_up_none_behind_it_and_is_tried_again() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("study.toml"), template::CANTON_STUDY).unwrap();
        let results = Results::of(&Study::load(folder.path()).unwrap());
        results.make_ready().unwrap();
        let got = RefCell::new(Vec::new());
        // What it takes and what it fails at; what it says of failures, and what is left.
        let give = |from: usize, to: usize, fails: &[&str]| {
            let notice = |line: usize| (line, Notice { words: line.to_string(), json: String::new() });
            let mut queue = Queue {
                results: &results,
                notices: (from..=to).map(notice).collect(),
                told: told(&results).unwrap(),
                delivered: Delivered::default(),
            };
            let send = |notice: &Notice| {
                if fails.contains(&notice.words.as_str()) {
                    return Err(NotifyError::Command { command: "hook".to_owned(), why: notice.words.clone() });
                }
                got.borrow_mut().push(notice.words.clone());
                Ok(Vec::new())
            };
            queue.give(|told| &mut told.command, send).unwrap();
            let left = told(&results).unwrap().command.unwrap();
            (queue.delivered.failures.len(), left.line, left.missed.into_iter().collect::<Vec<_>>())
        };
        write(&results, &Told { command: Some(Mark::default()), ..Told::default() }).unwrap();
        // It fails at the second.
        assert_eq!(give(1, 4, &["2"]), (1, 4, vec![2]));
        assert_eq!(got.take(), ["1", "3", "4"]);
        // It still does, and takes what is new.
        assert_eq!(give(2, 5, &["2"]), (1, 5, vec![2]));
        assert_eq!(got.take(), ["5"]);
        // It is away: nothing is lost, and it is not tried at every event.
        assert_eq!(give(2, 9, &["2", "6", "7", "8", "9"]), (1, 5, vec![2]));
        assert!(got.take().is_empty());
        assert_eq!(told(&results).unwrap().first_waiting(), Some(2));
        assert_eq!(give(2, 9, &[]), (0, 9, vec![]));
        assert_eq!(got.take(), ["6", "7", "8", "9", "2"]);
        assert_eq!(told(&results).unwrap().first_waiting(), Some(10));
    }

    #[test]
    fn a_destination_that_is_gone_or_a_file_that_is_begun_anew_leaves_nothing_to_catch_up_on() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("study.toml"), template::CANTON_STUDY).unwrap();
        let study = Study::load(folder.path()).unwrap();
        let results = Results::of(&study);
        results.make_ready().unwrap();
        let mark = Mark { line: 9, missed: BTreeSet::from([4]) };
        write(&results, &Told { command: Some(mark.clone()), email: Some(mark.clone()), mqtt: None }).unwrap();
        // The study names no mail server, and there is no file of alarms any more; a watch without the command leaves that as it is.
        Notifier::new(&study, None).begin().unwrap();
        assert_eq!(told(&results).unwrap(), Told { command: Some(mark), ..Told::default() });
        let hook = Hook::parse("true").unwrap();
        Notifier::new(&study, Some(&hook)).begin().unwrap();
        assert_eq!(told(&results).unwrap(), Told { command: Some(Mark::default()), ..Told::default() });
    }
}
