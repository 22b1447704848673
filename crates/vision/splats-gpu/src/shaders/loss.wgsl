// The loss of an image and its gradient: L1, SSIM with a separable window of 11x11 pixels, depth.
// Formulas as `train/loss.rs` of `splats` has them.

struct Loss {
    // Columns, rows, columns of groups, whether there are depths.
    size: vec4<u32>,
    // Gradient of L1, weight of SSIM per value, weight of depth, square of the noise.
    weights: vec4<f32>,
    // Errors of depth that count linearly, sigmas; smallest sigma, m.
    depth: vec4<f32>,
    // The window from its middle outward.
    window: array<vec4<f32>, 2>,
}

@group(0) @binding(0) var<uniform> loss: Loss;
// Planes: red, green, blue, expected and median depth (0 where there is none), alpha.
@group(0) @binding(1) var<storage, read> image: array<f32>;
// Red, green, blue and 255 where the pixel may be used, from the lowest byte on.
@group(0) @binding(2) var<storage, read> recorded: array<u32>;
// Planes: depth (0 where unknown) and sigma, m.
@group(0) @binding(3) var<storage, read> depths: array<f32>;
// Planes: red, green, blue, expected depth, alpha, error.
@group(0) @binding(4) var<storage, read_write> gradient: array<f32>;
// Per group: L1, depth, SSIM, all as sums, and one unused.
@group(0) @binding(5) var<storage, read_write> sums: array<vec4<f32>>;
// Blurred along x, a plane per quantity and channel.
@group(0) @binding(6) var<storage, read_write> blurred: array<f32>;
// Derivatives of the similarity by mean, square and product, per channel.
@group(0) @binding(7) var<storage, read_write> by: array<f32>;

const RADIUS: u32 = 5u;
// Smallest value of 8 bits at which a sensor saturates.
const SATURATED: u32 = 254u;
const C1: f32 = 1e-4;
const C2: f32 = 9e-4;

var<workgroup> partial: array<vec2<f32>, 256>;

fn pixels() -> u32 {
    return loss.size.x * loss.size.y;
}

fn is_valid(pixel: u32) -> bool {
    return recorded[pixel] >> 24u != 0u;
}

fn rendered(pixel: u32, channel: u32) -> f32 {
    return image[channel * pixels() + pixel];
}

fn recorded_value(pixel: u32, channel: u32) -> u32 {
    return (recorded[pixel] >> (8u * channel)) & 255u;
}

// Whether the rendered color is above a saturated one, which bounds it from below only.
fn exceeds(pixel: u32, channel: u32) -> bool {
    let value = recorded_value(pixel, channel);
    return value >= SATURATED && rendered(pixel, channel) > f32(value) / 255.0;
}

// The recorded color; where it may not be used or is exceeded the rendered one.
fn target_of(pixel: u32, channel: u32) -> f32 {
    if (is_valid(pixel) && !exceeds(pixel, channel)) {
        return f32(recorded_value(pixel, channel)) / 255.0;
    }
    return rendered(pixel, channel);
}

fn tap(distance: u32) -> f32 {
    return loss.window[distance / 4u][distance % 4u];
}

// The sum of all threads, in their order, at thread 0.
fn total(thread: u32, value: vec2<f32>) -> vec2<f32> {
    partial[thread] = value;
    workgroupBarrier();
    var sum = vec2<f32>(0.0);
    if (thread == 0u) {
        for (var row = 0u; row < 256u; row += 16u) {
            var of_row = vec2<f32>(0.0);
            for (var k = row; k < row + 16u; k++) {
                of_row += partial[k];
            }
            sum += of_row;
        }
    }
    return sum;
}

@compute @workgroup_size(16, 16)
fn compare(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    var value = vec2<f32>(0.0);
    if (all(id.xy < loss.size.xy)) {
        let pixel = id.y * loss.size.x + id.x;
        let n = pixels();
        var error = 0.0;
        for (var c = 0u; c < 3u; c++) {
            let r = rendered(pixel, c) - target_of(pixel, c);
            gradient[c * n + pixel] = loss.weights.x * sign(r);
            value.x += abs(r);
            error += r * r / sqrt(r * r + loss.weights.w) / 3.0;
        }
        let of_depth = depth_of(pixel);
        value.y = of_depth.x;
        gradient[3u * n + pixel] = of_depth.y;
        gradient[4u * n + pixel] = 0.0;
        gradient[5u * n + pixel] = error;
    }
    let sum = total(thread, value);
    if (thread == 0u) {
        sums[group.y * loss.size.z + group.x] = vec4<f32>(sum, 0.0, 0.0);
    }
}

// Robust squared error of the depth, and its gradient times the weight.
fn depth_of(pixel: u32) -> vec2<f32> {
    let n = pixels();
    if (loss.size.w == 0u || !is_valid(pixel)) {
        return vec2<f32>(0.0);
    }
    let z = image[3u * n + pixel];
    let d = depths[pixel];
    let sigma = max(depths[n + pixel], loss.depth.y);
    if (image[5u * n + pixel] <= 0.5 || z <= 0.0 || d <= 0.0) {
        return vec2<f32>(0.0);
    }
    let scale = loss.depth.x;
    let factor = d * d / sigma;
    let e = (1.0 / z - 1.0 / d) * factor;
    let root = sqrt(1.0 + e * e / (scale * scale));
    return vec2<f32>(
        scale * scale * (root - 1.0),
        -loss.weights.z * e / root * factor / (z * z),
    );
}

// Means, squares and products along x.
@compute @workgroup_size(16, 16)
fn blur_images(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= loss.size.xy)) {
        return;
    }
    let n = pixels();
    let row = id.y * loss.size.x;
    let first = max(id.x, RADIUS) - RADIUS;
    let end = min(id.x + RADIUS + 1u, loss.size.x);
    for (var c = 0u; c < 3u; c++) {
        var means = vec2<f32>(0.0);
        var products = vec3<f32>(0.0);
        for (var x = first; x < end; x++) {
            let weight = tap(max(x, id.x) - min(x, id.x));
            let a = rendered(row + x, c);
            let b = target_of(row + x, c);
            means += weight * vec2<f32>(a, b);
            products += weight * vec3<f32>(a * a, b * b, a * b);
        }
        let to = 5u * c * n + row + id.x;
        blurred[to] = means.x;
        blurred[to + n] = means.y;
        blurred[to + 2u * n] = products.x;
        blurred[to + 3u * n] = products.y;
        blurred[to + 4u * n] = products.z;
    }
}

// A plane that is blurred along x, along y.
fn blur_down(plane: u32, at: vec2<u32>) -> f32 {
    let n = pixels();
    let first = max(at.y, RADIUS) - RADIUS;
    let end = min(at.y + RADIUS + 1u, loss.size.y);
    var sum = 0.0;
    for (var y = first; y < end; y++) {
        sum += tap(max(y, at.y) - min(y, at.y)) * blurred[plane * n + y * loss.size.x + at.x];
    }
    return sum;
}

// Similarity and its derivatives times minus the weight; 0 where a pixel may not be used.
@compute @workgroup_size(16, 16)
fn similarity(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    var value = vec2<f32>(0.0);
    if (all(id.xy < loss.size.xy)) {
        value.x = similarity_of(id.xy);
    }
    let sum = total(thread, value);
    if (thread == 0u) {
        sums[group.y * loss.size.z + group.x].z = sum.x;
    }
}

fn similarity_of(at: vec2<u32>) -> f32 {
    let n = pixels();
    let pixel = at.y * loss.size.x + at.x;
    let weight = select(0.0, -loss.weights.y, is_valid(pixel));
    var sum = 0.0;
    for (var c = 0u; c < 3u; c++) {
        let mx = blur_down(5u * c, at);
        let my = blur_down(5u * c + 1u, at);
        let exx = blur_down(5u * c + 2u, at);
        let eyy = blur_down(5u * c + 3u, at);
        let exy = blur_down(5u * c + 4u, at);
        let a1 = 2.0 * mx * my + C1;
        let a2 = 2.0 * (exy - mx * my) + C2;
        let i1 = 1.0 / (mx * mx + my * my + C1);
        let i2 = 1.0 / (exx - mx * mx + eyy - my * my + C2);
        let s = a1 * a2 * i1 * i2;
        sum += s;
        let by_mean = 2.0 * my * (a2 - a1) * i1 * i2 - 2.0 * mx * s * (i1 - i2);
        by[3u * c * n + pixel] = weight * by_mean;
        by[(3u * c + 1u) * n + pixel] = -weight * s * i2;
        by[(3u * c + 2u) * n + pixel] = weight * 2.0 * a1 * i1 * i2;
    }
    return select(0.0, sum, is_valid(pixel));
}

@compute @workgroup_size(16, 16)
fn blur_derivatives(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= loss.size.xy)) {
        return;
    }
    let n = pixels();
    let row = id.y * loss.size.x;
    let first = max(id.x, RADIUS) - RADIUS;
    let end = min(id.x + RADIUS + 1u, loss.size.x);
    for (var plane = 0u; plane < 9u; plane++) {
        var sum = 0.0;
        for (var x = first; x < end; x++) {
            sum += tap(max(x, id.x) - min(x, id.x)) * by[plane * n + row + x];
        }
        blurred[plane * n + row + id.x] = sum;
    }
}

@compute @workgroup_size(16, 16)
fn add_derivatives(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= loss.size.xy)) {
        return;
    }
    let n = pixels();
    let pixel = id.y * loss.size.x + id.x;
    if (!is_valid(pixel)) {
        return;
    }
    for (var c = 0u; c < 3u; c++) {
        if (exceeds(pixel, c)) {
            continue;
        }
        let by_mean = blur_down(3u * c, id.xy);
        let by_square = blur_down(3u * c + 1u, id.xy);
        let by_product = blur_down(3u * c + 2u, id.xy);
        let x = rendered(pixel, c);
        let y = target_of(pixel, c);
        gradient[c * n + pixel] += by_mean + 2.0 * x * by_square + y * by_product;
    }
}
