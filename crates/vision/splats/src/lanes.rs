//! Vectors of eight `f32`, one implementation per instruction set.
//!
//! Contract: all implementations compute the same bits, so that a kernel written once over
//! [`Lanes`] gives the same bytes on every processor: eight lanes everywhere, multiplications and
//! additions are fused where and only where [`Lanes::mul_add`] is written, sums over lanes have a
//! fixed order, and the exponential is computed from these operations. A kernel is a struct with
//! [`Kernel::run`]; [`Level::run`] compiles it for each instruction set and calls the selected one.
//!
//! Kernels call no closures: closures are compiled without the instruction set, and what they
//! contain is then called, not inlined.

mod portable;
#[cfg(test)]
mod tests;
mod vector;
#[cfg(target_arch = "x86_64")]
mod x86;

pub(crate) use vector::{Kernel, LANES, Lanes};

/// An instruction set that kernels are compiled for. It never changes a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// The baseline instruction set of the architecture. Fast where that contains fused
    /// multiply-add (aarch64), slow elsewhere.
    Portable,
    /// AVX2 with FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// The same vectors with the registers and masks of AVX-512.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Level {
    /// The most capable instruction set of this processor.
    pub fn best() -> Self {
        Self::all().pop().unwrap_or(Self::Portable)
    }

    /// All supported instruction sets of this processor, the most capable one last.
    pub fn all() -> Vec<Self> {
        let known = [
            Self::Portable,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2,
            #[cfg(target_arch = "x86_64")]
            Self::Avx512,
        ];
        known
            .into_iter()
            .filter(|level| level.is_supported())
            .collect()
    }

    fn is_supported(self) -> bool {
        match self {
            Self::Portable => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                Self::Avx2.is_supported()
                    && is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512vl")
                    && is_x86_feature_detected!("avx512dq")
            }
        }
    }

    /// Runs a kernel.
    ///
    /// # Panics
    /// If the processor does not support this instruction set.
    pub(crate) fn run<K: Kernel>(self, kernel: K) -> K::Output {
        assert!(self.is_supported(), "this processor has no {self:?}");
        match self {
            Self::Portable => kernel.run::<portable::Portable>(),
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the processor supports it, as asserted above.
            Self::Avx2 => unsafe { x86::on_avx2(kernel) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the processor supports it, as asserted above.
            Self::Avx512 => unsafe { x86::on_avx512(kernel) },
        }
    }
}
