#!/bin/sh
# Bad input through the whole program: each case must give a non-zero exit code, one clear message that names
# what and which, and leave nothing half-written behind. Needs CITYSPLAT_BIN.
#
# SPDX-License-Identifier: Apache-2.0
bin=${CITYSPLAT_BIN:?set it to the citysplat program}
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-bad-XXXXXX") || exit 1
trap 'chmod -R u+w "$work" 2>/dev/null; rm -rf "$work"' EXIT
failed=0
passed=0

# refuse NAME EXIT PATTERN OUTPUT-THAT-MUST-NOT-EXIST COMMAND...
refuse() {
    name=$1 want=$2 pattern=$3 absent=$4
    shift 4
    "$@" >"$work/log" 2>&1 </dev/null
    rc=$?
    why=
    case " $want " in *" $rc "*) ;; *) why="exit code $rc, want $want" ;; esac
    grep -Eiq -- "$pattern" "$work/log" || why="$why; message does not match '$pattern'"
    [ "$(grep -c 'error:' "$work/log")" = 1 ] || why="$why; not exactly one error line"
    [ -z "$absent" ] || [ ! -e "$absent" ] || why="$why; $absent was left behind"
    if [ -n "$absent" ] && ls -d "$absent".part* >/dev/null 2>&1; then why="$why; a .part file was left behind"; fi
    if [ -n "$why" ]; then
        failed=$((failed + 1))
        printf 'FAIL %s: %s\n  ran: %s\n' "$name" "$why" "$*"
        sed 's/^/  | /' "$work/log" | tail -5
    else
        passed=$((passed + 1))
        printf 'ok   %s: %s\n' "$name" "$(grep 'error:' "$work/log" | cut -c1-150)"
    fi
}

"$bin" synth -o "$work/city" --photos 12 --width-px 64 --height-px 48 --extent-m 40 -q || exit 1
fresh() { rm -rf "$work/bad"; cp -r "$work/city" "$work/bad"; }

# -- COLMAP ----------------------------------------------------------------------------------------------
for f in cameras images points3D; do
    fresh
    size=$(wc -c <"$work/bad/sparse/0/$f.bin")
    truncate -s $((size * 2 / 3)) "$work/bad/sparse/0/$f.bin"
    refuse "truncated $f.bin" 1 "$f\.bin" "$work/scene" \
        "$bin" ingest "$work/bad/images" "$work/bad/sparse" -o "$work/scene" -q
done
refuse "no COLMAP model" 1 "cameras.*sparse.*citysplat align" "$work/scene" \
    "$bin" ingest "$work/city/images" "$work/city/truth" -o "$work/scene" -q

# -- photographs -------------------------------------------------------------------------------------------
fresh
first=$(ls "$work/bad/images" | head -1)
printf 'this is not a photograph' >"$work/bad/images/$first"
# One of them is named and set aside; of all of them nothing can be made.
"$bin" ingest "$work/bad/images" "$work/bad/sparse" -o "$work/scene" -q >"$work/log" 2>&1
if [ $? = 0 ] && grep -q "set aside: .*$first" "$work/log"; then
    passed=$((passed + 1))
else
    failed=$((failed + 1))
    echo "FAIL one file that is no image: it is to be named and set aside"
fi
rm -rf "$work/scene"
for f in "$work/bad/images"/*.jpg; do printf 'this is not a photograph' >"$f"; done
refuse "no images" 1 "files of 12 are broken" "$work/scene" \
    "$bin" ingest "$work/bad/images" "$work/bad/sparse" -o "$work/scene" -q
fresh
for f in $(ls "$work/bad/images"/*.jpg | tail -n +4); do # three keep their GPS: somebody has to decide
    # Strip the APP1 segment: decode and encode again without metadata.
    oiiotool "$f" --eraseattrib ".*" -o "$f.tmp.jpg" >/dev/null 2>&1 && mv "$f.tmp.jpg" "$f"
done
refuse "photographs without GPS" 1 "GPS" "$work/scene" \
    "$bin" ingest "$work/bad/images" "$work/bad/sparse" -o "$work/scene" -q
refuse "no photographs" 1 "no such|not found|cannot|image" "$work/scene" \
    "$bin" ingest "$work/nothing" "$work/city/sparse" -o "$work/scene" -q

# -- the machine ---------------------------------------------------------------------------------------------
echo x >"$work/file"
refuse "output folder cannot be made" 1 "$work/file" "" \
    "$bin" ingest "$work/city/images" "$work/city/sparse" -o "$work/file/scene" -q
"$bin" ingest "$work/city/images" "$work/city/sparse" -o "$work/good" -q || exit 1
refuse "no OpenCL device" 1 "pocl-opencl-icd" "$work/good/cells" \
    env OCL_ICD_VENDORS=/nonexistent "$bin" train "$work/good" --iterations 10 -q
if unshare -rm true 2>/dev/null; then
    mkdir "$work/tiny"
    # shellcheck disable=SC2016
    refuse "full disk" 1 "No space left" "" \
        unshare -rm sh -c 'mount -t tmpfs -o size=64k none "$1/tiny" && "$2" ingest "$1/city/images" "$1/city/sparse" -o "$1/tiny/scene" -q; rc=$?; ls "$1/tiny" | grep . && rc=99; exit $rc' \
        sh "$work" "$bin"
else
    echo "skip full disk: no user namespaces here"
fi

# All photographs kept for scores: said when the scene is made, and with a remedy when nothing is left to train on.
if "$bin" ingest "$work/city/images" "$work/city/sparse" -o "$work/kept1" --test-every 1 -q >"$work/log" 2>&1 &&
    grep -q 'all 12 photographs are for testing' "$work/log"; then
    passed=$((passed + 1))
else
    failed=$((failed + 1))
    echo "FAIL --test-every 1: ingest is to warn"
fi
refuse "no photographs to train on" 1 "12 of 12 are kept for scores; --no-test-split trains with all" "$work/kept1/cells/all/config.jsonc" \
    "$bin" train "$work/kept1" --iterations 10 -q
refuse "no photographs for stereo" 1 "--no-test-split takes them too" "$work/kept1/depth" "$bin" stereo "$work/kept1" -q

# -- libraries of the program -------------------------------------------------------------------------------------
mkdir "$work/alone"
cp "$bin" "$work/alone/citysplat"
# Plain JPEGs need no library; a .tif does. One Gaussian of .splat: mean and size as 6 floats, RGBA, rotation.
printf '\0\0\0\0\0\0\0\0\0\0\200\100\315\314\314\075\315\314\314\075\315\314\314\075\377\200\100\377\377\200\200\200' >"$work/one.splat"
cat >"$work/camera.json" <<'JSON'
{"width": 64, "height": 48, "fx": 50, "fy": 50, "cx": 32, "cy": 24, "world_to_camera": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]}
JSON
refuse "no library of images" 1 "images: citysplat-image.so: is neither beside the program nor in" "$work/one.tif" \
    "$work/alone/citysplat" render "$work/one.splat" --camera "$work/camera.json" -o "$work/one.tif" -q
"$bin" import "$work/one.splat" --origin 8,50,100 -o "$work/lone.tiles" -q || exit 1
refuse "no library of maps" 1 "maps and projections: citysplat-gdal.so: is neither beside the program nor in" "$work/map.tif" \
    "$work/alone/citysplat" ortho "$work/lone.tiles" -o "$work/map.tif" -q
echo 'not a library' >"$work/alone/citysplat-gdal.so"
refuse "a library that is none" 1 "citysplat-gdal.so: cannot be loaded" "$work/map.tif" \
    "$work/alone/citysplat" ortho "$work/lone.tiles" -o "$work/map.tif" -q

# An installed program finds both: it writes a .tif and a map.
if [ -f "$(dirname "$bin")/CMakeCache.txt" ]; then
    cmake --install "$(dirname "$bin")" --prefix "$work/usr" >"$work/log" 2>&1 || { cat "$work/log"; exit 1; }
    "$work/usr/bin/citysplat" render "$work/one.splat" --camera "$work/camera.json" -o "$work/one.tif" -q || exit 1
    "$work/usr/bin/citysplat" ortho "$work/lone.tiles" -o "$work/map.tif" -q || exit 1
else
    echo "skip an installed program: this one is not in its build folder"
fi

# -- tile stores and splats --------------------------------------------------------------------------------------
refuse "not a tile store" 65 "$work/file" "" "$bin" serve "$work/file" --port 0 -q
mkfifo "$work/pipe.tiles"
refuse "a pipe as a store" 65 "pipe.tiles: no file" "" timeout 20 "$bin" serve "$work/pipe.tiles" --port 0 -q
refuse "a pipe for info" 1 "pipe.tiles: no file, but a pipe" "" timeout 20 "$bin" info "$work/pipe.tiles"
refuse "no tile store" 66 "nothing.tiles" "" "$bin" serve "$work/nothing.tiles" --port 0 -q
printf 'ply\nformat binary_little_endian 1.0\nelement vertex 4294967295\nproperty float x\nend_header\n' >"$work/huge.ply"
refuse "a .ply that lies about its size" 1 "huge.ply" "$work/huge.tiles" \
    "$bin" import "$work/huge.ply" --origin 8,50,100 -o "$work/huge.tiles" -q

# Rows that no float or no tile can hold are left out, and what is said of them is true.
{
    printf 'ply\nformat ascii 1.0\nelement vertex 202\n'
    for k in x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3; do
        echo "property float $k"
    done
    echo end_header
    awk 'BEGIN {
        for (i = 0; i < 200; i++) print i % 10, int(i / 10), i % 3, "0 0 0 2 -2 -2 -2 1 0 0 0"
        print "5 5 1 0 0 0 2 -2 800 -2 1 0 0 0"
        print "3e38 5 1 0 0 0 2 -2 -2 -2 1 0 0 0"
    }'
} >"$work/absurd.ply"
refuse "a mean beyond all tiles" 1 "row 200 lies 3[0-9]{35} km from the middle.*--drop-outliers" "$work/absurd.tiles" \
    "$bin" import "$work/absurd.ply" --origin 8,50,100 -o "$work/absurd.tiles"
if "$bin" import "$work/absurd.ply" --origin 8,50,100 -o "$work/absurd.tiles" --drop-outliers >"$work/log" 2>&1 &&
    grep -q '1 of 202 rows are left out' "$work/log" && grep -q 'up to 3e+35 km: left out' "$work/log"; then
    passed=$((passed + 1))
else
    failed=$((failed + 1))
    echo "FAIL absurd rows: they are to be left out"
    sed 's/^/  | /' "$work/log"
fi
# Too large for a city is said at once. Of rows so far apart that none is near the middle on all axes, a tile keeps one.
splats() { # N AWK: an ASCII .ply of N rows, whose means AWK prints for i
    printf 'ply\nformat ascii 1.0\nelement vertex %d\n' "$1"
    for k in x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3; do
        echo "property float $k"
    done
    echo end_header
    awk -v n="$1" "BEGIN { OFS = \" \"; tail = \"0 0 0 2 -2 -2 -2 1 0 0 0\"; for (i = 0; i < n; i++) { $2 } }"
}
# shellcheck disable=SC2016
splats 200 'print i % 10, int(i / 10), i * 7 % 50, tail' >"$work/block.ply"
refuse "a scale that is too large" 1 "half of the Gaussians lie more than [0-9]* km.*--scale" "$work/wide.tiles" \
    "$bin" import "$work/block.ply" --origin 8,50,100 --scale 1000000 -o "$work/wide.tiles" -q
# shellcheck disable=SC2016
splats 700 'if (i < 400) print i % 20 * 1000, int(i / 20) * 1000, i % 3, tail
    else { for (k = 0; k < 3; k++) u[k] = x = (x ? x : 1) * 16807 % 2147483647
        r = u[0] / 7158; a = u[1] / 3e8; print r * sin(a), r * cos(a), u[2] / 2147 - 2e5, tail }' >"$work/apart.ply"
if "$bin" import "$work/apart.ply" --origin 8,50,100 -o "$work/wide.tiles" >"$work/log" 2>&1; then
    passed=$((passed + 1))
else
    failed=$((failed + 1))
    echo "FAIL rows far apart in a tile: $(grep error: "$work/log")"
fi
refuse "an origin that is no place" 2 "origin" "$work/huge.tiles" \
    "$bin" import "$work/huge.ply" --origin 8,95,100 -o "$work/huge.tiles" -q

refuse "a name that is too long" 2 "at most 63" "$work/huge.tiles" \
    "$bin" import "$work/huge.ply" --origin 8,50,100 -o "$work/huge.tiles" -q \
    --name "$(printf %064d 0)"

# -- files that are there ----------------------------------------------------------------------------------------
mkdir "$work/kept"
keep() { # NAME OUTPUT COMMAND...: refused, and the file is as it was
    file=$work/kept/$2
    echo precious >"$file"
    kept=$1
    shift 2
    refuse "$kept over a file" "${want:-2}" "exists; choose another name, or replace it with --overwrite" "" "$@"
    [ "$(cat "$file")" = precious ] || { failed=$((failed + 1)); echo "FAIL $kept: the file was touched"; }
    rm "$file"
    mkfifo "$file"
    refuse "$kept over a pipe" "${want:-2}" "no file, but a pipe or a device" "" timeout 20 "$@" --overwrite
    [ -p "$file" ] || { failed=$((failed + 1)); echo "FAIL $kept: the pipe was replaced"; }
    rm "$file"
}
keep tile a.tiles "$bin" tile "$work/city" -o "$work/kept/a.tiles" -q
keep import a.tiles "$bin" import "$work/huge.ply" --origin 8,50,100 -o "$work/kept/a.tiles" -q
keep merge a.tiles "$bin" merge "$work/a.tiles" "$work/b.tiles" -o "$work/kept/a.tiles" -q
keep clip a.tiles "$bin" clip "$work/a.tiles" --high-m 100 -o "$work/kept/a.tiles" -q
keep convert a.spz "$bin" convert "$work/huge.ply" "$work/kept/a.spz" -q
keep render a.png "$bin" render "$work/a.tiles" --lon 8 --lat 50 --height-m 9 -o "$work/kept/a.png" -q
keep report a.html "$bin" report "$work/city" -o "$work/kept/a.html" -q
keep eval a.json "$bin" eval "$work/city" -o "$work/kept/a.json" -q
for end in ply spz sog glb compressed.ply 3tz pmtiles; do
    keep "export .$end" "a.$end" "$bin" export "$work/a.tiles" -o "$work/kept/a.$end" -q
done
for map in "ortho a.tif" "dsm a.TIF" "contour a.gpkg" "points a.las"; do
    keep "${map% *}" "${map#* }" "$bin" ${map% *} "$work/a.tiles" -o "$work/kept/${map#* }" -q
done
keep compare a.tif "$bin" compare "$work/a.tiles" "$work/a.tiles" -o "$work/kept/a.tif" -q
mkfifo "$work/kept/list.txt"
refuse "marks into a pipe" 2 "no file, but a pipe" "" timeout 20 "$bin" mark "$work/good" -o "$work/kept/list.txt"
refuse "a folder as a picture" 2 "a folder of this name exists" "" \
    "$bin" render "$work/a.tiles" --lon 8 --lat 50 --height-m 9 -o "$work/kept" --overwrite

# What a command reads it does not replace, by whatever name.
ln -s one.splat "$work/link.splat"
ln "$work/lone.tiles" "$work/lone.ply"
ln "$work/lone.tiles" "$work/lone.tif"
cp "$work/absurd.ply" "$work/link.ply"
itself() { # NAME FILE COMMAND...
    before=$(cksum <"$2")
    own=$1 file=$2
    shift 2
    refuse "$own onto itself" 2 "is what this command reads|onto itself" "" "$@" --overwrite -q
    [ "$(cksum <"$file")" = "$before" ] || { failed=$((failed + 1)); echo "FAIL $own: its input was replaced"; }
}
itself export "$work/lone.tiles" "$bin" export "$work/lone.tiles" -o "$work/lone.tiles" --format ply
itself "export, a link" "$work/lone.tiles" "$bin" export "$work/lone.tiles" -o "$work/lone.ply"
itself import "$work/one.splat" "$bin" import "$work/one.splat" --origin 8,50,100 -o "$work/link.splat"
itself convert "$work/link.ply" "$bin" convert "$work/link.ply" "$work/link.ply"
itself clip "$work/lone.tiles" "$bin" clip "$work/lone.tiles" --high-m 1000 -o "$work/lone.tiles"
itself merge "$work/lone.tiles" "$bin" merge "$work/none.tiles" "$work/lone.tiles" -o "$work/lone.tiles"
itself ortho "$work/lone.tiles" "$bin" ortho "$work/lone.tiles" -o "$work/lone.tif"

if unshare -rm true 2>/dev/null; then
    "$bin" import "$work/one.splat" --origin 7.5,47.5,300 -o "$work/one.tiles" -q || exit 1
    # shellcheck disable=SC2016
    refuse "full disk, a map" 1 "are needed on the disk, .* free; make room" "" \
        unshare -rm sh -c 'mount -t tmpfs -o size=4k none "$1/tiny" && "$2" dsm "$1/one.tiles" -o "$1/tiny/a.tif" -q; rc=$?; ls "$1/tiny" | grep . && rc=99; exit $rc' \
        sh "$work" "$bin"
fi

# -- stdout ------------------------------------------------------------------------------------------------------
full() { # NAME COMMAND...: stdout is a full disk
    full=$1
    shift
    # shellcheck disable=SC2016
    refuse "$full into a full disk" 1 "stdout: cannot write" "" sh -c '"$@" >/dev/full' sh "$@"
}
if [ -c /dev/full ]; then
    full --version "$bin" --version
    full "help --markdown" "$bin" help --markdown
    full --print-config "$bin" train "$work/good" --print-config
    full info "$bin" info "$work/lone.tiles"
fi
# A reader that has seen enough is no fault, not even where its signal is ignored.
# shellcheck disable=SC2016
sh -c 'trap "" PIPE; "$1" help --markdown; echo "exit $?" >"$2/piped"' sh "$bin" "$work" 2>"$work/log" | head -c 10 >/dev/null
if [ ! -s "$work/log" ] && [ "$(cat "$work/piped")" = "exit 0" ]; then
    passed=$((passed + 1))
else
    failed=$((failed + 1))
    echo "FAIL a pipe that is closed: $(cat "$work/piped" "$work/log")"
fi

# -- endings that say what nobody writes ---------------------------------------------------------------------------
for asked in "ortho a.png .tif or .tiff" "dsm a.jpg .tif or .tiff" "points a.laz pdal.translate" "points a.csv .las" \
    "contour a.shp .geojson or .gpkg" "export a.laz .ply" "export a.png .ply"; do
    set -- $asked
    command=$1 file=$2
    shift 2
    refuse "$command -o $file" 2 "$*" "$work/none-$file" "$bin" "$command" "$work/a.tiles" -o "$work/none-$file" -q
done

# -- what is something else ---------------------------------------------------------------------------------------
refuse "a folder as a store" 65 "a folder, and a tile store is a file; .citysplat tile" "" "$bin" serve "$work/good" --port 0
cp -r "$work/good" "$work/hurt"
hurt=$(ls "$work/hurt/images" | head -1)
head -c 400 "$work/good/images/$hurt" >"$work/hurt/images/$hurt"
refuse "a photograph that broke after ingest" 1 "ingest the scene again: .*$hurt" "$work/hurt/cells/all/level1.ckpt" \
    "$bin" train "$work/hurt" --iterations 10 --budget 100 -q

# -- results that are unfinished, or of another scene ---------------------------------------------------------------------
said() { # NAME PATTERN COMMAND...: succeeds, and says it
    name=$1 pattern=$2
    shift 2
    if "$@" >"$work/log" 2>&1 && grep -Eq -- "$pattern" "$work/log"; then
        passed=$((passed + 1))
    else
        failed=$((failed + 1))
        echo "FAIL $name: '$pattern' is not said"
        sed 's/^/  | /' "$work/log" | tail -5
    fi
}
short="--iterations 40 --level-count 2 --budget 500"
# shellcheck disable=SC2086
"$bin" train "$work/good" $short --stop-after 30 -q >"$work/log" 2>&1 # level 1 is made, level 2 is not
unfinished="cell all: its training is not finished, without level 2 of 2.*train .*/good --resume"
said "tiles of an unfinished training" "$unfinished" "$bin" tile "$work/good" -o "$work/half.tiles" -q
said "scores of an unfinished training" "$unfinished" "$bin" eval "$work/good" -q
# shellcheck disable=SC2086
"$bin" train "$work/good" $short --resume -q >"$work/log" 2>&1 || cat "$work/log"
rm "$work/good/cells/all/done.json"
said "no done.json" "cell all: no done.json says that it is finished" "$bin" tile "$work/good" -o "$work/whole.tiles" -q
"$bin" ingest "$work/city/images" "$work/city/sparse" -o "$work/moved" --origin 7.58,47.56,300 -q >"$work/log" 2>&1 || cat "$work/log"
other="level1.ckpt: was trained of another scene, whose origin lies [0-9]* m from that of .*/moved"
refuse "tiles of another scene" 1 "$other" "$work/other.tiles" "$bin" tile "$work/moved" --trained "$work/good" -o "$work/other.tiles" -q
refuse "scores of another scene" 1 "$other" "" "$bin" eval "$work/moved" --results "$work/good" -q
refuse "scores of another scene's store" 1 "whole.tiles: its origin lies [0-9]* m from that of .*/moved" "" \
    "$bin" eval "$work/moved" --tiles "$work/whole.tiles" -q
refuse "a report with a store of another place" 1 "no ground in common" "$work/other.html" \
    "$bin" report "$work/good" --tiles "$work/lone.tiles" -o "$work/other.html" -q
refuse "an area in hexadecimal" 2 "west,south,east,north" "$work/hex.tif" \
    "$bin" ortho "$work/whole.tiles" -o "$work/hex.tif" --bbox 0x8,50,9,51 -q

# -- what a killed run leaves, the next one removes -------------------------------------------------------------------
leftovers() { find "$work" -name 'killed.ply.part-*' | wc -l; }
sh -c 'ulimit -f 1; exec "$@"' sh "$bin" export "$work/whole.tiles" -o "$work/killed.ply" -q >/dev/null 2>&1
left=$(leftovers)
"$bin" export "$work/whole.tiles" -o "$work/killed.ply" -q >"$work/log" 2>&1
if [ "$left" = 1 ] && [ "$(leftovers)" = 0 ] && [ -e "$work/killed.ply" ]; then
    passed=$((passed + 1))
else
    failed=$((failed + 1))
    echo "FAIL a killed export: $left parts, and $(leftovers) after the next one"
fi

# -- the command line -----------------------------------------------------------------------------------------------
refuse "unknown option" 2 "did you mean --output" "" "$bin" ingest a b --ouput x
sed -n 's/^GONE("\([a-z]*\)", "\([a-z_]*\)".*/\1 \2/p' "${0%/*}/../../core/options/options_gone.def" | tr _ - >"$work/gone"
[ -s "$work/gone" ] || failed=$((failed + 1))
while read -r command key; do # none of them is an option again
    [ -n "$key" ] || key=$command command=dsm
    refuse "$command --$key left" "2 64" "option --$key is gone: " "" "$bin" "$command" a b "--$key" x
done <"$work/gone"
refuse "an idle option, and no photographs" "1 2 64 65 66" "option format is gone and does nothing: pictures are JPEG 98" "" \
    "$bin" ingest "$work/nowhere" "$work/nowhere" --format png -o "$work/none"
echo '{"write_timeout_s": 5}' >"$work/old.jsonc"
refuse "an option that left, in a file" 78 "old.jsonc.*option write_timeout_s is gone: it is 30 s" "" "$bin" serve --config "$work/old.jsonc"
refuse "unknown command" 2 "no command 'trian'; did you mean 'train'" "" "$bin" trian
refuse "a command like no other" 2 "no command 'q'; .citysplat help" "" "$bin" q
refuse "a value out of range" 64 "from" "" "$bin" serve x.tiles --port 70000
refuse "missing argument" 2 "too few" "" "$bin" train

# -- options without effect, and what only a part of the message would say ---------------------------------------
refuse "a base without a polygon" 2 "only volumes have a base; give --polygon" "" "$bin" measure x.tiles 8,50 8.1,50 --base-m 3
for command in dsm points; do
    refuse "$command --widest-m without --ground" 2 "add --ground" "$work/none" "$bin" $command x.tiles -o "$work/none" --widest-m 20
done
refuse "zooms of a .ply" 2 "zooms is for pmtiles alone" "$work/none.ply" "$bin" export "$work/a.tiles" -o "$work/none.ply" --zooms 14-15
refuse "a level of 3D Tiles" 2 "level is not for 3dtiles" "$work/none.3tz" "$bin" export "$work/a.tiles" -o "$work/none.3tz" --level 1
refuse "pixels of a nanometre" 2 "gsd-m: 1e-09: 0, or at least 0.001 m" "" "$bin" height x.tiles 8,50 --gsd-m 1e-9
# shellcheck disable=SC2046
refuse "the 16th place" 2 "one argument too many; .*at most 15" "" "$bin" height x.tiles $(yes 8,50 | head -16)
refuse "a file of places that is not there" 2 "places.txt.*there is no file of this name" "$work/none.tiles" \
    "$bin" import "$work/huge.ply" --origin "$work/places.txt" -o "$work/none.tiles"
echo '{"keys": {"k": "a key of this test alone, 32 characters"}}' >"$work/auth.jsonc"
chmod 600 "$work/auth.jsonc"
refuse "a signed redirect" 2 "with the revision, /d/city/r/REV/" "" "$bin" sign /d/city/t/1/0/0.glb --auth "$work/auth.jsonc"
"$bin" help sign | sed -n 's/^ *citysplat sign \(\/.*\) --auth.*/\1/p' | grep . >"$work/paths" || failed=$((failed + 1))
while read -r path; do # the help's own example
    "$bin" sign "$path" --auth "$work/auth.jsonc" >/dev/null || failed=$((failed + 1))
done <"$work/paths"

echo "$passed passed, $failed failed"
[ "$failed" = 0 ]
