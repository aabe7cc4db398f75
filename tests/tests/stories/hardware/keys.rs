//! A board with a key in its flash.

use std::path::{Path, PathBuf};

use belfry_shared::message::FaultKind;
use belfry_shared::seal::Key;
use belfry_tests::belfry_command;
use serde_json::Value;

use super::emulator::{Board, assert_same_bits, belfry, program};

/// A board in whose flash an image lies.
fn board_with(image: &Path) -> Board {
    let loader = format!("loader,file={},addr=0x08060000,force-raw=on", image.display());
    Board::run(&program("belfry-node"), &["-device", &loader]).0
}

fn with_keys(keys: &Path, arguments: &[&str]) -> (bool, Value, String) {
    let output = belfry_command().env("BELFRY_KEYS", keys).args(arguments).arg("--json").output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    (output.status.success(), serde_json::from_slice(&output.stdout).unwrap_or(Value::Null), said)
}

#[test]
#[cfg_attr(not(emulator), ignore = "needs qemu-system-arm and a compiler for the board")]
fn a_board_with_a_key_measures_for_who_has_it_and_for_nobody_else() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| -> PathBuf { folder.path().join(name) };
    let (keys, image, study) = (path("keys"), path("node.key"), path("tower"));
    let (done, _, said) = with_keys(&keys, &["key", "new", "1", "--output", image.to_str().unwrap()]);
    assert!(done, "{said}");
    let study = study.to_str().unwrap();
    assert!(belfry(&["init", study, "--template", "canton"]).0);
    assert!(belfry(&["simulate", study, "--hours", "0.25", "--seed", "3", "--adopt"]).0);
    let board = board_with(&image);
    let replay = ["replay", study, "--nodes", "1", "--port", &board.line()];
    let (done, _, said) = with_keys(&path("none"), &replay);
    assert!(!done && said.contains("node 1 has a key, and this computer does not have it"), "{said}");
    let (done, _, said) =
        with_keys(&path("others"), &["key", "new", "1", "--output", path("other.key").to_str().unwrap()]);
    assert!(done, "{said}");
    let (done, _, said) = with_keys(&path("others"), &replay);
    assert!(!done && said.contains("node 1 has another key"), "{said}");
    let (done, report, said) = with_keys(&keys, &replay);
    assert!(done, "{said}");
    assert_same_bits(&report, 1);
}

#[test]
#[cfg_attr(not(emulator), ignore = "needs qemu-system-arm and a compiler for the board")]
fn a_board_with_another_nodes_key_says_so_and_obeys_nobody() {
    let folder = tempfile::tempdir().unwrap();
    let image = folder.path().join("node.key");
    std::fs::write(&image, Key::new([7; 32]).image(2)).unwrap();
    let board = board_with(&image);
    let hello = board.hello();
    assert!(hello.counters.is_some() && hello.fault.is_some_and(|fault| fault.kind == FaultKind::Key));
}
