# gpio-sim.sh HEADERS FOLDER: builds gpio-sim and what it needs out of tree, as FOLDER/gpio_sim_all.ko.
headers=$1 folder=$2
work=$(mktemp -d -p "$folder"); trap 'rm -rf "$work"' EXIT
cd "$work"
apt-get download linux-source-6.1
dpkg-deb -x linux-source-6.1_*.deb package
tar --strip-components=1 -xJf package/usr/src/linux-source-6.1.tar.xz \
  linux-source-6.1/drivers/gpio/gpio-sim.c linux-source-6.1/drivers/gpio/gpiolib.h linux-source-6.1/kernel/irq/irq_sim.c
mkdir module; cp drivers/gpio/* kernel/irq/irq_sim.c module/
# irq_to_desc is not exported to modules; this does the same by number.
grep -q 'handle_simple_irq(irq_to_desc(irqnum));' module/irq_sim.c
sed -i 's/handle_simple_irq(irq_to_desc(irqnum));/generic_handle_irq(irqnum);/' module/irq_sim.c
printf 'obj-m += gpio_sim_all.o\ngpio_sim_all-y := gpio-sim.o irq_sim.o\n' >module/Kbuild
make -s -C "$headers" M="$work/module" modules
strip --strip-debug module/gpio_sim_all.ko
mv module/gpio_sim_all.ko "$folder/"
