#!/usr/bin/env bash
# Lays out what a package of Belfry has to read: packaging/documents.sh FOLDER
#
# The guides of docs/ and the schemas of the JSON that commands print, with the package's own README.md. Links to files that only the
# repository has become their text.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)

folder=${1:?"usage: packaging/documents.sh FOLDER"}
install -d -m 755 "$folder" "$folder/schema"
install -m 644 "$here"/../docs/*.md "$here"/../docs/*.svg "$here"/../docs/*.ipynb "$folder"
install -m 644 "$here"/../docs/schema/*.json "$folder/schema"
sed --in-place --null-data 's#\[\([^]]*\)\](\.\./[^)]*)#\1#g' "$folder"/*.md
# Here the README.md stands beside the guides, in the archive above them.
sed 's#(share/doc/belfry/#(#g' "$here/README.md" >"$folder/README.md"
chmod 644 "$folder/README.md"
