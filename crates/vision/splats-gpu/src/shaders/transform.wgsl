// From the slots of a Gaussian to the gradients of its parameters and of the camera's motion. The
// root of the covariance in the image is `N = S J R A diag(s)`: shear of the shutter, lens, camera,
// axes, scales. With G the gradient of the covariance, that of the root is `2 G N`. The root of the
// depth, the row of depth of `R A diag(s)`, is a third row that neither lens nor shutter change.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> planes: array<f32>;
@group(0) @binding(2) var<storage, read> footprints: array<Footprint>;
@group(0) @binding(3) var<storage, read> order: array<u32>;
@group(0) @binding(4) var<storage, read> first_pair: array<u32>;
@group(0) @binding(5) var<storage, read> slots: array<f32>;
// A plane per parameter.
@group(0) @binding(6) var<storage, read_write> by_parameter: array<f32>;
// Planes: whether the Gaussian is visible, absolute values (two), error, weight, motion (six).
@group(0) @binding(7) var<storage, read_write> extras: array<f32>;

const SLOT: u32 = 16u;
const EXTRAS: u32 = 11u;
// Half the step of the differences of a distorted lens's Jacobian, as a share of the distance.
const LENS_STEP: f32 = 4e-3;

fn plane(index: u32, splat: u32) -> f32 {
    return planes[index * view.counts.x + splat];
}

fn plane3(index: u32, splat: u32) -> vec3<f32> {
    return vec3<f32>(plane(index, splat), plane(index + 1u, splat), plane(index + 2u, splat));
}

fn put(index: u32, splat: u32, value: f32) {
    by_parameter[index * view.counts.x + splat] = value;
}

fn put3(index: u32, splat: u32, value: vec3<f32>) {
    put(index, splat, value.x);
    put(index + 1u, splat, value.y);
    put(index + 2u, splat, value.z);
}

// Sums of the slots, tile by tile.
fn sum_of(rank: u32) -> array<f32, 16> {
    var sums: array<f32, 16>;
    let end = min(first_pair[rank + 1u], view.counts.z);
    for (var pair = first_pair[rank]; pair < end; pair++) {
        for (var k = 0u; k < SLOT; k++) {
            sums[k] += slots[pair * SLOT + k];
        }
    }
    return sums;
}

struct ByImage {
    mean: vec2<f32>,
    root: Rows,
    depth_root: vec3<f32>,
    z: f32,
    opacity: f32,
}

// Gradients with respect to mean, roots, depth and opacity before compensation.
fn image_gradient(
    sums: array<f32, 16>, root: Rows, depth_root: vec3<f32>, z: f32, opacity: f32,
) -> ByImage {
    var out: ByImage;
    let shape = shape_of(root);
    let inverse = 1.0 / shape.determinant;
    let a = shape.covariance.z * inverse;
    let b = -shape.covariance.y * inverse;
    let c = shape.covariance.x * inverse;
    let compensation = compensation_of(shape);
    let by_opacity = -sums[0] / (opacity * compensation);
    let q = 0.5 * vec3<f32>(sums[3], sums[4], sums[5]);
    // -Q G Q, symmetric.
    let first = vec2<f32>(a * q.x + b * q.y, a * q.y + b * q.z);
    let second = vec2<f32>(b * q.x + c * q.y, b * q.y + c * q.z);
    var g = -vec3<f32>(
        first.x * a + first.y * b, first.x * b + first.y * c, second.x * b + second.y * c,
    );
    if (view.kinds.z != 0u && compensation > view.shape.y) {
        let by_square = 0.5 * by_opacity * opacity / compensation;
        let rest = 1.0 - compensation * compensation;
        let dilation = view.shape.x * inverse;
        g += by_square * vec3<f32>(rest * a - dilation, rest * b, rest * c - dilation);
    }
    let slope = slope_of(root, depth_root, shape, z);
    let by_slope = slope_gradient(slope, vec2<f32>(sums[14], sums[15]), root, depth_root, z);
    out.root = Rows(
        2.0 * (g.x * root.first + g.y * root.second) + by_slope.root.first,
        2.0 * (g.y * root.first + g.z * root.second) + by_slope.root.second,
    );
    out.depth_root = by_slope.depth_root;
    out.z = sums[11] + by_slope.z;
    out.mean = -vec2<f32>(a * sums[1] + b * sums[2], b * sums[1] + c * sums[2])
        - slope.value * sums[11];
    out.opacity = by_opacity * compensation;
    return out;
}

struct ByShear {
    mean: vec2<f32>,
    root: Rows,
    jacobian: Rows,
    point: vec3<f32>,
}

// Gradients without the shutter.
fn shear_gradient(shear: Shear, by: ByImage, still: Rows, linear: Linear) -> ByShear {
    var out: ByShear;
    let g = view.time.xy;
    let v = shear.velocity;
    let k = shear.stretch;
    let along_mean = dot(by.mean, v);
    out.mean = by.mean + k * along_mean * g;
    let along_root = (v.x * by.root.first + v.y * by.root.second) * k;
    out.root = Rows(by.root.first + g.x * along_root, by.root.second + g.y * along_root);
    // With respect to the shear's matrix, times the gradient of time.
    let by_shear = vec2<f32>(
        dot(by.root.first, still.first) * g.x + dot(by.root.first, still.second) * g.y,
        dot(by.root.second, still.first) * g.x + dot(by.root.second, still.second) * g.y,
    );
    let along = shear.time * along_mean + dot(v, by_shear);
    let by_velocity = k * (shear.time * by.mean + by_shear) + k * k * along * g;
    out.jacobian = Rows(-by_velocity.x * shear.u, -by_velocity.y * shear.u);
    let by_u = -(linear.first * by_velocity.x + linear.second * by_velocity.y);
    out.point = cross(by_u, view.rate.xyz);
    return out;
}

// Gradients through the pixel of a point and through the lens's Jacobian there.
fn lens_gradient(p: vec3<f32>, linear: Linear, mean: vec2<f32>, by: Rows) -> vec3<f32> {
    if (view.kinds.x != 0u) {
        let by_pixel = mean.x * linear.first + mean.y * linear.second;
        return by_pixel + distorted_gradient(p, linear, by);
    }
    let inverse = 1.0 / p.z;
    let focal = vec2<f32>(linear.first.x, linear.second.y);
    let slope = p.xy * inverse;
    let bounded = (slope < view.slopes.xy) | (slope > view.slopes.zw);
    let in_use = min(max(slope, view.slopes.xy), view.slopes.zw);
    let by_slope = vec2<f32>(by.first.z, by.second.z);
    // The pixel; then the Jacobian's entries f/z and -f slope/z, the slope bounded or not.
    let side = focal * (mean - select(by_slope, vec2<f32>(0.0), bounded) * inverse);
    let through_depth = select(2.0 * by_slope, by_slope, bounded) * in_use * inverse
        - mean * slope - vec2<f32>(by.first.x, by.second.y) * inverse;
    return vec3<f32>(side, dot(focal, through_depth));
}

fn jacobian_dot(lens: Linear, by: Rows) -> f32 {
    return dot(lens.first, by.first) + dot(lens.second, by.second);
}

fn distorted_gradient(p: vec3<f32>, linear: Linear, by: Rows) -> vec3<f32> {
    let step = LENS_STEP * length(p);
    let left = distorted_lens(p - vec3<f32>(step, 0.0, 0.0));
    let right = distorted_lens(p + vec3<f32>(step, 0.0, 0.0));
    let above = distorted_lens(p - vec3<f32>(0.0, step, 0.0));
    let below = distorted_lens(p + vec3<f32>(0.0, step, 0.0));
    // At the edge of the lens's domain the Jacobian is taken as constant.
    if (!(left.valid && right.valid && above.valid && below.valid)) {
        return vec3<f32>(0.0);
    }
    let x = (jacobian_dot(right, by) - jacobian_dot(left, by)) / (2.0 * step);
    let y = (jacobian_dot(below, by) - jacobian_dot(above, by)) / (2.0 * step);
    // A pixel depends on the direction alone, so that along the point itself the derivative of the
    // Jacobian is its negative.
    let z = (-jacobian_dot(linear, by) - p.x * x - p.y * y) / p.z;
    return vec3<f32>(x, y, z);
}

// Gradient of a quaternion of any length from that of its matrix, whose columns g has.
fn quaternion_gradient(value: vec4<f32>, g: mat3x3<f32>) -> vec4<f32> {
    let inverse = 1.0 / length(value);
    let q = value * inverse;
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    let a = g[1][2] - g[2][1];
    let b = g[2][0] - g[0][2];
    let c = g[0][1] - g[1][0];
    let d = g[0][1] + g[1][0];
    let e = g[0][2] + g[2][0];
    let f = g[1][2] + g[2][1];
    let by = 2.0 * vec4<f32>(
        x * a + y * b + z * c,
        y * d + z * e + w * a - 2.0 * x * (g[1][1] + g[2][2]),
        x * d + z * f + w * b - 2.0 * y * (g[0][0] + g[2][2]),
        x * e + y * f + w * c - 2.0 * z * (g[0][0] + g[1][1]),
    );
    return (by - dot(by, q) * q) * inverse;
}

// Stores the gradients of the harmonics; returns that of the position through the direction.
fn color_gradient(offset: vec3<f32>, splat: u32, by_color: vec3<f32>) -> vec3<f32> {
    let degree = view.counts.y;
    let distance = length(offset);
    let direction = offset * (1.0 / distance);
    let gradient = select(vec3<f32>(0.0), by_color, footprints[splat].color > vec3<f32>(0.0));
    var basis = basis_of(direction, degree);
    var weights: array<f32, 16>;
    for (var k = 0u; k < (degree + 1u) * (degree + 1u); k++) {
        put3(11u + 3u * k, splat, basis[k] * gradient);
        weights[k] = dot(gradient, plane3(11u + 3u * k, splat));
    }
    let by = basis_gradient(direction, weights, degree);
    return (by - direction * dot(by, direction)) / distance;
}

@compute @workgroup_size(64)
fn to_parameters(@builtin(global_invocation_id) id: vec3<u32>) {
    let rank = id.x;
    if (rank >= view.counts.x) {
        return;
    }
    let splat = order[rank];
    if (footprints[splat].z == 0.0) {
        for (var k = 0u; k < EXTRAS; k++) {
            extras[k * view.counts.x + splat] = 0.0;
        }
        return;
    }
    var sums = sum_of(rank);
    let offset = plane3(0u, splat) - view.center.xyz;
    let rotation = to_camera();
    let p = rotation * offset;
    let linear = linearize(p);
    let logs = plane3(3u, splat);
    let scale = vec3<f32>(exponential(logs.x), exponential(logs.y), exponential(logs.z));
    let quaternion = vec4<f32>(plane3(6u, splat), plane(9u, splat));
    let axes = axes_of(quaternion);
    let in_world = Rows(linear.first * rotation, linear.second * rotation);
    let still = Rows((in_world.first * axes) * scale, (in_world.second * axes) * scale);
    let depth_row = view.rotation[2].xyz;
    let depth_root = (depth_row * axes) * scale;
    let opacity = sigmoid(plane(10u, splat));
    var by_point = vec3<f32>(0.0);
    var by_jacobian = Rows(vec3<f32>(0.0), vec3<f32>(0.0));
    var mean: vec2<f32>;
    var by_root: Rows;
    var by_depth_root: vec3<f32>;
    var by_opacity: f32;
    if (view.kinds.y != 0u) {
        let shear = shear_of(p, linear);
        let by = image_gradient(sums, sheared(shear, still), depth_root, p.z, opacity);
        let unsheared = shear_gradient(shear, by, still, linear);
        mean = unsheared.mean;
        by_root = unsheared.root;
        by_jacobian = unsheared.jacobian;
        by_point = unsheared.point + vec3<f32>(0.0, 0.0, by.z);
        by_depth_root = by.depth_root;
        by_opacity = by.opacity;
    } else {
        let by = image_gradient(sums, still, depth_root, p.z, opacity);
        mean = by.mean;
        by_root = by.root;
        by_point.z = by.z;
        by_depth_root = by.depth_root;
        by_opacity = by.opacity;
    }
    // Scales, axes, lens in the axes of the world.
    let by_scale = by_root.first * still.first + by_root.second * still.second
        + by_depth_root * depth_root;
    let first = by_root.first * scale;
    let second = by_root.second * scale;
    let third = by_depth_root * scale;
    let by_axes = mat3x3<f32>(
        in_world.first * first.x + in_world.second * second.x + depth_row * third.x,
        in_world.first * first.y + in_world.second * second.y + depth_row * third.y,
        in_world.first * first.z + in_world.second * second.z + depth_row * third.z,
    );
    // Rows times the transposes of the axes and of the rotation.
    let by_camera = Rows(rotation * (axes * first), rotation * (axes * second));
    by_jacobian = Rows(by_jacobian.first + by_camera.first, by_jacobian.second + by_camera.second);
    by_point += lens_gradient(p, linear, mean, by_jacobian);
    let by_direction = color_gradient(offset, splat, vec3<f32>(sums[8], sums[9], sums[10]));
    put3(0u, splat, by_point * rotation + by_direction);
    put3(3u, splat, by_scale);
    let by_quaternion = quaternion_gradient(quaternion, by_axes);
    put3(6u, splat, by_quaternion.xyz);
    put(9u, splat, by_quaternion.w);
    put(10u, splat, by_opacity * opacity * (1.0 - opacity));

    // The camera's motion `p → p - v - ω × p`; the twist is the rotation of the covariance.
    // The row of the Jacobian that is depth is 0 0 1.
    let by_depth_row = rotation * (axes * third);
    let twist = cross(by_camera.first, linear.first) + cross(by_camera.second, linear.second)
        + cross(by_depth_row, vec3<f32>(0.0, 0.0, 1.0));
    let moved = -(by_point + rotation * by_direction);
    let turned = -twist - cross(p, by_point);
    let n = view.counts.x;
    extras[splat] = 1.0;
    extras[n + splat] = sums[6];
    extras[2u * n + splat] = sums[7];
    extras[3u * n + splat] = sums[12];
    extras[4u * n + splat] = sums[13];
    for (var k = 0u; k < 3u; k++) {
        extras[(5u + k) * n + splat] = moved[k];
        extras[(8u + k) * n + splat] = turned[k];
    }
}
