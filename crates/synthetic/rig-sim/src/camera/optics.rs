//! Lens effects other than distortion: flare, dirt, defocus, covers.
//!
//! Contract: an inactive effect changes no bit. Flare is caused by the sun alone: veiling glare
//! that falls with the square of the angle from it, and ghosts on the line through sun and image
//! center. The other effects follow from [`Conditions`].

use nalgebra::{UnitQuaternion, Vector3};

use super::shade::Radiance;
use crate::faults::{CameraFaults, Kind};
use crate::lens::Lens;
use crate::random;
use crate::scene::Scene;
use cad_transforms::so3;

/// Light that a clean lens scatters from a source of irradiance 1 to an angle of 1 rad, relative to
/// a white surface; over all angles about 2 percent of the light.
const SCATTER: f32 = 0.003;
/// Fraction of a pixel's light that each of its four neighbors receives: a point spread of half a
/// pixel.
const NEIGHBOR_WEIGHT: f32 = 0.12;
/// The same, at most, of one pass of an additional blur.
const MAX_NEIGHBOR_WEIGHT: f32 = 0.25;
/// Within this angle the image of the sun is brighter than its veiling glare, rad.
const SUN_ANGLE: f32 = 0.01;
/// Minimum cosine of the angle to the optical axis at which the sun reaches the glass.
const MIN_SUN_COSINE: f64 = 0.2;
/// Ghosts: position on the line from the image center to the sun (1 is the sun), radius as a
/// fraction of the width, brightness under a sun of irradiance 1.
const GHOSTS: [(f32, f32, f32); 4] = [
    (-0.45, 0.03, 0.10),
    (-0.9, 0.07, 0.05),
    (0.4, 0.02, 0.12),
    (-0.2, 0.012, 0.2),
];
/// Width of the soft edge of a cover on the lens, as a fraction of the image width.
const COVER_EDGE: f32 = 0.25;
/// Number of smears on a lens of maximum dirt.
const SMEARS: u64 = 80;

/// Imaging conditions of a camera in one frame, besides the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Conditions {
    /// Factor on the light; 1 is nominal.
    pub light: f32,
    /// Fraction of the image that is covered.
    pub covered: f32,
    /// Fraction of the lens that is dirty.
    pub dirty: f32,
    /// Blur radius as a fraction of the image width.
    pub blur: f32,
    /// Rotation of the camera on the rig: maps its true frame to its nominal frame.
    pub rotation: UnitQuaternion<f64>,
    /// Seed of the direction of the cover and the positions of dirt.
    pub seed: u64,
}

impl Conditions {
    /// No faults.
    pub const NOMINAL: Self = Self {
        light: 1.0,
        covered: 0.0,
        dirty: 0.0,
        blur: 0.0,
        rotation: UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(1.0, 0.0, 0.0, 0.0)),
        seed: 0,
    };

    /// Conditions under faults at a time, s.
    pub fn of(faults: &CameraFaults, time_s: f64) -> Self {
        let strength = |kind| faults.strength(kind, time_s);
        let seed = faults.seed();
        let axis = Vector3::new(
            random::bell(seed, random::FAULT, 1),
            random::bell(seed, random::FAULT, 2),
            random::bell(seed, random::FAULT, 3),
        );
        let angle = strength(Kind::ShiftedCamera) * std::f64::consts::PI / 180.0;
        let dark = libm::exp2(-strength(Kind::Darkness));
        Self {
            light: (dark * (1.0 + strength(Kind::Flash))) as f32,
            covered: strength(Kind::CoveredLens) as f32,
            dirty: strength(Kind::DirtyLens) as f32,
            blur: strength(Kind::Blur) as f32,
            rotation: match angle == 0.0 {
                true => UnitQuaternion::identity(),
                false => so3::exp(axis.normalize() * angle),
            },
            seed,
        }
    }
}

/// The sun in the frame of a lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sun {
    /// Unit direction in the optical frame.
    direction: [f32; 3],
    /// Irradiance on the lens, relative to daylight; reduced if the sun is partly occluded.
    irradiance: f32,
}

/// The sun as seen by a camera, if any of it reaches the lens.
pub(super) fn sun(scene: &Scene, eye: &(Vector3<f64>, UnitQuaternion<f64>)) -> Option<Sun> {
    let (direction, strength) = scene.light.sun?;
    let seen = eye.1.inverse() * direction;
    if seen.z < MIN_SUN_COSINE {
        return None;
    }
    // A few rays within the disc and around it, so that it is occluded gradually.
    let (side, up) = (
        eye.1 * Vector3::x() * 0.006,
        direction.cross(&(eye.1 * Vector3::x())) * 0.006,
    );
    let free = [(0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]
        .into_iter()
        .filter(|(x, y)| {
            let towards = direction + side * *x + up * *y;
            scene.first_hit(&eye.0, &towards).is_none()
        })
        .count();
    // Less light enters from the side.
    let irradiance = strength * free as f64 / 5.0 * seen.z;
    (free > 0).then_some(Sun {
        direction: [seen.x as f32, seen.y as f32, seen.z as f32],
        irradiance: irradiance as f32,
    })
}

impl Sun {
    /// Position in the image, px from the image center; far outside if it is not visible.
    pub(super) fn position(&self, lens: &Lens) -> (f32, f32) {
        let model = lens.model();
        let [x, y, z] = self.direction.map(f64::from);
        let (u, v) = lens.project(x / z, y / z);
        let middle = |size: u32| 0.5 * f64::from(size - 1);
        let limit = |off: f64| (off as f32).clamp(-1e4, 1e4);
        (
            limit(u - middle(model.width)),
            limit(v - middle(model.height)),
        )
    }
}

impl Radiance {
    /// Slightly blurs the light over neighboring pixels, as lenses and demosaicing do.
    pub(super) fn soften(&mut self) {
        self.spread(NEIGHBOR_WEIGHT);
    }

    /// Blurs the luminance by about a Gaussian of this standard deviation, px; 0 changes no bit.
    pub(super) fn blur(&mut self, sigma_px: f32) {
        // A pass has the variance of two neighbors of that weight. Above a quarter, the pixel
        // itself would have less weight than they.
        let variance = sigma_px * sigma_px;
        let passes = (variance / (2.0 * MAX_NEIGHBOR_WEIGHT)).ceil();
        for _ in 0..passes as usize {
            self.spread(0.5 * variance / passes);
        }
    }

    /// Moves a part of the light of each pixel to each neighbor, along rows and along columns.
    /// Pixels at the edge are replicated outwards.
    fn spread(&mut self, weight: f32) {
        let width = self.width;
        let mut before = vec![0.0; width];
        let mut row = vec![0.0; width + 2];
        for pixels in self.luminance.chunks_exact_mut(width) {
            row[1..=width].copy_from_slice(pixels);
            row[0] = pixels[0];
            row[width + 1] = pixels[width - 1];
            for (to, near) in pixels.iter_mut().zip(row.windows(3)) {
                *to = near[1] + weight * (near[0] - 2.0 * near[1] + near[2]);
            }
        }
        before.copy_from_slice(&self.luminance[..width]);
        for y in 0..self.height {
            let (upper, lower) = self.luminance.split_at_mut((y + 1) * width);
            let pixels = &mut upper[y * width..];
            row[..width].copy_from_slice(pixels);
            let below = if lower.is_empty() {
                &row[..width]
            } else {
                &lower[..width]
            };
            for (((to, now), above), below) in pixels.iter_mut().zip(&row).zip(&before).zip(below) {
                *to = now + weight * (above - 2.0 * now + below);
            }
            before.copy_from_slice(&row[..width]);
        }
    }

    /// Adds flare of the sun. `rays` are those of the pixels, `at` is the position of the sun, px
    /// from the image center.
    pub(super) fn flare(&mut self, sun: &Sun, rays: &[[f32; 2]], at: (f32, f32)) {
        let (width, height) = (self.width, self.height);
        let veil = |ray: [f32; 2]| {
            let length2 = ray[0] * ray[0] + ray[1] * ray[1] + 1.0;
            let dot = ray[0] * sun.direction[0] + ray[1] * sun.direction[1] + sun.direction[2];
            // 2 (1 - cos) approximates the squared angle for small angles, and is less for large
            // ones.
            let cosine = dot / length2.sqrt();
            let angle2 = (2.0 - 2.0 * cosine).max(0.0);
            SCATTER * sun.irradiance / (angle2 + SUN_ANGLE * SUN_ANGLE)
        };
        for (to, ray) in self.luminance.iter_mut().zip(rays) {
            *to += veil(*ray);
        }
        for y in 0..height / 2 {
            for x in 0..width / 2 {
                let added = veil(rays[2 * y * width + 2 * x]);
                let to = &mut self.color[y * (width / 2) + x];
                *to = to.map(|v| v + added);
            }
        }
        let middle = (0.5 * (width - 1) as f32, 0.5 * (height - 1) as f32);
        for (place, radius, bright) in GHOSTS {
            let center = (middle.0 + place * at.0, middle.1 + place * at.1);
            self.disc(center, radius * width as f32, bright * sun.irradiance);
        }
    }

    /// Adds a uniform disc with an edge of a few pixels.
    fn disc(&mut self, center: (f32, f32), radius: f32, bright: f32) {
        let (width, height) = (self.width, self.height);
        let share = |x: usize, y: usize| {
            let (dx, dy) = (x as f32 - center.0, y as f32 - center.1);
            let inside = (radius - (dx * dx + dy * dy).sqrt()) / (0.15 * radius);
            bright * inside.clamp(0.0, 1.0)
        };
        let range = |c: f32, limit: usize| {
            let end = ((c + radius).ceil().max(0.0) as usize + 1).min(limit);
            ((c - radius).floor().max(0.0) as usize).min(end)..end
        };
        for y in range(center.1, height) {
            for x in range(center.0, width) {
                let added = share(x, y);
                self.luminance[y * width + x] += added;
                if y % 2 == 0 && x % 2 == 0 && y / 2 < height / 2 && x / 2 < width / 2 {
                    let to = &mut self.color[y / 2 * (width / 2) + x / 2];
                    *to = to.map(|v| v + added);
                }
            }
        }
    }

    /// Applies all conditions except the rotation. `eye` is 0 or 1: their lenses have different
    /// dirt.
    pub(super) fn degrade(&mut self, conditions: &Conditions, eye: u64) {
        if conditions.light != 1.0 {
            self.scale(|_, _| conditions.light);
        }
        if conditions.dirty > 0.0 {
            self.smear(conditions.dirty, random::bits(conditions.seed, 0, eye));
        }
        let radius = conditions.blur * self.width as f32;
        if radius > 0.0 {
            let (width, height) = (self.width, self.height);
            self.luminance = blurred(&self.luminance, width, height, radius);
            for k in 0..3 {
                let plane: Vec<f32> = self.color.iter().map(|c| c[k]).collect();
                let plane = blurred(&plane, width / 2, height / 2, 0.5 * radius);
                for (to, from) in self.color.iter_mut().zip(plane) {
                    to[k] = from;
                }
            }
        }
        if conditions.covered > 0.0 {
            self.cover(conditions.covered, conditions.seed);
        }
    }

    /// Multiplies every pixel by a factor that depends on its position.
    fn scale(&mut self, factor: impl Fn(f32, f32) -> f32) {
        let (width, half) = (self.width, self.width / 2);
        for (i, v) in self.luminance.iter_mut().enumerate() {
            *v *= factor((i % width) as f32, (i / width) as f32);
        }
        for (i, c) in self.color.iter_mut().enumerate() {
            let f = factor((2 * (i % half)) as f32 + 0.5, (2 * (i / half)) as f32 + 0.5);
            *c = c.map(|v| v * f);
        }
    }

    /// Dark, strongly defocused cover of the lens up to a line across the image.
    fn cover(&mut self, share: f32, seed: u64) {
        let turn = std::f64::consts::TAU * random::uniform(seed, random::FAULT, 4);
        let (dx, dy) = (libm::cos(turn) as f32, libm::sin(turn) as f32);
        let (half_w, half_h) = (0.5 * self.width as f32, 0.5 * self.height as f32);
        let edge = COVER_EDGE * self.width as f32;
        let kept = |x: f32, y: f32, line: f32| {
            let along = (x - half_w) * dx + (y - half_h) * dy;
            let v = ((along - line) / edge + 0.5).clamp(0.0, 1.0);
            v * v * (3.0 - 2.0 * v)
        };
        // The line that leaves the required fraction of light, by bisection.
        let reach = dx.abs() * half_w + dy.abs() * half_h + 0.5 * edge;
        let (mut from, mut to) = (-reach, reach);
        for _ in 0..20 {
            let line = 0.5 * (from + to);
            let mut sum = 0.0;
            for i in 0..32 * 32 {
                let part = |k: i32| (k as f32 + 0.5) / 32.0;
                sum += kept(
                    part(i % 32) * 2.0 * half_w,
                    part(i / 32) * 2.0 * half_h,
                    line,
                );
            }
            match sum / 1024.0 > 1.0 - share {
                true => from = line,
                false => to = line,
            }
        }
        let line = if share >= 1.0 { reach } else { to };
        self.scale(|x, y| kept(x, y, line));
    }

    /// Smears: each removes light locally and spreads it over the whole image.
    fn smear(&mut self, share: f32, seed: u64) {
        let (width, height) = (self.width as f32, self.height as f32);
        let count = self.luminance.len() as f32;
        let mean = self.luminance.iter().sum::<f32>() / count;
        let whole = share * SMEARS as f32;
        let mut kept = vec![1.0_f32; self.luminance.len()];
        for i in 0..whole.ceil() as u64 {
            let draw = |k| random::uniform(seed, random::FAULT + 8 + k, i) as f32;
            let (cx, cy) = (draw(0) * width, draw(1) * height);
            let radius = width * (0.02 + 0.12 * draw(2) * draw(2));
            let takes = (whole - i as f32).min(1.0) * (0.3 + 0.6 * draw(3));
            let rows = (cy - radius).max(0.0) as usize..((cy + radius).max(0.0) as usize + 1);
            for y in rows.start..rows.end.min(self.height) {
                let dy = y as f32 - cy;
                let from = (cx - radius).max(0.0) as usize;
                let to = ((cx + radius).max(0.0) as usize + 1).min(self.width);
                for (x, kept) in (from..to).zip(&mut kept[y * self.width + from..]) {
                    let dx = x as f32 - cx;
                    let v = (1.0 - (dx * dx + dy * dy) / (radius * radius)).max(0.0);
                    *kept *= 1.0 - takes * v;
                }
            }
        }
        let half = self.width / 2;
        for (i, c) in self.color.iter_mut().enumerate() {
            let k = kept[2 * (i / half) * self.width + 2 * (i % half)];
            *c = c.map(|v| v * k + mean * (1.0 - k));
        }
        for (v, k) in self.luminance.iter_mut().zip(&kept) {
            *v = *v * k + mean * (1.0 - k);
        }
    }
}

/// Convolution with a disc, by cumulative sums along rows.
fn blurred(plane: &[f32], width: usize, height: usize, radius: f32) -> Vec<f32> {
    // Half-widths of the disc's rows, from its upper edge to its lower.
    let reach = radius.ceil() as i64;
    let widths: Vec<(i64, f32)> = (-reach..=reach)
        .filter_map(|dy| {
            let square = radius * radius - (dy * dy) as f32;
            (square >= 0.0).then(|| (dy, square.sqrt()))
        })
        .collect();
    let mut sums = vec![0.0_f64; (width + 1) * height];
    for y in 0..height {
        for x in 0..width {
            let at = y * (width + 1) + x;
            sums[at + 1] = sums[at] + f64::from(plane[y * width + x]);
        }
    }
    // Sum of a row from the left edge to a subpixel position; edge pixels are replicated.
    let until = |y: usize, x: f32| -> f64 {
        let row = &sums[y * (width + 1)..(y + 1) * (width + 1)];
        let first = f64::from(plane[y * width]);
        let last = f64::from(plane[y * width + width - 1]);
        if x <= 0.0 {
            return first * f64::from(x);
        }
        if x >= width as f32 {
            return row[width] + last * f64::from(x - width as f32);
        }
        let whole = x as usize;
        row[whole] + (row[whole + 1] - row[whole]) * f64::from(x - whole as f32)
    };
    // Half a pixel more on each side: a disc of radius 0 is the pixel itself.
    let area: f64 = widths.iter().map(|(_, w)| f64::from(2.0 * w + 1.0)).sum();
    let mut out = Vec::with_capacity(plane.len());
    for y in 0..height as i64 {
        for x in 0..width {
            let mut sum = 0.0;
            for &(dy, w) in &widths {
                let row = (y + dy).clamp(0, height as i64 - 1) as usize;
                let x = x as f32;
                sum += until(row, x + 1.0 + w) - until(row, x - w);
            }
            out.push((sum / area) as f32);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::{Fault, Faults};

    fn image() -> Radiance {
        let mut light = Radiance::new(64, 32);
        for (i, v) in light.luminance.iter_mut().enumerate() {
            *v = random::uniform(1, 2, i as u64) as f32;
        }
        for (i, c) in light.color.iter_mut().enumerate() {
            *c = [random::uniform(1, 3, i as u64) as f32; 3];
        }
        light
    }

    fn spoilt(change: impl Fn(&mut Conditions)) -> Radiance {
        let mut conditions = Conditions {
            seed: 5,
            ..Conditions::NOMINAL
        };
        change(&mut conditions);
        let mut light = image();
        light.degrade(&conditions, 0);
        light
    }

    fn mean(plane: &[f32]) -> f32 {
        plane.iter().sum::<f32>() / plane.len() as f32
    }

    #[test]
    fn point_spread_conserves_light() {
        let mut light = Radiance::new(8, 6);
        light.luminance[2 * 8 + 3] = 1.0;
        light.soften();
        let at = |x: usize, y: usize| light.luminance[y * 8 + x];
        assert!((light.luminance.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        assert_eq!(
            at(3, 2),
            (1.0 - 2.0 * NEIGHBOR_WEIGHT) * (1.0 - 2.0 * NEIGHBOR_WEIGHT)
        );
        for (x, y) in [(2, 2), (4, 2), (3, 1), (3, 3)] {
            assert!((at(x, y) - NEIGHBOR_WEIGHT * (1.0 - 2.0 * NEIGHBOR_WEIGHT)).abs() < 1e-7);
        }
        let mut even = Radiance::new(8, 6);
        even.luminance.fill(0.7);
        even.soften();
        assert!(even.luminance.iter().all(|v| (v - 0.7).abs() < 1e-6));
    }

    #[test]
    fn blur_has_its_standard_deviation() {
        for sigma_px in [0.0, 0.4, 1.5_f32] {
            let mut light = Radiance::new(32, 32);
            light.luminance[16 * 32 + 16] = 1.0;
            light.blur(sigma_px);
            let moment = |power: i32| -> f32 {
                let pixels = light.luminance.iter().enumerate();
                let of = |(i, v): (usize, &f32)| v * ((i % 32) as f32 - 16.0).powi(power);
                pixels.map(of).sum()
            };
            assert!((moment(0) - 1.0).abs() < 1e-5 && moment(1).abs() < 1e-5);
            let found = moment(2).sqrt();
            assert!((found - sigma_px).abs() < 1e-3, "{found}, {sigma_px}");
        }
    }

    #[test]
    fn images_are_unchanged_without_faults() {
        let light = spoilt(|_| {});
        assert_eq!(light.luminance, image().luminance);
        assert_eq!(light.color, image().color);
        assert_eq!(
            Conditions::of(&CameraFaults::default(), 1.0),
            Conditions {
                seed: 0,
                ..Conditions::NOMINAL
            }
        );
        let none = |kind| Fault {
            kind,
            strength: 0.0,
            from_s: 0.0,
            to_s: 9.0,
            camera: None,
            foot: None,
        };
        let faults = Faults {
            list: Kind::ALL.map(none).to_vec(),
            seed: 0,
        };
        let mut conditions = Conditions::of(&faults.of("feet"), 1.0);
        conditions.seed = 0;
        assert_eq!(conditions, Conditions::NOMINAL);
    }

    #[test]
    fn cover_removes_its_fraction_of_light() {
        let whole = mean(&image().luminance);
        let mut before = whole;
        for share in [0.25, 0.5, 0.75, 1.0] {
            let light = spoilt(|c| c.covered = share);
            let left = mean(&light.luminance);
            assert!(
                (left / whole - (1.0 - share)).abs() < 0.05,
                "{share}: {left}"
            );
            assert!(left < before);
            before = left;
        }
        assert_eq!(before, 0.0);
    }

    #[test]
    fn blur_conserves_light_and_reduces_detail() {
        let detail = |plane: &[f32]| -> f32 { plane.windows(2).map(|w| (w[1] - w[0]).abs()).sum() };
        let sharp = image();
        let soft = spoilt(|c| c.blur = 0.05);
        assert!((mean(&soft.luminance) / mean(&sharp.luminance) - 1.0).abs() < 0.03);
        assert!(detail(&soft.luminance) < 0.3 * detail(&sharp.luminance));
        let same = blurred(&sharp.luminance, 64, 32, 1e-6);
        for (a, b) in same.iter().zip(&sharp.luminance) {
            assert!((a - b).abs() < 1e-5);
        }
    }

    #[test]
    fn dirt_reduces_contrast_but_hardly_light() {
        let spread = |plane: &[f32]| {
            let m = mean(plane);
            mean(&plane.iter().map(|v| (v - m) * (v - m)).collect::<Vec<_>>())
        };
        let clean = image();
        let little = spoilt(|c| c.dirty = 0.2);
        let much = spoilt(|c| c.dirty = 1.0);
        assert!(spread(&little.luminance) < spread(&clean.luminance));
        assert!(spread(&much.luminance) < 0.7 * spread(&little.luminance));
        assert!((mean(&much.luminance) / mean(&clean.luminance) - 1.0).abs() < 0.05);
    }

    #[test]
    fn darkness_and_flash_scale_the_light() {
        let bright = spoilt(|c| c.light = 4.0);
        for (a, b) in bright.luminance.iter().zip(&image().luminance) {
            assert_eq!(*a, 4.0 * b);
        }
    }
}
