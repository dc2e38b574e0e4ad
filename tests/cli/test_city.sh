#!/usr/bin/env bash
# ./bootstrap city: a second run goes on where the first was killed, and trains nothing again; folders of one name do not
# collide; options reach ingest; other options do not remove what was trained; photographs alone get poses first, by a
# stand-in for COLMAP (tests/cli/fake_colmap.c).
#
# SPDX-License-Identifier: Apache-2.0
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.." || exit 1
bin=${CITYSPLAT_BIN:?the program under test}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export CITYSPLAT_BIN=$bin CITYSPLAT_OUT=$work/out
bad=0

fail() { printf 'FAIL %s\n' "$*"; sed 's/^/    /' "$work/log" | tail -15; bad=1; }
expect() { grep -q -- "$2" "$work/log" || fail "$1: '$2' is not said"; }
city() { ./bootstrap city "$@" --no-serve --iterations 2000 --max-edge-px 64 >"$work/log" 2>&1; }

for place in a b; do
  "$bin-lab" synth -q -o "$work/$place/my flight" --photos 16 --width-px 64 --height-px 48 --extent-m 60 --points 600 \
    --supersample 1 --seed $((${#place} + 1)) >/dev/null || exit 1
done

# Stopped while it trains: the state is kept, and the next run goes on with it.
setsid ./bootstrap city "$work/a/my flight" --no-serve --iterations 2000 --max-edge-px 64 >"$work/log" 2>&1 &
pid=$!
for _ in $(seq 1200); do
  grep -qs '"event":"step"' "$work"/out/my-flight/scene/cells/*/metrics.jsonl && break # before it no state is worth keeping
  sleep 0.1
done
pkill -TERM -g "$pid" citysplat
wait "$pid" 2>/dev/null
scene=$work/out/my-flight/scene
[ -f "$scene/scene.json" ] || fail "no scene after the stop"
made=$(stat -c %Y.%i "$scene/scene.json")
city "$work/a/my flight" || fail "the second run: exit $?"
expect "the second run" "the scene is there already"
expect "the second run" "a training was interrupted: it goes on"
expect "the second run" "steps more with all 16 photographs"
[ "$(stat -c %Y.%i "$scene/scene.json")" = "$made" ] || fail "the second run made the scene again"
[ -f "$work/out/my-flight/my-flight.tiles" ] || fail "no tiles"

# All is there: nothing is made again.
done_at=$(stat -c %Y.%i "$scene/cells/all/done.json")
tiles_at=$(stat -c %Y.%i "$work/out/my-flight/my-flight.tiles")
city "$work/a/my flight" || fail "the third run: exit $?"
expect "the third run" "complete already"
expect "the third run" "tiles are there already"
[ "$(stat -c %Y.%i "$scene/cells/all/done.json")" = "$done_at" ] || fail "the third run trained again"
[ "$(stat -c %Y.%i "$work/out/my-flight/my-flight.tiles")" = "$tiles_at" ] || fail "the third run tiled again"

# Other options: refused, with what was trained untouched.
city "$work/a/my flight" --origin 7.5,47.5,300 && fail "other options were taken"
expect "other options" "made with other options"
[ "$(stat -c %Y.%i "$scene/cells/all/done.json")" = "$done_at" ] || fail "other options touched the training"

# Another folder of that name, with options for ingest.
city "$work/b/my flight" --origin 7.5731,47.5582,300 --geoid egm96 || fail "the other folder: exit $?"
other=$(ls -d "$work"/out/my-flight-*)
[ -f "$other/scene/scene.json" ] || fail "the other folder has no scene of its own"
grep -q '"origin": "7.5731,47.5582,300"' "$other/scene/report.json" || fail "--origin did not reach ingest"
grep -q '"heights": "ellipsoid"' "$other/scene/scene.json" || fail "--geoid did not reach ingest"
[ "$(stat -c %Y.%i "$scene/cells/all/done.json")" = "$done_at" ] || fail "the other folder touched the first one"

# A model that changed since is named, and nothing is made of the old one. Without the change all is as before.
echo "# more" >"$work/b/my flight/sparse/0/more.txt"
city "$work/b/my flight" --origin 7.5731,47.5582,300 --geoid egm96 && fail "a changed model was passed over"
expect "a changed model" "my flight/sparse has changed since"
rm "$work/b/my flight/sparse/0/more.txt"
touch "$work/b/my flight/sparse/0/"*
city "$work/b/my flight" --origin 7.5731,47.5582,300 --geoid egm96 || fail "the model as before: exit $?"
expect "the model as before" "the scene is there already"

# Photographs alone: their poses come first. What failed goes on; what is there is not done again.
mkdir "$work/path" "$work/c" && ln -s "${FAKE_COLMAP:?the stand-in for COLMAP}" "$work/path/colmap"
cp -r "$work/a/my flight/images" "$work/c/photographs alone"
export PATH=$work/path:$PATH FAKE_LOG=$work/calls FAKE_TRUTH=$work/a/my\ flight/sparse/0
FAKE_FAIL=mapper city "$work/c/photographs alone" && fail "an alignment that failed was taken"
expect "a failed alignment" "mapper: exit 1"
alone=$work/out/photographs-alone
[ ! -e "$alone/scene" ] && [ ! -e "$alone/align/sparse" ] || fail "an alignment that failed left something"
: >"$work/calls"
city "$work/c/photographs alone" || fail "photographs alone: exit $?"
expect "photographs alone" "16 of 16 photographs"
[ "$(cut -d' ' -f1 "$work/calls" | sort | uniq -c | tr -d ' \n')" = 1mapper ] || fail "a failed alignment began anew"
[ -f "$alone/photographs-alone.tiles" ] || fail "photographs alone: no tiles"
city "$work/c/photographs alone" || fail "photographs alone again: exit $?"
expect "photographs alone again" "the poses are there already"
expect "photographs alone again" "tiles are there already"
[ "$(wc -l <"$work/calls")" = 1 ] || fail "photographs alone again: COLMAP was called"

# More minutes may place what has no pose; a model that stays as it was leaves the scene as it is.
sed -i 's/"unplaced": \[\]/"unplaced": [{"name": "a.png", "why": "w", "features": 1, "matches": 0}]/' "$alone/align/align.json"
city "$work/c/photographs alone" --minutes 60 || fail "more minutes: exit $?"
expect "more minutes" "1/5 align"
expect "more minutes" "the scene is there already"
grep -q '"minutes": 60' "$alone/align/align.json" || fail "more minutes: align did not get them"

# The forecast: what is known before work, and nothing is made.
before=$(find "$work/out" | sort)
./bootstrap city "$work/a/my flight" --dry-run --iterations 2000 --max-edge-px 64 >"$work/log" 2>&1 || fail "--dry-run: exit $?"
expect "--dry-run" "14 train, 2 are kept for scores"
expect "--dry-run" "^minutes  of a processor"
grep -Eq '^train +[0-9]+\.[0-9]' "$work/log" || fail "--dry-run: no minutes of training"
grep -q '^align ' "$work/log" && fail "--dry-run: poses that are there are sought"
expect "--dry-run" "2000 steps; at most"
[ "$(find "$work/out" | sort)" = "$before" ] || fail "--dry-run made something"
./bootstrap city "$work/c/photographs alone" --dry-run >"$work/log" 2>&1 || fail "--dry-run of photographs alone: exit $?"
grep -Eq '^align +[0-9]+\.[0-9]' "$work/log" || fail "--dry-run of photographs alone: no minutes of alignment"

# Paths of options are seen from where the script is called.
echo "EPSG:4326" >"$work/gcp_list.txt"
here=$PWD
(cd "$work" && "$here/bootstrap" city "a/my flight" --name gcp --gcp gcp_list.txt --no-serve) >"$work/log" 2>&1
expect "--gcp" "gcp_list.txt: no ground control points"
./bootstrap city "$work/nowhere" >"$work/log" 2>&1 && fail "a folder that is not there was taken"
expect "no folder" "a folder is expected"
./bootstrap city "$work/a/my flight" --frobnicate >"$work/log" 2>&1 && fail "an unknown option was taken"
expect "unknown option" "unknown option --frobnicate"
[ "$bad" = 0 ] && echo "a second run goes on; names do not collide; options reach ingest"
exit "$bad"
