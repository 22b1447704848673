//! KITTI odometry: a line of 12 numbers per frame, `[R | t]` rows first, metres (Geiger et al.
//! 2012); the times, in seconds, one per line, are a file of their own (`times.txt`).
//!
//! Contract: as of [`formats`](super). A row is the transform to the first frame's coordinates from
//! this frame's; the caller knows of which camera. A matrix's digits are those of the quaternion's
//! products, so a rotation comes back within 1e-15, not to the bit. Velocities are not kept.

use std::path::Path;

use cad_transforms::RigidTransform;

use super::seconds::{format_seconds, parse_seconds};
use super::text::{FormatError, Rows, Source, format_numbers, read as text_of};
use crate::trajectory::{Pose, Trajectory};

const KIND: &str = "KITTI";

/// Reads poses and their times.
///
/// # Errors
/// [`FormatError`]; [`FormatError::Counts`] if their numbers differ.
pub fn read(poses: &Path, times: &Path) -> Result<Trajectory, FormatError> {
    let poses = parse_poses(&text_of(poses)?, poses)?;
    let text = text_of(times)?;
    let source = Source {
        kind: KIND,
        path: times,
        text: &text,
    };
    let stamps = times_of(&source)?;
    if stamps.len() != poses.len() {
        return Err(FormatError::Counts {
            kind: KIND,
            path: times.to_owned(),
            found: stamps.len(),
            expected: poses.len(),
        });
    }
    let mut rows = Rows::default();
    for ((line, time_ns), pose) in stamps.into_iter().zip(poses) {
        rows.push(line, Pose::new(time_ns, pose));
    }
    source.trajectory(rows)
}

/// Reads the poses alone; `path` is for messages.
///
/// # Errors
/// [`FormatError::Malformed`].
pub fn parse_poses(text: &str, path: &Path) -> Result<Vec<RigidTransform>, FormatError> {
    let source = Source {
        kind: KIND,
        path,
        text,
    };
    let mut poses = Vec::new();
    for (line, text) in source.lines() {
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        if words.len() != 12 {
            let found = format!("{} numbers", words.len());
            return Err(source.malformed(line, found, "12: a matrix [R | t] of 3x4, rows first"));
        }
        let mut rows = [0.0; 12];
        for (number, word) in rows.iter_mut().zip(words) {
            *number = source.number(line, word)?;
        }
        let pose = RigidTransform::from_rows_3x4(rows)
            .map_err(|e| source.malformed(line, e.to_string(), "a rotation matrix"))?;
        poses.push(pose);
    }
    Ok(poses)
}

fn times_of(source: &Source<'_>) -> Result<Vec<(usize, i64)>, FormatError> {
    let time = |(line, text): (usize, &str)| {
        parse_seconds(text)
            .map(|ns| (line, ns))
            .ok_or_else(|| source.malformed(line, format!("{text:?}"), "a time in seconds"))
    };
    source.lines().map(time).collect()
}

/// The texts of the two files, poses and times. Lost poses are left out of both.
///
/// ```
/// use std::path::Path;
///
/// use cad_transforms::RigidTransform;
/// use scene_bundle::formats::kitti::{parse_poses, to_text};
/// use scene_bundle::{Pose, Trajectory};
///
/// let place = RigidTransform::from_translation_m([1.5, 0.0, -2.0])?;
/// let (poses, times) = to_text(&Trajectory::new(vec![Pose::new(103_600_000, place)])?);
/// assert_eq!(poses.split_whitespace().count(), 12);
/// assert_eq!(parse_poses(&poses, Path::new("poses.txt"))?[0].translation_m(), [1.5, 0.0, -2.0]);
/// assert_eq!(times.trim().parse::<f64>()?, 0.1036);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn to_text(trajectory: &Trajectory) -> (String, String) {
    let (mut poses, mut times) = (String::new(), String::new());
    for pose in trajectory.usable() {
        let r = pose.world_from_rig.rotation_rows();
        let t = pose.world_from_rig.translation_m();
        let rows: [f64; 12] = std::array::from_fn(|i| match i % 4 {
            3 => t[i / 4],
            column => r[i / 4 * 3 + column],
        });
        poses += &format_numbers(&rows, " ");
        poses.push('\n');
        times += &format_seconds(pose.time_ns);
        times.push('\n');
    }
    (poses, times)
}

#[cfg(test)]
mod tests {
    use super::*;
    use test_data::shared;

    use crate::formats::tests::{bare, walk};

    #[test]
    fn written_poses_read_back() {
        let trajectory = walk();
        let folder = tempfile::tempdir().unwrap();
        let [poses, times] = ["poses.txt", "times.txt"].map(|name| folder.path().join(name));
        let texts = to_text(&trajectory);
        std::fs::write(&poses, &texts.0).unwrap();
        std::fs::write(&times, &texts.1).unwrap();
        let back = read(&poses, &times).unwrap();
        let expected = bare(&trajectory);
        assert_eq!(back.len(), expected.len());
        for (found, expected) in back.poses().iter().zip(expected.poses()) {
            assert_eq!(found.time_ns, expected.time_ns);
            let off = found.world_from_rig.inverse() * expected.world_from_rig;
            // The angle of a rotation this near to none is computed from the quaternion's vector
            // part: no cancellation.
            assert!(off.angle_rad() < 1e-14, "{}", off.angle_rad());
            let [a, b] = [found, expected].map(|p| p.world_from_rig.translation_m());
            assert_eq!(a, b);
        }

        // Of poses of one time, the first.
        let one = "1 0 0 0 0 1 0 0 0 0 1 0\n";
        std::fs::write(
            &poses,
            format!("{one}{}{one}", one.replace("1 0\n", "1 9\n")),
        )
        .unwrap();
        std::fs::write(&times, "0.5\n0.5\n0.6\n").unwrap();
        let repeated = read(&poses, &times).unwrap();
        assert_eq!(repeated.len(), 2);
        assert_eq!(repeated.poses()[0].world_from_rig.translation_m(), [0.0; 3]);

        std::fs::write(&poses, &texts.0).unwrap();
        std::fs::write(&times, "0.5\n").unwrap();
        let error = read(&poses, &times).unwrap_err().to_string();
        let expected = format!(
            "found 1 times, expected one for each of the {} poses",
            expected.len()
        );
        assert!(error.contains(&expected), "{error}");
    }

    #[test]
    fn rows_come_first() {
        // A rotation by 90 degrees to the left about z, then a translation.
        let text = "0 -1 0 5 1 0 0 6 0 0 1 7\n";
        let poses = parse_poses(text, Path::new("p.txt")).unwrap();
        assert_eq!(poses[0].apply([1.0, 0.0, 0.0]), [5.0, 7.0, 7.0]);
    }

    #[test]
    fn malformed_lines_are_named_in_the_error() {
        let path = Path::new("p.txt");
        let message = |error: FormatError| error.to_string();
        assert_eq!(
            message(parse_poses("1 0 0 0 0 1 0 0 0 0 1 0\n1 2 3\n", path).unwrap_err()),
            "reading a KITTI trajectory: line 2: found 3 numbers, expected 12: a matrix [R | t] of 3x4, rows first: p.txt"
        );
        let mirrored = message(parse_poses("-1 0 0 0 0 1 0 0 0 0 1 0\n", path).unwrap_err());
        assert!(
            mirrored.contains("line 1: found the rotation matrix is left-handed"),
            "{mirrored}"
        );
        let times = |text| {
            let kind = KIND;
            times_of(&Source { kind, path, text })
        };
        assert_eq!(
            message(times("0.0\nsoon\n").unwrap_err()),
            "reading a KITTI trajectory: line 2: found \"soon\", expected a time in seconds: p.txt"
        );
        let times = times("0.000000e+00\n1.037300e-01\n").unwrap();
        assert_eq!(times, [(1, 0), (2, 103_730_000)]);
    }

    #[test]
    fn the_real_files_are_read() {
        let Some(folder) = shared("04_trajectories/evo") else {
            return;
        };
        for name in ["KITTI_00_gt.txt", "KITTI_00_ORB.txt"] {
            let path = folder.join(name);
            let text = std::fs::read_to_string(&path).unwrap();
            let poses = parse_poses(&text, &path).unwrap();
            assert_eq!(poses.len(), text.lines().count());
            let steps = poses.windows(2);
            let length: f64 = steps.map(|p| (p[0].inverse() * p[1]).distance_m()).sum();
            // Sequence 00 is 3.7 km long (Geiger et al. 2012, table 1: 3,724 m); a monocular
            // estimate has its own scale.
            if name == "KITTI_00_gt.txt" {
                assert!((3700.0..3750.0).contains(&length), "{length}");
            }
        }
    }
}
