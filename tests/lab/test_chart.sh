#!/bin/sh
# `citysplat-lab study-record`, `study-chart` and `chart`: a tiny set of runs becomes charts and tables; missing
# gnuplot and bad records are one clear error. Needs CITYSPLAT_BIN; what needs gnuplot is skipped (77) without it.
#
# SPDX-License-Identifier: Apache-2.0
bin=${CITYSPLAT_BIN:?set it to the citysplat program}
lab=$bin-lab
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-chart-XXXXXX") || exit 1
trap 'rm -rf "$work"' EXIT
fail() { echo "FAIL $*"; exit 1; }
expect() { grep -q -- "$1" "$2" || { cat "$2"; fail "$2 lacks '$1'"; }; }

# Runs: what eval, train and the benchmarks write.
runs=$work/runs
mkdir -p "$runs" "$work/run/cells/a" "$work/run/cells/b"
scores() { # PSNR SSIM GAUSSIANS
    printf '{"device": "a device", "scores": [{"what": "level 1", "photographs": 4, "edge_px": 100, "psnr_db": 20, "ssim": 0.5, "gaussians": 10, "ms_frame": 1, "bytes": 100}, {"what": "level 2", "photographs": 4, "edge_px": 200, "psnr_db": %s, "ssim": %s, "gaussians": %s, "ms_frame": 2, "bytes": 2000000}]}\n' "$@" >"$work/scores.json"
}
for cell in a b; do
    printf '{"event":"start","t_s":0}\n{"event":"level","level":1,"seconds":10,"peak_bytes":1000000}\n{"event":"level","level":2,"seconds":3%s,"peak_bytes":5000000}\n' \
        "$([ $cell = a ] && echo 0 || echo 5)" >"$work/run/cells/$cell/metrics.jsonl"
done
printf '{"bench":"ceiling","case":"fma","value":80,"unit":"GFLOP/s"}\n{"bench":"ceiling","case":"triad","value":20,"unit":"GB/s"}\n' >"$work/ceilings"
add() { # STUDY ROW SET
    "$lab" study-record "$runs/$1.jsonl" --study "$1" --row "$2" --command "train $2 --iterations 2000" --dataset "toy city" --commit abc \
        --scores "$work/scores.json" --results "$work/run" --ceilings "$work/ceilings" --set "$3" || fail "record $1 $2"
}
scores 21 0.6 1000; add budgets "1 k" budget=1000
scores 23 0.7 2000; add budgets "2 k" budget=2000
scores 24.5 0.75 4000; add budgets "4 k" budget=4000
for seed in 1 2 3; do
    scores 24 0.74 4000; add ablation "full (seed $seed)" "seed=$seed"
    scores 23.5 0.75 3000; add ablation "no anti-aliasing (seed $seed)" "seed=$seed"
    scores 24.25 0.745 5000; add ablation "it's \`odd\` \$HOME \"x\" (seed $seed)" "seed=$seed"
done
expect '"train_s":65' "$runs/budgets.jsonl"         # 30 + 35, both cells
expect '"train_longest_s":35' "$runs/budgets.jsonl" # the slower one
expect '"fma_gflops":80' "$runs/budgets.jsonl"
[ "$(wc -l <"$runs/budgets.jsonl")" = 6 ] || fail "three runs of two levels make $(wc -l <"$runs/budgets.jsonl") records"
scores 25 0.76 4000; add budgets "2 k" budget=2000
[ "$(wc -l <"$runs/budgets.jsonl")" = 6 ] || fail "a run recorded again is not replaced"
sed -n 4p "$runs/budgets.jsonl" | grep -q '"psnr_db":25' || fail "a replaced run changes its place"

# What else was scored of the finest level is not its score against photographs.
sed -n '4s/"what": *"level 2"/"what":"level 2, surface"/p' "$runs/budgets.jsonl" >"$work/surface"
[ -s "$work/surface" ] || fail "no line of the finest level"
cat "$work/surface" >>"$runs/budgets.jsonl"

# Refusals.
refuse() { # PATTERN COMMAND...
    pattern=$1
    shift
    "$@" >"$work/log" 2>&1 && fail "taken: $*"
    expect "$pattern" "$work/log"
    [ "$(grep -c 'error:' "$work/log")" = 1 ] || fail "not one error line: $*"
}
refuse 'expected a number' "$lab" study-record "$work/x.jsonl" --study a --row b --set k=x
refuse 'required' "$lab" study-record "$work/x.jsonl" --study a
refuse 'not the results' "$lab" study-record "$work/x.jsonl" --study a --row b --results "$work/none"
refuse 'apt-get install gnuplot' env PATH=/nonexistent "$lab" study-chart "$runs" -o "$work/none"
ls "$work/none"/* >/dev/null 2>&1 && fail "without gnuplot something was written"
mkdir "$work/empty"
refuse 'no recorded runs' "$lab" study-chart "$work/empty" -o "$work/none"
echo '{"study":"a","row":"b"}' >"$work/bad.jsonl"
refuse "record 1: no text 'what'" "$lab" study-chart "$work/bad.jsonl" -o "$work/none"
echo 'nonsense' >"$work/bad.jsonl"
refuse 'line 1: expected a JSON object' "$lab" study-chart "$work/bad.jsonl" -o "$work/none"
refuse 'no such chart' "$lab" study-chart "$runs" -o "$work/none" --only nosuch

command -v gnuplot >/dev/null || { echo "skipped: gnuplot is not installed"; exit 77; }

# Charts and tables.
mkdir "$work/docs"
doc=$work/docs/page.md
printf 'Before.\n\n<!-- chart budgets -->\nold\n<!-- end -->\n\nBetween.\n\n<!-- table budgets -->\n<!-- end -->\n<!-- table lod -->\nold\n<!-- end -->\nAfter.\n' >"$doc"
"$lab" study-chart "$runs" -o "$work/docs/charts" --markdown "$doc" >"$work/log" 2>&1 || { cat "$work/log"; fail chart; }
for f in budgets ablation; do
    [ -s "$work/docs/charts/$f.svg" ] && [ -s "$work/docs/charts/$f.png" ] || fail "no chart $f"
    head -c 400 "$work/docs/charts/$f.svg" | grep -q '<svg' || fail "$f.svg is not SVG"
done
expect 'PSNR (dB)' "$work/docs/charts/budgets.svg"
expect 'no anti-aliasing' "$work/docs/charts/ablation.svg"
expect '-0.50' "$work/docs/charts/ablation.svg" # 23.5 - 24
expect '+0.25' "$work/docs/charts/ablation.svg"
expect 'odd HOME x' "$work/docs/charts/ablation.svg" # what gnuplot would interpret is gone
grep -q "$(basename "$HOME")/" "$work/docs/charts/ablation.svg" && fail "a variable was expanded"
expect '^!\[.*\](charts/budgets.svg)$' "$doc"
expect '^| 2 k | 4.0 | 25.00 | 0.7600 |' "$doc"
[ "$(grep -c '^| 2 k | 4.0 |' "$doc")" = 1 ] || fail "the surface is in the table of photographs"
expect 'Not recorded: `lab/study.sh lod`' "$doc"
expect 'abc, on a device, FMA 80 GFLOP/s, triad 20 GB/s' "$doc"
for text in Before Between After; do expect "^$text" "$doc"; done
grep -q '^old' "$doc" && fail "old tables stay"
cp "$doc" "$work/again"
"$lab" study-chart "$runs" -o "$work/docs/charts" --no-png --markdown "$doc" -q >/dev/null || fail "chart again"
cmp -s "$doc" "$work/again" || fail "writing again changes the page"
pages=$work/docs/pages
mkdir "$pages"
cp "$doc" "$pages/a.md"
printf 'One\n<!-- table lod -->\nold\n<!-- end -->\n' >"$pages/b.md"
"$lab" study-chart "$runs" -o "$work/docs/charts" --no-png --markdown "$pages" -q >/dev/null || fail "pages of a folder"
if grep -q '^old' "$pages/b.md"; then fail "the second page stays"; fi
"$lab" study-chart "$runs" -o "$work/docs/charts" --check --markdown "$pages" -q >/dev/null || fail "check of a folder"
echo '<!-- chart nosuch -->' >>"$pages/b.md"
refuse "no chart is called 'nosuch'" "$lab" study-chart "$runs" -o "$work/docs/charts" --markdown "$pages"
echo '<!-- chart nosuch -->' >>"$doc"
refuse "no chart is called 'nosuch'" "$lab" study-chart "$runs" -o "$work/docs/charts" --markdown "$doc"
printf '<!-- chart lod -->\nopen\n' >"$doc"
refuse "not closed" "$lab" study-chart "$runs" -o "$work/docs/charts" --markdown "$doc"
expect '^open' "$doc"
ls "$work/docs/charts"/*.part* >/dev/null 2>&1 && fail "part files stay"

# A user's own runs: scenes as `citysplat train` leaves them, two cells of one and one of the other.
for cell in near/cells/a near/cells/b far/cells/all; do
    mkdir -p "$work/$cell"
    printf '{"event":"level","level":1,"gaussians":100,"test_photographs":1,"psnr_db":20,"ssim":0.5,"ms_frame":2,"seconds":10,"peak_bytes":5}\n{"event":"level","level":2,"gaussians":300,"test_photographs":3,"psnr_db":%s,"ssim":0.7,"ms_frame":4,"seconds":30,"peak_bytes":7}\n' \
        "$(case $cell in *a) echo 24 ;; *b) echo 26 ;; *) echo 30 ;; esac)" >"$work/$cell/metrics.jsonl"
    head -c 1000000 /dev/zero >"$work/$cell/level2.ckpt"
done
"$lab" chart "$work/near" "$work/far" -o "$work/own" >"$work/table" 2>"$work/log" || { cat "$work/log"; fail "chart of scenes"; }
for f in accuracy_seconds accuracy_gaussians accuracy_bytes accuracy_frame; do
    [ -s "$work/own/$f.svg" ] && [ -s "$work/own/$f.png" ] || fail "no chart $f"
done
# Both cells: 600 Gaussians, 60 s, 2 MB, the mean of 24 and 26 dB over as many photographs.
expect 'near: level 2 |.*25\.00.*0\.6.*2\.00.*60\.0' "$work/table"
expect 'far: level 2 |.*30\.00' "$work/table"
refuse 'not a trained scene' "$lab" chart "$work/runs" -o "$work/own"
mkdir -p "$work/bare/cells/all"
refuse 'no cell has a metrics.jsonl' "$lab" chart "$work/bare" -o "$work/own"
printf '{"event":"level","level":1,"gaussians":100,"test_photographs":0,"seconds":10}\n' >"$work/bare/cells/all/metrics.jsonl"
refuse 'no level has a score' "$lab" chart "$work/bare" -o "$work/own"
echo ok
