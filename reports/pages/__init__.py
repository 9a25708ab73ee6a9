"""What is written for a reader: pages, Markdown, terminal."""
