// Gradients of a tile: the sums over its pixels for each of its Gaussians, front to back, into the
// slot of the pair. With `s = ∂L/∂σ` and `d = u - m`: `s`, `s d`, `s d dᵀ`, absolute values of the
// gradient with respect to the mean, color and depth, error, weight, the slope of depth.
//
// A thread has a pixel and blends a few Gaussians; then a thread has a Gaussian and some pixels.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> footprints: array<Footprint>;
@group(0) @binding(2) var<storage, read> splat_of_pair: array<u32>;
@group(0) @binding(3) var<storage, read> entries: array<u32>;
@group(0) @binding(4) var<storage, read> first_entry: array<u32>;
@group(0) @binding(5) var<storage, read> start: array<f32>;
@group(0) @binding(6) var<storage, read_write> slots: array<f32>;

const SLOT: u32 = 16u;
// Gaussians at a time, and threads of each.
const BATCH: u32 = 7u;
const SHARE: u32 = 32u;
// Threads that have a Gaussian.
const SUMMING: u32 = 224u;

// Weight and `s` of each pixel: 14 x 256; then partial sums of each thread: 16 x 224.
var<workgroup> shared_values: array<f32, 3584>;
var<workgroup> live: atomic<u32>;
var<workgroup> is_live: u32;

@compute @workgroup_size(16, 16)
fn sum_pixels(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let pixels = view.size.x * view.size.y;
    let pixel = id.y * view.size.x + id.x;
    let at = vec2<f32>(id.xy);
    var open = all(id.xy < view.size.xy);
    var color = vec4<f32>(0.0);
    var behind = 0.0;
    if (open) {
        color = vec4<f32>(
            start[pixel], start[pixels + pixel], start[2u * pixels + pixel],
            start[3u * pixels + pixel],
        );
        behind = start[4u * pixels + pixel];
    }
    var transmittance = 1.0;
    let tile = group.y * view.size.z + group.x;
    let first = first_entry[tile];
    let end = first_entry[tile + 1u];
    var entry = first;
    loop {
        if (thread == 0u) {
            atomicStore(&live, 0u);
        }
        workgroupBarrier();
        if (open) {
            atomicOr(&live, 1u);
        }
        workgroupBarrier();
        if (thread == 0u) {
            is_live = atomicLoad(&live);
        }
        let goes_on = workgroupUniformLoad(&is_live);
        if (goes_on == 0u || entry >= end) {
            break;
        }
        for (var k = 0u; k < BATCH; k++) {
            var weight = 0.0;
            var by_sigma = 0.0;
            if (open && entry + k < end) {
                let splat = splat_of_pair[entries[entry + k]];
                let conic = footprints[splat].conic;
                let d = at - footprints[splat].mean;
                let across = fma(0.5 * conic.x, d.x, conic.y * d.y);
                let sigma = fma(across, d.x, 0.5 * conic.z * d.y * d.y);
                let unbounded = footprints[splat].opacity * exponential(-sigma);
                let alpha = min(unbounded, view.shape.z);
                if (alpha >= view.shape.w) {
                    let product = transmittance * alpha;
                    let next = transmittance - product;
                    if (next <= view.limits.x) {
                        open = false;
                    } else {
                        let slope = footprints[splat].slope;
                        let z = fma(slope.x, d.x, footprints[splat].z + slope.y * d.y);
                        let values = vec4<f32>(footprints[splat].color, z);
                        let own = dot(color, values);
                        weight = product;
                        behind -= weight * own;
                        // Where alpha is bounded, nothing that it depends on matters.
                        if (unbounded <= view.shape.z) {
                            let by_alpha = transmittance * own - behind / (1.0 - alpha);
                            by_sigma = -alpha * by_alpha;
                        }
                        transmittance = next;
                    }
                }
            }
            shared_values[2u * k * 256u + thread] = weight;
            shared_values[(2u * k + 1u) * 256u + thread] = by_sigma;
        }
        workgroupBarrier();
        var sums = gather(group.xy, thread, entry, end);
        workgroupBarrier();
        if (thread < SUMMING) {
            for (var k = 0u; k < SLOT; k++) {
                shared_values[k * SUMMING + thread] = sums[k];
            }
        }
        workgroupBarrier();
        // A thread per Gaussian and sum.
        if (thread < BATCH * SLOT) {
            let item = thread / SLOT;
            let sum_of = thread % SLOT;
            var sum = 0.0;
            for (var k = 0u; k < SHARE; k++) {
                sum += shared_values[sum_of * SUMMING + item * SHARE + k];
            }
            if (entry + item < end) {
                slots[entries[entry + item] * SLOT + sum_of] = sum;
            }
        }
        workgroupBarrier();
        entry += BATCH;
    }
    // Gaussians that no pixel shows any more.
    for (var k = entry * SLOT + thread; k < end * SLOT; k += 256u) {
        slots[entries[k / SLOT] * SLOT + k % SLOT] = 0.0;
    }
}

// Sums over the eight pixels of a thread for its Gaussian of the batch.
fn gather(group: vec2<u32>, thread: u32, entry: u32, end: u32) -> array<f32, 16> {
    var sums: array<f32, 16>;
    let item = thread / SHARE;
    if (item >= BATCH || entry + item >= end) {
        return sums;
    }
    let pixels = view.size.x * view.size.y;
    let splat = splat_of_pair[entries[entry + item]];
    let mean = footprints[splat].mean;
    let conic = footprints[splat].conic;
    for (var k = 0u; k < 8u; k++) {
        let local = (thread % SHARE) * 8u + k;
        let weight = shared_values[2u * item * 256u + local];
        let s = shared_values[(2u * item + 1u) * 256u + local];
        if (weight == 0.0) {
            continue;
        }
        let at = TILE * group + vec2<u32>(local % TILE, local / TILE);
        let pixel = at.y * view.size.x + at.x;
        let d = vec2<f32>(at) - mean;
        let along = s * d;
        sums[0] += s;
        sums[1] += along.x;
        sums[2] += along.y;
        sums[3] += along.x * d.x;
        sums[4] += along.x * d.y;
        sums[5] += along.y * d.y;
        sums[6] += abs(conic.x * along.x + conic.y * along.y);
        sums[7] += abs(conic.y * along.x + conic.z * along.y);
        for (var c = 0u; c < 4u; c++) {
            sums[8u + c] += weight * start[c * pixels + pixel];
        }
        sums[12] += weight * start[5u * pixels + pixel];
        sums[13] += weight;
        let by_depth = weight * start[3u * pixels + pixel];
        sums[14] += by_depth * d.x;
        sums[15] += by_depth * d.y;
    }
    return sums;
}
