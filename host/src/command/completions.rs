//! `belfry completions`: what makes a shell complete belfry's commands and options.

use clap::Args;
use clap_complete::Shell;
use serde::Serialize;

use super::Console;

const EXAMPLES: &str = "Examples:
  belfry completions bash > ~/.local/share/bash-completion/completions/belfry
  belfry completions zsh > ~/.zfunc/_belfry      with fpath+=~/.zfunc in ~/.zshrc
  belfry completions fish > ~/.config/fish/completions/belfry.fish
  belfry completions powershell >> $PROFILE";

/// Print what makes a shell complete belfry's commands and options
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The shell
    #[arg(value_enum)]
    pub shell: Shell,
}

#[derive(Serialize)]
struct Report {
    shell: String,
    script: String,
}

/// Prints the script for the commands of `line`.
///
/// # Errors
/// When standard output cannot be written.
pub fn run(arguments: &Arguments, mut line: clap::Command, console: &Console) -> anyhow::Result<()> {
    let mut script = Vec::new();
    let name = line.get_name().to_owned();
    clap_complete::generate(arguments.shell, &mut line, name, &mut script);
    let script = String::from_utf8_lossy(&script).into_owned();
    console.raw(&script)?;
    console.json("completions-1", &Report { shell: arguments.shell.to_string(), script })
}
