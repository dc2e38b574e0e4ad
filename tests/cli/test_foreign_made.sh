#!/bin/bash
# Foreign files that this test makes itself: tables with decimal commas and names in other forms, outliers, axes, and the
# fit of an import to places on the ground. Each gives the right value, or an error that says what is wrong, where, and what
# to do. test_foreign.sh has other people's files.
#
# SPDX-License-Identifier: Apache-2.0
set -u
bin=$(realpath "${CITYSPLAT_BIN:?set it to the citysplat program}")
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-made-XXXXXX") || exit 1
trap 'rm -rf "$work"' EXIT
export LC_ALL=C.UTF-8
place() { echo "$work"; }
# shellcheck source=tests/cli/foreign.sh
. "$(dirname "$0")/foreign.sh"
check() { # NAME COMMAND...: the command holds
  local name=$1
  shift
  if "$@"; then passed=$((passed + 1)); else failed=$((failed + 1)); echo "FAIL $name"; fi
}

"$bin" synth -q -o "$work/city" --photos 12 --width-px 160 --height-px 120 --extent-m 40 --points 800 >/dev/null || exit 1
mapfile -t names < <(ls "$work/city/images")
ingest() { "$bin" ingest "$@" -o "$work/scene" --overwrite --max-edge-px 64 --no-exposure; }
is 'as it is' 0 'origin   lon 7\.573' ingest city/images city/sparse

# ---- tables: decimal commas, capitals, backslashes, letters with marks in one character and two
list() { # SEPARATOR NUMBERS NAMES: positions of the photographs, from their EXIF by our own reading
  local n k=0
  printf 'Image%bLon%bLat%bHeight\n' "$1" "$1" "$1"
  for n in "${names[@]}"; do
    k=$((k + 1))
    printf "$3$1$2$1$2$1$2\n" "$n" "7.57$((300 + k % 4 * 10))" "47.558$((10 + k / 4 * 10))" "360.$k"
  done
}
list ';' '%s' '%s' >"$work/points.csv"
is 'decimal points and semicolons' 0 '12 photographs: those of --positions' ingest city/images city/sparse --positions points.csv
scale=$(grep -o '"scale_m": [0-9.]*' "$work/scene/report.json")
for separator in ';' '\t'; do
  list "$separator" '%s' '%s' | sed 's/\([0-9]\)\.\([0-9]\)/\1,\2/g' >"$work/commas.csv"
  is "decimal commas, separator $separator" 0 $'decimal commas are read as points\n12 photographs: those of --positions' \
    ingest city/images city/sparse --positions commas.csv
  check "decimal commas, separator $separator: another scale" grep -qF "$scale" "$work/scene/report.json"
done
list ';' '%s' 'D:\\Fl\u00fcge\\%s' | sed 's/IMG/img/' >"$work/names.csv"
is 'capitals and backslashes' 0 $'12 names differ from those of the photographs\n12 photographs: those of --positions' \
  ingest city/images city/sparse --positions names.csv
list ';' '%s' 'Ko\u0308ln/%s' >"$work/nfd.csv"
is 'a folder with an umlaut in two characters' 0 '12 photographs: those of --positions' ingest city/images city/sparse --positions nfd.csv

# OpenDroneMap's geo.txt, UTF-16, and a system by a code alone
{ echo EPSG:4326 && list ' ' '%s' '%s' | tail -n +2; } >"$work/geo.txt"
is 'geo.txt' 0 '12 photographs: those of --positions' ingest city/images city/sparse --positions geo.txt
check 'geo.txt: another scale' grep -qF "$scale" "$work/scene/report.json"
iconv -t UTF-16 "$work/points.csv" >"$work/wide.csv"
is 'UTF-16' 0 '12 photographs: those of --positions' ingest city/images city/sparse --positions wide.csv
check 'UTF-16: another scale' grep -qF "$scale" "$work/scene/report.json"
sed 's/;360[.][13]$/;-9999/' "$work/points.csv" >"$work/unknown.csv"
is 'heights of -9999' 0 $'2 rows have no coordinates and are left out\n10 photographs: those of --positions' \
  ingest city/images city/sparse --positions unknown.csv
is 'all photographs stay' 0 '12 of 12 photographs' ingest city/images city/sparse --positions unknown.csv

printf 'EPSG:4326\n392740.9 5268339.1 280 10 10 %s g1\n' "${names[@]}" >"$work/utm.txt"
sed -i '3,${/EPSG/d}' "$work/utm.txt"
is 'metres in a list of degrees' 2 'utm.txt: line 2: ground control point g1: .* is no longitude and latitude' \
  ingest city/images city/sparse --gcp utm.txt

# ---- Gaussians: outliers, unusable rows, axes
# ply FILE ROW...: an ASCII .ply of 3DGS: 100 in a box of 20 units, and more rows "x y z".
ply() {
  local file=$1 extra=("${@:2}") p
  {
    printf 'ply\nformat ascii 1.0\nelement vertex %d\n' $((100 + ${#extra[@]}))
    for p in x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3; do printf 'property float %s\n' $p; done
    printf 'end_header\n'
    for k in $(seq 0 99); do printf '%d %d %d 0.5 0.2 -0.3 2 -2 -3 -4 1 0.2 0 0\n' $((k % 10 * 2)) $((k / 10 * 2)) $((k % 3)); done
    for p in "${extra[@]}"; do printf '%s 0.5 0.2 -0.3 2 -2 -3 -4 1 0 0 0\n' "$p"; done
  } >"$work/$file"
}
import() { "$bin" import "$1" -o "$work/out.tiles" --overwrite "${@:2}"; }
ply plain.ply
is 'no outliers' 0 'tiles, zoom' import plain.ply --origin 8,50,100
check 'no outliers: told of some' sh -c "! grep -q 'outlier' '$work/log'"
ply near.ply '5000 0 0'
is 'an outlier at 5 km' 0 '1 Gaussians lie more than 1[0-9]{3} m .*--drop-outliers leaves them out' import near.ply --origin 8,50,100
is 'an outlier at 5 km, left out' 0 '1 Gaussians lie more than .*left out' import near.ply --origin 8,50,100 --drop-outliers
ply far.ply '0 0 3e9' 'nan 0 0'
is 'an outlier at 3 million km, and no number' 1 'row 100 lies 3000000 km .*--drop-outliers' import far.ply --origin 8,50,100
is 'both, left out' 0 $'1 of 102 rows are left out: not finite\n1 Gaussians lie more than' import far.ply --origin 8,50,100 --drop-outliers
ply large.ply '0 0 0' '1 1 1'
sed -i '$s/-2 -3 -4/12 -3 -4/' "$work/large.ply"
is 'a standard deviation of 163 km' 0 '1 Gaussians lie more than .*or are so large, up to 162\.75.*--drop-outliers' import large.ply --origin 8,50,100
is 'the same, left out' 0 '1 Gaussians lie more than .*left out' import large.ply --origin 8,50,100 --drop-outliers
sed -i '$s/12 -3 -4/60 -3 60/' "$work/large.ply"
is 'one of 1e26 m' 1 'row 101 .*or is so large.*--drop-outliers' import large.ply --origin 8,50,100
awk 'NF == 14 { $1 += 392740; $2 += 5268339 } 1' "$work/plain.ply" | sed 's/float \([xyz]\)$/double \1/' >"$work/utm.ply"
is 'coordinates of a map' 1 'middle of the Gaussians, 3927[0-9]+ 52683[0-9]+ 1, lies 5283 km .*Subtract' import utm.ply --origin 7.57,47.56,0
is 'info of them' 0 'unusable +1' "$bin" info far.ply
is 'axes that nobody says, .ply to .glb' 0 'axes' "$bin" convert plain.ply as_is.glb --overwrite
is 'axes that are said, .ply to .spz' 0 'gaussians=100' "$bin" convert plain.ply up.spz --axes enu --overwrite
is 'and back' 0 'gaussians=100' "$bin" convert up.spz back.ply --ply-axes gltf --overwrite

# ---- three places of the file and of the ground
# The file is turned by 90 degrees about up, twice as small, and its 10,10,0 lies at 8.68 50.11 160 (a degree of latitude
# there is 111,236 m, one of longitude 71,478).
cat >"$work/places.txt" <<'P'
# x y z, longitude, latitude, height
10 10 0    8.68          50.11       160
20 10 0    8.68          50.1101798  160
10 20 0    8.67972019    50.11       160
10 10 5    8.68 50.11    170
P
is 'a fit to four places' 0 $'fit +(1\\.99|2\\.00)[0-9]* m a unit of the file, RMSE 0\\.0[0-9]+ m at 4 places\nplace 4' import plain.ply --origin places.txt
is 'where it lies' 0 'origin_lon_lat_h +8\.6799' "$bin" info out.tiles
sed 's/8.67972019/8.6805/' "$work/places.txt" >"$work/wrong.txt"
is 'a place that is wrong' 0 'contradict each other' import plain.ply --origin wrong.txt
printf '0 0 0 8 50 100\n1 1 1 8.0001 50.0001 110\n2 2 2 8.0002 50.0002 120\n' >"$work/line.txt"
is 'places on a line' 1 'lie on a line' import plain.ply --origin line.txt
head -3 "$work/places.txt" >"$work/two.txt"
is 'two places' 1 'two.txt: 2 places, three at least' import plain.ply --origin two.txt
printf '0 0 0 50.11 8.68\n' >"$work/short.txt"
is 'a place without a height' 1 'short.txt: line 1: field 6' import plain.ply --origin short.txt
printf '10,5 20,5 0,5 8,68 50,11 160\n' >"$work/commas.txt"
is 'decimal commas' 1 'commas.txt: line 1: 11 fields' import plain.ply --origin commas.txt
is 'neither' 2 'no such|longitude, latitude and height' import plain.ply --origin nowhere.txt

echo "$passed passed, $failed failed"
[ $failed = 0 ]
