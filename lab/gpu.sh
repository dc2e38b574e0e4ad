#!/usr/bin/env bash
# gpu.sh: what a device is worth, in one command and under ten minutes: is it right, how fast is it, what does it train.
#
#   lab/gpu.sh [--device NAME] [--steps N] [--runs N] [--most N] [-o FILE] [--quick]
#
#   1. build, if there is no build/release yet (CITYSPLAT_BUILD names another)
#   2. every test of a kernel against its twin in plain C (ctest -L '^cl$'), on the device
#   3. ceilings of the device; a frame and a training iteration of 0.1, 1, 3.6 and 6.84 million Gaussians; on a GPU
#      also each kernel of an iteration
#   4. caliterra at its full size, trained and scored (CITYSPLAT_CALITERRA; without it the procedural city)
#
# One JSON line a figure on stdout and in FILE, keys as in lab/runs/README.md; what is going on, on stderr. --device
# as in `citysplat train`: auto takes a GPU where there is one, else PoCL. The tests always take what auto takes.
# --steps of the training: 3,000 on a GPU, 200 on a CPU if not given. --most: sizes of no more Gaussians than this. --quick:
# one small size of everything; does it run at all?
# Every stage ends by itself: a figure that takes too long is missing, and said. Exit 0: everything ran; 1: not.
#
# SPDX-License-Identifier: Apache-2.0
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.." || exit 1

readonly BUILD=${CITYSPLAT_BUILD:-build/release}
readonly BUILD_S=150 TESTS_S=120 SIZES_S=180 TRAIN_S=110 # at most; together under ten minutes
DEVICE=auto STEPS= RUNS= MOST=0 OUT=/dev/null QUICK=
say() { printf '== %s\n' "$*" >&2; }
die() { printf 'gpu: error: %s\n' "$*" >&2; exit "${2:-2}"; }

while [ $# -gt 0 ]; do
    case $1 in
        --device) DEVICE=${2:?--device NAME}; shift ;;
        --steps) STEPS=${2:?--steps N}; shift ;;
        --runs) RUNS=${2:?--runs N}; shift ;;
        --most) MOST=${2:?--most N}; shift ;;
        -o) OUT=${2:?-o FILE}; shift ;;
        --quick) QUICK=--quick ;;
        -h | --help) sed -n '2,20s/^# \{0,1\}//p' "$0"; exit 0 ;;
        *) die "unknown argument: $1 (--help)" ;;
    esac
    shift
done

scratch=$(mktemp -d) || exit 1
trap 'rm -rf "$scratch"' EXIT
failed=0
[ "$OUT" = /dev/null ] || : >"$OUT" || die "cannot write $OUT" 1
print() { tee -a "$OUT"; }
figure() { # CASE VALUE UNIT
    printf '{"bench": "gpu", "case": "%s", "value": %s, "unit": "%s", "device": "%s"}\n' "$1" "$2" "$3" "$name" | print
}
missing() { printf 'gpu: missing: %s\n' "$*" >&2; failed=1; }

if [ ! -x "$BUILD/citysplat-lab" ]; then
    say "building ($BUILD)"
    cmake --preset release >"$scratch/build.log" 2>&1 &&
        timeout "$BUILD_S" cmake --build --preset release >>"$scratch/build.log" 2>&1 ||
        { tail -n 20 "$scratch/build.log" >&2; die "the build failed; ./bootstrap packages installs what it needs" 1; }
fi

say "ceilings of the device"
timeout 60 "$BUILD/citysplat-lab" ceiling --device "$DEVICE" $QUICK 2>"$scratch/ceiling.log" | print >"$scratch/ceiling.json"
name=$(sed -n 's/.*"device": *"\([^"]*\)".*/\1/p' "$scratch/ceiling.json" | head -n 1)
[ -n "$name" ] || { cat "$scratch/ceiling.log" >&2; die "no device '$DEVICE'" 1; }
cat "$scratch/ceiling.json"
is_gpu=$("$BUILD/citysplat-lab" ceiling --device gpu --quick >/dev/null 2>&1 && echo 1 || echo 0)
[ "$DEVICE" != cpu ] || is_gpu=0
say "device: $name"

say "kernels against their twins"
if [ -f "$BUILD/CTestTestfile.cmake" ]; then
    timeout "$TESTS_S" ctest --test-dir "$BUILD" -L '^cl$' -LE '^long$' -j "$(nproc)" --timeout "$TESTS_S" >"$scratch/tests.log" 2>&1
    case $? in
        0) ;;
        124) missing "tests of kernels: stopped after $TESTS_S s" ;;
        *)
            grep -E 'Failed|\*\*\*|Timeout' "$scratch/tests.log" >&2
            missing "tests of kernels: not all passed"
            ;;
    esac
    figure "tests of kernels that passed" "$(grep -c ' Passed ' "$scratch/tests.log")" tests
    figure "tests of kernels that did not pass" "$(grep -cE '\*\*\*' "$scratch/tests.log")" tests
else
    missing "tests of kernels: $BUILD has none"
fi

say "a frame and a training iteration, up to 6.84 million Gaussians"
[ -n "$RUNS" ] || RUNS=$([ "$is_gpu" = 1 ] && echo 20 || echo 1)
names=sizes
[ "$is_gpu" = 0 ] || names="kernels sizes"
# shellcheck disable=SC2086 # the names of benchmarks are words
timeout "$SIZES_S" "$BUILD/citysplat-lab" $names --device "$DEVICE" --runs "$RUNS" --most "$MOST" $QUICK 2>"$scratch/sizes.log" | print
[ "${PIPESTATUS[0]}" = 0 ] || missing "sizes: $(tail -n 1 "$scratch/sizes.log") (stopped after $SIZES_S s, if nothing else is said)"
grep 'left out' "$scratch/sizes.log" >&2

edge=0 iterations=${STEPS:-$([ "$is_gpu" = 1 ] && echo 3000 || echo 200)}
if [ -n "${CITYSPLAT_CALITERRA:-}" ] && [ -z "$QUICK" ]; then
    what="caliterra, 1600 x 1200"
    say "training: $what, $iterations steps"
    "$BUILD/citysplat" ingest "$CITYSPLAT_CALITERRA/images" "$CITYSPLAT_CALITERRA/sparse" -o "$scratch/scene" -q || missing "caliterra: ingest"
else
    what="procedural city, 400 x 300"
    say "training: $what, $iterations steps (CITYSPLAT_CALITERRA is not given)"
    [ -z "$QUICK" ] || { edge=100; iterations=${STEPS:-60}; }
    "$BUILD/citysplat" synth -o "$scratch/photos" -q &&
        "$BUILD/citysplat" ingest "$scratch/photos/images" "$scratch/photos/sparse" -o "$scratch/scene" -q || missing "city: synth, ingest"
fi
began=$(date +%s.%N)
if timeout --signal INT "$TRAIN_S" "$BUILD/citysplat" train "$scratch/scene" --iterations "$iterations" --level-count 1 \
    --max-edge-px "$edge" --device "$DEVICE" -q >"$scratch/train.log" 2>&1; then
    figure "$what: $iterations steps" "$(awk -v a="$began" -v b="$(date +%s.%N)" 'BEGIN { printf "%.1f", b - a }')" s
    timeout 60 "$BUILD/citysplat" eval "$scratch/scene" --device "$DEVICE" -q -o "$scratch/scores.json" >>"$scratch/train.log" 2>&1 &&
        figure "$what: test photographs" "$(sed -n 's/.*"psnr_db": *\([0-9.]*\).*/\1/p' "$scratch/scores.json" | head -n 1)" dB ||
        missing "eval: $(tail -n 1 "$scratch/train.log")"
else
    missing "training: not done within $TRAIN_S s, or: $(tail -n 1 "$scratch/train.log")"
fi
exit $failed
