"""``python -m boresight``: the command line where the script ``boresight`` is not on the path."""

import sys

from boresight.campaign.cli import main

sys.exit(main())
