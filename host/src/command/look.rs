//! `belfry look`: what was recorded, channel by channel, and which channels are suspect.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;

use super::Console;
use super::interrupt::{alone, leave_nothing_unfinished};
use super::text::{Columns, in_shell, next_lines, or_dash, short};
use crate::files::write_anew;
use crate::measure::SetupLook;
use crate::numbers::counted;
use crate::picture;
use crate::record::{named_files, time_of_day};
use crate::story::{LookReport, Project, look_at_files};
use crate::study::STUDY_FILE;

const EXAMPLES: &str = "Examples:
  belfry look canton              what a study's recordings, or its nodes' windows, hold
  belfry look mast/*.tdms         recordings alone, before there is a study
  belfry look a.npy --rate 50 --picture a.svg
  belfry look canton --json

Counts rows, gaps and levels of every channel, and looks for channels that are dead, cut off, held at one value, copies of others, or have nothing in common with them. The lowest modes then tell which channels seem to be reversed, exchanged or in another unit: that takes directions of sensors at four heights. `belfry identify` works around most of this, and names it too.

Of a study writes look.json and look.svg (every channel over time) into `results`.";

/// Look at what was recorded: rates, gaps, levels, and which channels are suspect
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder, or recordings
    #[arg(value_name = "STUDY|FILE", required = true, num_args = 1..)]
    pub paths: Vec<PathBuf>,
    /// Rows per second of recordings that do not say it
    #[arg(long, value_name = "HZ", value_parser = rate)]
    pub rate: Option<f64>,
    /// Draw recordings into this file (SVG); a study's picture is results/look.svg
    #[arg(long, value_name = "FILE")]
    pub picture: Option<PathBuf>,
}

fn rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(rate_hz) if rate_hz.is_normal() && rate_hz > 0.0 => Ok(rate_hz),
        _ => Err("expected rows per second, such as 50".to_owned()),
    }
}

/// Runs the command.
///
/// # Errors
/// When the study or none of its recordings can be read, or files do not say their rate.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    leave_nothing_unfinished()?;
    if let [study] = arguments.paths.as_slice()
        && is_study(study)
    {
        if arguments.rate.is_some() {
            bail!("--rate goes with recordings; of a study study.toml says it (sampling_rate_hz)");
        }
        return at_study(study, arguments.picture.as_deref(), console);
    }
    if let Some(folder) = arguments.paths.iter().find(|path| path.is_dir()) {
        bail!("{} is a folder, beside other paths; name one study, or recordings alone", folder.display());
    }
    let files = named_files(&arguments.paths)?;
    let report = console.with_progress(|on_progress| look_at_files(files, arguments.rate, on_progress))?;
    if let Some(file) = &arguments.picture {
        draw("Recordings", &report, file)?;
    }
    tell(&report, console);
    console.json("look-1", &report)?;
    if let Some(file) = &arguments.picture {
        console.say(format!("The picture is {}.", file.display()));
    }
    Ok(())
}

/// Whether a path is one of a study: a folder, or its study.toml.
fn is_study(path: &Path) -> bool {
    path.is_dir() || path.file_name().is_some_and(|name| name == STUDY_FILE)
}

fn at_study(study: &Path, picture: Option<&Path>, console: &Console) -> anyhow::Result<()> {
    let _lock = alone(study, console)?;
    let project = Project::open(study)?;
    let (report, drawn) = console.with_progress(|on_progress| project.look(on_progress))?;
    if let Some(file) = picture {
        draw(&project.study().structure.name, &report, file)?;
    }
    tell(&report, console);
    console.json("look-1", &report)?;
    console.say(format!("The picture is {}.", picture.unwrap_or(&drawn).display()));
    let study = in_shell(&project.study().folder);
    console.say(next_lines(&[(format!("identify {study}"), "the modes of these recordings")]));
    Ok(())
}

fn draw(title: &str, report: &LookReport, file: &Path) -> anyhow::Result<()> {
    let picture = picture::look(title, report)?;
    write_anew(file, picture.as_bytes()).with_context(|| format!("cannot write {}", file.display()))
}

fn tell(report: &LookReport, console: &Console) {
    console.warn_all(&report.warnings);
    for seen in &report.setups {
        console.say(format!("\n{}", heading(seen)));
        console.say(table(seen, report));
    }
    console.say(shapes(report));
    if report.suspects.is_empty() {
        console.say("No channel is suspect.");
    }
}

/// What a setup is, in a line.
fn heading(seen: &SetupLook) -> String {
    let what = if seen.live { "window" } else { "row" };
    let when = match (&seen.start_utc, &seen.end_utc) {
        (Some(start), Some(end)) => format!(", from {start} to {end}"),
        _ => String::new(),
    };
    let (channels, rows) = (counted(seen.channels.len() as u64, "channel"), counted(seen.rows, what));
    let long = time_of_day(seen.duration_s);
    format!("{}: {channels} at {} Hz, {rows}, {long} long{when}", seen.setup, seen.sampling_rate_hz)
}

fn table(seen: &SetupLook, report: &LookReport) -> Columns {
    let header = ["channel", "unit", "mean", "RMS", "smallest", "largest", "missing %", "gaps", "suspect"];
    let mut table = Columns::new(header).expendable(&[7, 4, 5, 2, 1]);
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), short);
    for channel in &seen.channels {
        let suspect = report.suspect_of(&seen.setup, &channel.channel);
        let gaps = if seen.live { "-".to_owned() } else { channel.gaps.to_string() };
        table.row([
            channel.channel.clone(),
            channel.unit.clone(),
            number(channel.mean),
            number(channel.rms),
            number(channel.smallest),
            number(channel.largest),
            or_dash(Some(channel.missing_percent), 2),
            gaps,
            if suspect.is_empty() { "-".to_owned() } else { suspect.join("\n") },
        ]);
    }
    table
}

/// What the lowest modes say, in a sentence.
fn shapes(report: &LookReport) -> String {
    match &report.shapes.obstacle {
        Some(obstacle) => format!("Shapes were not asked for reversed or exchanged channels: {obstacle}."),
        None => {
            let (modes, were) = (report.shapes.modes as u64, if report.shapes.modes == 1 { "was" } else { "were" });
            format!("{} {were} asked for reversed and exchanged channels.", counted(modes, "mode"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::story::ShapesLook;

    #[test]
    fn what_was_asked_of_how_many_modes_is_told() {
        let told = |modes: usize, obstacle: Option<&str>| {
            let shapes_look = ShapesLook { modes, obstacle: obstacle.map(str::to_owned) };
            shapes(&LookReport {
                structure: None,
                setups: Vec::new(),
                suspects: Vec::new(),
                shapes: shapes_look,
                warnings: Vec::new(),
            })
        };
        assert_eq!(told(1, None), "1 mode was asked for reversed and exchanged channels.");
        assert_eq!(told(3, None), "3 modes were asked for reversed and exchanged channels.");
        assert!(told(3, Some("that takes heights")).starts_with("Shapes were not asked"));
    }
}
