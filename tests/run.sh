#!/bin/sh
# Builds and passes the tests: gcc and clang with warnings as errors, then gcc with ASan and UBSan,
# threads with TSan, lack of memory under Valgrind. Before that cppcheck and clang-tidy; with it, the
# share of the lines of src/ that the tests ran, and whether gcc's and clang's programs write the same
# files. Installs what is missing first. Usage: sh tests/run.sh
set -eu
root=$(cd "$(dirname "$0")/.." && pwd)
jobs=$(nproc 2>/dev/null || echo 2)

sh "$root/src/cmake/debian_packages.sh" gcc g++ libc6-dev make cmake pkg-config \
    clang clang-tidy cppcheck valgrind \
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

# covers NAME PERCENT: prints the lines of src/ that the tests of build/NAME ran; fails below PERCENT.
covers() {
    find "$root/build/$1/CMakeFiles/proxycloth.dir" -name '*.gcda' -exec gcov -n -s "$root" -r {} + 2>/dev/null |
        awk -v least="$2" '
            /^File/ { counts = /src\/.*\.c/ }
            counts && /^Lines executed/ { split($0, part, /[:%]/); n = $NF; lines += n; run += n * part[2] / 100; counts = 0 }
            END {
                share = lines > 0 ? 100 * run / lines : 0
                printf "lines of src/ run by the tests: %.1f %% of %d\n", share, lines
                exit share < least
            }'
}

mkdir -p "$root/build"
printf '\n== cppcheck\n'
(cd "$root" && cppcheck -q -j "$jobs" --enable=warning,portability,performance --std=c11 --platform=unix64 \
    --error-exitcode=1 --suppress=missingIncludeSystem --suppressions-list=.cppcheck -I include -I src src cli)
build clang -DCMAKE_C_COMPILER=clang -DCMAKE_BUILD_TYPE=Release -DCMAKE_EXPORT_COMPILE_COMMANDS=ON
printf '\n== clang-tidy\n'
find "$root/src" "$root/cli" -name '*.c' -print0 |
    xargs -0 -n 1 -P "$jobs" clang-tidy -p "$root/build/clang" --quiet 2>"$root/build/tidy.log" || {
    grep error "$root/build/tidy.log" >&2 # what the compiler says; findings are on standard output
    exit 1
}
check clang -L unit
build sanitize -DCMAKE_C_COMPILER=gcc -DCMAKE_BUILD_TYPE=RelWithDebInfo \
    -DPROXYCLOTH_SANITIZE=address,undefined
check sanitize -LE 'install|golden'
# Embree and TBB are not instrumented: what happens inside of them is none of our races.
target=thread_tests
build thread -DCMAKE_C_COMPILER=gcc -DCMAKE_BUILD_TYPE=RelWithDebInfo -DPROXYCLOTH_SANITIZE=thread
TSAN_OPTIONS=suppressions=$root/tests/support/tsan.txt
export TSAN_OPTIONS
check thread -L threads
unset TSAN_OPTIONS
target=
build coverage -DCMAKE_C_COMPILER=gcc -DCMAKE_BUILD_TYPE=None "-DCMAKE_C_FLAGS=-O1 --coverage" -DPROXYCLOTH_CLI=OFF
find "$root/build/coverage" -name '*.gcda' -delete
check coverage -L unit
covers coverage 90
build gcc -DCMAKE_C_COMPILER=gcc -DCMAKE_BUILD_TYPE=Release
check gcc
printf '\n== gcc and clang\n'
sh "$root/tests/cli/same.sh" "$root/build/gcc/cli/proxycloth" "$root/build/clang/cli/proxycloth" \
    "$root/data/makehuman_fedora.obj" "$root/data/godette_backpack.obj"
printf '\n== Valgrind\n'
# Every test that lets allocations fail and takes a few seconds at most; one call of two in the
# longest one. Threads of TBB live on.
printf '%s\n' 'lack_of_memory 2' contexts asset_file body deform evaluate_motion export options_file \
    scenario sparse visual |
    (cd "$root/build" && xargs -L 1 -P "$jobs" sh -c 'valgrind -q --error-exitcode=1 --leak-check=full \
        --errors-for-leak-kinds=definite,indirect --show-leak-kinds=definite,indirect \
        gcc/tests/test_"$0" "$@" >valgrind_"$0".log 2>&1 || { cat valgrind_"$0".log; exit 255; }')
printf 'no error\n'
