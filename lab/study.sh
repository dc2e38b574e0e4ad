#!/usr/bin/env bash
# study.sh: accuracy, size and time under varied settings, recorded for the charts and tables of lab/studies.
#
#   lab/study.sh [--dry-run] all | STUDY...      --list names the studies
#
# Every row of a study is one run: train, then score, then `citysplat-lab study-record` into lab/runs/. A row that
# is recorded there by the same command is skipped, so a stopped study goes on where it was, and changing a
# setting repeats the rows it touches. Training itself is resumed too. Steps and seeds of every study are stated in
# lab/study/studies.def: there is no other default. Redraw a page afterwards with
# `citysplat-lab study-chart lab/runs -o lab/charts --markdown lab/studies/STUDY.md`; lab/studies/README.md has all of them.
#
# Environment:
#   CITYSPLAT_CALITERRA   folder with images/ and sparse/ of the caliterra survey (docs/tutorial.md); without it
#                         the studies on photographs are skipped, those on the procedural city are not
#   CITYSPLAT_OCHOTA      the same of the ochota survey (docs/photographs.md)
#   STUDY_STEPS           steps of every training, for a trial; as stated if not given, and pages take nothing shorter
#   STUDY_SEEDS           the seeds to run of those stated, "1 2"; all if not given
#   STUDY_ROWS            the rows to run of the studies on solid surfaces, "stereo off"; all if not given
#   STUDY_MILLIONS        sizes of the cities of growth_import, "1 4 16 64", in millions of Gaussians
#   STUDY_COMMIT          the commit that the programs were built of; HEAD if not given, which must then be clean
#   STUDY_OUT             where scenes and trained cells go [out/study]
#   STUDY_RUNS            where runs are recorded [lab/runs]
#   STUDY_AGAIN           1: also rows that are recorded
#   CITYSPLAT_BUILD       folder of the programs [build/release]
#
# SPDX-License-Identifier: Apache-2.0
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

readonly BIN=${CITYSPLAT_BUILD:-build/release}
readonly OUT=${STUDY_OUT:-out/study}
readonly RUNS=${STUDY_RUNS:-lab/runs}
DRY=0
COMMIT=
SEED=

say() { printf '== %s\n' "$*" >&2; }
die() { printf 'study: error: %s\n' "$*" >&2; exit 1; }

citysplat() { "$BIN/citysplat" "$@"; }
lab() { "$BIN/citysplat-lab" "$@"; }

# What lab/study/studies.def states of a study.
stated() { # STUDY 1|2
  local n
  n=$(sed -n "s/^STUDY(\"$1\", *\([0-9][0-9]*\), *\([0-9][0-9]*\))\$/\\$2/p" lab/study/studies.def)
  [ -n "$n" ] || die "study '$1' is not in lab/study/studies.def"
  printf '%s' "$n"
}
steps() { # STUDY
  local n
  n=$(stated "$1" 1) || exit 1
  printf '%s' "${STUDY_STEPS:-$n}"
}

# seeded STUDY COMMAND...: COMMAND with SEED 1, 2, ... as often as the study states; all rows of a seed before the next.
seeded() {
  local seeds
  seeds=$(stated "$1" 2) || exit 1
  for SEED in $(seq "$seeds"); do
    case " ${STUDY_SEEDS:-$SEED} " in *" $SEED "*) "${@:2}" ;; esac
  done
  SEED=
}

# ---- scenes: NAME -> $OUT/NAME, made on first use ---------------------------------------------------------

# What a scene is, for the tables.
scene_about() {
  case $1 in
    caliterra-200) echo "caliterra, 200 x 150 px" ;;
    caliterra-400) echo "caliterra, 400 x 300 px" ;;
    caliterra-800) echo "caliterra, 800 x 600 px" ;;
    ochota-400) echo "ochota, 400 x 300 px" ;;
    ochota-cells) echo "ochota, 400 x 300 px, 10 cells of 150 m" ;;
    ochota-800) echo "ochota, 800 x 600 px" ;;
    city) echo "procedural city 300 m, 300 photographs of 400 x 300 px, cells of 100 m" ;;
    cells) echo "procedural city 200 m, 150 photographs of 400 x 300 px, 6 cells of 70 m, 24 map views" ;;
    cells-light) echo "procedural city 200 m, 150 photographs of 400 x 300 px under changing light, 11 cells of 66 m" ;;
    exact) echo "city of the demo's size, seed 7, exact GPS, 84 photographs of 480 x 360 px, 24 map views" ;;
    block) echo "the same city and one with a block of 400 m3 on a street" ;;
    fine) echo "the same city, 84 photographs of 960 x 720 px, 24 map views" ;;
    tricky) echo "the same city in paint that says little of shape" ;;
    small) echo "city of the demo's size, seed 7, exact GPS, 84 photographs of 240 x 180 px, 48 map views" ;;
    demo) echo "demo city 120 m, 84 photographs of 480 x 360 px, 24 map views" ;;
    gloss) echo "the demo city with surfaces that shine, 84 photographs of 480 x 360 px, 24 map views" ;;
    big) echo "procedural city 1 km, 640 photographs of 512 x 384 px, 12 cells of 340 m, 24 map views" ;;
    above) echo "procedural city 100 m, 60 photographs of 320 x 240 px from straight above, 24 map views" ;;
    light | light-views*) echo "procedural city 100 m, 60 photographs of 320 x 240 px under changing light" ;;
    sun-views*) echo "procedural city 100 m, 60 photographs of 320 x 240 px under sun and clouds" ;;
    one-light) echo "the same city under one light" ;;
    city-light) echo "procedural city 200 m, 150 photographs of 400 x 300 px under changing light" ;;
    *) die "no scene '$1'" ;;
  esac
}

scene_ingest_caliterra() { # FOLDER EDGE_PX
  citysplat ingest "$CITYSPLAT_CALITERRA/images" "$CITYSPLAT_CALITERRA/sparse" --max-edge-px "$2" -o "$1" -q
}

# The city of the studies on light, and what changes from photograph to photograph.
readonly LIGHT=(--extent-m 100 --photos 60 --width-px 320 --height-px 240 --points 20000)
readonly CHANGING=(--exposure-ev 0.5 --white-balance 0.15 --sun-variation 0.5)
readonly SUN=(--sun-variation 1.5)

EXPOSURE= # of a scene alone, never of the caller's environment
scene_ingest_city() { # FOLDER "MAP-VIEWS OPTIONS" SYNTH OPTIONS...; no map views where their options are empty
  local folder=$1 views=$2
  shift 2
  lab synth -o "$folder-photos" --overwrite -q "$@"
  # shellcheck disable=SC2086 # options are words
  [ -z "$views" ] || lab map-views "$folder-photos" -q $views
  # Exposures are left to the network where a scene says nothing else, as when most rows were measured.
  citysplat ingest "$folder-photos/images" "$folder-photos/sparse" "${EXPOSURE:---no-exposure}" -o "$folder" -q
}

scene_build() { # NAME FOLDER
  case $1 in
    caliterra-200) scene_ingest_caliterra "$2" 200 ;;
    caliterra-400) scene_ingest_caliterra "$2" 400 ;;
    caliterra-800) scene_ingest_caliterra "$2" 800 ;;
    ochota-cells) scene_build ochota-400 "$2"; citysplat plan "$2" --edge-m 150 --images-few 16 --images-least 8 ;;
    ochota-*) # no GPS: what a map says of its middle, and of its size
      citysplat ingest "$CITYSPLAT_OCHOTA/images" "$CITYSPLAT_OCHOTA/sparse" --max-edge-px "${1#*-}" --origin 20.97095,52.218,110 --metres-per-unit 71 -o "$2" -q ;;
    city) scene_ingest_city "$2" "" --extent-m 300 --photos 300 --points 100000; citysplat plan "$2" --edge-m 100 --images-few 16 ;;
    cells) scene_ingest_city "$2" "--count 24" --extent-m 200 --photos 150 --points 45000; citysplat plan "$2" --edge-m 70 --images-few 16 ;;
    cells-light)
      scene_ingest_city "$2" "" --extent-m 200 --photos 150 --points 45000 "${CHANGING[@]}"
      citysplat plan "$2" --edge-m 66 --images-few 16 --images-least 8
      ;;
    demo)
      lab synth --config configs/demo-synth.jsonc -o "$2-photos" --overwrite -q
      lab map-views "$2-photos" -q
      citysplat ingest "$2-photos/images" "$2-photos/sparse" --config configs/demo-ingest.jsonc -o "$2" -q
      ;;
    exact | tricky | fine | block | small)
      local city=(--seed 7 --gps-sigma-m 0 --gps-outlier-share 0) views=24
      case $1 in
        tricky) city+=(--paint tricky) ;;
        fine) city+=(--width-px 960 --height-px 720) ;;
        block) city+=(--block-m3 400) ;;
        small) city+=(--width-px 240 --height-px 180) views=48 ;;
      esac
      lab synth --config configs/demo-synth.jsonc "${city[@]}" -o "$2-photos" --overwrite -q
      lab map-views "$2-photos" --count $views -q
      citysplat ingest "$2-photos/images" "$2-photos/sparse" --config configs/demo-ingest.jsonc -o "$2" -q
      ;;
    gloss)
      lab synth --config configs/demo-synth.jsonc --gloss 1 -o "$2-photos" --overwrite -q
      lab map-views "$2-photos" -q
      citysplat ingest "$2-photos/images" "$2-photos/sparse" --config configs/demo-ingest.jsonc -o "$2" -q
      ;;
    big) scene_ingest_city "$2" "--count 24" --extent-m 1000 --photos 640 --width-px 512 --height-px 384 --points 400000; citysplat plan "$2" --edge-m 340 --images-few 16 ;;
    above) scene_ingest_city "$2" "--count 24" --extent-m 100 --photos 60 --width-px 320 --height-px 240 --points 20000 --oblique-share 0 ;;
    light) scene_ingest_city "$2" "" "${LIGHT[@]}" "${CHANGING[@]}" ;;
    light-views) scene_ingest_city "$2" "--count 24 --light" "${LIGHT[@]}" "${CHANGING[@]}" ;;
    light-views-exposed) EXPOSURE=--exposure scene_ingest_city "$2" "--count 24 --light" "${LIGHT[@]}" "${CHANGING[@]}" ;;
    sun-views) scene_ingest_city "$2" "--count 24 --light" "${LIGHT[@]}" "${SUN[@]}" ;;
    sun-views-exposed) EXPOSURE=--exposure scene_ingest_city "$2" "--count 24 --light" "${LIGHT[@]}" "${SUN[@]}" ;;
    one-light) scene_ingest_city "$2" "--count 24" "${LIGHT[@]}" ;;
    city-light) scene_ingest_city "$2" "" --extent-m 200 --photos 150 --points 60000 "${CHANGING[@]}" ;;
  esac >&2
}

# scene NAME: makes it unless it is there, and fails when its photographs are not at hand.
scene() {
  case $1 in
    caliterra*) [ -n "${CITYSPLAT_CALITERRA:-}" ] || return 1 ;;
    ochota*) [ -n "${CITYSPLAT_OCHOTA:-}" ] || return 1 ;;
  esac
  [ -f "$OUT/$1/scene.json" ] && [ ! -e "$OUT/$1.unfinished" ] && return 0
  say "scene $1: $(scene_about "$1")"
  mkdir -p "$OUT"
  touch "$OUT/$1.unfinished"
  rm -rf "${OUT:?}/$1"
  scene_build "$1" "$OUT/$1"
  rm "$OUT/$1.unfinished"
}

# ---- recording --------------------------------------------------------------------------------------------

# The ceilings are measured next to every run: what a neighbour takes away shows in them as well.
ceilings() { lab ceiling --runs 5 >"$OUT/ceilings.jsonl" 2>/dev/null; }

# Studies of one question are recorded in one file: solid, solid_block and solid_fine in solid.jsonl. A file stays below 1 MiB.
runs_of() { # STUDY
  case $1 in
  map_views | solid_terms | solid_fixed* | solid_alone | solid_ochota) echo "$RUNS/$1.jsonl" ;;
  *) echo "$RUNS/${1%%_*}.jsonl" ;;
  esac
}

record() { # STUDY ROW COMMAND, then options of `citysplat-lab study-record`
  local study=$1 row=$2 command=$3
  shift 3
  lab study-record "$(runs_of "$study")" --study "$study" --row "$row" --command "$command" "$@"
}

# older COMMAND: as records spell it that are of before the laboratory was a program of its own.
older() {
  sed -E 's/citysplat-lab eval-photographs /citysplat eval /g
    s/citysplat-lab eval-views ([^ ;]+) ([^ ;]+) --tiles CITY.tiles/citysplat eval \1 --tiles CITY.tiles --views \2/g
    s/citysplat-lab eval-(views|surface) ([^ ;]+) ([^ ;]+)/citysplat eval \2 --\1 \3/g
    s/citysplat-lab truth ([^ ;]+) DSM/citysplat synth --city \1 --map DSM/g
    s/citysplat-lab splats --count /citysplat synth --splats /g
    s/citysplat-lab( bench)?/citysplat-bench/g' <<<"$1"
}

# recorded STUDY ROW COMMAND
recorded() {
  [ -f "$(runs_of "$1")" ] || return 1
  record "$1" "$2" "$3" --check 2>/dev/null || record "$1" "$2" "$(older "$3")" --check 2>/dev/null
}

# wanted STUDY ROW COMMAND: says what will be done; false when the row is recorded or this is a dry run.
wanted() {
  if [ "${STUDY_AGAIN:-0}" != 1 ] && recorded "$1" "$2" "$3"; then
    say "$1: $2: recorded"
    return 1
  fi
  if [ $DRY = 1 ]; then
    printf '%s\t%s\t%s\n' "$1" "$2" "$3"
    return 1
  fi
  say "$1: $2: $3"
}

slug() { printf '%s' "$*" | tr -c 'A-Za-z0-9.' '-'; }

# trained FOLDER SCENE OPTIONS...: FOLDER/cells complete, or resumed, or begun afresh when the options changed.
trained() {
  local folder=$1 scene=$2
  shift 2
  if [ "$(cat "$folder/options" 2>/dev/null)" != "$scene $*" ]; then
    rm -rf "$folder"
    mkdir -p "$folder"
    printf '%s' "$scene $*" >"$folder/options"
  fi
  [ -e "$folder/done" ] && return 0
  local begun=$EPOCHREALTIME whole=1
  [ ! -d "$folder/cells" ] || whole=0 # it goes on: how long it took is not known
  citysplat train "$OUT/$scene" --output "$folder" --resume "$@" >&2
  [ $whole = 0 ] || awk -v a="$begun" -v b="$EPOCHREALTIME" 'BEGIN { printf "%.1f", b - a }' >"$folder/done"
  touch "$folder/done"
}

# map_errors SCENE DSM: errors of a surface model of a city, as numbers for `record`.
map_errors() {
  lab truth "$OUT/$1-photos" "$2" | awk '
    $1 == "level" { printf "dsm_level_median_m=%s,dsm_level_off_m=%s,dsm_level_rmse_m=%s,dsm_level_le90_m=%s,dsm_level_1_gsd_percent=%s,", $3, $4, $5, $7, $10 }
    $1 == "edges" { printf "dsm_edges_median_m=%s,dsm_edges_1_gsd_percent=%s,", $3, $10 }
    $1 == "all" { printf "dsm_rmse_m=%s,dsm_above_1_m_percent=%s,", $5, $9 }
    / without a surface;/ { sub(/.*square, /, ""); printf "dsm_missing=%s,", $1 }
    $1 == "walls" { sub(/.*px \(/, ""); printf "dsm_roofs_out_m=%s", $1 + 0 }'
}

# model_errors SCENE FOLDER: those of a city's training.
model_errors() {
  local scene=$1 folder=$2
  [ -f "$folder/city.tiles" ] || citysplat tile "$OUT/$scene" --trained "$folder" -o "$folder/city.tiles" >&2
  citysplat dsm "$folder/city.tiles" --gsd-m "${GSD_M:-0.192}" -o "$folder/dsm.tif" --overwrite >&2
  map_errors "$scene" "$folder/dsm.tif"
}

# row STUDY ROW SCENE SET OPTIONS...: train with OPTIONS, score every level at its own size, record with the
# numbers SET (budget=50000,...). Options of eval come after `--eval`, those of a second scoring as tiles after
# `--tiles`. MAP_VIEWS=1 also scores the scene's map views, MAP_VIEWS=tiles with those tiles as well, SURFACE=city or points its surface, KEEP=1 leaves the trained cells where they are, SHARED=1 in
# the scene's own folder, for other studies that train it alike.
row() {
  local study=$1 name=$2 scene=$3 set=$4 part=train folder command o surface=
  shift 4
  local train=(${SEED:+--seed "$SEED"}) eval=() tiles=()
  [ -z "$SEED" ] || name="$name (seed $SEED)" set="${set:+$set,}seed=$SEED"
  for o in "$@"; do
    case $o in
      --eval | --tiles) part=${o#--} ;;
      *) case $part in
        train) train+=("$o") ;;
        eval) eval+=("$o") ;;
        tiles) tiles+=("$o") ;;
        esac ;;
    esac
  done
  command="citysplat train $scene ${train[*]//$OUT\//}; citysplat-lab eval-photographs $scene${eval[*]:+ ${eval[*]}}"
  [[ $command != *"--depth-prior $scene-depth"* ]] || command="citysplat stereo $scene -o $scene-depth; $command"
  [ $part != tiles ] || command+="; citysplat tile $scene --crop none; citysplat-lab eval-photographs $scene --tiles CITY.tiles${tiles[*]:+ ${tiles[*]}}"
  [ -z "${MAP_VIEWS:-}" ] || command+="; citysplat-lab eval-views $scene $scene-photos/map-views"
  [ "${MAP_VIEWS:-}" != tiles ] || command+="; citysplat-lab eval-views $scene $scene-photos/map-views --tiles CITY.tiles"
  case ${SURFACE:-} in
    city)
      command+="; citysplat-lab eval-surface $scene $scene-photos; citysplat tile $scene; citysplat dsm CITY.tiles --gsd-m ${GSD_M:-0.192}; citysplat-lab truth $scene-photos DSM"
      surface=$OUT/$scene-photos
      ;;
    points) command+="; citysplat-lab eval-surface $scene points" surface=points ;;
  esac
  wanted "$study" "$name" "$command" || return 0
  scene "$scene" || { say "$study: $name: skipped: its photographs are not at hand"; return 0; }
  depths "$scene" "$command"
  folder=$OUT/trained/$([ -n "${SHARED:-}" ] && slug shared "$scene" || slug "$study" "$name")
  ceilings
  trained "$folder" "$scene" "${train[@]}"
  [ ! -s "$folder/done" ] || set+=${set:+,}run_s=$(cat "$folder/done")
  lab eval-photographs "$OUT/$scene" --results "$folder" -o "$folder/scores.json" --overwrite "${eval[@]}" >&2
  local scores=$folder/scores.json
  if [ $part = tiles ]; then
    citysplat tile "$OUT/$scene" --crop none --trained "$folder" -o "$folder/city.tiles" --overwrite >&2
    lab eval-photographs "$OUT/$scene" --tiles "$folder/city.tiles" -o "$folder/tiles.json" --overwrite "${tiles[@]}" >&2
    scores+=,$folder/tiles.json
  fi
  if [ -n "${MAP_VIEWS:-}" ]; then
    lab eval-views "$OUT/$scene" "$OUT/$scene-photos/map-views" --results "$folder" -o "$folder/views.json" --overwrite >&2
    scores+=,$folder/views.json
  fi
  if [ "${MAP_VIEWS:-}" = tiles ]; then
    lab eval-views "$OUT/$scene" "$OUT/$scene-photos/map-views" --tiles "$folder/city.tiles" -o "$folder/tiles-views.json" --overwrite >&2
    scores+=,$folder/tiles-views.json
  fi
  if [ -n "$surface" ]; then
    lab eval-surface "$OUT/$scene" "$surface" --results "$folder" -o "$folder/surface.json" --overwrite >&2
    scores+=,$folder/surface.json
  fi
  if [ "${SURFACE:-}" = city ]; then
    set+="${set:+,}$(model_errors "$scene" "$folder")"
  fi
  record "$study" "$name" "$command" --dataset "$(scene_about "$scene")" --commit "$COMMIT" --scores "$scores" \
    --results "$folder" --ceilings "$OUT/ceilings.jsonl" ${set:+--set "$set"}
  [ "${KEEP:-0}" = 1 ] || [ -n "${SHARED:-}" ] || rm -rf "$folder"
}

# depths SCENE COMMAND: depth maps of its photographs beside it, $OUT/SCENE-depth, where the command asks for them.
depths() {
  [[ $2 != *"--depth-prior $1-depth"* ]] || [ -d "$OUT/$1-depth" ] || citysplat stereo "$OUT/$1" -o "$OUT/$1-depth" >&2
}

# json_numbers FILE: the numbers of a JSON object, as `record --set` takes them.
json_numbers() { sed -n 's/^  "\([a-z0-9_]*\)": \(-\{0,1\}[0-9][-+.0-9e]*\),\{0,1\}$/\1=\2/p' "$1" | paste -sd, -; }

# repeat STUDY ROW SCENE SET OPTIONS...: what `compare` makes of two trainings of the same photographs, which should be
# nothing, recorded as STUDY_repeat. They are those of `row STUDY ROW` with seeds 1 and 2 where KEEP=1 has left them.
repeat() {
  local study=$1 name=$2 scene=$3 k folder command tiles=()
  shift 4
  command="citysplat train $scene --seed 1 ${*//$OUT\//}; citysplat train $scene --seed 2 ${*//$OUT\//}; citysplat tile $scene; citysplat compare 1.tiles 2.tiles"
  wanted solid_repeat "$study: $name" "$command" || return 0
  scene "$scene" || { say "$study: $name: skipped: its photographs are not at hand"; return 0; }
  depths "$scene" "$command"
  for k in 1 2; do
    folder=$OUT/trained/$(slug "$study" "$name (seed $k)")
    trained "$folder" "$scene" --seed "$k" "$@"
    tiles+=("$folder/city.tiles")
    [ -f "$folder/city.tiles" ] || citysplat tile "$OUT/$scene" --trained "$folder" -o "$folder/city.tiles" >&2
  done
  citysplat compare "${tiles[@]}" -o "$folder/change.tif" --overwrite >"$folder/change.json"
  cat "$folder/change.json" >&2
  record solid_repeat "$study: $name" "$command" --dataset "$(scene_about "$scene")" --commit "$COMMIT" \
    --set "$(json_numbers "$folder/change.json")"
}

# changed RUNS ROW EARLIER LATER SEED OPTIONS...: what `compare` makes of a training of one scene with seed 1 and one of another
# with SEED, recorded in RUNS. The last option takes the depth maps of each scene.
changed() {
  local runs=$1 name=$2 earlier=$3 later=$4 seed=$5 k scene folder command="" tiles=()
  shift 5
  for scene in "$earlier" "$later"; do
    command+="citysplat stereo $scene -o $scene-depth; citysplat train $scene --seed $([ "$scene" = "$earlier" ] && echo 1 || echo "$seed") $* $scene-depth; citysplat tile $scene; "
  done
  command+="citysplat compare $earlier.tiles $later.tiles"
  wanted "$runs" "$name" "$command" || return 0
  for scene in "$earlier" "$later"; do
    k=$([ "$scene" = "$earlier" ] && echo 1 || echo "$seed")
    scene "$scene" || return 0
    depths "$scene" "$* $scene-depth"
    folder=$OUT/trained/$(slug solid_block "$scene" "$k")
    trained "$folder" "$scene" --seed "$k" "$@" "$OUT/$scene-depth"
    tiles+=("$folder/city.tiles")
    [ -f "$folder/city.tiles" ] || citysplat tile "$OUT/$scene" --trained "$folder" -o "$folder/city.tiles" >&2
  done
  citysplat compare "${tiles[@]}" -o "$folder/change.tif" --polygons "$folder/change.geojson" --overwrite >"$folder/change.json"
  cat "$folder/change.json" >&2
  record "$runs" "$name" "$command" --dataset "$(scene_about "$later")" --commit "$COMMIT" --set "$(json_numbers "$folder/change.json")"
}

# tile_row STUDY ROW SCENE SET TILE-OPTIONS --eval EVAL-OPTIONS -- TRAIN-OPTIONS: score tiles of a scene that is
# trained once for all rows with the same TRAIN-OPTIONS.
tile_row() {
  local study=$1 name=$2 scene=$3 set=$4 part=tile folder tiles command o
  shift 4
  local tile=() eval=() train=()
  for o in "$@"; do
    case $o in
      --eval) part=eval ;;
      --) part=train ;;
      *) case $part in
        tile) tile+=("$o") ;;
        eval) eval+=("$o") ;;
        train) train+=("$o") ;;
        esac ;;
    esac
  done
  command="citysplat train $scene ${train[*]}; citysplat tile $scene --crop none ${tile[*]}; citysplat-lab eval-photographs $scene --tiles CITY.tiles ${eval[*]}"
  wanted "$study" "$name" "$command" || return 0
  scene "$scene" || { say "$study: $name: skipped: its photographs are not at hand"; return 0; }
  folder=$OUT/trained/$(slug shared "$scene")
  ceilings
  trained "$folder" "$scene" "${train[@]}"
  tiles=$folder/$(slug "${tile[*]}").tiles
  [ -f "$tiles" ] || citysplat tile "$OUT/$scene" --crop none --trained "$folder" -o "$tiles" "${tile[@]}" >&2
  set+=${set:+,}tiles=$(citysplat info "$tiles" --json | sed -n 's/.*"tiles_count": *\([0-9][0-9]*\).*/\1/p' | head -1)
  lab eval-photographs "$OUT/$scene" --tiles "$tiles" -o "$folder/scores.json" --overwrite "${eval[@]}" >&2
  record "$study" "$name" "$command" --dataset "$(scene_about "$scene")" --commit "$COMMIT" \
    --scores "$folder/scores.json" --ceilings "$OUT/ceilings.jsonl" --set "$set"
}

# ---- the studies: study_NAME, in the order of `all` -------------------------------------------------------

# Budgets of cells of about 300 m^2 a thousand Gaussians; the presets' budgets are for larger ones.
readonly SMALL=(--budget 40000,80000,160000)

# ROWS STUDY: the rows of a study on the demo city with map views, or on caliterra at a budget that binds.
on_demo() {
  local MAP_VIEWS=1
  "$1" "$2" demo --iterations "$(steps "$2")" "${SMALL[@]}"
}
on_caliterra() { "$1" "$2" caliterra-400 --level-count 1 --iterations "$(steps "$2")" --budget 100000; }

study_time() { # accuracy against training time, with the finest level alone and with all three
  local n
  for n in 250 500 1000 2000 4000; do
    row time "one level: $n steps" caliterra-400 "steps=$n" --level-count 1 --iterations "$n" --budget 200000
  done
  for n in 500 1000 2000 4000; do
    row time "three levels: $n steps" caliterra-400 "steps=$n" --iterations "$n" --budget 50000,100000,200000
  done
  for n in 500 1000 2000; do # photographs as they came, as other trainers take them
    row time "one level, as taken: $n steps" caliterra-400 "steps=$n" --level-count 1 --iterations "$n" --budget 200000 --no-exposure
  done
}

# What going on does, at a budget that binds: photographs, map views, heights. Rows of n steps are whole runs, not what a longer one has after n.
long_rows() { # STUDY SCENE TRAIN-OPTIONS
  local study=$1 scene=$2 n
  shift 2
  for n in 2000 4000 7000 15000 30000; do
    row "$study" "$n steps" "$scene" "steps=$n" --iterations "$n" --depth-prior "$OUT/$scene-depth" "$@"
  done
}
study_long() { SURFACE=points long_rows long caliterra-400 --budget 25000,50000,100000; }
study_long_city() { MAP_VIEWS=1 SURFACE=city long_rows long_city exact --budget 40000,80000,160000; }

study_budgets() { # accuracy against the number of Gaussians
  local b
  for b in 25000 50000 100000 200000 400000; do
    row budgets "$((b / 1000)) k" caliterra-400 "budget=$b" --level-count 1 --iterations "$(steps budgets)" --budget-rule table --budget "$b" --tau 1e-4
  done
}

# Accuracy and bytes at degree 0 to 3 of harmonics: of a dry survey from above, of a real district seen from all sides, and of
# a city without and with surfaces that shine.
sh_rows() { # STUDY SCENE DEGREES BUDGET, then what follows --tiles or --eval
  local d study=$1 scene=$2 degrees=$3 budget=$4
  shift 4
  for d in $degrees; do # the default first: the others are compared with it
    row "$study" "degree $d" "$scene" "sh_degree=$d" --level-count 1 --iterations "$(steps "$study")" --budget "$budget" --sh-degree "$d" "$@"
  done
}
sh_caliterra_rows() { sh_rows sh caliterra-400 "3 0 1 2" 100000 --tiles; }
sh_ochota_rows() { sh_rows sh_ochota ochota-400 "3 0" 150000 --eval --half-image off; }
sh_city_rows() { # STUDY SCENE DEGREES
  local MAP_VIEWS=1
  sh_rows "$@" 120000
}
study_sh() { seeded sh sh_caliterra_rows; }
study_sh_ochota() { seeded sh_ochota sh_ochota_rows; }
study_sh_demo() { seeded sh_demo sh_city_rows sh_demo demo "3 0"; }
study_sh_gloss() { seeded sh_gloss sh_city_rows sh_gloss gloss "3 0 1"; }

# Rows of Table 10 and of the main ablation: each turns one thing off, or on, at a budget that binds. AbsGS also at an equal
# number of Gaussians, where the threshold is so low that the budget binds without it as well.
ablation_rows() { # STUDY SCENE OPTIONS
  local study=$1 scene=$2
  shift 2
  row "$study" full "$scene" "" "$@"
  row "$study" "no AbsGS" "$scene" "" "$@" --absgrad-from 4 --tau 2e-4
  row "$study" "no AbsGS, lower threshold" "$scene" "" "$@" --absgrad-from 4 --tau 5e-5
  row "$study" "no anti-aliasing" "$scene" "" "$@" --aa none
}
ablation_city_rows() {
  local MAP_VIEWS=1
  ablation_rows ablation_city demo --level-count 1 --iterations "$(steps ablation_city)" --budget 120000
}
study_ablation() { seeded ablation on_caliterra ablation_rows ablation; }
study_ablation_city() { seeded ablation_city ablation_city_rows; }

# What cells alone have: which photographs train one, where it may grow, what it begins from.
cells_rows() {
  local MAP_VIEWS=1 base=(--iterations "$(steps cells)" --budget 20000,40000,80000)
  row cells full cells "" "${base[@]}"
  row cells "from sparse points" cells "" "${base[@]}" --no-coarse-start
}
study_cells() { seeded cells cells_rows; }

# One appearance model for all cells of a city whose light changes from photograph to photograph, by half images.
study_cells_light() {
  local base=(--iterations "$(steps cells_light)" --budget 10000,20000,40000)
  row cells_light "no appearance" cells-light "" "${base[@]}" --eval --half-image on
  row cells_light "appearance" cells-light "" "${base[@]}" --appearance --eval --half-image on
}

embedding_rows() {
  local n base=(--level-count 1 --iterations "$(steps embedding)" --budget 40000)
  for n in 16 4 8; do # the default first: the others are compared with it
    row embedding "length $n" light "embed_len=$n" "${base[@]}" --appearance --appearance-warmup 250 --embed-len "$n" --eval --half-image on
  done
  row embedding "no appearance" light "embed_len=0" "${base[@]}" --eval --half-image on
}
study_embedding() { seeded embedding embedding_rows; } # length of a Gaussian's appearance embedding (Table 11), under changing light

# Which levels the appearance network learns at; the others are brought to the last one.
network_rows() {
  local base=(--iterations "$(steps network)" --budget 15000,25000,40000)
  row network "all levels" light "" "${base[@]}" --appearance --eval --half-image on
  row network "no appearance" light "" "${base[@]}" --eval --half-image on
}
study_network() { seeded network network_rows; }

# The light of a photograph put on the whole city: map views in the light of photographs. Cameras and a
# little of the light change, then the light alone.
transfer_rows() { # STUDY SCENE
  local study=$1 scene=$2 MAP_VIEWS=1 base=(--iterations "$(steps "$1")" --budget 15000,25000,40000)
  row "$study" "neither" "$scene" "" "${base[@]}"
  row "$study" "exposure" "$scene-exposed" "" "${base[@]}"
  row "$study" "appearance" "$scene" "" "${base[@]}" --appearance
  row "$study" "both" "$scene-exposed" "" "${base[@]}" --appearance
  [ "$study" != transfer ] || row "$study" "one light" one-light "" "${base[@]}"
}
study_transfer() { seeded transfer transfer_rows transfer light-views; }
study_transfer_sun() { seeded transfer_sun transfer_rows transfer_sun sun-views; }

# What exposures and appearance are worth on photographs of a real district under changing light, by half images.
ochota_light_rows() {
  local base=(--level-count 1 --iterations "$(steps ochota_light)")
  row ochota_light "neither" ochota-400 "" "${base[@]}" --no-exposure --eval --half-image on
  row ochota_light "exposure" ochota-400 "" "${base[@]}" --eval --half-image on
  row ochota_light "appearance" ochota-400 "" "${base[@]}" --no-exposure --appearance --eval --half-image on
  row ochota_light "both" ochota-400 "" "${base[@]}" --appearance --eval --half-image on
}
study_ochota_light() { seeded ochota_light ochota_light_rows; }

# The same in cells, beside one piece: each photograph, or its parts together, is used 29 times in both.
ochota_cells_rows() { # STUDY TRAIN-OPTIONS
  local study=$1 n
  n=$(steps "$study")
  shift
  row "$study" "one piece" ochota-400 "" --level-count 1 --iterations $((n * 15 / 11)) "$@" --eval --half-image on
  row "$study" "ten cells" ochota-cells "" --level-count 1 --iterations "$n" "$@" --eval --half-image on
}
study_ochota_cells() { seeded ochota_cells ochota_cells_rows ochota_cells; }
study_ochota_cells_light() { seeded ochota_cells_light ochota_cells_rows ochota_cells_light --appearance; }

# What looking at many photographs before a Gaussian is split is worth, where the budget binds: thirty thousand Gaussians
# for photographs that support 100,000 and more.
importance_rows() {
  row importance "10 views" caliterra-400 "" --level-count 1 --iterations "$(steps importance)" --budget-rule table --budget 30000 --tau 1e-4
}
study_importance() { seeded importance importance_rows; }

# What map views have for how many Gaussians, bytes, seconds and milliseconds, by fixed budgets and the trainer's own.
pareto_rows() {
  local b base=(--iterations "$(steps pareto)") MAP_VIEWS=1
  row pareto "split: fit" demo "" "${base[@]}" --budget-rule fit
  for b in 40000 80000 160000 320000; do
    row pareto "split: $((b / 1000)) k" demo "budget=$b" "${base[@]}" --budget-rule table --budget "$((b / 4))","$((b / 2))","$b"
  done
}
study_pareto() { seeded pareto pareto_rows; }

# Each remedy against halo, haze and floaters taken away from the default.
remedy_rows() { # STUDY SCENE TRAIN-OPTIONS
  local study=$1 scene=$2
  shift 2
  row "$study" full "$scene" "" "$@"
  row "$study" "no pruning at the end" "$scene" "" "$@" --prune-contribution 0 --prune-support 0
  row "$study" "no loss on sizes" "$scene" "" "$@" --scale-weight 0
}
study_remedies() { seeded remedies on_demo remedy_rows remedies; }
study_remedies_caliterra() { seeded remedies_caliterra on_caliterra remedy_rows remedies_caliterra; }

# Another colour behind the Gaussians every step: nowhere, behind dark pixels of supported ground (the default), behind all
# of it, behind all pixels.
background_rows() { # STUDY SCENE TRAIN-OPTIONS
  local study=$1 scene=$2 b
  shift 2
  for b in none dark supported all; do row "$study" "$b" "$scene" "" "$@" --background-random "$b"; done
}
study_background() { seeded background on_demo background_rows background; }
study_background_caliterra() { seeded background_caliterra on_caliterra background_rows background_caliterra; }

# Solid surfaces, with known depths, without, and without the terms. CALL is `row`, or `repeat`.
solid_rows() { # CALL STUDY SCENE TRAIN-OPTIONS
  local call=$1 study=$2 scene=$3 name
  shift 3
  for name in ${STUDY_ROWS:-stereo default off}; do
    case $name in
      stereo) "$call" "$study" stereo "$scene" "" "$@" --depth-prior "$OUT/$scene-depth" ;;
      default) "$call" "$study" default "$scene" "" "$@" ;;
      off) "$call" "$study" off "$scene" "" "$@" --solid-spread 0 --solid-light 0 --solid-flat 0 ;;
      *) die "STUDY_ROWS: no row '$name' of stereo, default, off" ;;
    esac
  done
}
# Which terms a city needs, at a budget that binds: with known depths, and without ("no depths").
solid_terms_rows() { # STUDY SCENE TRAIN-OPTIONS
  local study=$1 scene=$2 known=(--depth-prior "$OUT/$2-depth") spread=(--solid-spread 0) light=(--solid-light 0) flat=(--solid-flat 0)
  shift 2
  row "$study" none "$scene" "" "$@" "${spread[@]}" "${light[@]}" "${flat[@]}"
  row "$study" light "$scene" "" "$@" "${known[@]}" "${spread[@]}" "${flat[@]}"
  row "$study" "balance, light" "$scene" "" "$@" "${known[@]}" "${flat[@]}"
  row "$study" default "$scene" "" "$@" "${known[@]}"
  row "$study" "no depths, light" "$scene" "" "$@" "${spread[@]}" "${flat[@]}"
  row "$study" "no depths, default" "$scene" "" "$@"
}
# solid STUDY SCENE SURFACE: all rows with their seeds, then two trainings of each against each other.
solid() {
  local study=$1 scene=$2 SURFACE=$3 KEEP=1
  seeded "$study" solid_rows row "$study" "$scene" --iterations "$(steps "$study")"
  solid_rows repeat "$study" "$scene" --iterations "$(steps "$study")"
  rm -rf "$OUT/trained/$(slug "$study")"-*--seed-*
}
study_solid() { MAP_VIEWS=1 solid solid exact city; }
study_solid_terms() {
  local MAP_VIEWS=1 SURFACE=city GSD_M=0.384
  seeded solid_terms solid_terms_rows solid_terms small --iterations "$(steps solid_terms)" --budget 20000,30000,40000
}
# The same question at 480 x 360 px, the default's length and a budget that binds.
solid_at_budget() { # STUDY ROWS...
  local MAP_VIEWS=1 SURFACE=city study=$1
  shift
  seeded "$study" "$@" --iterations "$(steps "$study")" --budget 40000,80000,160000
}
# "points" begins with the points of known depths, as rows with terms do. "balance 0.01" is the default, with light 0.08 and flat 0.01. Rows of a weight of
# spread are of commits before balance took its place about known depths.
solid_fixed_rows() { # STUDY SCENE TRAIN-OPTIONS
  local study=$1 scene=$2 off=(--solid-spread 0 --solid-light 0 --solid-flat 0)
  shift 2
  row "$study" "balance 0.01" "$scene" "" "$@" --depth-prior "$OUT/$scene-depth"
  row "$study" none "$scene" "" "$@" "${off[@]}"
  row "$study" "none, points" "$scene" "" "$@" --depth-prior "$OUT/$scene-depth" "${off[@]}"
}
study_solid_fixed() { solid_at_budget solid_fixed solid_fixed_rows solid_fixed exact; }
# Terms alone and in pairs, and all of them without known depths.
solid_alone_rows() { # TRAIN-OPTIONS
  local known=("$@" --depth-prior "$OUT/exact-depth")
  row solid_alone "light alone" exact "" "${known[@]}" --solid-spread 0 --solid-flat 0
  row solid_alone "balance, light" exact "" "${known[@]}" --solid-flat 0
  row solid_alone "light, flat" exact "" "${known[@]}" --solid-spread 0
  row solid_alone "no known depths" exact "" "$@"
}
study_solid_alone() { solid_at_budget solid_alone solid_alone_rows; }
solid_fixed_caliterra_rows() { # TRAIN-OPTIONS
  solid_fixed_rows solid_fixed_caliterra caliterra-400 "$@"
  row solid_fixed_caliterra "light alone" caliterra-400 "" "$@" --depth-prior "$OUT/caliterra-400-depth" --solid-spread 0 --solid-flat 0
}
study_solid_fixed_caliterra() {
  local SURFACE=points
  seeded solid_fixed_caliterra solid_fixed_caliterra_rows --iterations "$(steps solid_fixed_caliterra)" --budget 25000,50000,100000
}
# The same elsewhere: in paint that says little of shape, and in a district that was seen from all sides.
solid_elsewhere_rows() { # STUDY SCENE TRAIN-OPTIONS
  local study=$1 scene=$2
  shift 2
  set -- "$scene" "" "$@" --depth-prior "$OUT/$scene-depth"
  row "$study" "balance 0.01" "$@"
  row "$study" "none, points" "$@" --solid-spread 0 --solid-light 0 --solid-flat 0
}
study_solid_fixed_tricky() { solid_at_budget solid_fixed_tricky solid_elsewhere_rows solid_fixed_tricky tricky; }
study_solid_fixed_ochota() {
  local SURFACE=points
  seeded solid_fixed_ochota solid_elsewhere_rows solid_fixed_ochota ochota-400 --iterations "$(steps solid_fixed_ochota)" --budget 40000,80000,160000
}
# With 0.7 of the Gaussians, against no term with all of them in solid_fixed.
solid_fewer_rows() { # TRAIN-OPTIONS
  row solid_fixed_fewer "balance 0.01" exact "" "$@" --budget 28000,56000,112000 --depth-prior "$OUT/exact-depth"
}
study_solid_fixed_fewer() {
  local MAP_VIEWS=1 SURFACE=city
  seeded solid_fixed_fewer solid_fewer_rows --iterations "$(steps solid_fixed_fewer)"
}
study_solid_tricky() { MAP_VIEWS=1 solid solid_tricky tricky city; }
# Photographs of twice as many pixels across: half the footprint of a pixel.
fine_rows() {
  local MAP_VIEWS=1 SURFACE=city GSD_M=0.096 STUDY_ROWS=${STUDY_ROWS:-stereo}
  solid_rows row solid_fine fine --iterations "$(steps solid_fine)"
}
study_solid_fine() { seeded solid_fine fine_rows; }
# What is known without training: the depth maps of `stereo`, brought together as a map. The study's rows are beside those of solid.
study_solid_mvs() {
  local scene=exact name="known depths alone" folder=$OUT/mvs command TIMEFORMAT="%U %S"
  command="citysplat stereo exact -o exact-depth; citysplat dsm exact --depths exact-depth --gsd-m 0.192; citysplat-lab truth exact-photos DSM"
  wanted solid_mvs "$name" "$command" || return 0
  scene $scene
  rm -rf "$folder"
  mkdir -p "$folder"
  ceilings
  { # processor seconds of all cores
    time {
      citysplat stereo "$OUT/$scene" -o "$folder/depth"
      citysplat dsm "$OUT/$scene" --depths "$folder/depth" --gsd-m 0.192 -o "$folder/dsm.tif"
    } >"$folder/log" 2>&1
  } 2>"$folder/time"
  record solid_mvs "$name" "$command" --dataset "$(scene_about $scene)" --commit "$COMMIT" --ceilings "$OUT/ceilings.jsonl" \
    --set "$(map_errors $scene "$folder/dsm.tif"),cpu_s=$(awk '{ print $1 + $2 }' "$folder/time")"
  rm -rf "$folder"
}
# Two surveys of a place where a block was built: the volume that `compare` finds, of three later trainings.
study_solid_block() {
  local k
  for k in 2 3 4; do
    changed solid_block "stereo (seeds 1 and $k)" exact block "$k" --iterations "$(steps solid_block)" --depth-prior
  done
  rm -rf "$OUT/trained/solid-block"*
}
study_solid_caliterra() { solid solid_caliterra caliterra-400 points; }
study_solid_ochota() { solid solid_ochota ochota-400 points; }

# What long Gaussians and harmonics do to views from where nobody photographed.
side_rows() {
  local MAP_VIEWS=1 base=(--iterations "$(steps side)" --budget 20000,40000,80000)
  row side "both" above "" "${base[@]}"
}
side_demo_rows() {
  local MAP_VIEWS=1 base=(--iterations "$(steps side_demo)" "${SMALL[@]}")
  row side_demo "both" demo "" "${base[@]}"
}
side_caliterra_rows() {
  local base=(--level-count 1 --iterations "$(steps side_caliterra)" --budget 200000)
  row side_caliterra "both" caliterra-400 "" "${base[@]}"
}
study_side() { seeded side side_rows; }
study_side_demo() { seeded side_demo side_demo_rows; }
study_side_caliterra() { seeded side_caliterra side_caliterra_rows; }

# Steps that are larger in short runs, against those of the full method.
rates_city_rows() {
  local MAP_VIEWS=1 base=(--iterations "$(steps rates)" "${SMALL[@]}")
  row rates "rates of the full method" demo "" "${base[@]}" --lr-short 1
  row rates default demo "" "${base[@]}"
}
rates_caliterra_rows() {
  local base=(--level-count 1 --iterations "$(steps rates_caliterra)" --budget 200000)
  row rates_caliterra "rates of the full method" caliterra-400 "" "${base[@]}" --lr-short 1
  row rates_caliterra default caliterra-400 "" "${base[@]}"
}
study_rates() { seeded rates rates_city_rows; }
study_rates_caliterra() { seeded rates_caliterra rates_caliterra_rows; }

# Rates that fall at the end of a run, and that stay; with known depths. And runs that choose their length.
fall_rows() { # STUDY SCENE TRAIN-OPTIONS
  local study=$1 scene=$2
  shift 2
  row "$study" "rates fall" "$scene" "" --iterations "$(steps "$study")" --depth-prior "$OUT/$scene-depth" "$@"
  row "$study" "rates stay" "$scene" "" --iterations "$(steps "$study")" --depth-prior "$OUT/$scene-depth" --lr-end 1 "$@"
}
study_fall() {
  local MAP_VIEWS=1 SURFACE=city
  seeded fall fall_rows fall exact
}
study_fall_caliterra() { seeded fall_caliterra fall_rows fall_caliterra caliterra-400; }
study_fall_ochota() { seeded fall_ochota fall_rows fall_ochota ochota-400; }
# Which level is trained first. Every level on photographs of its own size, and tiles of a store that are picked for
# photographs made small, as if from farther away.
order_rows() { # STUDY SCENE
  local study=$1 scene=$2 base
  base=(--iterations "$(steps "$study")" --depth-prior "$OUT/$scene-depth")
  row "$study" "coarse to fine" "$scene" "" "${base[@]}" --level-order coarse-to-fine --tiles --max-edge-px 96 --half-image off
  row "$study" "and coarse ones again" "$scene" "" "${base[@]}" --level-order both --tiles --max-edge-px 96 --half-image off
}
study_order() {
  local MAP_VIEWS=tiles SURFACE=city
  seeded order order_rows order exact
}
study_order_caliterra() { seeded order_caliterra order_rows order_caliterra caliterra-400; }

# The whole method at half of the paper's steps.
study_full() {
  row full caliterra caliterra-800 "" --iterations "$(steps full)"
  row full ochota ochota-800 "" --iterations "$(steps full)" --appearance --eval --half-image on
}

# A square kilometre in twelve cells, trained once for the studies of its tiles and levels as well.
big_options() { printf '%s\n' --iterations "$(steps big)" --budget 30000,60000,100000 --jobs 2; }
study_big() {
  local base MAP_VIEWS=1
  mapfile -t base < <(big_options)
  SHARED=1 row big "trained" big "" "${base[@]}"
}

# level_row STUDY ROW SCENE SET EVAL-OPTIONS -- TRAIN-OPTIONS: every level of the same trained scene by its photographs, or
# with `--views` the finest one by its map views.
level_row() {
  local study=$1 name=$2 scene=$3 set=$4 folder command what=eval-photographs views=() eval=()
  shift 4
  while [ "$1" != -- ]; do
    case $1 in
      --views) what=eval-views views=("$scene-photos/map-views") ;;
      *) eval+=("$1") ;;
    esac
    shift
  done
  shift
  [ -z "$SEED" ] || { name="$name (seed $SEED)" set="${set:+$set,}seed=$SEED"; set -- --seed "$SEED" "$@"; }
  command="citysplat train $scene $*; citysplat-lab $what $scene${views[*]:+ ${views[*]}} ${eval[*]}"
  wanted "$study" "$name" "$command" || return 0
  scene "$scene" || { say "$study: $name: skipped: its photographs are not at hand"; return 0; }
  folder=$OUT/trained/$(slug shared "$scene")
  ceilings
  trained "$folder" "$scene" "$@"
  lab "$what" "$OUT/$scene" "${views[@]/#/$OUT/}" --results "$folder" -o "$folder/scores.json" --overwrite "${eval[@]}" >&2
  record "$study" "$name" "$command" --dataset "$(scene_about "$scene")" --commit "$COMMIT" \
    --scores "$folder/scores.json" --ceilings "$OUT/ceilings.jsonl" --set "$set"
}

study_far() { # where each level suits: all of them from farther and farther away, which is to say, smaller
  local px base
  mapfile -t base < <(big_options)
  for px in 512 256 128 64; do
    level_row far "$px px" big "" --half-image off --full-size --max-edge-px "$px" -- "${base[@]}"
  done
}

# Pictures drawn finer and filtered down: map views, and photographs made small as if from farther away.
supersample_rows() {
  local f
  for f in 1 2 3; do
    level_row supersample "$f" demo "factor=$f" --views --supersample "$f" -- --iterations "$(steps supersample)" "${SMALL[@]}"
  done
}
supersample_caliterra_rows() {
  local px f
  for px in 400 200 100; do
    for f in 1 2; do
      level_row supersample_caliterra "$px px: $f" caliterra-400 "factor=$f" --half-image off --max-edge-px "$px" --supersample "$f" -- \
        --level-count 1 --iterations "$(steps supersample_caliterra)" --budget 200000
    done
  done
}
study_supersample() { seeded supersample supersample_rows; }
study_supersample_caliterra() { seeded supersample_caliterra supersample_caliterra_rows; }

study_lod() { # tile sizes, distances and what a Gaussian may have on the screen (Tables 12 and 13)
  local edge d base
  mapfile -t base < <(big_options)
  for d in 0.5 1 2 4 8; do
    tile_row lod "screen: $d px" big "edge_m=50,error_px=$d" --tile-edge-m 50 --eval --metric screen --error-px "$d" -- "${base[@]}"
  done
  for edge in 50 100 200; do
    tile_row lod "edge: $edge m" big "edge_m=$edge,distance_1_m=90,distance_2_m=180" --tile-edge-m "$edge" \
      --eval --metric distance --distance-m 90,180 -- "${base[@]}"
  done
  for d in 45 180 360; do
    tile_row lod "distance: $d m" big "edge_m=50,distance_1_m=$d,distance_2_m=$((2 * d))" --tile-edge-m 50 \
      --eval --metric distance --distance-m "$d",$((2 * d)) -- "${base[@]}"
  done
}

# citysplat-lab bench on a quiet machine: `bench` all cases, `growth` against Gaussians and pixels.
bench_rows() { # STUDY NAMES...
  local study=$1 command
  shift
  command="citysplat-lab bench${*:+ $*}"
  wanted "$study" citysplat-bench "$command" || return 0 # what the row was first recorded as
  mkdir -p "$OUT"
  lab bench "$@" >"$OUT/$study.jsonl"
  record "$study" citysplat-bench "$command" --dataset "procedural city of benchmarks" --commit "$COMMIT" \
    --bench "$OUT/$study.jsonl" --ceilings "$OUT/$study.jsonl"
}
study_bench() { bench_rows bench; }

# import_row MILLIONS: a city of so many Gaussians, without harmonics, tiled from one .ply. It needs 68 B a Gaussian on the disk
# for the .ply, and 55 B for what tiling writes.
import_row() {
  local m=$1 line
  local command="citysplat-lab splats --count ${1}M -o city.ply; citysplat import city.ply --no-lossless -o city.tiles"
  wanted growth "import $m M" "$command" || return 0
  mkdir -p "$OUT"
  ceilings
  lab splats --count "${m}M" -o "$OUT/import.ply" --overwrite -q
  line=$(citysplat import "$OUT/import.ply" --no-lossless -o "$OUT/import.tiles" --overwrite 2>&1 >/dev/null | grep 'tile seconds=')
  rm "$OUT/import.ply"
  awk -v m="$m" -v bytes="$(stat -c %s "$OUT/import.tiles")" -v device="$(sed -n 's/.*"device":"\([^"]*\)".*/\1/p' "$OUT/ceilings.jsonl" | head -1)" '{
    for (i = 1; i <= NF; i++) if (split($i, kv, "=") == 2) v[kv[1]] = kv[2]
    printf "{\"bench\":\"growth\",\"case\":\"import: %.0f Gaussians\",\"value\":%s,\"unit\":\"s\",\"gaussians\":%.0f,\"gaussians_per_s\":%.0f,\"cpu_s\":%s,", m * 1e6, v["seconds"], m * 1e6, m * 1e6 / v["seconds"], v["cpu_s"]
    printf "\"read_s\":%s,\"plan_s\":%s,\"write_s\":%s,\"peak_bytes\":%s,\"bytes\":%.0f,\"device\":\"%s\"}\n", v["read_s"], v["plan_s"], v["write_s"], v["peak_bytes"], bytes, device
  }' <<<"$line" >"$OUT/import.jsonl"
  rm "$OUT/import.tiles"
  record growth "import $m M" "$command" --dataset "city of Gaussians" --commit "$COMMIT" --bench "$OUT/import.jsonl" \
    --ceilings "$OUT/ceilings.jsonl"
}
study_growth() {
  local m
  bench_rows growth growth
  for m in 1 4 16 64; do import_row "$m"; done
}
study_growth_import() { # MILLIONS in STUDY_MILLIONS: the largest need much disk
  local m
  for m in ${STUDY_MILLIONS:-1 4 16 64}; do import_row "$m"; done
}

# scored STUDY SCENE TRAIN-OPTIONS: trains SCENE and sets FOLDER; those of the city are the same for several studies.
scored() {
  local study=$1 scene=$2
  shift 2
  scene "$scene" || { say "$study: skipped: its photographs are not at hand"; return 1; }
  case $scene in city) FOLDER=$OUT/trained/$(slug shared city) ;; *) FOLDER=$OUT/trained/$(slug "$study" "$scene") ;; esac
  ceilings
  trained "$FOLDER" "$scene" "$@"
}
forget() { [ "${KEEP:-0}" = 1 ] || [ "$FOLDER" = "$OUT/trained/shared-city" ] || rm -rf "$FOLDER"; }

# What rd, layout and pyramid record by themselves.
bench_scored() { # NAME STUDY SCENE COMMAND, then options of citysplat-lab bench
  local name=$1 study=$2 scene=$3 command=$4
  shift 4
  lab "$name" "$@" --study "$study" --dataset "$(scene_about "$scene")" --command "$command" \
    --commit "$COMMIT" --record "$(runs_of "$study")" >&2
}

# Bytes a Gaussian against PSNR: every preset and format, and every field of the quantiser by itself; and, as the
# study layout, bytes by what no picture shows.
rate() { # SUFFIX SCENE TRAIN-OPTIONS
  local rd=rd$1 layout=layout$1 scene=$2 command todo=
  shift 2
  command="citysplat train $scene $*; citysplat tile $scene --crop none; citysplat-lab"
  wanted "$rd" "preset:balanced" "$command rd --scene $scene --tiles CITY.tiles" && todo=rd
  wanted "$layout" "order: Hilbert curve" "$command layout --tiles CITY.tiles" && todo+=layout
  [ -n "$todo" ] || return 0
  scored "$rd" "$scene" "$@" || return 0
  citysplat tile "$OUT/$scene" --crop none --trained "$FOLDER" -o "$FOLDER/city.tiles" --overwrite >&2
  case $todo in rd*) bench_scored rd "$rd" "$scene" "$command rd --scene $scene --tiles CITY.tiles" --scene "$OUT/$scene" --tiles "$FOLDER/city.tiles" ;; esac
  case $todo in *layout) bench_scored layout "$layout" "$scene" "$command layout --tiles CITY.tiles" --tiles "$FOLDER/city.tiles" ;; esac
  forget
}
study_rd() {
  rate "" caliterra-400 --level-count 1 --iterations "$(steps rd)" --budget 150000
  rate _city city --iterations "$(steps rd_city)" "${SMALL[@]}"
}

study_layout() { # study_rd has two scenes; this one has appearance embeddings
  local n command
  n=$(steps layout_light) || exit 1
  command="citysplat train city-light --level-count 1 --iterations $n --budget 100000 --appearance --appearance-warmup 250 --embed-len 16"
  command+="; citysplat tile city-light --crop none; citysplat-lab layout --tiles CITY.tiles"
  wanted layout_light "order: Hilbert curve" "$command" || return 0
  scored layout city-light --level-count 1 --iterations "$n" --budget 100000 --appearance --appearance-warmup 250 --embed-len 16
  citysplat tile "$OUT/city-light" --crop none --trained "$FOLDER" -o "$FOLDER/city.tiles" --overwrite >&2
  bench_scored layout layout_light city-light "$command" --tiles "$FOLDER/city.tiles"
  forget
}

# Trained levels against the finest one simplified to as many Gaussians: levels that were trained for long, and for a
# few hundred steps.
pyramid() { # STUDY SCENE TRAIN-OPTIONS
  local study=$1 scene=$2 command
  shift 2
  command="citysplat train $scene $*; citysplat-lab pyramid --scene $scene"
  wanted "$study" trained "$command" || return 0
  scored "$study" "$scene" "$@" || return 0
  bench_scored pyramid "$study" "$scene" "$command" --scene "$OUT/$scene" --trained "$FOLDER"
  forget
}
study_pyramid() {
  pyramid pyramid caliterra-400 --iterations "$(steps pyramid)" --budget-rule table --budget 25000,50000,100000
  pyramid pyramid_city city --iterations "$(steps pyramid_city)" "${SMALL[@]}"
}

# Those of a city trained alike stand together: it is trained once for them.
readonly STUDIES=(time full long long_city big lod far budgets pareto importance rates rates_caliterra fall fall_caliterra fall_ochota side side_demo side_caliterra remedies remedies_caliterra background background_caliterra solid solid_terms solid_fixed solid_alone solid_fixed_caliterra solid_fixed_tricky solid_fixed_ochota solid_fixed_fewer solid_tricky solid_fine solid_block solid_mvs solid_caliterra solid_ochota sh sh_ochota sh_demo sh_gloss embedding network transfer transfer_sun ochota_light ochota_cells ochota_cells_light ablation ablation_city cells cells_light
  supersample supersample_caliterra rd layout pyramid growth bench)

main() {
  local s wanted_studies=()
  for s in "$@"; do
    case $s in
      --dry-run) DRY=1 ;;
      --list) printf '%s\n' "${STUDIES[@]}"; return ;;
      -h | --help) sed -n '2,/SPDX/{/SPDX/d;s/^# \{0,1\}//p}' "${BASH_SOURCE[0]}"; return ;;
      all) wanted_studies=("${STUDIES[@]}") ;;
      *) declare -F "study_$s" >/dev/null || die "no study '$s'; --list names them"
        wanted_studies+=("$s") ;;
    esac
  done
  [ ${#wanted_studies[@]} -gt 0 ] || { "${BASH_SOURCE[0]}" --help >&2; exit 2; }
  [ -x "$BIN/citysplat-lab" ] || [ $DRY = 1 ] || die "$BIN/citysplat-lab is not there: cmake --build --preset release"
  [ $DRY = 1 ] || mkdir -p "$OUT" "$RUNS"
  COMMIT=${STUDY_COMMIT:-$(git rev-parse --short HEAD 2>/dev/null || echo unknown)}
  # A record of changes that are nowhere cannot be repeated.
  [ $DRY = 1 ] || [ -n "${STUDY_COMMIT:-}" ] || [ -z "$(git status --porcelain -- . ':!docs' ':!lab/runs' ':!lab/studies' ':!lab/charts' ':!lab/study.sh' 2>/dev/null)" ] ||
    die "the working tree has changes: commit them, or name the commit that the programs are of (STUDY_COMMIT)"
  for s in "${wanted_studies[@]}"; do "study_$s"; done
}
main "$@"
