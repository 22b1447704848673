//! Sections of the page about feet and ground: footsteps on the height map, feet over time, the
//! mesh.
//!
//! Contract: everything is in the world of the bundle; ground truth is aligned with it. What is
//! missing is named and left out.

use cad_transforms::RigidTransform;
use cad_transforms::rig::Foot;
use charts::{Axis, BREAK, Cell, Chart, Image, Page, Series, Span, Table, Timeline, si};
use scene_bundle::outputs::cloud::CloudPoint;
use scene_bundle::outputs::contacts::FootContact;
use scene_bundle::outputs::feet::{FootPose, FootStatus};
use scene_bundle::outputs::maps::MapLevel;
use scene_bundle::outputs::terrain::{MeshDetail, TerrainMesh};
use scene_bundle::outputs::{self, CONTACTS, FEET, MAPS, RIG_REFINED, TERRAIN};
use scene_bundle::{BundleError, Scene};

use super::footstep_map::{Footstep, FootstepMap};
use super::png_file::png;
use super::{footstep_map, point_raster, views};
use crate::evaluate::Similarity;
use crate::evaluate::feet::{FeetEvaluation, GroundEvaluation, evaluate_feet, evaluate_ground};
use crate::evaluate::ground_truth::GroundTruth;
use crate::pipeline::stages::soles;

/// Feet and ground of a bundle; empty where it has none.
pub(super) struct Ground<'a> {
    contacts: Vec<FootContact>,
    poses: Vec<FootPose>,
    levels: Vec<MapLevel>,
    mesh: Option<TerrainMesh>,
    /// Outlines of the soles of both feet, m.
    soles: [Vec<[f64; 2]>; 2],
    /// Ground truth, and what takes the bundle's world to its one.
    truth: Option<(&'a GroundTruth, Similarity)>,
}

impl<'a> Ground<'a> {
    pub(super) fn read(
        scene: &Scene,
        truth: Option<&'a GroundTruth>,
        true_from_estimated: Option<Similarity>,
    ) -> Result<Self, BundleError> {
        let output = |name: &str| scene.has(name).then(|| scene.output(name)).transpose();
        let contacts = output(CONTACTS)?.map(|o| outputs::contacts::read(&o));
        let poses = output(FEET)?.map(|o| outputs::feet::read(&o));
        let rig = output(RIG_REFINED)?.map(|o| outputs::rig::read(&o));
        let rig = rig.transpose()?;
        let mut levels = Vec::new();
        if let Some(reader) = output(MAPS)? {
            let index = outputs::maps::read_index(&reader)?;
            for number in 0..index.levels.len() {
                levels.push(outputs::maps::read_level(&reader, &index, number)?);
            }
        }
        let mesh = output(TERRAIN)?.map(|reader| {
            let terrain = outputs::terrain::read(&reader)?;
            outputs::terrain::read_mesh(&reader, MeshDetail::Dense, &terrain)
        });
        let soles = Foot::ALL.map(|foot| rig.as_ref().map(|rig| soles::outline(rig, foot)));
        Ok(Self {
            contacts: contacts.transpose()?.unwrap_or_default(),
            poses: poses.transpose()?.unwrap_or_default(),
            levels,
            mesh: mesh.transpose()?,
            soles: soles.map(Option::unwrap_or_default),
            truth: truth.zip(true_from_estimated),
        })
    }

    /// Errors against the ground truth.
    pub(super) fn evaluate(&self) -> Option<(FeetEvaluation, GroundEvaluation)> {
        let (truth, similarity) = self.truth?;
        let times = self.poses.iter().map(|pose| pose.time_ns);
        let (first, last) = (times.clone().min()?, times.max()?);
        Some((
            evaluate_feet(&self.contacts, &self.poses, truth, &similarity),
            evaluate_ground(&self.levels, truth, first..=last, &similarity),
        ))
    }

    /// Number of contacts; with ground truth how many were found, and the errors of contacts and
    /// ground.
    pub(super) fn summary(&self) -> String {
        let Some((feet, ground)) = self.evaluate() else {
            return match self.contacts.len() {
                0 => String::new(),
                count => format!(", {count} footsteps"),
            };
        };
        let position = feet
            .position_m
            .map(|s| format!(" with {} (95 %)", si(s.p95, "m")));
        let height = (ground.height_m)
            .map(|s| format!(", ground below them with {} (95 %)", si(s.p95, "m")));
        format!(
            ", {} of {} footsteps{}{}",
            feet.found,
            feet.contacts,
            position.unwrap_or_default(),
            height.unwrap_or_default()
        )
    }

    /// Adds the sections.
    pub(super) fn add(
        &self,
        page: Page,
        rig_path: &[[f64; 3]],
    ) -> Result<Page, png::EncodingError> {
        let mut page = page.section("Footsteps");
        if self.contacts.is_empty() {
            page = page.text("There are no contacts of feet.");
        } else {
            page = self.feet(page);
        }
        let page = page.section("Terrain");
        self.terrain(page, rig_path)
    }

    fn feet(&self, mut page: Page) -> Page {
        if let Some((feet, ground)) = self.evaluate() {
            page = page.text(
                "Positions are compared after the alignment of the trajectory and contain its error. Events are those of \
                 every contact, seen or not.",
            );
            page = page.table(&errors(&feet, &ground));
        }
        let (footsteps, truth) = (self.footsteps(), self.true_footsteps());
        let map = FootstepMap {
            levels: &self.levels,
            footsteps: &footsteps,
            truth: &truth,
        };
        let caption = match truth.is_empty() {
            true => "Soles at rest on the height map; the left one white, the right one black.",
            false => {
                "Soles at rest on the height map; the left one white, the right one black, ground truth purple below them."
            }
        };
        page = page.drawing(
            |width| footstep_map::svg(&map, width).unwrap_or_default(),
            caption,
        );
        page = page.timeline(&self.statuses(), "");
        for foot in Foot::ALL {
            page = page.chart(&self.height_chart(foot), 220, "");
        }
        page
    }

    fn footsteps(&self) -> Vec<Footstep> {
        let steps = self.contacts.iter();
        let step = |contact: &FootContact| self.footstep(contact.foot, &contact.world_from_foot);
        steps.map(step).collect()
    }

    fn footstep(&self, foot: Foot, world_from_foot: &RigidTransform) -> Footstep {
        Footstep::at(foot, world_from_foot, &self.soles[foot as usize])
    }

    /// True soles at rest within the recording, in the world of the bundle.
    fn true_footsteps(&self) -> Vec<Footstep> {
        let Some((truth, similarity)) = &self.truth else {
            return Vec::new();
        };
        let times = self.poses.iter().map(|pose| pose.time_ns);
        let (Some(first), Some(last)) = (times.clone().min(), times.max()) else {
            return Vec::new();
        };
        let estimated_from_true = similarity.rigid.inverse();
        let is_inside = |time: &Option<i64>| time.is_some_and(|ns| (first..=last).contains(&ns));
        let inside = (truth.contacts.iter()).filter(|own| is_inside(&own.events_ns[1]));
        inside
            .map(|own| self.footstep(own.foot, &(estimated_from_true * own.world_from_foot)))
            .collect()
    }

    /// Seconds since the first pose.
    fn seconds(&self, time_ns: i64) -> f64 {
        let first = self.poses.iter().map(|pose| pose.time_ns).min();
        1e-9 * (time_ns - first.unwrap_or(0)) as f64
    }

    fn of(&self, foot: Foot) -> impl Iterator<Item = &FootPose> {
        self.poses.iter().filter(move |pose| pose.foot == foot)
    }

    fn statuses(&self) -> Timeline {
        let names = FootStatus::ALL.map(FootStatus::name);
        let mut timeline = Timeline::new("Poses of feet", Axis::time("time")).kinds(names);
        for foot in Foot::ALL {
            let poses: Vec<&FootPose> = self.of(foot).collect();
            let seen = poses.iter().filter(|p| p.status == FootStatus::Observed);
            let share = 100.0 * seen.count() as f64 / poses.len().max(1) as f64;
            let spans = poses.chunk_by(|a, b| a.status == b.status).map(|span| {
                let end =
                    poses.partition_point(|pose| pose.time_ns <= span[span.len() - 1].time_ns);
                let end = poses.get(end).unwrap_or(&span[span.len() - 1]);
                Span {
                    from: self.seconds(span[0].time_ns),
                    to: self.seconds(end.time_ns),
                    kind: span[0].status as usize,
                }
            });
            let spans: Vec<Span> = spans.collect();
            timeline = timeline.row(name(foot), &format!("{share:.0} % observed"), spans);
        }
        timeline
    }

    /// Height of the middle of a sole over time.
    fn height_chart(&self, foot: Foot) -> Chart {
        let poses: Vec<&FootPose> = self.of(foot).collect();
        let height = |pose: &FootPose| 100.0 * pose.world_from_foot.translation_m()[2];
        let mut chart = Chart::new(&format!("Height of the sole, {}", name(foot)))
            .x_axis(Axis::time("time"))
            .y_axis(Axis::linear("height in the world", "cm"));
        let is = |k: usize, status: FootStatus| poses.get(k).is_some_and(|p| p.status == status);
        let is_bridged = |k: usize| is(k, FootStatus::Bridged);
        // A bridge is drawn to the poses at its ends.
        let is_end = |k: usize| is_bridged(k + 1) || k > 0 && is_bridged(k - 1);
        let line = |is_drawn: &dyn Fn(usize) -> bool| -> Vec<(f64, f64)> {
            let points = poses.iter().enumerate().map(|(k, pose)| match is_drawn(k) {
                true => (self.seconds(pose.time_ns), height(pose)),
                false => BREAK,
            });
            points.collect()
        };
        let is_lost = |k: usize| is(k, FootStatus::Lost);
        let seen = line(&|k| !is_bridged(k) && !is_lost(k));
        let bridged = line(&|k| is_bridged(k) || is_end(k) && !is_lost(k));
        if let Some((truth, similarity)) = &self.truth {
            let estimated_from_true = similarity.rigid.inverse();
            let line = poses.iter().filter_map(|pose| {
                let truth = truth.world_from_foot(foot, pose.time_ns)?;
                let [_, _, z] = estimated_from_true.apply(truth.translation_m());
                Some((self.seconds(pose.time_ns), 100.0 * z))
            });
            chart = chart.series(Series::line("ground truth", line).slot(3));
        }
        chart = chart
            .series(Series::line("observed or held", seen).slot(0))
            .series(Series::line("bridged", bridged).slot(1));
        chart
    }

    fn terrain(&self, page: Page, rig_path: &[[f64; 3]]) -> Result<Page, png::EncodingError> {
        let Some(mesh) = self.mesh.as_ref().filter(|mesh| !mesh.triangles.is_empty()) else {
            return Ok(page.text("There is no mesh of the ground."));
        };
        let top = rig_path
            .iter()
            .map(|x| x[2])
            .fold(f64::NEG_INFINITY, f64::max);
        let vertices: Vec<CloudPoint> = (mesh.positions.iter().zip(&mesh.colors))
            .map(|(position, color)| CloudPoint {
                x_in_world: *position,
                color: *color,
                sigma_m: 0.0,
            })
            .collect();
        let shown = views::shown(&vertices, rig_path);
        let Some(viewpoint) = views::oblique(&shown, rig_path) else {
            return Ok(page.text("There is no path to look from."));
        };
        let corners =
            |triangle: &[u32; 3]| triangle.map(|i| mesh.positions[i as usize].map(f64::from));
        let low = mesh.triangles.iter().filter(|triangle| {
            corners(triangle)
                .iter()
                .all(|x| x[2] <= top + views::MAX_HEIGHT_M)
        });
        let colored = low.map(|triangle| {
            let sum = |k: usize| {
                triangle
                    .iter()
                    .map(|i| u32::from(mesh.colors[*i as usize][k]))
                    .sum::<u32>()
            };
            (corners(triangle), [0, 1, 2].map(|k| (sum(k) / 3) as u8))
        });
        let path: Vec<([f64; 3], [u8; 3])> =
            rig_path.iter().map(|x| (*x, [42, 157, 143])).collect();
        let pixels = point_raster::draw_mesh(colored, &path, &viewpoint);
        let caption = format!(
            "The mesh, {} triangles, up to {} m around the middle of the path. Holes are where no depth map shows a surface.",
            mesh.triangles.len(),
            views::VIEW_RADIUS_M
        );
        let file = png(viewpoint.size, &pixels)?;
        Ok(page.image(&Image::png(&file, "the mesh from the side", &caption)))
    }
}

fn name(foot: Foot) -> &'static str {
    match foot {
        Foot::Left => "left foot",
        Foot::Right => "right foot",
    }
}

fn errors(feet: &FeetEvaluation, ground: &GroundEvaluation) -> Table {
    let number = |value: Option<String>| Cell::number(value.unwrap_or_else(|| "-".to_owned()));
    let ms = |value: f64| format!("{:.0} ms", 1e3 * value);
    let rows = [
        (
            "contacts found, invented",
            Some(format!(
                "{} of {}, {}",
                feet.found, feet.contacts, feet.invented
            )),
        ),
        (
            "position of a contact, median and 95 %",
            feet.position_m
                .map(|s| format!("{}, {}", si(s.median, "m"), si(s.p95, "m"))),
        ),
        (
            "heel strike, median and 95 %",
            feet.heel_strike_s
                .map(|s| format!("{}, {}", ms(s.median), ms(s.p95))),
        ),
        (
            "toe off, median and 95 %",
            feet.toe_off_s
                .map(|s| format!("{}, {}", ms(s.median), ms(s.p95))),
        ),
        (
            "bridged swings, root mean square",
            feet.bridged_m.map(|s| si(s.rmse, "m")),
        ),
        (
            "of these within the stated ellipsoid of 95 %",
            feet.bridged_m
                .map(|_| format!("{:.0} %", 100.0 * feet.bridged_within)),
        ),
        (
            "height of the ground under a footstep, median and 95 %",
            ground
                .height_m
                .map(|s| format!("{}, {}", si(s.median, "m"), si(s.p95, "m"))),
        ),
        (
            "footsteps on ground that depth shows",
            Some(format!("{} of {}", ground.shown, ground.footsteps)),
        ),
    ];
    rows.into_iter().fold(
        Table::new(["against the ground truth", ""]),
        |table, (what, value)| table.row([what.into(), number(value)]),
    )
}
