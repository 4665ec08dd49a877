#!/bin/sh
# Two builds of the program, by different compilers, give the same files; but for timings and the
# name of the compiler. usage: same.sh PROXYCLOTH OTHER_PROXYCLOTH GARMENT...
set -u
one=$1
other=$2
shift 2
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
failures=0

# convert PROGRAM FOLDER GARMENT
convert() {
    "$1" build "$3" -o "$2" --quiet || exit 1
    for report in "$2"/*.json; do
        sed -i '/^\t"timings":/,/}/d; /^\t\t"compiler":/d' "$report"
    done
}
for garment; do
    convert "$one" "$work/one" "$garment"
    convert "$other" "$work/other" "$garment"
done
[ "$(ls "$work/one" | wc -l)" -eq $((5 * $#)) ] || {
    echo "FAILED: not five files for each garment: $(ls "$work/one" | tr '\n' ' ')"
    exit 1
}
for file in "$work"/one/*; do
    cmp "$file" "$work/other/${file##*/}" || failures=$((failures + 1))
done
echo "$(($(ls "$work/one" | wc -l) - failures)) files of $# garments are the same"
[ "$failures" -eq 0 ] || exit 1
