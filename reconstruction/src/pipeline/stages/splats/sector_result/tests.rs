use ::splats::{
    Coverage, ObservedGaussian, ObservedSky, ObservedSpace, SectorConfig, Sky, Splat, Splats,
};
use serde_json::json;

use super::*;
use crate::pipeline::stages::preset::Preset;

/// x of the first Gaussian, m.
const FIRST_M: f32 = 12.3456;

fn config() -> SplatsConfig {
    SplatsConfig::preset(Preset::Fast, None)
}

/// Two cells with a border at 9.5 m.
fn cells() -> Cells {
    let positions: Vec<[f64; 3]> = (0..20).map(|k| [f64::from(k), 0.0, 0.0]).collect();
    Cells::of_positions(&positions, 10, &SectorConfig::default())
}

fn sky(size: usize) -> Background {
    Background::Sky(Sky::uniform(size, [0.5; 3]).expect("a size"))
}

/// With two Gaussians of a degree at x from [`FIRST_M`] on.
fn splats(degree: usize, second_m: f32) -> Splats {
    let mut splats = Splats::empty(degree).expect("a degree");
    for x in [FIRST_M, second_m] {
        let mut splat = Splat::sphere(0.1, [0.5; 3]);
        splat.position_m = [x, 0.0, 1.0];
        splats.push(&splat).expect("finite");
    }
    splats
}

fn coverage(count: usize, [voxel_m, range_m]: [f32; 2], sky_texels: usize) -> Coverage {
    Coverage::new(
        vec![ObservedGaussian::default(); count],
        ObservedSpace::new(voxel_m, range_m),
        ObservedSky::none(sky_texels),
    )
}

/// The second of two sectors.
fn trained() -> SectorResult {
    let of = config().coverage;
    SectorResult {
        found: ImageSummary {
            training: vec![20, 21, 24],
            held_out: vec![22],
            all: 5,
            inside: 4,
            masked: 1,
            ..ImageSummary::default()
        },
        part: Some(Part {
            splats: splats(0, 14.0),
            background: sky(config().sky_texels),
            coverage: coverage(2, [of.voxel_m, of.range_m], of.sky_texels),
            start_count: 3,
            checks: Vec::new(),
        }),
        fell_back: Some("it was taken away".to_owned()),
    }
}

/// What is read from a file with these bytes.
fn read(bytes: &[u8]) -> Option<SectorResult> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("splats-001.checkpoint");
    let file = CheckpointFile::new(path, &json!({}), &[]);
    file.write_complete(bytes);
    assert_eq!(file.read_complete().as_deref(), Some(bytes));
    let views = SectorViews {
        training: vec![18, 20, 21, 24, 25],
        held_out: vec![22, 23],
    };
    let expected = SectorSpec {
        sector: 1,
        cells: &cells(),
        views: &views,
        config: &config(),
    };
    SectorResult::read(&file, &expected)
}

type Forge = fn(&mut SectorResult, &mut Part);

/// Each with a hash that is right.
#[test]
fn files_of_complete_sectors_that_no_training_wrote_are_discarded() {
    let whole = trained();
    let bytes = whole.to_bytes().expect("bytes");
    assert_eq!(read(&bytes), Some(whole.clone()));
    let mut without = whole.clone();
    without.part = None;
    assert_eq!(read(&without.to_bytes().expect("bytes")), Some(without));

    let forged: [(&str, Forge); 14] = [
        ("a view of no sector", |of, _| of.found.training[2] = 4000),
        ("a view of another sector", |of, _| of.found.training[0] = 2),
        ("a held-out view", |of, _| of.found.training[2] = 22),
        ("a view twice", |of, _| of.found.training[1] = 20),
        ("another order", |of, _| of.found.training.swap(0, 1)),
        ("a view of the training", |of, _| of.found.held_out[0] = 20),
        ("no view", |of, _| of.found.training.clear()),
        ("no Gaussian", |_, part| {
            part.splats = Splats::empty(0).expect("a degree");
            part.coverage = coverage(0, [0.25, 20.0], 32);
        }),
        ("beyond the cell", |_, part| part.splats = splats(0, 9.0)),
        ("degree", |_, part| part.splats = splats(1, 14.0)),
        ("sky", |_, part| part.background = sky(64)),
        ("no sky", |_, part| {
            part.background = Background::Constant([0.0; 3]);
        }),
        ("sky that was seen", |_, part| {
            part.coverage = coverage(2, [0.25, 20.0], 16);
        }),
        ("voxels", |_, part| {
            part.coverage = coverage(2, [0.5, 20.0], 32);
        }),
    ];
    for (what, forge) in forged {
        let mut of = trained();
        let mut part = of.part.take().expect("a part");
        forge(&mut of, &mut part);
        of.part = Some(part);
        assert_eq!(read(&of.to_bytes().expect("bytes")), None, "{what}");
    }
    // Not finite.
    let first = FIRST_M.to_le_bytes();
    let at = bytes.windows(4).position(|of| of == first);
    let at = at.expect("the first mean");
    for mean in [f32::NAN, f32::INFINITY] {
        let mut forged = bytes.clone();
        forged[at..at + 4].copy_from_slice(&mean.to_le_bytes());
        assert_eq!(read(&forged), None, "{mean}");
    }
    // Bytes before and after.
    for length in 0..bytes.len() {
        assert!(
            SectorResult::from_bytes(&bytes[..length]).is_err(),
            "{length}"
        );
    }
}
