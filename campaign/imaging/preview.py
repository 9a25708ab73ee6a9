"""Preview of the images of a scenario in words, before anything is built, from some views drawn as in trials."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from boresight.campaign.imaging.ranges import longest_m, ranges_m
from boresight.renderers.brdf import brdf_value
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.bodies import detailed_count, expected_facets, load_body
from boresight.scenarios.draw import Stream, draw_aimed_view, drawn_together, generator, prior_covariance
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, TriangleMesh, View, look_at
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.onboard import onboard_spec
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.sequences.trajectory import nominal_trajectory
from boresight.scenarios.spec.body import without_detail
from boresight.scenarios.spec.camera import DetectorSpec
from boresight.scenarios.spec.craters import CratersSpec, PlaneCratersSpec
from boresight.scenarios.spec.distribution import drawn
from boresight.scenarios.spec.scenario import ScenarioSpec
from boresight.scenarios.spec.trajectory import FlownSpec, TrajectorySpec

_VIEWS, _POINTS = 40, 4000
_FOUND_PX = 10.0  # diameter of a crater that a detector finds
_NOISY = 50.0  # median signal to noise: at 37, landmarks were recognised in 1 of 50 images of bennu-pass
_SATURATED = 0.01
_TOLD_BYTES = 1e9
# Resident at most in a process that renders: 0.50 GB for 1.3 million and 1.06 GB for 5.2 million facets in 512 x 512
# pixels, 4.1 GB for 21 million in 4096 x 4096.
_PROCESS_BYTES, _FACET_BYTES, _PIXEL_BYTES = 0.31e9, 142.0, 47.0
_SAMPLING_PX = 0.01
_COARSE_PX = 2.0  # edges of facets beyond which they, not the surface, make the image
_DrawnView = tuple[View, float, FloatArray | None]
"""A view, its brightness, and the camera's velocity (3,) in body axes of a trajectory that has it, m/s."""


@dataclass(frozen=True, slots=True, eq=False)
class _Sight:
    """Visible part of a body in some views, as means over points that are uniform over its area.

    ``out`` is the share of the projected area that faces the camera out of the frame, and ``dark`` that of the rest
    unlit (NaN without a rest). ``in_view`` is the share of the whole surface that is lit and in the frame,
    ``distance_m`` its median distance from the camera, and ``nearest_m`` the least distance of the surface from it.
    ``radiance_factor`` and ``weight``, both (N,), are I/F and projected areas of its points. ``phase_deg`` are the
    least and the largest phase angle of the views, which ``looked`` names.
    """

    out: float
    dark: float
    in_view: float
    distance_m: float
    nearest_m: float
    radiance_factor: FloatArray
    weight: FloatArray
    phase_deg: tuple[float, float]
    looked: str


def preview(scenario: LoadedScenario, *, detailed: bool = True, trials: int | None = None) -> list[str]:
    """Describe field of view, pixel, body, signal and craters in the images of a scenario, a line each.

    The body is taken without its detail unless it is wanted: that may take a minute to make. Of a trajectory whose
    states are taken in turn, those of the first ``trials`` are described, by default all. Raise BoresightError if the
    sphere about the body is out of the frame in all views that are drawn.
    """
    spec, camera = scenario.spec, scenario.spec.camera.camera()
    # Held until the end, so that its file is read once.
    coarse = load_body(without_detail(spec.body), scenario.search_dirs)
    memory = memory_in_words(scenario)
    mesh = load_body(spec.body, scenario.search_dirs).mesh if detailed else coarse.mesh
    flown = _states_flown(spec, trials)
    ends_m = ranges_m(scenario, mesh)
    if spec.viewpoint is not None and spec.viewpoint.states is not None:
        ranges = np.linalg.norm(spec.viewpoint.states.position_m[:flown], axis=1)
        ends_m = float(ranges.min()), float(np.median(ranges)), float(ranges.max())
    views = list(_views(scenario, mesh, flown))
    sight = _sight(scenario, mesh, views) if views else None
    lines = [
        _views_in_words(scenario, camera, longest_m(scenario, mesh), ends_m, sight),
        *_states_in_words(spec, flown),
        *memory,
    ]
    if spec.viewpoint is not None:
        lines.append(_prior_in_words(spec, camera, ends_m[1]))
    if spec.images is not None or images_of(spec, 1):  # estimators of real images render too
        near_m = ends_m[1], ends_m[1]
        if sight is not None and not np.isnan(sight.distance_m):
            near_m = sight.distance_m, sight.nearest_m
        lines.append(_facets_in_words(spec, mesh, len(coarse.mesh.faces), np.array(near_m) / camera.fx_px))
        if images_of(spec, 1):
            lines += _sampling_in_words(spec, longest_m(scenario, mesh) / ends_m[2] * camera.fx_px)
    if sight is not None and spec.detector is not None and len(sight.weight):
        lines.append(signal_in_words(spec.detector, sight.radiance_factor, sight.weight))
    if spec.detector is not None and spec.detector.motion is not None and views:
        lines.append(_smear_in_words(scenario, spec.detector, views))
    pairs = spec.crater_pairs
    if spec.craters is not None and sight is not None:
        lines.append(_craters_in_words(spec.craters, sight.in_view, sight.distance_m / camera.fx_px))
    elif pairs is not None and (craters := pairs.craters or spec.craters) is not None:
        m_per_px = pairs.range_m / camera.fx_px
        area_m2 = float(mesh.areas_m2.sum())
        framed_m2 = camera.width_px * camera.height_px * m_per_px**2
        lines.append(_craters_in_words(craters, min(framed_m2 / area_m2, 0.5), m_per_px))
    if spec.craters is not None:
        from boresight.scenarios.craters.tiles import expected_bytes  # compiled code, 0.4 s, of craters alone

        tiles, vertices = expected_bytes(mesh, spec.craters)
        lines.append(f"the cratered surface takes about {(tiles + vertices) / 1e9:.2g} GB of memory")
    return lines


def _states_flown(spec: ScenarioSpec, trials: int | None) -> int:
    """Return how many states of a trajectory are in images or frames; 0 without one."""
    trajectory = _trajectory_of(spec)
    if trajectory is None:
        return 0
    count = len(trajectory.states)
    in_turn = isinstance(trajectory, TrajectorySpec) and trajectory.order == "in-turn"
    return min(trials, count) if in_turn and trials is not None else count


def _trajectory_of(spec: ScenarioSpec) -> FlownSpec | None:
    if spec.viewpoint is not None:
        return spec.viewpoint.trajectory
    return None if spec.sequence is None else spec.sequence.trajectory


def _states_in_words(spec: ScenarioSpec, flown: int) -> list[str]:
    """Describe the states of a trajectory and their axes in a line; empty without one."""
    trajectory = _trajectory_of(spec)
    if trajectory is None:
        return []
    if trajectory.spice is not None:
        axes = trajectory.spice.target_frame
    elif trajectory.rotation is not None:
        axes = "inertial axes, turned to body axes by trajectory.rotation"
    else:
        axes = "body axes; if they are inertial, give trajectory.rotation"
    count = len(trajectory.states)
    are = "is" if flown == 1 else "are"
    some = f"{flown} of {count} states {are} flown, one in each trial; " if flown < count else f"{count} "
    times_s = trajectory.states.time_s
    over = f" over {times_s[-1] - times_s[0]:.6g} s" if count > 1 else ""
    return [f"trajectory: {some}states{over} in {axes}"]


def _views_in_words(
    scenario: LoadedScenario, camera: Camera, size_m: float, ends_m: tuple[float, float, float], sight: _Sight | None
) -> str:
    """Describe the field of view, a pixel, and a body of a size at the shortest, median and longest range."""
    ends = np.array(ends_m)
    fields = np.degrees(2.0 * np.arctan([0.5 * camera.width_px / camera.fx_px, 0.5 * camera.height_px / camera.fy_px]))
    unit, unit_m = ("km", 1000.0) if ends[2] >= 1e5 else ("m", 1.0)
    four_digits = partial(np.format_float_positional, precision=4, unique=False, fractional=False, trim="-")
    told = [" to ".join(dict.fromkeys(map(four_digits, values[[0, 2]].tolist()))) for values in (
        ends / unit_m, ends / camera.fx_px, size_m / ends * camera.fx_px
    )]  # fmt: skip
    median = "" if " to " not in told[2] else f" ({size_m / ends[1] * camera.fx_px:.4g} at the median range)"
    words = (
        f"field of view {fields[0]:.3g} x {fields[1]:.3g} deg; range {told[0]} {unit}, a pixel {told[1]} m;"
        f" body {told[2]} px long in {camera.width_px} x {camera.height_px}{median}"
    )
    if sight is None:
        return words
    lit = "" if np.isnan(sight.dark) else f" and {100.0 * sight.dark:.0f} % of the rest in the dark"
    phases = " to ".join(dict.fromkeys(f"{angle:.3g}" for angle in sight.phase_deg))
    return (
        f"{words}; phase angle {phases} deg in {sight.looked}; of the side that faces the camera"
        f" {100.0 * sight.out:.0f} % is out of the frame on average{lit}"
    )


def _prior_in_words(spec: ScenarioSpec, camera: Camera, range_m: float) -> str:
    """Describe the errors of priors at a range in the image, and the standard deviations that estimators are told.

    Along a trajectory, in the direction of the state whose range is nearest.
    """
    up, velocity_m_s = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    if spec.viewpoint is not None and (states := spec.viewpoint.states) is not None:
        sizes_m = np.linalg.norm(states.position_m, axis=1)
        state = int(np.abs(sizes_m - range_m).argmin())
        up, told_m_s = np.array(states.position_m[state]) / sizes_m[state], states.velocity(state)
        velocity_m_s = velocity_m_s if told_m_s is None else told_m_s
    pose = look_at(range_m * up)
    told = []
    for law in (spec.pose_error, spec.believed_pose_error):
        variances = np.diag(prior_covariance(law, pose, camera, velocity_m_s))
        turn_deg = np.degrees(np.sqrt(variances[:3].mean()))
        across_px = np.sqrt(variances[3:5].mean()) / range_m * camera.fx_px
        told.append(
            f"{across_px:.3g} px in the place of the body, {np.sqrt(variances[5]):.4g} m along the line of sight,"
            f" {turn_deg:.3g} deg of the attitude about each axis"
        )
    believed = "the same" if told[0] == told[1] else told[1]
    return f"errors of the prior (RMS): {told[0]}; estimators are told {believed}"


def images_of(spec: ScenarioSpec, trials: int) -> int:
    """Return how many images are rendered for so many trials; those of plans of an orbit are not counted.

    On an approach all are taken, and counted.
    """
    if spec.viewpoint is not None:
        return trials
    if spec.images is not None:
        return trials if spec.images.rendered else 0  # at most: a view is rendered once
    if spec.crater_pairs is not None:
        return 0 if spec.crater_pairs.images is None else 2 * trials
    if spec.orbit is not None and spec.orbit.arc.approach is not None and spec.orbit.imaging is not None:
        return trials * spec.orbit.imaging.epochs
    if spec.sequence is None or spec.sequence.images is None:
        return 0
    revolution = round(360.0 / spec.sequence.orbit.step_deg)
    return revolution if spec.sequence.trajectory is None else spec.sequence.frames


def memory_in_words(scenario: LoadedScenario) -> list[str]:
    """Say in a line how many facets the bodies of a scenario will have, and what these take, before they are made.

    Empty if that is below 1 GB. Raise BoresightError if a shape is missing or wrong.
    """
    spec = scenario.spec
    if spec.sequence is not None and spec.sequence.sphere_radius_m is not None:
        return []
    bodies = list({body.model_dump_json(): body for body in (*spec.bodies, onboard_spec(spec).body)}.values())
    counts = [expected_facets(body, scenario.search_dirs) for body in bodies]
    pixels = spec.camera.width_px * spec.camera.height_px
    size = _PROCESS_BYTES + _FACET_BYTES * sum(counts) + _PIXEL_BYTES * pixels
    if size < _TOLD_BYTES:
        return []
    told = " and ".join(f"{count:,}" for count in counts)
    have = "the body has" if len(counts) == 1 else "the bodies, those on board among them, have"
    return [f"{have} about {told} facets: each process that makes images takes about {size / 1e9:.2g} GB of memory"]


def _facets_in_words(spec: ScenarioSpec, mesh: TriangleMesh, of_file: int, m_per_px: FloatArray) -> str:
    """Describe the facets against a pixel, (2,) of all views and at the nearest point, and those of a site.

    ``of_file`` is how many the shape file has. Say what to change if they are coarse; the nearest point is named if
    they are coarse there alone.
    """
    site = None
    if spec.craters is not None:
        edge_m, key = spec.craters.edge_m, "lower craters.edge_m"
    else:
        key = "take a finer shape, or raise body.detail.facets"
        site = None if spec.body.detail is None else spec.body.detail.site
        count = detailed_count(spec.body, of_file)  # without the finer facets of a site and of local shapes
        area_m2 = float(mesh.areas_m2.sum())
        edge_m = math.sqrt(4.0 / math.sqrt(3.0) * area_m2 / count)  # of equilateral triangles
    edge_px, nearest_px = (edge_m / m_per_px).tolist()
    words = f"facets have edges of {edge_m:.3g} m, {edge_px:.2g} px of the surface in view"
    if site is not None:
        words += f", at the site of {site.edge_m:.3g} m at most, {site.edge_m / m_per_px[0]:.2g} px"
    if edge_px <= _COARSE_PX < nearest_px:
        words = f"{words} and {nearest_px:.2g} px at the nearest point"
    return f"{words}: coarse for this camera, as images show them; {key}" if nearest_px > _COARSE_PX else words


def _sampling_in_words(spec: ScenarioSpec, size_px: float) -> list[str]:
    """Say in a line how far samples move a small body in rendered images; empty if that is little.

    The number of points of a regular grid in a disc scatters with its place (Kendall 1948, Quarterly Journal of
    Mathematics 19, 1), and so does their middle: by 0.19 to 0.24 / sqrt(k^3 d) px in each coordinate, for k x k points
    a pixel and a disc d pixels across (k 2 to 6, d 3 to 100, 200 places each). Of a ball in Lommel and Seeliger's law
    it is five times as much at a phase angle of 120 deg, a ninth in Lambert's law with the Sun behind the camera.
    """
    least, samples = (0.22 / _SAMPLING_PX / math.sqrt(size_px)) ** (2.0 / 3.0), spec.rendering.samples_per_pixel
    most = min(math.ceil(least), 8) ** 2
    if samples >= most or size_px > min(spec.camera.width_px, spec.camera.height_px):
        return []
    few = "1 sample in a pixel moves" if samples == 1 else f"{samples} samples in a pixel move"
    off_px = 0.22 / math.sqrt(samples**1.5 * size_px)
    return [
        f"{few} the middle of an even disc of {size_px:.3g} px by {off_px:.2g} px (1 sigma), of a crescent more, which"
        f" no camera does: raise rendering.samples_per_pixel to {most}"
    ]


def signal_in_words(detector: DetectorSpec, radiance_factor: FloatArray, weight: FloatArray) -> str:
    """Describe the signal of the lit surface in one frame, and say what to change where it is too low or too high.

    ``radiance_factor`` (N,) is the I/F of points of the surface, ``weight`` (N,) their areas in the image.
    """
    order = np.argsort(radiance_factor)
    shares = np.cumsum(weight[order]) / weight.sum()
    middle, bright = (float(radiance_factor[order][np.searchsorted(shares, share)]) for share in (0.5, 0.99))
    most_dn = 2**detector.bits - 1
    most_e = min(detector.full_well_e, (most_dn - detector.offset_dn) * detector.gain_e_per_dn)
    exposure_s = detector.exposure_s if isinstance(detector.exposure_s, float) else detector.exposure_s.median
    white_e = detector.white_e_per_s * exposure_s
    shot_e2 = middle * white_e + detector.dark_e_per_s * exposure_s if detector.shot_noise else 0.0
    noise_e = np.sqrt(shot_e2 + detector.read_noise_e**2 + detector.gain_e_per_dn**2 / 12.0)
    ratio = middle * white_e / noise_e
    dn = min(middle * white_e, most_e) / detector.gain_e_per_dn + detector.offset_dn
    saturated = float(weight[radiance_factor * white_e >= most_e].sum() / weight.sum())
    words = (
        f"lit surface: median {dn:.0f} DN of {most_dn}, signal to noise {ratio:.3g};"
        f" median {middle * white_e / most_e:.2g} and brightest {bright * white_e / most_e:.2g} of saturation"
    )
    if saturated > _SATURATED:
        return f"{words}: {100.0 * saturated:.0f} % is saturated, lower detector.exposure_s"
    return f"{words}: too dark for most methods, raise detector.exposure_s" if ratio < _NOISY else words


def _smear_in_words(scenario: LoadedScenario, detector: DetectorSpec, views: Sequence[_DrawnView]) -> str:
    """Describe the smear of images in some views; raise BoresightError if no image is made in any of them."""
    from boresight.renderers.artefacts import MOST_SMEAR_PX  # OpenCV and SciPy, of smear alone
    from boresight.renderers.detector import Detector

    lengths_px, exposing = [], Detector(detector)
    for trial, (view, _, velocity_m_s) in enumerate(views):
        rng = generator(0, Stream.DETECTOR, trial)
        motion = exposing.motion(drawn(detector.exposure_s, rng), view, velocity_m_s, rng)
        lengths_px.append(0.0 if motion is None else motion.length_px)
    most_px, failed = max(lengths_px), sum(length_px > MOST_SMEAR_PX for length_px in lengths_px)
    typical_px = np.median(lengths_px)
    words = f"motion moves images by {typical_px:.4g} px (median) and {most_px:.4g} px at most in {len(views)} views"
    if not failed:
        return words
    words += f", above {MOST_SMEAR_PX:g} px in {failed}, where trials fail: give lower rates or a shorter exposure_s"
    if failed == len(lengths_px):
        raise BoresightError(f"{scenario.path}: detector.motion: {words}")
    return words


def _craters_in_words(craters: CratersSpec | PlaneCratersSpec, in_view: float, m_per_px: float) -> str:
    """Describe the craters that are lit and in the frame, and say what to change where hardly any can be found."""
    least_m, most_m = craters.min_diameter_m, craters.max_diameter_m
    if least_m == most_m:
        share = float(most_m >= _FOUND_PX * m_per_px)
    else:
        at, low, high = (
            size_m**-craters.exponent for size_m in (np.clip(_FOUND_PX * m_per_px, least_m, most_m), least_m, most_m)
        )
        share = float((at - high) / (low - high))
    found = craters.count * share * in_view
    words = (
        f"craters of {least_m:g} to {most_m:g} m are {least_m / m_per_px:.3g} to {most_m / m_per_px:.3g} px across;"
        f" about {found:.2g} of {_FOUND_PX:g} px or more are lit and in an image"
    )
    return words if found >= 4.0 else f"{words}: too few for most methods, choose a shorter range or more craters"


def _views(scenario: LoadedScenario, mesh: TriangleMesh, flown: int) -> Iterator[_DrawnView]:
    """Yield views that are drawn as those of trials, or spread over the frames of a sequence or over real images.

    Views along a trajectory are spread over its first ``flown`` states, whatever its order is. None of tracks alone.
    """
    spec, camera, sequence = scenario.spec, scenario.spec.camera.camera(), scenario.spec.sequence
    states = [view * max(flown - 1, 0) // (_VIEWS - 1) for view in range(_VIEWS)]
    if spec.viewpoint is not None:
        for trial, state in enumerate(states):
            draws, own = generator(0, Stream.TRUTH, trial), drawn_together(spec, 0, trial)
            view = draw_aimed_view(own.viewpoint or spec.viewpoint, own.lighting, camera, mesh, draws, state)
            brightness = own.lighting.brightness
            velocity_m_s = None if spec.viewpoint.states is None else spec.viewpoint.states.velocity(state)
            yield view, brightness if isinstance(brightness, float) else brightness.median, velocity_m_s
    elif sequence is not None and sequence.images is not None and sequence.trajectory is not None:
        frames = nominal_trajectory(sequence, MeshGround(mesh)).views(camera)
        yield from ((frames[state], 1.0, None) for state in states)
    elif spec.images is not None:
        from boresight.campaign.imaging.real_images import open_images  # renderers take a second to import

        images = open_images(scenario)
        yield from ((images.view(index), 1.0, None) for index in range(0, len(images), -(-len(images) // _VIEWS)))


def _sight(scenario: LoadedScenario, mesh: TriangleMesh, views: Sequence[_DrawnView]) -> _Sight:
    """Look at points that are spread over the surface in some views.

    What one part of the body hides or shades of another is not taken into account, nor is relief smaller than a facet.
    Raise BoresightError if the sphere about the body is out of the frame in all of these views.
    """
    spec, camera, rng = scenario.spec, scenario.spec.camera.camera(), np.random.default_rng(0)
    areas = np.cumsum(mesh.areas_m2)
    rows = np.searchsorted(areas, areas[-1] * (np.arange(_POINTS) + 0.5) / _POINTS)
    weights = rng.dirichlet(np.ones(3), _POINTS)  # uniform over a triangle
    places, normals = np.einsum("pk,pki->pi", weights, mesh.corners_of(rows)), mesh.normals[rows]
    in_view, phases_rad = False, list[float]()
    seen = inside = dark = 0.0
    nearest_m = np.inf
    lit_points: list[FloatArray] = []  # (N, 3): I/F, projected area, distance
    for view, brightness, _ in views:
        in_view |= view.may_show(mesh.radius_m)
        phases_rad.append(view.phase_angle_rad)
        towards = view.T_cam_body.camera_position_m - places
        distances = np.linalg.norm(towards, axis=1)
        projected = np.einsum("pi,pi->p", normals, towards) / distances**3
        facing = projected > 0.0
        nearest_m = min(nearest_m, float(distances.min()))
        framed = camera.contains(camera.project(view.T_cam_body.transform(places[facing])))
        cos_i = normals[facing] @ view.sun_dir_body
        seen += float(projected[facing].sum())
        inside += float(projected[facing][framed].sum())
        dark += float(projected[facing][framed & (cos_i <= 0.0)].sum())
        lit = framed & (cos_i > 0.0)
        cos_e = (projected * distances**2)[facing][lit]
        phase_rad = np.arccos(np.clip(towards[facing][lit] @ view.sun_dir_body / distances[facing][lit], -1.0, 1.0))
        values = np.pi * brightness * cos_i[lit] * brdf_value(spec.brdf, cos_i[lit], cos_e, phase_rad)
        lit_points.append(np.stack([values, projected[facing][lit], distances[facing][lit]], axis=1))
    looked = f"{len(views)} {'views' if spec.images is None else 'image(s)'}"
    if not in_view:
        place = next(key for key in ("viewpoint", "sequence", "images") if getattr(spec, key) is not None)
        raise BoresightError(
            f"{scenario.path}: {place}: nothing of the body is in the frame in {looked}: check"
            " camera.principal_point_px, and the attitudes of a trajectory"
        )
    found = np.concatenate(lit_points)
    return _Sight(
        1.0 - inside / seen,
        dark / inside if inside else np.nan,
        len(found) / (len(views) * _POINTS),
        float(np.median(found[:, 2])) if len(found) else np.nan,
        nearest_m,
        found[:, 0],
        found[:, 1],
        (math.degrees(min(phases_rad)), math.degrees(max(phases_rad))),
        looked,
    )
