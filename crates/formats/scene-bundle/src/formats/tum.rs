//! TUM: a line `t x y z qx qy qz qw` per pose, seconds and metres, `#` starts a comment (Sturm et
//! al. 2012; the format page of the TUM RGB-D benchmark). The quaternion has its real part last.
//!
//! Contract: as of [`formats`](super). Velocities are not kept.

use std::path::Path;

use super::seconds::{format_seconds, parse_seconds};
use super::text::{FormatError, Rows, Source, format_numbers, read as text_of};
use crate::trajectory::{Pose, Trajectory};

/// Reads a file.
///
/// # Errors
/// [`FormatError`].
pub fn read(path: &Path) -> Result<Trajectory, FormatError> {
    parse(&text_of(path)?, path)
}

/// Reads a text; `path` is for messages.
///
/// # Errors
/// [`FormatError::Malformed`].
///
/// ```
/// use std::path::Path;
///
/// use scene_bundle::formats::tum;
///
/// let text = "# timestamp tx ty tz qx qy qz qw\n1305031102.175304 1.3 0.6 1.6 0 0 1 0\n";
/// let trajectory = tum::parse(text, Path::new("groundtruth.txt"))?;
/// let pose = &trajectory.poses()[0];
/// assert_eq!(pose.time_ns, 1_305_031_102_175_304_000);
/// assert_eq!(pose.world_from_rig.rotation_wxyz(), [0.0, 0.0, 0.0, 1.0]);
///
/// // What is written reads back to the same bits.
/// let again = tum::parse(&tum::to_text(&trajectory), Path::new("copy.txt"))?;
/// assert_eq!(again, trajectory);
/// # Ok::<(), scene_bundle::FormatError>(())
/// ```
pub fn parse(text: &str, path: &Path) -> Result<Trajectory, FormatError> {
    let source = Source {
        kind: "TUM",
        path,
        text,
    };
    let mut rows = Rows::default();
    for (line, text) in source.lines() {
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        let [time, numbers @ ..] = words.as_slice() else {
            continue;
        };
        if numbers.len() != 7 {
            let found = format!("{} fields", words.len());
            return Err(source.malformed(
                line,
                found,
                "8: t x y z qx qy qz qw, separated by blanks",
            ));
        }
        let time_ns = parse_seconds(time)
            .ok_or_else(|| source.malformed(line, format!("{time:?}"), "a time in seconds"))?;
        let mut n = [0.0; 7];
        for (number, word) in n.iter_mut().zip(numbers) {
            *number = source.number(line, word)?;
        }
        let transform = source.transform(line, [n[6], n[3], n[4], n[5]], [n[0], n[1], n[2]])?;
        rows.push(line, Pose::new(time_ns, transform));
    }
    source.trajectory(rows)
}

/// The text of a file. Lost poses are left out.
pub fn to_text(trajectory: &Trajectory) -> String {
    let mut text = String::from("# timestamp tx ty tz qx qy qz qw\n");
    for pose in trajectory.usable() {
        let [x, y, z] = pose.world_from_rig.translation_m();
        let [qw, qx, qy, qz] = pose.world_from_rig.rotation_wxyz();
        text += &format_seconds(pose.time_ns);
        text.push(' ');
        text += &format_numbers(&[x, y, z, qx, qy, qz, qw], " ");
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use test_data::shared;

    use crate::formats::tests::{bare, walk};

    #[test]
    fn written_poses_read_back_to_the_same_bits() {
        let trajectory = walk();
        let back = parse(&to_text(&trajectory), Path::new("t.txt")).unwrap();
        assert_eq!(back, bare(&trajectory));
    }

    #[test]
    fn the_real_part_is_last() {
        let path = Path::new("t.txt");
        // A rotation by 90 degrees to the left about z takes x to y.
        let h = std::f64::consts::FRAC_1_SQRT_2;
        let trajectory = parse(&format!("1.5 1 2 3 0 0 {h} {h}\n"), path).unwrap();
        let pose = &trajectory.poses()[0];
        let [x, y, z] = pose.world_from_rig.apply([1.0, 0.0, 0.0]);
        assert!((x - 1.0).abs() < 1e-15 && (y - 3.0).abs() < 1e-15 && z == 3.0);
        assert_eq!(pose.time_ns, 1_500_000_000);
    }

    #[test]
    fn malformed_lines_are_named_in_the_error() {
        let check = |text: &str, message: &str| {
            let error = parse(text, Path::new("t.txt")).unwrap_err().to_string();
            assert_eq!(error, format!("reading a TUM trajectory: {message}: t.txt"));
        };
        check(
            "# comment\n\n1.0 0 0 0 0 0 1\n",
            "line 3: found 7 fields, expected 8: t x y z qx qy qz qw, separated by blanks",
        );
        check(
            "1,0 0 0 0 0 0 0 1\n",
            "line 1: found \"1,0\", expected a time in seconds",
        );
        check(
            "1 0 0 nan 0 0 0 1\n",
            "line 1: found \"nan\", expected a finite number with a decimal point",
        );
        check(
            "1 0 0 0 0 0 0 0.9\n",
            "line 1: found a quaternion of norm 0.9, expected norm 1 within 0.001",
        );
        check(
            "#\n2.0 0 0 0 0 0 0 1\n#\n1.5 0 0 0 0 0 0 1\n",
            "line 4: found the time 1500000000 ns, expected a later one than the 2000000000 ns of line 2",
        );
    }

    #[test]
    fn first_pose_of_a_repeated_time_is_used() {
        let text = "1.0 1 0 0 0 0 0 1\n1.0 2 0 0 0 0 0 1\n1.0 3 0 0 0 0 0 1\n2.0 4 0 0 0 0 0 1\n";
        let trajectory = parse(text, Path::new("t.txt")).unwrap();
        let poses = trajectory.poses().iter();
        let x: Vec<f64> = poses.map(|p| p.world_from_rig.translation_m()[0]).collect();
        assert_eq!(x, [1.0, 4.0]);
        // A time that comes back later is out of order.
        let text = "1.0 1 0 0 0 0 0 1\n2.0 2 0 0 0 0 0 1\n1.0 3 0 0 0 0 0 1\n";
        let error = parse(text, Path::new("t.txt")).unwrap_err().to_string();
        assert!(
            error.contains("a later one than the 2000000000 ns of line 2"),
            "{error}"
        );
    }

    #[test]
    fn the_real_files_are_read() {
        let Some(folder) = shared("04_trajectories/evo") else {
            return;
        };
        let truth = read(&folder.join("freiburg1_xyz-groundtruth.txt")).unwrap();
        assert_eq!(truth.poses()[0].time_ns, 1_305_031_098_665_900_000);
        // The page of the data set says 7.112 m. Straight from pose to pose it is more: 3000 poses
        // at 100 Hz that shake by less than a millimetre each.
        let length = truth.path_length_m();
        assert!((7.112..10.0).contains(&length), "{length}");
        let estimate = read(&folder.join("freiburg1_xyz-rgbdslam.txt")).unwrap();
        assert_eq!(estimate.poses()[0].time_ns, 1_305_031_102_160_407_000);
    }
}
