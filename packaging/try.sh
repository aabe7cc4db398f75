#!/usr/bin/env bash
# Installs packages in clean places and tries them there: packaging/try.sh FILE...
#
# A .deb goes into an empty root with a package database of its own, an archive into an empty folder, a wheel into a virtual environment of
# python3 (or of what BELFRY_PYTHON names). The program then runs without this computer's settings: a study is made, simulated, identified
# and looked at, and the manual, completions and guides are where they belong. Of a wheel the tests in python/tests are run, its types are checked,
# and the tutorial is run as a notebook.
set -euo pipefail
repository=$(cd "$(dirname "$0")/.." && pwd)

run_in() { env --ignore-environment PATH=/usr/bin:/bin HOME="$1" LANG=C.UTF-8 "${@:2}"; }

# The story of a study in an empty home.
story() {
    local belfry=$1 home=$2
    run_in "$home" "$belfry" --version
    (
        cd "$home"
        run_in "$home" "$belfry" init canton --template canton >/dev/null
        run_in "$home" "$belfry" simulate canton --effect added-mass@443.6m=2e6 --hours 0.5 --adopt >/dev/null
        run_in "$home" "$belfry" look canton >/dev/null
        run_in "$home" "$belfry" identify canton --direct --json >modes.json 2>/dev/null
        run_in "$home" "$belfry" report canton >/dev/null
        grep --quiet '"frequency_hz"' modes.json
        test -s canton/results/report.html
    )
}

# Guides and schemas below share/doc; what a guide links to is there.
documents() {
    local documents=$1/doc/belfry file
    for file in README.md tutorial.md formats.md schema/identify-1.json schema/error-1.json; do
        test -s "$documents/$file" || { echo "error: the package lacks $documents/$file" >&2; return 1; }
    done
    for file in "$documents"/*.md; do
        links "$file"
    done
}

# Links of a text lead to files beside it, or to the web.
links() {
    local file=$1 target
    # Between back quotes brackets are code.
    sed 's/`[^`]*`//g' "$file" | { grep --only-matching ']([^)]*)' || true; } | sed 's/^](//; s/)$//; s/#.*//' | while read -r target; do
        case $target in
            '' | http:* | https:* | mailto:*) ;;
            *) test -e "$(dirname "$file")/$target" || { echo "error: $file links to $target, which the package lacks" >&2; return 1; } ;;
        esac
    done
}

# What a package installs beside the program.
files() {
    local share=$1 name
    documents "$share"
    for name in identify diagnose look; do
        gzip --decompress --stdout "$share/man/man1/belfry-$name.1.gz" | grep --quiet "belfry.*$name"
    done
    bash -n "$share/bash-completion/completions/belfry"
    test -s "$share/zsh/vendor-completions/_belfry" && test -s "$share/fish/vendor_completions.d/belfry.fish"
}

# The module and the program of a wheel.
wheel() {
    local file=$1 place=$2 bin=$2/venv/bin
    "${BELFRY_PYTHON:-python3}" -m venv "$place/venv"
    "$bin/python" -m pip install --quiet "$file"
    # Nothing but what it asks for.
    (cd "$place" && run_in "$place/home" "$bin/python" -c 'import belfry; print("module", belfry.__version__)')
    story "$bin/belfry" "$place/home"
    documents "$place/venv/share"
    "$bin/python" -m pip install --quiet --requirement "$repository/python/tests/requirements.txt"
    (
        cd "$place"
        run_in "$place/home" "$bin/python" -m mypy --strict --package belfry
        run_in "$place/home" "$bin/python" -m pytest --quiet --config-file "$repository/python/pyproject.toml" "$repository/python/tests"
        run_in "$place/home" "$bin/python" "$repository/packaging/notebook.py" --run
    )
    "$bin/python" -m pip uninstall --quiet --yes belfry
    test ! -e "$bin/belfry" && test ! -e "$place/venv/share/doc/belfry/README.md" && test ! -e "$place"/venv/lib/python*/site-packages/belfry
}

for file in "$@"; do
    place=$(mktemp -d)
    trap 'rm -rf "$place"' EXIT
    mkdir "$place/home"
    case $file in
        *.deb)
            root=$place/root
            mkdir -p "$root/var/lib/dpkg/info" "$root/var/lib/dpkg/updates" "$root/var/lib/dpkg/triggers"
            touch "$root/var/lib/dpkg/status" "$root/var/lib/dpkg/available"
            # Its only dependencies are those of every program in C, which this root does not have.
            dpkg --root="$root" --force-depends --force-not-root --force-script-chrootless --log=/dev/null --install "$file" >/dev/null 2>"$place/said" \
                || { cat "$place/said" >&2; exit 1; }
            dpkg --root="$root" --verify belfry
            test -s "$root/usr/lib/udev/rules.d/70-belfry.rules"
            story "$root/usr/bin/belfry" "$place/home"
            files "$root/usr/share"
            dpkg --root="$root" --force-not-root --force-script-chrootless --log=/dev/null --purge belfry >/dev/null 2>&1
            test ! -e "$root/usr/bin/belfry"
            ;;
        *.tar.gz)
            tar --extract --gzip --file "$file" --directory "$place" --strip-components 1
            story "$place/belfry" "$place/home"
            files "$place/share"
            links "$place/README.md"
            ;;
        *.whl)
            wheel "$file" "$place"
            ;;
        *)
            echo "error: $file: expected .deb, .tar.gz or .whl" >&2
            exit 2
            ;;
    esac
    rm -rf "$place"
    trap - EXIT
    echo "$file: installed and tried"
done
