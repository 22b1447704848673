#!/bin/busybox sh
# Process 1 of a guest with a stock kernel: the modules that reach the host's root over 9p, an overlay over it, and on there.
# From the kernel's command line come vm.guest, vm.job and vm.kernel (the folder of the unpacked kernel).
b=/bin/busybox
$b mount -t proc proc /proc; $b mount -t sysfs sysfs /sys; $b mount -t devtmpfs devtmpfs /dev
for module in /modules/*.ko; do $b insmod $module; done
for word in $($b cat /proc/cmdline); do case $word in
  vm.guest=*) guest=${word#*=} ;; vm.job=*) job=${word#*=} ;; vm.kernel=*) kernel=${word#*=} ;;
esac; done
over9p=trans=virtio,version=9p2000.L,msize=1048576
$b mount -t 9p -o ro,cache=loose,$over9p host /host && $b mount -t tmpfs -o size=75% tmpfs /upper && $b mkdir /upper/upper /upper/work &&
  $b mount -t overlay -o lowerdir=/host,upperdir=/upper/upper,workdir=/upper/work overlay /system || exec $b echo "guest: no root"
$b mount -t tmpfs tmpfs /system/run; $b mkdir -p /system/run/guest /system/run/job
$b mount --bind "/host$guest" /system/run/guest && $b mount -t 9p -o cache=none,$over9p job /system/run/job || exec $b echo "guest: no job"
modules=lib/modules/$($b uname -r)
$b mkdir -p /system/usr/$modules; $b mount --bind "/host$kernel/$modules" /system/usr/$modules
$b mount --move /proc /system/proc; $b mount --move /sys /system/sys; $b mount --move /dev /system/dev
exec $b switch_root /system /bin/bash /run/guest/start.sh
