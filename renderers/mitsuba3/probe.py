"""Whether a variant traces rays at all: asked in a process of its own, for a driver that fails may take it along."""

from __future__ import annotations

import subprocess
import sys

_TIMEOUT_S = 120.0
_SAYS = "it traces rays"

# A cube of two units about the origin, a ray that meets it at distance 4, and one that passes by.
_PROBE = f"""
import sys
import mitsuba
mitsuba.set_variant(sys.argv[1])
import drjit
scene = mitsuba.load_dict({{"type": "scene", "cube": {{"type": "cube"}}}})
rays = mitsuba.Ray3f(mitsuba.Point3f([0.1, 5.0], [0.2, 5.0], [-5.0, -5.0]), mitsuba.Vector3f(0.0, 0.0, 1.0))
hit = scene.ray_intersect_preliminary(rays)
distance = drjit.select(hit.is_valid(), hit.t, -1.0).numpy()
blocked = scene.ray_test(rays).numpy()
if abs(distance[0] - 4.0) > 1e-4 or distance[1] != -1.0 or list(blocked) != [True, False]:
    sys.exit(f"rays meet a cube at {{distance}}, {{blocked}}")
print({_SAYS!r})
"""


def variant_fault(name: str, timeout_s: float = _TIMEOUT_S) -> str:
    """Say in one line why Mitsuba's variant ``name`` traces no rays here; '' where it does."""
    try:
        done = subprocess.run(  # noqa: S603  this interpreter, with a script of ours
            [sys.executable, "-c", _PROBE, name],
            stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=timeout_s, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"no answer in {timeout_s:g} s"
    except OSError as error:
        return f"no process could be started ({error.strerror})"
    if done.returncode == 0 and _SAYS in done.stdout:
        return ""
    if done.returncode < 0:
        return f"its process was ended by signal {-done.returncode}"
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return lines[-1] if lines else f"its process ended with exit code {done.returncode}"
