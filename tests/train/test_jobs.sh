#!/bin/sh
# Cells as jobs, through the program: one process, several processes, jobs with a dependent merge; what
# happens when a job fails, is stopped, or is started twice. Results must be the same bytes whichever way.
#
# SPDX-License-Identifier: Apache-2.0
bin=${CITYSPLAT_BIN:?set it to the citysplat program}
top=$(cd "$(dirname "$0")/../.." && pwd)
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-jobs-XXXXXX") || exit 1
trap 'rm -rf "$work"' EXIT
. "$(dirname "$0")/../check.sh"
said() { grep -Eq -- "$1" "$work/log"; }
same_levels() { # DIR-A DIR-B: the levels of all cells, byte by byte
    for f in "$1"/cells/*/level?.ckpt; do cmp "$f" "$2/${f#"$1"/}" || return 1; done
    [ "$(ls "$1"/cells/*/level?.ckpt | wc -l)" = 11 ] # 5 cells of 2 levels, and the coarse model
}

"$bin" synth -o "$work/city" --photos 24 --width-px 64 --height-px 48 --extent-m 120 --points 1200 >"$work/log" 2>&1 &&
    "$bin" ingest "$work/city/images" "$work/city/sparse" -o "$work/scene" >>"$work/log" 2>&1 &&
    "$bin" plan "$work/scene" --edge-m 70 --images-few 6 --images-least 3 >>"$work/log" 2>&1 ||
    { cat "$work/log"; exit 1; }
short="--iterations 40 --level-count 2 --budget 1500,1800 --coarse-iterations-min 20"
train() { "$bin" train "$work/scene" $short "$@" >"$work/log" 2>&1; }

check 'the picture of the plan shows cells, cameras and points' sh -c \
    "grep -c '<rect' $work/scene/plan.svg | grep -qv '^0' && [ \$(grep -c '<line' $work/scene/plan.svg) = 24 ] &&
     [ \$(grep -c 'r=\"0.8\"' $work/scene/plan.svg) -gt 100 ]"
"$bin" train "$work/scene" $short --list >"$work/list" 2>"$work/log"
n=$(wc -l <"$work/list")
check 'the list has a line a cell' [ "$n" = 5 ]
check 'all are new' [ "$(cut -f2 "$work/list" | sort -u)" = new ]
check 'each has a bound of memory and a time' [ "$(awk -F'\t' 'NF == 6 && $5 > 100 && $5 < 1000 && $6 > 0' "$work/list" | wc -l)" = "$n" ]
"$bin" train "$work/scene" --iterations 15000,15000,30000 --budget-rule table --list 2>>"$work/log" >"$work/full"
check 'the published length takes much more of both' [ "$(paste "$work/list" "$work/full" | awk -F'\t' '$11 > 10 * $5 && $12 > 100 * $6' | wc -l)" = "$n" ]
"$bin" train "$work/scene" $short --list --coarse-only >"$work/first" 2>>"$work/log"
check 'the coarse model has a line of its own' [ "$(cut -f1,2,4 "$work/first")" = "$(printf 'coarse\tnew\t20')" ]
check 'where the cells need it' [ -z "$("$bin" train "$work/scene" $short --list --coarse-only --no-coarse-start)" ]
second=$(sed -n 2p "$work/list" | cut -f1)

train -o "$work/early" --cell "$second"
check 'a cell waits for the coarse model' [ $? = 1 ]
check 'and says what makes it' said "--coarse-only"
check 'one process' train -o "$work/serial" --jobs 1
check 'four processes' train -o "$work/jobs" --jobs 4
check 'the same bytes' same_levels "$work/serial" "$work/jobs"
check 'by itself as many as there are threads' train -o "$work/itself" --threads 3 --device cpu
check 'and says so' said "3 of $n cells at a time"
check 'the same bytes again' same_levels "$work/serial" "$work/itself"
check 'one at a time where memory has room for one' train -o "$work/narrow" --threads 3 --device cpu --memory 300M
check 'in one process' [ ! -e "$work/narrow/cells/$second/train.log" ]
check 'with the same bytes' same_levels "$work/serial" "$work/narrow"
check 'done is listed' sh -c "[ \"\$('$bin' train '$work/scene' $short -o '$work/jobs' --list | cut -f2 | sort -u)\" = done ]"
check 'again: nothing to do' train -o "$work/jobs" --jobs 4 --resume
check 'says so' [ "$(grep -c 'complete already' "$work/jobs"/cells/*/train.log | grep -c ':1$')" = "$n" ]
check 'the table is whole' [ "$(grep -c ' of 2 ' "$work/log")" = $((2 * n)) ]

# A file that cannot be put in place fails one cell; the others are trained, and the rest is done later.
mkdir -p "$work/fail/cells/$second/level1.ckpt"
train -o "$work/fail" --jobs 3
check 'a failure is an exit code' [ $? = 1 ]
check 'names the cell' said "error: cell $second: .*level1.ckpt"
check 'and counts the others' said "$((n - 1)) of $n cells are complete"
check 'one error line' [ "$(grep -c 'citysplat train: error:' "$work/log")" = 1 ]
rmdir "$work/fail/cells/$second/level1.ckpt"
cut -f1 "$work/list" | xargs -P 3 -I{} "$bin" train "$work/scene" $short -o "$work/fail" --resume --threads 1 --cell {} >"$work/log" 2>&1
check 'the rest later, by a list for parallel or xargs' [ $? = 0 ]
check 'is the same' same_levels "$work/serial" "$work/fail"

# A result that lost bytes is not complete.
: >"$work/fail/cells/$second/level2.ckpt"
check 'a damaged result is trained again' train -o "$work/fail" --jobs 2 --resume
check 'and is the same again' same_levels "$work/serial" "$work/fail"

# A stop reaches every child; nothing is lost and nothing is left running.
"$bin" train "$work/scene" --level-count 1 --iterations 900000 --no-coarse-start -o "$work/stop" --jobs 2 --threads 2 --budget 1500 \
    >"$work/log" 2>&1 &
parent=$!
for _ in $(seq 300); do
    [ "$(grep -l '"event":"step"' "$work"/stop/cells/*/metrics.jsonl 2>/dev/null | wc -l)" = 2 ] && break
    sleep 0.1
done
kill -TERM $parent # a background job of a script ignores SIGINT
wait $parent
check 'a stop ends it' said 'error: stopped: 0 of 5 cells are complete; .*--resume'
check 'with states saved' [ "$(ls "$work"/stop/cells/*/resume.ckpt | wc -l)" = 2 ]
check 'and no process left' sh -c "! ps ax -o args | grep -v grep | grep -q '$work/stop'"

# A scene without a plan whose forecast exceeds --memory is cut into cells, and its commands go on with them.
"$bin" synth -o "$work/wide" --photos 160 --width-px 160 --height-px 120 --extent-m 200 --points 4000 >"$work/log" 2>&1 &&
    "$bin" ingest "$work/wide/images" "$work/wide/sparse" -o "$work/large" >>"$work/log" 2>&1 ||
    { cat "$work/log"; exit 1; }
auto() { "$bin" train "$work/large" --iterations 40 --coarse-iterations-min 20 --device cpu "$@" >"$work/log" 2>&1; }
whole=$("$bin" train "$work/large" --list 2>"$work/log" | cut -f5)
auto --memory half
check 'memory is a size' said "--memory half"
auto --memory 1M --stop-after 1 &
search=$! named=
while kill -0 $search 2>/dev/null; do
    [ ! -e "$work/large/plan.json" ] || named=1
    sleep 0.02
done
wait $search
check 'no plan has its name before it is known to fit' [ -z "$named" ]
check 'nor is any left' sh -c "! ls '$work/large' | grep -q part-"
check 'with no cut that fits it stays whole and says so' said "no cut into cells fits: it is trained in one piece"
check 'without a plan' [ ! -e "$work/large/plan.json" ]
auto --memory $((whole * 8 / 10))M --resume --stop-after 1
check 'what has begun in one piece goes on so and says that' said "has begun so and goes on so"
rm -r "$work/large/cells"
check 'a model that fits is one piece' auto --memory $((whole + 1))M -o "$work/fits"
check 'in one cell' [ "$(ls "$work/fits/cells")" = all ]
check 'one that does not is cut' auto --memory $((whole * 8 / 10))M
check 'with the forecast, the limit and the number of cells' said "in one piece is [0-9.]+ GB, --memory is [0-9.]+ GB: it is cut into [0-9]+ cells of [0-9]+ m"
cut -f1,5 >"$work/cells" <<LIST
$("$bin" train "$work/large" --list 2>>"$work/log")
LIST
check 'every cell has its result' sh -c "[ \"\$(wc -l <'$work/cells')\" -gt 1 ] && cut -f1 '$work/cells' | while read -r c; do [ -e '$work/large/cells/'\$c/done.json ] || exit 1; done"
check 'and fits' [ "$(awk -v most=$((whole * 8 / 10)) '$2 > most' "$work/cells" | wc -l)" = 0 ]
by_hand=$(sed -n 's/.*as by `citysplat plan .* \(--edge-m [0-9]*\)`.*/\1/p' "$work/log")
cp "$work/large/plan.json" "$work/plan.json"
check 'the plan is the one that was named' sh -c "'$bin' plan '$work/large' $by_hand >/dev/null && cmp '$work/large/plan.json' '$work/plan.json'"
check 'tiles are cut of its cells' "$bin" tile "$work/large" --name large -o "$work/large.tiles" -q

# The jobs of configs/slurm on a make-believe Slurm that runs them at once; tests/machines/slurm.sh has a real one.
mkdir "$work/path"
ln -s "$bin" "$work/path/citysplat"
cat >"$work/path/sbatch" <<'SBATCH'
#!/bin/sh
dep= mem=
while :; do
    case $1 in
        --dependency=afterok:7*) dep=ok ;;
        --cpus-per-task=*) cores=${1#*=} ;;
        --mem=*M) mem=${1#*=} ;;
        --*) ;;
        *) break ;;
    esac
    shift
done
case $1 in *coarse.sbatch) ;; *) [ "$dep" ] || exit 1 ;; esac
SLURM_CPUS_PER_TASK=$cores SLURM_MEM_PER_NODE=${mem%M} sh "$@" >&2 || exit 1
echo '7;cluster'
SBATCH
chmod +x "$work/path/sbatch"
PATH="$work/path:$PATH" "$top/configs/slurm/submit.sh" --cores 1 "$work/scene" "$work/out.tiles" $short >"$work/log" 2>&1
check 'a job for each cell and a merge' [ $? = 0 ]
check 'the same bytes as one process' same_levels "$work/serial" "$work/scene"
check 'tiles were cut' "$bin" verify "$work/out.tiles"
flock "$work/fail/cells/$second/lock" "$bin" train "$work/scene" $short -o "$work/fail" --cell "$second" >"$work/log" 2>&1
check 'two processes keep out of one cell' said "cells/$second: another process trains this cell"
[ $failed = 0 ] || { echo "$failed checks failed"; exit 1; }
