//! A program reads what commands print with --json, and what they write into `results`: every object names its schema, `docs/schema` has it, and
//! the object is as it says.
//!
//! `python3 tests/schema.py` widens a schema for an object that has more; a key that goes, or that means something else, takes a new version.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use belfry_tests::{belfry_command, repository, schema};
use serde_json::Value;

/// The files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

/// What stands in quotes behind some words of the program's source.
fn named(text: &str, words: &[&str], names: &mut BTreeSet<String>) {
    for word in words {
        let named = text.split(word).skip(1).filter_map(|rest| rest.trim_start().strip_prefix('"')?.split('"').next());
        names.extend(named.map(str::to_owned));
    }
}

#[test]
fn every_object_has_a_schema_and_every_schema_an_object() {
    let mut names = BTreeSet::new();
    let read = |path: &Path| fs::read_to_string(path).unwrap();
    for file in files(&repository().join("host/src/command")) {
        // `console.json("name-1", ...)`
        named(&read(&file), &[".json(", ".json_line(", "const FAILURE: &str ="], &mut names);
    }
    // `(MODES_FILE, "name-1")`
    named(&read(&repository().join("host/src/results/mod.rs")), &["_FILE,"], &mut names);
    let kept: BTreeSet<String> = files(&schema::folder())
        .into_iter()
        .filter(|file| file.extension().is_some_and(|ending| ending == "json"))
        .map(|file| file.file_stem().unwrap().to_str().unwrap().to_owned())
        .collect();
    assert!(names.len() > 35, "{names:?}");
    assert_eq!(names, kept);
    for name in kept {
        let text = fs::read_to_string(schema::folder().join(format!("{name}.json"))).unwrap();
        let schema: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(
            (&schema["$id"], &schema["properties"]["schema"]["const"]),
            (&format!("{name}.json").into(), &name.as_str().into())
        );
        let version = name.rsplit_once('-').unwrap().1;
        assert!(version.parse::<u32>().is_ok(), "{name}: a version");
    }
}

/// Runs a command in `folder`, and holds the object that it prints against its schema.
fn object(folder: &Path, words: &str) -> Value {
    let output = belfry_command()
        .args(words.split(' '))
        .arg("--json")
        .env("BELFRY_KEYS", folder.join("keys.toml"))
        .current_dir(folder)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let value: Value =
        serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{words}: {error}\n{said}"));
    let faults = schema::faults(&value);
    assert!(faults.is_empty(), "{words}:\n{}", faults.join("\n"));
    assert_eq!(output.status.success(), value["schema"] != "error-1", "{words}: {said}");
    value
}

/// The story of a study, each step as a program takes it.
#[test]
fn what_commands_print_is_as_their_schemas_say() {
    let folder = tempfile::tempdir().unwrap();
    let mut seen = BTreeSet::new();
    for words in [
        "init canton --template canton",
        "init canton",
        "simulate canton --effect added-mass@443.6m=2e6 --hours 0.7 --adopt",
        "look canton",
        "identify canton --direct",
        "compare canton",
        "update canton",
        "covalidate canton --direct",
        "diagnose canton",
        "profile canton",
        "add canton added-mass@443.6m",
        "history canton",
        "compare canton",
        "diagnose canton",
        "profile canton",
        "remove canton added-mass@443.6m",
        "plan canton --effect base-rotation=7.2e-15 --hours 1",
        "change canton --before canton/results/modes.json",
        "watch canton --every 15min --once",
        "export canton",
        "export canton --of model",
        "export canton --of animation --mode 1 --output mode-1.gif",
        "export canton --of psd --direct",
        "report canton",
        "effects",
        "effects base-rotation",
        "ports",
        "key new 7 --output key.bin",
        "key list",
        "completions bash",
        "man",
        "man pages",
        "archive check canton",
    ] {
        seen.insert(object(folder.path(), words)["schema"].as_str().unwrap().to_owned());
    }
    let mut results = BTreeSet::new();
    for file in files(&folder.path().join("canton/results")) {
        let text = || fs::read_to_string(&file).unwrap();
        let objects: Vec<String> = match file.extension().and_then(|ending| ending.to_str()) {
            Some("json") => vec![text()],
            Some("jsonl") => text().lines().map(str::to_owned).collect(),
            _ => continue,
        };
        for object in objects {
            let faults = schema::faults(&serde_json::from_str(&object).unwrap());
            assert!(faults.is_empty(), "{}:\n{}", file.display(), faults.join("\n"));
        }
        results.insert(file.file_name().unwrap().to_str().unwrap().to_owned());
    }
    assert!(results.len() >= 17, "{results:?}");
    // What takes nodes: the stories of collecting and of the demo hold theirs against the schemas.
    assert!(seen.len() >= 24, "{seen:?}");
}
