"""The frame of binary kernels: what once ended the process inside of SPICE's library is refused in one line."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import spiceypy

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spice import check_binary, loaded_kernels

_SEGMENTS = 30  # more than the 25 that one record tells of


@pytest.fixture(scope="module")
def kernel(tmp_path_factory) -> bytes:
    """Positions of one body in 30 spans of time, as SPICE itself writes them."""
    path = tmp_path_factory.mktemp("spk") / "a.bsp"
    handle = spiceypy.spkopn(str(path), "a", 0)
    for index in range(_SEGMENTS):
        epochs = np.linspace(0.0, 10.0, 11) + 10.0 * index
        states = np.column_stack([epochs, np.zeros((11, 2)), np.ones((11, 1)), np.zeros((11, 2))])
        spiceypy.spkw09(handle, -130, 10, "J2000", epochs[0], epochs[-1], "s", 3, 11, states, epochs)
    spiceypy.spkcls(handle)
    return path.read_bytes()


def replaced(kernel: bytes, at: int, form: str, value: float) -> bytes:
    changed = struct.pack(form, value)
    return kernel[:at] + changed + kernel[at + len(changed) :]


def test_a_kernel_of_spice_itself_is_read(kernel, tmp_path):
    path = tmp_path / "a.bsp"
    path.write_bytes(kernel)
    with loaded_kernels([path]):
        position, _ = spiceypy.spkpos("-130", 295.0, "J2000", "NONE", "10")
    np.testing.assert_allclose(position, [295.0, 0.0, 0.0], atol=1e-9)


def second(kernel: bytes) -> int:
    """Find where the second record of summaries is: the first names it."""
    return int(struct.unpack_from("<d", kernel, 1024)[0])


# The first two are segmentation faults in CSPICE N67, the third is an abort.
FAULTS = {
    "many doubles": (lambda kernel: replaced(kernel, 8, "<i", 385), "not of 2 doubles and 6 integers"),
    "many integers": (lambda kernel: replaced(kernel, 12, "<i", 1000), "not of 2 doubles and 6 integers"),
    "very many arrays": (lambda kernel: replaced(kernel, 1040, "<d", 1e9), r"cannot have 1e\+09 of them"),
    "no number of arrays": (lambda kernel: replaced(kernel, 1040, "<d", float("nan")), "cannot have nan of them"),
    "a list that is round": (
        lambda kernel: replaced(kernel, 1024 * (second(kernel) - 1), "<d", 2.0), "to record 2, out of the file or",
    ),
    "a list that leads out": (lambda kernel: replaced(kernel, 1024, "<d", 1e18), r"to record 1e\+18, out of the file"),
    "an array that leads out": (lambda kernel: replaced(kernel, 1024 + 24 + 36, "<i", 2**30), "does not lie in its"),
    "another kind": (lambda kernel: b"DAS/DSK " + kernel[8:], "no SPK, CK or PCK"),
    "a beginning alone": (lambda kernel: kernel[:500], "no SPK, CK or PCK"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_what_would_end_the_process_is_refused(kernel, tmp_path, fault):
    damage, said = FAULTS[fault]
    path = tmp_path / "a.bsp"
    path.write_bytes(damage(kernel))
    with (
        pytest.raises(BoresightError, match=f"not a kernel that SPICE reads: .*{said}") as caught,
        loaded_kernels([path]),
    ):
        pass
    assert "\n" not in str(caught.value)


def test_the_other_order_of_bytes_is_followed_too(kernel, tmp_path):
    """The frame alone, as CSPICE translates the rest when it reads."""
    words = np.frombuffer(kernel, "<f8").astype(">f8").tobytes()
    head = bytearray(kernel[:1024])
    head[88:96] = b"BIG-IEEE"
    for at in (8, 12, 76, 80, 84):
        head[at : at + 4] = head[at : at + 4][::-1]
    content = bytearray(bytes(head) + words[1024:])
    for record in (2, second(kernel)):
        start = 1024 * (record - 1)
        for index in range(int(struct.unpack_from("<d", kernel, start + 16)[0])):
            at = start + 24 + 40 * index + 16
            content[at : at + 24] = np.frombuffer(kernel, "<i4", 6, at).astype(">i4").tobytes()
    path = tmp_path / "a.bsp"
    path.write_bytes(content)
    check_binary(path)
    path.write_bytes(replaced(bytes(content), 1024 + 24 + 36, ">i", 2**30))
    with pytest.raises(ValueError, match="does not lie in its"):
        check_binary(path)
