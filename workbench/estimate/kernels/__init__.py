"""Compiled loops: stem paths, the output-error model along them, and many of both side by side."""
