#!/usr/bin/env bash
# Makes a Python wheel of the module in python/ and of a program that is built: packaging/wheel.sh PROGRAM FOLDER [PROFILE]
#
# The module is compiled with PROFILE (release), which the program should have too, so that both compute the same. One wheel serves all
# Pythons from 3.9. It carries guides and schemas, and the program as a file, not as a function of the module: `belfry serve` starts itself, the program starts in
# milliseconds, and it is the same in all packages. maturin is installed into a virtual environment below the target folder. The wheel's
# path is printed.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(dirname "$here")

usage="usage: packaging/wheel.sh PROGRAM FOLDER [PROFILE]"
program=$(realpath "${1:?"$usage"}") folder=$(realpath -m "${2:?"$usage"}") profile=${3:-release}
target=$(realpath -m "${CARGO_TARGET_DIR:-$root/target}")
environment=$target/wheel/venv
if [ ! -x "$environment/bin/maturin" ]; then
    python3 -m venv "$environment"
    "$environment/bin/python" -m pip install --quiet "maturin==1.16.0"
fi

# maturin takes what lies here for files of the wheel.
data=$root/python/belfry.data
trap 'rm -rf "$data"' EXIT
install -D -m 755 "$program" "$data/scripts/belfry"
! command -v strip >/dev/null || strip --strip-unneeded "$data/scripts/belfry"
"$here/documents.sh" "$data/data/share/doc/belfry"

mkdir -p "$folder"
made=$(mktemp -d "$folder/wheel.XXXXXX")
trap 'rm -rf "$data" "$made"' EXIT
time=${SOURCE_DATE_EPOCH:-$(git -C "$here" log --max-count=1 --format=%ct)}
SOURCE_DATE_EPOCH=$time CARGO_TARGET_DIR=$target "$environment/bin/maturin" build --quiet --manifest-path "$root/python/Cargo.toml" \
    --profile "$profile" --out "$made" >&2
wheel=$(echo "$made"/belfry-*.whl)

# Its name says which C library the module needs; the program must not need a newer one.
needs=$(grep --text --only-matching --extended-regexp 'GLIBC_2\.[0-9]+' "$program" | sort --unique --version-sort | tail -n 1)
says=$(basename "$wheel" | sed -n 's/.*manylinux_2_\([0-9]*\)_.*/GLIBC_2.\1/p')
if [ "$(printf '%s\n' "$needs" "$says" | sort --version-sort | tail -n 1)" != "$says" ]; then
    echo "error: the program needs $needs, and $(basename "$wheel") says ${says:-nothing of it}" >&2
    exit 1
fi
mv "$wheel" "$folder"
echo "$folder/$(basename "$wheel")"
