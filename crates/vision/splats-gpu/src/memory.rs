//! Buffers of the device, that grow and keep their size, and their way back.

use bytemuck::Pod;
use wgpu::{Buffer, BufferUsages, CommandEncoder};

use crate::device::Gpu;
use crate::error::GpuError;

/// Smallest number of values: those of the largest structure in an array.
const MIN_LEN: usize = 16;

/// A buffer of 32-bit values.
#[derive(Debug)]
pub(crate) struct Store {
    what: &'static str,
    buffer: Buffer,
}

impl Store {
    /// A buffer of `len` values, zeros.
    pub(crate) fn new(gpu: &Gpu, what: &'static str, len: usize) -> Result<Self, GpuError> {
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let buffer = buffer(gpu, what, len, usage)?;
        Ok(Self { what, buffer })
    }

    /// A buffer with these values.
    pub(crate) fn of<T: Pod>(gpu: &Gpu, what: &'static str, of: &[T]) -> Result<Self, GpuError> {
        let store = Self::new(gpu, what, of.len())?;
        store.write(gpu, 0, of);
        Ok(store)
    }

    /// Room for at least `len` values; those that were there are lost if it grows.
    pub(crate) fn reserve(&mut self, gpu: &Gpu, len: usize) -> Result<(), GpuError> {
        if self.len() < len {
            *self = Self::new(gpu, self.what, len)?;
        }
        Ok(())
    }

    /// Number of values that fit.
    pub(crate) fn len(&self) -> usize {
        (self.buffer.size() / 4) as usize
    }

    pub(crate) fn write<T: Pod>(&self, gpu: &Gpu, at: usize, of: &[T]) {
        if !of.is_empty() {
            let bytes = bytemuck::cast_slice(of);
            gpu.queue.write_buffer(&self.buffer, 4 * at as u64, bytes);
        }
    }

    pub(crate) fn buffer(&self) -> &Buffer {
        &self.buffer
    }
}

/// A uniform buffer of one value.
#[derive(Debug)]
pub(crate) struct Uniform(Buffer);

impl Uniform {
    pub(crate) fn new<T: Pod>(gpu: &Gpu, value: &T) -> Result<Self, GpuError> {
        let usage = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        let out = Self(buffer(gpu, "settings", size_of::<T>().div_ceil(4), usage)?);
        out.write(gpu, value);
        Ok(out)
    }

    pub(crate) fn write<T: Pod>(&self, gpu: &Gpu, value: &T) {
        let bytes = bytemuck::bytes_of(value);
        gpu.queue.write_buffer(&self.0, 0, bytes);
    }

    pub(crate) fn buffer(&self) -> &Buffer {
        &self.0
    }
}

/// Copies of the first values of some buffers, on their way to the processor.
pub(crate) struct Download {
    buffer: Buffer,
    lens: Vec<usize>,
}

impl Download {
    /// Copies after the work that was encoded.
    pub(crate) fn new(
        gpu: &Gpu,
        encoder: &mut CommandEncoder,
        from: &[(&Store, usize)],
    ) -> Result<Self, GpuError> {
        let lens: Vec<usize> = from.iter().map(|(_, len)| *len).collect();
        let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
        let buffer = buffer(gpu, "results", lens.iter().sum(), usage)?;
        let mut at = 0;
        for (store, len) in from {
            let bytes = 4 * *len as u64;
            if bytes > 0 {
                encoder.copy_buffer_to_buffer(&store.buffer, 0, &buffer, at, bytes);
            }
            at += bytes;
        }
        Ok(Self { buffer, lens })
    }

    /// Waits for the work and returns the values, buffer by buffer.
    pub(crate) fn read(self, gpu: &Gpu) -> Result<Vec<Vec<u32>>, GpuError> {
        let slice = self.buffer.slice(..);
        let (to, done) = std::sync::mpsc::sync_channel(1);
        slice.map_async(wgpu::MapMode::Read, move |result| {
            // The receiver waits, or has given up after an error.
            let _ = to.send(result);
        });
        gpu.wait()?;
        match done.try_recv() {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Err(gpu.lost(error.to_string())),
            Err(error) => return Err(gpu.lost(error.to_string())),
        }
        let range = slice.get_mapped_range();
        let range = range.map_err(|error| gpu.lost(error.to_string()))?;
        let all: Vec<u32> = bytemuck::pod_collect_to_vec(&range[..]);
        let mut rest = &all[..];
        let mut out = Vec::with_capacity(self.lens.len());
        for len in self.lens {
            let (part, after) = rest.split_at(len);
            out.push(part.to_vec());
            rest = after;
        }
        Ok(out)
    }
}

/// The bits as numbers.
pub(crate) fn floats(of: &[u32]) -> Vec<f32> {
    of.iter().map(|bits| f32::from_bits(*bits)).collect()
}

fn buffer(
    gpu: &Gpu,
    what: &'static str,
    len: usize,
    usage: BufferUsages,
) -> Result<Buffer, GpuError> {
    // Empty buffers cannot be bound, nor those below the size of a structure.
    let bytes = 4 * len.max(MIN_LEN) as u64;
    let limits = gpu.device.limits();
    let limit = limits
        .max_buffer_size
        .min(limits.max_storage_buffer_binding_size);
    if bytes > limit {
        let name = gpu.name().to_owned();
        return Err(GpuError::TooLarge {
            what,
            bytes,
            limit,
            name,
        });
    }
    gpu.attempt(what, || {
        gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(what),
            size: bytes,
            usage,
            mapped_at_creation: false,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::Adapters;

    #[test]
    fn buffers_beyond_the_limit_are_refused_in_bytes() {
        let gpu = match Gpu::open(Adapters::SoftwareToo) {
            Ok(gpu) => gpu,
            Err(error) => {
                let required = std::env::var_os("PAWS_GPU_REQUIRED").is_some();
                assert!(!required, "PAWS_GPU_REQUIRED is set, but {error}");
                eprintln!("skipped: {error}");
                return;
            }
        };
        let error = Store::new(&gpu, "a test", 1 << 50).unwrap_err();
        let expected = matches!(
            error,
            GpuError::TooLarge { what: "a test", bytes, .. } if bytes == 1 << 52
        );
        assert!(expected, "{error}");
        let mut store = Store::of(&gpu, "a test", &[1_u32; 20]).unwrap();
        store.reserve(&gpu, 10).unwrap();
        assert_eq!(store.len(), 20);
        store.reserve(&gpu, 30).unwrap();
        assert_eq!(store.len(), 30);
    }
}
