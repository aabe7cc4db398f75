//! Studies of accuracy, each a subcommand: longer than a test, on data that do not share the program's assumptions.
//!
//! `cargo run --release -p belfry-tests -- help` lists them.

mod archive;
mod blind;
mod campaign;
mod canton;
mod cases;
mod clock;
#[cfg(unix)]
mod fleet;
mod footbridge;
mod frame;
mod identification;
#[cfg(unix)]
mod kills;
#[cfg(unix)]
mod load;
mod records;
mod years;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Studies of how accurate and how honest Belfry is
#[derive(Debug, Parser)]
#[command(name = "studies", max_term_width = 100)]
struct CommandLine {
    #[command(subcommand)]
    study: StudyCommand,
}

#[derive(Debug, Subcommand)]
enum StudyCommand {
    Archive(archive::Arguments),
    Blind(blind::Arguments),
    Campaign(campaign::Arguments),
    Canton(canton::Arguments),
    Clock(clock::Arguments),
    #[cfg(unix)]
    Fleet(fleet::Arguments),
    Footbridge(footbridge::Arguments),
    Frame(frame::Arguments),
    Identification(identification::Arguments),
    #[cfg(unix)]
    Kills(kills::Arguments),
    #[cfg(unix)]
    Load(load::Arguments),
    Records(records::Arguments),
    Years(years::Arguments),
}

fn main() -> ExitCode {
    let outcome = match CommandLine::parse().study {
        StudyCommand::Archive(arguments) => archive::run(&arguments),
        StudyCommand::Blind(arguments) => blind::run(&arguments),
        StudyCommand::Campaign(arguments) => campaign::run(&arguments),
        StudyCommand::Canton(arguments) => canton::run(&arguments),
        StudyCommand::Clock(arguments) => clock::run(&arguments),
        #[cfg(unix)]
        StudyCommand::Fleet(arguments) => fleet::run(&arguments),
        StudyCommand::Footbridge(arguments) => footbridge::run(&arguments),
        StudyCommand::Frame(arguments) => frame::run(&arguments),
        StudyCommand::Identification(arguments) => identification::run(&arguments),
        #[cfg(unix)]
        StudyCommand::Kills(arguments) => kills::run(&arguments),
        #[cfg(unix)]
        StudyCommand::Load(arguments) => load::run(&arguments),
        StudyCommand::Records(arguments) => records::run(&arguments),
        StudyCommand::Years(arguments) => years::run(&arguments),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
