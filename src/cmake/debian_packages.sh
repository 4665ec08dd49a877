#!/bin/sh
# Installs the Debian packages that are named on the command line and missing. Does nothing, and needs
# no network, when all of them are there. Usage: sh debian_packages.sh PACKAGE...
set -eu
missing=
for package in "$@"; do
    if ! dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'install ok installed'; then
        missing="$missing $package"
    fi
done
[ -n "$missing" ] || exit 0
if ! command -v apt-get >/dev/null; then
    echo "these packages are needed, and apt-get is not here to install them:$missing" >&2
    exit 1
fi
run=
if [ "$(id -u)" -ne 0 ]; then
    run=sudo
fi
echo "installing:$missing"
export DEBIAN_FRONTEND=noninteractive
$run apt-get -q update
# shellcheck disable=SC2086 # one word per package
$run apt-get -q -y --no-install-recommends install $missing
