#!/usr/bin/env bash
# citysplat align with COLMAP itself, on a small synthetic flight whose poses are known: one camera, and poses held against
# exact GPS. With the argument `kills` the flight is larger, and align is killed within features, pairs and the model, and
# goes on; that takes minutes. Skipped where COLMAP is not installed.
#
# SPDX-License-Identifier: Apache-2.0
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.." || exit 1
bin=${CITYSPLAT_BIN:?the program under test}
command -v colmap >/dev/null || { echo "skipped: COLMAP is not installed (apt-get install colmap)"; exit 77; }
readonly KILLS=${1:-}
if [ "$KILLS" = kills ]; then
  readonly PHOTOS=36 PLACED_LEAST=35 # 95 %
  readonly GPS_MOST_M=0.5            # 90 % of the poses from their exact GPS; a pixel on the ground is 0.2 m
  readonly CITY=(--width-px 800 --height-px 600 --extent-m 120) SIZE=(--max-edge-px 800 --features 2048)
else
  readonly PHOTOS=10 PLACED_LEAST=10
  readonly GPS_MOST_M=0.5 # 0.13 when written; a pixel on the ground is 0.2 m
  readonly CITY=(--width-px 480 --height-px 360 --extent-m 50) SIZE=(--max-edge-px 480 --features 1024)
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
bad=0
fail() { printf 'FAIL %s\n' "$*"; tail -15 "$work/log" | sed 's/^/    /'; bad=1; }
rows() { sqlite3 -readonly "$out/work/database.db" "$1" 2>/dev/null || echo 0; }

"$bin" synth -q -o "$work/city" --photos $PHOTOS "${CITY[@]}" --points 2000 --seed 3 >/dev/null || exit 1
out=$work/model
align() { "$bin" align "$work/city/images" -o "$out" "${SIZE[@]}" "$@" >"$work/log" 2>&1 </dev/null; }

# killed WHAT CONDITION: killed as soon as the condition holds; it must not be through by then.
killed() {
  align --no-look &
  local pid=$!
  for _ in $(seq 6000); do
    "$2" && break
    kill -0 $pid 2>/dev/null || break
    sleep 0.1
  done
  kill -9 "$(pgrep -P $pid || echo $pid)" 2>/dev/null
  kill -9 $pid 2>/dev/null
  wait $pid 2>/dev/null
  [ ! -e "$out/align.json" ] || fail "killed in $1: it was through"
  [ ! -e "$out/sparse" ] || fail "killed in $1: a partial model"
}
some_features() { [ "$(rows 'SELECT count(*) FROM keypoints')" -ge 5 ]; }
some_pairs() { [ "$(rows 'SELECT count(*) FROM two_view_geometries')" -ge 20 ]; }
some_model() { grep -q 'Registering image' "$out/logs/model.log" 2>/dev/null; }

if [ "$KILLS" = kills ]; then
  killed features some_features
  features=$(rows 'SELECT count(*) FROM keypoints')
  [ "$features" -lt $PHOTOS ] || fail "killed in features: all were there"
  killed pairs some_pairs
  grep -c "Features:" "$out/logs/features.log" >"$work/extracted"
  [ "$(cat "$work/extracted")" -lt $((PHOTOS + features)) ] || fail "features were sought again"
  killed model some_model
fi
align --no-look || fail "align: exit $?"
# COLMAP draws its samples by chance. One draw in six has a focal length that is far off; align seeks those again.
placed=$(sed -n 's/^ *"placed": \([0-9]*\),*$/\1/p' "$out/align.json")
[ "${placed:-0}" -ge $PLACED_LEAST ] || fail "placed ${placed:-none} of $PHOTOS"
[ "$(rows 'SELECT count(DISTINCT camera_id) FROM images')" = 1 ] || fail "more than one camera"
"$bin" ingest "$work/city/images" "$out/sparse" -o "$work/scene" >"$work/log" 2>&1 || fail "ingest: exit $?"
off=$(sed -n 's/^ *"residual_90_m": \([0-9.e-]*\),*$/\1/p' "$work/scene/report.json" | head -1)
awk -v x="${off:-99}" -v most=$GPS_MOST_M 'BEGIN { exit !(x < most) }' || fail "poses are ${off:-?} m from exact GPS"
[ "$bad" = 0 ] && echo "align with COLMAP: $placed of $PHOTOS placed, 90 % within $off m of exact GPS${KILLS:+, after three $KILLS}"
exit "$bad"
