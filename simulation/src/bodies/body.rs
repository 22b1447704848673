//! What a body is made of, and where it is.

use cad_transforms::RigidTransform;
use rapier3d::prelude::{Collider, ColliderBuilder, RigidBody, RigidBodyBuilder};

use super::single;
use crate::error::{SimulationError, check_range};

/// Largest position, m, mass, kg, and impulse, N s.
pub(super) const MAX_NUMBER: f64 = 1e6;
/// Largest component of a velocity: above 400 m/s the engine shortens it.
const MAX_SPEED_M_S: f64 = 200.0;
/// Largest component of an angular velocity: half of a turn in the longest time step is more.
const MAX_RATE_RAD_S: f64 = 30.0;

/// A rigid body of one or more shapes of equal density.
#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    /// Its shapes, each with its pose in the frame of the body.
    pub shapes: Vec<(BodyShape, RigidTransform)>,
    /// Its mass, kg.
    pub mass_kg: f64,
    /// Its pose.
    pub world_from_body: RigidTransform,
    /// Its velocity along the axes of the world, m/s.
    pub velocity_m_s: [f64; 3],
    /// Its angular velocity about the axes of the world, rad/s.
    pub angular_velocity_rad_s: [f64; 3],
}

/// A convex shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BodyShape {
    /// A box.
    Box {
        /// Half of its extent along x, y and z, m.
        half_m: [f64; 3],
    },
    /// A ball.
    Ball {
        /// Its radius, m.
        radius_m: f64,
    },
    /// A cylinder along z with hemispheres at its ends.
    Capsule {
        /// Half of the length between the centers of the hemispheres, m.
        half_m: f64,
        /// Its radius, m.
        radius_m: f64,
    },
}

/// Pose and velocity of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyState {
    /// Its pose.
    pub world_from_body: RigidTransform,
    /// Velocity of its center of mass along the axes of the world, m/s.
    pub velocity_m_s: [f64; 3],
    /// Angular velocity about the axes of the world, rad/s.
    pub angular_velocity_rad_s: [f64; 3],
    /// Whether it rests and is no longer computed until something touches it.
    pub is_asleep: bool,
}

impl Body {
    /// A body of one shape at rest, its axes those of the world.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for a position that is not finite or beyond 10^6 m.
    pub fn new(
        shape: BodyShape,
        mass_kg: f64,
        position_m: [f64; 3],
    ) -> Result<Self, SimulationError> {
        check_vector("body.position_m", position_m, MAX_NUMBER)?;
        let world_from_body = RigidTransform::from_translation_m(position_m).map_err(|error| {
            SimulationError::Setting {
                name: "body.position_m".to_owned(),
                found: format!("{position_m:?}: {error}"),
                expected: "a position".to_owned(),
            }
        })?;
        Ok(Self {
            shapes: vec![(shape, RigidTransform::identity())],
            mass_kg,
            world_from_body,
            velocity_m_s: [0.0; 3],
            angular_velocity_rad_s: [0.0; 3],
        })
    }

    pub(super) fn check(&self) -> Result<(), SimulationError> {
        if self.shapes.is_empty() {
            return Err(SimulationError::Setting {
                name: "body.shapes".to_owned(),
                found: "none".to_owned(),
                expected: "one or more".to_owned(),
            });
        }
        check_extent("body.mass_kg", self.mass_kg)?;
        let (velocity, rate) = (self.velocity_m_s, self.angular_velocity_rad_s);
        check_vector("body.velocity_m_s", velocity, MAX_SPEED_M_S)?;
        check_vector("body.angular_velocity_rad_s", rate, MAX_RATE_RAD_S)?;
        let position_m = self.world_from_body.translation_m();
        check_vector("body.world_from_body", position_m, MAX_NUMBER)?;
        for (shape, body_from_shape) in &self.shapes {
            shape.check()?;
            let position_m = body_from_shape.translation_m();
            check_vector("body.body_from_shape", position_m, MAX_NUMBER)?;
        }
        Ok(())
    }

    /// The body of the engine, without its shapes.
    pub(super) fn rigid_body(&self) -> RigidBody {
        RigidBodyBuilder::dynamic()
            .pose(single::pose(&self.world_from_body))
            .linvel(single::vector(self.velocity_m_s))
            .angvel(single::vector(self.angular_velocity_rad_s))
            .ccd_enabled(true)
            .build()
    }

    /// The shapes of the engine; mass is shared out by volume.
    pub(super) fn colliders(&self, friction: f64) -> Vec<Collider> {
        let volumes = self.shapes.iter().map(|(shape, _)| shape.volume_m3());
        let volume_m3: f64 = volumes.sum();
        let collider = |(shape, body_from_shape): &(BodyShape, RigidTransform)| {
            shape
                .builder()
                .mass((self.mass_kg * shape.volume_m3() / volume_m3) as f32)
                .friction(friction as f32)
                .position(single::pose(body_from_shape))
                .build()
        };
        self.shapes.iter().map(collider).collect()
    }
}

impl BodyShape {
    fn check(self) -> Result<(), SimulationError> {
        match self {
            Self::Box { half_m } => half_m
                .into_iter()
                .try_for_each(|v| check_extent("box.half_m", v)),
            Self::Ball { radius_m } => check_extent("ball.radius_m", radius_m),
            Self::Capsule { half_m, radius_m } => {
                check_extent("capsule.half_m", half_m)?;
                check_extent("capsule.radius_m", radius_m)
            }
        }
    }

    fn volume_m3(self) -> f64 {
        let ball = |radius: f64| 4.0 / 3.0 * std::f64::consts::PI * radius * radius * radius;
        match self {
            Self::Box { half_m: [x, y, z] } => 8.0 * x * y * z,
            Self::Ball { radius_m } => ball(radius_m),
            Self::Capsule { half_m, radius_m } => {
                ball(radius_m) + 2.0 * half_m * std::f64::consts::PI * radius_m * radius_m
            }
        }
    }

    fn builder(self) -> ColliderBuilder {
        match self {
            Self::Box { half_m } => {
                let [x, y, z] = half_m.map(|v| v as f32);
                ColliderBuilder::cuboid(x, y, z)
            }
            Self::Ball { radius_m } => ColliderBuilder::ball(radius_m as f32),
            Self::Capsule { half_m, radius_m } => {
                ColliderBuilder::capsule_z(half_m as f32, radius_m as f32)
            }
        }
    }
}

/// Refuses lengths and masses that the engine cannot compute with.
fn check_extent(name: &str, value: f64) -> Result<(), SimulationError> {
    check_range(
        name,
        value,
        [1e-4, MAX_NUMBER],
        "a number from 0.0001 to 10^6",
    )
}

/// Refuses components that are not finite or too large.
pub(super) fn check_vector(name: &str, value: [f64; 3], most: f64) -> Result<(), SimulationError> {
    let expected = format!("numbers from -{most} to {most}");
    let mut values = value.into_iter();
    values.try_for_each(|v| check_range(name, v, [-most, most], &expected))
}
