#!/bin/sh
# Fails when an include points the wrong way: core never knows stages or io, stages never know each
# other's insides, io or the pipeline, public headers never name a third party, and the program sees
# public headers only. Usage: sh layering.sh PROJECT_FOLDER
set -eu
cd "$1"
bad=0
# forbid WHAT PATTERN FILE...
forbid() {
    what=$1
    pattern=$2
    shift 2
    if grep -nE "#include [<\"]($pattern)" "$@"; then
        echo "layering: $what" >&2
        bad=1
    fi
}
third='embree|assimp|hdf5|H5|png|zlib|cs\.h|suitesparse|cjson|omp\.h'
forbid 'public headers name a third party' "$third|core/|stages/|io/" include/proxycloth/*.h
forbid 'core includes a stage, io or the pipeline' \
    'stages/|io/|asset\.h|proxycloth/(voxelize|isosurface|project|graph|label|carve|simplify|simulate|skin)\.h' \
    src/core/*.[ch]
forbid 'a stage includes io, the asset or a third party' "io/|asset\.h|proxycloth/(pipeline|export|asset_file)|$third" \
    src/stages/*.[ch]
forbid 'the program includes internals' 'core/|stages/|io/|asset\.h' cli/*.[ch]
# Every source file is in the build, and every listed file exists.
for file in src/*.c src/*/*.c; do
    grep -q " $file" CMakeLists.txt || { echo "layering: $file is not built" >&2; bad=1; }
done
exit $bad
