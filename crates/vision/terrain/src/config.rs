//! Configuration of terrain reconstruction.
//!
//! Where a field names no source, its value was chosen on the analytic scenes of the tests.

use estimator_config::config;

config! {
    /// Constants of [`Volume`](crate::fusion::Volume).
    pub struct FusionConfig {
        /// Edge of a voxel, m. Planes and edges are refitted to the depths themselves, so the voxel
        /// determines only how rough ground is sampled, and memory and time.
        pub voxel_m: f64 = 0.02,
        /// Sigma along the normal of an observation of weight 1, m. Half of it is the least sigma
        /// of an observation.
        pub unit_sigma_m: f64 = 0.005,
        /// Distance in front of a surface up to which voxels are updated, in voxels and in sigmas;
        /// the larger applies.
        pub front_voxels: f64 = 3.0,
        /// See `front_voxels`.
        pub front_sigmas: f64 = 3.0,
        /// Maximum of that distance, m.
        pub max_front_m: f64 = 0.12,
        /// Distance behind a surface up to which voxels are updated, in voxels and in sigmas; the
        /// larger applies.
        pub back_voxels: f64 = 1.5,
        /// See `back_voxels`.
        pub back_sigmas: f64 = 3.0,
        /// Maximum of the distance in sigmas, m: open treads are 3 to 4 cm thick.
        pub max_back_m: f64 = 0.04,
        /// Maximum sigma along the normal of a depth that becomes a surface, m.
        pub max_sigma_m: f64 = 0.06,
        /// Maximum depth, m.
        pub max_depth_m: f64 = 8.0,
        /// Minimum cosine of the angle between ray and normal: 75 degrees.
        pub min_incidence_cos: f64 = 0.26,
        /// Width of the seam of foreground at depth steps that is not used, in 640ths of the image
        /// width: matchers make foreground too wide.
        pub step_margin: f64 = 2.0,
        /// Depth step, as a share of the depth; five sigmas if they are more.
        pub step_ratio: f64 = 0.05,
        /// Number of views that see through a surface before it loses weight. With one, mirrors and
        /// errors of a single view would remove ground.
        pub min_contradictions: u8 = 2,
        /// Share of the best sigma of a view below which no number of views reduces the sigma:
        /// errors of calibration are common to neighboring views.
        pub common_ratio: f64 = 0.3,
    }

    /// Constants of [`Mesh::of`](crate::mesh::Mesh::of).
    pub struct MeshConfig {
        /// Maximum difference of the distances of neighboring voxels on either side of a surface,
        /// voxels. More is a border between seen and unseen space, where no surface was observed.
        pub max_jump_voxels: f64 = 2.5,
        /// Minimum ratio of the eigenvalues of a vertex that is on an edge rather than on a plane:
        /// edges of 35 degrees. Lower takes the noise of normals for edges.
        pub min_feature_ratio: f64 = 0.1,
        /// Minimum area of a connected surface, m2. Smaller ones are noise of the matcher.
        pub min_component_m2: f64 = 0.02,
        /// Minimum number of views of a vertex.
        pub min_views: u8 = 1,
    }

    /// Constants of [`PlaneRefiner`](crate::planes::PlaneRefiner).
    pub struct PlaneConfig {
        /// Maximum distance of a vertex from its plane, in its sigmas.
        pub max_vertex_sigmas: f64 = 2.0,
        /// The same in m; the larger applies. Above the rounding of a voxel, below bumps that feet
        /// notice.
        pub min_vertex_distance_m: f64 = 0.004,
        /// Maximum angle of the normal of a vertex with that of its plane, rad: normals of stereo
        /// depth are known to 5 to 10 degrees.
        pub max_normal_angle_rad: f64 = 0.30,
        /// Minimum area, m2.
        pub min_area_m2: f64 = 0.05,
        /// Maximum root mean square distance of two regions beside each other from one plane, of
        /// which they then are parts, m: noise of the mesh divides regions.
        pub max_merge_m: f64 = 0.005,
        /// Maximum angle of their normals with its, rad: small regions have noisy ones.
        pub max_merge_angle_rad: f64 = 0.10,
        /// Maximum distance of a plane's points from its first one, m. Larger surfaces become
        /// several planes: a road whose crown is 16 cm high deviates from a plane by 4 mm within
        /// this radius, by 17 mm within twice as much.
        pub max_radius_m: f64 = 1.5,
        /// Maximum sigma along the normal of a depth of a plane, m. Noisier ones add little.
        pub max_sigma_m: f64 = 0.025,
        /// Maximum distance of a depth from its plane, in combined sigmas.
        pub max_depth_sigmas: f64 = 3.0,
        /// Number of samples of a plane that share their errors: windows of the matcher. Samples
        /// are every second column and row.
        pub correlated_samples: f64 = 9.0,
        /// One standard deviation of the rotation of a view relative to others, rad.
        pub view_tilt_sigma_rad: f64 = 0.002,
        /// Share of the sigma of a plane's depths that all of them in a view have in common: errors
        /// of the matcher are alike where the texture is. On treads of simulated stairs the median
        /// error of a view is 0.3 (large treads nearby) to 0.6 (parts of treads farther away).
        pub common_ratio: f64 = 0.45,
        /// Maximum chi-square per depth of a plane. Above, the surface is not plane.
        pub max_chi_square: f64 = 1.8,
        /// Maximum root mean square distance of the means of patches of 6 cm from their plane,
        /// beyond their own errors, in standard deviations of a depth: the matcher makes bumps in
        /// proportion to its noise, 0.2 to 0.5 of it on simulated pavements. Above, the ground is
        /// rough.
        pub max_roughness_sigmas: f64 = 0.55,
        /// That limit at least, m: bumps that the matcher makes nearby, up to 4.4 mm.
        pub min_roughness_m: f64 = 0.0045,
        /// That limit at most, m.
        pub max_roughness_m: f64 = 0.008,
        /// Minimum area of a plane without edges that vertices of the mesh are moved to, m2.
        /// Smaller ones are facets of rough ground.
        pub min_alone_m2: f64 = 0.6,
        /// Minimum number of samples of a plane in a view.
        pub min_view_depths: u32 = 20,
        /// Edge of a cell of a plane's support, m: about three pixels.
        pub support_cell_m: f64 = 0.01,
        /// Minimum number of depths in such a cell, as a share of the median. Fewer are errors
        /// beyond the end of the plane.
        pub min_cell_share: f64 = 0.15,
    }

    /// Constants of [`find_edges`](crate::edges::find_edges).
    pub struct EdgeConfig {
        /// Minimum angle of two planes that meet in an edge, rad: 30 degrees. Less is smooth
        /// ground.
        pub min_angle_rad: f64 = 0.52,
        /// Maximum distance of the support of a plane from its edge, m.
        pub max_support_gap_m: f64 = 0.04,
        /// Minimum length of an edge, m.
        pub min_length_m: f64 = 0.12,
        /// Minimum length of an edge where depths end and no riser was seen, m.
        pub min_end_length_m: f64 = 0.25,
        /// Maximum gap within an edge, m.
        pub max_gap_m: f64 = 0.10,
        /// Maximum distance from a line of the points of a plane's end, m.
        pub max_line_distance_m: f64 = 0.012,
        /// Minimum height of a step, m. Lower ones are left to the height layers.
        pub min_step_m: f64 = 0.03,
        /// Maximum height of a step, m: what people climb.
        pub max_step_m: f64 = 0.40,
        /// Maximum horizontal distance from an edge to the ground below it, m.
        pub max_run_m: f64 = 0.35,
        /// Minimum cosine of the slope of ground that is stepped on: 45 degrees.
        pub min_ground_cos: f64 = 0.71,
        /// Maximum vertical part of the normal of a riser that is upright: 20 degrees. Ramps by
        /// which matchers join a tread and the ground behind its end lean by 22 degrees and more.
        pub max_upright_cos: f64 = 0.34,
        /// Maximum distance across a leaning riser's edge of an end of the depths that contradicts
        /// it, m.
        pub max_ramp_m: f64 = 0.06,
        /// One standard deviation of the place where the depths of a plane end, m: matchers make
        /// foreground wider by a pixel or two.
        pub end_sigma_m: f64 = 0.005,
    }

    /// Constants of [`without_ramps`](crate::edges::without_ramps).
    pub struct RampConfig {
        /// Range of horizontal distances from its edge in which a ramp is, m. Nearer, it may be the
        /// riser; farther, views see the ground below. On simulated stairs ramps are 10 to 17 cm
        /// long.
        pub min_run_m: f64 = 0.005,
        /// See `min_run_m`.
        pub max_run_m: f64 = 0.20,
        /// Distance from its edge within which a vertex of a ramp is moved to the foot of the
        /// step, m: the mesh is as steep there as its vertices allow.
        pub foot_reach_m: f64 = 0.03,
        /// Distance beyond its edge up to which the ground above is an error of the matcher, m: it
        /// makes foreground wider.
        pub max_overhang_m: f64 = 0.05,
        /// Height above the edge from which the upper limit of a ramp falls, m, and its slope. What
        /// stands higher on the ground below is a thing.
        pub max_above_m: f64 = 0.03,
        /// See `max_above_m`.
        pub min_slope: f64 = 0.6,
        /// Distance beyond the ends of an edge, m, as long as the ground above ends at its line and
        /// that below was observed: edges end where few depths do.
        pub max_extension_m: f64 = 1.0,
        /// Distance from an edge within which the ground below it was observed, m.
        pub max_reach_m: f64 = 0.4,
        /// Cosines of the slopes of planes that can be ramps: 70 to 16 degrees. Steeper ones are
        /// risers, more level ones ground.
        pub min_plane_cos: f64 = 0.34,
        /// See `min_plane_cos`.
        pub max_plane_cos: f64 = 0.96,
        /// Minimum cosine of the horizontal angle between the normal of a ramp and its step.
        pub min_facing_cos: f64 = 0.7,
        /// Distance from ramps up to which cells of a plane are on them, m: the border of the tread
        /// above is smeared too.
        pub margin_m: f64 = 0.10,
        /// Minimum share of a ramp's observed cells that are on ramps.
        pub min_share: f64 = 0.5,
        /// Maximum distance of two steps of a flight, m: two goings.
        pub max_flight_m: f64 = 0.7,
    }

    /// Constants of [`build`](crate::maps::build).
    pub struct MapConfig {
        /// Edge of a cell, m.
        pub cell_m: f64 = 0.04,
        /// Minimum cosine of the slope of ground: 45 degrees.
        pub min_ground_cos: f64 = 0.71,
        /// Maximum difference of heights of neighboring cells of a level, m: people climb 25 cm.
        pub max_step_m: f64 = 0.25,
        /// Least height of the next surface above for the clearance of a floor, m: what is lower
        /// is an obstacle on it.
        pub level_gap_m: f64 = 0.5,
        /// Head room, m.
        pub head_room_m: f64 = 1.9,
        /// Minimum area of a level without ground samples, m2.
        pub min_level_m2: f64 = 0.25,
        /// A level is divided if its grid has more cells than this and less than a share of them
        /// has ground: 28x28 m.
        pub max_level_cells: usize = 500_000,
        /// See `max_level_cells`.
        pub min_level_share: f64 = 0.25,
        /// Maximum number of cells along a side of a level: 1 km. Files allow 65 535.
        pub max_level_side: usize = 25_000,
        /// Overlap of its parts, m: what is nearer to the end of a part than the radius of an agent
        /// is within another one.
        pub level_overlap_m: f64 = 4.0,
        /// Maximum width of a hole that is filled, m: the shade of a shoe.
        pub max_hole_m: f64 = 0.10,
        /// Maximum distance of its rim from a plane, m.
        pub max_rim_m: f64 = 0.01,
        /// Height difference of neighboring cells, beyond their slope, that is an edge, m.
        pub min_edge_m: f64 = 0.03,
        /// Radius within which the height of steps is measured, m.
        pub step_radius_m: f64 = 0.12,
        /// Radius within which roughness is measured, m.
        pub roughness_radius_m: f64 = 0.10,
        /// Slope, step and roughness that are not traversable: rad, m, m.
        pub max_slope_rad: f64 = 0.6,
        /// See `max_slope_rad`.
        pub max_traversable_step_m: f64 = 0.2,
        /// See `max_slope_rad`.
        pub max_roughness_m: f64 = 0.05,
        /// Ground samples that differ from depth by more sigmas win over it.
        pub max_sample_sigmas: f64 = 3.0,
        /// Share of the samples of a contact with known heights that agree with them, from which
        /// on the others that are higher hang over.
        pub min_agreeing_share: f64 = 0.2,
        /// Minimum height of what hangs over, beside two sigmas, m: the sag of a sole.
        pub min_overhang_m: f64 = 0.015,
        /// Maximum sigma of a height that is certain, m: a foot that finds ground 3 cm lower than
        /// expected, three sigmas, stumbles.
        pub max_certain_sigma_m: f64 = 0.01,
    }

    /// Constants of [`contact_patch`](crate::contact_patch).
    pub struct PatchConfig {
        /// Distance between points of a sole that are compared with the ground, m.
        pub spacing_m: f64 = 0.005,
        /// Height above the ground up to which a sole bears, beside `sigmas`, m: its sag and that
        /// of soft ground.
        pub max_gap_m: f64 = 0.015,
        /// Standard deviations of the height of sole and ground.
        pub sigmas: f64 = 2.0,
        /// Maximum distance of the edge of a step from the middle of a sole, m.
        pub edge_reach_m: f64 = 0.3,
        /// Distance beyond its ends in which an edge counts, m: views see less of it than there is.
        pub edge_margin_m: f64 = 0.05,
        /// Maximum height of a sole above or below the edge on which it stands, m.
        pub max_edge_height_m: f64 = 0.03,
    }

    /// Constants of [`simplify`](crate::simplify::simplify).
    pub struct SimplifyConfig {
        /// Maximum height error at the vertices of the dense mesh that a foot can stand on, 95 %
        /// quantile, m.
        pub max_height_p95_m: f64 = 0.002,
        /// Error above which a foot would stumble, m, and the maximum share of such vertices.
        pub max_height_m: f64 = 0.010,
        /// See `max_height_m`. Vertices at ragged borders of the dense mesh are among them.
        pub max_beyond_share: f64 = 0.005,
        /// Minimum cosine of the slope of ground that counts: 45 degrees.
        pub min_ground_cos: f64 = 0.71,
        /// Tolerances of the quadric error that are tried, m: the first and, doubled each time, the
        /// last.
        pub first_tolerance_m: f64 = 0.0005,
        /// See `first_tolerance_m`.
        pub last_tolerance_m: f64 = 0.016,
    }

    /// Constants of [`collision_parts`](crate::convex::collision_parts).
    pub struct ConvexConfig {
        /// Area that a part may cover beyond what was observed, as a share of its own and in m2;
        /// the larger applies. More gives fewer parts and larger errors.
        pub max_uncovered_share: f64 = 0.25,
        /// See `max_uncovered_share`.
        pub max_uncovered_m2: f64 = 0.025,
        /// Minimum area of a plane without edges that gets parts, m2. Smaller ones are facets of
        /// rough ground, which the height layer shows better.
        pub min_plane_m2: f64 = 1.0,
        /// Minimum area of a part, m2.
        pub min_part_m2: f64 = 0.002,
        /// Maximum number of corners of a part.
        pub max_corners: usize = 16,
        /// Thickness of the parts of ground, m: bodies fall through thin ones.
        pub ground_thickness_m: f64 = 0.20,
        /// Thickness of the parts of risers and walls, m: a wall may be thin.
        pub wall_thickness_m: f64 = 0.05,
        /// Minimum cosine of the slope of ground: 45 degrees.
        pub min_ground_cos: f64 = 0.71,
        /// Distance within which the border of a part is moved to an edge, m.
        pub edge_reach_m: f64 = 0.05,
        /// Distance beyond the edge of a step up to which ground is an error of the matcher, m,
        /// also beyond the ends of the edge, where no view saw the riser: 6 to 7 cm on simulated
        /// stairs.
        pub max_overhang_m: f64 = 0.08,
        /// Maximum share of the cells of a plane that are farther beyond such an edge.
        pub max_beyond_share: f64 = 0.01,
        /// Overlap of parts below their surface, m: a body that slides over flush ones would catch
        /// at their seams.
        pub overlap_m: f64 = 0.01,
        /// Depth of the height layer below the surface of parts of planes, m: how deep the joint
        /// between part and layer may be. Less, and feet that sink in by millimetres touch both.
        pub layer_seam_m: f64 = 0.005,
        /// Maximum width of the upper ground above a step that is left out where no part covers it,
        /// for a step that is as steep as the part's border, m. Where it would be more, the layer
        /// makes a slope of the step, at most as wide above a part of the lower ground. Half the
        /// diagonal of a cell of 4 cm.
        pub max_smear_m: f64 = 0.03,
        /// Maximum distance of a cell's height from the plane that stands for it, m.
        pub max_plane_distance_m: f64 = 0.03,
        /// Height above an edge up to which the top of a riser is cut off there, m: depths beyond
        /// the edge are errors.
        pub max_riser_top_m: f64 = 0.06,
        /// Ramps below steps, which have no parts.
        pub ramps: RampConfig = RampConfig::default(),
    }

    /// Constants of `obstacle_parts` (feature `obstacles`).
    pub struct ObstacleConfig {
        /// Edge of the tiles that are decomposed on their own, m.
        pub tile_m: f64 = 1.5,
        /// Edge of the voxels of the decomposition, m.
        pub voxel_m: f64 = 0.02,
        /// Concavity that a part may have, as a share of its volume (V-HACD). Less gives more
        /// parts.
        pub concavity: f64 = 0.02,
        /// Maximum number of parts of a thing in a tile.
        pub max_parts: u32 = 16,
        /// Minimum area of the surface of a thing in a tile, m2.
        pub min_area_m2: f64 = 0.02,
        /// Height above free ground up to which a surface is that ground, m.
        pub ground_m: f64 = 0.06,
        /// Maximum height of a step between neighboring cells whose face is ground too, m: that of
        /// neighboring cells of a level.
        pub max_step_m: f64 = 0.25,
    }
}
