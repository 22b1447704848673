"""The tables of docs/reference are those of the code: settings with their defaults, rewards,
numbers of `info`, codes, actions."""

import ast
import importlib
import math
import re
import unittest
from pathlib import Path

import numpy as np
import paws_sim
from gymnasium.vector import AutoresetMode
from paws_sim import simulator

REFERENCE = Path(__file__).parents[3] / "docs/reference"
SETTINGS = (REFERENCE / "simulation-settings.md").read_text()
PYTHON = (REFERENCE / "simulation-python.md").read_text()
CORE = (REFERENCE / "simulation.md").read_text()
# Settings of `WorldConfig` that have an argument of their own in Python.
ARGUMENTS = ("environments", "seed", "task.task", "body_from_camera")
ANGLES = {"π": math.pi, "π/2": math.pi / 2, "π/6": math.pi / 6}
SCENE = "synthetic:room"
CAMERAS = SETTINGS.index("\n## Cameras\n")
# Settings that only cameras of environments have, beside `timing`.
OF_ENVIRONMENTS = ("mount", "budget_bytes")
# What a setting of a camera needs beside it to have an effect.
BESIDE = {
    "noise.readout_e": {"noise": {"full_well_e": 500.0}},
    "shutter.exposure_s": {"shutter": {"blur_poses": 3}},
    "shutter.blur_poses": {"shutter": {"exposure_s": 0.1}},
}


def rows(text, first):
    """Cells of the rows of all tables whose head begins with a cell."""
    found, is_inside = [], False
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if not line.startswith("|"):
            is_inside = False
        elif cells[0].strip("`") == first:
            is_inside = True
        elif is_inside and not set(line) <= set("|- "):
            found.append([cell.strip("`") for cell in cells])
    return found


def default(text):
    """A default as the page writes it."""
    names = "|".join(sorted(ANGLES, key=len, reverse=True))
    text = re.sub(names, lambda found: str(ANGLES[found[0]]), text)
    return eval(text, {"__builtins__": {}})


def flat(settings, prefix=""):
    """Nested settings by their whole names."""
    found = {}
    for name, value in settings.items():
        nested = isinstance(value, dict)
        found.update(flat(value, f"{prefix}{name}.") if nested else {f"{prefix}{name}": value})
    return found


def nested(name, value):
    """A setting by its whole name as nested dictionaries."""
    for part in reversed(name.split(".")):
        value = {part: value}
    return value


class Examples(unittest.TestCase):
    def test_examples_import_what_the_package_has(self):
        folder = Path(__file__).parents[1] / "examples"
        for path in sorted(folder.glob("*.py")):
            for node in ast.walk(ast.parse(path.read_text())):
                if not isinstance(node, ast.ImportFrom) or not node.module.startswith("paws_sim"):
                    continue
                try:
                    module = importlib.import_module(node.module)
                except paws_sim.BackendMissing:
                    # Of the adapters only the name: their trainers are not here.
                    self.assertTrue({name.name for name in node.names} <= {"VecEnv"})
                    continue
                for name in node.names:
                    self.assertTrue(hasattr(module, name.name), f"{path.name}: {name.name}")
        self.assertTrue(any(folder.glob("*.py")))


class Pages(unittest.TestCase):
    def assert_equal(self, name, found, expected):
        if isinstance(expected, (float, list)):
            np.testing.assert_allclose(found, expected, rtol=1e-12, err_msg=name)
        else:
            self.assertEqual(found, expected, name)

    def test_settings_of_worlds_and_their_defaults(self):
        page = {row[0]: default(row[1]) for row in rows(SETTINGS, "setting")}
        page.update({row[1]: default(row[2]) for row in rows(SETTINGS, "term")})
        env = paws_sim.make(SCENE, config={"support": None})
        code = {name: value for name, value in flat(env.config).items() if name not in ARGUMENTS}
        self.assertIsNone(code.pop("support"))
        of_worlds = {row[0] for row in rows(SETTINGS[:CAMERAS], "setting")}
        of_worlds |= {row[1] for row in rows(SETTINGS, "term")}
        of_support = {name for name in of_worlds if name.startswith("support.")}
        timing = {name for name in code if name.startswith("timing.")}
        self.assertEqual(of_worlds - of_support, set(code) - timing)
        for name, value in code.items():
            self.assert_equal(name, page[name], value)

    def test_settings_of_the_prediction(self):
        page = {row[0]: default(row[1]) for row in rows(SETTINGS, "setting")}
        code = paws_sim.make(SCENE, config={"support": {}}).config["support"]
        prefix = "support."
        of_page = {n.removeprefix(prefix): v for n, v in page.items() if n.startswith(prefix)}
        self.assertEqual(of_page, code)

    def test_every_default_of_a_camera_changes_nothing(self):
        cameras = paws_sim.Cameras(SCENE)
        pose = cameras.scene.reference_poses(0)[:1]
        motion = {"velocity": [0.8, 0.2, 0.5], "rate": [0.1, 0.6, 0.2]}
        page = {row[0]: row[1] for row in rows(SETTINGS[CAMERAS:], "setting")}
        for name, text in page.items():
            if name in OF_ENVIRONMENTS or name.startswith("timing."):
                continue
            beside = BESIDE.get(name, {})
            plain = cameras.render(pose, **motion, **beside)
            with_default = simulator.merge_settings(beside, nested(name, default(text)))
            images = cameras.render(pose, **motion, **with_default)
            for key, values in plain.items():
                np.testing.assert_array_equal(images[key], values, f"{name}: {key}")
        env = paws_sim.make(SCENE, observation="depth")
        far_m = env.observation_space["depth"].high.max()
        self.assertEqual(far_m, default(page["far_m"]))
        self.assertEqual(simulator.BUDGET_BYTES, default(page["budget_bytes"]))
        # Color, depth and mask.
        count = default(page["max_bytes"]) // (64 * 64 * (3 + 4 + 1)) + 1
        with self.assertRaisesRegex(paws_sim.BudgetError, page["max_bytes"]):
            cameras.render(np.broadcast_to(pose, (count, 4, 4)))

    def test_timing_of_late_images(self):
        page = [row for row in rows(SETTINGS, "setting") if row[0].startswith("timing.")]
        for column, camera in ((1, {}), (4, {"timing": "gauss_gym"})):
            timing = paws_sim.make(SCENE, camera=camera).config["timing"]
            names = {row[0].removeprefix("timing."): default(row[column]) for row in page}
            self.assertEqual(names, timing)

    def test_terms_of_the_reward(self):
        self.assertEqual([row[0] for row in rows(SETTINGS, "term")], paws_sim.REWARD_TERMS)

    def test_numbers_of_info(self):
        page = {row[0]: row[1] for row in rows(PYTHON, "key")}
        _, info = paws_sim.make_vec(SCENE, 2).reset(seed=0)
        code = {name: str(values.dtype) for name, values in info.items() if name[0] != "_"}
        self.assertEqual(page, code)

    def test_reasons_of_ends(self):
        page = {row[0].replace(" ", "_"): int(row[1]) for row in rows(CORE, "reason")}
        code = {reason.name.lower(): int(reason) for reason in paws_sim.EndReason}
        self.assertEqual({"none": 0, **page}, code)

    def test_modes_of_autoreset(self):
        page = {row[0] for row in rows(PYTHON, "mode")}
        self.assertEqual(page, {mode.value for mode in AutoresetMode})
        for name in page:
            paws_sim.make_vec(SCENE, 1, autoreset_mode=name)

    def test_actions_of_drives(self):
        page = {row[0]: row[1:] for row in rows(PYTHON, "drive")}
        for drive, (components, _) in page.items():
            env = paws_sim.make(SCENE, config={"drive": drive})
            self.assertEqual(env.action_space.shape, (components.count(";") + 1,), drive)
        self.assertEqual(set(simulator._DISCRETE), set(page) - {"free"})
        counts = {drive: len(table) for drive, table in simulator._DISCRETE.items()}
        self.assertEqual(counts, {"differential": 4, "wheels": 4, "holonomic": 6})


if __name__ == "__main__":
    unittest.main()
