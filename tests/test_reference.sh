#!/bin/sh
# The reference is what the program prints: docs/commands.md by `citysplat help --markdown`, docs/man/*.1 by
# `citysplat help --man [COMMAND]`; every page passes `mandoc -Tlint` where mandoc is there. With --write the
# files are made anew. Needs CITYSPLAT_BIN.
#
# SPDX-License-Identifier: Apache-2.0
bin=${CITYSPLAT_BIN:?set it to the citysplat program}
cd "$(dirname "$0")/.." || exit 1
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-reference-XXXXXX") || exit 1
trap 'rm -rf "$work"' EXIT
fail() { echo "FAIL $*"; exit 1; }

mkdir "$work/man1"
"$bin" help --markdown >"$work/commands.md" || fail "citysplat help --markdown"
"$bin" help --man >"$work/man1/citysplat.1" || fail "citysplat help --man"
commands=$(sed -n 's/^COMMAND(\([a-z]*\),.*/\1/p' cli/commands.def)
[ -n "$commands" ] || fail "cli/commands.def names no command"
for c in $commands; do
    "$bin" help --man "$c" >"$work/man1/citysplat-$c.1" || fail "citysplat help --man $c"
done
if [ "$1" = --write ]; then
    mkdir -p docs/man
    rm -f docs/man/*.1
    cp "$work/commands.md" docs/commands.md && cp "$work/man1/"*.1 docs/man/ || fail "not written"
fi
again='CITYSPLAT_BIN=PROGRAM tests/test_reference.sh --write makes it anew'
diff -u docs/commands.md "$work/commands.md" || fail "docs/commands.md is not what the program prints: $again"
diff -ru docs/man "$work/man1" || fail "docs/man is not what the program prints: $again"

# A format that is none, and a command that is none, are errors of the command line.
"$bin" train --help=html >/dev/null 2>&1
[ $? = 2 ] || fail "--help=html is taken"
"$bin" help --man nosuch >/dev/null 2>&1
[ $? = 2 ] || fail "help --man nosuch is taken"

if command -v mandoc >/dev/null; then
    # It looks for our own pages among those that are installed.
    mandoc -Tlint "$work/man1/"*.1 | grep -v 'referenced manual not found: Xr citysplat' >"$work/lint"
    [ ! -s "$work/lint" ] || { cat "$work/lint"; fail "mandoc -Tlint"; }
else
    echo "mandoc is not installed: the pages are not checked by it"
fi
echo "$(ls "$work/man1" | wc -l) manual pages and docs/commands.md are what the program prints"
