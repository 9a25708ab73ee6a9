"""Choice of the Mitsuba variant that works on this machine, and of the NVIDIA GPU of each worker process."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from boresight.renderers.mitsuba3.llvm import HIDE_VARIABLE, MINIMUM_MAJOR, WHEEL, find_llvm, use_llvm
from boresight.scenarios.errors import BoresightError

CUDA, LLVM, SCALAR = "cuda_ad_mono", "llvm_ad_mono", "scalar_rgb"
CUDA_PROBED = "BORESIGHT_CUDA_PROBED"

_LLVM_ADVICE = (
    f"for rendering several times faster install a libLLVM of version {MINIMUM_MAJOR} or newer: `pip install {WHEEL}`"
    f" on Linux x86-64, or the system's package (Debian: libllvm19, macOS: brew install llvm)"
)

_TIMEOUT_S = 120.0
_SAYS = "it traces rays"

# A cube of side 2 about the origin, a ray that hits it at distance 4, and one that misses it.
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

# LLVM may take AVX2 and no more, which x86-64 processors have had since 2013: with AVX-512 a few pixels at the edges of
# facets and shadows come out otherwise, and the medians of recognition with them. It is as fast.
_TARGET = (b"haswell", b"+avx2,+fma", 8)

VISIBLE_GPUS = "CUDA_VISIBLE_DEVICES"
"""Environment variable of NVIDIA's driver that lists the GPUs a process may use."""


def variant_fault(name: str, timeout_s: float = _TIMEOUT_S) -> str:
    """Test ray tracing with a variant in a subprocess, as a faulty driver can crash it; return the fault or ''."""
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


@dataclass(frozen=True, slots=True)
class Variant:
    """A Mitsuba variant, the reason for its choice, and advice for faster rendering ('' if there is none)."""

    name: str
    why: str
    advice: str = ""

    @property
    def is_wavefront(self) -> bool:
        """Whether it traces arrays of rays at once, rather than single rays."""
        return self.name != SCALAR


def choose_variant(request: str | None = None) -> Variant:
    """Choose the fastest variant that works, or check the requested one.

    The first call imports Dr.Jit, with a libLLVM that works with it if there is one. Raise `BoresightError` if the
    requested variant is unknown or does not work here.
    """
    if request not in (None, CUDA, LLVM, SCALAR):
        raise BoresightError(f"the Mitsuba variant {request!r} is unknown: choose {CUDA}, {LLVM} or {SCALAR}")
    if request == SCALAR:
        return Variant(SCALAR, "it was asked for")
    llvm, llvm_why = _llvm_status()
    if request == LLVM:
        if not llvm:
            raise BoresightError(f"the Mitsuba variant {LLVM} does not work here: {llvm_why}; {_LLVM_ADVICE}")
        return Variant(LLVM, f"it was asked for; {llvm_why}")
    cuda, cuda_why = _cuda_status()
    if request == CUDA:
        if not cuda:
            raise BoresightError(
                f"the Mitsuba variant {CUDA} does not work here: {cuda_why};"
                f" install NVIDIA's driver, or leave the choice of variant to boresight"
            )
        return Variant(CUDA, f"it was asked for; {cuda_why}")
    if cuda:
        return Variant(CUDA, cuda_why)
    if llvm:
        return Variant(LLVM, llvm_why)
    return Variant(SCALAR, llvm_why, _LLVM_ADVICE)


def gpu_status() -> str:
    """Return one line on whether rendering on a GPU works on this machine, and why."""
    return _cuda_status()[1]


def code_generator(variant: Variant) -> str:
    """Return compiler and instructions of a variant ("LLVM 19.1.7 haswell", or ''), as others may round differently."""
    if variant.name != LLVM:
        return ""
    load_mitsuba(variant)
    target = f" {_TARGET[0].decode()}" if _keep_to_avx2() else ""
    return f"LLVM {'.'.join(map(str, _load_drjit().detail.llvm_version()))}{target}"


def load_mitsuba(variant: Variant) -> Any:
    """Return the library ``mitsuba`` with this variant active.

    Mitsuba's active variant is global to the process, so every user of the library gets it from here.
    """
    import mitsuba

    if mitsuba.variant() != variant.name:
        mitsuba.set_variant(variant.name)
    if variant.name == LLVM:
        _keep_to_avx2()
    return mitsuba


@cache
def _keep_to_avx2() -> bool:
    """Let Dr.Jit compile for the same instructions on every x86-64 processor; return whether it does."""
    # Its Python module does not offer these functions of drjit-core (`jit.h`), so their C++ names stand here; where
    # they are called otherwise, or the processor has no AVX2, Dr.Jit compiles for the processor at hand.
    try:
        core = ctypes.CDLL(str(Path(_load_drjit().__file__).with_name("libdrjit-core.so")))
        features, set_target = core._Z24jit_llvm_target_featuresv, core._Z19jit_llvm_set_targetPKcS0_j
    except (OSError, AttributeError):
        return False
    features.restype = ctypes.c_char_p
    if not {b"+avx2", b"+fma"} <= set((features() or b"").split(b",")):
        return False
    set_target.argtypes = (ctypes.c_char_p, ctypes.c_char_p, ctypes.c_uint32)
    set_target(*_TARGET)
    return True


def limit_threads(threads: int) -> None:
    """Set the number of threads of Mitsuba and Dr.Jit in this process; `BoresightError` below 1."""
    if threads < 1:
        raise BoresightError(f"rendering needs at least 1 thread, not {threads}")
    _load_drjit().set_thread_count(threads)


def _load_drjit() -> Any:
    """Import Dr.Jit with a suitable libLLVM, unless the program imported it earlier."""
    # Dr.Jit opens its libLLVM at import: later the choice has no effect.
    if "drjit" not in sys.modules:
        found = find_llvm().found
        if found is not None:
            use_llvm(found)
    import drjit

    return drjit


@cache
def _llvm_status() -> tuple[bool, str]:
    """Return whether Dr.Jit's LLVM backend works, and why or why not."""
    drjit = _load_drjit()
    search = find_llvm()
    if search.found is None:
        reasons = "; ".join(f"{item.path}: {item.reason}" for item in search.rejected)
        return False, f"no usable libLLVM was found ({reasons or f'none is installed, or {HIDE_VARIABLE} is set'})"
    if not drjit.has_backend(drjit.JitBackend.LLVM):
        return False, f"Dr.Jit could not start LLVM from {search.found.path}"
    version = drjit.detail.llvm_version()
    if version[0] < MINIMUM_MAJOR:
        return False, f"Dr.Jit was imported before boresight and took LLVM {version[0]}, with which it crashes"
    return True, f"LLVM {'.'.join(map(str, version))} works ({search.found.path})"


@cache
def _cuda_status() -> tuple[bool, str]:
    """Return whether an NVIDIA GPU traces rays with OptiX, by the driver and then by a test, and why or why not."""
    gpus, fault = nvidia_gpus()
    if not gpus:
        return False, fault
    drjit = _load_drjit()
    if not drjit.has_backend(drjit.JitBackend.CUDA):
        return False, "Dr.Jit could not start CUDA"
    if not os.environ.get(CUDA_PROBED):
        fault = variant_fault(CUDA)
        if fault:
            return False, f"the NVIDIA driver finds {gpus} GPU, but Mitsuba traces no rays on it: {fault}"
        os.environ[CUDA_PROBED] = "1"  # inherited by worker processes, which need not test again
    return True, f"{gpus} NVIDIA GPU with OptiX"


def nvidia_gpus() -> tuple[int, str]:
    """Return the number of NVIDIA GPUs by the driver, and for 0 the reason."""
    count = ctypes.c_int(0)
    try:
        driver = ctypes.CDLL("libcuda.so.1")
        ctypes.CDLL("libnvoptix.so.1")
    except OSError as error:
        return 0, f"no NVIDIA driver with OptiX ({error})"
    if driver.cuInit(0) != 0 or driver.cuDeviceGetCount(ctypes.byref(count)) != 0 or count.value == 0:
        return 0, "the NVIDIA driver finds no GPU"
    return count.value, ""


def gpu_names() -> tuple[str, ...]:
    """Names of the GPUs in CUDA_VISIBLE_DEVICES, or of all GPUs if it is not set."""
    chosen = os.environ.get(VISIBLE_GPUS)
    if chosen is not None:
        return tuple(name.strip() for name in chosen.split(",") if name.strip())
    return tuple(str(number) for number in range(nvidia_gpus()[0]))


def gpu_of_worker(place: int) -> dict[str, str]:
    """Environment variables that give a worker a GPU of its own; none if there is only one GPU.

    Dr.Jit uses the first visible GPU, which all workers would share otherwise. ``place`` is the index of the worker,
    from 0; with more workers than GPUs, several share a GPU.
    """
    names = gpu_names()
    # CUDA numbers the visible devices from 0, and Dr.Jit takes device 0.
    return {VISIBLE_GPUS: names[place % len(names)]} if len(names) > 1 else {}
