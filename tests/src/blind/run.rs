//! The run of a case: the study is written, `belfry` is run on it as a user would, and its answers are read.
//!
//! A command that fails, or does not end, is noted in the case's record and ends nothing else.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;

use super::answer::{self, IdentifiedMode};
use super::cases::{Case, Category};
use super::effect::Place;
use super::honesty::{ExactMode, honesty};
use super::score::{CaseRecord, TrueEffect, canonical};
use super::study;
use super::visibility::{Measured, visibility};
use crate::statistics::quantile;

/// A command that takes longer hangs. Far above what any takes (20 s on a quiet computer), for a busy one must not fail here.
const DEADLINE: Duration = Duration::from_secs(1200);
const USAGE: i32 = 2;

/// Why the bench cannot go on.
#[derive(Debug)]
pub enum BenchError {
    /// A case cannot be made, or its study not be written.
    Generation(String),
}

impl std::fmt::Display for BenchError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Generation(reason) => write!(f, "the case cannot be made: {reason}"),
        }
    }
}

impl std::error::Error for BenchError {}

/// Runs cases.
#[derive(Debug)]
pub struct Bench {
    /// The `belfry` program.
    pub program: PathBuf,
    /// Where studies are written.
    pub folder: PathBuf,
    /// Whether they stay.
    pub keep: bool,
    /// Whether the program has `diagnose`; found out on the way.
    pub diagnoses: bool,
    /// Whether it has `diagnose --without`.
    pub leaves_out: bool,
}

/// How a command ended.
enum Outcome {
    Answer(Value),
    Usage,
    Failed(String),
}

impl Bench {
    /// Makes, runs and judges a case.
    ///
    /// # Errors
    /// Where the case's study cannot be made; what belfry does wrong is part of the record.
    pub fn run(&mut self, case: &Case) -> Result<CaseRecord, BenchError> {
        let folder = self.folder.join(format!("case{:04}", case.index));
        let _ = fs::remove_dir_all(&folder);
        let start = Instant::now();
        study::write(case, &folder).map_err(BenchError::Generation)?;
        let mut record = blank(case).map_err(BenchError::Generation)?;
        record.generation_s = start.elapsed().as_secs_f64();
        self.measure(case, &folder, &mut record).map_err(BenchError::Generation)?;
        if self.diagnoses {
            self.diagnose(&folder, &mut record);
        }
        if !self.keep {
            let _ = fs::remove_dir_all(&folder);
        }
        Ok(record)
    }

    /// Modes and comparison.
    fn measure(&self, case: &Case, folder: &Path, record: &mut CaseRecord) -> Result<(), String> {
        let start = Instant::now();
        let identified = self.answer(&["identify", "--direct"], folder, record).unwrap_or_default();
        record.identify_s = start.elapsed().as_secs_f64();
        let exact: Vec<ExactMode> = case
            .damped_modes()?
            .into_iter()
            .map(|mode| {
                // A late clock turns what it samples back.
                let late = case.body.sensors.iter().map(|sensor| (-mode.pole * sensor.delay_s).exp());
                let shape = mode.shape.iter().zip(late).map(|(part, late)| part * late).collect();
                ExactMode { frequency_hz: mode.frequency_hz(), shape }
            })
            .collect();
        let modes = answer::modes(&identified);
        record.honesty = honesty(&modes, &exact, case.structure.band_hz);
        record.visibility = how_well(&modes).and_then(|measured| visibility(case, measured));
        let compared = self.answer(&["compare"], folder, record).unwrap_or_default();
        [record.error_before, record.mac_before] = answer::comparison(&compared);
        Ok(())
    }

    /// Diagnosis, and what follows from it.
    fn diagnose(&mut self, folder: &Path, record: &mut CaseRecord) {
        let start = Instant::now();
        let said = self.command(&["diagnose"], folder);
        record.diagnose_s = start.elapsed().as_secs_f64();
        match said {
            Outcome::Answer(object) => match answer::diagnosis(&object) {
                Some(diagnosis) => record.diagnosis = Some(diagnosis),
                None => record.failures.push("diagnose: its object has no verdict".to_owned()),
            },
            Outcome::Usage => {
                self.diagnoses = false;
                record.failures.push("diagnose: no such command, or other options".to_owned());
                return;
            }
            Outcome::Failed(reason) => record.failures.push(reason),
        }
        match record.category {
            Category::Single => {
                self.leave_out(folder, record);
                self.add_best(folder, record);
            }
            Category::Pair => self.find_both(folder, record),
            Category::Nothing | Category::Outside => {}
        }
    }

    /// The same without the true kind, and without its twin.
    fn leave_out(&mut self, folder: &Path, record: &mut CaseRecord) {
        let Some(effect) = record.effects.first().filter(|_| self.leaves_out) else { return };
        let twins: &[&str] = match canonical(effect.kind, effect.place == Place::Whole) {
            "stiffness-scale" => &["stiffness-scale", "mass-scale"],
            "axis-rotation" => &["axis-rotation", "sensor-rotation"],
            _ => &[effect.kind],
        };
        let mut words = vec!["diagnose"];
        words.extend(twins.iter().flat_map(|kind| ["--without", kind]));
        match self.command(&words, folder) {
            Outcome::Answer(object) => record.without = answer::diagnosis(&object).map(|said| said.verdict),
            Outcome::Usage => {
                self.leaves_out = false;
                record.failures.push("diagnose --without: no such option; skipped from here on".to_owned());
            }
            Outcome::Failed(reason) => record.failures.push(reason),
        }
    }

    /// Adds what was named best and compares again.
    fn add_best(&self, folder: &Path, record: &mut CaseRecord) {
        let best = record.diagnosis.as_ref().and_then(|diagnosis| diagnosis.best.first()).map(ToString::to_string);
        let Some(best) = best else { return };
        let added = run(Command::new(&self.program).args(["add"]).arg(folder).args([&best, "--json"]), folder);
        match added {
            Outcome::Answer(_) => {
                let compared = self.answer(&["compare"], folder, record);
                record.error_after = compared.map(|compared| answer::comparison(&compared)[0]);
            }
            Outcome::Usage => record.failures.push(format!("add {best}: refused as wrong usage")),
            Outcome::Failed(reason) => record.failures.push(reason),
        }
    }

    /// Lets belfry add and drop effects by itself, on a copy.
    fn find_both(&self, folder: &Path, record: &mut CaseRecord) {
        let copy = folder.with_extension("auto");
        let _ = fs::remove_dir_all(&copy);
        if let Err(error) = copy_folder(folder, &copy) {
            record.failures.push(format!("the study cannot be copied: {error}"));
            return;
        }
        if self.answer(&["diagnose", "--auto"], &copy, record).is_some() {
            let text = fs::read_to_string(copy.join("study.toml")).unwrap_or_default();
            record.found = Some(answer::effects_of_study(&text));
            let compared = self.answer(&["compare"], &copy, record);
            record.error_after = compared.map(|compared| answer::comparison(&compared)[0]);
        }
        if !self.keep {
            let _ = fs::remove_dir_all(&copy);
        }
    }

    /// A command that has to answer; where it does not, that is noted.
    fn answer(&self, words: &[&str], folder: &Path, record: &mut CaseRecord) -> Option<Value> {
        match self.command(words, folder) {
            Outcome::Answer(object) => return Some(object),
            Outcome::Usage => record.failures.push(format!("{}: refused as wrong usage", words.join(" "))),
            Outcome::Failed(reason) => record.failures.push(reason),
        }
        None
    }

    /// `belfry COMMAND STUDY OPTIONS --json`.
    fn command(&self, words: &[&str], folder: &Path) -> Outcome {
        let (name, options) = words.split_first().unwrap_or((&"help", &[]));
        run(Command::new(&self.program).arg(name).arg(folder).args(options).arg("--json"), folder)
    }
}

/// How well modes are measured, by what they state: the median of them; `None` where there are none.
fn how_well(modes: &[IdentifiedMode]) -> Option<Measured> {
    let of_shape = |mode: &IdentifiedMode| {
        let length = mode.shape.iter().map(|[re, im, _]| re * re + im * im).sum::<f64>().sqrt();
        mode.shape.iter().map(move |[.., std]| std / length).collect::<Vec<f64>>()
    };
    let mut frequencies: Vec<f64> = modes.iter().map(|mode| mode.frequency_std_hz / mode.frequency_hz).collect();
    let mut shapes: Vec<f64> = modes.iter().flat_map(of_shape).collect();
    let measured = Measured { frequency: quantile(&mut frequencies, 0.5), shape: quantile(&mut shapes, 0.5) };
    (measured.frequency.is_finite() && measured.shape.is_finite()).then_some(measured)
}

/// A record with what the case itself knows.
fn blank(case: &Case) -> Result<CaseRecord, String> {
    let effect = |effect: &super::effect::Effect| TrueEffect {
        kind: effect.kind(),
        place: effect.place(),
        parameters: effect.parameters(),
    };
    Ok(CaseRecord {
        index: case.index,
        structure: case.structure.name,
        category: case.category,
        truth: case.truth(),
        effects: case.effects.iter().map(effect).collect(),
        outside: case.outside,
        height_m: case.structure.height_m(),
        world: case.world,
        shift: case.shift(),
        visibility: None,
        honesty: Default::default(),
        error_before: f64::NAN,
        error_after: None,
        floor: case.floor_percent().ok_or("the structure buckles")?,
        mac_before: f64::NAN,
        diagnosis: None,
        without: None,
        found: None,
        generation_s: 0.0,
        identify_s: 0.0,
        diagnose_s: 0.0,
        failures: Vec::new(),
    })
}

/// Runs a command to its end or its deadline; its output goes through files, which cannot fill up.
fn run(command: &mut Command, folder: &Path) -> Outcome {
    let [out, err] = ["blind.out", "blind.err"].map(|name| folder.join(name));
    let ended = (|| -> std::io::Result<Option<ExitStatus>> {
        command.stdin(Stdio::null()).stdout(File::create(&out)?).stderr(File::create(&err)?);
        let mut child = command.spawn()?;
        let start = Instant::now();
        while start.elapsed() < DEADLINE {
            if let Some(status) = child.try_wait()? {
                return Ok(Some(status));
            }
            thread::sleep(Duration::from_millis(5));
        }
        child.kill()?;
        child.wait()?;
        Ok(None)
    })();
    let words: Vec<_> = command.get_args().map(|word| word.to_string_lossy()).collect();
    let words = words.join(" ");
    match ended {
        Ok(Some(status)) if status.success() => {
            match fs::read_to_string(&out).map(|text| serde_json::from_str(&text)) {
                Ok(Ok(object)) => Outcome::Answer(object),
                _ => Outcome::Failed(format!("{words}: standard output is not one JSON object")),
            }
        }
        Ok(Some(status)) if status.code() == Some(USAGE) => Outcome::Usage,
        Ok(Some(status)) => {
            let said = fs::read_to_string(&err).unwrap_or_default();
            let error = said.lines().find(|line| line.contains("error")).or_else(|| said.lines().last());
            Outcome::Failed(format!("{words}: {status}: {}", error.unwrap_or_default()))
        }
        Ok(None) => Outcome::Failed(format!("{words}: did not end within {} s", DEADLINE.as_secs())),
        Err(error) => Outcome::Failed(format!("{words}: {error}")),
    }
}

/// Copies a folder and what is in it.
fn copy_folder(from: &Path, to: &Path) -> std::io::Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let target = to.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            copy_folder(&entry.path(), &target)?;
        } else if entry.file_name() != "recording.npy" || fs::hard_link(entry.path(), &target).is_err() {
            fs::copy(entry.path(), &target)?;
        }
    }
    Ok(())
}
