#!/usr/bin/env bash
# From nothing to a city on a Debian of its own: debootstrap, a clone of HEAD, ./bootstrap demo, the answers of its server, ./bootstrap
# test. The last lines are the seconds of each stage, the revision of the demo's store, and what ctest said.
#   tests/machines/debian.sh SUITE [BASE]       SUITE: bookworm, trixie, sid; BASE: a debootstrap of before
# DEBIAN_TESTS: options of ctest; by default the long tests and those of texts are left out. none: no tests.
# Exits with 77 where it cannot run.
#
# SPDX-License-Identifier: Apache-2.0
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
# shellcheck source=tests/machines/chroot.sh
. tests/machines/chroot.sh
suite=${1:?bookworm, trixie or sid}
[ "$(id -u)" = 0 ] || { echo 'not run: not root'; exit 77; }
for tool in debootstrap curl git; do command -v $tool >/dev/null || { echo "not run: no $tool (apt-get install $tool)"; exit 77; }; done
work=$(mktemp -d "${TMPDIR:-/var/tmp}/citysplat-$suite-XXXXXX") pid=
clean() {
    [ -z "$pid" ] || kill -KILL "$pid" 2>/dev/null || true # and with it what runs inside
    rm -rf --one-file-system "$work"
}
trap clean EXIT
fail() { echo "FAILED: $*" >&2; exit 1; }

chroot_make "$suite" "$work/root" "${2:-}" || fail "debootstrap $suite"
git clone -q . "$work/src"
export CHROOT_BIND=$work/src:/src
[ ! -d ../shared ] || CHROOT_BIND+=,$(realpath ../shared):/shared
inside() { chroot_inside "$work/root" sh -euc "cd /src && $*"; }
echo "== Debian $(cat "$work/root/etc/debian_version"), from nothing"
inside './bootstrap demo --no-serve' 2>&1 | tee "$work/demo.log" | grep -E '^.\[1m==|error|Error|level=3 done' || { tail -40 "$work/demo.log"; fail 'demo'; }
[ "${PIPESTATUS[0]}" = 0 ] || { tail -40 "$work/demo.log"; fail 'demo'; }
inside 'dpkg-query -W -f="\${Package} \${Version}\n" pocl-opencl-icd libmicrohttpd-dev libdraco-dev libopenimageio-dev libgdal-dev nodejs gcc cmake'
inside 'build/release/citysplat info --device auto'

# ---- what it serves

port=$((20000 + RANDOM % 12000))
inside "exec build/release/citysplat serve out/demo/demo.tiles --port $port" >"$work/served" 2>&1 &
pid=$!
n=0
until curl -fsS -o /dev/null "http://127.0.0.1:$port/readyz" 2>/dev/null; do
    n=$((n + 1))
    { [ $n -lt 300 ] && kill -0 $pid; } || { cat "$work/served"; fail 'it does not serve'; }
    sleep 0.2
done
at=http://127.0.0.1:$port
tile=$(curl -fsS "$at/d/demo/tileset.json" | tr ',' '\n' | sed -n 's/.*"uri": *"\([^"]*\)\.glb[^"]*".*/\1/p' | grep -v lowpass | head -1)
case $tile in /*) ;; *) tile=/d/demo/$tile ;; esac
asked=0
key=${tile#*/t/} # z/x/y, of maps as well
view=/d/demo/static/7.5733,47.5570,430@0,-50/320x240
for path in /healthz /version /collections /collections/demo /collections/demo/tiles.json /conformance /api /api.html \
    /d/demo/tileset.json "$tile.glb" "$tile.spz" "$tile.drc" "$tile.ply" "$view.jpg" "$view.png" "$view.webp" "/d/demo/map/$key.jpg" \
    "/d/demo/terrain/$key.png" /d/demo/style.json /d/demo/wmts.xml '/d/demo/height?lon=7.5733&lat=47.5584' / /viewer.js; do
    got=$(curl -sSL -H 'Accept: text/html,*/*' -o "$work/answer" -w '%{http_code} %{content_type} %{size_download}' "$at$path")
    echo "$path: $got"
    case $got in 200\ *) ;; *) fail "$path: $got: $(head -c 300 "$work/answer")" ;; esac
    asked=$((asked + 1))
done
kill "$pid" 2>/dev/null || true
wait "$pid" 2>/dev/null || true
pid=
echo "$asked addresses answered 200"

# ---- tests

[ "${DEBIAN_TESTS:-}" = none ] || inside "./bootstrap test ${DEBIAN_TESTS:--LE 'long|texts'}" >"$work/test.log" 2>&1 ||
    { tail -40 "$work/test.log"; fail 'tests'; }
sed -n '/tests passed, /,$p' "$work/test.log" 2>/dev/null || true
grep -h 'seconds:' "$work/demo.log"
mkdir -p build/ci
inside 'build/release/citysplat info out/demo/demo.tiles' | sed -n 's/^revision *//p' | tee "build/ci/revision.$suite"
for other in build/ci/revision.*; do # of the same commit, where it ran on both
    [ "$(cat "$other")" = "$(cat "build/ci/revision.$suite")" ] || echo "another revision on ${other##*.}: $(cat "$other")"
done
