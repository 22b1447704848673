//! Synthetic scenes with exact truth, for tests of simulators and tasks.
//!
//! Every scene consists of parallelograms: heights, normals and depths of rays are closed formulas.
//! From them come the walkable levels, a recorded walk and Gaussians that cover all surfaces. A
//! scene is made in memory, in a second at most.

pub mod beogym;
pub(crate) mod bundle;
mod depth;
pub(crate) mod levels;
mod surfaces;
mod walk;

use std::sync::Arc;

use cad_transforms::RigidTransform;
use nalgebra::{UnitQuaternion, Vector3};
use splats::{Background, Scene};

pub use depth::DepthErrors;
pub use surfaces::{Patch, Surfaces};
pub use walk::offset_pose;

use crate::error::SimulationError;
use crate::scene::{Area, GaussianSource, SceneData, Sector, SectorEdge, Similarity};

/// Edge of a cell of the maps, m.
pub const CELL_M: f64 = 0.04;
/// Distance of the Gaussians on surfaces, m.
const SPACING_M: f64 = 0.06;
/// How far maps of the corridor reach beyond the area of their sector, m: 25 cells.
const MAP_MARGIN_M: f64 = 1.0;
/// Color behind everything.
const SKY: [f32; 3] = [0.55, 0.7, 0.9];
/// Height of walls, m.
const WALL_M: f64 = 2.4;

const CONCRETE: [f32; 3] = [0.55, 0.53, 0.5];
const GRASS: [f32; 3] = [0.35, 0.5, 0.25];
const BRICK: [f32; 3] = [0.6, 0.32, 0.22];
const PLASTER: [f32; 3] = [0.75, 0.72, 0.6];

/// A scene with its truth.
///
/// ```
/// use simulation::testing::SyntheticScene;
///
/// let stairs = SyntheticScene::stairs()?;
/// let truth = &stairs.surfaces[0];
/// // The third step of 15 cm begins at 2.6 m.
/// let (height, normal) = truth.ground([2.75, 1.0], 0.0).unwrap();
/// assert!((height - 0.45).abs() < 1e-12 && normal == [0.0, 0.0, 1.0]);
/// // Its riser is 0.5 m in front of a point on the step below.
/// let ray = truth.ray_m([2.1, 1.0, 0.37], [1.0, 0.0, 0.0]).unwrap();
/// assert!((ray - 0.5).abs() < 1e-12);
/// assert!(stairs.scene.sectors[0].gaussians.as_ref().unwrap().count() > 1000);
/// # Ok::<(), simulation::SimulationError>(())
/// ```
#[derive(Clone, Debug)]
pub struct SyntheticScene {
    /// The scene as simulators use it.
    pub scene: Arc<SceneData>,
    /// Exact surfaces of each sector, in its frame.
    pub surfaces: Vec<Surfaces>,
}

impl SyntheticScene {
    /// A plane of 6 x 6 m that rises by `slopes` along x and y, 0.1 is 10 cm per metre.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] for slopes that are not finite.
    pub fn tilted_plane(slopes: [f64; 2]) -> Result<Self, SimulationError> {
        let mut all = Surfaces::default();
        let heights = [0.0, 6.0 * slopes[0], 6.0 * slopes[1]];
        all.add_ground([0.0; 2], [6.0; 2], heights, CONCRETE, Some(0));
        let middle = 3.0 * slopes[1];
        let walk = [[1.0, 3.0, middle], [5.0, 3.0, middle + 5.0 * slopes[0]]];
        Self::of("tilted plane", all, [6.0; 2], &walk)
    }

    /// Eight steps of 15 cm height and 30 cm depth along x from 2 m on, 3 m wide, between level
    /// ground of 2 m.
    ///
    /// # Errors
    /// None for this scene; the type is that of the others.
    pub fn stairs() -> Result<Self, SimulationError> {
        let (steps, rise, tread, width) = (8, 0.15, 0.3, 3.0);
        let mut all = Surfaces::default();
        all.add_ground([0.0; 2], [2.0, width], [0.0; 3], CONCRETE, Some(0));
        for step in 1..=steps {
            let x = 2.0 + tread * f64::from(step - 1);
            let z = rise * f64::from(step);
            let end = if step == steps { x + 2.0 } else { x + tread };
            all.add_ground([x, 0.0], [end, width], [z; 3], CONCRETE, Some(0));
            all.patches.push(riser([x, 0.0, z - rise], width, rise));
        }
        let end = 2.0 + tread * f64::from(steps - 1) + 2.0;
        let walk = [[0.5, 1.5, 0.0], [end - 0.5, 1.5, rise * f64::from(steps)]];
        Self::of("stairs", all, [end, width], &walk)
    }

    /// A step of a height along x at 3 m, between two halves of level ground of 6 x 4 m.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] for a height that is not finite.
    pub fn kerb(height_m: f64) -> Result<Self, SimulationError> {
        let mut all = Surfaces::default();
        all.add_ground([0.0; 2], [3.0, 4.0], [0.0; 3], CONCRETE, Some(0));
        all.add_ground([3.0, 0.0], [6.0, 4.0], [height_m; 3], GRASS, Some(0));
        if height_m != 0.0 {
            all.patches.push(riser([3.0, 0.0, 0.0], 4.0, height_m));
        }
        let walk = [[0.5, 2.0, 0.0], [5.5, 2.0, height_m]];
        Self::of("kerb", all, [6.0, 4.0], &walk)
    }

    /// Level ground of 6 x 6 m with a wall across, one cell thick, from y = 0 to 4.48 m at x = 3 m:
    /// a detour leads around its end.
    ///
    /// # Errors
    /// None for this scene; the type is that of the others.
    pub fn wall() -> Result<Self, SimulationError> {
        let mut all = Surfaces::default();
        all.add_ground([0.0; 2], [6.0; 2], [0.0; 3], CONCRETE, Some(0));
        all.add_obstacle([3.0, 0.0, 0.0], [3.0 + CELL_M, 4.48, WALL_M], BRICK);
        let walk = [
            [1.0, 1.0, 0.0],
            [1.0, 5.2, 0.0],
            [5.0, 5.2, 0.0],
            [5.0, 1.0, 0.0],
        ];
        Self::of("wall", all, [6.0; 2], &walk)
    }

    /// A room of 8 x 6 m with walls, a ceiling and a box of 1 m in it.
    ///
    /// # Errors
    /// None for this scene; the type is that of the others.
    pub fn room() -> Result<Self, SimulationError> {
        let mut all = Surfaces::default();
        all.add_ground([0.0; 2], [8.0, 6.0], [0.0; 3], CONCRETE, Some(0));
        let t = 4.0 * CELL_M;
        for (min, max) in [
            ([0.0, 0.0], [8.0, t]),
            ([0.0, 6.0 - t], [8.0, 6.0]),
            ([0.0, t], [t, 6.0 - t]),
            ([8.0 - t, t], [8.0, 6.0 - t]),
        ] {
            all.add_obstacle([min[0], min[1], 0.0], [max[0], max[1], WALL_M], PLASTER);
        }
        all.add_obstacle([3.52, 2.52, 0.0], [4.52, 3.52, 1.0], BRICK);
        all.patches.push(Patch {
            corner_m: [0.0, 0.0, WALL_M],
            edges_m: [[0.0, 6.0, 0.0], [8.0, 0.0, 0.0]],
            color: PLASTER,
            level: None,
        });
        let walk = [
            [1.5, 1.5, 0.0],
            [6.5, 1.5, 0.0],
            [6.5, 4.5, 0.0],
            [1.5, 4.5, 0.0],
            [1.5, 1.5, 0.0],
        ];
        Self::of("room", all, [8.0, 6.0], &walk)
    }

    /// Level ground of 24 x 8 m, level 0, and a bridge along x over it, level 1: 2 m wide, ramps of
    /// 8 m up from x = 2 m and down to 22 m, 2.4 m high from 10 to 14 m.
    ///
    /// # Errors
    /// None for this scene; the type is that of the others.
    pub fn bridge() -> Result<Self, SimulationError> {
        let mut all = Surfaces::default();
        let high = 2.4;
        all.add_ground([0.0; 2], [24.0, 8.0], [0.0; 3], GRASS, Some(0));
        for (from, to, [z0, z1]) in [
            (2.0, 10.0, [0.0, high]),
            (10.0, 14.0, [high, high]),
            (14.0, 22.0, [high, 0.0]),
        ] {
            all.add_ground([from, 3.0], [to, 5.0], [z0, z1, z0], CONCRETE, Some(1));
        }
        let walk = [
            [0.5, 4.0, 0.0],
            [2.0, 4.0, 0.0],
            [10.0, 4.0, high],
            [14.0, 4.0, high],
            [22.0, 4.0, 0.0],
            [23.0, 4.0, 0.0],
            [23.0, 1.5, 0.0],
            [12.0, 1.5, 0.0],
            [12.0, 7.0, 0.0],
        ];
        Self::of("bridge", all, [24.0, 8.0], &walk)
    }

    /// A corridor around a square of 12 m, 2 m wide, as four sectors that are recordings of their
    /// own: one per side, its frame at the begin of the side with x along it. Neighbors overlap in
    /// the corners, edges lead both ways.
    ///
    /// # Errors
    /// None for this scene; the type is that of the others.
    pub fn corridor_loop() -> Result<Self, SimulationError> {
        Self::corridor_loop_with(SPACING_M)
    }

    /// The same with another distance between Gaussians, m; 7 % more from side to side. Depth
    /// depends on it: surfaces seen at a grazing angle are known to about half of it.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] for a distance that is not above 0.
    pub fn corridor_loop_with(spacing_m: f64) -> Result<Self, SimulationError> {
        Self::corridor_loop_scaled(spacing_m, 1.0)
    }

    /// The same with lengths of the second and fourth side in another unit: `scale` times those of
    /// the others, as an alignment with scale finds them.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] for a distance or scale that is not above 0.
    pub fn corridor_loop_scaled(spacing_m: f64, scale: f64) -> Result<Self, SimulationError> {
        check_spacing(spacing_m)?;
        check_spacing(scale)?;
        let (size, width, t) = (12.0, 2.0, 4.0 * CELL_M);
        let mut world = Surfaces::default();
        let inner = size - width;
        for (min, max) in [
            ([0.0, 0.0], [size, width]),
            ([inner, width], [size, size]),
            ([0.0, inner], [inner, size]),
            ([0.0, width], [width, inner]),
        ] {
            world.add_ground(min, max, [0.0; 3], CONCRETE, Some(0));
        }
        for (min, max, color) in [
            ([-t, -t], [size + t, 0.0], BRICK),
            ([size, 0.0], [size + t, size], PLASTER),
            ([-t, size], [size + t, size + t], GRASS),
            ([-t, 0.0], [0.0, size], BRICK),
            ([width, width], [inner, inner], PLASTER),
        ] {
            world.add_obstacle([min[0], min[1], 0.0], [max[0], max[1], WALL_M], color);
        }
        let corners = [[0.0, 0.0], [size, 0.0], [size, size], [0.0, size]];
        let frames: Vec<Similarity> = (0..4)
            .map(|side| {
                let [x, y] = corners[side];
                // Exact quarter turns; frames differ in height too.
                let [sin, cos] = [[0.0, 1.0], [1.0, 0.0], [0.0, -1.0], [-1.0, 0.0]][side];
                let yaw =
                    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), libm::atan2(sin, cos));
                let origin = Vector3::new(x, y, 0.25 * side as f64);
                let scale = if side % 2 == 1 { scale } else { 1.0 };
                Similarity::from_parts(1.0 / scale, yaw, origin).inverse()
            })
            .collect();
        let (mut sectors, mut surfaces) = (Vec::new(), Vec::new());
        for (side, side_from_world) in frames.iter().enumerate() {
            let here = world.carried(side_from_world);
            let scale = side_from_world.scale();
            let [size, width, inner, wall] = [size, width, inner, WALL_M].map(|v| scale * v);
            // Maps reach beyond the area: agents at the border stand on the ground of one sector.
            let (min, max) = (
                [-MAP_MARGIN_M; 2],
                [size + MAP_MARGIN_M, width + MAP_MARGIN_M],
            );
            let z = side_from_world.translation_m()[2];
            let walk = [[0.5, 0.5 * width, z], [size - 0.5, 0.5 * width, z]];
            // Recordings of their own: no sector has the Gaussians of another one.
            let spacing_m = spacing_m * (1.0 + 0.07 * side as f64);
            let splats = match side_from_world.is_rigid() {
                true => world.gaussians(spacing_m, &side_from_world.rigid())?,
                false => here.gaussians(scale * spacing_m, &RigidTransform::identity())?,
            };
            let mut sector = sector(&format!("side {side}"), &here, [min, max], splats, &walk)?;
            sector.area = Area::new([0.0; 2], [size, width]);
            sector.edges = [(side + 1) % 4, (side + 3) % 4]
                .into_iter()
                .map(|to| {
                    let begin = if to == (side + 1) % 4 { inner } else { 0.0 };
                    SectorEdge {
                        to,
                        to_from_here: frames[to].compose(&side_from_world.inverse()),
                        overlap: Area {
                            height_m: [z, z + wall],
                            ..Area::new([begin, 0.0], [begin + width, width])
                        },
                        residual_m: Some(0.0),
                        is_imported: true,
                    }
                })
                .collect();
            sectors.push(sector);
            surfaces.push(here);
        }
        let scene = Arc::new(SceneData::new("corridor loop", sectors)?);
        Ok(Self { scene, surfaces })
    }

    /// The Gaussians of the first sector again, with another distance between them, m, as a scene
    /// of that sector alone.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] for a distance that is not above 0.
    pub fn with_spacing(&self, spacing_m: f64) -> Result<Arc<SceneData>, SimulationError> {
        check_spacing(spacing_m)?;
        let splats = self.surfaces[0].gaussians(spacing_m, &RigidTransform::identity())?;
        let background = Background::Constant(SKY);
        let first = &self.scene.sectors[0];
        let sector = Sector {
            gaussians: Some(GaussianSource::new(Scene { splats, background }, false)?),
            edges: Vec::new(),
            ..first.clone()
        };
        Ok(Arc::new(SceneData::new(&first.name, vec![sector])?))
    }

    /// A scene of one sector from the origin to a corner.
    fn of(
        name: &str,
        surfaces: Surfaces,
        max_m: [f64; 2],
        walk: &[[f64; 3]],
    ) -> Result<Self, SimulationError> {
        let splats = surfaces.gaussians(SPACING_M, &Similarity::identity().rigid())?;
        let sector = sector(name, &surfaces, [[0.0; 2], max_m], splats, walk)?;
        Ok(Self {
            scene: Arc::new(SceneData::new(name, vec![sector])?),
            surfaces: vec![surfaces],
        })
    }
}

fn check_spacing(spacing_m: f64) -> Result<(), SimulationError> {
    match spacing_m > 0.0 && spacing_m.is_finite() {
        true => Ok(()),
        false => Err(SimulationError::Scene {
            place: "Gaussians of a synthetic scene".to_owned(),
            found: format!("a distance of {spacing_m} m"),
            expected: "a number above 0".to_owned(),
        }),
    }
}

/// The front of a step across y, from a corner at its foot.
fn riser(corner_m: [f64; 3], width_m: f64, rise_m: f64) -> Patch {
    Patch {
        corner_m,
        edges_m: [[0.0, 0.0, rise_m], [0.0, width_m, 0.0]],
        color: CONCRETE.map(|v| 0.8 * v),
        level: None,
    }
}

/// A sector of surfaces in its frame, with maps of a rectangle.
fn sector(
    name: &str,
    surfaces: &Surfaces,
    [min_m, max_m]: [[f64; 2]; 2],
    splats: splats::Splats,
    walk: &[[f64; 3]],
) -> Result<Sector, SimulationError> {
    let recording = walk::record(surfaces, walk);
    let background = Background::Constant(SKY);
    let views = recording.views.iter().map(|view| view.world_from_camera);
    let gaussians = GaussianSource::new(Scene { splats, background }, false)?;
    let gaussians = gaussians.recorded_by(walk::recording_cameras(&recording)?);
    Ok(Sector {
        name: name.to_owned(),
        levels: Some(Arc::new(levels::levels(surfaces, min_m, max_m, CELL_M))),
        area: Area::new(min_m, max_m),
        references: Arc::new(views.collect()),
        gaussians: Some(gaussians),
        recording: Arc::new(recording),
        edges: Vec::new(),
    })
}

/// The corridor loop, made once for all tests.
#[cfg(test)]
pub(crate) fn corridor() -> &'static SyntheticScene {
    static CORRIDOR: std::sync::OnceLock<SyntheticScene> = std::sync::OnceLock::new();
    CORRIDOR.get_or_init(|| SyntheticScene::corridor_loop().expect("a scene of closed formulas"))
}

#[cfg(test)]
mod tests;
