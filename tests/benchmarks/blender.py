"""Blender Cycles in a process of its own, with an interpreter of its own: ``bpy`` brings and pins its own packages."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.scene import ALBEDO, FOV_RAD, SIZE_PX, SUN_DIR_BODY, SpeedScene
from benchmarks.timing import Seconds
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import View

VARIABLE = "BORESIGHT_BLENDER_PYTHON"
_SCRIPT = Path(__file__).with_name("blender_script.py")
_WORDS = "stderr.txt"
_HOW = (
    f"make a virtual environment, `pip install bpy` in it, and name its interpreter by --blender PYTHON or ${VARIABLE}"
)


@dataclass(frozen=True, slots=True)
class Cycles:
    """A running Blender that holds the scene."""

    version: str
    scene: SpeedScene
    folder: Path
    to: IO[str]
    answers: IO[str]

    def render(self, view: int, samples: int) -> Seconds:
        """Render the window of a view with the body, and tell how long Blender took for that alone."""
        answer = self._ask(f"{view} {samples}")
        return Seconds(answer["cpu"], answer["wall"])

    def image(self, view: int, samples: int) -> NDArray[np.float32]:
        """Render a view; radiance factor (H, W)."""
        file = self.folder / "image.npy"
        self._ask(f"{view} {samples} {file}")
        image = np.zeros((SIZE_PX, SIZE_PX), dtype=np.float32)
        image[self.scene.window(view).slices] = np.load(file)
        return image

    def _ask(self, line: str) -> dict[str, Any]:
        try:
            self.to.write(f"{line}\n")
            self.to.flush()
        except BrokenPipeError:
            pass  # it ended; its last words tell why
        return _answer(self.answers, self.folder)


@contextmanager
def cycles(python: Path | None, scene: SpeedScene, threads: int) -> Iterator[Cycles]:
    """Start Blender with a scene, and end it.

    Parameters
    ----------
    python
        The interpreter that has ``bpy``; $BORESIGHT_BLENDER_PYTHON, or this one, where it is None.
    scene
        What is rendered.
    threads
        Threads that it may use.

    Raises
    ------
    BoresightError
        If it does not start.
    """
    interpreter = str(python or os.environ.get(VARIABLE) or sys.executable)
    with tempfile.TemporaryDirectory(prefix="boresight-cycles-") as name:
        folder = Path(name)
        _write(folder / "scene.npz", scene, threads)
        try:
            with (folder / _WORDS).open("w", encoding="utf-8") as words:
                blender = subprocess.Popen(
                    # -P: nothing beside the script shadows what Blender imports.
                    [interpreter, "-P", str(_SCRIPT), name],
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=words, text=True,
                    env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
                )  # fmt: skip
        except OSError as error:
            raise BoresightError(f"Blender: {interpreter} cannot be started ({error.strerror}); {_HOW}") from None
        with blender:
            try:
                if blender.stdin is None or blender.stdout is None:
                    raise BoresightError("Blender: its process has no pipes")
                version = str(_answer(blender.stdout, folder)["version"])
                yield Cycles(version, scene, folder, blender.stdin, blender.stdout)
            finally:
                blender.kill()


def _write(file: Path, scene: SpeedScene, threads: int) -> None:
    np.savez(
        file,
        vertices_m=scene.mesh.vertices_m,
        faces=scene.mesh.faces,
        T_body_camera=np.array([_blender_pose(view) for view in scene.views]),
        windows=np.array([astuple(scene.window(k)) for k in range(len(scene.views))]),
        sun_dir_body=SUN_DIR_BODY,
        size_px=SIZE_PX,
        fov_rad=FOV_RAD,
        albedo=ALBEDO,
        threads=threads,
    )


def _blender_pose(view: View) -> NDArray[np.float64]:
    """Camera to body (4, 4), of Blender's camera: x right, y up, z backward."""
    pose = np.eye(4)
    pose[:3, :3] = view.T_cam_body.rotation.T @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = view.T_cam_body.camera_position_m
    return pose


def _answer(answers: IO[str], folder: Path) -> dict[str, Any]:
    line = answers.readline()
    if line:
        return dict(json.loads(line))
    words = (folder / _WORDS).read_text(encoding="utf-8", errors="replace").strip().splitlines()
    why = words[-1].strip() if words else "it ended without a word"
    raise BoresightError(f"Blender: {why}; {_HOW}")
