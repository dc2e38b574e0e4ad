#!/bin/sh
# Every record of lab/runs may be used (its commit is in the history, it is as long and of as many seeds as its study
# states), every table of docs/ says what the records say, and what is wrong with a record is named. A shallow clone
# leaves the history out. Needs CITYSPLAT_BIN.
#
# SPDX-License-Identifier: Apache-2.0
bin=${CITYSPLAT_BIN:?set it to the citysplat program}
lab=$bin-lab
cd "$(dirname "$0")/../.." || exit 1
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-records-XXXXXX") || exit 1
trap 'rm -rf "$work"' EXIT
failed=0
for page in lab/BENCHMARKS.md lab/studies; do
    "$lab" study-chart lab/runs -o lab/charts --check --markdown "$page" -q >"$work/log" 2>&1 || { cat "$work/log"; failed=1; }
done

# Every record is on a page, or a page says what it is: the name of its file stands in docs/.
for runs in lab/runs/*.jsonl; do
    grep -qr --include='*.md' "$(basename "$runs")" lab docs || { echo "no page names $runs"; failed=1; }
done

# Refusals, in a history of its own.
refuse() { # PATTERN RECORD...
    pattern=$1
    shift
    printf '%s\n' "$@" >"$work/repo/runs/time.jsonl"
    "$lab" study-chart "$work/repo/runs" -o "$work/repo" --check >"$work/log" 2>&1 && { echo "taken: $*"; failed=1; }
    grep -q -- "$pattern" "$work/log" || { cat "$work/log"; echo "lacks '$pattern'"; failed=1; }
}
record() { # STUDY ROW COMMAND COMMIT
    printf '{"study":"%s","row":"%s","what":"level 1","dataset":"d","command":"%s","commit":"%s","device":"d","numbers":{"psnr_db":30}}' "$@"
}
if command -v git >/dev/null; then
    mkdir -p "$work/repo/runs"
    git() { command git -C "$work/repo" -c user.name=n -c user.email=e@example.org "$@"; }
    git init -q . && git commit -q --allow-empty -m a && git checkout -q -b other && git commit -q --allow-empty -m b
    away=$(git rev-parse --short HEAD)
    git checkout -q - && git commit -q --allow-empty -m c
    here=$(git rev-parse --short HEAD~1)
    refuse "commit '$away' is not in the history" "$(record time 'a: b' 'train --iterations 250' "$away")"
    refuse "commit '--help' is not in the history" "$(record time 'a: b' 'train --iterations 250' --help)"
    refuse "249 steps, and the study states 250" "$(record time 'a: b' 'train --iterations 249' "$here")"
    refuse "row 'b': 0 steps" "$(record time b 'train' "$here")"
    refuse "study 'none' states no length" "$(record none b 'train --iterations 250' "$here")"
    refuse "row 'b': 2 seeds, and the study states 3" "$(record embedding 'b (seed 1)' 'train --seed 1 --iterations 1500' "$here")" \
        "$(record embedding 'b (seed 2)' 'train --seed 2 --iterations 1500' "$here")" "$(record embedding 'b (seed 2) ' 'train --seed 2 --iterations 1500' "$here")"
    record time 'a: b' 'train --iterations 250' "$here" >"$work/repo/runs/time.jsonl"
    "$lab" study-chart "$work/repo/runs" -o "$work/repo" --check >"$work/log" 2>&1 || { cat "$work/log"; failed=1; }
    printf '<!-- table time -->\nanother figure\n<!-- end -->\n' >"$work/repo/page.md"
    "$lab" study-chart "$work/repo/runs" -o "$work/repo" --check --markdown "$work/repo/page.md" >"$work/log" 2>&1 && { echo "a wrong table is taken"; failed=1; }
    grep -q 'says something else than the records' "$work/log" || { cat "$work/log"; failed=1; }
    grep -q 'another figure' "$work/repo/page.md" || { echo "--check writes"; failed=1; }
    # Seeds of a row are one row: the mean of PSNR and its spread, the median of seconds, what any of the machines could do.
    seed() { # SEED PSNR SECONDS FMA ROW
        printf '{"study":"embedding","row":"%s (seed %s)","what":"level 1, half image","dataset":"d","command":"train --seed %s --iterations 1500","commit":"%s","device":"d","fma_gflops":%s,"triad_gbps":20,"numbers":{"level":1,"seed":%s,"psnr_db":%s,"train_s":%s}}\n' \
            "$5" "$1" "$1" "$here" "$4" "$1" "$2" "$3"
    }
    { seed 1 30 10 50 a; seed 2 31 20 100 a; seed 3 32 90 40 a; seed 1 36 10 50 b; seed 2 36 10 50 b; seed 3 36 10 50 b; } >"$work/repo/runs/embedding.jsonl"
    printf '<!-- table embedding -->\n<!-- end -->\n' >"$work/repo/page.md"
    if command -v gnuplot >/dev/null; then
        "$lab" study-chart "$work/repo/runs" -o "$work/repo" --no-png --markdown "$work/repo/page.md" >"$work/log" 2>&1 || { cat "$work/log"; failed=1; }
        for row in '^| a | 3 | 31.00 | 1.00 | – | 20.0 |' '^| b | 3 | 36.00 | 0.00 | +5.00 | 10.0 |' 'FMA 40 to 100 GFLOP/s, triad 20 GB/s'; do
            grep -q -- "$row" "$work/repo/page.md" || { cat "$work/repo/page.md"; echo "lacks '$row'"; failed=1; }
        done
    fi
fi
[ $failed = 0 ] && echo ok
exit $failed
