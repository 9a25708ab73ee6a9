"""Blender's side of the comparison of images: run by an interpreter that has ``bpy``, and by nothing else here.

Reads lines ``VIEW SAMPLES [FILE]`` from standard input, renders the window of that view with the body, and answers each
with a line of JSON: the seconds of the render alone. With a FILE the window is then written there, as EXR and read
back, for a comparison. The argument is a folder with ``scene.npz``: vertices (V, 3) and faces (F, 3); cameras (K, 4, 4)
to the body's axes, in Blender's own (x right, y up, z back); their windows (K, 4) as first column and row, width and
height; the direction towards the Sun (3,); size, field, albedo and threads.
"""

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector


def build(scene: Any, stored: Any) -> Any:
    """Fill a scene with the body, the Sun and a camera; there is no world, and so no other light."""
    body = bpy.data.objects.new("body", mesh_of(stored["vertices_m"], stored["faces"], float(stored["albedo"])))
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.angle = np.pi, 0.0  # so that the picture is the radiance factor I/F, with hard shadows
    light = bpy.data.objects.new("sun", sun)
    light.rotation_mode = "QUATERNION"
    light.rotation_quaternion = Vector(stored["sun_dir_body"].tolist()).to_track_quat("Z", "Y")
    lens = bpy.data.cameras.new("camera")
    lens.angle, lens.clip_end = float(stored["fov_rad"]), 1e5
    camera = bpy.data.objects.new("camera", lens)
    for thing in (body, light, camera):
        scene.collection.objects.link(thing)
    scene.camera = camera
    return camera


def mesh_of(vertices_m: Any, faces: Any, albedo: float) -> Any:
    """Make a mesh with flat facets that reflect as Lambert says."""
    mesh = bpy.data.meshes.new("body")
    mesh.vertices.add(len(vertices_m))
    mesh.vertices.foreach_set("co", vertices_m.astype(np.float32).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.astype(np.int32).ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    mesh.update(calc_edges=False)
    material = bpy.data.materials.new("lambert")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    diffuse, out = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (albedo, albedo, albedo, 1.0)
    diffuse.inputs["Roughness"].default_value = 0.0
    material.node_tree.links.new(diffuse.outputs[0], out.inputs["Surface"])
    mesh.materials.append(material)
    return mesh


def configure(scene: Any, size_px: int, threads: int) -> None:
    """Direct light alone, a box for a filter, nothing after the picture, and what can be kept between pictures kept."""
    scene.render.engine = "CYCLES"
    cycles, render = scene.cycles, scene.render
    cycles.device = "CPU"
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_auto_tile = False
    cycles.max_bounces = 0
    cycles.light_sampling_threshold = 0.0
    cycles.use_light_tree = False  # there is one light
    cycles.pixel_filter_type = "BOX"
    render.use_persistent_data = True
    render.use_compositing = render.use_sequencer = False
    render.threads_mode, render.threads = "FIXED", threads
    render.resolution_x = render.resolution_y = size_px
    render.resolution_percentage = 100
    render.use_border = render.use_crop_to_border = True
    scene.view_settings.view_transform = "Raw"
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_mode, render.image_settings.color_depth = "RGB", "32"


def set_window(scene: Any, window: Any) -> None:
    """Restrict the picture to first column and row, width and height; Blender counts rows from the bottom."""
    column, row, width, height = window.tolist()
    render, size = scene.render, scene.render.resolution_x
    render.border_min_x, render.border_max_x = column / size, (column + width) / size
    render.border_min_y, render.border_max_y = 1.0 - (row + height) / size, 1.0 - row / size


def keep_image(scene: Any, file: Path) -> None:
    """Write the last picture as an array (H, W), rows from the top."""
    exr = file.with_suffix(".exr")
    bpy.data.images["Render Result"].save_render(str(exr), scene=scene)
    image = bpy.data.images.load(str(exr))
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    values = np.empty(width * height * 4, dtype=np.float32)
    image.pixels.foreach_get(values)
    np.save(file, values.reshape(height, width, 4)[::-1, :, 0])


def main(folder: Path) -> None:
    """Build the scene, say so, and render what is asked for."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Blender tells of each picture on standard output
    stored = np.load(folder / "scene.npz")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    configure(scene, int(stored["size_px"]), int(stored["threads"]))
    camera = build(scene, stored)
    print(json.dumps({"version": bpy.app.version_string}), file=answers, flush=True)
    for line in sys.stdin:
        view, samples, *file = line.split(maxsplit=2)
        camera.matrix_world = Matrix(stored["T_body_camera"][int(view)].tolist())
        set_window(scene, stored["windows"][int(view)])
        scene.cycles.samples = int(samples)
        cpu, wall = time.process_time(), time.perf_counter()
        bpy.ops.render.render()
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        if file:
            keep_image(scene, Path(file[0].strip()))
        print(json.dumps({"cpu": cpu, "wall": wall}), file=answers, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
