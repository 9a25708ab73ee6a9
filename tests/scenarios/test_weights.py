"""Weights of trials by another law of the pose errors, against the moments of the laws and against scipy."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import maxwell

from boresight.scenarios.draw import Stream, draw_pose_error, generator
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spec.world import PoseErrorSpec
from boresight.scenarios.weights import log_density, pose_error_weights

N = 2000
WIDE = {"mixture": [{"weight": 1, "law": {"normal": [2, 2, 2]}}, {"weight": 2, "law": {"normal": [6, 4, 5]}}]}


def spec(position, attitude=None, key="position_cam_m"):
    return PoseErrorSpec.model_validate_json(
        json.dumps({key: position, "attitude": attitude or {"angle_deg": {"normal": 1.0}}})
    )


TRUE = {
    "normal": spec({"normal": [2, 1, 1.5], "mean": [0.5, 0, 0]}, {"angle_deg": {"normal": 1.0}}),
    "correlated": spec(
        {"covariance": [[2, 1, 0], [1, 2, 0], [0, 0, 1]]}, {"rotation_vector_deg": {"normal": [0.5, 0.5, 0.5]}}
    ),
    "uniform": spec({"uniform": [[-3, 3], [-1, 2], [-2, 2]]}, {"angle_deg": {"uniform": [-1, 1]}}),
    "mixture": spec(
        {"mixture": [{"weight": 1, "law": {"normal": [1, 1, 1]}}, {"weight": 3, "law": {"normal": [2, 1, 1]}}]},
        {"angle_deg": {"normal": [0.3, 0.7]}},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TRUE)
def test_weighted_moments_are_those_of_the_wanted_law(name):
    wanted, drawn = TRUE[name], spec(WIDE, {"angle_deg": {"normal": 2.0}})
    weights = pose_error_weights(wanted, drawn, 3, np.arange(N))
    errors = [draw_pose_error(drawn, generator(3, Stream.POSE_ERROR, trial)) for trial in range(N)]
    for part, moment in (
        (np.array([one for one, _ in errors]), wanted.position[1].second_moment),
        (np.degrees([turn for _, turn in errors]), np.degrees(np.degrees(wanted.attitude.second_moment_rad2))),
    ):
        products = weights[:, None, None] * part[:, :, None] * part[:, None, :]
        sigma = products.std(axis=0) / np.sqrt(N)
        assert (np.abs(products.mean(axis=0) - moment) < 4.5 * sigma).all()
    assert weights.mean() == pytest.approx(1.0, abs=4.5 * weights.std() / np.sqrt(N))


def test_the_weight_of_its_own_law_is_one():
    drawn = TRUE["mixture"]
    assert pose_error_weights(drawn, drawn, 1, np.arange(50)) == pytest.approx(np.ones(50))


def test_rotations_and_shifts_with_one_covariance():
    rows = np.diag([1.0, 1.0, 1.0, 400.0, 400.0, 25.0])
    rows[0, 3] = rows[3, 0] = 15.0
    narrow, wide = (
        PoseErrorSpec.model_validate({"pose_cam_deg_m": {"covariance": tuple(map(tuple, scale * rows))}})
        for scale in (1.0, 2.0)
    )
    weights = pose_error_weights(narrow, wide, 4, np.arange(4000))
    # Of 6 components with half the covariance.
    assert weights.max() < 8.0
    assert weights.mean() == pytest.approx(1.0, abs=4.5 * weights.std() / np.sqrt(4000))


def test_an_angle_about_any_axis_is_a_density_over_rotation_vectors():
    """A normal vector of three equal components has an angle of Maxwell's law; scipy has its density."""
    vector = spec(WIDE, {"rotation_vector_deg": {"normal": [0.7, 0.7, 0.7]}})
    angle = spec(WIDE, {"angle_deg": {"normal": 2.0}})
    ratio = pose_error_weights(vector, angle, 5, np.arange(100))
    turns = [draw_pose_error(angle, generator(5, Stream.POSE_ERROR, trial))[1] for trial in range(100)]
    size = np.degrees(np.linalg.norm(turns, axis=1))
    folded = 2.0 * np.exp(-0.5 * (size / 2.0) ** 2) / (2.0 * np.sqrt(2.0 * np.pi))
    assert ratio == pytest.approx(maxwell.pdf(size, scale=0.7) / folded)


def test_a_density_integrates_to_one():
    law = spec(WIDE, {"angle_deg": {"normal": [0.4, 1.3]}}).attitude.angle_deg
    whole, _ = quad(lambda x: float(np.exp(log_density(law, np.array([x]))[0])), -12.0, 12.0)
    assert whole == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("wanted", "drawn", "said"),
    [
        (spec({"choice": [[1, 2, 3], [4, 5, 6]]}), spec(WIDE), "choice.* has no density"),
        (spec({"normal": [1, 1, 1], "student_t": 5}), spec(WIDE), "student_t.* has no density"),
        (spec({"normal": [1, 1, 0]}), spec(WIDE), "has no density"),
        (spec({"uniform": [[-1, 1], [-1, 1], [0, 0]]}), spec(WIDE), "has no density"),
        (spec({"covariance": [[1, 1, 0], [1, 1, 0], [0, 0, 1]]}), spec(WIDE), "has no density"),
        (spec(WIDE, {"angle_deg": 1.0}), spec(WIDE), "has no density"),
        (spec(WIDE), spec(WIDE, key="position_cam_px"), "position_cam_px.*position_cam_m: give the same"),
    ],
)
def test_laws_that_cannot_be_weighted_are_refused(wanted, drawn, said):
    with pytest.raises(BoresightError, match=said):
        pose_error_weights(wanted, drawn, 1, np.arange(3))
