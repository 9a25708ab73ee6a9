"""Images against plain Mitsuba scenes, OpenCV and the analytic sphere."""

import hashlib
import json
import os
import subprocess
import sys

import cv2
import numpy as np
import pytest
import trimesh

from boresight.renderers.mitsuba3 import MitsubaRenderer, register_bsdfs, wavefront
from boresight.renderers.mitsuba3.scene import mesh_on_device
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, TriangleMesh, View, look_at
from boresight.scenarios.spec.brdf import HapkeSpec, LambertSpec, OrenNayarSpec

CAMERA = Camera.from_fov(96, 96, np.radians(20.0))
ODD = Camera(90, 70, 260.0, 300.0, 40.3, 38.8)
HAPKE = HapkeSpec(kind="hapke")
POSITION = [900.0, -1500.0, 700.0]
SUN = [0.9, -0.5, 0.1]
BRDFS = [LambertSpec(), OrenNayarSpec(kind="oren-nayar"), HAPKE]


@pytest.fixture(params=["llvm", "scalar"])
def variant(request):
    return request.getfixturevalue(request.param)


def plain_mitsuba(mi, folder, mesh: TriangleMesh, bsdf: dict, view: View, samples: int) -> np.ndarray:
    """I/F from a scene as any user of Mitsuba writes it: a PLY file, a perspective sensor, a directional light."""
    trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False).export(folder / "body.ply")
    pose = view.T_cam_body
    to_world = np.eye(4)
    to_world[:3, :3] = pose.rotation.T @ np.diag([-1.0, -1.0, 1.0])
    to_world[:3, 3] = pose.camera_position_m
    fov_deg = np.degrees(2.0 * np.arctan(0.5 * view.camera.width_px / view.camera.fx_px))
    film = {"type": "hdrfilm", "width": view.camera.width_px, "height": view.camera.height_px}
    scene = mi.load_dict(
        {
            "type": "scene",
            "body": {"type": "ply", "filename": str(folder / "body.ply"), "face_normals": True, "bsdf": bsdf},
            "sun": {"type": "directional", "direction": list(-view.sun_dir_body), "irradiance": float(np.pi)},
            "sensor": {
                "type": "perspective",
                "fov": float(fov_deg),
                "near_clip": 10.0,
                "far_clip": 1e5,
                "to_world": mi.ScalarTransform4f(to_world),
                "film": {**film, "rfilter": {"type": "box"}, "pixel_format": "luminance"},
            },
            "integrator": {"type": "direct"},
        }
    )
    return np.array(mi.render(scene, spp=samples, seed=1))[..., 0]


@pytest.mark.parametrize(
    ("brdf", "bsdf"),
    [
        (LambertSpec(albedo=0.3), {"type": "diffuse", "reflectance": 0.3}),
        (OrenNayarSpec(kind="oren-nayar"), {"type": "boresight_oren_nayar"}),
        (HAPKE, {"type": "boresight_hapke"}),
    ],
    ids=lambda x: getattr(x, "kind", None),
)
def test_image_is_that_of_a_plain_mitsuba_scene(llvm, tmp_path, rock, looking, brdf, bsdf):
    """256 random samples a pixel of the plain scene against 64 regular ones of ours."""
    view = looking(CAMERA, POSITION, SUN)
    ours = MitsubaRenderer(rock, brdf, 64, variant=llvm).render(view)
    theirs = plain_mitsuba(register_bsdfs(llvm), tmp_path, rock, bsdf, view, 256)
    peak = theirs.max()
    assert ours.dtype == np.float32
    assert (theirs > 0.05 * peak).mean() > 0.15
    inside = cv2.erode((theirs > 0.0).astype(np.uint8), np.ones((3, 3))) > 0
    difference = np.abs(ours - theirs)
    assert np.median(difference[inside]) < 0.003 * peak
    assert np.percentile(difference, 99) < 0.05 * peak
    assert ours.sum() == pytest.approx(theirs.sum(), rel=2e-3)


def test_small_facets_are_traced_ray_by_ray_to_the_same_image(llvm, ball, looking, monkeypatch):
    """In packets or not: facets of 1.5 distances between samples, and of 3."""
    view = looking(CAMERA, [1500.0, 0.0, 0.0], [1.0, 0.6, 0.2])
    facet_m = np.sqrt(4.0 * np.pi * 250.0**2 / len(ball.faces))
    far = looking(CAMERA, [250.0 + 272.2 * facet_m / 1.5, 0.0, 0.0], SUN)  # 272.2 px: the camera's focal length
    one, four = (MitsubaRenderer(ball, LambertSpec(), samples, variant=llvm) for samples in (1, 4))
    assert not one._tracer.coherent(far)
    assert four._tracer.coherent(far)
    images = []
    for limit in (0.0, np.inf):
        monkeypatch.setattr(wavefront, "_COHERENT_FACET", limit)
        images.append(four.render(view))
    assert (images[0] != images[1]).mean() < 1e-3


@pytest.mark.parametrize("camera", [CAMERA, ODD], ids=["square", "odd"])
def test_pixels_are_where_opencv_projects_them(variant, camera):
    """The middle of a small ball lit from behind the camera: its image's centroid, to 0.03 pixels."""
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=8.0)
    for centre in ([60.0, 20.0, -15.0], [-70.0, 40.0, 60.0], [0.0, -60.0, 30.0]):
        ball = TriangleMesh(sphere.vertices + centre, sphere.faces)
        pose = look_at(np.array([200.0, -400.0, 100.0]), 0.3)
        image = MitsubaRenderer(ball, LambertSpec(), 64, variant=variant).render(
            View(camera, pose, pose.camera_position_m - centre)
        )
        rows, columns = np.mgrid[: camera.height_px, : camera.width_px] + 0.5
        centroid = np.array([(columns * image).sum(), (rows * image).sum()]) / image.sum()
        rvec = cv2.Rodrigues(pose.rotation)[0]
        opencv, _ = cv2.projectPoints(np.array([centre]), rvec, pose.translation_m, camera.matrix, None)
        np.testing.assert_allclose(centroid, opencv.ravel(), atol=0.03)


def test_lambert_sphere_is_albedo_times_cosine(variant):
    """The analytic radiance factor at every pixel well inside the disc, with the albedo of each vertex."""
    camera = Camera.from_fov(64, 64, np.radians(18.0))
    ball = trimesh.creation.icosphere(subdivisions=5, radius=250.0)
    painted = TriangleMesh(ball.vertices, ball.faces, 1.0 + 0.5 * ball.vertices[:, 2] / 250.0)
    view = View(camera, look_at(np.array([2000.0, 0.0, 0.0])), np.array([1.0, 0.8, 0.3]))
    image = MitsubaRenderer(painted, LambertSpec(albedo=0.4), 4, "smooth", variant).render(view)
    columns, rows = np.meshgrid(np.arange(64) + 0.5, np.arange(64) + 0.5)
    normals = sphere_points(view, np.stack([columns, rows], axis=-1).reshape(-1, 2), 250.0) / 250.0
    cos_e = normals @ np.array([1.0, 0.0, 0.0])
    cos_i = normals @ view.sun_dir_body
    expected = 0.4 * (1.0 + 0.5 * normals[:, 2]) * np.maximum(cos_i, 0.0)
    clear = (cos_e > 0.4) & (np.abs(cos_i) > 0.1)
    assert clear.sum() > 400
    np.testing.assert_allclose(image.ravel()[clear], expected[clear], atol=2e-3)
    assert image[0, 0] == 0.0


def sphere_points(view: View, uv: np.ndarray, radius: float) -> np.ndarray:
    """First intersections (N, 3) of lines of sight with a sphere about the origin; NaN where they miss."""
    origin = view.T_cam_body.camera_position_m
    directions = view.camera.unproject(uv) @ view.T_cam_body.rotation
    along = directions @ origin
    with np.errstate(invalid="ignore"):
        distance = -along - np.sqrt(along**2 - origin @ origin + radius**2)
    return origin + distance[:, None] * directions


def test_convex_body_never_shadows_itself(variant, ball):
    """A grazing Sun finds no false shadows: every facet that faces it is lit."""
    camera = Camera.from_fov(200, 200, np.radians(16.0))
    view = View(camera, look_at(np.array([2000.0, 300.0, 100.0])), np.array([0.05, 1.0, 0.1]))
    renderer = MitsubaRenderer(ball, LambertSpec(), 1, variant=variant)
    rng = np.random.default_rng(8)
    hits = renderer.surface(view, rng.uniform(20.0, 180.0, (1500, 2)))
    cos_i = hits.normals_body[hits.hit] @ view.sun_dir_body
    assert ((cos_i > 1e-3) & (cos_i < 0.05)).sum() > 30
    np.testing.assert_array_equal(hits.lit[hits.hit], cos_i > 0.0)


@pytest.mark.parametrize("camera", [CAMERA, ODD], ids=["square", "odd"])
@pytest.mark.parametrize("shading", ["flat", "smooth"])
@pytest.mark.parametrize("brdf", BRDFS, ids=lambda spec: spec.kind)
def test_fallback_gives_the_same_image(llvm, scalar, rock, looking, camera, shading, brdf):
    """Stated tolerance: a median of 1e-5 of the peak, and 99.5 % of the lit pixels within 1 % of the peak.

    The rest are pixels where a shadow's edge passes next to a sample.
    """
    painted = TriangleMesh(rock.vertices_m, rock.faces, 1.0 + 0.3 * np.sin(rock.vertices_m[:, 0] / 20.0))
    view = looking(camera, POSITION, [0.2, -0.5, 1.0])  # shadows run along both axes of the image
    fast = MitsubaRenderer(painted, brdf, 4, shading, llvm).render(view)
    slow = MitsubaRenderer(painted, brdf, 4, shading, scalar).render(view)
    lit = (fast > 0.0) | (slow > 0.0)
    difference = np.abs(fast - slow)[lit] / fast.max()
    assert lit.mean() > 0.1
    assert np.median(difference) < 1e-5
    assert (difference < 0.01).mean() > 0.995


@pytest.mark.parametrize("brdf", BRDFS, ids=lambda spec: spec.kind)
def test_shadows_albedo_and_shading_show(llvm, rock, looking, brdf):
    view = looking(CAMERA, POSITION, SUN)
    flat = MitsubaRenderer(rock, brdf, 4, variant=llvm).render(view)
    smooth = MitsubaRenderer(rock, brdf, 4, "smooth", llvm).render(view)
    halved = TriangleMesh(rock.vertices_m, rock.faces, np.full(len(rock.vertices_m), 0.5))
    np.testing.assert_allclose(MitsubaRenderer(halved, brdf, 4, variant=llvm).render(view), 0.5 * flat, rtol=1e-5)
    assert 0.0 < np.abs(smooth - flat).mean() < 0.1 * flat.mean()


def test_strips_of_a_large_image_join(variant, rock, looking, monkeypatch):
    view = looking(CAMERA, POSITION, SUN)
    renderer = MitsubaRenderer(rock, HAPKE, 4, variant=variant)
    whole = renderer.render(view)
    monkeypatch.setattr("boresight.renderers.mitsuba3.renderer._MAX_SAMPLES", 1500)
    strips = renderer.render(view)
    difference = np.abs(strips - whole)
    assert (difference < 1e-5).mean() > 0.999


def test_body_that_fills_leaves_or_misses_the_image(variant, rock):
    renderer = MitsubaRenderer(rock, LambertSpec(), 4, variant=variant)
    at = np.array([0.0, 0.0, 400.0])
    near = renderer.render(View(CAMERA, look_at(at), at))
    assert (near > 0.0).mean() > 0.99
    away = look_at(at).perturbed(np.array([np.pi, 0.0, 0.0]), np.zeros(3))
    away = type(away)(away.rotation, -away.rotation @ at)
    assert not renderer.render(View(CAMERA, away, at)).any()
    aside = look_at(at * 10.0).perturbed(np.zeros(3), np.array([5000.0, 0.0, 0.0]))
    assert not renderer.render(View(CAMERA, aside, at)).any()
    partly = renderer.render(View(CAMERA, look_at(at * 10.0).perturbed(np.zeros(3), np.array([700.0, 0.0, 0.0])), at))
    assert partly[:, -1].any()
    assert not partly[:, 0].any()


def test_view_from_inside_the_bounding_sphere(llvm, scalar, rock):
    """Beside the waist of the body, nearer than its farthest point: allowed, and the same in both variants."""
    position = np.array([0.0, 0.0, 0.6 * rock.radius_m])
    view = View(CAMERA, look_at(position), position)
    fast, slow = (MitsubaRenderer(rock, LambertSpec(), 4, variant=v).render(view) for v in (llvm, scalar))
    assert (fast > 0.0).mean() > 0.9
    assert np.median(np.abs(fast - slow)) < 1e-5


def test_camera_inside_the_body_is_refused(variant, rock):
    renderer = MitsubaRenderer(rock, LambertSpec(), 1, variant=variant)
    view = View(CAMERA, look_at(np.array([30.0, 20.0, 10.0])), np.array(SUN))
    with pytest.raises(BoresightError, match="inside the body"):
        renderer.render(view)
    with pytest.raises(BoresightError, match="inside the body"):
        renderer.surface(view, np.array([[4.0, 4.0]]))


@pytest.mark.parametrize(
    ("wrong", "named"), [({"samples_per_pixel": 5}, "samples_per_pixel: 5"), ({"shading": "phong"}, "'phong'")]
)
def test_wrong_options_are_refused(scalar, rock, wrong, named):
    with pytest.raises(BoresightError, match=named):
        MitsubaRenderer(rock, LambertSpec(), variant=scalar, **wrong)


def test_body_without_facets_is_refused(scalar):
    with pytest.raises(BoresightError, match="no facets"):
        MitsubaRenderer(TriangleMesh(np.zeros((3, 3)), np.zeros((0, 3), dtype=int)), LambertSpec(), variant=scalar)


def test_the_same_call_gives_the_same_bits(variant, rock, looking):
    view, other = looking(CAMERA, POSITION, SUN), looking(CAMERA, [1500.0, 900.0, 20.0], SUN)
    renderer = MitsubaRenderer(rock, HAPKE, 9, "smooth", variant)
    first = renderer.render(view)
    renderer.render(other)
    np.testing.assert_array_equal(renderer.render(view), first)
    np.testing.assert_array_equal(MitsubaRenderer(rock, HAPKE, 9, "smooth", variant).render(view), first)


@pytest.mark.parametrize("brdf", BRDFS)
def test_renderers_of_a_mesh_share_its_tree_and_nothing_of_their_reflectances(llvm, rock, looking, brdf):
    view = looking(CAMERA, POSITION, SUN)
    others = [MitsubaRenderer(rock, one, variant=llvm) for one in BRDFS]
    shared = MitsubaRenderer(rock, brdf, variant=llvm)
    assert mesh_on_device(llvm, rock) is mesh_on_device(llvm, rock)
    alone = MitsubaRenderer(TriangleMesh(rock.vertices_m, rock.faces, rock.albedo), brdf, variant=llvm)
    for renderer in (*others, shared):
        renderer.render(view)
    np.testing.assert_array_equal(shared.render(view), alone.render(view))


def test_a_new_pose_compiles_no_new_kernel(llvm, rock, looking):
    """Poses, windows, cameras and Suns are data: every image runs the same kernels, told by their hashes."""
    import drjit as dr

    renderer = MitsubaRenderer(rock, HAPKE, 4, "smooth", llvm)
    views = [
        looking(CAMERA, POSITION, SUN),
        looking(ODD, [1500.0, 900.0, 20.0], [0.3, -0.9, 0.2]),
        looking(ODD, [0.0, 0.0, 2900.0], [0.0, 0.0, 1.0], 0.0),
    ]
    hashes = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for view in views:
            dr.kernel_history_clear()
            assert renderer.render(view).any()
            hashes.append([entry["hash"] for entry in dr.kernel_history([dr.KernelType.JIT])])
    assert hashes[0]
    assert hashes[1:] == [hashes[0], hashes[0]]


_DIGEST = """
import hashlib, json, sys
import numpy as np
from boresight.renderers.mitsuba3 import MitsubaRenderer, choose_variant, limit_threads
from boresight.scenarios.geometry import Camera, TriangleMesh, View, look_at
from boresight.scenarios.spec.brdf import HapkeSpec
case = json.load(sys.stdin)
mesh = TriangleMesh(np.array(case["vertices"]), np.array(case["faces"]))
renderer = MitsubaRenderer(mesh, HapkeSpec(kind="hapke"), 4, variant=choose_variant(case["variant"]))
pose = look_at(np.array(case["position"]))
for threads in (1, 2):
    limit_threads(threads)
    image = renderer.render(View(Camera.from_fov(96, 96, 0.35), pose, np.array(case["sun"])))
    assert image.any()
    print(hashlib.sha256(image.tobytes()).hexdigest())
"""


def test_processes_and_threads_do_not_change_a_bit(variant):
    sphere = trimesh.creation.icosphere(subdivisions=3)
    bumpy = sphere.vertices * (250.0 + 60.0 * np.sin(4.0 * sphere.vertices[:, :1]))
    case = {"vertices": bumpy.tolist(), "faces": sphere.faces.tolist(), "position": POSITION, "sun": SUN}
    stdin = json.dumps({**case, "variant": variant.name})
    command = [sys.executable, "-c", _DIGEST]
    done = subprocess.run(command, input=stdin, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    digests = set(done.stdout.split())
    renderer = MitsubaRenderer(TriangleMesh(bumpy, sphere.faces), HAPKE, 4, variant=variant)
    here = renderer.render(View(Camera.from_fov(96, 96, 0.35), look_at(np.array(POSITION)), np.array(SUN)))
    digests.add(hashlib.sha256(here.tobytes()).hexdigest())
    assert len(digests) == 1


def test_without_llvm_all_models_still_render_the_same(llvm, tmp_path, rock, looking):
    """The whole fallback as a machine without libLLVM takes it: a process from which every libLLVM is hidden."""
    np.savez(tmp_path / "rock.npz", v=rock.vertices_m, f=rock.faces)
    script = f"""
import numpy as np
from boresight.renderers.mitsuba3 import MitsubaRenderer, choose_variant
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh, View
from boresight.scenarios.spec.brdf import HapkeSpec, LambertSpec, OrenNayarSpec
variant = choose_variant()
assert variant.name == "scalar_rgb" and "pip install" in variant.advice, variant
stored = np.load({str(tmp_path / "rock.npz")!r})
mesh = TriangleMesh(stored["v"], stored["f"])
view = np.load({str(tmp_path / "view.npz")!r})
view = View(Camera.from_fov(96, 96, np.radians(20.0)), Pose(view["r"], view["t"]), view["s"])
brdfs = [LambertSpec(), OrenNayarSpec(kind="oren-nayar"), HapkeSpec(kind="hapke")]
np.save({str(tmp_path / "images.npy")!r}, [MitsubaRenderer(mesh, brdf).render(view) for brdf in brdfs])
"""
    view = looking(CAMERA, POSITION, SUN)
    pose = view.T_cam_body
    np.savez(tmp_path / "view.npz", r=pose.rotation, t=pose.translation_m, s=view.sun_dir_body)
    environment = {**os.environ, "BORESIGHT_HIDE_LLVM": "1"}
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, env=environment, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    for brdf, slow in zip(BRDFS, np.load(tmp_path / "images.npy"), strict=True):
        fast = MitsubaRenderer(rock, brdf, variant=llvm).render(view)
        difference = np.abs(fast - slow)[(fast > 0.0) | (slow > 0.0)] / fast.max()
        assert np.median(difference) < 1e-5
        assert (difference < 0.01).mean() > 0.995
