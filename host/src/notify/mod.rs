//! Who hears of a watch's events besides `alarms.jsonl`: a command of the user's, an e-mail, a broker.
//!
//! The file is the queue. `watch_told.json` counts the lines that each destination has received, so what cannot be sent is sent later, in order, by
//! this watch or the next; a destination that fails holds up no other. One that fails between taking an event and saying so gets it twice: an e-mail
//! then has the same Message-ID.

mod command;
mod email;
mod mqtt;
mod tls;

use std::io;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use command::Hook;

use crate::results::{ALARMS_FILE, Results, ResultsError, TOLD_FILE};
use crate::story::WatchEvent;
use crate::study::Study;

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

/// Lines of `alarms.jsonl` that each destination has got; `None` of one that there was not yet.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
struct Told {
    command: Option<usize>,
    email: Option<usize>,
    mqtt: Option<usize>,
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
        let before = told(&results)?;
        let last = results.lines::<WatchEvent>(ALARMS_FILE)?.objects.last().map_or(0, |(line, _)| *line);
        let now = |told: Option<usize>, is_there: bool| is_there.then_some(told.unwrap_or(last).min(last));
        let after = Told {
            // A watch without the command may run beside one with it, whose events wait.
            command: if self.hook.is_some() { now(before.command, true) } else { before.command },
            email: now(before.email, self.study.alarms.email.is_some()),
            mqtt: now(before.mqtt, self.study.alarms.mqtt.is_some()),
        };
        if before != after {
            results.make_ready()?;
        }
        write(&results, before, after)
    }

    /// Gives every destination the events that it has not got yet.
    ///
    /// # Errors
    /// When the files of results cannot be read or written.
    pub fn deliver(&self, words: impl Fn(&WatchEvent) -> String) -> Result<Delivered, ResultsError> {
        let results = Results::of(self.study);
        let before = told(&results)?;
        let destinations = [before.command, before.email, before.mqtt];
        let Some(first) = destinations.into_iter().flatten().min() else { return Ok(Delivered::default()) };
        let lines = results.lines::<WatchEvent>(ALARMS_FILE)?;
        let notices: Vec<(usize, Notice)> = lines
            .objects
            .iter()
            .filter(|(line, _)| *line > first)
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
            queue.give(|told| &mut told.mqtt, |notice| mqtt::publish(mqtt, folder, notice).map(|()| Vec::new()))?;
        }
        // Last: it may take its time.
        if let Some(hook) = self.hook {
            queue.give(|told| &mut told.command, |notice| hook.run(notice).map(|()| Vec::new()))?;
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
    /// Gives a destination its events, in order, until one fails; each is noted when it has been taken. `send` says who refused it.
    fn give(
        &mut self,
        of: fn(&mut Told) -> &mut Option<usize>,
        send: impl Fn(&Notice) -> Result<Vec<NotifyError>, NotifyError>,
    ) -> Result<(), ResultsError> {
        for (line, notice) in &self.notices {
            if of(&mut self.told).is_none_or(|done| *line <= done) {
                continue;
            }
            match send(notice) {
                Ok(refused) => self.delivered.refused.extend(refused),
                Err(error) => {
                    self.delivered.failures.push(error);
                    break;
                }
            }
            let before = self.told;
            *of(&mut self.told) = Some(*line);
            write(self.results, before, self.told)?;
        }
        Ok(())
    }
}

fn told(results: &Results) -> Result<Told, ResultsError> {
    Ok(results.read_json(TOLD_FILE, "watch")?.unwrap_or_default())
}

fn write(results: &Results, before: Told, after: Told) -> Result<(), ResultsError> {
    if before == after { Ok(()) } else { results.write_json_short(TOLD_FILE, &after).map(drop) }
}

/// The password in a file: its first line.
fn password(file: PathBuf) -> Result<String, NotifyError> {
    let wrong = |why: String| NotifyError::File { file: file.clone(), why };
    let text = std::fs::read_to_string(&file).map_err(|error| wrong(error.to_string()))?;
    let line = text.lines().next().filter(|line| !line.is_empty());
    line.map(str::to_owned).ok_or_else(|| wrong("its first line is to be the password".to_owned()))
}
