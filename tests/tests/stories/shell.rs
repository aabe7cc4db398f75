//! A user's shell completes commands and options, and `man` knows them: both are made of the same text as the help.

use std::fs;
use std::io::Write;
use std::process::{Command, Stdio};

use assert_cmd::prelude::*;
use belfry_tests::belfry_command;
use predicates::prelude::*;
use serde_json::Value;

/// Commands that the help lists, but for itself.
fn commands() -> Vec<String> {
    let output = belfry_command().arg("--help").output().unwrap();
    let help = String::from_utf8(output.stdout).unwrap();
    let list = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    let names = list.filter_map(|line| line.strip_prefix("  ")?.split_once(' ')).map(|(name, _)| name.to_owned());
    names.filter(|name| !name.is_empty() && name != "help").collect()
}

fn script(shell: &str) -> String {
    let output = belfry_command().args(["completions", shell]).output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty());
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn every_shell_has_every_command_and_bash_completes_them() {
    let names = commands();
    assert!(names.len() > 20 && names.contains(&"identify".to_owned()), "{names:?}");
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = script(shell);
        assert!(names.iter().all(|name| script.contains(name.as_str())), "{shell}");
        assert!(script.contains("damaged-frames"), "{shell}: options of commands");
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("belfry.bash");
    fs::write(&file, script("bash")).unwrap();
    // What bash does when a user presses the tabulator behind these words.
    let completed = |words: &[&str]| -> Vec<String> {
        let at = words.len() - 1;
        let words = words.iter().map(|word| format!("'{word}'")).collect::<Vec<_>>().join(" ");
        let asked = format!(
            "set -e; source '{}'; COMP_WORDS=({words}); COMP_CWORD={at}; _belfry belfry \"${{COMP_WORDS[{at}]}}\" \"${{COMP_WORDS[{}]}}\"; printf '%s\\n' \"${{COMPREPLY[@]}}\"",
            file.display(),
            at - 1
        );
        let output = Command::new("bash").args(["--norc", "-c", &asked]).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap().split_whitespace().map(str::to_owned).collect()
    };
    assert_eq!(completed(&["belfry", "iden"]), ["identify"]);
    let mut options = completed(&["belfry", "identify", "--dam"]);
    options.sort();
    assert_eq!(options, ["--damaged-frames", "--damping-within"]);
    assert_eq!(completed(&["belfry", "init", "--template", "tur"]), ["turbine"]);
    let unknown = predicate::str::contains("bash").and(predicate::str::contains("zsh"));
    belfry_command().args(["completions", "cmd"]).assert().code(2).stderr(unknown);
}

#[test]
fn the_manual_has_a_page_for_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let pages = folder.path().join("man1");
    belfry_command().arg("man").arg(&pages).assert().success().stdout(predicate::str::contains("pages of the manual"));
    let page = |name: &str| fs::read_to_string(pages.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    for name in commands() {
        let text = page(&format!("belfry-{name}.1"));
        for section in [".SH NAME", ".SH SYNOPSIS", ".SH DESCRIPTION", ".SH OPTIONS"] {
            assert!(text.contains(section), "{name}: {section}");
        }
        assert!(text.starts_with(".ie") || text.starts_with(".TH"), "{name}: {}", text.lines().next().unwrap());
    }
    assert!(page("belfry-archive-check.1").contains("archive"), "steps of a command have pages of their own");
    // A synopsis has the values of options and arguments, and says what may be repeated.
    let collect = page("belfry-collect.1");
    for words in
        ["[\\fB\\-\\-port\\fR\\ \\fI<PORT>\\fR]...", "[\\fB\\-\\-baud\\fR\\ \\fI<BAUD>\\fR]", "<\\fISTUDY\\fR>"]
    {
        assert!(collect.contains(words), "{words}: {collect}");
    }
    let first = page("belfry.1");
    assert!(first.contains("belfry\\-identify(1)") && first.contains("Exit status: 0 done, 1 failed"));
    // The first page is printed where no folder is named.
    let printed = belfry_command().arg("man").output().unwrap();
    assert_eq!(String::from_utf8(printed.stdout).unwrap().trim_end(), first.trim_end());
    let report = belfry_command().args(["man", "--json"]).arg(&pages).output().unwrap();
    let report: Value = serde_json::from_slice(&report.stdout).unwrap();
    assert_eq!(report["files"].as_array().unwrap().len(), fs::read_dir(&pages).unwrap().count());
    // groff, where it is installed, has nothing to warn of.
    let Ok(mut groff) = Command::new("groff")
        .args(["-man", "-Tutf8", "-ww", "-z"])
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
    else {
        return;
    };
    groff.stdin.take().unwrap().write_all(first.as_bytes()).unwrap();
    let output = groff.wait_with_output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
}
