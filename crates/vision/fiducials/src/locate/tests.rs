use boards::Dictionary;
use imaging::ImageView;

use super::*;
use crate::test_images::{CLEAN, Draw, Imaging, SIZE, lens, render};

/// Two cells and a half of blur, and an orientation that is wrong by 0.12 rad.
#[test]
fn blurred_tags_are_located_within_a_cell() {
    let tag = Tag::new(Dictionary::AprilTag36h11, 1, 0.06).unwrap();
    let lens = lens();
    let mut draw = Draw(5);
    for exposure_s in [0.0, 0.004, 0.008] {
        let motion = Motion {
            linear: [1.9, 1.2, 0.0],
            angular: [0.0; 3],
        };
        let imaging = Imaging {
            exposure_s,
            noise: 3.0,
            ..CLEAN
        };
        let eye = RigidTransform::identity();
        for _ in 0..8 {
            let yaw = 0.5 * draw.bell();
            let at = [0.04 * draw.bell(), 0.02 * draw.bell(), 1.1];
            let truth = RigidTransform::from_rotation_vector([0.1, 0.15, yaw], at).unwrap();
            let pixels = render(&lens, &tag, &eye, &truth, &motion, &imaging, &mut draw);
            let view = View {
                image: ImageView::packed(SIZE[0], SIZE[1], &pixels).unwrap(),
                lens: &lens,
                eye_from_reference: eye,
                line_s: 0.0,
                exposure_s,
            };
            let start = |turn: f64| {
                RigidTransform::from_rotation_vector([0.0, 0.1, yaw + turn], [0.0, 0.0, 1.12])
                    .unwrap()
            };
            let starts = [start(-0.28), start(0.12), start(0.5)];
            let plane = ([0.0, 0.0, 1.0], 0.3);
            let config = LocateConfig::default();
            let found = locate(&view, &tag, &starts, &motion, plane, &config).expect("a place");
            let error = found.reference_from_tag.translation() - truth.translation();
            let cells = error.xy().norm() / tag.cell_m();
            assert!(cells < 1.5, "{exposure_s} {cells} {}", found.correlation);
            let other = Tag::new(Dictionary::AprilTag36h11, 7, 0.06).unwrap();
            let wrong = locate(&view, &other, &starts, &motion, plane, &config);
            assert!(wrong.is_none_or(|wrong| wrong.correlation < found.correlation));
        }
    }
}

#[test]
fn an_image_without_a_tag_has_no_place() {
    let lens = lens();
    let pixels: Vec<u8> = (0..SIZE[0] * SIZE[1])
        .map(|k| (90 + (k * 7919) % 40) as u8)
        .collect();
    let view = View {
        image: ImageView::packed(SIZE[0], SIZE[1], &pixels).unwrap(),
        lens: &lens,
        eye_from_reference: RigidTransform::identity(),
        line_s: 0.0,
        exposure_s: 0.0,
    };
    let tag = Tag::new(Dictionary::AprilTag36h11, 1, 0.06).unwrap();
    let start = RigidTransform::from_translation_m([0.0, 0.0, 1.1]).unwrap();
    let plane = ([0.0, 0.0, 1.0], 0.3);
    let config = LocateConfig::default();
    assert_eq!(
        locate(&view, &tag, &[start], &Motion::default(), plane, &config),
        None
    );
}
