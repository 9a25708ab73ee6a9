"""Figures of reports, drawn from plain tables and arrays.

In all of them ``title`` is printed above the panels, and ``credit_lines``, the credits of real images, below them.
"""
