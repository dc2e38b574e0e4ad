#!/bin/sh
# One dialect of C:
#   sizeof   sizeof x, without parentheses, unless it is a type or an expression that needs them
#   ok       !rc and rc, not rc == ERR_OK and rc != ERR_OK
#   static   a static function is named after its file (not in main.c and tests): the stem, or the stem's first or last word, and an underscore
#   ruler    /* ---- text ---- */ on one line
# tests/dialect_todo.txt lists folders that do not keep a rule yet, as "RULE FOLDER"; it may only get shorter.
#
#   tests/test_dialect.sh [FILE...]   what is otherwise in these files, without exemptions
#
# SPDX-License-Identifier: Apache-2.0
cd "$(dirname "$0")/.." || exit 1
todo=tests/dialect_todo.txt
[ $# -eq 0 ] || todo=
# shellcheck disable=SC2046 # names of files are words
[ $# -gt 0 ] || set -- $(find core codec render scene lod train server cli lab tests -name node_modules -prune \
    -o \( -name '*.[ch]' -o -name '*.cc' \) -print 2>/dev/null | sort)
awk -v todo="$todo" '
BEGIN {
    while (todo != "" && (getline line < todo) > 0)
        if (line !~ /^#/ && line != "") open[line] = 1
    type = "^sizeof\\((const )?(struct|union|enum|unsigned|signed|char|short|int|long|float|double|void|bool|FILE|[a-z0-9_]+_t|cl_[a-z0-9_]+|va_list|[A-Z_0-9]+)[ *)[]"
    plain = "^sizeof\\((\"[^\"]*\"|[*&]*[a-zA-Z_][a-zA-Z_0-9]*((\\.|->)[a-zA-Z_0-9]+|\\[[^]]*\\])*)\\)"
}
function other(rule, what,    row) {
    row = rule " " folder
    if (row in open) { open[row] = 2; return }
    print FILENAME ":" FNR ": " what; bad = 1
}
FNR == 1 {
    folder = FILENAME; sub(/\/.*/, "", folder)
    stem = FILENAME; sub(/.*\//, "", stem); sub(/(_shim)?\.(c|h|cc)$/, "", stem); sub(/^(bench|test)_/, "", stem)
    words = split(stem, word, "_")
}
# Arguments of macros are left alone: they may be expressions.
/sizeof\(/ && !/^#define|\\$/ {
    line = $0
    while ((at = index(line, "sizeof(")) > 0) {
        line = substr(line, at)
        if (line !~ type && line ~ plain) { match(line, plain); other("sizeof", substr(line, 1, RLENGTH)) }
        line = substr(line, 7)
    }
}
/(^|[^a-z_.>])rc (==|!=) ERR_OK/ { other("ok", "rc compared with ERR_OK") }
/\/\* -----* / && !/ -----* \*\/$/ { other("ruler", "a ruler is /* ---- text ---- */ on one line") }
/^(SIMD_WIDE )?static / && /\(/ && folder != "tests" && stem != "main" {
    name = $0; sub(/\(.*/, "", name); sub(/^.*[ *]/, "", name)
    if ($0 ~ /=/ || name !~ /^[a-z]/ || name == "__attribute__") next
    if (name != stem && index(name, stem "_") != 1 && name != word[1] && index(name, word[1] "_") != 1 && name != word[words] && index(name, word[words] "_") != 1)
        other("static", name " is not named after " FILENAME)
}
END {
    for (row in open) if (open[row] == 1) { print todo ": \"" row "\" is kept now: take the line out"; bad = 1 }
    exit bad
}' "$@" && echo "one dialect in $# files"
