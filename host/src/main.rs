//! The `belfry` command: parses arguments, runs one subcommand, and turns an error into sentences.

use std::process::ExitCode;

use belfry_host::command::{
    Console, add, archive, calibrate, change, collect, compare, completions, covalidate, demo, diagnose, effects,
    export, history, identify, init, key, look, man, plan, ports, profile, remove, replay, report, serve, simulate,
    update, watch, work,
};
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

fn main() -> ExitCode {
    let CommandLine { json, command } = CommandLine::parse();
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

#[cfg(test)]
mod tests {
    use super::*;

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
