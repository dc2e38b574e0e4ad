#!/bin/sh
# Which folder may include which (docs/architecture.md): lab/ may all, and nothing of the product lab/; a room (server/data) counts as one. C++ headers only in the three shims, microhttpd.h
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
function folder(path,    n, q) { # a room of a folder counts as one
    n = split(path, q, "/")
    return n == 3 ? q[1] "/" q[2] : q[1]
}
BEGIN {
    ok["core"] = " core "
    ok["render"] = " core render "
    ok["codec"] = " core codec "
    ok["lod"] = " core codec render lod "
    ok["scene/synth"] = " core codec scene/synth "
    ok["scene/ingest"] = " core codec scene/ingest "
    ok["scene/cells"] = " core codec scene/cells "
    ok["train/loss"] = " core codec render train/loss "
    ok["scene/stereo"] = " core codec scene/stereo "
    ok["train"] = " core codec render lod scene/cells train/loss train "
    ok["survey"] = " core codec render lod survey "
    ok["server/base"] = " core codec server/base "
    ok["server/http"] = " core server/base server/http "
    ok["server/route"] = " core codec lod server/base server/route "
    ok["server/access"] = " core server/base server/route server/access "
    ok["server/data"] = " core codec lod server/base server/route server/data "
    ok["server/documents"] = " core lod server/base server/route server/data server/documents "
    ok["server/jobs"] = " core server/base server/jobs "
    ok["server/drawing"] = " core codec render lod server/base server/route server/data server/documents server/jobs server/drawing "
    ok["server/answers"] = " core codec render lod server/base server/http server/route server/access server/data server/documents server/jobs server/drawing server/answers "
    ok["server"] = " core lod server/base server/http server/route server/access server/data server/documents server/jobs server/drawing server/answers server "
    ok["cli"] = " core codec render lod scene/cells train/loss scene/synth scene/ingest scene/stereo train survey server server/base server/answers server/data server/documents server/drawing server/jobs server/route server/access server/http cli "
}
/^#include "/ {
    from = folder(FILENAME); to = substr($2, 2); sub(/"$/, "", to)
    if (!index(ok[from], " " folder(to) " ")) {
        print FILENAME ":" FNR ": " from "/ may not include " $2; bad = 1
    }
}
/^#include ".*_internal.h"/ {
    split(FILENAME, f, "/"); split($2, p, /["\/]/)
    if (f[1] != p[2]) { print FILENAME ":" FNR ": " $2 " is internal to " p[2] "/"; bad = 1 }
}
/^#include <gdal\// && FILENAME !~ /^survey\// {
    print FILENAME ":" FNR ": only survey/ includes GDAL"; bad = 1
}
/^#include <microhttpd.h>/ && FILENAME !~ /^server\/(http\.c|mhd_callbacks\.[ch]|reply\.[ch])$/ {
    print FILENAME ":" FNR ": only server/http.c, mhd_callbacks and reply include microhttpd.h"; bad = 1
}
END { exit bad }' core/*.[ch] core/*.cc render/*.[ch] codec/*.[ch] codec/*.cc lod/*.[ch] scene/synth/*.[ch] scene/ingest/*.[ch] scene/cells/*.[ch] train/loss/*.[ch] scene/stereo/*.[ch] train/*.[ch] survey/*.[ch] server/*.[ch] server/*/*.[ch] cli/*.[ch] || exit 1
cxx=$(find core render codec lod scene train survey server cli lab -name '*.cc' -o -name '*.cpp' | sort | tr '\n' ' ')
if [ "$cxx" != "codec/draco_shim.cc codec/image_shim.cc core/geo_shim.cc " ]; then
    echo "C++ outside the three shims: $cxx"
    exit 1
fi

folders="core render codec scene lod train survey server cli lab"
sources() { # ENDING...: files of the program
    for ending; do find $folders -name "*.$ending"; done | sort
}

include_arrows() { # KIND: header or module; lines "from to"
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
