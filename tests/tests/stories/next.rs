//! A user types what the commands say comes next: every such line can be run as it stands.

use std::collections::{BTreeSet, VecDeque};

use belfry_tests::shell;

/// The lines below "Next:" in what a command prints.
fn next_lines(said: &str) -> Vec<String> {
    let mut lines = Vec::new();
    let mut is_next = false;
    for line in said.lines() {
        let first = line.strip_prefix("Next:");
        is_next = first.is_some() || (is_next && line.starts_with("      belfry "));
        if is_next {
            lines.push(first.unwrap_or(line).trim().to_owned());
        }
    }
    lines
}

#[test]
fn every_line_that_comes_next_can_be_run() {
    let parent = tempfile::tempdir().unwrap();
    // As awkward a name as a folder can have.
    let folder = parent.path().join("my tower's $HOME");
    let quoted = format!("\"{}\"", folder.display().to_string().replace('$', "\\$"));
    let mut typed = BTreeSet::new();
    let mut waiting = VecDeque::from([format!("belfry init {quoted} --template canton"), "belfry effects".to_owned()]);
    while let Some(line) = waiting.pop_front() {
        if !typed.insert(line.clone()) {
            continue;
        }
        let output = shell(&line).output().unwrap();
        let said = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success(), "{line}\n{said}\n{}", String::from_utf8_lossy(&output.stderr));
        waiting.extend(next_lines(&said));
        if line.contains("belfry simulate") {
            // The line's own recording has nothing that the model lacks; this one has.
            let other = format!("belfry simulate {quoted} --effect base-rotation=7.21e-15 --adopt --force");
            assert!(shell(&other).output().unwrap().status.success());
        }
    }
    for command in ["simulate", "identify", "compare", "update", "covalidate", "diagnose", "add", "history", "effects"]
    {
        assert!(typed.iter().any(|line| line.contains(&format!("belfry {command}"))), "{command}: {typed:#?}");
    }
}
