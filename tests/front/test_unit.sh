#!/usr/bin/env bash
# configs/citysplat.service, citysplat.socket and serve.jsonc as they are shipped, in a systemd of its own: this system's
# files under an overlay, booted by systemd-nspawn. With no store, with broken ones, with a wrong
# configuration, after kill -9, over a restart, and stopped. Needs root, and cgroups that may be written.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/front/front.sh
. "$(dirname "$0")/front.sh"
need systemd-nspawn systemd-container
need curl curl
[ "$(id -u)" = 0 ] || skip 'not root, which systemd-nspawn needs'
trap 'front_end' EXIT

row() { :; } # of docs/operations.md: what is made to happen inside
row 'clients wait, and `NRestarts` grows'
row '`systemctl stop citysplat` does not stop it'

# What runs inside, after the sockets are there. Its output is the test's.
cat >"$work/inside.sh" <<'INSIDE'
failed=0
check() { local what=$1; shift; if "$@"; then echo "ok: $what"; else echo "FAILED: $what"; failed=1; fi; }
is() { [ "$1" = "$2" ] || { echo "  is '$1', want '$2'"; return 1; }; }
at_least() { [ "${1:-0}" -ge "$2" ] || { echo "  is '$1', want at least $2"; return 1; }; }
status() { curl -s -o /dev/null --max-time 20 -w '%{http_code}' "$@"; }
until_is() { # WANT COMMAND...: within twenty seconds
    local want=$1 k got
    shift
    for k in $(seq 200); do got=$("$@"); [ "$got" != "$want" ] || return 0; sleep 0.1; done
    echo "  is '$got', want '$want'"
    return 1
}
of() { systemctl show -P "$1" "citysplat.${2:-service}"; }
here=http://127.0.0.1:8080 admin=http://127.0.0.1:8078 stores=/var/lib/citysplat
datasets() { curl -s --max-time 20 $here/version | tr ',{}' '\n\n\n' | grep -cE '"[a-z0-9]+": *"[0-9a-f]{12}"'; }
put() { install -m 644 /check/toy.tiles $stores/part && mv $stores/part "$stores/$1.tiles"; }

useradd --system --user-group --home-dir /var/lib/citysplat --shell /usr/sbin/nologin citysplat
install -D -m 644 /check/serve.jsonc /etc/citysplat/serve.jsonc
systemctl start citysplat.socket
check 'nothing runs before somebody asks' is "$(of ActiveState)" inactive
check 'with no store it starts' is "$(status $here/healthz)" 200
check 'and says that it has none' at_least "$(curl -s $admin/readyz | grep -c empty)" 1
check 'it runs as its own user' is "$(ps -o user= -p "$(of MainPID)")" citysplat

put toy
systemctl reload citysplat
check 'a store that was added is served after a reload' until_is 200 status $here/d/toy/tileset.json
pid=$(of MainPID)
head -c 5000 /check/toy.tiles >$stores/broken.tiles
mkfifo $stores/fifo.tiles
mkdir $stores/folder.tiles
install -m 600 -o root /check/toy.tiles $stores/secret.tiles
systemctl restart citysplat
check 'with a truncated store, a FIFO, a folder and one that it may not read, the others are served' is "$(status $here/d/toy/tileset.json)" 200
check 'ready, and degraded' is "$(curl -s -w '%{http_code}' $admin/readyz | tr -d '\n' | grep -c '"degraded".*200$')" 1
for name in broken fifo folder secret; do check "readiness names $name.tiles" at_least "$(curl -s $admin/readyz | grep -c "$name.tiles")" 1; done
check 'no request was lost over the restart, and the process is another' test "$pid" != "$(of MainPID)"
rm -r $stores/{broken,fifo,folder,secret}.tiles

kill -9 "$(of MainPID)"
check 'killed, it is back' is "$(status $here/d/toy/tileset.json)" 200
check 'the socket was there all the time' is "$(of ActiveState socket)" active

# Wrong options: it goes on trying, and starts when they are right.
cp /etc/citysplat/serve.jsonc /tmp/right
echo '{"no_such_option": 1}' >/etc/citysplat/serve.jsonc
systemctl restart citysplat 2>/dev/null
starts=$(of NRestarts)
sleep 13
check 'wrong options: it tries again and again' at_least "$(($(of NRestarts) - starts))" 3
check 'wrong options: neither has failed for good' is "$(of ActiveState) $(of ActiveState socket)" 'activating active'
check 'the journal has the reason under our name' at_least "$(journalctl -t citysplat --no-pager | grep -c no_such_option)" 1
cp /tmp/right /etc/citysplat/serve.jsonc
check 'right again: it is there, and nobody did anything' is "$(status --retry 5 --retry-all-errors $here/d/toy/tileset.json)" 200

# A secret of the group.
install -m 640 -o root -g citysplat /check/auth.jsonc /etc/citysplat/auth.jsonc
sed -i 's|// "auth"|"auth"|' /etc/citysplat/serve.jsonc
systemctl restart citysplat
check 'a secret of root and the group, 0640' is "$(status $here/d/toy/tileset.json)" 401
cp /tmp/right /etc/citysplat/serve.jsonc
systemctl restart citysplat

check 'the process that draws may be killed for memory, and the others stay' is "$(of OOMPolicy)" continue
check 'stopped alone, the socket starts the next' is "$(systemctl stop citysplat 2>/dev/null; of ActiveState; of ExecMainStatus; status $here/healthz)" "$(printf 'inactive\n0\n200')"
check 'the socket stopped: both are' is "$(systemctl stop citysplat.socket; status $here/healthz; sleep 1; of ActiveState; of ActiveState socket)" "$(printf '000inactive\ninactive')"
systemctl start citysplat
check 'started, the socket is there as well' is "$(status $here/healthz) $(of ActiveState socket)" '200 active'
check 'it ended in order' is "$(systemctl stop citysplat.socket; of ExecMainStatus)" 0
echo "inside: failed $failed"
[ $failed = 0 ] || journalctl -t citysplat --no-pager | tail -60
INSIDE

printf '{"tokens": [{"sha256": "%064d", "scope": ["read:toy"]}]}' 0 >"$work/auth.jsonc"
cp "$root/configs/serve.jsonc" "$work/"
mkdir "$work/root"
cat >"$work/check.service" <<END
[Unit]
Requires=basic.target
After=basic.target
[Service]
Type=oneshot
ExecStart=/bin/bash /check/inside.sh
StandardOutput=append:/check/out
StandardError=append:/check/out
ExecStopPost=/bin/systemctl exit --force
TimeoutStartSec=100
END
: >"$work/out"
# The mount is of a namespace of its own, and is gone with it.
# shellcheck disable=SC2016
timeout 110 unshare --mount bash -c '
    mount --make-rprivate / && mount --bind / "$1/root" || exit 1
    ip link set lo up 2>/dev/null
    exec systemd-nspawn --quiet --directory="$1/root" --volatile=overlay --boot --register=no --keep-unit --private-network --machine=citysplat-$$ \
        --bind="$1:/check" --bind-ro="$1/check.service:/etc/systemd/system/check.service" \
        --bind-ro="$2/configs/citysplat.service:/etc/systemd/system/citysplat.service" \
        --bind-ro="$2/configs/citysplat.socket:/etc/systemd/system/citysplat.socket" \
        --bind-ro="$3:/usr/local/bin" systemd.unit=check.service' bash "$work" "$root" "$(dirname "$bin")" >"$work/boot" 2>&1 </dev/null
grep -q . "$work/out" || { tail -5 "$work/boot"; skip 'systemd does not boot here in a namespace'; }
cat "$work/out"
check 'it went through' grep -qx 'inside: failed 0' "$work/out"
exit $failed
