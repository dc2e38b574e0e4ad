#!/bin/sh
# Writes what the program prints about itself into a folder: man1/*.1, and the completions citysplat (bash),
# _citysplat (zsh) and citysplat.fish. The build calls it; cmake --install installs the files.
#   cli/reference.sh PROGRAM FOLDER
#
# SPDX-License-Identifier: Apache-2.0
set -e
bin=$1 to=$2
commands=$(sed -n -e 's/^COMMAND(\([a-z]*\),.*/\1/p' -e 's/^COMMAND_AS([a-z_]*, "\([a-z-]*\)",.*/\1/p' "$(dirname "$0")/base/commands.def")
[ -n "$commands" ]
rm -rf "$to/man1" "$to/done"
mkdir -p "$to/man1"
"$bin" help --man >"$to/man1/citysplat.1"
for c in $commands; do "$bin" help --man "$c" >"$to/man1/citysplat-$c.1"; done
"$bin" completion bash >"$to/citysplat"
"$bin" completion zsh >"$to/_citysplat"
"$bin" completion fish >"$to/citysplat.fish"
touch "$to/done"
