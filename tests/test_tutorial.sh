#!/usr/bin/env bash
# docs/tutorial.md, word by word: the commands of its blocks are run in their order, in one shell, and what they make has
# the sizes of its tables within a factor. COLMAP is a stand-in (tests/cli/fake_colmap.c) unless TUTORIAL_COLMAP=real. The
# port is another one, because 8080 may be taken.
#
# SPDX-License-Identifier: Apache-2.0
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.." || exit 1
page=$PWD/docs/tutorial.md factor=1.5
work=$(mktemp -d)
server=
trap '[ -z "$server" ] || kill "$server" 2>/dev/null; rm -rf "$work"' EXIT
mkdir "$work/bin" "$work/try"
ln -s "${CITYSPLAT_BIN:?the program under test}" "$work/bin/citysplat"
if [ "${TUTORIAL_COLMAP:-}" != real ]; then
    ln -s "${FAKE_COLMAP:?the stand-in for COLMAP}" "$work/bin/colmap"
    export FAKE_TRUTH=$work/try/example/sparse/0
fi
port=$((20000 + RANDOM % 12000))
{
    echo "set -eum; cd '$work/try'; trap 'kill \$(jobs -p) 2>/dev/null || true' EXIT; set -x"
    awk '/^```sh$/ { on = 1; next } /^```$/ { on = 0 } on' "$page" | sed -E "s/127\.0\.0\.1:8080/127.0.0.1:$port/g; s/^(citysplat serve [^&]*)&/\1--port $port \&/"
} >"$work/commands"
[ "$(grep -c '^citysplat ' "$work/commands")" -ge 10 ] || { echo "few commands were found in $page"; exit 1; }
PATH=$work/bin:$PATH bash "$work/commands" >"$work/log" 2>&1 </dev/null || { tail -40 "$work/log"; exit 1; }

bad=0
for file in map.html viewer.js view.jpg tileset.json report.html public/city/tileset.json; do
    [ -s "$work/try/$file" ] || { echo "FAILED: there is no $file"; bad=1; }
done
n=0
while IFS='|' read -r _ name size _; do
    name=$(tr -d '` ' <<<"$name")
    bytes=$(du -sb --apparent-size "$work/try/$name" | cut -f1)
    awk -v name="$name" -v have="$bytes" -v want="${size/MB/}" -v factor=$factor 'BEGIN {
        printf "%-12s %.2f MB, the page says %s MB\n", name, have / 1e6, want + 0
        exit !(have / 1e6 < factor * want && have / 1e6 > want / factor) }' || { echo "FAILED: $name"; bad=1; }
    n=$((n + 1))
done < <(grep -E '^\| `[^`]+` \| [0-9.]+ MB \|$' "$page")
[ $n -ge 4 ] || { echo "FAILED: $n sizes on the page"; bad=1; }
exit $bad
