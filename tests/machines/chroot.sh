# shellcheck shell=bash
# Source this: a Debian in a folder, made by debootstrap, and commands in it. Needs root.
#   chroot_make SUITE FOLDER [BASE]    BASE: a debootstrap of before, which is copied and not changed
#   chroot_inside FOLDER COMMAND...    as root, with nothing of this machine's environment; CHROOT_BIND=FROM:TO[,...] are folders of
#                                      this machine that it sees
#
# SPDX-License-Identifier: Apache-2.0
chroot_make() { # the log is in FOLDER.log
    local mirror
    if [ -n "${3:-}" ]; then
        cp -a "$3" "$2"
    else
        mirror=$(sed -n 's/^URIs: *\(\S*\)$/\1/p; s/^deb \(\[.*\] \)\?\(\S*\) .*/\2/p' /etc/apt/sources.list /etc/apt/sources.list.d/debian* 2>/dev/null | head -1 || true)
        debootstrap --variant=minbase "$1" "$2" "${mirror:-http://deb.debian.org/debian}" >"$2.log" 2>&1 || { tail -20 "$2.log"; return 1; }
    fi
    cp /etc/resolv.conf "$2/etc/resolv.conf"
    # Certificates that this machine trusts beside Debian's: npm's registry may be behind a proxy of its own.
    [ ! -f "${NODE_EXTRA_CA_CERTS:-}" ] || cp "$NODE_EXTRA_CA_CERTS" "$2/etc/extra-ca.crt"
}

# Namespaces of its own for mounts and processes: nothing has to be undone. The program finds its folder by /proc/self/exe, and PoCL
# its cores in /sys.
chroot_inside() {
    local root=$1
    shift
    # shellcheck disable=SC2016
    unshare --mount --pid --fork --kill-child sh -euc '
        root=$0 binds=$1
        shift
        mount -t proc proc "$root/proc"
        mount --rbind /sys "$root/sys"
        mount --rbind /dev "$root/dev"
        IFS=,
        for bind in $binds; do
            mkdir -p "$root${bind#*:}"
            mount --bind "${bind%%:*}" "$root${bind#*:}"
        done
        exec chroot "$root" env -i PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8 \
            DEBIAN_FRONTEND=noninteractive NODE_EXTRA_CA_CERTS=/etc/extra-ca.crt "$@"' "$root" "${CHROOT_BIND:-}" "$@"
}
