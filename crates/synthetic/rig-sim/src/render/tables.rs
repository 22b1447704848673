//! Numbers as text: trajectories, contacts, IMU samples. Every digit that an `f64` needs is
//! written.

use std::fmt::Write as _;

use nalgebra::{UnitQuaternion, Vector3};

use crate::camera::sensor::Tone;
use crate::scene::Scenery;
use crate::simulation::{EyeDifference, Imaging, RigImu, Simulation, seconds};
use crate::walker::{Footfall, Phase, Side};

/// Poses of a foot per second.
const FOOT_RATE_HZ: i64 = 200;

/// The settings, so that the walk can be reproduced.
pub(super) fn settings(simulation: &Simulation) -> String {
    let settings = simulation.settings();
    let quality = &settings.quality;
    let mut text = format!(
        "# A walk made by paws-rig-sim {}.\n\
         scene = {:?}\nlight = {:?}\nseed = {}\nseconds = {:?}\nrate_hz = {:?}\n\
         width = {}\nheight = {}\n\n\
         [quality]\nsamples = {}\nmost_samples = {}\nnoise = {}\n",
        env!("CARGO_PKG_VERSION"),
        settings.kind.name(),
        settings.lighting.name(),
        settings.seed,
        settings.seconds,
        settings.rate_hz,
        settings.width,
        settings.height,
        quality.samples,
        quality.max_samples,
        quality.noise,
    );
    if let Some(plan) = simulation.plan() {
        let (motion, bend, scale_error) = (plan.motion.name(), plan.bow_m, plan.scale_error);
        line(
            &mut text,
            format_args!(
                "\n[targets]\nmotion = {motion:?}\nbend_m = {bend:?}\nlarger = {scale_error:?}"
            ),
        );
        if let Some(views) = plan.views {
            line(&mut text, format_args!("views = {views}"));
        }
    }
    let imaging = simulation.imaging();
    if *imaging != Imaging::USUAL {
        let linear = imaging.tone == Tone::Linear;
        line(
            &mut text,
            format_args!(
                "\n[sensors]\nnoise = {:?}\nlinear = {linear}\nglobal_shutter = {}",
                imaging.noise, imaging.global_shutter
            ),
        );
        if let Some(exposure_s) = imaging.exposure_s {
            line(&mut text, format_args!("exposure_s = {exposure_s:?}"));
        }
        let right = &imaging.right_eye;
        if *right != EyeDifference::default() {
            line(
                &mut text,
                format_args!(
                    "right_blur_px = {:?}\nright_vignetting = {:?}\nright_gain = {:?}",
                    right.blur_px, right.vignetting, right.gain
                ),
            );
        }
        if imaging.codec_step > 0.0 {
            line(
                &mut text,
                format_args!("codec_step = {:?}", imaging.codec_step),
            );
        }
    }
    let scenery = simulation.scenery();
    if *scenery != Scenery::default() {
        line(
            &mut text,
            format_args!(
                "\n[scenery]\nfence_spacing_m = {:?}\ngloss = {:?}",
                scenery.fence_spacing_m, scenery.gloss
            ),
        );
    }
    text
}

/// The rig at each frame, as the TUM RGB-D benchmark writes trajectories (Sturm et al. 2012).
pub(super) fn tum(simulation: &Simulation) -> String {
    let mut text = "# world_from_rig: time [s] tx ty tz [m] qx qy qz qw\n".to_owned();
    for time_ns in frame_times(simulation) {
        let (p, q) = simulation.world_from_rig(time_ns);
        // Without floating point: the digits are those of the integer.
        let (whole, ns) = (time_ns / 1_000_000_000, time_ns % 1_000_000_000);
        line(
            &mut text,
            format_args!(
                "{whole}.{ns:09} {} {} {} {} {} {} {}",
                p.x, p.y, p.z, q.i, q.j, q.k, q.w
            ),
        );
    }
    text
}

/// The rig at each frame, as KITTI odometry writes poses: the rows of `world_from_rig` (Geiger et
/// al. 2012). Unlike there, the first pose is not the identity, and the body's x looks forward.
pub(super) fn kitti(simulation: &Simulation) -> String {
    let mut text = String::new();
    for time_ns in frame_times(simulation) {
        let (p, q) = simulation.world_from_rig(time_ns);
        let rotation = q.to_rotation_matrix();
        let rows = [0, 1, 2].map(|i| {
            let m = rotation.matrix();
            format!("{} {} {} {}", m[(i, 0)], m[(i, 1)], m[(i, 2)], p[i])
        });
        line(&mut text, format_args!("{}", rows.join(" ")));
    }
    text
}

/// Contacts of both feet that begin within the walk, in the order of their strikes; times are
/// counted from `begin_ns`, which is the beginning of the walk.
pub(crate) fn contacts(simulation: &Simulation, begin_ns: i64) -> String {
    let mut text = "#side,heel strike [ns],foot flat [ns],heel off [ns],toe off [ns],\
                    x [m],y [m],z [m],q_w [],q_x [],q_y [],q_z []\n"
        .to_owned();
    let walker = simulation.walker();
    let end_s = simulation.settings().seconds;
    let mut falls: Vec<&Footfall> = [Side::Left, Side::Right]
        .iter()
        .flat_map(|&side| walker.contacts(side))
        .filter(|fall| fall.strike_s <= end_s)
        .collect();
    falls.sort_by(|a, b| a.strike_s.total_cmp(&b.strike_s));
    for fall in falls {
        let side = fall.side.name();
        let (flat, heel_off) = fall.flat_phase();
        let times = [fall.strike_s, flat, heel_off, fall.off_s];
        let times = times.map(|time_s| match time_s.is_finite() {
            true => format!("{}", begin_ns + (time_s * 1e9).round() as i64),
            // The foot remains on the ground.
            false => String::new(),
        });
        let pose = pose(&fall.position, &fall.rotation);
        line(&mut text, format_args!("{side},{},{pose}", times.join(",")));
    }
    text
}

/// Poses of both soles at [`FOOT_RATE_HZ`], to 1 µm, and the part that bears on the ground; of a
/// flat phase, in which the foot is at rest, the first and the last. Times are counted from
/// `begin_ns`, which is the beginning of the walk.
pub(crate) fn foot_poses(simulation: &Simulation, begin_ns: i64) -> String {
    let mut text =
        "#time [ns],side,phase,x [m],y [m],z [m],q_w [],q_x [],q_y [],q_z []\n".to_owned();
    let walker = simulation.walker();
    let step_ns = 1_000_000_000 / FOOT_RATE_HZ;
    let end_ns = (simulation.settings().seconds * 1e9) as i64;
    for side in [Side::Left, Side::Right] {
        let phase = |time_ns: i64| walker.foot(side, seconds(time_ns)).phase;
        for time_ns in (0..=end_ns).step_by(step_ns as usize) {
            let foot = walker.foot(side, seconds(time_ns));
            let (before, after) = (time_ns - step_ns, time_ns + step_ns);
            let is_at_rest = [before, time_ns, after].map(phase) == [Phase::Flat; 3];
            if is_at_rest && before >= 0 && after <= end_ns {
                continue;
            }
            let (p, q) = (foot.position, foot.rotation);
            let (time_ns, side, phase) = (begin_ns + time_ns, side.name(), foot.phase.name());
            line(
                &mut text,
                format_args!(
                    "{time_ns},{side},{phase},{:.6},{:.6},{:.6},{:.6},{:.6},{:.6},{:.6}",
                    p.x, p.y, p.z, q.w, q.i, q.j, q.k
                ),
            );
        }
    }
    text
}

/// IMU samples, as EuRoC writes them.
pub(super) fn imu(simulation: &Simulation, imu: &RigImu) -> String {
    let mut text = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],\
                    a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n"
        .to_owned();
    for (_, time_ns, sample) in simulation.samples(imu) {
        let (gyro, accel) = (vector(&sample.gyro), vector(&sample.accel));
        line(&mut text, format_args!("{time_ns},{gyro},{accel}"));
    }
    text
}

/// Pose and velocity of an IMU in the world and its biases, at each of its samples, as EuRoC's
/// ground truth.
pub(super) fn state(simulation: &Simulation, imu: &RigImu) -> String {
    let mut text = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],\
                    q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],\
                    v_RS_R_x [m s^-1],v_RS_R_y [m s^-1],v_RS_R_z [m s^-1],\
                    b_w_RS_S_x [rad s^-1],b_w_RS_S_y [rad s^-1],b_w_RS_S_z [rad s^-1],\
                    b_a_RS_S_x [m s^-2],b_a_RS_S_y [m s^-2],b_a_RS_S_z [m s^-2]\n"
        .to_owned();
    let rig_from_imu = imu.imu_from_rig.inverse();
    let arm = rig_from_imu.translation();
    for (n, time_ns, _) in simulation.samples(imu) {
        let rig = simulation.walker().rig(seconds(time_ns));
        let pose = pose(
            &(rig.position + rig.rotation * arm),
            &(rig.rotation * rig_from_imu.rotation()),
        );
        let velocity = rig.velocity + rig.rotation * rig.angular_rate.cross(arm);
        let [gyro, accel] = imu.imu.bias(n).map(|bias| vector(&bias));
        let velocity = vector(&velocity);
        line(
            &mut text,
            format_args!("{time_ns},{pose},{velocity},{gyro},{accel}"),
        );
    }
    text
}

fn frame_times(simulation: &Simulation) -> impl Iterator<Item = i64> {
    let settings = *simulation.settings();
    (0..settings.frame_count()).map(move |n| settings.frame_ns(n))
}

fn vector(v: &Vector3<f64>) -> String {
    format!("{},{},{}", v.x, v.y, v.z)
}

/// Position, then quaternion w x y z.
fn pose(p: &Vector3<f64>, q: &UnitQuaternion<f64>) -> String {
    format!("{},{},{},{},{}", vector(p), q.w, q.i, q.j, q.k)
}

fn line(text: &mut String, words: std::fmt::Arguments<'_>) {
    // Writing to a string does not fail.
    let _ = writeln!(text, "{words}");
}
