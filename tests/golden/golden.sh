#!/bin/sh
# The whole pipeline over the sample garments, as a user would run it: what must hold for every
# garment is checked, and the measures are compared with golden.tsv. With --update that file is
# rewritten. usage: golden.sh PROXYCLOTH GOLDEN DATA_FOLDER GOLDEN.tsv [--update]
set -eu
program=$1
golden=$2
data=$3
table=$4
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$program" batch "$data/*.obj" -o "$work" --no-png --quiet >"$work/lines" || {
    cat "$work/lines"
    exit 1
}
"$golden" "$work"/garments/*/*.h5
if [ "${5:-}" = --update ]; then
    "$program" regress "$work" >"$work/table"
    cp "$work/table" "$table"
fi
"$program" regress "$table" "$work" --changes
