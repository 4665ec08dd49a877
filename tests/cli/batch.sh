#!/bin/sh
# batch: broken files among good ones, what is up to date, interruption, shards, limits, manifests.
# usage: batch.sh PROXYCLOTH
. "$(dirname "$0")/common.sh"
own_program

# batch CODE ARGUMENTS...: stdout keeps the lines.
quick="--voxels 8 --vertices 20 --frames 2 --epochs 1 --no-png"
batch() {
    code=$1
    shift
    run "$code" batch $quick "$@"
}

# line ID PATTERN: the garment's line matches; lines NUMBER PATTERN: so many lines do.
line() {
    grep "\"id\":\"$1\"" stdout | grep -Eq "$2" || fail "line of $1: no match for $2"
}
lines() {
    [ "$(grep -Ec "$2" stdout)" -eq "$1" ] || fail "not $1 lines match $2"
}
counts() { # counts REPORT NAME NUMBER
    grep -Eq "\"$2\":.$3(,|$)" "$1" || fail "$1: $2 is not $3"
}
gone() { # no process is left: what dies with its parent does so soon
    tries=0
    while grep -ls "$program" /proc/[0-9]*/cmdline >left; do
        [ $((tries += 1)) -le 2400 ] || return 1
        sleep 0.05
    done
}
clean() { # no work folder is left, and no process
    [ -z "$(ls -A "$1" | grep '^\.')" ] || fail "$1 holds a work folder"
    gone || fail "a process is left: $(cat left)"
}
listing() { # names, times and contents of all files
    find "$1" -type f -exec ls -l --time-style=full-iso {} + | LC_ALL=C sort -k 9
}

mkdir -p in/coats in/hats/old in/.hidden
sheet 6 >in/cape.obj
sheet 7 >in/coats/long.obj
(echo "mtllib long.mtl"; sheet 8) >in/hats/long.obj
echo "newmtl red" >in/hats/long.mtl
sheet 9 >in/hats/old/top.obj
sheet 5 >in/.hidden/no.obj
echo "no mesh" >in/notes.txt
printf 'glTF\002\000\000\000\377\000\000\000\377\000\000\000JSON{}' >in/broken.glb
printf 'v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n' >in/nan.obj
: >in/empty.obj

# Broken files among good ones; hidden folders and other files are no garments.
batch 1 in -o in/out --jobs 2
lines 7 '"outcome":'
lines 4 '"outcome":"done","code":0'
lines 3 '"outcome":"failed","code":3,"error":"input","retryable":false,"message":"in/'
line coats-long '"path":"in/coats/long.obj".*"results":\["coats-long"\]'
line hats-old-top '"outcome":"done"'
line cape "\"input_sha256\":\"$(sha256sum <in/cape.obj | cut -d ' ' -f 1)\""
line nan 'vertex [0-9] has z'
for extension in glb h5 json proxy.obj batch.json; do
    [ -f in/out/garments/hats-long/hats-long.$extension ] || fail "no hats-long.$extension"
done
[ "$(ls in/out/garments/nan)" = "nan.batch.json
nan.log" ] || fail "files of a garment that failed"
counts in/out/batch.json done 4
counts in/out/batch.json failed 3
grep -q '"complete":.true' in/out/batch.json || fail "complete"
clean in/out

# Names may hold spaces, and bytes that no JSON can.
mkdir 'odd names'
sheet 6 >"odd names/$(printf 'M\303\244ntel (1) \042x\042').obj"
sheet 6 >"odd names/$(printf 'M\344ntel').obj"
batch 0 'odd names' -o 'odd results'
lines 2 '"outcome":"done"'
cat stdout 'odd results/batch.json' | iconv -f UTF-8 -t UTF-8 >after || fail "names that are no text"
clean 'odd results'

# What build made of a garment is none itself, unless it is named.
mkdir built
sheet 6 >built/cap.obj
run 0 build built/cap.obj -o built $quick
batch 0 built -o built/out
lines 1 '"path":"built/cap.obj".*"outcome":"done"'
lines 1 '"outcome":'
batch 0 built/cap.glb -o built/out
lines 1 '"path":"built/cap.glb".*"outcome":"done"'

# A second run does nothing, and finds no garment among the results.
listing in/out/garments >before
batch 1 in -o in/out
lines 7 '"ran":false'
listing in/out/garments >after
cmp -s before after || fail "a second run changes files"
counts in/out/batch.json ran 0
batch 1 in -o in/out --retry-failed
lines 3 '"ran":true'
batch 0 "in/c*" in/hats/ -o in/out --dry-run --force
lines 0 '"ran":true'
lines 4 '"outcome":"pending"' # cape, coats/long, hats/long, hats/old/top
batch 0 "in/c*.obj" in/cape.obj ./in/../in/cape.obj -o in/out --force
lines 1 '"id":"cape".*"ran":true' # once

# What changed is converted again: the input, a file that it names, an option, a result that is gone.
touch in/cape.obj
batch 1 in -o in/out
lines 0 '"ran":true'
sheet 5 >in/cape.obj
echo "newmtl blue" >in/hats/long.mtl
rm in/out/garments/coats-long/coats-long.glb
sheet 4 >in/nan.obj
batch 1 in -o in/out
for id in cape hats-long coats-long nan; do
    line $id '"outcome":"done".*"ran":true'
done
lines 3 '"ran":false'
batch 1 in -o in/out --vertices 20,24 --threads 1
lines 7 '"ran":true' # those that fail as well
line cape '"results":\["cape.lod20","cape.lod24"\]'
[ ! -e in/out/garments/cape/cape.glb ] || fail "results of other options are left"
rm -r in/out

# Shards: together they make what one run makes, and a run collects them into one report.
batch 1 in -o whole --jobs 1
for shard in 1 2 3; do # at once, as on a farm
    "$program" batch in -o parts $quick --shard $shard/3 >shard$shard 2>stderr$shard &
done
wait
for shard in 1 2 3; do
    [ -f parts/batch-$shard-of-3.json ] || fail "report of shard $shard: $(cat stderr$shard)"
done
clean parts
cat shard1 shard2 shard3 >shards
[ "$(sort -u shards | wc -l)" -eq 7 ] || fail "the shards do not share the garments"
[ -s whole/report.html ] || fail "no page"
[ ! -e parts/report.html ] || fail "a page of a shard"
batch 1 in -o parts
[ -s parts/report.html ] || fail "no page of collected shards"
lines 0 '"ran":true'
for file in whole/garments/*/*; do
    case $file in
    *.json) ;; # holds times
    *) cmp "$file" "parts${file#whole}" >stderr 2>&1 || fail "$file differs between shards" ;;
    esac
done
[ "$(find parts/garments | wc -l)" -eq "$(find whole/garments | wc -l)" ] || fail "files of shards"

# Files of one name: ids that depend on the paths only.
mkdir a b
sheet 4 >a/vest.obj
sheet 5 >b/vest.obj
batch 0 a/vest.obj b/vest.obj -o twins
lines 2 '"id":"vest-[0-9a-f]{8}".*"outcome":"done"'
batch 0 b/vest.obj "$work/a/vest.obj" -o twins
lines 2 '"ran":false'

# Manifests: parts of a file, options of their own, ids that are no paths.
mkdir lists
(echo "o cape"; sheet 6; echo "o scarf"; sheet 4 | sed 's/^v \([^ ]*\)/v 3\1/') >lists/suit.obj
cat >lists/list.jsonl <<'EOF'
{"path": "suit.obj", "id": "cape", "mesh": "c*"}

{"path": "suit.obj", "id": "../../scarf", "mesh": ["sc*", "s?arf"], "options": {"vertices": 12}}
{"path": "../in/cape.obj", "id": "cape"}
EOF
batch 2 lists/list.jsonl -o listed
grep -q 'lists/list.jsonl:4: the id "cape" is that of lists/list.jsonl:1 too' stderr || fail "same ids"
[ ! -e listed ] || fail "work was begun in spite of a wrong manifest"
sed -i '4s/"id": "cape"/"id": "other"/' lists/list.jsonl
batch 0 lists/list.jsonl -o listed
lines 3 '"outcome":"done"'
[ "$(ls listed/garments | tr '\n' ' ')" = "_.-..-scarf cape other " ] || fail "ids of a manifest"
[ "$(grep -c '^v ' listed/garments/_.-..-scarf/*.proxy.obj)" -eq 12 ] || fail "options of a line"
[ "$(grep -c '^v ' listed/garments/cape/*.proxy.obj)" -eq 20 ] || fail "options leak into a line"
cat >wrong.jsonl <<'EOF'
{"path": "in/cape.obj"}
{"path": "in/cape.obj"
["in/cape.obj"]
{"id": "x"}
{"id": "y", "path": 7}
{"id": "z", "path": "in/cape.obj", "mesh": [1]}
{"id": "w", "path": "in/cape.obj", "vertices": 12}
{"id": "u", "path": "in/cape.obj", "options": {"vertices": 1}}
{"id": "v", "path": "in/cape.obj", "options": {"vertexes": 64}}
EOF
batch 2 wrong.jsonl -o listed2
for number in 2 3 4 5 6 7 8 9; do
    [ "$(grep -c "wrong.jsonl:$number: " stderr)" -eq 1 ] || fail "no message for line $number"
done
[ "$(wc -l <stderr)" -eq 8 ] || fail "messages for wrong lines"
[ ! -e listed2 ] || fail "work was begun in spite of a wrong manifest"

# Limits of time and memory end one garment, not the run.
sheet 150 >large.obj
cat >limits.jsonl <<'EOF'
{"path": "large.obj", "options": {"voxels": 200, "vertices": 4000}}
{"path": "in/cape.obj"}
EOF
batch 1 limits.jsonl -o limits --garment-cpu-seconds 1
line large '"code":7,"error":"limit","retryable":false,"message":".*--garment-cpu-seconds'
[ "$(ls -A limits/garments/large)" = large.batch.json ] || fail "files of a child that was killed"
line cape '"outcome":"done"'
batch 1 limits.jsonl -o limits --garment-cpu-seconds 1
lines 2 '"ran":false' # nothing changed
batch 1 limits.jsonl -o limits --garment-seconds 0.3
line large '"code":7,"error":"limit".*--garment-seconds.*"ran":true'
line cape '"ran":false'
if ! grep -q __asan_init "$program"; then
    batch 1 limits.jsonl -o limits --garment-memory 64
    line large '"code":7,"error":"limit".*memory ran out.*"garment_memory":64'
fi
batch 1 limits.jsonl -o limits --import-seconds 0.01
line large '"code":7,"error":"limit".*--import-seconds'

# Outputs that cannot be written: the folder, and one that somebody else made.
printf 'a file' >file
batch 4 in -o file/out
mkdir -p foreign/garments/cape
echo "mine" >foreign/garments/cape/letter
batch 75 in/cape.obj in/nan.obj -o foreign
line cape '"code":4,"error":"output","retryable":true,"message":"foreign/garments/cape is in the way'
line nan '"outcome":"done"'
[ "$(ls foreign/garments/cape)" = letter ] || fail "somebody else's folder was touched"
rm -r foreign/garments/cape
batch 0 in/cape.obj in/nan.obj -o foreign
line cape '"ran":true'

# Whoever reads along may leave.
"$program" batch in -o pipe $quick 2>stderr | head -n 1 >stdout
grep -q '"complete":.true' pipe/batch.json || fail "the reader ended the run"

# Ended from outside, and interrupted: what is finished stays, and the next run goes on.
mkdir many
for i in 10 11 12 13 14 15 16 17 18 19; do
    sheet $i >many/sheet$i.obj
done
longer="--voxels 16 --vertices 40 --frames 5 --epochs 5 --no-png"
# stop SIGNAL: sends it when two garments of ten are done.
stop() {
    : >stdout # the loop below must not count the lines of the run before, nor signal too early
    "$program" batch many -o stopped --jobs 2 $longer >stdout 2>stderr </dev/null &
    process=$!
    until [ "$(wc -l <stdout)" -ge 2 ] || ! kill -0 $process; do
        sleep 0.05
    done 2>/dev/null
    kill -$1 $process 2>/dev/null
    wait $process 2>/dev/null
    actual=$?
    finished=$(grep -c '"outcome":"done"' stdout)
}
for signal in KILL INT TERM; do
    # On a busy machine this shell may wake up when all are done: again, then.
    stop $signal
    tries=0
    while [ "$finished" -eq 10 ] && [ $((tries += 1)) -le 20 ]; do
        rm -r stopped
        stop $signal
    done
    [ "$finished" -ge 2 ] && [ "$finished" -lt 10 ] || fail "$finished garments before $signal"
    if [ $signal = KILL ]; then
        [ ! -e stopped/batch.json ] || fail "a report after $signal"
        gone || fail "a process is left after $signal: $(cat left)"
        ls -A stopped | grep -q '^\.proxycloth' || fail "no work folder after $signal"
    else
        [ "$actual" -eq 130 ] || fail "exit code $actual after $signal"
        grep -q '"complete":.false' stopped/batch.json || fail "the report after $signal"
        clean stopped
    fi
    "$program" batch many -o stopped $longer >stdout 2>stderr
    lines 10 '"outcome":"done"'
    [ "$(grep -c '"ran":false' stdout)" -ge "$finished" ] || fail "done again after $signal"
    grep -q '"ran":true' stdout || fail "nothing was left after $signal"
    clean stopped
    rm -r stopped
done

finish
