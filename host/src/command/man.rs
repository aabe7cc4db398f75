//! `belfry man`: the manual's pages, made of the same text as the help.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use clap_mangen::Man;
use serde::Serialize;

use super::Console;
use crate::files::{ready_folder, write_anew};

const EXAMPLES: &str = "Examples:
  belfry man | man -l -                 the first page
  belfry man ~/.local/share/man/man1    a page a command: `man belfry-identify`";

/// Write the manual: a page for each command
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The folder for all pages; without one the first page is printed
    #[arg(value_name = "DIR")]
    pub folder: Option<PathBuf>,
}

/// A page of the manual.
struct Page {
    file: String,
    text: Vec<u8>,
}

#[derive(Serialize)]
struct Report {
    /// Files that were written.
    files: Vec<PathBuf>,
    /// The first page, where no folder was named.
    #[serde(skip_serializing_if = "Option::is_none")]
    page: Option<String>,
}

/// Writes the pages of `line`, or prints the first.
///
/// # Errors
/// When a file, or standard output, cannot be written.
pub fn run(arguments: &Arguments, mut line: clap::Command, console: &Console) -> anyhow::Result<()> {
    line.build();
    let Some(folder) = &arguments.folder else {
        let page = String::from_utf8_lossy(&page(&line)?.text).into_owned();
        console.raw(&page)?;
        return console.json("man-1", &Report { files: Vec::new(), page: Some(page) });
    };
    ready_folder(folder).with_context(|| format!("cannot write into {}", folder.display()))?;
    let mut files = Vec::new();
    for Page { file, text } in pages(&line)? {
        let file = folder.join(file);
        write_anew(&file, &text).with_context(|| format!("cannot write {}", file.display()))?;
        files.push(file);
    }
    console.say(format!("{} pages of the manual are in {}.", files.len(), folder.display()));
    console.json("man-1", &Report { files, page: None })
}

/// The page of a command, and those of the commands below it.
fn pages(line: &clap::Command) -> anyhow::Result<Vec<Page>> {
    let mut pages = vec![page(line)?];
    for command in line.get_subcommands().filter(|command| !command.is_hide_set() && command.get_name() != "help") {
        pages.extend(self::pages(command)?);
    }
    Ok(pages)
}

fn page(command: &clap::Command) -> anyhow::Result<Page> {
    // The name of a command within another one is both: `belfry-archive-check`.
    let man = Man::new(command.clone().disable_help_subcommand(true)).manual("Belfry");
    let mut text = Vec::new();
    man.render(&mut text).context("cannot make a page of the manual")?;
    Ok(Page { file: man.get_filename(), text })
}
