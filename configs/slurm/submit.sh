#!/bin/sh
# Train all cells of a planned scene as a job array and cut the tiles when every one of them is complete.
#   configs/slurm/submit.sh SCENE OUT.tiles [options of citysplat train]
# Again with the same arguments after a failure: complete cells take seconds, the others go on.
#
# SPDX-License-Identifier: Apache-2.0
scene=${1:?usage: submit.sh SCENE OUT.tiles [options]}
out=${2:?usage: submit.sh SCENE OUT.tiles [options]}
shift 2
here=$(dirname "$0")
list=$(citysplat train "$scene" --list "$@") || exit 1
n=$(printf '%s\n' "$list" | wc -l)
# Some sites append ";cluster" to the number.
coarse=$(sbatch --parsable "$here/coarse.sbatch" "$scene" "$@") || exit 1
array=$(sbatch --parsable --dependency="afterok:${coarse%%;*}" --array="0-$((n - 1))" "$here/train.sbatch" "$scene" "$@") || exit 1
merge=$(sbatch --parsable --dependency="afterok:${array%%;*}" "$here/tile.sbatch" "$scene" "$out") || exit 1
echo "coarse model: job $coarse; $n cells: job $array; tiles: job $merge"
