"""Trains agents with the example of the Python package, from their state alone, and counts successes
on unseen goals."""

import time

import common


def state(scene, question):
    example = common.load(question["examples"], "train_point_goal")
    config = common.config(example.CONFIG)
    goals = {"episodes": question["goals"], "goal_seed": common.GOAL_SEED}
    random = example.evaluate(scene, config, example.random_actions(), **goals)
    curves, times = [], []
    for _ in range(2):
        wall, cpu = time.perf_counter(), time.process_time()
        model, curve = example.train(
            scene, config, steps=question["steps"], seed=question["seed"]
        )
        times.append({"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu})
        curves.append(curve)

    def act(observations):
        return model.predict(observations, deterministic=True)[0]

    trained = example.evaluate(scene, config, act, **goals)
    goals["goal_seed"] = common.HELD_BACK_GOAL_SEED
    held_back = example.evaluate(scene, config, act, **goals)
    for result in (random, trained, held_back):
        del result["returns"]
    return {
        "random": random,
        "trained": trained,
        "trained_held_back": held_back,
        "curve": curves[0],
        "same_seed_same_curve": curves[0] == curves[1],
        "times": times,
        "steps": question["steps"],
    }


common.answer(state)
