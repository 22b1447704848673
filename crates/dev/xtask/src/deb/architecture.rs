//! The architectures that packages are built for, by the names that each tool gives them.

use anyhow::{Context, Result};

/// An architecture that the recorder is packaged for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Architecture {
    Amd64,
    Arm64,
}

impl Architecture {
    pub(crate) const ALL: [Self; 2] = [Self::Amd64, Self::Arm64];

    /// Debian's name.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Amd64 => "amd64",
            Self::Arm64 => "arm64",
        }
    }

    /// The kernel's, QEMU's and Rust's name.
    pub(crate) fn machine(self) -> &'static str {
        match self {
            Self::Amd64 => "x86_64",
            Self::Arm64 => "aarch64",
        }
    }

    /// The name of library folders and the prefix of GCC and binutils.
    pub(crate) fn gnu(self) -> String {
        format!("{}-linux-gnu", self.machine())
    }

    /// Rust's target.
    pub(crate) fn target(self) -> String {
        format!("{}-unknown-linux-gnu", self.machine())
    }

    /// This machine's.
    pub(crate) fn here() -> Result<Self> {
        let machine = std::env::consts::ARCH;
        Self::ALL
            .into_iter()
            .find(|architecture| architecture.machine() == machine)
            .with_context(|| {
                format!("this machine is {machine}; packages are made on x86_64 and aarch64")
            })
    }
}
