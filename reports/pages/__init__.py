"""Reports as HTML pages, Markdown and tables for the terminal."""
