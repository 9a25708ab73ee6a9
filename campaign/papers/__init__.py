"""Pages of papers, with figures and tables from stored runs; each paper is a module that defines ``PAPER``."""
