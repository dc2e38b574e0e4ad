#!/usr/bin/env bash
# test_kernels.sh: `citysplat-lab kernels` has a limit for every kernel that a step launches, and sums of a frame and
# of a step.
#
# SPDX-License-Identifier: Apache-2.0
set -euo pipefail
lab=$CITYSPLAT_BIN-lab
[ -x "$lab" ] || { echo "no $lab"; exit 77; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$lab" kernels --quick --runs 1 >"$work/lines" 2>"$work/table" || { cat "$work/table"; exit 1; }
# A line: a kernel or a sum, all of its numbers above 0 and finite but for the multiply-adds, which may be 0.
awk -F'[,{}]' '
    !/"series":"[a-z_]* \([0-9.]* launches|"series":"all kernels of a / { next }
    {
        /launches/ ? kernels++ : sums++
        for (k in want)
            delete want[k]
        for (i = 1; i <= NF; i++) {
            n = index($i, "\":")
            key = substr($i, 2, n - 2); value = substr($i, n + 2)
            want[key] = value
        }
        for (k = split("value ratio took_ms bytes limit_ms", keys, " "); k; k--)
            if (want[keys[k]] !~ /^[0-9.]+(e[-+]?[0-9]+)?$/ || !(want[keys[k]] + 0 > 0)) { print keys[k] ": " $0; bad = 1 }
        if (want["multiply_adds"] !~ /^[0-9.]+(e[-+]?[0-9]+)?$/ || want["bound"] !~ /^"(memory|arithmetic)"$/) { print; bad = 1 }
    }
    END {
        if (kernels < 30 || sums != 4) print kernels " kernels, " sums " sums"
        exit bad || kernels < 30 || sums != 4
    }' "$work/lines" || exit 1
grep -q '^kernel .* took, ms *limit, ms *times bound by' "$work/table"
grep -qE '^blend .* (memory|arithmetic)$' "$work/table"
echo "every kernel has a limit"
