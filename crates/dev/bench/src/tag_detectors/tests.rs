use super::conditions::Curve;
use super::*;

fn condition() -> Condition {
    Condition {
        size_px: 40.0,
        noise_levels: 0.0,
        curve: Curve::Linear,
        ..USUAL
    }
}

#[test]
fn rendered_tag_is_where_the_truth_is() {
    let renderer = Renderer::new(Camera::new(Resolution::Vga)).unwrap();
    let camera = renderer.camera();
    for (seed, motion_cells) in [(3, 0.0), (4, 0.0), (5, 1.0)] {
        let condition = Condition {
            motion_cells,
            ..condition()
        };
        let scene = Scene::new(camera, &condition, seed, true).unwrap();
        let ground = renderer.ground(seed);
        let images = renderer.images(&scene, &condition, &ground).unwrap();
        let scenes = [scene];
        let answers = methods::answers(camera, &scenes, &[images]).unwrap();
        for (answers, limit) in answers.iter().zip([0.4, 0.1, 0.1, 0.1]) {
            let score = score(camera, &scenes, answers).unwrap();
            assert_eq!([score.found, score.wrong], [1, 0], "{seed}: {score:?}");
            assert!(score.corner_rms_px < limit, "{seed}: {score:?}");
        }
    }
}

#[test]
fn same_seed_gives_the_same_image() {
    let renderer = Renderer::new(Camera::new(Resolution::Vga)).unwrap();
    let image = |seed, has_tag| {
        let scene = Scene::new(renderer.camera(), &USUAL, seed, has_tag).unwrap();
        let ground = renderer.ground(seed);
        renderer.images(&scene, &USUAL, &ground).unwrap()
    };
    assert_eq!(image(1, true), image(1, true));
    assert_ne!(image(1, true), image(2, true));
    assert_ne!(image(1, true), image(1, false));
}
