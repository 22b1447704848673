//! Shared parts of scene builders.

use nalgebra::{UnitQuaternion, Vector3};

use super::light::Lights;
use super::mesh::{Mesh, Stuff};
use super::people::Part;
use super::route::Route;
use super::surface::{Class, Material};
use super::texture::layout::Layout;
use super::texture::{Recipe, Texture};
use crate::random;
use cad_transforms::so3;

/// Builder of a scene.
#[derive(Debug)]
pub struct Builder {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Built so far.
    pub materials: Vec<Material>,
    /// Built so far.
    pub mesh: Mesh,
    /// Panes so far.
    pub glass: Mesh,
    /// Moving parts so far.
    pub parts: Vec<Part>,
    /// Recipes of textures.
    pub recipes: Vec<(Recipe, Layout)>,
    instances: u16,
    draws: u64,
}

/// Generates the textures of these recipes for a scene of this seed.
pub(super) fn textures(recipes: &[(Recipe, Layout)], seed: u64) -> Vec<Texture> {
    let numbered = recipes.iter().zip(0..);
    let texture = |((recipe, layout), index): (&(Recipe, Layout), u64)| {
        let seed = random::bits(seed, random::SCENE + 1, index);
        Texture::new(recipe, layout, seed)
    };
    numbered.map(texture).collect()
}

/// Result of building a scene, besides the builder.
#[derive(Clone, Debug)]
pub struct SceneParts {
    /// Light sources.
    pub lights: Lights,
    /// Route of the walker.
    pub route: Route,
}

impl Builder {
    /// An empty scene.
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            materials: Vec::new(),
            mesh: Mesh::default(),
            glass: Mesh::default(),
            parts: Vec::new(),
            recipes: Vec::new(),
            instances: 0,
            draws: 0,
        }
    }

    /// The next random number, uniform in `from..to`.
    pub fn draw(&mut self, from: f64, to: f64) -> f64 {
        self.draws += 1;
        from + (to - from) * random::uniform(self.seed, random::SCENE, self.draws)
    }

    /// Number of a new instance.
    pub fn thing(&mut self) -> u16 {
        self.instances += 1;
        self.instances
    }

    /// Texture of a recipe with leaves along u.
    pub fn texture(&mut self, recipe: &Recipe) -> u16 {
        self.texture_laid(recipe, &Layout::Along)
    }

    /// Number of the texture of a recipe and a layout.
    pub(crate) fn texture_laid(&mut self, recipe: &Recipe, layout: &Layout) -> u16 {
        let wanted = (*recipe, *layout);
        let known = self.recipes.iter().position(|made| *made == wanted);
        known.unwrap_or_else(|| {
            self.recipes.push(wanted);
            self.recipes.len() - 1
        }) as u16
    }

    /// Adds a material that differs from another one in its colors.
    pub(super) fn material_like(&mut self, other: u16, albedo: [f32; 3], mixed: [f32; 3]) -> u16 {
        self.materials.push(Material {
            albedo,
            other_albedo: mixed,
            ..self.materials[other as usize]
        });
        self.materials.len() as u16 - 1
    }

    /// Adds a material.
    pub fn material(
        &mut self,
        class: Class,
        texture: u16,
        texel_mm: f32,
        albedo: [f32; 3],
        other_albedo: [f32; 3],
    ) -> u16 {
        self.materials.push(Material {
            class,
            walkable: matches!(
                class,
                Class::Pavement | Class::Road | Class::Crosswalk | Class::Grass | Class::Stair
            ),
            texture,
            texel_m: texel_mm * 1e-3,
            albedo,
            other_albedo,
            glow: 0.0,
        });
        self.materials.len() as u16 - 1
    }

    /// Part of the ground.
    pub fn on_ground(material: u16) -> Stuff {
        Stuff {
            material,
            instance: 0,
        }
    }

    /// A new instance.
    pub fn of_thing(&mut self, material: u16) -> Stuff {
        Stuff {
            material,
            instance: self.thing(),
        }
    }

    /// A box that stands on `base`, rotated by `yaw` rad.
    pub(crate) fn standing_box(
        &mut self,
        base: Vector3<f64>,
        size: Vector3<f64>,
        yaw: f64,
        cell_m: f64,
        stuff: Stuff,
    ) {
        let center = base + Vector3::z() * (0.5 * size.z);
        self.mesh
            .cuboid(center, size, so3::exp(Vector3::z() * yaw), cell_m, stuff);
    }

    /// A pane, visible from both sides.
    pub fn pane(&mut self, [a, b, c, d]: [Vector3<f64>; 4], cell_m: f64, stuff: Stuff) {
        self.glass.tiled_quad([a, b, c, d], [0.0; 2], cell_m, stuff);
        self.glass.tiled_quad([b, a, d, c], [0.0; 2], cell_m, stuff);
    }

    /// A lump of about this radius, as a stone or a tuft: a sphere of `rings` rings with bumps.
    pub(crate) fn lump(
        &mut self,
        center: Vector3<f64>,
        radius: Vector3<f64>,
        rings: usize,
        rough: f64,
        stuff: Stuff,
    ) {
        let sides = 2 * rings;
        let mut points = Vec::new();
        for i in 0..=rings {
            let polar = std::f64::consts::PI * i as f64 / rings as f64;
            for k in 0..sides {
                let angle = 2.0 * std::f64::consts::PI * k as f64 / sides as f64;
                let bump = 1.0 + rough * self.draw(-1.0, 1.0);
                let is_pole = i == 0 || i == rings;
                let bump = if is_pole { 1.0 } else { bump };
                let out = Vector3::new(
                    libm::sin(polar) * libm::cos(angle),
                    libm::sin(polar) * libm::sin(angle),
                    libm::cos(polar),
                );
                points.push(center + out.component_mul(&radius) * bump);
            }
        }
        let at = |i: usize, k: usize| points[i * sides + k % sides];
        for i in 0..rings {
            for k in 0..sides {
                let (a, b, c, d) = (at(i + 1, k), at(i + 1, k + 1), at(i, k + 1), at(i, k));
                let uv = [radius.x * k as f64, radius.z * i as f64];
                // At the poles one side has no length.
                if i == 0 {
                    self.mesh.triangle([a, b, d], uv, stuff);
                } else if i + 1 == rings {
                    self.mesh.triangle([a, c, d], uv, stuff);
                } else {
                    self.mesh.triangle([a, b, c], uv, stuff);
                    self.mesh.triangle([a, c, d], uv, stuff);
                }
            }
        }
    }

    /// Rotation about the vertical, rad.
    pub fn yaw(angle: f64) -> UnitQuaternion<f64> {
        so3::exp(Vector3::z() * angle)
    }
}
