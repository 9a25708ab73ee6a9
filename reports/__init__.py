"""Statistics, tables, figures and the report page of stored runs."""
