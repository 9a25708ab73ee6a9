"""What is to be seen in space of each kind of trial: ``images``, ``sequence``, ``orbit`` and ``craters``.

``parts`` holds what they share: which trials are good and bad, and how far away cameras are drawn.
"""
