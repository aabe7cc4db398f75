//! The blind bench of `belfry diagnose`: `cargo run --release -p belfry-tests --bin blind -- [--cases N] [--seed S]
//! [--first CASE] [--keep DIR] [--structure NAME] [--only KIND|nothing|single|pairs|outside] [--hours H]
//! [--loads even|uneven] [--belfry PROGRAM]`.
//!
//! Each case is a structure of which the study's model lacks something, or nothing; a line says what was hidden and what belfry
//! said, and the score of all of them follows.

use std::path::PathBuf;
use std::process::ExitCode;

use belfry_tests::blind::{Bench, Case, Kinds, Options, line, print_summary};

struct Arguments {
    cases: u64,
    first: u64,
    keep: Option<PathBuf>,
    belfry: Option<PathBuf>,
    options: Options,
}

fn main() -> ExitCode {
    match arguments() {
        Ok(arguments) => match run(&arguments) {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => {
                eprintln!("error: {error}");
                ExitCode::FAILURE
            }
        },
        Err(error) => {
            eprintln!("error: {error}");
            eprintln!(
                "usage: blind [--cases N] [--seed S] [--first CASE] [--keep DIR] [--structure tower|chimney|shear-building] \
                 [--only KIND|nothing|single|pairs|outside] [--hours H] [--loads even|uneven] \
                 [--belfry PROGRAM]"
            );
            ExitCode::from(2)
        }
    }
}

fn arguments() -> Result<Arguments, String> {
    let options = Options { seed: 1, structure: None, kinds: Kinds::Mix, hours: 12.0, uneven: false };
    let mut read = Arguments { cases: 60, first: 0, keep: None, belfry: None, options };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let value = words.next().ok_or_else(|| format!("{word} needs a value"))?;
        let number = || value.parse::<u64>().map_err(|_| format!("{word} needs a whole number, not {value}"));
        match word.as_str() {
            "--cases" => read.cases = number()?,
            "--first" => read.first = number()?,
            "--seed" => read.options.seed = number()?,
            "--keep" => read.keep = Some(PathBuf::from(value)),
            "--belfry" => read.belfry = Some(PathBuf::from(value)),
            "--structure" => read.options.structure = Some(value),
            "--only" => {
                read.options.kinds = Kinds::named(&value).ok_or_else(|| format!("there is no kind {value}"))?;
            }
            "--hours" => {
                let hours = value.parse().ok().filter(|hours| (0.1..=100.0).contains(hours));
                read.options.hours = hours.ok_or_else(|| format!("{word} needs 0.1 to 100, not {value}"))?;
            }
            "--loads" => match value.as_str() {
                "even" => read.options.uneven = false,
                "uneven" => read.options.uneven = true,
                _ => return Err(format!("{word} needs even or uneven, not {value}")),
            },
            _ => return Err(format!("{word} is no option")),
        }
    }
    Ok(read)
}

fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let beside = std::env::current_exe()?.with_file_name(format!("belfry{}", std::env::consts::EXE_SUFFIX));
    let program = arguments.belfry.clone().unwrap_or(beside);
    if !program.is_file() {
        return Err("belfry is not built; run `cargo build --release` first, or name it with --belfry".into());
    }
    let scratch = tempfile::tempdir()?;
    let folder = arguments.keep.clone().unwrap_or_else(|| scratch.path().to_owned());
    let mut bench = Bench { program, folder, keep: arguments.keep.is_some(), diagnoses: true, leaves_out: true };
    let mut records = Vec::new();
    for index in arguments.first..arguments.first + arguments.cases {
        let case = Case::draw(index, &arguments.options)?;
        let record = bench.run(&case)?;
        println!("{}", line(&record));
        records.push(record);
    }
    print_summary(&records);
    if !bench.diagnoses {
        println!("\nthis belfry has no `diagnose`: the cases were made, identified and compared, and not judged");
    }
    Ok(())
}
