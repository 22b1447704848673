"""Memory stays as it is over many images, while Gaussians of sectors are loaded and leave."""

import os
import unittest
from pathlib import Path

import numpy as np
import paws_sim

LOOP = paws_sim.open_scene("synthetic:corridor-loop")
# Upper bound of the memory of a Gaussian of degree 0 with its levels of detail.
GAUSSIAN_BYTES = 420
ROUNDS = 12
# What the allocator may keep more: less than half of the images of all rounds.
MOST_GROWTH_BYTES = 6 << 20


def resident_bytes() -> int:
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


@unittest.skipUnless(Path("/proc/self/statm").exists(), "the memory is read from /proc")
class Memory(unittest.TestCase):
    def grows(self, round_of_images):
        """Growth from a third of the rounds on, after which caches are full, bytes."""
        for _ in range(ROUNDS // 3):
            round_of_images()
        before = resident_bytes()
        for _ in range(ROUNDS - ROUNDS // 3):
            round_of_images()
        return resident_bytes() - before

    def test_images_from_sectors_that_leave(self):
        sector_bytes = max(LOOP.gaussians) * GAUSSIAN_BYTES
        cameras = paws_sim.Cameras(LOOP, budget_bytes=int(2.1 * sector_bytes))
        poses = [LOOP.reference_poses(sector)[:8] for sector in range(4)]
        seen = []

        def around():
            for sector in range(4):
                images = cameras.render(poses[sector], 128, 96, sectors=[sector] * 8)
                self.assertTrue(images["has_depth"].any())
                seen.append(sector in cameras._core.resident())
                self.assertLessEqual(len(cameras._core.resident()), 2)

        # Two sectors may be there that were not before; 32 of them were loaded since.
        self.assertLess(self.grows(around), 2 * sector_bytes)
        self.assertTrue(all(seen))

    def test_steps_with_images(self):
        vector = paws_sim.make_vec(
            LOOP,
            4,
            observation=("rgb", "depth"),
            camera={"width": 64, "height": 48},
            config={"end": {"time_limit_s": 1.0}},
        )
        vector.reset(seed=0)
        random = np.random.default_rng(1)

        def steps():
            for _ in range(20):
                vector.step(random.uniform(-1.0, 1.0, (4, 2)))

        self.assertLess(self.grows(steps), MOST_GROWTH_BYTES)
        vector.close()


if __name__ == "__main__":
    unittest.main()
