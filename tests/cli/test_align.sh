#!/usr/bin/env bash
# citysplat align, with a stand-in for COLMAP (tests/cli/fake_colmap.c): what it is asked, what is told of photographs that
# find no place, kill -9 in every stage and the run after it, stages that fail, options, and folders that are not ours.
#
# SPDX-License-Identifier: Apache-2.0
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.." || exit 1
bin=${CITYSPLAT_BIN:?the program under test}
fake=${FAKE_COLMAP:?the stand-in for COLMAP}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
bad=0
export FAKE_LOG=$work/calls FAKE_TRUTH=$work/city/sparse/0

fail() { printf 'FAIL %s\n' "$*"; sed 's/^/    /' "$work/log" | tail -20; bad=1; }
expect() { grep -Eq -- "$2" "$work/log" || fail "$1: '$2' is not said"; }
called() { grep -Ec -- "$1" "$FAKE_LOG"; }
align() { "$bin" align "$@" --colmap "$fake" --threads 1 >"$work/log" 2>&1 </dev/null; }
refused() { # WHAT PATTERN FOLDER-THAT-MUST-NOT-EXIST ARGUMENTS...
  local what=$1 pattern=$2 absent=$3
  shift 3
  "$bin" align "$@" >"$work/log" 2>&1 </dev/null && fail "$what: was taken"
  expect "$what" "$pattern"
  [ "$(grep -c 'error:' "$work/log")" = 1 ] || fail "$what: not exactly one error"
  [ -z "$absent" ] || [ ! -e "$absent" ] || fail "$what: $absent was left behind"
}
placed() { number placed "$1/align.json"; }
number() { # KEY FILE
  sed -n "s/^ *\"$1\": \([0-9]*\),*$/\1/p" "$2"
}

"$bin-lab" synth -q -o "$work/city" --photos 24 --width-px 96 --height-px 72 --extent-m 60 --points 1500 --supersample 1 >/dev/null || exit 1
photos=$work/city/images
mapfile -t names < <(ls "$photos")

# -- all is well -------------------------------------------------------------------------------------------
align "$photos" -o "$work/a" || fail "a good folder: exit $?"
expect "a good folder" "24 of 24 photographs match a neighbour"
expect "a good folder" "model    .*/a/sparse/0: 24 of 24 photographs"
[ "$(placed "$work/a")" = 24 ] || fail "a good folder: placed $(placed "$work/a")"
grep -q '"colmap": "COLMAP 3.8' "$work/a/align.json" || fail "align.json has no version"
for stage in look features matches model; do
  [ -s "$work/a/logs/$stage.log" ] || fail "no log of $stage"
  grep -q "\"$stage\": [0-9]" "$work/a/align.json" || fail "align.json has no seconds of $stage"
done
"$bin" ingest "$photos" "$work/a/sparse" -o "$work/scene" -q >"$work/log" 2>&1 || fail "ingest of the model: exit $?"
"$bin" ingest "$photos" "$work/city/sparse" -o "$work/scene2" -q >"$work/log" 2>&1
cmp -s "$work/scene/points.bin" "$work/scene2/points.bin" || fail "the model is not COLMAP's"

# Run again: nothing is done again.
cp "$FAKE_LOG" "$work/before"
align "$photos" -o "$work/a" || fail "a complete folder: exit $?"
cmp -s "$FAKE_LOG" "$work/before" || fail "a complete folder: COLMAP was called again"
expect "a complete folder" "24 of 24 photographs"

# Pairs: by GPS and order, not all with all; one camera for one lens.
[ "$(called 'feature_extractor .*single_camera 1')" = 2 ] || fail "features: not one call for the look and one for all"
pairs=$(number pairs "$work/a/align.json")
# Options reach COLMAP.
align "$photos" -o "$work/options" --max-edge-px 77 --features 555 --lens radial --no-look --neighbours 3 --next 1 || fail "options: exit $?"
few=$(number pairs "$work/options/align.json")
[ "$few" -ge 23 ] && [ "$few" -le $((24 * 4)) ] && [ "$pairs" -le 276 ] && [ "$few" -lt "$pairs" ] || fail "pairs: $pairs, few: $few"
[ "$(called 'feature_extractor .*camera_model RADIAL .*max_image_size 77 --SiftExtraction.max_num_features 555 --SiftExtraction.num_threads 1')" = 1 ] || fail "options do not reach COLMAP"
grep -q '"edge_px": 77' "$work/options/align.json" || fail "align.json has another size"
[ ! -e "$work/options/work/look.db" ] || fail "--no-look looked"

# A look alone; the work that follows uses it, and gets two models.
: >"$FAKE_LOG"
align "$photos" -o "$work/dry" --dry-run || fail "--dry-run: exit $?"
expect "--dry-run" "forecast [0-9]+ px, [0-9]+ features"
[ ! -e "$work/dry/sparse" ] && [ "$(called mapper)" = 0 ] || fail "--dry-run made a model"
FAKE_SPLIT=1 align "$photos" -o "$work/dry" --max-edge-px 80 || fail "two models: exit $?"
[ "$(called 'feature_extractor .*look.db')" = 1 ] || fail "after --dry-run: looked twice"

# Two models: the largest first, whatever COLMAP's order.
expect "two models" "sparse/1: [0-9]+ photographs that nothing joins to it"
expect "two models" "it is in sparse/1, which nothing joins"
in_second=$(ls "$photos" | grep -c 1)
least=$((in_second < 12 ? in_second : 24 - in_second))
[ "$(placed "$work/dry")" = $((24 - least)) ] || fail "two models: placed $(placed "$work/dry"), want $((24 - least))"

# -- mappers -----------------------------------------------------------------------------------------------
mapper() { sed -n 's/^ *"mapper": "\([a-z]*\)",*$/\1/p' "$1/align.json" | head -1; }
[ "$(mapper "$work/a")" = incremental ] || fail "COLMAP 3.8: the mapper is $(mapper "$work/a")"
refused "no prior" "--mapper prior: COLMAP 3.8.* has no pose_prior_mapper" "$work/p0/sparse" "$photos" -o "$work/p0" --colmap "$fake" --mapper prior
refused "no GLOMAP" "no global_mapper, and there is no program glomap" "$work/p0/sparse" "$photos" -o "$work/p0" --colmap "$fake" --mapper global --overwrite
: >"$FAKE_LOG"
FAKE_NEW=1 align "$photos" -o "$work/p1" --no-look --gps-sigma-m 2 || fail "a newer COLMAP: exit $?"
[ "$(called '^pose_prior_mapper .*--overwrite_priors_covariance 1 --use_robust_loss_on_prior_position 1 --prior_position_std_x 2 --prior_position_std_y 2 --prior_position_std_z 6$')" = 1 ] || fail "GPS is no prior of a newer COLMAP"
[ "$(called '^feature_extractor .*--FeatureExtraction.use_gpu 0')" = 1 ] || fail "a newer COLMAP: options of older ones"
[ "$(mapper "$work/p1")" = prior ] && [ "$(placed "$work/p1")" = 24 ] || fail "a newer COLMAP: $(mapper "$work/p1"), $(placed "$work/p1") placed"
FAKE_NEW=1 FAKE_FAIL=pose_prior_mapper align "$photos" -o "$work/p2" --no-look || fail "a prior that gives no model: exit $?"
expect "a prior that gives no model" "with GPS as prior there is no model .*sought without"
[ "$(mapper "$work/p2")" = incremental ] && [ "$(placed "$work/p2")" = 24 ] || fail "a prior that gives no model: $(mapper "$work/p2")"
FAKE_NEW=1 FAKE_FAIL=pose_prior_mapper align "$photos" -o "$work/p3" --no-look --mapper prior && fail "a prior that was asked for and failed was taken"
FAKE_NEW=global align "$photos" -o "$work/p4" --no-look --mapper global || fail "a global mapper: exit $?"
[ "$(called '^global_mapper ')" = 1 ] && [ "$(mapper "$work/p4")" = global ] || fail "a global mapper: $(mapper "$work/p4")"
mkdir "$work/path" && ln -s "$fake" "$work/path/glomap"
PATH=$work/path:$PATH align "$photos" -o "$work/p5" --no-look --mapper global || fail "GLOMAP: exit $?"
[ "$(mapper "$work/p5")" = global ] && [ "$(placed "$work/p5")" = 24 ] || fail "GLOMAP: $(mapper "$work/p5")"

# -- a focal length that is far off ------------------------------------------------------------------------
: >"$FAKE_LOG"
FAKE_FOCAL=1 align "$photos" -o "$work/flat" --no-look || fail "a focal length far off: exit $?"
expect "a focal length far off" "the focal length came out at [0-9.e+]* times .*sought again within a factor of two"
[ "$(called '^mapper ')" = 2 ] && [ "$(called '^mapper .*--Mapper.max_focal_length_ratio 2')" = 1 ] || fail "a focal length far off: calls"
cmp -s "$work/flat/sparse/0/points3D.bin" "$work/a/sparse/0/points3D.bin" || fail "a focal length far off: the better model was not taken"
FAKE_FOCAL=always align "$photos" -o "$work/flatter" --no-look || fail "a lens that sees narrowly: exit $?"
expect "a lens that sees narrowly" "that gave no better one"
[ "$(placed "$work/flatter")" = 24 ] || fail "a lens that sees narrowly: $(placed "$work/flatter") placed"

# -- photographs without a place ---------------------------------------------------------------------------
cp -r "$photos" "$work/mixed"
cp "$work/mixed/${names[3]}" "$work/mixed/zz double.jpg"
printf 'no photograph' >"$work/mixed/broken.jpg"
FAKE_ALONE=${names[5]} FAKE_BLANK=${names[7]} align "$work/mixed" -o "$work/b" || fail "a mixed folder: exit $?"
expect "a mixed folder" "photos   26, of which 24 are used"
expect "a mixed folder" "unplaced broken.jpg: it cannot be read"
expect "a mixed folder" "unplaced zz double.jpg: a copy of ${names[3]}|unplaced ${names[3]}: a copy of zz double.jpg"
expect "a mixed folder" "unplaced ${names[5]}: .*matches no neighbour"
expect "a mixed folder" "unplaced ${names[7]}: .*only 12 features"
[ "$(placed "$work/b")" = 22 ] || fail "a mixed folder: placed $(placed "$work/b")"
[ "$(grep -c '"why":' "$work/b/align.json")" = 4 ] || fail "align.json does not name the four"
"$bin" ingest "$work/mixed" "$work/b/sparse" -o "$work/scene3" -q >"$work/log" 2>&1 || fail "ingest of a mixed folder: exit $?"

# -- photographs that lack features ------------------------------------------------------------------------
# Pictures so large that a minute allows few features: those of two photographs fix no pose. They get more, with those that
# they are compared with, and the others keep theirs.
"$bin-lab" synth -q -o "$work/large" --photos 28 --width-px 640 --height-px 480 --extent-m 60 --points 1500 --supersample 1 >/dev/null
mapfile -t large < <(ls "$work/large/images")
export FAKE_TRUTH=$work/large/sparse/0 FAKE_LOOSE=${large[4]}
: >"$FAKE_LOG"
align "$work/large/images" -o "$work/more" --no-look --minutes 1 --neighbours 2 --next 1 || fail "few features: exit $?"
expect "few features" "1 photographs match others, but with 1[05][0-9]+ features their poses are not known: these and [0-9]+ beside"
grep -q "^loose" "$work/log" && fail "few features: a pose is still loose"
[ "$(placed "$work/more") $(number kept_by_ingest "$work/more/align.json")" = "28 28" ] || fail "few features: placed $(placed "$work/more")"
grep -q '"better": true' "$work/more/align.json" || fail "few features: the second model was not taken"
again=$(number photographs "$work/more/align.json" | tail -1)
[ "$again" -ge 3 ] && [ "$again" -le 8 ] || fail "few features: $again photographs were sought again"
"$bin" ingest "$work/large/images" "$work/more/sparse" -o "$work/scene4" -q >"$work/log" 2>&1 || fail "few features: ingest: exit $?"
grep -q '"kept": 28' "$work/scene4/report.json" || fail "few features: ingest drops what align calls good"
cp "$FAKE_LOG" "$work/before"
align "$work/large/images" -o "$work/more" --no-look --minutes 1 --neighbours 2 --next 1 || fail "few features, complete: exit $?"
cmp -s "$FAKE_LOG" "$work/before" || fail "few features, complete: COLMAP was called again"
grep -q "^loose" "$work/log" && fail "few features, complete: the first model came back"
# Asked for few features: told what to do, and ingest names the photograph as align does.
align "$work/large/images" -o "$work/few" --no-look --features 900 || fail "900 features: exit $?"
expect "900 features" "1 photographs match others, but with 900 features .*give more --features"
expect "900 features" "^loose    ${large[4]}: its 3 points do not fix its pose"
"$bin" ingest "$work/large/images" "$work/few/sparse" -o "$work/scene5" >"$work/log" 2>&1 || fail "900 features: ingest: exit $?"
expect "900 features" "^dropped  ${large[4]}: its 3 points do not fix its pose"
# Killed within the second round, which minutes allow once --features is not asked for: it goes on there.
rm -f "$FAKE_LOG.hangs"
FAKE_HANG=feature_extractor "$bin" align "$work/large/images" -o "$work/few" --no-look --colmap "$fake" >"$work/log" 2>&1 &
pid=$!
for _ in $(seq 600); do [ -e "$FAKE_LOG.hangs" ] && break; sleep 0.1; done
kill -9 $pid
wait $pid 2>/dev/null
[ -e "$work/few/work/again.db" ] && [ -e "$work/few/sparse/0/images.bin" ] || fail "a kill in the second round: the first model is gone"
align "$work/large/images" -o "$work/few" --no-look || fail "after a kill in the second round: exit $?"
[ "$(number kept_by_ingest "$work/few/align.json")" = 28 ] || fail "after a kill in the second round: $(number kept_by_ingest "$work/few/align.json") good"

# A look that would take more than a quarter of the minutes is the first part of the work: features are sought once, as large.
: >"$FAKE_LOG"
FAKE_LOOSE='' align "$work/large/images" -o "$work/shared" --minutes 1 || fail "a dear look: exit $?"
[ ! -e "$work/shared/work/look.db" ] || fail "a dear look: features were sought twice"
[ "$(called 'feature_extractor .*/database.db')" = 2 ] && [ "$(grep -o 'max_num_features [0-9]*' "$FAKE_LOG" | sort -u | wc -l)" = 1 ] ||
  fail "a dear look: not the work's size"
expect "a dear look" "28 of 28 photographs match a neighbour"
[ "$(placed "$work/shared")" = 28 ] || fail "a dear look: placed $(placed "$work/shared")"
export FAKE_TRUTH=$work/city/sparse/0 FAKE_LOOSE=

# Two places: told before the work.
"$bin-lab" synth -q -o "$work/far" --photos 12 --width-px 96 --height-px 72 --extent-m 40 --supersample 1 --lat-deg 47.6 --seed 2 >/dev/null
mkdir "$work/two" && cp -r "$photos" "$work/two/first flight" && cp -r "$work/far/images" "$work/two/second"
FAKE_SPLIT=second align "$work/two" -o "$work/d" --dry-run || fail "two places: exit $?"
expect "two places" "lie in 2 places, [0-9]+ m apart"
expect "two places" "only 24 of 36 photographs hang together"

# -- killed ------------------------------------------------------------------------------------------------
wait_for() { for _ in $(seq 600); do [ -e "$1" ] && return; sleep 0.1; done; fail "$1 did not come"; }
for at in feature_extractor matches_importer mapper; do
  out=$work/killed-$at
  rm -f "$FAKE_LOG.hangs"
  FAKE_HANG=$at "$bin" align "$photos" -o "$out" --colmap "$fake" --no-look >"$work/log" 2>&1 &
  pid=$!
  wait_for "$FAKE_LOG.hangs"
  child=$(cat "$FAKE_LOG.hangs")
  kill -9 $pid
  wait $pid 2>/dev/null
  [ ! -e "$out/sparse" ] && [ ! -e "$out/align.json" ] || fail "killed in $at: a partial model"
  for _ in $(seq 50); do kill -0 "$child" 2>/dev/null || break; sleep 0.1; done
  kill -0 "$child" 2>/dev/null && fail "killed in $at: COLMAP lives on"
  : >"$FAKE_LOG"
  align "$photos" -o "$out" --no-look || fail "after a kill in $at: exit $?"
  [ "$(placed "$out")" = 24 ] || fail "after a kill in $at: placed $(placed "$out")"
  cmp -s "$out/sparse/0/points3D.bin" "$work/a/sparse/0/points3D.bin" || fail "after a kill in $at: another model"
  case $at in
    feature_extractor) # the camera of the first half is that of the second
      [ "$(called 'feature_extractor .*existing_camera_id 1')" = 1 ] || fail "after a kill in $at: another camera" ;;
    matches_importer) [ "$(called feature_extractor)" = 0 ] || fail "after a kill in $at: features again" ;;
    mapper) [ "$(called feature_extractor)$(called matches_importer)" = 00 ] || fail "after a kill in $at: features or pairs again" ;;
  esac
done

# Stopped in the look, politely.
rm -f "$FAKE_LOG.hangs"
FAKE_HANG=matches_importer "$bin" align "$photos" -o "$work/stopped" --colmap "$fake" >"$work/log" 2>&1 &
pid=$!
wait_for "$FAKE_LOG.hangs"
kill -TERM $pid
wait $pid && fail "stopped: exit 0"
expect "stopped" "stopped; the same command goes on"
align "$photos" -o "$work/stopped" || fail "after a stop: exit $?"
[ "$(placed "$work/stopped")" = 24 ] || fail "after a stop: placed $(placed "$work/stopped")"

# -- stages that fail --------------------------------------------------------------------------------------
for at in feature_extractor matches_importer mapper; do
  FAKE_FAIL=$at refused "$at fails" "$at: exit 1: ERROR: out of luck.*its log is .*/logs/" "$work/f-$at/sparse" "$photos" -o "$work/f-$at" --colmap "$fake"
  [ ! -e "$work/f-$at/align.json" ] || fail "$at fails: align.json is there"
done
align "$photos" -o "$work/f-mapper" || fail "after the mapper failed: exit $?"
FAKE_ALONE=.jpg refused "nothing matches" "failed to create sparse model" "$work/g/sparse" "$photos" -o "$work/g" --colmap "$fake"
expect "nothing matches" "unplaced ${names[0]}: .*matches no neighbour"
expect "nothing matches" "only 1 of 24 photographs hang together"

# -- bad input ---------------------------------------------------------------------------------------------
refused "no COLMAP" "no such program; install COLMAP .*apt-get install colmap" "$work/x" "$photos" -o "$work/x" --colmap nothing-of-this-name
refused "not COLMAP" "does not call itself COLMAP" "" "$photos" -o "$work/echo" --colmap echo
refused "no folder" "no such folder of photographs" "$work/x" "$work/nowhere" -o "$work/x" --colmap "$fake"
mkdir "$work/empty"
refused "an empty folder" "no photographs" "$work/x" "$work/empty" -o "$work/x" --colmap "$fake"
cp "$photos/${names[0]}" "$photos/${names[1]}" "$work/empty/"
refused "two photographs" "2 of 2 photographs can be used .*three are needed" "$work/x" "$work/empty" -o "$work/x" --colmap "$fake"
refused "no -o" "-o is missing" "" "$photos" --colmap "$fake"
refused "an unknown lens" "lens" "$work/x" "$photos" -o "$work/x" --lens round --colmap "$fake"
mkdir -p "$work/mine/work" && echo mine >"$work/mine/work/thesis.txt"
refused "a folder of others" "is there already, and not of align" "" "$photos" -o "$work/mine" --overwrite --colmap "$fake"
[ "$(cat "$work/mine/work/thesis.txt")" = mine ] || fail "a folder of others was touched"
refused "other options" "made with other photographs or options" "" "$photos" -o "$work/a" --neighbours 4 --colmap "$fake"
refused "other photographs" "made with other photographs or options" "" "$work/mixed" -o "$work/a" --colmap "$fake"
[ "$(placed "$work/a")" = 24 ] && [ -f "$work/a/sparse/0/images.bin" ] || fail "refused, and yet touched"
align "$work/mixed" -o "$work/a" --overwrite || fail "--overwrite: exit $?"
[ "$(placed "$work/a")" = 24 ] || fail "--overwrite: placed $(placed "$work/a")"

[ "$bad" = 0 ] && echo "align: pairs, options, photographs without a place, kills, failures, bad input"
exit "$bad"
