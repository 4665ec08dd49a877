#!/bin/sh
# regress: what got worse, by garment and measure. usage: regress.sh PROXYCLOTH
. "$(dirname "$0")/common.sh"

# regress CODE LAST_LINE ARGUMENTS...
regress() {
    code=$1
    last=$2
    shift 2
    run "$code" regress "$@"
    [ -z "$last" ] || [ "$(tail -n 1 stdout)" = "$last" ] || fail "not \"$last\": $*"
}
printed() {
    grep -Eq "^$1$" stdout || fail "no line $1"
}

# Reports of real garments: the same folder, and the table that is made of it.
mkdir in
for n in 4 5; do
    sheet $n >in/sheet$n.obj
done
"$program" batch in -o out --voxels 8 --vertices 20 --frames 2 --epochs 1 --no-png >/dev/null \
    2>stderr || fail "batch"
regress 0 "2 garments compared: 0 worse; 0 missing, 0 new" out out
regress 0 "" out
cp stdout table.tsv
regress 0 "2 garments compared: 0 worse; 0 missing, 0 new" table.tsv out
regress 0 "2 garments compared: 0 worse; 0 missing, 0 new" table.tsv out --changes
"$program" build in/sheet4.obj -o flat --name sheet4 --voxels 8 --vertices 20 --frames 2 \
    --epochs 1 --no-png 2>stderr || fail "build"
regress 1 "1 garments compared: 0 worse; 1 missing, 0 new" out flat
printed "sheet5: missing"
regress 0 "1 garments compared: 0 worse; 0 missing, 1 new" flat out
rm -r out/garments/sheet5/sheet5.json # as of a garment that failed
regress 1 "1 garments compared: 0 worse; 1 missing, 0 new" table.tsv out

# Directions and tolerances.
tab() { printf '%s\n' "$@" | tr ' ' '\t' | sed 's/^#./# /'; }
tab "# garment vertices hausdorff min_angle_mean skin_loss_after label_objective" \
    "a 100 0.1 40 1 5" "b 100 0.1 40 1 5" >before
now() { # now A'S VALUES: b stays as it is
    tab "# garment vertices hausdorff min_angle_mean skin_loss_after label_objective" \
        "a $*" "b 100 0.1 40 1 5" >now
}
same="2 garments compared: 0 worse; 0 missing, 0 new"
worse="2 garments compared: 1 worse; 0 missing, 0 new"
now 100 0.106 39.6 1.04 5
regress 0 "$same" before now
now 100 0.108 40 1 5
regress 1 "$worse" before now
printed "a: hausdorff 0.1 -> 0.108 \(tolerance 0.007\)"
regress 0 "$same" now before
now 100 0.05 60 0.1 9 # better, or of no account
regress 0 "$same" before now
regress 1 "$worse" before now --changes
[ "$(grep -c '^a: ' stdout)" -eq 4 ] || fail "--changes"
now 100 0.1 39.4 1.06 5
regress 1 "$worse" before now
printed "a: min_angle_mean 40 -> 39.4 .*"
printed "a: skin_loss_after 1 -> 1.06 .*"
[ "$(wc -l <stdout)" -eq 3 ] || fail "more is printed"
for vertices in 99 101; do
    now $vertices 0.1 40 1 5
    regress 1 "$worse" before now
done
now 100 nan 40 1 5
regress 1 "$worse" before now
tab "# garment vertices" "a 100" "b 100" >now # a measure is gone
regress 1 "2 garments compared: 2 worse; 0 missing, 0 new" before now
regress 0 "$same" now before

# Tolerances of one's own.
now 97 0.3 40 1.06 5
echo '{"hausdorff": {"relative": 2.1}, "vertices": {"absolute": 3}, "skin_loss_after": null}' >t.json
regress 0 "$same" before now --tolerances t.json
echo '{"hausdorff": {"relative": 1.9}, "vertices": null, "skin_loss_after": null}' >t.json
regress 1 "$worse" before now --tolerances t.json
regress 1 "" before now --json --tolerances t.json
tr -d ' \t\n' <stdout | grep -q '"worse":\[{"garment":"a","measure":"hausdorff","baseline":0.1' ||
    fail "--json"

# Wrong usage and input.
bad() { # bad CODE PATTERN ARGUMENTS...
    code=$1
    pattern=$2
    shift 2
    regress "$code" "" "$@"
    grep -Eq "^proxycloth regress: error: .*$pattern" stderr || fail "no match for \"$pattern\""
    [ ! -s stdout ] || fail "output on stdout: $*"
}
bad 2 "an input is missing"
bad 3 "nowhere: No such file" nowhere out
mkdir empty
bad 3 "empty: no report" out empty
bad 3 "in/sheet4.obj: this is no folder, and no table" in/sheet4.obj out
tab "# garment vertices" "a" >short
bad 3 "short:2: 1 numbers must follow" short out
tab "# garment vertices" "a 1 2" >long
bad 3 "long:2: 1 numbers" long out
tab "# garment vertices" "a 1" "a 2" >twice
bad 3 "twice: the garment a is there twice" before twice
tab "# garment verticals" "a 1" >unknown
bad 3 "unknown: this is no folder, and no table" unknown out
echo '{"hausdorf": null}' >t.json
bad 2 't.json: no measure "hausdorf"; did you mean hausdorff' before now --tolerances t.json
for text in '{"hausdorff": 1}' '{"hausdorff": {"absolute": -1}}' '{"hausdorff": {"abs": 1}}' '[1]' '{'; do
    echo "$text" >t.json
    bad 2 "t.json: " before now --tolerances t.json
done
bad 3 "t2.json: No such file" before now --tolerances t2.json

finish
