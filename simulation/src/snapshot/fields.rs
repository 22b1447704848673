//! State and episode of an environment as bytes.

use super::bytes::{Reader, Writer, damaged};
use crate::SimulationError;
use crate::agent::AgentState;
use crate::episode::end::EndReason;
use crate::episode::randomization::EpisodeParameters;
use crate::world::episode::{Episode, Phase, Target};

pub(super) fn write_state(writer: &mut Writer, state: &AgentState) {
    let AgentState {
        position_m,
        yaw_rad,
        pitch_rad,
        roll_rad,
        velocity,
        level,
        is_on_ground,
    } = *state;
    for value in position_m {
        writer.f64(value);
    }
    for value in [yaw_rad, pitch_rad, roll_rad] {
        writer.f64(value);
    }
    for value in velocity {
        writer.f64(value);
    }
    writer.u32(level as u32);
    writer.u8(u8::from(is_on_ground));
}

pub(super) fn read_state(reader: &mut Reader<'_>) -> Result<AgentState, SimulationError> {
    Ok(AgentState {
        position_m: three(reader)?,
        yaw_rad: reader.f64()?,
        pitch_rad: reader.f64()?,
        roll_rad: reader.f64()?,
        velocity: three(reader)?,
        level: reader.u32()? as usize,
        is_on_ground: reader.bool()?,
    })
}

pub(super) fn three(reader: &mut Reader<'_>) -> Result<[f64; 3], SimulationError> {
    Ok([reader.f64()?, reader.f64()?, reader.f64()?])
}

pub(super) fn write_episode(writer: &mut Writer, episode: &Episode) {
    let Episode {
        seed,
        number,
        steps,
        phase,
        end,
        is_faulty,
        parameters,
        target,
        first_m,
        remaining_m,
        path_length_m,
        collisions,
        clipped,
    } = *episode;
    for value in [seed, number, steps] {
        writer.u64(value);
    }
    writer.u8(phase as u8);
    writer.u8(end as u8);
    writer.u8(u8::from(is_faulty));
    for value in [parameters.speed_scale, parameters.yaw_rate_scale] {
        writer.f64(value);
    }
    for value in parameters.mount {
        writer.f64(value);
    }
    match target {
        Target::Goal { index, position_m } => {
            writer.u8(0);
            writer.u32(index);
            for value in position_m {
                writer.f64(value);
            }
        }
        Target::Path { along_m } => {
            writer.u8(1);
            writer.f64(along_m);
        }
        Target::Command => writer.u8(2),
    }
    for value in [first_m, remaining_m, path_length_m] {
        writer.f64(value);
    }
    writer.u32(collisions);
    writer.u32(clipped);
}

/// Greatest count in a snapshot. The counts of an episode that goes on from there stay in range
/// for 2^31 further steps.
const MAX_COUNT: u64 = 1 << 31;

pub(super) fn read_episode(reader: &mut Reader<'_>) -> Result<Episode, SimulationError> {
    let (seed, number, steps) = (reader.u64()?, reader.u64()?, reader.u64()?);
    if number.max(steps) > MAX_COUNT {
        return Err(damaged("a count that no episode reaches"));
    }
    let phase = match reader.u8()? {
        0 => Phase::New,
        1 => Phase::Running,
        2 => Phase::Ended,
        other => return Err(damaged(&format!("the phase {other}"))),
    };
    let code = reader.u8()? as i8;
    let end = EndReason::from_code(code).ok_or_else(|| damaged(&format!("the end {code}")))?;
    let is_faulty = reader.bool()?;
    let (speed_scale, yaw_rate_scale) = (reader.f64()?, reader.f64()?);
    let mut mount = [0.0; 6];
    for value in &mut mount {
        *value = reader.f64()?;
    }
    let target = match reader.u8()? {
        0 => Target::Goal {
            index: reader.u32()?,
            position_m: three(reader)?,
        },
        1 => Target::Path {
            along_m: reader.f64()?,
        },
        2 => Target::Command,
        other => return Err(damaged(&format!("the target {other}"))),
    };
    let (first_m, remaining_m, path_length_m) = (reader.f64()?, reader.f64()?, reader.f64()?);
    let (collisions, clipped) = (reader.u32()?, reader.u32()?);
    if u64::from(collisions.max(clipped)) > MAX_COUNT {
        return Err(damaged("a count that no episode reaches"));
    }
    Ok(Episode {
        seed,
        number,
        steps,
        phase,
        end,
        is_faulty,
        parameters: EpisodeParameters {
            speed_scale,
            yaw_rate_scale,
            mount,
        },
        target,
        first_m,
        remaining_m,
        path_length_m,
        collisions,
        clipped,
    })
}
