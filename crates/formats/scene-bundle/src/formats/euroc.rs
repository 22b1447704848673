//! EuRoC/ASL `data.csv`: a line per pose, nanoseconds, position m, quaternion `w x y z`, and where
//! known velocity m/s and the biases of gyroscope rad/s and accelerometer m/s² (Burri et al. 2016,
//! `state_groundtruth_estimate0`).
//!
//! Contract: as of [`formats`](super). A line has 8, 11 or 17 fields, the same number in every line
//! of a file; a trailing comma is allowed, since some files have it. Velocities are written when
//! all poses have one, biases when velocities are.

use std::path::Path;

use super::text::{FormatError, Rows, Source, format_numbers, read as text_of};
use crate::trajectory::{Pose, Trajectory};

const COLUMNS: [&str; 17] = [
    "timestamp [ns]",
    "p_RS_R_x [m]",
    "p_RS_R_y [m]",
    "p_RS_R_z [m]",
    "q_RS_w []",
    "q_RS_x []",
    "q_RS_y []",
    "q_RS_z []",
    "v_RS_R_x [m s^-1]",
    "v_RS_R_y [m s^-1]",
    "v_RS_R_z [m s^-1]",
    "b_w_RS_S_x [rad s^-1]",
    "b_w_RS_S_y [rad s^-1]",
    "b_w_RS_S_z [rad s^-1]",
    "b_a_RS_S_x [m s^-2]",
    "b_a_RS_S_y [m s^-2]",
    "b_a_RS_S_z [m s^-2]",
];

/// IMU biases, in the IMU's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Biases {
    /// Of the gyroscope, rad/s.
    pub gyroscope_rad_s: [f64; 3],
    /// Of the accelerometer, m/s².
    pub accelerometer_m_s2: [f64; 3],
}

/// What such a file holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// The poses, with velocities where the file has them.
    pub trajectory: Trajectory,
    /// Biases, one per pose, where the file has them.
    pub biases: Option<Vec<Biases>>,
}

/// Reads a file.
///
/// # Errors
/// [`FormatError`].
pub fn read(path: &Path) -> Result<Estimate, FormatError> {
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
/// use scene_bundle::formats::euroc;
///
/// let text = "#timestamp, p_x, p_y, p_z, q_w, q_x, q_y, q_z, v_x, v_y, v_z\n\
///             1403715273262142976,0.878,2.142,0.947,1,0,0,0,0.009,-0.327,0.001\n";
/// let estimate = euroc::parse(text, Path::new("data.csv"))?;
/// let pose = &estimate.trajectory.poses()[0];
/// assert_eq!(pose.time_ns, 1_403_715_273_262_142_976);
/// assert_eq!(pose.velocity_in_world, Some([0.009, -0.327, 0.001]));
/// assert_eq!(estimate.biases, None);
/// # Ok::<(), scene_bundle::FormatError>(())
/// ```
pub fn parse(text: &str, path: &Path) -> Result<Estimate, FormatError> {
    let source = Source {
        kind: "EuRoC",
        path,
        text,
    };
    let (mut rows, mut biases) = (Rows::default(), Vec::new());
    let mut columns: Option<(usize, usize)> = None;
    for (line, text) in source.lines() {
        let text = text.strip_suffix(',').unwrap_or(text);
        let words: Vec<&str> = text.split(',').map(str::trim).collect();
        let count = words.len();
        if ![8, 11, 17].contains(&count) {
            return Err(source.malformed(
                line,
                format!("{count} fields"),
                "8 (time, position, quaternion), 11 (velocity too) or 17 (biases too), separated by commas",
            ));
        }
        let (of_line, columns) = *columns.get_or_insert((line, count));
        if count != columns {
            let expected = format!("{columns} as in line {of_line}");
            return Err(source.malformed(line, format!("{count} fields"), expected));
        }
        let time_ns = words[0].parse::<i64>().map_err(|_| {
            source.malformed(
                line,
                format!("{:?}", words[0]),
                "a time in whole nanoseconds",
            )
        })?;
        let mut n = [0.0; 16];
        for (number, word) in n.iter_mut().zip(&words[1..]) {
            *number = source.number(line, word)?;
        }
        let three = |first: usize| [n[first], n[first + 1], n[first + 2]];
        let transform = source.transform(line, [n[3], n[4], n[5], n[6]], three(0))?;
        let mut pose = Pose::new(time_ns, transform);
        pose.velocity_in_world = (count > 8).then(|| three(7));
        if rows.push(line, pose) && count == 17 {
            biases.push(Biases {
                gyroscope_rad_s: three(10),
                accelerometer_m_s2: three(13),
            });
        }
    }
    Ok(Estimate {
        trajectory: source.trajectory(rows)?,
        biases: (!biases.is_empty()).then_some(biases),
    })
}

/// The text of a file. Lost poses are left out, with their biases. `biases`, where given, are one
/// per pose of the trajectory (lost ones included); they are left out if their number differs, or
/// not every pose has a velocity, since the columns of the format cannot be skipped.
pub fn to_text(trajectory: &Trajectory, biases: Option<&[Biases]>) -> String {
    let velocities = trajectory.usable().all(|p| p.velocity_in_world.is_some());
    let biases = biases.filter(|b| velocities && b.len() == trajectory.len());
    let columns = match (velocities, biases) {
        (false, _) => 8,
        (true, None) => 11,
        (true, Some(_)) => 17,
    };
    let mut text = format!("#{}\n", COLUMNS[..columns].join(","));
    for (index, pose) in trajectory.poses().iter().enumerate() {
        if pose.status == crate::Status::Lost {
            continue;
        }
        let mut numbers = pose.world_from_rig.translation_m().to_vec();
        numbers.extend(pose.world_from_rig.rotation_wxyz());
        if columns > 8 {
            numbers.extend(pose.velocity_in_world.iter().flatten());
        }
        if let Some(biases) = biases {
            numbers.extend(biases[index].gyroscope_rad_s);
            numbers.extend(biases[index].accelerometer_m_s2);
        }
        text += &pose.time_ns.to_string();
        text.push(',');
        text += &format_numbers(&numbers, ",");
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use test_data::shared;

    use crate::formats::tests::{bare, walk};
    use crate::trajectory::Status;

    fn parsed(text: &str) -> Result<Estimate, FormatError> {
        parse(text, Path::new("data.csv"))
    }

    #[test]
    fn written_poses_read_back_to_the_same_bits() {
        let all = walk();
        let biases: Vec<Biases> = (0..all.len())
            .map(|i| Biases {
                gyroscope_rad_s: [0.01, -0.02, 1e-7 * i as f64],
                accelerometer_m_s2: [0.1 / 3.0, 0.0, -0.2],
            })
            .collect();

        let with_biases = parsed(&to_text(&all, Some(&biases))).unwrap();
        let kept: Vec<usize> = (0..all.len())
            .filter(|&i| all.poses()[i].status != Status::Lost)
            .collect();
        let kept_biases: Vec<Biases> = kept.iter().map(|&i| biases[i]).collect();
        assert_eq!(with_biases.biases, Some(kept_biases));
        for (found, &index) in with_biases.trajectory.poses().iter().zip(&kept) {
            let expected = &all.poses()[index];
            assert_eq!(found.velocity_in_world, expected.velocity_in_world);
            assert_eq!(found.world_from_rig, expected.world_from_rig);
            assert_eq!(found.time_ns, expected.time_ns);
        }

        let with_velocities = parsed(&to_text(&all, None)).unwrap();
        assert_eq!(with_velocities.biases, None);
        assert_eq!(with_velocities.trajectory, with_biases.trajectory);

        // One pose without a velocity: the columns are left out.
        let mut poses = all.into_poses();
        poses[0].velocity_in_world = None;
        let all = Trajectory::new(poses).unwrap();
        let without = parsed(&to_text(&all, Some(&biases))).unwrap();
        assert_eq!((without.trajectory, without.biases), (bare(&all), None));
    }

    #[test]
    fn malformed_lines_are_named_in_the_error() {
        let check = |text: &str, message: &str| {
            let error = parsed(text).unwrap_err().to_string();
            assert_eq!(
                error,
                format!("reading a EuRoC trajectory: {message}: data.csv")
            );
        };
        let good = "1,0,0,0,1,0,0,0\n";
        check(
            &format!("{good}2,0,0,0,1,0,0\n"),
            "line 2: found 7 fields, expected 8 (time, position, quaternion), 11 (velocity too) or 17 (biases too), \
             separated by commas",
        );
        check(
            &format!("#header\n{good}2,0,0,0,1,0,0,0,1,2,3\n"),
            "line 3: found 11 fields, expected 8 as in line 2",
        );
        check(
            "1.5,0,0,0,1,0,0,0\n",
            "line 1: found \"1.5\", expected a time in whole nanoseconds",
        );
        check(
            &format!("{good}0,0,0,0,1,0,0,0\n"),
            "line 2: found the time 0 ns, expected a later one than the 1 ns of line 1",
        );
        // A file with the real part last, of a body that hardly rotates: the norm is right
        // nevertheless, so this cannot be detected. Only values that are not a rotation are
        // refused.
        check(
            "1,0,0,0,0.5,0,0,0\n",
            "line 1: found a quaternion of norm 0.5, expected norm 1 within 0.001",
        );
    }

    #[test]
    fn first_row_of_a_repeated_time_is_used_with_its_biases() {
        let row = |time: i64, x: f64| format!("{time},{x},0,0,1,0,0,0,0,0,0,{x},0,0,0,0,0\n");
        let text: String = [(1, 1.0), (1, 2.0), (2, 3.0)]
            .map(|(t, x)| row(t, x))
            .concat();
        let found = parsed(&text).unwrap();
        let poses = found.trajectory.poses().iter();
        let x: Vec<f64> = poses.map(|p| p.world_from_rig.translation_m()[0]).collect();
        let biases = found.biases.unwrap();
        let bias_x: Vec<f64> = biases.iter().map(|b| b.gyroscope_rad_s[0]).collect();
        assert_eq!((x, bias_x), (vec![1.0, 3.0], vec![1.0, 3.0]));
    }

    #[test]
    fn the_real_files_are_read() {
        if let Some(path) = shared("03_stereo_imu/euroc_groundtruth/V1_01_easy.csv") {
            let found = read(&path).unwrap();
            let first = &found.trajectory.poses()[0];
            assert_eq!(first.time_ns, 1_403_715_273_262_142_976);
            assert_eq!(
                first.velocity_in_world,
                Some([0.00157587, 0.00179383, -0.00231615])
            );
            assert_eq!(found.biases.unwrap()[0].accelerometer_m_s2[2], 0.0309774);
            // Burri et al. 2016, table 2: V1_01_easy is 58.6 m long.
            let length = found.trajectory.path_length_m();
            assert!((57.5..60.0).contains(&length), "{length}");
        }
        if let Some(path) = shared("03_stereo_imu/kimera_online_alignment/mav0/gt0/data.csv") {
            let found = read(&path).unwrap();
            assert!(found.trajectory.len() > 100 && found.biases.is_some());
        }
    }
}
