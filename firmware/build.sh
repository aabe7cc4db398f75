#!/usr/bin/env bash
# Builds the program of the sensor-node board (Cortex-M4F) and says where it is; other programs by their names. With BELFRY_STORE=yes it is built
# for a memory chip beside the sensor.
# Uses rustup's target where it is installed (rustup target add thumbv7em-none-eabihf); otherwise Debian's Rust for
# embedded targets (packages rustc-web, cargo-web, rust-web-src), which builds `core` from its source.
set -euo pipefail
cd "$(dirname "$0")/.."

programs=("${@:-belfry-node}")
target=thumbv7em-none-eabihf
profile=firmware
features=()
if [ "${BELFRY_STORE:-}" = yes ]; then
    profile=firmware-store
    features=(--features store)
fi
arguments=(--locked --package belfry-firmware "${programs[@]/#/--bin=}" --profile "$profile" "${features[@]}" --target "$target")

if [ -d "$(rustc --print sysroot)/lib/rustlib/$target" ]; then
    folder=${CARGO_TARGET_DIR:-target}
    cargo build "${arguments[@]}"
else
    if [ ! -x /usr/bin/cargo ] || [ ! -d /usr/lib/rustlib/src ]; then
        echo "error: no Rust for $target. Install it with one of:" >&2
        echo "    rustup target add $target" >&2
        echo "    apt-get install rustc-web cargo-web rust-web-src" >&2
        exit 1
    fi
    folder=${CARGO_TARGET_DIR:-target}/debian
    # The linker is inside whichever toolchain has it; /usr/bin in front makes cargo and rustc Debian's own pair.
    linker=$(dirname "$(find "$(rustc --print sysroot)/lib/rustlib" -name rust-lld | head -n 1)")
    PATH="/usr/bin:$PATH:$linker" RUSTC_BOOTSTRAP=1 RUSTC=/usr/bin/rustc \
        /usr/bin/cargo build -Zbuild-std=core --target-dir "$folder" "${arguments[@]}"
fi
printf '%s\n' "${programs[@]/#/$folder/$target/$profile/}"
