//! End-to-end tests of Belfry live in `tests/tests`, one file per story a user would tell; here is what they share.

pub mod blind;
mod canton;
pub mod clock;
mod footbridge;

pub use canton::{CantonRun, canton_data, run_canton};
pub use footbridge::{FOOTBRIDGE_STIFFNESS, footbridge_data, write_footbridge_study};

use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

/// The `belfry` program of this workspace as a command to run, built beforehand in the profile the tests have.
///
/// Cargo builds a package's own programs for its tests, but not those of another package; a `belfry` that happens to lie
/// in the target folder may be an old one.
///
/// # Panics
/// When the program cannot be built; the test has nothing to test then.
pub fn belfry_command() -> Command {
    static PROGRAM: LazyLock<PathBuf> = LazyLock::new(build);
    Command::new(&*PROGRAM)
}

/// Builds the program into the folder that this test runs from and returns its path.
fn build() -> PathBuf {
    // <target folder>/<profile>/deps/<test>
    let test = env::current_exe().expect("a test knows its own path");
    let profile_folder = test.parent().and_then(Path::parent).expect("a test stands in <target>/<profile>/deps");
    let target_folder = profile_folder.parent().expect("a profile's folder stands in the target folder");
    let profile = match profile_folder.file_name().and_then(|name| name.to_str()) {
        Some("debug") | None => "dev",
        Some(profile) => profile,
    };
    let cargo = env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let built = Command::new(cargo)
        .args(["build", "--quiet", "--package", "belfry-host", "--bin", "belfry", "--profile", profile])
        .arg("--target-dir")
        .arg(target_folder)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .status()
        .expect("cargo can be run");
    assert!(built.success(), "belfry cannot be built: {built}");
    profile_folder.join(format!("belfry{}", env::consts::EXE_SUFFIX))
}
