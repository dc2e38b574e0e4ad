#!/bin/sh
# Which folder may include which (docs/architecture.md): lab/ may all, and nothing of the product lab/; a room (server/data) counts as one,
# and the rooms of a folder stand in no circle. A folder or room has at most 25 modules. C++ headers only in the three shims, microhttpd.h
# only in server/http.c, mhd_callbacks and reply, GDAL's in survey/. No circle of headers, and none of modules, where a .c counts with its header and an include
# of another's header is an arrow. No circle of sources either: a call is an arrow to the .c that defines the function,
# whatever header declares it, and in web/src an import is an arrow. tests/circles_todo.txt names the modules and sources
# that still stand in a circle, and may only get shorter.
#
# What is read is text. A function is what stands at the start of a line and has its { on a line of its own; a call is its
# name in another source, followed by a bracket or not (tables of functions), unless it is a member or the tag of a struct.
# Not seen: names that a macro puts together (cli/main.c's table of commands), calls through a pointer that another file
# has set, kernels, and C++.
#
# SPDX-License-Identifier: Apache-2.0
cd "$(dirname "$0")/.." || exit 1
awk '
function folder(path,    n, q) { # its room where it has one
    n = split(path, q, "/")
    return n == 3 ? q[1] "/" q[2] : q[1]
}
BEGIN {
    # A name with / at its end: the folder and its rooms.
    ok["core"] = " core "
    ok["core/math"] = " core core/math "
    ok["core/options"] = " core core/options "
    ok["core/geo"] = " core core/geo "
    ok["core/splat"] = " core core/math core/splat "
    ok["core/device"] = " core core/device "
    ok["render"] = " core/ render "
    ok["codec"] = " codec "
    ok["codec/container"] = " core/ codec/container "
    ok["codec/image"] = " core/ codec codec/image "
    ok["codec/scene"] = " core/ codec/image codec/scene "
    ok["codec/splat"] = " core/ codec codec/container codec/image codec/splat "
    ok["lod/store"] = " core/ codec/ lod/store "
    ok["lod/make"] = " core/ codec/ lod/store lod/make "
    ok["lod/choose"] = " core/ codec/ render lod/store lod/choose "
    ok["lod/export"] = " core/ codec/ lod/store lod/export "
    ok["lod/surface"] = " core/ codec/ render lod/store lod/choose lod/surface "
    ok["scene/synth"] = " core/ codec/ scene/synth "
    ok["scene/control"] = " core/ codec/ scene/control "
    ok["scene/ingest"] = " core/ codec/ scene/control scene/ingest "
    ok["scene/cells"] = " core/ codec/ scene/cells "
    ok["scene/stereo"] = " core/ codec/ scene/stereo "
    ok["train/loss"] = " core/ codec/ render train/loss "
    ok["train/base"] = " core/ scene/cells train/base "
    ok["train/model"] = " core/ codec/ render lod/ scene/cells train/base train/model "
    ok["train/photographs"] = " core/ codec/ render scene/cells train/loss train/base train/model train/photographs "
    ok["train/terms"] = " core/ codec/ scene/cells train/loss train/base train/model train/photographs train/terms "
    ok["train/density"] = " core/ codec/ render scene/cells train/loss train/base train/model train/photographs train/density "
    ok["train"] = " core/ codec/ render lod/ scene/cells train/ "
    ok["survey"] = " core/ codec/ render lod/ survey "
    ok["server/base"] = " core/ codec/ server/base "
    ok["server/http"] = " core/ server/base server/http "
    ok["server/route"] = " core/ codec/ lod/ server/base server/route "
    ok["server/access"] = " core/ server/base server/route server/access "
    ok["server/data"] = " core/ codec/ lod/ server/base server/route server/data "
    ok["server/documents"] = " core/ lod/ server/base server/route server/data server/documents "
    ok["server/jobs"] = " core/ server/base server/jobs "
    ok["server/drawing"] = " core/ codec/ render lod/ server/base server/route server/data server/documents server/jobs server/drawing "
    ok["server/answers"] = " core/ codec/ render lod/ server/base server/http server/route server/access server/data server/documents server/jobs server/drawing server/answers "
    ok["server"] = " core/ lod/ server/base server/http server/route server/access server/data server/documents server/drawing server/answers server "
    for (k = split("cli/base cli/scene cli/train cli/tiles cli/maps cli/serve", room, " "); k; k--)
        ok[room[k]] = " core/ codec/ render lod/ scene/ train/ survey server/ cli/base " room[k] " "
    ok["cli"] = " core/ codec/ render lod/ scene/ train/ survey server/ cli/ "
}
/^#include "/ {
    from = folder(FILENAME); to = substr($2, 2); sub(/"$/, "", to)
    all = to; sub(/\/.*/, "/", all)
    if (!index(ok[from], " " folder(to) " ") && !index(ok[from], " " all " ")) {
        print FILENAME ":" FNR ": " from "/ may not include " $2; bad = 1
    }
}
/^#include ".*_internal.h"/ {
    if (from != folder(to)) { print FILENAME ":" FNR ": " $2 " is internal to " folder(to) "/"; bad = 1 }
}
/^#include <gdal\// && FILENAME !~ /^survey\// {
    print FILENAME ":" FNR ": only survey/ includes GDAL"; bad = 1
}
/^#include <microhttpd.h>/ && FILENAME !~ /^server\/(http\.c|mhd_callbacks\.[ch]|reply\.[ch])$/ {
    print FILENAME ":" FNR ": only server/http.c, mhd_callbacks and reply include microhttpd.h"; bad = 1
}
END { exit bad }' $(find core render codec lod scene train survey server cli -name '*.[ch]' -o -name '*.cc') || exit 1
cxx=$(find core render codec lod scene train survey server cli lab -name '*.cc' -o -name '*.cpp' | sort | tr '\n' ' ')
if [ "$cxx" != "codec/image/image_shim.cc codec/splat/draco_shim.cc core/geo/geo_shim.cc " ]; then
    echo "C++ outside the three shims: $cxx"
    exit 1
fi

folders="core render codec scene lod train survey server cli lab"
sources() { # ENDING...: files of the program
    for ending; do find $folders -name "*.$ending"; done | sort
}

include_arrows() { # KIND: header, module or file; lines "from to"
    sources c h cc | xargs grep -H '^#include "' | awk -F'"' -v kind="$1" '
function name(f) { if (kind == "module") sub(/(_shim)?\.(c|h|cc)$/, "", f); return f }
{
    from = $1; sub(/:.*/, "", from)
    if (kind == "header" && from !~ /\.h$/) next
    from = name(from); to = name($2)
    if (kind == "header" || from != to) print from, to
}'
}

call_arrows() { # lines "from to function"; every source is read twice
    awk '
function code(line) { # without comments and strings
    if (comment) {
        if (!sub(/^.*\*\//, "", line)) return ""
        comment = 0
    }
    gsub(/\\./, "", line)
    gsub(/"[^"]*"/, "", line)
    gsub(/\/\*[^*]*(\*[^*\/][^*]*)*\*\//, "", line)
    sub(/\/\/.*/, "", line)
    if (sub(/\/\*.*/, "", line)) comment = 1
    return line
}
FNR == 1 { second = FILENAME in read; read[FILENAME]; head = ""; comment = 0 }
{ line = code($0) }
!second && line == "{" && match(head, /[A-Za-z_0-9]+\(/) {
    f = substr(head, RSTART, RLENGTH - 1)
    if (head ~ /^static /) own[FILENAME, f]
    else if (f != "main") home[f] = FILENAME
}
!second && line ~ /^[A-Za-z]/ { head = line }
second {
    gsub(/(struct|enum|union) +[A-Za-z_0-9]+|(\.|->) *[A-Za-z_0-9]+/, " ", line)
    n = split(line, word, /[^A-Za-z_0-9]+/)
    for (k = 1; k <= n; k++) {
        f = word[k]
        if (f in home && home[f] != FILENAME && !((FILENAME, f) in own)) print FILENAME, home[f], f
    }
}' $(sources c) $(sources c)
}

import_arrows() { # of TypeScript; lines "from to"
    grep -oE '(from|import|import\(|URL\() *"\./[^"?]*' web/src/*.ts | awk -F'"' '
{
    from = $1; sub(/:.*/, "", from)
    to = "web/src" substr($2, 2)
    print from, to ~ /\.[a-z]+$/ ? to : to ".ts"
}'
}

circles() { # of arrows "from to"; a line a circle
    awk '
function walk(a,    k, n, to) {
    n = split(out[a], to, " ")
    for (k = 1; k <= n; k++) if (!(to[k] in seen)) { seen[to[k]]; walk(to[k]) }
}
!(($1, $2) in arrow) { arrow[$1, $2]; out[$1] = out[$1] " " $2 }
END {
    for (a in out) { split("", seen); walk(a); for (b in seen) reach[a, b] }
    for (a in out) if ((a, a) in reach) {
        first = a # the circle is called after the first of its members
        for (b in out) if ((a, b) in reach && (b, a) in reach && b < first) first = b
        members[first] = members[first] " " a
    }
    for (a in members) print substr(members[a], 2)
}'
}
crowded=$(find $folders tests -name '*.c' -o -name '*.cc' | sed 's|/[^/]*$||' | sort | uniq -c | awk '$1 > 25 { print $2 " has " $1 }')
[ -z "$crowded" ] || { echo "more than 25 modules in one folder: $crowded"; exit 1; }
rooms=$(include_arrows file | awk '{
    from = $1; to = $2; sub(/\/[^\/]*$/, "", from); sub(/\/[^\/]*$/, "", to)
    split(from, f, "/"); split(to, t, "/")
    if (from != to && f[1] == t[1]) print from, to
}' | circles)
[ -z "$rooms" ] || { echo "rooms include each other: $rooms"; exit 1; }
headers=$(include_arrows header | circles)
[ -z "$headers" ] || { echo "headers include each other: $headers"; exit 1; }
{
    include_arrows module | circles | sed 's/^/modules include each other: /'
    call_arrows | circles | sed 's/^/sources call each other: /'
    import_arrows | circles | sed 's/^/modules import each other: /'
} | awk -v todo=tests/circles_todo.txt '
BEGIN { while ((getline line < todo) > 0) if (line !~ /^#/ && line != "") open[line] = 1 }
{
    fresh = 0 # the first four words say what they do
    for (k = 5; k <= NF; k++) if (!($k in open)) fresh = 1; else open[$k] = 2
    if (fresh) { print; bad = 1 }
}
END {
    for (m in open) if (open[m] == 1) { print m " stands in no circle any more: take it out of " todo; bad = 1 }
    exit bad
}' || exit 1
echo "include rules hold"
