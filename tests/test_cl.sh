#!/bin/sh
# Every kernel file compiles, by itself behind its prelude, with an OpenCL compiler that is not the one of the
# device at hand: clang, for a CPU-like, an AMD and an NVIDIA target. Skipped (77) where clang is missing.
#
# SPDX-License-Identifier: Apache-2.0
cd "$(dirname "$0")/.." || exit 1
clang=$(command -v clang || command -v clang-14) || { echo "skipped: clang is not installed"; exit 77; }
status=0
compile() { # options, besides those of $f, $target and $vw
    # vload_half needs no extension, but clang's header has it for NVIDIA only with that of half arithmetic.
    # shellcheck disable=SC2086
    "$clang" -x cl -cl-std=CL1.2 -Xclang -finclude-default-header -Xclang -cl-ext=+cl_khr_fp16 -target "$target" -nogpulib -DVW="$vw" \
        -I. $1 -fsyntax-only -Wall -Wno-unused-function -Werror "$f" || {
        echo "$f: does not compile for $target with VW=$vw and $1"; status=1; }
}
for f in $(find core render train scene lab -name '*.cl' | sort); do
    for target in spir64 nvptx64 amdgcn--amdhsa; do
        case $f in
            *_gpu.cl) widths=1 ;; # one shape only: a work-group a tile, scalar lanes
            *_cpu.cl) widths=16 ;;
            *) widths="16 1" ;;
        esac
        for vw in $widths; do
            prelude="-include core/layout.h"
            case $f in
                render/common.cl | train/loss/lanes.cl | train/loss/solid.cl) prelude="$prelude -include core/device/vector.cl" ;;
                render/*) prelude="$prelude -include core/device/vector.cl -include render/common.cl" ;;
                train/loss/axes.cl)
                    prelude="$prelude -include core/device/vector.cl -include train/loss/lanes.cl" ;;
                train/loss/scale_loss.cl | train/loss/flat_loss.cl)
                    prelude="$prelude -include core/device/vector.cl -include train/loss/lanes.cl -include train/loss/axes.cl" ;;
                scene/stereo/sweep.cl)
                    prelude="-DPLANES=192 -DRADIUS=3 -DSLAB=16 -DCOST_MOST=200.0f -DSTEP_COST=4 -DNOISE=1e-3f \
                        -DLIKE=0.1f -DTILE_W=64 -DTILE_H=32 -DWALL_MORE=12 -DWALL_COST=4 -DWALL_EVERY=2.0f -DDOWN=0.05f $prelude -include core/device/vector.cl" ;;
            esac
            case $f:$vw in # compiled after others, see their heads
                render/blend_cpu.cl:1) continue ;; # the CPU shape alone
                render/appearance*.cl:*) prelude="-DAPPEARANCE_LEN=16 -DAPPEARANCE_HIDDEN=32 $prelude" ;;
                render/blend_backward.cl:16) prelude="$prelude -include render/blend_cpu.cl" ;;
                render/importance.cl:16) prelude="$prelude -include render/blend_cpu.cl -include render/blend_backward.cl" ;;
            esac
            case $f in
                render/appearance_backward.cl)
                    prelude="$prelude -include render/appearance.cl -include render/adam.cl \
                        -include render/project_backward.cl" ;;
                train/loss/embed_smoothness.cl)
                    prelude="$prelude -include core/device/vector.cl -include render/adam.cl" ;;
                render/project_backward.cl | render/defer.cl) prelude="$prelude -include render/adam.cl" ;;
            esac
            compile "$prelude"
            case $f in # with appearance they are others
                render/project.cl | render/project_backward.cl)
                    for lengths in "16 32" "17 63"; do
                        compile "-DAPPEARANCE_LEN=${lengths% *} -DAPPEARANCE_HIDDEN=${lengths#* } $prelude \
                            -include render/appearance.cl"
                    done ;;
            esac
        done
    done
done
[ $status = 0 ] && echo "all kernels compile for three targets"
exit $status
