#!/bin/sh
# The surface from end to end: a small city, ingested, trained for a moment and tiled, is measured against its own
# truth and its own points.
#
# SPDX-License-Identifier: Apache-2.0
# shellcheck source=tests/lab/trained.sh
. "$(dirname "$0")/trained.sh"
# The surface against the city, from the checkpoint with map views and from the tiles.
lab eval-surface scene city -o surface.json
for row in level edges all "level ground" ground roof wall tree "bright from 0.6" points; do
    grep -q "^$row  *[a-z0-9]" log || fail "a row '$row' of the surface"
done
grep -q '"views_of": "map views: wall"' surface.json || fail "walls of map views"
for key in level_rmse_m ground_thickness_m ground_never_opaque follows_brightness f1_1_gsd faint_share; do
    grep -Eq "\"$key\": -?[0-9]" surface.json || fail "$key in the JSON"
done
grep -Eq '"gaussians": [1-9][0-9]{3}' surface.json || fail "how many Gaussians"
rmse() { sed -n 's/.*"level_rmse_m": \([0-9.]*\).*/\1/p' "$1"; }
lab eval-surface scene city --tiles t.tiles -o tiles.json
awk -v a="$(rmse surface.json)" -v b="$(rmse tiles.json)" 'BEGIN { exit !(a > 0 && a < 30 && a - b < 0.1 * a && b - a < 0.1 * a) }' ||
    fail "level places are off by $(rmse surface.json) m from the checkpoint, by $(rmse tiles.json) m from its tiles"
# A surface model of the tiles is scored by other code, of other pixels: it comes out alike.
run dsm t.tiles -o dsm.tif --gsd-m 0.8
lab truth city dsm.tif
for row in level edges all; do grep -Eq "^$row +[0-9]+( +[-0-9.]+){10}$" log || fail "a row '$row' of the surface model"; done
awk -v a="$(rmse surface.json)" -v b="$(awk '$1 == "level" { print $5 }' log)" 'BEGIN { exit !(b > 0.6 * a && b < 1.8 * a) }' ||
    fail "level places are off by $(rmse surface.json) m along rays, by $(awk '$1 == "level" { print $5 }' log) m in the surface model"
# The standard deviations beside the heights: what they say of the errors.
for row in level edges all; do
    grep -Eq "^sigma   $row: [1-9][0-9]* pixels, median [0-9.]+ m; [0-9.]+, [0-9.]+ and [0-9.]+ % of the errors" log || fail "sigma of '$row'"
done
awk '$1 == "sigma" && $2 == "all:" { gsub(",", ""); ok = $8 > 20 && $8 <= $9 && $9 <= $11 && $11 <= 100 } END { exit !ok }' log ||
    fail "errors over standard deviations: $(grep '^sigma' log)"
# Its errors as a map: heights of the model less those of the city, on the same pixels.
lab truth city dsm.tif -o errors.tif
grep -q "^level " log || fail "the map of errors comes without figures"
gdalinfo -mm errors.tif | tr , ' ' | awk -F'[= ]+' '/Computed Min\/Max/ { ok = $(NF - 1) < 0 && $NF > 0 && $NF < 60 } END { exit !ok }' ||
    fail "the map of errors has $(gdalinfo -mm errors.tif | grep Computed)"
# Bare earth lies below the surface: its heights are off by less from the ground than the surface's are.
run dsm t.tiles -o dtm.tif --gsd-m 0.8 --ground
grep -q "bare earth" log || fail "dsm --ground does not say that it is bare earth"
gdalinfo dtm.tif | grep -q "bare earth" || fail "the file does not say that it is bare earth"
lab truth city dtm.tif --ground
for row in seen below all; do grep -Eq "^$row +[0-9]+( +[-0-9.]+){10}$" log || fail "a row '$row' of bare earth"; done
grep -q "^walls" log && fail "walls of bare earth"
bare=$(awk '$1 == "below" { print $5 }' log)
lab truth city dsm.tif --ground
awk -v a="$bare" -v b="$(awk '$1 == "below" { print $5 }' log)" 'BEGIN { exit !(a > 0 && a < 0.5 * b) }' ||
    fail "below houses bare earth is off by $bare m, the surface by $(awk '$1 == "below" { print $5 }' log) m"
# Points have its classes, and lie where they lie without them.
run points t.tiles -o plain.las --gsd-m 0.8
run points t.tiles -o classes.las --gsd-m 0.8 --ground
class() { od -An -v -tu1 -w36 -j "$(od -An -tu4 -j 96 -N 4 "$1")" "$1" | awk '{ n[$17]++ } END { for (c in n) print c, n[c] }' | sort -n; }
[ "$(class plain.las | awk '{ print $1 }')" = 1 ] || fail "classes without --ground: $(class plain.las)"
class classes.las | awk '{ n[$1] = $2 } END { exit !(n[2] > 100 && n[6] > 50) }' || fail "classes: $(class classes.las)"
# Points on walls come beside the others.
run points t.tiles -o walls.las --gsd-m 0.8 --walls
walls=$(sed -n 's/.* \([0-9]*\) of them on walls.*/\1/p' log)
[ "$walls" -gt 100 ] || fail "points on walls: '$walls'"
[ $(($(class walls.las | awk '{ print $2 }') - walls)) = "$(class plain.las | awk '{ print $2 }')" ] ||
    fail "$(class walls.las) points with walls, $(class plain.las) without, $walls on walls"
# Without a truth there are the points of the scene.
lab eval-surface scene points -o points.json
grep -Eq "^all +[1-9][0-9]{3}" log || fail "points that five photographs show"
for key in points_rmse_m points_nmad_m photographs_thickness_m photographs_never_opaque; do
    grep -Eq "\"$key\": [0-9]" points.json || fail "$key in the JSON"
done
# A city of another seed is another surface.
run synth --extent-m 60 --photos 24 --width-px 96 --height-px 72 --points 3000 --seed 2 -o elsewhere -q
lab eval-surface scene elsewhere -o elsewhere.json
grep -q "no map views" log || fail "says that there are no map views"
awk -v a="$(rmse surface.json)" -v b="$(rmse elsewhere.json)" 'BEGIN { exit !(b > a + 0.5) }' ||
    fail "against another city RMSE is $(rmse elsewhere.json) m, against its own $(rmse surface.json)"
"$bin-lab" eval-surface scene scene >log 2>&1 && fail "a surface without a city"
grep -q "citysplat synth" log || fail "says who makes a city"
echo "surfaces hold"
