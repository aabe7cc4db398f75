//! The `belfry` command: parses arguments, runs one subcommand, and turns an error into sentences.

use std::process::ExitCode;

use belfry_host::command::{
    Console, add, archive, calibrate, change, collect, compare, completions, covalidate, demo, diagnose, effects,
    export, history, identify, init, key, look, man, plan, ports, profile, remove, replay, report, serve, simulate,
    update, watch, work,
};
use clap::error::{Error, ErrorKind};
use clap::{CommandFactory, Parser, Subcommand};

/// Finds how a tall structure moves, and why its model is wrong
#[derive(Debug, Parser)]
#[command(
    name = "belfry",
    version,
    arg_required_else_help = true,
    max_term_width = 100,
    after_help = "\
Examples:
  belfry demo                             the chain at work on a simulated tower
  belfry init canton --template canton    a study of the Canton Tower
  belfry identify canton                  its modes
  belfry compare canton                   its model against the measured modes
  belfry diagnose canton                  which physical effect the model lacks
  belfry help init                        what a command does, with examples

Exit status: 0 done, 1 failed, 2 wrong usage."
)]
struct CommandLine {
    /// Print one JSON object on standard output, and nothing else there
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::Arguments),
    Init(init::Arguments),
    Look(look::Arguments),
    Plan(plan::Arguments),
    Simulate(simulate::Arguments),
    Ports(ports::Arguments),
    Key(key::Arguments),
    Calibrate(calibrate::Arguments),
    Collect(collect::Arguments),
    Archive(archive::Arguments),
    Replay(replay::Arguments),
    Identify(identify::Arguments),
    Compare(compare::Arguments),
    Update(update::Arguments),
    Covalidate(covalidate::Arguments),
    Diagnose(diagnose::Arguments),
    Change(change::Arguments),
    Watch(watch::Arguments),
    Work(work::Arguments),
    Profile(profile::Arguments),
    Add(add::Arguments),
    Remove(remove::Arguments),
    History(history::Arguments),
    Report(report::Arguments),
    Serve(serve::Arguments),
    Effects(effects::Arguments),
    Export(export::Arguments),
    Completions(completions::Arguments),
    Man(man::Arguments),
}

/// The exit status of wrong usage.
const WRONG_USAGE: u8 = 2;

fn main() -> ExitCode {
    let CommandLine { json, command } = match CommandLine::try_parse() {
        Ok(line) => line,
        Err(error) => return not_run(&error),
    };
    let console = Console::new(json);
    let outcome = match &command {
        Command::Demo(arguments) => demo::run(arguments, &console),
        Command::Init(arguments) => init::run(arguments, &console),
        Command::Look(arguments) => look::run(arguments, &console),
        Command::Plan(arguments) => plan::run(arguments, &console),
        Command::Simulate(arguments) => simulate::run(arguments, &console),
        Command::Ports(arguments) => ports::run(arguments, &console),
        Command::Key(arguments) => key::run(arguments, &console),
        Command::Calibrate(arguments) => calibrate::run(arguments, &console),
        Command::Collect(arguments) => collect::run(arguments, &console),
        Command::Archive(arguments) => archive::run(arguments, &console),
        Command::Replay(arguments) => replay::run(arguments, &console),
        Command::Identify(arguments) => identify::run(arguments, &console),
        Command::Compare(arguments) => compare::run(arguments, &console),
        Command::Update(arguments) => update::run(arguments, &console),
        Command::Covalidate(arguments) => covalidate::run(arguments, &console),
        Command::Diagnose(arguments) => diagnose::run(arguments, &console),
        Command::Change(arguments) => change::run(arguments, &console),
        Command::Watch(arguments) => watch::run(arguments, &console),
        Command::Work(arguments) => work::run(arguments, &console),
        Command::Profile(arguments) => profile::run(arguments, &console),
        Command::Add(arguments) => add::run(arguments, &console),
        Command::Remove(arguments) => remove::run(arguments, &console),
        Command::History(arguments) => history::run(arguments, &console),
        Command::Report(arguments) => report::run(arguments, &console),
        Command::Serve(arguments) => serve::run(arguments, &console),
        Command::Effects(arguments) => effects::run(arguments, &console),
        Command::Export(arguments) => export::run(arguments, &console),
        Command::Completions(arguments) => completions::run(arguments, CommandLine::command(), &console),
        Command::Man(arguments) => man::run(arguments, CommandLine::command(), &console),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            console.fail(&error);
            ExitCode::FAILURE
        }
    }
}

/// Tells of a command line that runs no command: help and the version, or wrong usage.
fn not_run(error: &Error) -> ExitCode {
    // Where nobody reads there is nobody to tell.
    let _ = error.print();
    if !error.use_stderr() {
        return ExitCode::SUCCESS;
    }
    // What the parser has understood is lost with the error.
    let is_json = std::env::args_os().take_while(|word| word != "--").any(|word| word == "--json");
    Console::new(is_json).misused(sentence(error));
    ExitCode::from(WRONG_USAGE)
}

/// What is wrong with the usage, without the usage itself.
fn sentence(error: &Error) -> String {
    if error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        return "a command or an argument is missing; --help lists them".to_owned();
    }
    let text = error.render().to_string();
    let text = text.strip_prefix("error: ").unwrap_or(&text);
    let paragraphs = text.split("\n\n").map(|paragraph| paragraph.split_whitespace().collect::<Vec<_>>().join(" "));
    let is_message = |paragraph: &String| {
        !paragraph.is_empty() && !paragraph.starts_with("Usage: ") && !paragraph.starts_with("For more information")
    };
    paragraphs.filter(is_message).collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_usage_is_one_sentence() {
        let told = |words: &[&str]| sentence(&CommandLine::try_parse_from([&["belfry"], words].concat()).unwrap_err());
        let missing = told(&["identify", "--json"]);
        assert!(missing.contains("required") && missing.contains("<STUDY>"), "{missing}");
        let wrong = told(&["look", "a.npy", "--rate", "x"]);
        assert!(
            wrong.contains("'x'") && wrong.contains("--rate") && wrong.contains("expected rows per second"),
            "{wrong}"
        );
        let unknown = told(&["look", "a.npy", "--rat", "50"]);
        assert!(unknown.contains("'--rat'") && unknown.contains("; tip: "), "{unknown}");
        for sentence in [missing, wrong, unknown, told(&["key"]), told(&["castle"])] {
            let is_bare = !sentence.is_empty() && !sentence.contains("Usage") && !sentence.contains("For more");
            assert!(is_bare && !sentence.contains('\n'), "{sentence}");
        }
    }

    /// Help is wrapped by the terminal's width. A paragraph that is broken by hand as well would be wrapped twice, and so would an
    /// example that is wider than a terminal.
    #[test]
    fn help_wraps_once() {
        let line = CommandLine::command();
        let commands = || line.get_subcommands();
        let steps = commands().flat_map(clap::Command::get_subcommands);
        for command in std::iter::once(&line).chain(commands()).chain(steps) {
            let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            let name = command.get_name();
            let is_text = |line: &str| !line.is_empty() && !line.starts_with(' ') && !line.ends_with(':');
            let lines: Vec<&str> = help.lines().collect();
            for pair in lines.windows(2) {
                assert!(!(is_text(pair[0]) && is_text(pair[1])), "{name}: broken by hand: {pair:?}");
            }
            for example in lines.iter().filter(|line| line.starts_with(' ')) {
                assert!(example.chars().count() <= 85, "{name}: an example is too wide: {example}");
            }
        }
    }

    #[test]
    fn no_option_is_declared_twice() {
        CommandLine::command().debug_assert();
    }
}
