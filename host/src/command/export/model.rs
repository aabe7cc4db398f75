//! `belfry export --of model`: the model with its effects as matrices, and its modes.

use std::path::{Path, PathBuf};

use super::{Arguments, Content, Format, Report, WrittenFile, own_folder, ready_for};
use crate::command::Console;
use crate::export::model::{MatrixFormat, ModelExport, left_out};
use crate::story::{Project, StoryError};
use crate::study::Study;

/// Writes the model and tells.
pub(super) fn run(arguments: &Arguments, format: Format, console: &Console) -> anyhow::Result<()> {
    let mut project = Project::open(&arguments.study)?;
    let folder = match &arguments.output {
        Some(output) => output.clone(),
        None => own_folder(project.study())?,
    };
    ready_for(&folder.join("dofs.csv"))?;
    let (model, structure) = if arguments.fitted_background {
        let case = project.case()?;
        console.warn_all(&case.warnings);
        (case.model.clone(), case.fitted()?)
    } else {
        let model = crate::model::load(project.study()).map_err(StoryError::from)?;
        let structure = model.structure()?;
        (model, structure)
    };
    let (bare, sensors) = (model.bare(), project.study().sensors());
    let left_out = left_out(&bare, &model.effects)?;
    let title = &project.study().structure.name;
    let frame = project.frame();
    let export = ModelExport { title, bare: &bare, structure: &structure, sensors: &sensors, frame: frame.as_ref() };
    let matrices = if format == Format::Npy { MatrixFormat::Numpy } else { MatrixFormat::MatrixMarket };
    let (written, warnings) = export.write(&folder, matrices)?;
    console.warn_all(&warnings);
    if !left_out.is_empty() {
        console.warn(format!("{}: no part of stiffness and mass, left out", left_out.join(", ")));
    }
    let files: Vec<WrittenFile> = written
        .into_iter()
        .map(|one| {
            let format = Format::of_ending(&one.file).unwrap_or(format);
            WrittenFile { file: one.file, of: Content::Model, format, rows: one.rows as u64 }
        })
        .collect();
    for WrittenFile { file, rows, .. } in &files {
        let is_modes = file.extension().is_some_and(|ending| ending == "uff")
            || file.file_stem().is_some_and(|stem| stem == "model_modes");
        console.say(format!("{}: {rows} {}", file.display(), if is_modes { "modes" } else { "rows" }));
    }
    console.say(format!("In a study.toml:\n{}", as_model(&files, project.study())));
    console.json("export-1", &Report { files, left_out })
}

/// The files as `[model]` of a study in the same folder names them.
fn as_model(files: &[WrittenFile], study: &Study) -> String {
    let named = |stem: &str| -> Option<String> {
        let file =
            files.iter().map(|one| &one.file).find(|file| file.file_stem().is_some_and(|known| known == stem))?;
        let path: PathBuf = file.strip_prefix(&study.folder).map_or_else(|_| file.clone(), Path::to_path_buf);
        Some(toml_edit::Value::from(path.display().to_string()).to_string().trim().to_owned())
    };
    let key = |stem: &str| named(stem).map(|path| format!("{stem} = {path}"));
    let keys: Vec<String> = ["stiffness", "mass", "dofs"].into_iter().filter_map(key).collect();
    format!("[model]\nmatrices = {{ {} }}", keys.join(", "))
}
