// Axes, shutter and covariance of a Gaussian.

// Rotation matrix of a quaternion of any length.
fn axes_of(q: vec4<f32>) -> mat3x3<f32> {
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    let two = 2.0 / dot(q, q);
    // Columns.
    return mat3x3<f32>(
        1.0 - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y),
        two * (x * y - w * z), 1.0 - two * (x * x + z * z), two * (y * z + w * x),
        two * (x * z + w * y), two * (y * z - w * x), 1.0 - two * (x * x + y * y),
    );
}

// Two rows of a matrix of 2x3.
struct Rows {
    first: vec3<f32>,
    second: vec3<f32>,
}

struct Shear {
    // Motion of the point, negated, m/s.
    u: vec3<f32>,
    // Velocity of the mean, px/s.
    velocity: vec2<f32>,
    // Time of the mean without shutter, s.
    time: f32,
    denominator: f32,
    stretch: f32,
}

fn shear_of(p: vec3<f32>, linear: Linear) -> Shear {
    var out: Shear;
    out.u = view.velocity.xyz + cross(view.rate.xyz, p);
    out.velocity = vec2<f32>(-dot(linear.first, out.u), -dot(linear.second, out.u));
    out.denominator = 1.0 - dot(view.time.xy, out.velocity);
    out.time = dot(view.time.xy, linear.mean - view.time.zw);
    out.stretch = 1.0 / out.denominator;
    return out;
}

// `(I + stretch v gᵀ) N`.
fn sheared(shear: Shear, root: Rows) -> Rows {
    let along = (view.time.x * root.first + view.time.y * root.second) * shear.stretch;
    return Rows(root.first + shear.velocity.x * along, root.second + shear.velocity.y * along);
}

struct Shape {
    // xx, xy, yy with dilation, px².
    covariance: vec3<f32>,
    // With dilation, px⁴.
    determinant: f32,
    // Without.
    still: f32,
}

// The determinant without cancellation: `det(N Nᵀ)` is the sum of the squares of the minors of N.
fn shape_of(root: Rows) -> Shape {
    return dilated(root, view.shape.x);
}

fn dilated(root: Rows, e: f32) -> Shape {
    var out: Shape;
    let xx = dot(root.first, root.first);
    let xy = dot(root.first, root.second);
    let yy = dot(root.second, root.second);
    let minors = cross(root.first, root.second);
    out.still = dot(minors, minors);
    out.determinant = e * (xx + yy + e) + out.still;
    out.covariance = vec3<f32>(xx + e, xy, yy + e);
    return out;
}

fn compensation_of(shape: Shape) -> f32 {
    if (view.kinds.z == 0u) {
        return 1.0;
    }
    return max(sqrt(shape.still / shape.determinant), view.shape.y);
}
