//! What a command says to a program.

use assert_cmd::prelude::*;
use belfry_tests::belfry_command;
pub(crate) use belfry_tests::schema::sound;
use serde_json::Value;

/// The JSON of a command that succeeds.
pub(crate) fn json(arguments: &[&str]) -> Value {
    let output = belfry_command().args(arguments).arg("--json").assert().success().get_output().stdout.clone();
    sound(serde_json::from_slice(&output).expect("standard output is one JSON object"))
}
