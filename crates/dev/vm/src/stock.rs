//! Debian's own kernel, for QEMU: the cross-check on a kernel that nobody here has configured or
//! changed.
//!
//! The package is downloaded and unpacked into the cache; nothing is installed. A small first root
//! with busybox reaches the host's root over 9p. The kernel has no gpio-sim: it is built against
//! the kernel's headers where these are installed, and without it there is no GPIO button.

use std::ffi::OsStr;
use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::kernel::{KernelError, cache};

/// The package that depends on the newest kernel.
const META_PACKAGE: &str = "linux-image-amd64";
/// What the first root loads, with all that these need.
const MODULES: [&str; 5] = ["virtio_pci", "9pnet_virtio", "9p", "overlay", "virtio_blk"];
/// The first root's first program.
const INIT: &str = include_str!("../guest/stock-init.sh");

/// A kernel as Debian ships it, unpacked.
#[derive(Clone, Debug)]
pub struct StockKernel {
    folder: PathBuf,
}

impl StockKernel {
    /// The kernel from the cache, or a fresh one: 70 MB. `tell` receives a line for every step that
    /// takes long.
    ///
    /// # Errors
    /// See [`KernelError`].
    pub fn get(tell: impl Fn(&str)) -> Result<Self, KernelError> {
        let cache = cache()?;
        let version = version().ok_or_else(|| {
            KernelError::Unavailable(format!("apt knows no package {META_PACKAGE}"))
        })?;
        let kernel = Self {
            folder: cache.join(format!("stock-{version}")),
        };
        if !kernel.initrd().is_file() {
            tell("downloading Debian's kernel, 70 MB");
            kernel.prepare(&version)?;
        }
        // The headers may have been installed since.
        if kernel.gpio_sim().is_none() {
            kernel.build_gpio_sim(&version);
        }
        Ok(kernel)
    }

    /// The ELF kernel: unpacking it in the emulator would take five seconds at every start.
    pub(crate) fn image(&self) -> PathBuf {
        self.folder.join("vmlinux")
    }

    /// The first root.
    pub(crate) fn initrd(&self) -> PathBuf {
        self.folder.join("initrd.gz")
    }

    /// Where its modules are.
    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// The module gpio-sim, if it could be built.
    pub(crate) fn gpio_sim(&self) -> Option<PathBuf> {
        let module = self.folder.join("gpio_sim_all.ko");
        module.is_file().then_some(module)
    }

    fn prepare(&self, version: &str) -> Result<(), KernelError> {
        let folder = &self.folder;
        let _ = fs::remove_dir_all(folder);
        fs::create_dir_all(folder).map_err(|e| self.io(e))?;
        let package = format!("linux-image-{version}");
        run(Command::new("apt-get")
            .args(["download", &package])
            .current_dir(folder))
        .map_err(|said| KernelError::Unavailable(format!("downloading {package}: {said}")))?;
        for archive in files(folder, "deb").map_err(|e| self.io(e))? {
            self.step(Command::new("dpkg-deb").arg("-x").arg(&archive).arg(folder))?;
            fs::remove_file(&archive).map_err(|e| self.io(e))?;
        }
        let mut depmod = Command::new("depmod");
        self.step(depmod.arg("-b").arg(folder).arg(version))?;
        let packed = fs::read(folder.join(format!("boot/vmlinuz-{version}")));
        let elf = unpack(&packed.map_err(|e| self.io(e))?)
            .ok_or_else(|| self.failed("found no ELF kernel inside of vmlinuz"))?;
        fs::write(self.image(), elf).map_err(|e| self.io(e))?;
        self.make_initrd(version)
    }

    /// The first root: busybox, modules in the order in which they are loaded, and the first
    /// program.
    fn make_initrd(&self, version: &str) -> Result<(), KernelError> {
        let root = self.folder.join("initrd");
        for name in [
            "bin", "modules", "proc", "sys", "dev", "host", "upper", "system",
        ] {
            fs::create_dir_all(root.join(name)).map_err(|e| self.io(e))?;
        }
        let busybox = ["/bin/busybox", "/usr/bin/busybox"].map(Path::new);
        let busybox = busybox.into_iter().find(|path| path.is_file());
        let busybox =
            busybox.ok_or_else(|| KernelError::Unavailable("busybox is not here".into()))?;
        fs::copy(busybox, root.join("bin/busybox")).map_err(|e| self.io(e))?;
        let mut order: Vec<PathBuf> = Vec::new();
        for module in MODULES {
            let mut modprobe = Command::new("modprobe");
            modprobe.arg("-d").arg(&self.folder).args(["-S", version]);
            let said =
                run(modprobe.args(["--show-depends", module])).map_err(|e| self.failed(e))?;
            let files = said.lines().filter_map(|line| line.strip_prefix("insmod "));
            for file in files.map(|file| PathBuf::from(file.trim())) {
                if !order.contains(&file) {
                    order.push(file);
                }
            }
        }
        for (i, file) in order.iter().enumerate() {
            let name = file
                .file_name()
                .unwrap_or(OsStr::new("module"))
                .to_string_lossy();
            let to = root.join(format!("modules/{i:02}-{name}"));
            fs::copy(file, to).map_err(|e| self.io(e))?;
        }
        fs::write(root.join("init"), INIT).map_err(|e| self.io(e))?;
        let pack = "chmod +x init && find . | cpio --quiet -o -H newc | gzip -1 >../initrd.new && mv ../initrd.new ../initrd.gz";
        let mut shell = Command::new("sh");
        self.step(shell.args(["-ec", pack]).current_dir(&root))
    }

    /// Debian's kernel has neither gpio-sim nor the simulated interrupts that it needs. Where this
    /// fails there is no GPIO button, and the case reports that.
    fn build_gpio_sim(&self, version: &str) {
        let headers = PathBuf::from(format!("/usr/src/linux-headers-{version}"));
        if !headers.is_dir() {
            return;
        }
        let mut build = Command::new("bash");
        build
            .arg("-ec")
            .arg(include_str!("../kernel/gpio-sim.sh"))
            .args([
                "gpio-sim.sh".as_ref(),
                headers.as_os_str(),
                self.folder.as_os_str(),
            ]);
        if let Err(said) = run(&mut build) {
            log::warn!("building gpio-sim for Debian's kernel: {said}");
        }
    }

    fn step(&self, command: &mut Command) -> Result<(), KernelError> {
        run(command).map(drop).map_err(|said| self.failed(said))
    }

    fn failed(&self, what: impl Into<String>) -> KernelError {
        KernelError::Stock {
            what: what.into(),
            folder: self.folder.clone(),
        }
    }

    fn io(&self, source: io::Error) -> KernelError {
        KernelError::Io {
            path: self.folder.clone(),
            source,
        }
    }
}

/// The newest version that apt knows.
fn version() -> Option<String> {
    let said = run(Command::new("apt-cache").args(["depends", META_PACKAGE])).ok()?;
    let package = said
        .lines()
        .find_map(|line| line.trim().strip_prefix("Depends: linux-image-"));
    package.map(str::to_owned)
}

/// What a command printed; the error is what it complained of.
fn run(command: &mut Command) -> Result<String, String> {
    let output = command.stdin(Stdio::null()).output();
    let output = output.map_err(|error| format!("{command:?}: {error}"))?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    Err(format!(
        "{command:?} ended with {}: {}",
        output.status,
        String::from_utf8_lossy(&output.stderr).trim()
    ))
}

fn files(folder: &Path, extension: &str) -> io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.extension().is_some_and(|e| e == extension) {
            found.push(path);
        }
    }
    Ok(found)
}

/// The ELF file packed inside of a vmlinuz: every place that looks like the beginning of a packed
/// file is tried.
fn unpack(packed: &[u8]) -> Option<Vec<u8>> {
    const PACKERS: [(&str, &[u8]); 3] = [
        ("xz", b"\xfd7zXZ\0"),
        ("zstd", b"\x28\xb5\x2f\xfd"),
        ("gzip", b"\x1f\x8b\x08"),
    ];
    PACKERS.into_iter().find_map(|(program, magic)| {
        let places = packed.windows(magic.len()).enumerate();
        let mut places = places.filter(|(_, window)| *window == magic);
        places.find_map(|(at, _)| {
            let elf = unpacked_by(program, &packed[at..]).ok()?;
            elf.starts_with(b"\x7fELF").then_some(elf)
        })
    })
}

fn unpacked_by(program: &str, packed: &[u8]) -> io::Result<Vec<u8>> {
    let mut child = Command::new(program)
        .arg("-dc")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()?;
    let input = child.stdin.take();
    std::thread::scope(|scope| {
        // Behind the packed file lies more, at which the program stops reading.
        scope.spawn(move || input.map(|mut input| input.write_all(packed)));
        child.wait_with_output().map(|output| output.stdout)
    })
}
