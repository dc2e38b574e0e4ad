#!/usr/bin/env bash
# QGIS, without a screen, opens an orthophoto, a surface model, and a server's map as XYZ tiles and as WMTS: what it
# draws lies where it is. Skipped without QGIS (Debian: python3-qgis, 600 MB).
#
#   QGIS_SHOTS=FOLDER   keeps the pictures
#
# SPDX-License-Identifier: Apache-2.0
set -u
bin=${CITYSPLAT_BIN:?run this test through ctest}
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-qgis-XXXXXX") || exit 1
server=
trap '[ -z "$server" ] || kill "$server"; wait; rm -rf "$work"' EXIT
export QT_QPA_PLATFORM=offscreen HOME=$work XDG_RUNTIME_DIR=$work no_proxy=127.0.0.1
skip() { echo "skipped: $*"; exit 77; }

/usr/bin/python3 -c 'import qgis.core' 2>/dev/null || skip "no QGIS for Python: Debian's package python3-qgis has it"
command -v node >/dev/null || skip "no Node.js: it makes the test city"
node "$here/city.mjs" "$work" || exit 1
"$bin" ortho -q "$work/city.tiles" -o "$work/ortho.tif" --gsd-m 0.25 || exit 1
"$bin" dsm -q "$work/city.tiles" -o "$work/dsm.tif" --gsd-m 0.25 || exit 1
# The city is private: QGIS has one signed address, and sends nothing else.
echo '{"keys": {"k": "a key of this test alone, 32 characters"}}' >"$work/auth.jsonc"
chmod 600 "$work/auth.jsonc"
"$bin" serve "$work/city.tiles" --auth "$work/auth.jsonc" --port 0 --no-access-log >"$work/out" 2>"$work/log" &
server=$!
for _ in $(seq 200); do
    url=$(sed -n 's|.*\(http://[^/]*\)/.*|\1|p' "$work/out")
    [ -z "$url" ] || break
    sleep 0.1
done
[ -n "$url" ] || { cat "$work/log"; exit 1; }
url=$("$bin" sign fcity --auth "$work/auth.jsonc" --url "$url") || exit 1
timeout 200 /usr/bin/python3 "$here/show.py" "$work/places.json" "$work" "${url}d/fcity"
rc=$?
[ -z "${QGIS_SHOTS:-}" ] || cp "$work"/qgis-*.png "$QGIS_SHOTS"
exit $rc
