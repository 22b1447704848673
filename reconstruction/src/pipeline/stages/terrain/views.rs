//! Depth maps of keyframes as the crate `terrain` takes them, a few at a time.

use camera_models::{Eye, Lens};
use rayon::prelude::*;
use scene_bundle::outputs::depth::{DEPTH_UNIT_M, DepthIndex, SIGMA_UNIT_M, read};
use scene_bundle::outputs::masks::{self, Mask};
use scene_bundle::outputs::rig::RigModel;
use scene_bundle::{BundleError, OutputReader};
use session_input::ReadError;
use terrain::{DepthView, PixelClass, TerrainError};

use super::shoes::Shoes;
use crate::pipeline::StageError;
use crate::pipeline::stages::depth_frames::DepthFrame;

/// Number of depth maps in memory.
const BATCH: usize = 8;

/// Reads depth maps and masks.
pub(super) struct ViewReader<'a> {
    depth: &'a OutputReader,
    index: &'a DepthIndex,
    masks: &'a OutputReader,
    shoes: Shoes<'a>,
    cameras: Vec<MaskedView>,
    pose_sigma_m: f64,
}

/// Masks of the view of a camera.
struct MaskedView {
    /// Pixel of the recorded left image of each pixel of the view, `None` outside of it.
    recorded: Vec<Option<u32>>,
    /// Classes of the pixels by the mask of the wearer.
    classes: Vec<PixelClass>,
}

/// A depth map in memory.
struct ViewBuffer {
    frame: DepthFrame,
    depth_m: Vec<f32>,
    sigma_m: Vec<f32>,
    classes: Vec<PixelClass>,
}

impl<'a> ViewReader<'a> {
    pub(super) fn new(
        (depth, index): (&'a OutputReader, &'a DepthIndex),
        masks: &'a OutputReader,
        shoes: Shoes<'a>,
        rig: &RigModel,
        pose_sigma_m: f64,
    ) -> Result<Self, StageError> {
        let camera = |view: &scene_bundle::outputs::depth::DepthView| {
            let camera = rig.camera(&view.camera);
            let (_, camera) = camera.ok_or_else(|| ReadError::NoSuch(view.camera.clone()))?;
            let (lens, pinhole) = (Lens::new(&camera.left), Lens::new(&view.model));
            let [width, height] = [camera.left.width, camera.left.height];
            let left_from_view = view.view_from_left.inverse();
            let pixel = |at: [u32; 2]| {
                let ray = pinhole.unproject(at.map(f64::from))?;
                let [x, y] = lens.project(left_from_view.rotate(ray))?.map(f64::round);
                let inside =
                    (0.0..f64::from(width)).contains(&x) && (0.0..f64::from(height)).contains(&y);
                inside.then(|| y as u32 * width + x as u32)
            };
            let rows =
                (0..view.model.height).flat_map(|y| (0..view.model.width).map(move |x| [x, y]));
            let recorded: Vec<Option<u32>> = rows.map(pixel).collect();
            let mut classes = vec![PixelClass::Static; recorded.len()];
            if let Some(wearer) = masks::read(masks, &view.camera, Eye::Left)? {
                exclude(&mut classes, &recorded, &wearer);
            }
            Ok(MaskedView { recorded, classes })
        };
        Ok(Self {
            depth,
            index,
            masks,
            shoes,
            cameras: index
                .views
                .iter()
                .map(camera)
                .collect::<Result<_, StageError>>()?,
            pose_sigma_m,
        })
    }

    /// Calls a function with the view of each frame, in order.
    pub(super) fn for_each(
        &self,
        frames: &[DepthFrame],
        mut use_view: impl FnMut(&DepthView<'_>) -> Result<(), TerrainError>,
    ) -> Result<(), StageError> {
        for batch in frames.chunks(BATCH) {
            let read = batch.par_iter().map(|frame| self.read(frame));
            for buffer in read.collect::<Result<Vec<_>, BundleError>>()? {
                use_view(&self.view(&buffer))?;
            }
        }
        Ok(())
    }

    fn read(&self, frame: &DepthFrame) -> Result<ViewBuffer, BundleError> {
        let image = read(self.depth, self.index, &frame.key)?;
        let view = &self.index.views[frame.key.view];
        let of_camera = &self.cameras[frame.key.view];
        let mut classes = of_camera.classes.clone();
        if let Some(dynamic) = masks::read_dynamic(self.masks, &view.camera, frame.key.frame)? {
            exclude(&mut classes, &of_camera.recorded, &dynamic);
        }
        let metres = |units: &[u16], unit_m: f64| {
            let one = |units: &u16| (f64::from(*units) * unit_m) as f32;
            units.iter().map(one).collect()
        };
        let depth_m: Vec<f32> = metres(&image.depth, DEPTH_UNIT_M);
        self.shoes.exclude(view, frame, &depth_m, &mut classes);
        Ok(ViewBuffer {
            frame: *frame,
            depth_m,
            sigma_m: metres(&image.sigma, SIGMA_UNIT_M),
            classes,
        })
    }

    fn view<'b>(&self, buffer: &'b ViewBuffer) -> DepthView<'b> {
        let model = &self.index.views[buffer.frame.key.view].model;
        DepthView {
            size: [model.width as usize, model.height as usize],
            focal_px: [model.fx, model.fy],
            center_px: [model.cx, model.cy],
            world_from_view: buffer.frame.world_from_view,
            row_motion: buffer.frame.row_motion,
            pose_sigma_m: self.pose_sigma_m,
            depth_m: &buffer.depth_m,
            sigma_m: &buffer.sigma_m,
            color: None,
            classes: Some(&buffer.classes),
        }
    }
}

/// Excludes pixels that a mask of the recorded left image excludes.
fn exclude(classes: &mut [PixelClass], recorded: &[Option<u32>], mask: &Mask) {
    for (class, pixel) in classes.iter_mut().zip(recorded) {
        if pixel.and_then(|pixel| mask.pixels.get(pixel as usize)) == Some(&0) {
            *class = PixelClass::Excluded;
        }
    }
}
