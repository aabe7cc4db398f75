//! `belfry init`: a new study from a template, or from what recordings say of themselves.
//!
//! A folder's name flows in; the files of the study flow out. What is there already is never overwritten.

mod check;
mod from;

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::ValueEnum;
use serde::Serialize;

use super::Console;
use super::text::{in_shell, next_lines};
use crate::files::write_new;
use crate::record::named_files;
use crate::record::survey::{joined, survey};
use crate::study::{STUDY_FILE, template};

/// Make a new study: a folder with a study.toml to edit
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  belfry init tower                       a study to fill in, in the new folder `tower`
  belfry init canton --template canton    the Canton Tower: 20 accelerometers, beam model
  belfry init turbine --template turbine  a wind turbine on a monopile, clamped at the mudline
  belfry init frame --template frame      a building frame of five storeys, matrices with a group a storey
  belfry init bridge --template bridge    a bridge of three spans, matrices with groups by span and bearing
  belfry init mast --from mast/*.tdms     look into recordings, and write what they say of themselves
  belfry init mast --from mast            the same of all recordings in a folder
  belfry init . --json                    in this folder, and say what was written as JSON")]
pub struct Arguments {
    /// Folder of the study; made where it does not exist
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// What the study starts from
    #[arg(long, value_enum, default_value_t = Template::Blank)]
    pub template: Template,
    /// Recordings to look into, their folders or patterns in quotes: their channels, rates, units and times become the study, and what they do not say is marked
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with = "template")]
    pub from: Vec<PathBuf>,
}

/// What a new study starts from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Template {
    /// The Canton Tower: 20 accelerometers at 8 levels, with its beam model
    Canton,
    /// A 5 MW wind turbine on a monopile: 8 accelerometers at 4 levels, with its beam model, clamped at the mudline
    Turbine,
    /// A building frame of five storeys: 15 accelerometers, matrices with a group a storey
    Frame,
    /// A bridge of three spans: 21 accelerometers, matrices with groups by span and bearing
    Bridge,
    /// One setup of two sensors, every key explained
    Blank,
}

impl Template {
    /// Name and content of the study's files; `study.toml` stands last, so that a study is whole once it is there.
    pub fn files(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Self::Canton => &[("beam.csv", template::CANTON_BEAM), (STUDY_FILE, template::CANTON_STUDY)],
            Self::Turbine => &[("beam.csv", template::TURBINE_BEAM), (STUDY_FILE, template::TURBINE_STUDY)],
            Self::Frame => template::FRAME_FILES,
            Self::Bridge => template::BRIDGE_FILES,
            Self::Blank => &[(STUDY_FILE, template::BLANK_STUDY)],
        }
    }

    /// What is to be done before modes can be identified, in a sentence.
    fn to_do(self, folder: &Path) -> String {
        let put = |files: &str| format!("Put recordings {files} into {}, or simulate one.", folder.display());
        match self {
            Self::Canton => put("accdata_*.txt"),
            Self::Turbine | Self::Frame | Self::Bridge => put("acceleration_*.txt"),
            Self::Blank => format!(
                "Describe your sensors in {} and put the recording next to it; or write `live = true` there, and `belfry collect` fetches it from nodes.",
                folder.join(STUDY_FILE).display()
            ),
        }
    }

    /// The commands that come next.
    fn next(self, folder: &Path) -> Vec<(String, &'static str)> {
        let study = in_shell(folder);
        let simulate = (format!("simulate {study} --adopt"), "simulates an hour of recording");
        let with_change = |group: &str| {
            (
                format!("simulate {study} --effect group@{group}=-0.25 --adopt"),
                "an hour of recording, with a group that is softer",
            )
        };
        let identify = (format!("identify {study}"), "the modes of the recording");
        let look = (format!("look {study}"), "what was recorded, and which channels are suspect");
        match self {
            Self::Canton | Self::Turbine => vec![simulate, identify],
            Self::Frame => vec![with_change("storey2"), identify],
            Self::Bridge => vec![with_change("span2"), identify],
            Self::Blank => vec![look, identify],
        }
    }
}

#[derive(Serialize)]
struct Report<'a> {
    study: String,
    files: Vec<&'a str>,
    next: String,
    /// What recordings hold and the study leaves out, and what of it cannot be read.
    warnings: Vec<String>,
}

/// Writes the template's files, or a study of recordings, into the folder and says what comes next.
///
/// # Errors
/// When one of the files exists already, or cannot be written, or a recording cannot be looked into.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let folder = &arguments.folder;
    if arguments.from.is_empty() {
        let files = arguments.template.files();
        write(folder, files)?;
        return tell(arguments, files, &arguments.template.to_do(folder), Vec::new(), console);
    }
    let found = joined(survey(named_files(&arguments.from)?)?);
    let draft = from::study(&found, folder);
    let files = [(STUDY_FILE, draft.text.as_str())];
    write(folder, &files)?;
    let mut warnings = draft.warnings;
    warnings.extend(check::failures(&found, folder));
    tell(arguments, &files, &to_complete(&draft.needed, folder), warnings, console)
}

/// Writes what is not there yet; where one of the files is, nothing.
fn write(folder: &Path, files: &[(&str, &str)]) -> anyhow::Result<()> {
    refuse_existing(folder, files)?;
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}; name one that you may write to", folder.display()))?;
    for (name, content) in files {
        let path = folder.join(name);
        // A file which came up since the look above is not overwritten either.
        write_new(&path, content.as_bytes()).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

/// What the user completes in a study of recordings, in a sentence.
fn to_complete(needed: &[&str], folder: &Path) -> String {
    let complete = format!("Complete the lines with {} in {}", from::TO_DO, folder.join(STUDY_FILE).display());
    if needed.is_empty() {
        return format!("{complete} where you can: what the recordings do not say, and these commands can do without.");
    }
    format!("{complete} first: the recordings do not say {}, and no command does without.", needed.join(", "))
}

fn tell(
    arguments: &Arguments,
    files: &[(&str, &str)],
    to_do: &str,
    warnings: Vec<String>,
    console: &Console,
) -> anyhow::Result<()> {
    let folder = &arguments.folder;
    let next = arguments.template.next(folder);
    console.warn_all(&warnings);
    console.say(format_args!("New study in {}", folder.display()));
    for (name, _) in files {
        console.say(format_args!("  {name}"));
    }
    console.say(to_do);
    console.say(next_lines(&next));
    let names = files.iter().map(|(name, _)| *name).collect();
    let commands: Vec<String> = next.iter().map(|(command, _)| format!("`belfry {command}`")).collect();
    let next = format!("{to_do} Then run {}", commands.join(", then "));
    console.json("init-1", &Report { study: folder.display().to_string(), files: names, next, warnings })
}

/// A study is somebody's work: the first file that is in the way is named, nothing is written.
fn refuse_existing(folder: &Path, files: &[(&str, &str)]) -> anyhow::Result<()> {
    // study.toml first: it says that there is a study, any other file only that there is a file.
    for (name, _) in files.iter().rev() {
        let path = folder.join(name);
        // Not `exists`: a link that leads nowhere is in the way too.
        if path.symlink_metadata().is_ok() {
            bail!("{} exists already and is not overwritten; name another folder, or move it away", path.display());
        }
    }
    Ok(())
}
