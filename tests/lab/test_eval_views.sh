#!/bin/sh
# Map views and the flight from end to end: a small city, ingested, trained for a moment and tiled, is scored
# against its own truth by kind of view, from the checkpoint and from the tiles, flown into, and refined in two orders.
#
# SPDX-License-Identifier: Apache-2.0
# shellcheck source=tests/lab/trained.sh
. "$(dirname "$0")/trained.sh"
lab eval-views scene city/map-views -o levels.json --pictures out
grep -q "overview" log && grep -q "^level 2 *all  *8 " log || fail "rows of the finest level"
[ "$(ls out/level_2 | wc -l)" = 8 ] || fail "pictures of 8 views"
for key in psnr_db bright_psnr_db ssim gmsd square_psnr_db bright_square_psnr_db depth_median depth_95 depth_above_2pct halo fog gaps haze veil; do
    grep -q "\"$key\": [0-9]" levels.json || fail "$key in the JSON"
done
lab eval-views scene city/map-views --tiles t.tiles --max-edge-px 96
grep -q "^tiles, LOD *all  *8 " log || fail "rows of the tiles"
# Nothing pops where nothing changes level.
lab eval-flight scene --tiles t.tiles --frames 6 --max-edge-px 96 -o flight.json
grep -Eq "^tiles, no LOD +6 +0 +0 +0.000" log || fail "the finest level alone pops"
grep -q '"pop_99"' flight.json || fail "pop_99 in the JSON"
# Levels that fade into each other pop less, and no picture on the way is far from both.
row() { awk '/^tiles, LOD/ { print $'"$1"' }' log; }
lab eval-flight scene --tiles t.tiles --frames 24 --max-edge-px 96
at_once=$(row 5)
lab eval-flight scene --tiles t.tiles --frames 24 --max-edge-px 96 --fade 8
[ "$at_once" -gt 20 ] && [ $((2 * $(row 5))) -lt "$at_once" ] || fail "a fade pops by half of $at_once or less"
[ "$(row 8)" -gt 0 ] && [ "$(row 8)" -lt 12 ] || fail "a fade strays little"
"$bin-lab" eval-flight scene --frames 6 >log 2>&1 && fail "a flight without --tiles"
grep -q -- "--tiles" log || fail "says what is missing"
# Orders of refinement: the finest level scores as elsewhere; the order that knows the photographs is the better one; where
# every tile is coarse, both are the same picture.
run tile scene --name fine --tile-edge-m 15 -o fine.tiles -q
lab eval-photographs scene --tiles fine.tiles --half-image off
finest=$(awk '/^tiles, no LOD/ { print $6 }' log)
lab eval-order scene --tiles fine.tiles -o order.json
grep -q "^finest level: $finest dB of 3 photographs" log || fail "the finest level has $finest dB in eval-photographs"
order() { awk '$1 == "by" && $2 == "'"$1"'" && ++n == '"$2"' { print $'"$3"' }' log; }
awk -v a="$(order error 1 6)" -v b="$(order photograph 1 6)" 'BEGIN { exit !(b < a) }' || fail "the best order loses less"
[ -n "$(order error 4 5)" ] && [ "$(order error 4 4) $(order error 4 5)" = "$(order photograph 4 4) $(order photograph 4 5)" ] ||
    fail "all tiles coarse in both orders"
awk -v a="$(order error 1 4)" 'BEGIN { exit !(a > 0.8 && a < 0.95) }' || fail "a share of 0.9 is left"
grep -q '"loss_db"' order.json || fail "loss_db in the JSON"
"$bin-lab" eval-order scene >log 2>&1 && fail "an order without --tiles"
grep -q -- "--tiles" log || fail "says what is missing"
# Views in the light of photographs.
lab map-views city --count 4 --light -o lit -q
[ "$(grep -c '"photograph": "IMG_[0-9]*.jpg"' lit/views.json)" = 4 ] || fail "views name the photograph of their light"
lab eval-views scene lit
# They are exposed as their photograph was, and drawn in its appearance: said to be of another one, they fit worse.
psnr() { awk '$3 == "all" { print $5 }' log; }
lab synth --extent-m 60 --photos 24 --width-px 96 --height-px 72 --points 3000 --exposure-ev 1 -o bright -q
lab map-views bright --count 8 --light -q
run ingest bright/images bright/sparse -o bright-scene -q
cp -r bright/map-views swapped
awk '/"photograph"/ { sub(/IMG_[0-9]*/, sprintf("IMG_%04d", 2 + 7 * n++ % 22)) } { print }' bright/map-views/views.json >swapped/views.json
run train bright-scene --level-count 1 --iterations 120 --budget 4000 -o exposure -q
run train bright-scene --level-count 1 --iterations 500 --budget 4000 --no-exposure --appearance --appearance-warmup 50 -o appearance -q
for results in exposure appearance; do
    lab eval-views bright-scene bright/map-views --results $results
    right=$(psnr)
    lab eval-views bright-scene swapped --results $results
    awk -v a="$right" -v b="$(psnr)" 'BEGIN { exit !(b > 5 && a > b + 3) }' ||
        fail "$results: $right dB of the right photographs, $(psnr) dB of others"
done
# The benchmark of formats exposes what it draws as eval does.
run tile bright-scene --trained exposure --crop none -o bright.tiles -q
run eval bright-scene --tiles bright.tiles
tiles=$(awk '/no LOD  / { print $6 }' log)
"$bin-lab" rd --quick --scene bright-scene --tiles bright.tiles --record rd.jsonl >log 2>&1 || { cat log; fail rd; }
trained=$(sed -n 's/.*"row":"trained".*"psnr_db":\([0-9.]*\).*/\1/p' rd.jsonl | head -1)
awk -v a="$tiles" -v b="$trained" 'BEGIN { exit !(a > 10 && a - b < 0.1 && b - a < 0.1) }' || fail "tiles have $tiles dB by eval, $trained by rd"
sed 's/"photograph": "IMG_/"photograph": "XYZ_/' lit/views.json >other && cp other lit/views.json
"$bin-lab" eval-views scene lit >log 2>&1 && fail "light of a photograph that is not there"
grep -q "XYZ_.*which the scene does not have" log || fail "says which photograph is missing"
"$bin-lab" eval-views scene city >log 2>&1 && fail "a folder without views"
grep -q "map-views" log || fail "says who makes views"
echo "map views and flight hold"
