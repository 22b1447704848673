"""Reads exports of the ground with other people's readers, and prints what they see as JSON.

Arguments: the reader, then JSON for it. Where a package is absent, {"absent": NAME}.
"""

import json
import math
import sys

try:
    import numpy as np
except ModuleNotFoundError as absent:
    json.dump({"absent": absent.name}, sys.stdout)
    sys.exit()


def plain(value):
    """Lists and numbers of NumPy's, with nothing in place of not-a-number and a word for infinity."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, dict):
        return {key: plain(v) for key, v in value.items()}
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else "inf"
    return value


def of_trimesh(paths):
    import trimesh

    seen = {}
    for name, path in paths.items():
        scene = trimesh.load_scene(path, process=False)
        # Nodes applied, if there are any.
        mesh = scene.to_mesh()
        visual = next(iter(scene.geometry.values())).visual
        # With a material, colors of vertices are an attribute beside it.
        of_material = getattr(visual, "vertex_attributes", {}).get("color")
        colors = visual.vertex_colors if of_material is None else of_material
        seen[name] = {
            "bounds": mesh.bounds,
            "triangles": mesh.triangles,
            "colors": np.asarray(colors)[mesh.faces][:, :, :3],
            "normals": mesh.vertex_normals[mesh.faces],
        }
    return seen


def of_mujoco(arguments):
    import mujoco

    BALLS = 5
    spec = mujoco.MjSpec.from_file(arguments["model"])
    radius = arguments["radius"]
    for number, at in enumerate(arguments["drops"]):
        body = spec.worldbody.add_body(name=f"ball_{number}", pos=at)
        body.add_freejoint()
        # Friction against rolling, so that a ball comes to rest.
        ball = body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], condim=6)
        ball.group = BALLS
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geom, rays = np.zeros(1, dtype=np.int32), []
    # Rays meet static geoms, and no balls.
    with_static, groups = 1, np.array([group != BALLS for group in range(6)], dtype=np.uint8)
    for x, y in arguments["rays"]:
        start, down = np.array([x, y, 50.0]), np.array([0.0, 0.0, -1.0])
        found = [model, data, start, down, groups, with_static, -1, geom]
        try:
            distance = mujoco.mj_ray(*found)
        except TypeError:
            # Later versions give the normal too.
            distance = mujoco.mj_ray(*found, None)
        hit = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom[0]) if geom[0] >= 0 else None
        rays.append([50.0 - distance if distance >= 0 else None, hit])
    layers = []
    for number in range(model.nhfield):
        place = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, f"layer_{number}")
        rows, columns = int(model.hfield_nrow[number]), int(model.hfield_ncol[number])
        first = int(model.hfield_adr[number])
        shares = model.hfield_data[first:first + rows * columns].astype(np.float64)
        layers.append({
            "rows": rows,
            "columns": columns,
            "heights": shares * model.hfield_size[number][2] + model.geom_pos[place][2],
        })
    for _ in range(int(arguments["seconds"] / model.opt.timestep)):
        mujoco.mj_step(model, data)
    balls = [body for body in range(model.nbody) if (model.body(body).name or "").startswith("ball_")]
    return {
        "rays": rays,
        "layers": layers,
        "rest": [data.xpos[body] for body in balls],
        "speeds": [float(np.linalg.norm(data.cvel[body])) for body in balls],
    }


def of_urdf(path):
    """Parts of a description of MuJoCo's own reader: geoms and their vertices in the world."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    parts = {}
    for number in range(model.ngeom):
        # Visual elements have no contacts.
        if model.geom_contype[number] == 0:
            continue
        mesh = model.geom_dataid[number]
        first = model.mesh_vertadr[mesh]
        vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        rotation = data.geom_xmat[number].reshape(3, 3)
        parts[model.geom(number).name] = vertices @ rotation.T + data.geom_xpos[number]
    return {"bodies": model.nbody, "joints": model.njnt, "parts": parts}


def of_usd(arguments):
    from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdValidation

    stage = Usd.Stage.Open(arguments["path"])
    colliders, pixels = {}, []
    for prim in stage.GetPrimAtPath("/Terrain/Collision").GetChildren():
        own = UsdGeom.Mesh(prim)
        colliders[prim.GetName()] = {
            "approximation": UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get(),
            "enabled": UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr().Get(),
            "points": np.array(own.GetPointsAttr().Get()),
            "indices": np.array(own.GetFaceVertexIndicesAttr().Get()),
        }
    for name, seconds, point, size in arguments["points"]:
        prim = UsdGeom.Camera(stage.GetPrimAtPath(f"/Terrain/Cameras/{name}"))
        frustum = prim.GetCamera(Usd.TimeCode(seconds)).frustum
        matrix = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
        x, y, depth = matrix.Transform(Gf.Vec3d(*point))
        assert abs(depth) < 1, "a point in front of the camera"
        pixels.append([0.5 * (x + 1) * size[0] - 0.5, 0.5 * (1 - y) * size[1] - 0.5])
    gravity = UsdPhysics.Scene(stage.GetPrimAtPath("/Terrain/PhysicsScene"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Terrain/Ground"))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    problems = UsdValidation.ValidationContext(validators).Validate(stage)
    return {
        "up": str(UsdGeom.GetStageUpAxis(stage)),
        "metres": UsdGeom.GetStageMetersPerUnit(stage),
        "default": str(stage.GetDefaultPrim().GetPath()),
        "schemas": list(mesh.GetPrim().GetAppliedSchemas()),
        "points": np.array(mesh.GetPointsAttr().Get()),
        "extent": np.array(mesh.GetExtentAttr().Get()),
        "counts": np.array(mesh.GetFaceVertexCountsAttr().Get()),
        "indices": np.array(mesh.GetFaceVertexIndicesAttr().Get()),
        "normals": np.array(mesh.GetNormalsAttr().Get()),
        "interpolation": [mesh.GetNormalsInterpolation(), mesh.GetDisplayColorPrimvar().GetInterpolation()],
        "colors": np.array(mesh.GetDisplayColorAttr().Get()),
        "enabled": UsdPhysics.CollisionAPI(mesh.GetPrim()).GetCollisionEnabledAttr().Get(),
        "colliders": colliders,
        "pixels": pixels,
        "gravity": [*gravity.GetGravityDirectionAttr().Get(), gravity.GetGravityMagnitudeAttr().Get()],
        "validators": len(validators),
        "problems": [f"{problem.GetName()}: {problem.GetMessage()}" for problem in problems],
    }


def of_rosbags(path):
    from pathlib import Path

    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    levels = {}
    with Reader(Path(path)) as reader:
        for connection, time, raw in reader.messages():
            # The types of ROS are its own, those of grid_map come from the file.
            store = get_typestore(Stores.ROS2_HUMBLE)
            types = get_types_from_msg(connection.msgdef.data, connection.msgtype)
            known = {name: kind for name, kind in types.items() if name in store.fielddefs}
            same = {name: store.fielddefs[name][1] == kind[1] for name, kind in known.items()}
            store.register({name: kind for name, kind in types.items() if name not in known})
            message = store.deserialize_cdr(raw, connection.msgtype)
            info, center = message.info, message.info.pose.position
            layers = {}
            for name, array in zip(message.layers, message.data):
                labels = [dim.label for dim in array.layout.dim]
                columns, rows = [dim.size for dim in array.layout.dim]
                assert labels == ["column_index", "row_index"], labels
                assert [dim.stride for dim in array.layout.dim] == [rows * columns, rows]
                assert array.layout.data_offset == 0
                assert math.isclose(rows * info.resolution, info.length_x)
                assert math.isclose(columns * info.resolution, info.length_y)
                matrix = np.asarray(array.data).reshape((rows, columns), order="F")
                cells = []
                for row in range(rows):
                    for column in range(columns):
                        # Position of a cell, as grid_map defines it.
                        x = center.x + 0.5 * info.length_x - (row + 0.5) * info.resolution
                        y = center.y + 0.5 * info.length_y - (column + 0.5) * info.resolution
                        cells.append([x, y, matrix[row, column]])
                layers[name] = cells
            levels[connection.topic] = {
                "type": connection.msgtype,
                "same": same,
                "time": time,
                "frame": message.header.frame_id,
                "basic": message.basic_layers,
                "start": [message.outer_start_index, message.inner_start_index],
                "rotation": [getattr(info.pose.orientation, k) for k in "xyzw"],
                "layers": layers,
            }
    return levels


def of_map_server(path):
    import cv2

    fields = dict(line.split(": ", 1) for line in open(path).read().splitlines())
    folder = path.rsplit("/", 1)[0]
    image = cv2.imread(f"{folder}/{fields['image']}", cv2.IMREAD_UNCHANGED)
    resolution = float(fields["resolution"])
    left, bottom, yaw = json.loads(fields["origin"])
    assert (fields["mode"], fields["negate"], yaw) == ("trinary", "0", 0.0)
    occupied, free = float(fields["occupied_thresh"]), float(fields["free_thresh"])
    height = image.shape[0]
    cells = []
    for row in range(height):
        for column in range(image.shape[1]):
            share = (255 - int(image[row, column])) / 255.0
            value = 100 if share > occupied else 0 if share < free else -1
            # The cell of a column and of a row from below.
            x, y = left + (column + 0.5) * resolution, bottom + (height - 1 - row + 0.5) * resolution
            cells.append([x, y, value])
    return cells


def of_tifffile(path):
    import tifffile

    with tifffile.TiffFile(path) as file:
        page = file.pages[0]
        image, tags = page.asarray(), page.geotiff_tags
        assert int(tags["GTRasterTypeGeoKey"]) == 1
        scale, tie = tags["ModelPixelScale"], tags["ModelTiepoint"]
        assert list(tie[:3]) == [0, 0, 0]
        cells = []
        for row in range(image.shape[0]):
            for column in range(image.shape[1]):
                x = tie[3] + (column + 0.5) * scale[0]
                y = tie[4] - (row + 0.5) * scale[1]
                cells.append([x, y, image[row, column]])
        return {
            "dtype": str(image.dtype),
            "nodata": page.tags[42113].value,
            "model": int(tags["GTModelTypeGeoKey"]),
            "unit": int(tags["ProjLinearUnitsGeoKey"]),
            "name": tags["GTCitationGeoKey"],
            "cells": cells,
        }


reader, arguments = sys.argv[1], json.loads(sys.argv[2])
try:
    seen = globals()[f"of_{reader}"](arguments)
except ModuleNotFoundError as absent:
    seen = {"absent": absent.name}
json.dump(plain(seen), sys.stdout)
