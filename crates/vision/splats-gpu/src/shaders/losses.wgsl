// Sums of the loss over all groups, in their order: L1, depth, SSIM.

struct Loss {
    size: vec4<u32>,
}

@group(0) @binding(0) var<uniform> loss: Loss;
@group(0) @binding(5) var<storage, read> sums: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> losses: array<vec4<f32>>;

const RUN: u32 = 64u;

@compute @workgroup_size(1)
fn sum_losses() {
    let groups = loss.size.z * ((loss.size.y + 15u) / 16u);
    var sum = vec4<f32>(0.0);
    for (var first = 0u; first < groups; first += RUN) {
        var of_run = vec4<f32>(0.0);
        for (var group = first; group < min(first + RUN, groups); group++) {
            of_run += sums[group];
        }
        sum += of_run;
    }
    losses[0] = sum;
}
