#!/usr/bin/env bash
# docs/http.md, word by word: every curl of its blocks is run against a city at the demo's place, and a city under
# changing light. All succeed, documents are JSON that is not empty, and pictures show the city.
#
# SPDX-License-Identifier: Apache-2.0
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.." || exit 1
command -v node >/dev/null || { echo 'skipped: there is no node'; exit 77; }
page=$PWD/docs/http.md
work=$(mktemp -d)
server=
trap '[ -z "$server" ] || kill "$server" 2>/dev/null; rm -rf "$work"' EXIT
fail() { echo "FAILED: $*"; exit 1; }

run() { "$@" >"$work/log" 2>&1 || { tail -20 "$work/log"; fail "$*"; }; }
run "${CITYSPLAT_LAB:?the laboratory}" synth --extent-m 160 --photos 24 --width-px 160 --height-px 120 --points 1500 --sun-variation 0.8 -o "$work/photos"
run "${CITYSPLAT_BIN:?the program under test}" ingest "$work/photos/images" "$work/photos/sparse" --no-exposure -o "$work/scene"
run "$CITYSPLAT_BIN" train "$work/scene" --iterations 120 --level-count 2 --budget 2000,4000 --appearance --appearance-warmup 20
for name in demo light; do run "$CITYSPLAT_BIN" tile "$work/scene" --name "$name" -o "$work/$name.tiles"; done

mkdir "$work/state"
port=$((20000 + RANDOM % 12000)) admin=$((port + 1)) # below those that the kernel gives to others
"$CITYSPLAT_BIN" serve "$work/demo.tiles" "$work/light.tiles" --port "$port" --admin "127.0.0.1:$admin" --state-dir "$work/state" >"$work/served" 2>&1 &
server=$!
for _ in $(seq 100); do kill -0 "$server" 2>/dev/null || { cat "$work/served"; fail "serve"; }; curl -fsS "http://127.0.0.1:$port/readyz" >/dev/null 2>&1 && break; sleep 0.1; done

# One command a line: those of several lines are joined. What needs a place of its own is left out: a number that the
# page leaves to the reader (…), and a stream, which does not end.
awk '/^```sh$/ { on = 1; next } /^```$/ { on = 0 } on' "$page" | awk '
    /^curl / { if (line) print line; line = $0; next } /^[^ ]/ { if (line) print line; line = ""; next }
    { if (line) line = line " " $0 } END { if (line) print line }' | grep -v -e '…' -e '/motion/' |
    sed "s/127\.0\.0\.1:8080/127.0.0.1:$port/; s/127\.0\.0\.1:8078/127.0.0.1:$admin/" >"$work/commands"
cd "$work" || exit 1
n=0
while read -r line; do
    answer=$(eval "curl() { command curl -sS --fail-with-body \"\$@\"; }; $line" 2>&1 </dev/null) ||
        fail "$line: $answer"
    case $line in
    *' -o '*) file=${line##* -o } && [ "$(stat -c %s "${file%% *}")" -gt 2000 ] || fail "$line: the file is empty" ;;
    *DELETE* | *PUT*) ;;
    *) node -e 'const o = JSON.parse(process.argv[1]); if (!Object.keys(o).length) process.exit(1);' "$answer" || fail "$line: $answer" ;;
    esac
    n=$((n + 1))
done <commands
[ "$n" -ge 12 ] || fail "only $n commands were found in $page"
echo "$n commands of the page"
