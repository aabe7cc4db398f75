//! `belfry export`: modes, spectra, spectral lines, the model and moving pictures as files for other tools.

mod animation;
mod model;

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::error::ErrorKind;
use clap::{Args, ValueEnum};
use serde::Serialize;

use super::Console;
use super::interrupt::{alone, leave_nothing_unfinished};
use super::range::RangeArguments;
use super::route::RouteArguments;
use crate::export::modes::Modes;
use crate::export::rows::TableFormat;
use crate::export::spectra::{LinesTable, write_psd};
use crate::export::{table, universal, write_file};
use crate::files::{folder_of, ready_folder, without_links};
use crate::measure::{Measurement, Observer, Route, measure_observed};
use crate::results::Results;
use crate::study::Study;

const EXAMPLES: &str = "Examples:
  belfry export canton                           its modes as UFF 55, CSV and JSON
  belfry export canton --format uff55 --output canton.uff
  belfry export canton --of psd --direct         averaged spectra as Parquet
  belfry export canton --of psd --format csv
  belfry export canton --format parquet          modes as a table
  belfry export canton --of lines                every window's complex lines
  belfry export canton --of animation            every mode in motion, as APNG
  belfry export canton --of animation --mode 2 --output mode-2.gif
  belfry export canton --of model                matrices with effects, and its modes
  belfry export canton --of model --fitted-background --format npy

Modes are those that `belfry identify` found; spectra are measured anew. Files go into the study's folder `results/export`: modes.uff, modes.csv, modes.json, psd.parquet, lines.parquet. Columns are named with their units.

Each mode in motion is a file, animation_1.png and so on. --output with the ending .png or .gif is one file instead, of the mode that --mode names, or of all modes one after the other; browsers and office programs play GIF, browsers APNG, too.

A model is written as stiffness.mtx and mass.mtx (damping.mtx where it has dashpots), dofs.csv (where each row of the matrices stands), model_shapes.csv and .parquet (its modes at every degree of freedom, of unit modal mass) and model_modes.uff, .csv and .parquet (the same at the sensors). [model] matrices in a study.toml reads it. Effects that are no part of stiffness and mass, such as faults of sensors, are named and left out.";

/// Write modes, spectra, or the model with its effects, for other tools
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    pub study: PathBuf,
    /// The files' format [default: uff55, csv and json for modes; mtx for the model; parquet otherwise]
    #[arg(long, value_enum)]
    pub format: Option<Format>,
    /// What to export
    #[arg(long = "of", value_enum, default_value_t = Content::Modes)]
    pub content: Content,
    /// The file to write, for a model the folder, for animations either; a file's ending says the format where --format does not
    #[arg(long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// The number of the mode to animate [default: all]
    #[arg(long, value_name = "N")]
    pub mode: Option<usize>,
    /// Write the model with its segments as they fit the measured modes best, within the tolerance
    #[arg(long)]
    pub fitted_background: bool,
    /// Which windows of a live setup are exported
    #[command(flatten)]
    pub range: RangeArguments,
    /// How spectra are made of the recordings
    #[command(flatten)]
    pub route: RouteArguments,
}

/// What can be exported.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Content {
    /// Frequencies, damping ratios and shapes
    Modes,
    /// Averaged power spectral densities of every channel
    Psd,
    /// The complex spectral lines of every window
    Lines,
    /// Mass and stiffness with the effects in the model, and its modes
    Model,
    /// Every mode as a moving picture
    Animation,
}

/// Formats of exported files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Universal file datasets 55, with the nodes (15)
    Uff55,
    /// A table as text
    Csv,
    /// The JSON of `belfry identify`
    Json,
    /// A table as Apache Parquet
    Parquet,
    /// Matrices as Matrix Market files
    Mtx,
    /// Matrices as NumPy files
    Npy,
    /// Animated PNG
    Png,
    /// Animated GIF
    Gif,
}

impl Content {
    /// What it can be written as.
    fn formats(self) -> &'static [Format] {
        match self {
            Self::Modes => &[Format::Uff55, Format::Csv, Format::Json, Format::Parquet],
            Self::Psd | Self::Lines => &[Format::Parquet, Format::Csv],
            Self::Model => &[Format::Mtx, Format::Npy],
            Self::Animation => &[Format::Png, Format::Gif],
        }
    }

    /// What it is written as without --format.
    fn by_default(self) -> &'static [Format] {
        match self {
            Self::Modes => &[Format::Uff55, Format::Csv, Format::Json],
            Self::Psd | Self::Lines => &[Format::Parquet],
            Self::Model => &[Format::Mtx],
            Self::Animation => &[Format::Png],
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Modes => "modes",
            Self::Psd => "psd",
            Self::Lines => "lines",
            Self::Model => "model",
            Self::Animation => "animation",
        }
    }
}

impl Format {
    fn name(self) -> &'static str {
        match self {
            Self::Uff55 => "uff55",
            Self::Csv => "csv",
            Self::Json => "json",
            Self::Parquet => "parquet",
            Self::Mtx => "mtx",
            Self::Npy => "npy",
            Self::Png => "png",
            Self::Gif => "gif",
        }
    }

    fn ending(self) -> &'static str {
        match self {
            Self::Uff55 => "uff",
            Self::Csv => "csv",
            Self::Json => "json",
            Self::Parquet => "parquet",
            Self::Mtx => "mtx",
            Self::Npy => "npy",
            Self::Png => "png",
            Self::Gif => "gif",
        }
    }

    /// The same for a table.
    fn of_table(self) -> TableFormat {
        if self == Self::Csv { TableFormat::Csv } else { TableFormat::Parquet }
    }

    fn of_ending(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "uff" | "unv" => Some(Self::Uff55),
            "csv" => Some(Self::Csv),
            "json" => Some(Self::Json),
            "parquet" => Some(Self::Parquet),
            "mtx" => Some(Self::Mtx),
            "npy" => Some(Self::Npy),
            "png" | "apng" => Some(Self::Png),
            "gif" => Some(Self::Gif),
            _ => None,
        }
    }
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
pub struct Report {
    /// The files that were written.
    pub files: Vec<WrittenFile>,
    /// Effects that are no part of a model's matrices.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<String>,
}

/// A file that was written.
#[derive(Debug, Serialize)]
pub struct WrittenFile {
    /// Its path.
    pub file: PathBuf,
    /// What it holds.
    pub of: Content,
    /// Its format.
    pub format: Format,
    /// Modes, or rows of the table or matrix.
    pub rows: u64,
}

/// Runs the command.
///
/// # Errors
/// When the study has no modes yet, its recordings cannot be read, or a file cannot be written.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    leave_nothing_unfinished()?;
    // What clap's attributes cannot say; it exits as for any wrong usage.
    let formats =
        formats(arguments).unwrap_or_else(|usage| clap::Error::raw(ErrorKind::ArgumentConflict, usage).exit());
    let _lock = if arguments.output.is_none() { alone(&arguments.study, console)? } else { None };
    if let (Content::Model, [format]) = (arguments.content, &formats[..]) {
        return model::run(arguments, *format, console);
    }
    if let (Content::Animation, [format]) = (arguments.content, &formats[..]) {
        return animation::run(arguments, *format, console);
    }
    let mut study = Study::load(&arguments.study)?;
    study.range = arguments.range.range_of(&study)?;
    let content = arguments.content;
    let targets: Vec<(Format, PathBuf)> = match &arguments.output {
        Some(output) => formats.into_iter().map(|format| (format, output.clone())).collect(),
        None => {
            let folder = own_folder(&study)?;
            let own = |format: Format| (format, folder.join(format!("{}.{}", content.name(), format.ending())));
            formats.into_iter().map(own).collect()
        }
    };
    let route = arguments.route.route();
    for (_, path) in &targets {
        // Before hours of recording are read.
        ready_for(path)?;
    }
    let written = match content {
        Content::Modes => export_modes(&study, &targets, console)?,
        Content::Psd => {
            let measurement = measured(&study, route, console, &mut |_, _, _| {})?;
            let write = |(format, path): &(Format, PathBuf)| write_psd(path, &measurement, format.of_table());
            targets.iter().map(write).collect::<Result<_, _>>()?
        }
        Content::Lines => {
            let mut rows = Vec::new();
            for (format, path) in &targets {
                let mut table = LinesTable::create(path, &study.setups, format.of_table())?;
                measured(&study, route, console, &mut |setup, grid, window| table.observe(setup, grid, window))?;
                rows.push(table.finish()?);
            }
            rows
        }
        Content::Model | Content::Animation => Vec::new(),
    };
    let files: Vec<WrittenFile> = targets
        .into_iter()
        .zip(written)
        .map(|((format, file), rows)| WrittenFile { file, of: content, format, rows })
        .collect();
    for WrittenFile { file, rows, format, .. } in &files {
        let is_of_modes = content == Content::Modes && *format != Format::Parquet;
        let what = if is_of_modes { "modes" } else { "rows" };
        console.say(format!("{}: {rows} {what}", file.display()));
    }
    console.json("export-1", &Report { files, left_out: Vec::new() })
}

/// The study's own folder of exports, made sure to lead nowhere else: a study may come from someone else.
fn own_folder(study: &Study) -> anyhow::Result<PathBuf> {
    let results = Results::of(study);
    results.make_ready()?;
    let folder = results.path("export");
    without_links(&folder).with_context(|| format!("cannot remove the links in {}", folder.display()))?;
    Ok(folder)
}

/// Makes sure that a file can be written there.
fn ready_for(path: &Path) -> anyhow::Result<()> {
    let folder = folder_of(path);
    ready_folder(folder).with_context(|| format!("cannot write into {}", folder.display()))
}

/// The formats asked for; the sentence that says what is wrong with the usage.
fn formats(arguments: &Arguments) -> Result<Vec<Format>, String> {
    let content = arguments.content;
    if arguments.fitted_background && content != Content::Model {
        return Err("--fitted-background goes with --of model\n".to_owned());
    }
    if arguments.mode.is_some() && content != Content::Animation {
        return Err("--mode goes with --of animation\n".to_owned());
    }
    if content == Content::Animation {
        animation::usage(arguments)?;
    }
    let by_ending = || match &arguments.output {
        None => Ok(None),
        Some(_) if content == Content::Model => Ok(None),
        Some(path) if content == Content::Animation && animation::is_folder(path) => Ok(None),
        Some(path) => Format::of_ending(path).map(Some).ok_or_else(|| {
            format!("--output {}: the ending says nothing about the format; give --format too\n", path.display())
        }),
    };
    let format = match arguments.format {
        Some(format) => Some(format),
        None => by_ending()?,
    };
    match format {
        None => Ok(content.by_default().to_vec()),
        Some(format) if content.formats().contains(&format) => Ok(vec![format]),
        Some(format) => {
            let names: Vec<&str> = content.formats().iter().map(|format| format.name()).collect();
            let (content, format) = (content.name(), format.name());
            Err(format!("--of {content} cannot be written as {format}; expected {}\n", names.join(" or ")))
        }
    }
}

/// The modes that `belfry identify` found.
fn modes_of(study: &Study) -> anyhow::Result<Modes> {
    if let Some(measured) = &study.measured {
        bail!(
            "{}: the study's modes are those of another tool; there are none of `belfry identify` to export",
            study.folder.join(&measured.modes).display()
        );
    }
    Ok(Modes::load(study)?)
}

fn export_modes(study: &Study, targets: &[(Format, PathBuf)], console: &Console) -> anyhow::Result<Vec<u64>> {
    let modes = modes_of(study)?;
    let mut rows = Vec::new();
    for (format, path) in targets {
        let mut count = modes.modes.len() as u64;
        match format {
            Format::Csv => table::write_csv(path, &modes)?,
            Format::Parquet => count = table::write_parquet(path, &modes)?,
            Format::Uff55 => {
                let (text, warnings) = universal::text(&modes, &study.structure.name);
                for warning in warnings {
                    console.warn(format!("{}: {warning}", path.display()));
                }
                write_file(path, &text)?;
            }
            Format::Json | Format::Mtx | Format::Npy | Format::Png | Format::Gif => write_file(path, &modes.json)?,
        }
        rows.push(count);
    }
    Ok(rows)
}

/// Measures the study with a progress bar, and warns.
fn measured<'a>(
    study: &'a Study,
    route: Route,
    console: &Console,
    observer: Observer<'_>,
) -> anyhow::Result<Measurement<'a>> {
    let bar = console.progress(0, "spectra");
    let mut progress = |done, total| {
        bar.set_length(total);
        bar.set_position(done);
    };
    let measurement = measure_observed(study, route, &mut progress, observer);
    bar.finish_and_clear();
    let measurement = measurement?;
    console.warn_all(&measurement.warnings);
    Ok(measurement)
}
