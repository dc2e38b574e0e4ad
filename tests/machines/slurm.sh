#!/usr/bin/env bash
# slurm.sh: configs/slurm on a cluster of two nodes that lives on this host (slurmctld, two slurmd, munge; no root and no
# systemd are needed). Eight cells and their coarse model are jobs of one graph. One node dies with everything on it while it
# trains a cell: the cell goes on at the other node, and the tiles are those of a single process. Another job runs into its
# time limit: it saves its state and queues itself again.
#
# SPDX-License-Identifier: Apache-2.0
set -u
# shellcheck source=tests/machines/machines.sh
. "$(dirname "$0")/machines.sh"
need slurmctld slurmctld
need slurmd slurmd
need sbatch slurm-client
need munged munge
export PATH=$PATH:/usr/sbin
daemons=()
trap 'slurm_end' EXIT
slurm_end() {
    scancel -u "$(id -un)" 2>/dev/null && sleep 2
    for p in $(processes_on n1) $(processes_on n2) "${daemons[@]}"; do kill -9 "$p" 2>/dev/null; done
    wait 2>/dev/null
    [ -z "${KEEP:-}" ] || cp -r "$work"/{log*,slurm,*.log} "$KEEP"
    rm -rf "$work"
}
processes_on() { # NODE: of its jobs, with the daemon of each (slurmstepd); of this cluster alone
    local pid
    for pid in $(grep -lzxs "SLURMD_NODENAME=$1" /proc/[0-9]*/environ | xargs -r grep -lzxs "SLURM_SUBMIT_DIR=$work" | cut -d/ -f3); do
        echo "$pid"
        pid=$(ps -o ppid= -p "$pid" | tr -d ' ')
        [ "$(cat "/proc/${pid:-none}/comm" 2>/dev/null)" != slurmstepd ] || echo "$pid"
    done | sort -u
}

# ---- the cluster ----

s=$work/slurm
export SLURM_CONF=$s/slurm.conf
mkdir -p "$s"/{munge,ctl,n1,n2}
chmod 755 "$work" "$s" "$s/munge"
head -c 1024 /dev/urandom >"$s/munge/key"
chmod 400 "$s/munge/key"
free_port() { perl -MIO::Socket::INET -e 'print IO::Socket::INET->new(Listen => 1, LocalAddr => "127.0.0.1")->sockport'; }
cat >"$SLURM_CONF" <<END
ClusterName=loop
SlurmctldHost=$(hostname)(127.0.0.1)
SlurmctldPort=$(free_port)
SlurmUser=$(id -un)
SlurmdUser=$(id -un)
AuthType=auth/munge
CredType=cred/munge
# A job that was requeued waits as long.
AuthInfo=socket=$s/munge/socket,cred_expire=5
StateSaveLocation=$s/ctl
SlurmctldPidFile=$s/ctl/pid
SlurmctldLogFile=$s/ctl/log
SlurmdSpoolDir=$s/%n
SlurmdPidFile=$s/%n/pid
SlurmdLogFile=$s/%n/log
# The nodes have what this file says, not what the host has.
SlurmdParameters=config_overrides
SlurmdTimeout=9
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
SwitchType=switch/none
MpiDefault=none
SchedulerParameters=sched_interval=1,bf_interval=1,batch_sched_delay=0
GresTypes=gpu
NodeName=n1 NodeHostname=$(hostname) NodeAddr=127.0.0.1 Port=$(free_port) CPUs=2 RealMemory=8000 Gres=gpu:1
NodeName=n2 NodeHostname=$(hostname) NodeAddr=127.0.0.1 Port=$(free_port) CPUs=1 RealMemory=8000 Gres=gpu:1
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
END
echo 'NodeName=n1,n2 Name=gpu File=/dev/null' >"$s/gres.conf"
munged -F --force --key-file="$s/munge/key" --socket="$s/munge/socket" --pid-file="$s/munge/pid" \
    --log-file="$s/munge/log" --seed-file="$s/munge/seed" >"$s/munge/out" 2>&1 & daemons+=($!)
until_true() { # SECONDS COMMAND...
    local end=$((SECONDS + $1))
    shift
    until "$@"; do [ $SECONDS -lt $end ] || return 1; sleep 0.3; done
}
until_true 30 test -S "$s/munge/socket" || { cat "$s/munge/out"; exit 1; }
slurmctld -D >"$s/ctl/out" 2>&1 & daemons+=($!)
slurmd -D -N n1 >"$s/n1/out" 2>&1 & daemons+=($!)
slurmd -D -N n2 >"$s/n2/out" 2>&1 & daemons+=($!)
node2=$!
idle() { [ "$(sinfo -h -o '%T %D' 2>/dev/null)" = 'idle 2' ]; }
check 'two nodes are there' until_true 120 idle
[ $failed = 0 ] || { tail -n 20 "$s"/*/out "$s"/*/log; exit 1; }

# ---- the city ----

city_in_cells 64 160 95
# Longer than elsewhere: a node must die in the middle of a cell.
short+=(--iterations 1200 --checkpoint-interval 20)
n=${#cells[@]}
check 'the city has eight cells' [ "$n" = 8 ]
check 'one process' "$bin" train "$work/scene" "${short[@]}" -o "$work/whole"
want=$(revision whole --trained "$work/whole")
mkdir "$work/path"
ln -s "$bin" "$work/path/citysplat"
export PATH=$work/path:$PATH
cd "$work" || exit 1

field() { scontrol show job "$1" 2>/dev/null | tr ' ' '\n' | sed -n "s/^$2=//p" | head -1; } # JOB NAME
long=$(sbatch --parsable --nodelist=n1 --cpus-per-task=1 --mem=500M --time=3 "$root/configs/slurm/train.sbatch" "$work/scene" "${cells[0]}" \
    --level-count 1 --iterations 900000 --budget 300 --no-coarse-start --checkpoint-interval 1000000 -o "$work/long")
"$root/configs/slurm/submit.sh" --cores 1 --gres gpu:1 "$work/scene" "$work/city.tiles" "${short[@]}" >"$work/log" 2>&1
check 'a coarse model, the cells and the tiles are queued' grep -Eq "^coarse model: job [0-9]+; $n cells: jobs [0-9:]+; tiles: job [0-9]+" "$work/log"
read -r coarse all tiles < <(sed -n 's/^coarse model: job \([0-9]*\);.*jobs \([0-9:]*\); tiles: job \([0-9]*\)$/\1 \2 \3/p' "$work/log")
IFS=: read -ra jobs <<<"${all:-}"
check 'a cell asks for the memory of the plan' [ "$(field "${jobs[0]}" MinMemoryNode)" = \
    "$(awk -F'\t' 'NR == 1 { printf "%dM", $5 * 1.1 + 256 }' <("$bin" train "$work/scene" "${short[@]}" --list))" ]
check 'for its time' [ "$(field "${jobs[0]}" TimeLimit)" = 00:10:00 ]
check 'and for a GPU' [ "$(field "${jobs[0]}" TresPerNode)" = gres:gpu:1 ]

# ---- a node dies ----

victim() { # a job that trains on n2 and has a state to go on from; its processes, stopped, in dead[]
    job=$(squeue -h -w n2 -t R -o %i | head -1)
    [ "$job" ] && [ "$job" != "$coarse" ] || return 1
    cell=$(field "$job" JobName)
    cell=${cell#citysplat-}
    [ -e "$work/scene/cells/$cell/resume.ckpt" ] || return 1
    mapfile -t dead < <(processes_on n2)
    [ ${#dead[@]} -ge 3 ] || return 1 # slurmstepd, the script, the program
    kill -STOP "${dead[@]}" 2>/dev/null && [ -e "$work/scene/cells/$cell/resume.ckpt" ] && return
    kill -CONT "${dead[@]}" 2>/dev/null # it was over
    return 1
}
check 'a cell trains on the second node' until_true 900 victim
kill -9 "$node2" "${dead[@]}"
wait "$node2" 2>/dev/null
echo "slurm: node n2 dies with ${#dead[@]} processes, in cell $cell (job $job)"
requeued() { [ "$(field "$job" Restarts)" = 1 ]; }
check 'its job is queued again' until_true 240 requeued
ended() { case $(field "$tiles" JobState) in COMPLETED | FAILED | CANCELLED | TIMEOUT | '') ;; *) return 1 ;; esac; }
check 'the graph ends' until_true 1800 ended
check 'with tiles' [ "$(field "$tiles" JobState)" = COMPLETED ]
check 'the job went on at the other node' [ "$(field "$job" NodeList)" = n1 ]
check 'from where it was' grep -q '"event":"resume"' "$work/scene/cells/$cell/metrics.jsonl"
check 'no other job was started twice' [ "$(for j in "$coarse" "${jobs[@]}"; do field "$j" Restarts; done | sort | uniq -c | xargs)" = "$n 0 1 1" ]
check 'every level has the bytes of one process' same_levels "$work/whole" "$work/scene"
check 'and the tiles have its revision' [ "${want:-none}" = "$(revision city)" ]

# ---- a time limit ----

again() { [ "$(field "$long" Restarts)" -ge 1 ] 2>/dev/null; }
check 'a job asks to run again before its time is over' until_true 240 again
check 'its state is saved' grep -q 'the state is saved' "$work/citysplat-train-$long.log"
goes_on() { grep -q '"event":"resume"' "$work/long/cells/${cells[0]}/metrics.jsonl"; }
check 'and it goes on from there' until_true 240 goes_on
[ $failed = 0 ] || { echo "$failed checks failed"; exit 1; }
