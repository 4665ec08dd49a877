#!/bin/sh
# Faults of the system: runs that are killed at random moments, full disks, folders that cannot be
# written. Afterwards every file is the complete old one or the complete new one, and a run on top
# of it completes and tidies up.
# usage: faults.sh PROXYCLOTH [KILLS [SEED]]
. "$(dirname "$0")/common.sh"
own_program
kills=${2:-2}
seed=${3:-1}

sheet 20 >cape.obj
cp cape.obj coat.obj

quick="--voxels 8 --frames 4 --epochs 2 --no-png --quiet"
old="--vertices 20"
new="--vertices 30"
convert() { # convert COMMAND OPTIONS FOLDER
    case $1 in
    build) "$program" build cape.obj -o "$3" $quick $2 ;;
    batch) "$program" batch cape.obj coat.obj -o "$3" $quick $2 ;;
    esac >stdout 2>stderr </dev/null
}

# Names and contents of all files but those of work folders; without what depends on the clock.
contents() { # contents FOLDER
    (cd "$1" && find . -name '.proxycloth-*' -prune -o -type f ! -name '*.json' ! -name report.html -print | LC_ALL=C sort |
        xargs -r sha256sum)
}
# Each file of FOLDER is as in OLD or as in NEW; JSON ends where it should.
is_old_or_new() { # is_old_or_new FOLDER OLD NEW
    contents "$1" >now
    contents "$2" >then
    contents "$3" >>then
    grep -vxFf then now >strange && fail "$(cat strange)"
    find "$1" -name '.proxycloth-*' -prune -o -name '*.json' -print | while read -r file; do
        [ "$(tail -c 2 "$file" | head -c 1)" = "}" ] || echo "$file"
    done >strange
    [ ! -s strange ] || fail "$(cat strange) is cut off"
}
same() { # same FOLDER NEW: and nothing else, work folders included
    contents "$1" >now
    contents "$2" >then
    cmp -s now then || fail "$1 is not what $2 is"
    [ -z "$(find "$1" -name '.proxycloth-*')" ] || fail "$1 holds a work folder"
}

# Killed at random moments.
for command in build batch; do
    convert $command "$old" old-$command || fail "$command: $(cat stderr)"
    start=$(date +%s%N)
    convert $command "$new" new-$command || fail "$command: $(cat stderr)"
    span=$((($(date +%s%N) - start) / 1000000))
    round=0
    while [ "$round" -lt "$kills" ]; do
        round=$((round + 1))
        rm -rf out
        cp -r old-$command out
        pause=$(awk -v seed="$seed$round" -v span="$span" 'BEGIN { srand(seed); printf "%.3f", rand() * span / 1000 }')
        case $command in
        build) "$program" build cape.obj -o out $quick $new ;;
        batch) "$program" batch cape.obj coat.obj -o out $quick $new ;;
        esac >stdout 2>stderr </dev/null &
        process=$!
        sleep "$pause"
        kill -9 "$process" 2>stderr
        wait "$process" 2>stderr
        tries=0 # the children die with it, soon
        while grep -ls "$program" /proc/[0-9]*/cmdline >left; do
            [ $((tries += 1)) -le 2400 ] || { fail "$command: a process is left: $(cat left)"; break; }
            sleep 0.05
        done
        is_old_or_new out old-$command new-$command
        convert $command "$new" out || fail "$command after a kill: $(cat stderr)"
        same out new-$command
    done
done

# refused WHAT: the last run ended with exit code 4 and one line, and the old files are there.
refused() {
    [ "$code" -eq 4 ] || fail "$1: exit code $code: $(cat stderr)"
    [ "$(wc -l <stderr)" -eq 1 ] || fail "$1: not one line: $(cat stderr)"
    same out old-build
}

# Files may not grow beyond 16 KiB, with and without the signal.
rm -rf out
cp -r old-build out
(ulimit -f 32 && convert build "$new" out)
code=$?
refused "file size limit"
(trap '' XFSZ && ulimit -f 32 && convert build "$new" out)
code=$?
refused "file size limit without a signal"

# A full disk and a folder that cannot be written need a file system and a user for the purpose.
mkdir disk
if [ "$(id -u)" -eq 0 ] && mount -t tmpfs -o "size=$(($(du -sk old-build | cut -f 1) + 32))k" tmpfs disk 2>stderr; then
    cp -r old-build/* disk
    convert build "$new" disk
    code=$?
    rm -rf out
    mkdir out
    cp -r disk/. out
    umount disk
    refused "full disk"
else
    echo "skipped: a full disk, for which nothing can be mounted here"
fi
if [ "$(id -u)" -ne 0 ]; then
    rm -rf out
    cp -r old-build out
    chmod 555 out
    convert build "$new" out
    code=$?
    chmod 755 out
    refused "read-only folder"
elif chmod 755 "$work" && setpriv --reuid=65534 --clear-groups test -x "$program" 2>stderr; then
    rm -rf out
    cp -r old-build out
    setpriv --reuid=65534 --clear-groups "$program" build cape.obj -o out $quick $new 2>stderr
    code=$?
    refused "folder of another user"
else
    echo "skipped: a folder of another user, which the program cannot be run as"
fi

finish
