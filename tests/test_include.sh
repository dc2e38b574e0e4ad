#!/bin/sh
# Which folder may include which (docs/architecture.md). C++ headers only in the three shims, microhttpd.h
# only in server/http.c.
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
    ok["server"] = " core codec render lod server "
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
/^#include <microhttpd.h>/ && FILENAME != "server/http.c" {
    print FILENAME ":" FNR ": only server/http.c includes microhttpd.h"; bad = 1
}
END { exit bad }' core/*.[ch] core/*.cc render/*.[ch] codec/*.[ch] codec/*.cc lod/*.[ch] synth/*.[ch] ingest/*.[ch] cells/*.[ch] loss/*.[ch] train/*.[ch] server/*.[ch] || exit 1
cxx=$(find core render codec lod synth ingest cells loss train server cli bench -name '*.cc' -o -name '*.cpp' | sort | tr '\n' ' ')
if [ "$cxx" != "codec/draco_shim.cc codec/image_shim.cc core/geo_shim.cc " ]; then
    echo "C++ outside the three shims: $cxx"
    exit 1
fi
echo "include rules hold"
