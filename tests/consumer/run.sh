#!/bin/sh
# Installs the build into a scratch folder and consumes it through find_package and pkg-config.
# Usage: sh run.sh CMAKE BUILD_FOLDER SOURCE_FOLDER
set -eu
cmake=$1
build=$2
source=$3
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
"$cmake" --install "$build" --prefix "$scratch/prefix" >/dev/null

"$cmake" -S "$source" -B "$scratch/build" -DCMAKE_PREFIX_PATH="$scratch/prefix" >/dev/null
"$cmake" --build "$scratch/build" >/dev/null
"$scratch/build/consumer_c"
"$scratch/build/consumer_cpp"

PKG_CONFIG_PATH=$(dirname "$(find "$scratch/prefix" -name proxycloth.pc)")
export PKG_CONFIG_PATH
# shellcheck disable=SC2046 # flags are words
cc -std=c17 -o "$scratch/consumer" "$source/consumer.c" $(pkg-config --cflags --libs proxycloth)
"$scratch/consumer"
"$scratch/prefix/bin/proxycloth" --version
