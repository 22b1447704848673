//! Directions of the pixels of lenses with distortion, for the background: slow to compute, and the
//! same in all images of a camera.

use std::sync::{Arc, Mutex, PoisonError};

use camera_models::{CameraModel, Distortion, Lens};
use rayon::prelude::*;

use crate::camera::Camera;

/// Lenses whose directions are kept: both eyes of a few cameras in a few sizes of the image.
const MAX_LENSES: usize = 24;

/// Direction of each pixel in the axes of the camera, row by row; NaN where the lens has none.
#[derive(Debug)]
pub(super) struct Rays(Vec<[f32; 3]>);

impl Rays {
    fn new(lens: &Lens) -> Self {
        let (width, height) = (lens.model().width as usize, lens.model().height as usize);
        let ray = |pixel: usize| {
            let [column, row] = [pixel % width, pixel / width].map(|v| v as f64);
            let ray = lens.unproject([column, row]);
            ray.map_or([f32::NAN; 3], |ray| ray.map(|v| v as f32))
        };
        Self((0..width * height).into_par_iter().map(ray).collect())
    }

    /// The direction of a pixel, if it has one.
    pub(super) fn get(&self, pixel: usize) -> Option<[f32; 3]> {
        let ray = self.0.get(pixel)?;
        (!ray[0].is_nan()).then_some(*ray)
    }
}

/// A lens with its directions.
type OfLens = (CameraModel, Arc<Rays>);

/// Directions of the lenses that were used last.
#[derive(Clone, Debug, Default)]
pub(super) struct RayTables(Arc<Mutex<Vec<OfLens>>>);

impl RayTables {
    /// Those of a camera; `None` of one without distortion.
    pub(super) fn of(&self, camera: &Camera) -> Option<Arc<Rays>> {
        let model = camera.model();
        if model.distortion == Distortion::None {
            return None;
        }
        let find = |tables: &[OfLens]| {
            let found = tables.iter().find(|(of, _)| of == model);
            found.map(|(_, rays)| rays.clone())
        };
        let lock = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = find(&lock()) {
            return Some(found);
        }
        // Without the lock: other tasks of this thread pool may want it meanwhile.
        let rays = Arc::new(Rays::new(camera.lens()));
        let mut tables = lock();
        if let Some(found) = find(&tables) {
            return Some(found);
        }
        if tables.len() == MAX_LENSES {
            tables.remove(0);
        }
        tables.push((*model, rays.clone()));
        Some(rays)
    }
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;

    use super::*;

    const FISHEYE: Distortion = Distortion::KannalaBrandt4 {
        k1: 0.05,
        k2: 0.01,
        k3: 0.0,
        k4: 0.0,
    };

    fn camera(width: u32, distortion: Distortion) -> Camera {
        let model = CameraModel::new((width, 12), [14.0, 14.0, 8.0, 6.0], distortion);
        Camera::new(model, RigidTransform::identity()).unwrap()
    }

    #[test]
    fn directions_are_those_of_the_lens_and_shared() {
        let tables = RayTables::default();
        assert!(tables.of(&camera(16, Distortion::None)).is_none());
        let own = camera(16, FISHEYE);
        let rays = tables.of(&own).unwrap();
        for pixel in 0..16 * 12_u32 {
            let at = [f64::from(pixel % 16), f64::from(pixel / 16)];
            let expected = own.lens().unproject(at).map(|ray| ray.map(|v| v as f32));
            assert_eq!(rays.get(pixel as usize), expected);
        }
        assert!(Arc::ptr_eq(&rays, &tables.of(&own).unwrap()));
        assert!(Arc::ptr_eq(&rays, &tables.clone().of(&own).unwrap()));
    }

    #[test]
    fn the_oldest_lens_gives_way() {
        let tables = RayTables::default();
        let distortion = FISHEYE;
        let first = tables.of(&camera(16, distortion)).unwrap();
        for width in 17..17 + MAX_LENSES as u32 {
            tables.of(&camera(width, distortion)).unwrap();
        }
        assert!(!Arc::ptr_eq(
            &first,
            &tables.of(&camera(16, distortion)).unwrap()
        ));
        assert_eq!(tables.0.lock().unwrap().len(), MAX_LENSES);
    }
}
