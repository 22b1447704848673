//! Scenes to walk through, generated from a seed.
//!
//! Contract: metric, z up, the same for the same `(kind, lighting, seed)` on every machine; nothing
//! is loaded from outside. Every triangle has a class ([`surface::Class`]) and states whether
//! people walk on it. Static light is computed once, at the corners of triangles ([`light`]).

use std::panic::resume_unwind;
use std::thread;

use nalgebra::Vector3;

pub mod body;
pub mod build;
pub mod bvh;
pub mod light;
pub mod mesh;
pub mod people;
pub mod route;
pub mod sky;
pub mod surface;
pub mod tag;
pub mod terrain;
pub mod texture;
pub mod wearer;

mod corridor;
mod fence;
mod front;
mod interior;
mod palette;
mod pavement;
mod plants;
mod plaza;
mod room;
mod shadow;
mod stairs;
mod street;
mod sweep;
mod targets;
mod trail;

use self::body::Body;
use self::build::{Builder, SceneParts};
use self::bvh::Bvh;
use self::light::Light;
use self::mesh::{Mesh, Stuff};
use self::people::Moving;
use self::route::Route;
use self::sky::Sky;
use self::surface::{Class, Material};
use self::texture::Texture;
use self::wearer::{ShoeTag, Wearer};
use crate::faults::WearerFaults;
use crate::targets::board::Board;
use crate::walker::GaitProfile;

/// Instance of the fence; others are numbered from 1.
const FENCE_INSTANCE: u16 = u16::MAX;

/// Kind of scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A pavement with a kerb, a crosswalk and a road.
    Pavement,
    /// A staircase up and down with a landing.
    Stairs,
    /// A long corridor with blank walls.
    Corridor,
    /// A furnished room with glass and thin rails.
    Room,
    /// A trail through a forest, with roots and stones.
    Trail,
    /// A square with people who walk about.
    Plaza,
    /// A room with calibration boards: not for a walk, but for [`crate::targets`].
    Targets,
}

impl Kind {
    /// All scenes to walk through.
    pub const ALL: [Self; 6] = [
        Self::Pavement,
        Self::Stairs,
        Self::Trail,
        Self::Corridor,
        Self::Plaza,
        Self::Room,
    ];

    /// Builds the scene.
    fn build(self, builder: &mut Builder) -> SceneParts {
        match self {
            Self::Pavement => pavement::build(builder),
            Self::Stairs => stairs::build(builder),
            Self::Corridor => corridor::build(builder),
            Self::Room => room::build(builder),
            Self::Trail => trail::build(builder),
            Self::Plaza => plaza::build(builder),
            Self::Targets => targets::build(builder),
        }
    }

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pavement => "pavement",
            Self::Stairs => "stairs",
            Self::Corridor => "corridor",
            Self::Room => "room",
            Self::Trail => "trail",
            Self::Plaza => "plaza",
            Self::Targets => "targets",
        }
    }
}

/// Lighting of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Lighting {
    /// Sun and sky, or all lamps on.
    Day,
    /// A few lamps.
    Night,
    /// Low sun ahead, with flare.
    LowSun,
    /// Lamps on alternating current.
    Flicker,
}

impl Lighting {
    /// All lightings.
    pub const ALL: [Self; 4] = [Self::Day, Self::Night, Self::LowSun, Self::Flicker];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Day => "day",
            Self::Night => "night",
            Self::LowSun => "low-sun",
            Self::Flicker => "flicker",
        }
    }
}

/// A scene with its light.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Kind of scene.
    pub kind: Kind,
    /// Lighting of a scene.
    pub lighting: Lighting,
    /// Materials.
    pub materials: Vec<Material>,
    /// Textures.
    pub textures: Vec<Texture>,
    /// Static geometry.
    pub fixed: Body,
    /// Body parts of the wearer that his cameras see.
    pub wearer: Wearer,
    /// Panes. Light passes them without attenuation.
    pub glass: Body,
    /// A fence along the route; see [`Scenery::fence_spacing_m`].
    pub(crate) fence: Body,
    /// Gloss of the ground; see [`Scenery::gloss`].
    pub(crate) gloss: f32,
    /// Moving bodies.
    pub moving: Vec<Moving>,
    /// Light sources.
    pub light: Light,
    /// Background.
    pub sky: Sky,
    /// Route of the walker.
    pub route: Route,
    /// Ray queries against static geometry, by the numbers of `fixed.triangles`.
    solid: Bvh,
    /// Ray queries against walkable geometry, by index in `walkable_triangles`.
    walkable: Bvh,
    walkable_triangles: Vec<u32>,
}

/// What real scenes have that misleads stereo matching; none by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scenery {
    /// Distance between the bars of a fence on both sides of the route, m: thin structure that
    /// repeats. 0 for no fence.
    pub fence_spacing_m: f64,
    /// Reflectance of the ground relative to glass: highlights of lamps and of the sun, which are
    /// not on the ground's surface. 0 for none.
    pub gloss: f32,
}

/// The ground under a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ground {
    /// Height, m.
    pub height: f64,
    /// Upward unit normal.
    pub normal: Vector3<f64>,
    /// Number of the triangle in [`Scene::fixed`].
    pub triangle: u32,
}

impl Scene {
    /// Builds a scene for a wearer without tags on his shoes.
    pub fn new(kind: Kind, lighting: Lighting, seed: u64) -> Self {
        let profile = GaitProfile::draw(seed);
        Self::with_tags(
            kind,
            lighting,
            seed,
            &profile,
            &[],
            &WearerFaults::default(),
        )
    }

    /// Builds a scene for this wearer with these tags on his shoes, and faults of them.
    ///
    /// # Panics
    /// If the `id` of a tag is not below [`tag::COUNT`].
    pub(crate) fn with_tags(
        kind: Kind,
        lighting: Lighting,
        seed: u64,
        profile: &GaitProfile,
        tags: &[ShoeTag],
        faults: &WearerFaults,
    ) -> Self {
        Self::make(kind, lighting, seed, (profile, tags, faults), &[])
    }

    /// The calibration room with these boards, without people.
    pub fn with_boards(lighting: Lighting, seed: u64, boards: &[Board]) -> Self {
        let bare = (&GaitProfile::draw(seed), &[][..], &WearerFaults::default());
        let mut scene = Self::make(Kind::Targets, lighting, seed, bare, boards);
        scene.wearer.parts.clear();
        scene
    }

    fn make(
        kind: Kind,
        lighting: Lighting,
        seed: u64,
        (profile, tags, faults): (&GaitProfile, &[ShoeTag], &WearerFaults),
        boards: &[Board],
    ) -> Self {
        let mut builder = Builder::new(seed);
        let made = kind.build(&mut builder);
        targets::stand(&mut builder, boards);
        let wearer = Wearer::make(&mut builder, tags, profile, faults);
        let clouds = builder.texture(&palette::CLOUDS);
        let light = made.lights.at(lighting);
        // Moving bodies have no shadows; indoors the sun rarely reaches them.
        let mut around = light.clone();
        around.sun = around.sun.filter(|_| !made.lights.indoors);
        let Builder {
            mut materials,
            recipes,
            mesh,
            glass,
            parts,
            ..
        } = builder;
        let lit = made.lights.lamps_on(lighting);
        materials.iter_mut().for_each(|m| m.glow *= lit as f32);
        // Two independent tasks of similar length.
        let (textures, fixed, glass) = thread::scope(|scope| {
            let textures = scope.spawn(|| build::textures(&recipes, seed));
            let solid = bvh_of(&mesh);
            let (mesh, baked) = shadow::baked(&mesh, &materials, &light, &solid, &made.route);
            let fixed = Body::new(&mesh, &baked);
            let baked = light.baked(&glass, &solid);
            let glass = Body::new(&glass, &baked);
            let textures = textures.join().unwrap_or_else(|panic| resume_unwind(panic));
            (textures, fixed, glass)
        });
        let walkable_triangles: Vec<u32> = (0..fixed.triangles.len() as u32)
            .filter(|&i| {
                let triangle = &fixed.triangles[i as usize];
                materials[triangle.material as usize].walkable
            })
            .collect();
        let walkable = Bvh::new(
            walkable_triangles
                .iter()
                .map(|&i| fixed.triangles[i as usize].corners.map(|c| c.position)),
        );
        Self {
            kind,
            lighting,
            materials,
            textures,
            solid: Bvh::new(
                fixed
                    .triangles
                    .iter()
                    .map(|t| t.corners.map(|c| c.position)),
            ),
            fixed,
            glass,
            fence: Body::default(),
            gloss: 0.0,
            moving: parts.into_iter().map(|part| part.lit(&around)).collect(),
            sky: Sky::new(lighting, &light, clouds),
            wearer: wearer.lit(&around),
            light,
            route: made.route,
            walkable,
            walkable_triangles,
        }
    }

    /// Adds scenery. The geometry that the walker uses is unchanged.
    pub(crate) fn furnish(&mut self, scenery: &Scenery) {
        self.gloss = scenery.gloss;
        self.fence = Body::default();
        if scenery.fence_spacing_m > 0.0 {
            let stuff = Stuff {
                material: self.materials.len() as u16,
                instance: FENCE_INSTANCE,
            };
            let (material, texture) =
                palette::METAL.material_and_texture(Class::Obstacle, self.textures.len());
            self.materials.push(material);
            self.textures.push(texture);
            let ground = |x, y, below| Some(self.ground(x, y, below)?.height);
            let mesh = fence::mesh(&self.route, ground, scenery.fence_spacing_m, stuff);
            self.fence = Body::new(&mesh, &self.light.baked(&mesh, &self.solid));
        }
    }

    /// The highest ground at `(x, y)` that is not above `below`, m.
    pub fn ground(&self, x: f64, y: f64, below: f64) -> Option<Ground> {
        let down = -Vector3::z();
        let hit = self
            .walkable
            .hit(&Vector3::new(x, y, below), &down, 0.0, 100.0)?;
        let triangle = self.walkable_triangles[hit.triangle as usize];
        let [a, b, c] = self.fixed.triangles[triangle as usize]
            .corners
            .map(|c| c.position);
        Some(Ground {
            height: below - hit.distance,
            normal: (b - a).cross(&(c - a)).normalize(),
            triangle,
        })
    }

    /// Whether static geometry is nearer than `reach` lengths of `direction`.
    pub fn is_hidden(
        &self,
        from: &Vector3<f64>,
        direction: &Vector3<f64>,
        reach: f64,
    ) -> bool {
        self.solid.is_hidden(from, direction, reach)
    }

    /// Nearest static surface along a ray: distance in lengths of `direction`, and number of the
    /// triangle. Reference implementation of the rasterizer.
    pub(crate) fn first_hit(
        &self,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
    ) -> Option<bvh::Hit> {
        self.solid.hit(origin, direction, 1e-6, f64::INFINITY)
    }
}

/// Daylight scenes that tests share, since building one takes seconds.
#[cfg(test)]
pub(crate) fn by_day(kind: Kind, seed: u64) -> std::sync::Arc<Scene> {
    use std::collections::BTreeMap;
    use std::sync::{Arc, Mutex, OnceLock, PoisonError};
    type CachedScene = Arc<OnceLock<Arc<Scene>>>;
    static CACHE: Mutex<BTreeMap<(&str, u64), CachedScene>> = Mutex::new(BTreeMap::new());
    let mut made = CACHE.lock().unwrap_or_else(PoisonError::into_inner);
    let slot = made.entry((kind.name(), seed)).or_default().clone();
    // Other scenes may be built meanwhile.
    drop(made);
    let new = || Arc::new(Scene::new(kind, Lighting::Day, seed));
    slot.get_or_init(new).clone()
}

fn bvh_of(mesh: &Mesh) -> Bvh {
    Bvh::new(mesh.triangles.iter().map(|t| t.corners.map(|c| c.position)))
}

#[cfg(test)]
mod tests;
