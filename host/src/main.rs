//! The `belfry` command: parses arguments, runs one subcommand, and turns an error into sentences.

use std::process::ExitCode;

use belfry_host::command::{
    Console, add, collect, compare, covalidate, demo, diagnose, effects, export, history, identify, init, ports,
    remove, replay, simulate, update,
};
use clap::{Parser, Subcommand};

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
    Simulate(simulate::Arguments),
    Ports(ports::Arguments),
    Collect(collect::Arguments),
    Replay(replay::Arguments),
    Identify(identify::Arguments),
    Compare(compare::Arguments),
    Update(update::Arguments),
    Covalidate(covalidate::Arguments),
    Diagnose(diagnose::Arguments),
    Add(add::Arguments),
    Remove(remove::Arguments),
    History(history::Arguments),
    Effects(effects::Arguments),
    Export(export::Arguments),
}

fn main() -> ExitCode {
    let CommandLine { json, command } = CommandLine::parse();
    let console = Console::new(json);
    let outcome = match &command {
        Command::Demo(arguments) => demo::run(arguments, &console),
        Command::Init(arguments) => init::run(arguments, &console),
        Command::Simulate(arguments) => simulate::run(arguments, &console),
        Command::Ports(arguments) => ports::run(arguments, &console),
        Command::Collect(arguments) => collect::run(arguments, &console),
        Command::Replay(arguments) => replay::run(arguments, &console),
        Command::Identify(arguments) => identify::run(arguments, &console),
        Command::Compare(arguments) => compare::run(arguments, &console),
        Command::Update(arguments) => update::run(arguments, &console),
        Command::Covalidate(arguments) => covalidate::run(arguments, &console),
        Command::Diagnose(arguments) => diagnose::run(arguments, &console),
        Command::Add(arguments) => add::run(arguments, &console),
        Command::Remove(arguments) => remove::run(arguments, &console),
        Command::History(arguments) => history::run(arguments, &console),
        Command::Effects(arguments) => effects::run(arguments, &console),
        Command::Export(arguments) => export::run(arguments, &console),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            console.fail(&error);
            ExitCode::FAILURE
        }
    }
}
