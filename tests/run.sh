#!/bin/sh
# Builds and passes the tests: gcc and clang with warnings as errors, then gcc with ASan and UBSan, and several
# contexts at once with TSan.
# Installs what is missing first. Usage: sh tests/run.sh
set -eu
root=$(cd "$(dirname "$0")/.." && pwd)
jobs=$(nproc 2>/dev/null || echo 2)

sh "$root/src/cmake/debian_packages.sh" gcc g++ libc6-dev make cmake pkg-config clang \
    libembree-dev libhdf5-dev libsuitesparse-dev libassimp-dev libpng-dev libcjson-dev libcmocka-dev coinor-cbc

# build NAME CMAKE_ARGUMENT...: configures and builds in build/NAME, all or the one of $target.
target=
build() {
    name=$1
    shift
    printf '\n== %s\n' "$name"
    cmake -S "$root" -B "$root/build/$name" -DCMAKE_COMPILE_WARNING_AS_ERROR=ON "$@" >/dev/null
    cmake --build "$root/build/$name" -j "$jobs" ${target:+--target "$target"} \
        >"$root/build/$name.log" 2>&1 || {
        grep -E 'error|warning|undefined' "$root/build/$name.log" >&2 || tail -n 40 "$root/build/$name.log" >&2
        exit 1
    }
}
# check NAME CTEST_ARGUMENT...: runs the tests of build/NAME.
check() {
    name=$1
    shift
    ctest --test-dir "$root/build/$name" --output-on-failure -j "$jobs" "$@"
}

mkdir -p "$root/build"
build clang -DCMAKE_C_COMPILER=clang -DCMAKE_BUILD_TYPE=Release
check clang -L unit
build sanitize -DCMAKE_C_COMPILER=gcc -DCMAKE_BUILD_TYPE=RelWithDebInfo \
    -DPROXYCLOTH_SANITIZE=address,undefined
check sanitize -LE 'install|golden'
# Embree and TBB are not instrumented: what happens inside of them is none of our races.
target=test_contexts
build thread -DCMAKE_C_COMPILER=gcc -DCMAKE_BUILD_TYPE=RelWithDebInfo -DPROXYCLOTH_SANITIZE=thread
TSAN_OPTIONS=suppressions=$root/tests/support/tsan.txt
export TSAN_OPTIONS
check thread -R '^contexts$'
unset TSAN_OPTIONS
target=
build gcc -DCMAKE_C_COMPILER=gcc -DCMAKE_BUILD_TYPE=Release
check gcc
