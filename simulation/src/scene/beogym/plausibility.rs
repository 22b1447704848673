//! Whether what a folder of generation 1 states can be true; what cannot is reported beside what
//! the folder does not have.

use crate::scene::data::Missing;
use crate::scene::sector::Sector;
use crate::scene::similarity::Similarity;

/// Share of the camera poses of a sector within the map, below which the map is one of another
/// place.
const MIN_SHARE_ON_MAP: f64 = 0.5;

/// What is implausible about sectors, each with the transform of its file.
pub(super) fn implausible(sectors: &[Sector], transforms: &[Similarity]) -> Vec<Missing> {
    let missing = |place: &str, output: &str, features: String| Missing {
        place: place.to_owned(),
        output: output.to_owned(),
        features,
    };
    let mut all = Vec::new();
    for (number, (sector, transform)) in sectors.iter().zip(transforms).enumerate() {
        let same = transforms[..number]
            .iter()
            .position(|other| other == transform);
        if let Some(same) = same {
            let features = format!("place in the world: it has that of {}", sectors[same].name);
            all.push(missing(
                &sector.name,
                "transformation.txt of its own",
                features,
            ));
        }
        if let Some(share) = share_on_map(sector).filter(|share| *share < MIN_SHARE_ON_MAP) {
            let features = format!(
                "agents on the ground in most of it: the map has {:.0} % of its camera poses",
                100.0 * share
            );
            all.push(missing(&sector.name, "map where it was recorded", features));
        }
    }
    all
}

/// Share of the camera poses of a sector within the grid of its lowest level; `None` without poses
/// or map.
fn share_on_map(sector: &Sector) -> Option<f64> {
    let grid = sector.levels.as_ref()?.first()?.grid;
    let on_map = sector.references.iter().filter(|pose| {
        let [x, y, _] = pose.translation_m();
        grid.cell([x, y]).is_some()
    });
    let count = sector.references.len();
    (count > 0).then(|| on_map.count() as f64 / count as f64)
}
