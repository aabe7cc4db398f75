//! Why a step of the story could not be taken.

use std::path::PathBuf;

use thiserror::Error;

use crate::archive::ArchiveError;
use crate::compare::ViewError;
use crate::covalidate::PredictError;
use crate::diagnose::DiagnoseError;
use crate::identify::IdentifyError;
use crate::measure::{MeasureError, may_be_why};
use crate::model::effect::EffectError;
use crate::model::{EigenError, ModelError};
use crate::modes::MeasuredError;
use crate::picture::PictureError;
use crate::plan::PlanError;
use crate::record::RecordError;
use crate::results::ResultsError;
use crate::study::StudyError;
use crate::trend::TrendError;
use crate::update::UpdateError;

/// Why a step of the story could not be taken. Most variants pass on what the part that failed says.
#[derive(Debug, Error)]
pub enum StoryError {
    /// `study.toml`.
    #[error(transparent)]
    Study(Box<StudyError>),
    /// The study's model.
    #[error(transparent)]
    Model(Box<ModelError>),
    /// The file of measured modes.
    #[error(transparent)]
    Measured(Box<MeasuredError>),
    /// The model as the sensors see it.
    #[error(transparent)]
    View(Box<ViewError>),
    /// An effect that the structure cannot have, or that does not exist.
    #[error(transparent)]
    Effect(Box<EffectError>),
    /// The recordings.
    #[error(transparent)]
    Measure(Box<MeasureError>),
    /// Files that were to be looked into.
    #[error(transparent)]
    Survey(Box<RecordError>),
    /// One of them, without a sampling rate.
    #[error("{} does not say its sampling rate; give it with --rate", file.display())]
    NoRate {
        /// The file.
        file: PathBuf,
    },
    /// Identification.
    #[error(transparent)]
    Identify(Box<IdentifyError>),
    /// Identification, of recordings in which there are faults.
    #[error("{source}{}", may_be_why(warnings))]
    Faulty {
        /// What failed.
        source: Box<IdentifyError>,
        /// What was found in the recordings.
        warnings: Vec<String>,
    },
    /// The update.
    #[error(transparent)]
    Update(Box<UpdateError>),
    /// Channels that cannot be predicted.
    #[error(transparent)]
    Covalidate(Box<CovalidateError>),
    /// What nodes have sent.
    #[error(transparent)]
    Archive(Box<ArchiveError>),
    /// Sensors that cannot tell the modes apart.
    #[error(transparent)]
    Predict(Box<PredictError>),
    /// The diagnosis, or the fit of effects.
    #[error(transparent)]
    Diagnose(Box<DiagnoseError>),
    /// The plan of a measurement.
    #[error(transparent)]
    Plan(Box<PlanError>),
    /// A picture.
    #[error(transparent)]
    Picture(Box<PictureError>),
    /// The folder of results.
    #[error(transparent)]
    Results(Box<ResultsError>),
    /// There is nothing to measure intervals of.
    #[error(
        "the study has [measured] modes and no recording: a watch follows modes from interval to interval, so it needs a [[setup]]"
    )]
    NoSetupToWatch,
    /// There are no modes that a watch could follow.
    #[error("{} has no modes to watch; run `belfry identify` first, over a week or more", file.display())]
    NothingToWatch {
        /// Where they would be.
        file: PathBuf,
    },
    /// A watch goes on with another length of intervals.
    #[error(
        "the watch has intervals of {before_s} s until now, not of {every_s} s; go on with `--every {before_s}s`, or remove {} to begin anew", file.display()
    )]
    OtherIntervals {
        /// The length until now.
        before_s: f64,
        /// What was asked for.
        every_s: f64,
        /// The intervals that were seen.
        file: PathBuf,
    },
    /// Identification found no modes.
    #[error(
        "no modes were found from {:.4} to {:.4} Hz: {reason} The spectra are drawn in {}{}",
        band_hz[0], band_hz[1], picture.display(), may_be_why(warnings)
    )]
    NoModes {
        /// The band that was searched.
        band_hz: [f64; 2],
        /// Why, and what to do: whole sentences.
        reason: String,
        /// The picture of the singular values.
        picture: PathBuf,
        /// What was found in the recordings.
        warnings: Vec<String>,
    },
    /// The modes cannot be followed over the hours.
    #[error("the modes are identified, but cannot be followed")]
    Follow(#[source] TrendError),
    /// Nothing was identified yet.
    #[error("{}: the study has no modes yet; run `belfry identify {}` first", file.display(), study.display())]
    NotIdentified {
        /// Where modes should be.
        file: PathBuf,
        /// The study's folder.
        study: PathBuf,
    },
    /// A sensor of another study is not where this study has it.
    #[error(
        "channel {channel} of {} is not that of {}: {reason}; both measurements need the same sensors, or leave the channel out of one study",
        other.display(), study.display()
    )]
    OtherSensors {
        /// The channel.
        channel: String,
        /// The other study's folder.
        other: PathBuf,
        /// This study's folder.
        study: PathBuf,
        /// What differs.
        reason: String,
    },
    /// Two measurements of which no mode is the same.
    #[error(
        "no mode of {} resembles one of {}: are both of the same structure, with the same channels and units?",
        before.display(), now.display()
    )]
    NoCommonModes {
        /// The modes before.
        before: PathBuf,
        /// Those of now.
        now: PathBuf,
    },
    /// There is no measured mode of that number.
    #[error("there is no measured mode {number}; {} has {known}", file.display())]
    UnknownMode {
        /// The number.
        number: usize,
        /// The file of modes.
        file: PathBuf,
        /// Those that there are.
        known: String,
    },
    /// The weights of shapes are not as many as can be used.
    #[error("{given} weights of shapes; give 1, 2 or one for each of the {pairs} modes that have a partner")]
    ShapeWeights {
        /// How many there are.
        given: usize,
        /// Modes that have a partner.
        pairs: usize,
    },
    /// The updated stiffness matrix is of no use.
    #[error("the updated model cannot be solved for its modes; use other modes (--modes)")]
    UpdatedModel(#[source] EigenError),
    /// The model has the effect.
    #[error("{effect} is in the model already; `belfry remove {} {effect}` takes it out", study.display())]
    EffectIsThere {
        /// The effect.
        effect: String,
        /// The study's folder.
        study: PathBuf,
    },
    /// An effect that shows over the hours, which nobody looked at.
    #[error(
        "{effect} shows only in how the modes change over time, and the study has no trends; run `belfry identify {} --every 1h` first, or give its value",
        study.display()
    )]
    NeedsTrends {
        /// The effect.
        effect: &'static str,
        /// The study's folder.
        study: PathBuf,
    },
    /// An effect whose values cannot be fitted.
    #[error("{effect} needs its values: see `belfry effects {effect}`")]
    NeedsValues {
        /// The effect.
        effect: &'static str,
    },
    /// The model has no effects.
    #[error("the model has no effects to remove, nor any {effect}")]
    NothingToRemove {
        /// What was to be removed.
        effect: String,
    },
    /// The model has other effects.
    #[error("the model has no effect {effect}; it has {known}")]
    NoSuchEffect {
        /// What was to be removed.
        effect: String,
        /// What there is.
        known: String,
    },
    /// The model has several such effects.
    #[error("the model has several: name one of {known}")]
    SeveralEffects {
        /// What there is.
        known: String,
    },
    /// A model without segments has no profile.
    #[error(
        "{}: [model] is given as matrices without a [[model.group]]; only groups and the segments of a beam table have a profile of stiffness and mass",
        file.display()
    )]
    NoSegments {
        /// The study's file.
        file: PathBuf,
    },
    /// The study takes its table to be exact.
    #[error(
        "{}: [model] states no background_stiffness and background_mass, so its table is taken to be exact and nothing is fitted to it; 0.03 and 0.01 are usual",
        file.display()
    )]
    NoTolerance {
        /// The study's file.
        file: PathBuf,
    },
    /// Nothing was done to the model yet.
    #[error(
        "{0}: the model has no history yet; `belfry diagnose {0}` names what it lacks, `belfry add {0} EFFECT` makes the first step",
        study.display()
    )]
    NoHistory {
        /// The study's folder.
        study: PathBuf,
    },
}

/// What a part says is large, and every step returns it: it is passed on in a box.
macro_rules! passes_on {
    ($($variant:ident($error:ty)),* $(,)?) => {$(
        impl From<$error> for StoryError {
            fn from(error: $error) -> Self {
                Self::$variant(Box::new(error))
            }
        }
    )*};
}

passes_on! {
    Archive(ArchiveError),
    Study(StudyError),
    Model(ModelError),
    Measured(MeasuredError),
    View(ViewError),
    Effect(EffectError),
    Measure(MeasureError),
    Identify(IdentifyError),
    Update(UpdateError),
    Covalidate(CovalidateError),
    Predict(PredictError),
    Diagnose(DiagnoseError),
    Plan(PlanError),
    Picture(PictureError),
    Results(ResultsError),
}

/// Why channels cannot be predicted.
#[derive(Debug, Error)]
pub enum CovalidateError {
    /// There is no motion to predict.
    #[error("the study has [measured] modes and no recording: co-validation predicts motion, so it needs a [[setup]]")]
    NoRecording,
    /// There is no setup of that name.
    #[error("there is no setup \"{name}\"; the study has {known}")]
    UnknownSetup {
        /// The name.
        name: String,
        /// Those that there are.
        known: String,
    },
    /// There is no channel of that name.
    #[error("there is no channel {name}; the study has {known}")]
    UnknownChannel {
        /// The name.
        name: String,
        /// Those that there are.
        known: String,
    },
    /// The channels stand in different setups.
    #[error("no single setup has all of {channels}")]
    SeveralSetups {
        /// The channels.
        channels: String,
    },
    /// A channel of the setup has no place among the study's sensors.
    #[error("channel {channel}: it has no place among the study's sensors")]
    NoPlace {
        /// The channel.
        channel: String,
    },
    /// Nothing is left to predict from.
    #[error("every channel of setup \"{setup}\" is to be left out; leave some to predict from")]
    NothingKept {
        /// The setup.
        setup: String,
    },
    /// No channel can be predicted from the others.
    #[error(
        "setup \"{setup}\": {channels} channels are too few to predict one from the others through {modes} modes; use fewer modes (--modes)"
    )]
    TooFewChannels {
        /// The setup.
        setup: String,
        /// Its channels.
        channels: usize,
        /// The modes.
        modes: usize,
    },
    /// No mode has a partner.
    #[error("no measured mode has a partner in the model; look at `belfry compare`")]
    NoPairs,
    /// The time asked for is too short.
    #[error(
        "less than half a segment of recording from {start_s} s on; choose an earlier --start-s, or a longer --duration-s"
    )]
    TooShort {
        /// Where it starts.
        start_s: f64,
    },
    /// There is nothing to hold a prediction against.
    #[error(
        "channel {channels} has no sound data, or does not move, in setup \"{setup}\" from {start_s} s on; choose other channels"
    )]
    Silent {
        /// The channels.
        channels: String,
        /// The setup.
        setup: String,
        /// Where the time asked for starts.
        start_s: f64,
    },
    /// The channels are never sound together.
    #[error("from {start_s} s on, at no time are all channels of setup \"{setup}\" sound: nothing to compare")]
    NeverSound {
        /// Where the time asked for starts.
        start_s: f64,
        /// The setup.
        setup: String,
    },
}
