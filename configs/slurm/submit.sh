#!/bin/sh
# Train all cells of a planned scene, a job each, and cut the tiles when every one of them is complete.
#   configs/slurm/submit.sh [--cores N] [--gres GRES] [--slack F] SCENE OUT.tiles [options of citysplat train]
# Again with the same arguments after a failure: complete cells take seconds, the others go on.
#
#   --cores N     cores of each job (16)
#   --gres GRES   what each training asks for beside them: gpu:1
#   --slack F     time that a training asks for, as a multiple of its forecast (3); where it was too little, the job saves
#                 its state and queues itself again
#
# Memory and time of each training come from `citysplat train --list`. Partition, account and the like: sbatch's own
# variables (SBATCH_PARTITION, SBATCH_ACCOUNT, ...).
#
# SPDX-License-Identifier: Apache-2.0
usage='usage: submit.sh [--cores N] [--gres GRES] [--slack F] SCENE OUT.tiles [options of citysplat train]'
cores=16 gres='' slack=3
while :; do
    case ${1:-} in
        --cores) cores=$2 ;;
        --gres) gres=$2 ;;
        --slack) slack=$2 ;;
        -*) echo "submit.sh: unknown option $1; $usage" >&2; exit 2 ;;
        *) break ;;
    esac
    shift 2 || { echo "$usage" >&2; exit 2; }
done
scene=${1:?$usage}
out=${2:?$usage}
shift 2
here=$(dirname "$0")
jobs='' # all that are queued
fail() { # what is queued without the rest would be half a city
    [ -z "$jobs" ] || scancel $jobs
    echo 'submit.sh: nothing is queued' >&2
    exit 1
}
# queue LINE DEPENDENCY SCRIPT ARGUMENTS...: a job as a line of the list needs it; its number in $job. A tenth more memory
# than the bound, and the forecast's processor seconds by the clock: 72 % of the cores are busy.
queue() {
    name=${1%%"$tab"*}
    mib=$(printf '%s\n' "$1" | awk -F'\t' '{ printf "%d", $5 * 1.1 + 256 }')
    minutes=$(printf '%s\n' "$1" | awk -F'\t' -v c="$cores" -v f="$slack" '{ printf "%d", f * $6 / (0.72 * c) / 60 + 10 }')
    after=$2
    shift 2
    job=$(sbatch --parsable --job-name="citysplat-$name" --cpus-per-task="$cores" --mem="${mib}M" --time="$minutes" \
        ${gres:+--gres="$gres"} ${after:+--dependency="afterok:$after" --kill-on-invalid-dep=yes} "$@") || fail
    job=${job%%;*} # some sites append ";cluster" to the number
    jobs="$jobs $job"
}
tab=$(printf '\t')
coarse=$(citysplat train "$scene" --list --coarse-only "$@") || exit 1
list=$(citysplat train "$scene" --list "$@") || exit 1
job=''
[ -z "$coarse" ] || queue "$coarse" '' "$here/coarse.sbatch" "$scene" "$@"
first=$job all='' n=0
while read -r line; do
    queue "$line" "$first" "$here/train.sbatch" "$scene" "${line%%"$tab"*}" "$@"
    all="$all:$job"
    n=$((n + 1))
done <<END
$list
END
tiles=$(sbatch --parsable --cpus-per-task="$cores" --dependency="afterok$all" --kill-on-invalid-dep=yes "$here/tile.sbatch" "$scene" "$out") || fail
echo "coarse model: job ${first:-not needed}; $n cells: jobs ${all#:}; tiles: job ${tiles%%;*}"
