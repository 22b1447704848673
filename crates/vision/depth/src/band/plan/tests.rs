use super::*;
use crate::reference::Random;

const NONE: Margin = Margin {
    px: 0,
    ratio: 0.0,
    rows: 0,
};

#[test]
fn plan_contains_all_added_disparities() {
    let full = Band::full(0, 64, 24).unwrap();
    let mut plan = Plan::new(&full);
    assert_eq!(plan.finish(&NONE).unwrap(), full);
    for y in 0..24 {
        plan.add(y, [10, 12]);
    }
    plan.add(9, [30, 31]);
    plan.add(99, [0, 63]);
    let band = plan.finish(&NONE).unwrap();
    assert_eq!(
        [0, 8, 15, 16].map(|y| band.row(y)),
        [[10, 12], [10, 31], [10, 31], [10, 12]]
    );
    let margin = Margin {
        px: 2,
        ratio: 0.1,
        rows: 2,
    };
    let wide = plan.finish(&margin).unwrap();
    // 10 - 2 - 1 to 12 + 2 + 2, and 31 + 2 + 4 where the margin includes row 9.
    assert_eq!([0, 8, 16].map(|y| wide.row(y)), [[7, 37], [7, 37], [7, 16]]);
    plan.add(3, [-50, 500]);
    assert_eq!(plan.finish(&margin).unwrap().row(3), [0, 63]);
}

#[test]
fn plane_adds_the_disparities_of_its_ray_intersections() {
    let geometry = Geometry {
        focal_px: 300.0,
        center: [159.5, 79.5],
        baseline_m: 0.1,
        offset_px: 0.0,
    };
    // Ground plane 1.5 m below a level camera with a small roll.
    let roll: f64 = 0.05;
    let plane = Plane {
        normal: [roll.sin(), roll.cos(), 0.0],
        distance_m: 1.5,
    };
    let mut plan = Plan::new(&Band::full(0, 64, 160).unwrap());
    for y in 0..160 {
        plan.add(y, [1, 1]);
    }
    plan.add_plane(&geometry, 320, &plane);
    let band = plan.finish(&NONE).unwrap();
    for (x, y) in [(0, 150), (319, 150), (200, 100), (319, 95)] {
        // Intersection of the ray of this pixel with the ground.
        let ray = [
            (f64::from(x) - 159.5) / 300.0,
            (f64::from(y) - 79.5) / 300.0,
        ];
        let depth = 1.5 / (ray[0] * roll.sin() + ray[1] * roll.cos());
        let disparity = geometry.disparity_px(depth);
        let [low, high] = band.row(y as usize).map(f64::from);
        assert!(
            low <= disparity && disparity <= high,
            "{x} {y} {disparity} {low} {high}"
        );
        assert!(high <= disparity + 3.0, "{high} {disparity}");
    }
    // The ground adds nothing above the horizon.
    assert_eq!(band.row(20), [1, 1]);
}

#[test]
fn probe_finds_a_new_near_object() {
    let mut random = Random(61);
    let (width, height) = (256, 96);
    let wide = width + 80;
    let (back, front) = (random.scene(wide, height), random.scene(wide, height));
    let mut eyes = [vec![0; width * height], vec![0; width * height]];
    for (eye, pixels) in eyes.iter_mut().enumerate() {
        for (i, pixel) in pixels.iter_mut().enumerate() {
            let (x, y) = (i % width, i / width);
            // Background at 6 px, with a box of 40 x 32 pixels at 48 px.
            let of_box = x + 48 * eye;
            *pixel = match (100..140).contains(&of_box) && (30..62).contains(&y) {
                true => front[y * wide + of_box],
                false => back[y * wide + x + 6 * eye],
            };
        }
    }
    let full = Band::full(0, 128, height).unwrap();
    let mut probe = Probe::new(&full, width).unwrap().unwrap();
    let images = [0, 1].map(|eye| ImageView::packed(width, height, &eyes[eye]).unwrap());
    let mut plan = Plan::new(&full);
    probe.search(&images[0], &images[1], &mut plan).unwrap();
    let band = plan.finish(&Margin::default()).unwrap();
    let holds = |y: usize, d: i32| band.row(y)[0] <= d && d <= band.row(y)[1];
    assert!((0..height).all(|y| holds(y, 6)), "{band:?}");
    assert!((34..58).all(|y| holds(y, 48)), "{band:?}");
    assert!(band.row(0)[1] < 48, "{band:?}");
    let other = ImageView::packed(128, 64, &eyes[0][..128 * 64]).unwrap();
    assert!(probe.search(&other, &other, &mut plan).is_err());
}

#[test]
fn small_images_have_no_probe() {
    let full = Band::full(0, 16, 40).unwrap();
    assert!(Probe::new(&full, 300).unwrap().is_none());
}
