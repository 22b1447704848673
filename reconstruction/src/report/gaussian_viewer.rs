//! The view of the scene of Gaussians: WebGL2, with everything it needs in the page.
//!
//! Contract: as of the view of the cloud; at most [`MAX_COUNT`] Gaussians, which take at most
//! 8.6 MB of text. `gaussian_viewer.js` draws them as the crate `splats` does with a pinhole
//! camera: without lens distortion, rolling shutter and exposure, with harmonics up to degree 1,
//! rounded as [`gaussian_packing`] states, and blended in 8 bits.

use serde_json::json;
use splats::{Background, Scene};

use super::fly_path::FlyPath;
use super::gaussian_packing;
use super::viewer_page::{self, Template};

const TEMPLATE: Template = Template {
    html: include_str!("gaussian_viewer.html"),
    script: include_str!("gaussian_viewer.js"),
};

/// Largest number of Gaussians in a view.
pub(super) const MAX_COUNT: usize = 200_000;

/// The view as HTML.
pub(super) struct GaussianViewer {
    pub(super) html: String,
    /// Number of Gaussians in it.
    pub(super) count: usize,
    /// Degree of their harmonics.
    pub(super) degree: usize,
    /// Text of the Gaussians in it, bytes.
    pub(super) bytes: usize,
}

/// Renders the view; `paths` are those of its flights, at least one.
pub(super) fn viewer(scene: &Scene, compensated: bool, paths: &[FlyPath]) -> GaussianViewer {
    let packed = gaussian_packing::pack(&scene.splats, MAX_COUNT);
    let (size, texels) = match &scene.background {
        Background::Constant(color) => (1, vec![*color]),
        Background::Sky(sky) => (sky.size(), sky.texels().to_vec()),
    };
    let paths: Vec<_> = paths
        .iter()
        .map(|path| json!({"name": path.name, "step_s": path.step_s, "poses": path.poses}))
        .collect();
    let header = json!({
        "count": packed.count,
        "degree": packed.degree,
        "scales": packed.scales,
        "compensates": compensated,
        "sky": size,
        "paths": paths,
    });
    let sky = texels.as_flattened().iter();
    let bytes = [&packed.shapes, &packed.harmonics]
        .map(|blob| viewer_page::text_bytes(blob.len()))
        .iter()
        .sum();
    let blobs = [
        ("gaussians-shapes".to_owned(), packed.shapes),
        ("gaussians-harmonics".to_owned(), packed.harmonics),
        (
            "gaussians-sky".to_owned(),
            sky.flat_map(|v| v.to_le_bytes()).collect(),
        ),
    ];
    GaussianViewer {
        html: TEMPLATE.fill("gaussians-data", &header, &blobs),
        count: packed.count,
        degree: packed.degree,
        bytes,
    }
}

#[cfg(test)]
mod tests {
    use splats::{Sky, Splat, Splats};

    use super::*;

    const MAX_BYTES: usize = 8_600_000;

    fn scene(count: usize, degree: usize) -> Scene {
        let mut splats = Splats::empty(degree).expect("a degree");
        for i in 0..count {
            let mut splat = Splat::sphere(0.1, [0.2, 0.4, 0.9]);
            splat.position_m = [i as f32 * 0.01, (i % 97) as f32, 0.0];
            splats.push(&splat).expect("a Gaussian");
        }
        let sky = Sky::uniform(32, [0.5, 0.7, 0.9]).expect("a sky");
        Scene {
            splats,
            background: Background::Sky(sky),
        }
    }

    fn path(name: &str) -> FlyPath {
        FlyPath {
            name: name.to_owned(),
            step_s: 0.5,
            poses: vec![[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]; 1000],
        }
    }

    #[test]
    fn the_program_is_short_and_fetches_nothing() {
        assert!(TEMPLATE.lines().count() <= 600);
        let longest = TEMPLATE.lines().map(|line| line.chars().count()).max();
        assert!(longest <= Some(140), "{longest:?}");
        let view = viewer(&scene(3, 1), true, &[path("a </script> camera")]);
        let page = charts::Page::new("p").embed(&view.html).to_html();
        assert_eq!(charts::inspect(&page), Ok(()));
        for text in ["<!--", "/*SHARED*/", "a </script>"] {
            assert!(!view.html.contains(text), "{text}");
        }
        for text in ["data-none=\"\"", "needs JavaScript and WebGL2"] {
            assert!(view.html.contains(text), "{text}");
        }
        for text in ["prefers-reduced-motion: reduce", "\"compensates\":true"] {
            assert!(view.html.contains(text), "{text}");
        }
    }

    #[test]
    fn many_gaussians_fit_the_size_limit() {
        let of = scene(MAX_COUNT + 1000, 3);
        let view = viewer(&of, false, &[path("a"), path("b"), path("c")]);
        assert_eq!((view.count, view.degree), (MAX_COUNT, 1));
        assert!(view.bytes <= MAX_BYTES, "{}", view.bytes);
        let rest = TEMPLATE.bytes() + 400_000;
        assert!(view.html.len() <= MAX_BYTES + rest, "{}", view.html.len());
        assert!(view.html == viewer(&of, false, &[path("a"), path("b"), path("c")]).html);
    }
}
