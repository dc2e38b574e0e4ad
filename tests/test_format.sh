#!/bin/sh
# The house format (.clang-format) on every C, C++ and OpenCL file. Skipped (77) where clang-format is missing or
# is not version 14, whose opinion counts.
#
# SPDX-License-Identifier: Apache-2.0
cd "$(dirname "$0")/.." || exit 1
tool=$(command -v clang-format-14 || command -v clang-format) || { echo "skipped: no clang-format"; exit 77; }
"$tool" --version | grep -q 'version 14' || { echo "skipped: $("$tool" --version)"; exit 77; }
# shellcheck disable=SC2046
"$tool" --dry-run --Werror $(find core render codec lod synth ingest cells loss train server cli bench tests -name node_modules -prune -o \
    \( -name '*.[ch]' -o -name '*.cc' -o -name '*.cl' \) -print | sort) && echo "formatted"
