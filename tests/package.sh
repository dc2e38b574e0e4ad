#!/usr/bin/env bash
# The Debian package on a system that has nothing of it: its contents and fields, then installed into a clean Debian
# (debootstrap) with what it depends on, and used there: from a procedural city to a served tile.
#   tests/package.sh PACKAGE.deb [CHROOT]     CHROOT: a debootstrap of before; it is not changed. By default one of this Debian is made
# Without root it is unpacked into a folder and run with the libraries of this system.
#
# SPDX-License-Identifier: Apache-2.0
set -euo pipefail
# shellcheck source=tests/machines/chroot.sh
. "$(dirname "${BASH_SOURCE[0]}")/machines/chroot.sh"
package=$(realpath "$1") base=${2:-}
version=$(dpkg-deb -f "$package" Version)
work=$(mktemp -d)
trap 'rm -rf --one-file-system "$work"' EXIT
fail() { echo "FAILED: $*" >&2; exit 1; }

# ---- contents

dpkg-deb -c "$package" | awk '{ print $6 }' >"$work/list"
for file in bin/citysplat lib/citysplat/citysplat-image.so lib/citysplat/citysplat-gdal.so lib/citysplat/citysplat-compiler share/man/man1/citysplat.1.gz \
    share/man/man1/citysplat-serve.1.gz share/bash-completion/completions/citysplat share/zsh/site-functions/_citysplat \
    share/fish/vendor_completions.d/citysplat.fish lib/systemd/system/citysplat.service lib/systemd/system/citysplat.socket \
    share/citysplat/web/index.html share/citysplat/web/viewer.js share/citysplat/web/LICENSES.txt share/doc/citysplat/copyright \
    share/doc/citysplat/CHANGELOG.md.gz share/doc/citysplat/sbom.spdx.json share/doc/citysplat/licences-npm.txt \
    share/doc/citysplat/examples/serve.jsonc share/doc/citysplat/examples/nginx.conf; do
    grep -qx "./usr/$file" "$work/list" || fail "no /usr/$file in the package"
done
! grep -vE '^\./(usr/.*|etc/(citysplat/(serve\.jsonc)?)?)?$' "$work/list" || fail 'files outside of /usr and /etc/citysplat'
[ "$(dpkg-deb -I "$package" conffiles)" = /etc/citysplat/serve.jsonc ] || fail 'serve.jsonc is no file of configuration'
dpkg-deb -c "$package" | awk '$2 != "root/root" || $1 ~ /^.{5}w|^.{8}w|[sS]/ && $1 !~ /^l/ { print; bad = 1 } END { exit bad }' || fail 'owners or permissions'
depends=$(dpkg-deb -f "$package" Depends)
for name in libc6 libsqlite3-0 libgdal libopenimageio libmicrohttpd12 ocl-icd-libopencl1; do # libgdal32 on Debian 12, 36 on 13
    case $depends in *"$name"*) ;; *) fail "it does not depend on $name: $depends" ;; esac
done
echo "contents: $(wc -l <"$work/list") entries, $(($(stat -c %s "$package") / 1024)) KiB"

# ---- use

cat >"$work/use.sh" <<'USE'
set -eu
version=$1 work=$(mktemp -d)
cd "$work"
export XDG_CACHE_HOME=$work/cache POCL_CACHE_DIR=$work/cache/pocl
[ "$(citysplat --version)" = "citysplat $version" ]
citysplat synth -o city --photos 24 --width-px 160 --height-px 120 --extent-m 100 -q
citysplat ingest city/images city -o scene -q
citysplat train scene --iterations 20,20,20 -q
citysplat tile scene -o city.tiles -q
citysplat ortho city.tiles -o ortho.tif -q # the plug-in with GDAL
[ -s ortho.tif ]
citysplat serve city.tiles --port 18080 --address 127.0.0.1 >log 2>&1 &
server=$!
trap "kill $server 2>/dev/null || true" EXIT
n=0
until curl -fsS -o /dev/null http://127.0.0.1:18080/readyz 2>/dev/null; do
    n=$((n + 1))
    [ $n -lt 300 ] && kill -0 $server || { cat log; exit 1; }
    sleep 0.2
done
curl -fsS http://127.0.0.1:18080/d/city/tileset.json >tileset.json
tile=$(tr ',' '\n' <tileset.json | sed -n 's/.*"uri": *"\([^"]*\.glb[^"]*\)".*/\1/p' | head -1)
case $tile in /*) ;; *) tile=/d/city/$tile ;; esac
curl -fsS "http://127.0.0.1:18080$tile" >tile.glb
[ "$(head -c 4 tile.glb)" = glTF ]
curl -fsS -H 'Accept: text/html' http://127.0.0.1:18080/ | grep -q '<html'
curl -fsSL -o view.jpg http://127.0.0.1:18080/d/city/static/7.5733,47.5570,430@0,-50/64x48.jpg
echo "used: a tile of $(wc -c <tile.glb) bytes, a view of $(wc -c <view.jpg) bytes"
kill $server
wait $server
cd /
rm -rf "$work"
USE

if [ "$(id -u)" != 0 ] || ! command -v debootstrap >/dev/null; then
    echo 'not root, or no debootstrap: unpacked, with the libraries of this system'
    dpkg-deb -x "$package" "$work/root"
    PATH=$work/root/usr/bin:$PATH sh "$work/use.sh" "$version"
    exit
fi
root=$work/root
chroot_make "$(. /etc/os-release && echo "$VERSION_CODENAME")" "$root" "$base" || fail debootstrap
cp "$package" "$root/tmp/citysplat.deb"
cp "$work/use.sh" "$root/tmp/use.sh"
inside() { chroot_inside "$root" "$@"; }
inside apt-get update -qq
inside apt-get install -y -qq --no-install-recommends /tmp/citysplat.deb pocl-opencl-icd curl >"$work/log" 2>&1 || { tail -30 "$work/log"; fail 'apt-get install'; }
inside sh /tmp/use.sh "$version"
inside sh -euc '
    echo "// changed" >>/etc/citysplat/serve.jsonc
    [ "$(stat -c %U:%G:%a /var/lib/citysplat /etc/citysplat/serve.jsonc | tr "\n" " ")" = "citysplat:citysplat:755 root:root:644 " ]
    dpkg -i /tmp/citysplat.deb >/dev/null
    grep -q changed /etc/citysplat/serve.jsonc' || fail 'user, folder, or a configuration that was changed'
inside apt-get purge -y -qq citysplat >"$work/log" 2>&1 || { tail -30 "$work/log"; fail 'apt-get purge'; }
left=$(inside find /usr /etc /lib/systemd /var/lib -name '*citysplat*' -not -path '/var/lib/dpkg/*' 2>/dev/null || true)
[ -z "$left" ] || fail "purged, and still there: $left"
echo "installed into a clean Debian $(cat "$root/etc/debian_version"), used, removed"
