//! The demo's study, and the tower that is simulated for it.

use std::fs;
use std::path::Path;

use anyhow::{Context, bail};

use super::hidden;
use crate::command::Console;
use crate::command::interrupt::alone_in;
use crate::files::{FolderLock, write_anew};
use crate::model::effect::Effect;
use crate::model::{BeamTable, Structure};
use crate::results::{HISTORY_FILE, Results};
use crate::simulate::{Options, Simulation, Truth, scattered};
use crate::study::{STUDY_FILE, Study, template};

/// First line of the demo's study.toml, by which a later demo knows that it may write over it.
const MARK: &str = "# Made by `belfry demo`; the next `belfry demo` here writes it anew.\n";
const RECORDING: &str = "recording.npy";
/// Segments scatter by this share of what the model's tolerance allows.
const SCATTER: f64 = 0.5;
/// The flexibility that gives the stand-in tower its measured frequencies.
const BASE_ROTATION: &str = "base-rotation=7.21e-15";

/// The structure that is simulated.
pub(super) struct Tower {
    pub(super) beam: BeamTable,
    pub(super) effects: Vec<Effect>,
}

impl Tower {
    /// The stand-in that has the frequencies measured on the Canton Tower.
    pub(super) fn of_paper() -> anyhow::Result<Self> {
        let beam = BeamTable::from_reader(template::CANTON_BEAM_FIELD.as_bytes(), Path::new("beam_field.csv"))?;
        Ok(Self { beam, effects: vec![BASE_ROTATION.parse()?] })
    }

    /// The model's tower with scattered segments and a hidden effect, which the seed draws where none is given.
    pub(super) fn with_hidden(effect: Option<&Effect>, seed: u64) -> anyhow::Result<Self> {
        let effect = match effect {
            Some(effect) => effect.clone(),
            None => hidden::drawn(seed)?,
        };
        hidden::check(&effect)?;
        let study = Study::from_text(template::CANTON_STUDY, Path::new("canton"))?;
        let model = study.model.as_ref().context("the demo's study has no model")?;
        let beam = BeamTable::from_reader(template::CANTON_BEAM.as_bytes(), Path::new("beam.csv"))?;
        let beam = scattered(beam, model, SCATTER, seed);
        let effect = effect.in_study(&study.sensors())?;
        Structure::with_effects(beam.clone(), std::slice::from_ref(&effect))?;
        Ok(Self { beam, effects: vec![effect] })
    }

    /// Simulates the tower's recording into the study.
    pub(super) fn record(&self, study: &Study, hours: f64, seed: u64, console: &Console) -> anyhow::Result<Truth> {
        let setup = study.setups.first().context("the demo's study has no setup")?;
        let options = Options { seed, ..Options::default() };
        let mut simulation = Simulation::of_beam(self.beam.clone(), &self.effects, setup, &options)?;
        let rows = (hours * 3600.0 * setup.sampling_rate_hz).round() as u64;
        let bar = console.progress(rows, "recording");
        simulation.write(&study.folder.join(RECORDING), rows, |made| bar.inc(made))?;
        bar.finish_and_clear();
        let truth = simulation.truth().clone();
        let path = study.folder.join("truth.json");
        let text = serde_json::to_string_pretty(&truth)? + "\n";
        write_anew(&path, text.as_bytes()).with_context(|| format!("cannot write {}", path.display()))?;
        Ok(truth)
    }
}

/// Writes the demo's study, for this command alone.
pub(super) fn write_study(folder: &Path, console: &Console) -> anyhow::Result<(Study, Option<FolderLock>)> {
    let path = folder.join(STUDY_FILE);
    if fs::read_to_string(&path).is_ok_and(|text| !text.starts_with(MARK)) {
        bail!(
            "{} is a study of your own: name another folder, as in `belfry demo {}-demo`",
            path.display(),
            folder.display()
        );
    }
    fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let lock = alone_in(folder, console)?;
    let results = Results::in_study(folder);
    results.make_ready()?;
    // A folder from someone else may have a link to a file of the user's, and what writes recordings follows links.
    let recording = folder.join(RECORDING);
    if recording.is_symlink() {
        fs::remove_file(&recording).with_context(|| format!("cannot remove the link {}", recording.display()))?;
    }
    let mut study: toml_edit::DocumentMut = template::CANTON_STUDY.parse()?;
    if let Some(setups) = study.get_mut("setup").and_then(|item| item.as_array_of_tables_mut())
        && let Some(setup) = setups.get_mut(0)
    {
        setup["files"] = toml_edit::value(toml_edit::Array::from_iter([RECORDING]));
    }
    let write = |name: &str, text: &str| {
        let path = folder.join(name);
        write_anew(&path, text.as_bytes()).with_context(|| format!("cannot write {}", path.display()))
    };
    // The history is of the tower before.
    match fs::remove_file(results.path(HISTORY_FILE)) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            return Err(error).with_context(|| format!("cannot remove the old history in {}", folder.display()));
        }
        _ => {}
    }
    write("beam.csv", template::CANTON_BEAM)?;
    write(STUDY_FILE, &format!("{MARK}{study}"))?;
    Ok((Study::load(folder)?, lock))
}
