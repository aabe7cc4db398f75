//! `belfry export --of animation`: measured modes as moving pictures, a file a mode or one file.

use std::path::Path;

use anyhow::bail;

use super::{Arguments, Content, Format, Report, WrittenFile, modes_of, own_folder, ready_for};
use crate::command::Console;
use crate::export::modes::{Mode, Modes};
use crate::export::{ExportError, write_bytes};
use crate::numbers::counted;
use crate::picture::{self, MovingFormat, MovingMode, MovingStructure};
use crate::story::Project;

/// Whether `--output` names a folder: what has no ending, and what is one.
pub(super) fn is_folder(path: &Path) -> bool {
    path.extension().is_none() || path.is_dir() || path.to_string_lossy().ends_with(std::path::is_separator)
}

/// The sentence that says what is wrong with `--output`.
pub(super) fn usage(arguments: &Arguments) -> Result<(), String> {
    let Some(path) = arguments.output.as_deref().filter(|path| !is_folder(path)) else { return Ok(()) };
    let (of_ending, asked) = (Format::of_ending(path), arguments.format);
    let is_moving = matches!(of_ending, Some(Format::Png | Format::Gif));
    let is_other = asked.is_some_and(|asked| of_ending.is_some_and(|of_ending| of_ending != asked));
    match (is_moving, asked) {
        (false, _) => Err(format!(
            "--output {}: animations are written as .png or .gif; give such a file, or a folder without an ending\n",
            path.display()
        )),
        (true, Some(asked)) if is_other => Err(format!(
            "--output {}: the ending is not that of --format {}; leave out one of them\n",
            path.display(),
            asked.name()
        )),
        _ => Ok(()),
    }
}

/// Writes a picture a mode, or one of them all, and tells.
pub(super) fn run(arguments: &Arguments, format: Format, console: &Console) -> anyhow::Result<()> {
    let project = Project::open(&arguments.study)?;
    let modes = modes_of(project.study())?;
    let asked: Vec<&Mode> =
        modes.modes.iter().filter(|mode| arguments.mode.is_none_or(|number| mode.number == number)).collect();
    if let (Some(number), []) = (arguments.mode, &asked[..]) {
        let numbers: Vec<String> = modes.modes.iter().map(|mode| mode.number.to_string()).collect();
        bail!("there is no mode {number}; the study has {}", numbers.join(", "));
    }
    let one_file = arguments.output.as_deref().filter(|path| !is_folder(path));
    let frame = project.frame();
    let structure =
        MovingStructure { name: &project.study().structure.name, frame: frame.as_ref(), sensors: &modes.sensors };
    let mut files = Vec::new();
    let mut write = |file: &Path, part: &[&Mode]| -> anyhow::Result<()> {
        let Some(rows) = draw(&structure, part, format, file)? else { return Ok(()) };
        match part {
            [mode] => console.say(format!("{}: mode {} at {:.4} Hz", file.display(), mode.number, mode.frequency_hz)),
            _ => console.say(format!("{}: {}, one after the other", file.display(), counted(rows, "mode"))),
        }
        files.push(WrittenFile { file: file.to_owned(), of: Content::Animation, format, rows });
        Ok(())
    };
    if let Some(file) = one_file {
        ready_for(file)?;
        write(file, &asked)?;
    } else {
        let folder = match &arguments.output {
            Some(output) => output.clone(),
            None => own_folder(project.study())?,
        };
        let path = |mode: &Mode| folder.join(format!("animation_{}.{}", mode.number, format.ending()));
        if let Some(first) = asked.first() {
            ready_for(&path(first))?;
        }
        for mode in &asked {
            write(&path(mode), std::slice::from_ref(mode))?;
        }
    }
    if files.is_empty() {
        bail!("{}", nothing_drawn(&modes));
    }
    console.json("export-1", &Report { files, left_out: Vec::new() })
}

/// Writes one file; how many modes it has, `None` where none can be drawn.
fn draw(
    structure: &MovingStructure<'_>,
    modes: &[&Mode],
    format: Format,
    file: &Path,
) -> Result<Option<u64>, ExportError> {
    let shapes: Vec<Vec<_>> =
        modes.iter().map(|mode| mode.shape.iter().map(|part| part.map(|part| part.value)).collect()).collect();
    let moving: Vec<MovingMode<'_>> = modes
        .iter()
        .zip(&shapes)
        .map(|(mode, shape)| MovingMode {
            number: mode.number,
            frequency_hz: mode.frequency_hz,
            damping_ratio: mode.damping_ratio,
            shape,
        })
        .collect();
    let moving_format = if format == Format::Gif { MovingFormat::Gif } else { MovingFormat::Png };
    let drawn = picture::animation(structure, &moving, moving_format)
        .map_err(|source| ExportError::Write { file: file.to_owned(), source })?;
    let Some((bytes, count)) = drawn else { return Ok(None) };
    write_bytes(file, &bytes)?;
    Ok(Some(count as u64))
}

/// Why no mode can be drawn.
fn nothing_drawn(modes: &Modes) -> String {
    let placed =
        modes.sensors.iter().filter(|sensor| sensor.elevation_m.is_some() && sensor.direction.is_some()).count();
    if placed < 2 {
        return "no mode can be drawn: fewer than two sensors have a place and a direction; give elevation_m and azimuth_deg in study.toml".to_owned();
    }
    "no mode can be drawn: its sensors stand at one place, or none of them moves in it; export another mode".to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ending_says_whether_a_file_is_meant() {
        let folder = tempfile::tempdir().unwrap();
        for (name, is) in [("moving", true), ("x.gif", false), ("a/b.png", false), ("v1.2/", true)] {
            assert_eq!(is_folder(Path::new(name)), is, "{name}");
        }
        let named = folder.path().join("exports.2026");
        std::fs::create_dir(&named).unwrap();
        assert!(is_folder(&named));
    }
}
