#!/bin/sh
# The job script for farms on a Slurm of one node, which is started here: plan, shards, a garment
# that fails for now, one report. usage: slurm.sh PROXYCLOTH JOB_SCRIPT
# Exit code 77 where Slurm is not installed.
set -u
PROXYCLOTH=$1
script=$2
for tool in munged slurmctld slurmd sbatch; do
    PATH=$PATH:/usr/sbin command -v $tool >/dev/null || {
        echo "SKIPPED: $tool is not installed (Debian: slurmctld slurmd munge slurm-client)"
        exit 77
    }
done
PATH=$PATH:/usr/sbin
work=$(mktemp -d) || exit 1
daemons=
started=
finish() {
    if [ -n "$started" ]; then
        scancel --user "$(id -un)" && await 100 quiet
    fi
    kill $daemons 2>/dev/null
    wait
    rm -rf "$work"
}
trap finish EXIT
cd "$work" || exit 1

fail() {
    echo "FAILED: $1"
    tail -n 20 slurm-*.out ./*.log 2>/dev/null
    exit 1
}
# await SECONDS COMMAND...
await() {
    left=$(($1 * 5))
    shift
    until "$@" >/dev/null 2>&1; do
        [ $((left -= 1)) -gt 0 ] || return 1
        sleep 0.2
    done
}

quiet() { [ -z "$(squeue -h)" ]; }

# Ports below those that the kernel hands out; another test may run.
port=$((20000 + $$ % 5000 * 2))
user=$(id -un)
host=$(hostname -s)
mkdir state spool munge socket
chmod 700 munge
chmod 711 . socket
head -c 128 /dev/urandom >munge/key
chmod 600 munge/key
cat >slurm.conf <<EOF
ClusterName=test
SlurmctldHost=$host(127.0.0.1)
SlurmUser=$user
SlurmdUser=$user
AuthType=auth/munge
AuthInfo=socket=$work/socket/munge,cred_expire=2
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool
SlurmctldPort=$port
SlurmdPort=$((port + 1))
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
MpiDefault=none
ReturnToService=2
SchedulerParameters=sched_interval=1,batch_sched_delay=0
KillWait=1
NodeName=$host NodeAddr=127.0.0.1 CPUs=2 RealMemory=16000 State=UNKNOWN
PartitionName=all Nodes=$host Default=YES State=UP
EOF
export SLURM_CONF="$work/slurm.conf" PROXYCLOTH
munged --foreground --force --key-file="$work/munge/key" --socket="$work/socket/munge" \
    --pid-file="$work/munge/pid" --log-file="$work/munge/log" --seed-file="$work/munge/seed" \
    >munged.log 2>&1 &
daemons="$daemons $!"
await 300 test -S socket/munge || fail "munged does not start"
slurmctld -D >slurmctld.log 2>&1 &
daemons="$daemons $!"
slurmd -D -N "$host" >slurmd.log 2>&1 &
daemons="$daemons $!"
idle() { sinfo -h -o %t | grep -q '^idle'; }
await 300 idle || fail "Slurm does not start"
started=yes

mkdir -p in out/garments/sheet6
for n in 4 5 6 7; do
    awk -v n=$n 'BEGIN {
        for (j = 0; j <= n; ++j) for (i = 0; i <= n; ++i)
            printf "v %.6f %.6f %.6f\n", i / n, j / n, 0.2 * sin(3 * i / n)
        for (j = 0; j < n; ++j) for (i = 0; i < n; ++i) {
            a = j * (n + 1) + i + 1
            printf "f %d %d %d %d\n", a, a + 1, a + n + 2, a + n + 1
        }
    }' >in/sheet$n.obj
done
printf 'v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n' >in/nan.obj
farm() {
    SHARDS=3 bash "$script" in -o out --voxels 8 --vertices 20 --frames 2 --epochs 1 --no-png
}
# What stands in the way of one garment goes away while its task waits to be run again.
echo "mine" >out/garments/sheet6/letter
farm >planned 2>&1 || fail "planning"
grep -q '^5 garments in 3 tasks: job [0-9]*$' planned || fail "the plan: $(cat planned)"
again() { grep -qs 'DUE TO JOB REQUEUE' slurm-*_*.out; }
await 600 again || fail "no task is queued again"
rm -r out/garments/sheet6
await 900 quiet || fail "the jobs do not end"
grep -hq '"id":"sheet6".*"outcome":"failed".*"retryable":true' slurm-*_*.out || fail "no failure"
[ "$(ls out/batch-?-of-3.json | wc -l)" -eq 3 ] || fail "reports of the shards"
[ "$(grep -c '"outcome":.*"done"' out/batch.json)" -eq 4 ] || fail "garments that are done"
[ "$(grep -c '"outcome":.*"failed"' out/batch.json)" -eq 1 ] || fail "garments that failed"
# The tasks did the work, not the job that collects.
grep -Eq '"ran":.0,' out/batch.json || fail "the collecting job converted garments"

# All is up to date: there is nothing to submit but the report.
farm >planned 2>&1 || fail "planning again"
grep -q '^report: job [0-9]*$' planned && [ "$(wc -l <planned)" -eq 1 ] || fail "a plan for nothing"
await 600 quiet || fail "the report does not end"
