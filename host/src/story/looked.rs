//! A look at what was recorded, before anything is identified: channels, rates, spans, gaps and levels, and which channels are suspect.
//!
//! A study, or recordings alone, flow in. What their rows hold is counted; then the lowest modes are asked which channels they contradict.

use std::path::PathBuf;

use serde::Serialize;

use super::error::StoryError;
use super::identified::{Method, measure_between_gaps};
use crate::archive::TimeRange;
use crate::identify::suspect::{Suspicion, can_be_asked, suspicions};
use crate::identify::{MeasuredSetup, hold_to_standards, identify};
use crate::measure::{ChannelLook, MeasureError, Measurement, Route, SetupLook, glance};
use crate::progress::{OnProgress, rows_of};
use crate::record::survey::{Surveyed, SurveyedChannel, survey};
use crate::spectra::{Alone, Lines};
use crate::study::alarms::Alarms;
use crate::study::{Analysis, Sensor, Setup, Structure, Study, Unit};

/// A channel with a larger part of its samples missing is suspect for it.
const MOSTLY_MISSING_PERCENT: f64 = 50.0;

/// Volts say nothing of motion without a sensitivity: they stay as they are.
const VOLTS: &str = "V";
/// The unit of numbers whose unit the file does not say.
const AS_RECORDED: &str = "as recorded";

/// What `belfry look --json` prints and `results/look.json` holds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LookReport {
    /// The structure's name; none of files without a study.
    pub structure: Option<String>,
    /// What each setup holds.
    pub setups: Vec<SetupLook>,
    /// What may be wrong with channels.
    pub suspects: Vec<Suspect>,
    /// Whether the lowest modes were asked.
    pub shapes: ShapesLook,
    /// The same and more in sentences.
    pub warnings: Vec<String>,
}

impl LookReport {
    /// What is suspect of a setup's channel, in a few words each.
    pub fn suspect_of(&self, setup: &str, channel: &str) -> Vec<String> {
        let is_of = |suspect: &&Suspect| suspect.setup == setup && suspect.channels.iter().any(|one| one == channel);
        let words = |suspect: &Suspect| {
            let other = suspect.channels.iter().find(|other| *other != channel);
            let is_first = suspect.channels.first().is_some_and(|first| first == channel);
            match (suspect.kind, other) {
                // Of a channel and its copy the channel is not suspect.
                ("copy", Some(other)) => is_first.then(|| format!("copy of {other}")),
                ("exchanged", Some(other)) => Some(format!("exchanged with {other}")),
                ("unit", _) => Some("another unit".to_owned()),
                ("alone", _) => Some("unlike the others".to_owned()),
                (kind, _) => Some(kind.replace('_', " ")),
            }
        };
        self.suspects.iter().filter(is_of).filter_map(words).collect()
    }
}

/// What may be wrong with channels.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Suspect {
    /// `dead`, `mostly_missing`, `clipped`, `holds`, `spikes`, `copy`, `noisy`, `alone`; by the shapes `reversed`, `unit`, `exchanged`.
    pub kind: &'static str,
    /// The setup.
    pub setup: String,
    /// Its channels: one, or two that are alike or exchanged.
    pub channels: Vec<String>,
}

/// Whether the lowest modes were asked which channels they contradict.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ShapesLook {
    /// Modes that were found.
    pub modes: usize,
    /// Why there are none.
    pub obstacle: Option<String>,
}

/// Looks at a study.
///
/// # Errors
/// When none of its setups can be read; one among others is left out with a warning.
pub(super) fn look(study: &Study, on_progress: OnProgress<'_>) -> Result<LookReport, StoryError> {
    let (mut setups, mut left_out, mut failure) = (Vec::new(), Vec::new(), None);
    for setup in &study.setups {
        match glance(study, setup, &mut rows_of("rows", on_progress)) {
            Ok(seen) => setups.push(seen),
            Err(error) => {
                left_out.push(format!("left out: {error}"));
                failure.get_or_insert(error);
            }
        }
    }
    if setups.is_empty() {
        return Err(failure.unwrap_or(MeasureError::NoSetups).into());
    }
    let mut suspects: Vec<Suspect> = setups.iter().flat_map(suspects_of).collect();
    let mut warnings = left_out;
    let shapes = match measure_between_gaps(
        study,
        Route::Direct,
        Method::Spectra,
        Lines::Enough,
        &mut rows_of("spectra", on_progress),
    ) {
        Ok(measurement) => {
            // They name setups that were left out, too.
            warnings.clone_from(&measurement.warnings);
            suspects.extend(alone(&measurement));
            by_shapes(study, &measurement, &mut suspects, &mut warnings)
        }
        Err(error) => {
            let of = |seen: &SetupLook| {
                let name = seen.setup.clone();
                seen.warnings.clone().into_iter().map(move |warning| format!("setup \"{name}\": {warning}"))
            };
            warnings.extend(setups.iter().flat_map(of));
            ShapesLook { modes: 0, obstacle: Some(error.to_string()) }
        }
    };
    Ok(LookReport { structure: Some(study.structure.name.clone()), setups, suspects, shapes, warnings })
}

/// What rows alone make suspect.
fn suspects_of(seen: &SetupLook) -> Vec<Suspect> {
    let suspect = |kind, channels| Suspect { kind, setup: seen.setup.clone(), channels };
    let mut suspects: Vec<Suspect> =
        seen.copies.iter().map(|[copy, of]| suspect("copy", vec![copy.clone(), of.clone()])).collect();
    for channel in &seen.channels {
        suspects.extend(kinds_of(channel).map(|kind| suspect(kind, vec![channel.channel.clone()])));
    }
    suspects
}

fn kinds_of(channel: &ChannelLook) -> impl Iterator<Item = &'static str> {
    let kinds = [
        ("dead", channel.dead),
        ("mostly_missing", channel.missing_percent > MOSTLY_MISSING_PERCENT),
        ("clipped", channel.clipped.is_some()),
        ("holds", channel.held.is_some()),
        ("spikes", channel.spikes > 0),
    ];
    kinds.into_iter().filter(|(_, is_so)| *is_so).map(|(kind, _)| kind)
}

/// Channels that have nothing in common with the others.
fn alone(measurement: &Measurement<'_>) -> Vec<Suspect> {
    let of = |(measured, Alone { loud, quiet }): (&MeasuredSetup<'_>, &Alone)| {
        let setup = measured.setup;
        let suspect = |kind: &'static str, channel: &usize| {
            let channels = setup.sensors.get(*channel).map(|sensor| sensor.channel.clone()).into_iter().collect();
            Suspect { kind, setup: setup.name.clone(), channels }
        };
        let loud = loud.iter().map(|channel| suspect("noisy", channel));
        loud.chain(quiet.iter().map(|channel| suspect("alone", channel))).collect::<Vec<_>>()
    };
    measurement.setups.iter().zip(&measurement.alone).flat_map(of).collect()
}

/// Which channels the lowest modes contradict.
fn by_shapes(
    study: &Study,
    measurement: &Measurement<'_>,
    suspects: &mut Vec<Suspect>,
    warnings: &mut Vec<String>,
) -> ShapesLook {
    let mut identification = match identify(&measurement.setups, &study.analysis.modes) {
        Ok(identification) => identification,
        Err(error) => return ShapesLook { modes: 0, obstacle: Some(error.to_string()) },
    };
    hold_to_standards(&mut identification);
    let modes = identification.modes.len();
    let found = suspicions(&identification.modes, &measurement.setups);
    warnings.extend(found.iter().map(|suspicion| suspicion.words.clone()));
    suspects.extend(found.into_iter().map(|Suspicion { kind, setup, channels, .. }| Suspect { kind, setup, channels }));
    let obstacle = match modes {
        0 => Some("no mode stands out from the noise".to_owned()),
        _ if !can_be_asked(&study.setups) => Some(
            "that takes elevation_m and azimuth_deg of sensors in one direction at four heights at least".to_owned(),
        ),
        _ => None,
    };
    ShapesLook { modes, obstacle }
}

/// Looks at recordings without a study: each run of files with the same channels is a setup.
///
/// # Errors
/// When a file cannot be read, or does not say its sampling rate and none is given; one that is given counts before the files'.
pub fn look_at_files(
    files: Vec<PathBuf>,
    rate_hz: Option<f64>,
    on_progress: OnProgress<'_>,
) -> Result<LookReport, StoryError> {
    let found = survey(files).map_err(|source| StoryError::Survey(Box::new(source)))?;
    let setups = found.iter().zip(1..).map(|(one, number)| setup_of(one, number, rate_hz)).collect::<Result<_, _>>()?;
    let study = Study {
        folder: PathBuf::new(),
        structure: Structure { name: "recordings".to_owned(), place_deg: None },
        setups,
        measured: None,
        analysis: Analysis::default(),
        model: None,
        alarms: Alarms::default(),
        range: TimeRange::default(),
    };
    let mut report = look(&study, on_progress)?;
    report.warnings.splice(0..0, found.iter().flat_map(Surveyed::warnings));
    for (one, setup) in found.iter().zip(&study.setups) {
        let Some(seen) = report.setups.iter_mut().find(|seen| seen.setup == setup.name) else { continue };
        for (channel, surveyed) in seen.channels.iter_mut().zip(one.channels.iter().filter(|c| one.is_at_rate(c))) {
            if surveyed.unit.is_none_or(|unit| unit == VOLTS) {
                channel.unit = surveyed.unit_as_written.clone().unwrap_or_else(|| AS_RECORDED.to_owned());
            }
        }
    }
    Ok(LookReport { structure: None, ..report })
}

/// A setup of files, with what they say of themselves. Numbers whose unit nobody knows are taken as they are.
fn setup_of(one: &Surveyed, number: usize, given_hz: Option<f64>) -> Result<Setup, StoryError> {
    let file = || one.files.first().cloned().unwrap_or_default();
    let rate_hz = given_hz.or(one.rate_hz).ok_or_else(|| StoryError::NoRate { file: file() })?;
    let sensor = |channel: &SurveyedChannel| {
        let unit = channel.unit.filter(|unit| *unit != VOLTS).and_then(Unit::of_word);
        Sensor { unit, ..Sensor::new(channel.name.clone(), 1) }
    };
    let names = one.files.iter().map(|file| file.to_string_lossy().into_owned()).collect();
    let name = if one.files.len() == 1 { file().display().to_string() } else { format!("files {number}") };
    let sensors = one.channels.iter().filter(|channel| one.is_at_rate(channel)).map(sensor).collect();
    Ok(Setup { files: names, ..Setup::new(name, rate_hz, sensors) })
}
