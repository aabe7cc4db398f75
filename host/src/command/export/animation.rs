//! `belfry export --of animation`: every measured mode as a moving picture.

use anyhow::bail;

use super::{Arguments, Content, Format, Report, WrittenFile, modes_of, own_folder, ready_for};
use crate::command::Console;
use crate::export::{ExportError, write_bytes};
use crate::picture;
use crate::story::Project;

/// Writes a picture a mode and tells.
pub(super) fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let project = Project::open(&arguments.study)?;
    let modes = modes_of(project.study())?;
    let folder = match &arguments.output {
        Some(output) => output.clone(),
        None => own_folder(project.study())?,
    };
    ready_for(&folder.join("animation_1.png"))?;
    let frame = project.frame();
    let mut files = Vec::new();
    for mode in &modes.modes {
        let shape: Vec<_> = mode.shape.iter().map(|part| part.map(|part| part.value)).collect();
        let file = folder.join(format!("animation_{}.png", mode.number));
        let drawn = picture::animation(frame.as_ref(), &modes.sensors, &shape)
            .map_err(|source| ExportError::Write { file: file.clone(), source })?;
        let Some(drawn) = drawn else { continue };
        write_bytes(&file, &drawn)?;
        console.say(format!("{}: mode {} at {:.4} Hz", file.display(), mode.number, mode.frequency_hz));
        files.push(WrittenFile { file, of: Content::Animation, format: Format::Png, rows: 1 });
    }
    if files.is_empty() {
        bail!(
            "no mode can be drawn: fewer than two sensors have a place and a direction; give elevation_m and azimuth_deg in study.toml"
        );
    }
    console.json("export-1", &Report { files, left_out: Vec::new() })
}
