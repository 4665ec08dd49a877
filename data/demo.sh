#!/bin/sh
# Converts the sample garments: installs what is missing, builds, runs, says where to look.
# Usage: sh data/demo.sh [OUTPUT_FOLDER]    (default: out, in the project's folder)
set -eu
root=$(cd "$(dirname "$0")/.." && pwd)
out=${1:-$root/out}
build=$root/build/release
jobs=$(nproc 2>/dev/null || echo 2)

sh "$root/src/cmake/debian_packages.sh" gcc libc6-dev make cmake pkg-config \
    libembree-dev libhdf5-dev libsuitesparse-dev libassimp-dev libpng-dev libcjson-dev
cmake -S "$root" -B "$build" -DCMAKE_BUILD_TYPE=Release -DPROXYCLOTH_TESTS=OFF >/dev/null
cmake --build "$build" -j "$jobs" >/dev/null

mkdir -p "$out"
failed=0
for garment in "$root"/data/*.obj "$root"/data/*.glb; do
    name=$(basename "$garment")
    set -- build "$garment" -o "$out" --quiet
    case $name in
        kaykit_knight_animated.glb) set -- "$@" --mesh '*Cape*' ;; # the character's only cloth
    esac
    if "$build/cli/proxycloth" "$@"; then
        printf 'done    %s\n' "$name"
    else
        failed=$((failed + 1))
        printf 'failed  %s\n' "$name"
    fi
done
printf '\nResults are in %s: for each garment NAME.png (open this first), NAME.glb (skinned,\n' "$out"
printf 'animated), NAME.proxy.obj, NAME.h5 (every stage) and NAME.json (report).\n'
[ "$failed" -eq 0 ]
