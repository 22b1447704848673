#!/bin/bash
# Process 1 of a User-Mode Linux guest: puts the host's root, read-only, under a tmpfs overlay, and goes on there.
# From the kernel's command line come vm.guest (the folder of these scripts) and vm.job (the job's folder).
mount -t proc proc /proc
for word in $(</proc/cmdline); do case $word in vm.guest=*) guest=${word#*=} ;; vm.job=*) job=${word#*=} ;; esac; done
mount -t tmpfs tmpfs /mnt && mkdir /mnt/{upper,work,host,root} && mount -t hostfs -o ro,/ host /mnt/host &&
  mount -t overlay -o lowerdir=/mnt/host,upperdir=/mnt/upper,workdir=/mnt/work overlay /mnt/root || exec echo "guest: no root"
cd /mnt/root
mount -t tmpfs tmpfs run && mkdir run/guest run/job
mount --bind "/mnt/host$guest" run/guest && mount -t hostfs -o "$job" job run/job || exec echo "guest: no job"
mount -t proc proc proc && mount -t sysfs sysfs sys && mount -t devtmpfs devtmpfs dev
exec chroot . /bin/bash /run/guest/start.sh
