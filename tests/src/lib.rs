//! End-to-end tests of Belfry live in `tests/tests/stories`, a module a story that a user would tell; here is what they share with
//! the studies of accuracy, which `cargo run --release -p belfry-tests -- help` lists.

pub mod archive;
pub mod blind;
pub mod cable;
pub mod campaign;
mod canton;
pub mod clock;
#[cfg(unix)]
pub mod fleet;
mod footbridge;
mod frames;
pub mod fuzz;
#[cfg(unix)]
pub mod live;
pub mod nats;
mod npy;
pub mod post;
pub mod records;
pub mod schema;
mod spectral;
mod statistics;
pub mod years;

pub use canton::{CantonRun, run_canton};
pub use footbridge::{FOOTBRIDGE_STIFFNESS, write_footbridge_study};
pub use frames::{Frame, write_frame_study};

use std::env;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

/// This repository's folder.
///
/// # Panics
/// When it has gone since the tests were compiled.
pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("..")
        .canonicalize()
        .expect("the folder was there when this was compiled")
}

/// A folder of other people's data, beside the repository in `../shared`; they are read there and never copied.
///
/// # Panics
/// When it is not there; a test that needs it is ignored then, see `build.rs`.
pub fn published(name: &str) -> PathBuf {
    find_published(name).unwrap_or_else(|| panic!("../shared/{name} is not there"))
}

/// As [`published`], `None` where it is not there.
pub fn find_published(name: &str) -> Option<PathBuf> {
    repository().join("../shared").join(name).canonicalize().ok()
}

/// A folder in memory where the system has one: every window is on the disk before the next is taken, and a disk that others keep busy
/// makes minutes of that.
///
/// # Errors
/// When no folder can be made.
pub fn folder_in_memory() -> io::Result<tempfile::TempDir> {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir())
}

/// The `belfry` program of this workspace as a command to run, built beforehand in the profile the tests have.
///
/// Cargo builds a package's own programs for its tests, but not those of another package; a `belfry` that happens to lie
/// in the target folder may be an old one. `./test`, which has just built it, names it in `BELFRY_PROGRAM`.
///
/// # Panics
/// When the program cannot be built; the test has nothing to test then.
pub fn belfry_command() -> Command {
    static PROGRAM: LazyLock<PathBuf> =
        LazyLock::new(|| env::var_os("BELFRY_PROGRAM").map_or_else(build, PathBuf::from));
    let mut command = Command::new(&*PROGRAM);
    command.env("BELFRY_KEYS", no_keys());
    command
}

/// A file of keys that is not there: the keys of whoever runs the tests belong to other nodes.
fn no_keys() -> PathBuf {
    env::temp_dir().join("belfry-tests-have-no-keys")
}

/// A line as a user types it into a shell, with this workspace's `belfry` in front on the path.
///
/// # Panics
/// As [`belfry_command`].
pub fn shell(line: &str) -> Command {
    let belfry = belfry_command();
    let mut folders: Vec<PathBuf> =
        Path::new(belfry.get_program()).parent().map(Path::to_path_buf).into_iter().collect();
    folders.extend(env::split_paths(&env::var_os("PATH").unwrap_or_default()));
    let mut command = Command::new("sh");
    command.args(["-e", "-c", line]).env("PATH", env::join_paths(folders).expect("the path was one before"));
    command.env("BELFRY_KEYS", no_keys());
    command
}

/// Builds the program into the folder that this program runs from and returns its path.
fn build() -> PathBuf {
    // <target folder>/<profile>/deps/<test>, or <target folder>/<profile>/studies
    let program = env::current_exe().expect("a program knows its own path");
    let folder = program.parent().expect("a program stands in a folder");
    let profile_folder = if folder.ends_with("deps") { folder.parent().unwrap_or(folder) } else { folder };
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
