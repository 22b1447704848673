// Adam (Kingma and Ba, ICLR 2015) on the Gaussians that a step shows, and on the background. After
// a step that could not be computed nothing changes any more until the processor has looked.

struct Step {
    // Gaussians, planes, number of the step, colors of the background times three.
    counts: vec4<u32>,
    // Number of the instant and one, whether harmonics above degree 0 are trained, unused.
    flags: vec4<u32>,
    // Learning rates: position, scale, rotation, opacity.
    rates: vec4<f32>,
    // Color, harmonics, background, epsilon.
    more_rates: vec4<f32>,
    // One minus both decays, correction of the background's moments, smallest error times pixels.
    moments: vec4<f32>,
    // Halves of the image, px; recorded pixels per pixel; learning rate of positions as a share of
    // the largest scale.
    size: vec4<f32>,
}

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read_write> status: array<u32>;
@group(0) @binding(2) var<storage, read> extras: array<f32>;
@group(0) @binding(3) var<storage, read> by_parameter: array<f32>;
@group(0) @binding(4) var<storage, read_write> planes: array<f32>;
// Pairs of both moments.
@group(0) @binding(5) var<storage, read_write> moments: array<vec2<f32>>;
// Steps of each Gaussian: of the harmonics above degree 0, then of all others.
@group(0) @binding(6) var<storage, read_write> steps: array<u32>;
@group(0) @binding(7) var<storage, read> corrections: array<f32>;
// Planes: error, instants, last instant and one, gradient, views, weight; floats as bits.
@group(0) @binding(8) var<storage, read_write> observed: array<u32>;
@group(0) @binding(9) var<storage, read> by_texel: array<f32>;
@group(0) @binding(10) var<storage, read_write> background: array<f32>;
@group(0) @binding(11) var<storage, read_write> background_moments: array<vec2<f32>>;

const OVERFLOW: u32 = 5u;
const NOT_FINITE: u32 = 6u;
const HALTED: u32 = 7u;
const HALTED_AT: u32 = 8u;
const MAX_STEPS: u32 = 8192u;
const COLOR_END: u32 = 14u;

fn is_finite(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7f800000u) != 0x7f800000u;
}

@compute @workgroup_size(64)
fn check_finite(@builtin(global_invocation_id) id: vec3<u32>) {
    var finite = true;
    if (id.x < step.counts.x && extras[id.x] > 0.0) {
        for (var plane = 0u; plane < step.counts.y; plane++) {
            finite = finite && is_finite(by_parameter[plane * step.counts.x + id.x]);
        }
    }
    if (id.x < step.counts.w) {
        finite = finite && is_finite(by_texel[id.x]);
    }
    if (!finite) {
        // All threads that write, write the same.
        status[NOT_FINITE] = 1u;
    }
}

@compute @workgroup_size(1)
fn halt() {
    if (status[HALTED] == 0u && (status[OVERFLOW] != 0u || status[NOT_FINITE] != 0u)) {
        status[HALTED] = 1u;
        status[HALTED_AT] = step.counts.z;
    }
}

fn rate_of(plane: u32) -> f32 {
    if (plane < 6u) {
        return step.rates.y;
    }
    if (plane < 10u) {
        return step.rates.z;
    }
    if (plane == 10u) {
        return step.rates.w;
    }
    return select(step.more_rates.y, step.more_rates.x, plane < COLOR_END);
}

// The moments after a gradient.
fn updated(before: vec2<f32>, g: f32) -> vec2<f32> {
    return before + step.moments.xy * (vec2<f32>(g, g * g) - before);
}

@compute @workgroup_size(64)
fn step_splats(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = step.counts.x;
    let splat = id.x;
    if (splat >= n || status[HALTED] != 0u || extras[splat] == 0.0) {
        return;
    }
    if (step.flags.y != 0u) {
        steps[splat] = min(steps[splat] + 1u, MAX_STEPS);
    }
    steps[n + splat] = min(steps[n + splat] + 1u, MAX_STEPS);
    // The scales are planes 3 to 5, which are changed after the positions.
    let scale = max(planes[3u * n + splat], max(planes[4u * n + splat], planes[5u * n + splat]));
    let position_rate = step.size.w * exp(scale) + step.rates.x;
    for (var plane = 0u; plane < step.counts.y; plane++) {
        let rate = select(rate_of(plane), position_rate, plane < 3u);
        if (rate == 0.0) {
            continue;
        }
        let count = steps[select(0u, n, plane < COLOR_END) + splat];
        let at = plane * n + splat;
        let after = updated(moments[at], by_parameter[at]);
        moments[at] = after;
        let change = corrections[count - 1u] * after.x / (sqrt(after.y) + step.more_rates.w);
        let value = planes[at] - rate * change;
        if (is_finite(value)) {
            planes[at] = value;
        }
    }
}

@compute @workgroup_size(64)
fn observe(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = step.counts.x;
    let splat = id.x;
    if (splat >= n || status[HALTED] != 0u || extras[splat] == 0.0) {
        return;
    }
    let area = step.size.z;
    let absolute = vec2<f32>(extras[n + splat], extras[2u * n + splat]) * step.size.xy;
    let error = extras[3u * n + splat] * area;
    let weight = extras[4u * n + splat] * area;
    observed[splat] = bitcast<u32>(max(bitcast<f32>(observed[splat]), error));
    if (error >= step.moments.w && observed[2u * n + splat] != step.flags.x) {
        observed[n + splat] += 1u;
        observed[2u * n + splat] = step.flags.x;
    }
    let gradient = bitcast<f32>(observed[3u * n + splat]) + sqrt(dot(absolute, absolute));
    observed[3u * n + splat] = bitcast<u32>(gradient);
    observed[4u * n + splat] += 1u;
    observed[5u * n + splat] = bitcast<u32>(max(bitcast<f32>(observed[5u * n + splat]), weight));
}

@compute @workgroup_size(64)
fn step_background(@builtin(global_invocation_id) id: vec3<u32>) {
    let at = id.x;
    if (at >= step.counts.w || status[HALTED] != 0u) {
        return;
    }
    let g = by_texel[at];
    // A texel that the view does not show keeps its moments.
    if (g != 0.0) {
        let after = updated(background_moments[at], g);
        background_moments[at] = after;
        let change = step.moments.z * after.x / (sqrt(after.y) + step.more_rates.w);
        background[at] -= step.more_rates.z * change;
    }
}
