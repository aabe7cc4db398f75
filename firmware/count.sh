#!/usr/bin/env bash
# Counts the instructions of spectra and of the whole node, in the emulator (Debian's qemu-system-arm), where an instruction
# takes exactly 1 ns. Counts repeat exactly. Builds belfry-count, or runs the one at the path that is given.
set -euo pipefail
cd "$(dirname "$0")/.."
program=${1:-$(firmware/build.sh belfry-count)}
exec timeout 900 qemu-system-arm -M netduinoplus2 -display none -monitor none -serial null -serial null -icount shift=0 \
    -semihosting-config enable=on,target=native -kernel "$program"
