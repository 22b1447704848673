//! Exclusive sums and the radix sort, from their kernels.

use bytemuck::{Pod, Zeroable};
use wgpu::{Buffer, ComputePass};

use crate::device::Gpu;
use crate::error::GpuError;
use crate::kernel::Kernel;
use crate::memory::{Store, Uniform};

const SCAN: &str = include_str!("shaders/scan.wgsl");
const SORT: &str = include_str!("shaders/sort.wgsl");

/// Values of a group of threads.
const BLOCK: usize = 1024;
/// Bits of a pass of the sort.
const BITS: u32 = 4;

/// What is scanned or sorted: `Length` in the kernels.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct Length {
    kind: u32,
    at: u32,
    shift: u32,
    unused: u32,
}

/// Keys with their values, and room for a copy of both.
#[derive(Debug)]
pub(crate) struct Pairs {
    pub(crate) keys: [Store; 2],
    pub(crate) values: [Store; 2],
}

impl Pairs {
    pub(crate) fn new(gpu: &Gpu, what: &'static str) -> Result<Self, GpuError> {
        let store = || Store::new(gpu, what, 0);
        Ok(Self {
            keys: [store()?, store()?],
            values: [store()?, store()?],
        })
    }

    pub(crate) fn reserve(&mut self, gpu: &Gpu, len: usize) -> Result<(), GpuError> {
        for store in self.keys.iter_mut().chain(&mut self.values) {
            store.reserve(gpu, len)?;
        }
        Ok(())
    }

    /// Number of pairs that fit.
    pub(crate) fn len(&self) -> usize {
        self.keys[0].len()
    }
}

/// Kernels of sums and sorts with their memory.
#[derive(Debug)]
pub(crate) struct Sorter {
    scan: [Kernel; 3],
    count: Kernel,
    move_pairs: Kernel,
    /// Per position of the length in the status: the pass of each digit.
    passes: Vec<Vec<Uniform>>,
    /// The length of a scan of all Gaussians and one.
    plain: Uniform,
    sums: Store,
    counts: Store,
}

impl Sorter {
    /// `lengths` are the positions in the status of the lengths that are sorted; that of the
    /// Gaussians is the first one.
    pub(crate) fn new(gpu: &Gpu, lengths: &[u32]) -> Result<Self, GpuError> {
        let scan = |name| Kernel::new(gpu, name, &[SCAN]);
        let uniform = |kind, at, shift| {
            let unused = 0;
            Uniform::new(
                gpu,
                &Length {
                    kind,
                    at,
                    shift,
                    unused,
                },
            )
        };
        let mut passes = Vec::new();
        for at in lengths {
            let digits = (0..32).step_by(BITS as usize);
            let digits: Result<Vec<_>, _> = digits.map(|shift| uniform(1, *at, shift)).collect();
            passes.push(digits?);
        }
        Ok(Self {
            scan: [
                scan("block_sums")?,
                scan("sum_of_blocks")?,
                scan("within_blocks")?,
            ],
            count: Kernel::new(gpu, "count_digits", &[SORT])?,
            move_pairs: Kernel::new(gpu, "move_pairs", &[SORT])?,
            passes,
            plain: uniform(0, lengths[0], 0)?,
            sums: Store::new(gpu, "sums", 0)?,
            counts: Store::new(gpu, "counts of digits", 0)?,
        })
    }

    /// Room for sorts of `len` pairs and sums of `len` values and one.
    pub(crate) fn reserve(&mut self, gpu: &Gpu, len: usize) -> Result<(), GpuError> {
        let digits = (1 << BITS) * len.div_ceil(BLOCK);
        self.counts.reserve(gpu, digits)?;
        self.sums
            .reserve(gpu, (len + 1).max(digits).div_ceil(BLOCK))
    }

    /// Replaces values by their exclusive sums: one more value than there are Gaussians.
    pub(crate) fn scan(
        &self,
        gpu: &Gpu,
        pass: &mut ComputePass<'_>,
        status: &Store,
        data: &Store,
        len: usize,
    ) {
        self.scan_as(gpu, pass, &self.plain, status, data.buffer(), len);
    }

    fn scan_as(
        &self,
        gpu: &Gpu,
        pass: &mut ComputePass<'_>,
        length: &Uniform,
        status: &Store,
        data: &Buffer,
        len: usize,
    ) {
        let groups = len.div_ceil(BLOCK) as u32;
        let [length, status, sums] = [length.buffer(), status.buffer(), self.sums.buffer()];
        let all = [(0, length), (1, status), (2, data), (3, sums)];
        let sums_alone = [(0, length), (1, status), (3, sums)];
        self.scan[0].run(gpu, pass, &all, [groups, 1]);
        self.scan[1].run(gpu, pass, &sums_alone, [1, 1]);
        self.scan[2].run(gpu, pass, &all, [groups, 1]);
    }

    /// Sorts pairs by the lowest `bits` of their keys, equal ones in their order. `length` is the
    /// index of the length among those of [`Sorter::new`], `most` a bound of it. Returns which copy
    /// has the result.
    pub(crate) fn sort(
        &self,
        gpu: &Gpu,
        pass: &mut ComputePass<'_>,
        status: &Store,
        pairs: &Pairs,
        (length, most, bits): (usize, usize, u32),
    ) -> usize {
        let groups = most.div_ceil(BLOCK) as u32;
        let counts = self.counts.buffer();
        let digits = bits.div_ceil(BITS) as usize;
        for (digit, uniform) in self.passes[length][..digits].iter().enumerate() {
            let (from, to) = (digit % 2, (digit + 1) % 2);
            let common = [
                (0, uniform.buffer()),
                (1, status.buffer()),
                (2, pairs.keys[from].buffer()),
                (3, counts),
            ];
            self.count.run(gpu, pass, &common, [groups, 1]);
            let len = (1 << BITS) * groups as usize;
            self.scan_as(gpu, pass, uniform, status, counts, len);
            let [a, b, c, d] = common;
            let all = [
                a,
                b,
                c,
                d,
                (4, pairs.values[from].buffer()),
                (5, pairs.keys[to].buffer()),
                (6, pairs.values[to].buffer()),
            ];
            self.move_pairs.run(gpu, pass, &all, [groups, 1]);
        }
        digits % 2
    }
}
