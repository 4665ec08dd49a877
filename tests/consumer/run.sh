#!/bin/sh
# Installs the build into a scratch folder and consumes it through find_package and pkg-config: a
# builder that makes an asset of plain arrays, and importers in C and C++ that play an asset file.
# Usage: sh run.sh CMAKE BUILD_FOLDER SOURCE_FOLDER DATA_FOLDER
set -eu
cmake=$1
build=$2
source=$3
data=$4
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
"$cmake" --install "$build" --prefix "$scratch/prefix" >/dev/null
"$scratch/prefix/bin/proxycloth" build "$data/makehuman_fedora.obj" -o "$scratch" --name hat \
    --vertices 64 --frames 30 --rounds 2 --no-png --quiet

"$cmake" -S "$source" -B "$scratch/build" -DCMAKE_PREFIX_PATH="$scratch/prefix" >/dev/null
"$cmake" --build "$scratch/build" >/dev/null
"$scratch/build/builder_c"
"$scratch/build/importer_c" "$scratch/hat.h5"
"$scratch/build/importer_cpp" "$scratch/hat.h5"

PKG_CONFIG_PATH=$(dirname "$(find "$scratch/prefix" -name proxycloth.pc)")
export PKG_CONFIG_PATH
# shellcheck disable=SC2046 # flags are words
{
    cc -std=c17 -o "$scratch/builder" "$source/builder.c" $(pkg-config --cflags --libs proxycloth)
    cc -std=c17 -o "$scratch/importer" "$source/importer.c" $(pkg-config --cflags --libs proxycloth)
    c++ -std=c++17 -o "$scratch/importer++" "$source/importer.cpp" \
        $(pkg-config --cflags --libs proxycloth)
}
"$scratch/builder"
"$scratch/importer" "$scratch/hat.h5"
"$scratch/importer++" "$scratch/hat.h5"

# Headers of another version: noticed when the context is made.
sed 's/\(define PC_VERSION_M[A-Z]* *\)[0-9]*/\1 77/' \
    "$scratch/prefix/include/proxycloth/version.h" >"$scratch/version.h"
mv "$scratch/version.h" "$scratch/prefix/include/proxycloth/version.h"
# shellcheck disable=SC2046
cc -std=c17 -o "$scratch/stranger" "$source/importer.c" $(pkg-config --cflags --libs proxycloth)
if "$scratch/stranger" "$scratch/hat.h5" 2>/dev/null; then
    echo "headers of another version are not noticed" >&2
    exit 1
fi

# Every library is listed with version and licence.
"$scratch/prefix/bin/proxycloth" --version --licences >"$scratch/licences"
for name in proxycloth embree hdf5 libpng zlib cxsparse cjson assimp glibc libtbb libsz; do
    grep -Eq "^$name +[0-9][0-9.]* +[A-Za-z]" "$scratch/licences" || {
        echo "--licences does not list $name" >&2
        cat "$scratch/licences" >&2
        exit 1
    }
done
