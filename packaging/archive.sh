#!/usr/bin/env bash
# Makes the archive that `cargo binstall` fetches, of a program that is built: packaging/archive.sh PROGRAM FOLDER
#
# The archive is FOLDER/belfry-VERSION-TARGET.tar.gz; its name is printed.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)

program=${1:?"usage: packaging/archive.sh PROGRAM FOLDER"} folder=${2:?"usage: packaging/archive.sh PROGRAM FOLDER"}
version=$("$program" --version | cut -d ' ' -f 2)
target=$(rustc --print host-tuple 2>/dev/null || rustc --version --verbose | sed -n 's/^host: //p')
name=belfry-$version-$target
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$here/stage.sh" "$program" "$work/stage"
mkdir "$work/$name"
cp "$work/stage/usr/bin/belfry" "$here"/../LICENSE* "$here/../CHANGELOG.md" "$here/README.md" "$here/70-belfry.rules" "$work/$name"
cp -r "$work/stage/usr/share" "$work/$name/share"

mkdir -p "$folder"
time=${SOURCE_DATE_EPOCH:-$(git -C "$here" log --max-count=1 --format=%ct)}
tar --create --directory "$work" --sort=name --owner=0 --group=0 --numeric-owner --mtime="@$time" "$name" \
    | gzip --best --no-name >"$folder/$name.tar.gz"
echo "$folder/$name.tar.gz"
