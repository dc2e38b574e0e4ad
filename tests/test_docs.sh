#!/bin/sh
# What documents point at is there: files behind relative links, headings behind #anchors, sources that are named, and in
# every quoted `citysplat COMMAND --option` the command and the option. Decisions have the same parts and stand in their index.
#
# SPDX-License-Identifier: Apache-2.0
cd "$(dirname "$0")/.." || exit 1
work=$(mktemp -d "${TMPDIR:-/tmp}/citysplat-docs-XXXXXX") || exit 1
trap 'rm -rf "$work"' EXIT
find . \( -name node_modules -o -name build -o -name out -o -name .git \) -prune -o -name '*.md' -print | sed 's|^\./||' | sort >"$work/files"
failed=0

# Links: FILE LINE TARGET, and the anchors that headings make.
xargs awk '
FNR == 1 { fence = 0 }
/^ *```/ { fence = !fence; next }
fence { next }
/^#+ / {
    slug = tolower($0); sub(/^#+ +/, "", slug); gsub(/[^a-z0-9 _-]/, "", slug); gsub(/ /, "-", slug)
    print "anchor\t" FILENAME "#" slug
}
{
    line = $0; gsub(/`[^`]*`/, "", line)
    while (match(line, /\]\([^) ]+/)) {
        print "link\t" FILENAME "\t" FNR "\t" substr(line, RSTART + 2, RLENGTH - 2)
        line = substr(line, RSTART + RLENGTH)
    }
}' <"$work/files" >"$work/found"
grep '^anchor' "$work/found" | cut -f2 >"$work/anchors"
grep '^link' "$work/found" | cut -f2- >"$work/links"
# No process a link: there are a thousand.
while IFS='	' read -r file line target; do
    case $target in *://* | mailto:*) continue ;; esac
    path=${target%%#*}
    case $path,$file in
        ,*) path=$file ;;
        *,*/*) path=${file%/*}/$path ;;
    esac
    if [ ! -e "$path" ]; then
        echo "$file:$line: $target leads nowhere"
        failed=1
        continue
    fi
    case $target in
        *.md\#* | \#*)
            case $path in *..*) path=$(realpath --relative-to=. "$path") ;; esac
            printf '%s:%s: %s\t%s\n' "$file" "$line" "$target" "$path#${target#*#}" >>"$work/wanted" ;;
    esac
done <"$work/links"
awk -F'\t' 'NR == FNR { there[$0]; next } !($2 in there) { print $1 ": no such heading"; bad = 1 } END { exit bad }' \
    "$work/anchors" "$work/wanted" || failed=1
# Sources by their path, also in the scripts of pages. codec/splat/xyz is the example of docs/architecture.md.
{ grep -v '^CHANGELOG.md$' "$work/files"; ls tests/web/*.mjs lab/web/*.mjs; } | xargs grep -noHE \
    '(core|codec|render|lod|scene|train|survey|server|cli|lab|tests|configs|web)/[a-z0-9_./]*[a-z0-9_]\.(c|h|cl|cc|def|sh|jsonc|mjs|ts|tsx|html|css|txt|md)\b' |
    grep -vE ':(codec/splat/xyz\.[ch]|scene/.*\.jsonc?|web/dist/.*)$' >"$work/sources"
while IFS=: read -r file line path; do
    [ -e "$path" ] || { echo "$file:$line: there is no $path"; failed=1; }
done <"$work/sources"
echo "$(wc -l <"$work/links") links in $(wc -l <"$work/files") documents"

# FILE LINE COMMAND OPTION, an empty option for the command itself. Blocks of code, with lines that go on after a
# backslash, and spans of code, which may go over the end of a line.
xargs awk '
function quoted(text, at,    n, k, word, command) {
    n = split(text, word, /[ \t]+/); command = ""
    for (k = 1; k <= n; k++) {
        if (word[k] ~ /^#/) return
        if (word[k] ~ /(^|[\/$(])citysplat-lab$/) {
            if (word[k + 1] ~ /^[a-z]+(-[a-z]+)?$/) print FILENAME "\t" at "\t-lab " word[k + 1] "\t"
            command = "-lab"
        } else if (word[k] ~ /(^|[\/$(])(citysplat|bootstrap)$/ && word[k - 1] != "comment") {
            command = word[k + 1]
            if (command !~ /^[a-z]+(-[a-z]+)?$/) command = ""
            else if (word[k] ~ /bootstrap$/) { print FILENAME "\t" at "\tbootstrap " command "\t"; command = "" }
            else print FILENAME "\t" at "\t" command "\t"
        } else if (word[k] ~ /^[|;&]|[;|]$/) {
            command = ""
        } else if (command != "" && match(word[k], /^[[]?--[a-z][a-z0-9-]*/)) {
            print FILENAME "\t" at "\t" command "\t" substr(word[k], index(word[k], "--"), RLENGTH - index(word[k], "--") + 1)
        }
    }
}
FNR == 1 { fence = 0; held = ""; span = "" }
/^ *```/ { fence = !fence; held = span = ""; next }
fence || /^    / {
    held = held (held == "" ? "" : " ") $0
    if (sub(/\\$/, "", held)) next
    quoted(held, FNR); held = ""; next
}
/^[ \t]*$/ { span = ""; next }
{
    line = span (span == "" ? "" : " ") $0; span = ""
    while ((a = index(line, "`")) > 0) {
        rest = substr(line, a + 1); b = index(rest, "`")
        if (!b) { span = substr(line, a); break }
        quoted(substr(rest, 1, b - 1), FNR)
        line = substr(rest, b + 1)
    }
}' <"$work/files" | sort -u -t'	' -k3,4 >"$work/quoted"
# What there is: docs/commands.md, which tests/test_reference.sh compares with the program; the tables of commands and
# options of citysplat-lab; the usage of bootstrap.
{
    printf 'help\t--markdown\nhelp\t--man\nhelp\t\ncompletion\t\n'
    awk '
    /^## citysplat / { command = $3; for (k = split("--config --print-config --help", all, " "); k; k--) print command "\t" all[k]; print command "\t" }
    command != "" && match($0, /^\| `--[a-z0-9-]+`/) { print command "\t" substr($0, 4, RLENGTH - 4) }' docs/commands.md
    printf -- '-lab help\t\n-lab\t--help\n-lab\t--config\n'
    sed -n 's/^COMMAND([a-z_]*, "\([a-z-]*\)".*/-lab \1\t/p; s/^BENCH[A-Z_]*(\([a-z]*\),.*/-lab \1\t/p' lab/*.def lab/*/*.def
    sed -n 's/^OPT([A-Z]*, [A-Z]*, *\([a-z_0-9]*\),.*/\1/p' lab/*/*.def cli/train/eval_city.def scene/synth/*.def | sed 's/_/-/g; s/.*/-lab\t--&\n-lab\t--no-&/'
    ./bootstrap help | sed -n 's|^ *\./bootstrap \([a-z]*\).*|bootstrap \1\t|p'
} >"$work/known"
awk -F'\t' 'NR == FNR { known[$1, $2]; next }
    !(($3, $4) in known) {
        program = $3 ~ /^bootstrap/ ? $3 : $3 ~ /^-/ ? "citysplat" $3 : "citysplat " $3
        if (!(($3, "") in known) && $3 !~ /^-/) print $1 ":" $2 ": there is no command " program
        else if ($4 != "") print $1 ":" $2 ": " program " has no option " $4
        else next
        bad = 1
    }
    END { exit bad }' "$work/known" "$work/quoted" || failed=1
# Decisions: number, date, status, context, decision, consequences, and a row in the index with the same date.
awk '
function close_page(    k) {
    for (k = 1; k in part; k++) if (!(k in seen)) { print page ": lacks \"" part[k] "\""; bad = 1 }
    row = "| [" number "](" name ") | " day " |"
    if (page != "" && !index(index_text, row)) { print page ": no row of number and date in docs/decisions/README.md"; bad = 1 }
}
FILENAME == "docs/decisions/README.md" { index_text = index_text $0 "\n"; next }
FNR == 1 {
    if (page != "") close_page()
    page = FILENAME; name = page; sub(/.*\//, "", name); number = substr(name, 1, 3); day = ""; delete seen
    split("^# " number ": .|^Date: 20[0-9][0-9]-[01][0-9]-[0-3][0-9]$|^Status: .|^## Context$|^## Decision$|^## Consequences$", part, "|")
}
{ for (k = 1; k in part; k++) if ($0 ~ part[k]) seen[k] }
/^Date: [0-9-]*$/ { day = substr($0, 7) }
END { close_page(); exit bad }' docs/decisions/README.md docs/decisions/[0-9]*.md || failed=1
[ "$(wc -l <"$work/quoted")" -gt 50 ] || { echo "only $(wc -l <"$work/quoted") quoted commands were found"; failed=1; }
echo "$(wc -l <"$work/quoted") quoted commands and options"
exit $failed
