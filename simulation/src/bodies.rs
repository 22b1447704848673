//! Rigid bodies that fall, roll and rest on the collision geometry of a scene, with `rapier3d`.
//!
//! Feature `rapier`. Robots with joints and motors are MuJoCo's, from Python; this engine is for
//! loose bodies, pushes and the comparison of both. World frame z up, metres, kilograms, seconds.
//! The engine computes in single precision. Each world of bodies runs on the thread that steps it:
//! the same geometry, bodies and pushes give the same bits on one architecture, however many worlds
//! there are.

mod body;
mod config;
mod contact;
mod ground;
mod single;
mod snapshot;
#[cfg(test)]
mod tests;

pub use body::{Body, BodyShape, BodyState};
pub use config::BodiesConfig;
pub use contact::BodyContact;

use rapier3d::prelude::{
    IntegrationParameters, PhysicsWorld, Ray, RigidBodyHandle, SpringCoefficients,
};
use scene_bundle::outputs::collision::Collision;

use crate::error::SimulationError;
use ground::Ground;
use single::{vector, vector_f64};

/// Bodies on the collision geometry of a scene.
///
/// ```
/// use scene_bundle::outputs::collision::{Collision, ConvexPart, PartKind};
/// use simulation::{BodiesConfig, Body, BodyShape, RigidBodies};
///
/// // A slab of ground with its top at z = 0.
/// let corner = |i: usize| {
///     let half = |bit: usize| if i >> bit & 1 == 1 { 2.0 } else { -2.0 };
///     [half(0), half(1), if i & 4 == 4 { 0.0 } else { -0.2 }]
/// };
/// let slab = ConvexPart {
///     kind: PartKind::Ground,
///     plane: None,
///     vertices_m: (0..8).map(corner).collect(),
///     triangles: Vec::new(),
/// };
/// let ground = Collision { parts: vec![slab], ..Collision::default() };
///
/// let mut bodies = RigidBodies::new(&ground, BodiesConfig::default())?;
/// let ball = Body::new(BodyShape::Ball { radius_m: 0.1 }, 1.0, [0.0, 0.0, 0.5])?;
/// let ball = bodies.add(&ball)?;
/// for _ in 0..1000 {
///     bodies.step()?;
/// }
/// let [_, _, height_m] = bodies.state(ball)?.world_from_body.translation_m();
/// assert!((height_m - 0.1).abs() < 2e-3);
/// # Ok::<(), simulation::SimulationError>(())
/// ```
pub struct RigidBodies {
    world: PhysicsWorld,
    /// Of the bodies in the order in which they were added.
    handles: Vec<RigidBodyHandle>,
    config: BodiesConfig,
    /// Of the ground and the configuration.
    hash: blake3::Hash,
    parts_left_out: usize,
}

impl RigidBodies {
    /// Bodies on convex parts and height layers; none yet. Unknown cells of a layer are holes.
    ///
    /// # Errors
    /// [`SimulationError::Setting`]; [`SimulationError::Scene`] for vertices and heights that are
    /// not finite, and for layers with another number of heights than cells, without a size of
    /// cells, or of more cells than a height field of the engine can have.
    pub fn new(collision: &Collision, config: BodiesConfig) -> Result<Self, SimulationError> {
        config.check()?;
        let ground = Ground::new(collision, &config)?;
        let mut world = PhysicsWorld {
            gravity: vector([0.0, 0.0, -config.gravity_m_s2]),
            integration_parameters: integration(&config),
            ..PhysicsWorld::default()
        };
        for collider in ground.colliders {
            world.insert_collider(collider, None);
        }
        Ok(Self {
            world,
            handles: Vec::new(),
            config,
            hash: ground.hash,
            parts_left_out: ground.parts_left_out,
        })
    }

    /// Convex parts without volume, which the engine cannot collide with.
    pub fn parts_left_out(&self) -> usize {
        self.parts_left_out
    }

    /// Adds a body and gives its index.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for a body without shape, mass or extent, or with numbers that
    /// are not finite; nothing is added then.
    pub fn add(&mut self, body: &Body) -> Result<usize, SimulationError> {
        body.check()?;
        let handle = self.world.bodies.insert(body.rigid_body());
        for collider in body.colliders(self.config.friction) {
            self.world.insert_collider(collider, Some(handle));
        }
        self.handles.push(handle);
        Ok(self.handles.len() - 1)
    }

    /// Number of bodies.
    pub fn len(&self) -> usize {
        self.handles.len()
    }

    /// Whether there is no body.
    pub fn is_empty(&self) -> bool {
        self.handles.is_empty()
    }

    /// Pushes a body: an impulse in N s at a point, both in the world frame.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for a body that does not exist and numbers that are not finite
    /// or above 10^6.
    pub fn push(
        &mut self,
        body: usize,
        impulse_n_s: [f64; 3],
        point_m: [f64; 3],
    ) -> Result<(), SimulationError> {
        body::check_vector("impulse_n_s", impulse_n_s, body::MAX_NUMBER)?;
        body::check_vector("point_m", point_m, body::MAX_NUMBER)?;
        let handle = self.handle(body)?;
        if let Some(found) = self.world.bodies.get_mut(handle) {
            found.apply_impulse_at_point(vector(impulse_n_s), vector(point_m), true);
        }
        Ok(())
    }

    /// One step of `BodiesConfig::step_s`.
    ///
    /// # Errors
    /// [`SimulationError::State`] from the step on in which the velocity or a force of a body was
    /// not finite: the engine takes such a body out of the computation. The others go on.
    pub fn step(&mut self) -> Result<(), SimulationError> {
        self.world.step();
        let is_out = |handle: &RigidBodyHandle| !self.world.bodies[*handle].is_enabled();
        match self.handles.iter().position(is_out) {
            None => Ok(()),
            Some(body) => Err(SimulationError::State(format!(
                "body {body} is no longer computed: found a velocity or force that is not finite, \
                 expected numbers; restore a snapshot"
            ))),
        }
    }

    /// Pose and velocity of a body.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for a body that does not exist.
    pub fn state(&self, body: usize) -> Result<BodyState, SimulationError> {
        let found = &self.world.bodies[self.handle(body)?];
        Ok(BodyState {
            world_from_body: single::transform(found.position())?,
            velocity_m_s: vector_f64(found.linvel()),
            angular_velocity_rad_s: vector_f64(found.angvel()),
            is_asleep: found.is_sleeping(),
        })
    }

    /// Points at which a body touches the ground or another body, as of the last step.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for a body that does not exist.
    pub fn contacts(&self, body: usize) -> Result<Vec<BodyContact>, SimulationError> {
        Ok(contact::contacts(
            &self.world,
            self.handle(body)?,
            self.config.step_s,
        ))
    }

    /// Height at which a ray straight down from a point meets the ground or a body first, m: the
    /// height of the point itself inside of a convex part, `None` without anything within a depth.
    /// Of shapes as they were at the last step; there has to be one before. A ray on the edge of
    /// two triangles of a height layer may miss both, by rounding.
    pub fn ground_m(&self, from_m: [f64; 3], depth_m: f64) -> Option<f64> {
        let ray = Ray::new(vector(from_m), vector([0.0, 0.0, -1.0]));
        let hit = self
            .world
            .query_pipeline()
            .cast_ray(&ray, depth_m as f32, true);
        hit.map(|(_, below_m)| from_m[2] - f64::from(below_m))
    }

    fn handle(&self, body: usize) -> Result<RigidBodyHandle, SimulationError> {
        self.handles
            .get(body)
            .copied()
            .ok_or_else(|| SimulationError::Setting {
                name: "body".to_owned(),
                found: body.to_string(),
                expected: format!("the index of one of {} bodies", self.handles.len()),
            })
    }
}

fn integration(config: &BodiesConfig) -> IntegrationParameters {
    let contacts = SpringCoefficients::new(
        config.contact_frequency_hz as f32,
        config.contact_damping as f32,
    );
    IntegrationParameters {
        dt: config.step_s as f32,
        num_solver_iterations: config.solver_iterations,
        contact_softness: contacts,
        static_contact_softness: contacts,
        // Contacts are those of the step, not of a pose up to 5 cm away.
        contact_recycling: false,
        ..IntegrationParameters::default()
    }
}
