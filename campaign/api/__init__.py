"""Monte Carlo evaluation of camera navigation around small bodies.

>>> import boresight
>>> rows = boresight.run("quickstart", trials=50)  # a pandas frame
>>> boresight.trial("quickstart", "landmark-harris").plot()  # a Matplotlib figure

`campaign_names`, `scenario_names` and `estimator_names` list what the other functions take; each also takes the path of
a YAML file, and an estimator can be ``module:Class`` or ``file.py:Class``. What is asked for wrongly raises a
`BoresightError` of one line. A name is imported at its first use, from where ``__init__.pyi`` says.
"""

import os

import lazy_loader

# OpenCV filters by Intel's IPP, which comes out otherwise on processors with AVX-512, and with it the medians of
# recognition. IPP reads this at its first use.
os.environ["OPENCV_IPP"] = "avx2"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
