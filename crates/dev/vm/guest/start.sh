#!/bin/bash
# Process 1 of every guest once its root is there: the rest of the mounts, the job's script, then the end.
# The host reads two lines of it: "guest: up SECONDS" and "guest: exit CODE".
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8 XDG_RUNTIME_DIR=/run
dmesg -n 1
ln -sfn /proc/self/fd /dev/fd
for i in 0:stdin 1:stdout 2:stderr; do ln -sf "/proc/self/fd/${i%:*}" "/dev/${i#*:}"; done
mkdir -p /dev/pts /dev/shm /run/paws
mount -t devpts devpts /dev/pts
mount -t tmpfs tmpfs /dev/shm
mount -t configfs configfs /sys/kernel/config 2>/dev/null || { modprobe configfs && mount -t configfs configfs /sys/kernel/config; }
mount -t debugfs debugfs /sys/kernel/debug 2>/dev/null
hostname rig
ip link set lo up
# The kernel's test battery begins as one that is being emptied.
echo full >/sys/module/test_power/parameters/battery_status 2>/dev/null
echo "guest: up $(cut -d' ' -f1 /proc/uptime)"
bash /run/job/script.sh
echo "guest: exit $?"
sync
echo o >/proc/sysrq-trigger
sleep 60
