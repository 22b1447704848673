use std::sync::atomic::{AtomicUsize, Ordering};

use super::*;
use crate::testing::{self, SyntheticScene};

fn corridor() -> Arc<SceneData> {
    testing::corridor().scene.clone()
}

/// A budget for a number of sectors.
fn budget(scene: &SceneData, sectors: u64) -> ResidencyConfig {
    let gaussians = scene.sectors[0].gaussians.as_ref().unwrap();
    ResidencyConfig {
        budget_bytes: sectors * gaussians.resident_bytes(),
        ..ResidencyConfig::default()
    }
}

/// A store that counts what it loads, of a few Gaussians each; sector 2 fails the first time.
fn counting(scene: &Arc<SceneData>, sectors: u64) -> (GaussianStore, Arc<AtomicUsize>) {
    let count = Arc::new(AtomicUsize::new(0));
    let (of_loader, has_failed) = (count.clone(), AtomicUsize::new(0));
    let small = SyntheticScene::kerb(0.1).unwrap().scene;
    let loader = move |_: &SceneData, sector: usize| {
        of_loader.fetch_add(1, Ordering::SeqCst);
        assert!(
            sector != 2 || has_failed.fetch_add(1, Ordering::SeqCst) > 0,
            "no disk"
        );
        load(&small, 0)
    };
    let config = budget(scene, sectors);
    let store = GaussianStore::with_loader(scene.clone(), config, Box::new(loader));
    (store, count)
}

#[test]
fn longest_unused_sectors_leave() {
    let scene = corridor();
    let (store, count) = counting(&scene, 2);
    for sector in [0, 1, 0, 3] {
        store.content(sector).unwrap();
    }
    assert_eq!(store.resident(), [0, 3]);
    assert_eq!(count.load(Ordering::SeqCst), 3);
    // What a caller has remains valid.
    let kept = store.content(0).unwrap();
    store.content(1).unwrap();
    store.content(3).unwrap();
    assert_eq!(store.resident(), [1, 3]);
    assert!(!kept.exact.splats.is_empty());
}

#[test]
fn a_budget_below_what_is_needed_is_an_error_with_numbers() {
    let scene = corridor();
    let (store, count) = counting(&scene, 1);
    let middle = [6.0, 1.0, 0.0];
    store.update(&[(0, middle)]).unwrap();
    store.content(0).unwrap();
    let error = store.update(&[(0, middle), (1, middle)]).unwrap_err();
    let SimulationError::Budget {
        place,
        needed,
        allowed,
    } = error
    else {
        panic!("{error}");
    };
    let bytes = [0, 1].map(|k| {
        scene.sectors[k]
            .gaussians
            .as_ref()
            .unwrap()
            .resident_bytes()
    });
    assert_eq!(
        (place.as_str(), needed),
        ("Gaussians of side 0, side 1", bytes[0] + bytes[1])
    );
    assert_eq!(allowed, bytes[0]);
    // Required sectors do not leave for another one.
    assert!(matches!(
        store.content(1),
        Err(SimulationError::Budget { .. })
    ));
    assert_eq!(
        (store.resident(), count.load(Ordering::SeqCst)),
        (vec![0], 1)
    );
}

#[test]
fn sectors_beyond_a_near_border_are_loaded_ahead() {
    let scene = corridor();
    let (store, count) = counting(&scene, 4);
    // In the middle both ends are 4 m away: within 8 m.
    store.update(&[(0, [6.0, 1.0, 0.0])]).unwrap();
    store.wait_for_prefetch();
    assert_eq!(store.resident(), [1, 3]);
    assert_eq!(count.load(Ordering::SeqCst), 2);
    // Only the nearer one has room beside the required one; it does not leave again for the other.
    let (store, count) = counting(&scene, 2);
    store.content(0).unwrap();
    for _ in 0..3 {
        store.update(&[(0, [6.5, 1.0, 0.0])]).unwrap();
        store.wait_for_prefetch();
    }
    assert_eq!(store.resident(), [0, 1]);
    assert_eq!(count.load(Ordering::SeqCst), 2);
}

/// Images are rendered meanwhile.
#[test]
fn sectors_are_loaded_ahead_by_one_thread() {
    let scene = corridor();
    let small = SyntheticScene::kerb(0.1).unwrap().scene;
    let threads = Arc::new(AtomicUsize::new(0));
    let of_loader = threads.clone();
    let loader = move |_: &SceneData, _: usize| {
        of_loader.fetch_max(rayon::current_num_threads(), Ordering::SeqCst);
        load(&small, 0)
    };
    let store = GaussianStore::with_loader(scene.clone(), budget(&scene, 4), Box::new(loader));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build();
    let update = || store.update(&[(0, [6.0, 1.0, 0.0])]);
    pool.unwrap().install(update).unwrap();
    store.wait_for_prefetch();
    assert_eq!(store.resident(), [1, 3]);
    assert_eq!(threads.load(Ordering::SeqCst), 1);
}

#[test]
fn failures_ahead_are_errors_of_the_call_that_needs_the_sector() {
    let scene = corridor();
    let (store, _) = counting(&scene, 4);
    // From side 1 the failing side 2 and side 0 are ahead.
    store.update(&[(1, [6.0, 1.0, 0.25])]).unwrap();
    store.wait_for_prefetch();
    assert_eq!(store.resident(), [0]);
    store.content(1).unwrap();
    let error = store.content(2).unwrap_err();
    let place = "Gaussians of sector side 2: found a panic while they were loaded";
    assert!(error.to_string().starts_with(place), "{error}");
    // The next call tries again.
    store.content(2).unwrap();
}

#[test]
fn content_does_not_depend_on_what_was_loaded_before() {
    let scene = corridor();
    let ahead = GaussianStore::new(scene.clone(), budget(&scene, 4));
    ahead.update(&[(0, [6.0, 1.0, 0.0])]).unwrap();
    ahead.wait_for_prefetch();
    // A store in which each sector makes the one before leave.
    let single = GaussianStore::new(scene.clone(), budget(&scene, 1));
    for sector in [2, 1, 0, 3, 1] {
        let source = scene.sectors[sector].gaussians.as_ref().unwrap();
        let expected = source.load().unwrap();
        for store in [&ahead, &single] {
            let content = store.content(sector).unwrap();
            assert_eq!(content.exact.splats, expected.splats, "sector {sector}");
        }
        let other = scene.sectors[(sector + 1) % 4].gaussians.as_ref().unwrap();
        assert_ne!(expected.splats, other.load().unwrap().splats);
    }
}

#[test]
fn many_threads_get_the_same_sector_once() {
    let scene = corridor();
    let (store, count) = counting(&scene, 4);
    std::thread::scope(|scope| {
        for _ in 0..8 {
            scope.spawn(|| store.content(3).unwrap());
        }
    });
    assert_eq!(count.load(Ordering::SeqCst), 1);
}

#[test]
fn unknown_sectors_are_errors() {
    let scene = corridor();
    let (store, _) = counting(&scene, 4);
    assert!(matches!(
        store.content(4),
        Err(SimulationError::Setting { .. })
    ));
    let places = [(7, [0.0; 3])];
    assert!(matches!(
        store.update(&places),
        Err(SimulationError::Setting { .. })
    ));
}

#[test]
fn a_store_with_a_thread_is_refused_in_a_child_process() {
    let scene = corridor();
    let (store, _) = counting(&scene, 4);
    let places = [(0, [6.0, 1.0, 0.0])];
    store.update(&places).unwrap();
    store.wait_for_prefetch();
    // What a child sees: the thread belongs to another process.
    store
        .process
        .store(std::process::id() + 1, Ordering::SeqCst);
    assert!(matches!(store.content(0), Err(SimulationError::State(_))));
    assert!(matches!(
        store.update(&places),
        Err(SimulationError::State(_))
    ));
}
