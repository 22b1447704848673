//! Visible body parts of the wearer: shoes, the tags on them and what hides these, and legs.
//!
//! Rigid parts: a shoe with its tags, a shank and a thigh on each side. Their poses follow from the
//! walk: shoes are the feet, and the knee bends so that the leg reaches from the hip to the ankle.
//! The origin of a body is its center of rotation: shoes in the middle of the sole, shanks at the
//! ankle, thighs at the knee, with z along the limb.

use nalgebra::{UnitQuaternion, Vector3};

use super::body::Body;
use super::build::Builder;
use super::light::Light;
use super::mesh::{Mesh, Stuff};
use super::surface::Class;
use super::tag;
use super::texture::Recipe;
use crate::faults::{Fault, Kind, WearerFaults};
use crate::random;
use crate::walker::gait::{HEEL_X, TOE_X};
use crate::walker::{GaitProfile, Side, Walker};
use cad_transforms::so3;

/// From the rig's datum to the hips of a wearer of the reference height, m: back, to each side,
/// down.
const HIP: [f64; 3] = [-0.14, 0.09, -0.37];
/// From the middle of the sole to the ankle, m.
const ANKLE: [f64; 3] = [-0.07, 0.0, 0.09];
/// Lengths of limbs of a wearer of the reference height, m.
const SHANK_M: f64 = 0.42;
const THIGH_M: f64 = 0.43;
/// Maximum extension of a leg as a fraction of its length.
const MAX_LEG_EXTENSION: f64 = 0.998;

/// A rigid part of the wearer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The foot.
    Shoe(Side),
    /// From the ankle to the knee.
    Shank(Side),
    /// From the knee to the hip.
    Thigh(Side),
    /// A tag by its index in [`Wearer::tags`]; its frame is the tag's.
    Tag(usize),
    /// What a fault puts over a tag or a shoe, by its index.
    Cover(usize),
}

/// Something over a tag or a shoe.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Cover {
    /// Index of the tag in whose frame it is; `None` for the frame of the shoe.
    tag: Option<usize>,
    side: Side,
    from_s: f64,
    to_s: f64,
}

/// Turn of a tag that slips, rad/m.
const SLIP_TURN: f64 = 600.0 * std::f64::consts::PI / 180.0;
/// Height of a part that is not there, m.
const NOWHERE_M: f64 = -1000.0;
/// Distance of mud in front of a tag, and of other covers, m: more than ground truth tolerates.
const DIRT_M: f64 = 0.004;
const COVER_M: f64 = 0.006;
/// Where cloth over the instep begins, m, and half its width, m.
const CLOTH_X: f64 = -0.02;
const CLOTH_HALF_WIDTH_M: f64 = 0.07;
/// Stream of dirty cells.
const DIRT: u64 = random::FAULT + 0x80;

/// A tag on a shoe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShoeTag {
    /// Number in the family 36h11, below [`tag::COUNT`].
    pub id: usize,
    /// Which shoe.
    pub side: Side,
    /// Side of the black square, m.
    pub size_m: f64,
    /// Middle of the tag in the foot's frame, m.
    pub position: Vector3<f64>,
    /// Maps the tag frame (x right, y down, z into it) to the foot frame.
    pub rotation: UnitQuaternion<f64>,
}

/// The body parts of the wearer that cameras on his chest can see.
#[derive(Clone, Debug)]
pub struct Wearer {
    /// All parts.
    pub parts: Vec<(Part, Body)>,
    /// The tags on the shoes.
    pub tags: Vec<ShoeTag>,
    covers: Vec<Cover>,
}

impl Wearer {
    pub(super) fn make(
        b: &mut Builder,
        tags: &[ShoeTag],
        profile: &GaitProfile,
        faults: &WearerFaults,
    ) -> UnlitWearer {
        let scale = profile.scale();
        let cloth = b.texture(&Recipe {
            radius: [1.0, 50.0],
            contrast: 0.2,
            grain: 0.15,
            mixed: 0.4,
            stretch: 3.0,
        });
        let instance = b.thing();
        let mut stuff = |texel_mm: f32, albedo: [f32; 3], other: [f32; 3]| Stuff {
            material: b.material(Class::Person, cloth, texel_mm, albedo, other),
            instance,
        };
        let trousers = stuff(1.0, [0.06, 0.08, 0.16], [0.1, 0.12, 0.22]);
        let leather = stuff(0.6, [0.2, 0.11, 0.06], [0.26, 0.16, 0.1]);
        let sole = stuff(0.6, [0.5, 0.48, 0.45], [0.4, 0.4, 0.4]);
        // Print: its grain must not blur the edges of the cells.
        let black = stuff(40.0, [0.03; 3], [0.03; 3]);
        let white = stuff(40.0, [0.6; 3], [0.6; 3]);
        let mut meshes = Vec::new();
        for side in [Side::Left, Side::Right] {
            meshes.push((Part::Shoe(side), shoe(leather, sole)));
            let hem = profile.hem_m - ANKLE[2];
            let shank = limb([hem, scale * SHANK_M], [0.048, 0.06], trousers);
            meshes.push((Part::Shank(side), shank));
            let thigh = limb([0.0, scale * THIGH_M], [0.06, 0.085], trousers);
            meshes.push((Part::Thigh(side), thigh));
        }
        for (index, tag) in tags.iter().enumerate() {
            meshes.push((Part::Tag(index), plate(tag, [black, white])));
        }
        let mut covers = Vec::new();
        for (cover, mesh) in over_tags(b, tags, faults, trousers, instance) {
            meshes.push((Part::Cover(covers.len()), mesh));
            covers.push(cover);
        }
        UnlitWearer {
            meshes,
            tags: tags.to_vec(),
            covers,
        }
    }

    /// Pose of a tag in the frame of its foot; `None` if it is lost.
    fn foot_from_tag(
        tag: &ShoeTag,
        faults: &WearerFaults,
        time_s: f64,
    ) -> Option<(Vector3<f64>, UnitQuaternion<f64>)> {
        if faults.strength(Kind::TagLost, tag.side, time_s) > 0.0 {
            return None;
        }
        let slips = faults.of_foot(Kind::TagSlip, tag.side);
        let slip_m: f64 = slips
            .filter(|f| f.from_s <= time_s)
            .map(|f| f.strength)
            .sum();
        // Upwards in the tag is forward on the shoe; it turns in its plane.
        let rotation = tag.rotation * so3::exp(Vector3::z() * (SLIP_TURN * slip_m));
        let position = tag.position - tag.rotation * Vector3::y() * slip_m;
        Some((position, rotation))
    }

    /// Pose of a part in the world.
    pub fn pose(
        &self,
        part: Part,
        walker: &Walker,
        time_s: f64,
    ) -> (Vector3<f64>, UnitQuaternion<f64>) {
        let nowhere = (Vector3::z() * NOWHERE_M, UnitQuaternion::identity());
        let side = match part {
            Part::Shoe(side) | Part::Shank(side) | Part::Thigh(side) => side,
            Part::Tag(index) => {
                let tag = &self.tags[index];
                let foot = walker.foot(tag.side, time_s);
                let on_foot = Self::foot_from_tag(tag, walker.faults(), time_s);
                return on_foot.map_or(nowhere, |(position, rotation)| {
                    (
                        foot.position + foot.rotation * position,
                        foot.rotation * rotation,
                    )
                });
            }
            Part::Cover(index) => {
                let cover = &self.covers[index];
                let on = cover.tag.map_or(Part::Shoe(cover.side), Part::Tag);
                return match (cover.from_s..cover.to_s).contains(&time_s) {
                    true => self.pose(on, walker, time_s),
                    false => nowhere,
                };
            }
        };
        let foot = walker.foot(side, time_s);
        if let Part::Shoe(_) = part {
            return (foot.position, foot.rotation);
        }
        let rig = walker.rig(time_s);
        let sign = match side {
            Side::Left => 1.0,
            Side::Right => -1.0,
        };
        // Hips remain level while the chest leans.
        let ahead = rig.rotation * Vector3::x();
        let yaw = so3::exp(Vector3::z() * libm::atan2(ahead.y, ahead.x));
        let scale = walker.profile().scale();
        let [back, aside, down] = HIP;
        let hip = Vector3::new(back, sign * scale * aside, scale * down);
        let hip = rig.position + yaw * hip;
        let ankle = foot.position + foot.rotation * Vector3::from(ANKLE);
        let forward = yaw * Vector3::x();
        let hip = within_reach(&hip, &ankle, scale);
        let knee = knee(&hip, &ankle, &forward, scale);
        match part {
            Part::Thigh(_) => (knee, along(&(hip - knee), &forward)),
            _ => (ankle, along(&(knee - ankle), &forward)),
        }
    }
}

/// The wearer before lighting.
pub(super) struct UnlitWearer {
    meshes: Vec<(Part, Mesh)>,
    tags: Vec<ShoeTag>,
    covers: Vec<Cover>,
}

impl UnlitWearer {
    /// Applies lighting. Moving bodies are lit without occlusion, in the orientation of a standing
    /// wearer.
    pub(super) fn lit(self, light: &Light) -> Wearer {
        let lit = |(part, mesh): &(Part, Mesh)| -> (Part, Body) {
            let upright = self.upright_from_part(*part);
            let at = |t: &super::mesh::Triangle| {
                let [a, b, c] = t.corners.map(|c| c.position);
                let normal = upright * (b - a).cross(&(c - a)).normalize();
                // A lamp is far from a body compared with the body's size.
                let here = Vector3::new(0.0, 0.0, 0.5);
                [light.irradiance(&here, &normal, |_, _| false) as f32; 3]
            };
            let irradiances: Vec<_> = mesh.triangles.iter().map(at).collect();
            (*part, Body::new(mesh, &irradiances))
        };
        Wearer {
            parts: self.meshes.iter().map(lit).collect(),
            tags: self.tags,
            covers: self.covers,
        }
    }

    /// Rotation of the frame of a part to that of a standing wearer, with z up.
    fn upright_from_part(&self, part: Part) -> UnitQuaternion<f64> {
        match part {
            Part::Tag(index) => self.tags[index].rotation,
            Part::Cover(index) => {
                let tag = self.covers[index].tag;
                tag.map_or(UnitQuaternion::identity(), |tag| self.tags[tag].rotation)
            }
            _ => UnitQuaternion::identity(),
        }
    }
}

fn shoe(leather: Stuff, sole: Stuff) -> Mesh {
    let mut mesh = Mesh::default();
    let turn = UnitQuaternion::identity();
    let length = TOE_X - HEEL_X;
    let middle = 0.5 * (TOE_X + HEEL_X);
    let mut block = |x: f64, z: f64, size: [f64; 3], stuff: Stuff| {
        let [l, w, h] = size;
        let center = Vector3::new(x, 0.0, z + 0.5 * h);
        mesh.cuboid(center, Vector3::new(l, w, h), turn, 0.1, stuff);
    };
    block(middle, 0.0, [length, 0.095, 0.025], sole);
    block(middle, 0.025, [length - 0.01, 0.088, 0.035], leather);
    block(HEEL_X + 0.085, 0.06, [0.15, 0.078, 0.045], leather);
    mesh
}

/// A tag with the plate under it, in the tag's frame.
fn plate(tag: &ShoeTag, print: [Stuff; 2]) -> Mesh {
    let mut mesh = Mesh::default();
    let side = tag.size_m * 1.25;
    mesh.cuboid(
        Vector3::new(0.0, 0.0, 0.004),
        Vector3::new(side, side, 0.006),
        UnitQuaternion::identity(),
        1.0,
        print[1],
    );
    tag::draw(&mut mesh, tag.id, tag.size_m, |p| p, print);
    mesh
}

/// What faults put over tags and shoes.
fn over_tags(
    b: &mut Builder,
    tags: &[ShoeTag],
    faults: &WearerFaults,
    cloth: Stuff,
    instance: u16,
) -> Vec<(Cover, Mesh)> {
    let mut covers = Vec::new();
    let mut mud = None;
    let mut mud = |b: &mut Builder| {
        *mud.get_or_insert_with(|| Stuff {
            // The grain of the cloth.
            material: b.material_like(cloth.material, [0.2, 0.16, 0.11], [0.26, 0.21, 0.15]),
            instance,
        })
    };
    for (index, tag) in tags.iter().enumerate() {
        let cell = tag.size_m / tag::CELLS as f64;
        let half = 0.5 * tag.size_m + cell;
        let mut over = |fault: &Fault, mesh: Mesh| {
            let cover = Cover {
                tag: Some(index),
                side: tag.side,
                from_s: fault.from_s,
                to_s: fault.to_s,
            };
            covers.push((cover, mesh));
        };
        // Seen from outside, against z: x to the right, y down.
        let quad = |mesh: &mut Mesh, [x0, x1]: [f64; 2], [y0, y1]: [f64; 2], z: f64, stuff| {
            let at = |x, y| Vector3::new(x, y, -z);
            let corners = [at(x0, y1), at(x1, y1), at(x1, y0), at(x0, y0)];
            mesh.quad(corners, [x0 - half, y0 - half], stuff);
        };
        for fault in faults.of_foot(Kind::TagDirt, tag.side) {
            let mut mesh = Mesh::default();
            let across = tag::CELLS as u64 + 2;
            let draw = |n: u64| random::uniform(faults.seed(), DIRT + tag.id as u64, n);
            for n in (0..across * across).filter(|n| draw(4 * n) < fault.strength) {
                let size = (0.8 + 0.6 * draw(4 * n + 1)) * cell;
                let [x, y] = [(n % across, 2), (n / across, 3)]
                    .map(|(k, stream)| (k as f64 + 0.6 * draw(4 * n + stream) - 0.3) * cell - half);
                let within = |v: f64| v.clamp(-half, half);
                let [x, y] = [x, y].map(|v| [within(v), within(v + size)]);
                quad(&mut mesh, x, y, DIRT_M, mud(b));
            }
            over(fault, mesh);
        }
        for fault in faults.of_foot(Kind::TagCovered, tag.side) {
            let mut mesh = Mesh::default();
            let y = [-half, 2.0 * half * fault.strength - half];
            quad(&mut mesh, [-half, half], y, COVER_M, mud(b));
            over(fault, mesh);
        }
    }
    for side in [Side::Left, Side::Right] {
        for fault in faults.of_foot(Kind::Trousers, side) {
            let own = tags.iter().filter(|tag| tag.side == side);
            let top = own.flat_map(|tag| {
                let corners = tag::corners(1.25 * tag.size_m);
                corners.map(|corner| (tag.position + tag.rotation * corner).z)
            });
            let z = top.fold(0.11, f64::max) + COVER_M;
            let middle = Vector3::new(CLOTH_X + 0.5 * fault.strength, 0.0, z);
            let size = Vector3::new(fault.strength, 2.0 * CLOTH_HALF_WIDTH_M, 0.004);
            let mut mesh = Mesh::default();
            mesh.cuboid(middle, size, UnitQuaternion::identity(), 0.1, cloth);
            let cover = Cover {
                tag: None,
                side,
                from_s: fault.from_s,
                to_s: fault.to_s,
            };
            covers.push((cover, mesh));
        }
    }
    covers
}

fn limb(ends_m: [f64; 2], radii: [f64; 2], stuff: Stuff) -> Mesh {
    let mut mesh = Mesh::default();
    let ends = ends_m.map(|end| Vector3::z() * end);
    mesh.tube(ends, radii, 12, 0.1, stuff);
    mesh
}

/// The hip, moved towards the ankle if the leg is too short: in a long step the pelvis rotates and
/// drops.
fn within_reach(hip: &Vector3<f64>, ankle: &Vector3<f64>, scale: f64) -> Vector3<f64> {
    let leg = hip - ankle;
    let most = scale * (SHANK_M + THIGH_M) * MAX_LEG_EXTENSION;
    ankle + leg * (most / leg.norm()).min(1.0)
}

/// Position of the knee, in front of the line from hip to ankle, which is within reach.
fn knee(
    hip: &Vector3<f64>,
    ankle: &Vector3<f64>,
    forward: &Vector3<f64>,
    scale: f64,
) -> Vector3<f64> {
    let [shank, thigh] = [SHANK_M, THIGH_M].map(|length| scale * length);
    let leg = ankle - hip;
    let reach = leg.norm().max(0.2);
    let axis = leg.normalize();
    // From the hip along the leg to the foot of the knee's height, by the law of cosines.
    let along = (reach * reach + thigh * thigh - shank * shank) / (2.0 * reach);
    let height = (thigh * thigh - along * along).max(0.0).sqrt();
    let out = (forward - axis * forward.dot(&axis)).normalize();
    hip + axis * along + out * height
}

/// Rotation whose z is along `axis` and whose x is as close to `forward` as possible.
fn along(axis: &Vector3<f64>, forward: &Vector3<f64>) -> UnitQuaternion<f64> {
    let z = axis.normalize();
    let x = (forward - z * forward.dot(&z)).normalize();
    UnitQuaternion::from_basis_unchecked(&[x, z.cross(&x), z])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Kind, by_day};

    #[test]
    fn legs_reach_from_hip_to_ankle_and_knees_point_forward() {
        let scene = by_day(Kind::Pavement, 1);
        let walker = Walker::new(&scene, 1, 20.0);
        let scale = walker.profile().scale();
        let [shank_m, thigh_m] = [SHANK_M, THIGH_M].map(|length| scale * length);
        let mut bent = 0;
        let mut far = 0;
        for k in 0..400 {
            let t = 0.05 * f64::from(k);
            let rig = walker.rig(t);
            let ahead = rig.rotation * Vector3::x();
            for side in [Side::Left, Side::Right] {
                let (ankle, shank) = scene.wearer.pose(Part::Shank(side), &walker, t);
                let (knee, thigh) = scene.wearer.pose(Part::Thigh(side), &walker, t);
                let knee_of_shank = ankle + shank * Vector3::z() * shank_m;
                assert!((knee_of_shank - knee).norm() < 1e-9, "{t} {side:?}");
                let hip = knee + thigh * Vector3::z() * thigh_m;
                let bend = (knee - (hip + ankle) * 0.5).dot(&ahead);
                assert!(bend > -0.02, "{t} {side:?}: {bend}");
                bent += i32::from(bend > 0.15);
                let out = (hip - rig.position).xy().norm() - f64::hypot(HIP[0], HIP[1]);
                let drop = rig.position.z + scale * HIP[2] - hip.z;
                far += i32::from(drop.max(out.abs()) > 0.08);
            }
        }
        // The knee is strongly bent only in a swing, and the pelvis moves by more than is natural
        // only in the longest steps of the jog.
        assert!((40..400).contains(&bent), "{bent} of 800");
        assert!(far < 80, "{far} of 800");
    }
}
