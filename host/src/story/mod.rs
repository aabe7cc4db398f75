//! The story of a study, step by step, for every front end: the commands of `belfry`, a web page, another language.
//!
//! A study's folder flows in as a [`Project`]; each step flows out as a report, the same that the command of that name prints
//! with `--json`, and stands in the study's folder `results` afterwards. Nothing here prints. What takes its time tells a
//! callback of its [`Progress`], and what the reader should know stands in the `warnings` of reports.
//!
//! An hour of a tower that turns on its foundation, and a model that does not know it:
//!
//! ```
//! use belfry_host::model::BeamTable;
//! use belfry_host::simulate::{Options, Simulation, adopt, plan};
//! use belfry_host::story::{CovalidationRequest, IdentifyRequest, Project, Route};
//! use belfry_host::study::{Study, template};
//! use std::fs::write;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let folder = tempfile::tempdir()?;
//! write(folder.path().join("study.toml"), template::CANTON_STUDY)?;
//! write(folder.path().join("beam.csv"), template::CANTON_BEAM)?;
//! let study = Study::load(folder.path())?;
//! let (beam, setup) = (BeamTable::read(&folder.path().join("beam.csv"))?, &study.setups[0]);
//! let mut tower = Simulation::of_beam(beam, &["base-rotation=7.21e-15".parse()?], setup, &Options::default())?;
//! let recordings = plan(&study, None)?;
//! tower.write(&recordings[0].path, 3600 * 50, |_| {})?;
//! adopt(folder.path(), &recordings)?;
//!
//! let mut project = Project::open(folder.path())?;
//! let found = project.identify(&IdentifyRequest::by(Route::Direct), &mut |progress| {
//!     assert!(progress.done <= progress.total);
//! })?;
//! assert_eq!(found.identification.modes.len(), 14);
//! let comparison = project.compare()?.comparison;
//! assert!(comparison.mean_abs_frequency_error_percent > Some(0.5));
//!
//! let diagnosis = project.diagnose(&[], &mut |_| {})?;
//! assert_eq!(diagnosis.best, ["base-rotation"]);
//! let change = project.add("base-rotation", &mut |_| {})?;
//! assert!(change.after.mean_abs_frequency_error_percent < Some(0.2));
//! let request = CovalidationRequest::of_channels(Vec::new(), Route::Direct);
//! let channels = project.covalidate(&request, &mut |_| {})?.channels;
//! assert!(channels.iter().all(|channel| channel.error_percent.with_effects.is_some()));
//! assert_eq!(project.history()?.len(), 2);
//! # Ok(())
//! # }
//! ```

mod blocks;
mod case;
mod cause;
mod change;
mod climate;
mod covalidated;
mod error;
mod identified;
mod inputs;
mod left_out;
mod looked;
mod motion;
mod nodes;
mod parts;
mod planned;
mod profiled;
mod project;
mod shapes;
mod since;
mod trends;
mod updated;
mod watched;

pub use crate::measure::Route;
pub use crate::progress::{OnProgress, Progress};
pub(crate) use case::outdated;
pub use case::{Case, measured_modes};
pub use cause::{Cause, ProbableEffect};
pub(crate) use change::data_mark;
pub use change::{AutoEnd, ChangeReport, EffectReport, add, add_until_nothing_gains, remove};
pub use climate::Climate;
pub(crate) use covalidated::CURVES_FILE;
pub use covalidated::{
    ChannelReport, Covalidation, CovalidationReport, CovalidationRequest, covalidate, worst_channel,
};
pub use error::{CovalidateError, StoryError};
pub use identified::{LinkReport, Method, ModesReport, SegmentReport, TimingReport, identify};
pub(crate) use inputs::AllInputs;
pub(crate) use inputs::EFFECTS;
pub use inputs::Inputs;
pub use left_out::MOST_NOISE_GAIN;
pub use looked::{LookReport, ShapesLook, Suspect, look_at_files};
pub use motion::Stretch;
pub(crate) use nodes::nodes;
pub use planned::{PlanRequest, planned};
pub use project::{Compared, IdentifyRequest, Project, WrittenReport};
pub use shapes::BySource;
pub(crate) use shapes::turned_by_update;
pub use since::{SinceReport, SinceRequest};
pub use updated::{BeforeAfter, OtherMode, PairState, PsiExplained, Update, UpdateReport, UpdatedPair, update};
pub(crate) use watched::{Earlier, Judged, judged, last_seen, node_events};
pub use watched::{
    Event, EventKind, NodeEvent, NodesReport, Turned, WatchEvent, WatchReport, WatchRequest, WatchedMode,
};
