//! SIMD vectors of bytes and of 16-bit words, one implementation per instruction set.
//!
//! Contract: all implementations compute the same result, so that a kernel written once over
//! [`Lanes`] gives the same bytes on every processor. A kernel is a struct with [`Kernel::run`];
//! [`Level::run`] compiles it for each instruction set and calls the selected one. The compiler
//! chooses the instructions of the portable implementation (SSE2, NEON).

mod portable;
#[cfg(target_arch = "x86_64")]
mod x86;

/// An instruction set that kernels are compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// The baseline instruction set of the architecture.
    Portable,
    /// AVX2.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512 with BW, VBMI and BITALG.
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

/// A vector of bytes. Loads and stores need no alignment.
pub(crate) trait Lanes: Copy {
    /// Number of bytes.
    const COUNT: usize;
    /// Vector of the same size with 16-bit words.
    type Words: Words;

    /// All lanes equal to `value`.
    fn splat(value: u8) -> Self;
    /// # Safety
    /// `COUNT` bytes can be read.
    unsafe fn load(from: *const u8) -> Self;
    /// # Safety
    /// `COUNT` bytes can be written.
    unsafe fn store(self, to: *mut u8);
    /// Minimum per lane.
    fn min(self, other: Self) -> Self;
    /// Saturating sum.
    fn add(self, other: Self) -> Self;
    /// Saturating difference.
    fn sub(self, other: Self) -> Self;
    /// Bitwise or.
    fn or(self, other: Self) -> Self;
    /// Bitwise exclusive or.
    fn xor(self, other: Self) -> Self;
    /// Number of set bits per byte.
    fn count_ones(self) -> Self;
    /// 255 in the first lane, 0 elsewhere.
    fn first() -> Self;
    /// 255 in the last lane, 0 elsewhere.
    fn last() -> Self;
    /// Shifts each lane to the next one; the first lane is the last one of `before`.
    fn up(self, before: Self) -> Self;
    /// Shifts each lane to the previous one; the last lane is the first one of `after`.
    fn down(self, after: Self) -> Self;
    /// Minimum of all lanes, broadcast to every lane.
    fn least(self) -> Self;
    /// The first lane.
    fn any(self) -> u8;
    /// The lower and the upper half, widened to words.
    fn widen(self) -> [Self::Words; 2];
}

/// A vector of words of 16 bits.
pub(crate) trait Words: Copy {
    /// Number of words.
    const COUNT: usize;

    /// All lanes equal to `value`.
    fn splat(value: u16) -> Self;
    /// `from`, `from + 1`, and so on, wrapping.
    fn counting(from: u16) -> Self;
    /// # Safety
    /// `COUNT` words can be written.
    unsafe fn store(self, to: *mut u16);
    /// Minimum per lane.
    fn min(self, other: Self) -> Self;
    /// Wrapping sum.
    fn add(self, other: Self) -> Self;
    /// Saturating difference.
    fn sub(self, other: Self) -> Self;
    /// Bitwise or.
    fn or(self, other: Self) -> Self;
    /// Selects `yes` where the two are equal, `no` elsewhere.
    fn pick_equal(self, other: Self, yes: Self, no: Self) -> Self;
    /// Shifts each word to the previous one; the last word is the first one of `after`.
    fn down(self, after: Self) -> Self;
    /// Minimum of all words.
    fn least(self) -> u16;
}

impl Level {
    /// The most capable instruction set of this processor.
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

    /// All supported instruction sets of this processor.
    ///
    /// The instruction set never changes the result:
    ///
    /// ```
    /// use depth::{Band, ImageView, Level, Matcher, Config, Preset};
    ///
    /// # // A random texture of 3 x 3 patches; the right image shows it `shift` columns further to the left.
    /// # fn pair(width: usize, height: usize, shift: usize) -> [Vec<u8>; 2] {
    /// #     let gray = |x: usize, y: usize| {
    /// #         let hash = (x / 3 * 1009 + y / 3 + 1) as u64;
    /// #         40 + (hash.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 57) as u8
    /// #     };
    /// #     [0, shift].map(|from| (0..width * height).map(|i| gray(i % width + from, i / width)).collect())
    /// # }
    /// # let [left, right] = pair(128, 48, 8);
    /// let maps = Level::all().into_iter().map(|level| {
    ///     let mut config = Config::preset(Preset::Fast);
    ///     config.level = Some(level);
    ///     let mut matcher = Matcher::new(config, 128, 48)?;
    ///     let images = [ImageView::packed(128, 48, &left)?, ImageView::packed(128, 48, &right)?];
    ///     let map = matcher.run(&images[0], &images[1], &Band::full(0, 32, 48)?)?;
    ///     Ok(map.disparity.iter().map(|disparity| disparity.to_bits()).collect())
    /// });
    /// let maps: Vec<Vec<u32>> = maps.collect::<Result<_, depth::DepthError>>()?;
    /// assert!(maps.iter().all(|map| *map == maps[0]));
    /// # Ok::<(), depth::DepthError>(())
    /// ```
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

    /// Number of bytes in a vector.
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
    /// If the processor does not support this instruction set.
    pub(crate) fn run<K: Kernel>(self, kernel: K) -> K::Output {
        assert!(self.is_supported(), "this processor has no {self:?}");
        match self {
            Self::Portable => kernel.run::<portable::Bytes>(),
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the processor supports it, as asserted above.
            Self::Avx2 => unsafe { x86::on_avx2(kernel) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the processor supports it, as asserted above.
            Self::Avx512 => unsafe { x86::on_avx512(kernel) },
        }
    }
}

#[cfg(test)]
mod tests;
