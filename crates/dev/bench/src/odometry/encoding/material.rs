//! A walk in color, as the daemon gets it from its cameras.

use std::fs::File;
use std::io::{BufReader, BufWriter, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;

use anyhow::{Context, Result, ensure};
use harness::sequences::{self, OwnedFrameSet, OwnedView, Sequence, named};
use rig_sim::device::{Delivery, Device};
use rig_sim::faults::Faults;
use rig_sim::simulation::Simulation;
use video::{PixelFormat, RawImage};

/// Images of all cameras of a walk: left and right side by side, I420, one file for each camera.
pub(super) struct Material {
    /// One for each camera.
    pub(super) files: Vec<PathBuf>,
    /// Columns of both images together.
    pub(super) width: u32,
    /// Rows.
    pub(super) height: u32,
    /// Frames per second.
    pub(super) rate_hz: f64,
    /// Times of the sets, ns.
    pub(super) times: Vec<i64>,
}

impl Material {
    /// Renders a walk unless it is in the folder already.
    ///
    /// # Errors
    /// There is no such walk, or the folder cannot be written.
    pub(super) fn of(walk: &str, folder: &Path) -> Result<(Self, Sequence)> {
        let settings = named::settings(walk)?;
        let sequence = sequences::walk(&settings)?;
        let simulation = sequence
            .truth()
            .simulation()
            .context("a walk is simulated")?;
        let folder = folder.join("encoding").join(walk);
        std::fs::create_dir_all(&folder).with_context(|| format!("making {}", folder.display()))?;
        let cameras = simulation.cameras().iter();
        let files: Vec<PathBuf> = cameras
            .map(|camera| folder.join(format!("{}.i420", camera.name)))
            .collect();
        let rendering: Vec<_> = (files.iter().enumerate())
            .filter(|(_, path)| !path.exists())
            .map(|(camera, path)| {
                let (simulation, path) = (simulation.clone(), path.clone());
                thread::spawn(move || render(&simulation, camera, &path))
            })
            .collect();
        for thread in rendering {
            thread.join().expect("rendering does not panic")?;
        }
        let [width, height] = settings.size;
        let material = Self {
            files,
            width: 2 * width,
            height,
            rate_hz: settings.rate_hz,
            times: sequence.times().collect(),
        };
        let expected = (material.times.len() * material.image_bytes()) as u64;
        for path in &material.files {
            let found = std::fs::metadata(path)?.len();
            ensure!(
                found == expected,
                "found {found} bytes of images, expected {expected}: remove {}",
                path.display()
            );
        }
        Ok((material, sequence))
    }

    fn image_bytes(&self) -> usize {
        self.width as usize * self.height as usize * 3 / 2
    }

    /// The images of a file, in order.
    ///
    /// # Errors
    /// The file cannot be opened; each image has an error of its own.
    pub(super) fn images(
        &self,
        path: &Path,
    ) -> Result<impl Iterator<Item = Result<RawImage>> + use<>> {
        let file = File::open(path).with_context(|| format!("opening {}", path.display()))?;
        let mut file = BufReader::with_capacity(1 << 20, file);
        let (width, height, bytes) = (self.width, self.height, self.image_bytes());
        let path = path.to_owned();
        let read = move || {
            let mut pixels = vec![0; bytes];
            let read = file.read_exact(&mut pixels);
            read.with_context(|| format!("reading {}", path.display()))?;
            Ok(RawImage::new(width, height, PixelFormat::I420, pixels)?)
        };
        Ok(std::iter::repeat_with(read).take(self.times.len()))
    }

    /// The luma of all images, set by set.
    ///
    /// # Errors
    /// A file cannot be read.
    pub(super) fn sets(&self) -> Result<Vec<OwnedFrameSet>> {
        let mut sets = self.empty();
        for path in &self.files {
            for (set, image) in sets.iter_mut().zip(self.images(path)?) {
                set.views.push(Some(view(&image?, set.time_ns)));
            }
        }
        Ok(sets)
    }

    /// Sets without views.
    pub(super) fn empty(&self) -> Vec<OwnedFrameSet> {
        let set = |time_ns: &i64| OwnedFrameSet {
            time_ns: *time_ns,
            views: Vec::new(),
            imu: Vec::new(),
        };
        self.times.iter().map(set).collect()
    }
}

/// The luma of an image.
pub(super) fn view(image: &RawImage, time_ns: i64) -> OwnedView {
    let (width, height) = (image.width as usize, image.height as usize);
    let half = width / 2;
    let eye = |from: usize| -> Vec<u8> {
        let rows = image.data[..width * height].chunks_exact(width);
        rows.flat_map(|row| &row[from..from + half])
            .copied()
            .collect()
    };
    OwnedView {
        time_ns,
        width: half,
        height,
        left: eye(0),
        right: eye(half),
    }
}

fn render(simulation: &Arc<Simulation>, camera: usize, path: &Path) -> Result<()> {
    let name = &simulation.cameras()[camera].name;
    let mut device = Device::rendered(simulation, camera, Faults::default().of(name));
    let beside = path.with_extension("part");
    let file = File::create(&beside).with_context(|| format!("making {}", beside.display()))?;
    let mut file = BufWriter::with_capacity(1 << 20, file);
    while let Some(delivery) = device.deliver() {
        if let Delivery::Frame(frame) = delivery {
            file.write_all(&frame.image.i420)?;
        }
    }
    file.flush()?;
    std::fs::rename(&beside, path).with_context(|| format!("writing {}", path.display()))
}
