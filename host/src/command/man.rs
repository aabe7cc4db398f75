//! `belfry man`: the manual's pages, made of the same text as the help. The synopsis says which value an option takes and what may be
//! repeated, which that of clap_mangen leaves out.

use std::path::PathBuf;

use anyhow::Context;
use clap::{Arg, ArgAction, Args};
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
    let command = command.clone().disable_help_subcommand(true);
    let man = Man::new(command.clone()).manual("Belfry");
    let mut text = Vec::new();
    man.render(&mut text).context("cannot make a page of the manual")?;
    let text = with_synopsis(&String::from_utf8_lossy(&text), &synopsis(&command));
    Ok(Page { file: man.get_filename(), text: text.into_bytes() })
}

/// The page with another synopsis.
fn with_synopsis(page: &str, synopsis: &str) -> String {
    const HEAD: &str = "\n.SH SYNOPSIS\n";
    let Some((before, rest)) = page.split_once(HEAD) else { return page.to_owned() };
    let after = rest.find("\n.SH ").map_or("", |end| &rest[end + 1..]);
    format!("{before}{HEAD}{synopsis}\n{after}")
}

/// The synopsis as roff: the command, its options, its arguments, and the commands below it.
fn synopsis(command: &clap::Command) -> String {
    let name = command.get_bin_name().unwrap_or_else(|| command.get_name());
    let shown = || command.get_arguments().filter(|argument| !argument.is_hide_set());
    let (needed, optional): (Vec<&Arg>, Vec<&Arg>) =
        shown().filter(|argument| !argument.is_positional()).partition(|argument| argument.is_required_set());
    let mut words = vec![format!("\\fB{}\\fR", escaped(name))];
    words.extend(optional.into_iter().chain(needed).map(option));
    words.extend(shown().filter(|argument| argument.is_positional()).map(positional));
    if command.has_subcommands() {
        words.push(bracketed("\\fICOMMAND\\fR", command.is_subcommand_required_set()));
    }
    words.join("\n")
}

/// An option with its value: `[--rate <HZ>]`, and `...` after what may be repeated.
fn option(argument: &Arg) -> String {
    let short = argument.get_short().map(|letter| format!("-{letter}"));
    let long = argument.get_long().map(|word| format!("--{word}"));
    let names = short.into_iter().chain(long).map(|name| format!("\\fB{}\\fR", escaped(&name)));
    let mut words = names.collect::<Vec<_>>().join("|");
    let takes_values = argument.get_action().takes_values();
    if takes_values {
        let values = value_names(argument).map(|name| format!("\\fI<{}>\\fR", escaped(name)));
        // A blank at which no line ends.
        let values = values.collect::<Vec<_>>().join("\\ ") + if is_list(argument) { "..." } else { "" };
        let may_lack = argument.get_num_args().is_some_and(|count| count.min_values() == 0);
        words += "\\ ";
        words += &if may_lack { format!("[{values}]") } else { values };
    }
    let word = if argument.is_required_set() { words } else { format!("[{words}]") };
    let is_repeated = matches!(argument.get_action(), ArgAction::Append | ArgAction::Count);
    // One that already ends in dots is not marked twice.
    if is_repeated && !is_list(argument) { word + "..." } else { word }
}

/// An argument by its place: `<STUDY>`, `[DIR]`, `<FILE>...`.
fn positional(argument: &Arg) -> String {
    let names = value_names(argument).map(|name| format!("\\fI{}\\fR", escaped(name)));
    let word = bracketed(&names.collect::<Vec<_>>().join("\\ "), argument.is_required_set());
    let is_repeated = is_list(argument) || matches!(argument.get_action(), ArgAction::Append);
    if is_repeated { word + "..." } else { word }
}

fn value_names(argument: &Arg) -> impl Iterator<Item = &str> {
    let named = argument.get_value_names().unwrap_or_default();
    let own = named.is_empty().then(|| argument.get_id().as_str());
    named.iter().map(clap::builder::Str::as_str).chain(own)
}

/// Whether one name stands for several values.
fn is_list(argument: &Arg) -> bool {
    let names = argument.get_value_names().map_or(1, <[_]>::len);
    argument.get_num_args().is_some_and(|count| count.max_values() > names.max(1))
}

fn bracketed(word: &str, is_needed: bool) -> String {
    if is_needed { format!("<{word}>") } else { format!("[{word}]") }
}

/// Text as roff takes it: a hyphen that is one, and no character that begins a request.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\e").replace('-', "\\-").replace('\'', "\\(aq")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_synopsis_has_values_and_says_what_may_be_repeated() {
        let mut command = clap::Command::new("sound")
            .arg(Arg::new("rate").long("rate").value_name("HZ"))
            .arg(Arg::new("port").short('p').long("port").value_name("PORT").action(ArgAction::Append))
            .arg(Arg::new("near").long("near").value_names(["X", "Y"]).num_args(2))
            .arg(Arg::new("modes").long("modes").value_name("N").num_args(1..))
            .arg(Arg::new("loud").long("loud").action(ArgAction::SetTrue))
            .arg(Arg::new("to").long("to").value_name("DIR").required(true))
            .arg(Arg::new("hidden").long("hidden").hide(true))
            .arg(Arg::new("study").value_name("STUDY").required(true))
            .arg(Arg::new("more").value_name("FILE").num_args(0..))
            .after_help("Examples:");
        command.build();
        let text = String::from_utf8(page(&command).unwrap().text).unwrap();
        let synopsis = text.split(".SH SYNOPSIS\n").nth(1).unwrap().split("\n.SH ").next().unwrap();
        let plain = synopsis.replace("\\fB", "").replace("\\fI", "").replace("\\fR", "");
        let plain = plain.replace("\\-", "-").replace("\\ ", " ").replace('\n', " ");
        assert_eq!(
            plain,
            "sound [--rate <HZ>] [-p|--port <PORT>]... [--near <X> <Y>] [--modes <N>...] [--loud] [-h|--help] \
             --to <DIR> <STUDY> [FILE]..."
        );
        // What follows is as it was.
        assert!(text.contains("\n.SH OPTIONS\n") && text.contains("Examples:"), "{text}");
        assert_eq!(text.matches(".SH SYNOPSIS").count(), 1);
    }

    #[test]
    fn the_page_of_this_command_names_its_folder() {
        let mut line = <Arguments as Args>::augment_args(clap::Command::new("man"));
        line.build();
        assert!(synopsis(&line).ends_with("[\\fIDIR\\fR]"), "{}", synopsis(&line));
    }
}
