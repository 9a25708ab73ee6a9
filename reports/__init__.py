"""What is told: statistics, tables, figures and the report page."""
