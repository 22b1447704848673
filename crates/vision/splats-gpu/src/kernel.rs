//! Kernels: a WGSL source with an entry point, and what it is bound to.

use wgpu::{BindGroupEntry, Buffer, ComputePass};

use crate::device::Gpu;
use crate::error::GpuError;

/// A compiled kernel.
#[derive(Debug)]
pub(crate) struct Kernel {
    pipeline: wgpu::ComputePipeline,
    name: &'static str,
}

impl Kernel {
    /// Compiles the entry point `name` of some sources.
    pub(crate) fn new(
        gpu: &Gpu,
        name: &'static str,
        sources: &[&'static str],
    ) -> Result<Self, GpuError> {
        let pipeline = gpu.attempt("compiling a kernel", || {
            let source = sources.concat();
            let module = gpu
                .device
                .create_shader_module(wgpu::ShaderModuleDescriptor {
                    label: Some(name),
                    source: wgpu::ShaderSource::Wgsl(source.into()),
                });
            gpu.device
                .create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                    label: Some(name),
                    layout: None,
                    module: &module,
                    entry_point: Some(name),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    cache: None,
                })
        })?;
        Ok(Self { pipeline, name })
    }

    /// Runs the kernel on groups of threads, with the buffers of its bindings.
    pub(crate) fn run(
        &self,
        gpu: &Gpu,
        pass: &mut ComputePass<'_>,
        buffers: &[(u32, &Buffer)],
        [x, y]: [u32; 2],
    ) {
        if x == 0 || y == 0 {
            return;
        }
        let entries: Vec<BindGroupEntry<'_>> = buffers
            .iter()
            .map(|(binding, buffer)| BindGroupEntry {
                binding: *binding,
                resource: buffer.as_entire_binding(),
            })
            .collect();
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(self.name),
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(x, y, 1);
    }
}
