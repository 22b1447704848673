//! Shapes of people: tapered limbs in clothes, each in the frame of its joint.

use nalgebra::Vector3;

use super::{BALL, HEEL, Limb, SHIN, SOLE, THIGH, UPPER_ARM};
use crate::scene::build::Builder;
use crate::scene::mesh::{Mesh, Stuff};
use crate::scene::surface::Class;
use crate::scene::sweep::{Ring, sweep};
use crate::scene::texture::Recipe;

/// Clothes and materials of people: indices of materials.
#[derive(Clone, Debug)]
pub struct Wardrobe {
    tops: Vec<u16>,
    trousers: Vec<u16>,
    skins: Vec<u16>,
    hairs: Vec<u16>,
    shoes: Vec<u16>,
}

/// Clothes and build of one person.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Outfit {
    top: Stuff,
    sleeve: Stuff,
    trousers: Stuff,
    skin: Stuff,
    hair: Stuff,
    shoe: Stuff,
    bag: Option<Stuff>,
    /// Width relative to a slender person.
    girth: f64,
}

impl Wardrobe {
    /// Cloth, skin, hair and leather.
    pub fn new(b: &mut Builder) -> Self {
        let recipe = |radius: [f32; 2], contrast: f32, mixed: f32, stretch: f32| Recipe {
            radius,
            contrast,
            grain: 0.05,
            mixed,
            stretch,
        };
        let plain = b.texture(&recipe([2.0, 120.0], 0.22, 0.3, 1.5));
        let print = b.texture(&recipe([6.0, 60.0], 0.3, 0.5, 1.0));
        let strands = b.texture(&recipe([1.5, 40.0], 0.4, 0.4, 5.0));
        let mut cloths = |texture, texel_mm, colors: &[([f32; 3], [f32; 3])]| {
            colors
                .iter()
                .map(|&(own, other)| b.material(Class::Person, texture, texel_mm, own, other))
                .collect::<Vec<u16>>()
        };
        let mut tops = cloths(
            plain,
            0.9,
            &[
                ([0.36, 0.07, 0.06], [0.28, 0.05, 0.05]),
                ([0.07, 0.11, 0.22], [0.1, 0.15, 0.28]),
                ([0.42, 0.38, 0.3], [0.34, 0.3, 0.24]),
                ([0.05, 0.05, 0.055], [0.08, 0.08, 0.08]),
                ([0.12, 0.2, 0.1], [0.16, 0.22, 0.12]),
            ],
        );
        tops.extend(cloths(
            print,
            1.0,
            &[
                ([0.5, 0.48, 0.44], [0.12, 0.16, 0.3]),
                ([0.45, 0.3, 0.08], [0.5, 0.44, 0.35]),
            ],
        ));
        Self {
            tops,
            trousers: cloths(
                plain,
                0.8,
                &[
                    ([0.06, 0.08, 0.14], [0.1, 0.12, 0.18]),
                    ([0.09, 0.085, 0.08], [0.06, 0.06, 0.06]),
                    ([0.26, 0.21, 0.14], [0.2, 0.16, 0.11]),
                    ([0.17, 0.17, 0.18], [0.22, 0.22, 0.22]),
                ],
            ),
            skins: cloths(
                plain,
                0.5,
                &[
                    ([0.45, 0.29, 0.21], [0.42, 0.25, 0.18]),
                    ([0.26, 0.15, 0.09], [0.23, 0.13, 0.08]),
                    ([0.12, 0.065, 0.04], [0.1, 0.055, 0.035]),
                ],
            ),
            hairs: cloths(
                strands,
                0.7,
                &[
                    ([0.03, 0.025, 0.02], [0.06, 0.05, 0.04]),
                    ([0.13, 0.08, 0.04], [0.08, 0.05, 0.03]),
                    ([0.35, 0.34, 0.33], [0.24, 0.23, 0.23]),
                ],
            ),
            shoes: cloths(
                plain,
                0.6,
                &[
                    ([0.05, 0.04, 0.035], [0.09, 0.07, 0.05]),
                    ([0.5, 0.5, 0.48], [0.3, 0.3, 0.3]),
                ],
            ),
        }
    }

    /// Chooses an outfit.
    pub(super) fn choose(&self, b: &mut Builder) -> Outfit {
        let instance = b.thing();
        let short_sleeves = b.draw(0.0, 1.0) < 0.4;
        let carries = b.draw(0.0, 1.0) < 0.35;
        let girth = b.draw(0.92, 1.2);
        let mut one_of = |choices: &[u16]| {
            let i = (b.draw(0.0, 1.0) * choices.len() as f64) as usize;
            Stuff {
                material: choices[i],
                instance,
            }
        };
        let skin = one_of(&self.skins);
        // In turn, so that people can be distinguished.
        let top = Stuff {
            material: self.tops[usize::from(instance) % self.tops.len()],
            instance,
        };
        Outfit {
            top,
            sleeve: if short_sleeves { skin } else { top },
            trousers: one_of(&self.trousers),
            skin,
            hair: one_of(&self.hairs),
            shoe: one_of(&self.shoes),
            bag: carries.then(|| one_of(&self.tops)),
            girth,
        }
    }
}

/// Rings along z: height, half the width, half the depth, and how far forward, m.
fn upright(rings: &[[f64; 4]], girth: f64) -> Vec<Ring> {
    rings
        .iter()
        .map(|&[z, width, depth, forward]| Ring {
            center: Vector3::new(forward, 0.0, z),
            radii: [width * girth, depth * girth],
        })
        .collect()
}

/// Mesh of a limb of a person 1.75 m tall.
pub(super) fn mesh(limb: Limb, outfit: &Outfit) -> Mesh {
    let mut mesh = Mesh::default();
    let girth = outfit.girth;
    let mut skin = |rings: &[[f64; 4]], girth: f64, sides: usize, stuff: Stuff| {
        sweep(
            &mut mesh,
            &upright(rings, girth),
            Vector3::y(),
            sides,
            stuff,
        );
    };
    match limb {
        Limb::Torso => {
            let hips = [
                [-0.12, 0.06, 0.07, 0.0],
                [-0.07, 0.15, 0.105, -0.005],
                [0.02, 0.17, 0.115, -0.01],
                [0.12, 0.15, 0.1, 0.0],
            ];
            skin(&hips, girth, 14, outfit.trousers);
            let trunk = [
                [-0.02, 0.188, 0.132, -0.01],
                [0.05, 0.182, 0.128, -0.006],
                [0.17, 0.16, 0.112, 0.005],
                [0.3, 0.165, 0.115, 0.01],
                [0.4, 0.178, 0.115, 0.0],
                [0.46, 0.18, 0.1, -0.01],
                [0.5, 0.15, 0.085, -0.012],
                [0.53, 0.085, 0.07, -0.005],
                [0.55, 0.055, 0.055, 0.0],
            ];
            skin(&trunk, girth, 14, outfit.top);
            if let Some(bag) = outfit.bag {
                let size = Vector3::new(0.15, 0.3, 0.42);
                let center = Vector3::new(-0.105 * girth - 0.06, 0.0, 0.3);
                mesh.cuboid(center, size, super::pitch(0.05), 0.2, bag);
            }
        }
        Limb::Head => {
            let head = [
                [-0.04, 0.055, 0.055, 0.0],
                [0.03, 0.05, 0.052, 0.005],
                [0.05, 0.052, 0.075, 0.025],
                [0.09, 0.068, 0.09, 0.02],
                [0.14, 0.074, 0.096, 0.012],
                [0.2, 0.07, 0.09, 0.008],
                [0.245, 0.045, 0.058, 0.0],
                [0.258, 0.01, 0.013, 0.0],
            ];
            skin(&head, 1.0, 12, outfit.skin);
            // Hair lies behind the face and on top.
            let hair = [
                [0.06, 0.055, 0.05, -0.035],
                [0.1, 0.075, 0.075, -0.025],
                [0.16, 0.08, 0.09, -0.012],
                [0.21, 0.077, 0.098, 0.0],
                [0.255, 0.052, 0.066, -0.003],
                [0.272, 0.012, 0.015, -0.003],
            ];
            skin(&hair, 1.0, 12, outfit.hair);
            let nose = [
                [0.1, 0.014, 0.014, 0.105],
                [0.115, 0.014, 0.02, 0.11],
                [0.15, 0.007, 0.008, 0.105],
            ];
            skin(&nose, 1.0, 6, outfit.skin);
        }
        Limb::Thigh(_) => {
            let thigh = [
                [0.05, 0.055, 0.06, 0.0],
                [-0.02, 0.083, 0.09, 0.0],
                [-0.15, 0.08, 0.085, 0.005],
                [-0.3, 0.066, 0.07, 0.008],
                [-THIGH, 0.058, 0.062, 0.006],
                [-THIGH - 0.04, 0.035, 0.038, 0.004],
            ];
            skin(&thigh, girth, 10, outfit.trousers);
        }
        Limb::Shin(_) => {
            let shin = [
                [0.03, 0.04, 0.042, 0.004],
                [-0.02, 0.058, 0.06, 0.002],
                [-0.13, 0.06, 0.066, -0.012],
                [-0.3, 0.052, 0.054, -0.004],
                [-SHIN + 0.005, 0.054, 0.058, 0.0],
                [-SHIN - 0.02, 0.05, 0.056, 0.0],
            ];
            skin(&shin, girth.min(1.1), 10, outfit.trousers);
        }
        Limb::Foot(_) => shoe(&mut mesh, outfit.shoe),
        Limb::UpperArm(_) => {
            let arm = [
                [0.05, 0.035, 0.035, 0.0],
                [0.02, 0.058, 0.058, 0.0],
                [-0.1, 0.052, 0.055, 0.0],
                [-0.2, 0.046, 0.05, 0.0],
            ];
            let lower = [
                [-0.17, 0.042, 0.045, 0.0],
                [-UPPER_ARM, 0.039, 0.042, 0.0],
                [-UPPER_ARM - 0.03, 0.025, 0.025, 0.0],
            ];
            skin(&arm, girth, 10, outfit.top);
            skin(&lower, girth, 10, outfit.sleeve);
        }
        Limb::Forearm(_) => {
            let forearm = [
                [0.03, 0.026, 0.026, 0.0],
                [-0.01, 0.04, 0.042, 0.0],
                [-0.08, 0.04, 0.042, 0.0],
                [-0.25, 0.029, 0.032, 0.0],
            ];
            skin(&forearm, girth.min(1.1), 9, outfit.sleeve);
            let hand = [
                [-0.235, 0.02, 0.026, 0.0],
                [-0.28, 0.02, 0.04, 0.005],
                [-0.33, 0.02, 0.042, 0.012],
                [-0.38, 0.017, 0.036, 0.02],
                [-0.42, 0.01, 0.02, 0.025],
            ];
            skin(&hand, 1.0, 8, outfit.skin);
        }
    }
    mesh
}

/// From behind the heel to the toes, with a hem over the ankle; the sole touches the ground from
/// [`HEEL`] to [`BALL`].
fn shoe(mesh: &mut Mesh, stuff: Stuff) {
    // Forward, half the width, half the height.
    let rings: Vec<Ring> = [
        (HEEL - 0.025, 0.022, 0.022),
        (HEEL, 0.036, 0.042),
        (0.0, 0.042, 0.052),
        (0.07, 0.043, 0.04),
        (BALL - 0.03, 0.048, 0.03),
        (BALL, 0.043, 0.024),
        (BALL + 0.035, 0.024, 0.014),
    ]
    .into_iter()
    .map(|(x, width, height)| {
        // The ends are lifted a little.
        let lift = if (HEEL..=BALL).contains(&x) {
            0.0
        } else {
            0.008
        };
        Ring {
            center: Vector3::new(x, 0.0, -SOLE + height + lift),
            radii: [width, height],
        }
    })
    .collect();
    // With 12 sides one corner is the lowest.
    sweep(mesh, &rings, Vector3::y(), 12, stuff);
}
