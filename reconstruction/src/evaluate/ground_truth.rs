//! Ground truth of feet, as simulated sessions and rendered walks have it beside that of cameras.
//!
//! Contract: `contacts.csv` and `foot-poses.csv` of `paws-rig-sim`, in a session with `truth.`
//! before their names. A contact that has no end, since the foot remains on the ground, has no time
//! of heel off and toe off. Between the rows of a foot at rest its pose is constant.

use std::path::{Path, PathBuf};

use cad_transforms::RigidTransform;
use cad_transforms::rig::Foot;

/// Maximum size of a file, bytes: 200 Hz for days.
const FILE_LIMIT: u64 = 1 << 30;

/// Why ground truth of feet cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum GroundTruthError {
    /// The file cannot be read.
    #[error("reading the ground truth of feet: {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A line is wrong.
    #[error("reading the ground truth of feet: found {found:?}, expected {expected}: {}, line {line}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Its line, from 1.
        line: usize,
        /// What was found.
        found: String,
        /// What was expected.
        expected: &'static str,
    },
}

/// A true contact of a foot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueContact {
    /// The foot.
    pub foot: Foot,
    /// Times of heel strike, foot flat, heel off and toe off, ns.
    pub events_ns: [Option<i64>; 4],
    /// Takes points in the frame of the foot at rest to the true world, metres.
    pub world_from_foot: RigidTransform,
}

/// True pose of a foot at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
struct TruePose {
    time_ns: i64,
    world_from_foot: RigidTransform,
}

/// True contacts and poses of both feet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GroundTruth {
    /// Contacts by the time of their heel strike.
    pub contacts: Vec<TrueContact>,
    /// Poses of either foot, by time.
    poses: [Vec<TruePose>; 2],
}

impl GroundTruth {
    /// Reads the files of a folder; `None` if it has none.
    ///
    /// # Errors
    /// [`GroundTruthError`].
    pub fn of_folder(folder: &Path) -> Result<Option<Self>, GroundTruthError> {
        let find = |name: &str| {
            let names = [format!("truth.{name}.csv"), format!("{name}.csv")];
            let mut paths = names.map(|name| folder.join(name)).into_iter();
            paths.find(|path| path.is_file())
        };
        let (Some(contacts), Some(poses)) = (find("contacts"), find("foot-poses")) else {
            return Ok(None);
        };
        Ok(Some(Self {
            contacts: lines(&contacts, contact)?,
            poses: split(lines(&poses, foot_pose)?),
        }))
    }

    /// Pose of a foot, if the files have that time.
    pub fn world_from_foot(&self, foot: Foot, time_ns: i64) -> Option<RigidTransform> {
        let poses = &self.poses[foot as usize];
        let after = poses.partition_point(|pose| pose.time_ns < time_ns);
        let b = poses.get(after)?;
        if b.time_ns == time_ns {
            return Some(b.world_from_foot);
        }
        let a = poses.get(after.checked_sub(1)?)?;
        let share = (time_ns - a.time_ns) as f64 / (b.time_ns - a.time_ns) as f64;
        let motion = a.world_from_foot.inverse() * b.world_from_foot;
        let turn = motion.rotation_vector().map(|v| v * share);
        let shift = motion.translation_m().map(|v| v * share);
        let part = RigidTransform::from_rotation_vector(turn, shift).ok()?;
        Some(a.world_from_foot * part)
    }
}

fn split(poses: Vec<(Foot, TruePose)>) -> [Vec<TruePose>; 2] {
    Foot::ALL.map(|foot| {
        let own = poses.iter().filter(|(of, _)| *of == foot);
        let mut own: Vec<TruePose> = own.map(|(_, pose)| *pose).collect();
        own.sort_by_key(|pose| pose.time_ns);
        own.dedup_by_key(|pose| pose.time_ns);
        own
    })
}

/// All lines that are no comments.
fn lines<T>(
    path: &Path,
    parse: impl Fn(&[&str]) -> Result<T, &'static str>,
) -> Result<Vec<T>, GroundTruthError> {
    let text =
        plain_file::read_to_string(path, FILE_LIMIT).map_err(|source| GroundTruthError::Read {
            path: path.to_owned(),
            source,
        })?;
    let rows = text.lines().enumerate();
    let rows = rows.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    rows.map(|(number, line)| {
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        parse(&fields).map_err(|expected| GroundTruthError::Malformed {
            path: path.to_owned(),
            line: number + 1,
            found: line.chars().take(120).collect(),
            expected,
        })
    })
    .collect()
}

fn contact(fields: &[&str]) -> Result<TrueContact, &'static str> {
    let [side, strike, flat, heel_off, toe_off, pose @ ..] = fields else {
        return Err("a foot, four times and a pose");
    };
    let time = |text: &&str| match text.is_empty() {
        true => Ok(None),
        false => text.parse().map(Some).map_err(|_| "a time in ns, or none"),
    };
    Ok(TrueContact {
        foot: foot(side)?,
        events_ns: [time(strike)?, time(flat)?, time(heel_off)?, time(toe_off)?],
        world_from_foot: transform(pose)?,
    })
}

fn foot_pose(fields: &[&str]) -> Result<(Foot, TruePose), &'static str> {
    let [time, side, _, pose @ ..] = fields else {
        return Err("a time, a foot, a phase and a pose");
    };
    let pose = TruePose {
        time_ns: time.parse().map_err(|_| "a time in ns")?,
        world_from_foot: transform(pose)?,
    };
    Ok((foot(side)?, pose))
}

fn foot(side: &str) -> Result<Foot, &'static str> {
    match side {
        "left" => Ok(Foot::Left),
        "right" => Ok(Foot::Right),
        _ => Err("left or right"),
    }
}

fn transform(fields: &[&str]) -> Result<RigidTransform, &'static str> {
    let numbers: Result<Vec<f64>, _> = fields.iter().map(|text| text.parse()).collect();
    let numbers = numbers.map_err(|_| "numbers")?;
    let [x, y, z, wxyz @ ..] = numbers.as_slice() else {
        return Err("seven numbers of a pose");
    };
    let wxyz: [f64; 4] = wxyz.try_into().map_err(|_| "seven numbers of a pose")?;
    RigidTransform::from_wxyz(wxyz, [*x, *y, *z]).map_err(|_| "a pose with a unit quaternion")
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONTACTS: &str = "#side,...\n\
        left,100,200,300,400,1,2,0.5,1,0,0,0\n\
        right,500,600,,,2,2,0.5,0.7071067811865476,0,0,0.7071067811865475\n";
    const POSES: &str = "#time [ns],side,phase,...\n\
        100,left,heel,0,0,0,1,0,0,0\n200,left,flat,1,0,0,1,0,0,0\n\
        300,left,flat,1,0,0,1,0,0,0\n100,right,swing,5,0,0,1,0,0,0\n";

    fn folder(contacts: &str, poses: &str) -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("truth.contacts.csv"), contacts).expect("write");
        std::fs::write(folder.path().join("truth.foot-poses.csv"), poses).expect("write");
        folder
    }

    #[test]
    fn files_are_read_and_poses_interpolated() {
        let folder = folder(CONTACTS, POSES);
        let truth = GroundTruth::of_folder(folder.path()).expect("good files");
        let truth = truth.expect("files");
        assert_eq!(truth.contacts[0].events_ns[2], Some(300));
        assert_eq!(
            truth.contacts[1].events_ns,
            [Some(500), Some(600), None, None]
        );
        let at = |foot, time_ns| {
            let pose = truth.world_from_foot(foot, time_ns)?;
            Some(pose.translation_m()[0])
        };
        for (time_ns, x) in [(100, 0.0), (150, 0.5), (200, 1.0), (250, 1.0)] {
            assert_eq!(at(Foot::Left, time_ns), Some(x), "{time_ns}");
        }
        assert_eq!(at(Foot::Left, 99), None);
        assert_eq!(at(Foot::Left, 301), None);
        assert_eq!(at(Foot::Right, 100), Some(5.0));
    }

    #[test]
    fn a_folder_without_files_has_no_truth() {
        let empty = tempfile::tempdir().expect("a folder");
        let found = GroundTruth::of_folder(empty.path());
        assert_eq!(found.expect("nothing is wrong"), None);
    }

    #[test]
    fn errors_name_file_and_line() {
        for (contacts, expected) in [
            ("#\nboth,1,2,3,4,0,0,0,1,0,0,0\n", "left or right"),
            ("#\nleft,1,2,3\n", "a foot, four times"),
            ("#\nleft,1,2,3,soon,0,0,0,1,0,0,0\n", "a time in ns"),
            ("#\nleft,1,2,3,4,0,0,0,1,0,0\n", "seven numbers"),
            ("#\nleft,1,2,3,4,0,0,0,2,0,0,0\n", "unit quaternion"),
        ] {
            let folder = folder(contacts, POSES);
            let error = GroundTruth::of_folder(folder.path()).expect_err("a bad line");
            let text = error.to_string();
            assert!(text.contains(expected) && text.contains("line 2"), "{text}");
            assert!(text.contains("truth.contacts.csv"), "{text}");
        }
    }
}
