#!/usr/bin/env bash
# The folders that people have: `citysplat city` on fifty that are wrong in one thing each. Whatever it is, the message names
# it, it comes before training, the exit code tells whether a city can be made of the rest, and a refused folder leaves
# neither a scene nor a store. COLMAP is a stand-in (tests/cli/fake_colmap.c); what it is asked and told is tested by test_align.sh.
#
# SPDX-License-Identifier: Apache-2.0
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.." || exit 1
bin=${CITYSPLAT_BIN:?the program under test}
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-folders-XXXXXX") || exit 1
trap 'chmod -R u+w "$work" 2>/dev/null; rm -rf "$work"' EXIT
mkdir "$work/path" && ln -s "${FAKE_COLMAP:?the stand-in for COLMAP}" "$work/path/colmap"
export PATH=$work/path:$PATH FAKE_TRUTH=$work/city/sparse/0 FAKE_LOG=$work/calls
export LC_ALL=C.UTF-8
failed=0 passed=0

"$bin-lab" synth -q -o "$work/city" --photos 12 --width-px 64 --height-px 48 --extent-m 40 --points 800 --supersample 1 >/dev/null || exit 1
mapfile -t names < <(ls "$work/city/images")

# begin NAME [poses]: $f is a fresh copy of the good folder: photographs alone, or with COLMAP's model.
begin() {
    name=$1
    f=$work/folder
    rm -rf "$f" "$work/out"
    if [ "${2:-}" = poses ]; then mkdir "$f" && cp -r "$work/city/images" "$work/city/sparse" "$f/" && p=$f/images; else cp -r "$work/city/images" "$f" && p=$f; fi
}

# judge EXIT PATTERN [OPTIONS]: EXIT 0: a city can be made of the rest; else refused, with one error.
judge() {
    local want=$1 pattern=$2 why='' rc
    shift 2
    timeout 120 env PATH="${only:-$PATH}" "$bin" city "$f" -o "$work/out" --iterations 10 --max-edge-px 32 "$@" >"$work/log" 2>&1 </dev/null
    rc=$?
    [ $rc -lt 124 ] || why='; it crashed or hung'
    [ $rc = "$want" ] || why="$why; exit $rc, expected $want"
    grep -Eiq -- "$pattern" "$work/log" || why="$why; not said: $pattern"
    if [ "$want" = 0 ]; then
        [ -f "$work/out/out.tiles" ] || why="$why; no store"
    else
        grep -q 'error:' "$work/log" || why="$why; no error is named"
        [ ! -e "$work/out/out.tiles" ] && [ ! -e "$work/out/scene/scene.json" ] || why="$why; something was left behind"
        ! grep -q ' train level' "$work/log" || why="$why; it was trained first"
    fi
    ! ls -d "$work"/out/*.part* >/dev/null 2>&1 || why="$why; a .part was left behind"
    if [ -n "$why" ]; then
        failed=$((failed + 1))
        printf 'FAIL %s%s\n' "$name" "$why"
        tail -8 "$work/log" | sed 's/^/  | /'
    else
        passed=$((passed + 1))
        printf 'ok   %-40s %s\n' "$name" "$(grep -Ei -m1 -- "$pattern" "$work/log" | sed "s#$work/##g" | cut -c1-150)"
    fi
}
each() { local x; for x in "$p"/*.jpg; do "$@" "$x"; done; } # COMMAND... with each photograph behind
strip() { oiiotool "$1" --eraseattrib '.*' -o "$1.tmp.jpg" 2>/dev/null && mv "$1.tmp.jpg" "$1"; }
nothing() { printf 'this is not a photograph' >"$1"; }
halve() { truncate -s $(($(stat -c %s "$1") / 3)) "$1"; }

# ---- what is not a folder of photographs
begin 'a folder that is not there'; rm -rf "$f"; judge 1 'folder is expected'
begin 'a file in place of a folder'; rm -rf "$f"; echo x >"$f"; judge 1 'folder is expected'
begin 'an empty folder'; rm -f "$f"/*; judge 1 'no photographs'
begin 'texts alone'; rm -f "$f"/*; echo hello >"$f/readme.txt"; judge 1 'no photographs'
begin 'raw photographs alone'; for x in "$f"/*.jpg; do mv "$x" "${x%.jpg}.dng"; done; judge 1 'no photographs'
begin 'a film alone'; rm -f "$f"/*; head -c 5000 /dev/urandom >"$f/DJI_0001.MP4"; judge 1 'no photographs'
begin 'an empty folder images/' poses; rm -f "$p"/*; judge 1 'no photographs|no such|not found|there'
begin 'one photograph'; find "$f" -name '*.jpg' | sort | tail -n +2 | xargs -d '\n' rm; judge 1 '1 of 1 photographs can be used'
begin 'two photographs'; find "$f" -name '*.jpg' | sort | tail -n +3 | xargs -d '\n' rm; judge 1 '2 of 2 photographs can be used'

# ---- photographs that are wrong
begin 'all are broken'; each nothing; judge 1 'can be used|cannot be read|broken'
begin 'all are empty files'; each truncate -s 0; judge 1 'can be used|cannot be read|broken'
begin 'one is broken'; nothing "$p/${names[4]}"; judge 0 "${names[4]}: it cannot be read"
begin 'one is an empty file'; : >"$p/${names[4]}"; judge 0 "${names[4]}: it cannot be read"
begin 'one is broken, with poses' poses; nothing "$p/${names[4]}"; judge 0 "set aside.*${names[4]}"
begin 'one is cut off, with poses' poses; halve "$p/${names[4]}"; judge 0 "${names[4]}"
begin 'all are cut off, with poses' poses; each halve; judge 1 'broken'
begin 'all are one photograph'; for n in "${names[@]:1}"; do cp "$p/${names[0]}" "$p/$n"; done; judge 1 '1 of 12 photographs can be used'
begin 'one is double'; cp "$p/${names[2]}" "$p/zz.jpg"; judge 0 'zz.jpg: a copy of|a copy of zz.jpg'
begin 'one is a text of that name'; printf 'notes' >"$p/notes.jpg"; judge 0 'notes.jpg: it cannot be read'
begin 'one claims to be huge'
printf '\377\330\377\300\000\021\010\377\377\377\377\003\001\042\000\002\021\001\003\021\001\377\332\000\014\003\001\000\002\021\003\021\000\077\000\377\331' >"$p/huge.jpg"
judge 0 'huge.jpg: '
begin 'one is a folder of that name'; mkdir "$p/folder.jpg"; judge 0 '12 of 12'
begin 'a link that leads nowhere'; ln -s /nowhere/at/all.jpg "$p/link.jpg"; judge 0 'link.jpg: it cannot be read'
begin 'a link that leads to itself'; ln -s "$f" "$p/again"; judge 0 '12 of 12'
begin 'no GPS'; each strip; judge 0 '0 of 12 .*GPS.*no place and no metres.*--gcp.*--positions'; grep -q 'heights.*unscaled' "$work/out/scene/scene.json" || { failed=$((failed + 1)); echo 'FAIL no GPS: the scene has metres'; }
begin 'no GPS, placed by hand'; each strip; judge 0 'frame by hand' --origin 7.5,47.5,300 --metres-per-unit 1
begin 'no GPS, with poses' poses; each strip; judge 0 'metres are not known.*--metres-per-unit'
begin 'GPS in a quarter'; for n in "${names[@]:3}"; do strip "$p/$n"; done; judge 1 '3 of 12 .*GPS.*--gcp.*--positions.*--origin'; ! grep -q '^look' "$work/log" || { failed=$((failed + 1)); echo 'FAIL GPS in a quarter: poses were sought first'; }
begin 'one without GPS'; strip "$p/${names[3]}"; judge 0 '12 of 12'
begin 'names in capitals, with poses' poses; for n in "${names[@]}"; do mv "$p/$n" "$p/${n%.jpg}.JPG"; done; judge 0 '12 of 12 photographs'
begin 'blanks and umlauts in names'; mv "$p/${names[0]}" "$p/Über den Dächern 1.jpg"; judge 0 'photographs'

# ---- photographs that do not belong together
begin 'nothing matches'; FAKE_ALONE=.jpg judge 1 'only 1 of 12 photographs hang together|matches no neighbour'
begin 'one matches none'; FAKE_ALONE=${names[5]} judge 0 "${names[5]}: .*matches no neighbour"
begin 'one shows water'; FAKE_BLANK=${names[6]} judge 0 "${names[6]}: .*only 12 features"
begin 'a second flight elsewhere'
"$bin-lab" synth -q -o "$work/far" --photos 8 --width-px 64 --height-px 48 --extent-m 40 --supersample 1 --lat-deg 47.6 --seed 2 >/dev/null
mkdir "$p/second" && cp "$work/far/images/"*.jpg "$p/second/"; FAKE_SPLIT=second judge 0 'lie in 2 places'

# ---- COLMAP and its model
begin 'no COLMAP'; only=/nowhere judge 1 'install COLMAP|no such program'
for at in feature_extractor matches_importer mapper; do
    begin "COLMAP fails in its $at"; FAKE_FAIL=$at judge 1 "$at: exit 1"
done
begin 'an empty sparse/' poses; rm -rf "$f/sparse/"*; judge 1 'sparse'
for part in cameras images points3D; do
    begin "$part.bin is cut off" poses; halve "$f/sparse/0/$part.bin"; judge 1 "$part.bin"
    begin "$part.bin is not there" poses; rm "$f/sparse/0/$part.bin"; judge 1 "$part"
done
begin 'the model of other photographs' poses; for n in "${names[@]}"; do mv "$p/$n" "$p/other-$n"; done; judge 1 'not in|no such|missing'
begin 'a photograph of the model is missing' poses; rm "$p/${names[2]}"; judge 1 "${names[2]}.*--skip-missing|skip-missing"

# ---- files that come with the photographs
begin 'ground control that is not there' poses; judge 1 'gcp.txt' --gcp "$work/gcp.txt"
begin 'an empty list of ground control' poses; : >"$f/gcp.txt"; judge 1 'gcp.txt' --gcp "$f/gcp.txt"
begin 'ground control without a system' poses; printf '399999 5270000 300 10 10 %s\n' "${names[0]}" >"$f/gcp.txt"; judge 2 'gcp.txt.*--gcp-epsg' --gcp "$f/gcp.txt"
begin 'ground control of other photographs' poses; printf 'EPSG:32632\n399999 5270000 300 10 10 nobody.jpg a\n' >"$f/gcp.txt"; judge 1 'gcp.txt: 0 of 1 ground control' --gcp "$f/gcp.txt"
begin 'masks that are not there' poses; judge 1 'mask' --masks "$work/no-masks"
begin 'a mask of another size' poses; mkdir "$f/masks"; oiiotool --create 10x10 1 -o "$f/masks/${names[1]}.png"; judge 1 "${names[1]}" --masks "$f/masks"
begin 'a mask that is none' poses; mkdir "$f/masks"; nothing "$f/masks/${names[1]}.png"; judge 1 "${names[1]}" --masks "$f/masks"
begin 'positions of other photographs' poses; printf 'image,lon,lat,height\nnobody.jpg,7.5,47.5,300\n' >"$f/pos.csv"; judge 1 'pos.csv' --positions "$f/pos.csv"
begin 'positions that are none' poses; head -c 400 /dev/urandom >"$f/pos.csv"; judge 1 'pos.csv' --positions "$f/pos.csv"
begin 'a geoid that is not installed' poses; judge 1 'geoid' --geoid nowhere-96
begin 'an origin that is no place' poses; judge 2 'origin' --origin 7.5,147.5,300

# ---- where it goes
begin 'the output is a file'; echo precious >"$work/out"; judge 1 'out'; rm -f "$work/out"

echo "$passed passed, $failed failed"
[ "$failed" = 0 ] && [ "$passed" -ge 50 ]
