#!/bin/sh
# Which lines and branches of a folder its tests reach, by gcov: a line a file, the least covered first, and a sum.
#
#   tests/coverage.sh server          builds build/coverage, runs the folder's unit tests
#   tests/coverage.sh server --again  reads what earlier runs left there
#
# Not in CI: a build of its own, and minutes. The process that draws counts as well; what a test kills does not.
#
# SPDX-License-Identifier: Apache-2.0
cd "$(dirname "$0")/.." || exit 1
module=${1:?folder}
build=build/coverage
if [ "${2:-}" != --again ]; then
    cmake --preset coverage >/dev/null || exit 1
    tests=$(sed -n "s/^ *unit([a-z\/]*\/\\([a-z0-9_]*\\)\\( [a-z_]*\\)* $module\\( .*\\)*)\$/\\1/p" tests/CMakeLists.txt)
    targets=citysplat # some start the program
    for t in $tests; do targets="$targets test_$t"; done
    # shellcheck disable=SC2086
    cmake --build --preset coverage --target $targets -- -j "${JOBS:-$(nproc)}" >/dev/null || exit 1
    find $build -name '*.gcda' -delete
    ctest --preset coverage -R "^($(echo $tests | tr ' ' '|'))\$" >&2 || exit 1
fi
# What no test ran has no .gcda, and counts as it is.
for source in $(find "$module" -name '*.c'); do
    note=$build/$module/CMakeFiles/$module.dir/${source#"$module"/}.gcno
    [ -e "$note" ] || continue
    gcov -n -b -o "$(dirname "$note")" "$note" 2>/dev/null | awk -v want="$source" '
        /^File / { here = index($0, "/" want "\047") || $0 == "File \047" want "\047" }
        here && /^Lines executed:/ { split($0, a, /[:% ]+/); lines = a[5]; hit = a[3] }
        here && /^Taken at least once:/ { split($0, a, /[:% ]+/); branches = a[7]; taken = a[5] }
        END { if (lines) print want, lines, hit, branches + 0, taken + 0 }'
done | awk '
    { printf "%6.1f %% of %5d lines %6.1f %% of %5d branches  %s\n", $3, $2, $5, $4, $1 | "sort -n"
      lines += $2; hit += $2 * $3 / 100; branches += $4; taken += $4 * $5 / 100 }
    END { close("sort -n")
          if (lines) printf "%6.1f %% of %5d lines %6.1f %% of %5d branches  in all\n", 100 * hit / lines, lines, 100 * taken / branches, branches }'
