//! Command lines that a document shows and that cannot run here: do their programs, tests and options exist?

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;

use belfry_tests::belfry_command;

/// Programs of other people, whose options are their affair.
const FOREIGN: [&str; 10] =
    ["probe-rs", "rm", "rustup", "qemu-system-arm", "git", "$EDITOR", "docker", "sudo", "tar", "nats-server"];

/// The help of belfry's commands and of the studies, asked for once each.
pub(crate) struct CommandHelp {
    repository: PathBuf,
    asked: Mutex<HashMap<String, Option<String>>>,
}

impl CommandHelp {
    pub(crate) fn new(repository: &Path) -> Self {
        Self { repository: repository.to_owned(), asked: Mutex::default() }
    }

    /// Whether a program has the subcommand, with its own where there is a blank in it, and that one every long option among `words`.
    fn check(&self, mut program: Command, subcommand: &str, words: &[&str]) -> Result<(), String> {
        let key = format!("{} {subcommand}", program.get_program().display());
        let mut asked = self.asked.lock().unwrap();
        let help = asked.entry(key).or_insert_with(|| {
            let output = program.args(subcommand.split(' ')).arg("--help").output().unwrap();
            output.status.success().then(|| String::from_utf8(output.stdout).unwrap())
        });
        let help = help.as_ref().ok_or_else(|| format!("there is no command {subcommand}"))?;
        // Examples show options too; only the list of options says which there are.
        let list = help.split("\nExamples:").next().unwrap_or(help);
        let known: Vec<&str> = list.split_whitespace().map(|word| word.trim_matches([',', '[', ']', '.'])).collect();
        for word in words.iter().map(|word| word.trim_matches(['[', ']'])).filter(|word| word.len() > 2) {
            let option = word.split('=').next().unwrap_or(word);
            if option.starts_with("--") && !known.contains(&option) {
                return Err(format!("{subcommand} has no option {option}"));
            }
        }
        Ok(())
    }

    fn exists(&self, path: &str) -> Result<(), String> {
        self.repository.join(path).exists().then_some(()).ok_or_else(|| format!("there is no {path}"))
    }

    fn belfry(&self, words: &[&str]) -> Result<(), String> {
        match words {
            ["help", command, ..] => self.check(belfry_command(), command, &[]),
            ["help"] | [] => Ok(()),
            ["archive", step, rest @ ..] => self.check(belfry_command(), &format!("archive {step}"), rest),
            [command, rest @ ..] => self.check(belfry_command(), command, rest),
        }
    }

    fn simple(&self, words: &[&str]) -> Result<(), String> {
        match words {
            [] => Ok(()),
            ["belfry", rest @ ..] | ["cargo", "run", "--release", "--", rest @ ..] => self.belfry(rest),
            ["cargo", "run", "--release", "-p", "belfry-tests", "--", study, rest @ ..] => {
                self.check(Command::new(env!("CARGO_BIN_EXE_studies")), study, rest)
            }
            ["cargo", "test", "-p", "belfry-tests", "--test", "stories", story, ..] => {
                let story = format!("tests/tests/stories/{story}");
                self.exists(&format!("{story}.rs")).or_else(|_| self.exists(&story))
            }
            ["cargo", "test", "-p", package @ ("belfry-host" | "belfry-firmware"), module] => {
                self.exists(&format!("{}/src/{module}", package.trim_start_matches("belfry-")))
            }
            ["cargo", "bench", "-p", "belfry-benches", "--bench", name] => {
                self.exists(&format!("tests/benches/benches/{name}.rs"))
            }
            ["cargo", "install", "--path", path] => self.exists(path),
            ["cargo", "+nightly", "fuzz", "run", "-s", "none", target, ..] => {
                self.exists(&format!("fuzz/fuzz_targets/{target}.rs"))
            }
            ["cargo", "+nightly", "miri", "test", "-p", package, ..] => {
                self.exists(package.trim_start_matches("belfry-"))
            }
            [script, ..] if script.starts_with("packaging/") => self.exists(script),
            ["tests/other-systems"] => self.exists(words[0]),
            ["python3", "-m", "pip", "install", _] => Ok(()),
            ["cargo", "build", "--release"]
            | ["cargo", "run"]
            | ["cargo", "install", "probe-rs-tools" | "cargo-fuzz"]
            | ["cargo", "+nightly", "fuzz", "list"] => Ok(()),
            ["./test", options @ ..] => {
                let script =
                    std::fs::read_to_string(self.repository.join("test")).map_err(|error| error.to_string())?;
                let unknown = options.iter().find(|option| !script.contains(**option));
                unknown.map_or(Ok(()), |option| Err(format!("./test has no option {option}")))
            }
            ["python3", script, ..] | ["cd", script] => self.exists(script),
            [script, ..] if script.starts_with("firmware/") => self.exists(script),
            [program, ..] if FOREIGN.contains(program) => Ok(()),
            [program, ..] => Err(format!("{program} is a program that this test does not know")),
        }
    }
}

/// Checks a line of commands.
pub(crate) fn check_line(line: &str, help: &CommandHelp) -> Result<(), String> {
    // The command in `name=$(command)` stands for itself.
    let line = without_comment(line).replace("$(", " ; ").replace(')', " ; ");
    let words: Vec<&str> = line.split_whitespace().collect();
    for simple in words.split(|word| ["&&", "||", "|", ";", "&"].contains(word)) {
        let assignments = simple.iter().take_while(|word| is_assignment(word)).count();
        help.simple(&simple[assignments..])?;
    }
    Ok(())
}

/// Whether a word sets a variable: `NAME=value`.
fn is_assignment(word: &str) -> bool {
    let is_name = |name: &str| !name.is_empty() && name.chars().all(|sign| sign.is_ascii_alphanumeric() || sign == '_');
    word.split_once('=').is_some_and(|(name, _)| is_name(name))
}

/// A line up to its comment.
pub(crate) fn without_comment(line: &str) -> &str {
    line.split(" #").next().unwrap_or(line).trim()
}
