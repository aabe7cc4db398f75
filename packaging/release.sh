#!/usr/bin/env bash
# Makes everything that a release consists of from a tag: packaging/release.sh [TAG] [FOLDER]
#
# TAG is v and the version of Cargo.toml; without one it is the tag of this commit. The program is built in a clone of the tag, so that
# nothing of this folder that was not committed is in it. FOLDER (release) then holds the archive for `cargo binstall`, the .deb, the Python
# wheel and their checksums; each was installed in a clean place and tried.
set -euo pipefail
cd "$(dirname "$0")/.."

tag=${1:-$(git describe --tags --exact-match 2>/dev/null || true)}
folder=$(realpath -m "${2:-release}")
if [ -z "$tag" ]; then
    echo "error: this commit has no tag; name one, such as v0.1.0" >&2
    exit 2
fi
git rev-parse --quiet --verify "refs/tags/$tag" >/dev/null || { echo "error: there is no tag $tag" >&2; exit 1; }

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
git -c advice.detachedHead=false clone --quiet --branch "$tag" --depth 1 "file://$PWD" "$work/belfry"
cd "$work/belfry"
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)
[ "$tag" = "v$version" ] || { echo "error: the tag is $tag, and Cargo.toml says version $version" >&2; exit 1; }
grep "^## $version " CHANGELOG.md | grep --quiet --invert-match unreleased || { echo "error: CHANGELOG.md has no section \"## $version (date)\"" >&2; exit 1; }

SOURCE_DATE_EPOCH=$(git log --max-count=1 --format=%ct)
export SOURCE_DATE_EPOCH
cargo build --release --locked --package belfry-host
program=${CARGO_TARGET_DIR:-target}/release/belfry
mkdir -p "$folder"
packages=("$(packaging/archive.sh "$program" "$folder")")
! command -v dpkg-deb >/dev/null || packages+=("$(packaging/deb.sh "$program" "$folder")")
packages+=("$(packaging/wheel.sh "$program" "$folder")")
packaging/try.sh "${packages[@]}"
(cd "$folder" && sha256sum "${packages[@]##*/}" >SHA256SUMS && cat SHA256SUMS)
