//! Frame sets: the stereo frames of all cameras that belong to one instant.
//!
//! One camera is the reference; each of its frames forms one set. Another camera's frame joins it
//! if the two are each other's nearest: no frame is used twice, and none is invented. The distance
//! must be at most half of the slower camera's period; for cameras on the same trigger as the
//! reference at most a quarter of a period, because their exposures coincide and only their times
//! are uncertain. A camera without such a frame is listed as missing.
//!
//! If the reference itself lost a frame or failed, another camera's frame forms the set, and the
//! reference is listed as missing: a frame that is at least three quarters of the slower camera's
//! period from every instant of the reference. Frames in between, of a camera that is faster than
//! the reference or half a period apart, belong to no instant and to no set.
//!
//! *Early*: a set is returned as soon as no nearer frame can arrive. *At a gap* or when a camera
//! falls silent: after [`HORIZON_NS`], without it. *At the end*: [`FrameSetBuilder::flush`]. Sets
//! are in the order of their time, and do not depend on the order in which the cameras' frames
//! arrive unless one is later than the horizon. *A frame lost* before its set is returned is
//! removed ([`FrameSetBuilder::forget`]). Frames must be in the order of their numbers for each
//! camera.

use std::collections::VecDeque;

use session_archive::time::HostTime;

/// Maximum lead of some camera over a set that has not been returned, ns.
pub const HORIZON_NS: i64 = 1_000_000_000;

/// A camera.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraSpec {
    /// Its trigger: cameras with the same one are exposed by the same signal.
    pub trigger: Option<String>,
    /// Nominal period, ns.
    pub period_ns: i64,
}

/// A frame in a set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Member {
    /// Position of the camera.
    pub camera: usize,
    /// Frame number.
    pub number: u64,
    /// Frame time.
    pub time: HostTime,
}

/// A frame set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameSet {
    /// Counts up from 0.
    pub number: u64,
    /// Time of the reference camera's frame; if that is missing, of the frame used instead of it.
    pub time: HostTime,
    /// The frames, in the order of the cameras.
    pub members: Vec<Member>,
    /// Positions of the cameras without a frame.
    pub missing: Vec<usize>,
}

/// Builds frame sets. See the module's documentation for the contract.
#[derive(Clone, Debug)]
pub struct FrameSetBuilder {
    cameras: Vec<CameraSpec>,
    reference: usize,
    /// Frames that may still belong to a future set, per camera.
    frames: Vec<VecDeque<(u64, HostTime)>>,
    newest: Vec<HostTime>,
    /// Time of the newest set.
    previous: Option<HostTime>,
    count: u64,
}

/// The reference: the first camera of the largest trigger group with at least two cameras, else the
/// slowest camera, because a set should not wait for a rarer frame.
fn reference(cameras: &[CameraSpec]) -> usize {
    let group = |c: &CameraSpec| match &c.trigger {
        Some(t) => cameras
            .iter()
            .filter(|o| o.trigger.as_ref() == Some(t))
            .count(),
        None => 1,
    };
    let largest = cameras.iter().map(group).max().unwrap_or(1);
    let slowest = cameras.iter().map(|c| c.period_ns).max();
    cameras
        .iter()
        .position(|c| {
            if largest > 1 {
                group(c) == largest
            } else {
                Some(c.period_ns) == slowest
            }
        })
        .unwrap_or(0)
}

impl FrameSetBuilder {
    /// A builder for these cameras.
    pub fn new(cameras: Vec<CameraSpec>) -> Self {
        Self {
            reference: reference(&cameras),
            frames: vec![VecDeque::new(); cameras.len()],
            newest: vec![HostTime::MIN; cameras.len()],
            previous: None,
            count: 0,
            cameras,
        }
    }

    /// Position of the reference camera.
    pub fn reference(&self) -> usize {
        self.reference
    }

    /// Takes the next frame of a camera; returns the completed sets.
    pub fn push(&mut self, camera: usize, number: u64, time: HostTime) -> Vec<FrameSet> {
        self.frames[camera].push_back((number, time));
        self.newest[camera] = self.newest[camera].max(time);
        self.take(false)
    }

    /// These frames of a camera are lost after all: no future set contains them.
    pub fn forget(&mut self, camera: usize, first: u64, last: u64) {
        self.frames[camera].retain(|(number, _)| !(first..=last).contains(number));
    }

    /// No more frames: returns all remaining sets.
    pub fn flush(&mut self) -> Vec<FrameSet> {
        self.take(true)
    }

    /// Returns all settled sets, at the end all remaining ones.
    fn take(&mut self, end: bool) -> Vec<FrameSet> {
        let mut sets = Vec::new();
        while let Some((camera, time)) = self.leader() {
            if !end && !self.is_settled(camera, time) {
                break;
            }
            if camera == self.reference || self.is_own_instant(camera, time) {
                sets.extend(self.settle(camera));
            } else {
                self.frames[camera].pop_front();
            }
        }
        sets
    }

    /// The frame that forms the next set, if there is one: the reference's, or an earlier one
    /// beyond its reach.
    fn leader(&self) -> Option<(usize, HostTime)> {
        let front = |camera: usize| self.frames[camera].front().map(|f| f.1);
        let reference = front(self.reference);
        let orphan = (0..self.cameras.len())
            .filter(|&camera| camera != self.reference)
            .filter_map(|camera| Some((camera, front(camera)?)))
            .filter(|&(c, t)| reference.is_none_or(|r| t + self.tolerance(c) < r))
            .min_by_key(|&(_, time)| time);
        orphan.or(reference.map(|time| (self.reference, time)))
    }

    /// Whether a frame is far enough from every instant of the reference to form its own set.
    fn is_own_instant(&self, camera: usize, time: HostTime) -> bool {
        let apart = self.slower(camera) / 4 * 3;
        let next = self.frames[self.reference].front().map(|f| f.1);
        self.previous.is_none_or(|p| time.since(p) >= apart)
            && next.is_none_or(|n| n.since(time) >= apart)
    }

    /// The longer one of a camera's and the reference's periods.
    fn slower(&self, camera: usize) -> i64 {
        self.cameras[camera]
            .period_ns
            .max(self.cameras[self.reference].period_ns)
    }

    /// Maximum distance of a camera's frame from the reference's, ns.
    fn tolerance(&self, camera: usize) -> i64 {
        let (c, r) = (&self.cameras[camera], &self.cameras[self.reference]);
        if c.trigger.is_some() && c.trigger == r.trigger {
            c.period_ns / 4
        } else {
            self.slower(camera) / 2
        }
    }

    /// Whether no future frame can change the set of a leader's frame.
    fn is_settled(&self, leader: usize, time: HostTime) -> bool {
        let latest = self.newest.iter().copied().max().unwrap_or(time);
        let known_to = |camera: usize, span: i64| self.newest[camera] >= time + span;
        let orphan = leader != self.reference;
        latest.since(time) > HORIZON_NS
            || (!orphan || known_to(self.reference, self.slower(leader)))
                && (0..self.cameras.len()).all(|camera| {
                    let tolerance = self.tolerance(camera);
                    // A frame within the tolerance may be nearer to the next reference frame, so
                    // that one must be known too, if it can be that near.
                    camera == leader
                        || camera == self.reference
                        || (known_to(camera, tolerance) && known_to(self.reference, 2 * tolerance))
                        || self.exact(camera, time)
                })
    }

    /// Whether a camera has a frame so near that no other pairing can be nearer.
    fn exact(&self, camera: usize, time: HostTime) -> bool {
        let quarter = self.cameras[camera]
            .period_ns
            .min(self.cameras[self.reference].period_ns)
            / 4;
        self.frames[camera]
            .iter()
            .any(|f| f.1.since(time).abs() <= quarter)
    }

    /// The set of a leader's first frame.
    fn settle(&mut self, leader: usize) -> Option<FrameSet> {
        let (number, time) = self.frames[leader].pop_front()?;
        let following = self.frames[self.reference].front().map(|f| f.1);
        let mut set = FrameSet {
            number: self.count,
            time,
            members: Vec::new(),
            missing: Vec::new(),
        };
        for camera in 0..self.cameras.len() {
            if camera == leader {
                set.members.push(Member {
                    camera,
                    number,
                    time,
                });
                continue;
            }
            let distance = |t: HostTime| t.since(time).unsigned_abs();
            let nearest = self.frames[camera]
                .iter()
                .min_by_key(|f| distance(f.1))
                .copied();
            let near = nearest.filter(|(_, t)| {
                let nearer = |other: Option<HostTime>| {
                    other.is_some_and(|o| t.since(o).unsigned_abs() < distance(*t))
                };
                distance(*t) <= self.tolerance(camera).unsigned_abs()
                    && !nearer(following)
                    && !nearer(self.previous)
            });
            match near {
                Some((number, time)) => {
                    set.members.push(Member {
                        camera,
                        number,
                        time,
                    });
                    // It and all before it are used or too old.
                    while self.frames[camera].front().is_some_and(|f| f.1 <= time) {
                        self.frames[camera].pop_front();
                    }
                }
                None => set.missing.push(camera),
            }
        }
        self.previous = Some(time);
        self.count += 1;
        Some(set)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const MS: i64 = 1_000_000;

    fn camera(trigger: Option<&str>, period_ms: i64) -> CameraSpec {
        CameraSpec {
            trigger: trigger.map(str::to_owned),
            period_ns: period_ms * MS,
        }
    }

    /// Pushes frames given as (camera, number, time in ms) and flushes.
    fn run(cameras: Vec<CameraSpec>, frames: &[(usize, u64, i64)]) -> Vec<FrameSet> {
        let mut builder = FrameSetBuilder::new(cameras);
        let mut sets = Vec::new();
        for &(camera, number, ms) in frames {
            sets.extend(builder.push(camera, number, HostTime(ms * MS)));
        }
        sets.extend(builder.flush());
        sets
    }

    fn numbers(set: &FrameSet) -> Vec<(usize, u64)> {
        set.members.iter().map(|m| (m.camera, m.number)).collect()
    }

    #[test]
    fn reference_is_the_triggered_or_slowest_camera() {
        let free = vec![camera(None, 33), camera(None, 100), camera(None, 50)];
        assert_eq!(FrameSetBuilder::new(free).reference(), 1);
        let triggered = vec![
            camera(None, 100),
            camera(Some("a"), 33),
            camera(Some("a"), 33),
        ];
        assert_eq!(FrameSetBuilder::new(triggered).reference(), 1);
    }

    #[test]
    fn lost_frames_are_in_no_set() {
        let mut builder = FrameSetBuilder::new(vec![camera(None, 40), camera(None, 40)]);
        let mut sets = Vec::new();
        for n in 0..4 {
            let time = HostTime(n as i64 * 40 * MS);
            sets.extend(builder.push(0, n, time));
        }
        builder.forget(0, 1, 2);
        for n in 0..4 {
            let time = HostTime((n as i64 * 40 + 1) * MS);
            sets.extend(builder.push(1, n, time));
        }
        sets.extend(builder.flush());
        let found: Vec<_> = sets.iter().map(numbers).collect();
        assert_eq!(
            found,
            [
                vec![(0, 0), (1, 0)],
                vec![(1, 1)],
                vec![(1, 2)],
                vec![(0, 3), (1, 3)]
            ]
        );
    }

    #[test]
    fn triggered_pairs_and_a_free_running_camera_form_sets() {
        let cameras = vec![
            camera(Some("a"), 40),
            camera(Some("a"), 40),
            camera(None, 40),
        ];
        let mut frames = Vec::new();
        for n in 0..10 {
            let t = n as i64 * 40;
            frames.extend([(0, n, t), (1, n + 5, t + 1), (2, n + 9, t + 15)]);
        }
        let sets = run(cameras, &frames);
        assert_eq!(sets.len(), 10);
        for (set, n) in sets.iter().zip(0..) {
            assert_eq!(numbers(set), [(0, n), (1, n + 5), (2, n + 9)]);
        }
    }

    #[test]
    fn lost_frame_is_missing_and_not_replaced() {
        let cameras = vec![camera(Some("a"), 40), camera(Some("a"), 40)];
        let frames = [
            (0, 0, 0),
            (1, 0, 0),
            (0, 1, 40),
            (0, 2, 80),
            (1, 2, 80),
            (1, 3, 120),
        ];
        let sets = run(cameras, &frames);
        assert_eq!(sets.len(), 4);
        assert_eq!(sets[1].missing, [1]);
        assert_eq!(numbers(&sets[2]), [(0, 2), (1, 2)]);
        assert_eq!(sets[3].missing, [0], "the reference can be missing too");
        assert_eq!(
            (sets[3].time, numbers(&sets[3])),
            (HostTime(120 * MS), vec![(1, 3)])
        );
    }

    #[test]
    fn sets_continue_without_the_reference_camera() {
        let cameras = vec![
            camera(Some("a"), 40),
            camera(Some("a"), 40),
            camera(None, 40),
        ];
        let mut frames = Vec::new();
        for n in 0..50 {
            let t = n as i64 * 40;
            if n < 10 {
                frames.push((0, n, t));
            }
            frames.extend([(1, n, t + 1), (2, n, t + 15)]);
        }
        let sets = run(cameras, &frames);
        assert_eq!(sets.len(), 50);
        for (set, n) in sets.iter().zip(0..) {
            let with_reference = [(0, n), (1, n), (2, n)];
            let expected = if n < 10 {
                &with_reference[..]
            } else {
                &with_reference[1..]
            };
            assert_eq!(numbers(set), expected);
        }
    }

    #[test]
    fn frames_between_instants_form_no_sets() {
        // Twice as fast; the reference loses a frame at 200 ms.
        let cameras = vec![camera(None, 40), camera(None, 20)];
        let mut frames: Vec<_> = (0..10)
            .filter(|n| *n != 5)
            .map(|n| (0, n, n as i64 * 40))
            .collect();
        frames.extend((0..20).map(|n| (1, n, n as i64 * 20 + 3)));
        frames.sort_by_key(|f| f.2);
        let sets = run(cameras, &frames);
        let times: Vec<_> = sets.iter().map(|s| s.time.0 / MS).collect();
        assert_eq!(times, [0, 40, 80, 120, 160, 203, 240, 280, 320, 360]);
        assert_eq!(sets[5].missing, [0]);
        assert!(sets.iter().all(|s| s.members.iter().any(|m| m.camera == 1)));
    }

    #[test]
    fn silent_camera_is_waited_for_up_to_the_horizon() {
        let cameras = vec![camera(None, 100), camera(None, 100)];
        let mut builder = FrameSetBuilder::new(cameras);
        builder.push(1, 0, HostTime(0));
        let mut given = 0;
        for n in 0..30 {
            given += builder.push(0, n, HostTime(n as i64 * 100 * MS)).len();
            let waiting = n as usize + 1 - given;
            assert!(waiting <= 11, "{waiting}");
        }
        assert!(given >= 19);
    }

    proptest! {
        /// No frame is in two sets, every reference frame is in one, sets are ordered by time, and
        /// every member is within tolerance.
        #[test]
        fn no_frame_is_used_twice_or_invented(
            periods in prop::collection::vec(20_i64..120, 2..4),
            drops in prop::collection::vec((0_usize..4, 0_u64..40), 0..20),
            jitter in prop::collection::vec(-9_i64..9, 200),
        ) {
            let cameras: Vec<_> = periods.iter().map(|p| camera(None, *p)).collect();
            let mut frames = Vec::new();
            for (c, period) in periods.iter().enumerate() {
                for n in 0..40_u64 {
                    if !drops.contains(&(c, n)) {
                        let t = 1000 + n as i64 * period + jitter[(c * 40 + n as usize) % 200];
                        frames.push((c, n, t));
                    }
                }
            }
            frames.sort_by_key(|f| f.2);
            let reference = FrameSetBuilder::new(cameras.clone()).reference();
            let sets = run(cameras.clone(), &frames);
            let led = sets.iter().filter(|s| !s.missing.contains(&reference)).count();
            prop_assert_eq!(led, frames.iter().filter(|f| f.0 == reference).count());
            let mut used = std::collections::BTreeSet::new();
            for set in &sets {
                prop_assert_eq!(set.members.len() + set.missing.len(), cameras.len());
                for m in &set.members {
                    prop_assert!(used.insert((m.camera, m.number)));
                    prop_assert!(frames.contains(&(m.camera, m.number, m.time.0 / MS)));
                    let limit = periods[m.camera].max(periods[reference]) * MS / 2;
                    prop_assert!((m.time - set.time).abs() <= limit);
                }
            }
            prop_assert!(sets.windows(2).all(|w| w[0].time < w[1].time));
        }

        /// Sets do not depend on which camera's frames come first.
        #[test]
        fn sets_do_not_depend_on_delays_between_cameras(
            periods in prop::collection::vec(20_i64..120, 2..4),
            drops in prop::collection::vec((0_usize..4, 0_u64..40), 0..20),
            delays in prop::collection::vec(0_i64..400, 4),
        ) {
            let cameras: Vec<_> = periods.iter().map(|p| camera(None, *p)).collect();
            let mut frames = Vec::new();
            for (c, period) in periods.iter().enumerate() {
                let sent = (0..40_u64).filter(|n| !drops.contains(&(c, *n)));
                frames.extend(sent.map(|n| (c, n, 1000 + n as i64 * period)));
            }
            frames.sort_by_key(|f| f.2);
            let expected = run(cameras.clone(), &frames);
            frames.sort_by_key(|f| f.2 + delays[f.0]);
            prop_assert_eq!(run(cameras, &frames), expected);
        }
    }
}
