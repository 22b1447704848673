// The camera, the settings and a Gaussian in the image, as all passes see them.

struct View {
    // Columns, rows, columns of tiles, rows of tiles.
    size: vec4<u32>,
    // Gaussians, degree of the harmonics, pairs that fit, edge of the sky in texels (0: one color).
    counts: vec4<u32>,
    // Lens (0 pinhole, 1 radial, 2 fisheye, 3 double sphere, 4 EUCM), rolling shutter, compensation.
    kinds: vec4<u32>,
    // `camera_from_world`, rows.
    rotation: array<vec4<f32>, 3>,
    // The camera in the world, m.
    center: vec4<f32>,
    // Focal lengths and principal point, px.
    focal: vec4<f32>,
    // Slopes beyond which a pinhole camera is linearized at the bound: lowest, highest.
    slopes: vec4<f32>,
    // Pixels beyond which a lens with distortion is not linearized: lowest, highest.
    bounds: vec4<f32>,
    // Parameters of the lens.
    lens: array<vec4<f32>, 3>,
    // Gradient of the time, s/px, and reference, px.
    time: vec4<f32>,
    // m/s, rad/s.
    velocity: vec4<f32>,
    rate: vec4<f32>,
    // Dilation, smallest compensation, largest and smallest alpha.
    shape: vec4<f32>,
    // Smallest transmittance, smallest alpha with a depth, nearest and farthest depth.
    limits: vec4<f32>,
    // Smallest shear, reach of an opaque Gaussian, dilation of the slope of depth, and the largest
    // standard deviation of depth as a share of the distance from the nearest one.
    bound: vec4<f32>,
    // Rows of the exposure.
    exposure: array<vec4<f32>, 3>,
}

struct Footprint {
    // px
    mean: vec2<f32>,
    // Half of the box around the ellipse, px.
    extent: vec2<f32>,
    // Inverse covariance `a b; b c`, px⁻², and its determinant.
    conic: vec4<f32>,
    color: vec3<f32>,
    opacity: f32,
    // Depth of the mean, m; 0 where it is not visible.
    z: f32,
    // `dᵀ Q d` at which alpha falls to its minimum.
    reach: f32,
    // Change of depth along x and y, m/px.
    slope: vec2<f32>,
}

const TILE: u32 = 16u;
// Slack of the intervals for rounding, px.
const SLACK_PX: f32 = 0.02;

// `exp(x)`, the polynomial of the renderer on the processor (Cephes, Moshier 1989). With `round`,
// because compilers of shaders may drop an addition and subtraction of the same large number.
fn exponential(argument: f32) -> f32 {
    let x = clamp(argument, -87.0, 87.0);
    let n = round(x * 1.4426950408889634);
    var r = fma(n, -0.693359375, x);
    r = fma(n, 2.12194440e-4, r);
    var p = fma(1.9875691e-4, r, 1.3981999e-3);
    p = fma(p, r, 8.333452e-3);
    p = fma(p, r, 4.1665796e-2);
    p = fma(p, r, 1.6666666e-1);
    p = fma(p, r, 0.5);
    let power = bitcast<f32>(u32(i32(n) + 127) << 23u);
    return fma(p, r * r, r + 1.0) * power;
}

fn sigmoid(logit: f32) -> f32 {
    return 1.0 / (1.0 + exponential(-logit));
}

// `camera_from_world` as a matrix: `to_camera() * v` turns into the axes of the camera, `v *
// to_camera()` into those of the world.
fn to_camera() -> mat3x3<f32> {
    let rows = mat3x3<f32>(view.rotation[0].xyz, view.rotation[1].xyz, view.rotation[2].xyz);
    return transpose(rows);
}
