//! Vectors of bytes and of 16-bit words, one kind per instruction set.
//!
//! Contract: every kind computes the same, so a kernel that is written once over [`Lanes`] gives the same bytes whatever the
//! processor has. A kernel is a struct with [`Kernel::run`]; [`Level::run`] compiles it for each instruction set and calls
//! the one that is asked for. Which vectors the portable kind becomes is the compiler's choice (SSE2, NEON).

mod portable;
#[cfg(target_arch = "x86_64")]
mod x86;

/// An instruction set that kernels are compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// What every processor of this kind has.
    Portable,
    /// AVX2.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512 with bytes, words and counting bits in bytes.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

/// Work on vectors.
pub(crate) trait Kernel {
    /// What comes out.
    type Output;
    /// Does it. Implementations are `#[inline(always)]`, or the compiler makes no vectors of them.
    fn run<V: Lanes>(self) -> Self::Output;
}

/// A vector of bytes. Loads and stores need no alignment.
pub(crate) trait Lanes: Copy {
    /// Bytes in it.
    const COUNT: usize;
    /// As many bits in words of 16.
    type Words: Words;

    /// All the same.
    fn splat(value: u8) -> Self;
    /// # Safety
    /// `COUNT` bytes can be read.
    unsafe fn load(from: *const u8) -> Self;
    /// # Safety
    /// `COUNT` bytes can be written.
    unsafe fn store(self, to: *mut u8);
    /// Lesser ones.
    fn min(self, other: Self) -> Self;
    /// Sum, at most 255.
    fn add(self, other: Self) -> Self;
    /// Difference, at least 0.
    fn sub(self, other: Self) -> Self;
    /// Bits of either.
    fn or(self, other: Self) -> Self;
    /// Bits of one of the two.
    fn xor(self, other: Self) -> Self;
    /// How many bits are set in each byte.
    fn count_ones(self) -> Self;
    /// 255 in the first lane, 0 elsewhere.
    fn first() -> Self;
    /// 255 in the last lane, 0 elsewhere.
    fn last() -> Self;
    /// Each lane goes to the next one; the first is the last of `before`.
    fn up(self, before: Self) -> Self;
    /// Each lane goes to the one before; the last is the first of `after`.
    fn down(self, after: Self) -> Self;
    /// The least of all lanes, in every lane.
    fn least(self) -> Self;
    /// The first lane.
    fn any(self) -> u8;
    /// The lower and the upper half as words.
    fn widen(self) -> [Self::Words; 2];
}

/// A vector of words of 16 bits.
pub(crate) trait Words: Copy {
    /// Words in it.
    const COUNT: usize;

    /// All the same.
    fn splat(value: u16) -> Self;
    /// `from`, `from` + 1 and so on.
    fn counting(from: u16) -> Self;
    /// # Safety
    /// `COUNT` words can be written.
    unsafe fn store(self, to: *mut u16);
    /// Lesser ones.
    fn min(self, other: Self) -> Self;
    /// Sum, wrapping.
    fn add(self, other: Self) -> Self;
    /// Difference, at least 0.
    fn sub(self, other: Self) -> Self;
    /// Bits of either.
    fn or(self, other: Self) -> Self;
    /// `yes` where the two are equal, `no` elsewhere.
    fn pick_equal(self, other: Self, yes: Self, no: Self) -> Self;
    /// Each word goes to the one before; the last is the first of `after`.
    fn down(self, after: Self) -> Self;
    /// The least of all.
    fn least(self) -> u16;
}

impl Level {
    /// The best that this processor has.
    pub fn best() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            if Self::Avx512.is_supported() {
                return Self::Avx512;
            }
            if Self::Avx2.is_supported() {
                return Self::Avx2;
            }
        }
        Self::Portable
    }

    /// All that this processor has.
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
            Self::Avx2 => is_x86_feature_detected!("avx2"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                is_x86_feature_detected!("avx512bw")
                    && is_x86_feature_detected!("avx512vbmi")
                    && is_x86_feature_detected!("avx512bitalg")
            }
        }
    }

    /// Bytes in a vector.
    pub(crate) fn lanes(self) -> usize {
        match self {
            Self::Portable => portable::Bytes::COUNT,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => x86::Bytes32::COUNT,
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => x86::Bytes64::COUNT,
        }
    }

    /// Runs a kernel.
    ///
    /// # Panics
    /// The processor does not have this.
    pub(crate) fn run<K: Kernel>(self, kernel: K) -> K::Output {
        assert!(self.is_supported(), "this processor has no {self:?}");
        match self {
            Self::Portable => kernel.run::<portable::Bytes>(),
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the processor has it.
            Self::Avx2 => unsafe { x86::on_avx2(kernel) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the processor has it.
            Self::Avx512 => unsafe { x86::on_avx512(kernel) },
        }
    }
}

#[cfg(test)]
mod tests;
