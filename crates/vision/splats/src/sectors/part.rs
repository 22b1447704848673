//! What the training of a sector leaves.

use crate::confidence::{Coverage, Directions, ObservedGaussian, ObservedSky, ObservedSpace};
use crate::error::SplatError;
use crate::scene::{Background, Plane, Scene, Sky, Splats};
use crate::train::{Codec, GrowthCheck, State, broken};

/// The Gaussians of a sector with what is known of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Gaussians with their means in the cell.
    pub splats: Splats,
    /// What was behind them in the training.
    pub background: Background,
    /// What the views of the training saw of the Gaussians, of space and of the sky.
    pub coverage: Coverage,
    /// Number of Gaussians at the start of the training, those beyond the cell among them.
    pub start_count: usize,
    /// Checks of growth.
    pub checks: Vec<GrowthCheck>,
}

impl Part {
    /// The part of a trained scene whose means are where `is_inside` says, world, m. The order of
    /// the Gaussians remains. Space and sky are kept whole: they were seen from wherever.
    ///
    /// # Panics
    /// If the coverage is not one of the scene.
    pub fn cut(
        scene: &Scene,
        coverage: &Coverage,
        (start_count, checks): (usize, Vec<GrowthCheck>),
        is_inside: impl Fn([f64; 3]) -> bool,
    ) -> Self {
        let planes = &scene.splats.planes()[Plane::POSITION..];
        let mean = |k: usize| [0, 1, 2].map(|axis| f64::from(planes[axis][k]));
        let inside = (0..scene.splats.len()).filter(|k| is_inside(mean(*k)));
        let inside: Vec<u32> = inside.map(|k| k as u32).collect();
        let gaussians = inside.iter().map(|k| coverage.gaussians()[*k as usize]);
        Self {
            splats: scene.splats.select(&inside),
            background: scene.background.clone(),
            coverage: Coverage::new(
                gaussians.collect(),
                coverage.space().clone(),
                coverage.sky().clone(),
            ),
            start_count,
            checks,
        }
    }

    /// The part as bytes, for a file between two runs; numbers keep their bits.
    ///
    /// # Errors
    /// [`SplatError::Sky`] if the sky is not finite.
    pub fn to_bytes(&self) -> Result<Vec<u8>, SplatError> {
        let mut codec = Codec::Write(Vec::new());
        self.clone().visit(&mut codec)?;
        match codec {
            Codec::Write(bytes) => Ok(bytes),
            Codec::Read(_) => Ok(Vec::new()),
        }
    }

    /// The reverse. Any bytes are accepted.
    ///
    /// # Errors
    /// [`SplatError::Checkpoint`] and those of Gaussians and of the sky if the bytes are not those
    /// of a part.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, SplatError> {
        let mut part = Self {
            splats: Splats::empty(0)?,
            background: Background::Constant([0.0; 3]),
            coverage: Coverage::new(
                Vec::new(),
                ObservedSpace::new(0.0, 0.0),
                ObservedSky::none(2),
            ),
            start_count: 0,
            checks: Vec::new(),
        };
        let mut codec = Codec::Read(bytes);
        part.visit(&mut codec)?;
        match codec {
            Codec::Read([]) => {}
            _ => return Err(broken("it has more bytes than its part")),
        }
        match part.coverage.gaussians().len() == part.splats.len() {
            true => Ok(part),
            false => Err(broken("its lists are of different numbers of Gaussians")),
        }
    }
}

impl State for Part {
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        let mut degree = self.splats.degree();
        degree.visit(codec)?;
        let mut planes = match codec {
            Codec::Write(_) => self.splats.planes().to_vec(),
            Codec::Read(_) => Vec::new(),
        };
        planes.visit(codec)?;
        if let Codec::Read(_) = codec {
            self.splats = Splats::from_planes(degree, planes)?;
        }
        let mut size = match &self.background {
            Background::Constant(_) => 0,
            Background::Sky(sky) => sky.size(),
        };
        size.visit(codec)?;
        let mut texels = match &self.background {
            Background::Constant(color) => vec![*color],
            Background::Sky(sky) => sky.texels().to_vec(),
        };
        texels.visit(codec)?;
        self.background = match (size, texels.as_slice()) {
            (0, [color]) => Background::Constant(*color),
            _ => Background::Sky(Sky::from_texels(size, texels)?),
        };
        visit_coverage(&mut self.coverage, codec)?;
        self.start_count.visit(codec)?;
        self.checks.visit(codec)
    }
}

fn visit_coverage(coverage: &mut Coverage, codec: &mut Codec<'_>) -> Result<(), SplatError> {
    let mut gaussians = coverage.gaussians().to_vec();
    gaussians.visit(codec)?;
    let space = coverage.space();
    let mut sizes = [space.voxel_m(), space.range_m()];
    sizes.visit(codec)?;
    let blocks = space.blocks();
    let mut blocks: Vec<Block> = blocks.map(|(index, bits)| Block { index, bits }).collect();
    blocks.visit(codec)?;
    let mut size = coverage.sky().size();
    size.visit(codec)?;
    let mut texels = coverage.sky().texels().to_vec();
    texels.visit(codec)?;
    let blocks = blocks.into_iter().map(|block| (block.index, block.bits));
    *coverage = Coverage::new(
        gaussians,
        ObservedSpace::from_blocks(sizes, blocks),
        ObservedSky::from_texels(size, texels)?,
    );
    Ok(())
}

/// Block of voxels.
#[derive(Clone, Copy, Debug, Default)]
struct Block {
    index: [i32; 3],
    bits: u64,
}

impl State for Block {
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        self.index.visit(codec)?;
        self.bits.visit(codec)
    }
}

impl State for ObservedGaussian {
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        self.instants.visit(codec)?;
        let Directions(bits) = &mut self.directions;
        bits.visit(codec)?;
        self.finest_m.visit(codec)?;
        self.color_error.visit(codec)?;
        self.depth_error.visit(codec)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Splat;

    fn scene() -> (Scene, Coverage) {
        let mut splats = Splats::empty(1).expect("a degree");
        let mut gaussians = Vec::new();
        for k in 0..10_u16 {
            let mut splat = Splat::sphere(0.1, [0.1, 0.5, 0.9]);
            splat.position_m = [f32::from(k), 0.5, -1.0];
            splat.harmonics[2] = [0.01 * f32::from(k); 3];
            splats.push(&splat).expect("finite");
            gaussians.push(ObservedGaussian {
                instants: u32::from(k),
                directions: Directions(1 << k),
                finest_m: 0.01,
                color_error: 0.2,
                depth_error: 0.125,
            });
        }
        let mut space = ObservedSpace::new(0.25, 20.0);
        space.insert_ray([0.0; 3], [-1.0, 0.0, 0.0], 5.0);
        let mut sky = ObservedSky::none(8);
        sky.insert([0.0, 0.1, 1.0]);
        let background = Background::Sky(Sky::uniform(4, [0.1, 0.2, 0.3]).expect("a size"));
        let scene = Scene { splats, background };
        (scene, Coverage::new(gaussians, space, sky))
    }

    fn part() -> Part {
        let (scene, coverage) = scene();
        let check = GrowthCheck {
            step: 300,
            gain_db: 0.1,
            continues: true,
            ..GrowthCheck::default()
        };
        Part::cut(&scene, &coverage, (7, vec![check]), |[x, ..]| x >= 6.0)
    }

    #[test]
    fn a_part_has_the_gaussians_of_its_cell_and_what_was_seen_of_them() {
        let (scene, coverage) = scene();
        let part = part();
        assert_eq!(part.splats.planes()[0], [6.0, 7.0, 8.0, 9.0]);
        assert_eq!(part.coverage.gaussians(), &coverage.gaussians()[6..]);
        assert_eq!(part.coverage.space(), coverage.space());
        assert_eq!(part.splats.get(1), scene.splats.get(7));
        let all = Part::cut(&scene, &coverage, (0, Vec::new()), |_| true);
        assert_eq!((&all.splats, &all.coverage), (&scene.splats, &coverage));
    }

    #[test]
    fn bytes_give_the_same_part_and_no_others_do() {
        let part = part();
        let bytes = part.to_bytes().expect("bytes");
        assert_eq!(Part::from_bytes(&bytes).as_ref(), Ok(&part));
        for length in 0..bytes.len() {
            assert!(Part::from_bytes(&bytes[..length]).is_err(), "{length}");
        }
        let mut more = bytes.clone();
        more.push(0);
        assert!(Part::from_bytes(&more).is_err());
        let mut constant = part;
        constant.background = Background::Constant([0.5, 0.25, 0.0]);
        let bytes = constant.to_bytes().expect("bytes");
        assert_eq!(Part::from_bytes(&bytes), Ok(constant));
    }
}
