#!/bin/sh
# size.sh: how large the repository is: lines of code without comments and blank lines, options, folders, modules, pages,
# files. It counts what git tracks, and prints a table.
#
# SPDX-License-Identifier: Apache-2.0
cd "$(dirname "$0")/.." || exit 1
code() { # FILE...: lines that are neither blank nor comment
    awk 'FNR == 1 { inside = 0; hash = FILENAME ~ /\.(sh|py|cmake)$/ || FILENAME !~ /\./ }
        { t = $0
          if (inside) { if (!(i = index(t, "*/"))) next; t = substr(t, i + 2); inside = 0 }
          while (!hash && (i = index(t, "/*"))) {
              if (!(j = index(substr(t, i + 2), "*/"))) { t = substr(t, 1, i - 1); inside = 1; break }
              t = substr(t, 1, i - 1) substr(t, i + 3 + j) }
          if (t ~ (hash ? "^[ \t]*#" : "^[ \t]*//") || t !~ /[^ \t]/) next
          n++ }
        END { print n + 0 }' "$@"
}
row() { printf '%-46s %s\n' "$1" "$2"; }
files() { git ls-files "$@"; }
ends='\.(c|cc|h|cl|def|ts|tsx|mjs|html|css|sh|py)$'
product='core codec render lod scene train survey server cli web'
# shellcheck disable=SC2046,SC2086
{
    row 'lines of code, product' "$(code $(files $product | grep -E "$ends"))"
    for f in $product; do row "  $f" "$(code $(files $f | grep -E "$ends"))"; done
    row 'lines of code, laboratory' "$(code $(files lab | grep -E "$ends"))"
    row 'lines of code, tests' "$(code $(files tests | grep -E "$ends"))"
    row 'options in tables, without lab/ and tests/' "$(cat $(files '*.def' | grep -v '^lab/\|^tests/') | grep -c '^OPT(')"
    row '  of them of citysplat-lab synth' "$(grep -c '^OPT(' scene/synth/synth_vary.def)"
    row '  train' "$(grep -c '^OPT(' train/base/options.def)"
    row '  serve' "$(grep -c '^OPT(' server/base/options.def)"
    row 'folders at the top' "$(files | sed -n 's|/.*||p' | grep -v '^\.' | sort -u | wc -l)"
    row 'modules in the fullest folder or room' "$(files $product lab | grep -E '\.(c|cc)$' |
        awk '{ sub("/[^/]*$", ""); n[$0]++ } END { for (d in n) print n[d], d }' | sort -rn | head -1)"
    row 'pages in docs/' "$(files 'docs/*.md' | grep -c '^docs/[^/]*$')"
    row 'decisions' "$(files 'docs/decisions/[0-9]*.md' | wc -l)"
    row 'lines of docs/, decisions included' "$(cat $(files 'docs/*.md') | wc -l)"
    row 'files' "$(files | wc -l)"
}
