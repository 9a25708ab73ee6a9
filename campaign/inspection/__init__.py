"""One case of a stored run: recomputed from its seed, held against what is stored, kept whole and drawn.

``case`` and ``ranking`` say which trial, ``recompute`` works it out again, ``same`` compares it bit by bit, ``draw``
finds what draws its kind (``single``, ``sequence``, ``craters``, ``orbit``), ``keep`` writes all that came about.
"""
