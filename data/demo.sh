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

"$build/cli/proxycloth" batch "$root/data/samples.jsonl" -o "$out" --strip |
    sed -n 's/.*"id":"\([^"]*\)".*"outcome":"\([^"]*\)".*/\2    \1/p'
printf '\nOpen %s in a browser: every garment with its measures and contact\n' "$out/report.html"
printf 'sheet. %s holds NAME.glb (skinned, animated), NAME.proxy.obj,\n' "$out/garments/NAME/"
printf 'NAME.h5 (every stage), NAME.json (report), NAME.png and NAME.strip.png (pictures).\n'
grep -q '"failed":[[:space:]]*0,' "$out/batch.json"
