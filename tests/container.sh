#!/usr/bin/env bash
# configs/Containerfile: built whole by buildah, and the image used as its first lines say, read-only and as nobody: from a
# procedural city to a served tile and picture.
#   tests/container.sh [BASE]     BASE: a folder with a Debian 13 (debootstrap); it is not changed
# Where the registry of debian:13-slim cannot be reached, the base image is made by debootstrap from Debian's packages.
# Exits with 77 where it cannot run.
#
# SPDX-License-Identifier: Apache-2.0
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
base=${1:-} name=docker.io/library/debian:13-slim pid=
skip() { echo "not built: $*"; exit 77; }
fail() { echo "FAILED: $*" >&2; exit 1; }
[ "$(id -u)" = 0 ] || skip 'not root, which buildah needs for a build without namespaces of users'
command -v buildah >/dev/null || skip 'no buildah (apt-get install buildah)'
for tool in curl python3; do command -v $tool >/dev/null || skip "no $tool (apt-get install $tool)"; done
work=$(mktemp -d "${TMPDIR:-/var/tmp}/citysplat-container-XXXXXX")
clean() {
    [ -z "$pid" ] || kill -KILL "$pid" 2>/dev/null || true # and with it what runs inside
    [ ! -e "$work/storage" ] || b umount --all >/dev/null 2>&1 || true
    umount "$work/storage/overlay" 2>/dev/null || true
    rm -rf --one-file-system "$work"
}
trap clean EXIT

driver=vfs # copies every layer, but needs nothing of the kernel
mkdir -p "$work"/try/{low,up,work,all}
unshare --mount mount -t overlay none -o "lowerdir=$work/try/low,upperdir=$work/try/up,workdir=$work/try/work" "$work/try/all" 2>/dev/null && driver=overlay
b() { buildah --root "$work/storage" --runroot "$work/run" --storage-driver "$driver" "$@"; }

# ---- the base image

if [ -z "$base" ] && timeout 120 buildah --root "$work/storage" --runroot "$work/run" --storage-driver "$driver" pull -q $name >"$work/log" 2>&1; then
    echo "base: $name of its registry"
else
    if [ -z "$base" ]; then
        command -v debootstrap >/dev/null || skip "$name cannot be pulled, and there is no debootstrap: $(tail -1 "$work/log")"
        base=$work/base
        mirror=$(sed -n 's/^URIs: *\(\S*\)$/\1/p; s/^deb \(\[.*\] \)\?\(\S*\) .*/\2/p' /etc/apt/sources.list /etc/apt/sources.list.d/debian* 2>/dev/null | head -1 || true)
        debootstrap --variant=minbase trixie "$base" "${mirror:-http://deb.debian.org/debian}" >"$work/log" 2>&1 ||
            { tail -20 "$work/log"; skip 'the registry of debian:13-slim cannot be reached, and debootstrap failed'; }
    fi
    c=$(b from scratch)
    b add -q "$c" "$base" / >/dev/null
    # Certificates that this machine trusts beside Debian's: npm's registry may be behind a proxy of its own.
    ! ls /usr/local/share/ca-certificates/*.crt >/dev/null 2>&1 || b add -q "$c" /usr/local/share/ca-certificates /usr/local/share/ca-certificates >/dev/null
    b commit -q "$c" $name >/dev/null
    b rm "$c" >/dev/null
    echo "base: Debian $(cat "$base/etc/debian_version") by debootstrap, in place of $name"
fi

# ---- build

SECONDS=0
b bud --isolation chroot --format docker --pull-never --layers=false -f configs/Containerfile -t citysplat . >"$work/log" 2>&1 </dev/null ||
    { tail -40 "$work/log"; fail 'buildah bud'; }
! grep -i 'warn' "$work/log" || true
b inspect --type image citysplat >"$work/image.json"
config() { # KEY: each line a value
    python3 -c '
import json, sys
value = json.load(open(sys.argv[1]))["Docker"]["config"]
for key in sys.argv[2].split("."): value = value[key]
print("\n".join(value if isinstance(value, list) else [value]))' "$work/image.json" "$1"
}
bytes=$(b images --json citysplat | sed -n 's/.*"size": "\(.*\)".*/\1/p')
echo "built in $SECONDS s: $bytes; driver $driver"
[ "$(config User)" = nobody ] || fail "it runs as $(config User)"
mapfile -t entry < <(config Entrypoint)
mapfile -t env < <(config Env)

# ---- use

root=$(b mount "$(b from --pull-never citysplat)")
[ -z "$(find "$root" -xdev \( -name cc1 -o -name node_modules -o -path '*/src/CMakeLists.txt' \) -print -quit)" ] || fail 'the image holds what it was built with'
mkdir -m 777 "$work/stores"
# As podman run --read-only --tmpfs /tmp --tmpfs /var/cache/citysplat -v STORES:/stores[:ro], on the network of this machine.
inside() { # ro|rw COMMAND...
    # shellcheck disable=SC2016
    unshare --mount --pid --fork --kill-child sh -c '
        root=$1 stores=$2 how=$3
        shift 3
        mount --bind "$root" "$root" && mkdir -p "$root/stores" && mount --bind "$stores" "$root/stores" && mount -o "remount,bind,$how" "$root/stores" &&
            mount -t tmpfs -o mode=1777 none "$root/tmp" && mount -t tmpfs -o mode=1777 none "$root/var/cache/citysplat" &&
            mount -t proc none "$root/proc" && mount --rbind /sys "$root/sys" && mount --rbind /dev "$root/dev" && mount -o remount,bind,ro "$root" &&
            cd / && exec chroot --userspec=nobody:nogroup "$root" env -i "$@"' sh "$root" "$work/stores" "$1" "${env[@]}" "${@:2}"
}
inside rw sh -euc '
    ! touch /usr/local/bin/x 2>/dev/null
    cd /tmp
    citysplat synth -o city --photos 24 --width-px 160 --height-px 120 --extent-m 100 -q
    citysplat ingest city/images city -o scene -q
    citysplat train scene --iterations 20,20,20 -q
    citysplat tile scene -o /stores/city.tiles -q
    citysplat ortho /stores/city.tiles -o ortho.tif -q # the plug-in with GDAL
    [ -s ortho.tif ]' || fail 'the program of the image'
port=$((20000 + RANDOM % 12000))
inside ro "${entry[@]}" --port $port >"$work/served" 2>&1 &
pid=$!
n=0
until curl -fsS -o /dev/null "http://127.0.0.1:$port/readyz" 2>/dev/null; do
    n=$((n + 1))
    { [ $n -lt 600 ] && kill -0 $pid; } || { cat "$work/served"; fail 'it does not serve'; }
    sleep 0.2
done
mapfile -t health < <(config Healthcheck.Test | tail -n +2 | sed "s/8080/$port/") # behind its first word, CMD
inside ro "${health[@]}" || fail "the health check: ${health[*]}"
curl -fsS "http://127.0.0.1:$port/d/city/tileset.json" >"$work/tileset.json"
tile=$(tr ',' '\n' <"$work/tileset.json" | sed -n 's/.*"uri": *"\([^"]*\.glb[^"]*\)".*/\1/p' | head -1)
case $tile in /*) ;; *) tile=/d/city/$tile ;; esac
curl -fsS "http://127.0.0.1:$port$tile" >"$work/tile.glb"
[ "$(head -c 4 "$work/tile.glb")" = glTF ] || fail "no tile at $tile"
curl -fsS -H 'Accept: text/html' -o "$work/page.html" "http://127.0.0.1:$port/"
grep -q '<html' "$work/page.html" || fail 'no viewer'
curl -fsSL -o "$work/view.jpg" "http://127.0.0.1:$port/d/city/static/7.5733,47.5570,430@0,-50/64x48.jpg"
outer=$(cat "/proc/$pid/task/$pid/children") && outer=${outer// /}       # unshare, which ignores SIGTERM
inner=$(cat "/proc/$outer/task/$outer/children") && kill -TERM "${inner// /}" # tini, as podman stop
wait $pid || fail "stopped, it exits with $?"
pid=
echo "used, read-only and as nobody: a tile of $(wc -c <"$work/tile.glb") bytes, a view of $(wc -c <"$work/view.jpg") bytes"
