//! Which tests can run here: those that lack their data or the emulator are ignored with a reason, never passed.

use std::env;
use std::path::PathBuf;

/// A cfg and the file, beside the repository, that its tests read. These data are other people's and are not copied.
const PUBLISHED: [(&str, &str); 4] = [
    ("canton_data", "canton/system_matrices.mat"),
    ("heritage_court_data", "heritage-court/dherita1.asc"),
    ("footbridge_data", "pedestrian-bridge/SteelPedestrianBridgeExp.mat"),
    ("real_data", "real/weimar-frame/grid.txt"),
];

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    // At the run: clones that share a target folder share this program too.
    let folder = env::var_os("CARGO_MANIFEST_DIR").map_or_else(PathBuf::new, PathBuf::from).join("../../shared");
    for (name, file) in PUBLISHED {
        allow(name, folder.join(file).is_file());
        // A file that is absent would run this again, and compile the tests again, at every call.
        if folder.join(file).is_file() {
            println!("cargo::rerun-if-changed={}", folder.join(file).display());
        }
    }
    // Data that have come since: `./test` lists what there is.
    println!("cargo::rerun-if-env-changed=BELFRY_PUBLISHED");
    // `./test` says whether the emulator is there; otherwise it is looked for once.
    println!("cargo::rerun-if-env-changed=BELFRY_EMULATOR");
    let is_on_path = |program: &str| {
        let path = env::var_os("PATH").unwrap_or_default();
        env::split_paths(&path).any(|folder| folder.join(program).is_file())
    };
    let is_there =
        |variable: &str, program: &str| env::var_os(variable).map_or_else(|| is_on_path(program), |word| word == "yes");
    allow("emulator", is_there("BELFRY_EMULATOR", "qemu-system-arm"));
    // The same of the browser and what drives it.
    println!("cargo::rerun-if-env-changed=BELFRY_BROWSER");
    allow("browser", is_there("BELFRY_BROWSER", "chromedriver"));
    println!("cargo::rerun-if-env-changed=BELFRY_TRACER");
    allow("tracer", is_there("BELFRY_TRACER", "strace"));
    println!("cargo::rerun-if-env-changed=BELFRY_CALCULIX");
    allow("calculix", is_there("BELFRY_CALCULIX", "ccx"));
    println!("cargo::rerun-if-env-changed=BELFRY_NATS");
    allow("nats", is_there("BELFRY_NATS", "nats-server"));
    // `./test --all` says so: the script installs OpenSees for itself, which takes a network.
    println!("cargo::rerun-if-env-changed=BELFRY_OPENSEES");
    allow("opensees", env::var_os("BELFRY_OPENSEES").is_some_and(|word| word == "yes"));
    // `./test --all` sets it.
    println!("cargo::rerun-if-env-changed=BELFRY_LONG_TESTS");
    allow("long_tests", env::var_os("BELFRY_LONG_TESTS").is_some());
}

fn allow(name: &str, is_there: bool) {
    println!("cargo::rustc-check-cfg=cfg({name})");
    if is_there {
        println!("cargo::rustc-cfg={name}");
    }
}
