#!/bin/sh
# Whole runs: build, the stages one by one, export, choice of parts, failure and interruption.
# usage: pipeline.sh PROXYCLOTH
. "$(dirname "$0")/common.sh"

same() {
    cmp "$1" "$2" >stderr 2>&1 || fail "$1 and $2 differ"
}

holds() { # holds FOLDER "NAMES": exactly these files, hidden ones included; - is a space
    ls -A "$1" 2>stderr | tr ' ' - | LC_ALL=C sort >actual
    printf '%s\n' $2 | LC_ALL=C sort >expected
    cmp -s actual expected || fail "$1 holds $(tr '\n' ' ' <actual)"
}

# A skirt: an open cone of 24 by 8 quads; beside it a scarf, a bent sheet.
awk 'BEGIN {
    pi = atan2(0, -1); n = 24; m = 8
    print "o skirt"
    for (j = 0; j <= m; ++j) for (i = 0; i < n; ++i) {
        a = 2 * pi * i / n; r = 0.2 + 0.25 * j / m
        printf "v %.9f %.9f %.9f\n", r * cos(a), 1 - 0.8 * j / m, r * sin(a)
    }
    for (j = 0; j < m; ++j) for (i = 0; i < n; ++i) {
        a = j * n + i + 1; b = j * n + (i + 1) % n + 1
        printf "f %d %d %d %d\n", a, b, b + n, a + n
    }
    print "o scarf"; first = n * (m + 1)
    for (j = 0; j <= 4; ++j) for (i = 0; i <= 12; ++i)
        printf "v %.9f %.9f %.9f\n", 0.05 * i - 0.3, 1.2 + 0.05 * j, 0.3 * cos(pi * (i - 6) / 24)
    for (j = 0; j < 4; ++j) for (i = 0; i < 12; ++i) {
        a = first + j * 13 + i + 1
        printf "f %d %d %d %d\n", a, a + 1, a + 14, a + 13
    }
}' >outfit.obj

# Options: preset < file < command line; what is printed reads back as the same.
printf '{"preset": "mobile", "seed": 7, "vertices": 96, "simplify": {"seed": 8}, "threads": 2}' >o.json
run 0 build --preset cinematic --options o.json --vertices 80 --print-options
mv stdout all.json
run 0 build --options all.json --print-options
same stdout all.json
for line in '"vertices":	80' '"influences":	4' '"voxels":	64' '"threads":	2' '"weight_storage":	"u8"'; do
    grep -q "$line" all.json || fail "no $line in all.json"
done
[ "$(grep -c '"seed":	7' all.json) $(grep -c '"seed":	8' all.json)" = "2 1" ] || fail "seeds in all.json"

# Every command has its help, and every flag of a help text is completed.
run 0 completion
mv stdout completion.bash
run 0 help
for command in $(sed -n 's/^  \([a-z]*\) .*/\1/p' stdout); do
    run 0 help "$command"
    for flag in $(grep -oE '^  (-[a-z], )?--[a-z-]*' stdout | grep -oE -- '--[a-z-]*'); do
        grep -E "^    $command\) flags=" completion.bash | grep -qE -- "$flag[ \"]" ||
            fail "$command $flag is not completed"
    done
done
if command -v bash >/dev/null; then
    printf '. ./completion.bash\nCOMP_WORDS=(proxycloth build --layer-source v); COMP_CWORD=3\n%s' \
        '_proxycloth; echo "${COMPREPLY[@]}"' >complete.sh
    [ "$(bash complete.sh)" = visual ] || fail "bash completion: $(bash complete.sh)"
fi

# build writes five files and nothing else, the same on any number of threads.
quick="--voxels 16 --vertices 60 --frames 8 --epochs 5"
run 0 build outfit.obj -o a/b/out $quick --threads 1
holds a/b/out "outfit.glb outfit.h5 outfit.json outfit.png outfit.proxy.obj"
run 0 build outfit.obj -o again/ $quick --threads 3 --quiet
[ ! -s stderr ] || fail "--quiet prints"
for extension in glb h5 proxy.obj png; do
    same a/b/out/outfit.$extension again/outfit.$extension
done

# Without standard streams nothing takes their place.
"$program" build outfit.obj -o closed $quick <&- >&- 2>&- || fail "exit code without streams"
for extension in glb h5 proxy.obj png; do
    same a/b/out/outfit.$extension closed/outfit.$extension
done
"$program" info outfit.obj >&- 2>stderr
[ $? -eq 4 ] || fail "exit code of info without standard output"

# The stages one by one, in place, give the same bytes.
run 0 voxelize outfit.obj -o stages.h5 --name outfit --voxels 16
run 0 isosurface stages.h5
run 0 project stages.h5
run 0 graph stages.h5
run 0 label stages.h5 --write-lp stages.lp
tail -n 1 stages.lp | grep -q '^End$' || fail "--write-lp"
run 0 carve stages.h5
# A link stays one, and the file that it leads to is the new one.
mkdir elsewhere
mv stages.h5 elsewhere/carved.h5
ln -s elsewhere/carved.h5 stages.h5
run 0 simplify stages.h5 --vertices 60
[ -L stages.h5 ] || fail "a link to an asset was replaced"
holds elsewhere carved.h5
mv elsewhere/carved.h5 stages.h5
run 0 simulate stages.h5 --frames 8
run 0 skin stages.h5 -o skinned.h5 --epochs 5
same skinned.h5 a/b/out/outfit.h5
run 0 export skinned.h5 -o exported
holds exported "outfit.glb outfit.json outfit.png outfit.proxy.obj"
for extension in glb proxy.obj png; do
    same a/b/out/outfit.$extension exported/outfit.$extension
done
run 0 export skinned.h5 -o exported2 --name other --no-png
holds exported2 "other.glb other.json other.proxy.obj"

# Levels of detail: a build of its own gives the same proxy, motion and weights as a series.
run 0 build outfit.obj -o series $quick --vertices=24,60 --no-png
holds series "outfit.lod24.glb outfit.lod24.h5 outfit.lod24.json outfit.lod24.proxy.obj \
outfit.lod60.glb outfit.lod60.h5 outfit.lod60.json outfit.lod60.proxy.obj"
same series/outfit.lod60.proxy.obj exported/outfit.proxy.obj
run 0 build outfit.obj -o alone $quick --vertices 24 --no-png --name outfit.lod24
for extension in glb h5 proxy.obj; do
    same series/outfit.lod24.$extension alone/outfit.lod24.$extension
done
run 0 build $quick --vertices 24,60 --print-options
mv stdout series.json
run 0 build outfit.obj -o listed --options series.json --no-png
for file in series/*; do
    [ "$file" = series/outfit.lod24.json ] || [ "$file" = series/outfit.lod60.json ] ||
        same "$file" "listed/${file#series/}"
done
run 0 build outfit.obj -o single --options series.json --vertices 24 --no-png
holds single "outfit.glb outfit.h5 outfit.json outfit.proxy.obj"
cp stages.h5 kept.h5
run 0 simplify stages.h5 --vertices 24,60
same stages.h5 kept.h5
run 0 simulate stages.lod24.h5 --frames 8
run 0 skin stages.lod24.h5 --epochs 5
same stages.lod24.h5 series/outfit.lod24.h5
mkdir a.b
run 0 simplify stages.h5 --vertices 24,60 -o a.b/levels
holds a.b "levels.lod24 levels.lod60"
for list in 24,24 24, ,24 24,x 24,3 24,25,26,27,28,29,30,31,32,33,34,35,36,37,38,39,40; do
    run 2 build outfit.obj -o refused --vertices $list
    grep -q -e '--vertices' stderr || fail "--vertices $list"
done
run 2 voxelize outfit.obj -o refused.h5 --vertices 24,60

# Garments of one file apart: the skirt, then the scarf; a button stays with what is nearest.
awk '{ print } END {
    print "o button"; n = 24 * 9 + 5 * 13
    print "v 0 0.5 0.45"; print "v 0.01 0.5 0.45"; print "v 0 0.51 0.45"
    printf "f %d %d %d\n", n + 1, n + 2, n + 3
}' outfit.obj >button.obj
run 0 build button.obj -o parts $quick --parts separate --no-png
holds parts "button.part1.glb button.part1.h5 button.part1.json button.part1.proxy.obj \
button.part2.glb button.part2.h5 button.part2.json button.part2.proxy.obj"
run 0 info parts/button.part1.h5
grep -Eq '^  visual_triangles +385$' stdout || fail "the button is not with the skirt"
run 0 info parts/button.part2.h5
grep -Eq '^  visual_triangles +96$' stdout || fail "the scarf is not alone"
[ "$(cat parts/*.proxy.obj | grep -c '^v ')" -eq 60 ] || fail "the vertices are not shared"
run 0 build outfit.obj -o parts2 $quick --parts separate --vertices 24,60 --no-png
[ "$(cat parts2/outfit.part?.lod24.proxy.obj | grep -c '^v ')" -eq 24 ] || fail "lod24 of parts"
[ "$(cat parts2/outfit.part?.lod60.proxy.obj | grep -c '^v ')" -eq 60 ] || fail "lod60 of parts"
run 0 build outfit.obj -o whole $quick --parts separate --mesh skirt --no-png
holds whole "outfit.glb outfit.h5 outfit.json outfit.proxy.obj"
# Pins of a scenario hold the part where they are; the other one gets its own, with a warning.
printf '{"pins": [{"box": {"min": [-1, 1.38, -1], "max": [1, 2, 1]}}]}' >pins.json
run 0 build outfit.obj -o pinned $quick --parts separate --scenario pins.json --no-png
grep -q 'part1: simulate: pin rules name no vertex' stderr || fail "no warning for the part without pins"
grep -q 'part2: simulate: pin rules name no vertex' stderr && fail "the scarf is not pinned"
for part in 1 2; do
    grep -Eq '"pinned":[^0-9]+[1-9]' pinned/outfit.part$part.json || fail "part $part is not held"
done
run 2 build outfit.obj -o refused --parts apart
run 2 voxelize outfit.obj -o refused.h5 --parts separate

# A density map: vertex colors of an OBJ, red in the lower half of the skirt.
awk '/^v / { print $0, ($3 < 0.6 ? 1 : 0), 0, 0; next } { print }' outfit.obj >painted.obj
run 0 build painted.obj -o painted $quick --density-channel red --no-png --threads 1
run 0 build painted.obj -o painted3 $quick --density-channel red --no-png --threads 3
same painted/painted.h5 painted3/painted.h5
low() { awk '/^v / && $3 < 0.6 { ++n } END { print n + 0 }' "$1"; }
run 0 build painted.obj -o even $quick --no-png
[ "$(low painted/painted.proxy.obj)" -gt "$(low even/painted.proxy.obj)" ] || fail "density map"
# The same from the colors of a GLB.
run 0 build painted/painted.glb --mesh painted -o gltf $quick --density-channel red --no-png
[ "$(low gltf/painted.proxy.obj)" -gt "$(low even/painted.proxy.obj)" ] || fail "density map of a GLB"
run 0 simplify stages.h5 --density-channel red -o ignored.h5
grep -q 'density channel was ignored' stderr || fail "no warning without vertex colors"

# An earlier stage drops the results of later ones; the visual mesh can be taken from an asset.
run 0 simplify skinned.h5 -o earlier.h5 --vertices 60
run 0 info earlier.h5
grep -q '^stages  *7 of 9' stdout || fail "stages left after simplify"
run 3 skin earlier.h5
run 0 voxelize skinned.h5 -o first.h5 --voxels 16
run 0 voxelize outfit.obj -o second.h5 --voxels 16
same first.h5 second.h5

# Our own GLB is read back: a skinned visual mesh and the proxy.
run 0 info a/b/out/outfit.glb
grep -q ' bones' stdout || fail "no skin in the GLB"
run 0 evaluate outfit.obj a/b/out/outfit.proxy.obj
run 0 evaluate skinned.h5 skinned.h5

# The strip on request.
run 0 export skinned.h5 -o strip --strip --no-png
holds strip "outfit.glb outfit.json outfit.proxy.obj outfit.strip.png"

# Weights in another wind: the asset's, the same out of its GLB, and those without optimisation; the
# same on any number of threads.
run 0 evaluate --motion skinned.h5 a/b/out/outfit.glb --threads 1
[ "$(grep -Ec '^(asset|outfit.glb|inverse|closest|heat)' stdout)" -eq 5 ] || fail "rows of --motion"
asset=$(sed -n 's/^asset *//p' stdout)
[ "$asset" = "$(sed -n 's/^outfit.glb *//p' stdout)" ] || fail "the GLB has other weights"
run 0 evaluate --motion skinned.h5 --json --threads 1
cp stdout motion.json
run 0 evaluate --motion skinned.h5 --json --threads 3
same stdout motion.json
echo '{"frames": 4, "winds": [{"time": 0, "velocity": [3, 0, 0]}]}' >gust.json
run 0 evaluate --motion skinned.h5 --scenario gust.json
grep -q '^# .* 4 frames' stdout || fail "--scenario chooses no motion"
run 0 evaluate --motion skinned.h5 --wind-seed 1
grep -q 'made in the wind of seed 1' stderr || fail "no warning about a wind that was seen"
own=$(sed -n 's/^on its own motion *//p' stdout)
[ -n "$own" ] && [ "$own" = "$(sed -n 's/^asset *//p' stdout)" ] || fail "the motion is not the asset's own"

# --mesh takes the named part only.
run 0 voxelize outfit.obj -o auto.h5 --voxels auto
run 0 info auto.h5
grep -q '^ *voxels *auto$' stdout || fail "info hides that N_v was chosen"
grep -Eq '^ *voxels *[0-9]+$' stdout || fail "info hides the N_v that was chosen"
run 0 info auto.h5 --json
grep -q '"voxels":.*"auto"' stdout || fail "JSON hides that N_v was chosen"

run 0 voxelize outfit.obj -o part.h5 --mesh 'sc*' --voxels 16
run 0 info part.h5
grep -Eq '^  visual_triangles +96$' stdout || fail "--mesh takes another part"

# --seed reaches every stage that has one.
run 0 build outfit.obj -o seeded $quick --seed 7 --no-png
run 0 info seeded/outfit.h5
[ "$(grep -c '^  seed  *7$' stdout)" -eq "$("$program" help build | grep -c -e --seed)" ] ||
    fail "--seed"

# A folder in the way of a result: nothing is added, and older results stay as they are.
mkdir -p blocked
cp exported/outfit.glb exported/outfit.png exported/outfit.proxy.obj blocked
mkdir blocked/outfit.json
run 4 export skinned.h5 -o blocked
grep -q 'blocked/outfit.json: a folder is in the way' stderr || fail "the folder is not named"
holds blocked "outfit.glb outfit.json outfit.png outfit.proxy.obj"
for extension in glb png proxy.obj; do
    same exported/outfit.$extension blocked/outfit.$extension
done

# Older results are replaced; the name may hold spaces, dots and letters beyond ASCII.
cp outfit.obj "my dréss.v2.obj"
chmod a-w "my dréss.v2.obj"
short="--voxels 8 --vertices 20 --frames 2 --epochs 1 --no-png"
run 0 build "my dréss.v2.obj" -o "new folder/x.y/" $short
run 0 build "./my dréss.v2.obj" -o "new folder/x.y" $short --influences 12
holds "new folder/x.y" "my-dréss.v2.glb my-dréss.v2.h5 my-dréss.v2.json my-dréss.v2.proxy.obj"
run 0 info "new folder/x.y/my dréss.v2.h5"
grep -Eq '^  influences +12$' stdout || fail "--influences 12, or the older result is still there"

# Interrupted: exit code 130, one line, nothing is left; the same after two signals at once. What is
# interrupted would go on for hours.
for signals in INT TERM "INT TERM"; do
    "$program" build outfit.obj -o stopped/deep --frames 10000 --frame-steps 1000 >stdout 2>stderr &
    process=$!
    until ls -A stopped/deep | grep -q proxycloth || ! kill -0 $process; do
        sleep 0.1
    done 2>/dev/null
    for signal in $signals; do
        kill -$signal $process 2>/dev/null
    done
    wait $process
    actual=$?
    [ "$actual" -eq 130 ] || fail "exit code $actual after $signals"
    [ ! -e stopped ] || fail "a folder is left after $signals"
    [ "$(wc -l <stderr)" -eq 1 ] || fail "not one line after $signals"
done

finish
