//! Surface finishes for all scenes: texture recipes, layouts and colors.
//!
//! Contract: a finish is a recipe, a layout, a size and two colors; the caller adds the [`Class`].
//! Reflectances are those of real materials, linear. Builders generate a texture once for all
//! finishes that share recipe and layout.

use super::build::Builder;
use super::surface::{Class, Material};
use super::texture::layout::{Courses, Layout, Stagger};
use super::texture::{Recipe, Texture};

/// Finish of a surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Finish {
    pub(super) recipe: Recipe,
    pub(super) layout: Layout,
    /// Length of a texel, mm.
    pub(super) texel_mm: f32,
    /// Reflectance, linear red, green, blue.
    pub(super) albedo: [f32; 3],
    /// Reflectance of the second color, or of the joints.
    pub(super) other: [f32; 3],
    /// See [`super::surface::Material::glow`].
    pub(super) glow: f32,
}

impl Finish {
    const fn new(recipe: Recipe, texel_mm: f32, albedo: [f32; 3], other: [f32; 3]) -> Self {
        Self {
            recipe,
            layout: Layout::Along,
            texel_mm,
            albedo,
            other,
            glow: 0.0,
        }
    }

    const fn laid(self, layout: Layout) -> Self {
        Self { layout, ..self }
    }

    /// With light emission while lamps are on.
    pub(super) const fn glowing(self, glow: f32) -> Self {
        Self { glow, ..self }
    }

    /// With other colors.
    pub(super) const fn dyed(self, albedo: [f32; 3], other: [f32; 3]) -> Self {
        Self {
            albedo,
            other,
            ..self
        }
    }

    /// Adds a material of a class to a scene.
    pub(super) fn of(&self, class: Class, b: &mut Builder) -> u16 {
        let texture = b.texture_laid(&self.recipe, &self.layout);
        let material = b.material(class, texture, self.texel_mm, self.albedo, self.other);
        b.materials[usize::from(material)].glow = self.glow;
        material
    }
}

impl Finish {
    /// Its material with the texture of this number, and that texture, to add to a scene that is
    /// built already.
    pub(super) fn material_and_texture(&self, class: Class, texture: usize) -> (Material, Texture) {
        let material = Material {
            class,
            walkable: false,
            texture: texture as u16,
            texel_m: self.texel_mm * 1e-3,
            albedo: self.albedo,
            other_albedo: self.other,
            glow: self.glow,
        };
        (material, Texture::new(&self.recipe, &self.layout, 0))
    }
}

const fn recipe(radius: [f32; 2], contrast: f32, grain: f32, mixed: f32, stretch: f32) -> Recipe {
    Recipe {
        radius,
        contrast,
        grain,
        mixed,
        stretch,
    }
}

const fn courses(across: u16, rows: u16, stagger: Stagger, joint: f32, uneven: f32) -> Layout {
    Layout::Courses(Courses {
        across,
        rows,
        stagger,
        joint,
        uneven,
    })
}

// Recipes.

/// Clouds, at one texel of level 2 per third of a degree.
pub(super) const CLOUDS: Recipe = recipe([10.0, 500.0], 0.4, 0.0, 0.0, 1.8);
const STONE: Recipe = recipe([1.5, 160.0], 0.25, 0.04, 0.3, 1.0);
const CHIPPINGS: Recipe = recipe([1.2, 90.0], 0.28, 0.1, 0.15, 1.0);
const POURED: Recipe = recipe([3.0, 320.0], 0.1, 0.03, 0.25, 1.0);
const SMOOTH: Recipe = recipe([6.0, 400.0], 0.1, 0.015, 0.3, 1.0);
/// Contrast of a few percent: textureless for stereo matching and tracking.
const BLANK: Recipe = recipe([3.0, 300.0], 0.02, 0.012, 0.3, 1.0);
const PAPER_ROUGH: Recipe = recipe([2.0, 200.0], 0.05, 0.02, 0.3, 1.0);
const GRAINED: Recipe = recipe([2.0, 90.0], 0.26, 0.05, 0.35, 8.0);
const WOVEN: Recipe = recipe([1.0, 40.0], 0.26, 0.1, 0.35, 1.5);
const FOLIAGE: Recipe = recipe([3.0, 40.0], 0.45, 0.1, 0.5, 2.2);
const BLADES: Recipe = recipe([1.5, 36.0], 0.45, 0.12, 0.5, 4.0);
const CRUMBS: Recipe = recipe([1.2, 120.0], 0.36, 0.1, 0.3, 1.0);
/// Leaves 2 cm to 9 cm long at 2 mm per texel.
const FALLEN: Recipe = recipe([4.0, 24.0], 0.42, 0.1, 0.45, 1.9);
const FURROWS: Recipe = recipe([2.0, 60.0], 0.42, 0.15, 0.4, 5.0);
/// Printed text and graphics.
const PRINT: Recipe = recipe([2.0, 10.0], 0.3, 0.02, 0.0, 5.0);
/// Reflections in a window: large, soft, upright.
const MIRRORED: Recipe = recipe([60.0, 500.0], 0.25, 0.01, 0.35, 0.5);

// Layouts.

const SLABBED: Layout = courses(4, 4, Stagger::Half, 6.0, 0.3);
const BONDED: Layout = courses(4, 14, Stagger::Half, 8.0, 0.35);
const PLANKS: Layout = courses(1, 10, Stagger::Any, 2.4, 0.6);
const BOARDS: Layout = courses(1, 6, Stagger::Any, 5.0, 0.5);

// Ground.

/// Slabs of 0.4 m.
pub(super) const SLABS: Finish =
    Finish::new(STONE, 1.6, [0.33, 0.31, 0.29], [0.13, 0.12, 0.11]).laid(SLABBED);
/// Cubes of 9 cm.
pub(super) const SETTS: Finish = Finish::new(STONE, 1.1, [0.22, 0.21, 0.2], [0.1, 0.09, 0.08])
    .laid(courses(12, 12, Stagger::Half, 11.0, 0.45));
/// Stones 1 m long.
pub(super) const KERB: Finish = Finish::new(STONE, 1.0, [0.42, 0.41, 0.39], [0.14, 0.13, 0.12])
    .laid(courses(1, 1, Stagger::None, 9.0, 0.0));
pub(super) const ASPHALT: Finish =
    Finish::new(CHIPPINGS, 1.3, [0.1, 0.1, 0.105], [0.13, 0.125, 0.12]);
/// On asphalt, which shows through where it is worn.
pub(super) const ROAD_PAINT: Finish =
    Finish::new(CHIPPINGS, 1.2, [0.6, 0.6, 0.58], [0.4, 0.4, 0.39]);
pub(super) const GRASS: Finish =
    Finish::new(BLADES, 1.5, [0.09, 0.15, 0.04], [0.17, 0.18, 0.08]).laid(Layout::Tossed);
pub(super) const EARTH: Finish = Finish::new(CRUMBS, 1.3, [0.15, 0.11, 0.075], [0.22, 0.17, 0.12]);
pub(super) const LITTER: Finish =
    Finish::new(FALLEN, 2.0, [0.17, 0.1, 0.045], [0.3, 0.2, 0.08]).laid(Layout::Tossed);
pub(super) const MOSS: Finish =
    Finish::new(FOLIAGE, 1.2, [0.09, 0.13, 0.035], [0.16, 0.17, 0.06]).laid(Layout::Tossed);
pub(super) const LINO: Finish = Finish::new(
    recipe([2.0, 140.0], 0.09, 0.03, 0.3, 1.4),
    1.2,
    [0.27, 0.28, 0.27],
    [0.22, 0.23, 0.24],
);
/// Planks 12 cm wide.
pub(super) const PARQUET: Finish =
    Finish::new(GRAINED, 1.2, [0.36, 0.23, 0.13], [0.14, 0.08, 0.04]).laid(PLANKS);
pub(super) const RUG: Finish = Finish::new(WOVEN, 2.0, [0.3, 0.1, 0.08], [0.16, 0.14, 0.22]);

// Walls.

pub(super) const CONCRETE: Finish =
    Finish::new(POURED, 1.5, [0.42, 0.41, 0.39], [0.34, 0.33, 0.32]);
pub(super) const GRANITE: Finish = Finish::new(
    recipe([1.2, 60.0], 0.22, 0.1, 0.3, 1.0),
    1.0,
    [0.38, 0.37, 0.35],
    [0.33, 0.33, 0.335],
);
/// Bricks of 25 cm by 7 cm.
pub(super) const BRICK: Finish =
    Finish::new(STONE, 1.0, [0.33, 0.15, 0.1], [0.4, 0.35, 0.29]).laid(BONDED);
pub(super) const PLASTER: Finish = Finish::new(POURED, 2.5, [0.58, 0.52, 0.4], [0.55, 0.5, 0.39]);
/// Cut stone, as of sills and plinths.
pub(super) const TRIM: Finish = Finish::new(POURED, 1.5, [0.5, 0.48, 0.44], [0.42, 0.4, 0.38]);
/// Paint on a wall with nothing on it.
pub(super) const PAINT: Finish = Finish::new(BLANK, 2.5, [0.66, 0.65, 0.6], [0.655, 0.645, 0.6]);
pub(super) const CEILING: Finish =
    Finish::new(BLANK, 2.5, [0.78, 0.78, 0.76], [0.775, 0.775, 0.76]);
pub(super) const WALLPAPER: Finish =
    Finish::new(PAPER_ROUGH, 2.0, [0.6, 0.6, 0.55], [0.56, 0.57, 0.53]);
/// A window from outside by day.
pub(super) const PANE: Finish = Finish::new(MIRRORED, 3.0, [0.045, 0.055, 0.07], [0.16, 0.18, 0.2]);
/// A window behind which a lamp is on at night.
pub(super) const LIT_PANE: Finish =
    Finish::new(MIRRORED, 3.0, [0.1, 0.085, 0.06], [0.2, 0.17, 0.12]).glowing(0.012);

// Things.

pub(super) const WOOD: Finish = Finish::new(GRAINED, 1.2, [0.34, 0.22, 0.12], [0.26, 0.16, 0.09]);
/// Boards side by side, 20 cm wide, along u.
pub(super) const DOOR: Finish =
    Finish::new(GRAINED, 1.2, [0.2, 0.13, 0.08], [0.07, 0.05, 0.035]).laid(BOARDS);
/// A board with sheets of paper on it, 25 cm wide.
pub(super) const PAPERS: Finish = Finish::new(PRINT, 1.0, [0.7, 0.69, 0.66], [0.2, 0.13, 0.07])
    .laid(courses(4, 4, Stagger::Any, 70.0, 0.15));
/// Varnished metal.
pub(super) const METAL: Finish = Finish::new(SMOOTH, 1.0, [0.1, 0.12, 0.11], [0.16, 0.16, 0.15]);
pub(super) const STEEL: Finish = Finish::new(SMOOTH, 0.6, [0.3, 0.31, 0.32], [0.24, 0.24, 0.25]);
pub(super) const WHITE: Finish = Finish::new(SMOOTH, 1.0, [0.68, 0.68, 0.66], [0.62, 0.62, 0.6]);
/// Base finishes for other colors: paint on metal or plastic, and cloth.
pub(super) const VARNISH: Finish = Finish::new(SMOOTH, 2.0, [0.4; 3], [0.35; 3]);
pub(super) const CLOTH: Finish = Finish::new(WOVEN, 1.2, [0.4; 3], [0.35; 3]);
/// Furrows run along u.
pub(super) const BARK: Finish = Finish::new(FURROWS, 1.6, [0.19, 0.15, 0.12], [0.12, 0.095, 0.07]);
pub(super) const LEAVES: Finish =
    Finish::new(FOLIAGE, 3.0, [0.085, 0.15, 0.04], [0.17, 0.21, 0.07]).laid(Layout::Tossed);
pub(super) const STONES: Finish = Finish::new(STONE, 1.0, [0.3, 0.3, 0.28], [0.2, 0.21, 0.18]);
/// A lamp's cover.
pub(super) const LAMP: Finish = Finish::new(BLANK, 2.0, [0.9, 0.9, 0.88], [0.9, 0.9, 0.88]);
