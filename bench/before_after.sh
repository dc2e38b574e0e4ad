#!/usr/bin/env bash
# before_after.sh: the same poses drawn by an earlier commit of this program and by this one, and what both cost.
#
#   bench/before_after.sh pictures [SCENE...]   docs/pictures/before-after-SCENE.jpg: six poses, before above after
#   bench/before_after.sh cost [SCENE...]       seconds and peak memory of short runs in turn, and of drawing one store
#   bench/before_after.sh parts SCENE           the same for this program with one remedy less at a time
#
# SCENE: demo, caliterra, ochota; all (cost: the first two) if none is given. Both programs train the same ingested photographs
# with the same steps, seed and budgets; all else is the default of each. docs/studies/before-after.md tells what is seen.
# What is there is not made again: a stopped run goes on. Pictures are put together by netpbm (Debian's package).
#
# Environment:
#   BEFORE                the earlier commit [fd913b9]
#   CITYSPLAT_CALITERRA   folder with images/ and sparse/ of the caliterra survey (docs/caliterra.md); without it: skipped
#   CITYSPLAT_OCHOTA      the same of the ochota survey (docs/exposure.md)
#   BEFORE_AFTER_OUT      where sources, scenes, trained cells and tiles go [out/before-after]
#   BEFORE_AFTER_STEPS    steps of the runs for pictures [3000]; those for cost: [600]
#   BEFORE_AFTER_PAIRS    runs of each for cost [3]
#   BEFORE_AFTER_CORE     the core that runs for cost are held to [1]
#   PICTURES              where the pictures go [docs/pictures]
#   CITYSPLAT_BUILD       folder of this program [build/release]
#
# SPDX-License-Identifier: Apache-2.0
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

readonly BEFORE=${BEFORE:-fd913b9}
readonly OUT=${BEFORE_AFTER_OUT:-out/before-after}
readonly PICTURES=${PICTURES:-docs/pictures}
readonly AFTER_BUILD=${CITYSPLAT_BUILD:-build/release}
readonly PAIRS=${BEFORE_AFTER_PAIRS:-3} CORE=${BEFORE_AFTER_CORE:-1}
readonly BACKGROUND=0.66,0.76,0.93 # the sky of the demo city
readonly SCENES=(demo caliterra ochota)

say() { printf '== %s\n' "$*" >&2; }
die() { printf 'before_after: error: %s\n' "$*" >&2; exit 1; }

# ---- both programs ----------------------------------------------------------------------------------------

build() { # FOLDER LOG
  say "building $1"
  (cd "$1" && cmake --preset release && cmake --build --preset release --target citysplat) >"$2" 2>&1 || { tail -n 20 "$2" >&2; die "$1 was not built"; }
}

programs() {
  mkdir -p "$OUT"
  [ -x "$AFTER_BUILD/citysplat" ] || build . "$OUT/build-after.log"
  [ -x "$OUT/before-source/build/release/citysplat" ] && return
  [ -e "$OUT/before-source" ] || git worktree add --detach "$OUT/before-source" "$BEFORE" >&2
  build "$OUT/before-source" "$OUT/build-before.log"
}

program() { # before|after
  case $1 in before) printf '%s' "$OUT/before-source/build/release/citysplat" ;; *) printf '%s' "$AFTER_BUILD/citysplat" ;; esac
}

# ---- scenes -----------------------------------------------------------------------------------------------

# scene NAME: ingested once, by this program, so that both stand in one frame; false where photographs are not at hand.
scene() {
  local folder=$OUT/$1 citysplat
  citysplat=$(program after)
  case $1 in
    demo) ;;
    caliterra) [ -n "${CITYSPLAT_CALITERRA:-}" ] || [ -f "$folder/scene.json" ] || { say "$1: skipped: its photographs are not at hand"; return 1; } ;;
    ochota) [ -n "${CITYSPLAT_OCHOTA:-}" ] || [ -f "$folder/scene.json" ] || { say "$1: skipped: its photographs are not at hand"; return 1; } ;;
    *) die "no scene '$1'" ;;
  esac
  [ ! -f "$folder/scene.json" ] || return 0
  say "scene $1"
  rm -rf "$folder.part"
  case $1 in
    demo)
      "$citysplat" synth --config configs/demo-synth.jsonc --map-views 24 -o "$folder-photos" --overwrite -q
      "$citysplat" ingest "$folder-photos/images" "$folder-photos/sparse" --config configs/demo-ingest.jsonc -o "$folder.part" -q
      ;;
    caliterra) "$citysplat" ingest "$CITYSPLAT_CALITERRA/images" "$CITYSPLAT_CALITERRA/sparse" --max-edge-px 400 -o "$folder.part" -q ;;
    ochota) # no GPS: what a map says of its middle, and of its size
      "$citysplat" ingest "$CITYSPLAT_OCHOTA/images" "$CITYSPLAT_OCHOTA/sparse" --max-edge-px 400 --origin 20.97095,52.218,110 --metres-per-unit 71 \
        --attribution "Andrew Zaborowski, CC BY 3.0, OpenStreetMap-PL" -o "$folder.part" -q ;;
  esac >&2
  mv "$folder.part" "$folder"
}

budgets() { # SCENE
  local finest=160000
  [ "$1" != ochota ] || finest=240000
  printf '%s\n' --budget-rule table --budget $((finest / 4)),$((finest / 2)),"$finest"
}

# Six poses a scene: NAME, metres east, north and up of the origin, heading and pitch in degrees.
poses() {
  case $1 in
    demo) cat <<END ;;
straight-down      0   -5  90    0 -90
near             -10  -50  38    0 -45
from-afar          0 -190 152    0 -40
towards-the-edge -20  -50  40    0 -20
from-outside    -210  -60  60   75 -20
street           -12  -72   3   74  -2
END
    caliterra) cat <<END ;;
straight-down      5   -5  70    0 -90
near              10  -30  27    0 -45
from-afar          5 -130 105    0 -40
towards-the-edge -20  -30  24   10 -20
from-outside    -140  -40  40   75 -20
street             5  -10   3   30  -4
END
    ochota) cat <<END ;;
straight-down   -100    0 420    0 -90
near            -150 -220 185    0 -45
from-afar       -150 -900 740    0 -40
towards-the-edge -100 -100 150  60 -20
from-outside     700  -60 300  285 -22
street          -124  -67  -4  353  -3
END
  esac
}

# The camera as JSON: 640 x 480 px, 50 degrees from top to bottom.
camera() { # X Y Z HEADING PITCH
  awk -v x="$1" -v y="$2" -v z="$3" -v heading="$4" -v pitch="$5" 'BEGIN {
    d = atan2(0, -1) / 180; h = heading * d; p = pitch * d; w = 640; t = 480
    f = t / 2 * cos(25 * d) / sin(25 * d)
    printf "{\"width\": %d, \"height\": %d, \"fx\": %.6f, \"fy\": %.6f, \"cx\": %d, \"cy\": %d, \"world_to_camera\": [", w, t, f, f, w / 2, t / 2
    row(cos(h), -sin(h), 0); row(sin(h) * sin(p), cos(h) * sin(p), -cos(p)); row(sin(h) * cos(p), cos(h) * cos(p), sin(p))
    print "0, 0, 0, 1]}"
  }
  function row(a, b, c) { printf "%.9f, %.9f, %.9f, %.9f, ", a, b, c, -(a * x + b * y + c * z) }'
}

# ---- pictures ---------------------------------------------------------------------------------------------

tiles() { # SCENE before|after: trained and tiled
  local run=$OUT/$1-$2 options citysplat
  [ ! -e "$run.tiles" ] || return 0
  citysplat=$(program "$2")
  mapfile -t options < <(budgets "$1")
  say "$1, $2: training"
  "$citysplat" train "$OUT/$1" --output "$run" --resume --seed 1 --iterations "${BEFORE_AFTER_STEPS:-3000}" "${options[@]}" >"$run.log" 2>&1
  "$citysplat" tile "$OUT/$1" --trained "$run" -o "$run.part" >>"$run.log" 2>&1
  mv "$run.part" "$run.tiles"
}

labelled() { # TEXT PICTURE.png: 400 px wide under a line of text, as PPM
  pbmtext -builtin fixed "$1" >"$OUT/views/text.pbm"
  pngtopnm "$2" | pamscale -xysize 400 300 >"$OUT/views/small.ppm"
  pnmcat -tb -jleft -white "$OUT/views/text.pbm" "$OUT/views/small.ppm"
}

sheet() { # SCENE
  local name which n=0 rows=() before=() after=() quality
  while read -r name _; do
    for which in before after; do
      labelled "$which: ${name//-/ }" "$OUT/views/$1-$name-$which.png" >"$OUT/views/$1-$name-$which.ppm"
    done
    before+=("$OUT/views/$1-$name-before.ppm") after+=("$OUT/views/$1-$name-after.ppm")
    n=$((n + 1))
    [ $((n % 3)) = 0 ] || continue
    for which in before after; do
      if [ $which = before ]; then pnmcat -lr "${before[@]}"; else pnmcat -lr "${after[@]}"; fi >"$OUT/views/row-$n-$which.ppm"
      rows+=("$OUT/views/row-$n-$which.ppm")
    done
    before=() after=()
  done < <(poses "$1")
  if [ "$1" = ochota ]; then
    pbmtext -builtin fixed "Photographs: Andrew Zaborowski, CC BY 3.0, OpenStreetMap-PL" >"$OUT/views/credit.pbm"
    rows+=("$OUT/views/credit.pbm")
  fi
  pnmcat -tb -jleft -white "${rows[@]}" >"$OUT/views/$1.ppm"
  for quality in 88 84 80 75 70 60; do
    pnmtojpeg -quality=$quality -optimize "$OUT/views/$1.ppm" >"$PICTURES/before-after-$1.jpg"
    [ "$(stat -c %s "$PICTURES/before-after-$1.jpg")" -gt 350000 ] || break
  done
  say "$PICTURES/before-after-$1.jpg: quality $quality"
}

pictures() {
  local s which name pose
  mkdir -p "$OUT/views" "$PICTURES"
  for s in "$@"; do
    scene "$s" || continue
    for which in before after; do
      tiles "$s" "$which"
      while read -r name pose; do
        # shellcheck disable=SC2086 # five numbers
        camera $pose >"$OUT/views/camera.json"
        "$(program "$which")" render "$OUT/$s-$which.tiles" --camera "$OUT/views/camera.json" --background "$BACKGROUND" -q -o "$OUT/views/$s-$name-$which.png" >/dev/null
      done < <(poses "$s")
      # Both by this program's eval: the earlier one measured depth otherwise.
      [ "$s" != demo ] || "$(program after)" eval "$OUT/$s" --tiles "$OUT/$s-$which.tiles" --views "$OUT/$s-photos/map-views" -q -o "$OUT/$s-$which-views.json" >/dev/null
    done
    sheet "$s"
  done
}

# ---- cost -------------------------------------------------------------------------------------------------

# A budget that binds nearly from the start, so that both have as many Gaussians in nearly every step.
short() { # SCENE
  local finest=40000
  [ "$1" != demo ] || finest=32000
  printf '%s\n' --iterations "${BEFORE_AFTER_STEPS:-600}" --seed 1 --threads 1 --budget-rule table --budget $((finest / 4)),$((finest / 2)),"$finest"
}

# One line: what, scene, seconds that passed, seconds of the core, peak MB, Gaussians.
timed() { # WHAT SCENE PROGRAM train options
  local what=$1 s=$2 citysplat=$3 run=$OUT/cost-run
  shift 3
  rm -rf "$run"
  POCL_MAX_PTHREAD_COUNT=1 taskset -c "$CORE" /usr/bin/time -f '%e %U %S %M' -o "$run.time" \
    "$citysplat" train "$OUT/$s" --output "$run" "$@" >"$run.log" 2>&1 || die "$what: $(tail -1 "$run.log")"
  awk -v what="$what" -v scene="$s" -v count="$(sed -n 's/.* level=3 done gaussians=\([0-9]*\).*/\1/p' "$run.log")" \
    '{ printf "%s\t%s\t%.1f\t%.2f\t%.1f\t%d\n", what, scene, $1, $2 + $3, $4 / 1024, count }' "$run.time" | tee -a "$OUT/cost.tsv"
}

# Medians of every WHAT of a scene, and the median of its ratios to the first WHAT in the same round.
medians() { # SCENE FILE
  awk -F'\t' -v scene="$1" '
    function median(text,    v, n, i, j, x) {
      n = split(text, v, " ")
      for (i = 2; i <= n; i++) for (j = i; j > 1 && v[j - 1] + 0 > v[j] + 0; j--) { x = v[j]; v[j] = v[j - 1]; v[j - 1] = x }
      return n % 2 ? v[(n + 1) / 2] : (v[n / 2] + v[n / 2 + 1]) / 2
    }
    $2 == scene {
      if (!($1 in rounds)) order[++kinds] = $1
      n = ++rounds[$1]
      for (c = 3; c <= 6; c++) { value[$1, n, c] = $c; all[$1, c] = all[$1, c] " " $c }
    }
    END {
      print "what\tseconds\tratio\tcore seconds\tratio\tpeak MB\tratio\tGaussians"
      for (k = 1; k <= kinds; k++) {
        line = order[k]
        for (c = 3; c <= 5; c++) {
          ratios = ""
          for (n = 1; n <= rounds[order[k]] && n <= rounds[order[1]]; n++) ratios = ratios " " value[order[k], n, c] / value[order[1], n, c]
          line = line sprintf("\t%.1f\t%.3f", median(all[order[k], c]), median(ratios))
        }
        print line "\t" median(all[order[k], 6])
      }
    }' "$2"
}

# One line: what, scene, milliseconds of the core a frame: of 220 frames less those of 20, which leaves the start out.
framed() { # WHAT SCENE STORE
  local n
  for n in 20 220; do
    POCL_MAX_PTHREAD_COUNT=1 taskset -c "$CORE" /usr/bin/time -f '%U %S' -o "$OUT/frame-$n.time" \
      "$(program "$1")" render "$3" --camera "$OUT/camera.json" --repeat "$n" -q -o "$OUT/frame.png" >/dev/null
  done
  awk -v what="$1" -v scene="$2" '{ s = $1 + $2 - s } END { printf "%s\t%s\t%.2f\n", what, scene, s * 5 }' "$OUT/frame-20.time" "$OUT/frame-220.time"
}

cost() {
  local s which options store
  : >"$OUT/cost.tsv"
  : >"$OUT/frames.tsv"
  for s in "$@"; do
    scene "$s" || continue
    mapfile -t options < <(short "$s")
    for _ in $(seq "$PAIRS"); do
      for which in before after; do timed "$which" "$s" "$(program $which)" "${options[@]}"; done
    done
    medians "$s" "$OUT/cost.tsv"
    store=$OUT/$s-before.tiles # one store for both: equal Gaussians
    [ -e "$store" ] || continue
    # shellcheck disable=SC2046 # five numbers
    camera $(poses "$s" | sed -n '2s/^[^ ]* *//p') >"$OUT/camera.json"
    for _ in $(seq "$PAIRS"); do
      for which in before after; do framed "$which" "$s" "$store" | tee -a "$OUT/frames.tsv"; done
    done
  done
}

# What each remedy costs: this program as it is, without each, without all, and the earlier one.
parts() {
  local s=$1 options
  scene "$s" || return
  mapfile -t options < <(short "$s")
  : >"$OUT/cost.tsv"
  for _ in $(seq "$PAIRS"); do
    timed after "$s" "$(program after)" "${options[@]}"
    timed before "$s" "$(program before)" "${options[@]}"
    timed "no remedy" "$s" "$(program after)" "${options[@]}" --seed-ground 0 --free-space 0 --prune-contribution 0 --prune-support 0 --no-trim-rim --prune-size 0 \
      --scale-weight 0 --size-limit 0 --sh-ridge 0
    timed "no seeded ground" "$s" "$(program after)" "${options[@]}" --seed-ground 0
    timed "no free space" "$s" "$(program after)" "${options[@]}" --free-space 0
    timed "no pruning at the end" "$s" "$(program after)" "${options[@]}" --prune-contribution 0 --prune-support 0
    timed "no trimming of the rim" "$s" "$(program after)" "${options[@]}" --no-trim-rim
    timed "no removal by size" "$s" "$(program after)" "${options[@]}" --prune-size 0
    timed "no loss on sizes" "$s" "$(program after)" "${options[@]}" --scale-weight 0
    timed "no limit of sizes" "$s" "$(program after)" "${options[@]}" --size-limit 0
    timed "harmonics as trained" "$s" "$(program after)" "${options[@]}" --sh-ridge 0
    timed "no exposure" "$s" "$(program after)" "${options[@]}" --no-exposure
    timed "rates of before" "$s" "$(program after)" "${options[@]}" --lr-short 2
  done
  medians "$s" "$OUT/cost.tsv"
}

main() {
  local what=${1:-}
  case $what in
    pictures | cost | parts) ;;
    *) sed -n '2,/SPDX/{/SPDX/d;s/^# \{0,1\}//p}' "${BASH_SOURCE[0]}"; [ "$what" = --help ] || exit 2; return ;;
  esac
  shift
  [ "$what" != pictures ] || command -v pnmtojpeg >/dev/null || die "netpbm is not there: apt-get install netpbm"
  programs
  if [ $# -eq 0 ]; then
    case $what in pictures) set -- "${SCENES[@]}" ;; cost) set -- demo caliterra ;; parts) set -- demo ;; esac
  fi
  "$what" "$@"
}
main "$@"
