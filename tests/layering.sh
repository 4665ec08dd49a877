#!/bin/sh
# Fails when an include points the wrong way: core knows nothing above it, solvers know core, geometry
# knows both; stages never know each other's insides, io or the pipeline, public headers never name a
# third party, and the program sees public headers only. Usage: sh layering.sh PROJECT_FOLDER
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
insides='core/|solvers/|geometry/|stages/|io/|asset\.h'
above='stages/|io/|asset\.h|proxycloth/(voxelize|isosurface|project|graph|label|carve|simplify|simulate|skin)\.h'
forbid 'public headers name insides or a third party' "$third|$insides" include/proxycloth/*.h
forbid 'core includes what builds on it' "solvers/|geometry/|$above" src/core/*.[ch]
forbid 'solvers include what builds on them' "geometry/|$above" src/solvers/*.[ch]
forbid 'geometry includes what builds on it' "$above" src/geometry/*.[ch]
forbid 'a stage includes io, the asset or a third party' "io/|asset\.h|proxycloth/(pipeline|export|asset_file)|$third" \
    src/stages/*.[ch] src/stages/*/*.[ch]
forbid 'the program includes internals' "$insides" cli/*.[ch]
# Only tests know what is inside the folder of a stage.
inside=$(cd src/stages && printf '%s|' */ | sed 's/|$//')
forbid "a file outside the folder of a stage includes from it" "stages/($inside)" src/*.[ch] src/stages/*.[ch] \
    src/io/*.[ch] cli/*.[ch]
for folder in src/stages/*/; do
    name=$(basename "$folder")
    others=$(cd src/stages && printf '%s\n' */ | grep -v "^$name/" | paste -sd '|')
    forbid "$name includes from another stage's folder" "stages/($others)" "$folder"*.[ch]
done
# Every source file is in the build, and every listed file exists.
for file in src/*.c src/*/*.c src/*/*/*.c; do
    grep -q " $file" CMakeLists.txt || { echo "layering: $file is not built" >&2; bad=1; }
done
exit $bad
