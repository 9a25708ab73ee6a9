"""Ceres in a C++ program of its own, built where a compiler and libceres-dev are."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from numpy_equations import cost

from benchmarks.peers import PeerSolution
from boresight.estimators.slam.adjustment.problem import Adjustment, State
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError

Case = tuple[Adjustment, State]

# Its default, and the loosest power of ten that ends the windows of the benchmark within a part in a million of their
# minimum.
FUNCTION_TOLERANCE = 1e-6
_SOURCE = Path(__file__).with_name("ceres_peer.cpp")
_HOW = "install a compiler and Ceres: apt-get install g++ libceres-dev"


@dataclass(frozen=True, slots=True, eq=False)
class Ceres:
    """A running program that holds adjustments of pixels and distances."""

    cases: Sequence[Case]
    requests: IO[str]
    answers: IO[str]

    def solve(self, number: int, repetitions: int = 1, tolerance: float = FUNCTION_TOLERANCE) -> PeerSolution:
        """Solve an adjustment some times from its start; the times are means.

        Raises
        ------
        BoresightError
            If the program has ended.
        """
        problem, start = self.cases[number]
        try:
            self.requests.write(f"{number} {repetitions} {tolerance}\n")
            self.requests.flush()
        except BrokenPipeError:
            pass  # no answer will come
        build_s, solve_s, *places = [float(value) for value in self.answers.readline().split()] or [0.0, 0.0]
        if not places:
            raise BoresightError("Ceres: its program ended")
        views = len(start.positions_m)
        end = np.array(places).reshape(-1, 3)
        state = State(end[:views], end[views:])
        return PeerSolution(state, cost(problem, state), build_s, solve_s)


@contextmanager
def ceres(cases: Sequence[Case]) -> Iterator[Ceres]:
    """Build the program, start it with adjustments without motions and priors, and end it.

    Raises
    ------
    BoresightError
        If it cannot be built.
    """
    with tempfile.TemporaryDirectory(prefix="boresight-ceres-") as name:
        program, file = Path(name) / "ceres_peer", Path(name) / "windows"
        _build(program)
        np.concatenate([[float(len(cases))], *(_flat(*case) for case in cases)]).tofile(file)
        with subprocess.Popen(
            [program, file], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        ) as process:
            try:
                if process.stdin is None or process.stdout is None:
                    raise BoresightError("Ceres: its process has no pipes")
                yield Ceres(cases, process.stdin, process.stdout)
            finally:
                process.kill()


def version() -> str:
    """Return the version of Ceres that is compiled against.

    Raises
    ------
    BoresightError
        If there is no compiler, or no Ceres for it.
    """
    if shutil.which(_compiler()) is None:
        raise BoresightError(f"Ceres: there is no compiler {_compiler()}; {_HOW}")
    text = "#include <ceres/version.h>\nCERES_VERSION_STRING\n"
    found = subprocess.run(
        [_compiler(), "-E", "-P", "-x", "c++", "-"], input=text, capture_output=True, text=True, check=False
    )
    if found.returncode:
        raise BoresightError(f"Ceres: its headers are not installed; {_HOW}")
    return found.stdout.splitlines()[-1].replace('"', "").replace(" ", "")


def _compiler() -> str:
    return os.environ.get("CXX", "g++")


def _build(program: Path) -> None:
    version()
    # For this processor, as numba compiles our kernels.
    options = ["-std=c++17", "-O3", "-march=native", "-isystem", "/usr/include/eigen3"]
    built = subprocess.run(
        [_compiler(), *options, str(_SOURCE), "-o", str(program), "-lceres", "-lglog"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if built.returncode:
        why = next((line for line in built.stderr.splitlines() if "error" in line), "it cannot be built")
        raise BoresightError(f"Ceres: {why.strip()}")


def _flat(problem: Adjustment, start: State) -> FloatArray:
    """Return the numbers of an adjustment in the order in which the program reads them."""
    camera, seen, ranged = problem.camera, problem.pixels, problem.distances
    views, points = len(start.positions_m), len(start.points_m)
    parts = (
        [views, points, len(seen.view), len(ranged.view)],
        [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px],
        np.column_stack([problem.R_cam_body.reshape(views, 9), start.positions_m, problem.free_views]),
        start.points_m,
        np.column_stack([seen.view, seen.point, seen.uv_px, seen.sigma_px]),
        np.column_stack([ranged.view, ranged.point, ranged.range_m, ranged.sigma_m]),
    )
    return np.concatenate([np.asarray(part, dtype=np.float64).ravel() for part in parts])
