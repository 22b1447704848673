"""GTSAM's smoother on the same keyframes, bearings and IMU samples, from the same first state.

Takes JSON on its standard input and gives JSON back. `{"where": true}` gives GTSAM's version and the
file of tracks that its package brings. Anything else is the problem: after each keyframe the
whole graph so far is optimized (Levenberg-Marquardt), which no fixed lag or iSAM2 can beat; the
causal pose of a keyframe is the newest of its optimization, the smoothed poses are those of the
last one. Covariances are the inverse of GTSAM's Hessian.
"""

import importlib.metadata
import json
import os
import sys

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, L, V, X

OUTLIER_SIGMA = 5.0
# Prior of a landmark: without parallax its range is not determined. The room has 8 m.
GUESSED_RANGE_M, LANDMARK_SIGMA_M = 4.0, 4.0
# Depth below which a landmark is wrong: its Jacobian makes the whole problem singular.
MIN_DEPTH_M = 0.3


def where():
    folder = os.path.dirname(gtsam.__file__)
    path = os.path.join(folder, "Data", "eqvio_processed_30s.csv")
    return {"version": importlib.metadata.version("gtsam"), "file": path}


def pose(wxyz, p):
    return gtsam.Pose3(gtsam.Rot3.Quaternion(*wxyz), np.array(p))


class Smoother:
    def __init__(self, problem):
        self.problem = problem
        self.extrinsics = pose(*problem["imu_from_camera"])
        self.camera = gtsam.Cal3_S2(*problem["intrinsics"][:2], 0.0, *problem["intrinsics"][2:])
        self.sigma = problem["observation_sigma_px"]
        huber = gtsam.noiseModel.mEstimator.Huber.Create(problem["huber_sigma"])
        plain = gtsam.noiseModel.Isotropic.Sigma(2, self.sigma)
        self.pixel = gtsam.noiseModel.Robust.Create(huber, plain)
        self.weak = gtsam.noiseModel.Isotropic.Sigma(3, LANDMARK_SIGMA_M)
        self.guesses = {}
        self.motion = gtsam.NonlinearFactorGraph()
        self.observations = {}
        self.banned = set()
        self.values = gtsam.Values()
        self.params = self.imu_params()
        position, rotation, velocity, gyro, accel = problem["sigmas"]
        first = pose(*problem["first_pose"])
        velocity_at = np.array(problem["first_velocity"])
        bias = gtsam.imuBias.ConstantBias()
        sigmas = lambda *parts: gtsam.noiseModel.Diagonal.Sigmas(np.repeat(parts, 3))
        self.motion.add(gtsam.PriorFactorPose3(X(0), first, sigmas(rotation, position)))
        self.motion.add(gtsam.PriorFactorVector(V(0), velocity_at, sigmas(velocity)))
        self.motion.add(gtsam.PriorFactorConstantBias(B(0), bias, sigmas(accel, gyro)))
        self.values.insert(X(0), first)
        self.values.insert(V(0), velocity_at)
        self.values.insert(B(0), bias)

    def imu_params(self):
        noise = self.problem["noise"]
        params = gtsam.PreintegrationCombinedParams.MakeSharedU(self.problem["gravity"])
        eye = np.eye(3)
        params.setGyroscopeCovariance(noise["gyro"] ** 2 * eye)
        params.setAccelerometerCovariance(noise["accel"] ** 2 * eye)
        params.setIntegrationCovariance(1e-7 * eye)
        params.setBiasOmegaCovariance(noise["gyro_walk"] ** 2 * eye)
        params.setBiasAccCovariance(noise["accel_walk"] ** 2 * eye)
        return params

    def integrate(self, k):
        """From keyframe k - 1 to k, with the mean of neighboring samples over each interval."""
        problem = self.problem
        begin, end = problem["times"][k - 1], problem["times"][k]
        bias = self.values.atConstantBias(B(k - 1))
        measured = gtsam.PreintegratedCombinedMeasurements(self.params, bias)
        t = self.imu_times
        at = lambda s: np.array([np.interp(s, t, self.imu_values[:, c]) for c in range(6)])
        inside = t[(t > begin) & (t < end)]
        stamps = np.concatenate([[begin], inside, [end]])
        rows = np.array([at(s) for s in stamps])
        for a, b, low, high in zip(stamps[:-1], stamps[1:], rows[:-1], rows[1:]):
            mean = (low + high) / 2
            measured.integrateMeasurement(mean[3:], mean[:3], (b - a) * 1e-9)
        return measured

    def add_keyframe(self, k):
        measured = self.integrate(k)
        state = gtsam.NavState(
            self.values.atPose3(X(k - 1)), self.values.atVector(V(k - 1))
        )
        bias = self.values.atConstantBias(B(k - 1))
        predicted = measured.predict(state, bias)
        self.values.insert(X(k), predicted.pose())
        self.values.insert(V(k), predicted.velocity())
        self.values.insert(B(k), bias)
        self.motion.add(
            gtsam.CombinedImuFactor(X(k - 1), V(k - 1), X(k), V(k), B(k - 1), B(k), measured)
        )

    def ray(self, k, pixel):
        """Origin and direction of a bearing in the world."""
        camera = self.values.atPose3(X(k)).compose(self.extrinsics)
        u, v = self.camera.calibrate(pixel)
        direction = camera.rotation().matrix() @ np.array([u, v, 1.0])
        return camera.translation(), direction / np.linalg.norm(direction)

    def add_bearings(self, k):
        for landmark, pixel in self.problem["tracks"][k]:
            if landmark in self.banned:
                continue
            seen = self.observations.setdefault(landmark, {})
            seen[k] = np.array(pixel)
            if landmark not in self.guesses:
                origin, direction = self.ray(k, seen[k])
                self.guesses[landmark] = origin + GUESSED_RANGE_M * direction
                self.values.insert(L(landmark), self.guesses[landmark])

    def graph(self):
        graph = gtsam.NonlinearFactorGraph(self.motion)
        for landmark, seen in self.observations.items():
            guess = self.guesses[landmark]
            graph.add(gtsam.PriorFactorPoint3(L(landmark), guess, self.weak))
            for k, pixel in seen.items():
                graph.add(
                    gtsam.GenericProjectionFactorCal3_S2(
                        pixel, self.pixel, X(k), L(landmark), self.camera, False, False,
                        self.extrinsics,
                    )
                )
        return graph

    def optimize(self, rounds):
        params = gtsam.LevenbergMarquardtParams()
        params.setMaxIterations(rounds)
        params.setLinearSolverType("MULTIFRONTAL_QR")
        graph = self.graph()
        self.values = gtsam.LevenbergMarquardtOptimizer(graph, self.values, params).optimize()
        return graph

    def remove_outliers(self):
        """Bearings far from their landmark, and landmarks of which a third of the bearings are."""
        for landmark, seen in list(self.observations.items()):
            point = self.values.atPoint3(L(landmark))
            errors = {k: self.error(k, pixel, point) for k, pixel in seen.items()}
            bad = [k for k, error in errors.items() if error > OUTLIER_SIGMA]
            if 3 * len(bad) > len(seen):
                self.banned.add(landmark)
                self.values.erase(L(landmark))
                del self.observations[landmark]
            else:
                for k in bad:
                    del seen[k]

    def error(self, k, pixel, point):
        """In standard deviations."""
        x = self.values.atPose3(X(k)).compose(self.extrinsics).transformTo(point)
        if x[2] < MIN_DEPTH_M:
            return np.inf
        return np.linalg.norm(self.camera.uncalibrate(x[:2] / x[2]) - pixel) / self.sigma

    def covariances(self, graph):
        """Covariance of all poses, rotation first, by one dense inverse: GTSAM's own marginals
        refuse the first keyframes, whose information spans too many powers of ten."""
        ordering = gtsam.Ordering()
        count = sum(1 for k in range(len(self.problem["times"])) if self.values.exists(X(k)))
        for k in range(count):
            for key in (X(k), V(k), B(k)):
                ordering.push_back(key)
        for landmark in self.observations:
            ordering.push_back(L(landmark))
        information, _ = graph.linearize(self.values).hessian(ordering)
        scale = 1 / np.sqrt(np.diag(information))
        inverse = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
        return [inverse[15 * k : 15 * k + 6, 15 * k : 15 * k + 6] for k in range(count)]

    def report(self, k, covariances):
        at = self.values.atPose3(X(k))
        q = at.rotation().toQuaternion()
        # GTSAM's order is rotation, translation.
        order = [3, 4, 5, 0, 1, 2]
        covariance = covariances[k][np.ix_(order, order)]
        return {
            "wxyz": [q.w(), q.x(), q.y(), q.z()],
            "position": list(at.translation()),
            "covariance": ((covariance + covariance.T) / 2).ravel().tolist(),
        }

    def run(self):
        problem = self.problem
        self.imu_times = np.array([row[0] for row in problem["imu"]], float)
        self.imu_values = np.array([row[1:] for row in problem["imu"]], float)
        count = len(problem["times"])
        causal = []
        for k in range(count):
            if k > 0:
                self.add_keyframe(k)
            self.add_bearings(k)
            self.optimize(problem["rounds"])
            self.remove_outliers()
            graph = self.optimize(problem["rounds"])
            causal.append(self.report(k, self.covariances(graph)))
            if k % 25 == 0:
                print(f"gtsam: keyframe {k} of {count}, {len(self.observations)} landmarks", file=sys.stderr, flush=True)
        for _ in range(2):
            self.optimize(50)
            self.remove_outliers()
        graph = self.optimize(50)
        covariances = self.covariances(graph)
        smoothed = [self.report(k, covariances) for k in range(count)]
        bias = self.values.atConstantBias(B(count - 1)).vector().tolist()
        return {"causal": causal, "smoothed": smoothed, "bias": bias}


def main():
    question = json.load(sys.stdin)
    print(json.dumps(where() if question.get("where") else Smoother(question).run()))


main()
