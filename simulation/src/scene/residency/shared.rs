//! What the callers of a store and its thread share: slots of sectors, and who leaves.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use splats::{DetailConfig, DetailScene};

use super::content::SectorGaussians;
use crate::error::SimulationError;
use crate::scene::data::SceneData;

pub(super) struct Shared {
    pub(super) scene: Arc<SceneData>,
    pub(super) loader: Loader,
    pub(super) state: Mutex<State>,
    /// Something was loaded, failed or is wished for.
    pub(super) changed: Condvar,
}

/// Loads the Gaussians of a sector.
pub(super) type Loader =
    Box<dyn Fn(&SceneData, usize) -> Result<SectorGaussians, SimulationError> + Send + Sync>;

#[derive(Default)]
pub(super) struct State {
    pub(super) slots: BTreeMap<usize, Slot>,
    /// Number of the request that used a sector last; grows.
    pub(super) clock: u64,
    /// Sectors that must not leave.
    pub(super) required: Vec<usize>,
    /// Sectors that may be needed soon, the nearest one first.
    pub(super) ahead: Vec<usize>,
    /// Those of them that are still to be loaded, the nearest one last.
    pub(super) wishes: Vec<usize>,
    pub(super) is_closing: bool,
}

pub(super) enum Slot {
    Loading,
    Failed(SimulationError),
    Resident {
        content: Arc<SectorGaussians>,
        used: u64,
    },
}

impl Shared {
    pub(super) fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn wait<'a>(&self, state: MutexGuard<'a, State>) -> MutexGuard<'a, State> {
        let waited = self.changed.wait(state);
        waited.unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn bytes(&self, sector: usize) -> u64 {
        let gaussians = self.scene.sectors[sector].gaussians.as_ref();
        gaussians.map_or(0, |gaussians| gaussians.resident_bytes())
    }

    /// Loads a sector; a panic is an error as well.
    pub(super) fn load(&self, sector: usize) -> Result<SectorGaussians, SimulationError> {
        let loading = AssertUnwindSafe(|| (self.loader)(&self.scene, sector));
        catch_unwind(loading).unwrap_or_else(|_| {
            Err(SimulationError::Scene {
                place: format!("Gaussians of sector {}", self.scene.sectors[sector].name),
                found: "a panic while they were loaded".to_owned(),
                expected: "Gaussians".to_owned(),
            })
        })
    }

    /// Removes sectors used longest ago until the needed ones fit; false if they do not because of
    /// others that are being loaded. What leaves is the caller's to drop without the lock: that
    /// takes milliseconds, for which images would wait. Until then its memory is used, although it
    /// counts as free.
    pub(super) fn make_room(
        &self,
        state: &mut State,
        needed: &[usize],
        budget_bytes: u64,
        leaving: &mut Vec<(usize, Slot)>,
    ) -> bool {
        let of_needed: u64 = needed.iter().map(|sector| self.bytes(*sector)).sum();
        loop {
            let kept = state
                .slots
                .iter()
                .filter(|(_, slot)| !matches!(slot, Slot::Failed(_)));
            let others = kept.filter(|(sector, _)| !needed.contains(sector));
            let of_others: u64 = others.map(|(sector, _)| self.bytes(*sector)).sum();
            if of_others + of_needed <= budget_bytes {
                return true;
            }
            let resident = state.slots.iter().filter_map(|(sector, slot)| match slot {
                Slot::Resident { used, .. } if !needed.contains(sector) => Some((*used, *sector)),
                _ => None,
            });
            let Some((_, oldest)) = resident.min() else {
                return false;
            };
            leaving.extend(state.slots.remove_entry(&oldest));
        }
    }

    /// Loads what is wished for until the store closes, on this thread alone: images are rendered
    /// meanwhile.
    pub(super) fn prefetch(&self, budget_bytes: u64) {
        // Its registry is not freed when the thread ends: some kilobytes for each store.
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .use_current_thread()
            .build();
        if let Err(error) = &pool {
            log::warn!("sectors are loaded ahead by several threads: {error}");
        }
        let mut state = self.lock();
        while !state.is_closing {
            let Some(sector) = state.wishes.pop() else {
                self.changed.notify_all();
                let waited = self
                    .changed
                    .wait_while(state, |s| s.wishes.is_empty() && !s.is_closing);
                state = waited.unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            if state.slots.contains_key(&sector) {
                continue;
            }
            // Neither required sectors nor nearer ones leave for it.
            let nearer = state.ahead.iter().take_while(|nearer| **nearer != sector);
            let mut needed: Vec<usize> = state.required.iter().chain(nearer).copied().collect();
            needed.push(sector);
            let bytes: u64 = needed.iter().map(|sector| self.bytes(*sector)).sum();
            if bytes > budget_bytes {
                continue;
            }
            let mut leaving = Vec::new();
            if !self.make_room(&mut state, &needed, budget_bytes, &mut leaving) {
                // For nothing.
                state.slots.extend(leaving);
                continue;
            }
            state.slots.insert(sector, Slot::Loading);
            drop(state);
            drop(leaving);
            let loaded = self.load(sector);
            state = self.lock();
            let used = state.clock;
            let slot = match loaded {
                Ok(content) => Slot::Resident {
                    content: Arc::new(content),
                    used,
                },
                Err(error) => Slot::Failed(error),
            };
            state.slots.insert(sector, slot);
            self.changed.notify_all();
        }
    }
}

pub(super) fn load(scene: &SceneData, sector: usize) -> Result<SectorGaussians, SimulationError> {
    let of = &scene.sectors[sector];
    let wrong = |found: String| SimulationError::Scene {
        place: format!("sector {}", of.name),
        found,
        expected: "Gaussians, output splats".to_owned(),
    };
    let source = of.gaussians.as_ref();
    let source = source.ok_or_else(|| wrong("none".to_owned()))?;
    let exact = source.load()?;
    let is_compensated = source.is_compensated();
    let detail = DetailScene::new(&exact, &DetailConfig::for_compensation(is_compensated));
    Ok(SectorGaussians {
        detail: detail.map_err(|error| wrong(error.to_string()))?,
        exact,
        is_compensated,
    })
}
