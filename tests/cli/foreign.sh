# shellcheck shell=bash
# Source this: cases of foreign files and what is printed for them. It wants $work, a folder to write to, and
# place NAME, which prints the folder in which a case's command runs. It counts in $passed and $failed.
#
# SPDX-License-Identifier: Apache-2.0
failed=0 passed=0

# is NAME EXIT PATTERNS COMMAND...: each line of PATTERNS must match what is printed.
is() {
  local name=$1 want=$2 patterns=$3 rc why=
  shift 3
  (cd "$(place "$name")" && "$@") >"$work/log" 2>&1 </dev/null
  rc=$?
  [ "$rc" = "$want" ] || why="exit code $rc, want $want"
  while IFS= read -r line; do
    grep -Eq -- "$line" "$work/log" || why="$why; nothing matches '$line'"
  done <<<"$patterns"
  if [ -n "$why" ]; then
    failed=$((failed + 1))
    printf 'FAIL %s: %s\n  ran: %s\n' "$name" "$why" "$*"
    tail -12 "$work/log" | sed 's/^/  | /'
  else
    passed=$((passed + 1))
    printf 'ok   %s: %s\n' "$name" "$(grep -E -m1 -- "$(head -1 <<<"$patterns")" "$work/log" | cut -c1-140)"
  fi
}
