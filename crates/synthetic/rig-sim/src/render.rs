//! A simulated walk as files in common formats.
//!
//! Contract: the folder appears complete or not at all; it is built in a sibling folder
//! `NAME.unfinished`, and a nonempty folder is never modified. The same [`Simulation`] gives the
//! same bytes on any number of threads.
//!
//! ```text
//! OUT/simulation.toml                 the settings
//! OUT/rig.toml                        the recorded rig file
//! OUT/rig.tum                         world_from_rig at each frame: time, position, quaternion x y z w
//! OUT/rig.kitti.txt                   the same as rows of 3x4 matrices
//! OUT/contacts.csv                    times and poses of foot contacts with the ground
//! OUT/foot-poses.csv                  poses of both soles at 200 Hz, and what bears on the ground
//! OUT/soles.csv                       outlines of the soles, in the frames of the feet
//! OUT/planes.csv, OUT/step-edges.csv  planes of the terrain near the route, and edges of steps
//! OUT/CAMERA/mav0/cam0, cam1          left and right eye as in EuRoC (Burri et al. 2016), gray
//! OUT/CAMERA/mav0/imu0                the camera's IMU, which is the body
//! OUT/CAMERA/mav0/state_groundtruth_estimate0   pose and velocity of the body, biases of the IMU
//! OUT/session                         a session archive, on request
//! ```
//!
//! For a calibration session, or if the ground truth differs from the recorded calibration, also
//!
//! ```text
//! OUT/target.N.toml                   each board as designed
//! OUT/truth.targets.csv               world_from_target of each board, and true positions of its corners
//! OUT/truth.rig.toml                  true extrinsics, and
//! OUT/truth.cameras.toml              true intrinsics, shutters and time offsets
//! OUT/CAMERA/corners.csv              corners of boards in both eyes, at each frame; with the ground truth of images
//! ```
//!
//! and ground truth of the images, on request:
//!
//! ```text
//! OUT/scene.ply                       the static scene, with class, plane, and whether it is walkable
//! OUT/CAMERA/tags.csv                 corners of the tags on the shoes, in both eyes, per frame
//! OUT/CAMERA/mav0/depth0, depth1      ground truth of the left and the right eye: depth,
//! OUT/CAMERA/mav0/class0, class1      class,
//! OUT/CAMERA/mav0/instance0, instance1   instance,
//! OUT/CAMERA/mav0/flow0, flow1        and optical flow to the next frame
//! ```
//!
//! The PNG files hold values at pixel centers, each row at the middle of its exposure: depth as
//! 16-bit mm along the optical axis (0: none, or more than 65.535 m); class as 8-bit numbers of
//! [`Class`]; instance as 16-bit numbers, 0 the sky; flow as KITTI's 16-bit red, green, blue (Menze
//! and Geiger 2015): 64 times the displacement in px plus 2^15, to the right and down, and 0 for
//! undefined, 1 for visible in the next frame, 2 for occluded or outside there. In `tags.csv` a row
//! is a tag in front of an eye (0 left, 1 right); `visible` is 1 if its whole black square is in
//! the image and unoccluded, `visible share` is how much of it is. Its corners are those of the
//! black square in the order of AprilTag's detections: bottom left, bottom right, top right, top
//! left, for a reader who sees the tag upright. Integers are pixel centers; AprilTag's own
//! coordinates are greater by 0.5.
//!
//! All times are ns since the beginning of the walk. The world is z up; its origin is that of the
//! scene.
//!
//! [`Class`]: crate::scene::surface::Class

use std::fs;
use std::io;
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use cad_transforms::rig::Rig;

use crate::faults::Faults;
use crate::simulation::Simulation;

mod asl;
mod mesh;
pub mod session;
mod special;
mod tables;
pub(crate) mod terrain;
mod truth;
mod yaml;

pub(crate) use self::tables::{contacts, foot_poses};

/// Options of rendering.
#[derive(Clone, Copy, Debug)]
pub struct Job<'a> {
    /// The recorded (nominal) rig.
    pub rig: &'a Rig,
    /// Text of its file, which is copied beside the images.
    pub rig_text: &'a str,
    /// Also writes a session archive.
    pub session: bool,
    /// Faults: the folders have those of lenses and light, the session has all.
    pub faults: &'a Faults,
    /// Also writes ground truth of the images.
    pub truth: bool,
    /// Number of cameras rendered concurrently, at least 1.
    pub threads: usize,
}

/// Error of rendering.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The folder is not empty: choose another one.
    #[error("rendering a walk: found something in the folder, expected a new or an empty one: {}", .0.display())]
    Occupied(PathBuf),
    /// Another run is writing there, or was interrupted: remove the folder in the latter case.
    #[error("rendering a walk: found the output of an unfinished run, remove it if no run is active: {}", .0.display())]
    Unfinished(PathBuf),
    /// A file or folder could not be created.
    #[error("writing a rendered walk: {}", path.display())]
    Write {
        /// Path.
        path: PathBuf,
        /// I/O error.
        source: io::Error,
    },
    /// The session archive could not be written.
    #[error(transparent)]
    Session(#[from] session::SessionError),
    /// EuRoC files cannot represent this lens model: use another one.
    #[error(
        "writing the calibration of {camera}: found a lens model that sensor.yaml cannot represent, expected none, radial-tangential without k3, or equidistant"
    )]
    Lens {
        /// Name of the camera.
        camera: String,
    },
}

/// Attaches the path to an I/O error.
fn at(path: &Path) -> impl FnOnce(io::Error) -> RenderError {
    let path = path.to_owned();
    move |source| RenderError::Write { path, source }
}

fn write(path: &Path, text: &str) -> Result<(), RenderError> {
    fs::write(path, text).map_err(at(path))
}

/// Renders the whole walk into the folder `out`. `done` is called after each stereo frame, from any
/// thread.
///
/// # Errors
/// [`RenderError`]; `out` is then unchanged.
pub fn render(
    simulation: &Arc<Simulation>,
    job: &Job<'_>,
    out: &Path,
    done: &(dyn Fn() + Sync),
) -> Result<(), RenderError> {
    let unfinished = begin(out)?;
    let result = fill(simulation, job, &unfinished, done)
        .and_then(|()| fs::rename(&unfinished, out).map_err(at(out)));
    if result.is_err() {
        // The first error is reported; if removing the folder fails, the next run reports it.
        let _ = fs::remove_dir_all(&unfinished);
    }
    result
}

/// Writes only the session archive, into the folder `out`; as [`render`].
///
/// # Errors
/// [`RenderError`]; `out` is then unchanged.
pub fn render_session(
    simulation: &Arc<Simulation>,
    job: &Job<'_>,
    out: &Path,
    done: &(dyn Fn() + Sync),
) -> Result<(), RenderError> {
    let unfinished = begin(out)?;
    let (rig, text) = (job.rig, job.rig_text);
    let result = session::write(simulation, rig, text, job.faults, &unfinished, done)
        .map_err(RenderError::from)
        .and_then(|()| fs::rename(&unfinished, out).map_err(at(out)));
    if result.is_err() {
        // See `render`.
        let _ = fs::remove_dir_all(&unfinished);
    }
    result
}

/// Creates the folder that is renamed to `out`.
fn begin(out: &Path) -> Result<PathBuf, RenderError> {
    match fs::read_dir(out) {
        Ok(mut entries) => {
            if entries.next().is_some() {
                return Err(RenderError::Occupied(out.to_owned()));
            }
        }
        Err(e) if e.kind() == io::ErrorKind::NotFound => {}
        Err(e) => return Err(at(out)(e)),
    }
    let Some(name) = out.file_name() else {
        let message = "expected a path that ends with the name of a folder";
        return Err(at(out)(io::Error::new(
            io::ErrorKind::InvalidInput,
            message,
        )));
    };
    let mut name = name.to_owned();
    name.push(".unfinished");
    let unfinished = out.with_file_name(name);
    if let Some(parent) = out.parent() {
        fs::create_dir_all(parent).map_err(at(parent))?;
    }
    match fs::create_dir(&unfinished) {
        Ok(()) => Ok(unfinished),
        Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {
            Err(RenderError::Unfinished(unfinished))
        }
        Err(e) => Err(at(&unfinished)(e)),
    }
}

fn fill(
    simulation: &Arc<Simulation>,
    job: &Job<'_>,
    folder: &Path,
    done: &(dyn Fn() + Sync),
) -> Result<(), RenderError> {
    let file = |name: &str, text: &str| write(&folder.join(name), text);
    file("simulation.toml", &tables::settings(simulation))?;
    file("rig.toml", job.rig_text)?;
    file("rig.tum", &tables::tum(simulation))?;
    file("rig.kitti.txt", &tables::kitti(simulation))?;
    file("contacts.csv", &contacts(simulation, 0))?;
    file("foot-poses.csv", &foot_poses(simulation, 0))?;
    file("soles.csv", &terrain::soles())?;
    let planes = simulation.scene().planes();
    file("planes.csv", &terrain::planes(&planes))?;
    let edges = simulation.scene().step_edges();
    file("step-edges.csv", &terrain::step_edges(&edges))?;
    for (name, text) in special::files(simulation, job.rig) {
        file(&name, &text)?;
    }
    if job.truth {
        let path = folder.join("scene.ply");
        fs::write(&path, mesh::ply(simulation.scene(), &planes)).map_err(at(&path))?;
    }
    let cameras = simulation.cameras().len();
    let next = AtomicUsize::new(0);
    let work = || -> Result<(), RenderError> {
        loop {
            let camera = next.fetch_add(1, Ordering::Relaxed);
            if camera >= cameras {
                return Ok(());
            }
            asl::camera(simulation, camera, job, folder, done)?;
        }
    };
    thread::scope(|scope| {
        let workers: Vec<_> = (0..job.threads.clamp(1, cameras.max(1)))
            .map(|_| scope.spawn(work))
            .collect();
        workers
            .into_iter()
            .try_for_each(|worker| worker.join().unwrap_or_else(|panic| resume_unwind(panic)))
    })?;
    if job.session {
        let session = folder.join("session");
        fs::create_dir(&session).map_err(at(&session))?;
        session::write(
            simulation,
            job.rig,
            job.rig_text,
            job.faults,
            &session,
            done,
        )?;
    }
    Ok(())
}
