//! Images to train from.

use camera_models::CameraModel;

use crate::camera::Camera;
use crate::error::SplatError;
use crate::scene::Exposure;

/// An image with its camera.
#[derive(Clone, Debug)]
pub struct TrainingView {
    /// The camera.
    pub camera: Camera,
    /// Red, green and blue of each pixel, row by row.
    pub rgb: Vec<u8>,
    /// Whether a pixel may be used, row by row. Empty: all.
    pub mask: Vec<bool>,
    /// Depth along the optical axis, m; NaN where unknown. Empty: unknown everywhere.
    pub depth_m: Vec<f32>,
    /// Standard deviation of the depth, m, with the part of the poses; as long as the depths.
    pub depth_sigma_m: Vec<f32>,
    /// Exposure as far as it is known.
    pub exposure: Exposure,
    /// Images of one group share a correction of the exposure: those of one frame, or of one
    /// camera.
    pub exposure_group: u32,
    /// Images of one instant count as one observation.
    pub instant: u32,
}

impl TrainingView {
    /// An image without mask and depth, with its own exposure group and instant.
    pub fn new(camera: Camera, rgb: Vec<u8>, number: u32) -> Self {
        Self {
            camera,
            rgb,
            mask: Vec::new(),
            depth_m: Vec::new(),
            depth_sigma_m: Vec::new(),
            exposure: Exposure::NONE,
            exposure_group: number,
            instant: number,
        }
    }

    /// # Errors
    /// [`SplatError::Size`] if a buffer does not fit the image.
    pub(crate) fn check(&self) -> Result<(), SplatError> {
        let pixels = self.camera.pixels();
        let check = |what, found: usize, expected: usize, may_be_empty: bool| match found
            == expected
            || may_be_empty && found == 0
        {
            true => Ok(()),
            false => Err(SplatError::Size {
                what,
                found,
                expected,
            }),
        };
        check("image", self.rgb.len(), 3 * pixels, false)?;
        check("mask", self.mask.len(), pixels, true)?;
        check("depth", self.depth_m.len(), pixels, true)?;
        let depths = self.depth_m.len();
        check(
            "standard deviations of depth",
            self.depth_sigma_m.len(),
            depths,
            false,
        )
    }

    /// Number of pixels that may be used.
    pub fn valid_pixels(&self) -> usize {
        match self.mask.is_empty() {
            true => self.camera.pixels(),
            false => self.mask.iter().filter(|valid| **valid).count(),
        }
    }

    /// The image at a fraction of its size: colors are averages over blocks of `factor` x `factor`
    /// pixels, all of which must be usable; depths are those of the block's middle. Rows and
    /// columns that fill no block are cut.
    ///
    /// # Errors
    /// [`SplatError::Camera`] if the camera is invalid.
    ///
    /// # Panics
    /// If a buffer does not fit the image.
    pub fn reduced(&self, factor: u32) -> Result<Self, SplatError> {
        let model = self.camera.model();
        let (width, height) = (model.width / factor, model.height / factor);
        if factor == 1 || width == 0 || height == 0 {
            return Ok(self.clone());
        }
        let f = f64::from(factor);
        let center = |c: f64| (c + 0.5) / f - 0.5;
        let small = CameraModel {
            width,
            height,
            fx: model.fx / f,
            fy: model.fy / f,
            cx: center(model.cx),
            cy: center(model.cy),
            distortion: model.distortion,
        };
        let mut camera = Camera::new(small, *self.camera.camera_from_world())?;
        if let Some(shutter) = self.camera.shutter() {
            let mut shutter = *shutter;
            shutter.time_gradient_s_per_px = shutter.time_gradient_s_per_px.map(|g| g * f);
            shutter.reference_px = shutter.reference_px.map(center);
            camera = camera.with_shutter(shutter)?;
        }
        let mut out = Self {
            camera,
            rgb: Vec::with_capacity((width * height * 3) as usize),
            mask: Vec::new(),
            depth_m: Vec::new(),
            depth_sigma_m: Vec::new(),
            ..*self
        };
        let stride = model.width as usize;
        let n = factor as usize;
        let area = (n * n) as u32;
        for row in 0..height as usize {
            for column in 0..width as usize {
                let first = row * n * stride + column * n;
                let mut sums = [area / 2; 3];
                let mut valid = true;
                for y in 0..n {
                    for pixel in first + y * stride..first + y * stride + n {
                        valid &= self.mask.get(pixel).copied().unwrap_or(true);
                        for (sum, value) in sums.iter_mut().zip(&self.rgb[3 * pixel..]) {
                            *sum += u32::from(*value);
                        }
                    }
                }
                out.rgb.extend(sums.map(|sum| (sum / area) as u8));
                if !self.mask.is_empty() {
                    out.mask.push(valid);
                }
                if !self.depth_m.is_empty() {
                    let middle = first + n / 2 * stride + n / 2;
                    out.depth_m.push(self.depth_m[middle]);
                    out.depth_sigma_m.push(self.depth_sigma_m[middle]);
                }
            }
        }
        Ok(out)
    }
}
