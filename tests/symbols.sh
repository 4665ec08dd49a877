#!/bin/sh
# Fails when the library defines a global symbol that is not pc_... (public) or pci_... (internal), or
# when a public function of the headers is missing. Usage: sh symbols.sh LIBRARY INCLUDE_FOLDER
set -eu
symbols=$(nm --defined-only --extern-only "$1" | awk 'NF == 3 { print $3 }' | sort -u)
[ -n "$symbols" ] || { echo "$1 defines nothing" >&2; exit 1; }
if echo "$symbols" | grep -Ev '^pci?_'; then
    echo "these symbols of the library do not begin with pc_ or pci_" >&2
    exit 1
fi
# Names before an opening parenthesis at the end of a declaration; inline functions need no symbol.
missing=$(sed -n '/^ *\/\//d; /static inline/,/^}/d; s/^[^=]*[ *]\(pc_[a-z0-9_]*\)(.*/\1/p' "$2"/*.h | sort -u |
    while read -r name; do echo "$symbols" | grep -qx "$name" || echo "$name"; done)
[ -z "$missing" ] || { echo "declared and not defined: $missing" >&2; exit 1; }
