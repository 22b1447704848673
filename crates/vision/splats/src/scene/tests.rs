use cad_transforms::RigidTransform;
use camera_models::Distortion;

use super::{Background, Exposure, Scene};
use crate::camera::Camera;
use crate::config::RenderConfig;
use crate::files::spz;
use crate::reference::tests::{camera, random_splats};
use crate::render::Renderer;

#[test]
fn rotated_scenes_keep_the_colors_of_all_directions() {
    let renderer = Renderer::new(RenderConfig::default()).unwrap();
    let camera = camera((60, 40), Distortion::None);
    let scene = |splats| Scene {
        splats,
        background: Background::Constant([0.1; 3]),
    };
    let splats = random_splats(5, 100, 3);
    let expected = renderer.render(&scene(splats.clone()), &camera, &Exposure::NONE);
    let general = RigidTransform::from_rotation_vector([0.7, -1.1, 0.4], [3.0, -1.0, 2.0]).unwrap();
    for b_from_a in [spz::rub_from_z_up(), general] {
        let pose = *camera.camera_from_world() * b_from_a.inverse();
        let camera: Camera = camera.clone().with_pose(pose);
        let image = renderer.render(
            &scene(splats.transformed(&b_from_a)),
            &camera,
            &Exposure::NONE,
        );
        let differences = image
            .rgb
            .iter()
            .zip(&expected.rgb)
            .flat_map(|(a, b)| a.iter().zip(b));
        let differs = differences.filter(|(a, b)| (*a - *b).abs() > 1e-3).count();
        assert!(differs < 20, "{differs} values differ");
    }
}
