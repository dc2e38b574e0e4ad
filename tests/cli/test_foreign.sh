#!/bin/bash
# Files of other programs and cameras, rebuilt from public reports, through the whole program: each gives the right
# value, or an error that names what, which and what to do. The inputs are too large for the repository: they lie in
# CITYSPLAT_FAULTS, by default ../shared/data/faults beside it. Needs CITYSPLAT_BIN.
#
# SPDX-License-Identifier: Apache-2.0
set -u
bin=$(realpath "${CITYSPLAT_BIN:?set it to the citysplat program}")
here=$(cd "$(dirname "$0")/../.." && pwd)
faults=${CITYSPLAT_FAULTS:-$here/../shared/data/faults}
if [ ! -d "$faults" ]; then
  echo "skipped: no folder $faults with the cases (CITYSPLAT_FAULTS)"
  exit 77
fi
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-foreign-XXXXXX") || exit 1
trap 'rm -rf "$work"' EXIT
place() { echo "$faults/$1"; }
# shellcheck source=tests/cli/foreign.sh
. "$(dirname "$0")/foreign.sh"
ingest() { # CASE EXIT PATTERN OPTIONS...
  local name=$1 want=$2 pattern=$3
  shift 3
  is "$name" "$want" "$pattern" "$bin" ingest ./images ./sparse/0 "$@" -o "$work/x" --overwrite
}

# The ground of the survey lies at 280 m above the sea, and its middle at 7.5731, 47.5584.
ground='h 280\.[0-9]+ m'
ingest 01-point-error-minus-1 0 '16 of 16 photographs .*, 5901 points'
ingest 03-alpha-ignored 0 '16 photographs have transparent pixels'
ingest 03-alpha-ignored 0 'option format is gone and does nothing' --format png
[ "$(find "$work/x/masks" -name '*.png' | wc -l)" = 16 ] || { failed=$((failed + 1)); echo "FAIL 03: no 16 masks"; }
ingest 04-xmp-absolute-altitude-ignored 0 "$ground"$'\n''contradict each other: -426\.7 m and 426\.6 m.*wrong sign'
ingest 05-altitude-zero 0 "$ground"$'\n''16 photographs have the altitude 0 in EXIF'
ingest 07-rtkalt-without-rtk 0 "$ground"$'\n''scene count from sea level by EXIF'
ingest 08-negative-rational 0 'lon -70\.6500.* lat -33\.8599'
ingest 14-gcp-blanks 0 'by [0-9]+ ground control points' --gcp ./gcp_list.txt
for k in k02 k03c k04 k07b; do
  ingest 15-gcp-header 0 'lon 7\.573[0-9]+ lat 47\.558' --gcp "./gcp_$k.txt"
done
ingest 15-gcp-header 0 'lon -43\.1999[0-9]+ lat -22\.9000' --gcp ./gcp_k20b.txt --no-gps-check
for k in metashape.txt pix4d.csv comment.csv; do
  ingest 17-positions-headings 0 "$ground"$'\n''16 photographs: those of --positions' --positions "./$k"
done
ingest 18-positions-swapped 1 '5[0-9]+\.[0-9] km from.*x and y are swapped' --positions ./pos.txt
is 09-spz-coordinate-system 0 'gaussians=100' "$bin" convert v4_coordRDF.spz "$work/rdf.ply" --ply-axes gltf --overwrite
is 09-spz-coordinate-system 0 'gaussians=100' "$bin" convert s_v3_coordRDF.spz "$work/rdf3.ply" --ply-axes gltf --overwrite
for k in rdf rdf3; do # the first mean: -6.4155 10.595 1.987
  first=$(tail -c +$(($(grep -abom1 end_header "$work/$k.ply" | cut -d: -f1) + 12)) "$work/$k.ply" | od -An -tf4 -N12)
  awk '{ exit !($1 < -6.41 && $1 > -6.42 && $2 > 10.59 && $2 < 10.6 && $3 > 1.98 && $3 < 1.99) }' <<<"$first" &&
    passed=$((passed + 1)) || { failed=$((failed + 1)); echo "FAIL 09: $k: $first"; }
done
is 10-import-outliers 1 '28053 km from the middle.*--drop-outliers' \
  "$bin" import f1_mcmc.ply --origin 8.68,50.11,100 -o "$work/far.tiles" --overwrite
[ ! -e "$work/far.tiles" ] || { failed=$((failed + 1)); echo "FAIL 10: a store was left behind"; }
is 10-import-outliers 0 '5 Gaussians lie more than .*left out' \
  "$bin" import f1_mcmc.ply --origin 8.68,50.11,100 -o "$work/near.tiles" --overwrite --drop-outliers
is 10-import-outliers 0 . "$bin" export "$work/near.tiles" -o "$work/near3d" --format 3dtiles --overwrite
is 11-convert-axes 0 'kept as they are.*y down' "$bin" convert base.ply "$work/a.sog" --overwrite
is 11-convert-axes 0 'gaussians=200' "$bin" convert base.ply "$work/b.sog" --axes ydown --overwrite
cmp -s "$work/a.sog" "$work/b.sog" || { failed=$((failed + 1)); echo "FAIL 11: --axes ydown gives another .sog"; }
is 21-unusable-rows 0 '8 rows are left out' "$bin" import p07_nan.ply --origin 8,50,100 -o "$work/nan.tiles" --overwrite
is 21-unusable-rows 0 'unusable +8' "$bin" info p07_nan.ply
is 21-unusable-rows 0 'unusable +199' "$bin" info p04_postshot_zero.ply
is 22-ply-rgb 0 'gaussians=200' "$bin" convert p02_rgb_only.ply "$work/rgb.ply" --overwrite
is 22-ply-rgb 0 'gaussians=200' "$bin" convert p06_2dgs.ply "$work/2dgs.ply" --overwrite
is 23-colmap-models 1 'EQUIRECTANGULAR is not read.*panoramas' "$bin" ingest images c1_EQUIRECTANGULAR/0 -o "$work/x" --overwrite
is 23-colmap-models 0 '5901 points' "$bin" ingest images c1_SIMPLE_FISHEYE/0 -o "$work/x" --overwrite
is 23-colmap-models 1 'DIVISION is not read.*image_undistorter' "$bin" ingest images c1t_DIVISION/0 -o "$work/x" --overwrite
is 25-xmp-forms 0 "$ground"$'\n'"barometer's above take-off" "$bin" ingest ./ds/images ./ds/sparse/0 -o "$work/x" --overwrite
is 26-sog1 0 'gaussians=3000' "$bin" convert z_v1.sog "$work/sog1.ply" --overwrite
is 26-sog1 0 'gaussians=3000' "$bin" convert unb/meta.json "$work/sogdir.ply" --overwrite

echo "$passed passed, $failed failed"
[ $failed = 0 ]
