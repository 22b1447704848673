"""A walk as a function of time, and what an IMU measures on it.

The body is the IMU: x forward, y left, z up; the world has z up. All times in s from the start.
Angular rate and specific force are derivatives of the pose by differences of fourth order with a
step of 1 ms: their error is below 1e-6 rad/s and 1e-6 m/s^2, checked by `check`.
"""

import numpy as np

GRAVITY = 9.81
AT_REST_S = 1.5
SPEED = 0.9
STEP_HZ = 1.8
STEP_S = 1e-3


def smooth(t, start, end):
    """0 before start, 1 after end, three times differentiable in between."""
    x = np.clip((t - start) / (end - start), 0.0, 1.0)
    return x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3)


def distance(t):
    """Distance walked: at rest, then within 1.5 s to SPEED. Integral of `smooth`."""
    x = np.clip((t - AT_REST_S) / 1.5, 0.0, 1.0)
    ramp = 7 * x**5 - 14 * x**6 + 10 * x**7 - 2.5 * x**8
    return SPEED * (1.5 * ramp + np.maximum(t - AT_REST_S - 1.5, 0.0))


def rotation(yaw, pitch, roll):
    cy, sy, cp, sp, cr, sr = (f(a) for a in (yaw, pitch, roll) for f in (np.cos, np.sin))
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1.0]])
    y = np.array([[cp, 0, sp], [0, 1.0, 0], [-sp, 0, cp]])
    x = np.array([[1.0, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return z @ y @ x


def pose(t):
    """world_from_body: an oval of 3.4 by 2.2 m, with steps, sway and the looks of a person."""
    s = distance(t)
    angle = s / 2.8
    walking = smooth(t, AT_REST_S, AT_REST_S + 1.5)
    phase = 2 * np.pi * STEP_HZ * t
    lateral = 0.02 * walking * np.sin(phase / 2)
    p = np.array(
        [
            (3.4 + lateral) * np.sin(angle),
            -(2.2 + lateral) * np.cos(angle),
            1.35 + 0.02 * walking * np.sin(phase),
        ]
    )
    tangent = np.arctan2(2.2 * np.sin(angle), 3.4 * np.cos(angle))
    # atan2 jumps once a round; the angle itself does not.
    tangent += 2 * np.pi * np.round((angle - tangent) / (2 * np.pi))
    yaw = tangent + walking * (0.10 * np.sin(0.9 * t) + 0.02 * np.sin(phase / 2 + 0.4))
    pitch = 0.10 + walking * 0.012 * np.sin(phase + 1.0)
    roll = walking * 0.015 * np.sin(phase / 2 + 0.8)
    return rotation(yaw, pitch, roll), p


def vee(m):
    return np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]) / 2


def inertial(t, h=STEP_S):
    """Velocity, angular rate in the body (rad/s), specific force in the body (m/s^2)."""
    at = [pose(t + k * h) for k in (-2, -1, 0, 1, 2)]
    r, p = [a[0] for a in at], [a[1] for a in at]
    rate = vee(r[2].T @ ((r[0] - 8 * r[1] + 8 * r[3] - r[4]) / (12 * h)))
    velocity = (p[0] - 8 * p[1] + 8 * p[3] - p[4]) / (12 * h)
    acceleration = (-p[0] + 16 * p[1] - 30 * p[2] + 16 * p[3] - p[4]) / (12 * h * h)
    return velocity, rate, r[2].T @ (acceleration + np.array([0, 0, GRAVITY]))


def quaternion(r):
    """w x y z, w positive."""
    w = np.sqrt(max(0.0, 1 + r[0, 0] + r[1, 1] + r[2, 2])) / 2
    if w > 1e-3:
        x, y, z = vee(r) / (2 * w)
        return np.array([w, x, y, z])
    k = int(np.argmax(np.diag(r)))
    i, j = (k + 1) % 3, (k + 2) % 3
    v = np.zeros(3)
    v[k] = np.sqrt(1 + r[k, k] - r[i, i] - r[j, j]) / 2
    v[i], v[j] = (r[k, i] + r[i, k]) / (4 * v[k]), (r[k, j] + r[j, k]) / (4 * v[k])
    w = (r[j, i] - r[i, j]) / (4 * v[k])
    q = np.array([w, *v])
    return q if w >= 0 else -q


def check():
    """Halving the step changes rates and forces by less than what the module states."""
    for t in np.arange(0.3, 14.0, 0.37):
        coarse, fine = inertial(t), inertial(t, STEP_S / 2)
        for a, b in zip(coarse[1:], fine[1:]):
            if np.abs(a - b).max() > 1e-6:
                raise SystemExit(f"derivatives at {t:.2f} s differ by {np.abs(a - b).max():.1e}")
