#!/bin/sh
# Which folder may include which (docs/architecture.md). C++ headers only in the three shims, microhttpd.h
# only in server/http.c, exchange and reply, GDAL's in survey/. No circle of headers, and none of modules, where a .c counts with its header and an include
# of another's header is an arrow; tests/circles_todo.txt names the modules that still stand in one, and may only
# get shorter.
#
# SPDX-License-Identifier: Apache-2.0
cd "$(dirname "$0")/.." || exit 1
awk '
BEGIN {
    ok["core"] = " core "
    ok["render"] = " core render "
    ok["codec"] = " core codec "
    ok["lod"] = " core codec render lod "
    ok["synth"] = " core codec synth "
    ok["ingest"] = " core codec ingest "
    ok["cells"] = " core codec cells "
    ok["loss"] = " core codec render loss "
    ok["train"] = " core codec render lod cells loss train "
    ok["survey"] = " core codec render lod survey "
    ok["server"] = " core codec render lod server "
    ok["studies"] = " core train cli studies "
}
/^#include "/ {
    split(FILENAME, f, "/"); split($2, p, /["\/]/)
    if (!index(ok[f[1]], " " p[2] " ")) {
        print FILENAME ":" FNR ": " f[1] "/ may not include " $2; bad = 1
    }
}
/^#include ".*_internal.h"/ {
    split(FILENAME, f, "/"); split($2, p, /["\/]/)
    if (f[1] != p[2]) { print FILENAME ":" FNR ": " $2 " is internal to " p[2] "/"; bad = 1 }
}
/^#include <gdal\// && FILENAME !~ /^survey\// {
    print FILENAME ":" FNR ": only survey/ includes GDAL"; bad = 1
}
/^#include <microhttpd.h>/ && FILENAME !~ /^server\/(http\.c|exchange\.[ch]|reply\.[ch])$/ {
    print FILENAME ":" FNR ": only server/http.c, exchange and reply include microhttpd.h"; bad = 1
}
END { exit bad }' core/*.[ch] core/*.cc render/*.[ch] codec/*.[ch] codec/*.cc lod/*.[ch] synth/*.[ch] ingest/*.[ch] cells/*.[ch] loss/*.[ch] train/*.[ch] survey/*.[ch] server/*.[ch] studies/*.[ch] || exit 1
cxx=$(find core render codec lod synth ingest cells loss train survey server cli bench studies -name '*.cc' -o -name '*.cpp' | sort | tr '\n' ' ')
if [ "$cxx" != "codec/draco_shim.cc codec/image_shim.cc core/geo_shim.cc " ]; then
    echo "C++ outside the three shims: $cxx"
    exit 1
fi

circles() { # KIND: header or module; a line a circle
    find core render codec cells ingest synth loss lod train survey server cli bench studies \( -name '*.[ch]' -o -name '*.cc' \) 2>/dev/null |
        sort | xargs grep -H '^#include "' | awk -F'"' -v kind="$1" '
function name(f) { if (kind == "module") sub(/(_shim)?\.(c|h|cc)$/, "", f); return f }
function walk(a,    k, n, to) {
    n = split(out[a], to, " ")
    for (k = 1; k <= n; k++) if (!(to[k] in seen)) { seen[to[k]]; walk(to[k]) }
}
{
    from = $1; sub(/:.*/, "", from)
    if (kind == "header" && from !~ /\.h$/) next
    from = name(from); to = name($2)
    if ((kind == "header" || from != to) && !((from, to) in arrow)) { arrow[from, to]; out[from] = out[from] " " to }
}
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
headers=$(circles header)
[ -z "$headers" ] || { echo "headers include each other: $headers"; exit 1; }
circles module | awk -v todo=tests/circles_todo.txt '
BEGIN { while ((getline line < todo) > 0) if (line !~ /^#/ && line != "") open[line] = 1 }
{
    fresh = 0
    for (k = 1; k <= NF; k++) if (!($k in open)) fresh = 1; else open[$k] = 2
    if (fresh) { print "modules include each other: " $0; bad = 1 }
}
END {
    for (m in open) if (open[m] == 1) { print m " stands in no circle any more: take it out of " todo; bad = 1 }
    exit bad
}' || exit 1
echo "include rules hold"
