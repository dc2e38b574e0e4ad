#!/bin/sh
# Header contracts: each function that returns enum err_code and is declared in a header of the folders below has a
# comment that names its error codes. The comment is the one above it, or above the group of declarations that it
# stands in (a group ends at a blank line or at the next comment). Codes are those of core/err.h. Headers that do not
# keep this yet are listed in tests/contracts_todo.txt, which may only get shorter.
#
#   tests/test_contracts.sh [FILE...]   what is missing in these headers, without exemptions
#
# SPDX-License-Identifier: Apache-2.0
cd "$(dirname "$0")/.." || exit 1
todo=tests/contracts_todo.txt
all=$#
[ $# -gt 0 ] || set -- $(find core codec render lod scene/cells train survey -name '*.h' 2>/dev/null | grep -vx core/err.h | sort)
awk -v todo="$([ "$all" = 0 ] && echo "$todo")" '
BEGIN {
    while ((getline line < "core/err.h") > 0) # the list: X(ERR_NAME, "text")
        if (match(line, /X\(ERR_[A-Z]+/)) code[substr(line, RSTART + 2, RLENGTH - 2)]
    if (!("ERR_MEM" in code)) { print "core/err.h: no list of codes"; exit bad = 1 }
    while (todo != "" && (getline line < todo) > 0)
        if (line !~ /^#/ && line != "") exempt[line] = 1
}
function says(text,    found, name) { # does a comment name a code; unknown codes are errors anywhere
    found = 0
    while (match(text, /ERR_[A-Z]+/)) {
        name = substr(text, RSTART, RLENGTH); text = substr(text, RSTART + RLENGTH)
        if (name in code) found = 1
        else if (name !~ /^ERR_(USE|PRINTF|LIST)$/) { print FILENAME ":" FNR ": " name " is no code of core/err.h"; bad = 1 }
    }
    return found
}
function declared(text, at,    name) {
    if (text !~ /^(static |extern |inline )*enum err_code \**[a-z_0-9]+\(/ ) return
    total++
    if (names) { told++; return }
    name = text; sub(/\(.*/, "", name); sub(/.* \**/, "", name)
    missing[FILENAME]++
    if (!(FILENAME in exempt)) { print FILENAME ":" at ": " name " names no ERR_ code"; bad = 1 }
}
function end() { if (text != "") declared(text, start); text = "" }
FNR == 1 { comment = names = depth = whole = cxx = macro = 0; text = ""; seen[FILENAME] }
/^#if.*__cplusplus/ { cxx = 1 }
/^#endif/ { cxx = 0 }
cxx { next } # extern "C" { is no body
!comment && (macro || /^#/) { macro = /\\$/; next }
{
    line = $0
    if (comment) { # inside a comment of several lines
        if (says(line)) names = 1
        if (!sub(/^.*\*\//, "", line)) next
        comment = 0
        if (whole) end()
        whole = 0
        if (line ~ /^[ \t]*$/) next
    }
    if (line ~ /^[ \t]*$/ && text == "") { names = 0; next }
    if (line ~ /^[ \t]*\/\*/ && text == "" && !depth) { # a comment of its own begins another group
        names = says(line)
        comment = line !~ /\*\//
        next
    }
    if (line ~ /\/\*/) { # behind code: it counts for this declaration, and for those that follow
        if (says(substr(line, index(line, "/*")))) names = 1
        if (line !~ /\*\//) comment = 1
        sub(/\/\*.*/, "", line)
    }
    # Bodies of structures and of inline functions are passed over.
    opened = gsub(/\{/, "{", line); closed = gsub(/\}/, "}", line)
    if (text == "") start = FNR
    if (!depth) text = text (text == "" ? "" : " ") line
    depth += opened - closed
    if (!depth && line ~ /[;}][ \t]*$/) { if (comment) whole = 1; else end() }
}
END {
    for (f in exempt)
        if (!(f in seen)) { print todo ": " f " is not there: take the line out"; bad = 1 }
        else if (!missing[f]) { print todo ": " f " says all its codes: take the line out"; bad = 1 }
    printf "%d of %d fallible functions name their codes\n", told, total
    exit bad
}' "$@"
