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

use std::ops::{Add, Div, Mul, Neg, Sub};

mod portable;
#[cfg(test)]
mod tests;
#[cfg(target_arch = "x86_64")]
mod x86;

/// Number of lanes.
pub(crate) const LANES: usize = 8;

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

/// Vectorized computation.
pub(crate) trait Kernel {
    /// Result of the kernel.
    type Output;
    /// Runs the kernel. Implementations are `#[inline(always)]`; otherwise the compiler does not
    /// vectorize them.
    fn run<V: Lanes>(self) -> Self::Output;
}

/// A vector of eight `f32`. Masks are vectors whose lanes have all bits set or none.
pub(crate) trait Lanes:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// All lanes equal to `value`.
    fn splat(value: f32) -> Self;
    /// From memory.
    fn load(from: &[f32; LANES]) -> Self;
    /// Into memory.
    fn store(self, to: &mut [f32; LANES]);
    /// `self * by + plus` with one rounding.
    fn mul_add(self, by: Self, plus: Self) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// The smaller one; `other` if one is NaN.
    fn min(self, other: Self) -> Self;
    /// The larger one; `other` if one is NaN.
    fn max(self, other: Self) -> Self;
    /// Mask: `self < other`; false if one is NaN.
    fn less(self, other: Self) -> Self;
    /// Bitwise and.
    fn and(self, other: Self) -> Self;
    /// Bitwise: `self` and not `mask`.
    fn and_not(self, mask: Self) -> Self;
    /// Bitwise or.
    fn or(self, other: Self) -> Self;
    /// `self` is a mask: `yes` where it is set, `no` elsewhere.
    fn select(self, yes: Self, no: Self) -> Self;
    /// The signs of the lanes as bits, the first lane in bit 0.
    fn bits(self) -> u32;
    /// Sum of all lanes: halves first, then quarters.
    fn sum(self) -> f32;
    /// `2^n` for each lane `1.5 * 2^23 + n`, n an integer in -126 to 127.
    fn power_of_two(self) -> Self;

    /// `exp(self)`, relative error below 3e-7 for arguments in -87 to 87; arguments beyond are
    /// taken as these.
    #[inline(always)]
    fn exp(self) -> Self {
        let s = Self::splat;
        let x = self.max(s(-87.0)).min(s(87.0));
        // exp(x) = 2^n exp(r), with n the nearest integer to x / ln 2; the added number leaves no
        // bits for the fraction. ln 2 in two parts, so that r is exact.
        let shifted = x.mul_add(s(std::f32::consts::LOG2_E), s(12_582_912.0));
        let n = shifted - s(12_582_912.0);
        let r = n.mul_add(s(-0.693_359_4), x);
        let r = n.mul_add(s(2.121_944_4e-4), r);
        // Minimax polynomial of (exp(r) - 1 - r) / r² on |r| <= ln 2 / 2 (Cephes, Moshier 1989).
        let p = s(1.987_569_1e-4)
            .mul_add(r, s(1.398_199_9e-3))
            .mul_add(r, s(8.333_452e-3))
            .mul_add(r, s(4.166_579_6e-2))
            .mul_add(r, s(1.666_666_5e-1))
            .mul_add(r, s(0.5));
        p.mul_add(r * r, r + s(1.0)) * shifted.power_of_two()
    }
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
