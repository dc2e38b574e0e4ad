#!/bin/sh
# What the Debian package would hold, installed into a folder: program, plug-ins, pages, completions, units, viewer, examples,
# licences. The SBOM and docs/licences.md name every library that is linked and every npm package of the viewer. One
# version everywhere. .ci/nightly makes the package itself and installs it. Needs CITYSPLAT_BIN.
#
# SPDX-License-Identifier: Apache-2.0
cd "$(dirname "$0")/.." || exit 1
bin=${CITYSPLAT_BIN:?} build=$(dirname "$CITYSPLAT_BIN")
for tool in node dpkg-query readelf ldd; do command -v $tool >/dev/null || { echo "skipped: no $tool"; exit 77; }; done
grep -qs 'set(CPACK_GENERATOR "DEB")' "$build/CPackConfig.cmake" || { echo "skipped: $build makes no package"; exit 77; }
work=$(mktemp -d) && trap 'rm -rf "$work"' EXIT
fail() { echo "FAILED: $*"; failed=1; }
failed=0

version=$("$bin" --version | sed 's/^citysplat //')
for file in web/package.json web/package-lock.json; do
    grep -m1 '"version"' "$file" | grep -qF "\"$version\"" || fail "$file has another version than the program: $version"
done
grep -qE "^## $version \([0-9]{4}-[0-9]{2}-[0-9]{2}\)\$" CHANGELOG.md || fail "CHANGELOG.md has no section of $version"

# ---- licences

programs="$bin $build/citysplat-gdal.so $build/citysplat-image.so"
# The page has the names of Debian 12.
page='--check docs/licences.md'
grep -qs 'VERSION_ID="12"' /etc/os-release || page=
# shellcheck disable=SC2086
node configs/deb/sbom.mjs $page --sbom "$work/sbom.json" --version "$version" $programs || exit 1
# shellcheck disable=SC2086
readelf -d $programs | sed -n 's/.*(NEEDED).*\[\(.*\)\]/\1/p' | grep -v '^ld-linux' | sort -u >"$work/needed"
# shellcheck disable=SC2086
ldd $programs | awk '$3 ~ /^\// { print $1 }' | sort -u >"$work/loaded"
node -e '
const sbom = JSON.parse(require("fs").readFileSync(process.argv[1]));
const lines = (file) => require("fs").readFileSync(file, "utf8").trim().split("\n");
const [needed, loaded, page] = [lines(process.argv[2]), lines(process.argv[3]), lines("docs/licences.md").join("\n")];
if (needed.length < 15 || loaded.length < 100) throw new Error(`readelf and ldd name ${needed.length} and ${loaded.length} libraries`);
const named = new Set(sbom.packages.flatMap((one) => (/libraries (.*)/.exec(one.sourceInfo ?? "")?.[1] ?? "").split(", ")));
for (const name of [...needed, ...loaded]) if (!named.has(name)) throw new Error(`the SBOM does not name ${name}`);
for (const name of needed) if (!page.includes(name.replace(/\.so.*/, ""))) throw new Error(`docs/licences.md does not name ${name}`);
const ids = new Set(sbom.packages.map((one) => one.SPDXID));
if (ids.size !== sbom.packages.length) throw new Error("two packages have one SPDXID");
for (const { spdxElementId: a, relatedSpdxElement: b } of sbom.relationships)
  for (const id of [a, b]) if (id !== "SPDXRef-DOCUMENT" && !ids.has(id)) throw new Error(`${id} is related and not there`);
for (const one of sbom.packages)
  for (const key of ["name", "versionInfo", "licenseDeclared", "downloadLocation"]) if (!one[key]) throw new Error(`${one.name}: no ${key}`);
const direct = sbom.relationships.filter((one) => one.relationshipType === "DYNAMIC_LINK").map((one) => one.relatedSpdxElement);
for (const one of sbom.packages) if (direct.includes(one.SPDXID) && one.licenseDeclared === "NOASSERTION") throw new Error(`${one.name}: no licence`);
const npm = new Set(sbom.packages.map((one) => one.name));
for (const name of ["three", "maplibre-gl", "meshoptimizer"]) if (!npm.has(name)) throw new Error(`no ${name}`);
if (!/Draco/.test(sbom.packages.find((one) => one.name === "three").licenseComments)) throw new Error("Draco is not named");
console.log(`${sbom.packages.length} packages, ${direct.length} linked`);' "$work/sbom.json" "$work/needed" "$work/loaded" || fail "the SBOM is not whole"

# ---- files

if [ -d web/node_modules ]; then
    DESTDIR=$work/root cmake --install "$build" --prefix /usr --component package >"$work/log" 2>&1 || { cat "$work/log"; exit 1; }
    for file in lib/systemd/system/citysplat.service lib/systemd/system/citysplat.socket share/doc/citysplat/copyright \
        share/doc/citysplat/sbom.spdx.json share/doc/citysplat/licences-npm.txt share/doc/citysplat/licences.md \
        share/doc/citysplat/CHANGELOG.md.gz share/doc/citysplat/examples/nginx.conf share/doc/citysplat/examples/serve.jsonc; do
        [ -s "$work/root/usr/$file" ] || fail "the package has no /usr/$file"
    done
    cmp "$work/root/etc/citysplat/serve.jsonc" configs/serve.jsonc || fail 'the package has no /etc/citysplat/serve.jsonc'
    [ ! -e "$work/root/usr/share/doc/citysplat/examples/deb" ] || fail "the package has its own making"
    for name in three maplibre-gl; do
        grep -q "^$name [0-9]" "$work/root/usr/share/doc/citysplat/licences-npm.txt" || fail "licences-npm.txt has no $name"
    done
fi
[ $failed = 0 ] && echo "ok: $(wc -l <"$work/needed") libraries named, version $version"
exit $failed
