#!/bin/sh
# Wrong usage and bad input: exit code, one line on stderr, no file left behind.
# usage: errors.sh PROXYCLOTH FIXTURES ALTER_ASSET
# Passes as root too: folders that cannot be written are made by a file in their way.
. "$(dirname "$0")/common.sh"
fixtures=$2
alter_asset=$3

# expect CODE PATTERN ARGUMENTS...: the program must exit with CODE, print one line that matches the
# extended regular expression, print nothing on stdout, and leave the folder as it was.
expect() {
    code=$1
    pattern=$2
    shift 2
    ls -AR . >before
    "$program" "$@" >stdout 2>stderr </dev/null
    actual=$?
    ls -AR . >after
    [ "$actual" -eq "$code" ] || fail "exit code $actual, expected $code: $*"
    [ "$(wc -l <stderr)" -eq 1 ] || fail "not one line on stderr: $*"
    grep -Eq "^proxycloth.*: error: .*$pattern" stderr || fail "no match for \"$pattern\": $*"
    [ ! -s stdout ] || fail "output on stdout: $*"
    cmp -s before after || fail "files changed: $*"
}

touch before after stdout stderr
cat >cloth.obj <<'END'
g sheet
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
f 1 2 3 4
END

# Usage.
expect 2 "command is missing"
expect 2 'no command "bild"; did you mean build' bild
expect 2 'no command "xyzzy"; see' xyzzy
expect 2 "an input is missing" build
expect 2 "an input is missing" evaluate cloth.obj
printf '{}' >plain.json
expect 2 "--scenario needs --motion" evaluate cloth.obj cloth.obj --scenario plain.json
expect 2 "no option --motion" build cloth.obj --motion
expect 2 'no preset "mobil"; did you mean mobile' build cloth.obj -o out --preset mobil
expect 3 "no.json" build cloth.obj -o out --options no.json
printf '{"simplify": {"vertices": 3}}' >few.json
expect 2 "few.json: simplify.vertices: simplify: option vertices = 3 is out of range" \
    build cloth.obj -o out --options few.json
printf '{\n"voxels": 3,\n' >cut.json
expect 3 "cut.json: line 2 is no valid JSON" build cloth.obj -o out --options cut.json
expect 2 "crossing_frames = 100001 is out of range" evaluate --motion a.h5 --crossing-frames 100001
expect 3 "cloth.obj: this is no asset file" evaluate --motion cloth.obj
expect 2 "-o OUTDIR is missing" build cloth.obj
expect 2 "-o ASSET is missing" voxelize cloth.obj
expect 2 "one argument too many" info cloth.obj cloth.obj
expect 2 "no option --voxel; did you mean --voxels" build cloth.obj -o out --voxel 3
expect 2 "no option --voxels" label cloth.h5 --voxels 3
expect 2 "no option -x" build cloth.obj -x
expect 2 "--voxels: a value is missing" build cloth.obj -o out --voxels
expect 2 "voxels = 1 is out of range, it must be between 4 and 1024" \
    build cloth.obj -o out --voxels 1
expect 2 'voxels = "many" is not a whole number or auto' build cloth.obj -o out --voxels many
expect 2 'voxels = "32x" is not' build cloth.obj -o out --voxels=32x
expect 2 "lambda_smooth = -1 is out of range" build cloth.obj -o out --lambda-smooth -1
expect 2 "lambda_smooth = \"nan\"" build cloth.obj -o out --lambda-smooth nan
expect 2 "--no-voxels: the option is not a switch" build cloth.obj -o out --no-voxels
expect 2 "threads = 257 is out of range" build cloth.obj -o out --threads 257
expect 2 "import_memory = 1 is out of range.*MiB" build cloth.obj -o out --import-memory 1
expect 2 'name "a/b"' build cloth.obj -o out --name a/b
expect 2 'mesh "cape" matches no part; names are: sheet' build cloth.obj -o out --mesh cape
expect 2 'no command "bild"' help bild
expect 2 "an input is missing" batch -o out
expect 2 "-o OUTDIR is missing" batch cloth.obj
expect 2 "no option --jobs" build cloth.obj -o out --jobs 2
expect 2 "no option --shards; did you mean --shard" batch cloth.obj -o out --shards 1/2
for shard in 0/2 3/2 2 1/2/3 a/b -1/2 1/0; do
    expect 2 "--shard: \"$shard\" is no part of a whole" batch cloth.obj -o out --shard=$shard
done
expect 2 "jobs = 257 is out of range" batch cloth.obj -o out --jobs 257
expect 3 "nowhere.*.obj: nothing matches" batch 'nowhere/*.obj' -o out

# No result takes the place of what it is made from, whatever the path to it.
expect 2 "cloth.obj: the asset file would replace" voxelize cloth.obj -o ./cloth.obj
"$program" build cloth.obj --no-png --frames 2 -o mine// 2>stderr || fail "build"
grep -q -e '-> mine/cloth\.\*$' stderr || fail "where the results are"
printf '{"frames": 2}' >mine/cloth.json
for input in cloth.glb cloth.proxy.obj; do
    cp mine/$input original
    expect 2 "$input: a result would replace what it is made from" \
        build mine/$input --name cloth --no-png --frames 2 -o mine
    cmp -s mine/$input original || fail "$input was replaced"
done
expect 2 "cloth.json: a result would replace what it is made from" \
    build cloth.obj --options mine/cloth.json --no-png -o mine
[ "$(cat mine/cloth.json)" = '{"frames": 2}' ] || fail "the options were replaced"
[ "$(ls -A mine | wc -l)" -eq 4 ] || fail "something is left behind"

# Files that are missing, of another kind, or damaged.
: >empty.obj
mkdir empty
mkdir folder.obj
mkfifo pipe.obj
printf 'hello\n' >hello.xyz
printf 'hello\n' >hello.glb
printf '\000\001\002\003' >binary.obj
printf '\211HDF\r\n\032\n garbage' >garbage.h5
printf 'glTF\002\000\000\000\377\000\000\000\377\000\000\000JSON{}' >truncated.glb
printf 'glTF\001\000\000\000\024\000\000\000\000\000\000\000\000\000\000\000' >old.glb
printf 'ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n' >truncated.ply
expect 3 "empty: no mesh file is there" batch empty -o out
expect 3 "missing.jsonl: No such file" batch missing.jsonl -o out
expect 3 "missing.obj: No such file" build missing.obj -o out
expect 3 "empty.obj: the file is empty" build empty.obj -o out
expect 3 "folder.obj: this is a folder; " build folder.obj -o out
expect 3 "pipe.obj: not a regular file" build pipe.obj -o out
expect 3 "hello.xyz: unknown format" build hello.xyz -o out
expect 3 "hello.glb: this is no GLB file" build hello.glb -o out
expect 3 "binary.obj: this is no OBJ file" build binary.obj -o out
expect 3 "truncated.glb: the file is truncated" build truncated.glb -o out
expect 3 "old.glb: only version 2" build old.glb -o out
expect 3 "truncated.ply: the file is truncated" build truncated.ply -o out
cp truncated.ply ply.obj
ply() { # ply FORMAT VERTICES FACES: the header
    printf 'ply\nformat %s 1.0\nelement vertex %s\nproperty float x\nproperty float y\n' "$1" "$2"
    printf 'property float z\nelement %s\nproperty list uchar int vertex_indices\nend_header\n' "$3"
}
(ply ascii 4 "face 1" && printf '0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n') >short.ply
expect 3 'short.ply: the file ends behind 0 of 1 elements "face"' build short.ply -o out
(ply ascii 3 "face 2" && printf '0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n3 0 1') >short.ply
expect 3 'short.ply: line 14: too few numbers for an element "face"' build short.ply -o out
(ply ascii 3 "tristrips 1" && printf '0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n') >short.ply
expect 3 'short.ply: triangle strips are not supported' build short.ply -o out
for format in little big; do
    (ply binary_${format}_endian 3 "face 2" && printf '%036d\003%012d\003%011d' 0 0 0) >short.ply
    expect 3 'short.ply: the file ends behind 1 of 2 elements "face"' build short.ply -o out
done
(ply ascii 3 "face 0" && printf '0 0 0\n1 0 0\n1 1 0\n') >points.ply
expect 3 'points.ply: the file has no faces' build points.ply -o out
(printf '%080d\002\000\000\000' 0 && printf '%0099d' 0) >short.stl
expect 3 'short.stl: the file ends behind 1 of 2 triangles' build short.stl -o out
printf 'binary\000' >short.stl
expect 3 'short.stl: the file ends within its header' build short.stl -o out
stl='facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n'
printf "solid a\n${stl}endsolid a\nsolid b\n$stl" >short.stl
expect 3 'short.stl: the file ends before "endsolid"' build short.stl -o out
printf 'v 0 0 0\n' >text.stl
expect 3 'text.stl: this is no STL file' build text.stl -o out
printf '<?xml version="1.0"?><COLLADA><asset>' >short.dae
expect 3 'short.dae: the file cannot be read: .*; export it again' build short.dae -o out
expect 3 "ply.obj: the file holds PLY data" build ply.obj -o out
expect 3 "garbage.h5" label garbage.h5
expect 3 "garbage.h5: this is an asset file" build garbage.h5 -o out
expect 3 "cloth.obj: this is no asset file" label cloth.obj
expect 3 "cloth.obj: this is no asset file" export cloth.obj -o out
expect 3 "missing.h5: No such file" info missing.h5
expect 3 "missing.obj: No such file" evaluate cloth.obj missing.obj
expect 3 "several nodes are called \"joint\".*; rename them, or export as glTF" \
    build "$fixtures/duplicate.dae" -o out
expect 3 "EXT_meshopt_compression is not supported" build "$fixtures/extension.gltf" -o out
expect 3 "refers to a vertex that does not exist" build "$fixtures/face_out_of_range.gltf" -o out
wrong_gltf() { # wrong_gltf PATTERN FIXTURE EDIT
    sed "$3" "$fixtures/$2.gltf" >wrong.gltf
    expect 3 "wrong.gltf: $1" build wrong.gltf -o out
}
wrong_gltf 'TEXCOORD_0 is of type VEC3 instead of VEC2' quantized 's/"VEC2"/"VEC3"/'
wrong_gltf 'JOINTS_0 is stored as numbers that are not read' skin 's/5121/5126/'
wrong_gltf 'JOINTS_0 is stored as numbers' skin 's/^ "meshes": \[/ "animations":[{"samplers":[{"output":2}]}],&/'
wrong_gltf 'numbers reach beyond their buffer' quantized 's/"count": 4/"count": 5/'
for member in bufferView indices mesh; do
    wrong_gltf "\"$member\" refers to what does not exist" quantized "s/\"$member\": [0-9]/\"$member\": 8/"
done
wrong_gltf '"POSITION" refers to what does not exist' quantized 's/"POSITION": 0/"POSITION": 8/'
wrong_gltf '"inverseBindMatrices" refers to what' skin 's/"inverseBindMatrices": 4/"inverseBindMatrices": 6/'
wrong_gltf 'a view reaches beyond its buffer' quantized 's/"buffer": 0/"buffer": 1/'
wrong_gltf 'its buffer 0 has [0-9]* bytes instead of [0-9]*;' quantized 's/==*"/"/; s/.."}\]/"}]/'
wrong_gltf 'its buffer "lost.bin" cannot be read: No such file' quantized 's/"data:[^"]*"/"lost.bin"/'
wrong_gltf 'a buffer in it is not written in base64' quantized 's/;base64//'
wrong_gltf 'its JSON part is damaged' quantized 's/"accessors": \[/"accessors": {/'
wrong_gltf 'a sparse accessor refers to what does not exist' quantized \
    's/"bufferView": 3, "byteOffset": 1/"bufferView": 2, "byteOffset": 4/'
printf '{"asset": {"version": "1.0"}}' >old.gltf
expect 3 "only version 2 of glTF" build old.gltf -o out

# Meshes that make no sense.
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\n' >points.obj
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2 3\n' >lines.obj
printf 'v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n' >nan.obj
printf 'v 0 0 0\nv 1 inf 0\nv 0 1 0\nf 1 2 3\n' >inf.obj
printf 'v 0 0 0\nv 1 1e32 0\nv 0 1 0\nf 1 2 3\n' >huge.obj
printf 'v 1 2 3\nv 1 2 3\nv 1 2 3\nf 1 2 3\n' >equal.obj
printf 'v 0 0 0\nv 1 1 1\nv 2 2 2\nf 1 2 3\n' >line.obj
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 2\nf 3 4 4\n' >flat.obj
expect 3 "points.obj: the file holds no face" build points.obj -o out
expect 3 "lines.obj: .*no triangle" build lines.obj -o out
expect 3 "nan.obj: .*vertex [0-9] has z = -?nan" build nan.obj -o out
expect 3 "inf.obj: .*vertex [0-9] has y = inf" build inf.obj -o out
expect 3 "huge.obj: .*vertex [0-9] has y = 1e\+32" build huge.obj -o out
expect 3 "equal.obj: .*all positions are equal" build equal.obj -o out
expect 3 "line.obj: .*lie on one line" build line.obj -o out
expect 3 "flat.obj: .*no triangle has an area" build flat.obj -o out
expect 3 "nan.obj: .*vertex [0-9] has z = -?nan" voxelize nan.obj -o out.h5
expect 3 "nan.obj" evaluate cloth.obj nan.obj

# What stops a mesh from becoming a garment is told, too, where it is only looked at.
looks_bad() { # looks_bad PATTERN FILE
    "$program" info "$2" >stdout 2>stderr || fail "exit code: info $2"
    grep -Eq "^proxycloth info: warning: $2: .*$1" stderr || fail "no \"$1\" about $2"
    grep -q "^vertices" stdout || fail "no counts of $2"
    "$program" info --json "$2" >stdout 2>stderr || fail "exit code: info --json $2"
    grep -Eq "\"problem\":.*$1" stdout || fail "no \"$1\" about $2 in JSON"
}
looks_bad "vertex [0-9] has z = -?nan" nan.obj
looks_bad "vertex [0-9] has y = inf" inf.obj
looks_bad "no triangle has an area" flat.obj
looks_bad "no triangle" lines.obj

# What is wrong in an OBJ file, with its line; a line that ends in a backslash goes on.
wrong_line() { # wrong_line PATTERN TEXT: the text appended to a square
    printf "v 0 0 0\nv 1 0 0 \\\\\n\nv 1 1 0\n$2" >wrong.obj
    expect 3 "wrong.obj: $1" build wrong.obj -o out
}
wrong_line 'line 5: "0x1" is no number' 'v 0x1 0 0\n'
wrong_line 'line 6: "1..5" is no number' '\nv 0 1..5 0\n'
wrong_line 'line 5: a vertex has 5 numbers' 'v 0 0 0 1 1\n'
wrong_line 'line 5: a vertex has the weight 0' 'v 0 0 0 0\n'
wrong_line 'line 5: there is no vertex 4; the file has 3' 'f 1 2 4\n'
wrong_line 'line 5: there is no vertex -4; the file has 3 up to there' 'f -4 1 2\nv 0 1 0\n'
wrong_line 'line 5: there is no vertex 99999999999999999999; ' 'f 1 2 99999999999999999999\n'
wrong_line 'line 5: there is no vertex 0' 'f 0 1 2\n'
wrong_line 'line 6: there is no texture coordinate 2; ' 'vt 0 0\nf 1/1 2/2 3/1\n'
wrong_line 'line 5: "2-3" is no corner of a face' 'f 1 2-3 3\n'
wrong_line 'line 5: "1/1/1/1" is no corner of a face' 'f 1/1/1/1 2 3\n'
wrong_line 'line 6: "x" is no corner of a face' 'f 1 2 3\nf 1 2 x\n'

# Outputs that cannot be written.
printf 'a file' >file
expect 4 "file: the output folder cannot be written" build cloth.obj -o file
expect 4 "file/out: the output folder cannot be written" build cloth.obj -o file/out
expect 4 "file/out: the output folder cannot be written" batch cloth.obj -o file/out
expect 4 "file/out.h5" voxelize cloth.obj -o file/out.h5
expect 4 "missing/out.h5" voxelize cloth.obj -o missing/out.h5

expect 2 "cloth.obj: body: neither the garment nor the body follows" \
    build cloth.obj -o out --no-png --frames 2 --body-blend 0.3

# Damaged assets, and stages without the ones before.
"$program" voxelize cloth.obj -o cloth.h5 --voxels 8 2>stderr || fail "voxelize"
expect 3 "cloth.h5: stage isosurface has not run yet" label cloth.h5
expect 3 "cloth.h5: stage isosurface has not run yet" export cloth.h5 -o out
expect 3 "cloth.h5: the asset has no proxy yet" evaluate cloth.h5 cloth.h5
expect 3 "cloth.h5: the asset has no proxy yet" evaluate --motion cloth.h5
head -c 1000 cloth.h5 >short.h5
expect 3 "short.h5.*cut off" info short.h5
(cat cloth.h5; printf x) >long.h5
expect 3 "long.h5" isosurface long.h5
cp cloth.h5 newer.h5
"$alter_asset" newer newer.h5 2>stderr || fail "alter_asset newer"
expect 3 "newer.h5.*use a newer proxycloth" info newer.h5
expect 3 "newer.h5.*use a newer proxycloth" isosurface newer.h5
expect 3 "newer.h5.*use a newer proxycloth" export newer.h5 -o out

# Exit code 1: a garment that leads to no proxy mesh; the asset stays as it was.
for stage in isosurface project graph label; do
    "$program" "$stage" cloth.h5 2>stderr || fail "$stage"
done
expect 2 "--write-lp: a value is missing" label cloth.h5 --write-lp
expect 2 "--write-lp: cloth.h5 is the asset file" label cloth.h5 --write-lp cloth.h5
cp cloth.h5 other.h5
expect 2 "--write-lp: other.h5 is the asset file" label other.h5 -o more.h5 --write-lp other.h5
expect 2 "no option --write-lp" graph cloth.h5 --write-lp cloth.lp
expect 2 "no option --write-pl; did you mean --write-lp" label cloth.h5 --write-pl cloth.lp
expect 4 "cloth.obj/x.lp" label cloth.h5 --write-lp cloth.obj/x.lp
cp cloth.h5 unlabelled.h5
"$alter_asset" unlabelled unlabelled.h5 2>stderr || fail "alter_asset unlabelled"
expect 1 "unlabelled.h5.*no triangle is left" carve unlabelled.h5 --layer-source labels

# Limits of the import child: time, and memory (or the crash that follows).
awk 'BEGIN {
    n = 500
    for (i = 0; i < n * n; ++i) printf "v %d %d %d\n", i % n, i / n, (i * 7) % 5
    for (i = 0; i + n + 1 < n * n; ++i) printf "f %d %d %d\n", i + 1, i + 2, i + n + 1
}' >large.obj
expect 7 "large.obj: reading took longer than 0.01 s.*--import-seconds" \
    build large.obj -o out --import-seconds 0.01
"$program" build large.obj -o out --import-memory 16 2>stderr
case $? in
7) grep -q "large.obj: reading needs more than 16 MiB" stderr || fail "memory of the importer" ;;
6) grep -q "large.obj: the importer crashed" stderr || fail "crash of the importer" ;;
*) fail "exit code with --import-memory 16" ;;
esac

# A garment with one bad part is accepted, with a counted warning.
cat >good.obj <<'END'
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0.5 0 1
f 1 2 3
f 1 3 4
END
warns() { # warns LINE FACES: the text appended to good.obj
    pattern=$1
    (cat good.obj && printf "$2") >bad.obj
    "$program" voxelize bad.obj -o bad.h5 --voxels 8 >stdout 2>stderr || fail "exit code: $2"
    grep -Eq "^proxycloth voxelize: warning: visual: $pattern" stderr || fail "no \"$pattern\""
}
warns 'degenerate triangles .*\(1\)' 'f 1 2 5\nf 2 2 3\n'
warns 'duplicate triangles .*\(2\)' 'f 1 2 5\nf 2 3 1\nf 2 3 1\n'
warns 'non-manifold edges .*\(1\)' 'f 1 3 5\n'

# The importer drops those of OBJ files.
printf '%s\n' ply 'format ascii 1.0' 'element vertex 4' 'property float x' 'property float y' \
    'property float z' 'element face 1' 'property list uchar int vertex_indices' end_header \
    '0 0 0' '1 0 0' '0 1 0' '5 5 5' '3 0 1 2' >stray.ply
"$program" voxelize stray.ply -o bad.h5 --voxels 8 >stdout 2>stderr || fail "stray.ply"
grep -Eq "warning: visual: stray vertices .*\(1\)" stderr || fail "no warning of stray vertices"

# Help and version are answers, not errors.
answer() {
    pattern=$1
    shift
    "$program" "$@" >stdout 2>stderr || fail "exit code: $*"
    [ ! -s stderr ] || fail "output on stderr: $*"
    grep -Eq -e "$pattern" stdout || fail "no match for \"$pattern\": $*"
}
answer "^proxycloth [0-9]+\.[0-9]+\.[0-9]+$" version
answer "^proxycloth [0-9]+\.[0-9]+\.[0-9]+$" --version
answer "simplify +single-layer" help
answer "130  interrupted" --help
answer "--voxels NUMBER .*default 32; auto, 4..1024" help build
answer "--carve, --no-carve" build --help
answer "usage: proxycloth label" label -h
answer '"sheet" .* 4 +2 +1 x 1 x 0' info cloth.obj
answer '"triangles":.2' info cloth.obj --json
answer "^hausdorff +0" evaluate cloth.obj cloth.obj
answer '"hausdorff":.0' evaluate cloth.obj cloth.obj --json
answer "^name +cloth" info cloth.h5
answer '"visual_triangles":.2' info --json cloth.h5

finish
