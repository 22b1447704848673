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
        /// Sigma along the normal of an observation of weight 1, m. Half of it is the least sigma of
        /// an observation.
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
}
