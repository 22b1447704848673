//! A camera that is moved on its plate while it records.
//!
//! All at once what it sees of old landmarks is off by one and the same turn, while the other cameras agree with what was
//! expected. From then on it is not known which of them the plate went with, nor how far the camera's mount is off, and poses are in doubt by a
//! share of that turn.

use nalgebra::{Matrix3, Vector3};

use crate::sight::{Placed, carry};
use crate::window::Window;

/// Sights that a camera needs to be judged, and the others together to be believed.
const FEWEST: usize = 12;
/// Off by less than this a sight agrees, px.
const AGREES_PX: f64 = 1.5;
/// Share of a camera's sights that may still agree as they are, and that must by a turn; share that must of all other cameras'.
const AS_IT_IS: f64 = 0.3;
const BY_A_TURN: f64 = 0.6;
const OTHERS: f64 = 0.6;
const ROUNDS: usize = 5;

/// A camera that was moved, as it seems.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shift {
    /// Of the frame set in which it was first seen, ns.
    pub time_ns: i64,
    /// Place of the camera in the rig.
    pub camera: usize,
    /// By how much it was turned, rad.
    pub turned: f64,
}

/// What a camera saw of a landmark: where it should be and where it was, as unit rays in its left eye.
type Pair = (Vector3<f64>, Vector3<f64>);

/// The camera that was moved since the frame before the newest, whose pose is known; none as a rule.
pub(crate) fn find(window: &Window) -> Option<Shift> {
    let frame = window.newest();
    let mut pairs: Vec<Vec<Pair>> = vec![Vec::new(); window.cameras.len()];
    for landmark in window.landmarks.values() {
        let (host_number, host) = &landmark.sights[0];
        let Some(at) = window.position(*host_number) else {
            continue;
        };
        let from = Placed::new(&window.frames[at].state, host.after_s);
        for (_, sight) in &landmark.sights[landmark.since(frame.number)..] {
            let to = Placed::new(&frame.state, sight.after_s);
            let seen = carry(
                &host.left.ray,
                landmark.rho,
                (&window.cameras[host.camera], &from),
                (&window.cameras[sight.camera], &to),
            );
            pairs[sight.camera].push((seen.x.normalize(), sight.left.ray));
        }
    }
    let judged: Vec<(usize, usize)> = (pairs.iter().enumerate())
        .map(|(k, pairs)| (agreeing(window, k, pairs, &Vector3::zeros()), pairs.len()))
        .collect();
    (0..pairs.len()).find_map(|camera| {
        let (good, all) = judged[camera];
        let others = judged.iter().enumerate().filter(|(k, _)| *k != camera);
        let (others_good, others_all) =
            others.fold((0, 0), |sum, (_, one)| (sum.0 + one.0, sum.1 + one.1));
        let is_alone = all >= FEWEST
            && others_all >= FEWEST
            && good as f64 <= AS_IT_IS * all as f64
            && others_good as f64 >= OTHERS * others_all as f64;
        let turn = is_alone.then(|| turn(window, camera, &pairs[camera]))??;
        let good = agreeing(window, camera, &pairs[camera], &turn);
        (good as f64 >= BY_A_TURN * all as f64).then_some(Shift {
            time_ns: frame.state.time_ns,
            camera,
            turned: turn.norm(),
        })
    })
}

fn off(pair: &Pair, turn: &Vector3<f64>) -> Vector3<f64> {
    pair.1 - pair.0 - turn.cross(&pair.0)
}

fn agreeing(window: &Window, camera: usize, pairs: &[Pair], turn: &Vector3<f64>) -> usize {
    let scale = window.cameras[camera].left.model().fx;
    let good = pairs
        .iter()
        .filter(|p| scale * off(p, turn).norm() < AGREES_PX);
    good.count()
}

/// The small turn that explains most of what is off.
fn turn(window: &Window, camera: usize, pairs: &[Pair]) -> Option<Vector3<f64>> {
    let scale = window.cameras[camera].left.model().fx;
    let mut turn = Vector3::zeros();
    for _ in 0..ROUNDS {
        let (mut h, mut g) = (Matrix3::zeros(), Vector3::zeros());
        for pair in pairs {
            let off = off(pair, &turn);
            // Far off counts little, so that what moves by itself does not decide.
            let weight = AGREES_PX / (scale * off.norm()).max(AGREES_PX);
            h += (Matrix3::identity() - pair.0 * pair.0.transpose()) * weight;
            g += pair.0.cross(&off) * weight;
        }
        turn += h.cholesky()?.solve(&g);
    }
    Some(turn)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::so3;
    use crate::solve::tests::window;

    /// What one camera sees last, turned.
    fn turned(by: Vector3<f64>) -> Window {
        let mut window = window(4, 0.0);
        let number = window.newest().number;
        let sights = window.landmarks.values_mut().flat_map(|l| &mut l.sights);
        for (_, sight) in sights.filter(|(n, s)| *n == number && s.camera == 1) {
            sight.left.ray = so3::exp(&by) * sight.left.ray;
        }
        window
    }

    #[test]
    fn a_camera_that_was_turned_is_found() {
        let by = Vector3::new(0.02, -0.01, 0.03);
        let shift = find(&turned(by)).expect("a shift");
        assert_eq!(shift.camera, 1);
        assert!((shift.turned - by.norm()).abs() < 1e-3, "{shift:?}");
    }

    #[test]
    fn cameras_that_stay_or_are_wrong_in_all_ways_are_not() {
        assert_eq!(find(&turned(Vector3::zeros())), None);
        let mut window = turned(Vector3::zeros());
        let number = window.newest().number;
        let sights = window.landmarks.values_mut().flat_map(|l| &mut l.sights);
        let own = sights.filter(|(n, s)| *n == number && s.camera == 1);
        for (k, (_, sight)) in own.enumerate() {
            let way = Vector3::new((k as f64).sin(), (1.7 * k as f64).cos(), 0.0);
            sight.left.ray = (sight.left.ray + way * 0.05).normalize();
        }
        assert_eq!(find(&window), None);
    }
}
