use super::*;

fn camera(distortion: Distortion) -> CameraModel {
    CameraModel {
        width: 752,
        height: 480,
        fx: 458.654,
        fy: 457.296,
        cx: 367.215,
        cy: 248.375,
        distortion,
    }
}

const EUROC: Distortion = Distortion::RadTan4 {
    k1: -0.28340811,
    k2: 0.07395907,
    p1: 0.00019359,
    p2: 1.76187114e-05,
};

#[test]
fn larger_models_of_the_family_are_exact() {
    let mut model = camera(Distortion::None);
    for target in [
        LensModel::Radial2,
        LensModel::RadTan4,
        LensModel::RadTan5,
        LensModel::Rational8,
    ] {
        let found = convert(&model, target).unwrap();
        assert!(found.exact && found.max_px == 0.0 && found.lost == 0.0);
        assert_eq!(LensModel::of(&found.model.distortion), target);
        model = found.model;
    }
    // And the reverse, since all coefficients are 0.
    assert_eq!(
        convert(&model, LensModel::None).unwrap().model,
        camera(Distortion::None)
    );

    let wide = convert(&camera(EUROC), LensModel::Rational8).unwrap();
    assert!(wide.exact);
    assert_eq!(
        exactly(&wide.model.distortion, LensModel::RadTan4),
        Some(EUROC)
    );
    assert_eq!(exactly(&EUROC, LensModel::Radial2), None);
    // The copied coefficients give the same pixels.
    let (a, b) = (Lens::new(&camera(EUROC)), Lens::new(&wide.model));
    assert_eq!(a.project([0.4, -0.2, 1.0]), b.project([0.4, -0.2, 1.0]));
}

/// The stated errors hold on pixels that neither grid has.
fn check(source: &CameraModel, target: LensModel, most_px: f64, lost: f64) -> Conversion {
    let found = convert(source, target).unwrap();
    println!("{} -> {found}", source.distortion.name());
    assert!(found.max_px <= most_px, "{found}");
    assert!(
        found.rms_px <= found.max_px && found.lost <= lost,
        "{found}"
    );
    let (a, b) = (Lens::new(source), Lens::new(&found.model));
    for i in 0..5000_u32 {
        // A low-discrepancy sequence.
        let part = |step: f64| (f64::from(i) * step).fract();
        let pixel = [
            part(0.754_877_666) * f64::from(source.width) - 0.5,
            part(0.569_840_291) * f64::from(source.height) - 0.5,
        ];
        let Some(direction) = a.unproject(pixel) else {
            continue;
        };
        let Some([x, y]) = b.project(direction) else {
            continue;
        };
        let angle = direction[0].hypot(direction[1]).atan2(direction[2]);
        if found.lost_from_rad.is_some_and(|from| angle > from) {
            continue;
        }
        let off = (x - pixel[0]).hypot(y - pixel[1]);
        // Between the points of the grid the error can be a little larger.
        assert!(
            off <= 1.05 * found.max_px + 1e-6,
            "{off} px at {pixel:?}: {found}"
        );
    }
    found
}

#[test]
fn a_moderate_lens_in_every_model() {
    let source = camera(EUROC);
    check(&source, LensModel::None, 200.0, 0.0);
    check(&source, LensModel::Radial2, 0.3, 0.0);
    // Models without tangential terms cannot follow them into the corners.
    check(&source, LensModel::KannalaBrandt4, 1.5, 0.0);
    // Nor can these two follow a polynomial that grows again at the corners.
    for target in [LensModel::DoubleSphere, LensModel::Eucm] {
        assert!(check(&source, target, 25.0, 0.0).rms_px < 1.5);
    }
}

#[test]
fn conversion_and_inverse_agree() {
    // A lens without tangential terms: a flexible model approximates another closely.
    let ds = camera(Distortion::DoubleSphere {
        xi: -0.24,
        alpha: 0.567,
    });
    let kb = check(&ds, LensModel::KannalaBrandt4, 0.02, 0.0);
    let back = check(&kb.model, LensModel::DoubleSphere, 0.02, 0.0);
    for (a, b) in ds.parameters().iter().zip(back.model.parameters()) {
        assert!((a - b).abs() < 2e-3 * a.abs(), "{:?}", back.model);
    }
    let rational = check(&ds, LensModel::Rational8, 0.1, 0.0);
    check(&rational.model, LensModel::Eucm, 0.2, 0.0);
}

#[test]
fn a_fisheye_loses_its_edge_in_a_pinhole_model() {
    let wide = CameraModel {
        width: 512,
        height: 512,
        fx: 190.978,
        fy: 190.973,
        cx: 254.93,
        cy: 256.9,
        distortion: Distortion::KannalaBrandt4 {
            k1: 0.0034,
            k2: 0.0007,
            k3: -0.002,
            k4: 0.0002,
        },
    };
    let found = convert(&wide, LensModel::RadTan5).unwrap();
    println!("{found}");
    assert!(found.lost > 0.1 && found.lost < 0.6, "{found}");
    assert!(found.lost_from_rad.unwrap() > 50_f64.to_radians());
    // A smaller range gives a smaller error.
    let middle = convert_within(&wide, LensModel::RadTan5, 50_f64.to_radians()).unwrap();
    println!("{middle}");
    assert!(
        middle.max_px < 0.3 && middle.max_px < found.max_px,
        "{middle}"
    );
    assert!(middle.lost_from_rad.unwrap() > 50_f64.to_radians());
    assert!(matches!(
        convert_within(&wide, LensModel::RadTan5, 0.01),
        Err(ConvertError::TooFew { .. })
    ));
    let eucm = check(&wide, LensModel::Eucm, 3.0, 0.05);
    assert!(!eucm.exact);
}
