"""The checks of a newcomer: what they keep from the machine, and what they say where they cannot."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / ".ci" / "run"
NEEDED = ("bash", "sh", "env", "dirname", "mktemp", "mkdir", "rm", "id", "cat", "chmod", "ls")
MAKE = """#!/usr/bin/env bash
echo "make $1"
if [[ $1 == */.installed ]]; then
  mkdir -p "$VENV/bin"
  for name in python boresight; do echo '#!/bin/sh' > "$VENV/bin/$name"; chmod +x "$VENV/bin/$name"; done
fi
if [ "$1" = test ]; then for one in HOME BORESIGHT_DATA XDG_{DATA,CONFIG,CACHE,STATE}_HOME; do
  echo "$one holds [$(ls -A "${!one}")] outside [${!one##"$TMPDIR"/*}]"
done; fi
"""
UNSHARE = """#!/bin/sh
[ "$2" = true ] && exit 0
echo "alone: $1"
while [ "$1" != sh ] || [ "$2" = -c ]; do shift; done
shift
exec "$@"
"""


@pytest.mark.parametrize("able", [True, False])
def test_the_first_tests_see_no_home_no_data_and_no_network_or_say_so(able, tmp_path):
    for name in NEEDED:
        (tmp_path / name).symlink_to(str(shutil.which(name)))
    stubs = {"make": MAKE, "apt-get": "#!/bin/sh\n", **({"unshare": UNSHARE, "ip": "#!/bin/sh\n"} if able else {})}
    for name, text in stubs.items():
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    environment = {
        "PATH": str(tmp_path),
        "HOME": str(Path.home()),
        "XDG_DATA_HOME": str(tmp_path),
        "TMPDIR": str(tmp_path),
    }
    done = subprocess.run([SCRIPT], env=environment, capture_output=True, text=True, check=False, timeout=60, cwd="/")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(" holds [] outside []") == 6
    assert ("alone: --net" in done.stdout) == able
    assert ("KEEP THE NETWORK" in done.stdout) == (not able)
    assert os.access(SCRIPT, os.X_OK)
