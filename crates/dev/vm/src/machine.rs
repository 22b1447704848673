//! What runs guests: User-Mode Linux, or QEMU with a stock kernel. Both start the same scripts.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, bail, ensure};

use crate::guest::Guest;
use crate::kernel::Kernel;
use crate::stock::StockKernel;

/// Where User-Mode Linux keeps the guest's memory; without, it takes the disk.
const SHARED_MEMORY: &str = "/dev/shm";

/// What runs guests.
#[derive(Clone, Debug)]
pub struct Machine {
    kind: Kind,
    programs: PathBuf,
    scripts: PathBuf,
    gst_registry: PathBuf,
}

#[derive(Clone, Debug)]
enum Kind {
    UserMode(Kernel),
    Qemu(StockKernel),
}

impl Machine {
    /// User-Mode Linux. `programs` is the folder of the built programs.
    ///
    /// # Errors
    /// GStreamer has no list of its plugins, and `gst-inspect-1.0` makes none.
    pub fn user_mode(kernel: Kernel, programs: &Path) -> Result<Self> {
        Self::new(Kind::UserMode(kernel), programs)
    }

    /// QEMU without hardware help: Debian's kernel, as it is, some ten times slower.
    ///
    /// # Errors
    /// As of [`Self::user_mode`].
    pub fn qemu(kernel: StockKernel, programs: &Path) -> Result<Self> {
        Self::new(Kind::Qemu(kernel), programs)
    }

    fn new(kind: Kind, programs: &Path) -> Result<Self> {
        Ok(Self {
            kind,
            programs: programs.to_owned(),
            scripts: scripts()?,
            gst_registry: gst_registry()?,
        })
    }

    /// The folder of the built programs.
    pub fn programs(&self) -> &Path {
        &self.programs
    }

    /// One of the built programs.
    pub fn host_program(&self, name: &str) -> PathBuf {
        self.programs.join(name)
    }

    /// Whether guests run many times slower than the host.
    pub fn is_slow(&self) -> bool {
        matches!(self.kind, Kind::Qemu(_))
    }

    /// GStreamer's list of its plugins, made on the host.
    pub(crate) fn gst_registry(&self) -> &Path {
        &self.gst_registry
    }

    pub(crate) fn program(&self) -> &Path {
        match &self.kind {
            Kind::UserMode(kernel) => kernel.path(),
            Kind::Qemu(_) => Path::new("qemu-system-x86_64"),
        }
    }

    /// The module gpio-sim, where the kernel has it not built in.
    pub(crate) fn gpio_sim(&self) -> Option<PathBuf> {
        match &self.kind {
            Kind::UserMode(_) => None,
            Kind::Qemu(kernel) => kernel.gpio_sim(),
        }
    }

    /// Whether guests can have a GPIO chip.
    pub fn has_gpio(&self) -> bool {
        matches!(self.kind, Kind::UserMode(_)) || self.gpio_sim().is_some()
    }

    /// What a guest calls its disk with this position.
    pub(crate) fn disk_name(&self, position: usize) -> String {
        let letter = char::from(b'a' + position as u8);
        match &self.kind {
            Kind::UserMode(_) => format!("/dev/ubd{letter}"),
            Kind::Qemu(_) => format!("/dev/vd{letter}"),
        }
    }

    /// The command that starts a guest whose job lies in a folder.
    pub(crate) fn command(&self, guest: &Guest, job: &Path) -> Result<Command> {
        let scripts = self.scripts.display();
        let words = format!("vm.guest={scripts} vm.job={}", job.display());
        ensure!(
            words.split_whitespace().count() == 2,
            "starting a guest: the project's path has a blank in it, which a kernel's command line cannot carry: {scripts}"
        );
        match &self.kind {
            Kind::UserMode(kernel) => Ok(user_mode(kernel, guest, &self.scripts, job, &words)),
            Kind::Qemu(_) if guest.is_in_virtual_time() => {
                bail!("virtual time needs User-Mode Linux")
            }
            Kind::Qemu(kernel) => Ok(qemu(kernel, guest, job, &words)),
        }
    }
}

fn user_mode(kernel: &Kernel, guest: &Guest, scripts: &Path, job: &Path, words: &str) -> Command {
    let mut command = Command::new(kernel.path());
    if guest.is_in_virtual_time() {
        command.arg("time-travel=inf-cpu");
    }
    command
        .arg(format!("mem={}M", guest.memory()))
        .args(["root=/dev/root", "rootfstype=hostfs", "rootflags=/", "ro"])
        .arg(format!("init={}/init.sh", scripts.display()))
        .args(["con=null", "con0=fd:0,fd:1", "quiet"])
        .arg(format!("uml_dir={}/", job.join("machine").display()))
        .args(words.split(' '))
        // HDMI inputs take any size; see rig.sh.
        .args(["vivid.n_devs=3", "vivid.node_types=0x1,0x1,0x1"])
        .args(["vivid.num_inputs=1,1,1", "vivid.input_types=0x3,0x3,0x3"])
        .arg(format!(
            "vivid.no_error_inj={}",
            u8::from(!guest.injects_errors())
        ));
    for (i, image) in guest.disks().iter().enumerate() {
        command.arg(format!("ubd{i}={}", image.display()));
    }
    if Path::new(SHARED_MEMORY).is_dir() {
        command.env("TMPDIR", SHARED_MEMORY);
    }
    command
}

fn qemu(kernel: &StockKernel, guest: &Guest, job: &Path, words: &str) -> Command {
    let mut command = Command::new("qemu-system-x86_64");
    command
        .args(["-machine", "q35", "-accel", "tcg,thread=multi"])
        .args(["-cpu", "max", "-smp", "2", "-nodefaults", "-no-user-config"])
        .args(["-nographic", "-no-reboot", "-serial", "stdio"])
        .arg("-m")
        .arg(guest.memory().to_string())
        .arg("-kernel")
        .arg(kernel.image())
        .arg("-initrd")
        .arg(kernel.initrd())
        .arg("-append")
        .arg(format!(
            "console=ttyS0 quiet panic=-1 mitigations=off tsc=reliable vm.kernel={} {words}",
            kernel.folder().display()
        ))
        .arg("-fsdev")
        .arg("local,id=host,path=/,security_model=none,readonly=on,multidevs=remap")
        .args(["-device", "virtio-9p-pci,fsdev=host,mount_tag=host"])
        .arg("-fsdev")
        .arg(format!(
            "local,id=job,path={},security_model=none",
            job.display()
        ))
        .args(["-device", "virtio-9p-pci,fsdev=job,mount_tag=job"]);
    for image in guest.disks() {
        command.arg("-drive").arg(format!(
            "file={},format=raw,if=virtio,cache=writeback",
            image.display()
        ));
    }
    command
}

/// The folder of the guests' scripts. Without links: a guest looks for it below another root.
fn scripts() -> Result<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("guest");
    std::fs::canonicalize(&folder)
        .with_context(|| format!("looking for the guests' scripts {}", folder.display()))
}

/// GStreamer's list of its plugins, where it keeps it; made if it is not there.
fn gst_registry() -> Result<PathBuf> {
    let path = match std::env::var_os("GST_REGISTRY") {
        Some(named) => PathBuf::from(named),
        None => {
            let cache = crate::cache_home()?;
            // GStreamer calls processors as the compiler does.
            let name = format!("registry.{}.bin", std::env::consts::ARCH);
            cache.join("gstreamer-1.0").join(name)
        }
    };
    if !path.is_file() {
        let _ = Command::new("gst-inspect-1.0")
            .args(["--exists", "identity"])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status()
            .context("starting gst-inspect-1.0")?;
    }
    ensure!(
        path.is_file(),
        "looking for GStreamer's list of plugins: gst-inspect-1.0 has made none: {}",
        path.display()
    );
    Ok(path)
}
