# Source this: checks of shell tests. Needs $work, a scratch folder; what failed is shown with $work/log*.
#
# SPDX-License-Identifier: Apache-2.0
failed=0
check() { # NAME CONDITION...
    name=$1
    shift
    if "$@" >"$work/check" 2>&1; then
        echo "ok   $name"
    else
        failed=$((failed + 1))
        echo "FAIL $name: $*"
        sed 's/^/  | /' "$work/check" "$work"/log* | tail -20
    fi
}
