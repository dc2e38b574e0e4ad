#!/bin/sh
# The house format (.clang-format) on every C, C++ and OpenCL file, and no line of more than 100 columns. Skipped (77)
# where clang-format is missing or is not version 14, whose opinion counts.
#
# SPDX-License-Identifier: Apache-2.0
cd "$(dirname "$0")/.." || exit 1
tool=$(command -v clang-format-14 || command -v clang-format) || { echo "skipped: no clang-format"; exit 77; }
"$tool" --version | grep -q 'version 14' || { echo "skipped: $("$tool" --version)"; exit 77; }
files=$(find core render codec lod survey scene train server cli lab tests -name node_modules -prune -o \
    \( -name '*.[ch]' -o -name '*.cc' -o -name '*.cl' \) -print | sort)
# Comments are wrapped by hand (ReflowComments is off, for tables and drawings).
# shellcheck disable=SC2086
long=$(awk 'length > 100 { print FILENAME ":" FNR ": longer than 100 columns" }' $files)
[ -z "$long" ] || { echo "$long"; exit 1; }
# shellcheck disable=SC2086
"$tool" --dry-run --Werror $files && echo "formatted"
