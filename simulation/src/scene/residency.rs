//! Gaussians in memory: those of the sectors that are in view, within a budget of bytes.
//!
//! Contract: a sector that is needed is waited for, however long it takes, so that images do not
//! depend on the speed of the disk. A thread loads sectors ahead, by the distance to the border
//! over which an agent would get there; it starts with the first prefetch, not before, and never
//! makes others leave that are needed. Otherwise those used longest ago leave. What failed is an
//! error of the call that needs the sector; the next such call tries again.

pub(super) mod content;
mod shared;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;

use estimator_config::config;

use self::content::SectorGaussians;
use self::shared::{Loader, Shared, Slot, State, load};
use super::data::SceneData;
use crate::error::SimulationError;

config! {
    /// Memory for Gaussians.
    pub struct ResidencyConfig {
        /// Memory for the Gaussians of all sectors together, bytes. Too little for the sectors
        /// that one step needs is an error with both numbers.
        pub budget_bytes: u64 = 2 << 30,
        /// Distance to a border at which the sector beyond is loaded ahead, m: 5 s of walking. Less
        /// waits at the border, more loads what is not used.
        pub prefetch_m: f64 = 8.0,
    }
}

/// Gaussians of a scene's sectors, those in memory.
///
/// ```
/// use simulation::testing::SyntheticScene;
/// use simulation::{GaussianStore, ResidencyConfig};
///
/// let room = SyntheticScene::room()?;
/// let store = GaussianStore::new(room.scene.clone(), ResidencyConfig::default());
/// let content = store.content(0)?;
/// let gaussians = room.scene.sectors[0].gaussians.as_ref().unwrap();
/// assert_eq!(content.exact.splats.len(), gaussians.count());
/// assert_eq!(store.resident(), [0]);
/// # Ok::<(), simulation::SimulationError>(())
/// ```
pub struct GaussianStore {
    shared: Arc<Shared>,
    config: ResidencyConfig,
    thread: Mutex<Option<Prefetcher>>,
    /// Process of the thread, 0 before there is one. Checked before any lock, which the thread may
    /// have held at a fork.
    process: AtomicU32,
}

struct Prefetcher {
    handle: JoinHandle<()>,
    process: u32,
}

impl GaussianStore {
    /// A store without anything in it; no thread is started and nothing loaded.
    pub fn new(scene: Arc<SceneData>, config: ResidencyConfig) -> Self {
        Self::with_loader(scene, config, Box::new(load))
    }

    fn with_loader(scene: Arc<SceneData>, config: ResidencyConfig, loader: Loader) -> Self {
        Self {
            shared: Arc::new(Shared {
                scene,
                loader,
                state: Mutex::default(),
                changed: Condvar::new(),
            }),
            config,
            thread: Mutex::new(None),
            process: AtomicU32::new(0),
        }
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<SceneData> {
        &self.shared.scene
    }

    /// Sectors that are in memory, by index.
    pub fn resident(&self) -> Vec<usize> {
        let state = self.shared.lock();
        let is_resident = |slot: &Slot| matches!(slot, Slot::Resident { .. });
        let resident = state.slots.iter().filter(|(_, slot)| is_resident(slot));
        resident.map(|(sector, _)| *sector).collect()
    }

    /// Gaussians of all sectors that images from places show, by sector: [`Self::update`], and what
    /// it requires. Callers on several threads do not count for the budget of each other.
    ///
    /// # Errors
    /// As [`Self::update`] and [`Self::content`].
    pub(crate) fn contents(
        &self,
        places: &[(usize, [f64; 3])],
    ) -> Result<BTreeMap<usize, Arc<SectorGaussians>>, SimulationError> {
        let required = self.require(places)?;
        let content = |sector: &usize| Ok((*sector, self.content_beside(*sector, &required)?));
        required.iter().map(content).collect()
    }

    /// States where agents and cameras are, each a sector and a position in its frame, m: their
    /// sectors must stay in memory together, those beyond near borders are loaded ahead. Costs no
    /// wait.
    ///
    /// # Errors
    /// [`SimulationError::Budget`] if the sectors do not fit in the budget together,
    /// [`SimulationError::Setting`] for an unknown sector, [`SimulationError::State`] in a child
    /// process of the one that used the store first. The store is then as before.
    pub fn update(&self, places: &[(usize, [f64; 3])]) -> Result<(), SimulationError> {
        self.require(places).map(drop)
    }

    /// Sectors that images from places show, in order.
    fn require(&self, places: &[(usize, [f64; 3])]) -> Result<Vec<usize>, SimulationError> {
        self.check_process()?;
        let scene = &self.shared.scene;
        let mut required: Vec<usize> = Vec::new();
        // By the nearest border first.
        let mut ahead: BTreeMap<usize, f64> = BTreeMap::new();
        for (sector, at_m) in places {
            self.check(*sector)?;
            required.push(*sector);
            if let Some((edge, _)) = scene.fade(*sector, *at_m) {
                required.push(edge.to);
            }
            for (to, distance_m) in scene.borders(*sector, *at_m) {
                if distance_m <= self.config.prefetch_m {
                    let nearest = ahead.entry(to).or_insert(distance_m);
                    *nearest = nearest.min(distance_m);
                }
            }
        }
        required.sort_unstable();
        required.dedup();
        self.fits(&required)?;
        let mut wishes: Vec<(f64, usize)> = ahead
            .into_iter()
            .filter(|(sector, _)| !required.contains(sector) && self.bytes(*sector) > 0)
            .map(|(sector, distance_m)| (distance_m, sector))
            .collect();
        wishes.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let ahead: Vec<usize> = wishes.into_iter().map(|(_, sector)| sector).collect();
        let has_wishes = !ahead.is_empty();
        if has_wishes {
            self.start()?;
        }
        let mut state = self.shared.lock();
        state.required.clone_from(&required);
        state.wishes = ahead.iter().rev().copied().collect();
        state.ahead = ahead;
        drop(state);
        if has_wishes {
            self.shared.changed.notify_all();
        }
        Ok(required)
    }

    /// Gaussians of a sector. Waits for them, or loads them in the calling thread.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] for a sector without Gaussians and for files that changed, also
    /// where they failed ahead; [`SimulationError::Budget`] if the sector does not fit beside those
    /// of the last [`Self::update`]; [`SimulationError::Setting`] for an unknown sector;
    /// [`SimulationError::State`] as for `update`.
    pub fn content(&self, sector: usize) -> Result<Arc<SectorGaussians>, SimulationError> {
        self.check_process()?;
        let required = self.shared.lock().required.clone();
        self.content_beside(sector, &required)
    }

    /// Gaussians of a sector, within the budget beside others.
    fn content_beside(
        &self,
        sector: usize,
        required: &[usize],
    ) -> Result<Arc<SectorGaussians>, SimulationError> {
        self.check(sector)?;
        let mut state = self.shared.lock();
        loop {
            state.clock += 1;
            let clock = state.clock;
            match state.slots.get_mut(&sector) {
                Some(Slot::Resident { content, used }) => {
                    *used = clock;
                    return Ok(content.clone());
                }
                Some(Slot::Loading) => {
                    state = self.shared.wait(state);
                }
                Some(Slot::Failed(_)) => {
                    if let Some(Slot::Failed(error)) = state.slots.remove(&sector) {
                        return Err(error);
                    }
                }
                None => break,
            }
        }
        let mut needed = required.to_vec();
        needed.push(sector);
        needed.sort_unstable();
        needed.dedup();
        self.fits(&needed)?;
        // The sector is needed now: what other threads load meanwhile may exceed the budget until
        // it leaves.
        let mut leaving = Vec::new();
        let budget_bytes = self.config.budget_bytes;
        self.shared
            .make_room(&mut state, &needed, budget_bytes, &mut leaving);
        state.slots.insert(sector, Slot::Loading);
        drop(state);
        drop(leaving);
        let loaded = self.shared.load(sector);
        let mut state = self.shared.lock();
        state.slots.remove(&sector);
        let content = loaded.map(Arc::new);
        if let Ok(content) = &content {
            let (content, used) = (content.clone(), state.clock);
            state.slots.insert(sector, Slot::Resident { content, used });
        }
        drop(state);
        self.shared.changed.notify_all();
        content
    }

    /// Waits until nothing more is loaded ahead, for measurements with and without prefetch.
    pub fn wait_for_prefetch(&self) {
        let mut state = self.shared.lock();
        let is_busy = |state: &State| {
            let is_loading = |slot: &Slot| matches!(slot, Slot::Loading);
            !state.wishes.is_empty() || state.slots.values().any(is_loading)
        };
        while is_busy(&state) {
            state = self.shared.wait(state);
        }
    }

    /// Refuses a child process of the one that has the thread.
    fn check_process(&self) -> Result<(), SimulationError> {
        let process = self.process.load(Ordering::Acquire);
        if process == 0 || process == std::process::id() {
            return Ok(());
        }
        let text = "the store of Gaussians was used before a fork: open it in the child";
        Err(SimulationError::State(text.to_owned()))
    }

    fn check(&self, sector: usize) -> Result<(), SimulationError> {
        let count = self.shared.scene.sectors.len();
        match sector < count {
            true => Ok(()),
            false => Err(SimulationError::Setting {
                name: "sector".to_owned(),
                found: sector.to_string(),
                expected: format!("below {count}"),
            }),
        }
    }

    fn bytes(&self, sector: usize) -> u64 {
        self.shared.bytes(sector)
    }

    fn fits(&self, sectors: &[usize]) -> Result<(), SimulationError> {
        let needed = sectors.iter().map(|sector| self.bytes(*sector)).sum();
        if needed <= self.config.budget_bytes {
            return Ok(());
        }
        let names: Vec<&str> = sectors
            .iter()
            .map(|sector| self.shared.scene.sectors[*sector].name.as_str())
            .collect();
        Err(SimulationError::Budget {
            place: format!("Gaussians of {}", names.join(", ")),
            needed,
            allowed: self.config.budget_bytes,
        })
    }

    /// Starts the thread that loads ahead.
    fn start(&self) -> Result<(), SimulationError> {
        let mut thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner);
        if thread.is_some() {
            return Ok(());
        }
        let (shared, budget_bytes) = (self.shared.clone(), self.config.budget_bytes);
        let builder = std::thread::Builder::new().name("prefetch".to_owned());
        let handle = builder.spawn(move || shared.prefetch(budget_bytes));
        let handle = handle.map_err(|error| {
            SimulationError::State(format!("no thread for loading sectors ahead: {error}"))
        })?;
        let process = std::process::id();
        *thread = Some(Prefetcher { handle, process });
        self.process.store(process, Ordering::Release);
        Ok(())
    }
}

impl Drop for GaussianStore {
    fn drop(&mut self) {
        let thread = self
            .thread
            .get_mut()
            .unwrap_or_else(PoisonError::into_inner);
        let Some(thread) = thread.take() else {
            return;
        };
        // In a child process the thread does not exist.
        if thread.process == std::process::id() {
            self.shared.lock().is_closing = true;
            self.shared.changed.notify_all();
            // A panic of the loader was caught and reported.
            drop(thread.handle.join());
        }
    }
}

#[cfg(test)]
mod tests;
