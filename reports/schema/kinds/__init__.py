"""Columns and measures of each kind of trial; a module exports its `reports.schema.column.KindSchema` as ``SCHEMA``."""
