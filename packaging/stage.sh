#!/usr/bin/env bash
# Lays out what a package of Belfry installs, from a program that is built: packaging/stage.sh PROGRAM FOLDER
#
# Program, manual, completions, guides, licences and the rules that let users at this computer talk to nodes, below FOLDER/usr.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)

program=${1:?"usage: packaging/stage.sh PROGRAM FOLDER"} folder=${2:?"usage: packaging/stage.sh PROGRAM FOLDER"}
usr=$folder/usr
install -D -m 755 "$program" "$usr/bin/belfry"
! command -v strip >/dev/null || strip --strip-unneeded "$usr/bin/belfry"
belfry=$usr/bin/belfry

mkdir -p "$usr/share/man/man1"
"$belfry" man "$usr/share/man/man1" >/dev/null
gzip --best --no-name "$usr"/share/man/man1/*.1

completion() { mkdir -p "$(dirname "$usr/share/$2")" && "$belfry" completions "$1" >"$usr/share/$2"; }
completion bash bash-completion/completions/belfry
completion zsh zsh/vendor-completions/_belfry
completion fish fish/vendor_completions.d/belfry.fish

install -D -m 644 "$here/70-belfry.rules" "$usr/lib/udev/rules.d/70-belfry.rules"
documents=$usr/share/doc/belfry
"$here/documents.sh" "$documents"
install -D -m 644 "$here/../LICENSE" "$documents/copyright"
install -m 644 "$here/../LICENSE-MIT" "$here/../LICENSE-APACHE" "$documents"
gzip --best --no-name --stdout "$here/../CHANGELOG.md" >"$documents/changelog.gz"
find "$folder" -type d -exec chmod 755 {} +
find "$usr/share" -type f -exec chmod 644 {} +
