# Sourced in front of every job's script: the devices of the rig. They are built into the User-Mode Linux kernel and are
# modules of a stock one. Each function ends when its device is there.
module() { modprobe "$@" 2>/dev/null || true; }
# Waits for a command to succeed, at most ten seconds.
until_true() { for _ in {1..100}; do "$@" 2>/dev/null && return; sleep .1; done; echo "not true within 10 s: $*" >&2; return 1; }

# cameras: three, at /dev/video0 to 2, that take any size at the rate of an HDMI signal: 30 (default), 50 or 60 Hz. Their
# stamps are the start of the exposure.
cameras() {
  local rate=${1:-30} index d
  case $rate in 30) index=5 ;; 50) index=6 ;; 60) index=7 ;; *) echo "no timings for $rate Hz" >&2; return 1 ;; esac
  module vivid n_devs=3 node_types=0x1,0x1,0x1 num_inputs=1,1,1 input_types=0x3,0x3,0x3 no_error_inj=$((1 - ${ERROR_INJECTION:-0}))
  until_true test -e /dev/video2 || return
  for d in 0 1 2; do
    v4l2-ctl -d "/dev/video$d" --set-dv-bt-timings index=$index -c timestamp_source=1,horizontal_movement=5 >/dev/null || return
  done
}

# gpio_chip: a chip with 8 lines at $GPIO_CHIP; line 3 is the button, line 5 the light. Call press to press the button.
gpio_chip() {
  local rig=/sys/kernel/config/gpio-sim/rig
  [ -d /sys/kernel/config/gpio-sim ] || insmod "$GPIO_SIM_MODULE" || return
  mkdir -p $rig/bank0/line3 $rig/bank0/line5
  echo 8 >$rig/bank0/num_lines
  echo record-button >$rig/bank0/line3/name
  echo record-light >$rig/bank0/line5/name
  echo 1 >$rig/live || return
  GPIO_CHIP=/dev/$(<$rig/bank0/chip_name)
  GPIO_LINES=/sys/devices/platform/$(<$rig/dev_name)/$(<$rig/bank0/chip_name)
}
# press [SECONDS]: the button, held for so long (default 0.08).
press() { echo pull-up >"$GPIO_LINES/sim_gpio3/pull"; sleep "${1:-.08}"; echo pull-down >"$GPIO_LINES/sim_gpio3/pull"; }
# light: 1 or 0, what the program drives the light's line to.
light() { cat "$GPIO_LINES/sim_gpio5/value"; }
# imu [ARGUMENTS of vm-imu]: the IMU of a ZED Mini at /dev/hidraw0; what it says goes into imu.txt.
imu() { module uhid; module hid-generic; vm-imu "$@" >imu.txt 2>&1 & imu=$!; until_true test -e /dev/hidraw0; }
# daemon: pawsd with the job's configuration, until it is armed; what it says goes into daemon.txt.
daemon() { pawsd run --config pawsd.toml 2>>daemon.txt & daemon=$!; until_state armed; }
state() { pawsd status --json | grep -qE "\"state\":\"($1)\""; }
until_state() { until_true state "$1"; }
# battery STATUS PERCENT: the machine's battery, discharging, charging or full; with a plug unless it is being emptied.
battery() {
  local plug=on; [ "$1" != discharging ] || plug=off
  echo $plug >/sys/module/test_power/parameters/ac_online && echo $plug >/sys/module/test_power/parameters/usb_online &&
    echo "$2" >/sys/module/test_power/parameters/battery_capacity && echo "$1" >/sys/module/test_power/parameters/battery_status
}
