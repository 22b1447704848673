// From the gradient of an image to that of what was blended: exposure, depth, background. With the
// sums over each tile, and the texels of the sky that it shows.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> blended: array<f32>;
// Planes: red, green, blue after the exposure, expected depth, alpha, error.
@group(0) @binding(2) var<storage, read> gradient: array<f32>;
@group(0) @binding(3) var<storage, read> sky: array<f32>;
@group(0) @binding(4) var<storage, read> rays: array<f32>;
// Planes: red, green, blue, sum of weights times depths, what lies behind the first Gaussian,
// error.
@group(0) @binding(5) var<storage, read_write> start: array<f32>;
// Per tile: twelve of the exposure's matrix, three of one background color, and one unused.
@group(0) @binding(6) var<storage, read_write> of_tile: array<f32>;
// Per tile: first and last column and row of the sky's texels.
@group(0) @binding(7) var<storage, read_write> boxes: array<vec4<u32>>;

var<workgroup> sums: array<array<f32, 256>, 15>;
// First and last column and row of the sky's texels.
var<workgroup> lowest: array<atomic<u32>, 2>;
var<workgroup> highest: array<atomic<u32>, 2>;

@compute @workgroup_size(16, 16)
fn start_pixels(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    for (var k = 0u; k < 15u; k++) {
        sums[k][thread] = 0.0;
    }
    if (thread < 2u) {
        atomicStore(&lowest[thread], 0xffffffffu);
        atomicStore(&highest[thread], 0u);
    }
    workgroupBarrier();
    if (all(id.xy < view.size.xy)) {
        of_pixel(id.xy, thread);
    }
    workgroupBarrier();
    let tile = group.y * view.size.z + group.x;
    if (thread < 15u) {
        var sum = 0.0;
        for (var row = 0u; row < 256u; row += 16u) {
            var of_row = 0.0;
            for (var k = row; k < row + 16u; k++) {
                of_row += sums[thread][k];
            }
            sum += of_row;
        }
        of_tile[16u * tile + thread] = sum;
    }
    if (thread == 15u) {
        boxes[tile] = vec4<u32>(
            atomicLoad(&lowest[0]), atomicLoad(&highest[0]),
            atomicLoad(&lowest[1]), atomicLoad(&highest[1]),
        );
    }
}

fn of_pixel(at: vec2<u32>, thread: u32) {
    let pixels = view.size.x * view.size.y;
    let pixel = at.y * view.size.x + at.x;
    let transmittance = blended[pixel];
    let color = vec3<f32>(
        blended[pixels + pixel], blended[2u * pixels + pixel], blended[3u * pixels + pixel],
    );
    let depth = blended[4u * pixels + pixel];
    let background = background_of(at, transmittance);
    let outer = vec3<f32>(
        gradient[pixel], gradient[pixels + pixel], gradient[2u * pixels + pixel],
    );
    // Times the transpose of the exposure's matrix.
    let g = outer.x * view.exposure[0].xyz + outer.y * view.exposure[1].xyz
        + outer.z * view.exposure[2].xyz;
    var g_alpha = gradient[4u * pixels + pixel];
    var g_depth = 0.0;
    let alpha = 1.0 - transmittance;
    if (alpha >= view.limits.y) {
        g_depth = gradient[3u * pixels + pixel] / alpha;
        g_alpha -= g_depth * depth / alpha;
    }
    let behind = g_depth * depth + dot(g, color) - transmittance * (g_alpha - dot(g, background));
    start[pixel] = g.x;
    start[pixels + pixel] = g.y;
    start[2u * pixels + pixel] = g.z;
    start[3u * pixels + pixel] = g_depth;
    start[4u * pixels + pixel] = behind;
    start[5u * pixels + pixel] = gradient[5u * pixels + pixel];

    let seen = vec4<f32>(color + background * transmittance, 1.0);
    for (var row = 0u; row < 3u; row++) {
        for (var column = 0u; column < 4u; column++) {
            sums[4u * row + column][thread] = outer[row] * seen[column];
        }
    }
    if (transmittance <= view.limits.x) {
        return;
    }
    if (view.counts.w == 0u) {
        for (var c = 0u; c < 3u; c++) {
            sums[12u + c][thread] = g[c] * transmittance;
        }
        return;
    }
    let direction = ray_of(at);
    if (any(direction != vec3<f32>(0.0))) {
        let taps = taps_of(direction);
        atomicMin(&lowest[0], taps.column);
        atomicMax(&highest[0], taps.column + 1u);
        atomicMin(&lowest[1], taps.row);
        atomicMax(&highest[1], taps.row + 1u);
    }
}
