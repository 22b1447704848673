//! What is seen where nothing is in the way.

use crate::camera::raster::View;
use crate::scene::Scene;

/// A sky: brighter and paler towards the horizon, with clouds, or a ceiling's black for rooms.
#[derive(Clone, Copy, Debug)]
pub struct Sky {
    /// Linear red, green, blue overhead, relative to white in daylight.
    pub zenith: [f32; 3],
    /// How much brighter the horizon is.
    pub horizon: f32,
    /// How strongly clouds show.
    pub clouds: f32,
    /// The texture of the clouds.
    pub texture: u16,
}

impl Sky {
    /// Brightness relative to the zenith and the zenith's colour, in the direction of a ray.
    #[inline]
    pub(crate) fn seen(&self, view: &View, [x, y]: [f32; 2], scene: &Scene) -> (f32, [f32; 3]) {
        // The transpose takes optical directions back to the world.
        let r = &view.rotation;
        let direction = [0, 1, 2].map(|k| r[0][k] * x + r[1][k] * y + r[2][k]);
        let length = (direction[0] * direction[0]
            + direction[1] * direction[1]
            + direction[2] * direction[2])
            .sqrt();
        let up = (direction[2] / length).max(0.0);
        let pale = (1.0 - up) * (1.0 - up);
        // A layer of clouds far above, so that it recedes towards the horizon.
        let scale = 300.0 / (up + 0.12);
        let (cu, cv) = (direction[0] / length * scale, direction[1] / length * scale);
        let (cloud, _) = scene.textures[self.texture as usize].sample(cu, cv, 2);
        let light = 1.0 + pale * self.horizon + self.clouds * (cloud - 1.0);
        (light.max(0.05), self.zenith)
    }
}
