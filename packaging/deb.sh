#!/usr/bin/env bash
# Makes a Debian package of a program that is built: packaging/deb.sh PROGRAM FOLDER
#
# The package is FOLDER/belfry_VERSION_ARCHITECTURE.deb; its name is printed.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)

program=${1:?"usage: packaging/deb.sh PROGRAM FOLDER"} folder=${2:?"usage: packaging/deb.sh PROGRAM FOLDER"}
version=$("$program" --version | cut -d ' ' -f 2)
architecture=$(dpkg --print-architecture)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$here/stage.sh" "$program" "$work/belfry"

# The newest symbol of the C library that the program asks for: an older library would refuse to start it.
glibc=$(grep --text --only-matching --extended-regexp 'GLIBC_2\.[0-9]+' "$work/belfry/usr/bin/belfry" | sort --unique --version-sort | tail -n 1)
size=$(du --summarize --block-size=1024 "$work/belfry" | cut -f 1)
mkdir "$work/belfry/DEBIAN"
cat >"$work/belfry/DEBIAN/control" <<END
Package: belfry
Version: $version
Architecture: $architecture
Maintainer: The Belfry maintainers <belfry@localhost>
Installed-Size: $size
Depends: libc6 (>= ${glibc#GLIBC_}), libgcc-s1
Suggests: chromium
Section: science
Priority: optional
Description: vibration of tall structures, and what a model of them lacks
 Belfry turns accelerations of towers, chimneys, masts and buildings into modes,
 each value with its uncertainty, compares them with a finite element model, and
 names the physical effect that the model lacks. It reads recordings of other
 systems, and collects from its own sensor nodes over serial lines.
END
# Ports that are there already get the rules as well.
cat >"$work/belfry/DEBIAN/postinst" <<'END'
#!/bin/sh
set -e
if [ "$1" = configure ] && [ -z "${DPKG_ROOT:-}" ] && [ -d /run/udev ] && command -v udevadm >/dev/null; then
    udevadm control --reload-rules || true
    udevadm trigger --subsystem-match=tty --subsystem-match=usb || true
fi
END
chmod 755 "$work/belfry/DEBIAN/postinst"
(cd "$work/belfry" && find usr -type f -print0 | sort --zero-terminated | xargs --null md5sum) >"$work/belfry/DEBIAN/md5sums"

mkdir -p "$folder"
package=$folder/belfry_${version}_$architecture.deb
# The same files give the same package: their time is that of the last commit.
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git -C "$here" log --max-count=1 --format=%ct)}
export SOURCE_DATE_EPOCH
dpkg-deb --root-owner-group --build "$work/belfry" "$package" >/dev/null
echo "$package"
