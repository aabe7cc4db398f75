//! The program itself. Because this test is in its package, cargo builds `belfry` together with all other tests.

use std::process::Command;

#[test]
fn the_program_says_its_version() {
    let output = Command::new(env!("CARGO_BIN_EXE_belfry")).arg("--version").output().unwrap();
    assert!(output.status.success());
    assert_eq!(String::from_utf8(output.stdout).unwrap().trim(), concat!("belfry ", env!("CARGO_PKG_VERSION")));
}
