"""Sequence section: orbit, trajectory or real tracks, forces, rotation, simulated or image-based tracks, knowledge."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from boresight.scenarios.spec.base import SpecModel, WithDefaultAlternative, deviation, optional, rule
from boresight.scenarios.spec.distribution import Direction
from boresight.scenarios.spec.trajectory import SequenceTrajectorySpec
from boresight.scenarios.spec.vision import ImageVisionSpec, VisionSpec


class TrackTableSpec(SpecModel):
    """Real tracks instead of simulated ones: tables of sightings and of reference poses, or files of SPC with both.

    ``table`` has a row for each sighting: ``track``, a number; ``frame``, the row of ``poses`` from 0; and ``u_px``,
    ``v_px``, or ``x_normalised``, ``y_normalised``: x / z and y / z in camera axes. Lens distortion is corrected. The
    sightings of a track are in the order of its frames. ``poses`` has the columns of ``viewpoint.trajectory.table``
    in body axes, attitudes among them. Both are CSV, Parquet, or MATLAB files of the toolbox SONIC.

    ``spc`` is a folder of stereophotoclinometry: SUM files in it or in SUMFILES, LMK files in it or in LMKFILES. The
    frames are the images that share landmarks, in the order of their epochs.

    Trials differ by the tracks that are drawn. Each frame is filled up with tracks that are seen in the next frame
    too, as a matcher knows a track from its second sighting on. They are followed to the last frame before a gap;
    after it, it is another track.
    """

    alternatives: ClassVar = (("table", "spc"), ("poses", "spc"))

    table: str | None = optional("Table of sightings (beside the scenario, or under BORESIGHT_DATA)", min_length=1)
    poses: str | None = optional(
        "Table of reference poses: scores, and the errors of all that is told beside tracks", min_length=1
    )
    spc: str | None = optional("Folder of SUM and LMK files, instead of table and poses", min_length=1)
    per_frame: int = Field(20, ge=3, le=100_000, description="Tracks of each frame that are drawn for a trial, if seen")
    frames: int | None = Field(
        None, ge=2, le=20_000, description="Consecutive frames of a trial; left out: all from the first one"
    )
    first_frame: int | None = Field(
        None, ge=0, le=20_000, description="First frame of a trial; left out: drawn where frames leave a choice, else 0"
    )
    sigma_px: float = Field(0.5, gt=0, description="Standard deviation of a coordinate that estimators are told")
    loops: bool = Field(
        False, description="Whether a track that comes back after a gap is recognised, as an additional loop closure"
    )


MOST_FRAMES = 1_000_000
_DAY_S = 86400.0


class ForcesSpec(SpecModel):
    """Forces on a spacecraft near a small body: equation (6) of Delpech et al. (2015)."""

    gravity: Literal["point-mass", "polyhedral"] = Field(
        "point-mass", description="Gravity of a point at the origin, or of the scenario's body at one density"
    )
    area_to_mass_m2_kg: float = Field(
        0.0, ge=0, description="Area over mass of the spacecraft as a sphere, for solar radiation pressure; 0 for none"
    )
    reflectivity: float = Field(1.3, ge=1, le=2, description="1 where all light is absorbed, 2 where it is thrown back")
    sun_distance_au: float = Field(
        1.0, gt=0, description="Distance of the body from the Sun; 0.746 to 1.099 for Apophis"
    )
    noise_m_s2: float = deviation(0.0, "each coordinate of an unmodelled acceleration, drawn for each step", ge=0)


class BodyMotionSpec(SpecModel):
    """Rotation of the body; body and inertial axes coincide at the first frame.

    Tumbling is torque-free: the angular velocity starts like that of a spin and evolves by Euler's equations with the
    inertia in body axes.
    """

    kind: Literal["none", "spin", "tumbling"] = Field(
        "none", description="At rest, about a fixed axis, or torque-free about no principal axis"
    )
    period_h: float = Field(30.4, gt=0, description="Period of the rotation at the first frame; 30.4 h for Apophis")
    axis_body: Direction = Field((0.0, 0.0, 1.0), description="Direction of the angular velocity, body axes")
    inertia: tuple[float, float, float] = Field(
        (0.61, 0.965, 1.0),
        description="Principal moments about the body's x, y, z, in any unit; only tumbling depends on them",
    )

    @rule
    def _is_a_rotation(self) -> None:
        # The principal moments of any body obey the triangle inequality.
        if min(self.inertia) <= 0 or 2 * max(self.inertia) > sum(self.inertia):
            raise ValueError(f"inertia {list(self.inertia)}: no moment may exceed the sum of the other two, or be zero")
        if self.kind != "tumbling" and self.stated("inertia"):
            raise ValueError("inertia has no part in a body that does not tumble: leave it out, or say kind: tumbling")
        moments = [moment for moment, part in zip(self.inertia, self.axis_body, strict=True) if part]
        # Angular velocity and momentum are parallel if all moments of the axes that take part are equal.
        if self.kind == "tumbling" and len(set(moments)) < 2:
            raise ValueError("axis_body is a principal axis, about which no body tumbles: tilt it, or say kind: spin")


class SequenceOrbitSpec(SpecModel):
    """An orbit about the body's origin; the boresight stays on the origin and x along the velocity.

    It is a circle, or starts as one and is propagated under ``forces``; then radius and anomaly are those of the circle
    at the same time. The Sun is along the orbit's normal (terminator orbit). Inertial axes are the body's axes at the
    first frame.
    """

    model: Literal["circular", "propagated"] = Field(
        "circular", description="A circle at constant speed, or an orbit integrated under ``forces``"
    )
    radius_m: float = Field(790.0, gt=0, description="Radius: 600 m above a sphere of 190 m in Delpech et al. (2015)")
    normal_body: Direction = Field(
        (0.0, 0.0, 1.0), description="Normal of the orbit, inertial axes; over the terminator it points to the Sun"
    )
    start_deg: float = Field(0.0, description="Anomaly of the first frame, from where the orbit comes nearest body x")
    step_deg: float = Field(2.0, ge=0.01, le=90, description="Anomaly between frames")
    revolutions: float = Field(2.0, gt=0, le=1000, description="Length of the sequence, in revolutions")
    gm_m3_s2: float = Field(3.54, gt=0, description="Gravity of the body, which sets the times; 5.3e10 kg by default")
    forces: ForcesSpec = ForcesSpec()

    @rule
    def _can_be_flown(self) -> None:
        if self.frames < 2:
            raise ValueError(f"{self.revolutions:g} revolutions in steps of {self.step_deg:g} deg are less than a step")
        if self.frames > MOST_FRAMES:
            raise ValueError(f"{self.frames} frames are more than {MOST_FRAMES}: take longer steps")
        if self.model == "circular" and self.forces != ForcesSpec():
            raise ValueError("forces have no part in a circular orbit: say model: propagated, or leave them out")

    @property
    def frames(self) -> int:
        """Number of frames, the first included."""
        # 1e-9: whole numbers of steps must not lose a frame by rounding.
        return int(self.revolutions * 360.0 / self.step_deg + 1e-9) + 1


class SequenceKnowledgeSpec(SpecModel):
    """A priori knowledge in addition to the images, and its standard deviations."""

    motion_error: float = Field(
        0.5, ge=0, description="lambda: length of the error of a predicted displacement over the displacement's"
    )
    ranges: int = Field(1, ge=0, le=100, description="Landmarks whose distance is measured in the first frame")
    range_to: Literal["central", "lasting"] = Field(
        "central",
        description="The landmarks seen nearest the principal point, or those whose tracks will last longest, which no"
        " spacecraft can know: a bound for studies of what the choice matters",
    )
    range_sigma_m: float = deviation(0.1, "such a distance", gt=0)
    range_every: int = Field(
        0, ge=0, description="Ranges are measured again after so many frames; 0 for the first frame alone"
    )
    position_sigma_m: float = deviation(0.0, "each coordinate of the first camera position", ge=0)
    attitude_sigma_deg: float = deviation(0.0, "a frame's attitude about each camera axis", ge=0)
    misalignment_sigma_deg: float = deviation(
        0.0, "the camera's mounting about each axis, the same in all frames", ge=0
    )
    pole_sigma_deg: float = deviation(
        0.0, "the direction of the body's spin axis, about each of two axes across it", ge=0
    )
    spin_sigma: float = Field(0.0, ge=0, lt=1, description="Relative standard deviation of the body's spin rate")
    dynamics: bool = Field(
        False, description="Whether the spacecraft knows the forces on it, with the errors of the keys below"
    )
    gm_sigma: float = Field(0.0, ge=0, lt=1, description="Relative standard deviation of the gravity parameter")
    radiation_sigma: float = Field(0.0, ge=0, lt=1, description="Relative standard deviation of the radiation pressure")
    velocity_sigma_m_s: float = deviation(0.0, "each coordinate of the velocity at the first frame", ge=0)
    noise_m_s2: float | None = Field(
        None, gt=0, description="Unmodelled acceleration that estimators assume; left out: the true one"
    )
    walk_px: float | None = optional(
        "Standard deviation of a coordinate's random step from frame to frame, of each track, that estimators assume;"
        " left out: none",
        gt=0,
    )
    contraction: float | None = optional(
        "Standard deviation of the contraction, as in sequence.vision.track_errors, that estimators assume; left out:"
        " none",
        gt=0,
        lt=1,
    )
    drift_px: float | None = optional(
        "Standard deviation of each coordinate of a step that all tracked points take from frame to frame, that"
        " estimators assume; left out: none",
        gt=0,
    )

    @rule
    def _dynamics_are_asked_for(self) -> None:
        given = self.stated("gm_sigma", "radiation_sigma", "velocity_sigma_m_s", "noise_m_s2")
        if given and not self.dynamics:
            raise ValueError(f"{given[0]} has no part where the forces are not known: say dynamics: true, or leave it")


class SequenceSpec(WithDefaultAlternative):
    """An image sequence along an orbit or a trajectory or of real tracks, instead of single images."""

    alternatives: ClassVar = (("orbit", "trajectory", "tracks"),)

    sphere_radius_m: float | None = Field(
        None, gt=0, description="Landmarks on an ideal sphere of this radius; left out: on the scenario's body"
    )
    orbit: SequenceOrbitSpec = SequenceOrbitSpec()
    trajectory: SequenceTrajectorySpec | None = optional("States of the camera, instead of orbit")
    tracks: TrackTableSpec | None = optional("Real tracks and reference poses of a file, instead of orbit and vision")
    body_motion: BodyMotionSpec = BodyMotionSpec()
    vision: VisionSpec = VisionSpec()
    images: ImageVisionSpec | None = Field(None, description="Tracks of rendered images instead of simulated ones")
    knowledge: SequenceKnowledgeSpec = SequenceKnowledgeSpec()

    @property
    def ended_revolutions(self) -> tuple[int, ...]:
        """Numbers, from 1, of the revolutions that a frame ends; () along given states."""
        if self.trajectory is not None or self.tracks is not None:
            return ()
        ends = ((k, 360.0 * k / self.orbit.step_deg) for k in range(1, int(self.orbit.revolutions + 1e-9) + 1))
        return tuple(k for k, steps in ends if abs(steps - round(steps)) * self.orbit.step_deg < 1e-6)  # as in scores

    @rule
    def _orbit_clears_the_sphere(self) -> None:
        sphere_m = self.sphere_radius_m or 0.0
        if self.trajectory is not None:
            ranges_m = np.linalg.norm(self.trajectory.states.position_m, axis=1)
            if ranges_m.min() <= sphere_m:
                row = int(ranges_m.argmin())
                raise ValueError(
                    f"trajectory: row {row} (from 0), at {ranges_m[row]:.6g} m, is not above the sphere of"
                    f" {sphere_m:g} m: check its units and axes"
                )
        elif self.orbit.radius_m <= sphere_m:
            raise ValueError(f"orbit.radius_m {self.orbit.radius_m:g} is not above the sphere of {sphere_m:g} m")

    @rule
    def _a_trajectory_has_its_own(self) -> None:
        flown, turning = self.trajectory, self.body_motion.kind != "none"
        if flown is None:
            return
        if turning and (flown.rotation is not None or flown.spice is not None):
            has = "rotation" if flown.rotation is not None else "spice"
            raise ValueError(f"body_motion has no part where trajectory.{has} has the body's rotation: leave it out")
        if turning and flown.flyby is not None:
            raise ValueError("body_motion: a flyby is in inertial axes: give the rotation as trajectory.rotation")
        if self.knowledge.dynamics and flown.flyby is None:
            raise ValueError("knowledge.dynamics: only orbit and trajectory.flyby have forces: leave it out")
        if self.images is not None and self.images.stated("starts"):
            raise ValueError("images.starts has no part where trials begin at the first state: leave it out")

    @rule
    def _real_tracks_have_their_own(self) -> None:
        if self.tracks is None:
            return
        if self.sphere_radius_m is not None:
            raise ValueError(
                "sphere_radius_m: real tracks are of a body, whose shape ranges are measured to: give body"
            )
        known = [f"knowledge.{key}" for key in self.knowledge.stated("dynamics")]
        if given := [*self.stated("vision", "images", "body_motion"), *known]:
            raise ValueError(f"{given[0]} has no part where tracks have path and sightings, in body axes: leave it out")

    @rule
    def _body_pulls_and_turns(self) -> None:
        if self.sphere_radius_m is not None and self.orbit.forces.gravity == "polyhedral":
            raise ValueError(
                "orbit.forces.gravity: a sphere pulls like a point: leave polyhedral or sphere_radius_m out"
            )
        wrong = self.knowledge.stated("pole_sigma_deg", "spin_sigma")
        if wrong and self.motion.kind == "none":
            raise ValueError(f"knowledge.{wrong[0]}: the body does not turn: give body_motion.kind, or leave it out")

    @rule
    def _tracks_of_a_fixed_field_are_found_fast_enough(self) -> None:
        vision = self.vision
        # An untracked landmark is found with the probability (1 - k) f / (1 - f), which must not exceed 1.
        odds, lost = vision.tracked_share / (1.0 - vision.tracked_share), 1.0 - vision.survival(self._largest_step_deg)
        if vision.field == "fixed" and odds * lost > 1.0:
            raise ValueError(
                f"vision.tracked_share {vision.tracked_share:g} cannot be kept up where {lost:.2g} of the tracks"
                f" are lost from frame to frame: at most {1.0 / (1.0 + lost):.3g}"
            )

    @rule
    def _images_fit_the_orbit(self) -> None:
        if self.images is None:
            return
        if self.vision != VisionSpec() or self.sphere_radius_m is not None:
            key = "sphere_radius_m" if self.vision == VisionSpec() else "vision"
            raise ValueError(f"{key} has no part where images show the body: leave it or images out")
        if self.trajectory is not None:
            return
        if self.orbit.model != "circular" or self.body_motion.kind != "none":
            raise ValueError("images are of a circular orbit about a body at rest: leave images or the motion out")
        count = 360.0 / self.orbit.step_deg
        if abs(count - round(count)) > 1e-9:
            raise ValueError(f"orbit.step_deg {self.orbit.step_deg:g} does not divide 360: images must close the orbit")
        if round(count) % self.images.starts:
            raise ValueError(f"images.starts {self.images.starts} does not divide the {count:.0f} images of the orbit")

    @property
    def _largest_step_deg(self) -> float:
        """The largest change of view between two frames, which is an angle at the body's origin."""
        if self.trajectory is None:
            return self.orbit.step_deg
        places = np.array(self.trajectory.states.position_m)
        places /= np.linalg.norm(places, axis=1, keepdims=True)
        apart = np.linalg.norm(np.diff(places, axis=0), axis=1).max()
        return float(np.degrees(2.0 * np.arcsin(min(0.5 * apart, 1.0))))

    @property
    def frames(self) -> int:
        """Number of frames, the first included."""
        return self.orbit.frames if self.trajectory is None else len(self.trajectory.states)

    @property
    def gm_m3_s2(self) -> float:
        """Gravity of the body; along a trajectory without one, nothing depends on it."""
        flyby = None if self.trajectory is None else self.trajectory.flyby
        return self.orbit.gm_m3_s2 if flyby is None else flyby.gm_m3_s2

    @property
    def motion(self) -> BodyMotionSpec:
        """Rotation of the body: ``body_motion``, or that of the trajectory."""
        flown = self.trajectory
        if flown is None or (flown.rotation is None and flown.spice is None):
            return self.body_motion
        if flown.rotation is not None:
            rate = np.array([0.0, 0.0, np.radians(flown.rotation.rate_deg_day) / _DAY_S])
        else:
            rate = np.array(flown.states.spin_rad_s or (0.0, 0.0, 0.0))
        size = float(np.linalg.norm(rate))
        if not size:
            return BodyMotionSpec()
        return BodyMotionSpec(kind="spin", period_h=2.0 * np.pi / size / 3600.0, axis_body=tuple(rate.tolist()))

    @property
    def sigma_px(self) -> float:
        """Standard deviation of a coordinate as given to estimators."""
        if self.tracks is not None:
            return self.tracks.sigma_px
        return self.vision.noise_px if self.images is None else self.images.sigma_px
