//! Snapshots: everything that an environment needs to go on with the same bits.
//!
//! A snapshot is at most [`MAX_SNAPSHOT_BYTES`] long. It holds poses and counters, no images: a
//! frame is a function of scene, pose, lens and seed, so that frames in transit are poses too. It
//! belongs to its scene and configuration and can be restored into any environment of any world
//! with these, in another process too.
//!
//! Layout, little endian: magic, version, hash of the scene, hash of the configuration, state,
//! episode, frames of the camera where it has a timing, attachment with its length, BLAKE3 of all
//! before (16 bytes).

mod bytes;
mod fields;
mod queue;

use std::ops::ControlFlow;

use bytes::{Reader, Writer, damaged};

use crate::SimulationError;
use crate::episode::task::Task;
use crate::world::World;
use crate::world::episode::{Phase, Target};
use crate::world::report;
use crate::world::rows::Rows;

/// Greatest length of a snapshot.
pub const MAX_SNAPSHOT_BYTES: usize = 4096;

const MAGIC: [u8; 8] = *b"PAWS-env";
const VERSION: u16 = 2;
const CHECKSUM_BYTES: usize = 16;

impl World {
    /// A snapshot of an environment, with an attachment of the caller, such as the state of physics
    /// outside of this world.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] without such an environment, [`SimulationError::Budget`] for an
    /// attachment with which it would be longer than [`MAX_SNAPSHOT_BYTES`].
    pub fn save(&self, environment: usize, attachment: &[u8]) -> Result<Vec<u8>, SimulationError> {
        self.check_index(environment)?;
        let mut writer = Writer::default();
        writer.bytes(&MAGIC);
        writer.bytes(&VERSION.to_le_bytes());
        writer.bytes(self.shared.scene.hash());
        writer.bytes(&self.shared.config_hash);
        let kept = &self.environments;
        writer.u32(kept.sector[environment]);
        fields::write_state(&mut writer, &kept.state[environment]);
        fields::write_episode(&mut writer, &kept.episode[environment]);
        if let Some(queue) = &kept.queue[environment] {
            queue::write(&mut writer, queue);
        }
        writer.u32(u32::try_from(attachment.len()).unwrap_or(u32::MAX));
        writer.bytes(attachment);
        let mut snapshot = writer.into_bytes();
        let checksum = blake3::hash(&snapshot);
        snapshot.extend_from_slice(&checksum.as_bytes()[..CHECKSUM_BYTES]);
        if snapshot.len() > MAX_SNAPSHOT_BYTES {
            return Err(SimulationError::Budget {
                place: format!("the snapshot of environment {environment}"),
                needed: snapshot.len() as u64,
                allowed: MAX_SNAPSHOT_BYTES as u64,
            });
        }
        Ok(snapshot)
    }

    /// Restores an environment, and returns the attachment. Its next step has the same results as
    /// that of the environment that was saved. Results of the step before are those of a reset: no
    /// reward and no flag.
    ///
    /// # Errors
    /// [`SimulationError::Snapshot`] for damaged bytes and for another version, scene or
    /// configuration; nothing changed. [`SimulationError::Setting`] without such an environment.
    /// [`SimulationError::Start`] and [`SimulationError::Scene`] as [`World::prepare`].
    pub fn restore<'a>(
        &mut self,
        environment: usize,
        snapshot: &'a [u8],
    ) -> Result<&'a [u8], SimulationError> {
        self.check_index(environment)?;
        let mut reader = Reader::new(self.checked(snapshot)?);
        let sector = reader.u32()?;
        let terrain = self.shared.terrains.get(sector as usize);
        let terrain = terrain.ok_or_else(|| damaged(&format!("sector {sector}")))?;
        let state = fields::read_state(&mut reader)?;
        if state.level >= terrain.ground.levels().len() {
            return Err(damaged(&format!("level {}", state.level)));
        }
        let episode = fields::read_episode(&mut reader)?;
        let queue = match episode.phase {
            Phase::New => None,
            _ => queue::read(&mut reader, &self.shared, &episode)?.map(Box::new),
        };
        let length = reader.u32()? as usize;
        let attachment = reader.bytes(length)?;
        reader.end()?;
        if episode.phase != Phase::New {
            self.shared.prepare(&|_, _| ControlFlow::Continue(()))?;
        }
        let is_of_task = match (episode.phase, episode.target, self.shared.config.task.task) {
            (Phase::New, ..) => true,
            (_, Target::Goal { index, .. }, Task::PointGoal) => {
                (index as usize) < self.shared.goals.len()
            }
            (_, Target::Path { .. }, Task::FollowPath) => true,
            (_, Target::Command, Task::Velocity) => true,
            _ => false,
        };
        if !is_of_task {
            return Err(damaged(&format!("{:?}", episode.target)));
        }
        let shared = &self.shared;
        let mut rows = Rows::new(
            &mut self.environments,
            &mut self.result,
            &mut self.observations,
            shared.layout.len(),
        );
        let mut row = rows.row(environment);
        *row.sector = sector;
        *row.state = state;
        *row.episode = episode;
        *row.body_from_camera = episode.parameters.body_from_camera(&shared.mount);
        *row.queue = queue;
        row.clear_step();
        report::report(shared, &mut row);
        Ok(attachment)
    }

    /// The state and attachment of a snapshot that is undamaged and belongs to this world.
    fn checked<'a>(&self, snapshot: &'a [u8]) -> Result<&'a [u8], SimulationError> {
        let mut reader = Reader::new(snapshot);
        if snapshot.len() > MAX_SNAPSHOT_BYTES || reader.bytes(MAGIC.len())? != MAGIC {
            return Err(SimulationError::Snapshot {
                found: format!("{} bytes of something else", snapshot.len()),
                expected: "a snapshot of an environment".to_owned(),
            });
        }
        let version = u16::from_le_bytes([reader.u8()?, reader.u8()?]);
        if version != VERSION {
            return Err(SimulationError::Snapshot {
                found: format!("version {version}"),
                expected: format!("version {VERSION}"),
            });
        }
        let end = snapshot.len().saturating_sub(CHECKSUM_BYTES);
        let (content, checksum) = snapshot.split_at(end);
        if blake3::hash(content).as_bytes()[..CHECKSUM_BYTES] != *checksum {
            return Err(damaged("another checksum than that of its bytes"));
        }
        for (name, of_world) in [
            ("scene", self.shared.scene.hash()),
            ("configuration", &self.shared.config_hash),
        ] {
            let found = reader.bytes(of_world.len())?;
            if found != of_world {
                return Err(SimulationError::Snapshot {
                    found: format!("the {name} {}", hex(found)),
                    expected: format!("the {name} {} of this world", hex(of_world)),
                });
            }
        }
        let begin = MAGIC.len() + 2 + 2 * blake3::OUT_LEN;
        content.get(begin..).ok_or_else(|| damaged("an early end"))
    }
}

/// The first bytes of a hash.
fn hex(bytes: &[u8]) -> String {
    bytes
        .iter()
        .take(8)
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

#[cfg(test)]
mod tests;
