//! Snapshots of bodies.
//!
//! The whole state of the engine, with its contacts and the ground: a world goes on from it bit for
//! bit. The size is that of the ground; for a branch within a program restore the same bytes into
//! several worlds of the same ground.

use rapier3d::prelude::{PhysicsWorld, RigidBodyHandle};

use super::RigidBodies;
use crate::error::SimulationError;

/// Begins each snapshot; the digits are its version.
const MAGIC: &[u8; 8] = b"pawsrb01";

impl RigidBodies {
    /// All of the state.
    ///
    /// # Errors
    /// [`SimulationError::State`] if it cannot be encoded.
    pub fn save(&self) -> Result<Vec<u8>, SimulationError> {
        let mut bytes = [MAGIC.as_slice(), self.hash.as_bytes()].concat();
        let content = (&self.world, &self.handles);
        let content = postcard::to_allocvec(&content)
            .map_err(|error| SimulationError::State(format!("snapshot of bodies: {error}")))?;
        bytes.extend(content);
        let checksum = blake3::hash(&bytes);
        bytes.extend(checksum.as_bytes());
        Ok(bytes)
    }

    /// The state of a snapshot, with its bodies and their contacts.
    ///
    /// # Errors
    /// [`SimulationError::Snapshot`] for one of another ground, configuration or version, and for
    /// damaged bytes; nothing changes then.
    pub fn restore(&mut self, snapshot: &[u8]) -> Result<(), SimulationError> {
        let end = snapshot.len().saturating_sub(blake3::OUT_LEN);
        let (content, checksum) = snapshot.split_at(end);
        let is_whole = blake3::hash(content).as_bytes().as_slice() == checksum;
        let head = content.split_at_checked(MAGIC.len() + blake3::OUT_LEN);
        let Some((head, content)) = head.filter(|_| is_whole) else {
            return Err(refused("damaged bytes", "the bytes of `save`"));
        };
        let (magic, hash) = head.split_at(MAGIC.len());
        if magic != MAGIC {
            return Err(refused("another kind or version", "one of rigid bodies"));
        }
        if hash != self.hash.as_bytes() {
            let found = "one of another ground or configuration";
            return Err(refused(found, "one of this ground and configuration"));
        }
        let decoded = postcard::take_from_bytes::<(PhysicsWorld, Vec<RigidBodyHandle>)>(content);
        let ((world, handles), rest) =
            decoded.map_err(|error| refused(&error.to_string(), "a state of rigid bodies"))?;
        if let Some(lost) = handles.iter().position(|own| !world.bodies.contains(*own)) {
            return Err(refused(
                &format!("no body {lost}"),
                "all bodies that were added",
            ));
        }
        if !rest.is_empty() {
            return Err(refused(
                &format!("{} bytes after the state", rest.len()),
                "none",
            ));
        }
        self.world = world;
        self.handles = handles;
        Ok(())
    }
}

fn refused(found: &str, expected: &str) -> SimulationError {
    SimulationError::Snapshot {
        found: found.to_owned(),
        expected: expected.to_owned(),
    }
}
