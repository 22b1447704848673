//! Steps take no memory.

use counting_allocator::{CountingAllocator, peak_of};
use simulation::testing::SyntheticScene;
use simulation::{Task, TimingConfig, World, WorldConfig};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

#[test]
fn steps_allocate_nothing() {
    let scene = SyntheticScene::room().unwrap().scene;
    for (task, timing) in [
        (Task::PointGoal, TimingConfig::default()),
        (Task::FollowPath, TimingConfig::default()),
        (Task::Velocity, TimingConfig::default()),
        (Task::Velocity, TimingConfig::gauss_gym()),
    ] {
        // So few environments that all are advanced by this thread.
        let mut config = WorldConfig {
            environments: 16,
            ..WorldConfig::default()
        };
        config.task.task = task;
        config.timing = timing;
        config.task.goals = 2;
        let mut world = World::new(scene.clone(), config).unwrap();
        world.reset(None, None).unwrap();
        let actions: Vec<f64> = (0..32).map(|i| 0.06 * f64::from(i) - 0.9).collect();
        let (moved, bytes) = peak_of(|| {
            let mut moved = 0.0;
            for _ in 0..200 {
                let result = world.step(&actions).unwrap();
                moved += result.path_length_m.iter().sum::<f32>();
            }
            moved
        });
        assert_eq!(bytes, 0, "{task:?}");
        assert!(moved > 100.0, "{task:?}: {moved}");
    }
}
