//! What a command has written is on the disk before it has its name, and the name before the command goes on: asked of the system
//! calls that it makes.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Command;

use assert_cmd::prelude::*;
use belfry_tests::belfry_command;

/// What a program does with the files of a folder, in its order.
#[derive(Debug, PartialEq, Eq)]
enum Call {
    /// Opened to be written, and how.
    Opened {
        path: String,
        flags: String,
    },
    Wrote {
        path: String,
    },
    Synced {
        path: String,
    },
    Renamed {
        from: String,
        to: String,
    },
}

/// The calls of a command on files in a folder.
fn calls(command: &Command, folder: &Path) -> Vec<Call> {
    let trace = tempfile::NamedTempFile::new().unwrap();
    let filter = "trace=openat,write,writev,pwrite64,fsync,fdatasync,rename,renameat,renameat2";
    let mut strace = Command::new("strace");
    // One line a call, whatever other threads do; paths whole, and those of open files too.
    strace.args(["--follow-forks", "--decode-fds=path", "--string-limit=4096", "--successful-only"]);
    strace.arg("-e").arg(filter).arg("-o").arg(trace.path()).arg(command.get_program()).args(command.get_args());
    strace.envs(command.get_envs().filter_map(|(name, value)| Some((name, value?))));
    strace.assert().success();
    let text = fs::read_to_string(trace.path()).unwrap();
    let folder = fs::canonicalize(folder).unwrap();
    let within = |path: &str| path.starts_with(folder.to_str().unwrap());
    text.lines().filter_map(call).filter(|call| within(call.path())).collect()
}

/// A line such as `7 fsync(5</tmp/file>) = 0`.
fn call(line: &str) -> Option<Call> {
    let (head, rest) = line.split_once('(')?;
    let open_file = || Some(rest.split_once('<')?.1.split_once('>')?.0.to_owned());
    let quoted: Vec<String> = rest.split('"').skip(1).step_by(2).map(str::to_owned).collect();
    match (head.split_whitespace().last()?, quoted.as_slice()) {
        ("openat", [path]) if rest.contains("O_WRONLY") || rest.contains("O_RDWR") => {
            let flags = rest.rsplit('"').next()?.to_owned();
            Some(Call::Opened { path: path.clone(), flags })
        }
        ("write" | "writev" | "pwrite64", _) => Some(Call::Wrote { path: open_file()? }),
        ("fsync" | "fdatasync", _) => Some(Call::Synced { path: open_file()? }),
        ("rename" | "renameat" | "renameat2", [from, to]) => Some(Call::Renamed { from: from.clone(), to: to.clone() }),
        _ => None,
    }
}

impl Call {
    fn path(&self) -> &str {
        match self {
            Self::Opened { path, .. } | Self::Wrote { path } | Self::Synced { path } => path,
            Self::Renamed { to, .. } => to,
        }
    }
}

/// Asserts that files got their names once they were on the disk, and that nothing was written under a name that stays; the names,
/// without their folders.
fn assert_durable(calls: &[Call]) -> BTreeSet<String> {
    let mut renamed = BTreeSet::new();
    for (at, call) in calls.iter().enumerate() {
        let (before, after) = (&calls[..at], &calls[at + 1..]);
        match call {
            Call::Renamed { from, to } => {
                let touches =
                    |call: &&Call| matches!(call, Call::Wrote { path } | Call::Synced { path } if path == from);
                let last = before.iter().rfind(touches);
                assert_eq!(last, Some(&Call::Synced { path: from.clone() }), "{to} got its name too early");
                let folder = Path::new(to).parent().unwrap().to_str().unwrap();
                let next = after.first();
                assert_eq!(
                    next,
                    Some(&Call::Synced { path: folder.to_owned() }),
                    "the name of {to} is not on the disk"
                );
                renamed.insert(Path::new(to).file_name().unwrap().to_str().unwrap().to_owned());
            }
            Call::Wrote { path } => assert!(path.ends_with(".partial"), "{path} is written in place"),
            Call::Opened { path, flags } => {
                assert!(!flags.contains("O_TRUNC"), "{path} is emptied before it is written");
            }
            Call::Synced { .. } => {}
        }
    }
    renamed
}

#[test]
#[cfg_attr(not(tracer), ignore = "strace is not installed, or may not trace here; ./test installs it")]
fn what_a_command_has_written_is_on_the_disk_before_it_has_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let study = folder.path().join("canton");
    let belfry = |words: &[&str]| {
        let mut command = belfry_command();
        command.arg(words[0]).arg(&study).args(&words[1..]);
        command
    };
    let durable = |words: &[&str], files: &[&str]| {
        let written = assert_durable(&calls(&belfry(words), folder.path()));
        for file in files {
            assert!(written.contains(*file), "{words:?} did not write {file} aside: {written:?}");
        }
    };
    durable(&["init", "--template", "canton"], &["study.toml"]);
    let effect = ["--effect", "base-rotation=1.2e-14", "--hours", "0.5", "--seed", "5", "--adopt"];
    durable(&[&["simulate"], &effect[..]].concat(), &["study.toml"]);
    durable(&["identify", "--direct"], &["modes.json", "spectra.json", "mode_shapes.svg"]);
    durable(&["compare"], &["comparison.json", "comparison.svg"]);
    durable(&["update"], &["update.json", "stiffness_updated.npy", "stiffness_updated.mtx", "mass.mtx"]);
    durable(&["add", "base-rotation=1e-14"], &["study.toml", "history.jsonl"]);
    durable(&["diagnose", "--without", "added-mass"], &["diagnosis.json", "inputs.json"]);
    durable(&["report"], &["report.html"]);
    durable(&["export", "--of", "modes"], &["modes.csv"]);
}
