//! A reader types what README.md and the guides in `docs` show: commands run, excerpts are what Belfry prints, links lead somewhere.
//!
//! Each document has a folder of its own, where its blocks of `sh` run line by line, so that later blocks build on earlier ones. A
//! comment above a block says more, see [`markdown::Note`]. Commands that cannot run here are held against the help.

mod commands;
mod excerpt;
mod markdown;

use std::fs;
use std::path::Path;
use std::process::{Output, Stdio};
use std::sync::Mutex;

use belfry_host::study::{STUDY_FILE, Study};
use belfry_tests::{belfry_command, repository, shell};
use commands::{CommandHelp, check_line, without_comment};
use markdown::{Block, Document, Note};

/// Why a block is not run; a document gives one of these reasons and no other.
const REASONS: [&str; 13] = [
    "compiles",
    "opens a browser",
    TAKES_MINUTES,
    "takes half an hour",
    "takes an hour",
    "needs a board",
    "needs a server",
    "needs a server and a board",
    "needs an emulator",
    "needs a nightly compiler",
    "needs other people's data",
    "needs a month of measurement",
    "needs recordings of one's own",
];

/// The reason of blocks that the long tests run all the same.
const TAKES_MINUTES: &str = "takes minutes";

/// Documents whose blocks run at the same time; most commands use two cores themselves.
const AT_ONCE: usize = 2;

/// README.md and the guides.
fn documents() -> Vec<Document> {
    let repository = repository();
    let mut names = vec!["README.md".to_owned()];
    for entry in fs::read_dir(repository.join("docs")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        if name.ends_with(".md") {
            names.push(format!("docs/{name}"));
        }
    }
    names.sort();
    assert!(names.len() > 5, "{names:?}");
    names.iter().map(|name| Document::read(&repository, name)).collect()
}

/// Fails with every fault, a line each.
fn assert_no_faults(faults: &[String]) {
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

#[test]
fn every_command_runs_and_every_excerpt_is_what_it_prints() {
    let waiting = Mutex::new(documents());
    let faults = Mutex::new(Vec::new());
    let next = || waiting.lock().unwrap().pop();
    std::thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                while let Some(document) = next() {
                    let found = run(&document);
                    faults.lock().unwrap().extend(found);
                }
            });
        }
    });
    assert_no_faults(&faults.into_inner().unwrap());
}

/// Runs a document's blocks; what went wrong. A command that fails ends it, because later ones build on it.
fn run(document: &Document) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    let mut printed: Vec<(String, String)> = Vec::new();
    let mut skipped: Vec<String> = Vec::new();
    let mut faults = Vec::new();
    for block in &document.blocks {
        match &block.note {
            _ if is_run(block) => {
                for (line, command) in block.commands() {
                    let command = without_comment(&command);
                    let output = run_line(command, folder.path());
                    if !output.status.success() {
                        let said = String::from_utf8_lossy(&output.stderr).into_owned();
                        faults.push(format!("{}:{line}: {command}: {}\n{said}", document.name, output.status));
                        return faults;
                    }
                    printed.push((command.to_owned(), String::from_utf8_lossy(&output.stdout).into_owned()));
                }
            }
            Some(Note::NotRun(_)) => {
                skipped.extend(block.commands().iter().map(|(_, command)| without_comment(command).to_owned()));
            }
            Some(Note::OutputOf(command)) if skipped.contains(command) => {}
            Some(Note::File(path)) => {
                let file = folder.path().join(path);
                write(&file, block);
                if path.ends_with(STUDY_FILE)
                    && let Err(error) = Study::load(file.parent().unwrap())
                {
                    faults.push(format!("{}:{}: {error}", document.name, block.first_line));
                }
            }
            Some(Note::OutputOf(command)) => match printed.iter().rev().find(|(earlier, _)| earlier == command) {
                None => faults.push(format!("{}:{}: no earlier line is `{command}`", document.name, block.first_line)),
                Some((_, output)) => {
                    for (line, text) in excerpt::lines_not_printed(block, output) {
                        faults.push(format!("{}:{line}: `{command}` does not print: {text}", document.name));
                    }
                }
            },
            _ => {}
        }
    }
    faults
}

/// Whether a block is run: blocks of `sh` without a reason against it; with the long tests also what takes belfry minutes.
fn is_run(block: &Block) -> bool {
    let is_belfry = || block.commands().iter().all(|(_, command)| command.starts_with("belfry "));
    block.language == "sh"
        && match &block.note {
            None => true,
            Some(Note::NotRun(reason)) => cfg!(long_tests) && reason == TAKES_MINUTES && is_belfry(),
            Some(Note::File(_) | Note::OutputOf(_)) => false,
        }
}

/// Runs a line in `folder`; tables are as wide as they are.
fn run_line(line: &str, folder: &Path) -> Output {
    shell(line).env_remove("COLUMNS").current_dir(folder).stdin(Stdio::null()).output().unwrap()
}

fn write(file: &Path, block: &Block) {
    fs::create_dir_all(file.parent().unwrap()).unwrap();
    fs::write(file, block.lines.join("\n") + "\n").unwrap();
}

#[test]
fn what_is_not_run_has_a_known_reason_and_options_that_exist() {
    let help = CommandHelp::new(&repository());
    let mut faults = Vec::new();
    for document in documents() {
        for block in &document.blocks {
            let at = format!("{}:{}", document.name, block.first_line);
            // The tutorial's of Python are run where the module is installed: packaging/try.sh.
            if !["sh", "text", "toml", "csv", "python"].contains(&block.language.as_str()) {
                let found = &block.language;
                faults.push(format!("{at}: a block of sh, text, toml, csv or python is expected, not of {found:?}"));
            }
            if block.language == "toml"
                && let Err(error) = block.lines.join("\n").parse::<toml::Table>()
            {
                faults.push(format!("{at}: {error}"));
            }
            let hides_command =
                |line: &String| ["belfry ", "cargo ", "$ ", "./"].iter().any(|word| line.starts_with(word));
            if block.language != "sh" && block.lines.iter().any(hides_command) {
                faults.push(format!("{at}: commands stand in blocks of sh"));
            }
            let Some(Note::NotRun(reason)) = &block.note else { continue };
            if !REASONS.contains(&reason.as_str()) {
                faults.push(format!("{at}: not run because it {reason:?}: no reason that is known"));
            }
            for (line, command) in block.commands() {
                if let Err(fault) = check_line(&command, &help) {
                    faults.push(format!("{}:{line}: {command}: {fault}", document.name));
                }
            }
        }
        for (line, command) in document.commands_in_prose() {
            if let Err(fault) = check_line(&command, &help) {
                faults.push(format!("{}:{line}: {command}: {fault}", document.name));
            }
        }
    }
    assert_no_faults(&faults);
}

#[test]
fn the_table_of_commands_is_that_of_the_help() {
    let readme = Document::read(&repository(), "README.md");
    let rows = readme.prose.iter().filter_map(|(_, line)| {
        let (name, about) = line.strip_prefix("| `belfry ")?.split_once("` | ")?;
        Some((name.to_owned(), about.trim_end_matches('|').trim().to_owned()))
    });
    let output = belfry_command().arg("--help").output().unwrap();
    let help = String::from_utf8(output.stdout).unwrap();
    let mut commands: Vec<(String, String)> = Vec::new();
    for line in help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty()) {
        match line.strip_prefix("  ") {
            // A description that is longer than a line goes on below itself.
            Some(rest) if rest.starts_with(' ') => commands.last_mut().unwrap().1 += &format!(" {}", rest.trim()),
            Some(rest) => {
                let (name, about) = rest.split_once(' ').unwrap();
                commands.push((name.to_owned(), about.trim().to_owned()));
            }
            None => panic!("{line}"),
        }
    }
    commands.retain(|(name, _)| name != "help");
    assert_eq!(rows.collect::<Vec<_>>(), commands);
}

/// `python3 packaging/notebook.py` makes it; `./test --all` runs it.
#[test]
fn the_notebook_has_the_blocks_of_the_tutorial() {
    let page = Document::read(&repository(), "docs/tutorial.md");
    let is_cell = |block: &&Block| block.note.is_none() && ["python", "sh"].contains(&block.language.as_str());
    let blocks: Vec<String> = page.blocks.iter().filter(is_cell).map(|block| block.lines.join("\n")).collect();
    let text = fs::read_to_string(repository().join("docs/tutorial.ipynb")).unwrap();
    let notebook: serde_json::Value = serde_json::from_str(&text).unwrap();
    let lines = |cell: &serde_json::Value| -> String {
        cell["source"].as_array().unwrap().iter().map(|line| line.as_str().unwrap()).collect()
    };
    let of_code = notebook["cells"].as_array().unwrap().iter().filter(|cell| cell["cell_type"] == "code");
    let cells: Vec<String> = of_code.map(|cell| lines(cell).trim_start_matches("%%sh\n").to_owned()).collect();
    assert!(cells.len() > 8, "{cells:?}");
    assert_eq!(cells, blocks);
}

#[test]
fn the_readme_is_short() {
    let lines = Document::read(&repository(), "README.md").line_count;
    assert!(lines <= 150, "{lines} lines");
}

/// docs/figures.md repeats the record that the tests of the board hold the program against.
#[test]
fn the_figures_of_the_node_are_those_on_record() {
    let read = |name: &str| fs::read_to_string(repository().join(name)).unwrap();
    let page = read("docs/figures.md");
    let record: toml::Table = read("firmware/figures.toml").parse().unwrap();
    let number = |value: &toml::Value| value.as_integer().unwrap() as f64;
    let kilobytes = |what: &str| format!("{:.1} KB", number(&record["bytes"][what]) / 1024.0);
    let core_percent = |rate_hz: &str| number(&record["instructions"]["second"][rate_hz]) / 168e6 * 100.0;
    let segment = |points: &str| {
        let count = number(&record["instructions"]["segment"][points]);
        format!("{} {:03}", (count / 1000.0).floor(), count % 1000.0)
    };
    let segments = ["256", "1024", "2048"].map(segment).join(", ");
    let stated = [
        kilobytes("flash"),
        kilobytes("ram"),
        segments,
        format!("{:.3} %", core_percent("50")),
        format!("{:.2} %", core_percent("1000")),
    ];
    for figure in stated {
        assert!(page.contains(&format!("| {figure}")), "docs/figures.md does not say {figure}");
    }
}

#[test]
fn links_lead_somewhere() {
    let mut faults = Vec::new();
    for document in documents() {
        let folder = document.path.parent().unwrap();
        for (line, target) in document.links() {
            if target.contains("://") {
                continue;
            }
            let (path, heading) = target.split_once('#').unwrap_or((target.as_str(), ""));
            let file = if path.is_empty() { document.path.clone() } else { folder.join(path) };
            if !file.exists() {
                faults.push(format!("{}:{line}: {target} does not exist", document.name));
            } else if !heading.is_empty() && !markdown::headings(&fs::read_to_string(&file).unwrap()).contains(heading)
            {
                faults.push(format!("{}:{line}: {target}: there is no such heading", document.name));
            }
        }
    }
    assert_no_faults(&faults);
}
