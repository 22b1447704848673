// Sums over all tiles and over all Gaussians, in their order.

@group(0) @binding(0) var<uniform> view: View;
// Per tile: twelve of the exposure's matrix, three of one background color, and one unused.
@group(0) @binding(1) var<storage, read> of_tile: array<f32>;
@group(0) @binding(2) var<storage, read> extras: array<f32>;
// The sums over tiles, then the six of the motion.
@group(0) @binding(3) var<storage, read_write> totals: array<f32>;
// Gradient of the texels, or of one color.
@group(0) @binding(4) var<storage, read_write> by_texel: array<f32>;

const THREADS: u32 = 64u;
const RUN: u32 = 64u;

var<workgroup> of_thread: array<array<f32, 64>, 6>;

@compute @workgroup_size(64)
fn sum_tiles(@builtin(local_invocation_index) thread: u32) {
    if (thread >= 15u) {
        return;
    }
    let tiles = view.size.z * view.size.w;
    var sum = 0.0;
    for (var first = 0u; first < tiles; first += RUN) {
        var of_run = 0.0;
        for (var tile = first; tile < min(first + RUN, tiles); tile++) {
            of_run += of_tile[16u * tile + thread];
        }
        sum += of_run;
    }
    totals[thread] = sum;
    if (thread >= 12u && view.counts.w == 0u) {
        by_texel[thread - 12u] = sum;
    }
}

@compute @workgroup_size(64)
fn sum_motion(@builtin(local_invocation_index) thread: u32) {
    let n = view.counts.x;
    let each = (n + THREADS - 1u) / THREADS;
    for (var k = 0u; k < 6u; k++) {
        var sum = 0.0;
        let end = min((thread + 1u) * each, n);
        for (var first = thread * each; first < end; first += RUN) {
            var of_run = 0.0;
            for (var splat = first; splat < min(first + RUN, end); splat++) {
                of_run += extras[(5u + k) * n + splat];
            }
            sum += of_run;
        }
        of_thread[k][thread] = sum;
    }
    workgroupBarrier();
    if (thread < 6u) {
        var sum = 0.0;
        for (var k = 0u; k < THREADS; k++) {
            sum += of_thread[thread][k];
        }
        totals[16u + thread] = sum;
    }
}
