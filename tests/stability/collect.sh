#!/bin/sh
# Runs the tests of lab/STABILITY.md and puts the figures they print into its last section.
#
#   tests/stability/collect.sh [BUILD] [all]     BUILD: build/release if not given; all: also those labelled long
#
# Exit status: that of the tests. With a failed test, or none, the document is left as it is.
#
# SPDX-License-Identifier: Apache-2.0
set -u
cd "$(dirname "$0")/../.." || exit 1
build=${1:-build/release}
long=${2:-}
if [ ! -f "$build/CTestTestfile.cmake" ]; then
    echo "collect.sh: $build holds no tests: build first (cmake --build --preset release), or name the folder" >&2
    exit 2
fi
page=lab/STABILITY.md
log=$(mktemp) || exit 1
new=$(mktemp) || exit 1
trap 'rm -f "$log" "$new"' EXIT
# Rows that a unit test covers are printed by that test.
others='^(step|georef|render|backward|densify|schedule|partition|mask|train|budget|residual|feed)$'
status=0
if [ "$long" = all ]; then
    ctest --test-dir "$build" -V -L stability >"$log" 2>&1 || status=1
else
    ctest --test-dir "$build" -V -L stability -LE long >"$log" 2>&1 || status=1
fi
ctest --test-dir "$build" -V -R "$others" >>"$log" 2>&1 || status=1
figures=$(sed -n 's/^[0-9]*: stability \(F[0-9][0-9]*\|LOD\) /\1 /p' "$log" | sort -V)
printf '%s\n' "$figures"
if [ $status -ne 0 ] || [ -z "$figures" ]; then
    sed -n '/tests failed/,$p' "$log" >&2
    exit 1
fi
[ -f "$page" ] || exit 0
awk -v figures="$figures" '
    /^<!-- figures -->$/ { print; print "```"; print figures; print "```"; skip = 1 }
    /^<!-- end of figures -->$/ { skip = 0 }
    !skip { if ($0 != "<!-- figures -->") print }' "$page" >"$new" && cat "$new" >"$page"
