#!/usr/bin/env bash
# hosts.sh: the recipes of docs/scale.md for hosts without a scheduler, GNU parallel and ssh alone, word by word from the
# page. Two hosts are an ssh server on this one.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/machines/machines.sh
. "$(dirname "$0")/machines.sh"
need sshd openssh-server
need ssh openssh-client
need parallel parallel
trap 'kill ${server:-} 2>/dev/null; wait; rm -rf "$work"' EXIT

recipe() { # HEADING: the commands that stand under it
    awk -v heading="### $1" '$0 == heading { on = 1; next } /^##/ { on = 0 } on && /^```/ { code = !code; next } on && code' "$root/docs/scale.md"
}

# ---- two hosts ----

port=$(perl -MIO::Socket::INET -e 'print IO::Socket::INET->new(Listen => 1, LocalAddr => "127.0.0.1")->sockport')
mkdir -p "$work"/{path,ssh} /run/sshd 2>/dev/null
ssh-keygen -q -t ed25519 -N '' -f "$work/ssh/host" && ssh-keygen -q -t ed25519 -N '' -f "$work/ssh/user" || exit 1
cp "$work/ssh/user.pub" "$work/ssh/allowed"
cat >"$work/path/citysplat" <<END
#!/bin/sh
# Tells who trained what, with the options that make it small.
case "\$*" in *'--cell '*) echo "\${SSH_CONNECTION:-here} \$*" >>"$work/calls" ;; esac
cmd=\$1
shift
[ "\$cmd" != train ] || set -- "\$@" ${short[*]} --threads 1
exec "$bin" "\$cmd" "\$@"
END
cat >"$work/ssh/server" <<END
Port $port
ListenAddress 127.0.0.1
HostKey $work/ssh/host
AuthorizedKeysFile $work/ssh/allowed
PidFile none
StrictModes no
UsePAM no
SetEnv PATH=$work/path:$PATH
END
cat >"$work/ssh/client" <<END
Host one two
HostName 127.0.0.1
Port $port
IdentityFile $work/ssh/user
UserKnownHostsFile $work/ssh/known
StrictHostKeyChecking accept-new
END
printf '#!/bin/sh\nexec %s -F %s "$@"\n' "$(command -v ssh)" "$work/ssh/client" >"$work/path/ssh"
chmod 755 "$work" "$work"/path/*
"$(PATH=$PATH:/usr/sbin command -v sshd)" -D -e -f "$work/ssh/server" 2>"$work/log.sshd" & server=$!
export PATH=$work/path:$PATH
for _ in $(seq 100); do ssh one true 2>/dev/null && break; sleep 0.1; done
check 'a host answers' ssh two true
[ $failed = 0 ] || { echo 'skipped: sshd does not run for this user'; exit 77; }

# ---- a city ----

city_in_cells 40 120 70
check 'the city has cells' [ ${#cells[@]} -ge 4 ]
check 'one process' "$bin" train "$work/scene" "${short[@]}" -o "$work/whole"
want=$(revision whole --trained "$work/whole")
cd "$work" || exit 1
printf 'one\ntwo\n' >hosts.txt

for name in 'GNU parallel, over ssh' 'Hosts by ssh alone'; do
    rm -rf scene/cells city.tiles calls
    recipe "$name" >recipe
    check "$name: the page has it" grep -q ssh recipe
    sh ./recipe >"$work/log" 2>&1
    check 'it ends' [ $? = 0 ]
    check 'every cell was trained at a host' [ "$(grep -v '^here' calls | grep -o -e '--cell [^ ]*' | sort -u | wc -l)" = ${#cells[@]} ]
    check 'every level has the bytes of one process' same_levels "$work/whole" "$work/scene"
    check 'and the tiles have its revision' [ "${want:-none}" = "$("$bin" info city.tiles | sed -n 's/^revision *//p')" ]
done
[ $failed = 0 ] || { echo "$failed checks failed"; exit 1; }
