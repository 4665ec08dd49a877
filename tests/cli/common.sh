# What the tests of the command line share; sourced as their first step, with the program in $1.
# They then stand in an empty folder of their own, $work, and end with: finish
set -u
case $1 in
/*) program=$1 ;;
*) program=$PWD/$1 ;;
esac
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
cd "$work" || exit 1
failures=0
touch stdout stderr

# A copy of the program whose path tells our processes from others.
own_program() {
    cp "$program" "$work/proxycloth" || exit 1
    program=$work/proxycloth
}

# fail WHAT: the test goes on. What the program printed last follows.
fail() {
    echo "FAILED: $1"
    tail -n 20 stdout stderr | sed 's/^/    /'
    failures=$((failures + 1))
}

# run CODE ARGUMENTS...
run() {
    code=$1
    shift
    "$program" "$@" >stdout 2>stderr </dev/null
    actual=$?
    [ "$actual" -eq "$code" ] || fail "exit code $actual, expected $code: $*"
}

# sheet SIZE: a bent sheet of SIZE by SIZE quads.
sheet() {
    awk -v n="$1" 'BEGIN {
        for (j = 0; j <= n; ++j) for (i = 0; i <= n; ++i)
            printf "v %.6f %.6f %.6f\n", i / n, j / n, 0.2 * sin(3 * i / n)
        for (j = 0; j < n; ++j) for (i = 0; i < n; ++i) {
            a = j * (n + 1) + i + 1
            printf "f %d %d %d %d\n", a, a + 1, a + n + 2, a + n + 1
        }
    }'
}

finish() {
    [ "$failures" -eq 0 ] || exit 1
}
